"""Candidates: what an estimator makes of the torso, a torso in front of a camera, often more than one way round.

Weak perspective leaves every torso a mirror twin (reflected in depth and turned) that projects to nearly the same
points; the limbs tell the two apart (§ 6 of the model). A `Frame` holds a detection with its candidates.
"""

from dataclasses import dataclass

import numpy as np

from probmodel.camera import WeakPerspective
from probmodel.detections import LIKELIHOOD_JOINTS, Detection
from probmodel.observation import Observation
from probmodel.skeleton import TORSO_INDEX


@dataclass(frozen=True)
class Candidate:
    """A torso `(6, 3)` (body axes, body units), its index in the dictionary, its camera, and the root mean square
    distance in pixels, weighted by score, between the seen torso joints and their projections."""

    torso_index: int
    torso: np.ndarray
    camera: WeakPerspective
    reprojection_error: float

    @property
    def facing(self) -> np.ndarray:
        """`(3,)`: the way the chest points, in camera axes (x right, y down, z away from the camera)."""
        return np.asarray(self.camera.rotation)[:, 2]


@dataclass(frozen=True)
class Frame:
    """A detection and the candidates that explain its torso, best reprojection first, held fixed from here on.

    `factor` is the paper's 0.25 in τ; `joints` are those that carry a factor of the likelihood where seen.
    """

    detection: Detection
    candidates: tuple[Candidate, ...]
    factor: float = 0.25
    joints: tuple[int, ...] = LIKELIHOOD_JOINTS

    def observation(self, candidate: Candidate) -> Observation:
        """What the likelihood of the limbs needs, for one candidate."""
        radius = self.detection.radius(float(candidate.camera.scale), factor=self.factor, joints=self.joints)
        return Observation(
            candidate.torso, candidate.camera, self.detection.keypoints, radius, np.int64(candidate.torso_index)
        )

    def log_torso_likelihood(self, candidate: Candidate) -> float:
        """Log density of the seen torso joints: uniform in their discs, -inf where one lies outside its own.

        The torso's scores are normalised among themselves.
        """
        joints = [joint for joint in TORSO_INDEX if self.detection.seen[joint]]
        radius = self.detection.radius(float(candidate.camera.scale), factor=self.factor, joints=TORSO_INDEX)[joints]
        rows = [TORSO_INDEX.index(joint) for joint in joints]
        offset = np.asarray(candidate.camera.project(candidate.torso))[rows] - self.detection.keypoints[joints]
        inside = np.all(np.sum(offset**2, axis=-1) <= radius**2)
        return float(-np.sum(np.log(np.pi * radius**2))) if inside else -np.inf
