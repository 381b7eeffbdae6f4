"""Mode coverage: which depth flips of the limbs a sampler visits, and how often, against the exact
shares.

Under weak perspective every bone may point towards the camera or away from it: 2^k patterns for k
bones."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy import stats

from poseterior.inference.studies.flips import codes

LEAST_EXPECTED = 5.0
"""Expected count below which modes are put together for the chi-square test."""


class Modes(NamedTuple):
    """`patterns` `(modes, bones)` bool, those that occur, commonest in the exact draws first;
    `exact` and `share` `(modes,)` their shares of the exact draws and of the sampler's; `missed`:
    exact share of modes that the sampler never visited; `expected_missed`: what as many independent
    draws would have missed."""

    patterns: np.ndarray
    exact: np.ndarray
    share: np.ndarray
    missed: float
    expected_missed: float


def _counts(away: np.ndarray, exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Codes `(modes,)` that occur, and how often `(2, modes)` in either sample."""
    both = codes(away), codes(exact)
    found = np.union1d(*both)
    return found, np.array([[np.sum(one == code) for code in found] for one in both])


def modes(away: np.ndarray, exact: np.ndarray, independent: float) -> Modes:
    """Of draws `(n, bones)`, worth `independent` independent ones, and exact draws `(m, bones)`."""
    found, counts = _counts(away, exact)
    order = np.argsort(-counts[1], kind="stable")
    found = found[order]
    counts = counts[:, order]
    share = counts[0] / len(away)
    known = counts[1] / len(exact)
    missed = float(known[counts[0] == 0].sum())
    expected = float(np.sum(known * (1 - known) ** independent))
    patterns = (found[:, None] >> np.arange(away.shape[1])) % 2 > 0
    return Modes(patterns, known, share, missed, expected)


def counts_by_mode(
    away: np.ndarray, exact: np.ndarray, known: Mapping[int, float] | None = None
) -> np.ndarray:
    """`(2, modes)`: how many independent draws `(n, bones)` and `(m, bones)` fall into each mode;
    rare modes are put together.

    Parameters
    ----------
    known
        How many of a great many exact draws fell into each mode, by its code, where that is known:
        then they stand in the place of the exact draws.
    """
    found, counts = _counts(away, exact)
    if known is not None:
        codes_known = np.array(list(known))
        found, which = np.unique(np.concatenate([found, codes_known]), return_inverse=True)
        drawn = np.bincount(which[: counts.shape[1]], counts[0], len(found))
        counts = np.stack([drawn, [known.get(int(code), 0.0) for code in found]])
    counts = counts[:, counts.any(axis=0)]
    pooled = counts.sum(axis=0) / counts.sum()
    rare = pooled * counts.sum(axis=1).min() < LEAST_EXPECTED
    together = counts[:, rare].sum(axis=1, keepdims=True)
    return np.concatenate([counts[:, ~rare], together], axis=1) if rare.any() else counts


def same_shares(counts: np.ndarray) -> tuple[float, float]:
    """Chi-square statistic and p-value that two samples, `(2, modes)`, fall into the modes alike
    (homogeneity)."""
    if counts.shape[1] < 2:
        return 0.0, 1.0
    statistic, p_value, _, _ = stats.chi2_contingency(counts, correction=False)
    return float(statistic), float(p_value)
