"""The weak-perspective camera: keypoint = scale · (rotation · point)[:2] + translation.

Axes of the image and of the camera: x right, y down, z away from the camera. The paper writes the
translation with the opposite sign. A camera owns both steps of a projection: from a point in its
axes to the *plane* through the pelvis parallel to the image (`flatten`, body units), and from there
to pixels (`to_pixels`, with its inverse `to_plane`). Everything but a picture works on the plane.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike


class WeakPerspective(NamedTuple):
    """A weak-perspective camera.

    Attributes
    ----------
    scale : `()`
        Pixels per body unit.
    rotation : `(3, 3)`
        From body axes to camera axes, proper.
    translation : `(2,)`
        Where the pelvis falls in the image, pixels.
    """

    scale: float | np.ndarray | jax.Array
    rotation: np.ndarray | jax.Array
    translation: np.ndarray | jax.Array

    def view(self, points: ArrayLike) -> jax.Array:
        """Turns points `(..., 3)` from body axes into camera axes, body units."""
        return jnp.asarray(points) @ jnp.asarray(self.rotation).T

    def flatten(self, points: ArrayLike) -> jax.Array:
        """Where points `(..., 3)` in camera axes fall on the plane `(..., 2)`, body units."""
        return jnp.asarray(points)[..., :2]

    def to_pixels(self, plane: ArrayLike) -> jax.Array:
        """Points of the plane `(..., 2)` as keypoints, pixels."""
        plane = jnp.asarray(plane)
        translation = jnp.broadcast_to(jnp.asarray(self.translation), plane.shape)
        return jnp.asarray(self.scale) * plane + translation

    def to_plane(self, keypoints: ArrayLike) -> Any:
        """Keypoints `(..., 2)` in pixels as points of the plane, body units: an array of JAX where
        the camera's numbers are, of NumPy else."""
        if isinstance(self.translation, jax.Array):
            keypoints = jnp.asarray(keypoints)
            translation = jnp.broadcast_to(self.translation, keypoints.shape)
            return (keypoints - translation) / self.scale
        return (np.asarray(keypoints, float) - np.asarray(self.translation)) / np.asarray(
            self.scale
        )

    def image(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` that are already in camera axes to pixels `(..., 2)`."""
        return self.to_pixels(self.flatten(points))

    def project(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` in body axes to pixels `(..., 2)`."""
        return self.image(self.view(points))
