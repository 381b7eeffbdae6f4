"""Adjustment: the rotation and the coefficients of a few terms that together explain a batch of
image points.

    min over R, c of Σ α_j |x_j − R₂ Σ_k c_k A_kj − t|² + |penalty(c)|²

by Levenberg–Marquardt, all problems of the batch at once. The scale of the camera is in the
coefficients. A step is kept only where the objective falls, so it never rises. In a turned image
the steps are turned: damping prefers no axis."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

Penalty = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""From coefficients `(n, k)` to residuals `(n, m)` and their derivatives `(n, m, k)`."""


class Adjusted(NamedTuple):
    """`rotation` `(n, 3, 3)`, `coefficient` `(n, k)`, `objective` `(n,)`, whether each `converged`
    `(n,)`."""

    rotation: np.ndarray
    coefficient: np.ndarray
    objective: np.ndarray
    converged: np.ndarray


def centred(xy: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """`xy` `(n, ..., 15, d)` less its mean under `weight` `(n, 15)`: the best translation, taken
    out."""
    extra = xy.ndim - 3
    shaped = (weight / weight.sum(axis=1, keepdims=True)).reshape(len(xy), *[1] * extra, -1, 1)
    return xy - np.sum(shaped * xy, axis=-2, keepdims=True)


def adjust(
    xy: np.ndarray,
    weight: np.ndarray,
    terms: np.ndarray,
    rotation: np.ndarray,
    coefficient: np.ndarray,
    penalty: Penalty | None = None,
    *,
    iterations: int = 50,
    tolerance: float = 1e-10,
) -> Adjusted:
    """From the start `rotation` `(n, 3, 3)`, `coefficient` `(n, k)`: points `xy` `(n, 15, 2)`,
    `weight` `(n, 15)`, `terms` `(n, k, 15, 3)`. Converged is where a kept step lowered the
    objective by less than its share `tolerance`."""
    root = np.sqrt(weight)[:, :, None]
    target, terms = centred(xy, weight) * root, centred(terms, weight) * root[:, None]
    count = coefficient.shape[1]
    damping, converged = np.full(len(xy), 1e-3), np.zeros(len(xy), bool)
    now = _look(target, terms, rotation, coefficient, penalty)
    for _ in range(iterations):
        gradient, normal = _normal_equations(target, terms, rotation, now, coefficient)
        diagonal = np.einsum("nii->ni", normal).copy()
        diagonal[:, :3] = diagonal[:, :3].mean(axis=1, keepdims=True)
        normal = normal + (damping[:, None] * diagonal + 1e-12)[:, :, None] * np.eye(3 + count)
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        turned = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        moved = coefficient + step[:, 3:]
        trial = _look(target, terms, turned, moved, penalty)
        # What has converged stays where it is, so that no problem depends on the others of its
        # batch.
        better = ~converged & (trial.objective <= now.objective)
        gain = now.objective - np.minimum(trial.objective, now.objective)
        converged |= better & (gain <= tolerance * now.objective + 1e-24)
        rotation = np.where(better[:, None, None], turned, rotation)
        coefficient = np.where(better[:, None], moved, coefficient)
        now = _View(
            *(np.where(_like(better, new), new, old) for new, old in zip(trial, now, strict=True))
        )
        damping = np.clip(np.where(better, damping / 6, damping * 5), 1e-12, 1e8)
        if converged.all():
            break
    return Adjusted(rotation, coefficient, now.objective, converged)


class _View(NamedTuple):
    """Residuals of the points `(n, 15, 2)` and of the penalty `(n, m)`, the penalty's derivatives,
    the objective."""

    points: np.ndarray
    penalty: np.ndarray
    slope: np.ndarray
    objective: np.ndarray


def _look(
    target: np.ndarray,
    terms: np.ndarray,
    rotation: np.ndarray,
    coefficient: np.ndarray,
    penalty: Penalty | None,
) -> _View:
    pose = np.einsum("nk,nkja->nja", coefficient, terms)
    points = target - pose @ rotation[:, :2].swapaxes(1, 2)
    if penalty is None:
        rest, slope = np.zeros((len(target), 0)), np.zeros((len(target), 0, coefficient.shape[1]))
    else:
        rest, slope = penalty(coefficient)
    return _View(points, rest, slope, np.sum(points**2, axis=(1, 2)) + np.sum(rest**2, axis=1))


def _normal_equations(
    target: np.ndarray, terms: np.ndarray, rotation: np.ndarray, now: _View, coefficient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient `(n, 3 + k)` and Gauss–Newton matrix; the first three columns turn the pose about
    the camera's axes."""
    seen = terms @ rotation[:, None].swapaxes(2, 3)  # terms in camera axes
    pose = np.einsum("nk,nkja->nja", coefficient, seen)
    zero = np.zeros_like(pose[..., 0])
    x, y, z = np.moveaxis(pose, -1, 0)
    turn = np.stack(
        [np.stack([zero, -z], -1), np.stack([z, zero], -1), np.stack([-y, x], -1)], axis=1
    )
    jacobian = np.concatenate([turn, seen[..., :2]], axis=1).reshape(
        len(terms), 3 + coefficient.shape[1], -1
    )
    gradient = np.einsum("nkr,nr->nk", jacobian, now.points.reshape(len(terms), -1))
    normal = jacobian @ jacobian.swapaxes(1, 2)
    gradient[:, 3:] -= np.einsum("nmk,nm->nk", now.slope, now.penalty)
    normal[:, 3:, 3:] += now.slope.swapaxes(1, 2) @ now.slope
    return gradient, normal


def _like(flag: np.ndarray, array: np.ndarray) -> np.ndarray:
    return flag.reshape(-1, *[1] * (array.ndim - 1))


DEPTH = np.diag([1.0, 1.0, -1.0])


def mirror_twin(rotation: np.ndarray) -> np.ndarray:
    """Rotations `(..., 3, 3)` under which a flat body looks the same: reflected in depth, then
    turned back."""
    return DEPTH @ rotation @ DEPTH


def angle_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Radians `(n,)` between rotations `(n, 3, 3)`."""
    return (Rotation.from_matrix(one).inv() * Rotation.from_matrix(other)).magnitude()
