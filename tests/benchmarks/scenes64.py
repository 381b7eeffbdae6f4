"""The fixed frames of the benchmark: 64 prior poses by their seeds, and 64 of motion capture where
that is at hand.

Every second frame has all limb joints, the others miss one or two; the head is seen in every second
pair."""

from pathlib import Path

import numpy as np

from probmodel.model import PoseModel
from probmodel.motion import read_motion
from probmodel.posterior import Estimate
from tests.scenes import motion_scene, prior_scene

NUMBER = 64
_MISSING = (
    (),
    (),
    ("right_wrist",),
    ("left_ankle",),
    (),
    (),
    ("left_elbow", "left_wrist"),
    ("right_knee", "left_wrist"),
)


def hidden(index: int) -> tuple[str, ...]:
    """The joints that are not seen in frame `index`."""
    return (*_MISSING[index % 8], *(("head",) if index % 4 < 2 else ()))


def prior_frames(model: PoseModel) -> list[Estimate]:
    """Poses of the prior, seeds 0 to 63, each from its own side."""
    return [prior_scene(model, seed, missing=hidden(seed)) for seed in range(NUMBER)]


def motion_frames(path: Path) -> list[Estimate]:
    """Poses of motion capture at even distances in the archive, yaw and tilt by the frame's
    number."""
    joints = np.concatenate([motion.joints for motion in read_motion(path)])
    rows = np.linspace(0, len(joints) - 1, NUMBER).astype(int)
    return [
        motion_scene(
            joints[row],
            360 * index * 0.618 % 360,
            (-20, 0, 20)[index % 3],
            index,
            missing=hidden(index),
        )
        for index, row in enumerate(rows)
    ]
