"""A camera that nobody knows, and points that are not the skeleton's joints: the posterior under a
few focal lengths is a mixture, which brute force takes one by one; definitions move the torso's
points; and controls that must fail.

False alarms: every number is held to 4.5 standard errors, 7e-6 each; seeds are fixed.
"""

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy import stats

from poseterior import inference
from poseterior.inference.baselines.rooted import RootedTarget
from poseterior.inference.draws import Draws
from poseterior.inference.importance import two_stage
from poseterior.inference.importance.weighted import weigh_roots
from poseterior.inference.sampler import REJECTION
from poseterior.probmodel import BadInput, DetectorErrors, Likelihood, PoseModel
from poseterior.probmodel.camera import FOCAL_MEDIAN, FOCAL_SPREAD, Lens, Perspective
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.root_priors import NEAREST, TorsoCameraPrior
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX
from tests import oracle
from tests.inference.test_oracle import (
    BIASES,
    FAR,
    SPREADS,
    Row,
    beliefs,
    case,
    likelihood,
    model,
    scene,
)
from tests.inference.test_oracle import (
    told as moments_told,
)
from tests.scenes import drawer, key

FOCAL = np.array([180.0, 650.0])
"""Pixels: two and seven body units away."""
PRINCIPAL = np.array([250.0, 420.0])
ROW = Row("uncertain", "", "gaussian", lens=True)
NAMES = ("log scale", "chest z", "back z", "elbow z", "wrist x", "wrist z")
LIMIT = 4.5
EFFORT = oracle.Effort(pilot=40_000, proposed=40_000, taken=5_000, arms=30)


@functools.cache
def each() -> tuple[oracle.Moments, ...]:
    """The oracle's posterior under each focal length."""
    found = []
    for seed, focal in enumerate(FOCAL):
        one = case(True)._replace(lens=oracle.Lens(float(focal), PRINCIPAL))
        found.append(oracle.under_roots(one, {"": beliefs(ROW)}, seed, EFFORT)[""])
    return tuple(found)


def mixed(chosen: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of a mixture over the chosen focal lengths `(k,)`: log evidence, shares, and means of
    `NAMES`, with standard errors."""
    some = [each()[index] for index in chosen]
    log = np.array([one.log_evidence for one in some])
    error = np.array([one.log_evidence_se for one in some])
    total = np.logaddexp.reduce(log)
    share = np.exp(log - total)
    columns = [oracle.NAMES.index(name) for name in NAMES]
    mean = np.stack([one.mean[columns] for one in some])
    mean_se = np.stack([one.mean_se[columns] for one in some])
    whole = share @ mean
    scatter = share[:, None] ** 2 * (mean_se**2 + ((mean - whole) * error[:, None]) ** 2)
    jacobian = np.diag(share) - np.outer(share, share)
    return {
        "evidence": (total - math.log(len(some)), np.sqrt(share**2 @ error**2)),
        "shares": (share, np.sqrt(jacobian**2 @ error**2)),
        "means": (whole, np.sqrt(scatter.sum(axis=0))),
    }


def told(draws: Draws, lenses: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The same of draws; those of one root err together."""
    joints = draws.joints
    elbow, wrist = (joints[:, list(oracle.JOINTS).index(name)] for name in oracle.ARM)
    points = draws.points
    rotation = points.rotation
    values = [points.log_scale, rotation[:, 2, 2], rotation[:, 2, 1], elbow[:, 2]]
    values += [wrist[:, 0], wrist[:, 2]]
    flags = np.arange(lenses) == points.lens[:, None]
    _, mean, error = oracle.moments(
        np.ones(len(joints)), np.stack(values, axis=1), flags.astype(float), points.log_scale
    )
    number = len(NAMES)
    rare = np.sqrt(mean[2 * number :] * (1 - mean[2 * number :]) / draws.effective_roots)
    return {
        "evidence": (draws.log_evidence, draws.log_evidence_se),
        "shares": (mean[2 * number :], np.maximum(error[2 * number :], rare)),
        "means": (mean[:number], error[:number]),
    }


def apart(one: dict, other: dict) -> dict[str, float]:
    """The largest difference of each part, in standard errors."""
    return {
        name: float(
            np.max(np.abs(one[name][0] - other[name][0]) / np.hypot(one[name][1], other[name][1]))
        )
        for name in one
    }


def ask(route: str, focal: np.ndarray, number: int = 3000, roots: int = 1000) -> Draws:
    people = PoseModel(torsos=model().torsos).seen_by(Lens(focal, PRINCIPAL))
    draw = drawer(people, root="uncertain", sampler=route, num_samples=number, num_roots=roots)
    return draw(dataclasses.replace(scene(), likelihood=likelihood(ROW)), key(3))


@pytest.mark.slow
def test_an_unknown_focal_length_is_a_mixture() -> None:
    """The fast route against brute force; controls: the longer focal length alone, and lenses
    weighed by how many roots they were given."""
    draws = ask("weighted-roots", FOCAL)
    found = told(draws, len(FOCAL))
    truth = mixed(np.arange(len(FOCAL)))
    off = apart(found, truth)
    assert max(off.values()) < LIMIT, off
    alone = mixed(np.array([1]))
    assert apart({"means": found["means"]}, {"means": alone["means"]})["means"] > LIMIT
    flat = np.bincount(draws.known.points.lens) / len(draws.known.points.lens)
    assert np.abs(flat - truth["shares"][0]).max() > LIMIT * truth["shares"][1].max()


SIMILAR = np.linspace(500.0, 850.0, 5)
RUNS = 12


def faulty(rare_odds: float, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """`(RUNS,)`: the evidence of outliers among the torso's keypoints, over five focal lengths,
    where faults are rare below such odds."""
    monkeypatch.setattr(two_stage, "RARE_ODDS", rare_odds)
    people = PoseModel(torsos=model().torsos).seen_by(Lens(SIMILAR, PRINCIPAL))
    row = Row("uncertain", "", "gaussian", lens=True, faults="outliers")
    posterior = dataclasses.replace(scene(), likelihood=likelihood(row)).posterior(people)
    found = []
    for run in range(RUNS):
        roots = weigh_roots(posterior, key=key(run), num_roots=1000)
        wrong = roots.proposed.faults.outlier[:, list(TORSO_INDEX)].any(axis=1)
        found.append(roots.evidence_of(np.flatnonzero(wrong))[0])
        assert bool(np.ptp(roots.proposed.stands_for)) is (rare_odds > 1)
    return np.exp(np.array(found))


@pytest.mark.slow
def test_rare_faults_under_one_focal_length_count_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same evidence in the mean as where every focal length has its own, within 4.5 standard
    errors and a quarter; uncounted, it would be a fifth of it."""
    own, alone = (faulty(odds, monkeypatch) for odds in (1e-300, 1e300))
    error = math.hypot(stats.sem(own), stats.sem(alone))
    assert error < 0.08 * own.mean()
    assert abs(own.mean() - alone.mean()) < min(LIMIT * error, 0.25 * own.mean())


@pytest.mark.sweep
def test_rejection_takes_the_same_mixture() -> None:
    found = told(ask(REJECTION, FOCAL, number=700, roots=300), len(FOCAL))
    off = apart(found, mixed(np.arange(len(FOCAL))))
    assert max(off.values()) < LIMIT, off


DEFINITIONS = {
    "right_shoulder": np.array([0.1, 0.1, 0.05]),
    "left_shoulder": np.array([-0.1, 0.1, 0.05]),
    "right_hip": np.array([-0.15, -0.05, 0.2]),
    "left_hip": np.array([0.15, -0.05, 0.2]),
}


SPREAD_OF_HIPS = np.array([0.05, 0.15, 0.0])


def defined() -> Likelihood:
    """A learned law whose shoulders lie farther in and up, and whose hips farther out, how far
    differing between people."""
    definition, differ = np.zeros((2, NUM_JOINTS, 3))
    for name, offset in DEFINITIONS.items():
        definition[JOINT_INDEX[name]] = offset
    differ[[JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]] = SPREAD_OF_HIPS
    sigma = np.array([SPREADS.get(name, np.nan) / 2 for name in JOINTS])
    bias = np.array([BIASES.get(name, [np.nan, np.nan]) for name in JOINTS])
    inlier = np.ones(NUM_JOINTS)
    law = DetectorErrors(Gaussian(), sigma, inlier, bias, outlier_radius=FAR, definition=definition)
    return Likelihood.of(dataclasses.replace(law, definition_sd=differ))


@pytest.mark.slow
def test_definitions_move_the_torsos_points() -> None:
    """Against brute force under a lens, each of three torsos with its own; controls: the joints
    themselves, and the same definitions of all torsos."""
    row = Row("uncertain", "", "gaussian", lens=True, bias=True)
    people = PoseModel(torsos=model().torsos)
    people = people.seen_by(Lens(case(True).lens.focal, case(True).lens.principal))
    draw = drawer(people, root="uncertain", num_samples=3000, num_roots=1000)
    draws = draw(dataclasses.replace(scene(), likelihood=defined()), key(3))
    differing = defined().definitions(3)
    assert differing is not None
    each = {name: differing[:, JOINT_INDEX[name]] for name in DEFINITIONS}
    assert np.ptp(each["left_hip"][:, 1]) > 0.3
    for definition, right in ((each, True), ({}, False), (DEFINITIONS, False)):
        small = case(True)._replace(definition=definition)
        truth = oracle.under_roots(small, {"": beliefs(row)}, 5, EFFORT)[""]
        off = float(np.abs(moments_told(draws, truth).apart(truth)).max())
        assert (off < LIMIT) == right, off
    log = draws.posterior.log_joint(
        draws.points.take(slice(0, 40)), type(draws.poses)(*(part[:40] for part in draws.poses))
    )
    assert np.isfinite(np.asarray(log)).all()


def test_the_prior_of_an_unknown_focal_length() -> None:
    """Log-normal, in longer sides of the image: mean and deviation of many atoms."""
    lens = Lens.unknown(1920.0, np.array([960.0, 540.0]), number=2000)
    log = np.log(np.asarray(lens.focal) / 1920.0)
    assert log.mean() == pytest.approx(math.log(FOCAL_MEDIAN), abs=1e-6)
    assert log.std() == pytest.approx(FOCAL_SPREAD, rel=0.01)
    assert stats.kstest((log - log.mean()) / FOCAL_SPREAD, "norm").statistic < 1e-3
    assert Lens.unknown(640.0, np.zeros(2)).number == 5


def test_what_is_behind_the_camera_was_not_seen() -> None:
    """A pelvis two body units away, a wrist three body units nearer."""
    people = PoseModel(torsos=model().torsos).seen_by(Lens(200.0, np.zeros(2)))
    frame = dataclasses.replace(scene(), likelihood=Likelihood(factor=1.0))
    posterior = frame.posterior(people)
    point = posterior.root_prior.compose(
        lambda site, law: {
            "torso": 0,
            "rotation": np.eye(3),
            "log_scale": math.log(100.0),
            "translation": np.zeros(2),
        }[site]
    )
    observation = posterior.detected.under(posterior.root_prior, point)
    joints = np.zeros((NUM_JOINTS, 3))
    assert isinstance(observation.root.camera, Perspective)
    joints[JOINT_INDEX["right_wrist"], 2] = -3.0
    wrist = np.asarray(observation.log_densities(joints))[JOINT_INDEX["right_wrist"]]
    assert wrist == -np.inf
    joints[JOINT_INDEX["right_wrist"], 2] = -3.0 * 0
    joints[JOINT_INDEX["left_wrist"], 2] = -3.0  # nobody saw that one
    assert np.asarray(observation.squares(joints))[JOINT_INDEX["left_wrist"]] == 0.0


def test_baselines_need_a_focal_length() -> None:
    people = PoseModel().seen_by(Lens(FOCAL, PRINCIPAL))
    with pytest.raises(BadInput, match="a focal length that is not known has no coordinate"):
        RootedTarget.of(scene().posterior(people))


def test_results_say_the_lens(tmp_path) -> None:
    people = PoseModel(torsos=model().torsos).seen_by(Lens(FOCAL, PRINCIPAL))
    result = inference.sample(people, scene(), key=key(0), num_samples=50, num_roots=60)
    lens = result.tree["posterior"]["lens"].values[0]
    assert set(lens.tolist()) <= {0, 1}
    assert result.tree.attrs["focal"] == "180 650"
    prior = TorsoCameraPrior.of(people)
    assert prior.lenses == 2
    assert NEAREST < 2


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (("right_elbow", [0.1, 0.0, 0.0]), "right_elbow has a definition in the torso's axes"),
        (("right_hip", [2.0, 0.0, 0.0]), "definition of right_hip must lie within 1 body unit"),
        (("right_hip", [np.nan, 0.0, 0.0]), "definition of right_hip must lie within"),
    ],
)
def test_definitions_that_are_none(place: tuple[str, list[float]], words: str) -> None:
    name, offset = place
    law = DetectorErrors.default()
    definition = np.zeros((NUM_JOINTS, 3))
    definition[JOINT_INDEX[name]] = offset
    with pytest.raises(BadInput, match=words):
        dataclasses.replace(law, definition=definition)


def test_definitions_are_written_and_read(tmp_path) -> None:
    law = defined().learned
    law.write(tmp_path / "law.json")
    again = DetectorErrors.read(tmp_path / "law.json")
    np.testing.assert_array_equal(again.definition, law.definition)
