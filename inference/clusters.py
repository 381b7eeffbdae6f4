"""k-means: greedy k-means++ for the first centres (Arthur & Vassilvitskii, 2007), then Lloyd's
iterations.

Written here since hypotheses need nothing else of scikit-learn, whose import takes longer than
everything that this does. The same seed finds what scikit-learn's `KMeans` finds, to rounding: a
test holds the two together."""

import math
from typing import NamedTuple

import numpy as np

MOST_ITERATIONS = 300
AT_REST = 1e-4
"""Centres that move less than this share of the points' mean variance have come to rest."""
ROUNDING = 1e-7
"""Of the largest distance from the middle: to so much differences of distances are known, being
roots of differences of squares."""


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
    varying = (points != points[0]).any(axis=0)  # the others tell no point from another
    some = points.compress(varying, axis=1)  # in rows: an index would lay out columns
    middle = some.mean(axis=0)
    moved = some - middle  # near the origin, squares of distances lose fewer digits
    squares = np.einsum("nd,nd->n", moved, moved)
    enough = AT_REST * float(np.mean(squares)) / points.shape[1]
    first = _first_centres(moved, squares, k, np.random.RandomState(seed))
    found, labels = _lloyd(moved, squares, first, enough)
    centres = np.tile(points[0], (k, 1))
    centres[:, varying] = found + middle
    return Clusters(centres, labels)


def _lloyd(
    points: np.ndarray, squares: np.ndarray, centres: np.ndarray, enough: float
) -> tuple[np.ndarray, np.ndarray]:
    """Centres that have come to rest, and the nearest one of each point.

    Most points keep their centre in most iterations, and need not be looked at: while two centres
    have moved less, in all, than the one was farther away than the other, the order of the two
    stays. Sums of clusters change by what moves from one to another. Rows are fetched by `take`,
    which needs half the time of an index."""
    number = np.arange(len(centres))[:, None]
    labels, gap = _nearest(points, squares, centres)
    members = (labels == number).astype(float)
    sums, sizes = members @ points, members.sum(axis=1)
    way = np.zeros(len(centres))  # of each centre and of the one that moves most beside it
    slack = ROUNDING * math.sqrt(squares.max())
    until = gap - slack  # where on its centre's way a point is to be looked at again
    for _ in range(MOST_ITERATIONS):
        before = centres
        centres = np.where(sizes[:, None], sums / np.maximum(sizes, 1)[:, None], before)
        steps = np.linalg.norm(centres - before, axis=1)
        way += steps + _largest_of_others(steps)
        due = np.flatnonzero(until <= way.take(labels))
        own, previous = points.take(due, axis=0), labels[due]
        labels[due], gap = _nearest(own, squares[due], centres)
        until[due] = way[labels[due]] + gap - slack
        left = np.flatnonzero(labels[due] != previous)
        if not len(left) or np.sum(steps**2) <= enough:
            break
        joining, leaving = labels[due[left]] == number, previous[left] == number
        moves = joining.astype(float) - leaving
        sums, sizes = sums + moves @ own.take(left, axis=0), sizes + moves.sum(axis=1)
    return centres, labels


def _largest_of_others(values: np.ndarray) -> np.ndarray:
    """Of each of some values, the largest of the others; 0 where there is none."""
    *_, second, first = 0.0, *np.sort(values)
    return np.where(values == first, second, first)


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


def _nearest(
    points: np.ndarray, squares: np.ndarray, centres: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`(n,)` each: the nearest centre of each point, and by how much the next one is farther away.
    Found centre by centre, since `np.argmin` over so few rows takes longer than all else."""
    first, *others = np.einsum("kd,kd->k", centres, centres)[:, None] - 2 * centres @ points.T
    labels, second = np.zeros(len(points), int), np.full(len(points), np.inf)
    for number, distance in enumerate(others, 1):
        labels[distance < first] = number
        np.minimum(second, np.maximum(first, distance), out=second)
        np.minimum(first, distance, out=first)
    near, next_one = (np.sqrt(np.maximum(part + squares, 0.0)) for part in (first, second))
    return labels, next_one - near
