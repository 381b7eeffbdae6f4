"""Maps of the joint limits: where upper bones can point, and how much room lower bones have
there."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from poseterior.probmodel.anatomy.limits import GRID, AnatomicalLimits
from poseterior.probmodel.learning.sphere import cells_of, fibonacci
from poseterior.probmodel.skeleton import BONE_NAMES, UPPER_BONES
from poseterior.reports.figures.style import page
from poseterior.reports.tables.words import spoken

EXTENT = (-180, 180, -90, 90)
DIRECTIONS = 2000
"""By which areas are measured."""


def limits_figure(limits: AnatomicalLimits, upper: np.ndarray) -> Figure:
    """Maps of our own tables, by azimuth and elevation.

    Parameters
    ----------
    limits
        The tables.
    upper
        `(N, 5, 3)` directions of upper bones that were seen.
    """
    figure = page(13, 6.2, dpi=120)
    grid = figure.add_gridspec(2, 6)
    for bone, place in ((0, grid[0, 0:2]), (1, grid[0, 2:4]), (3, grid[0, 4:6])):
        axes = figure.add_subplot(place)
        possible = np.asarray(limits.occupied)[bone]
        grey = np.where(possible, 0.15, np.nan)
        axes.imshow(grey.T, origin="lower", extent=EXTENT, cmap="Greys", vmin=0, vmax=1)
        counts = np.zeros(GRID)
        np.add.at(counts, cells_of(upper[:, bone]), 1.0)
        image = _draw(axes, np.where(counts > 0, counts, np.nan), "viridis", LogNorm(1, 2000))
        _outline(axes, possible)
        axes.set_title(spoken(UPPER_BONES[bone].name), fontsize=11)
    figure.colorbar(image, ax=axes, label="frames seen", shrink=0.85)
    free = solid_angles(limits)
    for bone, place in ((0, grid[1, 0:3]), (2, grid[1, 3:6])):
        axes = figure.add_subplot(place)
        image = _draw(axes, free[bone], "magma", Normalize(0, 4 * np.pi))
        _outline(axes, np.asarray(limits.has_plane)[bone])
        words = f"room of the {spoken(BONE_NAMES[5 + bone])}, by direction of its parent"
        axes.set_title(words, fontsize=11)
    figure.colorbar(image, ax=axes, label="steradians", shrink=0.85)
    return figure


def _draw(axes: Axes, values: np.ndarray, colours: str, norm: Normalize) -> AxesImage:
    image = axes.imshow(
        values.T, origin="lower", extent=EXTENT, cmap=colours, norm=norm, aspect="auto"
    )
    axes.set_xticks(range(-180, 181, 90))
    axes.set_yticks(range(-90, 91, 45))
    axes.set(xlabel="azimuth (°)", ylabel="elevation (°)")
    return image


def _outline(axes: Axes, mask: np.ndarray) -> None:
    azimuth = np.arange(GRID[0]) * 3 - 178.5
    elevation = np.arange(GRID[1]) * 3 - 88.5
    axes.contour(azimuth, elevation, mask.T.astype(float), [0.5], colors="black", linewidths=1.0)


def solid_angles(limits: AnatomicalLimits) -> np.ndarray:
    """`(4, 120, 60)` steradians of valid lower directions, by cell of the parent."""
    directions = fibonacci(DIRECTIONS)
    triples = np.asarray(limits.triples())
    areas = np.full(limits.has_plane.shape, np.nan)
    for where in zip(*np.nonzero(limits.has_plane), strict=True):
        coordinate = directions @ triples[where].T
        bounds = np.asarray(limits.bounds)[where]
        inside = (coordinate[:, 1:] >= bounds[0::2]) & (coordinate[:, 1:] <= bounds[1::2])
        valid = inside.all(axis=-1) & (coordinate[:, 0] + np.asarray(limits.offset)[where] < 0)
        areas[where] = 4 * np.pi * valid.mean()
    return areas
