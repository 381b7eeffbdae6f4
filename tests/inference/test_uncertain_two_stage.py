"""Two-stage importance sampling: roots are taken from many by their first-stage weights, and
weighted by the inverse of their chance: what is taken is unbiased, whatever these weights were; the
evidence says how far it may be off; and more roots are effective."""

import dataclasses
import functools
import gc
import math
import weakref

import jax
import numpy as np
import pytest
from scipy import stats

from poseterior.inference.exact.groups import memoised_by_model
from poseterior.inference.exact.loops import gaussian
from poseterior.inference.exact.loops.first_stage import LANES
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance import torso_proposals, two_stage
from poseterior.inference.importance.fault_patterns import pool_of
from poseterior.inference.importance.limbs import CHAINED, ENDS, LIMBS, POOL_SIZE, prior_poses
from poseterior.inference.importance.torso_proposals import TorsoDraws, draw_roots
from poseterior.inference.importance.two_stage import _oversampling, _part_of_pool, _take
from poseterior.inference.importance.weighted import WeightedRoots, weigh_roots
from poseterior.probmodel import Likelihood, PoseModel
from poseterior.probmodel.anatomy.limits import EMBEDDED
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from tests.inference.test_uncertain_root import scales_apart, small_case
from tests.scenes import key, prior_scene


@functools.cache
def an_arm() -> Posterior:
    model, frame = small_case()
    return frame.posterior(model)


@functools.cache
def weighed(seed: int, number: int) -> WeightedRoots:
    return weigh_roots(an_arm(), key=key(seed), num_roots=number)


def test_rows_are_taken_by_their_chance() -> None:
    """Each at most once. Inverse chances make sums over the rows taken those over all of them:
    mean of 4,000 within 4.5 standard errors (7e-6), where without them it is far off."""
    rng = np.random.default_rng(0)
    score = 4 * rng.normal(size=60)
    value = np.exp(score / 4) * rng.exponential(size=60)
    right, wrong = [], []
    for _ in range(4000):
        rows, chance = _take(score, 12, rng)
        assert len(np.unique(rows)) == len(rows) == 12
        assert ((chance > 0) & (chance <= 1)).all()
        right.append(np.sum(value[rows] / chance))
        wrong.append(np.sum(value[rows]) * 60 / 12)
    error = np.std(right) / math.sqrt(4000)
    assert abs(np.mean(right) - value.sum()) < 4.5 * error
    assert abs(np.mean(wrong) - value.sum()) > 9 * np.std(wrong) / math.sqrt(4000)


def test_where_few_have_weight_there_is_more_oversampling() -> None:
    """Eight for one where all first-stage weights are the same; so many that 1.7 of them are as
    large as the largest where one in twelve is; 32 where one in 48 is, or where the estimates of a
    pilot run are as uneven as a scatter of 10 nats makes them; by the power that roots are taken
    by."""

    def oversampling(large: int) -> int:
        return _oversampling(np.where(np.arange(48) < large, 0.0, -np.inf))

    assert oversampling(48) == 8
    assert oversampling(4) == math.ceil(1.7 * 12)
    assert oversampling(1) == 32
    rng = np.random.default_rng(0)
    assert _oversampling(10 * rng.normal(size=48)) == 32
    assert _oversampling(0.1 * rng.normal(size=48)) == 8
    estimate = 5 * rng.normal(size=48)
    weight = np.exp(two_stage.FIRST_STAGE_POWER * estimate)
    wanted = 1.7 * 48 * np.sum(weight**2) / np.sum(weight) ** 2
    assert 8 < _oversampling(estimate) == math.ceil(wanted) < 32
    assert _oversampling(np.zeros(0)) == 8  # nothing is known of a pattern without any


def test_more_oversampling_is_by_fewer_draws_of_the_prior() -> None:
    """As much work in all, within a fifth; in whole vectors, or what is read lies outside."""
    model = PoseModel()
    least, most = two_stage.OVERSAMPLING
    for oversampling in range(least, most + 1):
        number = _part_of_pool(model, oversampling).shape[-1]
        assert number % LANES == 0
        assert 0.8 < oversampling * number / (least * POOL_SIZE) <= 1


def test_every_seed_has_the_same_pool_of_the_prior() -> None:
    """Once a model, whoever's camera it is seen by, and for no longer than the model is there."""
    made: list[int] = []

    @memoised_by_model
    def count(model: PoseModel) -> int:
        made.append(id(model))
        return len(made)

    model, other = PoseModel(), PoseModel()
    copy = other.seen_by(Lens(1500.0, np.array([320.0, 240.0])))
    assert [count(one) for one in (model, other, model, other, copy)] == [1, 2, 1, 2, 2]
    gone = weakref.ref(other.cells)
    del other, copy
    gc.collect()
    assert gone() is None
    assert pool_of(model) is pool_of(model)


@pytest.mark.slow
@pytest.mark.parametrize("limits", EMBEDDED)
def test_draws_that_judge_are_draws_of_the_prior(limits: str) -> None:
    """Attempts with nothing to explain, placed by a compiled loop, against the prior's own draws,
    placed by the model: means and mean squares of both joints and of what lies between them (5
    standard errors of as many draws as are different; false alarms 1e-4). Bones the other way round
    are found out."""
    model = PoseModel.from_anatomy(Anatomy.embedded(limits))
    pool = pool_of(model).astype(float)
    truth = placed(model, jax.jit(lambda key: model.draw(key, POOL_SIZE))(key(5)))
    judges = placed(model, prior_poses(model, [3, 4]))
    for limb, chained in enumerate(CHAINED):
        number = len(np.unique(pool[:, limb, 1], axis=1).T)
        assert number > POOL_SIZE / 2
        assert apart(judges[:, limb], truth[:, limb], POOL_SIZE) < 5
        assert apart(pool[:, limb], truth[:, limb], number) < 5
        assert apart(-pool[:, limb], truth[:, limb], number) > 20
        assert (pool[:, limb, 0] == pool[:, limb, 1]).all() == (not chained)


def test_limbs_that_nobody_saw_have_the_lengths_of_the_prior() -> None:
    """Each bone's by the distribution function of SciPy's Beta (Kolmogorov and Smirnov, five of
    them: false alarms 1e-3), independent of the others (ten correlations: false alarms 1e-3). Where
    parameters are half as large again, all five are found out."""
    model = PoseModel()
    low, high, alpha, beta = map(np.asarray, model.lengths)
    fraction = (prior_poses(model, [3, 4], lower=False).length - low) / (high - low)

    def p_values(times: float) -> np.ndarray:
        law = stats.beta(times * alpha, times * beta)
        return np.array([stats.kstest(each, "uniform").pvalue for each in law.cdf(fraction).T])

    assert p_values(1.0).min() > 1e-3 / 5
    assert p_values(1.5).max() < 1e-3 / 5
    others = np.corrcoef(fraction.T)[np.triu_indices(5, 1)]
    assert np.abs(others).max() < stats.norm.isf(1e-3 / 2 / 10) / math.sqrt(POOL_SIZE)


def placed(model: PoseModel, poses: Pose) -> np.ndarray:
    """As `pool_of`, by poses and the model's joints."""
    torso = np.asarray(model.torsos)[0]
    joints = np.asarray(model.joints(torso, *poses))
    starts = np.array([limb.bones[0].start for limb in LIMBS])
    axes = np.asarray(upper_axes(torso))[[limb.upper for limb in LIMBS]]
    return np.einsum("lij,plei->jlep", axes, joints[:, ENDS] - joints[:, starts, None])


def apart(one: np.ndarray, other: np.ndarray, number: int) -> float:
    """How many standard errors moments of two sets of joints `(3, 2, n)` are apart; of the first
    only so `number` are different."""
    values = [
        np.concatenate([part.reshape(6, -1), (part[:, 0] - part[:, 1])]) for part in (one, other)
    ]
    moments = [np.concatenate([part, part**2]) for part in values]
    error = [
        np.std(moments[0], axis=1) / math.sqrt(number),
        np.std(moments[1], axis=1) / math.sqrt(POOL_SIZE),
    ]
    gap = np.abs(moments[0].mean(axis=1) - moments[1].mean(axis=1))
    return float(np.max(gap / np.maximum(np.hypot(*error), 1e-9)))


def test_where_all_are_wanted_all_are_taken() -> None:
    rows, chance = _take(np.array([-700.0, 0.0, 3.0]), 3, np.random.default_rng(0))
    np.testing.assert_array_equal(rows, [0, 1, 2])
    np.testing.assert_array_equal(chance, [1, 1, 1])


@pytest.mark.slow
def test_the_evidence_is_unbiased_wherever_proposals_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the last root looked for, at the limit, or with the last root needed: each is how some
    of 600 searches end, and their mean is that of 3,000 roots (4 standard errors, 6e-5). That of
    those that end before the limit is too large: they are those that were lucky."""

    def drawn(words: list[int], number: int, most: int) -> TorsoDraws:
        return draw_roots(an_arm(), Faults.none(), words, number, Budget(10**9), most=most)

    truth = drawn([0, 0], 3000, 3000)
    each = truth.proposals / 3000
    monkeypatch.setattr(torso_proposals, "TORSO_PROPOSALS", int(1.2 * each))
    found = [drawn([1, seed], 2, 4) for seed in range(600)]
    numbers = np.array([len(one.points.torso) for one in found])
    made = np.array([one.proposals for one in found])
    limit = 2 * torso_proposals.TORSO_PROPOSALS
    ends = {
        "most": (numbers == 4) & (made < limit),
        "limit": made == limit,
        "number": (numbers == 2) & (made > limit),
    }
    assert np.sum(list(ends.values())) == 600
    assert min(chosen.sum() for chosen in ends.values()) > 60
    ratio = np.exp([one.log_evidence - truth.log_evidence for one in found])
    error = math.hypot(ratio.std() / math.sqrt(600), math.sqrt(truth.variance))
    assert abs(ratio.mean() - 1) < 4 * error < 0.4
    lucky = ratio[ends["most"]]
    assert lucky.mean() - 1 > 4 * lucky.std() / math.sqrt(len(lucky))


@pytest.mark.slow
def test_first_stage_weights_change_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roots as they come, roots by first-stage weights, and roots by weights that are the wrong
    way round have one evidence (4 standard errors); without the inverse chances it is
    another one."""
    two_staged = weighed(0, 1500)
    monkeypatch.setattr(two_stage, "OVERSAMPLING", (1, 1))
    plain = weigh_roots(an_arm(), key=key(1), num_roots=1500)
    monkeypatch.setattr(two_stage, "OVERSAMPLING", (4, 4))
    monkeypatch.setattr(two_stage, "FIRST_STAGE_POWER", -0.3)
    perverse = weigh_roots(an_arm(), key=key(2), num_roots=1500)
    for one in (plain, perverse):
        error = math.hypot(two_staged.log_evidence_se, one.log_evidence_se)
        assert abs(two_staged.log_evidence - one.log_evidence) < 4 * error < 0.6
    monkeypatch.setattr(two_stage, "FIRST_STAGE_POWER", 0.85)
    taken = two_stage._take
    monkeypatch.setattr(
        two_stage, "_take", lambda *arguments: (taken(*arguments)[0], np.ones(arguments[1]))
    )
    wrong = weigh_roots(an_arm(), key=key(3), num_roots=1500)
    error = math.hypot(two_staged.log_evidence_se, wrong.log_evidence_se)
    assert abs(two_staged.log_evidence - wrong.log_evidence) > 8 * error


@pytest.mark.slow
def test_more_roots_are_effective(monkeypatch: pytest.MonkeyPatch) -> None:
    """All joints seen: three times as many, for a quarter of the roots' own cost."""
    model = PoseModel()
    posterior = prior_scene(model, 3, factor=0.4).posterior(model)
    two_staged = weigh_roots(posterior, key=key(0), num_roots=200)
    monkeypatch.setattr(two_stage, "OVERSAMPLING", (1, 1))
    plain = weigh_roots(posterior, key=key(0), num_roots=200)
    assert two_staged.proposed.chance.mean() < plain.proposed.chance.min() == 1
    assert two_staged.effective > 3 * plain.effective


@pytest.mark.slow
def test_sharp_torsos_have_the_evidence_of_exact_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where joints are known well, roots by approximations, few of them, so that some have more
    weight than others, against roots by bounds: evidence and mean scale (4 standard errors,
    1.3e-4)."""
    monkeypatch.setattr(torso_proposals, "AMPLE", 0.3)
    monkeypatch.setattr(gaussian, "APPROXIMATE", 0.6)
    model = PoseModel(torsos=np.asarray(PoseModel().torsos)[[0, 17, 40]])
    frame = prior_scene(model, 11, factor=0.3)
    likelihood = Likelihood(Gaussian(), factor=0.3)
    posterior = dataclasses.replace(frame, likelihood=likelihood).posterior(model)
    quick = weigh_roots(posterior, key=key(1), num_roots=1000)
    monkeypatch.setattr(
        two_stage,
        "weighted_proposal",
        lambda problem, levels=0: torso_proposals.exact_proposal(problem),
    )
    exact = weigh_roots(posterior, key=key(2), num_roots=1000)
    error = math.hypot(quick.log_evidence_se, exact.log_evidence_se)
    assert abs(quick.log_evidence - exact.log_evidence) < 4 * error < 0.5
    assert scales_apart(quick, exact) < 4


def test_a_small_budget_is_not_spent_on_a_first_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was enough for roots as they come is enough."""
    with monkeypatch.context() as patch:
        patch.setattr(two_stage, "OVERSAMPLING", (1, 1))
        plain = weigh_roots(an_arm(), key=key(5), num_roots=100)
    enough = (
        plain.proposals + 4 * torso_proposals.MOST_AT_A_TIME
    )  # proposals are allowed in batches
    tight = weigh_roots(an_arm(), key=key(5), num_roots=100, max_proposals=enough)
    assert len(tight.log_weight) == 100
    np.testing.assert_array_equal(tight.log_weight, plain.log_weight)


@pytest.mark.slow
def test_the_evidence_is_as_uncertain_as_it_says() -> None:
    """Sixty evidences of forty roots each stray around that of many roots as their standard errors
    say: the mean square of their ratio lies between 0.5 and 1.8 (1e-3 either side), with half the
    errors it does not."""
    truth = weighed(0, 1500)
    few = [weighed(seed, 40) for seed in range(100, 160)]
    error = np.array([one.log_evidence_se for one in few])
    # Relative errors of evidences, not of their logs, are unbiased.
    stray = np.exp([one.log_evidence - truth.log_evidence for one in few]) - 1
    ratio = np.mean((stray / np.hypot(error, truth.log_evidence_se)) ** 2)
    assert 0.5 < ratio < 1.8
    assert not 0.5 < 4 * ratio < 1.8
