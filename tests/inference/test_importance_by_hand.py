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
from scipy.spatial.transform import Rotation

from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance import rejection, two_stage
from poseterior.inference.importance.fault_patterns import log_priors
from poseterior.inference.importance.rejection import ROOM, Taken, _bound, _result, _Rounds
from poseterior.inference.importance.torso_proposals import Batches, exact_proposal
from poseterior.inference.importance.torsos import log_mass, rotations_of, torso_problem
from poseterior.inference.importance.weighted import WeightedRoots, _enough, log_limbs
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import Faults
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
    pilots = [SimpleNamespace(proposals=number) for number in (1, 10, 100)]
    monkeypatch.setattr(two_stage, "_draw", lambda *_: pilots)
    monkeypatch.setattr(two_stage, "_pilot_estimate", lambda *_: next(estimates))
    monkeypatch.setattr(two_stage, "_shares", lambda *_: np.zeros(3))
    plans, spent = two_stage._plan(found, key(0), Budget(1000), True)
    assert [plan.likely for plan in plans] == [True, False, True]
    assert spent == 111


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


def test_what_a_bound_cuts_off_is_a_share_of_the_posterior() -> None:
    """Weights of a half and of two bounds: one of 2.5 lies above."""
    nothing: Any = None
    taken = Taken(some_roots(1), Faults.none(1), [{}])
    log_weight = np.array([math.log(0.5), math.log(2.0), -math.inf])
    found = _result(nothing, [taken], log_weight - 3, -3.0, 10, 1, 10)
    assert found.cut_off == pytest.approx(1 / 2.5)
    assert found.log_evidence == pytest.approx(math.log(0.25) - 3)


def test_the_bound_has_room_above_the_largest_weight() -> None:
    """A pilot run ends with the round in which enough roots are weighed; the bound is `ROOM` times
    the largest weight of all of them, not of the last."""
    rounds: Any = [
        SimpleNamespace(limbs=[{}] * 3, log_weight=np.array(weight), attempts=10)
        for weight in ([-2.0, -5.0, -9.0], [-4.0, -8.0, -7.0], [99.0, 0.0, 0.0])
    ]
    assert _bound(rounds, 6) == pytest.approx(-2 + math.log(ROOM))
    assert ROOM == 3.0
