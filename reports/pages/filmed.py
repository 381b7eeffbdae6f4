"""A person filmed by calibrated cameras: what one camera detects, and where the person was, from
the other cameras. What reports/honest.md shows.

The calibration is Qualisys's XML, read as the data's own notes say: with R the nine numbers r11 …
r33 and W = diag(1, -1, -1) R, a point X of the world (mm) is at W (X - c) in camera axes; focal
lengths and principal point are those of `intrinsic` over 64.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from probmodel import Detection, read_detections
from probmodel.skeleton import BONES, JOINT_INDEX, LIMB_JOINTS

SUBPIXELS = 64
FLIP = np.diag([1.0, -1.0, -1.0])
HIPS = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
STEPS = 20
"""Of reweighting: residuals of twenty pixels and more count less and less."""
ROBUST = 20.0


class Pinhole(NamedTuple):
    """A calibrated camera: `rotation` `(3, 3)` from the world to its axes (x right, y down, z
    away), `centre` `(3,)` mm, `focal` `(2,)` and `principal` `(2,)` pixels."""

    rotation: np.ndarray
    centre: np.ndarray
    focal: np.ndarray
    principal: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """`(3, 4)`: homogeneous points of the world → homogeneous pixels."""
        inner = np.array(
            [
                [self.focal[0], 0, self.principal[0]],
                [0, self.focal[1], self.principal[1]],
                [0, 0, 1],
            ]
        )
        return inner @ np.column_stack([self.rotation, -self.rotation @ self.centre])


class FilmedCase(NamedTuple):
    """What one camera detected, and the truth `(15, 3)` from the others: body units of the person,
    the hips' midpoint at the origin, z along the line of sight to it."""

    camera: int
    detection: Detection
    truth: np.ndarray


def read_cameras(path: Path) -> list[Pinhole]:
    """The cameras of a calibration, in its order."""
    found = []
    for camera in ElementTree.parse(path).iter("camera"):
        place, inner = camera.find("transform"), camera.find("intrinsic")
        assert place is not None
        assert inner is not None
        names = [f"r{row}{column}" for row, column in itertools.product("123", "123")]
        rotation = np.array([float(place.attrib[name]) for name in names]).reshape(3, 3)
        pairs = ("focalLengthU", "focalLengthV"), ("centerPointU", "centerPointV")
        focal, principal = (
            np.array([float(inner.attrib[name]) for name in pair]) / SUBPIXELS for pair in pairs
        )
        centre = np.array([float(place.attrib[axis]) for axis in "xyz"])
        found.append(Pinhole(FLIP @ rotation, centre, focal, principal))
    return found


def triangulate(cameras: Sequence[Pinhole], xy: np.ndarray, score: np.ndarray) -> np.ndarray:
    """Points of the world `(n, 3)`, mm, by weighted least squares that trusts large residuals less:
    `xy` `(cameras, n, 2)` pixels and `score` `(cameras, n)`, 0 where nothing was seen."""
    matrices = np.stack([camera.matrix for camera in cameras])
    found = np.full((xy.shape[1], 3), np.nan)
    for point in range(xy.shape[1]):
        seen = score[:, point] > 0
        if seen.sum() < 2:
            continue
        rows, target = matrices[seen], xy[seen, point]
        weight = score[seen, point]
        for _ in range(STEPS):
            lines = target[:, :, None] * rows[:, 2:3] - rows[:, :2]
            system = (weight[:, None, None] * lines).reshape(-1, 4)
            found[point] = np.linalg.lstsq(system[:, :3], -system[:, 3], rcond=None)[0]
            image = rows @ np.append(found[point], 1.0)
            far = np.linalg.norm(image[:, :2] / image[:, 2:] - target, axis=1)
            weight = score[seen, point] / (image[:, 2] * np.sqrt(1 + (far / ROBUST) ** 2))
    return found


def read_cases(folder: Path, frames: Sequence[int]) -> list[FilmedCase]:
    """Every camera in some frames, judged by the others."""
    cameras = read_cameras(folder / "calibration.qca.txt")
    files = [sorted((folder / f"cam{number:02}").glob("*.json")) for number in range(1, 5)]
    cases, units = [], []
    for frame in frames:
        people = [read_detections(names[frame])[0] for names in files]
        xy = np.stack([np.nan_to_num(person.keypoints) for person in people])
        score = np.stack([person.score for person in people])
        for number, person in enumerate(people):
            others = [index for index in range(len(cameras)) if index != number]
            world = triangulate([cameras[index] for index in others], xy[others], score[others])
            cases.append(FilmedCase(number, person, along_sight(cameras[number], world)))
            units.append(mean_limb(world))
    unit = float(np.median(units))
    return [case._replace(truth=case.truth / unit) for case in cases]


def mean_limb(joints: np.ndarray) -> float:
    """The mean limb bone of a pose `(15, 3)`, in its unit."""
    limbs = [bone for bone in BONES if bone.end in LIMB_JOINTS]
    return float(np.mean([np.linalg.norm(joints[bone.end] - joints[bone.start]) for bone in limbs]))


def along_sight(camera: Pinhole, world: np.ndarray) -> np.ndarray:
    """Joints `(15, 3)` of the world in axes whose z is the camera's line of sight to the hips'
    midpoint, the origin."""
    view = (world - camera.centre) @ camera.rotation.T
    middle = view[HIPS].mean(axis=0)
    sight = middle / np.linalg.norm(middle)
    # The smallest turn that brings the line of sight onto z.
    axis = np.cross(sight, [0.0, 0.0, 1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1 + sight[2])
    return (view - middle) @ turn.T
