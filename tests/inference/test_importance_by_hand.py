"""What the importance route makes of roots, number by number: exact expectations of small cases,
written out anew, without a draw of a limb. A statistic that only a long run looks at is no
statistic that is looked at.
"""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior.inference.exact.groups import group_tables
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.tables import ROOTS
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance import rejection, torso_proposals, two_stage
from poseterior.inference.importance.fault_patterns import (
    FaultPattern,
    FitScore,
    fault_patterns,
    log_priors,
    propose_faults,
)
from poseterior.inference.importance.limbs import LimbSampling, blind, weigh_limbs
from poseterior.inference.importance.rejection import (
    ATTEMPTS,
    FIRST,
    ROOM,
    Taken,
    _bound,
    _result,
    _Rounds,
)
from poseterior.inference.importance.torso_proposals import (
    TORSO_ZERO_ACCEPTANCE_LIMIT,
    Batches,
    draw_torso,
    exact_proposal,
    weighted_proposal,
)
from poseterior.inference.importance.torsos import log_mass, rotations_of, torso_problem
from poseterior.inference.importance.two_stage import PatternRoots, propose_roots
from poseterior.inference.importance.weighted import WeightedRoots, _enough, log_limbs
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, TORSO_JOINTS
from tests.inference.test_oracle import (
    FAR,
    FOCAL,
    OUTLIERS,
    PRINCIPAL,
    SEEN,
    Row,
    likelihood,
    model,
    scene,
)
from tests.scenes import key


def posterior(row: Row, lens: Lens | None = None) -> Posterior:
    """Torso and one arm seen, as the oracle has them."""
    people = model() if lens is None else model().seen_by(lens)
    return dataclasses.replace(scene(), likelihood=likelihood(row)).posterior(people, UNCERTAIN)


def some_roots(number: int) -> RootPoint:
    """Roots here and there."""
    rng = np.random.default_rng(0)
    turns, _ = np.linalg.qr(rng.normal(size=(number, 3, 3)))
    turns *= np.linalg.det(turns)[:, None, None]
    return RootPoint(
        rng.integers(3, size=number),
        turns,
        np.log(rng.uniform(50, 90, number)),
        rng.normal(PRINCIPAL, 30, (number, 2)),
    )


# Roots that have weights.


def test_roots_are_drawn_as_often_as_their_weights_say() -> None:
    """A thousand draws of four roots, whose limbs are nowhere: systematic resampling is as their
    shares to within one draw; by no weight it would be 333 each."""
    share = np.array([0.1, 0.2, 0.7, 0.0])
    with np.errstate(divide="ignore"):
        log_weight = np.log(share) - 20
    points = some_roots(4)
    proposed: Any = SimpleNamespace(points=points)
    nothing: Any = None
    roots = WeightedRoots(nothing, proposed, [{}] * 4, log_weight, 0)
    drawn, _, chosen = roots.draw(np.random.default_rng(0), 1000)
    counts = np.bincount(chosen, minlength=4)
    np.testing.assert_allclose(counts, 1000 * share, atol=1)
    np.testing.assert_array_equal(drawn.log_scale, points.log_scale[chosen])


@pytest.mark.parametrize("lens", [None, Lens(FOCAL, PRINCIPAL)])
def test_limbs_weigh_roots_by_the_size_of_a_pixel_at_every_joint(lens: Lens | None) -> None:
    """An elbow and a wrist are seen, each worth scale⁻² (the perspective of limbs is in their own
    weights); and every joint of the torso that is seen has what perspective makes of its errors:
    the square of (1 + scale × depth / focal length), the depth being that of the turned torso."""
    found = posterior(Row(UNCERTAIN, "", "gaussian"), lens)
    points = some_roots(7)
    zero: Any = None
    limbs: list[dict[str, Any]] = [
        {"arms": SimpleNamespace(log_evidence=-float(row), draws=zero)} for row in range(7)
    ]
    scale = np.exp(points.log_scale)
    expected = -np.arange(7.0) - 2 * 2 * points.log_scale
    if lens is not None:
        torsos = np.asarray(found.model.torsos)[points.torso]
        depth = np.einsum("ni,nji->nj", points.rotation[:, 2], torsos)
        seen = [row for row, name in enumerate(TORSO_JOINTS) if name in SEEN]
        expected += 2 * np.log1p(scale[:, None] * depth[:, seen] / FOCAL).sum(axis=1)
    weight = log_limbs(found, points, Faults.none(7), limbs)
    np.testing.assert_allclose(weight, expected, rtol=1e-9)


def test_every_root_has_limbs_of_its_own_in_whatever_block_it_is() -> None:
    """Three roots that see nothing: no two have the same draws, and the last two have those that
    they have by themselves."""
    sampling = LimbSampling(group_tables(model()), {}, [1, 2], Gaussian(), {1: (4, 2), 2: (4, 2)})

    def lengths(number: int, first: int) -> list[np.ndarray]:
        views = blind(number)
        found = weigh_limbs(sampling, views, np.zeros(views.reach.shape, bool), first)
        return [one["arms"].draws[0] for one in found]

    whole, part = lengths(3, 0), lengths(2, 1)
    assert len(np.unique([one[0, 0] for one in whole])) == 3
    np.testing.assert_array_equal(whole[1:], part)


def test_an_outlier_is_worth_its_odds_and_its_own_peak() -> None:
    """Of a wrist that is an outlier, instead of none, the prior is worth w / (1 - w), and the peak
    of its density that of the far disc; so it is of the hip, the torso having one at most."""
    found = posterior(Row(UNCERTAIN, "", "gaussian", faults="outliers"))
    outlier = np.zeros((3, len(JOINTS)), bool)
    wrist, hip = JOINT_INDEX["right_wrist"], JOINT_INDEX["left_hip"]
    outlier[1, wrist] = outlier[2, hip] = True
    none, of_wrist, of_hip = log_priors(found, Faults(np.zeros(3, int), outlier))
    spread = np.asarray(found.detected.spread)

    def peak(joint: int) -> float:
        """Of the far disc over that of the Gaussian of σ = half a spread, cut off at 3 σ."""
        near = 2 * math.pi * (spread[joint] / 2) ** 2 * (1 - math.exp(-9 / 2))
        return math.log(near / (math.pi * FAR**2))

    odds = {name: share / (1 - share) for name, share in OUTLIERS.items()}
    assert of_wrist - none == pytest.approx(math.log(odds["right_wrist"]) + peak(wrist), abs=1e-9)
    assert of_hip - none == pytest.approx(math.log(odds["left_hip"]) + peak(hip), abs=1e-9)


@pytest.mark.parametrize(("effective", "enough"), [(7.3, 5500), (19.0, 2200), (0.2, 100_000)])
def test_as_many_roots_as_would_do(effective: float, enough: int) -> None:
    """Twenty effective ones and as many again, if they are worth what these thousand are: two
    digits, rounded up, and no more than fit the memory."""
    roots: Any = SimpleNamespace(log_weight=np.zeros(1000), effective=effective)
    assert _enough(roots) == enough


# Roots that are proposed.


def test_a_pattern_that_a_pilot_run_did_not_find_is_not_looked_for_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of three patterns (no outlier of the torso, a shoulder, a hip) the second brought no root."""
    found = posterior(Row(UNCERTAIN, "", "disc", faults="outliers"))
    estimates = iter([np.zeros(5), np.zeros(0), np.zeros(3)])
    monkeypatch.setattr(two_stage, "weighted_proposal", lambda *_: SimpleNamespace())
    numbers = iter((1, 10, 100))

    def drawn(plans: list[two_stage.PatternPlan], *_: Any) -> list[Any]:
        return [SimpleNamespace(proposals=next(numbers), log_evidence=0.0) for _ in plans]

    monkeypatch.setattr(two_stage, "_draw", drawn)
    monkeypatch.setattr(two_stage, "_pilot_estimate", lambda *_: next(estimates))
    plans, spent = two_stage._plan(found, key(0), Budget(1000), True, np.random.default_rng(0))
    assert [plan.likely for plan in plans] == [True, False, True]
    assert spent == 111


LENSES, COMMON = 3, math.log(0.7)
SOUND = np.array([0.2, 1.0, 0.05])
"""What no faults have under each focal length."""


def planned(
    monkeypatch: pytest.MonkeyPatch, odds: float, seed: int, sound: np.ndarray = SOUND
) -> list[two_stage.PatternPlan]:
    """Plans of no outlier, of one of a shoulder and of one of a hip, under three focal lengths,
    where pilot runs give the shoulder such odds, and the hip 0.3, under each of them."""
    found = posterior(Row(UNCERTAIN, "", "disc", faults="outliers"))
    several = [
        pattern._replace(lens=lens) for pattern in fault_patterns(found) for lens in range(LENSES)
    ]
    score = {id(several[index].faults): value for index, value in ((0, 1.0), (3, odds), (6, 0.3))}
    monkeypatch.setattr(two_stage, "fault_patterns", lambda _: several)
    monkeypatch.setattr(two_stage, "lenses_of", lambda _: LENSES)
    monkeypatch.setattr(two_stage, "torso_problem", lambda *of: of[1:])
    monkeypatch.setattr(two_stage, "weighted_proposal", lambda problem, *_: problem)

    def drawn(plans: list[two_stage.PatternPlan], *_: Any) -> list[Any]:
        own = [score[id(plan.pattern.faults)] * sound[plan.pattern.lens] for plan in plans]
        with np.errstate(divide="ignore"):
            return [SimpleNamespace(proposals=1, log_evidence=np.log(one) + COMMON) for one in own]

    monkeypatch.setattr(two_stage, "_draw", drawn)
    monkeypatch.setattr(two_stage, "_pilot_estimate", lambda *_: np.zeros(1))
    monkeypatch.setattr(two_stage, "_log_prior", lambda *_: 0.0)
    rng = np.random.default_rng(seed)
    plans, spent = two_stage._plan(found, key(0), Budget(1000), True, rng)
    anew = sum(plan.pattern.stands_for == 1 for plan in plans) - LENSES
    assert spent == LENSES + 2 + anew  # every pilot run is counted
    for plan in plans:
        assert plan.problem == (plan.pattern.faults, plan.pattern.lens)
        assert plan.likely == (plan.pattern.stands_for == 1)
    return plans


def test_rare_faults_are_looked_at_under_one_focal_length_that_stands_for_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Odds of 0.001 are rare, of 0.3 are not. A focal length stands for as many as its chance says,
    which is what no faults have under it, and an even tenth; its share is that of all of them."""
    chance = 0.9 * SOUND / SOUND.sum() + 0.1 / LENSES
    runs, lenses = 60, []
    for seed in range(runs):
        plans = planned(monkeypatch, 0.001, seed)
        assert [plan.pattern.lens for plan in plans[:3] + plans[4:]] == 2 * [0, 1, 2]
        lens = plans[3].pattern.lens
        assert lens is not None
        stood = [plan.pattern.stands_for for plan in plans]
        np.testing.assert_allclose(stood, [1, 1, 1, 1 / chance[lens], 1, 1, 1])
        lenses.append(lens)
    counts = np.bincount(lenses, minlength=LENSES)
    assert stats.chisquare(counts, runs * chance).pvalue > 1e-3
    score = np.array([*SOUND, 0.001 * SOUND.sum(), *(0.3 * SOUND)])
    share = [plan.share for plan in plans]
    np.testing.assert_allclose(share, 0.9 * score / score.sum() + 0.1 / 7)
    often = planned(monkeypatch, 0.1, 0)
    assert [plan.pattern.stands_for for plan in often] == [1] * 9
    assert [plan.pattern.lens for plan in often] == 3 * [0, 1, 2]


def test_faults_are_rare_beside_the_best_focal_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the one in the middle explains nothing, faults of odds 0.1 are not rare for that; where
    none does, nothing is."""
    for sound in (np.array([0.0, 0.0, 1.0]), np.zeros(3)):
        plans = planned(monkeypatch, 0.1, 0, sound)
        assert [plan.pattern.stands_for for plan in plans] == [1] * 9


def fake_plan(share: float, oversampling: int = 8, stands_for: int = 1) -> Any:
    """Of a pattern whose torso problem nobody asks for."""
    pattern = SimpleNamespace(stands_for=stands_for)
    return SimpleNamespace(share=share, oversampling=oversampling, likely=True, pattern=pattern)


def fake_draws(log_evidence: float, share: np.ndarray, inclusion: float) -> Any:
    """Roots that have these shares of a torso's evidence."""
    return SimpleNamespace(
        points=some_roots(len(share)),
        log_share=np.log(share),
        inclusion=np.full(len(share), inclusion),
        log_evidence=log_evidence,
        proposals=100,
        enough=True,
    )


def test_shares_of_the_roots_are_no_part_of_the_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two patterns whose torsos have the evidences 2 and 5, and a quarter and three quarters of
    twenty roots. Of the first, five of forty roots are taken, all alike; of the second all fifteen,
    which have shares of 1 to 15. Faults are proposed by exp(-0.7) where the prior says exp(-0.2).
    The mean weight is the sum of both evidences times exp(0.5), to the last digit; a focal length
    that stands for five counts five times."""
    uneven = np.arange(1, 16) / 120
    torsos = [
        fake_draws(math.log(2), np.full(40, 1 / 40), 0.5),
        fake_draws(math.log(5), uneven, 0.25),
    ]
    monkeypatch.setattr(two_stage, "_plan", lambda *_: ([fake_plan(0.25), fake_plan(0.75)], 30))
    monkeypatch.setattr(two_stage, "_draw", lambda *_: torsos)
    scores: Any = SimpleNamespace(take=lambda rows: rows)
    for name, found in {
        "_part_of_pool": lambda *_: None,
        "fit_score": lambda *_: scores,
        "log_first_stage": lambda *arguments: np.zeros(len(arguments[-1].torso)),
        "propose_faults": lambda rows, *_: (Faults.none(len(rows)), np.full(len(rows), -0.7)),
        "log_priors": lambda _, faults: np.full(len(faults.exchange), -0.2),
    }.items():
        monkeypatch.setattr(two_stage, name, found)
    people: Any = SimpleNamespace(model=None)
    proposed = propose_roots(people, key(0), 20, Budget(1000))
    weight, second = np.exp(proposed.log_weight - 0.5), proposed.pattern == 1
    assert (~second).sum() == 5
    assert weight.mean() == pytest.approx(2 + 5)
    np.testing.assert_allclose(weight[~second], 2 / 0.25)
    np.testing.assert_allclose(np.sort(weight[second]), 5 * 20 * uneven)
    np.testing.assert_allclose(proposed.chance[~second], 0.5 * 5 / 40)
    np.testing.assert_allclose(proposed.chance[second], 0.25)
    np.testing.assert_array_equal(proposed.made, [100, 100])
    alone = [fake_plan(0.25, stands_for=5), fake_plan(0.75)]
    monkeypatch.setattr(two_stage, "_plan", lambda *_: (alone, 30))
    weight = np.exp(propose_roots(people, key(0), 20, Budget(1000)).log_weight - 0.5)
    assert weight.mean() == pytest.approx(5 * 2 + 5)


def test_a_pattern_has_the_share_of_roots_that_it_has_of_the_posterior(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By the sum of its pilot roots' estimates × the torso's evidence × the prior of its faults:
    2 × 3 × 1 and (1 + 3) × 1 × 1/2 are 3 to 1; one tenth is shared out evenly among three, of which
    the last brought no root. Where none did, all is."""
    values = (3.0, 1.0, 9.0)
    drawn = [SimpleNamespace(log_evidence=math.log(one), proposals=1) for one in values]
    estimates = iter([np.log([2.0]), np.log([1.0, 3.0]), np.zeros(0)])
    prior = {0: 0.0, 1: math.log(0.5), 2: 0.0}
    monkeypatch.setattr(two_stage, "_draw", lambda *_: drawn)
    monkeypatch.setattr(two_stage, "_pilot_estimate", lambda *_: next(estimates))
    monkeypatch.setattr(two_stage, "_log_prior", lambda _, pattern: prior[pattern])
    nothing: Any = None
    plans: Any = [SimpleNamespace(pattern=pattern) for pattern in range(3)]
    pilots = two_stage._pilots(nothing, plans, key(0), Budget(1000))
    share = two_stage._shares(np.array([pilot.score for pilot in pilots]))
    np.testing.assert_allclose(share, 0.9 * np.array([0.75, 0.25, 0.0]) + 0.1 / 3)
    np.testing.assert_allclose(two_stage._shares(np.full(3, -np.inf)), 1 / 3)


def test_a_pilot_root_has_its_share_of_the_torso(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the limbs say of it × what it has of the torso's evidence: of four roots together it is
    their mean, however unevenly they were drawn."""
    share = np.array([0.1, 0.2, 0.3, 0.4])
    monkeypatch.setattr(two_stage, "fit_score", lambda *_: None)
    monkeypatch.setattr(two_stage, "pool_of", lambda _: None)
    monkeypatch.setattr(two_stage, "log_first_stage", lambda *_: np.log([4.0, 3.0, 2.0, 1.0]))
    people: Any = SimpleNamespace(model=None)
    nothing: Any = None
    found = two_stage._pilot_estimate(people, nothing, fake_draws(7.0, share, 1.0))
    assert np.exp(found).sum() == pytest.approx(share @ [4, 3, 2, 1])
    assert not len(two_stage._pilot_estimate(people, nothing, fake_draws(7.0, share[:0], 1.0)))


def test_an_outlier_of_the_torso_is_worth_as_much_in_its_pattern() -> None:
    """As `test_an_outlier_is_worth_its_odds_and_its_own_peak` has it, over that of no outlier."""
    found = posterior(Row(UNCERTAIN, "", "gaussian", faults="outliers"))
    none, *some = fault_patterns(found)
    outlier = np.stack([pattern.faults.outlier for pattern in (none, *some)])
    priors = log_priors(found, Faults(np.zeros(len(outlier), int), outlier))
    logs = [two_stage._log_prior(found, pattern) for pattern in (none, *some)]
    assert logs[0] == 0
    np.testing.assert_allclose(logs, priors - priors[0])
    assert max(logs[1:]) < -3


def test_a_limbs_outliers_are_proposed_as_often_as_is_said() -> None:
    """Of the right arm none, the elbow, the wrist or both, with scores of 1 to 4 tenths; a tenth of
    all is proposed by the roots of these. False alarms: one in 10,000."""
    number, chance = 4000, np.array([0.1, 0.2, 0.3, 0.4])
    share = 0.9 * chance + 0.1 * np.sqrt(chance) / np.sqrt(chance).sum()
    limbs = np.full((number, 1, 5, 4), -np.inf)
    limbs[..., 0] = 0.0
    limbs[:, 0, 1] = np.log(chance)
    score = FitScore(limbs, (0,), np.zeros(1))
    nothing = FaultPattern(Faults.none(), (0,))
    faults, log_proposal = propose_faults(score, nothing, np.random.default_rng(0))
    arm = [JOINT_INDEX["right_elbow"], JOINT_INDEX["right_wrist"]]
    which = faults.outlier[:, arm] @ [1, 2]
    assert stats.chisquare(np.bincount(which, minlength=4), number * share).pvalue > 1e-4
    np.testing.assert_allclose(log_proposal, np.log(share)[which])
    assert not np.delete(faults.outlier, arm, axis=1).any()


@pytest.mark.parametrize("lens", [None, Lens(FOCAL, PRINCIPAL)])
def test_a_root_is_taken_by_what_its_limbs_would_weigh_it(lens: Lens | None) -> None:
    """The first-stage weight is what `log_limbs` makes of the fit in the limbs' evidence's
    place."""
    found, points = posterior(Row(UNCERTAIN, "", "gaussian"), lens), some_roots(7)
    fit: Any = SimpleNamespace(total=-np.arange(7.0))
    (pattern,) = fault_patterns(found)
    none: Any = None
    limbs: list[dict[str, Any]] = [
        {"arms": SimpleNamespace(log_evidence=-float(row), draws=none)} for row in range(7)
    ]
    expected = log_limbs(found, points, Faults.none(7), limbs)
    weight = two_stage.log_first_stage(found, fit, pattern, points)
    np.testing.assert_allclose(weight, expected, rtol=1e-9)


def test_weighted_proposals_have_the_mean_of_their_weights(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half of the proposals bring roots, of weights 1 and 3, and so one on average: the
    evidence is the mass. Two hundred are taken, those that weigh more three times as often; then
    all have the same share. The variance is that of as many weights: 5/2 - 1 over their number."""

    def propose(_state: Any, proposals: int, roots: np.ndarray) -> tuple[int, int]:
        roots["inverse"] = 1.0
        roots["torso"][proposals // 4 :] = 1
        roots["log_weight"] = np.log([1.0, 3.0])[roots["torso"]]
        return proposals // 2, proposals

    problem: Any = SimpleNamespace(lowest=1.0, highest=2.0, upright=0.0)
    proposal: Any = SimpleNamespace(mass=7.0, propose=propose, thinned=False, exact=False)
    monkeypatch.setattr(torso_proposals, "log_mass", lambda _, mass: math.log(mass))
    monkeypatch.setattr(
        torso_proposals, "points_of", lambda _, roots: SimpleNamespace(torso=roots["torso"])
    )
    batches = Batches(problem, proposal, [0, 0])
    found = draw_torso(batches, 100, Budget(10**6), most=200)
    made = found.proposals - torso_proposals.PROBE
    assert found.log_evidence == pytest.approx(math.log(7))
    assert found.variance == pytest.approx(1.5 / made)
    np.testing.assert_allclose(found.log_share, -math.log(200))
    assert abs(found.points.torso.sum() - 150) <= 1
    expected = np.where(found.points.torso == 1, 3, 1) * 200 / made
    np.testing.assert_allclose(found.inclusion, expected)


def test_proposals_of_which_none_is_a_root_count_as_the_budget_has_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem: Any = SimpleNamespace(lowest=1.0, highest=2.0, upright=0.0)
    proposal: Any = SimpleNamespace(
        mass=7.0, propose=lambda _, proposals, roots: (0, proposals), thinned=False, exact=False
    )
    monkeypatch.setattr(torso_proposals, "points_of", lambda _, roots: some_roots(len(roots)))
    budget = Budget(10**6)
    found = draw_torso(Batches(problem, proposal, [0, 0]), 100, budget, most=200)
    assert found.proposals == budget.spent > torso_proposals.PROBE
    assert found.log_evidence == -math.inf


@pytest.mark.parametrize(
    ("every", "drawn", "rate"),
    [(2000, 4, 3 / 7999), (7001, 2, 2 / 16384), (16000, 2, 1 / 48767)],
    ids=["most", "limit", "number"],
)
def test_proposals_that_a_root_ends_are_one_fewer(
    every: int, drawn: int, rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two roots are wanted, or four within 2 × 8,192 proposals; each batch (8,192, 8,192, 16,384,
    16,384 …) brings them at the same places. Where the last root ended the search, (m - 1) /
    (n - 1) is without bias; where the limit did, m / n."""

    def propose(_state: Any, proposals: int, roots: np.ndarray) -> tuple[int, int]:
        number = np.arange(every - 1, proposals, every)
        roots["inverse"] = 1.0
        roots["number"][: len(number)] = number
        return len(number), proposals

    problem: Any = SimpleNamespace(lowest=1.0, highest=2.0, upright=0.0)
    proposal: Any = SimpleNamespace(mass=7.0, propose=propose, thinned=False, exact=True)
    monkeypatch.setattr(torso_proposals, "log_mass", lambda _, mass: math.log(mass))
    monkeypatch.setattr(torso_proposals, "points_of", lambda _, roots: roots)
    found = draw_torso(Batches(problem, proposal, [0, 0]), 2, Budget(10**6), most=4)
    assert len(found.log_share) == drawn
    assert found.log_evidence == pytest.approx(math.log(7 * rate))


def test_no_root_is_nearer_than_the_prior_allows() -> None:
    """Scales are the lowest over the inverse: of four proposals two are not above the highest."""

    def propose(_state: Any, proposals: int, roots: np.ndarray) -> tuple[int, int]:
        roots["inverse"][:4] = [0.2, 0.49, 0.51, 0.9]
        return 4, proposals

    problem: Any = SimpleNamespace(lowest=1.0, highest=2.0, upright=0.0)
    proposal: Any = SimpleNamespace(propose=propose, thinned=False, exact=True)
    roots, _ = Batches(problem, proposal, [0, 0]).make(8, 8, 0)
    np.testing.assert_array_equal(roots["inverse"], [0.51, 0.9])


class TorsoByHand(NamedTuple):
    """Joints of torsos whose errors are Gaussian: roots of the product, and its log evidence."""

    problem: Any
    roots: np.ndarray
    log_evidence: float


PROPOSALS = 1 << 16


@pytest.fixture(scope="module")
def torso() -> TorsoByHand:
    problem = torso_problem(posterior(Row(UNCERTAIN, "", "gaussian", bias=True)), Faults.none())
    proposal = exact_proposal(problem)
    roots, made = Batches(problem, proposal, [1, 2]).make(PROPOSALS, PROPOSALS, 0)
    return TorsoByHand(
        problem, roots, log_mass(problem, proposal.mass) + math.log(len(roots) / made)
    )


def least_squares(problem: Any, image: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of torsos seen `(n, joints, 2)` without their errors: the weighted means of detections and
    joints, and the best inverse scale with what it leaves of χ²."""
    weight = problem.joints.precision
    middle = np.average(problem.joints.keypoints, axis=0, weights=weight)
    own = np.average(image, axis=1, weights=weight)
    apart, seen = problem.joints.keypoints - middle, image - own[:, None]
    lever = np.einsum("j,jx,jx->", weight, apart, apart)
    best = np.einsum("j,jx,njx->n", weight, apart, seen) / lever
    square = np.einsum("j,njx,njx->n", weight, seen, seen) - lever * best**2
    return middle, own, best, square, lever


def images(problem: Any, torsos: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """`(n, joints, 2)`: where joints are detected in the mean, biases included."""
    turned = np.einsum("nxi,nji->njx", rotations, problem.joints.torsos[torsos])
    return turned[..., :2] + problem.joints.bias


def test_a_root_lies_where_its_keypoints_are_less_their_biases(torso: TorsoByHand) -> None:
    """Given rotation and scale, the place of the pelvis is normal about the weighted mean of what
    detections say: over all roots the standard scores have mean 0 and variance 1, to 4 standard
    errors. Biases of a fifth of a body unit that are forgotten move it by ten."""
    problem, roots = torso.problem, torso.roots
    middle, own, *_ = least_squares(problem, images(problem, roots["torso"], rotations_of(roots)))
    sharp = math.sqrt(problem.joints.precision.sum())
    scores = sharp * (roots["plane"] - roots["inverse"][:, None] * middle + own)
    error = 4 / math.sqrt(len(roots))
    assert len(roots) > 400
    assert np.abs(scores.mean(axis=0)).max() < error
    assert np.abs(scores.var(axis=0) - 1).max() < math.sqrt(2) * error
    aside = np.average(problem.joints.bias, axis=0, weights=problem.joints.precision)
    assert np.abs(sharp * aside).max() > 2 * error


def test_the_evidence_of_a_torso_is_that_of_all_rotations(torso: TorsoByHand) -> None:
    """Rotations by Haar's measure, the inverse scale by quadrature, the place in closed form:
    within 4 standard errors of both together, some 15 %. (What is cut off beyond 3 σ is less.)"""
    problem, rng, number = torso.problem, np.random.default_rng(0), 200_000
    four = rng.normal(size=(number, 4))
    rotations = Rotation.from_quat(four).as_matrix()
    torsos = rng.integers(len(problem.joints.torsos), size=number)
    _, _, best, square, lever = least_squares(problem, images(problem, torsos, rotations))
    inverse = (np.arange(1000) + 0.5) / 1000
    at = np.linspace(best.min(), best.max(), 500)
    density = inverse ** (problem.joints.power - 1) * np.exp(
        -lever / 2 * (inverse - at[:, None]) ** 2
    )
    weight = np.interp(best, at, density.mean(axis=1)) * np.exp(-square / 2)
    weight *= 2 * math.pi / problem.joints.precision.sum()
    expected = math.log(weight.mean()) - problem.joints.power * math.log(problem.lowest)
    error = math.hypot(weight.std() / weight.mean() / math.sqrt(number), len(torso.roots) ** -0.5)
    assert error < 0.06
    assert abs(torso.log_evidence - expected) < 4 * error


def test_weights_make_up_for_approximations(torso: TorsoByHand) -> None:
    """Of proposals by approximate cells: the mean weight × the mass is the evidence by bounds, to 4
    standard errors; by approximations without their weights it is not, by far."""
    problem = torso.problem
    proposal = weighted_proposal(problem)
    roots, made = Batches(problem, proposal, [3, 4]).make(PROPOSALS, PROPOSALS, 0)
    weight = np.exp(roots["log_weight"])
    evidence = log_mass(problem, proposal.mass) + math.log(weight.sum() / made)
    error = math.hypot(len(torso.roots) ** -0.5, math.sqrt(np.sum(weight**2)) / weight.sum())
    assert error < 0.02
    assert abs(evidence - torso.log_evidence) < 4 * error
    forgotten = log_mass(problem, proposal.mass) + math.log(len(roots) / made)
    assert abs(forgotten - torso.log_evidence) > 9 * error


@pytest.mark.parametrize(("law", "df"), [("student", 5.0), ("gaussian", None)])
def test_a_root_counts_by_what_its_law_has_more_than_the_proposal(
    law: str, df: float | None
) -> None:
    """A Student's t is proposed by the Gaussian that is as dense at the peak and at the reach,
    beyond which lies e^-4.5 of the mass: SciPy's density of every joint's error over that Gaussian,
    beside the weights that approximate cells have. A Gaussian is its own proposal."""
    problem = torso_problem(posterior(Row(UNCERTAIN, "", law, bias=True)), Faults.none())
    proposal = weighted_proposal(problem)
    found, _ = Batches(problem, proposal, [5, 6]).make(1 << 12, 1 << 12, 0)
    bare = np.zeros(1 << 12, ROOTS)
    number, _ = proposal.propose(seeded([5, 6], 0), 1 << 12, bare)
    bare = bare[:number][problem.lowest <= problem.highest * bare["inverse"][:number]]
    assert len(bare) > 1000
    expected = np.zeros(len(bare))
    if df is not None:
        image = images(problem, bare["torso"], rotations_of(bare)) + bare["plane"][:, None]
        error = image - bare["inverse"][:, None, None] * problem.joints.keypoints
        standard = error / problem.joints.reach[:, None] * math.sqrt(df * math.expm1(9 / df))
        t = stats.multivariate_t(shape=np.eye(2), df=df).logpdf
        end = math.sqrt(df * math.expm1(9 / df))
        slope = (t([end, 0]) - t([0, 0])) / end**2
        expected = (t(standard) - t([0, 0]) - slope * np.sum(standard**2, axis=2)).sum(axis=1)
        assert np.ptp(expected) > 1
    np.testing.assert_allclose(found["log_weight"] - bare["log_weight"], expected, atol=1e-9)


def test_roots_that_were_not_found_count_as_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of five roots that were asked for three were found, each of weight one as if it stood for
    five: their mean is what the sum of three is of five."""
    plan = fake_plan(1.0)
    found = SimpleNamespace(points=some_roots(3), enough=True, proposals=70)
    roots = PatternRoots(
        some_roots(3), Faults.none(3), np.zeros(3), np.zeros(3, int), np.full(3, 0.5)
    )
    monkeypatch.setattr(two_stage, "_plan", lambda *_: ([plan], 30))
    monkeypatch.setattr(two_stage, "_draw", lambda *_: [found])
    monkeypatch.setattr(two_stage, "_roots_of", lambda *_: roots)
    nothing: Any = None
    proposed = propose_roots(nothing, key(0), 5, Budget(1000))
    np.testing.assert_allclose(proposed.log_weight, math.log(3 / 5))
    np.testing.assert_array_equal(proposed.chance, 0.5)
    assert proposed.proposals == 100


# Roots by rejection.


def test_who_is_seldom_asked_counts_for_those_who_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the roots are asked for certain, and count as one over the share of their stratum;
    the others in one case of fifty, and count fifty times as much."""
    promise = np.repeat([0.0, -1000.0], 1000)
    zeros = SimpleNamespace(take=lambda rows: rows)
    for name, found in {
        "fit_score": zeros,
        "pool_of": None,
        "log_first_stage": promise,
        "log_mass": 0.0,
    }.items():
        monkeypatch.setattr(rejection, name, lambda *_, found=found: found)
    monkeypatch.setattr(
        rejection, "propose_faults", lambda rows, *_: (Faults.none(len(rows)), np.zeros(len(rows)))
    )
    monkeypatch.setattr(rejection, "log_priors", lambda _, faults: np.zeros(len(faults.exchange)))
    rounds: Any = SimpleNamespace(posterior=SimpleNamespace(model=None), promising=-1.0)
    stratum: Any = SimpleNamespace(
        stratum=None, share=0.25, posed=None, proposal=SimpleNamespace(mass=1.0)
    )
    points, _, weight = _Rounds._asked(rounds, np.random.default_rng(0), stratum, some_roots(2000))
    certain, lucky = weight[:1000], weight[1000:]
    assert len(points.torso) == len(weight)
    np.testing.assert_allclose(certain, math.log(4))
    np.testing.assert_allclose(lucky, math.log(4) + math.log(50))
    assert 8 <= len(lucky) <= 36  # 20 ± 4.4


def test_a_round_costs_its_attempts_and_its_limbs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A round of 2¹⁴ attempts that finds a hundred roots costs as many, and those of their limbs;
    the next has about as many as bring 512."""
    monkeypatch.setattr(_Rounds, "_round", lambda *_: SimpleNamespace(limbs=[{}] * 100))
    rounds: Any = object.__new__(_Rounds)
    rounds.key, rounds.left, rounds.number = key(0), 10**7, 0
    rounds.made, rounds.attempts = 0, FIRST
    next(iter(rounds))
    assert rounds.made == FIRST + 100 * ATTEMPTS
    assert rounds.left + rounds.made == 10**7
    assert rounds.attempts == int(FIRST * 512 / 100)


def test_what_a_bound_cuts_off_is_a_share_of_the_posterior() -> None:
    """Weights of a half and of two bounds: one of 2.5 lies above. Two roots are taken; the relative
    variance of the evidence is Σ w² / (Σ w)² - 1/n of all ten that were tried."""
    nothing: Any = None
    taken = Taken(some_roots(2), Faults.none(2), [{}, {}])
    log_weight = np.array([math.log(0.5), math.log(2.0), -math.inf])
    found = _result(nothing, [taken], log_weight - 3, -3.0, 10, 1, 10)
    assert found.cut_off == pytest.approx(1 / 2.5)
    assert found.log_evidence == pytest.approx(math.log(0.25) - 3)
    assert found.log_evidence_se**2 == pytest.approx((0.25 + 4) / 2.5**2 - 1 / 10)


def test_the_bound_has_room_above_the_largest_weight() -> None:
    """A pilot run ends with the round in which enough roots are weighed; the bound is `ROOM` times
    the largest weight of all of them, not of the last."""
    rounds: Any = [
        SimpleNamespace(limbs=[{}] * 3, log_weight=np.array(weight), attempts=10)
        for weight in ([-2.0, -5.0, -9.0], [-4.0, -8.0, -7.0], [99.0, 0.0, 0.0])
    ]
    assert _bound(rounds, 6) == pytest.approx(-2 + math.log(ROOM))
    assert ROOM == 3.0


def test_a_pilot_run_without_any_weight_ends() -> None:
    """Rounds of ten roots, none of which has any weight: the second passes sixteen times one."""
    rounds = iter(
        [SimpleNamespace(limbs=[{}] * 10, log_weight=np.full(10, -np.inf), attempts=10)] * 5
    )
    given: Any = rounds
    assert _bound(given, 1) == -math.inf
    assert len(list(rounds)) == 3


def test_a_pilot_run_without_any_root_ends() -> None:
    """Half the attempts that are allowed where none brings a root: two rounds are made."""
    attempts = TORSO_ZERO_ACCEPTANCE_LIMIT // 2
    rounds = iter([SimpleNamespace(limbs=[], log_weight=np.zeros(0), attempts=attempts)] * 5)
    given: Any = rounds
    assert _bound(given, 1) == -math.inf
    assert len(list(rounds)) == 3
