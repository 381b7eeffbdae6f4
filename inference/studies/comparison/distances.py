"""Distances between two sets of draws: energy distance, MMD, sliced Wasserstein, W1 of one
coordinate.

Draws `(n, c)` and `(m, c)`; coordinates are divided by a standard deviation first (`in_spreads`),
that of the exact draws where nothing else is said."""

import numpy as np
from scipy.spatial.distance import cdist

from poseterior.inference.studies.comparison.mixing import CONSTANT

DIRECTIONS = 100
MOST_PROJECTED = 20_000
"""Draws of either side in a sliced Wasserstein distance at most, taken evenly."""


def in_spreads(
    draws: np.ndarray, exact: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Both, divided by a `spread` `(c,)`; constant coordinates are left out."""
    varies = spread > CONSTANT
    return draws[:, varies] / spread[varies], exact[:, varies] / spread[varies]


def pairwise(draws: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """`(n + m, n + m)`: Euclidean distances between all draws, those of the sampler first; in
    single precision, which is a million times finer than what a test can see, and twice as fast."""
    pooled = np.concatenate([draws, exact])
    return cdist(pooled, pooled).astype(np.float32)


def energy(distance: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """`(p,)`: energy distance 2E|X-Y| - E|X-X'| - E|Y-Y'| for `labels` `(p, n + m)`, true for X
    (Székely & Rizzo)."""
    weight = _weights(labels)
    return -np.einsum("pi,pi->p", weight @ distance, weight)


def mmd(distance: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """`(p,)`: squared maximum mean discrepancy, Gaussian kernel of the median distance (Gretton et
    al. 2012)."""
    width = np.median(distance[distance > 0])
    weight = _weights(labels)
    return np.einsum("pi,pi->p", weight @ np.exp(-0.5 * (distance / width) ** 2), weight)


def _weights(labels: np.ndarray) -> np.ndarray:
    of_x = labels.sum(axis=1, keepdims=True)
    return np.where(labels, 1 / of_x, -1 / (labels.shape[1] - of_x)).astype(np.float32)


def wasserstein(one: np.ndarray, other: np.ndarray, points: int = 512) -> np.ndarray:
    """`(c,)`: W1 of each coordinate of `(n, c)` and `(m, c)`, from quantiles at the middles of
    `points` equal parts."""
    levels = (np.arange(points) + 0.5) / points
    return np.abs(np.quantile(one, levels, axis=0) - np.quantile(other, levels, axis=0)).mean(
        axis=0
    )


def sliced_wasserstein(draws: np.ndarray, exact: np.ndarray, seed: int = 0) -> float:
    """Mean W1 along random directions, in standard deviations of the exact draws (Bonneel et al.
    2015)."""
    draws, exact = (part[:: -(-len(part) // MOST_PROJECTED)] for part in (draws, exact))
    one, other = in_spreads(draws, exact, exact.std(axis=0))
    directions = np.random.default_rng(seed).normal(size=(one.shape[1], DIRECTIONS))
    directions /= np.linalg.norm(directions, axis=0)
    return float(wasserstein(one @ directions, other @ directions).mean())
