"""Simulation-based calibration of the whole posterior, root included: where the truth stands among
the draws is uniform, whatever is asked.

Torso, rotation, pose and detections are drawn from the model. Log scale and translation have flat
priors, from which nothing can be drawn; but moving and scaling the image moves the posterior with
it (d log s dt is the right Haar measure of that group), so any fixed scale and place will do, for
questions whose answers do not change or move along.

False alarms: 1e-3 for all questions of a test together (Bonferroni, Kolmogorov–Smirnov), 1e-3 for
the sets of 95 %; seeds are fixed. Every control misses by a factor of a thousand and more.
"""

import dataclasses
import functools

import jax
import numpy as np
import pytest
from scipy import stats

from poseterior.inference.importance.weighted import WeightedRoots, weigh_roots
from poseterior.probmodel import Candidate, Estimate, Likelihood, PoseModel, WeakPerspective
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.rotations import rotation_of
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_JOINTS
from tests.scenes import key, placed

FAMILY = 1e-3
"""False-alarm rate of the questions of one test together."""
ARM = (*TORSO_JOINTS, "right_elbow", "right_wrist")
DRAWS = 200
FACTOR = 0.25
SCALE, PLACE = 100.0, np.array([320.0, 240.0])


@functools.cache
def model() -> PoseModel:
    return PoseModel()


def errors_of(law: str, rng: np.random.Generator) -> np.ndarray:
    """`(15, 2)` pixels: uniform in discs, or normal with half their radius for standard deviation,
    drawn anew where they are beyond three of them."""
    radius = FACTOR * SCALE
    if law == "disc":
        length, angle = np.sqrt(rng.uniform(size=NUM_JOINTS)), rng.uniform(0, 2 * np.pi, NUM_JOINTS)
        return radius * length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    error = rng.normal(scale=radius / 2, size=(NUM_JOINTS, 2))
    while (far := np.linalg.norm(error, axis=1) > 1.5 * radius).any():
        error[far] = rng.normal(scale=radius / 2, size=(far.sum(), 2))
    return error


def simulate(
    seed: int, seen: tuple[str, ...], law: str = "disc"
) -> tuple[Estimate, dict[str, np.ndarray]]:
    """A root and a pose of the prior at a fixed scale and place, and their detections; the truth as
    draws have it."""
    rng = np.random.default_rng(seed)
    rotation = np.asarray(rotation_of(jax.random.normal(key(seed), (4,))))
    torso = np.asarray(model().torsos)[rng.integers(len(model().torsos))]
    pose = jax.tree.map(lambda leaf: leaf[0], model().draw(key(10_000 + seed), 1))
    camera = WeakPerspective(SCALE, rotation, PLACE)
    joints = np.asarray(model().joints(np.asarray(camera.view(torso)), *pose))
    error = errors_of(law, rng)
    score = np.array([float(name in seen) for name in JOINTS])
    keypoints = np.where(score[:, None] > 0, np.asarray(camera.image(joints)) + error, np.nan)
    detection = Detection(keypoints, score, "synthetic", f"simulation {seed}", 0)
    candidate = Candidate(0, torso, camera, 0.0)
    truth = {"rotation": rotation, "scale": SCALE, "translation": PLACE, "joints": joints}
    return Estimate(detection, (candidate,), Likelihood(factor=FACTOR)), truth


def answers(columns: dict[str, np.ndarray], seen: tuple[str, ...]) -> np.ndarray:
    """`(..., questions)`: what is asked of draws and of the truth."""
    rotation, joints = columns["rotation"], columns["joints"]
    root = [np.log(columns["scale"]), *np.moveaxis(np.asarray(columns["translation"]), -1, 0)]
    root += [rotation[..., 2, 2], rotation[..., 2, 1], rotation[..., 0, 0], rotation[..., 1, 2]]
    ends = [
        JOINT_INDEX[name] for name in seen if name not in ("pelvis", "left_hip", "left_shoulder")
    ]
    limbs = [joints[..., joint, axis] for joint in ends for axis in (0, 2)]
    return np.stack([*root, *limbs], axis=-1)


def standing(roots: WeightedRoots, truth: dict, seen: tuple[str, ...], seed: int) -> np.ndarray:
    """`(questions,)`: where the truth stands among draws, ties broken at random."""
    rng = np.random.default_rng(seed)
    points, poses, _ = roots.draw(rng, DRAWS)
    if not len(poses.length):
        return np.full(len(answers(truth, seen)), rng.choice([0.0, 1.0]))
    root = {"rotation": points.rotation, "translation": points.translation}
    joints = placed(model(), points, poses, size=DRAWS)
    found = answers(root | joints | {"scale": np.exp(points.log_scale)}, seen)
    below = np.sum(found < answers(truth, seen), axis=0)
    return (below + rng.uniform(size=below.shape)) / (DRAWS + 1)


def stand(
    number: int,
    num_roots: int,
    seen: tuple[str, ...],
    believed: Likelihood | None = None,
    law: str = "disc",
    most: int = 10**8,
) -> dict[str, np.ndarray]:
    """`(number, questions)` by right weights, and by weights without scale⁻²; and how many
    effective roots there were, for a likelihood that is `believed` where the errors follow a `law`.
    `most` proposals: where the law is too narrow, some torsos have no
    root at all."""
    found: dict[str, list] = {"right": [], "without s^-2": [], "effective": []}
    for seed in range(number):
        frame, truth = simulate(seed, seen, law)
        frame = dataclasses.replace(frame, likelihood=believed or frame.likelihood)
        roots = weigh_roots(
            frame.posterior(model()),
            key=key(20_000 + seed),
            num_roots=num_roots,
            max_proposals=most,
        )
        scale = np.asarray(roots.points.log_scale)
        wrong = dataclasses.replace(roots, log_weight=roots.log_weight + 2 * len(seen) * scale)
        found["right"].append(standing(roots, truth, seen, seed))
        found["without s^-2"].append(standing(wrong, truth, seen, seed))
        found["effective"].append(np.array(roots.effective))
    return {name: np.array(rows) for name, rows in found.items()}


def p_value(standings: np.ndarray) -> float:
    """The smallest p-value of uniformity, times the number of questions."""
    values = [stats.kstest(column, "uniform").pvalue for column in standings.T]
    return min(values) * len(values)


def outside(standings: np.ndarray) -> float:
    """The share of truths outside central intervals of 95 %, over all questions."""
    return float(np.mean((standings < 0.025) | (standings > 0.975)))


@functools.cache
def torso_and_an_arm() -> dict[str, np.ndarray]:
    return stand(40, 80, ARM)


@pytest.mark.slow
def test_torso_camera_and_an_arm_are_calibrated():
    found = torso_and_an_arm()
    assert np.median(found["effective"]) > 20
    assert p_value(found["right"]) > FAMILY


@pytest.mark.slow
def test_without_the_factors_of_the_scale_nothing_is():
    """Negative control: weights without scale⁻² for every seen joint."""
    assert p_value(torso_and_an_arm()["without s^-2"]) < FAMILY / 1000


@pytest.mark.slow
def test_an_error_law_that_is_too_narrow_is_found_out():
    """Negative control: detections stray twice as far as the likelihood believes."""
    found = stand(50, 40, ARM, Likelihood(factor=FACTOR / 2), most=1_000_000)
    assert p_value(found["right"]) < FAMILY / 1000
    assert outside(found["right"]) > 2 * outside(torso_and_an_arm()["right"])


@pytest.mark.sweep
def test_the_whole_body_is_calibrated():
    found = stand(40, 1000, JOINTS)
    assert np.median(found["effective"]) > 40
    assert p_value(found["right"]) > FAMILY
    assert p_value(found["without s^-2"]) < FAMILY / 1000


@pytest.mark.sweep
def test_a_gaussian_is_calibrated_and_a_narrower_one_is_not():
    """Torso, camera and an arm, whose roots come by least squares; the control believes errors to
    be half as large as they are."""
    law = Likelihood(Gaussian(), factor=FACTOR)
    found = stand(40, 100, ARM, law, law="gaussian")
    assert np.median(found["effective"]) > 20
    assert p_value(found["right"]) > FAMILY
    assert p_value(found["without s^-2"]) < FAMILY / 1000
    believed = Likelihood(Gaussian(), factor=FACTOR / 2)
    narrow = stand(45, 40, ARM, believed, law="gaussian", most=1_000_000)
    assert p_value(narrow["right"]) < FAMILY / 1000
