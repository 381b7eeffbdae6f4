"""Possible directions of lower bones: a plane and a box for each cell of the parent.

The usual way in: `Observations.gather(parent, lower)`, its `around` a cell, `fit_cell` of that."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from poseterior.probmodel.anatomy.limits import GRID, NUM_ELEVATION
from poseterior.probmodel.learning.sphere import (
    CUBES,
    cells_of,
    chord,
    cubes_of,
    fibonacci,
    grid_points,
    in_company,
    swing,
)
from poseterior.probmodel.learning.tolerance import Tolerance

REFERENCE = np.array([1.0, 0.0, 0.0])
"""The line through the shoulders or hips: only a limb stretched out exactly sideways is parallel to
it, and limits learned from mirrored poses are mirror images of each other."""
FALLBACK = np.array([0.0, 1.0, 0.0])
SPINNING = 20.0
"""Degrees from the reference within which a lower bone's axes turn by more than a few degrees
inside one parent cell."""
_CORNERS = np.array([(0.5, 0.5), (0.1, 0.1), (0.1, 0.9), (0.9, 0.1), (0.9, 0.9)])
_COARSE = fibonacci(1500)
_FINE = fibonacci(40_000)
_FINE = _FINE[_FINE[:, 2] > np.cos(np.radians(5))]


class Observations(NamedTuple):
    """What was seen of a lower bone: `parent` and `lower`, local directions `(N, 3)` of its parent
    and of the bone itself; `in_torso`, the latter in the torso's axes; `thinned`, the indices of
    distinct ones (one for each pair of cubes); `tree` of the thinned parents; `by_cell`, indices by
    the parent's cell."""

    parent: np.ndarray
    lower: np.ndarray
    in_torso: np.ndarray
    thinned: np.ndarray
    tree: cKDTree
    by_cell: dict[int, np.ndarray]

    @classmethod
    def gather(cls, parent: np.ndarray, lower: np.ndarray, tolerance: Tolerance) -> "Observations":
        """From local unit vectors `(N, 3)` each; odd ones are left out, by both bones' directions
        in the torso's axes."""
        in_torso = np.einsum("nij,nj->ni", lower_axes_of(parent), lower)
        regular = in_company(parent, in_torso, others=tolerance.company, degrees=tolerance.within)
        parent, lower, in_torso = parent[regular], lower[regular], in_torso[regular]
        own = np.ravel_multi_index(cells_of(parent), GRID)
        thinned = np.unique(cubes_of(parent) * CUBES**3 + cubes_of(lower), return_index=True)[1]
        order = np.argsort(own, kind="stable")
        cells, first = np.unique(own[order], return_index=True)
        by_cell = dict(zip(cells.tolist(), np.split(order, first[1:]), strict=True))
        return cls(parent, lower, in_torso, thinned, cKDTree(parent[thinned]), by_cell)

    def around(self, column: int, row: int, tolerance: Tolerance) -> np.ndarray:
        """Local directions `(n, 3)` of the lower bone seen in and near a cell of the parent."""
        centre = grid_points(column + 0.5, row + 0.5)
        far = np.max(self.tree.query(centre, k=min(tolerance.samples, len(self.thinned)))[0])
        radius = max(far * (1 + 1e-9), chord(tolerance.neighbourhood))
        near = self.thinned[self.tree.query_ball_point(centre, radius)]
        own = self.by_cell.get(column * NUM_ELEVATION + row, np.empty(0, int))
        return np.concatenate([self._carried(near, column, row), self.lower[own]])

    def _carried(self, near: np.ndarray, column: int, row: int) -> np.ndarray:
        """Neighbours' directions as seen from the cell: the lower bone is carried along when its
        parent swings there by the shortest way, because local axes spin fast where the parent nears
        the reference."""
        parent, in_torso = self.parent[near], self.in_torso[near]
        points = grid_points(column + _CORNERS[:, 0], row + _CORNERS[:, 1])
        if abs(points[0] @ REFERENCE) < np.cos(np.radians(SPINNING)):
            points = points[:1]
        moved = [
            lower_axes_of(point[None])[0].T @ swing(parent, in_torso, point).T for point in points
        ]
        return np.concatenate([directions.T for directions in moved])


def lower_axes_of(parent: np.ndarray) -> np.ndarray:
    """`kinematics.lower_axes` for many parents `(N, 3)`, in NumPy: `(N, 3, 3)`."""
    v = np.cross(REFERENCE, parent)
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    v = np.where(size > 1e-8, v / np.maximum(size, 1e-300), np.cross(parent, FALLBACK))
    return np.stack([parent, v, np.cross(parent, v)], axis=-1)


class CellFit(NamedTuple):
    """Plane and box of one cell, as in `limits.AnatomicalLimits`: `(3,)`, `(3,)`, `()`, `(4,)`."""

    normal: np.ndarray
    tangent: np.ndarray
    offset: float
    bounds: np.ndarray


def fit_cell(directions: np.ndarray, margin: float) -> CellFit:
    """The plane that cuts off the largest empty cap, and the smallest box within it.

    Parameters
    ----------
    directions : `(n, 3)`
        Local unit vectors that were seen.
    margin
        Degrees by which plane and box are moved outwards; the plane cuts off a hemisphere at most.
    """
    coarse = directions[np.unique(cubes_of(directions), return_index=True)[1]]
    normal = largest_empty_cap(coarse)
    tangent = smallest_box(coarse, normal)
    offset = min(0.0, -_widen((directions @ normal).max(), margin))
    across, along = directions @ tangent, directions @ np.cross(normal, tangent)
    bounds = [
        _widen(across.min(), -margin),
        _widen(across.max(), margin),
        _widen(along.min(), -margin),
        _widen(along.max(), margin),
    ]
    return CellFit(normal, tangent, offset, np.array(bounds))


def _widen(value: float, degrees: float) -> float:
    """The sine of an angle, moved by `degrees`; at most a right angle."""
    angle = np.arcsin(np.clip(value, -1, 1)) + np.radians(degrees)
    return float(np.sin(np.clip(angle, -np.pi / 2, np.pi / 2)))


def largest_empty_cap(directions: np.ndarray) -> np.ndarray:
    """Centre `(3,)` of the largest spherical cap without any of `directions` `(n, 3)`.

    It is the normal of the plane with the smallest |d|. Where all directions fit into a hemisphere,
    the cap is larger than one, and its centre is opposite to the middle of the directions. Found to
    within 3°: candidates are 5° apart, the best is refined."""
    coarse = _COARSE[(directions @ _COARSE.T).max(axis=0).argmin()]
    fine = swing(np.tile([0.0, 0.0, 1.0], (len(_FINE), 1)), _FINE, coarse)
    normal = fine[(directions @ fine.T).max(axis=0).argmin()]
    return normal / np.linalg.norm(normal)


def smallest_box(directions: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The tangent `(3,)` of the plane in which the box around projected `directions` `(n, 3)` has
    the least area."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angles = np.radians(np.arange(0, 90, 2))
    cosine, sine = np.cos(angles), np.sin(angles)
    x, y = directions @ first, directions @ second
    across, along = np.outer(x, cosine) + np.outer(y, sine), np.outer(y, cosine) - np.outer(x, sine)
    best = (np.ptp(across, axis=0) * np.ptp(along, axis=0)).argmin()
    return cosine[best] * first + sine[best] * second
