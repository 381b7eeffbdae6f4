"""`poseterior coverage`: what it writes and says, under the model and on real poses, and its
refusals."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from poseterior.inference.studies.calibration import judge, simulate
from poseterior.inference.studies.calibration.quantities import OF_BOTH, OF_POSE
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.datasets import DataSet, write_plain
from poseterior.reports.commands import coverage
from poseterior.reports.figures.coverage import controls_figure, ranks_figure
from poseterior.reports.options import Rooting, RootKind, Sampling, Screen
from poseterior.reports.settings import CoverageSettings
from poseterior.reports.tables.coverage import WORST, families_table, p_text, uniformity_table
from tests.conftest import Cli

JSON, TABLES = Screen(quiet=True, json=True), Screen(quiet=True)
FIXED = Rooting(root=RootKind.fixed, roots=200)


def asked(out: Path, num_samples: int = 20, **others: Any) -> CoverageSettings:
    sampling = Sampling(num_samples=num_samples, max_proposals=1_000_000)
    given = {"num_simulations": 100, "rooting": FIXED} | others
    return CoverageSettings(out=out, sampling=sampling, **given)


def read(path: Path) -> xr.DataTree:
    with xr.open_datatree(path) as tree:
        return tree.load()


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """One small run, its folder and what it printed."""
    import contextlib
    import io

    out = tmp_path_factory.mktemp("out") / "coverage"
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        coverage.run(asked(out), JSON)
    return out, json.loads(said.getvalue())


def test_the_run_is_written_and_said(done: tuple[Path, dict]) -> None:
    out, said = done
    assert said["verdict"] == "calibrated", said["sentence"]
    assert set(said["families"]) == {"ranks (SBC)", "highest density", "energy balls", "TARP"}
    assert [one["quantity"] for one in said["tests"]] == [*OF_POSE, *OF_BOTH]
    assert {one["size"] for one in said["tests"]} == {100}
    tree = read(out / "coverage.nc")
    assert tree["prior_sbc"].joints.shape == (1, 100, 9, 3)
    assert tree.attrs["sampler"] == "rejection"
    assert (out / "coverage.png").read_bytes().startswith(b"\x89PNG")


def test_arviz_plots_it_as_it_is(done: tuple[Path, dict]) -> None:
    import arviz_plots

    tree = read(done[0] / "coverage.nc")
    plot = arviz_plots.plot_ecdf_pit(tree, var_names=["log_density", "TARP"], backend="none")
    assert plot is not None


def test_another_call_goes_on(done: tuple[Path, dict], capsys: pytest.CaptureFixture) -> None:
    out = done[0]
    coverage.run(asked(out), TABLES)
    words = capsys.readouterr().out
    assert "calibrated: no test of 48 rejects at 0.01 with 100 simulations" in words
    assert "highest density" in words
    with pytest.raises(BadInput, match="holds another run"):
        coverage.run(asked(out, num_samples=21), TABLES)


def test_too_few_simulations_are_refused_before_any_work(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="99 simulations are too few: the tests need at least 100"):
        coverage.run(asked(tmp_path / "out", num_simulations=99), TABLES)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_draws_from_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Simulations are written, somebody draws (here: always the truth of the next one), and is
    found out."""
    coverage.run(asked(tmp_path, simulate_only=True), TABLES)
    tree = read(tmp_path / "simulations.nc")
    some = simulate(PoseModel(), 0, 0, 100)
    np.testing.assert_array_equal(tree["truth"].joints[3], some[3].joints)
    np.testing.assert_array_equal(
        tree["observed_data"].keypoints[3], some[3].frame.detection.keypoints
    )
    seen = np.isfinite(tree["constant_data"].radius.values[3])
    assert seen[some[3].frame.detection.seen].sum() == seen.sum()
    draws = np.roll(tree["truth"].joints.values, 1, axis=0)[:, None] + np.random.default_rng(
        0
    ).normal(size=(100, 10, 15, 3))
    np.savez(tmp_path / "draws.npz", joints=draws)
    capsys.readouterr()
    coverage.run(asked(tmp_path / "judged", 10, sampler=str(tmp_path / "draws.npz")), JSON)
    assert json.loads(capsys.readouterr().out)["verdict"] == "miscalibrated"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Poses of the model as a data set."""
    some = simulate(PoseModel(), 4, 0, 8)
    poses = np.stack([350 * instance.joints for instance in some])
    keypoints = np.stack([instance.frame.detection.keypoints for instance in some])
    score = np.stack([instance.frame.detection.score for instance in some])
    names = np.array([f"recording {number % 4}" for number in range(8)])
    scale, translation = np.full(8, 100 / 350), np.tile([320.0, 240.0], (8, 1))
    made = DataSet("made", poses, keypoints, score, scale, translation, names, names, names)
    path = tmp_path_factory.mktemp("data") / "made.npz"
    write_plain(made, path)
    return path


def test_real_poses(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    coverage.run(asked(tmp_path, dataset=data, frames=8, noise="none"), TABLES)
    words = capsys.readouterr().out
    assert "true poses are excluded" in words
    assert "right ankle" in words
    tree = read(tmp_path / "coverage.nc")
    assert tree["simulation"].sizes["simulation"] == 8
    assert tree.attrs["estimator"] == "true"
    assert (tmp_path / "coverage.png").exists()


@pytest.mark.slow
def test_real_poses_without_torso_and_camera(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    rooting = Rooting(root=RootKind.uncertain, roots=30)
    real = asked(tmp_path, dataset=data, frames=2, noise="none", rooting=rooting)
    coverage.run(real, JSON)
    said = json.loads(capsys.readouterr().out)
    assert said["poses"] == 2
    tree = read(tmp_path / "coverage.nc")
    assert (tree.attrs["root"], tree.attrs["num_roots"]) == ("uncertain", 30)
    with pytest.raises(BadInput, match="leave the estimator zhou out"):
        coverage.run(dataclasses.replace(real, estimator="zhou"), JSON)


@pytest.mark.slow
def test_estimated_torsos(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    real = asked(tmp_path, dataset=data, frames=8, noise="none", missing=1, estimator="zhou")
    coverage.run(real, JSON)
    said = json.loads(capsys.readouterr().out)
    assert said["poses"] == 8
    assert 0 <= said["excluded"] <= 1
    assert len(said["by_joint"]) == 81


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"noise": "pink:1"}, "must look like none, gaussian"),
        ({"estimator": "oracle"}, "no estimator 'oracle'"),
        ({"missing": 9}, "9 limb joints cannot be missing"),
        ({"frames": 0}, "at least 1"),
        ({"noise": "gaussian:0.02"}, "brings its own 2D joints"),
    ],
)
def test_bad_real_poses(data: Path, tmp_path: Path, change: dict, match: str) -> None:
    real = asked(tmp_path, **({"dataset": data, "frames": 8, "noise": "none"} | change))
    with pytest.raises(BadInput, match=match):
        coverage.run(real, TABLES)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--missing 1", "--missing means nothing without --dataset"),
        ("--frames 100", "--frames means nothing without --dataset"),
        ("--simulate-only --sampler rejection", "--sampler means nothing with --simulate-only"),
        ("--simulate-only --roots 30", "--roots means nothing with --simulate-only"),
        ("--simulate-only --noise none", "--noise means nothing with --simulate-only"),
        ("--dataset . --camera weak", "--camera means nothing but with views of people"),
        ("--dataset x.npz --num-simulations 9", "--num-simulations means nothing with --dataset"),
        ("--poses x.npz --simulate-only", "--simulate-only means nothing with --dataset"),
    ],
)
def test_an_option_of_another_way_is_refused(
    words: str,
    said: str,
    poseterior: Cli,
    tmp_path: Path,
) -> None:
    """Also where its value is the default."""
    run = poseterior("coverage", *words.split(), "--out", tmp_path / "out", "--quiet")
    assert (run.code, list(tmp_path.iterdir())) == (2, [])
    assert run.err.startswith(f"poseterior: {said}; leave it out")


def test_tables_and_figures_show_every_quantity(done: tuple[Path, dict]) -> None:
    tree = read(done[0] / "coverage.nc")
    simulation = tree["simulation"].to_dataset()
    figure = ranks_figure(simulation)
    drawn = {line.get_gid() for axis in figure.axes for line in axis.lines}
    assert {f"ranks {name}" for name in (*OF_POSE, *OF_BOTH)} <= drawn
    assert len(figure.axes) == 4  # nothing was asked of the root
    shown = controls_figure({"one": simulation, "other": simulation}, OF_BOTH[-2:])
    assert len(shown.axes[0].lines) == 3
    rows = uniformity_table(judge(simulation)).rows
    assert len(rows) == 4 + WORST
    assert p_text(0.0) == "< 1e-300"
    assert families_table({"exact": judge(simulation)}).markdown().count("\n") == 2
