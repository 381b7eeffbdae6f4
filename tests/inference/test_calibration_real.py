"""Coverage of poses whose truth is known: ECE and its floor, reasons of misses by known causes,
ways to choose k."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from poseterior.inference.draws import COMPLETE, OUT_OF_BUDGET
from poseterior.inference.hypothesis import diverse
from poseterior.inference.results import save_tree
from poseterior.inference.studies.calibration import assess, simulate
from poseterior.inference.studies.calibration.assess import FAILED, Answer, Standing
from poseterior.inference.studies.calibration.choices import (
    CHOICES,
    CHOOSE,
    POSE_GRID,
    best_error,
    by_distance,
    modes_represented,
)
from poseterior.inference.studies.calibration.coverage import summary
from poseterior.inference.studies.calibration.ece import (
    ECE_LEVELS,
    calibration_error,
    coverage,
    ece,
    shares,
)
from poseterior.inference.studies.calibration.exclusions import (
    CAMERA,
    LENGTH,
    LIMIT,
    TAU,
    TORSO,
    Reason,
    as_text,
    exclusions,
    from_text,
    hung,
    ranking,
)
from poseterior.inference.studies.calibration.posteriors import sampler_of
from poseterior.inference.studies.calibration.quantities import MOVING, QUANTITIES, of_both
from poseterior.inference.studies.calibration.real import (
    TRUE,
    by_the_likelihood,
    instances,
    true_candidate,
)
from poseterior.inference.studies.calibration.record import (
    case_columns,
    detected_columns,
    standings_tree,
)
from poseterior.inference.studies.calibration.run import cover, stand
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.inference.studies.intervals import resampled
from poseterior.inference.studies.judging.files import read_judged
from poseterior.inference.studies.judging.judge import judge_levels
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.camera import Lens, WeakPerspective
from poseterior.probmodel.datasets import Case
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import BONE_NAMES, BONES, JOINT_INDEX, TORSO_INDEX

RNG = np.random.default_rng
UNIT = 350.0


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


@pytest.fixture(scope="module")
def cases(model: PoseModel) -> list[Case]:
    """Poses of the model itself as a data set: nothing of them is excluded."""
    return [case_of(instance, number) for number, instance in enumerate(simulate(model, 9, 0, 24))]


def case_of(instance: Instance, number: int) -> Case:
    camera = instance.frame.candidates[0].camera
    pose = UNIT * instance.joints
    return Case(
        number,
        pose,
        instance.frame.detection,
        float(camera.scale) / UNIT,
        np.asarray(camera.translation),
        "an action",
        "a subject",
        f"recording {number % 6}",
    )


def possible(model: PoseModel, cases: list[Case]) -> list[Case]:
    """Those that are possible in their own unit, the mean limb length, which the model draws about
    one, not as one."""
    reasons = exclusions(model, cases, instances(cases, model))
    return [case for case, found in zip(cases, reasons, strict=True) if not found]


# --- instances and reasons


def test_a_real_pose_errs_in_its_own_units(model: PoseModel, cases: list[Case]) -> None:
    doubt = 25.0 * np.einsum("jk,xy->jkxy", np.eye(15), np.eye(3))
    one = dataclasses.replace(cases[0], doubt=doubt)
    (found, without) = instances([one, cases[1]], model)
    assert found.doubt == pytest.approx(doubt / one.unit**2)
    assert without.doubt is None


def test_true_torso_and_camera_show_what_was_seen(model: PoseModel, cases: list[Case]) -> None:
    for case, instance in zip(cases, instances(cases, model), strict=True):
        candidate = instance.frame.candidates[0]
        pixels = np.asarray(candidate.camera.image(instance.joints))
        np.testing.assert_allclose(pixels, case.pixels[:, :2], atol=1e-9)
        np.testing.assert_allclose(
            candidate.camera.view(candidate.torso), instance.joints[list(TORSO_INDEX)], atol=1e-12
        )
        np.testing.assert_allclose(hung(case, candidate), instance.joints, atol=1e-12)
        assert np.linalg.det(np.asarray(candidate.camera.rotation)) == pytest.approx(1)


def test_reasons_and_log_density_agree(model: PoseModel, cases: list[Case]) -> None:
    """Two routes: no reason is found iff the model's own log density of the truth is finite, for
    Gaussian errors of which many leave their discs. (The poses are the model's: left and right are
    equally long.)"""
    rng = RNG(0)
    moved = []
    for case in cases:
        keypoints = case.detection.keypoints + rng.normal(size=(15, 2)) * 3
        moved.append(
            dataclasses.replace(
                case, detection=dataclasses.replace(case.detection, keypoints=keypoints)
            )
        )
    known = instances(moved, model)
    found = exclusions(model, moved, known)
    finite = [
        bool(np.isfinite(of_both(model, one.frame.observation, one.joints[None])[0, -2]))
        for one in known
    ]
    assert finite == [not reasons for reasons in found]
    assert 2 < sum(finite) < len(finite) - 2, "both kinds have to occur"


def test_a_joint_beyond_its_disc_is_named(model: PoseModel, cases: list[Case]) -> None:
    case = cases[1]
    keypoints = case.detection.keypoints.copy()
    knee = JOINT_INDEX["right_knee"]
    keypoints[knee] = case.pixels[knee, :2] + [60.0, 0.0]
    case = dataclasses.replace(
        case, detection=dataclasses.replace(case.detection, keypoints=keypoints)
    )
    known = instances([case], model)
    (found,) = exclusions(model, [case], known)
    observation = known[0].frame.observation
    radius = observation.reach[knee] * observation.root.camera.scale
    assert [reason.source for reason in found] == [TAU]
    assert found[0].broken.part == "right_knee"
    assert found[0].broken.much == pytest.approx(60 / radius)
    assert found[0].label == "τ"


def test_a_broken_limit_is_named_with_its_degrees(model: PoseModel, cases: list[Case]) -> None:
    """A forearm folded back through the upper arm, with the detection moved along."""
    case = cases[1]
    elbow, wrist, shoulder = (
        JOINT_INDEX[name] for name in ("left_elbow", "left_wrist", "left_shoulder")
    )
    pose = case.pose.copy()
    length = np.linalg.norm(pose[wrist] - pose[elbow])
    back = pose[shoulder] - pose[elbow]
    pose[wrist] = pose[elbow] + length * back / np.linalg.norm(back)
    case = dataclasses.replace(case, pose=pose)
    case = by_the_likelihood(case)
    known = instances([case], model)
    check = model.limits.check(known[0].joints)
    (found,) = exclusions(model, [case], known)
    assert not check.pose_valid
    reason = next(one for one in found if one.broken.kind == LIMIT)
    assert reason.source == LIMIT
    assert reason.label == "limit of the left forearm"
    assert reason.broken.much == pytest.approx(check.excess[BONE_NAMES.index("left_forearm")])
    assert "° beyond its limit" in reason.sentence


def test_a_length_out_of_range_is_named(model: PoseModel, cases: list[Case]) -> None:
    case = cases[1]
    pose = case.pose.copy()
    head, thorax = JOINT_INDEX["head"], JOINT_INDEX["thorax"]
    pose[head] = pose[thorax] + 3 * (pose[head] - pose[thorax])
    case = dataclasses.replace(case, pose=pose)
    (found,) = exclusions(model, [case], instances([case], model))
    assert any(reason.source == LENGTH and reason.broken.part == "head" for reason in found)


def spoilt(instance: Instance, **changes: object) -> Instance:
    """The instance with another torso or camera."""
    right = instance.frame.candidates[0]
    camera = right.camera._replace(
        **{key: value for key, value in changes.items() if key != "torso"}
    )
    candidate = Candidate(-1, changes.get("torso", right.torso), camera, 0.0)  # type: ignore[arg-type]
    return Instance(dataclasses.replace(instance.frame, candidates=(candidate,)), instance.joints)


def test_the_estimates_faults_are_told_apart(model: PoseModel, cases: list[Case]) -> None:
    """A camera moved by a limb's length, a torso whose shoulders are: the blame falls on the right
    one."""
    some = possible(model, cases)[:6]
    known = instances(some, model)
    moved = [
        spoilt(one, translation=np.asarray(one.frame.candidates[0].camera.translation) + 60)
        for one in known
    ]
    for reasons in exclusions(model, some, moved):
        assert reasons
        assert {reason.source for reason in reasons} == {CAMERA}
    shifted = []
    for one in known:
        torso = np.array(one.frame.candidates[0].torso)
        torso[[2, 3], 1] -= 1.0  # shoulders a limb's length lower
        shifted.append(spoilt(one, torso=torso))
    for reasons in exclusions(model, some, shifted):
        assert reasons
        assert {reason.source for reason in reasons} == {TORSO}


def test_the_better_candidate_speaks(model: PoseModel, cases: list[Case]) -> None:
    known = instances(cases[:3], model)
    both = []
    for one in known:
        right = one.frame.candidates[0]
        wrong = Candidate(
            -1, right.torso, right.camera._replace(translation=right.camera.translation + 60), 0.0
        )
        both.append(Instance(dataclasses.replace(one.frame, candidates=(wrong, right)), one.joints))
    assert exclusions(model, cases[:3], both) == exclusions(model, cases[:3], known)


def test_reasons_survive_a_file_and_are_ranked(model: PoseModel) -> None:
    from poseterior.inference.studies.calibration.exclusions import Break

    tau, camera = (
        Reason(TAU, Break(TAU, "head", 1.5)),
        Reason(CAMERA, Break(LIMIT, "left_forearm", 4.0)),
    )
    parentless = Reason(CAMERA, Break(LIMIT, "left_forearm", float("nan")))
    many = [[tau], [], [camera, tau], [camera], [camera, parentless]]
    back = [from_text(as_text(reasons)) for reasons in many]
    assert [[reason.label for reason in one] for one in back] == [
        [reason.label for reason in one] for one in many
    ]
    first, second = ranking(back)
    assert (first.label, first.excluded, first.alone) == (CAMERA, 3, 2)
    assert (second.label, second.excluded, second.alone) == ("τ", 2, 1)
    assert first.amounts == {LIMIT: 4.0}


# --- ECE and coverage


def test_shares_and_ece_by_hand() -> None:
    levels = np.array([[0.1], [0.3], [0.9], [np.nan]])
    np.testing.assert_allclose(shares(levels)[[0, 3, 7, 20], 0], [0.0, 0.25, 0.5, 0.75])
    even = np.tile((np.arange(2000)[:, None] + 0.5) / 2000, (1, 3))
    assert calibration_error(even) < 1e-3
    assert calibration_error(np.zeros((50, 3))) == pytest.approx(
        np.sum(1 - ECE_LEVELS[1:]) / 21, abs=1e-12
    )


def test_the_floor_is_what_right_posteriors_have() -> None:
    """Uniform levels and uniform stand-ins: the ECE is about its floor; half as large levels are
    far above it."""
    rng = RNG(2)
    levels, stand_in = rng.uniform(size=(100, 9)), rng.uniform(size=(100, 10, 9))
    found = ece(levels, stand_in, np.arange(100))
    assert found.whole.low <= found.whole.high
    assert found.whole.value < 3 * found.floor
    assert found.joint.shape == (9,)
    wide = ece(levels * 0.5, stand_in, np.arange(100))
    assert wide.whole.low > found.floor_95


@pytest.mark.slow
def test_the_ece_is_blind_where_less_than_half_of_the_joints_are_wrong() -> None:
    """The field's hole, shown: four of nine joints ten times too narrow go unseen; by joint they
    are seen."""
    levels = RNG(3).uniform(size=(2000, 9))
    levels[:, :4] = 1.0
    found = ece(levels, levels[:, None], np.arange(2000))
    assert found.whole.value < 0.03
    assert found.joint[:4].min() > 0.4
    assert found.joint[4:].max() < 0.03


def test_intervals_draw_whole_clusters() -> None:
    levels = np.repeat(RNG(4).uniform(size=20), 30)
    tied = coverage(levels, 0.5, np.repeat(np.arange(20), 30))
    free = coverage(levels, 0.5, np.arange(600))
    assert tied.value == free.value
    assert tied.high - tied.low > 3 * (free.high - free.low)


def test_poses_of_the_model_are_covered(model: PoseModel, cases: list[Case]) -> None:
    """End to end with the true torso and camera: nothing is excluded, coverage is about nominal
    (some 12 poses, joints of a pose being tied: three standard errors of 80 % regions are 0.35)."""
    some = possible(model, [by_the_likelihood(case) for case in cases])
    assert len(some) > 8
    known = instances(some, model, TRUE)
    standings = stand(sampler_of("rejection", model, 100, root="candidates"), known, seed=0)
    columns = case_columns(some, exclusions(model, some, known))
    found = summary(standings_tree(standings, {}, columns))
    assert found.size == len(some)
    assert found.without_draws == 0
    assert 0.4 < found.covered["lateral", 0.8].value <= 1.0
    assert found.lateral > 10
    assert found.depth > 10
    assert found.ece.floor > 0


@pytest.mark.slow
def test_the_coverage_of_real_poses_is_resumed_to_the_same_bits(
    model: PoseModel, cases: list[Case], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("poseterior.inference.studies.calibration.run.SIMULATIONS_PER_BLOCK", 10)
    out, settings = (
        tmp_path / "coverage.nc",
        {
            "num_samples": 20,
            "source": {"data": "made"},
            "root": "candidates",
        },
    )
    whole = cover(model, cases, out=out, **settings)  # type: ignore[arg-type]
    assert summary(whole).size == len(cases)
    (tmp_path / "coverage.blocks" / "block-000001.nc").unlink()
    done: list[int] = []
    again = cover(
        model,
        cases,
        out=out,
        progress=lambda now, _: done.append(now),
        **settings,  # type: ignore[arg-type]
    )
    assert done == [10, 20, 24]
    assert again.identical(whole)
    with xr.open_datatree(out) as stored:
        np.testing.assert_array_equal(stored["simulation"].whole, whole["simulation"].whole)
        assert stored.attrs["data"] == "made"
    with pytest.raises(BadInput, match="was made of other poses"):
        cover(model, cases[::-1], out=out, **settings)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="its data is 'made', not None"):
        cover(model, cases, out=out, num_samples=20, root="candidates")


@pytest.mark.parametrize(
    ("held", "low", "high"),
    [(True, 0.025 ** (1 / 24), 1.0), (False, 0.0, 1 - 0.025 ** (1 / 24))],
)
def test_where_all_agree_the_interval_is_that_of_so_many_trials(
    held: bool, low: float, high: float
) -> None:
    """ "100 % (100 %–100 %)" of 24 poses says too much: 100 % (86 %–100 %)."""
    found = coverage(np.full((24, 9), 0.1 if held else 0.9), 0.5, np.arange(24))
    assert found == pytest.approx((float(held), low, high))


@pytest.mark.slow
@pytest.mark.parametrize("power", [1.0, 1.2, 2.0])
def test_the_interval_of_the_ece_holds_the_truth(power: float) -> None:
    """Levels uniform to a power, so that the truth is known, 20 times: 95 % intervals hold it at
    least 14 times (false alarm 5e-5 for each power). Percentiles, the negative control, never hold
    an ECE of zero: that of a sample is larger than that of the law."""
    truth = float(np.mean(np.abs(ECE_LEVELS ** (1 / power) - ECE_LEVELS)))
    held = by_percentiles = 0
    for seed in range(20):
        levels, cluster = RNG(seed).uniform(size=(40, 1)) ** power, np.arange(40)
        whole = ece(levels, levels[:, None], cluster, seed).whole
        held += whole.low <= truth <= whole.high
        again = resampled(
            cluster,
            RNG(seed),
            lambda rows, levels=levels: calibration_error(levels[rows]),
            number=50,
        )
        by_percentiles += np.quantile(again, 0.025) <= truth <= np.quantile(again, 0.975)
    assert held >= 14, held
    assert by_percentiles == 0 or power > 1, by_percentiles


def test_a_posterior_without_draws_is_a_miss() -> None:
    held = coverage(np.array([0.1, np.nan, np.nan, 0.2]), 0.95, np.arange(4))
    assert held.value == 0.5


def test_a_posterior_that_is_not_complete_is_not_without_draws() -> None:
    lost = Standing(OUT_OF_BUDGET, "no draws")
    half = {
        name: np.full_like(part, 0.5)
        for name, part in lost._asdict().items()
        if isinstance(part, np.ndarray)
    }
    few = lost._replace(num_draws=50, **half)
    columns = {
        "recording": np.array(["one", "another"]),
        "unit_mm": np.full(2, 300.0),
        "reasons": np.array(["[]", "[]"]),
    }
    found = summary(standings_tree([few, lost], {}, columns))
    assert (found.size, found.without_draws) == (2, 1)
    assert found.depth == pytest.approx(150)


def test_instances_that_failed_count_against_a_verdict(tmp_path: Path) -> None:
    """One of three has no level: a third failed, whatever the others say."""
    known = Standing(COMPLETE, "", level=np.full(len(QUANTITIES), 0.5), nearest_limit=3.0)
    standings = [known, Standing(FAILED, "no draws"), known._replace(nearest_limit=4.0)]
    columns = {"hidden": np.array([1, 2, 1]), "score": np.array([0.5, 0.6, 0.7])}
    save_tree(standings_tree(20 * standings, {}, _often(columns, 20)), tmp_path / "coverage.nc")
    found = read_judged(tmp_path / "coverage.nc")
    assert isinstance(found, tuple)
    level, covariates = found
    assert np.isfinite(level.values).any(axis=1).tolist() == 20 * [True, False, True]
    assert covariates["score"].tolist() == 20 * [0.5, 0.6, 0.7]
    assert covariates["nearest_limit"][[0, 2]].tolist() == [3.0, 4.0]
    judged = judge_levels(level, covariates)
    assert judged.calibration.tests.attrs["num_failed"] == 20
    assert judged.map is not None  # "hidden" is 1 of all that were judged
    assert judged.map.covariate.values.tolist() == ["score", "nearest_limit"]


def _often(columns: dict[str, np.ndarray], times: int) -> dict[str, np.ndarray]:
    return {name: np.tile(column, times) for name, column in columns.items()}


def test_what_is_hidden_is_counted(cases: list[Case]) -> None:
    seen = detected_columns(
        [case.hiding(missing).detection for case in cases[:1] for missing in (0, 3)]
    )
    assert np.diff(seen["hidden"]) == [3]
    assert seen["detector"].tolist() == 2 * [cases[0].detection.layout]


def test_detections_of_the_likelihood_stay_in_their_discs(
    model: PoseModel, cases: list[Case]
) -> None:
    for case in cases[:6]:
        drawn = by_the_likelihood(case)
        seen = drawn.detection.seen
        assert (seen == case.detection.seen).all()
        radius = Likelihood().spread(drawn.detection, case.scale * case.unit)
        far = np.linalg.norm(drawn.detection.keypoints - case.pixels[:, :2], axis=1)
        assert (
            far[list(MOVING)][seen[list(MOVING)]] <= radius[list(MOVING)][seen[list(MOVING)]]
        ).all()
        again = by_the_likelihood(case)
        np.testing.assert_array_equal(again.detection.keypoints, drawn.detection.keypoints)


def near(case: Case) -> Case:
    """The same person two metres from a camera whose lens is known, and seen exactly."""
    lens = Lens(2000 * case.scale, np.array([900.0, -200.0]))
    case = dataclasses.replace(case, lens=lens)
    keypoints = np.where(case.detection.seen[:, None], case.image(case.pose), np.nan)
    return dataclasses.replace(
        case, detection=dataclasses.replace(case.detection, keypoints=keypoints)
    )


def test_known_lenses_explain_who_is_near(model: PoseModel, cases: list[Case]) -> None:
    """Torso and camera of the truth show what was seen, and nothing excludes it; to a camera that
    does not know its lens it would be far off."""
    some = [near(case) for case in possible(model, cases)[:6]]
    likelihood = Likelihood(factor=0.05)
    known = instances(some, model, likelihood=likelihood)
    for case, instance in zip(some, known, strict=True):
        candidate = instance.frame.candidates[0]
        seen = np.asarray(candidate.camera.image(instance.joints))
        np.testing.assert_allclose(seen, case.image(case.pose), atol=1e-9)
        posterior = instance.frame.posterior(model)
        assert float(posterior.model.lens.focal) == 2000 * case.scale
    assert exclusions(model, some, known, "uncertain") == [[]] * len(some)
    without = [dataclasses.replace(case, lens=None) for case in some]
    blind = instances(without, model, likelihood=likelihood)
    assert all(exclusions(model, without, blind, "uncertain"))


def test_what_is_near_strays_farther_in_the_image(cases: list[Case]) -> None:
    case = near(cases[1])
    far = dataclasses.replace(case, lens=None)
    strays = [
        np.linalg.norm(by_the_likelihood(one).detection.keypoints - one.image(one.pose), axis=1)
        for one in (case, far)
    ]
    ratio, seen = strays[0] / strays[1], case.detection.seen
    np.testing.assert_allclose(ratio[seen], case.magnification(case.pose)[seen])
    assert np.ptp(ratio[seen]) > 0.1


def test_estimates_bring_the_truth_into_their_own_units(
    model: PoseModel, cases: list[Case]
) -> None:
    some = [cases[1], cases[5]]
    for case, instance in zip(some, instances(some, model, "zhou"), strict=True):
        camera = instance.frame.candidates[0].camera
        offset = float(camera.scale) * instance.joints
        np.testing.assert_allclose(offset, case.pixels - case.pixels[0], atol=1e-9)


# --- k hypotheses


def cloud(number: int = 60) -> np.ndarray:
    return RNG(5).normal(size=(number, 15, 3))


@pytest.mark.parametrize("way", CHOICES)
def test_ways_choose_among_the_poses(way: str) -> None:
    poses = cloud()
    for k in (1, 5, 20):
        chosen = CHOOSE[way](poses, k, 0)
        assert chosen.shape == (k, 15, 3)
        rows = [int(np.argmin(np.abs(poses - one).sum(axis=(1, 2)))) for one in chosen]
        assert len(set(rows)) == k
        np.testing.assert_array_equal(poses[rows], chosen)
    assert POSE_GRID in CHOICES


def test_the_farthest_points_are_far() -> None:
    line = np.zeros((11, 15, 3))
    line[:, 3, 0] = np.arange(11)
    chosen = by_distance(line, 3)[:, 3, 0]
    assert {0.0, 10.0} <= set(chosen.tolist()) or {0.0, 10.0} & set(chosen.tolist())
    gaps = np.diff(np.sort(chosen))
    assert gaps.min() >= 2


def test_best_errors_by_hand() -> None:
    truth = np.zeros((2, 15, 3))
    truth[1] += 1.0
    chosen = np.zeros((3, 15, 3))
    chosen[1, :, 0] = 3.0
    np.testing.assert_allclose(best_error(chosen, truth), [0.0, np.sqrt(3)])
    errors = [best_error(cloud()[:k], np.zeros((15, 3))) for k in (1, 5, 50)]
    assert errors == sorted(errors, reverse=True)


def test_modes_represented() -> None:
    poses = cloud(200)
    assert modes_represented(poses, poses) == 1.0
    one = modes_represented(poses[:1], poses)
    assert 0 < one < 0.2
    assert modes_represented(np.stack([pose.joints for pose in diverse(poses, 5)]), poses) > one


# --- shared data


def test_true_candidates_of_real_poses(model: PoseModel, shared_data: object) -> None:
    from poseterior.probmodel.datasets import Noise, read_data_set

    data = read_data_set(shared_data / "bvh", frames=6, noise=Noise("gaussian", 0.01))  # type: ignore[operator]
    for case in data:
        candidate = true_candidate(case, model)
        assert isinstance(candidate.camera, WeakPerspective)
        np.testing.assert_allclose(
            hung(case, candidate) * float(candidate.camera.scale),
            case.pixels - case.pixels[0],
            atol=1e-9,
        )
    known = instances(list(data), model)
    found = assess(known[0], Answer(np.repeat(known[0].joints[None], 20, axis=0)), RNG(0))
    assert np.isfinite(found.whole).all()
    assert len(BONES) == found.whole.size
