"""What reaches the terminal, and how a command is ended from outside."""

import contextlib
import io
import json
import resource
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import rich.console
import xarray as xr
from rich.table import Table

from poseterior.inference.results import save_tree
from poseterior.probmodel import BadInput
from poseterior.probmodel.example import example
from poseterior.reports import console
from poseterior.reports.signals import Signals
from tests.conftest import Cli
from tests.reports.test_cli import failing

ROOT = Path(__file__).parents[2]
EVIL = "\x1b[31mred\x1b]0;title\x07 \x9b2J \u202eright to left \x00 \ud800 \U000be400"
HARMLESS = r"\x1b[31mred\x1b]0;title\x07 \x9b2J \u202eright to left \x00 \ud800 \U000be400"


def test_what_steers_a_terminal_is_spelt_out(capsys: pytest.CaptureFixture[str]) -> None:
    console.say(f"found {EVIL} in café.json → ✓")
    console.warn(EVIL)
    with pytest.raises(SystemExit):
        console.refuse(f"{EVIL}\nis bad", 2)
    said = capsys.readouterr()
    assert said.out == f"found {HARMLESS} in café.json → ✓\n"
    assert said.err == f"poseterior: {HARMLESS}\nposeterior: {HARMLESS} is bad\n"


def test_tables_and_progress_do_not_steer_either(monkeypatch: pytest.MonkeyPatch) -> None:
    table = Table(EVIL, title=EVIL)
    table.add_row(EVIL + "\nsecond line")
    screen = io.StringIO()
    monkeypatch.setattr(console, "OUT", type(console.OUT)(file=screen, width=200))
    console.OUT.print(table)
    assert screen.getvalue().count(HARMLESS.rstrip()) == 3
    assert not set("\x1b\x07\x9b\u202e\x00") & set(screen.getvalue())
    bar = io.StringIO()
    monkeypatch.setattr(
        console, "ERR", rich.console.Console(file=bar, force_terminal=True, width=200)
    )
    with console.progress(f"draws by {EVIL} [bold]", quiet=False):
        pass
    assert HARMLESS in bar.getvalue()
    assert "[bold]" in bar.getvalue()
    assert "\x1b]0;" not in bar.getvalue()


def test_a_detector_s_image_id_is_harmless(poseterior: Cli, tmp_path: Path) -> None:
    """From the file to the screen: it is refused, and what is said of it is harmless."""
    keypoints = np.full((17, 3), 50.0)
    keypoints[:, 0] += np.arange(17) * 7
    row = {"image_id": EVIL, "category_id": 1, "keypoints": keypoints.ravel().tolist(), "score": 1}
    (tmp_path / "f.json").write_text(json.dumps([row]))
    for words in (("show",), ("hypotheses", "--num-samples", "1", "--k", "1", "--person", "7")):
        run = poseterior(words[0], tmp_path / "f.json", *words[1:], "--out", tmp_path / "o.png")
        assert run.code == 2, run.err
        assert "the image_id of person 0" in run.err
        assert not set("\x1b\x07\x9b\u202e\x00") & set(run.out + run.err)


@pytest.mark.parametrize("sentence", ["word " * 1000, "\x1b" * 400, "x" * 588])
def test_a_sentence_has_an_end(sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        console.refuse(f"it is wrong: {sentence}; mend it", 2)
    said = capsys.readouterr().err.rstrip("\n")
    assert len(said) <= console.LONGEST
    assert said.startswith("poseterior: it is wrong: ")
    assert said.endswith("; mend it")


@pytest.mark.parametrize(
    "words",
    [
        "prior --num-samples 5 --out {}.nc",
        "hypotheses f.json --out {}",
        "learn x --out {}.npz",
        "sample f.json --out {}.nc",
        "show f.json --out {}.png",
        "check {}.npy",
        "show {}.json",
    ],
)
def test_a_name_of_300_letters(
    words: str, poseterior: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f.json").write_bytes(example().path.read_bytes())
    run = poseterior(*words.format("long" * 75).split(), "--quiet")
    assert run.code == 2, run
    assert run.err.startswith("poseterior: ")
    assert run.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["f.json"]


def test_a_disk_that_fills_up_under_netcdf(tmp_path: Path) -> None:
    """A limit on the size of files does to the writer what a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    tree = xr.DataTree(xr.Dataset({"a": ("x", np.random.default_rng(0).normal(size=100_000))}))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
        with pytest.raises(BadInput, match=r"cannot write .*a\.nc \(.*\); choose a folder"):
            save_tree(tree, tmp_path / "a.nc")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert not list(tmp_path.iterdir())


def test_closed_streams(tmp_path: Path) -> None:
    code = "from poseterior.reports.cli import main; main()"
    command = f"'{sys.executable}' -c '{code}' --version"
    shut = subprocess.run(
        ["sh", "-c", f"{command} >&-"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (shut.returncode, shut.stdout) == (2, "")
    assert shut.stderr == "poseterior: stdout is closed; send it to a file, or to /dev/null\n"
    mute = subprocess.run(
        ["sh", "-c", f"{command[:-9]} check nothing.npy 2>&-"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (mute.returncode, mute.stdout, mute.stderr) == (2, "", "")


STUBBORN = """
import sys, time
from pathlib import Path
from poseterior.probmodel.files import replacing
from poseterior.reports import console

def app(*_, **__):
    with replacing(sys.argv[1]) as partial:
        partial.write_text("half")
        print("ready", flush=True)
        while True:
            try:
                time.sleep(60)
            except BaseException:
                if sys.argv[2] == "listens":
                    raise

console.guarded(app)
"""
"""A command that is in the midst of writing, and listens to signals or does not."""


@pytest.mark.parametrize("manner", ["listens", "is deaf"])
@pytest.mark.parametrize(
    ("number", "code", "sentence"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
def test_a_signal_ends_any_command(
    number: int, code: int, sentence: str, manner: str, tmp_path: Path
) -> None:
    # In the background of a shell SIGINT is ignored from the start; a terminal's is not.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    with subprocess.Popen(
        [sys.executable, "-c", heed + STUBBORN, str(tmp_path / "out.txt"), manner],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "ready\n"
        running.send_signal(number)
        try:
            _, said = running.communicate(timeout=60)
        finally:
            running.kill()  # of no effect on what has ended
    assert (running.returncode, said) == (code, f"poseterior: {sentence}\n")
    assert not list(tmp_path.iterdir())


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with contextlib.suppress(SystemExit):
        console.guarded(failing(BadInput("no")))
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert signal.set_wakeup_fd(-1) == -1


def test_a_warning_of_a_library_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not Python's, with the file and the line."""

    def app(*_: object, **__: object) -> int:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("compiled loops are kept nowhere", stacklevel=1)
        return 0

    monkeypatch.setattr("sys.argv", ["poseterior", "demo"])
    with pytest.raises(SystemExit):
        console.guarded(app)  # type: ignore[arg-type]
    assert capsys.readouterr().err == "poseterior: compiled loops are kept nowhere\n"


def test_a_signal_that_meets_the_garbage_collector_is_not_shown(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nothing can be raised there: Python would print a traceback. Other failures it shows."""

    class Collected:
        def __init__(self, action: Callable[[], object]) -> None:
            self.action = action

        def __del__(self) -> None:
            self.action()

    def fails() -> None:
        raise ValueError("a bug")

    before = sys.unraisablehook
    shown: list[str] = []
    sys.unraisablehook = lambda failure: shown.append(str(failure.exc_value))
    try:
        with Signals() as signals:
            del signals._before[signal.SIGTERM]  # nobody ends this very process
            Collected(lambda: signal.raise_signal(signal.SIGTERM))
            Collected(fails)
        assert sys.unraisablehook is not before
    finally:
        sys.unraisablehook = before
    assert shown == ["a bug"]


def test_compiled_code_that_was_cut_off_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a kill or a full disk: JAX itself never replaces what it has once kept."""
    import jax

    for name in ("jit_one-12ab-cache", "jit_one-34cd-cache", "jit_other-12ab-cache"):
        (tmp_path / name).write_bytes(b"cut o")

    def app(*_: object, **__: object) -> int:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn(
                "Error reading persistent compilation cache entry for 'jit_one': error: -5",
                stacklevel=1,
            )
        return 0

    monkeypatch.setattr("sys.argv", ["poseterior", "demo"])
    monkeypatch.setattr(
        jax, "config", SimpleNamespace(jax_compilation_cache_dir=str(tmp_path)), raising=True
    )
    with pytest.raises(SystemExit):
        console.guarded(app)  # type: ignore[arg-type]
    assert [path.name for path in tmp_path.iterdir()] == ["jit_other-12ab-cache"]
    said = capsys.readouterr().err
    assert said == (
        "poseterior: compiled code that was kept of jit_one is damaged; it is made anew\n"
    )


@pytest.mark.parametrize("asked", ["cuda", "tpu", "nonsense"])
def test_a_device_that_is_not_there_is_one_sentence(
    asked: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """JAX raises an AssertionError, or a RuntimeError; others of these kinds stay bugs."""
    monkeypatch.setenv("JAX_PLATFORMS", asked)
    with pytest.raises((RuntimeError, AssertionError)) as failed:
        jax.devices(asked)
    sentence, code = console._verdict(failed.value)
    assert code == 2
    assert sentence.startswith(f"JAX cannot compute on '{asked}', as JAX_PLATFORMS says")
    for bug in (RuntimeError("none of JAX's"), AssertionError()):
        assert console._verdict(bug) == ("", 1)


@pytest.mark.parametrize(
    "compute",
    [
        lambda: np.ones(1) / np.zeros(1),
        lambda: np.zeros(1) / np.zeros(1),
        lambda: np.full(1, 1e308) * 10,
        lambda: np.nanmean(np.full(2, np.nan)),
        lambda: np.nanmedian(np.full(2, np.nan)),
        lambda: np.nanmax(np.full(2, np.nan)),
        lambda: np.var(np.ones(1), ddof=1),
        lambda: np.mean(np.ones(0)),
    ],
)
def test_arithmetic_of_numpy_is_no_users_business(
    compute: Callable, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where it warns, nothing is said; of other warnings, all is."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        compute()
    assert heard
    for warning in heard:
        console._heed(str(warning.message))
    assert capsys.readouterr().err == ""
    console._heed("a file is older than its source")
    assert capsys.readouterr().err == "poseterior: a file is older than its source\n"
