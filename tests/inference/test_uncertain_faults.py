"""A detector's faults, outliers and exchanged sides, in the posterior with an uncertain root:
by simulation, and on detections that were spoilt; against brute force it is held by
`tests/inference/test_oracle.py`.

False alarms: evidence and every moment are held to 4 standard errors, 6e-5 each; seeds are fixed.
"""

import dataclasses
import functools
import itertools
import math

import jax
import numpy as np
import pytest
from numpyro.infer.util import log_density

from poseterior import inference
from poseterior.inference.importance.weighted import WeightedRoots, log_mean, weigh_roots
from poseterior.probmodel import BadInput, Detection, Estimate, Likelihood, PoseModel
from poseterior.probmodel.errors.detector import DetectorErrors
from poseterior.probmodel.errors.faults import (
    EXCHANGE_INDEX,
    EXCHANGES,
    LIMB_INDEX,
    ORDERS,
    OUTLIER_REACH,
    FaultPrior,
    Faults,
)
from poseterior.probmodel.errors.laws import Gaussian, Student
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX
from tests.scenes import key, prior_scene

FACTOR = 0.5
TORSO = ("right_hip", "right_shoulder", "left_shoulder", "left_hip")
ARM = ("right_elbow", "right_wrist")
OUTLIER = {"right_shoulder": 0.1, "left_hip": 0.2, "right_elbow": 0.3, "right_wrist": 0.2}
ARMS_EXCHANGED = 0.25


def faults() -> FaultPrior:
    exchange = tuple(ARMS_EXCHANGED if name == "arms" else 0.0 for name in EXCHANGES)[1:]
    return FaultPrior(tuple(OUTLIER.get(name, 0.0) for name in JOINTS), exchange)


@functools.cache
def small_case() -> tuple[PoseModel, Estimate]:
    """Two shoulders, two hips and one arm seen, its wrist moved a little too far."""
    whole = PoseModel()
    model = PoseModel(torsos=np.asarray(whole.torsos)[[0, 17, 40]])
    missing = tuple(name for name in JOINTS if name not in (*TORSO, *ARM))
    scene = prior_scene(model, 11, factor=FACTOR, missing=missing)
    keypoints = np.array(scene.detection.keypoints)
    keypoints[JOINT_INDEX["right_wrist"]] += 130.0
    detection = dataclasses.replace(scene.detection, keypoints=keypoints)
    return model, dataclasses.replace(
        scene, detection=detection, likelihood=Likelihood(factor=FACTOR, faults=faults())
    )


def moments(weight: np.ndarray, values: np.ndarray) -> dict:
    """Weighted means of values `(n, m)` with their standard errors."""
    share = weight / weight.sum()
    mean = share @ values
    return {"mean": mean, "mean_se": np.sqrt(share**2 @ (values - mean) ** 2)}


@functools.cache
def weighed() -> WeightedRoots:
    model, frame = small_case()
    return weigh_roots(frame.posterior(model), key=key(3), num_roots=1500)


def fast_moments(roots: WeightedRoots, log_weight: np.ndarray) -> dict:
    pattern = roots.proposed.faults
    values = np.stack(
        [
            pattern.outlier[:, JOINT_INDEX["right_wrist"]],
            pattern.outlier[:, JOINT_INDEX["left_hip"]],
            pattern.exchange == EXCHANGE_INDEX["arms"],
            roots.points.log_scale,
        ],
        axis=1,
    )
    return moments(np.exp(log_weight - log_weight.max()), values.astype(float))


def off(one: dict, other: dict) -> float:
    """The largest difference of two sets of moments, in standard errors."""
    error = np.hypot(one["mean_se"], other["mean_se"])
    return float(np.max(np.abs(one["mean"] - other["mean"]) / error))


def test_where_no_fault_is_believed_every_one_is_impossible() -> None:
    """An exchange, an outlier, and nothing: of a prior without faults."""
    counts, nothing = np.ones(NUM_JOINTS, bool), Faults.none()
    given = {"exchange": np.asarray(1), "outlier": np.arange(NUM_JOINTS) == LIMB_INDEX[0]}
    wrong = [nothing._replace(**{name: value}) for name, value in given.items()]
    found = [float(FaultPrior().log_prob(counts, one)) for one in (*wrong, nothing)]
    assert found == [-math.inf, -math.inf, 0.0]


@pytest.mark.slow
def test_patterns_weighed_by_their_prior_alone_are_found_out():
    """Negative control beside the oracle's table, which holds the right weights: the proposal's
    probabilities left out of them."""
    roots = weighed()
    posterior, pattern = roots.posterior, roots.proposed.faults
    prior = np.array([_log_prior(posterior, pattern.take(row)) for row in range(len(roots.limbs))])
    wrong = roots.log_weight - prior
    right = fast_moments(roots, roots.log_weight)
    assert 0.02 < right["mean"][0] < 0.98  # there is something to be told
    assert off(fast_moments(roots, wrong), right) > 5
    assert abs(log_mean(wrong) - roots.log_evidence) > 12 * roots.log_evidence_se


def _log_prior(posterior, pattern: Faults) -> float:
    """By hand."""
    outlier = np.array(posterior.faults.outlier) * np.asarray(posterior.detected.counts)
    found = math.log(
        {0: 1 - ARMS_EXCHANGED, EXCHANGE_INDEX["arms"]: ARMS_EXCHANGED}[int(pattern.exchange)]
    )
    for joint in LIMB_INDEX:
        found += math.log(outlier[joint] if pattern.outlier[joint] else 1 - outlier[joint])
    odds = outlier[list(TORSO_INDEX)] / (1 - outlier[list(TORSO_INDEX)])
    torso = pattern.outlier[list(TORSO_INDEX)]
    return found + math.log((odds[torso].prod() if torso.any() else 1.0) / (1 + odds.sum()))


def test_the_prior_of_patterns_is_one_in_all():
    """Every pattern of the joints that can be outliers, six exchanges: the prior by NumPyro's laws
    sums to one, and is that by hand."""
    prior = FaultPrior.of(0.3, 0.2)
    joints = [JOINT_INDEX[name] for name in ("right_hip", "left_hip", "head", "left_wrist")]
    counts = np.isin(np.arange(NUM_JOINTS), joints)
    log_prob = jax.jit(prior.log_prob)
    total = 0.0
    for exchange, flags in itertools.product(
        range(len(EXCHANGES)), itertools.product([False, True], repeat=4)
    ):
        outlier = np.zeros(NUM_JOINTS, bool)
        outlier[joints] = flags
        total += math.exp(float(log_prob(counts, Faults(exchange, outlier))))
        hips, moved = sum(flags[:2]), exchange >= EXCHANGE_INDEX["upper half"]
        if hips == 2 or (hips and moved):
            assert float(log_prob(counts, Faults(exchange, outlier))) == -math.inf
    assert total == pytest.approx(1, abs=1e-9)
    astray = np.arange(NUM_JOINTS) == JOINT_INDEX["left_knee"]
    assert float(log_prob(counts, Faults(0, astray))) == -math.inf


@pytest.mark.slow
def test_the_program_is_the_log_joint():
    """Density of the NumPyro program, with its discrete sites = that of the draws' lp, and = prior
    by hand + peaks."""
    model, frame = small_case()
    posterior = frame.posterior(model)
    result = inference.sample(
        model, frame, key=key(1), root="uncertain", num_roots=200, num_samples=400
    )
    draws = result.tree["posterior"]
    seen = set()
    for row in range(400):
        pattern = Faults(draws.exchange.values[0, row], draws.outlier.values[0, row])
        kind = (int(pattern.exchange), tuple(np.flatnonzero(pattern.outlier)))
        if kind in seen:
            continue
        seen.add(kind)
        at = {name: draws[name].values[0, row] for name in ("torso", "rotation", "translation")}
        scale = draws.scale.values[0, row]
        joints = draws.joints.values[0, row]
        pose = model.pose_of(joints, draws.bone_length.values[0, row])
        torso = pattern.outlier[list(TORSO_INDEX)]
        sites = (
            at
            | {"log_scale": np.log(scale), "exchange": pattern.exchange}
            | {"torso_outlier": int(np.argmax(torso)) + 1 if torso.any() else 0}
            | {"limb_outlier": pattern.outlier[list(LIMB_INDEX)].astype(int)}
            | dict(zip(("bone_length", "upper", "lower"), pose, strict=True))
        )
        found, _ = log_density(posterior.program, (), {}, sites)
        radii = [
            OUTLIER_REACH if pattern.outlier[JOINT_INDEX[name]] else FACTOR
            for name in (*TORSO, *ARM)
        ]
        by_hand = -np.log(3) + model.log_prior(*pose) + _log_prior(posterior, pattern)
        by_hand -= sum(math.log(math.pi * (radius * scale) ** 2) for radius in radii)
        assert float(found) == pytest.approx(float(by_hand), rel=1e-9)
        assert float(found) == pytest.approx(result.tree["sample_stats"].lp.values[0, row])
    assert len(seen) > 2


def test_exchanges_put_keypoints_where_they_belong():
    """Twice exchanged is not exchanged; the name says which joints move."""
    for name, order in zip(EXCHANGES, ORDERS, strict=True):
        np.testing.assert_array_equal(order[order], np.arange(NUM_JOINTS))
        moved = {JOINTS[joint] for joint in np.flatnonzero(order != np.arange(NUM_JOINTS))}
        assert moved == {f"{side}_{part}" for part in EXCHANGES[name] for side in ("left", "right")}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((1.0,) * 15,), "probability of an outlier must lie between 0 and 1, below 1, not 1.0"),
        (((math.nan,) * 15,), "probability of an outlier"),
        (((0.0,) * 15, (0.3, 0.3, 0.3, 0.1, 0.0)), "below 1 together"),
        (((0.0,) * 15, (-0.1, 0.0, 0.0, 0.0, 0.0)), "must not be negative"),
    ],
)
def test_what_is_no_probability_is_refused(arguments, words):
    with pytest.raises(BadInput, match=words):
        FaultPrior(*arguments)


def test_faults_need_an_uncertain_root():
    model, frame = small_case()
    with pytest.raises(BadInput, match="outliers and exchanges need"):
        inference.sample(model, frame, key=key(0), root="candidates")


def learned(**changes) -> DetectorErrors:
    """A law with a bias of its own for every joint and no faults."""
    bias = np.linspace(-0.3, 0.4, 2 * NUM_JOINTS).reshape(NUM_JOINTS, 2)
    sigma, inlier = np.linspace(0.15, 0.3, NUM_JOINTS), np.ones(NUM_JOINTS)
    return DetectorErrors(
        **({"law": Gaussian(), "sigma": sigma, "inlier": inlier} | changes), bias=bias
    )


@pytest.mark.slow
def test_a_learned_law_moves_keypoints_back_by_its_bias():
    """Every draw lies within three standard deviations of where the keypoint is, less its bias; and
    not of where it is."""
    model, frame = small_case()
    law = learned()
    frame = dataclasses.replace(frame, likelihood=Likelihood.of(law))
    result = inference.sample(
        model, frame, key=key(2), root="uncertain", num_roots=300, num_samples=300
    )
    draws, seen = result.tree["posterior"], [JOINT_INDEX[name] for name in (*TORSO, *ARM)]
    scale = draws.scale.values[0][:, None, None]
    gap = (frame.detection.keypoints - draws.keypoints.values[0]) / scale
    reach = 3 * law.sigma[seen] * (1 + 1e-9)
    assert (np.linalg.norm(gap - law.bias, axis=-1)[:, seen] <= reach).all()
    assert (np.linalg.norm(gap, axis=-1)[:, seen] > reach).any()
    assert np.isfinite(result.tree["sample_stats"].lp.values).all()
    likely = result.tree["log_likelihood"].keypoints.values[0]
    square = (np.linalg.norm(gap - law.bias, axis=-1) / law.sigma)[:, seen] ** 2
    cut = math.log(1 - math.exp(-4.5))
    by_hand = -square / 2 - np.log(2 * math.pi * (law.sigma[seen] * scale[:, :, 0]) ** 2) - cut
    order = [sorted(seen).index(joint) for joint in seen]
    np.testing.assert_allclose(likely[:, order], by_hand, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"law": Student(1.9)}, r"end within 6.7 spreads, and Student\(df=1.9\) ends at 7"),
        ({"sigma": np.where(np.arange(15) == 3, np.nan, 0.2)}, "knows no right_elbow"),
    ],
)
def test_a_learned_law_that_will_not_do_is_refused(changes, words):
    _, frame = small_case()
    with pytest.raises(BadInput, match=words):
        Likelihood.of(learned(**changes)).spread(frame.detection, 1.0)


def whole_body(seed: int) -> Detection:
    """A person of the prior, all joints detected."""
    return prior_scene(PoseModel(), seed, factor=0.2, missing=()).detection


def found_faults(detection: Detection, seed: int, num_roots: int = 300) -> tuple[np.ndarray, ...]:
    """Posterior probabilities of outliers `(15,)` and exchanges `(6,)`."""
    model = PoseModel()
    likelihood = Likelihood(factor=0.25, faults=FaultPrior.of(0.05, 0.05))
    frame = dataclasses.replace(
        inference.estimate_torso(detection, torsos=np.asarray(model.torsos)), likelihood=likelihood
    )
    roots = weigh_roots(frame.posterior(model), key=key(seed), num_roots=num_roots)
    pattern = roots.proposed.faults
    return (
        roots.share @ pattern.outlier,
        np.bincount(pattern.exchange, roots.share, minlength=len(EXCHANGES)),
    )


@pytest.mark.slow
def test_a_wrist_that_was_moved_away_is_found():
    """By one body length, five body units, in four people; it is the only one."""
    wrist = JOINT_INDEX["left_wrist"]
    for seed in range(4):
        detection = whole_body(seed)
        keypoints = np.array(detection.keypoints)
        extent = np.ptp(keypoints, axis=0).max()
        keypoints[wrist] += extent * np.array([0.8, -0.6])
        outlier, _ = found_faults(dataclasses.replace(detection, keypoints=keypoints), seed)
        assert outlier[wrist] > 0.95
        assert np.delete(outlier, wrist).max() < 0.5
        calm, _ = found_faults(detection, seed)
        assert calm[wrist] < 0.5
