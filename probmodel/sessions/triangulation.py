"""Triangulation: points of the world from what several calibrated cameras detected, with how sure
they are.

Residuals are measured where the person is: pixels over `scale`, the camera's pixels a mm there, so
that a near camera does not count for more. Each camera's trust is the square of its score over the
person's mean score, and falls for residuals beyond `ROBUST` (Cauchy's weights)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.sessions.pinhole import Pinhole

ROBUST = 50.0
"""Millimetres: residuals beyond it count less and less."""
STEPS = 25
"""Of reweighting."""
FLAT = 1e-14
"""A normal matrix whose determinant is smaller, in cubes of its trace, fixes no point: its lines of
sight are one."""
LINEAR = 5
"""Of them, so many by the linear system, which needs no start; the rest by Gauss and Newton."""


class Triangulated(NamedTuple):
    """Points of the world.

    Attributes
    ----------
    points
        `(n, 3)` mm, NaN where fewer than two cameras saw one, or all from one line.
    covariance
        `(n, 3, 3)` of the points, for detections whose error has a standard deviation of one mm
        each way where the person is, and an average score; NaN likewise. It is that of weighted
        least squares at the final weights: cameras that were not trusted do not help.
    weight
        `(cameras, n)` each camera's final trust, 0 where it saw nothing.
    """

    points: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray


def triangulate(
    cameras: Sequence[Pinhole], xy: np.ndarray, trust: np.ndarray, scale: np.ndarray
) -> Triangulated:
    """Points by weighted least squares that trusts large residuals less.

    Parameters
    ----------
    cameras
        Without distortion.
    xy
        `(cameras, n, 2)` straightened pixels; anything where nothing was seen.
    trust
        `(cameras, n)`, 0 where nothing was seen.
    scale
        `(cameras, n)` pixels a mm.
    """
    seen = trust > 0
    enough = seen.sum(axis=0) >= 2
    xy = np.where(seen[..., None], xy, 0.0)
    weight = trust.copy()
    points = np.zeros((xy.shape[1], 3))
    depth = np.ones_like(trust)
    with np.errstate(invalid="ignore", divide="ignore"):  # points that too few saw become NaN
        for step in range(STEPS):
            if step < LINEAR:
                points = _linear(cameras, xy, weight / (depth * scale) ** 2, enough)
            else:
                points = points + _newton(cameras, points, xy, weight, scale)[0]
            depth = np.stack([camera.view(points)[:, 2] for camera in cameras])
            far = np.linalg.norm(residuals(cameras, points, xy, scale), axis=-1)
            weight = np.where(seen & enough, trust / (1 + (far / ROBUST) ** 2), 0.0)
    _, normal = _newton(cameras, points, xy, weight, scale)
    enough = enough & _regular(normal)
    covariance = np.full((len(points), 3, 3), np.nan)
    covariance[enough] = np.linalg.inv(normal[enough])
    points = np.where(enough[:, None], points, np.nan)
    return Triangulated(points, covariance, weight)


def residuals(
    cameras: Sequence[Pinhole], points: np.ndarray, xy: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """`(cameras, n, 2)` mm: detected minus projected, where the person is."""
    image = np.stack([camera.project(points) for camera in cameras])
    return (xy - image) / scale[..., None]


def _linear(
    cameras: Sequence[Pinhole], xy: np.ndarray, weight: np.ndarray, enough: np.ndarray
) -> np.ndarray:
    """The points of the linear system (DLT), whose rows are weighted."""
    rows = np.stack([matrix(camera) for camera in cameras])
    lines = xy[..., None] * rows[:, None, 2:] - rows[:, None, :2]
    normal = np.einsum("cn,cnki,cnkj->nij", weight, lines[..., :3], lines[..., :3])
    right = -np.einsum("cn,cnki,cnk->ni", weight, lines[..., :3], lines[..., 3])
    return _solved(normal, right, enough)


def _newton(
    cameras: Sequence[Pinhole],
    points: np.ndarray,
    xy: np.ndarray,
    weight: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """A step of Gauss and Newton `(n, 3)`, and the normal matrices `(n, 3, 3)`."""
    slopes = np.stack([camera.slope(points) for camera in cameras]) / scale[..., None, None]
    apart = residuals(cameras, points, xy, scale)
    normal = np.einsum("cn,cnki,cnkj->nij", weight, slopes, slopes)
    right = np.einsum("cn,cnki,cnk->ni", weight, slopes, apart)
    return _solved(normal, right, weight.astype(bool).sum(axis=0) >= 2), normal


def _regular(normal: np.ndarray) -> np.ndarray:
    """`(n,)` bool: which of the matrices `(n, 3, 3)` have an inverse that says something."""
    finite = np.isfinite(normal).all(axis=(1, 2))
    safe = np.where(finite[:, None, None], normal, 0.0)
    return np.linalg.det(safe) > FLAT * np.trace(safe, axis1=1, axis2=2) ** 3


def _solved(normal: np.ndarray, right: np.ndarray, enough: np.ndarray) -> np.ndarray:
    """`(n, 3)`: solutions, 0 where there is none."""
    good = enough & _regular(normal)
    found = np.zeros(right.shape)
    found[good] = np.linalg.solve(normal[good], right[good][..., None])[..., 0]
    return found


def matrix(camera: Pinhole) -> np.ndarray:
    """`(3, 4)`: homogeneous points of the world → homogeneous straightened pixels."""
    inner = np.diag([*camera.focal, 1.0])
    inner[:2, 2] = camera.principal
    return inner @ np.column_stack([camera.rotation, -camera.rotation @ camera.centre])
