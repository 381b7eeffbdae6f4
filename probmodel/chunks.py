"""Compiled functions over any number of rows: chunks of one size, the last one padded, so that one
compilation does, and by as many threads as there are cores."""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

CHUNK = 1 << 12


def in_chunks(function: Callable[..., Any], *rows: np.ndarray, size: int = CHUNK) -> Any:
    """Applies a function to rows, chunk by chunk.

    Parameters
    ----------
    function
        Maps rows `(size, …)` to rows, or to a pytree of them, in any thread. The last chunk is
        padded with its last row, so that the function never sees an invalid one.
    rows
        Arrays `(n, …)`.
    size
        Rows of a chunk.

    Returns
    -------
    What `function` returns, with `n` rows, as NumPy arrays.

    Raises
    ------
    ValueError
        Where there are no rows.
    """
    number = len(rows[0])
    if number == 0:
        raise ValueError("there are no rows")

    def chunk(start: int) -> Any:
        piece = [row[start : start + size] for row in rows]
        missing = size - len(piece[0])
        if missing:
            piece = [np.append(part, np.repeat(part[-1:], missing, axis=0), 0) for part in piece]
        return function(*piece)

    def put(start: int, found: Any) -> None:
        for room, leaf in zip(rooms, jax.tree.leaves(found), strict=True):
            room[start : start + size] = np.asarray(leaf)[: number - start]

    first = chunk(0)  # by this thread, and before others: it compiles
    leaves, tree = jax.tree.flatten(first)
    rooms = [np.empty((number, *leaf.shape[1:]), leaf.dtype) for leaf in leaves]
    put(0, first)
    list(_threads().map(lambda start: put(start, chunk(start)), range(size, number, size)))
    return jax.tree.unflatten(tree, rooms)


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """One a core: compiled functions are free of Python's lock."""
    return ThreadPoolExecutor(os.cpu_count())
