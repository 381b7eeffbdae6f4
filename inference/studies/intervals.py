"""Numbers with intervals, whole recordings being drawn anew: frames of one recording are alike."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

RESAMPLES = 1000
TAIL = 0.025
"""What a central interval of 95 % leaves on either side."""
INTERVAL_ROUNDING = 1e-12


class Interval(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half the interval's width."""
        return (self.high - self.low) / 2


def permuted(p_value: float, permutations: int) -> str:
    """A permutation test's p-value in words. Where none was as extreme as what was observed, only
    the rule of three bounds it."""
    if p_value * (1 + permutations) < 1.5:  # what was observed counts as one of them
        return f"< {3 / permutations:.1g}"
    return f"= {p_value:.2g}"


def of_share(held: np.ndarray, cluster: np.ndarray, seed: int = 0) -> Interval:
    """How often something holds, of `held` `(n,)` or `(n, j)` bool, clusters `(n,)` being drawn
    anew (percentiles).

    Where all clusters have the same share, none of them, say, drawing them anew says nothing: then
    the interval is that of so many independent trials (Clopper & Pearson 1934).
    """
    found = resampled(cluster, np.random.default_rng(seed), lambda rows: held[rows].mean())
    value = float(held.mean())
    if np.ptp(found) > INTERVAL_ROUNDING:
        low, high = np.quantile(found, [TAIL, 1 - TAIL])
        return Interval(value, float(low), float(high))
    trials = len(np.unique(cluster))
    hits = value * trials
    low = stats.beta.ppf(TAIL, hits, trials - hits + 1) if value > 0 else 0.0
    high = stats.beta.isf(TAIL, hits + 1, trials - hits) if value < 1 else 1.0
    return Interval(value, float(low), float(high))


def of_mean_size(
    curve: Callable[[np.ndarray], np.ndarray], cluster: np.ndarray, rng: np.random.Generator
) -> Interval:
    """The mean absolute value of a curve `(m,)` of rows, clusters `(n,)` being drawn anew.

    Noise makes it larger, so that percentiles lie too high and never reach zero. The lower end is
    therefore what is left of the curve outside a band that holds 95 % of the curves drawn anew; the
    upper end is the percentile.
    """
    found = curve(np.arange(len(cluster)))
    many = resampled(cluster, rng, curve)
    width = np.quantile(np.abs(many - found).max(axis=1), 1 - 2 * TAIL)
    low = np.maximum(np.abs(found) - width, 0.0).mean()
    high = np.quantile(np.abs(many).mean(axis=1), 1 - TAIL)
    return Interval(float(np.abs(found).mean()), float(low), float(high))


def resampled(
    cluster: np.ndarray,
    rng: np.random.Generator,
    statistic: Callable[[np.ndarray], Any],
    number: int = RESAMPLES,
) -> np.ndarray:
    """`(number, …)`: a statistic of rows, whole clusters `(n,)` being drawn anew with
    replacement."""
    names = np.unique(cluster)
    members = [np.flatnonzero(cluster == name) for name in names]
    picks = rng.integers(0, len(names), (number, len(names)))
    return np.array([statistic(np.concatenate([members[pick] for pick in row])) for row in picks])
