"""The likelihood with faults summed out against the sum over all patterns of the posterior's own
log density, and patterns drawn given a pose against their probabilities; and sums that forget
something, which must be told apart.

False alarms: 0.001 for the frequencies of patterns; the seed is fixed."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import logsumexp
from scipy import stats

from poseterior.inference.importance.weighted import weigh_roots
from poseterior.probmodel import Lens, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGES, LIMB_INDEX, FaultPrior, Faults
from poseterior.probmodel.model import log_joint
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX
from poseterior.probmodel.summed import SummedFaults
from tests.inference import test_uncertain_faults as faulty
from tests.scenes import key, prior_scene

ASTRAY = {"left_hip": 0.3, "thorax": 0.1, "left_elbow": 0.2, "right_wrist": 0.4, "left_knee": 0.1}
"""Joints that may be outliers, and how probably."""
FAULTS = FaultPrior(
    tuple(ASTRAY.get(name, 0.0) for name in JOINTS), (0.1, 0.05, 0.2, 0.1, 0.15), reach=2.0
)
PIXELS = 1000.0
"""Focal length and principal point."""


LEARNED = Likelihood.of(faulty.learned(sigma=np.linspace(0.4, 0.9, NUM_JOINTS)))
"""Gaussian errors with a bias of its own for every joint."""
LIKELIHOODS = {"disc": Likelihood(factor=0.6), "learned": LEARNED}


@functools.cache
def case(law: str, lens: bool = False) -> tuple[Posterior, RootPoint, Pose]:
    """Someone of whom one ankle was not found, and draws, most of which need some fault."""
    whole = PoseModel()
    camera = Lens(PIXELS, np.full(2, PIXELS)) if lens else None
    model = PoseModel(whole.limits, whole.lengths, np.asarray(whole.torsos)[:5], lens=camera)
    scene = prior_scene(PoseModel(), 3, factor=0.3, missing=("right_ankle",))
    keypoints = np.array(scene.detection.keypoints)
    keypoints[JOINT_INDEX["right_wrist"]] += 90.0
    likelihood = dataclasses.replace(LIKELIHOODS[law], faults=FAULTS)
    detection = dataclasses.replace(scene.detection, keypoints=keypoints)
    frame = dataclasses.replace(scene, detection=detection, likelihood=likelihood)
    posterior = frame.posterior(model)
    roots = weigh_roots(posterior, key=key(1), num_roots=60)
    points, poses, _ = roots.draw(np.random.default_rng(0), 12)
    return posterior, points, poses


def patterns() -> Iterator[Faults]:
    """All of them: six exchanges, the torso's outlier, each limb joint's."""
    torso = [JOINT_INDEX[name] for name in ASTRAY if JOINT_INDEX[name] in TORSO_INDEX]
    limbs = [JOINT_INDEX[name] for name in ASTRAY if JOINT_INDEX[name] in LIMB_INDEX]
    for exchange, one, flags in itertools.product(
        range(len(EXCHANGES)), [None, *torso], itertools.product([False, True], repeat=len(limbs))
    ):
        outlier = np.zeros(NUM_JOINTS, bool)
        outlier[limbs] = flags
        if one is not None:
            outlier[one] = True
        yield Faults(exchange, outlier)


def every_pattern(posterior: Posterior, point: RootPoint, pose: Pose) -> tuple[Faults, np.ndarray]:
    """All patterns, and the log joint density of root and pose with each, that of the prior of
    both left out."""
    some = list(patterns())
    faults = Faults(
        np.array([one.exchange for one in some]), np.stack([one.outlier for one in some])
    )
    points, poses = (
        jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], len(some), axis=0), one)
        for one in (point, pose)
    )
    root = float(posterior.root_prior.log_density(point)) + float(posterior.model.log_prior(*pose))
    return faults, np.asarray(posterior.log_joint(points, poses, faults)) - root


def rows(law: str, lens: bool) -> Iterator[tuple[Posterior, RootPoint, Pose, jax.Array]]:
    """Draws one by one, with their joints."""
    posterior, points, poses = case(law, lens)
    for row in range(len(poses.length)):
        point = jax.tree.map(jnp.asarray, points.take(row))
        pose = Pose(*(np.asarray(part)[row] for part in poses))
        view = posterior.root_prior.root(point).view
        yield posterior, point, pose, posterior.model.joints(view, *pose)


def summed(posterior: Posterior) -> SummedFaults:
    return SummedFaults(posterior.detected, posterior.faults, posterior.root_prior)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "lens"), [("disc", False), ("learned", False), ("learned", True)])
def test_the_sum_is_that_over_all_patterns(law: str, lens: bool) -> None:
    """To 1e-9 at every draw; several patterns count; a sum over outliers alone is another
    number."""
    likely = jax.jit(SummedFaults.log_likelihood)
    several = 0
    for posterior, point, pose, joints in rows(law, lens):
        _, log_each = every_pattern(posterior, point, pose)
        found = float(likely(summed(posterior), point, joints))
        assert np.isfinite(found)
        assert found == pytest.approx(float(logsumexp(log_each)), abs=1e-9)
        several += bool(logsumexp(log_each) > log_each.max() + 0.01)
        blind = summed(posterior)._replace(faults=dataclasses.replace(FAULTS, exchange=(0.0,) * 5))
        assert float(likely(blind, point, joints)) != pytest.approx(found, abs=1e-3)
    assert several >= 6


@pytest.mark.sweep
def test_misfit_is_that_of_the_pattern_that_explains_a_pose_best() -> None:
    """The least of `Observation.misfit` over all patterns of the prior; at most 1 where the sum is
    not zero."""
    posterior, *_ = case("disc")
    counts, some = posterior.detected.counts, list(patterns())
    some = [one for one in some if posterior.faults.log_prob(counts, one) > -np.inf]
    batch = jax.tree.map(lambda *each: jnp.stack([jnp.asarray(one) for one in each]), *some)

    @jax.jit
    def least(point: RootPoint, joints: jax.Array) -> jax.Array:
        def one(pattern: Faults) -> jax.Array:
            return posterior.detected.under(posterior.root_prior, point, pattern).misfit(joints)

        return jax.vmap(one)(batch).min()

    inside = []
    for (_, point, _, joints), move in itertools.product(rows("disc", False), (0.0, 0.5, 2.0)):
        moved = joints.at[JOINT_INDEX["left_ankle"], 0].add(move)
        found = float(summed(posterior).misfit(point, moved))
        assert found == pytest.approx(float(least(point, moved)))
        likely = float(summed(posterior).log_likelihood(point, moved))
        assert (found <= 1) == np.isfinite(likely)
        inside.append(found <= 1)
    assert 5 < sum(inside) < len(inside) - 5


@pytest.mark.slow
def test_patterns_are_drawn_as_probable_as_they_are() -> None:
    """Frequencies of 20,000 draws; those of a detector that exchanges half as often again do not
    pass."""
    posterior, point, pose, joints = max(
        rows("learned", False), key=lambda one: _entropy(every_pattern(*one[:3])[1])
    )
    faults, log_each = every_pattern(posterior, point, pose)
    probable = np.exp(log_each - log_each.max())
    number = 20_000
    keys = jax.random.split(key(4), number)

    def p_value(prior: FaultPrior) -> float:
        one = summed(posterior)._replace(faults=prior)
        drawn = jax.jit(jax.vmap(lambda some: one.draw(some, point, joints)))(keys)
        code = {
            (int(exchange), outlier.tobytes()): row
            for row, (exchange, outlier) in enumerate(zip(*faults, strict=True))
        }
        pairs = zip(np.asarray(drawn.exchange), np.asarray(drawn.outlier), strict=True)
        found = np.bincount(
            [code[int(exchange), outlier.tobytes()] for exchange, outlier in pairs],
            minlength=len(probable),
        )
        expected = number * probable / probable.sum()
        assert not found[probable == 0].any()
        often = expected > 5
        seen = [*found[often], found[~often].sum()]
        wanted = [*expected[often], expected[~often].sum() + 1e-9]
        return float(stats.chisquare(seen, np.array(wanted) * number / np.sum(wanted)).pvalue)

    assert p_value(FAULTS) > 0.001
    exchanges = tuple(1.5 * one for one in FAULTS.exchange)
    oftener = dataclasses.replace(FAULTS, exchange=exchanges)
    assert p_value(oftener) < 1e-6


def _entropy(log_each: np.ndarray) -> float:
    return float(stats.entropy(np.exp(log_each - log_each.max())))


@pytest.mark.slow
def test_without_faults_the_sum_is_the_likelihood() -> None:
    posterior, _, _ = case("disc")
    for _, point, pose, joints in itertools.islice(rows("disc", False), 3):
        plain = SummedFaults(posterior.detected, FaultPrior(), posterior.root_prior)
        observation = posterior.detected.under(posterior.root_prior, point, Faults.none())
        np.testing.assert_allclose(
            plain.log_likelihood(point, joints), observation.log_density(joints)
        )
        assert float(plain.misfit(point, joints)) == pytest.approx(
            float(observation.misfit(joints))
        )
        assert float(log_joint(posterior.model, observation, *pose)) == pytest.approx(
            float(observation.log_density(joints) + posterior.model.log_prior(*pose)), rel=1e-9
        )
        assert plain.faults.exchanges.tolist() == [0]
        assert jnp.isfinite(plain.misfit(point, joints))
