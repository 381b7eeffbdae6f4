"""Joint angles, lengths and steps in CSV and in OpenSim's .mot and .sto, read back by the format's
own description."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from poseterior.inference import Item, Result, draws_of, hypotheses, sample_frames
from poseterior.inference.summaries import centre, deviation
from poseterior.probmodel import Estimate, PoseModel
from poseterior.probmodel.datasets import body_height
from poseterior.probmodel.measures import MEASURES, Measure, measure_of
from poseterior.reports.exports.measures import OPENSIM
from tests.conftest import Cli
from tests.scenes import key

KNEE, TURN, STEP = ASKED = "right_knee_flexion", "trunk_rotation", "step_length"
WORDS = [word for name in ASKED for word in ("--measure", name)]


@pytest.fixture(scope="module")
def folder(example_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    example_result.save(folder / "posterior.nc", double=True)
    return folder


@pytest.fixture(scope="module")
def stream(example_estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames 7, 8 (without a pose) and 10 of one person, whose draws are kept."""
    folder = tmp_path_factory.mktemp("stream") / "s"
    items = [
        Item("f_10/0", example_estimate),
        Item("f_7/0", example_estimate),
        Item("f_8/0", "f_8 has no torso; choose another"),
    ]
    given = {"num_samples": 30, "k": 2, "keep": 25, "root": "candidates"}
    sample_frames(PoseModel(), items, key=key(0), out=folder, **given)
    return folder


def read_motion(path: Path) -> tuple[dict[str, str], list[str], np.ndarray]:
    """Header, names of columns, and rows of an OpenSim storage file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    end = lines.index("endheader")
    header = dict(line.split("=") for line in lines[1:end])
    rows = np.array([[float(cell) for cell in line.split("\t")] for line in lines[end + 2 :]])
    return header, lines[end + 1].split("\t"), rows


def said(one: Measure, joints: np.ndarray, metres: float) -> tuple[float, float]:
    scale = metres if one.kind == "length" else 1.0
    draws = one.of(joints.astype(float))
    return scale * float(centre(draws, one.circular)), scale * float(deviation(draws, one.circular))


@pytest.mark.parametrize("to", ["mot", "sto"])
def test_a_film_in_opensims_table(stream: Path, tmp_path: Path, poseterior: Cli, to: str) -> None:
    """Frames without a pose have no row; those that are there have their times."""
    out = tmp_path / f"walk.{to}"
    done = poseterior("export", stream, "--to", to, *WORDS, "--rate", 10, "--out", out)
    assert done.code == 0, done.err
    tables = [read_motion(out), read_motion(tmp_path / "walk_sd.sto")]
    for header, names, rows in tables:
        assert header == {"version": "1", "nRows": "2", "nColumns": "4", "inDegrees": "yes"}
        assert names == ["time", "knee_angle_r", TURN, STEP]
        np.testing.assert_allclose(rows[:, 0], [0.0, 0.3])
    joints = draws_of(stream, "f_10/0").joints.values[0]
    rest = {name: measure_of(name) for name in (KNEE, TURN)}
    for column, one in enumerate(rest.values(), 1):
        value, spread = said(one, joints, 1.0)
        assert tables[0][2][1, column] == pytest.approx(value, abs=1e-5)
        assert tables[1][2][1, column] == pytest.approx(spread, abs=1e-5)


def test_a_length_is_of_the_person_of_that_height(
    folder: Path, tmp_path: Path, poseterior: Cli
) -> None:
    out = tmp_path / "r.csv"
    done = poseterior(
        *("export", folder / "posterior.nc", "--to", "csv", "--k", 3, *WORDS),
        *("--height", 1.8, "--out", out),
    )
    assert done.code == 0, done.err
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with xr.open_datatree(folder / "posterior.nc") as tree:
        joints = tree["posterior"].joints.values.reshape(-1, 15, 3)
    metres = 1.8 / float(np.median(body_height(joints)))
    for name, unit, scale in ((KNEE, "deg", 1), (TURN, "deg", 1), (STEP, "mm", 1000)):
        one = MEASURES[name]
        _, spread = said(one, joints, metres)
        assert float(rows[0][f"{name}_sd_{unit}"]) == pytest.approx(scale * spread, abs=2e-3)
        where = np.array([float(row[f"{name}_{unit}"]) for row in rows])
        wanted = one.of(joints) * (scale * metres if one.kind == "length" else 1)
        assert np.abs(wanted[:, None] - where).min(axis=0).max() < 2e-3  # each a draw's own


def test_every_column_where_nobody_says_which(
    folder: Path, tmp_path: Path, poseterior: Cli
) -> None:
    out = tmp_path / "all.mot"
    assert poseterior("export", folder, "--to", "mot", "--out", out).code == 0
    _, names, rows = read_motion(out)
    assert names[1:] == [OPENSIM.get(name, name) for name in MEASURES]
    assert len(rows) == 5
    assert len(set(names)) == len(names)


def test_hypotheses_alone_have_no_deviations(
    example_result: Result, tmp_path: Path, poseterior: Cli
) -> None:
    chosen = [one.as_json() for one in hypotheses(example_result, 2)]
    (tmp_path / "hypotheses.json").write_text(json.dumps({"hypotheses": chosen}))
    out = tmp_path / "x.mot"
    done = poseterior("export", tmp_path / "hypotheses.json", "--to", "mot", "--out", out)
    assert done.code == 0, done.err
    assert not (tmp_path / "x_sd.sto").exists()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--to", "bvh", "--measure", KNEE), "bvh has no room for measures"),
        (("--to", "csv", "--measure", "knee"), "there is no measure 'knee'"),
    ],
)
def test_what_has_no_room_is_refused(
    folder: Path, words: tuple[str, ...], match: str, poseterior: Cli
) -> None:
    done = poseterior("export", folder, *words)
    assert done.code == 2
    assert match in done.err
