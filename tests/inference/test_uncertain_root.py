"""The posterior with an uncertain root: what is not held against brute force by
`tests/inference/test_oracle.py`, and controls that must fail beside it.

False alarms: evidence and every moment are held to 4 standard errors, 6e-5 each; seeds are fixed.
"""

import dataclasses
import functools
import math
import re
from typing import Any
from unittest import mock

import jax
import numpy as np
import pytest
from numpyro.infer.util import log_density
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior import inference
from poseterior.inference.draws import OUT_OF_BUDGET
from poseterior.inference.exact.loops.roots import (
    TILTS,
    WIDTH,
    TorsoJoints,
    disc_cells,
    propose_by_discs,
)
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.tables import ROOTS
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance import two_stage, weighted
from poseterior.inference.importance.limbs import log_evidence, picks
from poseterior.inference.importance.torso_proposals import TorsoDraws, draw_roots
from poseterior.inference.importance.torsos import lowest_scale, rotations_of, torso_problem
from poseterior.inference.importance.two_stage import ProposedRoots
from poseterior.inference.importance.weighted import (
    WeightedRoots,
    log_mean,
    weigh_enough_roots,
    weigh_roots,
)
from poseterior.inference.resampling import inclusion, shares, systematic, times
from poseterior.inference.sampler import WEIGHTED
from poseterior.probmodel import BadInput, Detection, Estimate, Likelihood, PoseModel, RootPoint
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.skeleton import GROUPS, JOINT_INDEX, JOINTS, NUM_JOINTS
from tests import oracle
from tests.inference.test_oracle import Row, beliefs
from tests.inference.test_oracle import case as oracle_case
from tests.scenes import key, moved, placed, prior_scene

FACTOR = 0.5
SEEN = ("right_shoulder", "left_shoulder", "right_hip", "left_hip", "right_elbow", "right_wrist")
MOMENTS = ("log scale", "pelvis x", "chest z", "back z", "elbow z", "wrist x", "wrist z")


@functools.cache
def small_case() -> tuple[PoseModel, Estimate]:
    """Two shoulders, two hips and one arm seen, scores unequal, three torsos in the dictionary."""
    whole = PoseModel()
    model = PoseModel(torsos=np.asarray(whole.torsos)[[0, 17, 40]])
    missing = tuple(name for name in JOINTS if name not in SEEN)
    scores = np.linspace(0.6, 1.0, NUM_JOINTS)
    return model, prior_scene(model, 11, factor=FACTOR, missing=missing, scores=scores)


def moments(weight: np.ndarray, values: np.ndarray) -> dict:
    """Weighted means of values `(n, m)` with their standard errors."""
    share = weight / weight.sum()
    mean = share @ values
    return {"mean": mean, "mean_se": np.sqrt(share**2 @ (values - mean) ** 2)}


def fast_moments(roots: WeightedRoots, share: np.ndarray) -> dict:
    """The same moments of weighted roots, limbs averaged under each root."""
    held = [
        len(found["arms"].draws.length) if w else 0
        for found, w in zip(roots.limbs, share, strict=True)
    ]
    rows = np.repeat(np.arange(len(share)), held)
    poses, start = Pose.blank(len(rows)), 0
    for index in np.flatnonzero(held):
        part = slice(start, start + held[index])
        roots.limbs[index]["arms"].draws.fill(Pose(*(one[part] for one in poses)), GROUPS["arms"])
        start = part.stop
    points = roots.points
    joints = placed(roots.posterior.model, points.take(rows), poses)["joints"]
    elbow, wrist = (joints[:, JOINT_INDEX[name]] for name in SEEN[4:])
    limbs = np.stack([elbow[:, 2], wrist[:, 0], wrist[:, 2]], axis=1)
    sums = np.zeros((len(share), 3))
    np.add.at(sums, rows, limbs)
    chest, back = points.rotation[:, 2, 2], points.rotation[:, 2, 1]
    root = np.stack([points.log_scale, points.translation[:, 0], chest, back], axis=1)
    mean = sums / np.maximum(held, 1)[:, None]
    return moments(share, np.concatenate([root, mean], axis=1))


def off(one: dict, other: dict) -> float:
    """The largest difference of two sets of moments, in standard errors."""
    error = np.hypot(one["mean_se"], other["mean_se"])
    return float(np.max(np.abs(one["mean"] - other["mean"]) / error))


def scales_apart(one: WeightedRoots, other: WeightedRoots) -> float:
    """The difference of two mean log scales, in standard errors."""
    return off(*(moments(roots.share, roots.points.log_scale[:, None]) for roots in (one, other)))


@functools.cache
def truth(lens: bool = False) -> dict:
    """Evidence and moments of the small case under discs by the oracle of the tests."""
    row = Row(UNCERTAIN, WEIGHTED, "disc", lens)
    found = oracle.under_roots(oracle_case(lens), {"": beliefs(row)}, 5)[""]
    columns = [oracle.NAMES.index(name) for name in MOMENTS]
    told = {"mean": found.mean[columns], "mean_se": found.mean_se[columns]}
    return told | {"log": found.log_evidence, "se": found.log_evidence_se}


@functools.cache
def as_they_come() -> WeightedRoots:
    """Roots that no promise chose: those that promises choose have even weights under the right
    posterior, and few effective ones under a wrong one."""
    model, frame = small_case()
    with mock.patch.object(two_stage, "OVERSAMPLING", (1, 1)):
        return weigh_roots(frame.posterior(model), key=key(3), num_roots=3000)


@pytest.mark.slow
def test_a_biased_evidence_is_found_out():
    """Negative controls, of roots as they come (promises leave weights so even that their mean log
    would nearly do): the mean of logs instead of the log of the mean; and every root that has a
    draw counted alike, as if a draw had been waited for."""
    brute, roots = truth(), as_they_come()
    alive = np.isfinite(roots.log_weight)
    wrong = roots.log_evidence - log_mean(roots.log_weight) + roots.log_weight[alive].mean()
    assert abs(wrong - brute["log"]) > 7 * math.hypot(brute["se"], roots.log_evidence_se)
    evidence = np.array([log_evidence(found) for found in roots.limbs])
    flat = np.where(alive, roots.log_weight - np.where(alive, evidence, 0.0), -np.inf)
    assert off(fast_moments(roots, shares(flat)), brute) > 8


@pytest.mark.slow
def test_the_factors_of_the_scale_are_missed():
    """Negative control: weights without scale⁻² for every seen joint."""
    brute, roots = truth(), as_they_come()
    wrong = shares(roots.log_weight + 2 * len(SEEN) * roots.points.log_scale)
    assert off(fast_moments(roots, wrong), brute) > 8


def test_a_fixed_root_has_no_belief_of_its_rotation():
    model, frame = small_case()
    with pytest.raises(BadInput, match="a belief that people are upright needs"):
        frame.posterior(PoseModel(torsos=model.torsos, upright=20.0), CANDIDATES)


def test_systematic_resampling_is_even():
    """Every count is its expectation, rounded down or up, and their sum is exact."""
    rng = np.random.default_rng(0)
    for number in (0, 1, 7, 1000):
        share = rng.dirichlet(np.full(50, 0.2))
        many = np.array([times(share, number, rng.uniform()) for _ in range(400)])
        assert (many.sum(axis=1) == number).all()
        assert (np.abs(many - share * number) < 1).all()
        error = 4.5 * np.sqrt(0.25 / 400)  # false alarm 7e-6 a root
        assert (np.abs(many.mean(axis=0) - share * number) < error).all()


def test_the_same_key_the_same_weights():
    model, frame = small_case()
    one, two = (weigh_roots(frame.posterior(model), key=key(8), num_roots=40) for _ in range(2))
    np.testing.assert_array_equal(one.log_weight, two.log_weight)
    np.testing.assert_array_equal(one.points.rotation, two.points.rotation)
    other = weigh_roots(frame.posterior(model), key=key(9), num_roots=40)
    assert not np.isin(other.points.rotation[:, 0, 0], one.points.rotation[:, 0, 0]).any()


def test_a_root_needs_enough_of_the_torso():
    model, frame = small_case()
    score = np.array(frame.detection.score)
    score[[JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]] = 0.0
    keypoints = np.where(score[:, None] > 0, frame.detection.keypoints, np.nan)
    little = dataclasses.replace(
        frame, detection=Detection(keypoints, score, "synthetic", "a scene", 0)
    )
    with pytest.raises(BadInput, match="needed are at least three of pelvis"):
        inference.sample(model, little, key=key(0), root="uncertain")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"root": "maybe"}, "there is no root 'maybe'; choose one of uncertain, candidates"),
        ({"root": "uncertain", "num_roots": 0}, "number of roots must lie between 1 and 100,000"),
        ({"root": "uncertain", "num_samples": 0}, "number of samples must be at least 1"),
        ({"root": "uncertain", "sampler": "smc"}, "no sampler 'smc' draws torso and camera"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, words):
    model, frame = small_case()
    with pytest.raises(BadInput, match=words):
        inference.sample(model, frame, key=key(0), **settings)


def test_an_answer_that_is_none_is_not_called_one():
    """Few roots: draws, but a status and a sentence that says what to do; an impossible torso: no
    draw at all."""
    model, frame = small_case()
    few = inference.sample(model, frame, key=key(0), root="uncertain", num_roots=12)
    assert (few.status, few.num_draws) == (OUT_OF_BUDGET, 10_000)
    assert "effective roots of 12, too few for an answer" in few.sentence
    assert few.tree.attrs["effective_roots"] < 12
    sharp = dataclasses.replace(frame, likelihood=Likelihood(factor=1e-4))
    none = inference.sample(
        model, sharp, key=key(0), root="uncertain", num_roots=12, max_proposals=4_000_000
    )
    assert (none.status, none.num_draws) == (OUT_OF_BUDGET, 0)
    assert "no torso brings all its seen joints within reach" in none.sentence


@pytest.mark.slow
def test_a_joint_out_of_reach_is_named_with_its_distance():
    """Under every root that was looked at. The controls: a joint that some of 32 roots bring into
    reach is not named, nor any in poses of the prior, nor where a focal length is known, for which
    there are no bounds."""
    model = PoseModel()
    scene = prior_scene(model, 2)
    far = moved(scene, "right_wrist", (2000.0, 0.0))
    settings = {"key": key(0), "root": "uncertain", "num_roots": 40}
    result = inference.sample(model, far, **settings)
    assert (result.status, result.num_draws) == (OUT_OF_BUDGET, 0)
    assert "whose arms explain their detections: right_wrist was detected" in result.sentence
    assert 1300 < float(result.sentence.split(" px")[0].split()[-1]) < 2000
    near = moved(scene, "right_wrist", (600.0, 0.0))
    found = inference.sample(model, near, **settings).sentence
    excess = float(found.split(" px")[0].split()[-1])
    assert 0 < excess < 600
    within = [prior_scene(model, seed, factor=0.05) for seed in range(3)]
    for frame in (*within, moved(scene, "right_wrist", (160.0, 0.0))):
        roots = weigh_roots(frame.posterior(model), key=key(0), num_roots=40)
        assert weighted._out_of_reach(roots) is None
    lens = PoseModel(lens=Lens(1500.0, np.array([320.0, 240.0])))
    said = inference.sample(lens, far, **settings).sentence
    assert "whose arms explain their detections; mend or drop one" in said


@pytest.mark.slow
def test_too_few_roots_are_drawn_anew_as_many_as_would_do():
    """To the bit those of `weigh_roots` of that number, with a key of their own; nothing is drawn
    anew where the first ones do, where no root explains the limbs, where the most that there may be
    would not do, and where the budget would end before."""
    model = PoseModel()
    posterior = moved(prior_scene(model, 2), "right_wrist", (80.0, 0.0)).posterior(model)
    first = weigh_roots(posterior, key=key(3), num_roots=40)
    assert 5 < first.effective < weighted.FEWEST_EFFECTIVE
    found = weigh_enough_roots(posterior, key=key(3), num_roots=40, most_roots=4000)
    number = len(found.log_weight)
    assert 80 <= number <= 400
    assert found.effective >= weighted.FEWEST_EFFECTIVE
    again = weigh_roots(posterior, key=jax.random.fold_in(key(3), 0), num_roots=number)
    np.testing.assert_array_equal(found.log_weight, again.log_weight)
    assert found.proposals == first.proposals + again.proposals

    def left(**settings: int) -> None:
        kept = weigh_enough_roots(posterior, key=key(3), num_roots=40, **settings)
        np.testing.assert_array_equal(kept.log_weight, first.log_weight)
        assert kept.proposals == first.proposals

    left()
    left(most_roots=40)
    left(most_roots=50)
    left(most_roots=4000, max_proposals=first.proposals + int(0.95 * again.proposals))
    with pytest.raises(BadInput, match="number of roots must lie between 1 and 100,000"):
        left(most_roots=0)
    nobody = moved(prior_scene(model, 2), "right_wrist", (2000.0, 0.0)).posterior(model)
    none = weigh_enough_roots(nobody, key=key(3), num_roots=40, most_roots=4000)
    assert (len(none.log_weight), none.effective) == (40, 0)
    enough = prior_scene(model, 2).posterior(model)
    held = weigh_enough_roots(enough, key=key(3), num_roots=100, most_roots=4000)
    assert len(held.log_weight) == 100
    assert held.effective >= weighted.FEWEST_EFFECTIVE


def test_a_budget_that_ended_says_so():
    model = PoseModel()
    scene = prior_scene(model, 2)
    settings = {"key": key(0), "root": "uncertain", "num_roots": 1000}
    none = inference.sample(model, scene, **settings, max_proposals=1)
    assert none.sentence.startswith("no root was attempted for")
    assert none.sentence.endswith("allow more proposals")
    few = inference.sample(model, scene, **settings, max_proposals=200_000)
    assert few.status == OUT_OF_BUDGET
    assert re.search(r"\d+ of 1,000 roots after [\d,]+ proposals for .*; allow more", few.sentence)


def test_draws_are_possible_and_say_where_they_come_from():
    """Every draw lies in the support of the program, explains every seen joint, and has the root
    that its number names."""
    model, frame = small_case()
    result = inference.sample(
        model, frame, key=key(1), root="uncertain", num_roots=300, num_samples=500
    )
    draws, roots = result.tree["posterior"], result.tree["roots"]
    assert np.isfinite(result.tree["sample_stats"].lp.values).all()
    row = draws.root_index.values[0]
    for name in ("torso", "rotation", "scale", "translation"):
        np.testing.assert_allclose(draws[name].values[0], roots[name].values[row], rtol=1e-12)
    seen = [JOINT_INDEX[name] for name in SEEN]
    gap = draws.keypoints.values[0] - frame.detection.keypoints
    score = frame.detection.score[seen]
    radius = draws.scale.values[0][:, None] * FACTOR * score.mean() / score
    assert (np.linalg.norm(gap[:, seen], axis=-1) <= radius * (1 + 1e-9)).all()
    assert roots.share.values.sum() == pytest.approx(1)
    constant = result.tree["constant_data"]
    assert constant.weight.values.sum() == pytest.approx(1)
    np.testing.assert_allclose(
        np.logaddexp.reduce(constant.log_evidence.values), result.tree.attrs["log_evidence"]
    )


def test_the_program_is_the_log_joint():
    """Density of the NumPyro program = flat prior + that of pose and detection given the root."""
    model, frame = small_case()
    posterior = frame.posterior(model)
    result = inference.sample(
        model, frame, key=key(1), root="uncertain", num_roots=60, num_samples=5
    )
    draws = result.tree["posterior"]
    for row in range(5):
        at = {name: draws[name].values[0, row] for name in ("torso", "rotation", "translation")}
        point = RootPoint(at["torso"], at["rotation"], np.log(draws.scale.values[0, row]), None)
        point = point._replace(translation=at["translation"])
        joints = draws.joints.values[0, row]
        pose = model.pose_of(joints, draws.bone_length.values[0, row])
        sites = point._asdict() | dict(zip(("bone_length", "upper", "lower"), pose, strict=True))
        found, _ = log_density(posterior.program, (), {}, sites)
        by_hand = -np.log(3) + model.log_prior(*pose) + posterior.log_peak
        by_hand -= 2 * len(SEEN) * point.log_scale
        assert float(found) == pytest.approx(float(by_hand), rel=1e-9)
        assert float(found) == pytest.approx(result.tree["sample_stats"].lp.values[0, row])


def plain_roots(posterior, number: int, seed: int) -> tuple[np.ndarray, ...]:
    """Roots that explain the torso, by SciPy's rotations and a translation anywhere in the first
    joint's disc: torsos, rotations, inverse scales in units of the problem's."""
    problem, rng = torso_problem(posterior, Faults.none()).joints, np.random.default_rng(seed)
    torso = rng.integers(len(problem.torsos), size=number)
    rotation = Rotation.random(number, rng=rng).as_matrix()
    inverse = rng.uniform(0.4, 1.0, number)
    image = np.einsum("nij,nkj->nki", rotation[:, :2], problem.torsos[torso])
    angle, radius = rng.uniform(0, 2 * np.pi, number), np.sqrt(rng.uniform(size=number))
    shift = problem.reach[0] * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    shift += problem.keypoints[0] * inverse[:, None] - image[:, 0]
    gap = image + shift[:, None] - problem.keypoints * inverse[:, None, None]
    inside = (np.linalg.norm(gap, axis=-1) <= problem.reach).all(axis=1)
    return torso[inside], rotation[inside], inverse[inside]


def left_out(problem, torso, rotation, inverse) -> float:
    """The share of roots that the cells do not hold."""
    cells, _ = disc_cells(problem)
    roll, tilt, yaw = np.moveaxis(Rotation.from_matrix(rotation).as_euler("ZYZ"), -1, 0)
    turn = 2 * TILTS
    roll, yaw = ((angle % (2 * np.pi) // WIDTH).astype(int) % turn for angle in (roll, yaw))
    code = ((torso * turn + yaw) * TILTS + (tilt // WIDTH).astype(int)) * turn + roll
    own = cells[np.minimum(np.searchsorted(cells["code"], code), len(cells) - 1)]
    beyond = inverse**problem.power - own["low"]
    return 1 - float(np.mean((own["code"] == code) & (beyond >= 0) & (beyond <= own["span"])))


def test_rotations_of_roots_are_those_of_their_angles():
    roots = np.zeros(1000, ROOTS)
    roots["angles"] = np.random.default_rng(0).uniform(size=(1000, 3)) * [
        2 * np.pi,
        np.pi,
        2 * np.pi,
    ]
    known = Rotation.from_euler("ZYZ", roots["angles"]).as_matrix()
    assert np.allclose(rotations_of(roots), known, rtol=0, atol=1e-14)
    assert rotations_of(np.zeros(0, ROOTS)).shape == (0, 3, 3)


def test_proposals_of_a_root_are_draws_of_its_prior():
    """Discs so wide that every proposal passes: roll, cosine of the tilt (inside its cell too),
    yaw, the inverse scale to its power and the place in the first disc are uniform
    (Kolmogorov–Smirnov), torsos equally often; all cells together have the prior's
    mass; a proposal takes seven random numbers: the cell, three angles, the scale and two for
    the place. False alarm 1e-3 over all."""
    rng, number, power = np.random.default_rng(0), 20_000, 6.0
    torsos, reach = rng.normal(size=(2, 3, 3)), np.array([2.0, 50.0, 50.0])
    keypoints = rng.normal(size=(3, 2))
    none = np.zeros((3, 2))
    problem = TorsoJoints(torsos, keypoints, none, reach, np.zeros(3), none, power)
    (cells, mass), roots, state = disc_cells(problem), np.zeros(number, ROOTS), seeded([1], 1)
    assert mass == pytest.approx(math.pi * reach[0] ** 2 / power)
    before = int(state[3])
    assert propose_by_discs(state, number, problem, cells, roots) == (number, number)
    assert int(state[3]) - before == 7 * number
    first = np.einsum("nij,nj->ni", rotations_of(roots)[:, :2], torsos[roots["torso"], 0])
    offset = first + roots["plane"] - keypoints[0] * roots["inverse"][:, None]
    roll, tilt, yaw = roots["angles"].T
    uniform = [roll / (2 * np.pi), (1 - np.cos(tilt)) / 2, yaw / (2 * np.pi)]
    uniform += [roots["inverse"] ** power, np.sum(offset**2, axis=1) / reach[0] ** 2]
    uniform += [np.arctan2(*offset.T) / (2 * np.pi) + 0.5]
    half = tilt[tilt < np.pi / 2]  # beyond, the cosine bends the other way
    above = np.cos(half // WIDTH * WIDTH)
    uniform += [(above - np.cos(half)) / (above - np.cos((half // WIDTH + 1) * WIDTH))]
    p_values = [stats.kstest(column, "uniform").pvalue for column in uniform]
    p_values.append(stats.binomtest(int(roots["torso"].sum()), number).pvalue)
    assert min(p_values) * len(p_values) > 1e-3


@pytest.mark.slow
def test_few_roots_estimate_the_torsos_evidence_without_bias():
    """The mean of 200 estimates from three roots each is that from 3,000 (4 standard errors);
    successes over attempts, where the attempts end with a success, would be half too large."""
    model, frame = small_case()
    posterior = frame.posterior(model)

    def drawn(words: list[int], number: int) -> TorsoDraws:
        return draw_roots(posterior, Faults.none(), words, number, Budget(10**9))

    truth = drawn([0, 0], 3000)
    logs = np.array([drawn([1, seed], 3).log_evidence for seed in range(200)])
    ratio = np.exp(logs - truth.log_evidence)
    error = math.hypot(ratio.std() / math.sqrt(200), math.sqrt(truth.variance))
    assert abs(ratio.mean() - 1) < 4 * error < 0.4


def test_no_root_goes_below_the_lowest_scale():
    """By hand: joints at a distance of one limb, detected 34 pixels apart, each within its own
    reach of 0.2 and 0.5 limbs, are seen at 20 pixels a limb at least; a third joint that is near
    changes nothing."""
    torsos = np.array([[[0.0, 0.0, 0.0], [0.6, 0.0, 0.8], [0.0, 5.0, 0.0]]])
    keypoints, reach = np.array([[0.0, 0.0], [34.0, 0.0], [0.0, 1.0]]), np.array([0.2, 0.5, 0.2])
    none = np.zeros((3, 2))
    joints = TorsoJoints(torsos, keypoints, none, reach, np.zeros(3), none, 4.0)
    assert lowest_scale(joints) == pytest.approx(20.0)
    aside = np.array([[0.0, 0.3], [0.0, 0.0], [0.0, 0.0]])
    assert lowest_scale(joints._replace(bias=aside)) == pytest.approx(17.0)


def test_draws_of_a_root_are_taken_evenly():
    """Each of five as often as the others, to one, and any of them first (binomial, four standard
    errors)."""
    rng = np.random.default_rng(0)
    many = np.array([picks(rng, 5, 13) for _ in range(500)])
    counts = np.array([np.bincount(row, minlength=5) for row in many])
    assert ((counts == 2) | (counts == 3)).all()
    first = np.bincount(many[:, 0], minlength=5) / 500
    assert (np.abs(first - 0.2) < 4 * math.sqrt(0.16 / 500)).all()


def test_effective_roots_and_the_error_of_the_evidence_by_hand():
    """Four equal weights among seven are worth four; weights 3 and 1 are worth 16/10. The evidence
    is a mean of weights as good as independent, among attempts most of which found nothing, of two
    strata whose attempts were of fixed number; and what the roots were taken from scatters by
    itself."""

    def weighted(*weights: float, made: tuple[int, ...], chance: Any = 0.0) -> WeightedRoots:
        with np.errstate(divide="ignore"):
            log_weight = np.log(np.array(weights))
        nowhere = RootPoint(np.zeros(0, int), np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 2)))
        stratum = np.arange(len(weights)) % len(made)
        chances = np.broadcast_to(np.asarray(chance, float), len(weights))
        proposed = ProposedRoots(
            nowhere, Faults.none(0), log_weight, stratum, np.array(made), chances, 0, 0
        )
        return WeightedRoots(None, proposed, [], log_weight, 0)

    assert weighted(2, 2, 2, 2, 0, 0, 0, made=(7,)).effective == pytest.approx(4)
    # All that was found was weighed: two of ten attempts, each of them a tenth of the evidence.
    roots = weighted(3, 1, made=(10,), chance=1)
    assert roots.effective == pytest.approx(1.6)
    attempts = np.array([3.0, 1.0, *np.zeros(8)])
    of_mean = np.var(attempts) / 10 / np.mean(attempts) ** 2
    assert roots.log_evidence_se == pytest.approx(math.sqrt(of_mean))
    # One of each stratum, of ten and of five attempts.
    roots = weighted(3, 1, made=(10, 5), chance=1)
    one, two = np.array([3.0, *np.zeros(9)]), np.array([1.0, *np.zeros(4)])
    of_sum = 10 * np.var(one) + 5 * np.var(two)
    assert roots.log_evidence_se == pytest.approx(math.sqrt(of_sum / 4**2))
    # Taken for certain, or one in ten from so many that these have no say.
    roots = weighted(1, 1, made=(10**9,), chance=1 / 10)
    assert roots.log_evidence_se == pytest.approx(math.sqrt(1 / 20), rel=1e-6)
    # The second pattern's focal length stands for others: its quarter may be anything.
    alone = roots.proposed._replace(made=np.array([10, 5]), stands_for=np.array([1, 5]))
    alone = alone._replace(pattern=np.array([0, 1]), chance=np.ones(2))
    share = np.array([0.75, 0.25])
    sure = alone._replace(stands_for=1).relative_variance(share)
    assert alone.relative_variance(share) == pytest.approx(sure + 0.25**2)


def test_the_error_of_the_evidence_knows_that_likely_roots_weigh_more():
    """A hundred of 400 are taken by their first-stage weights, and weigh what these do not know:
    over 1,000 runs the evidence scatters as it says, to 10 % (its variance is known to 4.5 %); were
    shares unrelated to chances, it would say a quarter too little."""
    rng, number, held = np.random.default_rng(0), 400, 100
    found, said, unrelated = [], [], []
    for _ in range(1000):
        first = np.exp(0.6 * rng.normal(size=number))
        weight = first**1.5 * np.exp(0.3 * rng.normal(size=number))
        chance = inclusion(first, held)
        rows = systematic(chance, held, rng.uniform())
        taken = weight[rows] / chance[rows]
        share, own = taken / taken.sum(), chance[rows]
        proposed = ProposedRoots(
            None, None, np.log(taken), np.zeros(held, int), np.array([number]), own, 0, 0
        )
        found.append(taken.sum())
        said.append(proposed.relative_variance(share))
        unrelated.append((share**2).sum() - 1 / held + own.mean() / held - 1 / number)
    truth = np.var(found) / np.mean(found) ** 2
    assert np.mean(said) == pytest.approx(truth, rel=0.1)
    assert np.mean(unrelated) < 0.8 * truth


def test_a_root_goes_to_the_side_that_it_faces():
    """The candidate to which the smallest turn leads, by SciPy's angles."""
    model, frame = small_case()
    cameras = Rotation.random(3, rng=np.random.default_rng(0))
    (one,) = frame.candidates
    candidates = tuple(
        dataclasses.replace(one, camera=one.camera._replace(rotation=rotation))
        for rotation in cameras.as_matrix()
    )
    posterior = dataclasses.replace(frame, candidates=candidates).posterior(model)
    roots = Rotation.random(50, rng=np.random.default_rng(1))
    points = RootPoint(np.zeros(50, int), roots.as_matrix(), np.zeros(50), np.zeros((50, 2)))
    turns = np.array([(camera * roots.inv()).magnitude() for camera in cameras])
    np.testing.assert_array_equal(
        posterior.root_prior.sides(points, posterior.candidates), turns.argmin(axis=0)
    )


def test_cells_hold_every_root_that_explains_the_torso():
    """Bounds are bounds; and discs a third smaller, which leave roots out, are found out."""
    _, frame = small_case()
    posterior = frame.posterior(PoseModel())
    torso, rotation, inverse = plain_roots(posterior, 1_000_000, 2)
    assert len(torso) > 500
    problem = torso_problem(posterior, Faults.none()).joints
    assert left_out(problem, torso, rotation, inverse) == 0
    smaller = problem._replace(reach=problem.reach / 1.5)
    assert left_out(smaller, torso, rotation, inverse) > 0
