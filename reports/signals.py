"""SIGINT and SIGTERM end a command within a second, with a sentence and an exit code of their
own."""

import atexit
import contextlib
import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import NoReturn

ENDINGS: dict[int, tuple[str, int]] = {
    signal.SIGINT: ("interrupted", 130),
    signal.SIGTERM: ("terminated", 143),
}
"""What is said, and the exit code."""
GRACE = 0.5
"""Seconds in which a command may end by itself: it removes what is half written, and its workers
stop."""


class Signals:
    """Turns the first signal into a `KeyboardInterrupt`, and ends the process where that does not
    come through: compiled loops do not listen, and a pool waits for its threads."""

    def __init__(self) -> None:
        self._caught: int | None = None
        self._over = threading.Event()

    def __enter__(self) -> "Signals":
        # Where a signal is ignored from the start, as in the background of a shell, it stays so.
        usual = (signal.SIG_DFL, signal.default_int_handler)
        self._before = {
            number: signal.signal(number, self._answer)
            for number in ENDINGS
            if signal.getsignal(number) in usual
        }
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._unheard = sys.unraisablehook
        sys.unraisablehook = self._report
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        signal.set_wakeup_fd(self._wakeup)
        sys.unraisablehook = self._unheard
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._write)

    def leave(self) -> NoReturn:
        """Ends the process, once what was begun is put in order. Python's own way out would take
        seconds, in which it frees what the system takes back anyway."""
        if self._caught is None:  # a `KeyboardInterrupt` without a signal
            print("poseterior: interrupted", file=sys.stderr)
            raise SystemExit(130)
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
        _leave(self._caught)

    def _answer(self, number: int, frame: FrameType | None) -> None:
        if self._caught is None:
            self._caught = number
            raise KeyboardInterrupt

    def _report(self, failure: "sys.UnraisableHookArgs") -> None:
        """A signal may arrive while Python collects garbage, where nothing can be raised: there is
        nothing to show then, and `_watch` ends the process."""
        if self._caught is None or failure.exc_type is not KeyboardInterrupt:
            self._unheard(failure)

    def _watch(self) -> None:
        """Python answers signals in its main thread only, between two of its own steps; the file
        that it writes their numbers to is read here at once."""
        while number := os.read(self._read, 1):
            if number[0] in self._before and not self._over.wait(GRACE):
                _leave(number[0])
        os.close(self._read)


def depart(code: int) -> NoReturn:
    """Ends a process whose work is done: what is registered for the end happens, but nothing is
    taken to pieces. Python does that for half a second after JAX, numba and matplotlib have been
    imported, and the system takes all of it back anyway."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code)


def _leave(number: int) -> NoReturn:
    """Ends the process without waiting for anybody."""
    sentence, code = ENDINGS[number]
    files = sys.modules.get("poseterior.probmodel.files")
    unfinished: set[Path] = getattr(files, "UNFINISHED", set())
    for path in list(unfinished):
        path.unlink(missing_ok=True)
    show_cursor = "\r\x1b[K\x1b[?25h" if os.isatty(2) else ""  # a progress bar has hidden it
    os.write(2, f"{show_cursor}poseterior: {sentence}\n".encode())
    os._exit(code)
