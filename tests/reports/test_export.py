"""`poseterior export`: every format is read back by readers that share no code with its writer, to
within 0.1 mm."""

import base64
import csv
import json
import re
import shutil
import struct
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr

from poseterior.inference import Item, Result, hypotheses, open_stream, sample_frames
from poseterior.probmodel import Estimate, PoseModel
from poseterior.probmodel.datasets import body_height
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, PARENTS
from poseterior.reports.exports import OF_MEASURES, TARGETS, results
from poseterior.reports.exports.clip import Clip, viewed
from poseterior.reports.exports.results import Wanted, read_clip
from tests.conftest import Cli
from tests.scenes import key

OF_PLACES = [name for name in TARGETS if name not in OF_MEASURES]
TENTH = 1e-4
"""Metres: a tenth of a millimetre."""


# --- results to begin with


@pytest.fixture(scope="module")
def folder(example_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `poseterior hypotheses` leaves, but for the picture; made once."""
    folder = tmp_path_factory.mktemp("result")
    example_result.save(folder / "posterior.nc")
    chosen = [one.as_json() for one in hypotheses(example_result, 3)]
    (folder / "hypotheses.json").write_text(json.dumps({"hypotheses": chosen}))
    return folder


@pytest.fixture(scope="module")
def stream(example_estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of two people; the first cannot be estimated in its second frame, the other is not
    there."""
    folder = tmp_path_factory.mktemp("stream") / "s"
    names = ["f0/0", "f0/1", "f2/0", "f2/1"]
    items = [Item(name, example_estimate) for name in names]
    items.insert(2, Item("f1/0", "f1 has no torso; choose another"))
    sample_frames(
        PoseModel(), items, key=key(0), out=folder, num_samples=30, k=2, root="candidates"
    )
    return folder


def clip_of(path: Path, **wanted: Any) -> Clip:
    return read_clip(path, Wanted(1.75, **wanted))


def written(to: str, path: Path, out: Path, unit: str = "m", **wanted: Any) -> Clip:
    """A result in a file, and what should be in it."""
    clip = clip_of(path, **wanted)
    TARGETS[to].write(clip, out, unit)
    return clip


# --- readers of other makes: nothing of them is used by the writers


class Bvh(NamedTuple):
    """Joints of a .bvh by name `(frames, 3)`, and the names of channels by joint."""

    joints: dict[str, np.ndarray]
    channels: dict[str, list[str]]
    rate: float


def turn(axis: str, degrees: float) -> np.ndarray:
    """A rotation matrix about one axis, from its definition."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rows = {
        "X": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "Y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "Z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(rows[axis])


def read_bvh(path: Path) -> Bvh:
    """Forward kinematics as the format's description has it: M = T · R_1 · R_2 · R_3, down the
    tree."""
    words = iter(path.read_text().split())
    joints: list[dict[str, Any]] = []
    above: list[int] = []
    for word in words:
        if word in ("ROOT", "JOINT"):
            joints.append({"name": next(words), "parent": above[-1] if above else None})
            joints[-1]["channels"] = []
        elif word == "End":
            joints.append({"name": joints[-1]["name"] + " end", "parent": above[-1]})
            joints[-1]["channels"] = []
        elif word == "{":
            above.append(len(joints) - 1)
        elif word == "}":
            above.pop()
        elif word == "OFFSET":
            joints[-1]["offset"] = np.array([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            joints[-1]["channels"] = [next(words) for _ in range(int(next(words)))]
        elif word == "Frames:":
            count = int(next(words))
        elif word == "Time:":
            rate = 1 / float(next(words))
            break
    values = np.array([float(word) for word in words]).reshape(count, -1)
    found: dict[str, list[np.ndarray]] = {joint["name"]: [] for joint in joints}
    for row in values:
        numbers, matrices = iter(row), []
        for joint in joints:
            shift, rotation = np.array(joint["offset"]), np.eye(3)
            for channel in joint["channels"]:
                number = next(numbers)
                if channel.endswith("position"):
                    shift["XYZ".index(channel[0])] = number
                else:
                    rotation = rotation @ turn(channel[0], number)
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = rotation, shift
            if joint["parent"] is not None:
                matrix = matrices[joint["parent"]] @ matrix
            matrices.append(matrix)
            found[joint["name"]].append(matrix[:3, 3])
    channels = {joint["name"]: joint["channels"] for joint in joints}
    return Bvh({name: np.array(rows) for name, rows in found.items()}, channels, rate)


NAMES = {
    "pelvis": "Hips",
    "thorax": "Neck",
    "head": "HeadTop",
    **{
        f"{side}_{ours}": f"{side.title()}{theirs}"
        for side in ("left", "right")
        for ours, theirs in {
            "shoulder": "Arm",
            "elbow": "ForeArm",
            "wrist": "Hand",
            "hip": "UpLeg",
            "knee": "Leg",
            "ankle": "Foot",
        }.items()
    },
}


def bvh_joints(path: Path) -> np.ndarray:
    found = read_bvh(path).joints
    return np.stack([found[NAMES[joint]] for joint in JOINTS], axis=1)


class C3d(NamedTuple):
    """What a .c3d says: points and residuals, and parameters by `GROUP:NAME`."""

    points: np.ndarray
    residuals: np.ndarray
    parameters: dict[str, bytes]


def read_c3d(path: Path) -> C3d:
    """As the C3D user guide lays the file out (floating point, Intel): header, parameters, then
    frames of x, y, z and a word of which one byte, to some readers the low one and to others the
    high one, is the residual in steps of POINT:SCALE."""
    data = path.read_bytes()
    points, first, last, scale, start = (
        *struct.unpack_from("<H", data, 2),
        *struct.unpack_from("<HH", data, 6),
        *struct.unpack_from("<f", data, 12),
        *struct.unpack_from("<H", data, 16),
    )
    assert data[1] == 0x50
    assert scale < 0  # floating point
    place = 512 * (start - 1)
    rows = np.frombuffer(data, "<f4", 4 * points * (last - first + 1), place)
    rows = rows.reshape(-1, points, 4)
    last_word = rows[..., 3].astype(int)
    assert (last_word < 0).sum() + (last_word & 0xFF == last_word >> 8).sum() == last_word.size
    residuals = np.where(last_word < 0, -1.0, (last_word & 0xFF) * -scale)
    return C3d(rows[..., :3], residuals, c3d_parameters(data))


def c3d_parameters(data: bytes) -> dict[str, bytes]:
    groups, found = {}, {}
    place = 512 * (data[0] - 1) + 4
    while True:
        length, group = struct.unpack_from("<bb", data, place)
        if length == 0:
            return {f"{groups[number]}:{name}": value for (number, name), value in found.items()}
        name = data[place + 2 : place + 2 + abs(length)].decode().upper()
        after = place + 2 + abs(length)
        (offset,) = struct.unpack_from("<H", data, after)
        if group < 0:
            groups[-group] = name
        else:
            dims = data[after + 3]
            size = abs(struct.unpack_from("<b", data, after + 2)[0])
            shape = data[after + 4 : after + 4 + dims]
            count = int(np.prod(list(shape))) if dims else 1
            value = data[after + 4 + dims : after + 4 + dims + size * count]
            found[group, name] = value
        if offset == 0:
            return {f"{groups[number]}:{name}": value for (number, name), value in found.items()}
        place = after + offset


def read_trc(path: Path) -> tuple[dict[str, str], np.ndarray, dict[str, np.ndarray]]:
    """As OpenSim's adapter does: header, times, markers `(frames, 3)`. It refuses what OpenSim
    refuses."""
    lines = [line.split("\t") for line in path.read_text().split("\n")]
    assert lines[0][0] == "PathFileType"
    assert len(lines[0][3].split()) == 1
    assert lines[1] == [
        *("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate"),
        *("OrigDataStartFrame", "OrigNumFrames"),
    ]
    header = dict(zip(lines[1], lines[2], strict=True))
    labels = [word for word in lines[3] if word]
    assert labels[:2] == ["Frame#", "Time"]
    markers = labels[2:]
    assert len(markers) == int(header["NumMarkers"])
    assert [word for word in lines[4] if word] == [
        f"{axis}{number}" for number in range(1, len(markers) + 1) for axis in "XYZ"
    ]
    assert lines[5] == [""]
    rows = [line for line in lines[6:] if line != [""]]
    assert {len(row) for row in rows} == {2 + 3 * len(markers)}
    assert len(rows) == int(header["NumFrames"])
    values = np.array(rows, float)
    return (
        header,
        values[:, 1],
        {name: values[:, 2 + 3 * i : 5 + 3 * i] for i, name in enumerate(markers)},
    )


class Gltf(NamedTuple):
    """A glTF file's document and the rows of an accessor."""

    document: dict[str, Any]
    rows: Callable[[int], np.ndarray]


def read_gltf(path: Path) -> Gltf:
    """As the specification of glTF 2.0 lays out a .glb, or a .gltf with its buffer inside."""
    data = path.read_bytes()
    if data.startswith(b"glTF"):
        assert struct.unpack_from("<II", data, 4) == (2, len(data))
        size, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        document = json.loads(data[20 : 20 + size])
        assert data[24 + size : 28 + size] == b"BIN\0"
        buffer = data[28 + size :]
    else:
        document = json.loads(data)
        buffer = base64.b64decode(document["buffers"][0]["uri"].split(",")[1])

    def rows(index: int) -> np.ndarray:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        dtype = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
        place = view.get("byteOffset", 0)
        return np.frombuffer(buffer, dtype, width * accessor["count"], place).reshape(-1, width)

    return Gltf(document, rows)


def spun(quaternion: list[float], vector: np.ndarray) -> np.ndarray:
    """A vector turned by a quaternion (x, y, z, w)."""
    axis, w = np.array(quaternion[:3]), quaternion[3]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)


# --- what a clip is


def test_the_median_body_has_the_wanted_height(folder: Path) -> None:
    clip = read_clip(folder / "posterior.nc", Wanted(1.82, draws=200))
    assert np.median(body_height(clip.joints)) == pytest.approx(1.82)
    assert clip.names[:2] == ["draw 0", "draw 1"]
    assert clip.spread is None


def test_up_is_up_and_left_is_left(folder: Path) -> None:
    """The example stands and faces the camera: its head is up, and its left is on the right of the
    image."""
    pose = clip_of(folder / "hypotheses.json").joints[0]
    head, foot = pose[JOINT_INDEX["head"]], pose[JOINT_INDEX["left_ankle"]]
    assert head[1] > 0.3 > foot[1]
    down_and_away = np.array([0.2, 0.3, 0.5])
    assert viewed(down_and_away) == pytest.approx([0.2, -0.3, -0.5])


def test_a_folder_has_what_was_chosen_with_the_spread_of_the_draws(folder: Path) -> None:
    alone, both = clip_of(folder / "hypotheses.json"), clip_of(folder)
    drawn = clip_of(folder, draws=200)
    assert len(alone.joints) == len(both.joints) == 3
    assert alone.spread is None
    assert both.weights == pytest.approx(alone.weights)
    assert both.spread[0] == pytest.approx(drawn.joints.std(axis=0))
    assert both.joints[0] in drawn.joints


def test_a_film_keeps_its_time(stream: Path) -> None:
    film = clip_of(stream, person=0, what="hypothesis")
    assert film.names == ["f0", "f1", "f2"]
    assert film.there.tolist() == [True, False, True]
    held = film.held()
    assert np.array_equal(held.joints[1], film.joints[0])
    assert np.array_equal(held.joints[2], film.joints[2])
    assert clip_of(stream, person=1).there.tolist() == [True, False, True]


# --- files


@pytest.mark.parametrize("unit", ["m", "mm"])
@pytest.mark.parametrize("wanted", [{}, {"draws": 40}, {"draws": 1}], ids=str)
def test_bvh(folder: Path, tmp_path: Path, unit: str, wanted: dict[str, int]) -> None:
    clip = written("bvh", folder, tmp_path / "x.bvh", unit, **wanted)
    scale = {"m": 1, "mm": 1000}[unit]
    ours = read_motion(tmp_path / "x.bvh")[0]
    assert np.abs(ours.joints / 1000 - clip.joints).max() < TENTH  # the reader finds the unit
    assert np.abs(bvh_joints(tmp_path / "x.bvh") / scale - clip.joints).max() < TENTH
    assert ours.frame_rate == pytest.approx(30, abs=0.01)


def test_bvh_moves_joints_only_where_lengths_differ(folder: Path, tmp_path: Path) -> None:
    for draws, moved in ((1, {"Hips"}), (40, {"Hips", "LeftForeArm", "RightFoot"})):
        written("bvh", folder, tmp_path / "x.bvh", draws=draws)
        channels = read_bvh(tmp_path / "x.bvh").channels
        found = {name for name, own in channels.items() if "Xposition" in own}
        assert moved <= found
        assert draws > 1 or found == moved


def test_bvh_of_hard_poses(tmp_path: Path) -> None:
    """The T-pose itself, bones straight against it, and lying bodies whose Euler angles lock."""
    pose = clip_t_pose()
    upset = pose.copy()
    for end in ("left_wrist", "right_wrist", "left_ankle", "head"):
        joint, start = JOINT_INDEX[end], PARENTS[JOINT_INDEX[end]]
        upset[joint] = 2 * upset[start] - pose[joint]
    lying = pose @ turn("X", 90.0).T
    clip = Clip(np.stack([pose, upset, lying, upset @ turn("Z", 90.0).T]), list("abcd"))
    TARGETS["bvh"].write(clip, tmp_path / "x.bvh", "m")
    assert np.abs(bvh_joints(tmp_path / "x.bvh") - clip.joints).max() < TENTH


def clip_t_pose() -> np.ndarray:
    """A body `(15, 3)` in a T-pose, metres."""
    pose = np.zeros((15, 3))
    right = {
        "right_shoulder": (-0.2, 0.5, 0), "right_elbow": (-0.5, 0.5, 0),
        "right_wrist": (-0.75, 0.5, 0), "right_hip": (-0.1, -0.1, 0),
        "right_knee": (-0.1, -0.5, 0), "right_ankle": (-0.1, -0.9, 0),
    }  # fmt: skip
    for name, place in right.items():
        pose[JOINT_INDEX[name]] = place
        pose[JOINT_INDEX[name.replace("right", "left")]] = np.array(place) * [-1, 1, 1]
    pose[JOINT_INDEX["thorax"]], pose[JOINT_INDEX["head"]] = (0, 0.5, 0), (0, 0.8, 0)
    return pose


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_c3d(folder: Path, tmp_path: Path, unit: str) -> None:
    clip = written("c3d", folder, tmp_path / "x.c3d", unit)
    found, scale = read_c3d(tmp_path / "x.c3d"), {"m": 1, "mm": 1000}[unit]
    assert np.abs(found.points / scale - clip.joints).max() < TENTH
    assert np.abs(found.residuals / scale - clip.radius).max() <= clip.radius.max() / 250
    labels, width = found.parameters["POINT:LABELS"].decode(), max(map(len, JOINTS))
    assert labels == "".join(joint.ljust(width) for joint in JOINTS)
    assert found.parameters["POINT:UNITS"].decode().strip() == unit
    assert struct.unpack("<f", found.parameters["POINT:RATE"])[0] == 30
    assert found.parameters["POINT:Y_SCREEN"].decode().strip() == "+Y"


def test_c3d_of_a_film_says_which_frames_are_missing(stream: Path, tmp_path: Path) -> None:
    written("c3d", stream, tmp_path / "x.c3d", person=0)
    residuals = read_c3d(tmp_path / "x.c3d").residuals
    assert (residuals[1] == -1).all()
    assert (residuals[[0, 2]] >= 0).all()


def test_residuals_are_the_same_to_readers_of_both_makes(tmp_path: Path) -> None:
    """They differ over which byte has the residual; the largest is far beyond 255 mm."""
    ezc3d, c3d = pytest.importorskip("ezc3d"), pytest.importorskip("c3d")
    rng = np.random.default_rng(0)
    clip = Clip(
        np.where(np.arange(6)[:, None, None] == 2, np.nan, rng.normal(size=(6, 15, 3))),
        list("abcdef"),
        spread=rng.uniform(0.01, 0.4, (6, 15, 3)),
        film=True,
        numbers=[3, 4, 5, 6, 9, 10],
        rate=25.0,
    )
    TARGETS["c3d"].write(clip, tmp_path / "x.c3d", "mm")
    radius = 1000 * clip.regular().radius
    radius[~clip.regular().there] = -1
    by_ezc3d = ezc3d.c3d(str(tmp_path / "x.c3d"))
    assert by_ezc3d["parameters"]["POINT"]["RATE"]["value"] == [25]
    with (tmp_path / "x.c3d").open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frames = list(c3d.Reader(file).read_frames())
    step = np.nanmax(radius) / 127
    for found in (
        by_ezc3d["data"]["meta_points"]["residuals"][0].T,
        np.array([points[:, 3] for _, points, _ in frames]),
    ):
        assert found.shape == (8, 15)
        assert (found[[2, 4, 5]] == -1).all()
        there = clip.regular().there
        assert np.abs(found - radius)[there].max() <= 0.51 * step
        assert found[there].max() > 300
    points = by_ezc3d["data"]["points"][:3].T / 1000
    assert np.abs(points - clip.regular().joints)[there].max() < TENTH
    assert np.isnan(points[~there]).all()


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_trc(folder: Path, tmp_path: Path, unit: str) -> None:
    clip = written("trc", folder, tmp_path / "x y.trc", unit)
    header, times, markers = read_trc(tmp_path / "x y.trc")
    scale = {"m": 1, "mm": 1000}[unit]
    assert header["Units"] == unit
    assert times == pytest.approx([0, 1 / 30, 2 / 30], abs=1e-6)
    for index, joint in enumerate(JOINTS):
        assert np.abs(markers[joint] / scale - clip.joints[:, index]).max() < TENTH
        assert np.abs(markers[f"{joint}_sd"] / scale - clip.spread[:, index]).max() < TENTH


def test_trc_without_spread_has_fifteen_markers(stream: Path, folder: Path, tmp_path: Path) -> None:
    written("trc", folder, tmp_path / "x.trc", draws=2)
    assert tuple(read_trc(tmp_path / "x.trc")[2]) == JOINTS
    written("trc", stream, tmp_path / "x.trc", person=0)
    assert np.isnan(read_trc(tmp_path / "x.trc")[2]["head"][:, 0]).tolist() == [False, True, False]


@pytest.mark.parametrize("name", ["x.glb", "x.gltf"])
def test_gltf_of_hypotheses(folder: Path, tmp_path: Path, name: str) -> None:
    clip = written("gltf", folder, tmp_path / name)
    document, rows = read_gltf(tmp_path / name)
    nodes = document["nodes"]
    roots = [nodes[index] for index in document["scenes"][0]["nodes"]]
    assert [root["name"] for root in roots] == clip.names
    for root, pose in zip(roots, clip.joints, strict=True):
        parts = [nodes[index] for index in root["children"]]
        joints = np.array([part["translation"] for part in parts[:15]])
        assert tuple(part["name"] for part in parts[:15]) == JOINTS
        assert np.abs(joints - pose).max() < TENTH
        for end, bone in enumerate(parts[15:], 1):
            top = spun(bone["rotation"], np.array([0, bone["scale"][1], 0]))
            assert np.abs(bone["translation"] + top - pose[end]).max() < TENTH
    ghosts = [one["pbrMetallicRoughness"]["baseColorFactor"][3] for one in document["materials"]]
    assert ghosts == sorted(ghosts, reverse=True)
    places = rows(document["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    assert np.abs(places).max() < 0.05


def test_gltf_of_a_film(stream: Path, tmp_path: Path) -> None:
    clip = written("gltf", stream, tmp_path / "x.glb", person=0)
    document, rows = read_gltf(tmp_path / "x.glb")
    (animation,) = document["animations"]
    for channel in animation["channels"]:
        sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
        assert rows(sampler["input"])[:, 0] == pytest.approx([0, 2 / 30])
        name = document["nodes"][target["node"]]["name"]
        if name in JOINTS:
            found = rows(sampler["output"])
            assert np.abs(found - clip.joints[[0, 2], JOINT_INDEX[name]]).max() < TENTH
    assert len(animation["channels"]) == 15 + 3 * 14


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_csv(stream: Path, tmp_path: Path, unit: str) -> None:
    clip = written("csv", stream, tmp_path / "x.csv", unit, person=0)
    scale = {"m": 1, "mm": 1000}[unit]
    with (tmp_path / "x.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == clip.names
    assert rows[1][f"head_x_{unit}"] == ""
    for index in (0, 2):
        for joint, axis in (("head", 0), ("left_ankle", 2)):
            place = float(rows[index][f"{joint}_{'xyz'[axis]}_{unit}"]) / scale
            spread = float(rows[index][f"{joint}_{'xyz'[axis]}_sd_{unit}"]) / scale
            assert place == pytest.approx(clip.joints[index, JOINT_INDEX[joint], axis], abs=TENTH)
            assert spread == pytest.approx(clip.spread[index, JOINT_INDEX[joint], axis], abs=TENTH)


def test_npz(folder: Path, tmp_path: Path) -> None:
    clip = written("npz", folder, tmp_path / "x.npz", "mm")
    with np.load(tmp_path / "x.npz") as found:
        assert found["joints"] / 1000 == pytest.approx(clip.joints)
        assert found["spread"] / 1000 == pytest.approx(clip.spread)
        assert tuple(found["joint_names"]) == JOINTS
        assert found["weights"].sum() == pytest.approx(1)
        assert str(found["unit"]) == "mm"


# --- films: what they are made of, and when


GAP = ("f007/0", "f008/0", "f0011/0", "f012/0", "f0009/0")
"""Frames 7 to 12 without the tenth; the ninth has no pose, and comes last."""


@pytest.fixture(scope="module")
def gap(example_estimate: Estimate, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film with a gap."""
    folder = tmp_path_factory.mktemp("gap") / "s"
    items = [Item(name, example_estimate) for name in GAP[:-1]]
    items.append(Item(GAP[-1], "nothing is seen"))
    known = {"root": "candidates", "num_samples": 30, "k": 2}
    sample_frames(PoseModel(), items, key=key(0), out=folder, **known)
    return folder


THERE, TIMES = [7, 8, 11, 12], np.array([0, 0.04, 0.16, 0.2])


def times_and_wrists(to: str, path: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """When there is a pose, where the left wrist is then, and how many rows there are, by a reader
    of another make; of BVH, which cannot say that there is none, when it moves."""
    wrist = JOINT_INDEX["left_wrist"]
    if to == "trc":
        _, times, markers = read_trc(path)
        places = markers["left_wrist"]
    elif to == "c3d":
        found = read_c3d(path)
        places = np.where(found.residuals[:, wrist, None] < 0, np.nan, found.points[:, wrist])
        (rate,) = struct.unpack("<f", found.parameters["POINT:RATE"])
        times = np.arange(len(places)) / rate
    elif to == "csv":
        with path.open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [row["frame"] for row in rows] == ["7", "8", "9", "11", "12"]
        times = np.array([float(row["time_s"]) for row in rows])
        columns = [f"left_wrist_{axis}_m" for axis in "xyz"]
        places = np.array([[float(row[name] or "nan") for name in columns] for row in rows])
    elif to == "npz":
        with np.load(path) as arrays:
            assert arrays["frames"].tolist() == ["7", "8", "9", "11", "12"]
            times, places = arrays["times"], arrays["joints"][:, wrist]
    elif to == "gltf":
        document, rows_of = read_gltf(path)
        (animation,) = document["animations"]
        names = [node["name"] for node in document["nodes"]]
        (channel,) = (
            one for one in animation["channels"] if names[one["target"]["node"]] == "left_wrist"
        )
        sampler = animation["samplers"][channel["sampler"]]
        times, places = rows_of(sampler["input"])[:, 0], rows_of(sampler["output"])
    else:
        times = np.arange(len(bvh_joints(path))) / read_bvh(path).rate
        places = bvh_joints(path)[:, wrist]
        moves = np.linalg.norm(np.diff(places, axis=0), axis=1) > 2 * TENTH
        places[1:][~moves] = np.nan
    there = np.isfinite(places).all(axis=1)
    return times[there], places[there], len(places)


@pytest.mark.parametrize("what", ["mean", "hypothesis"])
@pytest.mark.parametrize("to", OF_PLACES)
def test_gaps_stay_gaps(gap: Path, tmp_path: Path, to: str, what: str) -> None:
    clip = clip_of(gap, what=what, rate=25.0)
    assert clip.numbers == [7, 8, 9, 11, 12]
    assert clip.there.tolist() == [True, True, False, True, True]
    TARGETS[to].write(clip, tmp_path / "x", "m" if to == "gltf" else TARGETS[to].units[0])
    if to == "csv":
        TARGETS[to].write(clip, tmp_path / "x", "m")
    times, places, count = times_and_wrists(to, tmp_path / "x")
    scale = {"c3d": 1000, "trc": 1000, "npz": 1000}.get(to, 1)
    assert times == pytest.approx(TIMES, abs=1e-6)
    expected = clip.joints[clip.there, JOINT_INDEX["left_wrist"]]
    assert np.abs(places / scale - expected).max() < 2 * TENTH
    assert count == {"csv": 5, "npz": 5, "gltf": 4}.get(to, 6)


def test_trc_has_the_numbers_of_the_film(gap: Path, tmp_path: Path) -> None:
    written("trc", gap, tmp_path / "x.trc")
    assert read_trc(tmp_path / "x.trc")[0]["OrigDataStartFrame"] == "7"
    rows = (tmp_path / "x.trc").read_text().splitlines()[6:]
    assert [row.split("\t")[0] for row in rows] == ["7", "8", "9", "10", "11", "12"]


def film_of(joints: np.ndarray, numbers: list[int] | None, rate: float = 50.0) -> Clip:
    names = [str(at) for at in range(len(joints))]
    return Clip(joints, names, film=True, numbers=numbers, rate=rate)


@pytest.mark.parametrize("to", ["trc", "c3d"])
def test_every_fifth_frame_is_no_gap(tmp_path: Path, to: str) -> None:
    clip = film_of(np.tile(clip_t_pose(), (3, 1, 1)), [10, 15, 25])
    TARGETS[to].write(clip, tmp_path / "x", "m")
    times, _, count = times_and_wrists(to, tmp_path / "x")
    assert times == pytest.approx([0, 0.1, 0.3])
    assert count == 4


@pytest.mark.parametrize("to", OF_PLACES)
def test_numbers_of_nineteen_digits_are_exported(tmp_path: Path, to: str) -> None:
    first = 1699999999123456789
    clip = film_of(np.tile(clip_t_pose(), (3, 1, 1)), [first, first + 1, first + 3])
    TARGETS[to].write(clip, tmp_path / "x", TARGETS[to].units[0])
    if to == "npz":
        with np.load(tmp_path / "x") as found:
            assert found["times"] == pytest.approx([0, 0.02, 0.06])
            assert found["frames"].tolist() == [str(first + n) for n in (0, 1, 3)]
    elif to == "csv":
        assert f"\n2,{first + 3},0.060000,2," in (tmp_path / "x").read_text()
    assert (tmp_path / "x").stat().st_size > 500


def test_names_that_do_not_count_are_taken_in_their_order(
    example_estimate: Estimate, tmp_path: Path, poseterior: Cli
) -> None:
    items = [Item(f"{name}/0", example_estimate) for name in ("left", "right", "above")]
    sample_frames(PoseModel(), items, key=key(0), out=tmp_path / "s", num_samples=30, k=2)
    assert clip_of(tmp_path / "s").names == ["left", "right", "above"]
    assert clip_of(tmp_path / "s").times == pytest.approx(np.arange(3) / 30)
    run = poseterior("export", tmp_path / "s", "--to", "csv", "--out", tmp_path / "x.csv")
    assert "the names of the frames (left, …) do not count them" in run.err
    assert "nobody says how many frames a second this film has; 30 are assumed" in run.err
    assert "30 a second" in run.out
    said = poseterior(
        *("export", tmp_path / "s", "--to", "csv", "--out", tmp_path / "x.csv", "--rate", 50)
    )
    assert "nobody says how many" not in said.err
    assert "50 a second" in said.out


def bones(joints: np.ndarray) -> np.ndarray:
    """`(n, 14)` lengths."""
    return np.linalg.norm(joints[:, 1:] - joints[:, list(PARENTS[1:])], axis=-1)


def test_a_film_is_the_mean_made_a_body(gap: Path) -> None:
    """Bones of one length, those of the hypotheses, along the means of the draws; the mean itself
    has shorter ones."""
    clip = clip_of(gap)
    joints = clip.joints[clip.there]
    assert np.ptp(bones(joints), axis=0) == pytest.approx(np.zeros(14), abs=1e-9)
    tree = open_stream(gap)
    there = tree["summary"].num_draws.values > 0
    means = viewed(tree["summary"]["mean"].values[there])
    heaviest = viewed(tree["hypotheses"].joints.values[there, 0])
    metres = 1.75 / np.median(body_height(heaviest))
    assert bones(joints).mean(axis=0) == pytest.approx(
        metres * np.median(bones(heaviest), axis=0), rel=1e-6
    )
    assert (bones(means).mean(axis=0) * metres < bones(joints)[0])[[3, 6, 10]].all()
    for end in ("left_wrist", "right_knee", "head"):
        joint, start = JOINT_INDEX[end], PARENTS[JOINT_INDEX[end]]
        ours, theirs = joints[:, joint] - joints[:, start], means[:, joint] - means[:, start]
        cosine = np.sum(ours * theirs, axis=1) / np.linalg.norm(ours, axis=1)
        assert cosine == pytest.approx(np.linalg.norm(theirs, axis=1))
    draws = clip_of(gap, what="hypothesis").joints[clip.there]
    assert draws == pytest.approx(metres * heaviest)


def test_where_the_focal_length_is_known_the_person_stands_somewhere(
    gap: Path, tmp_path: Path, poseterior: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pelvis that walks away from the camera."""
    still, tree = clip_of(gap), open_stream(gap)
    walk = np.stack([np.linspace(0, 1, 5), np.ones(5), 9 + np.arange(5)], axis=1)
    tree["summary"]["place"].values[:] = walk
    tree["summary"]["place_sd"].values[:] = 0.5
    tree["hypotheses"]["place"].values[:] = walk[:, None]
    monkeypatch.setattr(results, "open_stream", lambda path: tree)
    clip = clip_of(gap)
    assert clip.origin == "camera"
    assert still.origin == "pelvis"
    metres = 1.75 / np.median(body_height(tree["hypotheses"].joints.values[:4, 0]))
    in_time = walk[[0, 1, 4, 2, 3]]
    assert clip.joints[clip.there, 0] == pytest.approx((metres * viewed(in_time))[clip.there])
    assert (clip.joints - clip.joints[:, :1])[clip.there] == pytest.approx(
        still.joints[still.there], abs=1e-9
    )
    assert clip.joints[0, 0, 2] < -1, "z points to the camera"
    assert clip.spread[0, 0] == pytest.approx(metres * np.full(3, 0.5))
    run = poseterior("export", gap, "--to", "csv", "--out", tmp_path / "x.csv", "--rate", 25)
    assert "y up, the camera at the origin" in run.out
    assert "the mean of the draws made a body" in run.out


# --- the command


@pytest.mark.parametrize("to", TARGETS)
def test_the_command_writes_the_same_bytes_again(
    folder: Path, to: str, tmp_path: Path, poseterior: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = poseterior("export", folder, "--to", to)
    name = f"{folder.name}{TARGETS[to].suffix}"
    assert (run.code, run.err) == (0, "")
    assert run.out.startswith(f"Written to {name}: 3 hypotheses, in {TARGETS[to].units[0]}")
    before = (tmp_path / name).read_bytes()
    poseterior("export", folder, "--to", to)
    assert (tmp_path / name).read_bytes() == before


def test_json_and_the_warning_of_a_gap(stream: Path, tmp_path: Path, poseterior: Cli) -> None:
    out = tmp_path / "walk.bvh"
    run = poseterior(
        "export", stream, "--to", "bvh", "--person", 0, "--rate", 25, "--out", out, "--json"
    )
    assert run.code == 0
    said = json.loads(run.out)
    assert (said["missing"], said["rate"], said["unit"]) == (1, 25, "m")
    assert "1 of 3 frames have no pose" in run.err
    assert read_bvh(out).rate == pytest.approx(25)
    assert np.isfinite(bvh_joints(out)).all()


FLAT = {name: [0.1 * number, 0, 0] for number, name in enumerate(JOINTS)}
REFUSALS = [
    ("unknown target", "@ --to fbx", r"invalid value for '--to'.*bvh.*c3d"),
    ("no target", "@", "missing option '--to'"),
    ("nothing there", "nowhere --to bvh", "no result at nowhere; give a hypotheses.json, a post"),
    ("no height", "@ --to csv --height 0", "0 is not the height of a person in metres"),
    ("negative height", "@ --to csv --height -1", "-1 is not the height of a person"),
    ("not a number", "@ --to csv --height nan", "nan is not the height of a person"),
    ("centimetres", "@ --to csv --height 175", "175 is not .* from 0.2 to 3; give"),
    ("too many draws", "@/posterior.nc --to csv --draws 201", "holds 200 draws, not 201; give ano"),
    ("no draws", "@/posterior.nc --to csv --draws 0", "holds 200 draws, not 0; give another"),
    ("draws of json", "@/hypotheses.json --to csv --draws 1", "holds hypotheses, not draws; leave"),
    ("too many", "@/hypotheses.json --to csv --k 4", "holds 3 hypotheses, not 4; give another --k"),
    ("too many of draws", "@/posterior.nc --to csv --k 201", "201 hypotheses cannot be chosen am"),
    ("both", "@/posterior.nc --to csv --k 2 --draws 2", "--k hypotheses or --draws single draws"),
    ("millimetres of glTF", "@ --to gltf --unit mm", "gltf is in m by definition; leave --unit mm"),
    (
        "rate",
        "@ --to bvh --rate 0",
        "0 frames a second is no rate, from 0.001 to 100000; give --ra",
    ),
    ("infinite rate", "@ --to bvh --rate inf", "inf frames a second is no rate, from"),
    ("rate of nothing", "@ --to c3d --rate 1e-300", "1e-300 frames a second is no rate, from"),
    ("rate of a film", "# --to c3d --person 0 --rate 1e-300", "1e-300 frames a second is no rate"),
    (
        "over itself",
        "near.json --to csv --out near.json",
        "would replace what is read from near.json",
    ),
    (
        "over a part",
        "result --to csv --out result/hypotheses.json",
        "replace what is read from resu",
    ),
    (
        "over a film",
        "film --to npz --out film/block-000000.nc",
        "would replace what is read from fi",
    ),
    ("what of one", "@ --to csv --what mean", "is no film of frames; leave --what out"),
    (
        "path of one",
        "@ --to csv --path-number 1",
        "is no film, which alone has paths; leave --path-number out",
    ),
    ("what else", "# --to csv --person 0 --what mode", r"'--what'.*mean.*hypothesis"),
    (
        "filter",
        "# --to csv --person 0 --smooth gauss",
        "no filter 'gauss'; choose one of butterworth",
    ),
    (
        "no number",
        "# --to csv --person 0 --smooth savgol:x",
        "no filter; after the colon .*savgol:15",
    ),
    ("even", "# --to csv --person 0 --rate 9 --smooth savgol:4", "after the colon .*frames, odd"),
    (
        "nothing left",
        "# --to csv --person 0 --smooth butterworth:0",
        "after the colon .*butterworth:6",
    ),
    (
        "filter of one",
        "@ --to csv --rate 25 --smooth savgol",
        "--smooth is for films, and these poses",
    ),
    ("no rate", "# --to csv --person 0 --smooth savgol", "needs to know how many frames a second"),
    ("too quick", "# --to csv --person 0 --rate 10 --smooth butterworth:6", "less than 5 Hz"),
    ("person", "@ --to bvh --person 0", "is of one person; leave --person out"),
    ("two people", "# --to bvh", "a film of 2 people; choose one with `person`"),
    ("nobody", "# --to bvh --person 7", "has no person 7; choose one of 0, 1"),
    ("draws of a film", "# --to bvh --person 0 --draws 3", "is a stream: .* leave --draws and --k"),
    ("empty folder", "empty --to bvh", "empty is a folder without a result; give a hypo"),
    ("a picture", "photo.png --to bvh", "photo.png is no posterior.nc of poseterior, or is trun"),
    ("another JSON", "other.json --to bvh", r"not a hypotheses.json of poseterior \(KeyError\)"),
    ("no body", "flat.json --to bvh", "a pose with a bone of length zero, or a flat torso"),
    ("infinity", "far.json --to bvh", "has a joint that is not at a finite place"),
    ("draws far away", "far.nc --to bvh", "has a joint that is not at a finite place"),
    ("folder as out", "@ --to bvh --out empty", "empty is a folder; --out needs the name of a f"),
]


@pytest.mark.parametrize(("name", "line", "match"), REFUSALS, ids=[one[0] for one in REFUSALS])
def test_refusals(
    name: str,
    line: str,
    match: str,
    folder: Path,
    stream: Path,
    tmp_path: Path,
    poseterior: Cli,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "other.json").write_text('{"people": []}')
    far = {**FLAT, "head": [float("inf"), 0, 0]}
    for file, joints in (("flat", FLAT), ("far", far)):
        entry = {"joints": joints, "weight": 1.0, "draw": 0}
        (tmp_path / f"{file}.json").write_text(json.dumps({"hypotheses": [entry]}))
    places = (("chain", "draw", "joint", "axis"), np.full((1, 3, 15, 3), 1e300))
    xr.Dataset({"joints": places}).to_netcdf(tmp_path / "far.nc", group="posterior")
    (tmp_path / "result").mkdir()
    for name_of in ("near.json", "result/hypotheses.json"):
        shutil.copy(folder / "hypotheses.json", tmp_path / name_of)
    shutil.copytree(stream, tmp_path / "film")
    line = line.replace("@", str(folder)).replace("#", str(stream))
    before = sorted(tmp_path.iterdir())
    run = poseterior("export", *line.split(), "--quiet")
    assert run.code == 2
    assert len(run.err.splitlines()) == 1
    assert re.search(match, run.err), run.err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("to", "package"), [("c3d", "c3d"), ("gltf", "pygltflib")])
def test_without_the_package_it_names_the_extra(
    folder: Path,
    tmp_path: Path,
    poseterior: Cli,
    monkeypatch: pytest.MonkeyPatch,
    to: str,
    package: str,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    run = poseterior("export", folder, "--to", to, "--out", tmp_path / "x")
    assert run.code == 2
    assert f"need the package {package}; pip install '.[export]' in a clone" in run.err
    assert not (tmp_path / "x").exists()
