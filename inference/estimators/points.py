"""What a batch of detections shows, prepared for a fit: centred, of size one, weighted by the
scores.

Weak perspective has no units of its own, so an estimator fits in these and its poses are carried
back to pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS, TORSO_INDEX, TORSO_JOINTS

FEWEST_SEEN = 4
"""Seen joints that a whole pose needs."""
TOUCHING = 1e-3
"""Pixels within which joints are one point, or lie on one line."""
_UPPER = {"thorax", "right_shoulder", "left_shoulder"}
_LOWER = {"pelvis", "right_hip", "left_hip"}


@dataclass(frozen=True)
class Points:
    """`xy` `(n, 15, 2)`, their weighted mean at the origin and their weighted mean square one, zero
    where missing; `weight` `(n, 15)`, the paper's α: scores with mean one over the seen joints,
    zero where missing. In pixels the origin is `centre` `(n, 2)` and the unit `size` `(n,)`."""

    xy: np.ndarray
    weight: np.ndarray
    centre: np.ndarray
    size: np.ndarray

    @classmethod
    def gather(cls, detections: Sequence[Detection]) -> "Points":
        """Raises `BadInput` on a detection from which no pose can be told (`require_pose`)."""
        for detection in detections:
            require_pose(detection)
        seen = np.stack([detection.seen for detection in detections])
        weight = np.nan_to_num(
            np.stack([detection.alpha(range(NUM_JOINTS)) for detection in detections])
        )
        xy = np.where(
            seen[..., None], np.stack([detection.keypoints for detection in detections]), 0.0
        )
        centre = np.einsum("nj,nju->nu", weight, xy) / weight.sum(axis=1)[:, None]
        xy = np.where(seen[..., None], xy - centre[:, None], 0.0)
        size = np.sqrt(np.einsum("nj,nju->n", weight, xy**2) / weight.sum(axis=1))
        return cls(xy / size[:, None, None], weight, centre, size)

    def repeat(self, times: int) -> "Points":
        """Every detection `times` times, one after the other."""
        return self.take(np.repeat(np.arange(len(self.xy)), times))

    def take(self, rows: np.ndarray) -> "Points":
        """Some of the detections."""
        return Points(*(part[rows] for part in (self.xy, self.weight, self.centre, self.size)))

    def back(self) -> np.ndarray:
        """`(n, 2)`: from the middle of the seen hips and pelvis to that of the seen shoulders and
        thorax; zero where there is none of either."""
        ends = []
        for names in (_UPPER, _LOWER):
            seen = (self.weight > 0) & np.isin(JOINTS, list(names))
            middle = (
                np.einsum("nj,nju->nu", seen, self.xy) / np.maximum(seen.sum(axis=1), 1)[:, None]
            )
            ends.append(middle)
        return ends[0] - ends[1]

    def pixels(
        self, rotation: np.ndarray, coefficient: np.ndarray, terms: np.ndarray
    ) -> np.ndarray:
        """Poses `(n, 15, 3)` in camera axes and pixels, put where they fit best: their x and y are
        the projections."""
        pose = np.einsum("nk,nkja->nja", coefficient, terms) @ rotation.swapaxes(1, 2)
        middle = np.einsum("nj,nja->na", self.weight, pose) / self.weight.sum(axis=1)[:, None]
        pose = (pose - middle[:, None]) * self.size[:, None, None]
        return pose + np.pad(self.centre, ((0, 0), (0, 1)))[:, None]

    @property
    def torso_weight(self) -> np.ndarray:
        """`(n, 15)`: the weights of the torso's joints, zero elsewhere."""
        return self.weight * np.isin(np.arange(NUM_JOINTS), TORSO_INDEX)


def require_pose(detection: Detection) -> None:
    """Raises `BadInput` where too little is seen to tell a pose: fewer than four joints, no torso
    joint, or joints that lie on one point or one line."""
    names = [name for name, seen in zip(JOINTS, detection.seen, strict=True) if seen]
    if len(names) < FEWEST_SEEN:
        found = ", ".join(names) or "none"
        raise BadInput(
            f"{detection.where} shows {found}; a pose needs at least {FEWEST_SEEN} joints: lower"
            " the threshold, or choose another person"
        )
    if not set(names) & set(TORSO_JOINTS):
        raise BadInput(
            f"{detection.where} shows no joint of the torso; a pose needs one of"
            f" {', '.join(TORSO_JOINTS)}: lower the threshold, or choose another person"
        )
    require_spread(detection, range(NUM_JOINTS))


def require_camera(detection: Detection) -> None:
    """Raises `BadInput` where the seen torso joints do not determine a camera: too few, or on one
    point or line."""
    names = {JOINTS[joint] for joint in TORSO_INDEX if detection.seen[joint]}
    # Three points that are not on one line: one above, one below, and not all on the back-bone.
    enough = len(names) >= 3 and names & _UPPER and names & _LOWER and names - {"thorax", "pelvis"}
    if not enough:
        found = ", ".join(name for name in TORSO_JOINTS if name in names) or "none"
        raise BadInput(
            f"too few torso joints for a camera in {detection.where}: it shows {found}; needed are"
            f" at least three of {', '.join(TORSO_JOINTS)}, one of them a shoulder or the thorax"
            " and one a hip or the pelvis"
        )
    require_spread(detection, TORSO_INDEX, "torso ")


def require_spread(detection: Detection, joints: Sequence[int], what: str = "") -> None:
    """Raises `BadInput` where the seen ones of `joints` lie on one point or on one line."""
    xy = detection.keypoints[[joint for joint in joints if detection.seen[joint]]]
    extent = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    # Differences of large coordinates are only as exact as the coordinates are.
    least = max(TOUCHING, 1e-9 * np.abs(xy).max())
    place = "on one point" if extent[0] < least else "on one line" if extent[1] < least else ""
    if place:
        raise BadInput(
            f"the {what}joints of {detection.where} all lie {place}, so no camera can be found;"
            " mend the detection, or choose another person"
        )
