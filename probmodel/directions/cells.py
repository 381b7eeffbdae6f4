"""Directions of upper bones: the occupied cells of an azimuth × elevation table (eq. 7;
docs/model.md § 2).

Measure "angle" is uniform in azimuth and polar angle on the occupied cells, eq. 7: density ∝
1/cos(elevation) per steradian, which is unbounded at the poles. Measure "area" is uniform per
steradian. The way in: `Cells.build`."""

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION, cell_of
from poseterior.probmodel.directions.regions import Region
from poseterior.probmodel.kinematics import azimuth_elevation, direction

UPPER_MEASURES = ("angle", "area")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cells(Region):
    """Occupied cells with a measure.

    Parameters
    ----------
    occupied : `(120, 60)` bool
    columns : `(121,)`
        Running sums over azimuth of the cells' measure.
    rows : `(120, 61)`
        Within each azimuth, running sums over elevation.
    measure
        One of `UPPER_MEASURES`.
    """

    occupied: jax.Array
    columns: jax.Array
    rows: jax.Array
    measure: str = dataclasses.field(metadata={"static": True})

    @classmethod
    def build(cls, occupied: ArrayLike, measure: str = "angle") -> "Cells":
        """The region of a table `(..., 120, 60)`. Raises `ValueError` on an unknown measure."""
        if measure not in UPPER_MEASURES:
            raise ValueError(
                f"the measure of upper bones is one of {', '.join(UPPER_MEASURES)}, not {measure!r}"
            )
        occupied = jnp.asarray(occupied, bool)
        weight = jnp.where(occupied, cell_measure(measure), 0.0)
        rows = _running_sum(weight)
        return cls(occupied, _running_sum(rows[..., -1]), rows, measure)

    @property
    def total(self) -> jax.Array:
        """`()`: measure of all occupied cells, square radians or steradians."""
        return self.columns[..., -1]

    def contains(self, vector: jax.Array) -> jax.Array:
        """`()` bool: whether the unit vector `(3,)` points into an occupied cell."""
        return self.occupied[cell_of(vector)]

    def log_density(self, vector: jax.Array) -> jax.Array:
        """`()`: log density per steradian, eq. 7 for the measure "angle"."""
        if self.measure == "area":
            return -jnp.log(self.total)
        return -jnp.log(self.total) - jnp.log(jnp.hypot(vector[0], vector[1]))

    def transport(self, square: jax.Array) -> jax.Array:
        """Unit vector at a point of the unit square: azimuth by its marginal, elevation by its
        conditional law."""
        column, across = _pick(self.columns, square[0])
        row, along = _pick(self.rows[column], square[1])
        return direction((column + across) * CELL - jnp.pi, self._elevation(row + along, row))

    def inverse(self, vector: jax.Array) -> jax.Array:
        """The point of the unit square from which `transport` comes to `vector`."""
        azimuth, elevation = azimuth_elevation(vector)
        column, row = cell_of(vector)
        across = jnp.clip((azimuth + jnp.pi) / CELL - column, 0.0, 1.0)
        along = self._fraction(elevation, row)
        return jnp.stack(
            [_place(self.columns, column, across), _place(self.rows[column], row, along)]
        )

    def _elevation(self, position: jax.Array, row: jax.Array) -> jax.Array:
        if self.measure == "angle":
            return position * CELL - jnp.pi / 2
        low, high = row_sines(row)
        return jnp.arcsin(jnp.clip(low + (position - row) * (high - low), -1.0, 1.0))

    def _fraction(self, elevation: jax.Array, row: jax.Array) -> jax.Array:
        if self.measure == "angle":
            return jnp.clip((elevation + jnp.pi / 2) / CELL - row, 0.0, 1.0)
        low, high = row_sines(row)
        return jnp.clip((jnp.sin(elevation) - low) / (high - low), 0.0, 1.0)


def row_sines(row: ArrayLike) -> tuple[jax.Array, jax.Array]:
    """Sines of the elevations between which a row of cells lies."""
    row = jnp.asarray(row)
    return jnp.sin(row * CELL - jnp.pi / 2), jnp.sin((row + 1) * CELL - jnp.pi / 2)


def cell_measure(measure: str) -> jax.Array:
    """`(60,)`: each cell's measure by row, square radians for "angle", steradians for "area"."""
    if measure == "angle":
        return jnp.full(NUM_ELEVATION, CELL**2)
    low, high = row_sines(jnp.arange(NUM_ELEVATION))
    return CELL * (high - low)


def cell_centres() -> jax.Array:
    """`(120, 60, 3)`: unit vectors at the middle of the cells."""
    azimuth = (jnp.arange(NUM_AZIMUTH) + 0.5) * CELL - jnp.pi
    elevation = (jnp.arange(NUM_ELEVATION) + 0.5) * CELL - jnp.pi / 2
    return direction(*jnp.meshgrid(azimuth, elevation, indexing="ij"))


def _running_sum(weight: jax.Array) -> jax.Array:
    return jnp.concatenate(
        [jnp.zeros((*weight.shape[:-1], 1)), jnp.cumsum(weight, axis=-1)], axis=-1
    )


def _pick(sums: jax.Array, fraction: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The bin into which `fraction` of the whole falls, never an empty one, and how far into it."""
    target = fraction * sums[-1]
    index = jnp.searchsorted(sums, target, side="right") - 1
    # The very end belongs to the last bin that holds anything.
    last = jnp.searchsorted(sums, sums[-1], side="left") - 1
    index = jnp.clip(index, 0, last)
    width = sums[index + 1] - sums[index]
    return index, jnp.clip((target - sums[index]) / jnp.where(width > 0, width, 1.0), 0.0, 1.0)


def _place(sums: jax.Array, index: jax.Array, within: jax.Array) -> jax.Array:
    # A direction on the edge may round into an azimuth that holds nothing.
    whole = jnp.where(sums[-1] > 0, sums[-1], 1.0)
    return (sums[index] + within * (sums[index + 1] - sums[index])) / whole
