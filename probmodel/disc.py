"""The likelihood of one detected joint: uniform in a disc around the projected joint (§ 3 of the
model)."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from probmodel.directions.supports import disc, same_rank


class UniformDisc(Distribution):
    """Points `(2,)`, uniform in the disc with `centre` `(..., 2)` and `radius` `(...)`, both in
    pixels."""

    arg_constraints = {
        "centre": constraints.real_vector,
        "radius": constraints.positive,
    }  # noqa: RUF012
    reparametrized_params = ["centre", "radius"]  # noqa: RUF012

    def __init__(
        self, centre: ArrayLike, radius: ArrayLike, *, validate_args: bool | None = None
    ) -> None:
        centre, radius = jnp.asarray(centre), jnp.asarray(radius)
        batch_shape = jnp.broadcast_shapes(centre.shape[:-1], radius.shape)
        self.centre = jnp.broadcast_to(centre, (*batch_shape, 2))
        self.radius = jnp.broadcast_to(radius, batch_shape)
        super().__init__(batch_shape=batch_shape, event_shape=(2,), validate_args=validate_args)

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return disc(self.centre, self.radius)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Points `sample_shape + batch_shape + (2,)`."""
        shape = (*sample_shape, *self.batch_shape)
        for_distance, for_angle = jax.random.split(key)
        distance = jnp.sqrt(jax.random.uniform(for_distance, shape))
        angle = jax.random.uniform(for_angle, shape, maxval=2 * jnp.pi)
        offset = distance[..., None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        offset, centre, radius = same_rank(offset, self.centre, self.radius[..., None])
        return centre + radius * offset

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """-log πτ² per square pixel inside, -inf outside."""
        inside, radius = same_rank(self.support(value), self.radius)
        return jnp.where(inside, -jnp.log(jnp.pi) - 2 * jnp.log(radius), -jnp.inf)
