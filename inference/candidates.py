"""Candidates: what an estimator makes of the torso, a torso in front of a camera, often more than
one way round.

Weak perspective leaves every torso a mirror twin (reflected in depth and turned) that projects to
nearly the same points; the limbs tell the two apart (§ 6 of the model). A `Frame` holds a detection
with its candidates."""

from dataclasses import dataclass

import numpy as np

from probmodel.body import align_torsos
from probmodel.camera import WeakPerspective
from probmodel.detections import LIKELIHOOD_JOINTS, Detection
from probmodel.failures import BadInput
from probmodel.observation import Observation
from probmodel.skeleton import TORSO_INDEX


@dataclass(frozen=True)
class Candidate:
    """A torso `(6, 3)` (body axes, body units), its index in the dictionary (-1: it is not in it),
    its camera, and the root mean square distance in pixels, weighted by score, between the seen
    torso joints and their projections.

    `pose` `(15, 3)` is the estimator's single 3D pose (camera axes, body units, pelvis at the
    origin); `objective` what it made small, in its own units, `iterations` how long that took, and
    `converged` whether it came to an end. An estimate that did not converge is the best one found.
    """

    torso_index: int
    torso: np.ndarray
    camera: WeakPerspective
    reprojection_error: float
    pose: np.ndarray | None = None
    objective: float = np.nan
    iterations: int = 0
    converged: bool = True

    @property
    def facing(self) -> np.ndarray:
        """`(3,)`: the way the chest points, in camera axes (x right, y down, z away from the
        camera)."""
        return np.asarray(self.camera.rotation)[:, 2]


@dataclass(frozen=True)
class Frame:
    """A detection and the candidates that explain its torso, best reprojection first, held fixed
    from here on.

    `factor` is the paper's 0.25 in τ; `joints` are those that carry a factor of the likelihood
    where seen; `estimator` names where the candidates come from."""

    detection: Detection
    candidates: tuple[Candidate, ...]
    factor: float = 0.25
    joints: tuple[int, ...] = LIKELIHOOD_JOINTS
    estimator: str = ""

    @property
    def pose(self) -> np.ndarray | None:
        """`(15, 3)`: the estimator's single 3D pose, that of the best candidate, in camera axes and
        body units."""
        return self.candidates[0].pose

    @property
    def converged(self) -> bool:
        """Whether the estimator came to an end for every candidate."""
        return all(candidate.converged for candidate in self.candidates)

    def observation(self, candidate: Candidate) -> Observation:
        """What the likelihood of the limbs needs, for one candidate."""
        radius = self.detection.radius(
            float(candidate.camera.scale), factor=self.factor, joints=self.joints
        )
        return Observation(
            candidate.torso,
            candidate.camera,
            self.detection.keypoints,
            radius,
            np.int64(candidate.torso_index),
        )

    def log_torso_likelihood(self, candidate: Candidate) -> float:
        """Log density of the seen torso joints: uniform in their discs, -inf where one lies outside
        its own.

        The torso's scores are normalised among themselves.
        """
        joints = [joint for joint in TORSO_INDEX if self.detection.seen[joint]]
        radius = self.detection.radius(
            float(candidate.camera.scale), factor=self.factor, joints=TORSO_INDEX
        )[joints]
        rows = [TORSO_INDEX.index(joint) for joint in joints]
        offset = (
            np.asarray(candidate.camera.project(candidate.torso))[rows]
            - self.detection.keypoints[joints]
        )
        inside = np.all(np.sum(offset**2, axis=-1) <= radius**2)
        return float(-np.sum(np.log(np.pi * radius**2))) if inside else -np.inf


def candidate_from_pose(
    detection: Detection,
    joints: np.ndarray,
    torso: np.ndarray,
    *,
    objective: float = np.nan,
    iterations: int = 0,
    converged: bool = True,
) -> Candidate:
    """The candidate that a whole pose makes: `joints` `(15, 3)` in camera axes and pixels, x and y
    its projections.

    Body axes and body unit are those in which its torso lies best on `torso` `(6, 3)`, of which
    both are known. (A mean limb length of one would define the unit too, but estimators foreshorten
    limbs.) Raises `BadInput` where the torso has no size."""
    own = joints[list(TORSO_INDEX)] - joints[0]
    rotation = align_torsos(own[None], torso)[0].T
    unit = float(np.sum(own @ rotation * torso) / np.sum(torso**2))
    if not unit > 0:
        raise BadInput(
            f"the torso of the pose estimated for {detection.where} has no size, so that its scale"
            " is zero"
        )
    pose, own = (joints - joints[0]) / unit, own / unit
    camera = WeakPerspective(unit, rotation, joints[0, :2].copy())
    seen = [joint for joint in TORSO_INDEX if detection.seen[joint]]
    square = np.sum((joints[seen, :2] - detection.keypoints[seen]) ** 2, axis=1)
    error = float(np.sqrt(np.average(square, weights=detection.score[seen])))
    return Candidate(-1, own @ rotation, camera, error, pose, objective, iterations, converged)
