"""What a verdict could have seen: the smallest changes that nine runs of ten would have caught.

Of one coordinate by its own rank test, as if it were normal, and of modes by theirs; every test has
its part of the level. Other tests of the same draws may catch less. No test catches everything that
is larger: a change that moves neither location nor spread of any coordinate, and no mode, is none
of these."""

import math
from typing import NamedTuple

import numpy as np
from scipy import optimize, special, stats

POWER = 0.9
"""The share of runs in which a change is caught."""


class SmallestSeen(NamedTuple):
    """The smallest changes that are caught in `POWER` of all runs; infinite where none is sure to
    be.

    Attributes
    ----------
    shift : of the location of the coordinate that is known worst, in its standard deviations.
    spread : of its standard deviation, as a share of it.
    common : the share of the posterior that is in the commonest mode.
    moved : the share of all draws that is missing there, or too many.
    missing : the share of the posterior in a mode that no draw has.
    """

    shift: float
    spread: float
    common: float
    moved: float
    missing: float

    @property
    def sentence(self) -> str:
        """In words."""
        modes = (
            f", {self.moved:.1%} of the draws too few or too many in the commonest mode"
            f" ({self.common:.0%}), or a mode of {self.missing:.1%} that no draw has"
        )
        return (
            f"{round(100 * POWER)} % of runs would have caught a coordinate that is shifted by"
            f" {self.shift:.2g} or wider by {self.spread:.0%} of its standard deviation"
            f"{modes if math.isfinite(self.missing) else ''}"
        )


def seen(
    ess: np.ndarray, exact: int, counts: np.ndarray, common: float, tests: int, level: float
) -> SmallestSeen:
    """What a run could have seen.

    Parameters
    ----------
    ess : `(c, 2)`
        Effective sizes of the scores of shift and spread; NaN where a coordinate does not vary.
    exact
        How many exact draws the coordinates were compared with.
    counts : `(2, modes)`
        How many independent draws, and how many exact ones, fell into each mode that is tested.
    common
        The share of the commonest mode.
    tests, level
        How many tests share the level.
    """
    own = level / tests
    number = int(np.isfinite(ess).sum())
    sure = float(stats.norm.isf(own / number / 2) + stats.norm.ppf(POWER))
    shift, spread = sure * np.sqrt(1 / np.nanmin(ess, axis=0) + 1 / exact)
    draws, known = counts.sum(axis=1)
    worth = 1 / (1 / draws + 1 / known)
    apart = _noncentrality(own, counts.shape[1] - 1)
    return SmallestSeen(
        _shift(float(shift)),
        _wider(float(spread)),
        common,
        math.sqrt(apart * common * (1 - common) / worth),
        apart / (worth + apart) if math.isfinite(apart) else math.inf,
    )


def _shift(score: float) -> float:
    """By how many standard deviations a normal law is shifted against another whose first score has
    this mean: √3 (2Φ(δ/√2) - 1)."""
    share = score / math.sqrt(3)
    return math.sqrt(2) * float(stats.norm.ppf((1 + share) / 2)) if share < 1 else math.inf


def _wider(score: float) -> float:
    """By what share a normal law is wider than another whose second score has this mean:
    √5 (3/π arcsin(r²/(1 + r²)) - 1/2)."""
    angle = math.pi / 3 * (score / math.sqrt(5) + 1 / 2)
    ratio = math.sin(angle)
    return math.sqrt(ratio / (1 - ratio)) - 1 if angle < math.pi / 2 else math.inf


def _noncentrality(level: float, freedom: int) -> float:
    """Of a chi-square that is beyond the quantile of the level in `POWER` of cases; infinite
    without a degree of freedom."""
    if not freedom:
        return math.inf
    beyond = float(stats.chi2.isf(level, freedom))

    def lacking(noncentrality: float) -> float:
        # That of `stats` asks whether numbers are JAX's, and imports it for the question.
        return 1 - float(special.chndtr(beyond, freedom, noncentrality)) - POWER

    return float(optimize.brentq(lacking, 1e-9, 10 * beyond + 100))
