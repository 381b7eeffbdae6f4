"""Loops that another process compiles: they are those that the engine calls, they are found where
it looks for them, and nothing is started in vain."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from poseterior import inference
from poseterior.inference.exact import warm_up
from poseterior.inference.exact.loops import proposals
from poseterior.probmodel import PoseModel
from tests.scenes import prior_scene


def test_the_types_are_those_of_the_engine() -> None:
    model = PoseModel()
    inference.sample(
        model, prior_scene(model, 1), key=jax.random.key(0), num_samples=50, root="candidates"
    )
    for name, types in warm_up.signatures().items():
        assert types in getattr(proposals, name).signatures, name


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The commands of processes that are started; they end at once."""
    commands: list[list[str]] = []
    start = subprocess.Popen

    def recorded(command: list[str], **options: int) -> subprocess.Popen:
        commands.append(command)
        return start([sys.executable, "-c", ""], **options)

    monkeypatch.setattr(subprocess, "Popen", recorded)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    monkeypatch.setattr(warm_up, "_other", None)
    return commands


@pytest.mark.parametrize("root", warm_up.COMPILED)
def test_one_process_is_started_where_nothing_is_kept_for_this_root(
    root: str, started: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warm_up, "FOLDER", tmp_path)
    for other in set(warm_up.COMPILED) - {root}:
        (tmp_path / f"{warm_up.COMPILED[other]}-94.py312.nbi").touch()
    warm_up.begin(root)
    warm_up.begin(root)
    warm_up.wait()
    assert [command[1:] for command in started] == [
        ["-P", "-m", "poseterior.inference.exact.warm_up", root]
    ]


@pytest.mark.parametrize("why", ["kept", "no folder", "one core"])
def test_no_process_is_started_in_vain(
    why: str, started: list[list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warm_up, "FOLDER", None if why == "no folder" else tmp_path)
    if why == "kept":
        (tmp_path / "proposals.propose_limb-94.py312.nbi").touch()
    if why == "one core":
        monkeypatch.setattr(os, "cpu_count", lambda: 1)
    warm_up.begin("fixed")
    warm_up.wait()
    assert started == []


OTHER = [sys.executable, "-P", "-m", "poseterior.inference.exact.warm_up"]


def where_nothing_is_kept(folder: Path) -> dict:
    """How a process is run that keeps its loops in a folder of its own."""
    own = {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(Path(proposals.__file__).parents[4])}
    return {"env": {**os.environ, **own, "JAX_ENABLE_X64": "1"}}


@pytest.mark.slow
def test_what_the_other_process_compiles_is_found(tmp_path: Path) -> None:
    code = """
from poseterior.inference.exact import warm_up
from poseterior.inference.exact.loops import proposals
for name, types in warm_up.signatures().items():
    getattr(proposals, name).compile(types)
    print(sum(getattr(proposals, name).stats.cache_hits.values()))
"""
    options = where_nothing_is_kept(tmp_path)
    subprocess.run([*OTHER, "fixed"], check=True, **options)
    found = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, **options
    )
    assert found.stdout.split() == ["1"] * len(warm_up.signatures())


@pytest.mark.sweep
def test_what_weighs_limbs_is_found_too_and_nothing_else_is_compiled(tmp_path: Path) -> None:
    code = """
import jax
from poseterior import inference
from poseterior.inference.exact.loops import line_of_sight, pairs, seeds, weighted_limbs
from poseterior.probmodel import PoseModel
from tests.scenes import prior_scene
model = PoseModel()
scene = prior_scene(model, 1)
inference.sample(
    model, scene, key=jax.random.key(0), num_samples=50, root="uncertain", num_roots=40
)
for loop in (
    seeds._seed_rows,
    line_of_sight.line_of_sight_frames,
    weighted_limbs.draw_length_rows,
    weighted_limbs.propose_rows,
    pairs.combine_rows,
):
    print(sum(loop.stats.cache_hits.values()), sum(loop.stats.cache_misses.values()))
"""
    options = where_nothing_is_kept(tmp_path)
    subprocess.run([*OTHER, "uncertain"], check=True, **options)
    assert not list(tmp_path.rglob("proposals.*"))  # nothing in vain
    found = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, **options
    )
    assert found.stdout.split() == ["1", "0"] * 5
