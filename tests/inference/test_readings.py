"""Readings: which exchanges can be told and which cannot, the face, and the evidence against the
exact sampler's."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from poseterior import inference
from poseterior.inference.face import HEADS, OUTWARD, POINTS, log_face_likelihood
from poseterior.inference.readings import (
    BETTER_BY,
    BODY,
    NOISE,
    READINGS,
    Judge,
    Verdict,
    exchanged,
    judge,
    stretched,
    together,
)
from poseterior.inference.studies.misreadings import FileView, mirrored, seen_as, views
from poseterior.probmodel import Anatomy, Detection, PoseModel, read_detections
from poseterior.probmodel.detections import FACE
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.layouts import COCO_17, H36M_17, MPII_16
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, MIRROR
from tests.probmodel.test_formats import HMR, POSE2SIM, SPIN
from tests.probmodel.test_formats_fuzz import points
from tests.probmodel.test_formats_readers import LUNGE
from tests.scenes import key, motion_scene
from tests.sweeps import sweep

EVERYONE = 10


@functools.cache
def model() -> PoseModel:
    return PoseModel.from_anatomy(Anatomy.default())


@functools.cache
def judging() -> Judge:
    return Judge(model())


def verdict(*people: Detection, sizes: bool = False) -> Verdict:
    return judging().file(people, sizes=sizes)


def standing(layout=COCO_17) -> Detection:
    """The person of the readers' tests, who faces the camera, in wider proportions: theirs are a
    child's drawing."""
    rows = points(layout)
    rows[:, 0] = 50 + (rows[:, 0] - 50) * 1.2
    return layout.detection(rows, 0.0, "a file", 0)


@functools.cache
def scenes(data: Path) -> tuple[FileView, ...]:
    return tuple(views(data / "cmu" / "actions_train.npz", EVERYONE, seed=11))


def test_the_cheap_evidence_is_the_exact_samplers(shared_data: Path) -> None:
    """Second route: exact rejection under the Gaussian law.

    Poses of motion capture in front of their true camera, as they are and with the legs exchanged.
    The law is cut at three standard deviations and the cheap evidence is a mean over draws:
    agreement is to half a nat of some 25, and to five under discs, which end sooner."""
    poses = np.load(shared_data / "cmu" / "actions_train.npz")["walking/walking_1"]
    pairs = []
    for at in (10, 40, 70):
        joints = poses[at, [*range(12), 13, 14, 15]].astype(float)
        frame = motion_scene(joints, 40.0, 0.0, 1)
        for parts in ((), ("knee", "ankle")):
            detection = exchanged(frame.detection, *parts)
            likelihood = Likelihood(Gaussian(), factor=2 * NOISE)
            result = inference.sample(
                model(),
                Estimate(detection, frame.candidates, likelihood),
                key=key(0),
                num_samples=300,
                max_proposals=30_000_000,
                root="candidates",
            )
            arms, legs = judging()._under(detection, frame.candidates[0])[2:]
            pairs.append((float(result.tree.attrs["log_evidence"]), arms[0] + legs[0]))
    np.testing.assert_allclose(*np.array(pairs).T, atol=0.8)


def test_an_exchange_is_its_own_inverse_and_moves_what_it_says() -> None:
    person = standing()
    for reading in READINGS:
        other = exchanged(person, *reading.parts)
        moved = {
            name
            for name, one, two in zip(JOINTS, person.keypoints, other.keypoints, strict=True)
            if not np.array_equal(one, two, equal_nan=True)
        }
        assert moved == {f"{side}_{part}" for part in reading.parts for side in ("left", "right")}
        np.testing.assert_array_equal(exchanged(other, *reading.parts).keypoints, person.keypoints)
    whole = exchanged(person, *BODY)
    np.testing.assert_array_equal(whole.keypoints, person.keypoints[list(MIRROR)])
    assert person.face is not None
    assert whole.face is not None
    np.testing.assert_array_equal(
        whole.face[FACE.index("left_ear")], person.face[FACE.index("right_ear")]
    )


def test_joints_alone_cannot_tell_left_from_right(shared_data: Path) -> None:
    """A body reflected in depth, left and right exchanged, is possible and projects to the same
    points: the evidence of the exchanged reading is that of the right one, but for the noise of the
    draws. So is the mirror image's."""
    differences = []
    for view in scenes(shared_data)[:2]:
        usual = judging().evidence(view.detection).body(0, 0)
        differences += [judging().evidence(exchanged(view.detection, *BODY)).body(0, 0) - usual]
        differences += [judging().evidence(mirrored(view.detection, 0)).body(0, 0) - usual]
    assert np.median(np.abs(differences)) < 0.6
    assert np.max(np.abs(differences)) < BETTER_BY + 1


def test_without_a_face_nothing_is_said_about_left_and_right() -> None:
    person = standing(MPII_16)
    assert person.face is None
    assert verdict(person, exchanged(person, *BODY)).noticed == ()


@pytest.mark.parametrize(
    "kind", sweep(["arms", "halves", "shoulders", "hips", "limbs"], ["arms", "hips"])
)
def test_exchanges_that_anatomy_tells(kind: str) -> None:
    person = standing()
    assert verdict(person).noticed == ()
    reading = next(reading for reading in READINGS if reading.name == kind)
    noticed = verdict(exchanged(person, *reading.parts)).noticed
    assert noticed
    assert noticed[0] in {reading.name for reading in READINGS}


def test_what_the_face_tells() -> None:
    person = standing()
    for wrong in (exchanged(person, *BODY), mirrored(person, 0)):
        said = verdict(wrong)
        assert said.noticed == ("whole",)
        assert "left and right seem to be exchanged, or the image mirrored" in said.warnings[0]


def test_upside_down_is_told_by_the_spine() -> None:
    assert verdict(mirrored(standing(), 1)).noticed == ("upside down",)


def test_a_wrong_order_is_told_by_the_fit() -> None:
    rows = points(COCO_17)
    wrong = [
        H36M_17.detection(rows, 0.0, "a file", 0),
        COCO_17.detection(rows[::-1], 0.0, "a file", 0),
    ]
    assert verdict(*wrong[:1]).noticed[0] == "order"
    assert verdict(*wrong[1:]).noticed


def test_a_wrong_size_is_looked_for_where_it_is_open(shared_data: Path) -> None:
    """A lunge, arms spread, on an image that is said to be 16/9 times too wide: one of the few that
    give it away."""
    (lunge,) = read_detections(shared_data / LUNGE, image_size=(1000, 667))
    wide = stretched(lunge, 16 / 9)
    assert verdict(lunge, sizes=True).noticed == ()
    assert "size" in verdict(wide, sizes=True).noticed
    assert "size" not in verdict(wide).names


def test_people_too_little_of_whom_is_seen_are_skipped_and_counted() -> None:
    person = standing()
    score = np.where(np.arange(15) == JOINT_INDEX["left_wrist"], 1.0, 0.0)
    hand = dataclasses.replace(
        person, keypoints=np.where(score[:, None] > 0, person.keypoints, np.nan), score=score
    )
    said = judge([hand, person], model())
    assert len(said.gains) == 1
    assert len(said.skipped) == 1
    assert verdict(hand).noticed == ()
    assert together([]).warnings == ()


def test_real_people_read_rightly_are_not_doubted(shared_data: Path) -> None:
    for file in (SPIN, HMR):
        assert verdict(*read_detections(shared_data / file)).noticed == (), file


@pytest.mark.slow
def test_real_people_read_wrongly_are(shared_data: Path) -> None:
    """Seen from the side (SPIN), from behind (HMR, no face found), from the front."""
    for file in (SPIN, HMR, POSE2SIM):
        people = [exchanged(person, *BODY) for person in read_detections(shared_data / file)]
        assert "whole" in verdict(*people).noticed, file


@pytest.mark.slow
def test_the_reports_shortcut_is_the_judges_own_verdict(shared_data: Path) -> None:
    """The report derives the verdicts on exchanged files from the right one's evidences, by
    symmetry: the same as judging them anew, but for the noise of the draws."""
    for view in scenes(shared_data)[:3]:
        usual, opposed, whole = (
            judging().evidence(exchanged(view.detection, *p)) for p in ((), ("shoulder",), BODY)
        )
        for reading in READINGS:
            short = seen_as(reading.name, view.detection, usual, opposed, whole).gains[
                0, : len(READINGS)
            ]
            anew = (
                judging()
                .verdict(exchanged(view.detection, *reading.parts))
                .gains[0, : len(READINGS)]
            )
            near = np.minimum(
                np.abs(short - anew), np.abs(np.clip(short, -8, 8) - np.clip(anew, -8, 8))
            )
            assert np.median(near) < 1.5, (reading.name, short, anew)


# The face's own model.


def test_the_head_grid_is_a_distribution_of_rotations() -> None:
    assert np.logaddexp.reduce(HEADS.log_mass) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(
        HEADS.rotations @ HEADS.rotations.transpose(0, 2, 1),
        np.eye(3)[None].repeat(len(HEADS.log_mass), 0),
        atol=1e-12,
    )
    np.testing.assert_allclose(POINTS[1] * [-1, 1, 1], POINTS[2])
    np.testing.assert_allclose(OUTWARD[3] * [-1, 1, 1], OUTWARD[4])


def test_a_face_is_likely_in_front_and_not_behind() -> None:
    person = standing()
    frame = inference.estimate_torso(person)
    front = max(frame.candidates, key=lambda candidate: -candidate.facing[2])
    turned = dataclasses.replace(
        front,
        camera=front.camera._replace(
            rotation=np.asarray(front.camera.rotation) @ np.diag([-1.0, 1.0, -1.0])
        ),
    )
    assert log_face_likelihood(person, front) > log_face_likelihood(person, turned) + 5
    blank = dataclasses.replace(person, face=None)
    assert log_face_likelihood(blank, front) == 0
