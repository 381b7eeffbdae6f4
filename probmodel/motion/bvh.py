"""BVH: hierarchy and channels in one file. The CMU conversions lack the ASF's thorax bone, which is
put back (`_with_thorax`). Which joints are ours: `rigs`."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.motion.recording import (
    CMU_UNIT,
    MOST_JOINTS,
    NUMBER,
    Motion,
    Rig,
    floats,
    forward,
    positions,
    read_text,
    require_frames,
)
from poseterior.probmodel.motion.rigs import END, SIDES, joints_of_rig
from poseterior.probmodel.skeleton import JOINT_INDEX


class _BvhJoint(NamedTuple):
    name: str
    parent: int
    offset: np.ndarray
    channels: list[str]


UNITS = (CMU_UNIT, 1.0, 10.0, 1000.0)
"""Millimetres in the CMU conversions' unit, and in millimetres, centimetres and metres."""
LEG, LEG_PARTS = 800.0, ("hip", "knee", "ankle")
"""Millimetres from a grown person's hip by the knee to the ankle; units are five times apart or
more, so that children's legs do as well."""
SHORTEST_FRAME, LONGEST_FRAME = 1e-5, 100.0
"""Seconds from one frame to the next."""
CMU_THORAX = 1.0085 * np.array([0.014, 0.999, 0.027])
"""The thorax bone in upper backs, in the axes of the joint that turns it: the mean of 17 skeletons
of the CMU originals (0.997 to 1.041 upper backs, each within some 6° of the direction)."""
_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")


def read_bvh(path: Path, names: Mapping[str, str] | None = None) -> list[Motion]:
    """The recording of a .bvh file, whose joints the user may name (theirs → ours). Raises
    `BadInput` where it is damaged or lacks a joint."""
    text = read_text(path)
    hierarchy, found, motion = text.partition("MOTION")
    if not found or not hierarchy.lstrip().startswith("HIERARCHY"):
        raise BadInput(
            f"{path} is not a BVH file, or is truncated: it needs a HIERARCHY and a MOTION section"
        )
    joints = _parse_bvh_hierarchy(hierarchy, path)
    rig_names = [joint.name for joint in joints]
    wanted = joints_of_rig(rig_names, path, names)
    rate, values = _parse_bvh_motion(motion, sum(len(joint.channels) for joint in joints), path)
    require_frames(len(values), len(joints), path)
    rotations: list[Rotation | None] = []
    position = np.zeros((len(values), 3))
    offsets = [joint.offset for joint in joints]
    column = 0
    for i, joint in enumerate(joints):
        block = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        spins = [k for k, channel in enumerate(joint.channels) if channel.endswith("rotation")]
        order = "".join(joint.channels[k][0] for k in spins)
        # Upper-case letters are intrinsic axes: Zrotation Yrotation Xrotation means Rz·Ry·Rx.
        rotations.append(
            Rotation.from_euler(order, block[:, spins], degrees=True) if spins else None
        )
        places = [k for k, channel in enumerate(joint.channels) if channel.endswith("position")]
        axes = ["XYZ".index(joint.channels[k][0]) for k in places]
        if i == 0:
            position[:, axes] = block[:, places]
        elif places:  # they stand in place of the offset
            offsets[i] = np.tile(joint.offset, (len(values), 1))
            offsets[i][:, axes] = block[:, places]
    offsets = _with_thorax(joints, offsets)
    # A BVH joint's rotation turns what hangs from it, not its own offset: as segments, offsets
    # belong to the parent.
    rig = Rig(rig_names, [joint.parent for joint in joints], np.zeros((len(joints), 3)))
    ends = _bvh_forward(rig, offsets, wanted, position, rotations)
    return [Motion(positions(ends * _unit(ends), path), rate, path.stem, path.stem)]


def _with_thorax(joints: list[_BvhJoint], offsets: list[np.ndarray]) -> list[np.ndarray]:
    """Offsets with the thorax bone that conversions of the CMU files leave out.

    They are known by their build, since tools rename joints: three joints in the root's place (two
    hips and the lower back), lower and upper back, and three in the upper back's end (neck and
    collars), which is some 117 mm too low for these."""
    for lowest in _together(joints, offsets, 0):
        spine = [lowest]
        while len(below := _children(joints, spine[-1])) == 1:
            spine += below
        above = _together(joints, offsets, spine[-1])
        if len(spine) == 3 and above:
            thorax = CMU_THORAX * np.linalg.norm(joints[spine[-1]].offset)
            return [offset + thorax * (i in above) for i, offset in enumerate(offsets)]
    return offsets


def _together(joints: list[_BvhJoint], offsets: list[np.ndarray], parent: int) -> list[int]:
    """The three joints that stand where their parent does, if its children are three such."""
    children = _children(joints, parent)
    return children if len(children) == 3 and not any(offsets[i].any() for i in children) else []


def _children(joints: list[_BvhJoint], parent: int) -> list[int]:
    return [i for i, joint in enumerate(joints) if joint.parent == parent]


def _unit(joints: np.ndarray) -> float:
    """Millimetres in one unit of the file, which does not say it: the one of `UNITS` by which legs
    come nearest to `LEG`."""
    chain = [[JOINT_INDEX[f"{side}_{part}"] for part in LEG_PARTS] for side in SIDES]
    bones = np.linalg.norm(np.diff(joints[:, chain], axis=2), axis=-1).sum(axis=-1)
    leg = float(np.median(bones))
    return min(UNITS, key=lambda unit: abs(np.log(unit * leg / LEG))) if leg > 0 else CMU_UNIT


def _bvh_forward(
    rig: Rig,
    offsets: list[np.ndarray],
    wanted: list[int],
    root: np.ndarray,
    rotations: list[Rotation | None],
) -> np.ndarray:
    """As `forward`, with every joint split in two segments: its offset `(3,)` or `(T, 3)` in the
    parent's axes, then its rotation."""
    parents: list[int] = []
    shifts: list[np.ndarray] = []
    turns: list[Rotation | None] = []
    for parent, offset, turn in zip(rig.parents, offsets, rotations, strict=True):
        parents += [2 * parent + 1 if parent >= 0 else -1, len(parents)]
        shifts += [offset if parent >= 0 else np.zeros(3), np.zeros(3)]
        turns += [None, turn]
    split = Rig([name for name in rig.names for _ in range(2)], parents, shifts)
    return forward(split, [2 * segment for segment in wanted], root, turns)


def _parse_bvh_hierarchy(text: str, path: Path) -> list[_BvhJoint]:
    joints: list[_BvhJoint] = []
    stack: list[int] = []
    pending: str | None = None
    for number, line in enumerate(text.splitlines(), 1):
        match line.split():
            case [] | ["HIERARCHY"]:
                continue
            case ["ROOT" | "JOINT", *words] if words:
                pending = " ".join(words)
            case ["End", "Site" | "site"] if stack:
                pending = joints[stack[-1]].name + END
            case ["{"] if pending is not None:
                if len(joints) == MOST_JOINTS:
                    raise BadInput(
                        f"{path} has more than {MOST_JOINTS} joints; check what wrote it"
                    )
                joints.append(_BvhJoint(pending, stack[-1] if stack else -1, np.zeros(3), []))
                stack.append(len(joints) - 1)
                pending = None
            case ["}"] if stack:
                stack.pop()
            case ["OFFSET", *numbers] if (
                stack and len(numbers) == 3 and (offset := _offset(numbers)) is not None
            ):
                joints[stack[-1]].offset[:] = offset
            case ["CHANNELS", count, *channels] if (
                stack
                and count == str(len(channels))
                and _are_channels([*joints[stack[-1]].channels, *channels])
            ):
                joints[stack[-1]].channels.extend(channels)
            case _:
                raise BadInput(
                    f"{path}, line {number}: {shown(line.strip())} cannot be read as part of a BVH"
                    " hierarchy"
                )
    if stack or not joints:
        raise BadInput(f"{path}: the hierarchy is not closed, so the file is truncated or damaged")
    if not any(joint.channels for joint in joints):
        raise BadInput(f"{path}: no joint has CHANNELS; export it with its motion")
    return joints


def _offset(numbers: list[str]) -> np.ndarray | None:
    """Three numbers that can be a place, or None."""
    offset = floats(" ".join(numbers))
    possible = offset is not None and (np.abs(offset) <= LARGEST_NUMBER).all()
    return offset if possible else None


def _are_channels(channels: list[str]) -> bool:
    """Whether a joint can have them: each of the six at most once."""
    return set(channels) <= set(_CHANNELS) and len(channels) == len(set(channels))


def _parse_bvh_motion(text: str, num_channels: int, path: Path) -> tuple[float, np.ndarray]:
    """Frame rate and channel values `(T, num_channels)`."""
    header = re.match(rf"\s*Frames:\s*(\d{{1,9}})\s+Frame Time:\s*({NUMBER})\s", text)
    if header is None or not SHORTEST_FRAME <= float(header[2]) <= LONGEST_FRAME:
        raise BadInput(
            f"{path}: MOTION does not start with 'Frames: <count>' and 'Frame Time: <seconds>',"
            f" from {SHORTEST_FRAME:g} to {LONGEST_FRAME:g} seconds"
        )
    count, rate = int(header[1]), 1 / float(header[2])
    values = floats(text[header.end() :])
    if values is None or not (np.abs(values) <= LARGEST_NUMBER).all():
        raise BadInput(f"{path}: a channel of the MOTION section is not a finite number")
    if count == 0 or values.size != count * num_channels:
        raise BadInput(
            f"{path}: {count} frames of {num_channels} channels are announced, but {values.size}"
            " numbers follow; the file is truncated or damaged"
        )
    return round(rate, 2), values.reshape(count, num_channels)
