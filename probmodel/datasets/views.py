"""Synthetic cameras, weak perspective: where they stand, and how poses look from there.

Also the reverse: from 3D poses in axes of the world and 2D joints, the weak-perspective camera that
fits them best."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.camera import WeakPerspective

UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""Turns right-handed axes with y up into the camera's, which then looks along −z."""
CENTRE = (320.0, 320.0)
"""Pixels: where the pelvis is seen."""


class View(NamedTuple):
    """A camera that sees the world turned by `yaw` about the vertical and then tilted by `tilt`
    (degrees), at `scale` pixels a millimetre, the pelvis at `CENTRE`."""

    yaw: float
    tilt: float
    scale: float = 0.2

    @property
    def camera(self) -> WeakPerspective:
        """From the world's axes (y up), millimetres, to pixels."""
        turn = Rotation.from_euler("yx", [self.yaw, self.tilt], degrees=True).as_matrix()
        return WeakPerspective(self.scale, UPRIGHT @ turn, np.array(CENTRE))

    def see(self, poses: np.ndarray) -> np.ndarray:
        """Poses `(..., 15, 3)` (y up) in camera axes, the pelvis at the origin."""
        return (poses - poses[..., :1, :]) @ np.asarray(self.camera.rotation).T


VIEWS = tuple(View(yaw, tilt) for yaw in (0.0, 60.0, 135.0, 250.0) for tilt in (-10.0, 20.0))
"""All round the person, from a little below and from above."""


def resection(
    poses: np.ndarray, keypoints: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The weak-perspective cameras that explain 2D joints `(N, 15, 2)` (NaN where missing) of poses
    `(N, 15, 3)` in any right-handed axes: rotations `(N, 3, 3)` into camera axes, scales `(N,)`,
    and translations `(N, 2)` of the pelvis.

    Least squares for an affine camera, then the nearest rotation; where fewer than four joints are
    seen, NaN."""
    rotation, scale = np.full((len(poses), 3, 3), np.nan), np.full(len(poses), np.nan)
    translation = np.full((len(poses), 2), np.nan)
    for row, (pose, points) in enumerate(zip(poses, keypoints, strict=True)):
        if np.isfinite(points).all(axis=1).sum() >= 4 and np.isfinite(pose).all():
            rotation[row], scale[row], translation[row] = _resection(pose, points)
    return rotation, scale, translation


def _resection(pose: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    seen = np.isfinite(points).all(axis=1)
    middle, centre = pose[seen].mean(axis=0), points[seen].mean(axis=0)
    affine = np.linalg.lstsq(pose[seen] - middle, points[seen] - centre, rcond=None)[0].T
    left, size, right = np.linalg.svd(affine, full_matrices=False)
    rows, scale = left @ right, size.mean()
    rotation = np.vstack([rows, np.cross(*rows)])
    return rotation, float(scale), centre - scale * rows @ (middle - pose[0])
