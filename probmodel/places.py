"""The prior of where a body is in the world, as a NumPyro distribution."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import ImproperUniform, constraints

from poseterior.probmodel.rig import CameraRig


class SeenPlace(ImproperUniform):
    """Where a pelvis may be that some cameras see: flat in each image and in the log of the
    distance, on the average of the cameras. Its density per mm³ is the product of their depths to
    the power -3/C: what is believed of one camera alone (`TorsoCameraPrior`) where there is one.

    Parameters
    ----------
    rig
        The cameras.
    nearest : `()`
        Millimetres along its optical axis, that every camera is away at least.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    def __init__(
        self, rig: CameraRig, nearest: ArrayLike, *, validate_args: bool | None = None
    ) -> None:
        self.rig, self.nearest = rig, jnp.asarray(nearest)
        support: Any = constraints.real_vector
        super().__init__(support, (), (3,), validate_args=validate_args)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Log density per mm³, -inf where a camera is too near."""
        depth = self.rig.view(value)[..., 2]
        seen = jnp.all(depth >= self.nearest, axis=-1)
        level = -3 * jnp.mean(jnp.log(jnp.where(depth > 0, depth, 1.0)), axis=-1)
        return jnp.where(seen, level, -jnp.inf)
