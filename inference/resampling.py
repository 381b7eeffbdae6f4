"""Draws of equal weight from draws that have weights."""

import numpy as np


def shares(log_weight: np.ndarray) -> np.ndarray:
    """Weights `(n,)` with sum one; zeros where none is finite."""
    if not np.isfinite(log_weight).any():
        return np.zeros(len(log_weight))
    share = np.exp(log_weight - log_weight.max())
    return share / share.sum()


def effective(share: np.ndarray) -> float:
    """How many equal weights these `(n,)` with sum one are worth: 1 / Σ share² (Kish 1965); 0 where
    none has any."""
    square = float(np.sum(share**2))
    return 1 / square if square else 0.0


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
