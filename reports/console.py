"""What every command shares: progress, results as a table or JSON, errors as one sentence with an exit code.

Exit codes: 2 bad input, 3 a sampler that could not make what was asked for, 1 a bug.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import rich.console
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from probmodel.failures import BadInput, OutOfBudget

OUT = rich.console.Console(highlight=False)
ERR = rich.console.Console(stderr=True, highlight=False)
PATIENCE = 2.0
"""Seconds after which anything shows its progress, and between two lines of it in a log."""
Step = Callable[[int, int], None]


@contextmanager
def progress(what: str, quiet: bool) -> Iterator[Step]:
    """A function (done, wanted) that shows progress: a bar on a terminal, lines in a log, nothing when quiet."""
    if quiet:
        yield lambda done, wanted: None
    elif ERR.is_terminal:
        with _bar() as bar:
            task = bar.add_task(what, total=None)
            yield lambda done, wanted: bar.update(task, completed=done, total=wanted)
    else:
        yield _lines(what)


def _bar() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=ERR, transient=True)


def _lines(what: str) -> Step:
    last = [time.monotonic()]

    def step(done: int, wanted: int) -> None:
        if time.monotonic() - last[0] >= PATIENCE:
            last[0] = time.monotonic()
            print(f"{what}: {done} of {wanted}", file=sys.stderr, flush=True)

    return step


def show_json(value: Any) -> None:
    """Prints a value as JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def output_folder(path: Path) -> Path:
    """Makes the folder if need be. Raises `BadInput` where it cannot be made or written to."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot make the folder {path} ({error.strerror}); choose another --out") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise BadInput(f"cannot write to the folder {path}; choose another --out")
    return path


def output_file(path: Path) -> Path:
    """Checks, before any work is done, that a file can be written. Raises `BadInput` where it cannot."""
    if path.is_dir():
        raise BadInput(f"{path} is a folder; --out needs the name of a file")
    if not path.parent.is_dir():
        raise BadInput(f"the folder {path.parent} does not exist; make it, or choose another --out")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise BadInput(f"cannot write to the folder {path.parent}; choose another --out")
    return path


def write_text(path: Path, text: str) -> None:
    """Writes a text file, atomically. Raises `BadInput` where it cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise BadInput(f"cannot write {path} ({error.strerror}); choose another --out") from None


def refuse(sentence: str, code: int) -> NoReturn:
    """Prints one sentence on stderr and leaves with an exit code."""
    print(f"poseterior: {sentence}", file=sys.stderr)
    raise SystemExit(code)


def guarded(app: typer.Typer) -> None:
    """Runs the application; failures that have a sentence become that sentence and their exit code."""
    try:
        app()
    except BadInput as error:
        refuse(str(error), 2)
    except OutOfBudget as error:
        refuse(str(error), 3)
    except KeyboardInterrupt:
        refuse("interrupted", 130)
    except BrokenPipeError:
        # Whoever read the output has gone; nothing is left to say, and Python must not try to flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
