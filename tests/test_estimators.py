"""The dictionary estimator against known cameras, its twins, and torsos of which little is seen."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import inference
from probmodel import Anatomy, BadInput, Detection
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX, TORSO_JOINTS
from tests.scenes import camera

TORSOS = Anatomy.default().torsos


def detection(torso, view, missing=(), noise=0.0, seed=0) -> Detection:
    """The torso joints alone, projected, with Gaussian noise in pixels."""
    keypoints, score = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    image = np.asarray(view.project(torso)) + np.random.default_rng(seed).normal(size=(6, 2)) * noise
    for joint, name, point in zip(TORSO_INDEX, TORSO_JOINTS, image, strict=True):
        if name not in missing:
            keypoints[joint], score[joint] = point, 0.9
    return Detection(keypoints, score, "synthetic", "a torso", 0)


@pytest.mark.parametrize("yaw", [0, 50, 130, 180, 220, 290])
@pytest.mark.parametrize("missing", [(), ("left_hip",), ("pelvis", "thorax", "right_shoulder")])
def test_a_torso_of_the_dictionary_is_recovered_exactly(yaw, missing):
    """Noise-free: one candidate has the torso, the rotation, the scale and the translation, unless three joints are
    missing, which other torsos then fit as well."""
    view = camera(yaw, 15.0)
    frame = inference.estimate_torso(detection(TORSOS[7], view, missing))
    assert frame.candidates[0].reprojection_error < 1e-3
    if len(missing) < 3:
        errors = [np.abs(np.asarray(c.camera.rotation) - view.rotation).max() for c in frame.candidates]
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
    """Against SciPy's minimiser over rotation vector, log scale and translation, from many starts (second route)."""
    seen = detection(TORSOS[11], camera(40, -10), noise=6.0, seed=4)
    target = seen.keypoints[list(TORSO_INDEX)]

    def cost(parameters: np.ndarray, torso: np.ndarray) -> float:
        rows = Rotation.from_rotvec(parameters[:3]).as_matrix()[:2]
        residual = target - np.exp(parameters[3]) * torso @ rows.T - parameters[4:]
        return float(np.mean(np.sum(residual**2, axis=1)))

    rng = np.random.default_rng(0)
    best = np.inf
    fitted = inference.estimate_torso(seen).candidates[0]
    for _ in range(40):
        start = np.concatenate([Rotation.random(rng=rng).as_rotvec(), [np.log(100)], target.mean(axis=0)])
        best = min(best, minimize(cost, start, args=(fitted.torso,), method="BFGS").fun)
    assert fitted.reprojection_error**2 == pytest.approx(best, rel=1e-4)


def test_the_twin_is_reflected_in_depth_and_a_frontal_view_has_none_far_away():
    """From the side the two candidates face opposite ways; both explain the torso."""
    side = inference.estimate_torso(detection(TORSOS[0], camera(80), noise=2.0))
    one, two = (candidate.facing for candidate in side.candidates)
    assert one[0] * two[0] < 0
    assert one[2] * two[2] > 0
    front = inference.estimate_torso(detection(TORSOS[0], camera(0), noise=0.0))
    assert all(candidate.facing[2] < -0.7 for candidate in front.candidates)


def test_one_candidate_is_the_papers_method():
    assert len(inference.estimate_torso(detection(TORSOS[3], camera(70)), num_candidates=1).candidates) == 1


def test_a_joint_outside_its_disc_takes_a_candidates_torso_likelihood_away():
    frame = inference.estimate_torso(detection(TORSOS[3], camera(70), noise=2.0))
    inside = frame.candidates[0]
    assert np.isfinite(frame.log_torso_likelihood(inside))
    moved = dataclasses.replace(inside, camera=inside.camera._replace(translation=inside.camera.translation + 200.0))
    assert frame.log_torso_likelihood(moved) == -np.inf


@pytest.mark.parametrize(
    "missing",
    [TORSO_JOINTS, ("pelvis", "right_hip", "left_hip"), ("right_shoulder", "left_shoulder", "thorax"),
     ("right_shoulder", "left_shoulder", "right_hip", "left_hip")],
)  # fmt: skip
def test_too_few_torso_joints_are_refused_with_what_is_needed(missing):
    with pytest.raises(BadInput, match="at least three of pelvis, thorax"):
        inference.estimate_torso(detection(TORSOS[0], camera(0), missing))


@pytest.mark.parametrize(
    ("options", "match"), [({"method": "guess"}, "no estimator 'guess'"), ({"num_candidates": 0}, "at least 1")]
)
def test_bad_options_are_refused(options, match):
    with pytest.raises(BadInput, match=match):
        inference.estimate_torso(detection(TORSOS[0], camera(0)), **options)


def test_the_head_can_be_left_out():
    """The paper's likelihood runs over limb joints only."""
    keypoints, score = np.full((NUM_JOINTS, 2), 300.0), np.full(NUM_JOINTS, 0.5)
    keypoints[list(TORSO_INDEX)] = np.asarray(camera(30).project(TORSOS[0]))
    from probmodel.detections import LIMB_JOINTS

    frame = inference.estimate_torso(Detection(keypoints, score, "synthetic", "x", 0), joints=LIMB_JOINTS)
    seen = np.asarray(frame.observation(frame.candidates[0]).has_factor)
    assert not seen[JOINT_INDEX["head"]]
    assert seen.sum() == 8
