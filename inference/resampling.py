"""Draws of equal weight from draws that have weights, and the weights that come with draws of
somebody else's."""

import math
from collections.abc import Mapping

import numpy as np

from poseterior.probmodel.arrays import plain_numbers
from poseterior.probmodel.failures import BadInput

WEIGHTS = ("weights", "log_weights")
"""What the weights of draws are called in a file."""
NEGLIGIBLE = math.log(np.finfo(float).tiny)
"""Log of the smallest share of the largest weight that counts. Nested samplers give points of no
likelihood a log weight that is finite, such as -1e300."""
BISECTIONS = 40
"""By which a power of weights is found."""


def weights_of(
    arrays: Mapping[str, np.ndarray], shape: tuple[int, ...], where: str
) -> np.ndarray | None:
    """Logs of the weights that come with draws.

    Parameters
    ----------
    arrays
        What is in the file, by name.
    shape
        Of the draws.
    where
        The file, in messages.

    Returns
    -------
    ndarray or None
        `shape`, -inf where a weight is zero; None where there are no weights.

    Raises
    ------
    BadInput
        Where there are two kinds, one is no number, infinite or negative, they are not as many as
        the draws, or all are zero.
    """
    named = [name for name in WEIGHTS if name in arrays]
    if not named:
        return None
    if len(named) > 1:
        raise BadInput(f"{where} has both weights and log_weights; leave one out")
    values = plain_numbers(arrays[named[0]], f"{named[0]} of {where}")
    if values.size != math.prod(shape):
        raise BadInput(
            f"{named[0]} of {where} are {values.size:,} for {math.prod(shape):,} draws; give each"
            " draw one"
        )
    return logs_of(values.reshape(shape), named[0], f" of {where}")


def logs_of(values: np.ndarray, kind: str, of: str = "") -> np.ndarray:
    """Logs of weights of a kind of `WEIGHTS`; -inf where one is zero. Raises `BadInput`, with what
    they are `of`, where one is no number, infinite or negative, or all are zero."""
    if np.isnan(values).any() or (values == np.inf).any():
        raise BadInput(f"{kind}{of} hold a number that is not finite; leave it out")
    if kind == "weights":
        if (values < 0).any():
            raise BadInput(
                f"{int((values < 0).sum()):,} of {values.size:,} weights{of} are negative; a"
                " weight is 0 or more"
            )
        with np.errstate(divide="ignore"):
            values = np.log(values)
    if not np.isfinite(values).any():
        raise BadInput(f"all weights{of} are zero; no draw counts, so run the sampler anew")
    return values


def counting(log_weights: np.ndarray) -> np.ndarray:
    """Which draws count at all: bool, of the same shape."""
    with np.errstate(invalid="ignore"):  # where all are zero: -inf - -inf
        return log_weights - log_weights.max(initial=-np.inf) > NEGLIGIBLE


def merged(draws: np.ndarray, log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The set of draws `(n, ...)`: each once, in an order that does not depend on the given one,
    with the log of the sum of its weights."""
    rows = draws.reshape(len(draws), -1)
    _, first, which = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    total = np.full(len(first), -np.inf)
    np.logaddexp.at(total, which.ravel(), log_weights)
    order = np.random.default_rng(0).permutation(len(first))
    return draws[first[order]], total[order]


def let_pass(log_weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`(n,)` bool: draws with weights, let pass with probability weight over largest weight, are
    draws without: of independent ones, independent ones, and none of them twice."""
    return np.log(rng.uniform(size=len(log_weights))) < log_weights - log_weights.max()


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


def tempered(log_weight: np.ndarray, wanted: float) -> np.ndarray:
    """Weights `(n,)` with sum one, raised to the power, at most one, by which they are worth so
    many equal ones (or as near to that as they come); zeros where none is finite."""
    finite, low, high = np.isfinite(log_weight), 0.0, 1.0
    power = high
    for _ in range(BISECTIONS):
        share = shares(np.where(finite, power * log_weight, -np.inf))
        if effective(share) >= wanted:
            low = power
        else:
            high = power
        power = (low + high) / 2
    return shares(np.where(finite, power * log_weight, -np.inf))


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
