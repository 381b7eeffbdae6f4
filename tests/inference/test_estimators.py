"""All estimators by their one face; the dictionary estimator against known cameras; poses of others
from a file."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from poseterior import inference
from poseterior.inference.estimators import ESTIMATORS, dictionary, external
from poseterior.inference.estimators.points import Points
from poseterior.inference.estimators.zhou import fit_zhou
from poseterior.inference.studies.errors import mean_joint_error
from poseterior.probmodel import Anatomy, BadInput, Detection, Likelihood, PoseModel
from poseterior.probmodel.detections import LIMB_JOINTS
from poseterior.probmodel.example import example
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX, TORSO_JOINTS
from poseterior.reports.options import Estimation
from tests.scenes import camera, key

TORSOS = Anatomy.default().torsos
EXAMPLE = example()
MODEL = PoseModel()
METHODS = [*ESTIMATORS, "a file"]


@pytest.fixture
def method(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A named estimator, or a file with the example's true pose in millimetres."""
    if request.param != "a file":
        return request.param
    np.savez(tmp_path / "poses.npz", joints=EXAMPLE.joints[None] * 350.0 + [10.0, 20.0, 4000.0])
    return str(tmp_path / "poses.npz")


every_method = pytest.mark.parametrize("method", METHODS, indirect=True)


def whole(pose: np.ndarray, missing: Sequence[str] = (), person: int = 0) -> Detection:
    """All joints of a pose `(15, 3)` in camera axes, at 100 pixels a body unit."""
    score = np.full(NUM_JOINTS, 0.7)
    score[[JOINT_INDEX[name] for name in missing]] = 0.0
    keypoints = np.where(score[:, None] > 0, pose[:, :2] * 100 + 300, np.nan)
    return Detection(keypoints, score, "synthetic", "a pose", person)


# --- the one face


@every_method
def test_a_frame_has_what_it_promises(method):
    """Proper rotations, torsos that project where the pose does, twins that face the other way,
    best one first."""
    frame = inference.estimate_torso(EXAMPLE.detection, method)
    assert frame.estimator == method
    assert frame.converged
    assert len(frame.candidates) == 2
    assert frame.pose is frame.candidates[0].pose
    for candidate in frame.candidates:
        rotation, scale = np.asarray(candidate.camera.rotation), float(candidate.camera.scale)
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert scale == pytest.approx(110, rel=0.3)
        assert candidate.pose.shape == (NUM_JOINTS, 3)
        assert candidate.pose[0] == pytest.approx(np.zeros(3), abs=1e-12)
        # One camera for the torso and for the pose.
        torso = np.asarray(candidate.camera.view(candidate.torso))
        assert torso == pytest.approx(candidate.pose[list(TORSO_INDEX)], abs=1e-9)
        offset = (
            np.asarray(candidate.camera.project(candidate.torso))
            - EXAMPLE.detection.keypoints[list(TORSO_INDEX)]
        )
        square = np.average(
            np.sum(offset**2, axis=1), weights=EXAMPLE.detection.score[list(TORSO_INDEX)]
        )
        assert candidate.reprojection_error == pytest.approx(np.sqrt(square), rel=1e-6)
        assert candidate.reprojection_error < 0.15 * scale
    assert frame.candidates[0].objective <= frame.candidates[1].objective
    one, two = (candidate.facing for candidate in frame.candidates)
    assert np.degrees(np.arccos(np.clip(one @ two, -1, 1))) > 3


@every_method
def test_poses_can_be_drawn_under_every_estimate(method):
    """`sample` draws from the mixture over an estimate's candidates; the draws explain what was
    seen."""
    frame = inference.estimate_torso(EXAMPLE.detection, method)
    result = inference.sample(
        MODEL, frame, key=key(0), num_samples=200, max_proposals=20_000_000, root="candidates"
    )
    assert result.status == "complete"
    assert float(result.tree["constant_data"].weight.sum()) == pytest.approx(1.0)
    for index, candidate in enumerate(frame.candidates):
        drawn = np.asarray(result.tree["posterior"].candidate)[0] == index
        joints = np.asarray(result.tree["posterior"].joints)[0][drawn]
        assert np.asarray(
            frame.likelihood.observe(frame.detection, candidate.root).explains(joints)
        ).all()


@pytest.mark.parametrize("method", list(ESTIMATORS))
def test_many_at_once_are_what_each_is_alone(method):
    rng = np.random.default_rng(0)
    many = [
        whole(
            np.asarray(camera(40 * row, 10).view(PoseDictionary.default().mean))
            + rng.normal(size=(15, 3)) * 0.05,
            missing=["left_wrist"] * (row % 2),
        )
        for row in range(4)
    ]
    together = inference.estimate_torsos(many, method)
    assert inference.estimate_torsos([], method) == []
    for detection_, frame in zip(many, together, strict=True):
        alone = inference.estimate_torso(detection_, method)
        assert len(alone.candidates) == len(frame.candidates)
        assert alone.pose == pytest.approx(frame.pose, abs=1e-5)


@pytest.mark.parametrize("method", ["akhter-black", "zhou"])
def test_the_best_of_the_candidates_is_near_the_truth(method):
    """The example's pose, a wrist missing and 5 % noise: under 0.3 body units off, and nearer than
    the mean pose."""
    frame = inference.estimate_torso(EXAMPLE.detection, method)
    error = min(mean_joint_error(candidate.pose, EXAMPLE.joints) for candidate in frame.candidates)
    assert error < 0.3
    assert error < mean_joint_error(PoseDictionary.default().mean, EXAMPLE.joints)


LINE = np.outer(np.linspace(0, 1, NUM_JOINTS), [1.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("detected", "match"),
    [
        (whole(EXAMPLE.joints, TORSO_JOINTS), "no joint of the torso|too few torso joints"),
        (
            whole(EXAMPLE.joints, JOINTS[3:]),
            "at least 4 joints|too few torso joints|shows pelvis, thorax, right_shoulder",
        ),
        (whole(EXAMPLE.joints, JOINTS[2:]), "at least 4 joints|too few torso joints"),
        (whole(LINE), "all lie on one line"),
        (whole(LINE * 0), "all lie on one point"),
        (whole(LINE * 1e-9), "all lie on one point"),
    ],
    ids=["no torso", "three joints", "two joints", "a line", "a point", "nearly a point"],
)
@every_method
def test_too_little_to_see_is_refused(method, detected, match, request):
    if "three joints" in request.node.name and method == "dictionary":
        # Three torso joints that are not on one line are enough for a camera, and it needs no more.
        assert inference.estimate_torso(detected, method).converged
        return
    with pytest.raises(BadInput, match=match):
        inference.estimate_torso(detected, method)


def test_what_did_not_converge_is_said(monkeypatch, capsys):
    """In the frame, and by the command line, which goes on with the best iterate."""
    monkeypatch.setitem(
        ESTIMATORS, "zhou", lambda many, known: fit_zhou(many, known.poses, max_iterations=5)
    )
    frame = Estimation(estimator="zhou").estimate(EXAMPLE.detection, MODEL)
    assert not frame.converged
    assert np.isfinite(frame.pose).all()
    assert "zhou did not converge for person 0 of" in capsys.readouterr().err
    assert Estimation(estimator="akhter-black").estimate(EXAMPLE.detection, MODEL).converged
    assert capsys.readouterr().err == ""


def test_a_dictionary_for_another_skeleton_is_refused(tmp_path):
    np.savez(
        tmp_path / "other.npz",
        joints=np.array(["hip", "knee"]),
        **dataclasses.asdict(PoseDictionary.default()),
    )
    with pytest.raises(BadInput, match="another skeleton, of 2 joints"):
        Estimation(estimator="zhou", poses=str(tmp_path / "other.npz")).estimate(
            EXAMPLE.detection, MODEL
        )


def test_another_dictionary_gives_another_pose(tmp_path):
    default = PoseDictionary.default()
    dataclasses.replace(default, atoms=default.atoms[:20]).save(tmp_path / "few.npz")
    one, other = (
        Estimation(estimator="zhou", poses=poses).estimate(EXAMPLE.detection, MODEL)
        for poses in ("default", str(tmp_path / "few.npz"))
    )
    assert np.abs(one.pose - other.pose).max() > 0.01


# --- poses of others


def stored(tmp_path: Path, **arrays: np.ndarray) -> str:
    np.savez(tmp_path / "poses.npz", **arrays)
    return str(tmp_path / "poses.npz")


def test_the_true_pose_from_a_file_is_found_exactly(tmp_path):
    """Whatever its unit and place, by row for each person, in another order if named, and among
    alternatives."""
    truth, rng = EXAMPLE.joints, np.random.default_rng(1)
    seen, second = whole(truth), whole(truth, person=1)
    other = rng.normal(size=truth.shape)
    order = rng.permutation(NUM_JOINTS)
    files = {
        "one": {"joints": truth},
        "people": {"joints": np.stack([other, truth]) * 1000 + 7.0},
        "named": {"joints": truth[order], "names": np.array(JOINTS)[order]},
        "more joints": {
            "joints": np.concatenate([other[:2], truth]),
            "names": np.array(["left_ear", "nose", *JOINTS]),
        },
        "alternatives": {"joints": np.stack([other, truth, truth + 0.2 * other])[None]},
    }
    for name, arrays in files.items():
        target = second if name == "people" else seen
        frame = inference.estimate_torso(target, stored(tmp_path, **arrays))
        assert np.asarray(
            frame.candidates[0].camera.view(frame.candidates[0].torso)
        ) == pytest.approx(frame.pose[list(TORSO_INDEX)], abs=1e-9)
        assert mean_joint_error(frame.pose, truth) == pytest.approx(0.0, abs=1e-6), name
        assert frame.candidates[0].reprojection_error < 1e-4
        assert float(frame.candidates[0].camera.scale) * frame.pose == pytest.approx(
            100 * truth, abs=1e-3
        )
    np.save(tmp_path / "poses.npy", truth)
    assert (
        mean_joint_error(inference.estimate_torso(seen, str(tmp_path / "poses.npy")).pose, truth)
        < 1e-6
    )


def test_missing_joints_do_not_count_in_the_placing(tmp_path):
    path = stored(tmp_path, joints=EXAMPLE.joints)
    for joint in LIMB_JOINTS:
        frame = inference.estimate_torso(whole(EXAMPLE.joints, [JOINTS[joint]]), path)
        assert frame.candidates[0].reprojection_error < 1e-4


@pytest.mark.parametrize(
    ("arrays", "match"),
    [
        ({"poses": EXAMPLE.joints}, "holds no array `joints`"),
        ({"joints": np.zeros((4, 17, 3))}, r"joints have shape \(4, 17, 3\); give an .npz"),
        ({"joints": np.zeros((15, 2))}, "joints have shape"),
        ({"joints": np.zeros((0, 15, 3))}, "at least one pose"),
        ({"joints": np.full((15, 3), np.nan)}, "must be finite"),
        ({"joints": np.full((15, 3), 1e12)}, "must be finite, at most"),
        ({"joints": np.array("standing")}, "joints have shape"),
        ({"joints": np.zeros((15, 3))}, "on one point, so that its scale is zero"),
        ({"joints": np.ones((3, 15, 3)) * 5}, "person 0: all joints of a pose lie on one point"),
        ({"joints": EXAMPLE.joints, "names": np.array(JOINTS[:3])}, "names lack right_elbow"),
        (
            {"joints": EXAMPLE.joints[:9], "names": np.array(JOINTS)},
            "15 names, but joints have shape",
        ),
    ],
)
def test_files_that_are_not_poses_are_refused(arrays, match, tmp_path):
    with pytest.raises(BadInput, match=match):
        inference.estimate_torso(whole(EXAMPLE.joints), stored(tmp_path, **arrays))


def test_files_that_are_not_there_or_hold_too_few_are_refused(tmp_path):
    with pytest.raises(BadInput, match="there is no file of poses at"):
        inference.estimate_torso(whole(EXAMPLE.joints), str(tmp_path / "none.npy"))
    with pytest.raises(BadInput, match="there is no file of poses at"):
        inference.estimate_torso(whole(EXAMPLE.joints), str(tmp_path / "none.npz"))
    (tmp_path / "text.npy").write_text("a pose")
    with pytest.raises(BadInput, match="is no file of poses"):
        inference.estimate_torso(whole(EXAMPLE.joints), str(tmp_path / "text.npy"))
    path = stored(tmp_path, joints=EXAMPLE.joints[None])
    with pytest.raises(BadInput, match="hold 1 people, so none for person 2 of"):
        inference.estimate_torso(whole(EXAMPLE.joints, person=2), path)
    assert external.read_poses(path).shape == (1, 1, NUM_JOINTS, 3)


# --- the dictionary of torsos


def detection(torso, view, missing=(), noise=0.0, seed=0, scores=(0.9,) * 6) -> Detection:
    """The torso joints alone, projected, with Gaussian noise in pixels."""
    keypoints, score = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    image = (
        np.asarray(view.project(torso)) + np.random.default_rng(seed).normal(size=(6, 2)) * noise
    )
    for joint, name, point, own in zip(TORSO_INDEX, TORSO_JOINTS, image, scores, strict=True):
        if name not in missing:
            keypoints[joint], score[joint] = point, own
    return Detection(keypoints, score, "synthetic", "a torso", 0)


@pytest.mark.parametrize("yaw", [0, 50, 130, 180, 220, 290])
@pytest.mark.parametrize("missing", [(), ("left_hip",), ("pelvis", "thorax", "right_shoulder")])
def test_a_torso_of_the_dictionary_is_recovered_exactly(yaw, missing):
    """Noise-free: one candidate has the torso, the rotation, the scale and the translation, unless
    three joints are missing, which other torsos then fit as well."""
    view = camera(yaw, 15.0)
    frame = inference.estimate_torso(detection(TORSOS[7], view, missing))
    assert frame.candidates[0].reprojection_error < 1e-3
    if len(missing) < 3:
        errors = [
            np.abs(np.asarray(c.camera.rotation) - view.rotation).max() for c in frame.candidates
        ]
        best = frame.candidates[int(np.argmin(errors))]
        assert min(errors) < 1e-4
        assert best.torso_index == 7
        assert best.camera.scale == pytest.approx(view.scale, rel=1e-5)
        assert best.camera.translation == pytest.approx(view.translation, abs=1e-2)


def test_rotations_are_proper_and_errors_are_sorted():
    frame = inference.estimate_torso(detection(TORSOS[3], camera(70), noise=4.0))
    assert len(frame.candidates) == 2
    for candidate in frame.candidates:
        rotation = np.asarray(candidate.camera.rotation)
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert frame.candidates[0].reprojection_error <= frame.candidates[1].reprojection_error


def test_the_fit_is_the_least_squares_fit():
    """Against SciPy's minimiser over rotation vector, log scale and translation, from many starts
    (second route), weighted by unequal scores; and its camera is the one that has this error."""
    scores = np.linspace(0.2, 1.0, 6)
    seen = detection(TORSOS[11], camera(40, -10), noise=6.0, seed=4, scores=scores)
    target = seen.keypoints[list(TORSO_INDEX)]

    def cost(parameters: np.ndarray, torso: np.ndarray) -> float:
        rows = Rotation.from_rotvec(parameters[:3]).as_matrix()[:2]
        residual = target - np.exp(parameters[3]) * torso @ rows.T - parameters[4:]
        return float(np.average(np.sum(residual**2, axis=1), weights=scores))

    rng = np.random.default_rng(0)
    best = np.inf
    fitted = inference.estimate_torso(seen).candidates[0]
    for _ in range(40):
        start = np.concatenate(
            [Rotation.random(rng=rng).as_rotvec(), [np.log(100)], target.mean(axis=0)]
        )
        best = min(best, minimize(cost, start, args=(fitted.torso,), method="BFGS").fun)
    assert fitted.reprojection_error**2 == pytest.approx(best, rel=1e-4)
    off = np.asarray(fitted.camera.project(fitted.torso)) - target
    by_camera = np.average(np.sum(off**2, axis=1), weights=scores)
    assert by_camera == pytest.approx(best, rel=1e-4)


def test_a_spinor_is_a_scaled_rotation():
    """Images, their derivatives, the mirror twin and the angle between two, by SciPy's rotations
    and by differences."""
    rng = np.random.default_rng(7)
    spinor = rng.normal(size=(20, 2)) + 1j * rng.normal(size=(20, 2))
    points = rng.normal(size=(20, 5, 3))
    plane, height = points[..., 0] + 1j * points[..., 1], points[..., 2]

    def turn(spinor: np.ndarray) -> Rotation:
        alpha, beta = spinor.T
        return Rotation.from_quat(np.stack([alpha.real, alpha.imag, beta.imag, beta.real], axis=1))

    scale = np.linalg.norm(spinor, axis=1) ** 2
    seen = scale[:, None, None] * points @ turn(spinor).as_matrix().swapaxes(1, 2)
    image = dictionary._images(plane, height, spinor)
    np.testing.assert_allclose(image, seen[..., 0] + 1j * seen[..., 1], atol=1e-12)
    for number, slope in enumerate(dictionary._slopes(plane, height, spinor).swapaxes(0, 1)):
        step = 1e-6 * np.eye(2)[number]
        ahead = dictionary._images(plane, height, spinor + step)
        behind = dictionary._images(plane, height, spinor - step)
        np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, atol=1e-7)
    mirror = np.diag([1.0, 1.0, -1.0])
    twin = turn(spinor * dictionary.TWIN).as_matrix()
    np.testing.assert_allclose(twin, mirror @ turn(spinor).as_matrix() @ mirror, atol=1e-12)
    apart = (turn(spinor).inv() * turn(spinor[:1])).magnitude()
    np.testing.assert_allclose(dictionary._angle(spinor, spinor[0]), apart, atol=1e-7)


def test_points_are_centred_and_sized_by_their_scores():
    """Weighted means, by NumPy's average; a missing joint has no weight, and weights average one
    over the others."""
    rng, scores = np.random.default_rng(3), np.linspace(0.2, 1.0, NUM_JOINTS)
    scores[4] = 0.0
    keypoints = np.where(scores[:, None] > 0, rng.normal(300, 50, (NUM_JOINTS, 2)), np.nan)
    points = Points.gather([Detection(keypoints, scores, "synthetic", "a body", 0)])
    rest = scores > 0
    middle = np.average(keypoints[rest], axis=0, weights=scores[rest])
    far = np.sum((keypoints[rest] - middle) ** 2, axis=1)
    size = np.sqrt(np.average(far, weights=scores[rest]))
    assert points.centre[0] == pytest.approx(middle)
    assert points.size[0] == pytest.approx(size)
    assert points.xy[0, rest] == pytest.approx((keypoints[rest] - middle) / size)
    assert points.weight[0, rest] == pytest.approx(scores[rest] / scores[rest].mean())
    assert points.weight[0, 4] == 0


def test_the_twin_is_reflected_in_depth_and_a_frontal_view_has_none_far_away():
    """From the side the two candidates face opposite ways; both explain the torso."""
    side = inference.estimate_torso(detection(TORSOS[0], camera(80), noise=2.0))
    one, two = (candidate.facing for candidate in side.candidates)
    assert one[0] * two[0] < 0
    assert one[2] * two[2] > 0
    front = inference.estimate_torso(detection(TORSOS[0], camera(0), noise=0.0))
    assert all(candidate.facing[2] < -0.7 for candidate in front.candidates)


def test_one_candidate_is_the_papers_method():
    assert (
        len(inference.estimate_torso(detection(TORSOS[3], camera(70)), num_candidates=1).candidates)
        == 1
    )


def test_a_joint_outside_its_disc_takes_a_candidates_torso_likelihood_away():
    frame = inference.estimate_torso(detection(TORSOS[3], camera(70), noise=2.0))
    inside = frame.candidates[0]
    assert np.isfinite(frame.likelihood.log_torso(frame.detection, inside.root))
    moved = dataclasses.replace(
        inside, camera=inside.camera._replace(translation=inside.camera.translation + 200.0)
    )
    assert frame.likelihood.log_torso(frame.detection, moved.root) == -np.inf


@pytest.mark.parametrize(
    "missing",
    [
        TORSO_JOINTS,
        ("pelvis", "right_hip", "left_hip"),
        ("right_shoulder", "left_shoulder", "thorax"),
        ("right_shoulder", "left_shoulder", "right_hip", "left_hip"),
    ],
)
def test_too_few_torso_joints_are_refused_with_what_is_needed(missing):
    with pytest.raises(BadInput, match="at least three of pelvis, thorax"):
        inference.estimate_torso(detection(TORSOS[0], camera(0), missing))


@pytest.mark.parametrize(
    ("options", "match"),
    [({"method": "guess"}, "no estimator 'guess'"), ({"num_candidates": 0}, "at least 1")],
)
def test_bad_options_are_refused(options, match):
    with pytest.raises(BadInput, match=match):
        inference.estimate_torso(detection(TORSOS[0], camera(0)), **options)


def test_the_head_can_be_left_out():
    """The paper's likelihood runs over limb joints only."""
    keypoints, score = np.full((NUM_JOINTS, 2), 300.0), np.full(NUM_JOINTS, 0.5)
    keypoints[list(TORSO_INDEX)] = np.asarray(camera(30).project(TORSOS[0]))
    frame = inference.estimate_torso(
        Detection(keypoints, score, "synthetic", "x", 0),
        likelihood=Likelihood(joints=LIMB_JOINTS),
    )
    seen = np.asarray(frame.observation.seen)
    assert not seen[JOINT_INDEX["head"]]
    assert seen.sum() == 8
