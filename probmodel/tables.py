"""Tables of numbers in .npz files: read, written whole or not at all, and rounded for storage."""

import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from probmodel.failures import BadInput
from probmodel.files import replacing

WRITER = "`poseterior learn`"


def read_tables(
    path: str | os.PathLike, what: str = "limits file", advice: str = f"write one with {WRITER}"
) -> dict[str, np.ndarray]:
    """All arrays of an .npz.

    Parameters
    ----------
    path
    what, advice
        What the file should be and how to get one, for the sentence of an error.

    Raises
    ------
    BadInput
        Where there is no such file, or it is another kind of file, or damaged.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except FileNotFoundError:
        raise BadInput(f"there is no {what} at {path}; {advice}") from None
    except Exception as error:  # numpy meets damaged files with errors of many unrelated kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BadInput(f"{path} is no {what}, or is truncated ({reason}); {advice}") from None


def write_tables(path: str | os.PathLike, arrays: Mapping[str, np.ndarray]) -> None:
    """Writes an .npz, whole or not at all. Raises `BadInput` where it cannot be written."""
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def compact(values: np.ndarray) -> np.ndarray:
    """float32 where that loses nothing, float64 otherwise."""
    short = values.astype(np.float32)
    exact = np.array_equal(short.astype(np.float64), values)
    return short if exact else np.asarray(values, np.float64)


def single(values: ArrayLike) -> np.ndarray:
    """Values as float64, rounded to what float32 can hold, so that storing them loses nothing."""
    return np.asarray(values).astype(np.float32).astype(np.float64)
