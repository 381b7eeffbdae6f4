"""Data sets: what readers give back of files the test writes, what cameras and noise do, what is
refused."""

import dataclasses
import itertools
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import kstest, norm, t

from poseterior.probmodel import BadInput, Likelihood
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.datasets import (
    EXACT,
    VIEWS,
    DataSet,
    Noise,
    View,
    body_height,
    from_motions,
    read_data_set,
    write_plain,
)
from poseterior.probmodel.datasets.human36m import SEVENTEEN
from poseterior.probmodel.datasets.noise import HEAVY_FREEDOM
from poseterior.probmodel.datasets.pickles import follow
from poseterior.probmodel.datasets.views import resection
from poseterior.probmodel.errors.detector import DetectorErrors
from poseterior.probmodel.layouts import (
    H36M_17,
    MIDPOINTS,
    corrected,
    weights_of,
    without_midpoints,
)
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, LIMB_JOINTS, NUM_JOINTS

BODY = 330 * PoseDictionary.default().mean
"""A pose in millimetres, y up."""


def waving(seed: int, frames: int = 40) -> np.ndarray:
    """Poses `(frames, 15, 3)` that differ a little, smoothly."""
    rng = np.random.default_rng(seed)
    way = np.linspace(0, 1, frames)[:, None, None] * rng.normal(size=(NUM_JOINTS, 3)) * 30
    return BODY + way + 1000 * rng.normal(size=3)


MOTIONS = [
    Motion(waving(0), 30.0, "walking/one", "a"),
    Motion(waving(1), 30.0, "walking/two", "a"),
    Motion(waving(2, 7), 30.0, "running/one", "b"),
]


@pytest.fixture(scope="module")
def data() -> DataSet:
    return from_motions(MOTIONS, "three recordings", frames=60)


# --- motion capture


def test_every_action_gets_as_many_frames_and_none_the_same_twice(data):
    assert {action: int((data.action == action).sum()) for action in data.actions} == {
        "running": 30,
        "walking": 30,
    }
    assert set(data.recording[data.action == "walking"]) == {"walking/one", "walking/two"}
    pixels = np.stack([case.pixels for case in data])
    assert len(np.unique(pixels.round(6), axis=0)) == len(
        data
    )  # seven frames, but thirty views of them


def test_true_2d_is_the_projection_of_the_pose(data):
    for case in data:
        assert case.detection.keypoints == pytest.approx(case.pixels[:, :2], abs=1e-9)
        assert case.pose[0] == pytest.approx(0.0)


def test_a_pose_in_camera_axes_is_the_recorded_one_turned(data):
    recorded = MOTIONS[2].joints[0] - MOTIONS[2].joints[0, :1]
    rotation, distance = Rotation.align_vectors(data.poses[0], recorded)
    assert distance == pytest.approx(0.0, abs=1e-3)
    assert rotation.as_matrix() == pytest.approx(np.asarray(VIEWS[0].camera.rotation), abs=1e-9)


def test_a_person_who_faces_the_camera_stands_upright_and_looks_at_it():
    seen = View(0.0, 0.0).see(BODY)
    head, left_hip = JOINTS.index("head"), JOINTS.index("left_hip")
    assert seen[head, 1] < -400  # y points down
    assert seen[left_hip, 0] > 50  # the person's left is the image's right
    assert np.linalg.det(np.asarray(View(31.0, -12.0).camera.rotation)) == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_noise_and_larger_noise_is_the_same_enlarged():
    def errors(size: float, seed: int = 0) -> np.ndarray:
        noisy = from_motions(MOTIONS, "x", frames=20, noise=Noise("gaussian", size), seed=seed)
        return noisy.keypoints - from_motions(MOTIONS, "x", frames=20).keypoints

    assert np.array_equal(errors(0.02), errors(0.02))
    assert errors(0.04) == pytest.approx(2 * errors(0.02))
    assert np.abs(errors(0.02, seed=1) - errors(0.02)).min() > 0


@pytest.mark.parametrize(
    ("noise", "law"),
    [
        (Noise("gaussian", 0.02), norm(scale=0.02)),
        (Noise("heavy-tailed", 0.02), t(HEAVY_FREEDOM, scale=0.02)),
    ],
)
def test_noise_has_the_law_it_says(noise, law):
    """Kolmogorov–Smirnov, 6,000 numbers; false alarm 1e-3 each. Twice the size must fail, and so
    must the other law."""
    errors = np.concatenate([noise.errors(1.0, 7, number).ravel() for number in range(200)])
    assert kstest(errors, law.cdf).pvalue > 1e-3
    assert kstest(2 * errors, law.cdf).pvalue < 1e-6
    other = t(HEAVY_FREEDOM, scale=0.02) if noise.kind == "gaussian" else norm(scale=0.02)
    assert kstest(errors, other.cdf).pvalue < 1e-6


def test_missing_joints_are_limb_joints_nested_and_every_one_has_its_turn(data):
    case = data.case(3)
    gone = [set(np.flatnonzero(~case.hiding(number).detection.seen)) for number in range(9)]
    assert [len(joints) for joints in gone] == list(range(9))
    assert all(few <= more for few, more in itertools.pairwise(gone))
    assert gone[8] == set(LIMB_JOINTS)
    first = [int(np.flatnonzero(~case.hiding(1).detection.seen)[0]) for case in data]
    assert set(first) == set(LIMB_JOINTS)
    with pytest.raises(BadInput, match="9 limb joints cannot be missing"):
        case.hiding(9)


def test_a_turned_case_is_seen_by_a_rolled_camera(data):
    case = data.case(5).hiding(1)
    turned = case.turned(90.0)
    seen = case.detection.seen
    assert turned.detection.keypoints[seen] == pytest.approx(turned.pixels[seen, :2], abs=1e-9)
    right, down = turned.pose[8, 0], turned.pose[8, 1]
    assert (right, down) == pytest.approx((-case.pose[8, 1], case.pose[8, 0]))
    assert np.array_equal(np.isnan(turned.detection.keypoints), np.isnan(case.detection.keypoints))


def test_height_does_not_depend_on_the_pose_and_units_are_checked(data):
    assert body_height(BODY[None]) == pytest.approx(body_height(data.case(0).pose), rel=0.1)
    for factor, words in ((0.001, r"0\.00\d+"), (1000.0, r"1,\d\d\d")):
        with pytest.raises(BadInput, match=f"subject 'a' would be {words} m tall"):
            dataclasses.replace(data, poses=data.poses * factor, subject=np.full(len(data), "a"))


def test_real_motion_capture_is_read(shared_data):
    found = read_data_set(shared_data / "cmu" / "actions_train.npz", frames=80)
    assert len(found) == 80
    assert len(found.actions) == 8
    assert 1500 < np.median(body_height(found.poses)) < 1900
    trials = read_data_set(shared_data / "cmu" / "asfamc" / "02", frames=6)
    assert trials.actions == ["subject 02"]


# --- a plain file


def test_a_plain_file_gives_back_what_was_written(data, tmp_path):
    write_plain(data, tmp_path / "set.npz")
    back = read_data_set(tmp_path / "set.npz")
    assert back.sha256 == data.sha256
    assert len(read_data_set(tmp_path / "set.npz", frames=10)) == 10


# --- midpoints


BOTH, EVERY = ("thorax", "pelvis"), tuple(range(NUM_JOINTS))


def with_midpoints(joints: np.ndarray) -> np.ndarray:
    """Joints of a detector that has no thorax and no pelvis of its own."""
    halfway = joints.copy()
    for name, sides in MIDPOINTS.items():
        ends = [JOINT_INDEX[side] for side in sides]
        halfway[:, JOINT_INDEX[name]] = joints[:, ends].mean(axis=1)
    return halfway


NEAR = Lens(1100.0, np.array([400.0, 300.0]))


@pytest.mark.parametrize("lens", [pytest.param(None, id="far"), pytest.param(NEAR, id="near")])
def test_cases_have_the_skeletons_thorax_and_pelvis(data, lens):
    """By hand: two joints of the pose have moved, the camera is where it was, the others are seen
    where they were, and the detection is what `corrected` makes of it, so that the law is wider."""
    camera = lens and Lens(*(np.repeat([column], len(data), axis=0) for column in lens))
    poses = with_midpoints(data.poses)
    poses -= poses[:, :1]
    midway = dataclasses.replace(
        data,
        poses=poses,
        keypoints=with_midpoints(data.keypoints),
        lens=camera,
        midpoints=BOTH,
    )
    for number in range(0, len(data), 7):
        case, plainly = midway.case(number), dataclasses.replace(midway, midpoints=()).case(number)
        moved = without_midpoints(poses[number], BOTH)
        assert case.pose == pytest.approx(moved - moved[0], abs=1e-9)
        assert case.pixels[2:, :2] == pytest.approx(plainly.pixels[2:, :2], abs=1e-6)
        assert case.pixels[:2, :2] == pytest.approx(plainly.image(moved)[:2], abs=1e-6)
        if lens is not None:  # the pelvis is as far as its scale says
            far = lens.focal / plainly.scale + moved[0, 2]
            assert case.scale == pytest.approx(lens.focal / far)
        again = corrected(plainly.detection, BOTH)
        assert case.detection.moved == again.moved == BOTH
        np.testing.assert_array_equal(case.detection.keypoints, again.keypoints)
        law, at = Likelihood.of(DetectorErrors.default(), EVERY), plainly.scale * plainly.unit
        wider = law.spread(case.detection, at) / law.spread(plainly.detection, at)
        assert (wider[:2] > 1.01).all()
        assert wider[2:] == pytest.approx(1.0)
    assert midway.sha256 != dataclasses.replace(midway, midpoints=()).sha256
    assert midway.corrected(midway.poses)[7] == pytest.approx(midway.case(7).pose, abs=1e-9)
    with pytest.raises(BadInput, match="the midpoints are 'neck'; name thorax and pelvis"):
        dataclasses.replace(midway, midpoints=("neck",))


def test_a_midpoint_whose_counterpart_is_hidden_stays(data):
    keypoints, score = data.keypoints.copy(), data.score.copy()
    keypoints[:, 1], score[:, 1] = np.nan, 0.0
    midway = dataclasses.replace(data, keypoints=keypoints, score=score, midpoints=BOTH)
    detection = midway.case(0).detection
    assert detection.moved == ()
    np.testing.assert_array_equal(detection.keypoints, keypoints[0])


def test_a_plain_file_says_its_midpoints(data, tmp_path):
    midway = dataclasses.replace(data, midpoints=BOTH)
    write_plain(midway, tmp_path / "set.npz")
    back = read_data_set(tmp_path / "set.npz")
    assert (back.midpoints, back.sha256) == (BOTH, midway.sha256)
    np.savez(tmp_path / "set.npz", **plain(data, midpoints=np.array(["pelvis"])))
    assert read_data_set(tmp_path / "set.npz").case(3).detection.moved == ("pelvis",)


def test_weights_are_the_slopes_of_what_is_moved():
    """By differences, across the image where nothing lies behind the line; ends of midpoints move
    these."""
    weights = weights_of(BOTH)
    flat = BODY[:, :2]
    for joint in range(2, NUM_JOINTS):
        step = np.zeros_like(flat)
        step[joint] = [1.0, 2.0]
        found = without_midpoints(with_midpoints((flat + step)[None]), BOTH)[0]
        found -= without_midpoints(with_midpoints(flat[None]), BOTH)[0]
        assert found == pytest.approx(weights[:, joint, None] * [1.0, 2.0], abs=1e-9)
    assert weights.sum(axis=1) == pytest.approx(1.0)
    np.testing.assert_array_equal(weights_of(()), np.eye(NUM_JOINTS))


# --- errors of the truth


def doubtful(data: DataSet) -> DataSet:
    """With errors of 20 mm in depth, of one that grows with the joint to the right."""
    size = np.zeros((len(data), NUM_JOINTS, 3, 3))
    size[..., 2, 2] = 400.0
    size[..., 0, 0] = np.arange(NUM_JOINTS) ** 2
    return dataclasses.replace(data, doubt=size)


def test_errors_of_the_truth_are_as_large_as_is_said(data):
    """Rooted ones, of 40,000; the pelvis has none, and a turned case has turned ones."""
    case = doubtful(data).case(3)
    for one, across in ((case, 0), (case.turned(90.0), 1)):
        errors = one.strays(np.random.default_rng(0), 40_000)
        assert errors[:, 0] == pytest.approx(0.0)
        size = errors.std(axis=0)
        assert size[1:, 2] == pytest.approx(20 * np.sqrt(2), rel=0.02)
        assert size[:, across] == pytest.approx(np.arange(NUM_JOINTS), rel=0.02)
        assert size[:, 1 - across] == pytest.approx(0.0, abs=1e-5)
    assert not data.case(3).strays(np.random.default_rng(0), 5).any()


def test_midpoints_err_as_their_ends_do(data):
    """The thorax is 0.876 of the shoulders' midpoint and 0.124 of the hips', which are the
    pelvis'."""
    midway = dataclasses.replace(doubtful(data), midpoints=("thorax",))
    doubt = midway.case(0).doubt
    shoulders, hips = 876**2 * (2**2 + 5**2) / 4e6, 124**2 * (9**2 + 12**2) / 4e6
    assert doubt[1, 1, 0, 0] == pytest.approx(shoulders + hips)
    assert doubt[1, 2, 2, 2] == pytest.approx(400 * 0.876 / 2)


def test_a_plain_file_says_its_errors(data, tmp_path):
    write_plain(doubtful(data), tmp_path / "set.npz")
    back = read_data_set(tmp_path / "set.npz")
    assert back.sha256 == doubtful(data).sha256 != data.sha256
    assert back.take(np.array([5, 3])).case(1).doubt == pytest.approx(doubtful(data).case(3).doubt)
    turn = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    there = turn @ doubtful(data).doubt @ turn.T
    np.savez(tmp_path / "set.npz", **plain(data, poses=data.poses @ turn.T, doubt=there))
    fitted = read_data_set(tmp_path / "set.npz")
    assert fitted.doubt == pytest.approx(doubtful(data).doubt, abs=1e-3)


def test_a_flat_body_has_no_back():
    """Shoulders and hips in one line: the pelvis moves along it, and stays a number."""
    flat = np.zeros((NUM_JOINTS, 3))
    flat[:, 0] = np.arange(NUM_JOINTS)
    assert np.isfinite(without_midpoints(flat, BOTH)).all()


def test_without_a_camera_one_is_fitted(data, tmp_path):
    """The 2D of a scaled orthographic camera gives its rotation back exactly; a turned world does
    not matter."""
    turn = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    np.savez(
        tmp_path / "set.npz",
        poses=data.poses @ turn.T + 500,
        keypoints=data.keypoints,
        action=data.action,
        subject=data.subject,
    )
    back = read_data_set(tmp_path / "set.npz")
    assert back.poses == pytest.approx(data.poses, abs=1e-6)
    assert back.scale == pytest.approx(data.scale)
    assert back.translation == pytest.approx(data.translation)
    assert np.isnan(resection(data.poses[:1], np.full((1, NUM_JOINTS, 2), np.nan))[1]).all()


def plain(data: DataSet, **changes: object) -> dict[str, object]:
    return {
        "poses": data.poses,
        "keypoints": data.keypoints,
        "action": data.action,
        "subject": data.subject,
    } | changes


def at(row: int, values: np.ndarray, other: object) -> np.ndarray:
    """`values` with something else in one row."""
    changed = values.copy()
    changed[row] = other
    return changed


REFUSED = {
    "another skeleton": (
        lambda d: plain(d, poses=d.poses[:, :13]),
        r"poses has shape \(60, 13, 3\)",
    ),
    "metres": (lambda d: plain(d, poses=d.poses / 1000), "m tall; poses must be in millimetres"),
    "no actions": (lambda d: {k: v for k, v in plain(d).items() if k != "action"}, "lacks action"),
    "an empty action": (lambda d: plain(d, action=at(7, d.action, " ")), "frame 7 has no action"),
    "too few actions": (lambda d: plain(d, action=d.action[:5]), "action must be 60 texts"),
    "actions as numbers": (lambda d: plain(d, action=np.arange(60)), "action must be 60 texts"),
    "a frame of NaN": (lambda d: plain(d, poses=at(4, d.poses, np.nan)), "frame 4 has a coord"),
    "too few keypoints": (lambda d: plain(d, keypoints=d.keypoints[:9]), "60 poses, but 9 sets"),
    "scores of another shape": (lambda d: plain(d, score=np.ones(60)), r"score has shape \(60,\)"),
    "scores as text": (lambda d: plain(d, score=np.full((60, 15), "1")), "score has shape"),
    "a scale as text": (
        lambda d: plain(d, scale=np.full(60, "1"), translation=np.zeros((60, 2))),
        "scale has shape",
    ),
    "a translation as text": (
        lambda d: plain(d, scale=np.ones(60), translation=np.full((60, 2), "1")),
        "translation has shape",
    ),
    "an infinite score": (lambda d: plain(d, score=np.full((60, 15), np.inf)), "number beyond"),
    "a subject that no terminal should see": (
        lambda d: plain(d, subject=np.full(60, "a\x1b[31m")),
        "which is no name",
    ),
    "midpoints of numbers": (lambda d: plain(d, midpoints=np.ones(2)), "midpoints must be 2 texts"),
    "unknown midpoints": (
        lambda d: plain(d, midpoints=np.array(["spine"])),
        "the midpoints are 'spine'; name thorax and pelvis",
    ),
    "errors of no size": (
        lambda d: plain(d, doubt=np.full((60, 15, 3, 3), np.diag([1.0, 1.0, -1.0]))),
        "the doubt of frame 0 is no covariance",
    ),
    "errors that are not finite": (
        lambda d: plain(d, doubt=at(4, np.zeros((60, 15, 3, 3)), np.nan)),
        "the doubt of frame 4 is no covariance",
    ),
    "errors of another shape": (lambda d: plain(d, doubt=np.ones((60, 3))), "doubt has shape"),
    "no frames": (lambda d: {k: v[:0] for k, v in plain(d).items()}, "no frames"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_data_set_is_refused(case, data, tmp_path):
    make, words = REFUSED[case]
    np.savez(tmp_path / "set.npz", **make(data))
    with pytest.raises(BadInput, match=words):
        read_data_set(tmp_path / "set.npz")


def test_what_does_not_go_together_is_refused(data, tmp_path):
    write_plain(data, tmp_path / "set.npz")
    with pytest.raises(BadInput, match="brings its own 2D joints"):
        read_data_set(tmp_path / "set.npz", noise=Noise("gaussian", 0.1))
    with pytest.raises(BadInput, match="at least 1, not 0"):
        read_data_set(tmp_path / "set.npz", frames=0)
    (tmp_path / "films").mkdir()
    (tmp_path / "films" / "cam01.json").write_text("[]")
    with pytest.raises(BadInput, match=r"neither a file of motion .* nor the calibration of cam"):
        read_data_set(tmp_path / "films")
    with pytest.raises(BadInput, match="there is no motion capture"):
        read_data_set(tmp_path / "nothing")


@pytest.mark.parametrize(
    "text", ["gaussian", "gaussian:x", "gaussian:2", "gaussian:-1", "none:0.1", "uniform:0.1"]
)
def test_noise_that_is_none_is_refused(text):
    with pytest.raises(BadInput, match="must look like"):
        Noise.parse(text)


def test_noise_is_read():
    assert Noise.parse("none") == EXACT
    assert Noise.parse("heavy-tailed:0.05") == Noise("heavy-tailed", 0.05)


# --- Human3.6M


def human36m(folder: Path, poses: np.ndarray, protocol: int = 4, **changes: object) -> Path:
    """VideoPose3D's two files with two subjects, two actions of two takes, four cameras: metres, z
    up, 32 joints."""
    rng = np.random.default_rng(0)
    three: dict[str, dict[str, np.ndarray]] = {}
    two: dict[str, dict[str, list[np.ndarray]]] = {}
    rows = [H36M_17.points.index(name) for name in JOINTS]
    for subject in ("S1", "S11"):
        for action in ("Eating 1", "Eating 2", "Walking"):
            room = poses[:, :, [0, 2, 1]] * [1, -1, 1] / 1000 + rng.normal(size=3)
            joints = rng.normal(size=(len(poses), 32, 3))
            joints[:, np.array(SEVENTEEN)[rows]] = room
            three.setdefault(subject, {})[action] = joints.astype(np.float32)
            cameras = []
            for view in VIEWS[:4]:
                points = rng.normal(
                    size=(len(poses) + 3, 17, 2)
                )  # three frames more than the motion capture has
                points[:-3, rows] = 0.2 * view.see(poses)[..., :2] + 500
                cameras.append(points.astype(np.float32))
            two.setdefault(subject, {})[action] = cameras
    three, two = changes.get("three", three), changes.get("two", two)
    write_objects(folder / "data_3d_h36m.npz", protocol, positions_3d=three)
    metadata = {"layout_name": "h36m", "num_joints": 17, "keypoints_symmetry": [[4, 5], [1, 2]]}
    write_objects(folder / "data_2d_h36m_gt.npz", protocol, positions_2d=two, metadata=metadata)
    return folder


def write_objects(path: Path, protocol: int, **objects: object) -> None:
    """As np.savez_compressed writes objects, but in any protocol of pickle."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in objects.items():
            with archive.open(f"{name}.npy", "w") as file:
                array = np.array(value, dtype=object)
                np.lib.format.write_array_header_1_0(
                    file, np.lib.format.header_data_from_array_1_0(array)
                )
                pickle.dump(array, file, protocol=protocol)


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_human36m_is_read_without_unpickling(protocol, tmp_path, monkeypatch):
    poses = waving(5, 12)
    folder = human36m(tmp_path, poses, protocol)
    expected = np.load(folder / "data_3d_h36m.npz", allow_pickle=True)["positions_3d"].item()
    monkeypatch.setattr(pickle, "load", None)
    monkeypatch.setattr(pickle, "loads", None)
    found = read_data_set(folder)
    assert len(found) == 2 * 3 * 4 * 12
    assert found.actions == ["Eating", "Walking"]
    assert sorted(set(found.subject)) == ["S1", "S11"]
    assert len(set(found.recording)) == 6
    truth = np.concatenate([np.concatenate([view.see(poses) for view in VIEWS[:4]])] * 6)
    order = np.argsort(found.action == "Walking", kind="stable")
    assert np.array_equal(order, np.arange(len(found)))
    assert found.poses == pytest.approx(
        truth, abs=0.02
    )  # of single precision, and of metres off the room's origin
    assert found.scale == pytest.approx(0.2, abs=1e-4)
    assert {case.detection.moved for case in found} == {("pelvis",)}
    assert expected["S1"]["Walking"].shape == (12, 32, 3)
    few = read_data_set(folder / "data_3d_h36m.npz", frames=20)
    assert {action: int((few.action == action).sum()) for action in few.actions} == {
        "Eating": 10,
        "Walking": 10,
    }


def test_numpy_itself_writes_what_is_read(tmp_path):
    tree = {
        "S1": {"Eating": np.arange(6.0).reshape(1, 2, 3)},
        "list": [np.arange(3, dtype="<i4"), "ä", None, 2.5],
    }
    path = tmp_path / "any.npz"
    np.savez_compressed(path, positions=tree)
    from poseterior.probmodel.datasets.pickles import read_object

    found = read_object(path, "positions")
    assert np.array_equal(found["S1"]["Eating"], tree["S1"]["Eating"])
    assert np.array_equal(found["list"][0], [0, 1, 2])
    assert found["list"][1:] == ["ä", None, 2.5]


class Evil:
    """Whoever unpickles this makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return os.mkdir, (str(self.path),)


def test_a_pickle_that_would_run_code_is_refused_and_runs_nothing(tmp_path):
    folder = human36m(tmp_path, waving(5, 3), three={"S1": {"Eating": Evil(tmp_path / "made")}})
    with pytest.raises(BadInput, match="which plain data does not need"):
        read_data_set(folder)
    assert not (tmp_path / "made").exists()


def nested(depth: int) -> bytes:
    """A few bytes that stand for 10^depth texts."""
    value: list = ["x"]
    for _ in range(depth):
        value = [value] * 10
    return pickle.dumps(value)


def test_repetition_costs_nothing_and_damage_is_a_sentence():
    found = follow(nested(30), "a file")
    assert isinstance(found, list)
    whole = pickle.dumps({"a": np.arange(5.0), "b": ["x", 1, 2.0, None]})
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(400):  # whatever happens to the bytes, a value or BadInput comes out
        damaged = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        try:
            follow(bytes(damaged), "a file")
        except BadInput:
            refused += 1
    assert refused > 200
    loop: list = []
    loop.append(loop)
    with pytest.raises(BadInput, match="damaged"):
        follow(pickle.dumps(loop), "a file")


def _spoil(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place : place + 20] = bytes(20)
    path.write_bytes(data)


def _repack(path: Path, method: int) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


SLEEPER = np.zeros((3, 32, 3))
HUMAN_REFUSED = {
    "one file alone": (
        lambda f: (f / "data_2d_h36m_gt.npz").unlink(),
        "there is no data_2d_h36m_gt.npz",
    ),
    "a text": (
        lambda f: (f / "data_3d_h36m.npz").write_text("hello"),
        "is no file of positions_3d, or is truncated",
    ),
    "seventeen joints": (
        lambda f: human36m(f, waving(1, 3), three={"S1": {"Eating": np.zeros((3, 17, 3))}}),
        "17, 3",
    ),
    "no such action": (
        lambda f: human36m(f, waving(1, 3), three={"S1": {"Sleeping": SLEEPER}}),
        "lacks S1 Sl",
    ),
    "a list": (lambda f: human36m(f, waving(1, 3), three=[1, 2]), "not the dictionary"),
    "ragged lists": (
        lambda f: human36m(f, waving(1, 3), three={"S1": {"Eating": [[1.0, 2.0], [3.0]]}}),
        r"S1 Eating has \[\[1.0, 2.0\], \[3.0\]\], Human3.6M has",
    ),
    "numbers as names": (
        lambda f: human36m(f, waving(1, 3), three={1: {"Eating": np.zeros((3, 32, 3))}}),
        "a name in a dictionary is 1, not",
    ),
    "an empty subject": (lambda f: human36m(f, waving(1, 3), three={"S1": {}}), "hold no frame"),
    "takes without frames": (
        lambda f: human36m(f, waving(1, 3), three={"S1": {"Walking": np.zeros((0, 32, 3))}}),
        "hold no frame",
    ),
    "damaged deflate": (lambda f: _spoil(f / "data_3d_h36m.npz", 200), "or is truncated"),
    "another way of packing": (
        lambda f: _repack(f / "data_3d_h36m.npz", zipfile.ZIP_BZIP2),
        "packed in a way",
    ),
    "NaN": (lambda f: human36m(f, waving(1, 3) * np.nan), "coordinate that is not finite"),
}


@pytest.mark.parametrize("case", HUMAN_REFUSED)
def test_what_is_not_human36m_is_refused(case, tmp_path):
    spoil, words = HUMAN_REFUSED[case]
    human36m(tmp_path, waving(5, 3))
    spoil(tmp_path)
    with pytest.raises(BadInput, match=words):
        read_data_set(tmp_path)
