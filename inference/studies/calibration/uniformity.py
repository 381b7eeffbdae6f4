"""Are these numbers uniform on [0, 1]? One test for every rank of the calibration, exact at every
sample size.

The number of values below z is binomial if they are uniform. The statistic is the smallest binomial
tail, either side, over the points z = 1/100, …, 99/100: equal local levels (Säilynoja, Bürkner &
Vehtari 2022, Graphical test for discrete uniformity; Berk & Jones 1979). Its law is computed, not
simulated: the counts are a Markov chain."""

import functools
from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

ECDF_POINTS = 100
"""Parts of [0, 1] at whose borders the distribution function is looked at."""
ECDF_LEVELS = np.arange(1, ECDF_POINTS) / ECDF_POINTS
TINY = 1e-9
"""Below this, one minus a probability loses its digits: the sum over the points, which bounds it,
is taken instead."""


class Uniformity(NamedTuple):
    """`statistic`: the smallest two-sided binomial tail; `p_value`: how often uniform values have
    as small a one; `size`: how many values there were."""

    statistic: float
    p_value: float
    size: int


def uniformity(values: np.ndarray, lost: int = 0) -> Uniformity:
    """Tests independent values, uniform on [0, 1] under the hypothesis (ranks have to be spread
    over their steps first, `levels.rank_level`).

    Parameters
    ----------
    values
        `(n,)`, at least one.
    lost
        So many more values are not known: the p-value is then the largest that they could have led
        to, or more.

    Raises
    ------
    ValueError
        Where there are no values, or one lies outside.
    """
    values = np.asarray(values, float)
    if not values.size or not ((values >= 0) & (values <= 1)).all():
        raise ValueError("the test of uniformity needs values from 0 to 1, at least one")
    counts = np.searchsorted(np.sort(values), ECDF_LEVELS, side="right")
    size = len(values) + lost
    tail = float(min(1.0, 2 * _tails(counts, size, lost).min()))
    return Uniformity(tail, _probability_of(tail, size), len(values))


def band(size: int, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """`(99,)`, `(99,)`: between these the distribution function of `size` uniform values stays at
    all `ECDF_LEVELS` at once, with at least this probability; a test at that level rejects exactly
    where it leaves them."""
    low, high = _limits(_tail_for(size, probability), size)
    return low / size, high / size


def difference(values: np.ndarray) -> np.ndarray:
    """`(99,)`: empirical minus uniform distribution function at `ECDF_LEVELS`."""
    return np.searchsorted(np.sort(values), ECDF_LEVELS, side="right") / len(values) - ECDF_LEVELS


def _tails(counts: np.ndarray, size: int, lost: int) -> np.ndarray:
    """`(99,)`: the smaller of P(count ≤ observed) and P(count ≥ observed), of which `lost` values
    may or may not be part."""
    return np.minimum(
        stats.binom.cdf(counts + lost, size, ECDF_LEVELS),
        stats.binom.sf(counts - 1, size, ECDF_LEVELS),
    )


def _limits(tail: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest counts `(99,)` whose two-sided tail is larger than `tail`."""
    share = tail / 2 * (1 + 1e-9)  # rounding shall not let the observed count itself pass
    low = stats.binom.ppf(share, size, ECDF_LEVELS)
    low += stats.binom.cdf(low, size, ECDF_LEVELS) <= share
    high = stats.binom.isf(share, size, ECDF_LEVELS)
    high += stats.binom.sf(high, size, ECDF_LEVELS) > share
    high -= stats.binom.sf(high - 1, size, ECDF_LEVELS) <= share
    return low, high


def _probability_of(tail: float, size: int) -> float:
    """How often uniform values have a two-sided tail of at most `tail` somewhere."""
    if tail * len(ECDF_LEVELS) < TINY:
        return tail * len(ECDF_LEVELS)
    return min(1.0, 1 - _inside(*_limits(tail, size), size))


def _inside(low: np.ndarray, high: np.ndarray, size: int) -> float:
    """Probability that the counts stay within their limits at all points.

    Counts of a Poisson process with `size` expected, given that it has `size` in all, are those of
    uniform values; its increments are independent, so that each step is a convolution."""
    step = stats.poisson.pmf(np.arange(size + 1), size / ECDF_POINTS)
    step = step[: int(np.flatnonzero(step > 1e-30).max()) + 1]
    start = 0
    mass = np.ones(1)
    for least, most in zip(low.astype(int), high.astype(int), strict=True):
        if most < least:
            return 0.0
        spread = np.convolve(mass, step)
        whole = np.zeros(most - least + 1)
        first = max(least, start)
        last = min(most, start + len(spread) - 1)
        if first > last:
            return 0.0
        whole[first - least : last - least + 1] = spread[first - start : last - start + 1]
        start = least
        mass = whole
    rest = size - (start + np.arange(len(mass)))
    ends = np.sum(
        mass * stats.poisson.pmf(rest, size / ECDF_POINTS)
    )  # none where more than `size` are there already
    return float(ends / stats.poisson.pmf(size, size))


@functools.cache
def _tail_for(size: int, probability: float) -> float:
    """The largest tail at which uniform values stay inside with at least this probability."""

    def excess(log_tail: float) -> float:
        return _probability_of(np.exp(log_tail), size) - (1 - probability)

    low = np.log((1 - probability) / ECDF_POINTS / 10)
    high = 0.0
    root = optimize.brentq(excess, low, high, xtol=1e-6)
    while excess(root) > 0:  # the law has steps
        root -= 1e-6
    return float(np.exp(root))
