"""Distributions of bone directions: `OccupiedDirection` (upper bones), `HingedDirection` (lower
bones).

Each is the law that a region's transport makes of the uniform square; densities are per steradian
(docs/model.md § 2)."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.directions.regions import Region
from poseterior.probmodel.directions.supports import directions, is_inside, over_batch


class _Direction(Distribution):
    """Unit vectors `(3,)` from a region (a pytree whose leaves may have leading batch axes)."""

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012 — NumPyro's own protocol
    reparametrized_params: list[str] = []  # noqa: RUF012
    pytree_data_fields = ("region",)

    def __init__(
        self, region: Region, batch_shape: tuple[int, ...], *, validate_args: bool | None = None
    ) -> None:
        self.region = region
        super().__init__(batch_shape=batch_shape, event_shape=(3,), validate_args=validate_args)

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return directions(self.region, len(self.batch_shape))

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Unit vectors `sample_shape + batch_shape + (3,)`."""
        square = jax.random.uniform(key, (*sample_shape, *self.batch_shape, 2))
        return self.transport(square)

    def transport(self, square: ArrayLike) -> jax.Array:
        """Unit vectors `(..., 3)` at points `(..., 2)` of the unit square."""
        return over_batch(type(self.region).transport, len(self.batch_shape), self.region, square)

    def inverse(self, value: ArrayLike) -> jax.Array:
        """Points `(..., 2)` of the unit square that `transport` sends to unit vectors `(...,
        3)`."""
        return over_batch(type(self.region).inverse, len(self.batch_shape), self.region, value)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Log density per steradian, -inf outside the support."""
        return over_batch(_log_density, len(self.batch_shape), self.region, value)


def _log_density(region: Region, vector: jax.Array) -> jax.Array:
    inside = is_inside(region, vector)
    # The density is evaluated at a harmless vector outside, so that no gradient is NaN.
    safe = jnp.where(inside, vector, jnp.array([0.6, 0.48, 0.64]))
    return jnp.where(inside, region.log_density(safe), -jnp.inf)


class OccupiedDirection(_Direction):
    """Direction of an upper bone, uniform on the occupied cells in the cells' measure (eq. 7 for
    "angle").

    Parameters
    ----------
    region
        The cells of azimuth and elevation that are possible.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    def __init__(self, region: Cells, *, validate_args: bool | None = None) -> None:
        super().__init__(region, jnp.shape(region.columns)[:-1], validate_args=validate_args)


class HingedDirection(_Direction):
    """Direction of a lower bone given its hinge, uniform in the hinge's measure (eq. 8 for "area").

    Parameters
    ----------
    region
        The hinge: a plane and a box in a lower bone's local axes.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    def __init__(self, region: Hinge, *, validate_args: bool | None = None) -> None:
        super().__init__(region, jnp.shape(region.offset), validate_args=validate_args)
