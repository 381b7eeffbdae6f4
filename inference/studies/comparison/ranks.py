"""Rank tests: where the draws' coordinates stand among the exact ones, and whether location and
spread fit.

The rank u of a draw among N exact draws is uniform if both have one law. Its first two Legendre
polynomials, √3(2u-1) and √5(6u²-6u+1), have mean 0 and variance 1 then; the first sees a shift, the
second too narrow or too wide (Neyman's smooth test, 1937). Their means have variance 1/ESS + 1/N,
the ESS being measured on the very series."""

import numpy as np
from scipy import stats

from poseterior.inference.studies.comparison.mixing import mean_ess


def scores(values: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """`(..., c, 2)`: the two Legendre scores of the ranks of `values` `(..., c)` among `exact` `(m,
    c)`; ties count half."""
    shape = values.shape
    flat = values.reshape(-1, shape[-1])
    rank = np.empty(flat.shape)
    for column, known in enumerate(np.sort(exact, axis=0).T):
        below = np.searchsorted(known, flat[:, column], side="left")
        rank[:, column] = (below + np.searchsorted(known, flat[:, column], side="right")) / 2
    u = (rank + 0.5) / (len(exact) + 1)
    both = np.stack([np.sqrt(3) * (2 * u - 1), np.sqrt(5) * (6 * u**2 - 6 * u + 1)], axis=-1)
    return both.reshape(*shape, 2)


def each_coordinate(values: np.ndarray, exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p-values `(c, 2)` (shift, spread) of chains `(chain, draw, c)` against exact draws `(m, c)`,
    and the effective sizes `(c, 2)` they rest on; NaN where the exact draws do not vary. Normal
    approximation: worth nothing below some fifty effective draws."""
    found = scores(values, exact)
    ess = np.array(
        [
            [mean_ess(found[..., column, kind]) for kind in range(2)]
            for column in range(values.shape[-1])
        ]
    )
    z = found.mean(axis=(0, 1)) / np.sqrt(1 / ess + 1 / len(exact))
    varies = np.ptp(exact, axis=0)[:, None] > 0
    return np.where(varies, 2 * stats.norm.sf(np.abs(z)), np.nan), ess


def all_together(draws: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Hotelling's T² of all scores at once and its p-value, for independent draws `(n, c)` against
    exact ones `(m, c)`, with the exact draws' covariance of the scores."""
    varies = np.ptp(exact, axis=0) > 0
    ours = scores(draws[:, varies], exact[:, varies]).reshape(len(draws), -1)
    theirs = scores(exact[:, varies], exact[:, varies]).reshape(len(exact), -1)
    covariance = np.cov(theirs, rowvar=False)
    shift = ours.mean(axis=0)
    dim = len(shift)
    freedom = len(exact) - 1
    square = float(shift @ np.linalg.solve(covariance, shift)) / (1 / len(draws) + 1 / len(exact))
    return square, float(
        stats.f.sf(square * (freedom - dim + 1) / (dim * freedom), dim, freedom - dim + 1)
    )
