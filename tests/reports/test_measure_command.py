"""`poseterior measure`: a table, a file and a picture of a result's joint angles, lengths and
steps."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from poseterior.inference import Item, Result, measure_intervals, measures, sample_frames
from poseterior.probmodel import Estimate, PoseModel
from poseterior.probmodel.measures import MEASURES
from poseterior.reports.figures.measures import bands_figure, continued, densities_figure
from poseterior.reports.tables.measures import measures_table
from tests.conftest import Cli
from tests.scenes import key

KNEE, SPAN = "right_knee_flexion", "distance(left_wrist,right_wrist)"


@pytest.fixture(scope="module")
def folder(example_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    example_result.save(folder / "posterior.nc")
    return folder


@pytest.fixture(scope="module")
def stream(example_estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of two people, whose frames do not come in the order of time; frame 3 is not there."""
    folder = tmp_path_factory.mktemp("stream") / "s"
    items = [Item(f"f_{frame}/{who}", example_estimate) for frame in (4, 2) for who in (0, 1)]
    items.append(Item("f_1/0", "f_1 has no torso; choose another"))
    given = {"num_samples": 30, "k": 2, "keep": 20, "root": "candidates"}
    sample_frames(PoseModel(), items, key=key(0), out=folder, **given)
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_all_of_a_result(folder: Path, tmp_path: Path, poseterior: Cli) -> None:
    out = tmp_path / "measures.csv"
    done = poseterior("measure", str(folder), "--out", str(out), "--quiet")
    assert done.code == 0, done.err
    rows = rows_of(out)
    assert [row["measure"] for row in rows] == list(MEASURES)
    summed = measure_intervals(measures(folder))
    for field in ("mean", "sd", "low", "high"):
        found = [float(row[field]) for row in rows]
        np.testing.assert_allclose(found, summed[field], rtol=1e-5)
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert "right knee flexion" in done.out
    assert max(map(len, done.out.splitlines()[:-1])) <= 80
    assert "body unit" in done.out


def test_some_in_millimetres(folder: Path, tmp_path: Path, poseterior: Cli) -> None:
    out = tmp_path / "m.nc"
    words = ("--measure", KNEE, "--measure", SPAN, "--height", "1.8", "--interval", "0.5")
    done = poseterior("measure", str(folder), *words, "--out", str(out), "--json")
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert [(one["measure"], one["unit"]) for one in said["measures"]] == [
        (KNEE, "degrees"),
        (SPAN, "mm"),
    ]
    assert said["measures"][0]["convention"] == MEASURES[KNEE].convention
    with xr.open_datatree(out) as tree:
        low, high = np.quantile(tree["draws"][SPAN], [0.25, 0.75])
        assert said["measures"][1]["low"] == pytest.approx(low)
        assert said["measures"][1]["high"] == pytest.approx(high)
        assert {"seed", "limits", "versions", "source"} <= set(tree.attrs)
        assert tree.attrs["probability"] == 0.5
        assert tree.attrs["height"] == 1.8


def test_a_film(stream: Path, tmp_path: Path, poseterior: Cli) -> None:
    """In the order of time, a row for each frame; a gap where there is none, nothing where there is
    no pose."""
    out = tmp_path / "knee.csv"
    words = ("--person", "0", "--measure", KNEE, "--out", str(out), "--quiet")
    done = poseterior("measure", str(stream), *words)
    assert done.code == 0, done.err
    rows = rows_of(out)
    assert [row["frame"] for row in rows] == ["f_1", "f_2", "f_4"]
    assert {row["person"] for row in rows} == {"0"}
    assert rows[0]["mean"] == ""
    assert float(rows[2]["low"]) < float(rows[2]["mean"]) < float(rows[2]["high"])
    assert "Measures of the film" in done.out
    assert out.with_suffix(".png").exists()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--measure", "right_knee"), "there is no measure 'right_knee'"),
        (("--interval", "95"), "an interval of 95 is none"),
        (("--height", "180"), "180 is not the height"),
        (("--person", "1"), "is of one person; leave --person out"),
        (("--out", "measures.xlsx"), "is to be a .csv"),
    ],
)
def test_what_is_refused(
    folder: Path,
    words: tuple[str, ...],
    match: str,
    tmp_path: Path,
    poseterior: Cli,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = poseterior("measure", str(folder), *words, "--quiet")
    assert done.code == 2
    assert match in done.err
    assert not list(tmp_path.iterdir())


def test_a_stream_is_asked_whose_and_for_its_draws(
    stream: Path, example_estimate: Estimate, tmp_path: Path, poseterior: Cli
) -> None:
    done = poseterior("measure", str(stream), "--out", str(tmp_path / "a.csv"))
    assert done.code == 2
    assert "(on the command line --person)" in done.err
    given = {"num_samples": 10, "k": 1, "root": "candidates"}
    items = [Item("f/0", example_estimate)]
    sample_frames(PoseModel(), items, key=key(0), out=tmp_path / "bare", **given)
    done = poseterior("measure", str(tmp_path / "bare"), "--out", str(tmp_path / "a.csv"))
    assert done.code == 2
    assert "--keep" in done.err


def gids(figure: Figure, kind: str) -> list[str]:
    found = [one.get_gid() or "" for one in figure.findobj()]
    return [gid for gid in found if gid.startswith(kind)]


def test_pictures_show_what_was_asked_for(example_result: Result, stream: Path) -> None:
    found = measures(example_result, KNEE, "trunk_rotation", SPAN)
    summed = measure_intervals(found)
    figure = densities_figure(found, summed, list(found))
    assert gids(figure, "density") == [f"density {name}" for name in found]
    assert {f"mean {name}" for name in found} <= set(gids(figure, "mean"))
    film = measures(stream, KNEE, SPAN).isel(frame=[3, 1])
    figure = bands_figure(measure_intervals(film), [2, 4], [KNEE, SPAN])
    assert gids(figure, "band") == [f"band {KNEE}", f"band {SPAN}"]
    line = next(one for one in figure.axes[0].lines if one.get_gid() == f"mean {KNEE}")
    assert np.isfinite(line.get_ydata()).tolist() == [True, False, True]


def test_two_modes_are_said_with_their_masses(example_result: Result) -> None:
    found = measures(example_result, KNEE)
    draws = np.where(np.arange(found[KNEE].size) % 4, 120.0, 30.0)
    jitter = np.random.default_rng(0).normal(0, 4, draws.shape)
    found[KNEE].values[:] = (draws + jitter).reshape(found[KNEE].shape)
    text = measures_table(measure_intervals(found)).markdown()
    assert "(25 %) or 1" in text
    assert "(75 %)" in text


def test_angles_go_on_over_the_ends_of_the_circle() -> None:
    angles = np.array([np.nan, 170.0, -175.0, np.nan, -160.0, 175.0])
    np.testing.assert_allclose(continued(angles), [np.nan, 170, 185, np.nan, 200, 175])
