"""The skeleton: fifteen joints, the bones between them, the groups of bones that share a length
(docs/model.md § 1).

Order and names are Akhter & Black's (CVPR 2015) without the feet. Everything that loops over limbs
reads it from here: `JOINTS`, `PARENTS`, `UPPER_BONES`, `LOWER_BONES`, `LENGTH_GROUPS`, `GROUPS`."""

from typing import NamedTuple

JOINTS = (
    "pelvis",
    "thorax",
    "right_shoulder",
    "right_elbow",
    "right_wrist",
    "left_shoulder",
    "left_elbow",
    "left_wrist",
    "head",
    "right_hip",
    "right_knee",
    "right_ankle",
    "left_hip",
    "left_knee",
    "left_ankle",
)
JOINT_INDEX = {name: i for i, name in enumerate(JOINTS)}
NUM_JOINTS = len(JOINTS)

PARENTS = (-1, 0, 1, 2, 3, 1, 5, 6, 1, 0, 9, 10, 0, 12, 13)
"""Index of each joint's parent; the pelvis has none."""

TORSO_JOINTS = ("pelvis", "thorax", "right_shoulder", "left_shoulder", "right_hip", "left_hip")
TORSO_INDEX = tuple(JOINT_INDEX[name] for name in TORSO_JOINTS)

LENGTH_GROUPS = ("head", "upper_arm", "forearm", "upper_leg", "lower_leg")
"""Left and right share one length. One body unit is the mean of the last four (the limbs)."""


class Bone(NamedTuple):
    """A bone whose direction and length are random: it ends in the joint `end` and starts in that
    joint's parent."""

    name: str
    start: int
    end: int
    length_group: int


def _bone(name: str, end: str, group: str) -> Bone:
    index = JOINT_INDEX[end]
    return Bone(name, PARENTS[index], index, LENGTH_GROUPS.index(group))


UPPER_BONES = (
    _bone("head", "head", "head"),
    _bone("right_upper_arm", "right_elbow", "upper_arm"),
    _bone("left_upper_arm", "left_elbow", "upper_arm"),
    _bone("right_upper_leg", "right_knee", "upper_leg"),
    _bone("left_upper_leg", "left_knee", "upper_leg"),
)
"""Bones that start at the torso; their directions are limited by tables of occupied cells."""

LOWER_BONES = (
    _bone("right_forearm", "right_wrist", "forearm"),
    _bone("left_forearm", "left_wrist", "forearm"),
    _bone("right_lower_leg", "right_ankle", "lower_leg"),
    _bone("left_lower_leg", "left_ankle", "lower_leg"),
)
"""Bones that hang from an upper bone; `LOWER_BONES[i]` continues `UPPER_BONES[i + 1]`."""

BONES = UPPER_BONES + LOWER_BONES
BONE_NAMES = tuple(bone.name for bone in BONES)
NUM_UPPER, NUM_LOWER, NUM_LENGTHS = len(UPPER_BONES), len(LOWER_BONES), len(LENGTH_GROUPS)

LIMB_JOINTS = tuple(bone.end for bone in BONES if bone.name != "head")
"""Elbows, knees, wrists, ankles: the joints that the paper's sets S_m and S_o speak of."""

MIRROR = tuple(
    JOINT_INDEX[name.replace("right", "LEFT").replace("left", "right").replace("LEFT", "left")]
    for name in JOINTS
)
"""`MIRROR[i]` is the joint that joint i becomes when left and right are exchanged."""


class Limb(NamedTuple):
    """A chain of bones that hangs from the torso: an upper bone and, but for the head, the lower
    bone that follows."""

    name: str
    upper: int
    lower: int | None

    @property
    def bones(self) -> tuple[Bone, ...]:
        """The limb's bones, from the torso outwards."""
        return (UPPER_BONES[self.upper],) + (
            () if self.lower is None else (LOWER_BONES[self.lower],)
        )


GROUPS = {
    "head": (Limb("head", 0, None),),
    "arms": (Limb("right arm", 1, 0), Limb("left arm", 2, 1)),
    "legs": (Limb("right leg", 3, 2), Limb("left leg", 4, 3)),
}
"""Limbs that share bone lengths. Given torso and camera, the groups are independent of each
other."""
