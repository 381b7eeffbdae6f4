"""What is said of a camera that is too near for weak perspective: by pinhole projections of bodies
made here, at distances that are known."""

import dataclasses

import numpy as np
import pytest

from poseterior.probmodel import Detection, Lens, PoseModel
from poseterior.probmodel.camera import FOCAL_MEDIAN
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS
from poseterior.reports.doubts import MILLIMETRES, NEAR, about_the_camera, farthest

SIZE = (1080, 1920)


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


def person(model: PoseModel, metres: float, turned: float = 0.0) -> Detection:
    """All bones of the mean length across the image, before a usual camera; or turned out of it."""
    low, high, alpha, beta = map(np.asarray, model.lengths)
    mean = low + (high - low) * alpha / (alpha + beta)
    joints = np.zeros((NUM_JOINTS, 2))
    for bone in BONES:
        across = mean[bone.length_group] * np.cos(np.radians(turned))
        joints[bone.end] = joints[bone.start] + [0.0, across]
    focal = FOCAL_MEDIAN * max(SIZE)
    keypoints = focal * joints * MILLIMETRES / 1000 / metres + np.array(SIZE) / 2
    return Detection(keypoints, np.ones(NUM_JOINTS), "skeleton_15", "made here", 0)


@pytest.mark.parametrize("metres", [1.0, 2.5, 8.0])
def test_the_farthest_is_never_nearer_than_the_person(model: PoseModel, metres: float) -> None:
    """And hardly farther, where bones lie across the image: by what lengths of people vary."""
    assert metres < farthest(person(model, metres), SIZE, model) < 1.3 * metres
    turned = farthest(person(model, metres, turned=60), SIZE, model)
    assert turned == pytest.approx(2 * farthest(person(model, metres), SIZE, model))


def test_two_wrong_keypoints_say_nothing(model: PoseModel) -> None:
    seen = person(model, 8.0)
    wrong = seen.keypoints.copy()
    for bone in [bone for bone in BONES if bone.name.endswith("forearm")][:2]:
        wrong[bone.end] += 900.0
    stray = dataclasses.replace(seen, keypoints=wrong)
    assert farthest(stray, SIZE, model) > NEAR


def test_a_near_camera_is_spoken_of(model: PoseModel) -> None:
    near, far = person(model, 1.5), person(model, 8.0)
    (sentence,) = about_the_camera([near], SIZE, model)
    assert "within 1.8 m" in sentence
    assert "--focal" in sentence
    assert about_the_camera([far], SIZE, model) == []
    assert about_the_camera([near, far, far], SIZE, model) == []
    assert about_the_camera([near], None, model) == []
    assert about_the_camera([near], SIZE, model.seen_by(Lens(1000.0, np.array(SIZE) / 2))) == []


def test_who_is_hardly_seen_is_not_judged(model: PoseModel) -> None:
    seen = person(model, 1.5)
    score = np.zeros(NUM_JOINTS)
    score[:4] = 1.0
    keypoints = np.where(score[:, None] > 0, seen.keypoints, np.nan)
    hidden = dataclasses.replace(seen, keypoints=keypoints, score=score)
    assert np.isnan(farthest(hidden, SIZE, model))
    assert about_the_camera([hidden], SIZE, model) == []
