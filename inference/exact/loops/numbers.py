"""What the compiled loops have in common: how they are compiled, matrices as numbers, and uniform
random numbers, NumPy's SFC64, seeded by NumPy, run on in four registers.

    stream = load(state)
    value, stream = uniform(stream)
    store(state, stream)

A test holds the numbers to NumPy's bit for bit.
"""

import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import jax
import numba
import numpy as np

_settings: Any = numba.config  # its attributes are made at import

SOURCES = (
    "inference/exact/loops/attempts.py",
    "inference/exact/loops/bins.py",
    "inference/exact/loops/blocks.py",
    "inference/exact/loops/bounds.py",
    "inference/exact/loops/fits.py",
    "inference/exact/loops/numbers.py",
    "inference/exact/loops/rectangles.py",
    "inference/exact/loops/roots.py",
    "inference/exact/loops/series.py",
    "inference/exact/loops/strata.py",
    "inference/exact/loops/tables.py",
    "probmodel/kinematics.py",
    "probmodel/anatomy/limits.py",
)
"""All files whose text ends in the compiled loops, as functions or as constants."""


def digest(texts: Iterable[bytes]) -> str:
    """A short name for a state of the sources."""
    return hashlib.sha256(b"\0".join(texts)).hexdigest()[:16]


def _places() -> list[Path]:
    """Where compiled loops may be kept, best first: where the user says, beside the package, in the
    user's cache."""
    said = [Path(_settings.CACHE_DIR)] if _settings.CACHE_DIR else []
    cache = Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache"))
    home = [cache / "poseterior"] if cache.is_absolute() else []  # a user may have no home
    return [*said, Path(__file__).parent / "__pycache__", *home]


def _usable(folder: Path) -> bool:
    """Whether the folder is there, or can be made, and can be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _temporary() -> Path | None:
    """This user's own folder among the temporary ones. Compiled loops are code: nobody else may be
    able to put any there."""
    try:
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = Path(tempfile.gettempdir()) / f"poseterior-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = found.st_uid == user and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return folder if private and folder.is_dir() and not folder.is_symlink() else None


def _kept_in(name: str) -> Path | None:
    """The folder of compiled loops; None where there is none. Numba compiles a function anew where
    its own file has changed, but not where a function or a constant of another file has that was
    compiled into it: after an update old and new loops would work on each other's tables. So each
    state of the sources has a folder of its own, its `name`."""
    for place in _places():
        if _usable(place / name):
            return place / name
    begin = "neither the package's folder nor the home folder can be written to"
    end = "NUMBA_CACHE_DIR can name another folder"
    temporary = _temporary()
    if temporary is None or not _usable(temporary / name):
        warnings.warn(
            f"{begin}, so every process compiles the sampling loops anew, which takes up to a "
            f"minute; {end}.",
            stacklevel=2,
        )
        return None
    for place in _places():  # an image may bring loops that were compiled before it was sealed
        if (place / name).is_dir():
            shutil.copytree(place / name, temporary / name, dirs_exist_ok=True)
    warnings.warn(
        f"{begin}, so the compiled sampling loops are kept in {temporary}; {end}.", stacklevel=2
    )
    return temporary / name


def _source_state() -> str:
    root = Path(__file__).parents[3]
    return digest((root / source).read_bytes() for source in SOURCES)


def _njit(function: Callable, **options: Any) -> Callable:
    options |= {"nogil": True, "error_model": "numpy"}
    if FOLDER is None:
        return numba.njit(**options)(function)
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = str(FOLDER)  # read while numba looks for a place
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        _settings.CACHE_DIR = before


FOLDER = _kept_in(f"loops-{_source_state()}")


def compiled(function: Callable) -> Callable:
    """How every function of the compiled loops is compiled: once a machine, free of Python's lock,
    without fast-math. Arrays are handed over once a loop, never once an attempt: numba counts
    references at every call."""
    return _njit(function)


def inlined(function: Callable) -> Callable:
    """The same for formulas in the innermost loops: a call there would keep the loop from becoming
    vector instructions."""
    return _njit(function, forceinline=True)


Stream = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
"""The four words of a generator, as numbers."""


def seeded(words: list[int], *path: int) -> np.ndarray:
    """`(4,)` uint64: a generator's state, for the words of a key and whole numbers that say what it
    is used for."""
    return (
        np.random.SFC64(np.random.SeedSequence(words, spawn_key=path))
        .state["state"]["state"]
        .copy()
    )


def words_of(key: jax.Array) -> list[int]:
    """A JAX key as whole numbers."""
    return np.asarray(jax.random.key_data(key)).ravel().tolist()


@compiled
def load(state: np.ndarray) -> Stream:
    """The state as numbers."""
    return state[0], state[1], state[2], state[3]


@compiled
def store(state: np.ndarray, stream: Stream) -> None:
    """Keeps how far the stream has come."""
    state[0], state[1], state[2], state[3] = stream


@compiled
def uniform(stream: Stream) -> tuple[np.float64, Stream]:
    """A number in [0, 1) and the stream after it."""
    a, b, c, count = stream
    value = a + b + count
    after = (
        b ^ (b >> np.uint64(11)),
        c + (c << np.uint64(3)),
        ((c << np.uint64(24)) | (c >> np.uint64(40))) + value,
        count + np.uint64(1),
    )
    return (value >> np.uint64(11)) * 1.1102230246251565e-16, after


Rows = tuple[float, float, float, float, float, float, float, float, float]
"""A matrix (3, 3), row by row, as numbers: arrays would be read anew at every step."""


@compiled
def rows_of(matrix: np.ndarray) -> Rows:
    """A matrix `(3, 3)` as numbers."""
    return (
        matrix[0, 0],
        matrix[0, 1],
        matrix[0, 2],
        matrix[1, 0],
        matrix[1, 1],
        matrix[1, 2],
        matrix[2, 0],
        matrix[2, 1],
        matrix[2, 2],
    )
