"""The loops of attempts compiled by a second process, while this one imports, estimates and
compiles the loops of strata. Numba compiles under one lock, so that threads do not help; both
processes share its cache.

    begin()     # at the start of a command that draws
    wait()      # before the first attempt

Where anything of it fails, this process compiles the loops itself, as it always did."""

import atexit
import os
import subprocess
import sys

import numba
import numpy as np

from inference.exact.loops import attempts
from inference.exact.loops.numbers import FOLDER
from inference.exact.loops.tables import (
    ALIAS,
    CELLS,
    ENTRIES,
    SLICES,
    SUBS,
    CutLimb,
    LengthBins,
    LengthLaw,
    LimbProblem,
    LimbTables,
    Strata,
    desk,
)

PATIENCE = 120.0
"""Seconds that are waited for the other process at most."""
_other: subprocess.Popen | None = None


def begin() -> None:
    """Starts the other process, where there is something to compile and a core to do it."""
    global _other
    kept = FOLDER is None or any(FOLDER.rglob("attempts._attempt_limb-*.nbi"))
    if _other is not None or kept or (os.cpu_count() or 1) < 2:
        return
    # -P: a folder `inference` where the user happens to be is not ours.
    command = [sys.executable, "-P", "-m", "inference.exact.ahead"]
    quiet = subprocess.DEVNULL
    try:
        _other = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError:
        return
    atexit.register(_other.kill)


def wait() -> None:
    """Returns once the other process, if there is one, has ended."""
    if _other is None:
        return
    try:
        _other.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        _other.kill()


def signatures() -> dict[str, tuple]:
    """The types of what the engine calls each loop of attempts with."""
    limb = CutLimb(
        LimbProblem(np.eye(3), np.zeros((2, 2)), np.ones(2)),
        LimbTables(np.zeros(1, CELLS), (0.0,) * 6, False, False, 2),
        Strata(
            np.zeros(0, SUBS),
            np.zeros(0, ALIAS),
            np.zeros(0, ENTRIES),
            np.zeros(1, np.int64),
            np.zeros(0),
        ),
    )
    law = LengthLaw(0.0, 0.0, 0.0, 0.0)
    bins = LengthBins(law, np.zeros(0), np.zeros(1), np.zeros(0, ALIAS), np.zeros(0, SLICES))
    state, counts = np.zeros(4, np.uint64), np.zeros(0, np.int64)
    given = {
        "_attempt_lengths": (state, counts, bins, bins, True, desk(1)),
        "_attempt_limb": (state, limb, 1, 0, desk(1)),
    }
    return {name: tuple(map(numba.typeof, values)) for name, values in given.items()}


def main() -> None:
    """What the other process does."""
    for name, types in signatures().items():
        getattr(attempts, name).compile(types)


if __name__ == "__main__":
    main()
