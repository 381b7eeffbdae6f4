"""Readers of motion capture: small files worked out by hand, captures stored in two formats,
damaged files."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from poseterior.probmodel.body import body_unit
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion import CMU_UNIT, Motion, read_motion, recording
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

ASF_BONES = {
    "lhipjoint": ("root", (1, 0, 0), 1.0),
    "lfemur": ("lhipjoint", (0, -1, 0), 4.0),
    "ltibia": ("lfemur", (0, -1, 0), 3.0),
    "rhipjoint": ("root", (-1, 0, 0), 1.0),
    "rfemur": ("rhipjoint", (0, -1, 0), 4.0),
    "rtibia": ("rfemur", (0, -1, 0), 3.0),
    "thorax": ("root", (0, 1, 0), 5.0),
    "head": ("thorax", (0, 1, 0), 2.0),
    "lclavicle": ("thorax", (1, 0, 0), 1.5),
    "lhumerus": ("lclavicle", (1, 0, 0), 3.0),
    "lradius": ("lhumerus", (1, 0, 0), 2.0),
    "rclavicle": ("thorax", (-1, 0, 0), 1.5),
    "rhumerus": ("rclavicle", (-1, 0, 0), 3.0),
    "rradius": ("rhumerus", (-1, 0, 0), 2.0),
}
"""A body in T-pose: parent, direction, length."""
ASF_DOFS = {"rfemur": "rx ry rz", "rtibia": "rx", "lhumerus": "rz"}
ASF_AXES = {"rtibia": "0 90 0"}
REST = {
    "pelvis": (0, 0, 0),
    "thorax": (0, 5, 0),
    "head": (0, 7, 0),
    "right_shoulder": (-1.5, 5, 0),
    "right_elbow": (-4.5, 5, 0),
    "right_wrist": (-6.5, 5, 0),
    "left_shoulder": (1.5, 5, 0),
    "left_elbow": (4.5, 5, 0),
    "left_wrist": (6.5, 5, 0),
    "right_hip": (-1, 0, 0),
    "right_knee": (-1, -4, 0),
    "right_ankle": (-1, -7, 0),
    "left_hip": (1, 0, 0),
    "left_knee": (1, -4, 0),
    "left_ankle": (1, -7, 0),
}


def asf_text() -> str:
    lines = ["# a comment", ":version 1.10", ":units", "  length 0.45", "  angle deg"]
    lines += [":root", "  order TX TY TZ RX RY RZ", "  axis XYZ", ":bonedata"]
    for name, (_, direction, length) in ASF_BONES.items():
        lines += [
            "  begin",
            "    id 1",
            f"    name {name}",
            "    direction " + " ".join(map(str, direction)),
            f"    length {length}",
            f"    axis {ASF_AXES.get(name, '0 0 0')} XYZ",
        ]
        lines += [f"    dof {ASF_DOFS[name]}", "    limits (-1.0 1.0)"] if name in ASF_DOFS else []
        lines += ["  end"]
    lines += [":hierarchy", "  begin"]
    for parent in dict.fromkeys(parent for parent, _, _ in ASF_BONES.values()):
        lines.append(
            "    "
            + " ".join([parent, *(name for name, bone in ASF_BONES.items() if bone[0] == parent)])
        )
    return "\r\n".join([*lines, "  end", ""])


def amc_text(frames: list[dict[str, str]]) -> str:
    lines = ["#!OML:ASF", ":FULLY-SPECIFIED", ":DEGREES"]
    for number, frame in enumerate(frames, 1):
        channels = {
            "root": "0 0 0 0 0 0",
            "rfemur": "0 0 0",
            "rtibia": "0",
            "lhumerus": "0",
        } | frame
        lines += [str(number), *(f"{name} {values}" for name, values in channels.items())]
    return "\r\n".join([*lines, ""])


def write_subject(folder: Path, frames: list[dict[str, str]]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "07.asf").write_text(asf_text(), newline="")
    (folder / "07_01.amc").write_text(amc_text(frames), newline="")
    return folder / "07_01.amc"


def assert_joints(found: np.ndarray, **moved: tuple[float, float, float]) -> None:
    expected = np.array([(REST | moved)[name] for name in JOINT_INDEX], float)
    np.testing.assert_allclose(found / CMU_UNIT, expected, atol=1e-9)


def test_amc_by_hand(tmp_path: Path) -> None:
    frames = [
        {},
        {"rfemur": "-90 0 0"},  # about x by −90°: down turns to backward
        {"rfemur": "90 0 90"},  # Rz·Rx of down (0, −1, 0): to (0, 0, −1), which z leaves alone
        {"rtibia": "90"},  # its axis, turned about y by 90°, makes x into −z
        {"lhumerus": "90", "root": "1 2 3.5e-000 0 0 0"},
        {"root": "0 0 0 90 0 90"},  # Rz·Rx: x → y, y → z, z → x
    ]
    (motion,) = read_motion(write_subject(tmp_path, frames))
    assert (motion.name, motion.subject, motion.frame_rate) == ("07_01", "07", 120.0)
    assert_joints(motion.joints[0])
    assert_joints(motion.joints[1], right_knee=(-1, 0, 4), right_ankle=(-1, 0, 7))
    assert_joints(motion.joints[2], right_knee=(-1, 0, -4), right_ankle=(-1, 0, -7))
    assert_joints(motion.joints[3], right_ankle=(-4, -4, 0))
    shift = np.array([1, 2, 3.5])
    bent = REST | {"left_elbow": (1.5, 8, 0), "left_wrist": (1.5, 10, 0)}
    assert_joints(
        motion.joints[4], **{name: tuple(np.array(place) + shift) for name, place in bent.items()}
    )
    assert_joints(motion.joints[5], **{name: (z, x, y) for name, (x, y, z) in REST.items()})


def bvh_text() -> str:
    """The same body; tokens that open a line in a BVH file open one here."""
    zyx = "CHANNELS 3 Zrotation Yrotation Xrotation"

    def chain(*parts: tuple[str, str]) -> str:
        if not parts:
            return "End Site { OFFSET 0 1 0 }"
        name, offset = parts[0]
        return f"JOINT {name} {{ OFFSET {offset} {zyx} {chain(*parts[1:])} }}"

    limbs = [
        chain(("LeftUpLeg", "1 0 0"), ("LeftLeg", "0 -4 0"), ("LeftFoot", "0 -3 0")),
        chain(("RightUpLeg", "-1 0 0"), ("RightLeg", "0 -4 0"), ("RightFoot", "0 -3 0")),
        "JOINT Spine { OFFSET 0 5 0 "
        + zyx
        + " "
        + chain(("Neck", "0 0 0"), ("Head", "0 1 0"))
        + chain(("LeftArm", "1.5 0 0"), ("LeftForeArm", "3 0 0"), ("LeftHand", "2 0 0"))
        + chain(("RightArm", "-1.5 0 0"), ("RightForeArm", "-3 0 0"), ("RightHand", "-2 0 0"))
        + " }",
    ]
    root = (
        "ROOT Hips { OFFSET 0 0 0 CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation"
        " Xrotation "
    )
    flat = "HIERARCHY " + root + " ".join(limbs) + " }"
    for token in ("ROOT", "JOINT", "End", "OFFSET", "CHANNELS", "{", "}"):
        flat = (
            flat.replace(f"{token} ", f"\n{token} ") if token != "}" else flat.replace("}", "\n}\n")
        )
    return flat.replace("{ ", "{\n")


BVH_ORDER = (
    "Hips",
    "LeftUpLeg",
    "LeftLeg",
    "LeftFoot",
    "RightUpLeg",
    "RightLeg",
    "RightFoot",
    "Spine",
    "Neck",
    "Head",
    "LeftArm",
    "LeftForeArm",
    "LeftHand",
    "RightArm",
    "RightForeArm",
    "RightHand",
)


def write_bvh(
    path: Path,
    frames: list[dict[str, tuple[float, float, float]]],
    root: tuple[float, ...] = (0, 0, 0),
) -> Path:
    rows = [
        [*root, *(angle for joint in BVH_ORDER for angle in frame.get(joint, (0, 0, 0)))]
        for frame in frames
    ]
    body = "\n".join(" ".join(map(str, row)) for row in rows)
    path.write_text(f"{bvh_text()}\nMOTION\nFrames: {len(rows)}\nFrame Time: .0083333\n{body}\n")
    return path


def test_bvh_by_hand(tmp_path: Path) -> None:
    frames: list[dict[str, tuple[float, float, float]]] = [
        {},
        {"RightUpLeg": (0, 0, -90)},  # angles are z, y, x
        {
            "LeftForeArm": (0, 90, 0),
            "LeftArm": (90, 0, 0),
        },  # Rz·Ry of x: to −z, which z leaves alone
    ]
    (motion,) = read_motion(write_bvh(tmp_path / "walk.bvh", frames))
    assert (motion.name, motion.subject, motion.frame_rate) == ("walk", "walk", 120.0)
    assert_joints(motion.joints[0])
    assert_joints(motion.joints[1], right_knee=(-1, 0, 4), right_ankle=(-1, 0, 7))
    assert_joints(motion.joints[2], left_elbow=(1.5, 8, 0), left_wrist=(1.5, 8, -2))


def test_npz_of_fifteen_and_seventeen_joints(tmp_path: Path) -> None:
    seventeen = np.arange(2 * 17 * 3, dtype=np.float32).reshape(2, 17, 3)
    fifteen = np.delete(seventeen, [12, 16], axis=1)
    np.savez(tmp_path / "set.npz", **{"walk/walk_1": seventeen, "walk/walk_2": fifteen})
    first, second = read_motion(tmp_path / "set.npz")
    assert [first.name, second.name, first.subject, second.subject] == [
        "walk/walk_1",
        "walk/walk_2",
        "set",
        "set",
    ]
    assert first.joints.dtype == np.float64
    np.testing.assert_array_equal(first.joints, second.joints)


def test_a_folder_is_read_in_order(tmp_path: Path) -> None:
    write_subject(tmp_path / "07", [{}])
    (tmp_path / "07" / "07_00.amc").write_text(amc_text([{}, {}]))
    write_bvh(tmp_path / "a.bvh", [{}])
    np.savez(tmp_path / "z.npz", a=np.ones((1, NUM_JOINTS, 3)))
    assert [motion.name for motion in read_motion(tmp_path)] == ["07_00", "07_01", "a", "a"]


def smooth(count: int, rate: float) -> Motion:
    joints = np.random.default_rng(0).normal(size=(1, NUM_JOINTS, 3)) * 300 + np.zeros(
        (count, 1, 1)
    )
    return Motion(joints + np.linspace(0, 500, count)[:, None, None], rate, "smooth", "nobody")


def test_jumps_are_dropped_with_their_neighbours() -> None:
    motion = smooth(240, 120.0)
    motion.joints[100:103, JOINT_INDEX["right_wrist"]] += 400
    kept = motion.without_jumps()
    expected = np.delete(motion.joints, np.r_[94:109], axis=0)
    np.testing.assert_array_equal(kept.joints, expected)
    assert len(smooth(240, 120.0).without_jumps().joints) == 240


def test_a_fast_person_is_no_glitch() -> None:
    """The whole body moves at 40 m/s in a car, and a forearm turns by 40° a frame."""
    motion = smooth(60, 30.0)
    joints = motion.joints + np.arange(60)[:, None, None] * 40_000 / 30
    angle = np.radians(40) * np.arange(60)
    circle = 300 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    joints[:, JOINT_INDEX["left_wrist"]] = joints[:, JOINT_INDEX["left_elbow"]] + circle
    moved = Motion(joints, 30.0, "fast", "nobody")
    assert len(moved.without_jumps().joints) == 60


def whirl(speeds: list[float], rate: float = 120.0) -> Motion:
    """A forearm that turns by so many degrees a second, step by step."""
    joints = smooth(len(speeds) + 1, rate).joints
    angle = np.radians(np.cumsum([0.0, *speeds]) / rate)
    circle = 300 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    joints[:, JOINT_INDEX["left_wrist"]] = joints[:, JOINT_INDEX["left_elbow"]] + circle
    return Motion(joints, rate, "whirl", "nobody")


@pytest.mark.parametrize(
    ("speeds", "lost"),
    [
        ([0] * 20 + [700, 1300, 1900, 2100, 1700, 900] + [0] * 20, 0),  # thrown
        ([0] * 20 + [1900, 1900, 1900] + [0] * 20, 14),  # it starts and ends from nothing
        ([0] * 20 + [2000, -2000] + [0] * 20, 13),  # a spike of one frame
        ([0] * 20 + [700, 1300, 1900, 3200, 1700, 900] + [0] * 20, 12),  # faster than anybody
        ([2000] + [0] * 20, 7),  # a T-pose before the first frame
        ([0] * 20 + [1300, 2000, -2000, -1300] + [0] * 20, 13),  # there and back
        ([1900] * 9, 0),
        ([1900], 2),
    ],
)
def test_runs_of_fast_frames_are_no_glitches(speeds: list[float], lost: int) -> None:
    motion = whirl(speeds)
    assert len(motion.joints) - len(motion.without_jumps().joints) == lost


@pytest.mark.parametrize(
    ("rate", "target", "kept"),
    [(120.0, 30.0, 60), (30.0, 30.0, 240), (25.0, 30.0, 240), (59.9, 30.0, 120)],
)
def test_thinning(rate: float, target: float, kept: int) -> None:
    thinned = smooth(240, rate).at_rate(target)
    assert len(thinned.joints) == kept
    assert thinned.frame_rate == pytest.approx(rate * kept / 240)


def edit(old: str, new: str, count: int = 1) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, count)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            edit("lhumerus 0", "lhumerus 0 0"),
            r"07_01\.amc, line 8: 'lhumerus' has 2 numbers, not 1",
        ),
        (
            edit(
                "rfemur 0 0 0\r\nrtibia 0\r\nlhumerus 0\r\n3",
                "rfemur 0 x 0\r\nrtibia 0\r\nlhumerus 0\r\n3",
            ),
            r"line 11: 'rfemur' and 3 numbers expected",
        ),
        (edit("\r\n2\r\n", "\r\n5\r\n"), "line 9: frame number 2 was expected"),
        (edit("lhumerus 0", "tail 0"), "line 8: 'tail' is no bone of"),
        (edit("rtibia 0", "rtibia nan", 9), "not finite"),
        (edit(":DEGREES", ":RADIANS"), "radians"),
        (lambda text: text[: text.rindex("rtibia")], "truncated"),
        (lambda text: text[:30], "no frame 1"),
        (lambda text: "", "no frame 1"),
    ],
)
def test_damaged_amc(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    path = write_subject(tmp_path, [{}, {}, {}])
    path.write_text(change(amc_text([{}, {}, {}])), newline="")
    with pytest.raises(BadInput, match=message):
        read_motion(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit("length 4.0", "length long"), r"07\.asf, line \d+: the bone that ends here"),
        (edit("name lfemur", "nom lfemur"), r"line \d+: the bone that ends here"),
        (edit("dof rx ry rz", "dof rx rw"), r"line \d+: the bone that ends here"),
        (edit(":hierarchy", ":other"), "no :hierarchy section"),
        (edit("length 0.45", "length 0"), "not a number to divide by"),
        (edit("angle deg", "angle rad"), "only degrees"),
        (edit("TX TY TZ", "TX TY"), "root's order"),
        (edit("    lfemur ltibia\r\n", ""), "lacks the bones ltibia"),
        (edit("    lfemur ltibia", "    lfemur tail"), r"line \d+: 'tail' is not in :bonedata"),
        (edit("    lfemur ltibia", "    ltibia lfemur"), r"line \d+: 'ltibia' has children before"),
        (edit("dof rx ry rz", "dof rx rx ry"), r"line \d+: the bone that ends here"),
        (edit("axis 0 0 0 XYZ", "axis nan 0 0 XYZ"), r"line \d+: the bone that ends here"),
        (edit("axis 0 0 0 XYZ", "axis 1e300 0 0 XYZ"), r"line \d+: the bone that ends here"),
        (edit("length 4.0", "length 1e300"), r"line \d+: the bone that ends here"),
        (edit("length 0.45", "length 1e-320"), "not a number to divide by"),
        (lambda text: text[:300], "no :hierarchy section"),
        (lambda text: "", "no :units section"),
    ],
)
def test_damaged_asf(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    path = write_subject(tmp_path, [{}])
    (tmp_path / "07.asf").write_text(change(asf_text()), newline="")
    with pytest.raises(BadInput, match=message):
        read_motion(path)


def test_amc_without_its_asf(tmp_path: Path) -> None:
    path = write_subject(tmp_path, [{}])
    (tmp_path / "07.asf").unlink()
    with pytest.raises(BadInput, match=r"needs its skeleton 07\.asf"):
        read_motion(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit("HIERARCHY", "TREE"), "HIERARCHY"),
        (edit("MOTION", "MOVIE"), "MOTION section"),
        (edit("JOINT LeftLeg", "JOINT LeftShank"), "no joint that is known as left_knee, but"),
        (edit("OFFSET 0 -4 0", "OFFSET 0 -4"), r"line \d+: 'OFFSET 0 -4'"),
        (edit("CHANNELS 3", "CHANNELS 4"), r"line \d+: 'CHANNELS 4"),
        (edit("Frames: 2", "Frames: 3"), "3 frames of 51 channels are announced, but 102 numbers"),
        (edit("Frame Time: .0083333", "Frame Time: 0"), "Frame Time"),
        (edit("Frame Time: .0083333", "Frame Time: 1e-320"), "Frame Time"),
        (edit("Frames: 2", f"Frames: {'9' * 5000}"), "Frames: <count>"),
        (edit("Zrotation Yrotation Xrotation", "Xrotation Xrotation Xrotation", 2), r"line \d+"),
        (
            edit("CHANNELS 3 Zrotation", "CHANNELS 3 Zrotation Yrotation Xrotation\nCHANNELS 3 Zr"),
            r"line \d+",
        ),
        (edit("OFFSET 0 -4 0", "OFFSET 0 -4e300 0"), r"line \d+: 'OFFSET 0 -4e300 0'"),
        (
            edit("OFFSET 0 1 0", "OFFSET 0 1 0\n{" + "\nEnd Site\n{" * 3000),
            "cannot be read|more than",
        ),
        (edit("Frame Time: .0083333\n0", "Frame Time: .0083333\nzero"), "not a finite number"),
        (edit("}", " ", 1), "not closed|cannot be read"),
        (lambda text: text[:-30], "truncated or damaged"),
        (lambda text: "", "not a BVH file"),
    ],
)
def test_damaged_bvh(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    path = write_bvh(tmp_path / "walk.bvh", [{}, {}])
    path.write_text(change(path.read_text()))
    with pytest.raises(BadInput, match=message):
        read_motion(path)


def write_chain(path: Path, depth: int, frames: int, channels: str) -> Path:
    """A body whose joints hang on one chain; only its root may have channels."""
    joints = [*map(str, range(depth)), *(name for name in BVH_ORDER if name != "Spine"), "HeadTop"]
    lines = [f"JOINT {name}\n{{\nOFFSET 0 1 0" for name in joints]
    lines[0] = f"HIERARCHY\nROOT {lines[0][6:]}\n{channels}"
    rows = ["MOTION", f"Frames: {frames}", "Frame Time: 0.01", *["0"] * frames * bool(channels)]
    path.write_text("\n".join([*lines, *["}"] * len(joints), *rows, ""]))
    return path


def test_frames_that_take_no_room_in_the_file_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_chain(tmp_path / "a.bvh", 0, 10, "")
    with pytest.raises(BadInput, match="no joint has CHANNELS"):
        read_motion(path)
    write_chain(path, 0, 10, "CHANNELS 1 Xrotation")
    trial = write_subject(tmp_path, [{}] * 10)
    monkeypatch.setattr(recording, "MOST_PLACES", 160)
    (read,) = read_motion(path)
    assert len(read.joints) == len(read_motion(trial)[0].joints) == 10  # 160 and 150
    monkeypatch.setattr(recording, "MOST_PLACES", 149)
    for file, joints in ((path, 16), (trial, 15)):
        with pytest.raises(BadInput, match=f"10 frames of {joints} joints, more than 149 places"):
            read_motion(file)


def test_a_long_chain_does_not_fill_the_memory(tmp_path: Path) -> None:
    path = write_chain(tmp_path / "a.bvh", 200, 2000, "CHANNELS 1 Xrotation")
    tracemalloc.start()
    (read,) = read_motion(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 216 * read.joints[:, 0].nbytes  # one place for each joint


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({}, "holds no recording"),
        ({"a": np.zeros((4, 16, 3))}, r"'a' has shape \(4, 16, 3\)"),
        ({"a": np.full((4, 15, 3), np.nan)}, "'a' has a coordinate that is not finite"),
        ({"a": np.zeros((0, 15, 3))}, "'a' has no frames"),
        ({"a": np.array("text")}, "'a' has shape"),
    ],
)
def test_damaged_npz(tmp_path: Path, arrays: dict[str, np.ndarray], message: str) -> None:
    np.savez(tmp_path / "set.npz", **arrays)
    with pytest.raises(BadInput, match=message):
        read_motion(tmp_path / "set.npz")


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no motion")
    (tmp_path / "cut.npz").write_bytes(b"PK\x03\x04")
    for path, message in (
        (tmp_path / "notes.txt", "no motion capture that can be read"),
        (tmp_path / "nowhere.bvh", "there is no motion capture"),
        (tmp_path / "cut.npz", "truncated"),
    ):
        with pytest.raises(BadInput, match=message):
            read_motion(path)
    (tmp_path / "cut.npz").unlink()
    with pytest.raises(BadInput, match="holds no"):
        read_motion(tmp_path)


def joint_angle(joints: np.ndarray, a: str, b: str, c: str) -> np.ndarray:
    """Degrees at joint b between a and c, for `(T, 15, 3)`."""
    one, other = (
        joints[:, JOINT_INDEX[a]] - joints[:, JOINT_INDEX[b]],
        joints[:, JOINT_INDEX[c]] - joints[:, JOINT_INDEX[b]],
    )
    cosine = (
        np.sum(one * other, axis=-1) / np.linalg.norm(one, axis=-1) / np.linalg.norm(other, axis=-1)
    )
    return np.degrees(np.arccos(cosine))


def test_amc_agrees_with_the_same_capture_as_positions(shared_data: Path) -> None:
    (amc,) = read_motion(shared_data / "cmu" / "asfamc" / "02" / "02_01.amc")
    positions = {
        motion.name: motion for motion in read_motion(shared_data / "cmu" / "actions_train.npz")
    }
    assert len(positions) == 72
    assert sum(len(motion.joints) for motion in positions.values()) == 13452
    expected = positions["walking/walking_1"].joints
    assert np.abs(amc.at_rate(30).joints[: len(expected)] - expected).max() < 0.004


def test_bvh_agrees_with_the_same_capture_as_positions(shared_data: Path) -> None:
    """Bone lengths differ (the set has one skeleton for all), the angles at elbows and knees do
    not, nor does the trunk, of which the conversion left out the thorax bone."""
    (bvh,) = read_motion(shared_data / "bvh" / "cmu_12_01_walk.bvh")
    positions = {
        motion.name: motion for motion in read_motion(shared_data / "cmu" / "actions_train.npz")
    }
    expected = positions["walking_extra/walking_19"].joints
    found = bvh.joints[1::4]
    assert found.shape == expected.shape
    for side in ("left", "right"):
        for chain in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")):
            names = [f"{side}_{name}" for name in chain]
            difference = joint_angle(found, *names) - joint_angle(expected, *names)
            assert np.abs(difference - difference.mean()).max() < 1.5, names
            assert abs(difference.mean()) < 5, names
    trunks = [joints[:, 1] - joints[:, 0] for joints in (found, expected)]
    own, other = (
        np.linalg.norm(trunk, axis=-1).mean() / body_unit(joints)
        for trunk, joints in zip(trunks, (found, expected), strict=True)
    )
    assert own == pytest.approx(other, rel=0.03)  # without that bone: 0.67 of it
    tilts = [
        np.degrees(np.arccos(trunk[:, 1] / np.linalg.norm(trunk, axis=-1))) for trunk in trunks
    ]
    assert np.abs(tilts[0] - tilts[1]).max() < 5


def conversion(thorax: str = "0 0 0", hip: str = "0 0 0", lower_back: str = "LowerBack") -> str:
    """A BVH file of one frame, built as the conversions of the CMU files are, in their unit."""

    def joint(name: str, offset: str, *below: str) -> str:
        own = f"JOINT {name} {{\nOFFSET {offset}\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
        own = own.replace("{", "\n{")
        return own + ("".join(below) or "End Site\n{\nOFFSET 0 1 0\n}\n") + "}\n"

    legs = [
        joint(
            f"{side[0]}HipJoint",
            hip if side == "Left" else "0 0 0",
            joint(
                f"{side}UpLeg",
                f"{way} -1 0",
                joint(f"{side}Leg", "0 -7 0", joint(f"{side}Foot", "0 -7 0")),
            ),
        )
        for side, way in (("Left", 1), ("Right", -1))
    ]
    arms = [
        joint(
            f"{side}Shoulder",
            thorax,
            joint(
                f"{side}Arm",
                f"{3 * way} 1 0",
                joint(f"{side}ForeArm", f"{5 * way} 0 0", joint(f"{side}Hand", f"{4 * way} 0 0")),
            ),
        )
        for side, way in (("Left", 1), ("Right", -1))
    ]
    neck = joint("Neck", thorax, joint("Neck1", "0 1.5 0", joint("Head", "0 1.5 0")))
    spine = joint(
        lower_back, "0 0 0", joint("Spine", "0 2 0", joint("Spine1", "0 2 0", neck, *arms))
    )
    text = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
    text += "".join([*legs, spine]) + "}\n"
    zeros = " ".join(["0"] * (3 * text.count("CHANNELS")))
    return f"{text}MOTION\nFrames: 1\nFrame Time: .0333333\n{zeros}\n"


@pytest.mark.parametrize(
    ("given", "trunk"),
    [
        ({}, 6.0),
        ({"lower_back": "Belly"}, 6.0),  # tools rename joints
        ({"thorax": "0 2.5 0"}, 6.5),  # the file has the bone
        ({"hip": "0 0 0.1"}, 4.0),  # another build
    ],
)
def test_only_conversions_that_lack_the_thorax_bone_get_one(
    tmp_path: Path, given: dict[str, str], trunk: float
) -> None:
    (tmp_path / "a.bvh").write_text(conversion(**given))
    joints = read_motion(tmp_path / "a.bvh")[0].joints[0]
    at = [JOINT_INDEX[name] for name in ("pelvis", "thorax", "right_shoulder")]
    back, shoulder = (joints[row] - joints[at[0]] for row in at[1:])
    assert np.linalg.norm(back) / CMU_UNIT == pytest.approx(trunk, abs=0.03)
    np.testing.assert_allclose(shoulder - back, CMU_UNIT * np.array([-3, 1, 0]), atol=1e-6)


@pytest.mark.slow
def test_known_defects_are_dropped(shared_data: Path) -> None:
    """The recordings' known jumps go, and next to nothing else."""
    lost = {
        motion.name: len(motion.joints) - len(motion.without_jumps().joints)
        for folder in ("bvh", "cmu/asfamc")
        for motion in read_motion(shared_data / folder)
    }
    jerky = {
        "01_02",
        "01_06",
        "01_07",
        "01_10",
        "01_12",
        "01_13",
        "01_14",
        "03_02",
        "cmu_12_01_walk",
    }
    assert {name for name, count in lost.items() if count} == jerky
    assert max(lost.values()) <= 40
