"""BVH: a skeleton that stands in a T-pose facing +z, and the rotations and positions that make each
pose of it.

Every draw has bones of its own lengths, and the mirror twin a torso of its own. A joint whose
offset is not the same in all poses therefore has position channels too, which replace its OFFSET;
where all poses share their lengths, only the root has them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.reports.exports.clip import UNITS, Clip

ORDER = "ZXY"
"""Of the rotations, intrinsic: Zrotation Xrotation Yrotation means Rz · Rx · Ry."""
EQUAL = 1e-6
"""Metres; offsets that differ by less are one offset."""
_UP, _LEFT, _RIGHT, _DOWN = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)


class _FileJoint(NamedTuple):
    """A joint of the file: its name and parent there, which of ours it is, and the child towards
    which it turns from a direction of the T-pose (none: it is turned as its parent)."""

    name: str
    parent: str | None
    ours: str
    aims_at: str | None = None
    rest: tuple[float, float, float] = _UP


def _limb(side: str, rest: tuple[float, float, float]) -> list[_FileJoint]:
    word = side.lower()
    return [
        _FileJoint(f"{side}Arm", "Neck", f"{word}_shoulder", f"{word}_elbow", rest),
        _FileJoint(f"{side}ForeArm", f"{side}Arm", f"{word}_elbow", f"{word}_wrist", rest),
        _FileJoint(f"{side}Hand", f"{side}ForeArm", f"{word}_wrist"),
    ]


def _leg(side: str) -> list[_FileJoint]:
    word = side.lower()
    return [
        _FileJoint(f"{side}UpLeg", "Hips", f"{word}_hip", f"{word}_knee", _DOWN),
        _FileJoint(f"{side}Leg", f"{side}UpLeg", f"{word}_knee", f"{word}_ankle", _DOWN),
        _FileJoint(f"{side}Foot", f"{side}Leg", f"{word}_ankle"),
    ]


JOINTS_OF_FILE = (
    _FileJoint("Hips", None, "pelvis"),
    _FileJoint("Neck", "Hips", "thorax"),
    # The head turns about the thorax by itself: arms hang from the same point.
    _FileJoint("Head", "Neck", "thorax", "head"),
    _FileJoint("HeadTop", "Head", "head"),
    *_limb("Left", _LEFT),
    *_limb("Right", _RIGHT),
    *_leg("Left"),
    *_leg("Right"),
)
"""Parents first, each joint followed by all that hang from it."""


class _Channels(NamedTuple):
    """A joint's `offset` `(3,)`, its positions `(n, 3)` where its offset varies, and its Euler
    angles `(n, 3)` in degrees."""

    offset: np.ndarray
    positions: np.ndarray | None
    angles: np.ndarray


def write_bvh(clip: Clip, path: Path, unit: str) -> None:
    """A skeleton with an End Site at head, hands and feet, and a frame for every pose; frames
    without a pose repeat the one before."""
    clip = clip.regular()
    channels = _channels(clip.held().joints, UNITS[unit])
    lines = ["HIERARCHY", *_hierarchy(channels), "MOTION"]
    lines += [f"Frames: {len(clip.joints)}", f"Frame Time: {1 / clip.pace:.8f}"]
    columns = [
        block
        for one in channels.values()
        for block in (one.positions, one.angles)
        if block is not None
    ]
    for row in np.concatenate(columns, axis=1):
        lines.append(" ".join(f"{number:.6f}" for number in row))
    with replacing(path, "choose another --out") as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _channels(joints: np.ndarray, scale: float) -> dict[str, _Channels]:
    """What every joint needs so that forward kinematics gives the poses `(n, 15, 3)`."""
    axes: dict[str, Rotation] = {}
    found: dict[str, _Channels] = {}
    for joint in JOINTS_OF_FILE:
        place = joints[:, JOINT_INDEX[joint.ours]]
        if joint.parent is None:
            axes[joint.name] = _torso(joints)
            found[joint.name] = _Channels(np.zeros(3), scale * place, _euler(axes[joint.name]))
            continue
        above = axes[joint.parent]
        start = joints[:, JOINT_INDEX[_BY_NAME[joint.parent].ours]]
        local = above.inv().apply(place - start)
        turn = _aim(joint, joints, above)
        axes[joint.name] = above * turn
        varies = np.ptp(local, axis=0).max() > EQUAL
        found[joint.name] = _Channels(
            scale * local.mean(axis=0), scale * local if varies else None, _euler(turn)
        )
    return found


def _torso(joints: np.ndarray) -> Rotation:
    """The axes of the torso: up along the back, left along the hips."""
    up = joints[:, JOINT_INDEX["thorax"]] - joints[:, JOINT_INDEX["pelvis"]]
    left = joints[:, JOINT_INDEX["left_hip"]] - joints[:, JOINT_INDEX["right_hip"]]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    left = left - np.sum(left * up, axis=1, keepdims=True) * up
    left = left / np.linalg.norm(left, axis=1, keepdims=True)
    return Rotation.from_matrix(np.stack([left, up, np.cross(left, up)], axis=-1))


def _aim(joint: _FileJoint, joints: np.ndarray, above: Rotation) -> Rotation:
    """The shortest turn, in the parent's axes, from the T-pose to where the bone points."""
    if joint.aims_at is None:
        return Rotation.identity(len(joints))
    bone = joints[:, JOINT_INDEX[joint.aims_at]] - joints[:, JOINT_INDEX[joint.ours]]
    to = above.inv().apply(bone / np.linalg.norm(bone, axis=1, keepdims=True))
    rest = np.array(joint.rest)
    across = np.cross(rest, to)
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    # Straight back, any axis across will do; this one stands across every direction of the T-pose.
    across = np.where(sine > 1e-12, across / np.maximum(sine, 1e-12), [0.0, 0.0, 1.0])
    return Rotation.from_rotvec(np.arctan2(sine, (to @ rest)[:, None]) * across)


def _euler(turn: Rotation) -> np.ndarray:
    """Angles `(n, 3)` in degrees; where two axes coincide, one of them is chosen to be zero."""
    return turn.as_euler(ORDER, degrees=True, suppress_warnings=True)


_BY_NAME = {joint.name: joint for joint in JOINTS_OF_FILE}


def _hierarchy(channels: dict[str, _Channels]) -> list[str]:
    lines: list[str] = []
    open_joints: list[str] = []
    for joint in JOINTS_OF_FILE:
        while open_joints and open_joints[-1] != joint.parent:
            open_joints.pop()
            lines.append("  " * len(open_joints) + "}")
        lines += _opened(joint, channels[joint.name], "  " * len(open_joints))
        open_joints.append(joint.name)
    while open_joints:
        open_joints.pop()
        lines.append("  " * len(open_joints) + "}")
    return lines


def _opened(joint: _FileJoint, channels: _Channels, indent: str) -> list[str]:
    """A joint's lines up to what hangs from it."""
    names = [f"{axis}rotation" for axis in ORDER]
    if channels.positions is not None:
        names = ["Xposition", "Yposition", "Zposition", *names]
    lines = [
        f"{'JOINT' if joint.parent else 'ROOT'} {joint.name}",
        "{",
        "  OFFSET " + " ".join(f"{number:.6f}" for number in channels.offset),
        f"  CHANNELS {len(names)} {' '.join(names)}",
    ]
    if all(other.parent != joint.name for other in JOINTS_OF_FILE):
        lines += ["  End Site", "  {", "    OFFSET 0.000000 0.000000 0.000000", "  }"]
    return [indent + line for line in lines]
