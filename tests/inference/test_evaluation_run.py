"""Evaluations as they run: blocks that are lost or damaged, workers and runs that are killed, what
is refused."""

import dataclasses
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from poseterior.inference.machines import Machines
from poseterior.inference.studies.evaluation.conditions import Condition
from poseterior.inference.studies.evaluation.outcome import Protocol
from poseterior.inference.studies.evaluation.run import (
    FRAMES_PER_BLOCK,
    STORE,
    Results,
    evaluate,
    open_evaluation,
)
from poseterior.probmodel import Anatomy, BadInput
from poseterior.probmodel.datasets import DataSet, from_motions, write_plain
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import Motion
from poseterior.reports import cli
from poseterior.reports.commands.evaluate import Predictions
from tests.sweeps import sweep

POSETERIOR = Path(sys.executable).with_name("poseterior")
TABLES = (
    "table1.csv",
    "table2.csv",
    "relations.csv",
    "metrics.csv",
    "best.csv",
    "calibration.csv",
    "sharpness.csv",
    "frames.csv",
    "measures.csv",
    "pck.csv",
    "evaluation.md",
)
PROTOCOL = Protocol(Anatomy.default(), PoseDictionary.default(), num_samples=25, ks=(2, 5))
ONE, TWO = Condition("zhou"), Condition("zhou", 1)


def made(frames: int) -> DataSet:
    """Frames of two actions in several recordings."""
    rng = np.random.default_rng(0)
    base = 330 * PoseDictionary.default().mean
    many = [
        Motion(
            base + np.linspace(0, 1, 30)[:, None, None] * rng.normal(size=(15, 3)) * 40,
            30.0,
            f"{action}/{n}",
            "a",
        )
        for action in ("running", "walking")
        for n in range(3)
    ]
    return from_motions(many, "made", frames=frames)


class Here(Machines):
    """Worker processes take their time to start: here this process does what they would."""

    def each(self, task, work, *, apart=False):
        assert apart
        return super().each(task, work)


DATA = made(FRAMES_PER_BLOCK + 5)


def run_here(
    out: Path, conditions=(ONE,), protocol: Protocol = PROTOCOL, **more: object
) -> Results:
    return evaluate(DATA, conditions, protocol, out, machines=Here(), **more)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Results]:
    out = tmp_path_factory.mktemp("whole")
    return out, run_here(out)


def same(one: Results, other: Results) -> bool:
    """Whether two evaluations have the same bits, times aside."""
    return one.keys() == other.keys() and all(
        np.array_equal(one[key][name], other[key][name], equal_nan=one[key][name].dtype.kind == "f")
        for key in one
        for name in PROTOCOL.fields
        if name != "seconds"
    )


def test_an_evaluation_is_opened_by_xarray(whole):
    out, results = whole
    tree = open_evaluation(out)
    assert list(tree.children) == [ONE.name]
    np.testing.assert_array_equal(tree[ONE.name]["single"], results[ONE]["single"])
    assert tree[ONE.name]["hypotheses_5"].dims == ("frame", "hypothesis_5", "joint")
    assert tree.attrs["num_samples"] == 25
    with xr.open_datatree(out / STORE / ONE.name / "block-000000.nc") as block:
        assert block["frames"].sizes["frame"] == FRAMES_PER_BLOCK


def zeroed(path: Path) -> None:
    with netCDF4.Dataset(path, "a") as file:
        file["frames"]["single"][3:] = 0.0


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-500])


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("spoil", sweep([zeroed, cut_off, Path.unlink], [zeroed]))
def test_lost_and_damaged_blocks_are_named_and_made_anew(spoil, number, whole, tmp_path, caplog):
    out, results = whole
    shutil.copytree(out, tmp_path, dirs_exist_ok=True)
    path = tmp_path / STORE / ONE.name / f"block-00000{number}.nc"
    other = path.with_name(f"block-00000{1 - number}.nc")
    before = other.stat().st_mtime_ns
    spoil(path)
    with pytest.raises(BadInput, match=path.name):
        open_evaluation(tmp_path)
    assert same(run_here(tmp_path), results)
    assert (f"{path} is damaged" in caplog.text) == (spoil is not Path.unlink)
    assert other.stat().st_mtime_ns == before


def test_progress_counts_what_was_there(whole, tmp_path):
    out, _ = whole
    shutil.copytree(out, tmp_path, dirs_exist_ok=True)
    (tmp_path / STORE / ONE.name / "block-000001.nc").unlink()
    done: list[tuple[int, int]] = []
    run_here(tmp_path, progress=lambda *counts: done.append(counts))
    assert done == [
        (FRAMES_PER_BLOCK, FRAMES_PER_BLOCK + 5),
        (FRAMES_PER_BLOCK + 5, FRAMES_PER_BLOCK + 5),
    ]


@pytest.mark.parametrize(
    ("other", "words"),
    [({"seed": 1}, r"its seed is 0, not 1"), ({"ks": (5,)}, r"its k is \[2, 5\], not \[5\]")],
)
def test_another_runs_store_is_left_alone(other, words, whole):
    out, _ = whole
    before = contents(out)
    protocol = dataclasses.replace(PROTOCOL, **other)
    for conditions in ((ONE,), (TWO,)):
        with pytest.raises(BadInput, match=f"holds another run .{words}"):
            run_here(out, conditions, protocol)
    assert contents(out) == before


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


# --- the command


def arguments(data: Path, out: Path, *more: str) -> list[str]:
    return [
        str(POSETERIOR),
        "evaluate",
        str(data),
        "--out",
        str(out),
        "--estimator",
        "zhou",
        "--num-samples",
        "25",
        "--k",
        "2,5",
        "--root",
        "fixed",
        "--no-bias",
        "--quiet",
        *more,
    ]


def evaluated(data: Path, out: Path, *more: str) -> subprocess.CompletedProcess:
    return subprocess.run(arguments(data, out, *more), capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("data") / "made.npz"
    write_plain(DATA, path)
    return path


@pytest.fixture(scope="module")
def undisturbed(data, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed")
    done = evaluated(data, out, "--missing", "0,1", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    tables = json.loads(done.stdout)["tables"]
    first = tables["table1"][0]
    assert first["name"] == "Zhou et al., single estimate"
    assert {row["lost"] for row in tables["frames"]} == {0}
    return out


def test_predictions_have_the_joints_of_the_data_set(tmp_path):
    """Whoever predicts Human3.6M's own truth errs by nothing, though it has another pelvis."""
    whole = dataclasses.replace(DATA, midpoints=("pelvis",))
    np.savez(tmp_path / "right.npz", joints=DATA.poses[:, None])
    found = Predictions.read(tmp_path / "right.npz", whole)
    assert found.errors == pytest.approx(0.0, abs=1e-6)
    assert found.samples["best_root"][:, 0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_the_command_writes_tables_and_pictures(undisturbed):
    names = {path.name for path in undisturbed.iterdir()}
    assert names == {*TABLES, "errors.png", "pck.png", STORE}
    page = (undisturbed / "evaluation.md").read_text()
    assert "## " in page
    assert "another data set, Human3.6M" in page


def said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, *command: str
) -> tuple[int, str, str]:
    """The command in this process: its exit code, and what it said on stdout and stderr."""
    monkeypatch.setattr(sys, "argv", ["poseterior", *command[1:]])
    monkeypatch.setattr(
        "poseterior.reports.options.prepare_jax", lambda: None
    )  # which tests have done, without a cache
    with pytest.raises(SystemExit) as left:
        cli.main()
    return left.value.code, *capsys.readouterr()


@pytest.mark.slow
def test_a_finished_run_is_only_told_again(data, undisturbed, monkeypatch, capsys):
    """No worker is needed for what is there, nor a scheduler."""
    before = (undisturbed / "metrics.csv").read_bytes()
    command = arguments(data, undisturbed, "--missing", "0,1", "--scheduler", "tcp://127.0.0.1:9")
    code, out, _ = said(monkeypatch, capsys, *command)
    assert code == 0
    assert "best of 2" in out
    assert (undisturbed / "metrics.csv").read_bytes() == before


@pytest.mark.slow
def test_frames_without_draws_are_told(data, undisturbed, tmp_path, monkeypatch, capsys):
    """All frames of the first condition of a finished run, spoilt on their way to the tables."""

    def spoilt(*given: object, **settings: object) -> Results:
        first, *_ = results = evaluate(*given, **settings)
        lost = {"status": "out of budget", "sentence": "no draw in a million proposals"}
        values = results[first]
        blank = {name: values[name] * np.nan for name in values if values[name].dtype.kind == "f"}
        words = {name: np.full(len(values["status"]), word) for name, word in lost.items()}
        return results | {first: values | blank | words}

    monkeypatch.setattr("poseterior.reports.commands.evaluate.evaluate", spoilt)
    out = Path(shutil.copytree(undisturbed, tmp_path / "out"))
    code, shown, told = said(monkeypatch, capsys, *arguments(data, out, "--missing", "0,1"))
    assert code == 0
    lost = f"{len(DATA)} of {len(DATA)} frames under zhou-missing-0-rotate-0 are lost"
    assert f"{lost}; the first: no draw in a million proposals" in told
    assert "nan" not in shown


NOBODY = "tcp://127.0.0.1:9"
REFUSED = {
    "another seed": ("holds another run (its seed is 0, not 1)", "--seed", "1"),
    "other draws": ("holds another run (its num_samples is 25, not 30)", "--num-samples", "30"),
    "no estimator": ("no estimator 'hmr' to evaluate", "--estimator", "hmr"),
    "no numbers": ("--missing must be numbers with commas", "--missing", "few"),
    "noise on given 2D": ("brings its own 2D joints", "--noise", "gaussian:0.1"),
    "no scheduler": (
        f"no scheduler answers at '{NOBODY}'",
        "--scheduler",
        NOBODY,
        "--missing",
        "2",
    ),
    "k too large": ("k must be different numbers from 1 to the 25 draws", "--k", "26"),
    "faults with fixed roots": ("choose --root uncertain alone", "--errors", "learned"),
    "upright with fixed roots": ("add `uncertain` to --root", "--upright", "20"),
    "composed into another run": ("composed", "--missing", "0,1", "--composed"),
    "no predictions": ("there is no file of poses", "--predictions", "nothing.npz"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_a_sentence_and_nothing_is_overwritten(
    case, data, undisturbed, monkeypatch, capsys
):
    words, *more = REFUSED[case]
    monkeypatch.setattr("poseterior.inference.machines.SCHEDULER_PATIENCE", "1s")
    before = contents(undisturbed)
    code, out, sentence = said(monkeypatch, capsys, *arguments(data, undisturbed, *more))
    assert (code, out) == (2, "")
    assert words in sentence
    assert sentence.count("\n") == 1
    after = contents(undisturbed)
    assert {name: after[name] for name in before} == before


def children(pid: int) -> list[int]:
    """The processes below a process, worker processes among them."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            own = int(path.parent.name)
            found += [own, *children(own)]
    return found


def workers(pid: int) -> list[int]:
    return [
        child
        for child in children(pid)
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]


@pytest.mark.sweep
@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="worker processes are found through /proc"
)
def test_killed_at_random_moments_it_ends_with_the_same_bits(data, undisturbed, tmp_path):
    """Workers, and the whole run, are killed without warning, again and again, until a run comes to
    its end; other runs have another number of workers. Every table is then what it would have been,
    and every number in the store."""
    rng = random.Random(0)
    killed = {"worker": 0, "run": 0}
    for attempt in range(4):
        command = arguments(data, tmp_path, "--missing", "0,1", "--workers", str(1 + attempt % 2))
        run = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
        moments = (
            0 if attempt >= 3 else 1 + attempt % 2
        )  # the last of them ends the run, those before it a worker
        begun = len(contents(tmp_path))
        while moments and run.poll() is None:
            wait_for_progress(run, tmp_path, begun)
            time.sleep(rng.uniform(0, 2.0))
            victims = workers(run.pid)
            if moments > 1 and victims:
                os.kill(rng.choice(victims), signal.SIGKILL)
                killed["worker"] += 1
            elif run.poll() is None:
                run.kill()
                killed["run"] += 1
            begun = len(contents(tmp_path))
            moments -= 1
        _, said = run.communicate(timeout=600)
        if run.returncode == 0:
            break
        assert run.returncode == -signal.SIGKILL, said
    assert run.returncode == 0
    assert killed["run"] > 0
    assert killed["worker"] > 0
    for name in TABLES:
        assert (tmp_path / name).read_bytes() == (undisturbed / name).read_bytes(), name
    fields = [name for name in PROTOCOL.fields if name != "seconds"]
    for condition in (ONE, TWO):
        for name in fields:
            mine, theirs = (stored(folder, condition, name) for folder in (tmp_path, undisturbed))
            assert np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f"), name


def stored(folder: Path, condition: Condition, field: str) -> np.ndarray:
    return open_evaluation(folder)[condition.name][field].values


def wait_for_progress(run: subprocess.Popen, folder: Path, files: int) -> None:
    """Until something more has been written, so that there is something to lose."""
    deadline = time.monotonic() + 240
    while run.poll() is None and len(contents(folder)) <= files and time.monotonic() < deadline:
        time.sleep(0.1)
