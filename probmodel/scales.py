"""The prior of a root's scale where the focal length is known, as a NumPyro distribution."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import ImproperUniform, constraints


class FlatUpTo(ImproperUniform):
    """Density one on the real line up to `highest`: a law without a total mass.

    Parameters
    ----------
    highest : `()`
        Where it ends.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    def __init__(self, highest: ArrayLike, *, validate_args: bool | None = None) -> None:
        limit: Any = constraints.less_than(jnp.asarray(highest))
        super().__init__(limit, (), (), validate_args=validate_args)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """0, or -inf above `highest`."""
        return jnp.where(self.support(value), 0.0, -jnp.inf)
