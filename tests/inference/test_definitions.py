"""What a detector calls the torso's joints: definitions that differ between people, and how they
are learned; simulated detectors must be recovered.

False alarms: standard errors are estimates of some ten degrees of freedom; a family of 18 z-scores
is held to 5, and their root mean square to 1.6 (each below 1e-3). Seeds are fixed.
"""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from poseterior.inference.importance.torsos import torso_problem
from poseterior.inference.studies.errorlaws import definitions_of_data, learn
from poseterior.inference.studies.errorlaws.definitions import GIRDLES, best_torso, seen_offsets
from poseterior.inference.studies.errorlaws.pairs import pairs_of_data
from poseterior.probmodel import (
    BadInput,
    Detection,
    DetectorErrors,
    Estimate,
    Likelihood,
    PoseModel,
)
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.layouts import weights_of
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX

UNIT = 340.0
"""Millimetres of a person's mean limb bone."""
LIMBS = {
    "elbow": ("shoulder", [0.2, -0.9, 0.1]),
    "wrist": ("elbow", [0.1, -0.6, 0.5]),
    "knee": ("hip", [0.1, -1.2, 0.2]),
    "ankle": ("knee", [0.0, -1.2, -0.2]),
}
TORSO = list(TORSO_INDEX)


def offsets() -> np.ndarray:
    """`(15, 3)`: hips farther out, down and to the front, shoulders farther in."""
    found = np.zeros((NUM_JOINTS, 3))
    for side, sign in (("right", -1), ("left", 1)):
        found[JOINT_INDEX[f"{side}_hip"]] = 0.12 * sign, -0.15, 0.06
        found[JOINT_INDEX[f"{side}_shoulder"]] = -0.07 * sign, 0.03, -0.04
    return found


def seen(number: int, seed: int, *, around: bool = True) -> DataSet:
    """People of the embedded dictionary, turned anyhow, or not, before a detector with these
    offsets, a bias in the image, errors of 0.08, and one outlier in twenty."""
    rng = np.random.default_rng(seed)
    torsos = np.asarray(Anatomy.default().torsos)
    body = np.zeros((number, NUM_JOINTS, 3))
    body[:, TORSO] = torsos[rng.integers(len(torsos), size=number)]
    body[:, JOINT_INDEX["head"]] = body[:, JOINT_INDEX["thorax"]] + [0.0, 0.7, 0.1]
    for part, (start, bone) in LIMBS.items():
        for side, sign in (("right", -1), ("left", 1)):
            vector = np.array(bone) * [sign, 1, 1] / np.linalg.norm(bone)
            body[:, JOINT_INDEX[f"{side}_{part}"]] = (
                body[:, JOINT_INDEX[f"{side}_{start}"]] + vector
            )
    facing = Rotation.from_euler("x", 180, degrees=True)
    turn = (Rotation.random(number, random_state=seed) if around else facing).as_matrix()
    turn = np.broadcast_to(turn, (number, 3, 3))
    poses = np.einsum("nab,njb->nja", turn, body)
    points = np.einsum("nab,njb->nja", turn, body + offsets())[..., :2] + [0.03, -0.05]
    points += 0.08 * rng.normal(size=points.shape)
    wrong = rng.uniform(size=points.shape[:2]) < 0.05
    points += np.where(wrong[..., None], rng.uniform(-2, 2, points.shape), 0.0)
    scale = np.full(number, 0.4)
    recording = np.array([f"film {row * 12 // number}" for row in range(number)])
    return DataSet(
        "simulated",
        UNIT * poses,
        300 + 0.4 * UNIT * points,
        np.full((number, NUM_JOINTS), 0.9),
        scale,
        np.full((number, 2), 300.0),
        np.full(number, "turning"),
        np.full(number, "one"),
        recording,
    )


def test_a_simulated_detector_is_recovered() -> None:
    """To 3 mm, within standard errors, bias and outliers beside; whoever takes the sides for each
    other does not. Of people who all face the camera nobody knows what is in front."""
    found = definitions_of_data(seen(1000, 1))
    off, known = (found.mean - offsets())[TORSO], found.se[TORSO]
    assert UNIT * np.sqrt(np.mean(off**2)) < 3.0
    assert np.abs(off / known).max() < 5
    assert np.sqrt(np.mean((off / known) ** 2)) < 1.6
    assert np.abs((off - 2 * offsets()[TORSO] * [1, 0, 0]) / known).max() > 20
    one_sided = definitions_of_data(seen(300, 2, around=False))
    hip = JOINT_INDEX["left_hip"]
    assert one_sided.se[hip, 2] > 5 * found.se[hip, 2]


def test_a_law_has_what_was_learned() -> None:
    """Definitions and spreads of the record; the bias is that of the image alone, and sigma has
    nothing of the offsets, which else would widen it."""
    data = seen(400, 3)
    definitions = definitions_of_data(data)
    pairs = pairs_of_data(data, seen_offsets(definitions, data))
    law = learn(pairs, definitions=definitions).errors
    np.testing.assert_array_equal(law.definition, definitions.mean)
    np.testing.assert_array_equal(law.definition_sd, definitions.se)
    hip = JOINT_INDEX["right_hip"]
    np.testing.assert_allclose(law.bias[hip], [0.03, -0.05], atol=0.02)
    plain = learn(pairs_of_data(data)).errors
    assert law.sigma[hip] < 0.1 < plain.sigma[hip]


def test_triangulated_points_beside_the_torso_that_explains_them() -> None:
    """What turned and moved copies of one torso with offsets say of these, but for their mean."""
    rows = [TORSO.index(joint) for joint in GIRDLES]
    torsos = np.asarray(Anatomy.default().torsos)[:, rows]
    given = offsets()[TORSO][rows]
    # Offsets as large as people differ are taken for another person's: small ones are not.
    given = 0.1 * (given - given.mean(axis=0))
    turn = Rotation.random(200, random_state=4).as_matrix()
    points = np.einsum("nab,kb->nka", turn, torsos[7] + given)
    points += np.array([1.0, 2.0, 9.0])
    found = best_torso(points, torsos[[7, 30]])
    assert UNIT * np.abs(found.mean(axis=0) - given).max() < 3.0


def test_definitions_of_people() -> None:
    """Mean and deviations are those of the law, the sides mirror each other, a computed pelvis
    lies as hips and shoulders do; one person has the mean, and none has any without a law's."""
    mean, sd = offsets(), np.zeros((NUM_JOINTS, 3))
    hips = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
    sd[hips] = 0.03, 0.09, 0.05
    law = dataclasses.replace(DetectorErrors.default(), definition=mean, definition_sd=sd)
    people = law.definitions(48)
    assert people is not None
    np.testing.assert_allclose(people.mean(axis=0), mean, atol=1e-12)
    np.testing.assert_allclose(people.std(axis=0), sd, atol=1e-12)
    right, left = np.moveaxis(people[:, hips] - mean[hips], 1, 0)
    np.testing.assert_allclose(right * [-1, 1, 1], left, atol=1e-12)
    moved = law.definitions(48, ("thorax", "pelvis"))
    assert moved is not None
    np.testing.assert_allclose(moved, weights_of(("thorax", "pelvis")) @ people)
    assert moved[:, JOINT_INDEX["pelvis"]].std(axis=0)[1] > 0.06
    np.testing.assert_allclose(law.definitions(1), mean[None])
    blank = np.zeros_like(mean)
    plain = dataclasses.replace(law, definition=blank, definition_sd=blank)
    assert plain.definitions(48) is None


def test_a_root_sees_the_definitions_of_its_torso() -> None:
    """In the density as in the torso's problem, whose samplers take them from there."""
    law, model = DetectorErrors.default(), PoseModel()
    sd = np.zeros((NUM_JOINTS, 3))
    sd[GIRDLES] = 0.05
    law = dataclasses.replace(law, definition=offsets(), definition_sd=sd)
    keypoints = 100.0 * np.random.default_rng(0).normal(size=(NUM_JOINTS, 2))
    person = Detection(keypoints, np.ones(NUM_JOINTS), "skeleton_15", "made up", 0)
    posterior = Estimate(person, (), Likelihood.of(law)).posterior(model)
    people = law.definitions(len(model.torsos))
    assert people is not None
    problem = torso_problem(posterior, Faults.none())
    # The first joint of the problem is known by its keypoint.
    where = np.linalg.norm(keypoints[TORSO] - problem.origin, axis=1)
    joint = int(np.argmin(where))
    for torso in (3, 40):
        point = RootPoint(torso, np.eye(3), 0.0, np.zeros(2))
        seen = posterior.detected.under(posterior.root_prior, point)
        np.testing.assert_allclose(seen.defined(np.zeros((NUM_JOINTS, 3))), people[torso])
        whole = np.asarray(model.torsos)[torso] + people[torso, TORSO]
        np.testing.assert_allclose(problem.joints.torsos[torso, 0], whole[joint])


@pytest.mark.parametrize(
    ("name", "sd", "words"),
    [
        ("right_elbow", [0.1, 0.0, 0.0], "right_elbow has a definition in the torso's axes"),
        ("right_hip", [-0.1, 0.0, 0.0], "definition_sd of right_hip must lie between 0 and 1"),
        ("right_hip", [np.nan, 0.0, 0.0], "definition_sd of right_hip must lie between"),
    ],
)
def test_spreads_that_are_none(name: str, sd: list[float], words: str) -> None:
    given = np.zeros((NUM_JOINTS, 3))
    given[JOINTS.index(name)] = sd
    with pytest.raises(BadInput, match=words):
        dataclasses.replace(DetectorErrors.default(), definition_sd=given)


def test_spreads_are_written_and_read(tmp_path) -> None:
    law = DetectorErrors.default()
    sd = np.zeros((NUM_JOINTS, 3))
    sd[JOINT_INDEX["left_hip"]] = 0.01, 0.02, 0.03
    dataclasses.replace(law, definition_sd=sd).write(tmp_path / "law.json")
    np.testing.assert_array_equal(DetectorErrors.read(tmp_path / "law.json").definition_sd, sd)
