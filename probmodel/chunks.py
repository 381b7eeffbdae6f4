"""Compiled functions over any number of rows: chunks of one size, the last one padded, so that one
compilation does."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

CHUNK = 1 << 12


def in_chunks(function: Callable[..., Any], *rows: np.ndarray, size: int = CHUNK) -> Any:
    """Applies a function to rows, chunk by chunk.

    Parameters
    ----------
    function
        Maps rows `(size, …)` to rows, or to a pytree of them. The last chunk is padded with its
        last row, so that the function never sees an invalid one.
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
    parts = []
    for start in range(0, number, size):
        piece = [row[start : start + size] for row in rows]
        keep = len(piece[0])
        if keep < size:
            piece = [
                np.append(part, np.repeat(part[-1:], size - keep, axis=0), 0) for part in piece
            ]
        result = function(*piece)
        parts.append(jax.tree.map(lambda leaf, keep=keep: np.asarray(leaf)[:keep], result))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
