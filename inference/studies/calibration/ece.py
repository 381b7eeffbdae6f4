"""Coverage of instances whose truth is known: nominal against empirical, and the field's one
number.

ECE after Pierzchlewicz et al. (2022): the mean over 21 levels of |median over joints of share
covered - level|. It has a floor, since a right posterior's shares scatter too, and an interval, by
drawing whole recordings anew. It is blind where ranks are not: see reports/coverage.md."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

LEVELS = np.linspace(0, 1, 21)
RESAMPLES = 1000


class Interval(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


class Ece(NamedTuple):
    """The field's `whole` number with its interval, the `floor` that a right posterior has with as
    many instances (its mean, and what 95 % of right posteriors stay below), and the same without
    the median, by `joint` `(j,)`."""

    whole: Interval
    floor: float
    floor_95: float
    joint: np.ndarray


def shares(levels: np.ndarray, nominal: np.ndarray = LEVELS) -> np.ndarray:
    """`(len(nominal), j)`: how often the region of each nominal level holds the truth, from levels
    `(n, j)`; NaN: never, as there was no region."""
    known = np.where(np.isnan(levels), np.inf, levels)
    return np.mean(known[None] < nominal[:, None, None], axis=1)


def calibration_error(levels: np.ndarray) -> float:
    """The field's ECE of levels `(n, j)`."""
    return float(np.mean(np.abs(np.median(shares(levels), axis=1) - LEVELS)))


def ece(levels: np.ndarray, stand_in: np.ndarray, cluster: np.ndarray, seed: int = 0) -> Ece:
    """Of levels `(n, j)`; `stand_in` `(n, r, j)` those of draws in place of the truth, NaN where
    there are none; `cluster` `(n,)` names what is drawn anew together for the interval, two at
    least."""
    rng = np.random.default_rng(seed)
    found = resampled(cluster, rng, lambda rows: calibration_error(levels[rows]))
    low, high = np.quantile(found, [0.025, 0.975])
    whole = Interval(calibration_error(levels), float(low), float(high))
    right = stand_in[np.isfinite(stand_in).all(axis=(1, 2))]
    floors = np.array(
        [calibration_error(right[:, row]) for row in range(right.shape[1])]
        if len(right)
        else [np.nan]
    )
    joint = np.abs(shares(levels) - LEVELS[:, None]).mean(axis=0)
    return Ece(whole, float(floors.mean()), float(np.quantile(floors, 0.95)), joint)


def coverage(levels: np.ndarray, nominal: float, cluster: np.ndarray, seed: int = 0) -> Interval:
    """How often regions of one nominal level hold the truth, of levels `(n,)` or `(n, j)` (then
    over all joints), with its interval, clusters being drawn anew."""
    held = np.where(np.isnan(levels), np.inf, levels) < nominal
    found = resampled(cluster, np.random.default_rng(seed), lambda rows: held[rows].mean())
    low, high = np.quantile(found, [0.025, 0.975])
    return Interval(float(held.mean()), float(low), float(high))


def resampled(
    cluster: np.ndarray,
    rng: np.random.Generator,
    statistic: Callable[[np.ndarray], float],
    number: int = RESAMPLES,
) -> np.ndarray:
    """`(number,)`: a statistic of rows, whole clusters being drawn anew with replacement."""
    names = np.unique(cluster)
    members = [np.flatnonzero(cluster == name) for name in names]
    picks = rng.integers(0, len(names), (number, len(names)))
    return np.array([statistic(np.concatenate([members[pick] for pick in row])) for row in picks])
