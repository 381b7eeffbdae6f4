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


def inclusion(weight: np.ndarray, number: int) -> np.ndarray:
    """`(n,)`: probabilities by which `number` rows are taken, none of them twice: as its `weight`
    says, or 1 where it is greater. Rows without any weight are not taken, even if then fewer are
    than wanted."""
    held = weight > 0
    probability, certain = held.astype(float), ~held
    number = min(number, int(held.sum()))
    while not certain.all():
        rest = ~certain
        left = number - np.count_nonzero(certain & held)
        probability[rest] = weight[rest] * left / weight[rest].sum()
        if not (probability > 1).any():
            break
        certain |= probability >= 1
        probability[certain & held] = 1.0
    return probability
