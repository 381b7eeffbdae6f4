"""Akhter & Black's pursuit: the adjustment under it against SciPy, what its steps must do, and the
poses it finds."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from poseterior.inference.estimators import akhter_black as ab
from poseterior.inference.estimators.adjustment import adjust, mirror_twin
from poseterior.inference.estimators.points import Points
from poseterior.inference.studies.errors import mean_joint_error
from poseterior.probmodel import AnatomicalLimits, BadInput
from poseterior.probmodel.body import bone_vectors
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from tests.inference.test_zhou import VIEWS, detection, relative_error, seen

DICTIONARY = PoseDictionary.default()
LIMITS = AnatomicalLimits.default()
SHAPES = np.concatenate([DICTIONARY.mean[None], DICTIONARY.bases])


def problem(bones: float = ab.BONES_WEIGHT, limits: float = ab.LIMIT_WEIGHT) -> ab.PursuitProblem:
    return ab.PursuitProblem(SHAPES, DICTIONARY.lengths, LIMITS, bones, limits)


def noisy(number: int = 8, noise: float = 0.05, seed: int = 0) -> list[np.ndarray]:
    """Poses in camera axes, several directions mixed, with noise."""
    rng = np.random.default_rng(seed)
    found = []
    for row in range(number):
        weights = (
            rng.normal(size=len(DICTIONARY.bases))
            * (rng.uniform(size=len(DICTIONARY.bases)) < 0.05)
            * 0.5
        )
        pose = DICTIONARY.mean + np.einsum("k,kja->ja", weights, DICTIONARY.bases)
        found.append(
            seen(pose, *VIEWS[row % len(VIEWS)]) + rng.normal(size=(NUM_JOINTS, 3)) * noise
        )
    return found


# --- the adjustment


def test_the_adjustment_is_the_least_squares_fit():
    """Against SciPy's solver on the written-out residuals, with unequal scores, bone lengths of
    another weight than one, and a missing joint (second route)."""
    scores, beta = np.linspace(0.3, 1.0, NUM_JOINTS), 0.3
    points = Points.gather([detection(pose, missing=(4,), score=scores) for pose in noisy(4)])
    terms = np.tile([0, 3, 20, 50], (4, 1))
    penalty = problem(bones=beta).bone_penalty(terms)
    start = np.stack(
        [
            np.asarray(Rotation.from_euler("yx", view, degrees=True).as_matrix())
            for view in VIEWS[:4]
        ]
    )
    start = np.diag([1.0, -1.0, -1.0]) @ start
    first = np.tile([0.7, 0.0, 0.0, 0.0], (4, 1))
    ours = adjust(points.xy, points.weight, SHAPES[terms], start, first, penalty, iterations=200)
    assert ours.converged.all()
    bones, square = bone_vectors(SHAPES[terms[0]]), DICTIONARY.lengths**2
    for row in range(4):

        def residuals(x: np.ndarray, row: int = row) -> np.ndarray:
            turn = Rotation.from_rotvec(x[:3]).as_matrix() @ start[row]
            pose = np.einsum("k,kja->ja", x[5:], SHAPES[terms[row]])
            image = points.xy[row] - pose @ turn[:2].T - x[3:5]
            whole = np.einsum("k,kba->ba", x[5:], bones)
            lengths = np.sqrt(beta) * (np.sum(whole**2, axis=1) - x[5] ** 2 * square)
            return np.concatenate([(np.sqrt(points.weight[row])[:, None] * image).ravel(), lengths])

        theirs = least_squares(
            residuals, np.concatenate([np.zeros(5), first[row]]), xtol=1e-12, ftol=1e-12
        )
        assert ours.objective[row] == pytest.approx(2 * theirs.cost, rel=1e-6)


def test_an_adjustment_cut_short_has_not_converged_and_is_better_than_its_start():
    points = Points.gather([detection(pose) for pose in noisy(4)])
    terms = np.zeros((4, 1), int)
    start = np.tile(np.diag([1.0, -1.0, -1.0]), (4, 1, 1))
    cuts = [
        adjust(points.xy, points.weight, SHAPES[terms], start, np.full((4, 1), 0.7), iterations=n)
        for n in range(9)
    ]
    assert not cuts[1].converged.any()
    assert (np.diff([cut.objective for cut in cuts], axis=0) <= 0).all()


def test_a_mirror_twin_shows_a_flat_body_alike():
    rotation = Rotation.random(6, rng=np.random.default_rng(0)).as_matrix()
    flat = np.random.default_rng(1).normal(size=(5, 3)) * [1.0, 1.0, 0.0]
    twin = mirror_twin(rotation)
    assert np.linalg.det(twin) == pytest.approx(np.ones(6))
    assert flat @ twin[:, :2].swapaxes(1, 2) == pytest.approx(flat @ rotation[:, :2].swapaxes(1, 2))


# --- the pursuit


@pytest.mark.slow
def test_the_objective_never_rises(monkeypatch):
    """At no step of the pursuit, whether the term is kept or not, nor when it settles; and it falls
    by far in all."""
    steps: list[tuple[np.ndarray, np.ndarray]] = []

    def watched(name: str) -> None:
        step = getattr(ab, name)

        def record(points: Points, given: ab.PursuitProblem, fit: ab.PursuitFit) -> ab.PursuitFit:
            before = fit.objective.copy()
            found = step(points, given, fit)
            steps.append((before, found.objective.copy()))
            return found

        monkeypatch.setattr(ab, name, record)

    watched("_extended")
    watched("_settled")
    points = Points.gather([detection(pose, missing=(3, 11)) for pose in noisy()])
    rotation, scale = ab.torso_cameras(points, DICTIONARY.mean)
    twice = points.repeat(2)
    start = ab.pursue(twice, problem(), rotation, scale, most_terms=0).objective
    fit = ab.pursue(twice, problem(), rotation, scale)
    assert len(steps) > 5
    for before, after in steps:
        assert (after <= before + 1e-12).all()
    assert (fit.objective < 0.5 * start).all()


def test_terms_are_those_that_correlate_best():
    """By weighted least squares on each term's projection and a translation, term by term: those
    that lower the weighted squares most, whatever their length; never the mean, nor a term twice.
    Scores are unequal."""
    scores = np.linspace(0.2, 1.0, NUM_JOINTS)
    points = Points.gather([detection(pose, score=scores) for pose in noisy(2)])
    rotation, scale = ab.torso_cameras(points, DICTIONARY.mean)
    rotation, scale = rotation[::2], scale[::2]
    stretched = problem()._replace(shapes=SHAPES * np.linspace(1, 9, len(SHAPES))[:, None, None])
    terms, coefficient = np.tile([0, 7], (2, 1)), np.stack([scale, 0.1 * scale], axis=1)
    fit = ab._at(points, stretched, terms, coefficient, rotation)
    found = ab._promising(points, stretched, fit)
    for row in range(2):
        root, rows = np.sqrt(points.weight[row])[:, None], rotation[row, :2]
        pose = np.einsum("k,kja->ja", coefficient[row], stretched.shapes[terms[row]])
        left = ((points.xy[row] - pose @ rows.T) * root).ravel()
        moves = [np.outer(root, axis).ravel() for axis in np.eye(2)]
        gains = []
        for shape in stretched.shapes:
            columns = np.stack([*moves, (shape @ rows.T * root).ravel()], axis=1)
            solved = np.linalg.lstsq(columns, left, rcond=None)[0]
            gains.append(-np.sum((left - columns @ solved) ** 2))
        wanted = [term for term in np.argsort(gains)[::-1] if term not in (0, 7)]
        assert found[row].tolist() == wanted[: ab.TRIED]


def test_the_objective_is_the_sum_of_its_three_terms():
    """Recomputed from the parts: weighted reprojection, squared bone lengths, bones that break a
    limit."""
    poses = noisy(4)
    points = Points.gather([detection(pose) for pose in poses])
    rotation, scale = ab.torso_cameras(points, DICTIONARY.mean)
    twice = points.repeat(2)
    fit = ab.pursue(twice, problem(), rotation, scale)
    joints = np.einsum("nk,nkja->nja", fit.coefficient, SHAPES[fit.terms])
    image = joints @ fit.rotation[:, :2].swapaxes(1, 2)
    image = image - np.average(image - twice.xy, axis=1, weights=twice.weight[0])[:, None]
    reprojection = np.sum(twice.weight[..., None] * (image - twice.xy) ** 2, axis=(1, 2))
    square = (
        np.sum(bone_vectors(joints) ** 2, axis=-1)
        - fit.coefficient[:, :1] ** 2 * DICTIONARY.lengths**2
    )
    broken = np.sum(~LIMITS.check(joints).valid, axis=1)
    whole = reprojection + ab.BONES_WEIGHT * np.sum(square**2, axis=1) + ab.LIMIT_WEIGHT * broken
    assert fit.objective == pytest.approx(whole, rel=1e-9)


def test_limits_and_lengths_are_heeded():
    """With the terms C_p and C_l poses break fewer limits, and bones are nearer to the dictionary's
    lengths."""
    detections = [detection(pose) for pose in noisy(16, noise=0.1)]

    def judged(bones: float, limits: float) -> tuple[int, float]:
        fits = ab.fit_akhter_black(
            detections, DICTIONARY, LIMITS, bones_weight=bones, limit_weight=limits
        )
        joints = np.stack([fit[0].pose for fit in fits])
        lengths = np.linalg.norm(bone_vectors(joints), axis=-1)
        return int(np.sum(~LIMITS.check(joints).valid)), float(
            np.mean(np.abs(lengths / DICTIONARY.lengths - 1))
        )

    broken, spread = judged(ab.BONES_WEIGHT, ab.LIMIT_WEIGHT)
    assert broken < judged(ab.BONES_WEIGHT, 0.0)[0]
    assert spread < judged(0.0, ab.LIMIT_WEIGHT)[1]


@pytest.mark.parametrize("dictionary", ["embedded", "incoherent"])
def test_a_pose_in_the_span_is_recovered(dictionary):
    """Noise-free, reprojection alone: the mean and one direction of the embedded dictionary; the
    mean and two of an incoherent one (random limbs), at four yaws and two tilts."""
    rng = np.random.default_rng(12)
    bases, terms = DICTIONARY.bases, 1
    if dictionary == "incoherent":
        bases, terms = rng.normal(size=(40, NUM_JOINTS, 3)), 2
        bases[:, list(TORSO_INDEX)] = 0
        bases /= np.linalg.norm(bases, axis=(1, 2), keepdims=True)
    poses = []
    for view in VIEWS:
        chosen = rng.choice(len(bases), terms, replace=False)
        weights = rng.uniform(0.4, 0.8, terms) * rng.choice([-1, 1], terms)
        poses.append(seen(DICTIONARY.mean + np.einsum("k,kja->ja", weights, bases[chosen]), *view))
    own = dataclasses.replace(DICTIONARY, bases=bases)
    detections = [detection(pose) for pose in poses]
    fits = ab.fit_akhter_black(detections, own, LIMITS, bones_weight=0.0, limit_weight=0.0)
    for (best, *_), pose in zip(fits, poses, strict=True):
        assert relative_error(best, pose) < 1e-3
        assert best.converged
        turned = np.asarray(best.camera.rotation) @ best.torso.T * float(best.camera.scale)
        assert pytest.approx(100 * (pose - pose[0])[list(TORSO_INDEX)], abs=0.3) == turned.T


@pytest.mark.slow
def test_a_turned_image_gives_a_turned_pose():
    """By 30° and 60° in the image plane: the aligned error changes by less than 1 %, pose by
    pose."""
    truths = noisy(8)
    errors = []
    for angle in (0, 30, 60):
        turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        fits = ab.fit_akhter_black(
            [detection(truth @ turn.T) for truth in truths], DICTIONARY, LIMITS
        )
        errors.append(
            [mean_joint_error(fit[0].pose, truth) for fit, truth in zip(fits, truths, strict=True)]
        )
    assert errors[1] == pytest.approx(errors[0], rel=0.01)
    assert errors[2] == pytest.approx(errors[0], rel=0.01)


def test_frames_do_not_depend_on_their_batch():
    detections = [detection(pose, missing=(4,)) for pose in noisy(3)]
    whole = ab.fit_akhter_black(detections, DICTIONARY, LIMITS)
    for one, together in zip(detections, whole, strict=True):
        alone = ab.fit_akhter_black([one], DICTIONARY, LIMITS)[0]
        assert alone[0].pose == pytest.approx(together[0].pose, abs=1e-6)


def test_the_torso_needs_a_camera():
    pose = noisy(1)[0]
    missing = tuple(JOINT_INDEX[name] for name in ("pelvis", "right_hip", "left_hip"))
    with pytest.raises(BadInput, match="too few torso joints for a camera"):
        ab.fit_akhter_black([detection(pose, missing=missing)], DICTIONARY, LIMITS)
