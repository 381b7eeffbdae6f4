"""k-means: greedy k-means++ for the first centres (Arthur & Vassilvitskii, 2007), then Lloyd's
iterations.

Written here since hypotheses need nothing else of scikit-learn, whose import takes longer than
everything that this does. The same seed finds what scikit-learn's `KMeans` finds, to rounding: a
test holds the two together."""

import math
from typing import NamedTuple

import numpy as np

MOST_ITERATIONS = 300
TOLERANCE = 1e-4
"""Centres that move less than this share of the points' mean variance have come to rest."""


class Clusters(NamedTuple):
    """Points by their nearest centre.

    Attributes
    ----------
    centres : `(k, d)`
    labels : `(n,)` the nearest centre of each point
    """

    centres: np.ndarray
    labels: np.ndarray


def clusters(points: np.ndarray, k: int, seed: int) -> Clusters:
    """The clusters of points `(n, d)`; of fewer than `k` distinct points some are empty."""
    middle = points.mean(axis=0)
    moved = points - middle  # near the origin, squares of distances lose fewer digits
    squares = np.einsum("nd,nd->n", moved, moved)
    centres = _first_centres(moved, squares, k, np.random.RandomState(seed))
    enough = TOLERANCE * float(np.mean(np.var(moved, axis=0)))
    columns = np.vstack([moved.T, np.ones(len(moved))])
    labels = _nearest(columns, centres)
    for _ in range(MOST_ITERATIONS):
        before, centres = centres, _means(moved, labels, centres)
        previous, labels = labels, _nearest(columns, centres)
        if np.array_equal(labels, previous) or np.sum((centres - before) ** 2) <= enough:
            break
    return Clusters(centres + middle, labels)


def _first_centres(
    points: np.ndarray, squares: np.ndarray, k: int, rng: np.random.RandomState
) -> np.ndarray:
    """Points, each of them the one among a few, drawn by their squared distances to the centres
    that there are, that leaves the smallest sum of these."""
    number = len(points)
    chosen = [int(rng.choice(number, p=np.full(number, 1 / number)))]
    nearest = _distances(points[chosen], points, squares)[0]
    for _ in range(1, k):
        targets = rng.uniform(size=2 + int(math.log(k))) * nearest.sum()
        tried = np.minimum(np.searchsorted(np.cumsum(nearest), targets), number - 1)
        left = np.minimum(nearest, _distances(points[tried], points, squares))
        best = int(np.argmin(left.sum(axis=1)))
        nearest = left[best]
        chosen.append(int(tried[best]))
    return points[chosen]


def _distances(some: np.ndarray, points: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """`(m, n)`: squared distances of some of the points, whose squared lengths are given."""
    own = np.einsum("md,md->m", some, some)
    return np.maximum(own[:, None] - 2 * some @ points.T + squares, 0.0)


def _nearest(columns: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """`(n,)`: the nearest centre of each point, given as a column with a one below; what is the
    same for all centres is left out. The smallest is looked for centre by centre, since
    `np.argmin` over so few rows takes longer than all else."""
    lengths = np.einsum("kd,kd->k", centres, centres)
    first, *others = np.column_stack([-2 * centres, lengths]) @ columns
    labels = np.zeros(len(first), int)
    for number, distance in enumerate(others, 1):
        labels[distance < first] = number
        np.minimum(first, distance, out=first)
    return labels


def _means(points: np.ndarray, labels: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The means of clusters; a centre that nothing is nearest to stays where it is."""
    member = labels == np.arange(len(centres))[:, None]
    number = member.sum(axis=1)[:, None]
    return np.where(number, member.astype(float) @ points / np.maximum(number, 1), centres)
