"""A calibrated camera: where points of the world fall in its image, with its lens' distortion."""

import dataclasses
from dataclasses import dataclass

import numpy as np

_STEPS = 20
"""Of the fixed point that takes the distortion away; each step gains a digit or more."""
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A pinhole camera with a distorting lens (Brown 1966, as OpenCV has it).

    Attributes
    ----------
    rotation
        `(3, 3)` from the world to the camera's axes: x right, y down, z away from it.
    centre
        `(3,)` mm, where it stands.
    focal, principal
        `(2,)` pixels.
    distortion
        K1, k2, p1, p2, k3.
    """

    rotation: np.ndarray
    centre: np.ndarray
    focal: np.ndarray
    principal: np.ndarray
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION

    def view(self, points: np.ndarray) -> np.ndarray:
        """Points `(..., 3)` of the world, mm, in the camera's axes."""
        return (points - self.centre) @ self.rotation.T

    def project(self, points: np.ndarray) -> np.ndarray:
        """`(..., 2)` pixels at which points `(..., 3)` of the world are seen."""
        view = self.view(points)
        plane = view[..., :2] / view[..., 2:]
        return self.focal * self._distorted(plane) + self.principal

    def straighten(self, pixels: np.ndarray) -> np.ndarray:
        """`(..., 2)` where pixels `(..., 2)` would be if the lens did not distort, and pixels were
        square: what `straight` sees."""
        seen = (pixels - self.principal) / self.focal
        plane = seen
        for _ in range(_STEPS):
            plane = plane + seen - self._distorted(plane)
        return self.straight.focal * plane + self.principal

    def slope(self, points: np.ndarray) -> np.ndarray:
        """`(..., 2, 3)` pixels a mm: how the straightened image of points `(..., 3)` of the world
        moves with them."""
        view = self.view(points)
        depth = view[..., 2, None]
        image = np.zeros((*view.shape[:-1], 2, 3))
        image[..., 0, 0], image[..., 1, 1] = 1.0, 1.0
        image[..., 2] = -view[..., :2] / depth
        return (self.focal / depth)[..., None] * (image @ self.rotation)

    @property
    def straight(self) -> "Pinhole":
        """The same camera without its lens' distortion, with square pixels, so that errors to the
        right and down are measured alike."""
        focal = np.full(2, self.focal.mean())
        return dataclasses.replace(self, focal=focal, distortion=NO_DISTORTION)

    def _distorted(self, plane: np.ndarray) -> np.ndarray:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[..., 0], plane[..., 1]
        square = x**2 + y**2
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        sideways = 2 * p1 * x * y + p2 * (square + 2 * x**2)
        downwards = p1 * (square + 2 * y**2) + 2 * p2 * x * y
        return np.stack([radial * x + sideways, radial * y + downwards], axis=-1)
