"""The sphere in NumPy, 64 bits: the grid of cells, even spirals of points, turns, distances."""

import jax
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from poseterior.probmodel.anatomy.limits import CELL, GRID, cell_of
from poseterior.probmodel.directions import cells

CUBES = 32
"""Directions that share a cube, of which this many divide [−1, 1], are one: 3.6° on a side."""
MOST_ODD = 0.01
"""Share of what was seen that can be left out as odd: of few frames that are far apart, all are."""


def cells_of(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`limits.cell_of`."""
    with jax.enable_x64(True):
        column, row = cell_of(vectors)
    return np.asarray(column), np.asarray(row)


def cell_centres() -> np.ndarray:
    """Unit vectors `(120, 60, 3)` in the middle of the cells."""
    with jax.enable_x64(True):
        return np.asarray(cells.cell_centres())


def cell_areas() -> np.ndarray:
    """Areas `(120, 60)` of the cells in steradians."""
    with jax.enable_x64(True):
        return np.broadcast_to(np.asarray(cells.cell_measure("area")), GRID)


def grid_points(column: ArrayLike, row: ArrayLike) -> np.ndarray:
    """Unit vectors `(..., 3)` at places in the grid of cells; a half is the middle of a cell."""
    azimuth, elevation = np.asarray(column) * CELL - np.pi, np.asarray(row) * CELL - np.pi / 2
    planar = np.cos(elevation)
    return np.stack(
        [planar * np.cos(azimuth), planar * np.sin(azimuth), np.sin(elevation)], axis=-1
    )


def fibonacci(count: int) -> np.ndarray:
    """`count` unit vectors `(count, 3)`, evenly over the sphere (a Fibonacci spiral)."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1
    )


def chord(degrees: float) -> float:
    """Distance of two unit vectors that are so many degrees apart."""
    return 2 * np.sin(np.radians(degrees) / 2)


def swing(start: np.ndarray, vectors: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Turns vectors by the shortest rotations that take unit vectors to another one.

    Rodrigues' formula with axis a = s × e, cosine c = s·e: x ↦ c x + a × x + a (a·x) / (1 + c).

    Parameters
    ----------
    start : `(N, 3)`, unit vectors s
    vectors : `(N, 3)`, each turned by the rotation of its own s
    end : `(3,)`, unit vector e

    Returns
    -------
    turned : `(N, 3)`
    """
    axis = np.cross(start, end)
    cosine = start @ end
    along = np.einsum("ni,ni->n", axis, vectors) / np.maximum(1 + cosine, 1e-6)
    return vectors * cosine[:, None] + np.cross(axis, vectors) + axis * along[:, None]


def cubes_of(directions: np.ndarray) -> np.ndarray:
    """Index `(n,)` of the cube in which each of `directions` `(n, 3)` lies."""
    cubes = np.floor((directions + 1) * (CUBES / 2)).astype(int)
    return np.clip(cubes, 0, CUBES - 1) @ CUBES ** np.arange(3)


def in_company(*directions: np.ndarray, others: int, degrees: float) -> np.ndarray:
    """Which of what was seen is not odd: so many distinct others lie within `degrees` of it.

    Parameters
    ----------
    *directions : `(N, 3)`
        Unit vectors that were seen together; distances are over all of them.
    others
        How many; what shares all its cubes is not distinct.
    degrees
        How far away; further where more than `MOST_ODD` of all would be odd otherwise.

    Returns
    -------
    regular : `(N,)` bool
    """
    seen = np.concatenate(directions, axis=-1)
    cubes = np.stack([cubes_of(one) for one in directions], axis=-1)
    distinct = seen[np.unique(cubes, axis=0, return_index=True)[1]]
    if not 0 < others < len(distinct):
        return np.ones(len(seen), bool)
    distance = cKDTree(distinct).query(seen, k=[others + 1])[0][:, 0]
    return distance <= max(chord(degrees), np.quantile(distance, 1 - MOST_ODD))
