"""Calibrated cameras that stand in one world, and a body that all of them see.

Axes of the world are the calibration's, lengths millimetres. Cameras are without distortion and
have square pixels: `sessions.Pinhole.straight`, whose image `straighten` makes of a real one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.camera import Lens, Perspective, WeakPerspective

if TYPE_CHECKING:
    from poseterior.probmodel.sessions.pinhole import Pinhole


class CameraRig(NamedTuple):
    """Calibrated cameras, a pytree whose leaves start with C.

    Attributes
    ----------
    focal : `(C,)`
        Pixels.
    principal : `(C, 2)`
        Where the optical axes meet the images, pixels.
    rotation : `(C, 3, 3)`
        From the world's axes to those of each camera.
    centre : `(C, 3)`
        Where they stand, mm.
    """

    focal: np.ndarray | jax.Array
    principal: np.ndarray | jax.Array
    rotation: np.ndarray | jax.Array
    centre: np.ndarray | jax.Array

    @classmethod
    def of(cls, cameras: "Sequence[Pinhole]") -> "CameraRig":
        """Cameras without distortion, as `Pinhole.straight` has them."""
        return cls(
            np.array([camera.focal[0] for camera in cameras]),
            np.stack([camera.principal for camera in cameras]),
            np.stack([camera.rotation for camera in cameras]),
            np.stack([camera.centre for camera in cameras]),
        )

    @property
    def number(self) -> int:
        """How many cameras there are."""
        return self.focal.shape[0]

    def shifted(self, pixels: ArrayLike) -> "CameraRig":
        """The cameras whose images lie some pixels `(C, 2)` beside; `(0, 2)`: the same."""
        shift = jnp.asarray(pixels)
        return self._replace(principal=self.principal + shift) if shift.size else self

    def view(self, points: ArrayLike) -> jax.Array:
        """`(..., C, 3)`: points `(..., 3)` of the world, mm, in the axes of every camera."""
        centre, rotation = jnp.asarray(self.centre), jnp.asarray(self.rotation)

        def one(point: jax.Array) -> jax.Array:
            return jnp.einsum("cab,cb->ca", rotation, point[None] - centre)

        return jnp.vectorize(one, signature="(x)->(c,x)")(jnp.asarray(points))

    def rays(self, pixels: ArrayLike) -> jax.Array:
        """`(C, 3)`: unit vectors of the world along which each camera sees a pixel `(C, 2)`."""
        pixels = jnp.asarray(pixels)

        def one(pixel: jax.Array, camera: CameraRig) -> jax.Array:
            ahead = jnp.append((pixel - camera.principal) / camera.focal, 1.0)
            return ahead / jnp.linalg.norm(ahead) @ camera.rotation

        return jax.vmap(one)(pixels, jax.tree.map(jnp.asarray, self))


class PlacedBody(NamedTuple):
    """A body in the world and the cameras that see it: what a camera is to a root of one view.

    Attributes
    ----------
    rig
        The cameras.
    rotation : `(3, 3)`
        From body axes to the world's.
    size : `()`
        Millimetres a body unit.
    place : `(3,)`
        Where the pelvis is, mm.
    """

    rig: CameraRig
    rotation: np.ndarray | jax.Array
    size: float | np.ndarray | jax.Array
    place: np.ndarray | jax.Array

    def view(self, points: ArrayLike) -> jax.Array:
        """Turns points `(..., 3)` from body axes into the world's axes, body units."""
        return jnp.asarray(points) @ jnp.asarray(self.rotation).T

    def world(self, points: ArrayLike) -> jax.Array:
        """Points `(..., 3)` in the world's axes, body units from the pelvis, as places in mm."""
        arm = jnp.asarray(self.size) * jnp.asarray(points)
        return arm + jnp.broadcast_to(jnp.asarray(self.place), arm.shape)

    def image(self, points: ArrayLike) -> jax.Array:
        """`(C, ..., 2)` pixels: where every camera sees points `(..., 3)` that are already in the
        world's axes."""
        points = jnp.asarray(points)
        seen = zip(self.cameras, jnp.asarray(self.rig.rotation), strict=True)
        return jnp.stack([camera.image(points @ turn.T) for camera, turn in seen])

    @property
    def cameras(self) -> list[Perspective]:
        """The body's root as each camera sees it alone: a focal length is known, and the pelvis is
        where it is."""
        rotation, place = jnp.asarray(self.rotation), jnp.asarray(self.place)
        pelvis = self.rig.view(place)
        found = []
        for number in range(self.rig.number):
            focal, principal = self.rig.focal[number], jnp.asarray(self.rig.principal[number])
            depth = pelvis[number, 2]
            weak = WeakPerspective(
                focal * jnp.asarray(self.size) / depth,
                jnp.asarray(self.rig.rotation[number]) @ rotation,
                principal + focal * pelvis[number, :2] / depth,
            )
            found.append(Perspective(weak, Lens(focal, principal)))
        return found
