"""Distributions of bone directions: `OccupiedDirection` (upper bones), `HingedDirection` (lower
bones).

Both are the law that a region's transport makes of the uniform square; densities are per steradian.
`RecipeDirection` is the paper's recipe for lower bones to the letter, for replication only: it has
no density."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from probmodel.directions.cells import Cells
from probmodel.directions.hinges import Hinge
from probmodel.directions.regions import Region
from probmodel.directions.supports import directions, is_inside, over_batch


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
    "angle")."""

    def __init__(self, region: Cells, *, validate_args: bool | None = None) -> None:
        super().__init__(region, jnp.shape(region.columns)[:-1], validate_args=validate_args)


class HingedDirection(_Direction):
    """Direction of a lower bone given its hinge, uniform in the hinge's measure (eq. 8 for
    "area")."""

    def __init__(self, region: Hinge, *, validate_args: bool | None = None) -> None:
        super().__init__(region, jnp.shape(region.offset), validate_args=validate_args)


class RecipeDirection(Distribution):
    """The paper's recipe for lower bones, to the letter: u2, u3 uniform in the box, u1 =
    ±√max(1-u2²-u3², 0), renormalised, one of the two signs at random where both are valid.

    Where the box sticks out of the unit disc the clamp puts mass on a great circle, so the law has
    no density. Draws for which neither sign is valid are made again, `attempts` times; what then
    remains invalid comes back as it is."""

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012
    pytree_data_fields = ("hinge",)
    pytree_aux_fields = ("attempts",)

    def __init__(
        self, hinge: Hinge, *, attempts: int = 100, validate_args: bool | None = None
    ) -> None:
        self.hinge = hinge
        self.attempts = attempts
        super().__init__(
            batch_shape=jnp.shape(hinge.offset), event_shape=(3,), validate_args=validate_args
        )

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return directions(self.hinge, len(self.batch_shape))

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Unit vectors `sample_shape + batch_shape + (3,)`."""
        return _recipes(self.hinge, key, (*sample_shape, *self.batch_shape), self.attempts)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Always an error: the clamp gives a great circle positive probability."""
        raise TypeError(
            "the paper's literal recipe has no density: the clamp √max(1-u2²-u3², 0) puts positive"
            ' probability on a great circle; use HingedDirection with measure "area" (eq. 8) or'
            ' "box" (the recipe inside the disc)'
        )


@functools.partial(jax.jit, static_argnums=(2, 3))
def _recipes(hinge: Hinge, key: jax.Array, shape: tuple[int, ...], attempts: int) -> jax.Array:
    keys = jax.random.split(key, shape)
    one = functools.partial(_recipe, attempts=attempts)
    for _ in range(hinge.offset.ndim):
        one = jax.vmap(one)
    for _ in range(len(shape) - hinge.offset.ndim):
        one = jax.vmap(one, in_axes=(None, 0))
    return one(hinge, keys)


def _recipe(hinge: Hinge, key: jax.Array, attempts: int) -> jax.Array:
    bounds = hinge.bounds

    def attempt(
        state: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        step, key, _ = state
        key, for_box, for_sign = jax.random.split(key, 3)
        u2, u3 = jax.random.uniform(for_box, (2,), minval=bounds[0::2], maxval=bounds[1::2])
        u1 = jnp.sqrt(jnp.maximum(1 - u2**2 - u3**2, 0.0))
        both = jnp.stack([jnp.stack([-u1, u2, u3]), jnp.stack([u1, u2, u3])])
        both = (both / jnp.linalg.norm(both, axis=-1, keepdims=True)) @ hinge.triple
        valid = jax.vmap(hinge.contains)(both)
        behind = jnp.where(valid.all(), jax.random.bernoulli(for_sign), valid[1] & ~valid[0])
        chosen = jnp.where(behind, both[1], both[0])
        return step + 1, key, chosen

    def unfinished(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return (state[0] < attempts) & ~hinge.contains(state[2])

    outside = hinge.triple[0]  # the normal itself is never valid, so the loop runs at least once
    return jax.lax.while_loop(unfinished, attempt, (jnp.zeros((), int), key, outside))[2]
