"""What the likelihood needs: one candidate torso in front of one camera, the detected keypoints and
their discs."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from probmodel.camera import WeakPerspective


class Observation(NamedTuple):
    """A torso and camera held fixed, and the detections to be explained.

    `torso` `(6, 3)` body units, body axes, pelvis at the origin; `camera`; `keypoints` `(15, 2)`
    pixels, NaN where missing; `radius` `(15,)` τ in pixels, NaN where a joint has no factor;
    `torso_index` in the dictionary."""

    torso: ArrayLike
    camera: WeakPerspective
    keypoints: ArrayLike
    radius: ArrayLike
    torso_index: ArrayLike = 0

    @property
    def has_factor(self) -> jax.Array:
        """`(15,)` bool: joints that were detected and count in the likelihood."""
        return jnp.isfinite(jnp.asarray(self.radius)) & jnp.isfinite(
            jnp.asarray(self.keypoints)
        ).all(axis=-1)

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in camera axes."""
        return self.camera.view(self.torso)

    @property
    def log_disc_density(self) -> jax.Array:
        """`()`: the likelihood wherever the indicator is one, -Σ log πτ², per square pixel and seen
        joint."""
        radius = jnp.where(self.has_factor, jnp.asarray(self.radius), 1.0)
        return -jnp.sum(jnp.where(self.has_factor, jnp.log(jnp.pi * radius**2), 0.0))

    def explains(self, joints: ArrayLike) -> jax.Array:
        """`(...)` bool: whether poses `(..., 15, 3)` in camera axes put every seen joint into its
        disc."""
        return jnp.vectorize(self._explains, signature="(j,x)->()")(joints)

    def _explains(self, joints: jax.Array) -> jax.Array:
        seen = self.has_factor
        offset = self.camera.image(joints) - jnp.where(
            seen[:, None], jnp.asarray(self.keypoints), 0.0
        )
        radius = jnp.where(seen, jnp.asarray(self.radius), jnp.inf)
        return jnp.all(jnp.sum(offset**2, axis=-1) <= radius**2)
