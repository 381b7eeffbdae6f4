"""Roots by least squares, where the torso's joints err by Gaussians, against roots by discs that
are thinned; the bounds that they rest on; and roots with weights, by approximations, against those
by bounds.

False alarms: 1e-4 for each law that is compared, 6e-5 for the evidence; seeds are fixed."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior.inference.exact.loops import gaussian
from poseterior.inference.exact.loops.gaussian import GaussianTorso, bounded_cells, centre_joints
from poseterior.inference.exact.loops.roots import TorsoJoints
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance import torso_proposals
from poseterior.inference.importance.torso_proposals import (
    Batches,
    TorsoDraws,
    draw_roots,
    draw_torso,
    weighted_proposal,
)
from poseterior.inference.importance.torsos import TorsoProblem, torso_problem
from poseterior.probmodel import ErrorLaw, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import Gaussian, Student
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from tests.scenes import prior_scene

ALARM = 1e-4


def posterior(
    factor: float = 0.6, law: ErrorLaw | None = None, without: tuple[str, ...] = ()
) -> Posterior:
    """A torso, without some of its joints, three torsos in the dictionary, and errors so wide that
    discs find roots."""
    model = PoseModel(torsos=np.asarray(PoseModel().torsos)[[0, 17, 40]])
    frame = prior_scene(model, 11, factor=factor)
    hidden = np.isin(np.arange(NUM_JOINTS), [JOINT_INDEX[name] for name in without])
    detection = dataclasses.replace(
        frame.detection,
        keypoints=np.where(hidden[:, None], np.nan, frame.detection.keypoints),
        score=np.where(hidden, 0.0, frame.detection.score),
    )
    likelihood = Likelihood(law or Gaussian(), factor=factor)
    return dataclasses.replace(frame, detection=detection, likelihood=likelihood).posterior(model)


def by_discs(whole: Posterior, number: int, monkeypatch: pytest.MonkeyPatch) -> TorsoDraws:
    """As if nothing were known of the law but its ratio and its reach."""

    def plain(posterior: Posterior, faults: Faults) -> TorsoProblem:
        problem = torso_problem(posterior, faults)
        none = np.zeros_like(problem.joints.precision)
        return problem._replace(joints=problem.joints._replace(precision=none))

    with monkeypatch.context() as patch:
        patch.setattr(torso_proposals, "torso_problem", plain)
        return draw_roots(whole, Faults.none(), [3, 4], number, Budget(1 << 30))


def columns(draws: TorsoDraws) -> dict[str, np.ndarray]:
    """Quantities of roots `(n,)`, among them those of a turn that no angle of the cells is."""
    turn = np.asarray(draws.points.rotation)
    return {
        "log scale": draws.points.log_scale,
        "x": draws.points.translation[:, 0],
        "y": draws.points.translation[:, 1],
        "facing": turn[:, 2, 1],
        "up": turn[:, 1, 2],
        "across": turn[:, 0, 0],
    }


def smallest_p(one: TorsoDraws, other: TorsoDraws) -> float:
    """Of all quantities (Kolmogorov–Smirnov) and of the torsos (χ²), times their number."""
    pairs = zip(columns(one).values(), columns(other).values(), strict=True)
    p = [stats.ks_2samp(*pair).pvalue for pair in pairs]
    counts = [np.bincount(draws.points.torso, minlength=3) for draws in (one, other)]
    p.append(stats.chi2_contingency(counts)[1])
    return len(p) * min(p)


@pytest.mark.slow
def test_roots_by_least_squares_are_those_by_discs(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = posterior()
    fitted = draw_roots(whole, Faults.none(), [1, 2], 2500, Budget(1 << 30))
    discs = by_discs(whole, 2500, monkeypatch)
    assert discs.proposals > 100 * fitted.proposals
    assert smallest_p(fitted, discs) > ALARM
    error = math.sqrt(fitted.variance + discs.variance)
    assert abs(fitted.log_evidence - discs.log_evidence) < 4 * error < 0.2


@pytest.mark.slow
def test_students_roots_are_those_by_discs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of four joints, since discs that reach as far as a t find few roots; and the negative
    control: the Gaussian by which they are proposed, taken for the law."""
    whole = posterior(law=Student(6.0), without=("thorax", "pelvis"))
    discs = by_discs(whole, 1000, monkeypatch)
    fitted = draw_roots(whole, Faults.none(), [1, 2], 1000, Budget(1 << 30))
    assert discs.proposals > 10 * fitted.proposals
    assert smallest_p(fitted, discs) > ALARM
    error = math.sqrt(fitted.variance + discs.variance)
    assert abs(fitted.log_evidence - discs.log_evidence) < 4 * error < 0.25
    monkeypatch.setattr(Student, "exact", True)
    wrong = draw_roots(whole, Faults.none(), [1, 2], 1000, Budget(1 << 30))
    assert wrong.log_evidence > discs.log_evidence + 8 * error


@pytest.mark.slow
def test_a_factor_of_the_scale_that_is_lost_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: the inverse scale's density without two of its powers."""
    whole = posterior()
    discs = by_discs(whole, 2500, monkeypatch)

    def flatter(posterior: Posterior, faults: Faults) -> TorsoProblem:
        problem = torso_problem(posterior, faults)
        power = problem.joints.power - 2
        return problem._replace(joints=problem.joints._replace(power=power))

    monkeypatch.setattr(torso_proposals, "torso_problem", flatter)
    fitted = draw_roots(whole, Faults.none(), [1, 2], 2500, Budget(1 << 30))
    assert smallest_p(fitted, discs) < ALARM / 100


def broken_bounds(joints: TorsoJoints, cells: np.ndarray, shrunk: float) -> int:
    """In how many of 3,000 places, in cells made `1 / shrunk` times as wide, χ² or the best inverse
    scale is beyond its bound. Least squares are NumPy's."""
    rng = np.random.default_rng(5)
    root = np.sqrt(joints.precision)
    broken = 0
    for row in rng.integers(len(cells), size=3000):
        cell = cells[row]
        middle = cell["corner"] + cell["width"] / 2
        angles = middle + (rng.choice([-0.5, 0.5], 3) / shrunk) * cell["width"]
        view = joints.torsos[cell["torso"]] @ Rotation.from_euler("ZYZ", angles).as_matrix().T
        image = view[:, :2] - view[:, 2:] * joints.ray + joints.bias
        design = np.zeros((2 * len(image), 3))
        design[::2, 0] = design[1::2, 1] = root
        design[:, 2] = -(root[:, None] * joints.keypoints).ravel()
        target = -(root[:, None] * image).ravel()
        found, *_ = np.linalg.lstsq(design, target, rcond=None)
        chi = np.sum((design @ found - target) ** 2)
        broken += chi < cell["least"] - 1e-6 or found[2] > cell["top"] + 1e-6
    return broken


@pytest.mark.slow
@pytest.mark.parametrize("aside", [0.0, 0.4])
def test_bounds_are_bounds(aside: float) -> None:
    """At the corners of cells, where joints move most; corners one and a half cells away break
    them, or they would be too wide to be of use. Lines of sight that run `aside` differ too."""
    joints = torso_problem(posterior(0.25), Faults.none()).joints
    rays = np.random.default_rng(4).uniform(0.5, 1.0, joints.ray.shape)
    joints = joints._replace(ray=aside * rays)
    cells = bounded_cells(GaussianTorso(joints, centre_joints(joints))).table
    assert broken_bounds(joints, cells, 1.0) == 0
    assert broken_bounds(joints, cells, 1 / 3) > 30


@pytest.mark.slow
def test_cells_that_are_cut_finer_have_less_mass_and_the_same_evidence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = posterior(0.25)
    fine = draw_roots(whole, Faults.none(), [1, 2], 3000, Budget(1 << 30))
    monkeypatch.setattr(gaussian, "LEVELS", 2)
    coarse = draw_roots(whole, Faults.none(), [1, 2], 3000, Budget(1 << 30))
    assert coarse.proposals > 2 * fine.proposals
    error = math.sqrt(fine.variance + coarse.variance)
    assert abs(fine.log_evidence - coarse.log_evidence) < 4 * error < 0.2


def test_a_torso_that_hardly_fits_has_hardly_any_mass() -> None:
    """A joint detected ten torsos away."""
    joints = torso_problem(posterior(0.1), Faults.none()).joints
    keypoints = joints.keypoints.copy()
    keypoints[1] += 10 * np.ptp(keypoints)
    far = joints._replace(keypoints=keypoints)
    both = [GaussianTorso(one, centre_joints(one)) for one in (joints, far)]
    mass = [bounded_cells(one).mass for one in both]
    assert 0 <= mass[1] < 1e-9 * mass[0]


def test_the_same_key_gives_the_same_roots() -> None:
    whole = posterior()
    one, again = (draw_roots(whole, Faults.none(), [7], 50, Budget(1 << 24)) for _ in range(2))
    other = draw_roots(whole, Faults.none(), [8], 50, Budget(1 << 24))
    np.testing.assert_array_equal(one.points.log_scale, again.points.log_scale)
    assert np.any(one.points.log_scale != other.points.log_scale)


SHARP = {
    "gaussian": lambda: posterior(0.12),
    "student": lambda: posterior(0.12, Student(6.0)),
    "wide": posterior,
    "three-joints": lambda: posterior(0.2, without=("thorax", "pelvis", "left_hip")),
}


def weighed(
    whole: Posterior, words: list[int], number: int, budget: Budget | None = None
) -> TorsoDraws:
    """Roots by approximations, with weights."""
    problem = torso_problem(whole, Faults.none())
    batches = Batches(problem, weighted_proposal(problem), words)
    assert not batches.proposal.exact
    return draw_torso(batches, number, budget or Budget(1 << 30), most=number)


def far_apart(one: TorsoDraws, other: TorsoDraws) -> float:
    """The largest difference of means, of torsos and of other quantities and their squares, in
    standard errors."""
    found = []
    for draws in (one, other):
        share = np.exp(draws.log_share) / np.exp(draws.log_share).sum()
        measured = [*columns(draws).values(), *(draws.points.torso == k for k in range(3))]
        value = np.array([measured[0], *measured], float)
        value[0] = (value[0] - value[0].mean()) ** 2
        mean = value @ share
        # Those taken for certain are no draws of a number of their own, but not many of these are.
        found.append((mean, (share**2) @ (value - mean[:, None]).T ** 2))
    (a, of_a), (b, of_b) = found
    return float(np.max(np.abs(a - b) / np.sqrt(of_a + of_b + 1e-30)))


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARP)
def test_weighed_roots_are_those_by_bounds(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evidence, means and spreads (4 standard errors of each, 1e-3 in all); and the negative
    control: weights that are forgotten."""
    whole = SHARP[name]()
    exact = draw_roots(whole, Faults.none(), [1, 2], 3000, Budget(1 << 30))
    found = weighed(whole, [3, 4], 20_000)
    error = math.sqrt(exact.variance + found.variance)
    assert abs(found.log_evidence - exact.log_evidence) < 4 * error < 0.12
    assert far_apart(found, exact) < 4
    right = torso_proposals.propose_by_gaussian

    def without_weights(*arguments: Any) -> tuple[int, int]:
        result = right(*arguments)
        arguments[-1]["log_weight"] = 0.0
        return result

    monkeypatch.setattr(torso_proposals, "propose_by_gaussian", without_weights)
    wrong = weighed(whole, [3, 4], 20_000)
    assert abs(wrong.log_evidence - exact.log_evidence) > 5 * error


@pytest.mark.slow
def test_few_weighed_roots_have_an_unbiased_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean of 400 that are as short as they come (4 standard errors, 6e-5), and the sum of what
    their roots count, which is taken from more; without the chance of being taken it is off."""
    whole = posterior(0.12)
    truth = weighed(whole, [3, 4], 100_000)
    monkeypatch.setattr(torso_proposals, "PROBE", 64)
    some = [weighed(whole, [5, seed], 20) for seed in range(400)]
    ratio = np.exp([one.log_evidence - truth.log_evidence for one in some])
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / 20 < 0.2
    facing, share = truth.points.rotation[:, 2, 1], np.exp(truth.log_share)
    middle = float(np.median(facing))
    part = share @ (facing > middle) / share.sum()
    right, wrong = [], []
    for one, times in zip(some, ratio, strict=True):
        share = np.exp(one.log_share) * (one.points.rotation[:, 2, 1] > middle)
        right.append(times * share.sum())
        wrong.append(times * (share * one.inclusion).sum())
    assert abs(np.mean(right) - part) < 4 * np.std(right) / 20
    assert abs(np.mean(wrong) - part) > 9 * np.std(wrong) / 20


def test_weighed_roots_end_with_the_budget() -> None:
    """As many proposals as are left, an evidence of those, and a word that it was not enough."""
    whole = posterior(0.12)
    plenty = weighed(whole, [3, 4], 20_000)
    assert plenty.enough
    assert len(plenty.points.torso) == 20_000
    none = weighed(whole, [3, 4], 20_000, Budget(100))
    assert not none.enough
    assert len(none.points.torso) == none.proposals == 0
    assert none.log_evidence == -math.inf


def test_a_root_that_is_nowhere_is_not_looked_for_for_ever() -> None:
    """Joints so far apart that no torso fits: no root, though the budget would allow for more."""
    whole = posterior(0.02, without=("thorax", "pelvis"))
    keypoints = whole.detection.keypoints.copy()
    hips = [JOINT_INDEX[name] for name in ("left_hip", "right_hip")]
    keypoints[hips] = keypoints[hips[::-1]] + [[40.0, 0.0], [-40.0, 300.0]]
    crossed = dataclasses.replace(whole.detection, keypoints=keypoints)
    found = weighed(dataclasses.replace(whole, detection=crossed), [3, 4], 100)
    assert found.enough
    assert found.log_evidence == -math.inf
