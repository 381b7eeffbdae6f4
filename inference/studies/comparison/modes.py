"""Mode coverage: which depth flips of the limbs a sampler visits, and how often, against the exact
shares.

Under weak perspective every bone may point towards the camera or away from it: 2^k patterns for k
bones."""

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


def same_shares(away: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Chi-square statistic and p-value that independent draws `(n, bones)` and `(m, bones)` fall
    into the modes alike (homogeneity of two samples); rare modes are put together."""
    _, counts = _counts(away, exact)
    pooled = counts.sum(axis=0) / counts.sum()
    rare = pooled * min(len(away), len(exact)) < LEAST_EXPECTED
    if rare.any():
        counts = np.concatenate(
            [counts[:, ~rare], counts[:, rare].sum(axis=1, keepdims=True)], axis=1
        )
    if counts.shape[1] < 2:
        return 0.0, 1.0
    statistic, p_value, _, _ = stats.chi2_contingency(counts, correction=False)
    return float(statistic), float(p_value)
