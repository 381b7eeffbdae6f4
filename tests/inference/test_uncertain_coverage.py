"""Calibration and coverage with an uncertain root: simulations, what is asked of them, and whether
the ranks tell right draws from wrong ones.

False-alarm rates stand beside every statistical test; seeds are fixed.
"""

import dataclasses
import functools
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import xarray as xr
from scipy import stats

from poseterior.inference.draws import COMPLETE
from poseterior.inference.importance.weighted import WeightedRoots
from poseterior.inference.studies.calibration import calibrate, cover, judge, posteriors, simulate
from poseterior.inference.studies.calibration.assess import Answer, assess
from poseterior.inference.studies.calibration.exclusions import TAU, from_text
from poseterior.inference.studies.calibration.posteriors import independent_roots
from poseterior.inference.studies.calibration.quantities import (
    LOG_DENSITY,
    OF_ROOT,
    QUANTITIES,
    of_root,
    of_rooted,
)
from poseterior.inference.studies.calibration.real import by_the_likelihood
from poseterior.inference.studies.calibration.simulations import Instance, LensWindow
from poseterior.inference.studies.calibration.verdict import MISCALIBRATED
from poseterior.probmodel import BadInput, DetectorErrors, Gaussian, Lens, Likelihood, PoseModel
from poseterior.probmodel.datasets import Case
from poseterior.probmodel.errors.faults import (
    EXCHANGES,
    LIMB_INDEX,
    OUTLIER_REACH,
    FaultPrior,
    Faults,
)
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import JOINT_INDEX, MIRROR, NUM_JOINTS, TORSO_INDEX
from tests.scenes import drawer, key

ROOTS = 40


@functools.cache
def model() -> PoseModel:
    return PoseModel()


@functools.cache
def simulations() -> list[Instance]:
    return simulate(model(), 0, 0, 100, root="uncertain")


def forgetting_scale(roots: WeightedRoots) -> WeightedRoots:
    """The roots with weights that lack scale⁻² for every seen joint: they prefer cameras that are
    too near."""
    seen = np.isfinite(roots.posterior.detected.spread).sum()
    scale = np.asarray(roots.points.log_scale)
    return dataclasses.replace(roots, log_weight=roots.log_weight + 2 * seen * scale)


def truth(instance: Instance) -> tuple[RootPoint, np.ndarray]:
    one = instance.frame.candidates[0]
    log_scale = np.log(one.camera.scale)
    point = RootPoint(one.torso_index, one.camera.rotation, log_scale, one.camera.translation)
    return jax.tree.map(lambda part: np.asarray(part)[None], point), instance.joints[None]


# --- simulations


def test_simulated_roots_are_draws_of_their_prior() -> None:
    """Haar's measure: every entry of a rotation is uniform on (-1, 1) (Archimedes); torsos come as
    often as each other. Three tests at 1e-3 in all. Control: people seen from some side."""
    rotations = [one.frame.candidates[0].camera.rotation for one in simulations()]
    entries = np.array([[turn[2, 2], turn[1, 1]] for turn in rotations])
    for column in entries.T:
        assert stats.kstest(column, "uniform", (-1, 2)).pvalue > 1e-3 / 3
    torsos = np.bincount([one.frame.candidates[0].torso_index for one in simulations()])
    assert torsos.max() < stats.poisson.isf(1e-3 / 3 / len(torsos), 100 / len(torsos)) + 1
    upright = [one.frame.candidates[0].camera.rotation for one in simulate(model(), 0, 0, 100)]
    control = stats.kstest([turn[1, 1] for turn in upright], "uniform", (-1, 2))
    assert control.pvalue < 1e-9


LENS = Lens.unknown(1920.0, np.array([960.0, 540.0]))


def test_simulated_people_are_seen_in_the_window_of_a_lens() -> None:
    """Log scales and places are uniform in it, and every focal length comes; four tests at 1e-3 in
    all. Control: scales themselves are not uniform."""
    cameras = [
        one.frame.candidates[0].camera
        for one in simulate(PoseModel(lens=LENS), 1, 0, 400, root="uncertain")
    ]
    window = LensWindow.of(LENS)
    scale = np.array([float(camera.scale) for camera in cameras])
    place = np.array([camera.translation for camera in cameras])
    for column, low, high in zip([np.log(scale), *place.T], window.low, window.high, strict=True):
        assert stats.kstest(column, "uniform", (low, high - low)).pvalue > 1e-3 / 4
    low, high = np.exp(window.low[0]), np.exp(window.high[0])
    assert stats.kstest(scale, "uniform", (low, high - low)).pvalue < 1e-3
    focal = np.array([float(camera.lens.focal) for camera in cameras])
    counts = [np.sum(np.isclose(focal, one)) for one in np.asarray(LENS.focal)]
    assert sum(counts) == len(focal)
    assert stats.chisquare(counts).pvalue > 1e-3 / 4


def test_focal_lengths_too_far_apart_have_no_window() -> None:
    with pytest.raises(BadInput, match="differ by 10 times cannot be simulated together"):
        LensWindow.of(Lens(np.array([100.0, 1000.0]), np.zeros(2)))


@pytest.mark.parametrize("lens", [None, LENS])
def test_simulated_errors_are_as_large_as_at_the_joint(lens: Lens | None) -> None:
    """What remains beside the bias of a law ends where the law does. Controls: without the bias,
    and before a lens without the size at the joint, some is beyond."""
    sigma, inlier = np.full(NUM_JOINTS, 0.05), np.ones(NUM_JOINTS)
    bias = np.tile([0.3, -0.2], (NUM_JOINTS, 1))
    likelihood = Likelihood.of(DetectorErrors(Gaussian(), sigma, inlier, bias))
    far = 2 * sigma * Gaussian.reach
    within, unbiased, flat = [], [], []
    for one in simulate(PoseModel(lens=lens), 2, 0, 40, likelihood=likelihood, root="uncertain"):
        camera, seen = one.frame.candidates[0].camera, one.frame.detection.seen
        unit = float(camera.scale) * np.asarray(camera.magnification(one.joints))
        off = one.frame.detection.keypoints - np.asarray(camera.image(one.joints))
        within.append((np.linalg.norm(off / unit[:, None] - bias, axis=1) / far)[seen])
        unbiased.append((np.linalg.norm(off / unit[:, None], axis=1) / far)[seen])
        flat.append((np.linalg.norm(off / float(camera.scale) - bias, axis=1) / far)[seen])
    assert 0.9 < np.max(np.concatenate(within)) <= 1 + 1e-9
    assert np.max(np.concatenate(unbiased)) > 1
    assert lens is None or np.max(np.concatenate(flat)) > 1


@pytest.mark.slow
def test_simulated_truths_are_possible_under_their_own_root() -> None:
    """Every seen joint, the torso's too, lies in its disc, whose radius is the posterior's own."""
    worst = []
    for instance in simulations()[:8]:
        posterior = instance.frame.posterior(model())
        *_, density, misfit = of_rooted(posterior, *truth(instance))[0]
        assert np.isfinite(density)
        worst.append(misfit)
        assert instance.frame.detection.seen.sum() >= 12
    assert 0.5 < min(worst) <= max(worst) <= 1


# --- what is asked


@pytest.mark.slow
def test_numbers_of_draws_are_the_samplers_own() -> None:
    """Log density and misfit by way of the joints against the posterior's, of root and pose."""
    instance = simulations()[0]
    posterior = instance.frame.posterior(model())
    draw = drawer(model(), root="uncertain", num_samples=30, num_roots=ROOTS)
    draws = draw(instance.frame, key(3))
    assert draws.points is not None
    *_, density, misfit = of_rooted(posterior, draws.points, draws.joints).T
    observed = [
        posterior.detected.under(
            posterior.root_prior,
            jax.tree.map(lambda part, row=row: part[row], draws.points),
            Faults.none(),
        )
        for row in (0, 7)
    ]
    for row, observation in zip((0, 7), observed, strict=True):
        pose = model().pose_of(draws.joints[row], draws.bone_length[row])
        point = jax.tree.map(lambda part, row=row: part[row][None], draws.points)
        own = posterior.log_joint(point, Pose(*(np.asarray(part)[None] for part in pose)))
        assert density[row] == pytest.approx(float(own[0]), abs=1e-6)
        assert misfit[row] == pytest.approx(float(observation.misfit(draws.joints[row])))
    assert (misfit <= 1 + 1e-9).all()
    scale, *_, x, y, z = of_root(draws.points).T
    np.testing.assert_allclose(np.exp(scale), draws.scale)
    thorax = JOINT_INDEX["thorax"]
    pixels = draws.scale[:, None] * draws.joints[:, thorax, :2] + draws.points.translation
    np.testing.assert_allclose(pixels, draws.keypoints[:, thorax], atol=1e-9)
    np.testing.assert_allclose(x**2 + y**2 + z**2, 1)


def test_roots_are_ranked_where_draws_have_them() -> None:
    """The truth among twenty copies of itself is a tie in everything; without roots nothing is
    asked of them."""
    instance = simulations()[1]
    points, joints = truth(instance)
    many = jax.tree.map(lambda part: np.repeat(part, 20, axis=0), points)
    answer = Answer(np.repeat(joints, 20, axis=0), points=many)
    found = assess(instance, answer, np.random.default_rng(0), model=model())
    level = dict(zip(QUANTITIES, found.level, strict=True))
    assert all(0 <= level[name] <= 1 for name in (*OF_ROOT, LOG_DENSITY))
    moved = many._replace(log_scale=many.log_scale + 1.0)
    far = assess(instance, answer._replace(points=moved), np.random.default_rng(0), model=model())
    assert dict(zip(QUANTITIES, far.level, strict=True))["log scale"] <= 1 / 21
    without = assess(instance, answer._replace(points=None), np.random.default_rng(0))
    assert np.isnan(dict(zip(QUANTITIES, without.level, strict=True))["log scale"])


# --- draws


def test_every_other_effective_root_brings_a_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roots that are worth 9.9 effective ones bring four draws, and no more than are asked for."""
    asked = []

    def draw(_rng: object, number: int) -> tuple[None, None, None]:
        asked.append(number)
        return None, None, None

    roots = SimpleNamespace(effective=9.9, log_evidence=0.0, draw=draw)
    monkeypatch.setattr(posteriors, "weigh_roots", lambda *_, **__: roots)
    monkeypatch.setattr(posteriors, "verdict", lambda _: (COMPLETE, ""))
    monkeypatch.setattr(posteriors, "place", lambda *_, **__: (np.zeros((0, 15, 3)), None))
    for wanted in (100, 3):
        independent_roots(model(), wanted)(0, simulations()[0], key(0))
    assert asked == [4, 3]


@pytest.mark.slow
def test_draws_are_as_many_as_are_independent() -> None:
    draw = independent_roots(model(), 500, 10)
    answer = draw(0, simulations()[2], key(0))
    assert answer.points is not None
    assert 9 <= len(answer.joints) < 500  # ten roots are worth too few: there were more of them
    different = len(np.unique(answer.points.log_scale))
    assert different >= 0.8 * len(answer.joints)
    few = independent_roots(model(), 5, 100)(0, simulations()[2], key(0))
    assert len(few.joints) == 5


def test_a_sampler_under_fixed_roots_is_refused() -> None:
    with pytest.raises(
        BadInput,
        match="there is no exact sampler 'emcee' of many detections; choose one of weighted-roots",
    ):
        calibrate(model(), "emcee", root="uncertain", num_simulations=1)
    with pytest.raises(BadInput, match="there is no root 'free'"):
        cover(model(), [cases()[0]], root="free")
    with pytest.raises(BadInput, match="nobody's torso and camera are given"):
        cover(model(), [cases()[0]], root="uncertain", estimator="zhou")


# --- real poses


UNIT = 330.0
"""mm of a body unit."""


@functools.cache
def cases() -> list[Case]:
    """Poses of the prior as a data set has them, their detections drawn from the likelihood."""
    some = []
    for number, instance in enumerate(simulate(model(), 5, 0, 2)):
        camera = instance.frame.candidates[0].camera
        pose, labels = UNIT * instance.joints, ("walking", "a", f"recording {number}")
        detection, scale = instance.frame.detection, float(camera.scale) / UNIT
        case = Case(number, pose, detection, scale, np.asarray(camera.translation), *labels)
        some.append(by_the_likelihood(case, root="uncertain"))
    return some


@pytest.mark.slow
def test_real_poses_are_covered_without_torso_and_camera() -> None:
    tree = cover(model(), cases(), root="uncertain", num_samples=60, num_roots=ROOTS)
    found = tree["simulation"].to_dataset()
    assert tree.attrs["root"] == "uncertain"
    assert tree.attrs["num_roots"] == ROOTS
    assert (found.num_draws.values == 60).all()
    assert np.isfinite(found.whole.values).all()
    fixed = cover(model(), cases(), num_samples=60, root="candidates")["simulation"].to_dataset()
    assert (found.spread_depth.values.mean() > fixed.spread_depth.values.mean()).all()


def test_a_torso_that_is_detected_elsewhere_excludes_the_truth() -> None:
    """Under a fixed root nobody asks for the torso's detections."""
    case = cases()[0]
    keypoints = case.detection.keypoints.copy()
    keypoints[JOINT_INDEX["left_hip"]] += 3 * case.scale * case.unit
    detection = dataclasses.replace(case.detection, keypoints=keypoints)
    moved = dataclasses.replace(case, detection=detection)
    draws: list = []

    def nobody(index: int, instance: Instance, key: jax.Array) -> Answer:
        draws.append(index)
        return Answer(np.repeat(instance.joints[None], 20, axis=0))

    def reasons(root: str) -> list:
        found = cover(model(), [moved], sampler=nobody, root=root)["simulation"].reasons
        return [one for one in from_text(found.values[0]) if one.broken.part == "left_hip"]

    assert reasons("candidates") == []
    assert [one.source for one in reasons("uncertain")] == [TAU]


def strays(faults: FaultPrior, number: int) -> tuple[np.ndarray, np.ndarray]:
    """`(number, 15)`: body units from each keypoint to its own joint's projection, and to that of
    the other side."""
    likelihood = Likelihood(faults=faults)
    own, other = [], []
    for one in simulate(model(), 3, 0, number, likelihood=likelihood, root="uncertain"):
        camera = one.frame.candidates[0].camera
        exact = np.asarray(camera.image(one.joints))
        for rows, found in ((np.arange(NUM_JOINTS), own), (MIRROR, other)):
            gap = one.frame.detection.keypoints - exact[list(rows)]
            found.append(np.linalg.norm(gap, axis=1) / camera.scale)
    return np.array(own), np.array(other)


@pytest.mark.slow
def test_simulated_outliers_are_as_many_as_the_prior_says() -> None:
    """Of the limbs' seen keypoints 30 % lie beyond the widest disc, of radius 0.5, but for 0.4 % of
    the outliers; false alarm 1e-4. Of the torso's one at most."""
    own, _ = strays(FaultPrior.of(outlier=0.3), 60)
    limbs = own[:, LIMB_INDEX]
    seen = np.isfinite(limbs)
    assert stats.binomtest(int((limbs[seen] > 0.5).sum()), int(seen.sum()), 0.3).pvalue > 1e-4
    assert np.nanmax(own) < OUTLIER_REACH
    torso = (own[:, TORSO_INDEX] > 0.5).sum(axis=1)
    assert 0 < torso.mean() < 1
    assert torso.max() == 1


def test_simulated_exchanges_put_one_side_where_the_other_is() -> None:
    legs = tuple(0.999 if name == "legs" else 0.0 for name in EXCHANGES)[1:]
    own, other = strays(FaultPrior(exchange=legs), 12)
    for name, exchanged in (("left_knee", True), ("right_ankle", True), ("left_elbow", False)):
        near = (other if exchanged else own)[:, JOINT_INDEX[name]]
        assert np.nanmax(near) < 0.5
    assert np.nanmax(own[:, JOINT_INDEX["right_ankle"]]) > 0.5


# --- the whole


@pytest.mark.sweep
def test_the_whole_posterior_is_calibrated_and_the_control_is_not() -> None:
    """Thirty simulations, 1 % false alarms over all questions (Holm); weights without scale⁻² for
    every seen joint are found out."""
    number = 30

    def standings(sampler) -> xr.Dataset:
        tree = calibrate(model(), sampler, root="uncertain", num_simulations=number)
        return tree["simulation"].to_dataset()

    right = judge(standings(independent_roots(model(), 200, 150)), fewest=number // 2)
    assert right.verdict != MISCALIBRATED, right.sentence
    assert {"log scale", LOG_DENSITY} <= set(right.tests.quantity.values)
    wrong = independent_roots(model(), 200, 150, reweigh=forgetting_scale)
    control = judge(standings(wrong), fewest=number // 2)
    assert control.verdict == MISCALIBRATED, control.sentence


@pytest.mark.sweep
def test_the_posterior_with_faults_is_calibrated() -> None:
    """Detections with outliers and many exchanges, thirty simulations, 1 % false alarms; a
    likelihood that knows no exchanges is found out (p = 2e-5 when this was written). One with a
    hundred times fewer outliers is not, nor one with six times more: whether a keypoint is an
    outlier, the detections themselves say well enough."""
    number, faults = 30, FaultPrior.of(outlier=0.1, exchange=0.5)
    likelihood = Likelihood(faults=faults)
    blind = Likelihood(faults=FaultPrior.of(outlier=0.1))
    right = independent_roots(model(), 200, 300)

    def mistaken(index: int, instance: Instance, key: jax.Array) -> Answer:
        frame = dataclasses.replace(instance.frame, likelihood=blind)
        return right(index, instance._replace(frame=frame), key)

    def standings(sampler) -> xr.Dataset:
        tree = calibrate(
            model(), sampler, likelihood=likelihood, root="uncertain", num_simulations=number
        )
        return tree["simulation"].to_dataset()

    found = judge(standings(right), fewest=number // 2)
    assert found.verdict != MISCALIBRATED, found.sentence
    assert judge(standings(mistaken), fewest=number // 2).verdict == MISCALIBRATED
