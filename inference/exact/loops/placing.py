"""Joints and keypoints of poses under roots that many of them share: forward kinematics
(`PoseModel.joints`) and the camera (`camera.image`) in one pass. Compiled; in body units
and pixels."""

from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.vectors import Vector, axes_of, into, lower_axes, out_of
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.skeleton import (
    LOWER_BONES,
    NUM_JOINTS,
    NUM_UPPER,
    TORSO_INDEX,
    UPPER_BONES,
)

_NUM_TORSO = len(TORSO_INDEX)
_UPPER_ENDS = tuple((bone.start, bone.end, bone.length_group) for bone in UPPER_BONES)
_LOWER_ENDS = tuple((bone.start, bone.end, bone.length_group) for bone in LOWER_BONES)
_HEADS = NUM_UPPER - len(LOWER_BONES)
"""Upper bones, the first ones, that no other bone hangs from."""


class SharedRoots(NamedTuple):
    """What roots `(r, ...)` and limits say of where poses are.

    Attributes
    ----------
    torso : `(r, 6, 3)` in camera axes
    axes : `(r, 5, 3, 3)` local axes of the upper bones, columns, in camera axes
    scale : `(r,)` pixels a body unit at the pelvis
    translation : `(r, 2)` where the pelvis falls
    nearness : `(r,)` one over the pelvis' distance; 0 in weak perspective
    aside : `(r, 2)` where the pelvis is seen, over its distance; 0 in weak perspective
    reference, fallback : `(3,)`, `(4, 3)` of the lower bones' axes
    """

    torso: np.ndarray
    axes: np.ndarray
    scale: np.ndarray
    translation: np.ndarray
    nearness: np.ndarray
    aside: np.ndarray
    reference: np.ndarray
    fallback: np.ndarray


@compiled
def place_rows(
    begin: int,
    end: int,
    root: np.ndarray,
    poses: Pose,
    roots: SharedRoots,
    joints: np.ndarray,
    keypoints: np.ndarray,
) -> None:
    """Places the poses from `begin` to `end`.

    Parameters
    ----------
    begin, end : rows of all that follows
    root : `(n,)` which of the roots each pose has
    poses : leaves start with n
    roots : of all poses
    joints, keypoints : `(n, 15, 3)`, `(n, 15, 2)` written on
    """
    a0, a1, a2 = roots.reference
    for n in range(begin, end):
        row = root[n]
        for joint in range(_NUM_TORSO):
            for axis in range(3):
                joints[n, TORSO_INDEX[joint], axis] = roots.torso[row, joint, axis]
        for bone in range(NUM_UPPER):
            axes = axes_of(roots.axes[row, bone])
            upper = poses.upper[n, bone, 0], poses.upper[n, bone, 1], poses.upper[n, bone, 2]
            _hang(n, _UPPER_ENDS[bone], poses.length, into(axes, upper), joints)
            below = bone - _HEADS
            if below >= 0:
                f0, f1, f2 = roots.fallback[below]
                v, w, _ = lower_axes(upper, (a0, a1, a2, f0, f1, f2))
                lower = poses.lower[n, below, 0], poses.lower[n, below, 1], poses.lower[n, below, 2]
                along = into(axes, out_of((upper, v, w), lower))
                _hang(n, _LOWER_ENDS[below], poses.length, along, joints)
        for joint in range(NUM_JOINTS):
            away = joints[n, joint, 2]
            depth = 1 + away * roots.nearness[row]
            scale = roots.scale[row] / (depth if depth > 0 else 1.0)
            for axis in range(2):
                beside = joints[n, joint, axis] - away * roots.aside[row, axis]
                keypoints[n, joint, axis] = scale * beside + roots.translation[row, axis]


@inlined
def _hang(
    n: int, bone: tuple[int, int, int], length: np.ndarray, along: Vector, joints: np.ndarray
) -> None:
    """Where a bone ends that points `along`, from child to parent."""
    start, end, group = bone
    for axis in range(3):
        joints[n, end, axis] = joints[n, start, axis] - length[n, group] * along[axis]
