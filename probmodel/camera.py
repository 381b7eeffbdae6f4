"""Cameras. Weak perspective: keypoint = scale · (rotation · point)[:2] + translation; and
perspective, where the focal length is known, or what it may be.

Axes of the image and of the camera: x right, y down, z away from the camera. The paper writes the
translation with the opposite sign. A camera owns both steps of a projection: from a point in its
axes to the *plane* through the pelvis parallel to the image (`flatten`, body units), and from there
to pixels (`to_pixels`, with its inverse `to_plane`). Everything but a picture works on the plane.
How much larger than at the pelvis a point appears is its `magnification`.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from scipy.special import ndtri

FOCAL_MEDIAN, FOCAL_SPREAD = 0.9, 0.35
"""Of the log-normal prior of a focal length that nobody knows, in longer sides of the image: nine
in ten lie from 0.5 to 1.6, telephones' main cameras near 0.7 to 0.8, webcams and camcorders about
1."""
FOCAL_LENGTHS = 5
"""The prior has so many focal lengths, equally probable: neighbours' differ by a fifth to a third,
a perspective that no single detection tells apart."""


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

    def relative_depth(self, points: ArrayLike) -> jax.Array:
        """`(...)`: how far away points `(..., 3)` in camera axes are, in the pelvis' distances:
        everything is as far."""
        return jnp.ones(jnp.shape(points)[:-1])

    def magnification(self, points: ArrayLike) -> jax.Array:
        """`(...)`: how much larger than at the pelvis things appear at points `(..., 3)` in camera
        axes: everything is as large as there."""
        return self.relative_depth(points)

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

    def through(self, lens: "Lens | None") -> "WeakPerspective | Perspective":
        """The camera that has this lens and sees the pelvis as this one does; this one itself where
        no lens is known."""
        return self if lens is None else Perspective(self, lens)


class Lens(NamedTuple):
    """What is known of a camera before it sees anybody, a pytree.

    Attributes
    ----------
    focal : `()`
        The focal length, pixels; or `(K,)`, what it may be, each as probable as the others.
    principal : `(2,)`
        Where the optical axis meets the image, pixels.
    """

    focal: float | np.ndarray | jax.Array
    principal: np.ndarray | jax.Array

    @classmethod
    def unknown(cls, longer: float, principal: ArrayLike, number: int = FOCAL_LENGTHS) -> "Lens":
        """What is believed of a camera of which nobody knows anything.

        Parameters
        ----------
        longer
            The longer side of the whole image, pixels.
        principal : `(2,)`
            Where the optical axis meets the image, pixels.
        number
            How many focal lengths stand for all.

        Returns
        -------
        Lens
            Focal lengths at the middles of so many equal parts of a log-normal law, whose median
            is `FOCAL_MEDIAN` longer sides, and its spread `FOCAL_SPREAD`.
        """
        parts = ndtri((np.arange(number) + 0.5) / number)
        focal = longer * FOCAL_MEDIAN * np.exp(FOCAL_SPREAD * parts)
        return cls(focal, np.asarray(principal))

    @property
    def number(self) -> int:
        """How many focal lengths there may be."""
        return int(np.size(self.focal))

    def at(self, index: Any) -> "Lens":
        """The lens of one of the focal lengths; None: of the only one."""
        return self if index is None else Lens(jnp.asarray(self.focal)[index], self.principal)


class Perspective(NamedTuple):
    """A camera of known focal length. The pelvis stands focal / scale body units away, measured
    along the optical axis, and appears as under weak perspective; what is nearer appears larger.

    Attributes
    ----------
    weak
        What it is for points at the depth of the pelvis.
    lens
        Focal length and principal point.
    """

    weak: WeakPerspective
    lens: Lens

    @property
    def scale(self) -> float | np.ndarray | jax.Array:
        """`()`: pixels per body unit at the pelvis."""
        return self.weak.scale

    @property
    def rotation(self) -> np.ndarray | jax.Array:
        """`(3, 3)`: from body axes to camera axes."""
        return self.weak.rotation

    @property
    def translation(self) -> np.ndarray | jax.Array:
        """`(2,)`: where the pelvis falls in the image, pixels."""
        return self.weak.translation

    def view(self, points: ArrayLike) -> jax.Array:
        """Turns points `(..., 3)` from body axes into camera axes, body units."""
        return self.weak.view(points)

    def relative_depth(self, points: ArrayLike) -> jax.Array:
        """`(...)`: how far away along the optical axis points `(..., 3)` in camera axes are, in the
        pelvis' distances; not positive behind the camera."""
        depth = jnp.asarray(points)[..., 2]
        return 1 + depth * (jnp.asarray(self.scale) / self.lens.focal)

    def magnification(self, points: ArrayLike) -> jax.Array:
        """`(...)`: how much larger than at the pelvis things appear at points `(..., 3)` in camera
        axes: the pelvis' distance over theirs. Points behind the camera have no image: 1."""
        depth = self.relative_depth(points)
        return 1 / jnp.where(depth > 0, depth, 1.0)

    def flatten(self, points: ArrayLike) -> jax.Array:
        """Where points `(..., 3)` in camera axes are seen on the plane `(..., 2)`, body units."""
        points = jnp.asarray(points)
        aside = jnp.asarray(self.translation) - jnp.asarray(self.lens.principal)
        aside = jnp.broadcast_to(aside / self.lens.focal, (*points.shape[:-1], 2))
        sheared = points[..., :2] - points[..., 2:] * aside
        return sheared * self.magnification(points)[..., None]

    def to_pixels(self, plane: ArrayLike) -> jax.Array:
        """Points of the plane `(..., 2)` as keypoints, pixels."""
        return self.weak.to_pixels(plane)

    def to_plane(self, keypoints: ArrayLike) -> Any:
        """Keypoints `(..., 2)` in pixels as points of the plane, body units."""
        return self.weak.to_plane(keypoints)

    def image(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` that are already in camera axes to pixels `(..., 2)`."""
        return self.to_pixels(self.flatten(points))

    def project(self, points: ArrayLike) -> jax.Array:
        """Projects points `(..., 3)` in body axes to pixels `(..., 2)`."""
        return self.image(self.view(points))
