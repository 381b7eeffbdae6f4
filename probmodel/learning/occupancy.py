"""Possible directions of upper bones: which cells of the grid are occupied, from directions seen.

The usual way in: `occupancy(vectors, radius, closing)`."""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from poseterior.probmodel.anatomy.limits import GRID
from poseterior.probmodel.learning.sphere import cell_areas, cell_centres, cells_of, chord


def occupancy(vectors: np.ndarray, radius: float, closing: float) -> np.ndarray:
    """The cells that hold a seen direction or whose centre is near one, closed, without holes.

    Parameters
    ----------
    vectors : `(N, 3)`
        Unit vectors that were seen.
    radius
        A cell's centre this many degrees from a seen direction is possible.
    closing
        Degrees of the closing (dilation, then erosion) that follows.

    Returns
    -------
    occupied : `(120, 60)` bool
    """
    seen = np.zeros(GRID, bool)
    seen[cells_of(vectors)] = True
    # A thousandth of a radian is far below a cell; thinning makes the search ten times faster.
    grown = seen | _within(np.unique(vectors.round(3), axis=0), radius)
    centres = cell_centres()
    dilated = grown | _within(centres[grown], closing)
    closed = dilated if dilated.all() else grown | (dilated & ~_within(centres[~dilated], closing))
    return _fill_holes(closed)


def _within(vectors: np.ndarray, degrees: float) -> np.ndarray:
    """Cells `(120, 60)` whose centres lie within `degrees` of one of `vectors` `(N, 3)`."""
    distance, _ = cKDTree(vectors).query(
        cell_centres().reshape(-1, 3), distance_upper_bound=chord(degrees)
    )
    return np.isfinite(distance).reshape(GRID)


def _fill_holes(occupied: np.ndarray) -> np.ndarray:
    """Occupies every free patch but the largest; patches are connected across azimuth ±180° and
    over the poles."""
    labels, count = ndimage.label(~np.pad(occupied, ((1, 1), (0, 0)), mode="wrap"))
    labels, areas = labels[1:-1], cell_areas()
    graph = np.arange(count + 1)
    pairs = list(zip(labels[0], labels[-1], strict=True))
    for row in (labels[:, 0], labels[:, -1]):
        free = row[row > 0]
        pairs += [(free[0], label) for label in free[1:]]
    for a, b in pairs:
        if a and b and graph[a] != graph[b]:
            graph[graph == graph[b]] = graph[a]
    labels = graph[labels]
    sizes = np.bincount(labels.ravel(), weights=areas.ravel(), minlength=count + 1)
    sizes[0] = 0
    return occupied | (labels != sizes.argmax())
