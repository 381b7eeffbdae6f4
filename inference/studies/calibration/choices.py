"""What k hypotheses cover: how near the best of k comes to the truth, for ways of choosing them,
and which modes.

The floor of a way to choose is what it reaches when the truth is one more draw of the very
posterior: nobody who knows no more than the posterior does better with the same way of choosing,
except by luck. Errors are mean joint distances in camera axes, without alignment."""

from collections.abc import Callable

import numpy as np

from poseterior.inference.hypothesis import diverse
from poseterior.inference.studies.flips import away, codes

KMEANS, POSE_GRID, RANDOM, FARTHEST = CHOICES = (
    "k-means++",
    "grid",
    "random draws",
    "farthest point",
)
Way = Callable[[np.ndarray, int, int], np.ndarray]
"""Poses `(n, 15, 3)`, k, seed → `(k, 15, 3)`."""


def by_kmeans(joints: np.ndarray, k: int, seed: int = 0) -> np.ndarray:
    """The product's way (`inference.hypothesis`)."""
    return np.stack([one.joints for one in diverse(joints, min(k, len(joints)), seed=seed)])


def at_random(joints: np.ndarray, k: int, seed: int = 0) -> np.ndarray:
    """Some draws as they come."""
    return joints[np.random.default_rng(seed).permutation(len(joints))[:k]]


def by_distance(joints: np.ndarray, k: int, seed: int = 0) -> np.ndarray:
    """Each as far as can be from all before it, the first at random (Gonzalez 1985)."""
    flat = joints.reshape(len(joints), -1)
    chosen = [int(np.random.default_rng(seed).integers(len(flat)))]
    nearest = np.linalg.norm(flat - flat[chosen[0]], axis=1)
    while len(chosen) < min(k, len(flat)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(flat - flat[chosen[-1]], axis=1))
    return joints[chosen]


CHOOSE: dict[str, Way] = {
    KMEANS: by_kmeans,
    POSE_GRID: by_kmeans,
    RANDOM: at_random,
    FARTHEST: by_distance,
}
"""How each way chooses; "grid" chooses by k-means++ among the poses of the paper's grid."""


def best_error(chosen: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """`(...)`: the least mean joint distance of hypotheses `(k, 15, 3)` from truths `(..., 15,
    3)`."""
    far = np.linalg.norm(chosen - np.asarray(truth)[..., None, :, :], axis=-1).mean(axis=-1)
    return far.min(axis=-1)


def modes_represented(chosen: np.ndarray, draws: np.ndarray) -> float:
    """The share of draws `(n, 15, 3)` whose depth flips are those of one of the hypotheses `(k, 15,
    3)`."""
    return float(np.isin(codes(away(draws)), codes(away(chosen))).mean())
