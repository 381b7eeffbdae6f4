"""Torso and camera uncertain on the command line: files, tables, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from poseterior.inference.draws import OUT_OF_BUDGET
from poseterior.inference.saved import read_result
from poseterior.probmodel.anatomy.limits import EMBEDDED
from poseterior.probmodel.example import example
from poseterior.reports.cli import COMMANDS, declared
from poseterior.reports.options import PROGRAMS, PersonOrSession, Prior, RootKind, Viewing
from poseterior.reports.settings import HypothesesSettings, SampleSettings
from tests.conftest import Cli
from tests.reports.test_interactive import Parsed

EXAMPLE = example().path
UNCERTAIN = ("--root", "uncertain", "--num-samples", 400, "--quiet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("uncertain")


@pytest.mark.parametrize("command", ["hypotheses", "sample", "frames", "compare", "coverage"])
def test_who_asks_about_a_person_gets_all_that_is_uncertain(command: str) -> None:
    """The paper's way is asked for by its name."""
    (root,) = (one.default for one in declared(COMMANDS[command]) if one.name == "root")
    assert root == "uncertain"


def test_what_nobody_says_is_uncertain(poseterior: Cli, folder: Path) -> None:
    few = ("--num-samples", 400, "--roots", 200, "--quiet", "--json")
    said = [
        json.loads(poseterior("sample", EXAMPLE, "--out", folder / "d.nc", *few, *root).out)
        for root in ((), ("--root", "uncertain"))
    ]
    for one in said:
        del one["wall_time_s"]
    assert said[0] == said[1]


def test_hypotheses_differ_in_their_torsos(poseterior: Cli, folder: Path) -> None:
    run = poseterior("hypotheses", EXAMPLE, "--out", folder, *UNCERTAIN, "--roots", 200, "--json")
    assert run.code == 0, run
    said = json.loads(run.out)
    assert 20 < said["summary"]["effective_roots"] < said["summary"]["num_roots"] == 200
    assert said["summary"]["root"] == "uncertain"
    spread = {row["joint"]: row["depth_sd"] for row in said["joints"]}
    assert spread["thorax"] > 0.1
    assert sum(row["weight"] for row in said["candidates"]) == pytest.approx(1)
    assert all(row["turn_sd_degrees"] > 5 for row in said["candidates"] if row["weight"] > 0.05)
    chosen = json.loads((folder / "hypotheses.json").read_text())["hypotheses"]
    thorax = np.array([one["joints"]["thorax"] for one in chosen])
    assert np.ptp(thorax, axis=0).max() > 0.1
    assert (folder / "hypotheses.png").exists()
    with xr.open_datatree(folder / "posterior.nc", engine="netcdf4") as tree:
        draws = tree["posterior"]
        assert {"torso", "rotation", "scale", "translation", "root_index"} <= set(draws.data_vars)
        assert tree["roots"].share.shape == (200,)
        assert tree.attrs["effective_roots"] == said["summary"]["effective_roots"]
        assert tree.attrs["seed"] == "0 0"


@pytest.mark.slow
def test_composed_hypotheses_come_where_programs_are_kept(
    poseterior: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As every command keeps them; other tests do not."""
    monkeypatch.setenv(PROGRAMS, str(tmp_path / "programs"))
    out = tmp_path / "out"
    run = poseterior("hypotheses", EXAMPLE, "--out", out, *UNCERTAIN, "--roots", 200, "--composed")
    assert run.code == 0, run
    assert any((tmp_path / "programs").iterdir())
    chosen = json.loads((out / "hypotheses.json").read_text())["hypotheses"]
    assert all("keypoints" in one for one in chosen)
    assert poseterior("check", out / "hypotheses.json", "--quiet").code == 0


def test_results_say_under_which_limits_they_were_drawn(poseterior: Cli, tmp_path: Path) -> None:
    """So that `check` knows; the control: the usual limits exclude some of the wide ones' draws."""
    said = ("--out", tmp_path, *UNCERTAIN, "--roots", 200, "--limits", "wide")
    poseterior("hypotheses", EXAMPLE, *said)
    for file in (tmp_path / "posterior.nc", tmp_path / "hypotheses.json"):
        said = poseterior("check", file, "--quiet").out
        assert "are possible (limits wide)" in said
        possible, whole = said.split(" poses in")[0].splitlines()[-1].split(" of ")
        assert possible == whole
    narrow = poseterior("check", tmp_path / "posterior.nc", "--limits", "default", "--quiet").out
    assert "are possible (limits default)" in narrow
    assert "400 of 400" not in narrow


@pytest.mark.parametrize("root", RootKind)
@pytest.mark.parametrize("limits", EMBEDDED)
def test_what_is_said_of_limits_counts(root: RootKind, limits: str) -> None:
    assert Viewing(root=root).model(Prior(limits=limits)).limits.name == limits
    assert Viewing(root=root).model(Prior()).limits.name == "default"


def test_the_page_shows_every_hypothesis_by_its_own_camera(poseterior: Cli, folder: Path) -> None:
    said = ("--out", folder, *UNCERTAIN, "--roots", 200, "--focal", "weak")
    poseterior("hypotheses", EXAMPLE, *said)
    data = Parsed((folder / "hypotheses.html").read_text(encoding="utf-8")).data
    chosen = json.loads((folder / "hypotheses.json").read_text())["hypotheses"]
    with xr.open_datatree(folder / "posterior.nc", engine="netcdf4") as tree:
        draws, sides = tree["posterior"].isel(chain=0).load(), tree["constant_data"].load()
    for shown, one in zip(data["hypotheses"], chosen, strict=True):
        own, flat = draws.isel(draw=one["draw"]), np.array(shown["joints"])[:, :2]
        own_camera = float(own.scale) * flat + own.translation.values
        np.testing.assert_allclose(shown["projected"], own_camera, atol=1e-3)
        mean = sides.isel(candidate=int(own.candidate))
        of_side = float(mean.scale) * flat + mean.translation.values
        assert np.abs(of_side - own_camera).max() > 0.1, "the side's mean camera is another"
    thorax = data["joints"].index("thorax")
    assert all(rows[thorax]["counts"] is not None for rows in data["marginals"].values())
    assert "held fixed" not in (folder / "hypotheses.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_table_says_how_many_roots_count(poseterior: Cli, folder: Path) -> None:
    run = poseterior("sample", EXAMPLE, "--out", folder / "s.nc", *UNCERTAIN, "--roots", 200)
    assert run.code == 0, run
    assert "effective roots of 200" in run.out
    assert "Torso and camera are uncertain" in run.out
    assert "one possible pose in" not in run.out
    assert max(map(len, run.out.splitlines())) <= 80


@pytest.mark.slow
def test_a_baseline_draws_and_is_judged(poseterior: Cli, folder: Path) -> None:
    out = folder / "chains.nc"
    by = ("--root", "uncertain", "--sampler", "emcee", "--num-samples", 1000, "--quiet")
    run = poseterior("sample", EXAMPLE, "--out", out, *by)
    assert run.code == 0, run
    assert "effective roots of 1,000, R-hat" in run.out
    assert "roots drawn" in run.out
    with xr.open_datatree(out, engine="netcdf4") as tree:
        assert tree["posterior"].rotation.shape == (4, 250, 3, 3)
        assert "roots" not in tree.children
    few = ("--exact-draws", 100, "--num-samples", 100, "--roots", 400)
    by = ("--samplers", "weighted-roots,emcee", "--max-evaluations", 20_000, "--json")
    folder /= "contest"
    run = poseterior("compare", EXAMPLE, "--root", "uncertain", "--out", folder, *by, *few)
    assert run.code == 0, run
    lines = json.loads(run.out)["samplers"]
    assert [line["sampler"] for line in lines] == ["weighted-roots", "emcee (dispersed)"]
    assert (folder / "runs" / "emcee-dispersed.npz").exists()


def test_too_few_roots_are_no_answer(poseterior: Cli, folder: Path) -> None:
    out = folder / "few.nc"
    few = ("sample", EXAMPLE, "--out", out, *UNCERTAIN, "--roots", 15)
    run = poseterior(*few, "--most-roots", 15)
    assert run.code == 3, run
    assert "too few for an answer" in run.err
    assert "what there is, is saved" in run.err
    assert read_result(out).status == OUT_OF_BUDGET
    assert poseterior(*few).code == 0
    more = read_result(out).tree.attrs
    assert 15 < more["num_roots"] <= 16 * 15
    assert more["effective_roots"] >= 20


def test_a_sampler_under_fixed_roots_is_refused(poseterior: Cli, folder: Path) -> None:
    run = poseterior("sample", EXAMPLE, "--out", folder / "x.nc", *UNCERTAIN, "--sampler", "smc")
    assert run.code == 2, run
    assert "no sampler 'smc' draws torso and camera; choose" in run.err


@pytest.mark.slow
def test_an_outlier_stands_in_table_files_and_picture(poseterior: Cli, folder: Path) -> None:
    """The left wrist moved to a corner of the image, farther than an arm is long."""
    document = json.loads(EXAMPLE.read_text())
    document["people"][0]["keypoints"]["left_wrist"][:2] = [445.0, 30.0]
    file = folder / "moved.json"
    file.write_text(json.dumps(document))
    out, faults = folder / "moved", ("--outliers", 0.05, "--exchanges", 0.02)
    run = poseterior("hypotheses", file, "--out", out, *UNCERTAIN, "--roots", 200, *faults)
    assert run.code == 0, run
    assert "the left wrist's keypoint is an outlier" in run.out
    lines = [line for line in run.out.splitlines() if str(out) not in line]
    assert max(map(len, lines)) <= 80
    with xr.open_datatree(out / "posterior.nc", engine="netcdf4") as tree:
        draws = tree["posterior"]
        outlier = draws.outlier.sel(joint="left_wrist").values
        assert outlier.mean() > 0.95
        assert draws.exchange.values.max() < 6
        assert "with faults" in tree.attrs["errors"]
    calm = poseterior("sample", EXAMPLE, "--out", folder / "c.nc", *UNCERTAIN, "--json", *faults)
    assert json.loads(calm.out)["faults"]["outlier"]["left_wrist"] < 0.5


def test_outliers_need_an_uncertain_root(poseterior: Cli, folder: Path) -> None:
    by = ("hypotheses", EXAMPLE, "--out", folder / "no", "--root", "fixed")
    run = poseterior(*by, "--outliers", 0.1)
    assert run.code == 2
    assert "outliers and exchanges need torso and camera to be uncertain" in run.err
    run = poseterior(*by, "--outliers", 1.5)
    assert run.code == 2
    assert "probability of an outlier must lie between 0 and 1" in run.err


@pytest.mark.slow
def test_draws_by_rejection_say_so(poseterior: Cli, folder: Path) -> None:
    out, few = folder / "rejected.nc", ("--num-samples", 15, "--roots", 60, "--quiet")
    by = ("--root", "uncertain", "--sampler", "rejection")
    run = poseterior("sample", EXAMPLE, *by, *few, "--out", out, "--json")
    assert run.code == 0, run
    with xr.open_datatree(out, engine="netcdf4") as tree:
        assert tree.attrs["sampler"] == "rejection"
        assert tree.attrs["num_roots"] > 15
        assert sorted(tree["posterior"].root_index.values[0]) == list(range(15))
    assert json.loads(run.out)["effective_roots"] == pytest.approx(15)


def test_a_sampler_that_holds_the_root_is_refused(poseterior: Cli, folder: Path) -> None:
    for command, option in (("sample", "--sampler"), ("compare", "--samplers")):
        run = poseterior(command, EXAMPLE, "--root", "uncertain", option, "smc", "--quiet")
        assert run.code == 2, run
        assert "choose weighted-roots, rejection, emcee" in run.err


@pytest.mark.slow
def test_who_is_believed_upright_needs_an_uncertain_root(poseterior: Cli, folder: Path) -> None:
    few = ("--num-samples", 5, "--quiet")
    run = poseterior("sample", EXAMPLE, "--root", "fixed", "--upright", 20, *few)
    assert run.code == 2, run
    assert "a belief that people are upright needs torso and camera to be uncertain" in run.err
    out = folder / "upright.nc"
    run = poseterior("sample", EXAMPLE, *UNCERTAIN, "--roots", 300, "--upright", 20, "--out", out)
    assert run.code == 0, run
    with xr.open_datatree(out, engine="netcdf4") as tree:
        assert float(tree.attrs["upright"]) == pytest.approx((180 / np.pi / 20) ** 2, rel=1e-5)
        tilt = np.degrees(np.arccos(-tree["posterior"].rotation.values[0, :, 1, 1]))
        assert np.median(tilt) < 30


def test_what_is_compiled_ahead_is_what_the_call_draws_by() -> None:
    person, fixed = PersonOrSession(file=Path("frame.json")), Viewing(root=RootKind.fixed)
    assert HypothesesSettings(person=person).drawn == "uncertain"
    assert HypothesesSettings(person=person, rooting=fixed).drawn == "fixed"
    assert SampleSettings(person=person, sampler="rejection").drawn == "uncertain"
    assert SampleSettings(person=person, sampler="rejection", rooting=fixed).drawn == "fixed"
    assert SampleSettings(person=person, sampler="emcee", rooting=fixed).drawn is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            ["--root", "fixed", "--focal", 900, "--principal", "320,240"],
            "a known focal length needs torso and camera",
        ),
        ([*UNCERTAIN, "--focal", "weak", "--principal", "320,240"], "says nothing under weak"),
        ([*UNCERTAIN, "--focal", 0, "--principal", "320,240"], "a focal length must be positive"),
        ([*UNCERTAIN, "--focal", 900, "--principal", "middle"], "--principal must look like"),
        ([*UNCERTAIN, "--focal", 900, "--principal", "inf,0"], "must be two finite numbers"),
    ],
)
def test_cameras_that_cannot_be(poseterior: Cli, folder: Path, given: list, said: str) -> None:
    out = folder / "cameras.nc"
    run = poseterior("sample", EXAMPLE, *given, "--num-samples", 5, "--quiet", "--out", out)
    assert run.code == 2
    assert said in run.err
