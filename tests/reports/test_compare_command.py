"""`poseterior compare`: what it writes and says, its refusals, and that nothing computed is
lost."""

import contextlib
import dataclasses
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import rich.console
import xarray as xr

from poseterior.probmodel import BadInput, PoseModel, write_detections
from poseterior.reports.commands import compare
from poseterior.reports.figures.comparison import comparison_figure
from poseterior.reports.options import Person, RootKind, Screen, Viewing
from poseterior.reports.settings import CompareSettings
from poseterior.reports.tables.comparison import COMPARED_COLUMNS, NARROW, comparison_table
from tests.scenes import ALL_BUT_AN_ARM, prior_scene

JSON = Screen(quiet=True, json=True)


@pytest.fixture(scope="module")
def detection(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("frames") / "frame.json"
    write_detections(path, [prior_scene(PoseModel(), 1, missing=ALL_BUT_AN_ARM).detection])
    return path


def asked(
    detection: Path, out: Path, samplers: str, evaluations: int = 20_000, seconds: float = 60.0
) -> CompareSettings:
    return CompareSettings(
        person=Person(file=detection),
        samplers=samplers,
        out=out,
        seconds=seconds,
        max_evaluations=evaluations,
        num_samples=500,
        rooting=Viewing(root=RootKind.fixed),
    )


@pytest.fixture(scope="module")
def done(detection: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """One small comparison, its folder and what it printed."""
    out = tmp_path_factory.mktemp("out") / "comparison"
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        compare.run(asked(detection, out, "rejection, emcee"), JSON)
    return out, said.getvalue()


@pytest.mark.slow
def test_the_comparison_is_written_and_said(done: tuple[Path, str]) -> None:
    out, said = done
    lines = json.loads(said)["samplers"]
    assert [line["sampler"] for line in lines] == [
        "rejection",
        "emcee (dispersed)",
        "emcee (one flip)",
    ]
    assert lines[0]["verdict"] in ("agrees", "differs")
    assert lines[0]["ess_per_second"] > lines[1]["ess_per_second"]
    tree = xr.open_datatree(out / "comparison.nc")
    assert list(tree["summary"].sampler.values) == [line["sampler"] for line in lines]
    assert set(tree.children) >= {
        "summary",
        "tests",
        "coordinates",
        "joints",
        "modes",
        "course",
        "draws",
    }
    assert tree.attrs["versions"]
    assert (out / "comparison.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_another_call_goes_on_whoever_else_is_asked(
    done: tuple[Path, str], detection: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out, said = done
    before = json.loads(said)["samplers"][1]
    shutil.copytree(out, tmp_path / "again")
    compare.run(asked(detection, tmp_path / "again", "emcee"), JSON)
    after = json.loads(capsys.readouterr().out)["samplers"][0]
    assert after["num_evaluations"] == before["num_evaluations"]
    assert after["ess_worst"] == before["ess_worst"]


@pytest.mark.slow
def test_the_table_and_the_picture(done: tuple[Path, str]) -> None:
    tree = xr.open_datatree(done[0] / "comparison.nc").load()
    sheet = comparison_table(tree)
    rows = sheet.texts()
    assert [row[0] for row in rows] == ["rejection", "emcee (dispersed)", "emcee (one flip)"]
    assert all(len(row) == len(COMPARED_COLUMNS) for row in rows)
    assert "±" in rows[0][-1]
    assert sheet.markdown().split("\n\n")[0].count("\n") == 4
    for width, shown in ((80, sheet.only(NARROW)), (160, sheet)):
        printed = io.StringIO()
        rich.console.Console(file=printed, width=width).print(shown)
        assert "emcee (dispersed)" in printed.getvalue()
        assert "…" not in printed.getvalue()
    assert sheet.only(NARROW).head == list(NARROW)
    figure = comparison_figure(tree)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[0].startswith("Ranks")
    assert titles[3].startswith("Distance")
    assert len(figure.axes[3].lines) == 4  # three samplers and the distance to reach
    shown = figure.axes[3].lines[0]
    np.testing.assert_allclose(shown.get_xdata(), tree["course"].seconds.sel(sampler="rejection"))


def line(start: str, **numbers: float) -> xr.DataTree:
    """The summary of one sampler that agrees, worth 144 draws, after ten seconds."""
    found = {"ess_worst": 144.0, "ess_per_second": 1.6, "rhat_worst": 3.91, "seconds": 10.0}
    found |= {"settled_per_second": 2.0, "time_known": 0.0, "seconds_to_distance": 2.0}
    found |= {"log_evidence": np.nan, "log_evidence_se": np.nan, "missed_mass": 0.0}
    words = {"verdict": "agrees", "start": start, "sentence": "no test rejects"}
    values = {name: ("sampler", [value]) for name, value in (found | words | numbers).items()}
    coords = {"sampler": ["random-walk (dispersed)"]}
    return xr.DataTree.from_dict({"summary": xr.Dataset(values, coords=coords)})


def test_what_agrees_by_its_start_is_said_to() -> None:
    """As printed once: agrees, 144 effective draws, R-hat 3.91. It was started in exact draws."""
    sheet = comparison_table(line("dispersed"))
    said = sheet.caption
    assert sheet.json()[0]["by_its_start"] == said, "in what programs read as well"
    for form in (sheet.markdown(), sheet.only(NARROW).markdown(), sheet.html()):
        assert said in form
    assert said == (
        "random-walk (dispersed) agrees because it was started in exact draws: of its 144"
        " effective draws it has earned 16, and R-hat 3.91 says that its chains are still far apart"
    )
    mixed = comparison_table(line("dispersed", rhat_worst=1.02)).caption
    assert mixed.endswith("has earned 16"), "a good R-hat does not earn draws"
    apart = comparison_table(line("dispersed", ess_per_second=14.0)).caption
    assert "has earned 140" in apart, "earned draws do not bring chains together"
    assert not comparison_table(line("dispersed", ess_per_second=14.0, rhat_worst=1.02)).caption
    assert not comparison_table(line("")).caption, "it was given nothing"


def test_what_cannot_be_compared_is_refused_before_any_work(
    detection: Path, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match="no sampler 'magic'; choose from rejection"):
        compare.run(asked(detection, tmp_path / "a", "emcee,magic"), JSON)
    with pytest.raises(BadInput, match="--seconds must be more than 0"):
        compare.run(asked(detection, tmp_path / "b", "emcee", seconds=0), JSON)
    few = dataclasses.replace(asked(detection, tmp_path / "c", "emcee"), num_samples=99)
    with pytest.raises(BadInput, match="--num-samples must be at least 100, not 99"):
        compare.run(few, JSON)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_broken_file_loses_nothing_else(done: tuple[Path, str], detection: Path) -> None:
    out, _ = done
    kept = (out / "runs" / "emcee-one-flip.npz").read_bytes()
    (out / "runs" / "emcee-one-flip.npz").write_bytes(kept[:1000])
    with pytest.raises(BadInput, match=r"emcee-one-flip.npz is no saved run, or is truncated"):
        compare.run(asked(detection, out, "rejection,emcee"), JSON)
    (out / "runs" / "emcee-one-flip.npz").write_bytes(kept)
    tree = xr.open_datatree(out / "comparison.nc")
    assert "emcee (dispersed)" in tree["summary"].sampler.values


@pytest.mark.slow
def test_no_draws_is_a_line_of_its_own(
    detection: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    compare.run(asked(detection, tmp_path, "random-walk", evaluations=1), JSON)
    lines = json.loads(capsys.readouterr().out)["samplers"]
    assert all(line["verdict"] == "no draws" for line in lines)
    assert all("not one draw" in line["sentence"] for line in lines)
