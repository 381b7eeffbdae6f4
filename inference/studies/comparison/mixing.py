"""How well chains mixed: effective sample sizes and R-hat, believed only where the chains moved at
all.

ArviZ gives a stuck chain an effective size of N and four copies of one chain an R-hat of 1, so
unique draws are counted first, and a chain in which a coordinate stands still though the exact
draws vary counts as stuck."""

from typing import NamedTuple

import numpy as np
from scipy import stats

FEWEST_UNIQUE = 0.02
"""A sampler with a smaller share of distinct draws has not moved."""
FROZEN = 0.05
"""More chains than this share that stand still are a fault; of fewer, effective sizes and R-hat
tell."""
CONSTANT = 1e-9
"""A coordinate that varies by less, in standard deviations of the exact draws, does not vary but by
rounding."""

CHAINS_APART = 1.1
"""R-hat beyond which chains are not yet one sample (Gelman & Rubin 1992)."""
SCATTER = 0.1
"""How seldom chains that are as good as ArviZ says scatter more than they are allowed to."""


class Mixing(NamedTuple):
    """`bulk`, `tail` `(c,)` effective sizes of the coordinates and `rhat` `(c,)`; NaN where a
    coordinate is constant. `unique`: share of distinct draws; `stuck`: whether the chains, or one
    of them, did not move."""

    bulk: np.ndarray
    tail: np.ndarray
    rhat: np.ndarray
    unique: float
    stuck: bool

    @property
    def worst(self) -> float:
        """The smallest effective size of a coordinate that varies; 1 where the chains are stuck."""
        return 1.0 if self.stuck else float(np.nanmin(np.minimum(self.bulk, self.tail)))

    @property
    def worst_rhat(self) -> float:
        """The largest R-hat of a coordinate; NaN where there is none."""
        return float(np.nanmax(self.rhat)) if np.isfinite(self.rhat).any() else np.nan


def mixing(values: np.ndarray, spread: np.ndarray) -> Mixing:
    """Of draws `(chain, draw, c)`, where the exact draws have standard deviations `spread` `(c,)`;
    chains shorter than four draws have NaN."""
    from arviz_stats.base import array_stats

    chains, draws, number = values.shape
    varies = spread > CONSTANT
    scaled = values[..., varies] / spread[varies]
    unique = len(np.unique(np.round(scaled.reshape(-1, scaled.shape[-1]), 9), axis=0)) / (
        chains * draws
    )
    still = np.any(np.ptp(scaled, axis=1) < CONSTANT, axis=-1)
    frozen = draws > 1 and bool(still.mean() > FROZEN)
    stuck = frozen or unique < FEWEST_UNIQUE
    bulk, tail, rhat = (np.full(number, np.nan) for _ in range(3))
    for column in np.flatnonzero(varies) if draws >= 4 and not stuck else ():
        series = values[..., column]
        bulk[column] = array_stats.ess(series, chain_axis=0, draw_axis=1, method="bulk")
        tail[column] = array_stats.ess(
            series, chain_axis=0, draw_axis=1, method="tail", prob=(0.05, 0.95)
        )
        rhat[column] = array_stats.rhat(series, chain_axis=0, draw_axis=1, method="rank")
    return Mixing(
        np.minimum(bulk, chains * draws), np.minimum(tail, chains * draws), rhat, unique, stuck
    )


def mean_ess(series: np.ndarray) -> float:
    """Effective size `()` for the mean of a series `(chain, draw)`, at most its length; its length
    where constant.

    ArviZ's, unless the chains' own means scatter more than it allows (chi-square, at `SCATTER`):
    then what they say. The sum of autocorrelations ends where they sink into the noise, however
    long they go on there."""
    from arviz_stats.base import array_stats

    if series.shape[1] < 4 or np.ptp(series) == 0:
        return float(series.size)
    found = float(array_stats.ess(series, chain_axis=0, draw_axis=1, method="mean"))
    if not np.isfinite(found):
        return 1.0
    found = min(found, float(series.size))
    freedom = len(series) - 1
    if not freedom:
        return found
    excess = series.mean(axis=1).var(ddof=1) / len(series) / series.var() * found
    return found / excess if freedom * excess > stats.chi2.isf(SCATTER, freedom) else found
