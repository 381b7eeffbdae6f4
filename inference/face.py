"""The face: which side of a person the camera sees, told by the nose, the eyes and the ears.

Fifteen joints cannot tell: reflect a body in depth and exchange its left and right, and it is a
possible body that projects to the same points (reports/readings.md). A face can, because a head is
not transparent. It is believed to be rigid, turned against the chest within what a neck allows, and
each of its points to be found where it faces the camera."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.roots import Candidate

METRE = 1 / 0.325
"""Body units: a limb bone of the motion capture is 0.325 m long on average."""
POINTS = METRE * np.array(
    [
        [0.0, -0.03, 0.120],
        [0.032, 0.015, 0.085],
        [-0.032, 0.015, 0.085],
        [0.073, 0.0, 0.0],
        [-0.073, 0.0, 0.0],
    ]
)
"""`(5, 3)` nose, eyes, ears in the head's axes (left, up, forward), rounded from usual measures of
adult heads."""
OUTWARD = np.array(
    [[0.0, 0.0, 1.0], [0.35, 0.0, 0.94], [-0.35, 0.0, 0.94], [0.98, 0.0, -0.2], [-0.98, 0.0, -0.2]]
)
"""`(5, 3)`: the way each point faces."""
GRAZING = np.array([-0.15, 0.0, 0.0, -0.25, -0.25])
"""`(5,)`: cosine to the camera at which a point is found half of the time; a nose and an ear stick
out."""
SHARPNESS = 8.0
RARELY, MOSTLY = 0.05, 0.95
"""How often a point is found that is turned away, and one that is in full view."""
SPREAD = 0.08
"""Standard deviation, body units, of a point about its place on the rigid head."""
TURNED = np.radians([35.0, 20.0, 15.0])
"""Standard deviations of a head's yaw, pitch and roll against the chest."""
FOUND = 0.4
"""A point of the face counts as found above this share of the body's median score: many detectors
give all points a score."""


class Heads(NamedTuple):
    """Ways a head may be turned against the chest: `rotations` `(n, 3, 3)` and the log of their
    prior mass."""

    rotations: np.ndarray
    log_mass: np.ndarray


def heads() -> Heads:
    """A grid over yaw (up to ±80°), pitch and roll."""
    yaw, pitch, roll = (
        np.radians(values) for values in (np.arange(-80, 81, 16), [-30, 0, 30], [-20, 0, 20])
    )
    angles = np.stack(np.meshgrid(yaw, pitch, roll, indexing="ij"), axis=-1).reshape(-1, 3)
    log_mass = -0.5 * np.sum((angles / TURNED) ** 2, axis=1)
    return Heads(
        Rotation.from_euler("YXZ", angles).as_matrix(), log_mass - np.logaddexp.reduce(log_mass)
    )


HEADS = heads()


def found(detection: Detection) -> np.ndarray | None:
    """`(5,)`: which points of the face the detector found; None where it has none, or found no
    joint of the body."""
    if detection.face is None or not detection.seen.any():
        return None
    return detection.face[:, 2] > FOUND * np.median(detection.score[detection.seen])


def log_face_likelihood(detection: Detection, candidate: Candidate) -> float:
    """Log likelihood of the face (which points were found, and how they lie to each other), given a
    candidate's chest; 0 where the detector says nothing of it."""
    seen = found(detection)
    if seen is None or detection.face is None:
        return 0.0
    turns = np.asarray(candidate.camera.rotation) @ HEADS.rotations
    facing = -np.einsum("nj,pj->np", turns[:, 2], OUTWARD)  # the camera lies where z is negative
    chance = RARELY + (MOSTLY - RARELY) / (1 + np.exp(-SHARPNESS * (facing - GRAZING)))
    log_found = np.where(seen, np.log(chance), np.log1p(-chance)).sum(axis=1)
    log_place = np.zeros(len(turns))
    if seen.sum() > 1:
        places = np.einsum("nij,pj->npi", turns[:, :2], POINTS[seen])
        offset = detection.face[seen, :2] / float(candidate.camera.scale) - places
        offset = offset - offset.mean(axis=1, keepdims=True)  # where the head is, the neck decides
        log_place = -0.5 * np.sum((offset / SPREAD) ** 2, axis=(1, 2))
    return float(np.logaddexp.reduce(HEADS.log_mass + log_found + log_place))
