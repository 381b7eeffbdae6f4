"""Names of joints of motion capture: every program's rig, prefixes, the user's own names, units,
and poses without depth."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from poseterior.probmodel import BadInput
from poseterior.probmodel.datasets import read_data_set
from poseterior.probmodel.learning.poses import read_all
from poseterior.probmodel.motion import CMU_UNIT, read_motion
from poseterior.probmodel.motion.rigs import joints_of_rig
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from poseterior.reports.commands.check import read_poses
from tests.conftest import Cli
from tests.probmodel.test_markers import NAMES, POSE, trc, write_c3d

BODY: dict[str, tuple[str | None, tuple[float, float, float]]] = {
    "pelvis": (None, (0, 90, 0)),
    "spine": ("pelvis", (0, 20, -1)),
    "thorax": ("spine", (0, 30, 2)),
    "skull": ("thorax", (0, 8, 1)),
    "head": ("skull", (0, 20, 2)),
    **{
        f"{side}_{part}": (f"{side}_{parent}" if parent not in ("spine", "pelvis") else parent, at)
        for side, sign in (("right", -1), ("left", 1))
        for part, parent, at in (
            ("collar", "spine", (3 * sign, 25, 3)),
            ("shoulder", "collar", (15 * sign, 2, -2)),
            ("elbow", "shoulder", (28 * sign, 0, -1)),
            ("wrist", "elbow", (25 * sign, 0, 3)),
            ("hip", "pelvis", (9 * sign, -3, 1)),
            ("knee", "hip", (sign, -40, 1)),
            ("ankle", "knee", (0, -41, -4)),
            ("toe", "ankle", (0, -6, 12)),
        )
    },
}
"""A body's joints, the joints of which they hang, and where from there, in centimetres."""
PARTS = ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")


def place(joint: str | None) -> np.ndarray:
    """`(3,)`: where a joint is in the pose of rest."""
    if joint is None:
        return np.zeros(3)
    parent, offset = BODY[joint]
    return place(parent) + np.array(offset)


REST = np.array([place(joint) for joint in JOINTS])


def rig(
    centres: str, limbs: str, side: str = "{side}{part}", sides: tuple[str, str] = ("Right", "Left")
) -> dict[str, str]:
    """What a rig calls the body's joints: pelvis, spine, thorax, skull and perhaps the head, then
    `PARTS` on either side."""
    names = dict(zip(("pelvis", "spine", "thorax", "skull", "head"), centres.split(), strict=False))
    for ours, said in zip(("right", "left"), sides, strict=True):
        for part, theirs in zip(PARTS, limbs.split(), strict=True):
            names[f"{ours}_{part}"] = side.format(side=said, part=theirs)
    return names


LETTERS, SMALL = ("R", "L"), ("r", "l")
CMU = rig("Hips Spine Neck Head", "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase")
RIGS = {
    "CMU": CMU,
    "CMU's other conversion": rig(
        "Hips ToSpine lowerneck Head", "Collar Shoulder Elbow Wrist Hip Knee Ankle Toe"
    ),
    "poseterior": rig(
        "Hips Spine Neck Head HeadTop", "Shoulder Arm ForeArm Hand UpLeg Leg Foot Toe"
    ),
    "Mixamo": {ours: f"mixamorig:{name}" for ours, name in {**CMU, "head": "HeadTop_End"}.items()},
    "Mixamo, twice": {ours: f"mixamorig1:{name}" for ours, name in CMU.items()},
    "Mixamo, from Blender": {ours: f"mixamorig_{name}" for ours, name in CMU.items()},
    "a subject's": {ours: f"Ann_{name}" for ours, name in CMU.items()},
    "Rokoko": rig("Hips Spine Neck Head", "Shoulder Arm ForeArm Hand Thigh Shin Foot Toe"),
    "Xsens": rig("Hips Chest Neck Head", "Collar Shoulder Elbow Wrist Hip Knee Ankle Toe"),
    "Xsens, segments": rig(
        "Pelvis L5 Neck Head", "Shoulder UpperArm ForeArm Hand UpperLeg LowerLeg Foot Toe"
    ),
    "OptiTrack": rig(
        "Hip Ab Neck Head", "Shoulder UArm FArm Hand Thigh Shin Foot Toe", sides=LETTERS
    ),
    "Bandai-Namco": rig(
        "Hips Spine Neck Head",
        "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes",
        "{part}_{side}",
        LETTERS,
    ),
    "Unity": rig(
        "Hips Spine Neck Head", "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot Toes"
    ),
    "Rigify": rig(
        "spine spine.001 spine.004 spine.006",
        "shoulder upper_arm forearm hand thigh shin foot toe",
        "{part}.{side}",
        LETTERS,
    ),
    "Rigify, deforming": rig(
        "DEF-spine DEF-spine.001 DEF-spine.004 DEF-spine.006",
        "shoulder upper_arm forearm hand thigh shin foot toe",
        "DEF-{part}.{side}",
        LETTERS,
    ),
    "Unreal": rig(
        "pelvis spine_01 neck_01 head",
        "clavicle upperarm lowerarm hand thigh calf foot ball",
        "{part}_{side}",
        SMALL,
    ),
    "Biped": {
        ours: f"Bip001 {name}"
        for ours, name in rig(
            "Pelvis Spine Neck Head",
            "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0",
            "{side} {part}",
            LETTERS,
        ).items()
    },
    "SMPL": rig(
        "Pelvis Spine1 Neck Head",
        "Collar Shoulder Elbow Wrist Hip Knee Ankle Foot",
        "{side}_{part}",
        LETTERS,
    ),
    "VRM": {
        ours: f"J_Bip_{name}"
        for ours, name in rig(
            "C_Hips C_Spine C_Neck C_Head",
            "Shoulder UpperArm LowerArm Hand UpperLeg LowerLeg Foot ToeBase",
            "{side}_{part}",
            LETTERS,
        ).items()
    },
    "Character Creator": rig(
        "CC_Base_Hip CC_Base_Spine01 CC_Base_NeckTwist01 CC_Base_Head",
        "Clavicle Upperarm Forearm Hand Thigh Calf Foot ToeBase",
        "CC_Base_{side}_{part}",
        LETTERS,
    ),
    "DeepMotion": rig(
        "hips_JNT spine_JNT neck_JNT head_JNT",
        "shoulder arm forearm hand upleg leg foot toebase",
        "{side}_{part}_JNT",
        SMALL,
    ),
    "Advanced Skeleton": rig(
        "Root_M Spine1_M Neck_M Head_M HeadEnd_M",
        "Scapula Shoulder Elbow Wrist Hip Knee Ankle Toes",
        "{part}_{side}",
        LETTERS,
    ),
    "Auto-Rig Pro": rig(
        "root.x spine_01.x neck.x head.x",
        "shoulder arm_stretch forearm_stretch hand thigh_stretch leg_stretch foot toes_01",
        "{part}.{side}",
        SMALL,
    ),
    "Valve": rig(
        "ValveBiped.Bip01_Pelvis ValveBiped.Bip01_Spine ValveBiped.Bip01_Neck1"
        " ValveBiped.Bip01_Head1",
        "Clavicle UpperArm Forearm Hand Thigh Calf Foot Toe0",
        "ValveBiped.Bip01_{side}_{part}",
        LETTERS,
    ),
    "Daz": rig(
        "hip abdomenLower neckLower head",
        "Collar ShldrBend ForearmBend Hand ThighBend Shin Foot Toe",
        sides=SMALL,
    ),
    "Kinect": rig(
        "SpineBase SpineMid SpineShoulder Head",
        "Clavicle Shoulder Elbow Wrist Hip Knee Ankle Foot",
        "{part}{side}",
    ),
    "SOMA": rig(
        "Hips Spine1 Neck1 Head HeadEnd", "Shoulder Arm ForeArm Hand Leg Shin Foot ToeBase"
    ),
    "numbered by Blender": {ours: f"{name}.001" for ours, name in CMU.items()},
    "Poser": rig(
        "hip abdomen neck head", "Collar Shldr ForeArm Hand Thigh Shin Foot Toe", sides=SMALL
    ),
}
"""By program, what its rig calls the body's joints; the head is the skull's End Site, if not
named."""


def bvh(names: dict[str, str], scale: float = 1.0) -> str:
    """The body at rest and bent, below a root of another name, as Bandai-Namco has it."""

    def joint(ours: str, offset: np.ndarray) -> list[str]:
        below = [child for child, (parent, _) in BODY.items() if parent == ours]
        named = [child for child in below if child in names]
        ends = [child for child in below if child not in names] or ([] if below else [ours])
        channels = "CHANNELS 3 Zrotation Xrotation Yrotation"
        inner = [line for child in named for line in joint(child, scale * np.array(BODY[child][1]))]
        for end in ends if not named else []:
            x, y, z = scale * np.array(BODY[end][1]) if end != ours else (0, 1, 0)
            inner += ["End Site", "{", f"OFFSET {x} {y} {z}", "}"]
        x, y, z = offset
        return [f"JOINT {names[ours]}", "{", f"OFFSET {x} {y} {z}", channels, *inner, "}"]

    root = ["ROOT joint_Root", "{", "OFFSET 0 0 0", "CHANNELS 3 Xposition Yposition Zposition"]
    lines = ["HIERARCHY", *root, *joint("pelvis", scale * place("pelvis")), "}", "MOTION"]
    lines += ["Frames: 2", "Frame Time: 0.01"]
    for angle in (0, 1):
        lines += [" ".join(["0 0 0", *[f"{angle} 0 0"] * len(names)])]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("program", RIGS)
def test_the_rig_of_every_program(tmp_path: Path, program: str) -> None:
    """All fifteen joints are where the body has them, in its pose of rest; names of collars and
    toes do not come in between."""
    (tmp_path / "a.bvh").write_text(bvh(RIGS[program]))
    (motion,) = read_motion(tmp_path / "a.bvh")
    np.testing.assert_allclose(motion.joints[0], 10 * REST, atol=1e-6)
    assert not np.allclose(motion.joints[1], motion.joints[0])


@pytest.mark.parametrize("scale", [1 / 100, 1.0, 10.0, 10 / CMU_UNIT, 0.006, 0.6, 6.0])
def test_units_of_bvh_are_told_by_the_legs(tmp_path: Path, scale: float) -> None:
    """Metres, centimetres, millimetres and CMU's unit; of a child 110 cm tall as well."""
    (tmp_path / "a.bvh").write_text(bvh(CMU, scale))
    (motion,) = read_motion(tmp_path / "a.bvh")
    child = 0.6 if scale in (0.006, 0.6, 6.0) else 1.0
    np.testing.assert_allclose(motion.joints[0], child * 10 * REST, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("change", [("HIERARCHY", "\ufeffHIERARCHY"), ("End Site", "End site")])
def test_what_writers_of_bvh_do_otherwise(tmp_path: Path, change: tuple[str, str]) -> None:
    (tmp_path / "a.bvh").write_text(bvh(CMU).replace(*change), encoding="utf-8")
    (motion,) = read_motion(tmp_path / "a.bvh")
    np.testing.assert_allclose(motion.joints[0], 10 * REST, atol=1e-6)


OWN = {
    ours: f"bone{number}" for number, ours in enumerate(CMU)
}  # no program's, without a head: that is the skull's End Site
MAP = {theirs: ours for ours, theirs in OWN.items() if ours in JOINTS}
MAP |= {f"{OWN['skull']} end": "head"}


def test_names_of_the_users_own(tmp_path: Path) -> None:
    path = tmp_path / "a.bvh"
    path.write_text(bvh(OWN))
    with pytest.raises(BadInput, match=r"no joint that is known as pelvis, thorax, .* --names"):
        read_motion(path)
    (motion,) = read_motion(path, names=MAP)
    np.testing.assert_allclose(motion.joints[0], 10 * REST, atol=1e-6)
    assert len(read_all([path], names=MAP)) == len(read_motion(tmp_path, names=MAP)) == 1
    assert len(read_poses(path, MAP).names) == 2
    assert len(read_data_set(path, names=MAP)) == 1
    with pytest.raises(BadInput, match="'toe' is no joint; a map of names leads to pelvis"):
        read_motion(path, names=MAP | {"bone3": "toe"})
    with pytest.raises(BadInput, match=r"none of the names that were given \(\['a'\]\)"):
        read_motion(path, names={"a": "head"})


def test_names_of_the_users_come_before_those_that_are_known() -> None:
    names = ["Hips", *(name for name in CMU.values() if name != "Hips"), "Spine2", "Head end"]
    known = joints_of_rig(names, Path("a.bvh"))
    given = joints_of_rig(names, Path("a.bvh"), {"Spine2": "thorax"})
    assert names[known[JOINT_INDEX["thorax"]]] == "Neck"
    assert names[given[JOINT_INDEX["thorax"]]] == "Spine2"
    assert [one for one in given if names[one] != "Spine2"] == [
        one for one in known if names[one] != "Neck"
    ]


def test_names_of_markers(tmp_path: Path) -> None:
    odd = {joint: f"m{number}" for number, joint in enumerate(NAMES)}
    given = {theirs: ours for ours, theirs in odd.items()}
    (tmp_path / "a.trc").write_text(trc(odd))
    for path in (tmp_path / "a.trc", write_c3d(tmp_path / "a.c3d", odd)):
        with pytest.raises(BadInput, match=r"has no marker at .* --names"):
            read_motion(path)
        (motion,) = read_motion(path, names=given)
        np.testing.assert_allclose(motion.joints[0], POSE, atol=1e-3)


def test_names_mean_nothing_where_joints_have_an_order(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", walk=np.tile(POSE, (2, 1, 1)))
    with pytest.raises(BadInput, match="has joints in an order, which names do not change"):
        read_motion(tmp_path / "a.npz", names=MAP)
    np.save(tmp_path / "a.npy", POSE)
    with pytest.raises(BadInput, match="is no motion capture, whose joints have names"):
        read_poses(tmp_path / "a.npy", MAP)


def test_commands_take_names(tmp_path: Path, poseterior: Cli) -> None:
    (tmp_path / "a.bvh").write_text(bvh(OWN))
    (tmp_path / "names.json").write_text(json.dumps(MAP))
    path, names = str(tmp_path / "a.bvh"), str(tmp_path / "names.json")
    refused = poseterior("check", path)
    assert (refused.code, "--names" in refused.err) == (2, True)
    assert "of 2 poses in" in poseterior("check", path, "--names", names).out
    for command in ("check", "learn", "evaluate"):
        (tmp_path / "names.json").write_text(json.dumps([*MAP]))
        refused = poseterior(command, path, "--names", names)
        assert (refused.code, "not a list" in refused.err) == (2, True)


def test_trc_with_commas(tmp_path: Path) -> None:
    """As pyomeca writes it."""
    (tmp_path / "a.trc").write_text(trc().replace("\t", ","))
    (motion,) = read_motion(tmp_path / "a.trc")
    np.testing.assert_allclose(motion.joints[0], POSE, atol=1e-3)


# Without depth.


def flattened(axis: int) -> np.ndarray:
    poses = np.tile(POSE, (3, 1, 1)) + np.arange(3.0)[:, None, None]
    poses[..., axis] = 0.0
    return poses


@pytest.mark.parametrize("axis", [0, 2])
def test_poses_in_a_plane_are_no_poses_in_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, axis: int
) -> None:
    """TRC, C3D, recordings and arrays in .npz and .npy, and a plain data set."""
    flat = POSE.copy()
    flat[:, axis] = 0.0
    monkeypatch.setattr("tests.probmodel.test_markers.POSE", flat)
    monkeypatch.setattr("tests.probmodel.test_markers.moved", lambda frame: np.zeros(3))
    (tmp_path / "a.trc").write_text(trc())
    write_c3d(tmp_path / "a.c3d")
    np.savez(tmp_path / "a.npz", walk=flattened(axis))
    for name in ("a.trc", "a.c3d", "a.npz"):
        for read in (read_motion, read_data_set, read_poses):
            with pytest.raises(BadInput, match="lie in one plane"):
                read(tmp_path / name)
    np.save(tmp_path / "a.npy", flattened(axis))
    with pytest.raises(BadInput, match="lie in one plane"):
        read_poses(tmp_path / "a.npy")
    np.savez(
        tmp_path / "b.npz",
        poses=flattened(axis),
        keypoints=flattened(axis)[..., :2],
        action=np.array(["walk"] * 3),
        subject=np.array(["ann"] * 3),
    )
    for read in (read_data_set, read_poses):
        with pytest.raises(BadInput, match="lie in one plane"):
            read(tmp_path / "b.npz")


def test_infinite_joints_are_no_plane_and_no_warning(tmp_path: Path) -> None:
    """Infinity minus infinity would be a warning of NumPy's, in front of the sentence."""
    poses = np.tile(POSE, (3, 1, 1)) + np.arange(3.0)[:, None, None]
    poses[1, :, 0] = np.inf
    np.save(tmp_path / "a.npy", poses)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read_poses(tmp_path / "a.npy").joints) == 3


# The files that users brought.


@pytest.mark.parametrize("name", ["mixamo_names.bvh", "cmu_cm.bvh"])
def test_rigs_that_users_brought(shared_data: Path, name: str) -> None:
    """The same walk, to the rounding of the centimetres."""
    (walk,) = read_motion(shared_data / "cases" / "cmu_300.bvh")
    (motion,) = read_motion(shared_data / "cases" / name)
    np.testing.assert_allclose(motion.joints, walk.joints, atol=0.5)


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("sports2d_m_person00.trc", "all joints lie in one plane"),
        ("sports2d_px_person00.trc", "in pixels of an image, not in space; give it to show"),
    ],
)
def test_trc_of_one_camera(shared_data: Path, name: str, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        read_motion(shared_data / "cases" / name)
