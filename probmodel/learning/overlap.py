"""Overlap of two sets of limits: the share of the directions possible under one that is possible
under the other.

Shares are of area (steradians), not of cells: cells near the poles of azimuth and elevation are
small. The usual way in: `overlap(limits, other)`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.kinematics import lower_axes
from poseterior.probmodel.learning.sphere import cell_areas, cell_centres, fibonacci
from poseterior.probmodel.skeleton import NUM_LOWER


class Overlap(NamedTuple):
    """Two sets of possible directions, in the order of `skeleton.BONES`.

    Parameters
    ----------
    area, other_area : `(9,)`
        Steradians. Of a lower bone: averaged over the parent's directions that both sets have, or,
        where `joint`, integrated over all that either has.
    covered : `(9,)`
        Share of `other_area` that is in `area` too.
    outside : `(9,)`
        Share of `area` that is not in `other_area`.
    """

    area: np.ndarray
    other_area: np.ndarray
    covered: np.ndarray
    outside: np.ndarray


def overlap(
    limits: AnatomicalLimits, other: AnatomicalLimits, *, joint: bool = False, points: int = 1000
) -> Overlap:
    """Compares `limits` with `other`.

    A lower bone's set is that of pairs (parent's direction, own direction in the torso's axes),
    measured by the parent cell's area times the area of the valid directions at the cell's centre.

    Parameters
    ----------
    limits, other
    joint
        Whether parent cells that only one set has count too, a cell without a plane being empty.
    points
        Number of points over which a valid area is summed.
    """
    weights = cell_areas()
    measures = [
        _measure(weights[a], weights[b], weights[a & b])
        for a, b in zip(np.asarray(limits.occupied), np.asarray(other.occupied), strict=True)
    ]
    for bone in range(NUM_LOWER):
        here, there = (_parents(tables, bone) for tables in (limits, other))
        cells = np.argwhere(here | there if joint else here & there)
        a, b = (_valid(tables, bone, cells, points) for tables in (limits, other))
        weight = weights[tuple(cells.T)] * (4 * np.pi / points)
        scale = 1.0 if joint else weights[tuple(cells.T)].sum()
        measures.append(
            _measure(
                *(weight @ valid.sum(axis=-1, keepdims=True) / scale for valid in (a, b, a & b))
            )
        )
    return Overlap(*np.array(measures).T)


def _measure(a: np.ndarray, b: np.ndarray, both: np.ndarray) -> tuple[float, float, float, float]:
    area, other, common = float(a.sum()), float(b.sum()), float(both.sum())
    return area, other, common / other, 1 - common / area


def _parents(limits: AnatomicalLimits, bone: int) -> np.ndarray:
    return np.asarray(limits.occupied)[bone + 1] & limits.has_plane[bone]


def _valid(limits: AnatomicalLimits, bone: int, cells: np.ndarray, points: int) -> np.ndarray:
    """`(cells, points)`: which directions, given in the torso's axes, a lower bone can take."""
    valid = np.zeros((len(cells), points), bool)
    known = _parents(limits, bone)[tuple(cells.T)]
    where = (bone, *cells[known].T)
    parents = cell_centres()[where[1:]]
    with jax.enable_x64(True):
        axes = jax.vmap(lower_axes, (0, None, None))(
            jnp.asarray(parents),
            jnp.asarray(limits.reference, float),
            jnp.asarray(limits.fallback, float)[bone],
        )
        axes = np.asarray(axes) @ np.asarray(limits.triples())[where].swapaxes(-1, -2)
    coordinate = np.einsum("pi,cij->cpj", fibonacci(points), axes)
    offset, bounds = np.asarray(limits.offset)[where], np.asarray(limits.bounds)[where][:, None]
    in_box = (coordinate[..., 1:] >= bounds[..., 0::2]) & (coordinate[..., 1:] <= bounds[..., 1::2])
    valid[known] = (coordinate[..., 0] + offset[:, None] < 0) & in_box.all(axis=-1)
    return valid
