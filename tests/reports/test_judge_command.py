"""`poseterior coverage judge`: what it writes and says of anybody's draws, and its refusals."""

import json
from pathlib import Path

import arviz_plots
import numpy as np
import pytest
import xarray as xr

from poseterior.inference.studies.judging import recalibrate
from poseterior.inference.studies.judging.judge import judge_levels
from poseterior.inference.studies.judging.wrong import told
from poseterior.probmodel import BadInput
from poseterior.reports.settings import CoverageJudgeSettings
from poseterior.reports.tables.judging import map_table, recalibrated_table
from tests.conftest import Cli

POSTERIORS = Path(__file__).parents[2] / "examples" / "posteriors"


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mine") / "mine.npz"
    case = told("width wrong by one covariate", 300, 40, np.random.default_rng(0))
    seen = {f"covariates.{name}": column for name, column in zip("uvw", case.seen.T, strict=True)}
    np.savez(path, draws=case.draws, truth=case.truth, **seen)
    return path


def test_the_verdict_is_said_written_and_plotted(
    poseterior: Cli, mine: Path, tmp_path: Path
) -> None:
    out = tmp_path / "judged"
    wider = tmp_path / "wider.json"
    run = poseterior("coverage", "judge", mine, "--out", out, "--recalibrate", wider, "--by", "u")
    assert run.code == 0, run.err
    assert "mine: miscalibrated: " in run.out
    assert "What central intervals hold" in run.out
    assert "no posterior any more" in run.out
    with xr.open_datatree(out / "mine.nc") as tree:
        assert tree.attrs["seed"] == 0
        assert "versions" in tree.attrs
        arviz_plots.plot_ecdf_pit(tree.load(), var_names=["quantity_0"], backend="none")
    assert (out / "mine.png").stat().st_size > 10_000
    record = json.loads(wider.read_text())
    assert record["covariate"] == "u"
    assert list(record["scores"]) == ["0", "1", "2"]
    again = poseterior("coverage", "judge", out / "mine.nc", "--json", "--quiet")
    found = json.loads(again.out)["mine"]
    assert found["covered"]["quantity 0"][0]["nominal"] == 0.5


def test_others_files_are_judged_together(poseterior: Cli) -> None:
    names = ("two_moons_nested", "two_moons_barely_trained")
    run = poseterior("coverage", "judge", *(POSTERIORS / f"{one}.npz" for one in names), "--json")
    assert run.code == 0, run.err
    found = json.loads(run.out)
    assert [found[one]["verdict"] for one in names] == ["calibrated", "miscalibrated"]


def write_coverage(path: Path, detector: str) -> None:
    """A coverage.nc of sixty people who were seen by a detector."""
    level = np.random.default_rng(len(detector)).uniform(size=(60, 2))
    groups = {
        "simulation": xr.Dataset(
            {"level": (("simulation", "quantity"), level)}, coords={"quantity": ["x", "y"]}
        ),
        "covariates": xr.Dataset({"detector": ("simulation", np.repeat(detector, 60))}),
    }
    path.parent.mkdir(parents=True)
    xr.DataTree.from_dict(groups).to_netcdf(path)


def test_files_of_one_name_are_told_by_their_folders(poseterior: Cli, tmp_path: Path) -> None:
    for name in ("openpose", "mediapipe"):
        write_coverage(tmp_path / name / "coverage.nc", name)
    write_coverage(tmp_path / "later" / "openpose" / "coverage.nc", "openpose")
    files = [tmp_path / name / "coverage.nc" for name in ("openpose", "mediapipe")]
    three = CoverageJudgeSettings(files=[*files, tmp_path / "later" / "openpose" / "coverage.nc"])
    assert list(three.named)[2] == "later-openpose-coverage"
    run = poseterior("coverage", "judge", *files, "--json")
    assert list(json.loads(run.out)) == ["openpose-coverage", "mediapipe-coverage"], run.err
    run = poseterior("coverage", "judge", *files, "--together", "--out", tmp_path / "judged")
    assert run.code == 0, run.err
    assert "detector" in run.out
    assert "mediapipe" in run.out
    assert "not all of the files have" not in run.err
    with xr.open_datatree(tmp_path / "judged" / "together.nc") as tree:
        assert tree.attrs["source"] == "openpose-coverage, mediapipe-coverage"
    for words, said in (
        ((*files, files[0], "--together"), "a file is given twice"),
        ((files[0], "--circular", "x"), "nothing that could be circular; leave `circular` out"),
        (
            (files[0], "--recalibrate", tmp_path / "r.json", "--by", "detector"),
            "all of coverage have one detector; leave --by out",
        ),
    ):
        run = poseterior("coverage", "judge", *words)
        assert run.code == 2
        assert said in run.err
        assert run.err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--by", "u"], "--by means nothing without --recalibrate"),
        (["--recalibrate", "r.json", "--by", "x"], "has no covariate x; known are: u, v, w"),
        (["--together"], "--together means nothing for one file; give more, or leave it out"),
        (["--circular", "heading"], "heading shall be circular and is no quantity"),
    ],
)
def test_refusals(poseterior: Cli, mine: Path, words: list[str], said: str) -> None:
    run = poseterior("coverage", "judge", mine, *words)
    assert run.code == 2
    assert said in " ".join(run.err.split())


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"nothing", "is no file of draws and truths"), (None, "has no draws or posterior_samples")],
)
def test_other_files_are_refused(
    poseterior: Cli, tmp_path: Path, content: bytes | None, said: str
) -> None:
    path = tmp_path / "other.npz"
    if content is None:
        np.savez(path, poses=np.ones(3))
    else:
        path.write_bytes(content)
    run = poseterior("coverage", "judge", path)
    assert run.code == 2
    assert said in " ".join(run.err.split())


def levels(*names: str) -> xr.DataArray:
    values = np.random.default_rng(0).uniform(size=(200, len(names)))
    return xr.DataArray(values, dims=("simulation", "quantity"), coords={"quantity": [*names]})


def test_joints_have_recalibrated_intervals() -> None:
    joints = np.random.default_rng(1).normal(size=(1, 1000, 15, 3))
    tree = xr.DataTree.from_dict(
        {"posterior": xr.Dataset({"joints": (("chain", "draw", "joint", "axis"), joints)})}
    )
    sheet = recalibrated_table(tree, recalibrate(levels("right_wrist z", "depth")))
    (row,) = sheet.json()
    assert row["quantity"] == "right_wrist z"
    assert row["95%"] == pytest.approx(row["posterior 95%"], abs=0.4)
    with pytest.raises(BadInput, match=r"knows no joint's coordinate.*only depth"):
        recalibrated_table(tree, recalibrate(levels("depth")))
    grouped = recalibrate(levels("right_wrist z"), by=("side", np.tile(["l", "r"], 100)))
    with pytest.raises(BadInput, match="the recalibration is by side"):
        recalibrated_table(tree, grouped)


def test_a_bin_of_which_nothing_is_known_is_no_row_of_the_map() -> None:
    level = np.random.default_rng(3).uniform(size=(60, 1))
    level[:15] = np.nan
    table = xr.DataArray(
        np.column_stack([level, level[::-1]]),
        dims=("simulation", "quantity"),
        coords={"quantity": ["x", "y"]},
    )
    found = judge_levels(table, {"who": np.repeat([*"abcd"], 15)})
    rows = map_table(found).json()
    assert len(rows) == 3
    assert "nan" not in str(rows)
