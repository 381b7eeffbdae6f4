"""SIGINT and SIGTERM end a command within a second, with a sentence and an exit code of their
own."""

import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

ENDINGS: dict[int, tuple[str, int]] = {
    signal.SIGINT: ("interrupted", 130),
    signal.SIGTERM: ("terminated", 143),
}
"""What is said, and the exit code."""
GRACE = 0.7
"""Seconds in which a command may end by itself: it removes what is half written, and its workers
stop."""


class Signals:
    """Turns the first signal into a `KeyboardInterrupt`, and ends the process where that does not
    come through: compiled loops do not listen, and a pool waits for its threads."""

    def __init__(self) -> None:
        self._caught: int = signal.SIGINT
        self._asked = threading.Event()
        self._over = threading.Event()

    @property
    def ending(self) -> tuple[str, int]:
        """The sentence and the exit code of the signal that came."""
        return ENDINGS[self._caught]

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
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self._write)

    def _answer(self, number: int, frame: FrameType | None) -> None:
        if not self._asked.is_set():
            self._asked.set()
            self._caught = number
            raise KeyboardInterrupt

    def _watch(self) -> None:
        """Python answers signals in its main thread only, between two of its own steps; the file
        that it writes their numbers to is read here at once."""
        while number := os.read(self._read, 1):
            if number[0] in self._before and not self._over.wait(GRACE):
                _leave(*ENDINGS[number[0]])
        os.close(self._read)


def _leave(sentence: str, code: int) -> None:
    """Ends the process without waiting for anybody."""
    files = sys.modules.get("probmodel.files")
    unfinished: set[Path] = getattr(files, "UNFINISHED", set())
    for path in list(unfinished):
        path.unlink(missing_ok=True)
    show_cursor = "\r\x1b[K\x1b[?25h" if os.isatty(2) else ""  # a progress bar has hidden it
    os.write(2, f"{show_cursor}poseterior: {sentence}\n".encode())
    os._exit(code)
