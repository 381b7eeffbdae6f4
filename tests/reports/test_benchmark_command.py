"""`poseterior benchmark`: what it lists, draws and says, and what it refuses."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference.benchmark import shipped_points, targets
from poseterior.reports.tables.benchmark import targets_table
from tests.conftest import Cli

ROOT = Path(__file__).parents[2]


def test_the_list(poseterior: Cli) -> None:
    run = poseterior("benchmark", "list", "--json")
    assert run.code == 0
    listed = json.loads(run.out)["targets"]
    assert [one["target"] for one in listed] == list(targets())
    assert all(one["log_evidence"] < 0 < one["largest_mode"] <= 1 for one in listed)
    rows = targets_table().texts()
    assert rows[0][:4] == ["single", "6", "disc", "-7.057 ± 0.003"]


@pytest.mark.slow
def test_exact_draws_are_judged_to_agree(poseterior: Cli, tmp_path: Path) -> None:
    out = tmp_path / "draws.npz"
    run = poseterior(
        "benchmark", "draws", "--target", "single", "--num-samples", 1000, "--out", out
    )
    assert (run.code, run.out.startswith("1,000 exact draws of single")) == (0, True)
    with np.load(out) as file:
        np.savez(out, points=file["points"], seconds=2.0, evaluations=1000)
    run = poseterior("benchmark", "judge", out, "--target", "single")
    assert run.code == 0
    assert "no difference found" in run.out
    assert "worst coordinate: " in run.out
    assert "mass in modes never visited: " in run.out
    assert "effective draws per second: " in run.out
    assert "ranks of joints" in run.out
    run = poseterior("benchmark", "judge", out, "--target", "single", "--json")
    found = json.loads(run.out)
    assert found["verdict"] == "agrees"
    assert found["evidence_error"] is None
    assert {"name", "p_value", "size"} <= set(found["tests"][0])


@pytest.mark.parametrize(
    ("arrays", "target", "words"),
    [
        ({"points": np.zeros((3, 5))}, "arm", "arm needs (draws, 6) or (chains, draws, 6)"),
        ({"points": np.zeros((3, 6))}, "leg", "there is no target 'leg'; choose one of single"),
        ({"points": np.full((3, 6), 50.0)}, "arm", "3 of 3 draws of"),
        ({"draws": np.zeros((3, 6))}, "arm", "has an array 'draws'; it may have points, box"),
    ],
)
def test_refusals_come_at_once(
    arrays: dict[str, np.ndarray], target: str, words: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / "draws.npz", **arrays)
    code = """
import sys
from poseterior.reports.cli import main
try:
    main()
finally:
    print([name for name in ("jax", "numba", "xarray") if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "benchmark", "judge", "draws.npz", "--target", target],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split())
    assert done.stdout.strip() == "[]"


POINTS = shipped_points("arm")[:400]
BROKEN = np.where(np.arange(400)[:, None] == 3, np.nan, POINTS)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"points": BROKEN}, "1 of 400 draws of"),
        ({"points": np.tile(POINTS[:1], (30, 1))}, "stands still: its 30 draws are one and the"),
        ({"points": POINTS, "weights": np.linspace(-1, 1, 400)}, "200 of 400 weights of"),
        ({"points": POINTS, "weights": np.zeros(400)}, "no draw counts, so run the sampler anew"),
    ],
    ids=["not a number", "standing still", "negative weights", "weights of zero"],
)
def test_what_cannot_be_draws_is_code_2(
    arrays: dict[str, np.ndarray], words: str, poseterior: Cli, tmp_path: Path
) -> None:
    np.savez(tmp_path / "draws.npz", **arrays)
    run = poseterior("benchmark", "judge", tmp_path / "draws.npz", "--target", "arm")
    assert run.code == 2
    assert words in " ".join(run.err.split())
