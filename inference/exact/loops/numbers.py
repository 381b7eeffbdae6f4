"""What the compiled loops have in common: how they are compiled, and uniform random
numbers, NumPy's SFC64, run on in four registers.

    stream = load(state)
    value, stream = uniform(stream)
    store(state, stream)

A test holds the numbers to NumPy's bit for bit.
"""

from collections.abc import Callable
from typing import Any

import jax
import numba
import numpy as np

from poseterior.inference.exact.loops.cache_folder import FOLDER

_settings: Any = numba.config  # its attributes are made at import


def _njit(function: Callable, **options: Any) -> Callable:
    options |= {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    if FOLDER is None:
        return numba.njit(**options)(function)
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = str(FOLDER)  # read while numba looks for a place
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        _settings.CACHE_DIR = before


def compiled(function: Callable) -> Callable:
    """How every function of the compiled loops is compiled: once a machine, free of
    Python's lock. Of fast-math, products and sums in one step, rounded once, are all
    that is allowed: what a processor without them computes may differ in its last
    digits. Arrays are handed over once a loop, never once an attempt: numba counts
    references at every call."""
    return _njit(function)


def inlined(function: Callable) -> Callable:
    """The same for formulas in the innermost loops: a call there would keep the loop
    from becoming vector instructions."""
    return _njit(function, forceinline=True)


Stream = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
"""The four words of a generator, as numbers."""


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
