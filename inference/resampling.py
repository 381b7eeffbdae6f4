"""Draws of equal weight from draws that have weights."""

import numpy as np


def systematic(weight: np.ndarray, number: int, offset: float) -> np.ndarray:
    """`(number,)` rows of `weight` `(n,)`, each as often as its share says, rounded by one `offset`
    in [0, 1) for all, in order."""
    if not number:
        return np.zeros(0, int)
    shares = np.cumsum(weight) / weight.sum()
    return np.minimum(
        np.searchsorted(shares, (np.arange(number) + offset) / number), len(weight) - 1
    )


def times(weight: np.ndarray, number: int, offset: float) -> np.ndarray:
    """`(n,)`: how often `systematic` takes each row."""
    return np.bincount(systematic(weight, number, offset), minlength=len(weight))
