"""How fast a sampler brings effective draws, as only the truth can tell.

ArviZ gives a run shorter than its autocorrelation time as many effective draws as it has walkers: those it was
started with. Two figures are not taken in. *Earned*: the effective draws beyond the exact ones that the start was
given. And the autocorrelation time of all walkers together about the mean and variance of the exact draws (Sokal 1997):
a walker that stays where it is has a long one, and so has one that walks about in the wrong place. For a mean, draws
are worth their number over that time. From a path that is short beside it, it can only be bounded from below.
"""

from typing import NamedTuple

import numpy as np

from inference.comparison.mixing import CONSTANT
from inference.comparison.sample import Sample

WINDOW = 5.0
"""The sum of autocorrelations ends at this many autocorrelation times (Sokal's rule)."""
ENOUGH = 50.0
"""A path of fewer autocorrelation times bounds them, and no more (the rule of emcee's documentation)."""


class Pace(NamedTuple):
    """Of the worst coordinate: `earned` effective draws; `time`, the autocorrelation time in draws, at least 1;
    `settled` effective draws, their number over that time: what the run is worth, or where it is not `known` at most
    that."""

    earned: float
    time: float
    settled: float
    known: bool


def pace(sample: Sample, exact: Sample, *, effective: float, given: int, steps: int) -> Pace:
    """Of draws whose effective size in the worst coordinate is said to be `effective`, started with `given` exact
    draws, every `steps` draws being the path of one walker."""
    series, known = _series(sample), _series(exact)
    centre, spread = known.mean(axis=0), known.std(axis=0)
    varies = spread > CONSTANT
    paths = ((series[:, varies] - centre[varies]) / spread[varies]).reshape(-1, steps, int(varies.sum()))
    times, closed = autocorrelation_times(paths)
    time = max(1.0, float(times.max()))
    long = bool(closed.all()) and steps >= ENOUGH * time
    return Pace(max(0.0, effective - given), time, sample.num_draws / time, long)


def _series(sample: Sample) -> np.ndarray:
    """`(n, 40)`: coordinates and depth flips."""
    return np.concatenate([sample.flat, sample.away.reshape(-1, sample.away.shape[-1])], axis=1)


def autocorrelation_times(paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(c,)` integrated autocorrelation times of `paths` `(walker, step, c)` that have mean 0 and variance 1 in the
    limit, and whether the sum came to its end within half a path; where it did not, it is a lower bound."""
    steps = paths.shape[1]
    times, closed = np.empty(paths.shape[2]), np.empty(paths.shape[2], bool)
    lags = np.arange(steps // 2 + 1)
    for column in range(paths.shape[2]):
        power = np.abs(np.fft.rfft(paths[..., column], 2 * steps, axis=1)) ** 2
        products = np.fft.irfft(power.mean(axis=0))[: len(lags)]
        sums = 2 * np.cumsum(products / (steps - lags)) - products[0] / steps
        ends = lags >= WINDOW * np.maximum(sums, 1.0)
        end = int(np.argmax(ends)) if ends.any() else -1
        times[column], closed[column] = sums[end], ends.any()
    return times, closed
