"""The law of a detected keypoint as a NumPyro distribution; `likelihood` has the laws of its
error."""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from poseterior.probmodel.directions.supports import disc, same_rank
from poseterior.probmodel.errors.laws import ErrorLaw


class DetectedKeypoint(Distribution):
    """Where a joint is detected: `centre` plus an error of the law, times `spread`.

    Parameters
    ----------
    law
        The errors' law.
    centre : `(..., 2)`
        Where the joint projects.
    spread : `(...)`
        In the units of `centre`.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    arg_constraints = {"centre": constraints.real_vector, "spread": constraints.positive}  # noqa: RUF012
    reparametrized_params = ["centre", "spread"]  # noqa: RUF012
    pytree_data_fields = ("law", "centre", "spread")

    def __init__(
        self,
        law: ErrorLaw,
        centre: ArrayLike,
        spread: ArrayLike,
        *,
        validate_args: bool | None = None,
    ) -> None:
        centre, spread = jnp.asarray(centre), jnp.asarray(spread)
        batch_shape = jnp.broadcast_shapes(centre.shape[:-1], spread.shape)
        self.law = law
        self.centre = jnp.broadcast_to(centre, (*batch_shape, 2))
        self.spread = jnp.broadcast_to(spread, batch_shape)
        super().__init__(batch_shape=batch_shape, event_shape=(2,), validate_args=validate_args)

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return disc(self.centre, self.law.reach * self.spread)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Points `sample_shape + batch_shape + (2,)`."""
        error = self.law.sample(key, (*sample_shape, *self.batch_shape))
        error, centre, spread = same_rank(error, self.centre, self.spread[..., None])
        return centre + spread * error

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Log density per unit of area of `centre`, -inf outside the reach."""
        value, centre, spread = same_rank(value, self.centre, self.spread[..., None])
        square = jnp.sum(((value - centre) / spread) ** 2, axis=-1)
        return self.law.log_peak + self.law.log_ratio(square) - 2 * jnp.log(spread[..., 0])
