"""The candidate that a whole pose makes, for estimators that fit poses rather than torsos."""

from typing import Any

import numpy as np

from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import TORSO_INDEX


def candidate_from_pose(
    detection: Detection, joints: np.ndarray, torso: np.ndarray, **ending: Any
) -> Candidate:
    """The candidate that a whole pose makes: `joints` `(15, 3)` in camera axes and pixels, x and y
    its projections.

    Body axes and body unit are those in which its torso lies best on `torso` `(6, 3)`, of which
    both are known. (A mean limb length of one would define the unit too, but estimators foreshorten
    limbs.) How the estimator came to its `ending` is a `Candidate`'s `objective`, `iterations` and
    `converged`. Raises `BadInput` where the torso has no size."""
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
    return Candidate(
        torso_index=-1,
        torso=own @ rotation,
        camera=camera,
        reprojection_error=error,
        pose=pose,
        **ending,
    )
