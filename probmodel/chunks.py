"""Compiled functions over any number of rows: chunks of one size, the last one padded, so that one
compilation does."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

CHUNK = 1 << 12


def in_chunks(function: Callable[..., Any], *rows: np.ndarray, size: int = CHUNK) -> Any:
    """Applies `function`, a map of rows `(n, …)` to rows (or a pytree of them), chunk by chunk;
    returns NumPy arrays.

    Padding repeats the last row, so `function` never sees an invalid one. With no rows it sees
    nothing: raises `ValueError`."""
    number = len(rows[0])
    if number == 0:
        raise ValueError("there are no rows")
    parts = []
    for start in range(0, number, size):
        piece = [row[start : start + size] for row in rows]
        missing = size - len(piece[0])
        padded = (
            [np.concatenate([part, np.repeat(part[-1:], missing, axis=0)]) for part in piece]
            if missing
            else piece
        )
        result = function(*padded)
        keep = size - missing
        parts.append(jax.tree.map(lambda leaf, keep=keep: np.asarray(leaf)[:keep], result))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
