"""The dictionary of torsos, six joints each in body axes and body units; a torso is an index into
it."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints


class TorsoDictionary(Distribution):
    """Index `()` of a torso, uniform over a dictionary.

    Parameters
    ----------
    torsos : `(J, 6, 3)`
        Body axes, body units.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012 — NumPyro's own protocol
    has_enumerate_support = True
    pytree_data_fields = ("torsos",)

    def __init__(self, torsos: ArrayLike, *, validate_args: bool | None = None) -> None:
        self.torsos = jnp.asarray(torsos)
        super().__init__(batch_shape=(), event_shape=(), validate_args=validate_args)

    @constraints.dependent_property(is_discrete=True, event_dim=0)
    def support(self) -> constraints.Constraint:
        return constraints.integer_interval(0, self.torsos.shape[0] - 1)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Indices `sample_shape`."""
        return jax.random.randint(key, sample_shape, 0, self.torsos.shape[0])

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """-log J on 0, …, J-1, -inf elsewhere."""
        value = jnp.asarray(value)
        inside = (value >= 0) & (value < self.torsos.shape[0]) & (value == jnp.floor(value))
        return jnp.where(inside, -jnp.log(self.torsos.shape[0]), -jnp.inf)

    def enumerate_support(self, expand: bool = True) -> jax.Array:
        """All indices `(J,)`."""
        return jnp.arange(self.torsos.shape[0])
