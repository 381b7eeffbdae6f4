"""The weak-perspective camera: keypoint = scale · (rotation · point)[:2] + translation.

Axes of the image and of the camera: x right, y down, z away from the camera. The paper writes the
translation with the opposite sign. Points are in body units, keypoints in pixels, the scale in
pixels per body unit."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike


class WeakPerspective(NamedTuple):
    """Camera with `scale` `()`, `rotation` `(3, 3)` from body to camera axes (proper),
    `translation` `(2,)`."""

    scale: float | np.ndarray | jax.Array
    rotation: np.ndarray | jax.Array
    translation: np.ndarray | jax.Array

    def view(self, points: ArrayLike) -> jax.Array:
        """Turns points `(..., 3)` from body axes into camera axes, body units."""
        return jnp.asarray(points) @ jnp.asarray(self.rotation).T

    def image(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` that are already in camera axes to pixels `(..., 2)`."""
        planar = jnp.asarray(points)[..., :2]
        return jnp.asarray(self.scale) * planar + jnp.broadcast_to(
            jnp.asarray(self.translation), planar.shape
        )

    def project(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` in body axes to pixels `(..., 2)`."""
        return self.image(self.view(points))
