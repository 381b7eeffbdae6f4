"""Coverage of instances whose truth is known: nominal against empirical, and the field's one
number.

ECE after Pierzchlewicz et al. (2022): the mean over 21 levels of |median over joints of share
covered - level|. It has a floor, since a right posterior's shares scatter too, and an interval,
whole recordings being drawn anew. It is blind where ranks are not: see reports/coverage.md."""

from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.intervals import Interval, of_mean_size, of_share

ECE_LEVELS = np.linspace(0, 1, 21)


class Ece(NamedTuple):
    """The field's `whole` number with its interval, the `floor` that a right posterior has with as
    many instances (its mean, and what 95 % of right posteriors stay below), and the same without
    the median, by `joint` `(j,)`."""

    whole: Interval
    floor: float
    floor_95: float
    joint: np.ndarray


def shares(levels: np.ndarray, nominal: np.ndarray = ECE_LEVELS) -> np.ndarray:
    """`(len(nominal), j)`: how often the region of each nominal level holds the truth, from levels
    `(n, j)`; NaN: never, as there was no region."""
    known = np.where(np.isnan(levels), np.inf, levels)
    return np.mean(known[None] < nominal[:, None, None], axis=1)


def calibration_error(levels: np.ndarray) -> float:
    """The field's ECE of levels `(n, j)`."""
    return float(np.mean(np.abs(_deviation(levels))))


def _deviation(levels: np.ndarray) -> np.ndarray:
    return np.median(shares(levels), axis=1) - ECE_LEVELS


def ece(levels: np.ndarray, stand_in: np.ndarray, cluster: np.ndarray, seed: int = 0) -> Ece:
    """Of levels `(n, j)`; `stand_in` `(n, r, j)` those of draws in place of the truth, NaN where
    there are none; `cluster` `(n,)` names what is drawn anew together for the interval, two at
    least."""
    rng = np.random.default_rng(seed)
    whole = of_mean_size(lambda rows: _deviation(levels[rows]), cluster, rng)
    right = stand_in[np.isfinite(stand_in).all(axis=(1, 2))]
    floors = np.array(
        [calibration_error(right[:, row]) for row in range(right.shape[1])]
        if len(right)
        else [np.nan]
    )
    joint = np.abs(shares(levels) - ECE_LEVELS[:, None]).mean(axis=0)
    return Ece(whole, float(floors.mean()), float(np.quantile(floors, 0.95)), joint)


def coverage(levels: np.ndarray, nominal: float, cluster: np.ndarray, seed: int = 0) -> Interval:
    """How often regions of one nominal level hold the truth, of levels `(n,)` or `(n, j)` (then
    over all joints), with its interval, clusters being drawn anew."""
    return of_share(np.where(np.isnan(levels), np.inf, levels) < nominal, cluster, seed)
