"""How fast a sampler brings effective draws, as only the truth can tell.

ArviZ gives a run shorter than its autocorrelation time as many effective draws as it has walkers:
those it was started with. Two figures are not taken in. *Earned*: the effective draws beyond the
exact ones that the start was given. And the autocorrelation time of all walkers together about the
mean and variance of the exact draws (Sokal 1997): a walker that stays where it is has a long one,
and so has one that walks about in the wrong place. For a mean, draws are worth their number over
that time. From a path that is short beside it, it can only be bounded from below. And a path does
not show what keeps walkers apart for good, draws from clouds of their own, say: where ArviZ, which
compares walkers with each other, finds far fewer effective draws, that is the bound. A depth flip
that no path crossed has no slope to be bounded by; there the rule of three does it."""

from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.comparison.mixing import CONSTANT
from poseterior.inference.studies.comparison.sample import Sample

WINDOW = 5.0
"""The sum of autocorrelations ends at this many autocorrelation times (Sokal's rule)."""
ENOUGH = 50.0
"""A path of fewer autocorrelation times bounds them, and no more (the rule of emcee's
documentation)."""
MOST_PROMISED = 2.0
"""How many times as many effective draws paths may promise as ArviZ finds, whose figure is of tails
too."""
SERIES_ROUNDING = 1e-9
WALKER_GROUPS = 16
"""Groups of walkers, from whose differences standard errors come."""


class Pace(NamedTuple):
    """Of the worst coordinate: `earned` effective draws; `time`, the autocorrelation time in draws,
    at least 1; `settled` effective draws, their number over that time: what the run is worth, or
    where it is not `known` at most that."""

    earned: float
    time: float
    settled: float
    known: bool


def pace(sample: Sample, exact: Sample, *, effective: float, given: int, steps: int) -> Pace:
    """The pace of a run.

    Parameters
    ----------
    effective
        The effective size of its draws in the worst coordinate, by ArviZ.
    given
        How many exact draws it was started with.
    steps
        How many draws in a row are the path of one walker.
    """
    series = _series(sample)
    truth = _series(exact)
    centre = truth.mean(axis=0)
    spread = truth.std(axis=0)
    varies = spread > CONSTANT
    paths = ((series[:, varies] - centre[varies]) / spread[varies]).reshape(
        -1, steps, int(varies.sum())
    )
    times, closed = autocorrelation_times(paths)
    if steps > 1:
        bounds = np.zeros(len(varies))
        bounds[-sample.away.shape[-1] :] = uncrossed(sample.away, exact.away, steps)
        never = bounds[varies] > 0
        times = np.where(never, bounds[varies], times)
        closed = closed & ~never
    time = max(1.0, float(times.max()))
    settled = sample.num_draws / time
    known = bool(closed.all()) and steps >= ENOUGH * time
    if settled > MOST_PROMISED * effective:
        settled = effective
        known = False
    return Pace(max(0.0, effective - given), time, settled, known)


def uncrossed(away: np.ndarray, exact: np.ndarray, steps: int) -> np.ndarray:
    """`(bones,)`: what the autocorrelation time of a depth flip is at least, at 95 %, where no path
    of `steps` draws ever crossed it; 0 where one did, or there is nothing to cross.

    A chain in balance, with shares p away and q towards the camera, crosses either way with the
    frequency f, and leaves "away" at the rate f/p, "towards" at f/q: no crossing in m steps away
    and n towards has probability exp(-f (m/p + n/q)), below 5 % unless f (m/p + n/q) < 3 (the rule
    of three). The time is 2/(f/p + f/q) = 2pq/f. Shares are those of the `exact` draws.
    """
    paths = away.reshape(-1, steps, away.shape[-1])
    crossed = (paths != paths[:, :1]).any(axis=(0, 1))
    p = exact.reshape(-1, exact.shape[-1]).mean(axis=0)
    m = (steps - 1) * paths[:, 0].sum(axis=0)
    n = (steps - 1) * len(paths) - m
    return np.where(crossed | (p == 0) | (p == 1), 0.0, 2 * (m * (1 - p) + n * p) / 3)


def _series(sample: Sample) -> np.ndarray:
    """`(n, 40)`: coordinates and depth flips."""
    return np.concatenate([sample.flat, sample.away.reshape(-1, sample.away.shape[-1])], axis=1)


def autocorrelation_times(paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`(c,)` integrated autocorrelation times of `paths` `(walker, step, c)` that have mean 0 and
    variance 1 in the limit, and whether the sum came to its end within half a path; where it did
    not, it is a lower bound."""
    steps = paths.shape[1]
    times = np.empty(paths.shape[2])
    closed = np.empty(paths.shape[2], bool)
    lags = np.arange(steps // 2 + 1)
    groups = np.array_split(np.arange(len(paths)), min(WALKER_GROUPS, len(paths)))
    for column in range(paths.shape[2]):
        power = np.abs(np.fft.rfft(paths[..., column], 2 * steps, axis=1)) ** 2
        products = np.fft.irfft(np.stack([power[group].mean(axis=0) for group in groups]))[
            :, : len(lags)
        ]
        found = products / (steps - lags)
        mean = np.average(found, axis=0, weights=[len(group) for group in groups])
        sums = 2 * np.cumsum(mean) - mean[0]
        ends = lags >= WINDOW * np.maximum(sums, 1.0)
        closed[column] = ends.any()
        times[column] = sums[np.argmax(ends)] if closed[column] else sums[-1] + 2 * _rest(found)
    return times, closed


def _rest(found: np.ndarray) -> float:
    """At least what autocorrelations `(group, lag)` add up to beyond the last lag.

    Those of a reversible chain are mixtures of exponentials, log-convex, so that they fall ever
    more slowly (Geyer 1992): no faster than they do from half of the last lag to the last one, two
    standard errors (jackknife) added."""
    last = found.shape[1] - 1
    width = last // 8
    if len(found) < WALKER_GROUPS or not width:
        return 0.0
    half = last // 2
    end = last
    early, late = (found[:, at - width : at + 1].mean(axis=1) for at in (half, end))
    left_out = np.array(
        [[np.delete(part, group).mean() for group in range(len(found))] for part in (early, late)]
    )
    if left_out.min() <= 0:
        return 0.0
    falls = np.log(left_out[0] / left_out[1])
    error = np.sqrt((len(falls) - 1) * falls.var())
    fall = (max(falls.mean(), 0.0) + 2 * error) / (end - half)
    # A slope of nothing but rounding says nothing: the sum so far is a bound as well.
    return float(late.mean() / fall) if fall * (end - half) > SERIES_ROUNDING else 0.0
