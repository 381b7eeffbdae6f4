"""What every command shares: progress, results as a table or JSON, errors as one sentence with an
exit code.

Exit codes: 2 bad input, 3 a sampler that could not make what was asked for, 1 a bug.
"""

import errno
import io
import json
import os
import re
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import rich.console
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.reports.signals import Signals

LONGEST = 600
"""Most characters of a sentence; the middle of a longer one is left out."""
_CUT_OFF = re.compile(r"Error reading persistent compilation cache entry for '([\w.<>-]+)'")
"""What JAX says of compiled code in its folder that cannot be read."""
_ARITHMETIC = re.compile(
    r"(divide by zero|overflow|underflow|invalid value) encountered|Mean of empty slice"
    r"|All-NaN (slice|axis) encountered|Degrees of freedom <= 0"
)
"""What NumPy says of numbers that are not finite: nothing that a user of the command could act on;
tests, where warnings are errors, and `make fuzz` hear of it."""


def printable(text: str, keep: str = "") -> str:
    """A text of which nothing reaches a terminal but what can be read: escape sequences, what would
    turn the direction of writing, and what stands for no character are spelt out."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in keep else ascii(one)[1:-1] for one in text)


class _Console(rich.console.Console):
    """Tables on a terminal. Neither markup nor emoji codes: names of files and recordings are
    printed as they are."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Every text in a table or a title comes by here."""
        return super().render_str(printable(text, keep="\n"), **options)


OUT = _Console()
ERR = _Console(stderr=True)
PATIENCE = 2.0
"""Seconds after which anything shows its progress."""
RAREST = 60.0
"""Most seconds between two lines of progress in a log; the first ones are closer, and every pause
is twice the last."""
Step = Callable[[int, int], None]
_SYSTEM = (
    errno.EACCES,
    errno.EFBIG,
    errno.EIO,
    errno.ELOOP,
    errno.EMFILE,
    errno.ENAMETOOLONG,
    errno.ENOSPC,
    errno.EPERM,
    errno.EROFS,
)
"""What the system may say of any file at any time; that one does not exist is known before."""
_USAGE: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer raises on a wrong command line, under one name in all its versions."""


@contextmanager
def progress(what: str, quiet: bool) -> Iterator[Step]:
    """A function (done, wanted) that shows progress: a bar on a terminal, lines in a log, nothing
    when quiet."""
    what = printable(what)
    if quiet:
        yield lambda done, wanted: None
    elif ERR.is_terminal:
        with _bar() as bar:
            task = bar.add_task(what, total=None)
            yield lambda done, wanted: bar.update(task, completed=done, total=wanted)
    else:
        with _Log(what) as log:
            yield log.step


def _bar() -> Progress:
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=ERR, transient=True)


class _Log:
    """Lines of progress by a thread of their own: what is slow may not call `step` for a long
    time."""

    def __init__(self, what: str) -> None:
        self._what, self._count = what, ""
        self._started = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)

    def step(self, done: int, wanted: int) -> None:
        self._count = f"{done:,} of {wanted:,}, "

    def _talk(self) -> None:
        wait = PATIENCE
        while not self._over.wait(wait):
            seconds = time.monotonic() - self._started
            print(f"{self._what}: {self._count}{seconds:.0f} s", file=sys.stderr, flush=True)
            wait = min(2 * wait, RAREST)

    def __enter__(self) -> "_Log":
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()


def say(line: str) -> None:
    """Prints a line on stdout, however long."""
    print(printable(line))


def warn(sentence: str) -> None:
    """Prints a sentence on stderr: something is not as it should be, and the work goes on."""
    print(_spoken(sentence), file=sys.stderr, flush=True)


def _spoken(sentence: str) -> str:
    """One line of at most `LONGEST` characters; what is wrong stands at its beginning, what to do
    at its end."""
    said = printable("poseterior: " + " ".join(sentence.splitlines()))
    half = LONGEST // 2 - 2
    return said if len(said) <= LONGEST else f"{said[:half]} … {said[-half:]}"


def show(as_json: bool, value: Any, *shown: Any) -> None:
    """Results on stdout: `value` as JSON, or else tables and sentences, one after the other."""
    if as_json:
        show_json(value)
        return
    for one in shown:
        say(one) if isinstance(one, str) else OUT.print(one)


def show_json(value: Any) -> None:
    """Prints a value as JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def output_folder(path: Path) -> Path:
    """Makes the folder if need be. Raises `BadInput` where it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise BadInput(f"{path} is a file; --out needs the name of a folder") from None
    except (OSError, ValueError) as error:
        raise BadInput(
            f"cannot make the folder {path} ({_reason(error)}); choose another --out"
        ) from None
    _try_writing(path)
    return path


def output_file(path: Path) -> Path:
    """Checks, before any work is done, that a file can be written. Raises `BadInput` where it
    cannot."""
    if os.path.isdir(path):
        raise BadInput(f"{path} is a folder; --out needs the name of a file")
    if not os.path.isdir(path.parent):
        raise BadInput(f"the folder {path.parent} does not exist; make it, or choose another --out")
    try:
        # Results are first written beside their place, under a longer name.
        (path.parent / f"{path.name}.partial").exists()
    except OSError as error:
        raise BadInput(f"cannot write {path} ({_reason(error)}); choose another --out") from None
    if path.exists() and not path.is_file():
        # A device, say: results are renamed into place, which would put a file where it was.
        raise BadInput(f"{path} is not a regular file; choose another --out")
    _try_writing(path.parent)
    return path


def _try_writing(folder: Path) -> None:
    """Permissions alone do not tell (an administrator has them all); a file without a name does."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInput(
            f"cannot write to the folder {folder} ({_reason(error)}); choose another --out"
        ) from None


def write_text(path: Path, text: str) -> None:
    """Writes a text file, atomically. Raises `BadInput` where it cannot be written."""
    from poseterior.probmodel.files import replacing

    with replacing(path, "choose another --out") as partial:
        partial.write_text(text, encoding="utf-8")


def open_page(path: Path) -> None:
    """Opens a page in the user's browser; says so where there is none."""
    import webbrowser

    if not webbrowser.open(path.resolve().as_uri()):
        warn(f"no browser could be started; open {path} in one yourself")


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def refuse(sentence: str, code: int) -> NoReturn:
    """Prints one sentence on stderr and leaves with an exit code."""
    print(_spoken(sentence), file=sys.stderr)
    raise SystemExit(code)


def guarded(app: typer.Typer) -> None:
    """Runs the application; failures that have a sentence become that sentence and their exit
    code."""
    _prepare_streams()
    with Signals() as signals, warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: _heed(str(message))
        try:
            code = app(sys.argv[1:] or ["--help"], prog_name="poseterior", standalone_mode=False)
            sys.stdout.flush()
        except BrokenPipeError:
            _let_go_of_stdout()  # whoever read it has gone; nothing is left to say
            raise SystemExit(1) from None
        except (KeyboardInterrupt, typer.Abort):
            signals.leave()
        except Exception as error:
            sentence, code = _verdict(error)
            if not sentence:
                raise  # a bug: Python shows where, and leaves with 1
            refuse(sentence, code)
        if code == 130:  # how typer reports a KeyboardInterrupt
            signals.leave()
        raise SystemExit(code or 0)


def _heed(message: str) -> None:
    """Passes a library's warning on, unless it is of arithmetic. JAX never replaces compiled code
    that was cut off, by a full disk or by a kill, and would compile it anew in every run: it is
    taken away."""
    if _ARITHMETIC.match(message):
        return
    broken = _CUT_OFF.match(message)
    if broken is None:
        warn(message)
        return
    import jax

    kept = jax.config.jax_compilation_cache_dir
    for path in Path(kept).glob(f"{broken[1]}-*-cache") if kept else ():
        with suppress(OSError):
            path.unlink()
    warn(f"compiled code that was kept of {broken[1]} is damaged; it is made anew")


def _prepare_streams() -> None:
    """Refuses what could be neither said nor recorded."""
    if sys.stderr is None:  # closed; `print` would take stdout instead
        sys.stderr = io.StringIO()
    if sys.stdout is None:
        refuse("stdout is closed; send it to a file, or to /dev/null", 2)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError):  # what a test or a notebook puts there may not be able to
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    for word in sys.argv:
        if any("\ud800" <= letter <= "\udfff" for letter in word):
            refuse(f"{word} is not UTF-8, and could not be recorded in the results; rename it", 2)


def _verdict(error: Exception) -> tuple[str, int]:
    """The sentence and the exit code of a failure; no sentence where it is a bug."""
    if isinstance(error, _USAGE):
        return _usage(error), 2
    if isinstance(error, BadInput):
        return str(error), 2
    if isinstance(error, OutOfBudget):
        return str(error), 3
    if _of_jax_backends(error):
        asked = os.environ.get("JAX_PLATFORMS", "")
        return (
            f"JAX cannot compute on {asked!r}, as JAX_PLATFORMS says: this machine has no such"
            " device, or JAX lacks what it needs for it; leave the variable out, or say cpu"
            if asked
            else f"JAX finds no device to compute on ({str(error).partition(chr(10))[0]}); set"
            " JAX_PLATFORMS=cpu"
        ), 2
    if isinstance(error, MemoryError):
        return "the memory does not suffice; ask for fewer samples with --num-samples", 2
    if isinstance(error, OSError) and error.filename is not None and error.errno in _SYSTEM:
        return f"{error.filename}: {error.strerror}; choose another name or place", 2
    if isinstance(error, OSError) and error.filename is None and error.strerror:
        _let_go_of_stdout()
        return f"cannot write the output ({error.strerror}); make room, or send it elsewhere", 2
    return "", 1


def _of_jax_backends(error: Exception) -> bool:
    """Whether JAX failed to find a device: where it raised, since it raises errors of many kinds,
    an AssertionError among them."""
    if not isinstance(error, RuntimeError | AssertionError):
        return False
    frames = traceback.walk_tb(error.__traceback__)
    return any(frame.f_globals.get("__name__") == "jax._src.xla_bridge" for frame, _ in frames)


def _let_go_of_stdout() -> None:
    """What cannot be written is given up, before Python tries once more on its way out."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _usage(error: Any) -> str:
    message = error.format_message().strip().rstrip(".")
    command = error.ctx.command_path if error.ctx else "poseterior"
    return f"{message[:1].lower()}{message[1:]}; see `{command} --help`"
