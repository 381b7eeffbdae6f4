"""The sphere in NumPy, 64 bits: the grid of cells, even spirals of points, turns, distances."""

import jax
import numpy as np
from numpy.typing import ArrayLike

from poseterior.probmodel.anatomy.limits import CELL, GRID, cell_of
from poseterior.probmodel.directions import cells


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
