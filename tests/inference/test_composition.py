"""Composed hypotheses: possible, explained by their roots, and like the centres of their clusters.

A root is not handed out, so that it is found anew here: the torso whose joints a hypothesis has,
turned, and the scale and translation that put its joints onto its keypoints. Under it the log joint
density must be finite. Where there are few draws, every way to combine their limbs is tried."""

import dataclasses
import functools
import itertools

import jax
import numpy as np
import pytest
from scipy.optimize import least_squares

from poseterior import inference
from poseterior.inference.clusters import clusters
from poseterior.inference.composition import DrawnUnder, compose
from poseterior.inference.draws import Draws
from poseterior.inference.hypothesis import Hypothesis
from poseterior.probmodel import BadInput, Estimate, FaultPrior, Likelihood, PoseModel
from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.model import log_joint
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import GROUPS, LENGTH_GROUPS, NUM_JOINTS, PARENTS, TORSO_INDEX
from tests.scenes import drawer, key, prior_scene
from tests.sweeps import sweep

NUM, K = 600, 4
LIMBS = [limb for limbs in GROUPS.values() for limb in limbs]
TORSO = list(TORSO_INDEX)
SMALL = 0.1
CASES = {
    "disc": (Likelihood(factor=0.5), None),
    "small discs": (Likelihood(factor=SMALL), None),
    "Gaussian": (Likelihood(Gaussian(), factor=0.3), None),
    "faults": (Likelihood(factor=0.5, faults=FaultPrior.of(0.1, 0.1)), None),
    "focal": (Likelihood(factor=0.5), Lens(650.0, np.array([250.0, 420.0]))),
}


@functools.cache
def scene(name: str = "disc") -> tuple[PoseModel, Estimate]:
    likelihood, lens = CASES[name]
    model = PoseModel().seen_by(lens)
    frame = prior_scene(PoseModel(), 3, factor=SMALL if name == "small discs" else 0.5)
    return model, dataclasses.replace(frame, likelihood=likelihood)


@functools.cache
def uncertain(name: str) -> Draws:
    model, frame = scene(name)
    draw = drawer(model, root="uncertain", num_samples=NUM, num_roots=100)
    return draw(frame, key(1))


@functools.cache
def fixed() -> Draws:
    """Under three candidates: the true root, and two that are turned a little."""
    model, frame = scene()
    one = frame.candidates[0]
    turned = [one]
    for angle in (0.1, -0.1):
        spin = np.array(
            [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        )
        camera = one.camera._replace(rotation=np.asarray(one.camera.rotation) @ spin)
        turned.append(dataclasses.replace(one, camera=camera))
    frame = dataclasses.replace(frame, candidates=tuple(turned))
    return drawer(model, root="candidates", num_samples=NUM)(frame, key(1))


def lengths_of(joints: np.ndarray) -> np.ndarray:
    """`(5,)` by group of the right side's bones, whose equals the left side's are."""
    found = np.zeros(len(LENGTH_GROUPS))
    for limb in LIMBS:
        for bone in limb.bones:
            length = np.linalg.norm(joints[bone.end] - joints[PARENTS[bone.end]])
            assert found[bone.length_group] in (0, pytest.approx(length, abs=1e-9))
            found[bone.length_group] = length
    return found


def density_of(posterior: Posterior, one: Hypothesis, patterns: Faults) -> float:
    """The log joint density under the root that the hypothesis has, and the best of some patterns
    of faults."""
    torsos, view = np.asarray(posterior.model.torsos), one.joints[TORSO]
    rotations = align_torsos(torsos, view)
    residual = np.einsum("nab,njb->nja", rotations, torsos) - view
    torso = int(np.argmin(np.abs(residual).max(axis=(1, 2))))
    assert np.abs(residual[torso]).max() < 1e-9

    def point(values: np.ndarray) -> RootPoint:
        return RootPoint(torso, rotations[torso], values[0], values[1:])

    def off(values: np.ndarray) -> np.ndarray:
        image = posterior.root_prior.root(point(values)).camera.image(one.joints)
        return np.ravel(np.asarray(image) - one.keypoints)

    start = np.array([np.log(100.0), *one.keypoints[0]])
    found = least_squares(off, start, x_scale=(0.01, 1, 1), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(found.fun).max() < 1e-6
    pose = posterior.model.pose_of(one.joints, lengths_of(one.joints))
    best = -np.inf
    for row in range(len(patterns.exchange)):
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (point(found.x), pose))
        faults = patterns.take([row])
        best = max(best, float(posterior.log_joint(batch[0], Pose(*batch[1]), faults)[0]))
    return best


@pytest.mark.parametrize("name", sweep(CASES, ["disc", "small discs"]))
def test_composed_hypotheses_are_possible_under_an_uncertain_root(name):
    drawn = uncertain(name)
    faults = drawn.faults
    rows = np.unique(np.column_stack([faults.exchange, faults.outlier]), axis=0, return_index=True)
    for one in compose(drawn, K):
        assert drawn.posterior.model.limits.check(one.joints).valid.all()
        assert np.isfinite(density_of(drawn.posterior, one, faults.take(rows[1])))


def test_a_mean_camera_must_explain_the_torso_too():
    """Between these two draws lies a camera under which a torso of theirs is nearer to the centre
    than their own, but out of reach."""
    drawn = uncertain("disc").take([117, 571])
    (one,) = compose(drawn, 1)
    assert np.isfinite(density_of(drawn.posterior, one, Faults.none(1)))


def test_a_hypothesis_out_of_reach_has_no_density():
    """The control of the test above: the same, its elbow turned about the shoulder."""
    drawn = uncertain("disc")
    one = compose(drawn, K)[0]
    joints = one.joints.copy()
    for joint in (3, 4):  # mirrored in height
        joints[joint, 1] = 2 * joints[2, 1] - joints[joint, 1]
    scale = np.exp(drawn.points.log_scale).mean()
    keypoints = one.keypoints + scale * (joints - one.joints)[:, :2]
    assert np.linalg.norm(keypoints - one.keypoints, axis=1).max() > 30
    try:
        log = density_of(
            drawn.posterior, one._replace(joints=joints, keypoints=keypoints), Faults.none(1)
        )
    except AssertionError:  # no camera sees it so
        return
    assert log == -np.inf


def test_composed_hypotheses_are_possible_under_a_fixed_root():
    drawn = fixed()
    assert len(np.unique(drawn.points)) == 3
    for one in compose(drawn, K):
        assert drawn.posterior.model.limits.check(one.joints).valid.all()
        pose = drawn.posterior.model.pose_of(one.joints, lengths_of(one.joints))
        whole = jax.tree.map(lambda leaf: np.asarray(leaf)[None], pose)
        views = [np.asarray(seen.view) for seen in drawn.posterior.observations]
        index = int(np.argmin([np.abs(view - one.joints[TORSO]).max() for view in views]))
        seen = drawn.posterior.observations[index]
        assert np.abs(views[index] - one.joints[TORSO]).max() < 1e-9
        assert np.isfinite(log_joint(drawn.posterior.model, seen, *whole)[0])
        image = np.asarray(seen.root.camera.image(one.joints))
        assert one.keypoints == pytest.approx(image, abs=1e-6)


def directions(joints: np.ndarray) -> np.ndarray:
    """`(..., 9, 3)`: where bones point."""
    ends = [bone.end for limb in LIMBS for bone in limb.bones]
    bones = joints[..., ends, :] - joints[..., [PARENTS[end] for end in ends], :]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


@pytest.mark.parametrize("which", [fixed, functools.partial(uncertain, "disc")])
def test_composed_hypotheses_point_as_the_means_of_clusters(which):
    """Bones are off the directions of their clusters' mean bones by less than half of what those of
    the nearest draws are off."""
    drawn = which()
    draws = inference.diverse(drawn.joints, K)
    composed = compose(drawn, K)
    assert [one.weight for one in composed] == [one.weight for one in draws]
    flat = drawn.joints.reshape(len(drawn.joints), -1)
    fit = clusters(flat, K, 0)
    order = np.argsort(-np.bincount(fit.labels), kind="stable")
    centres = directions(fit.centres[order].reshape(K, NUM_JOINTS, 3))

    def angles(chosen: list[Hypothesis]) -> float:
        cosine = np.sum(directions(np.array([one.joints for one in chosen])) * centres, axis=-1)
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())

    assert angles(composed) < angles(draws) / 2


def test_the_draw_of_a_composed_hypothesis_is_the_nearest():
    drawn = uncertain("disc")
    for one in compose(drawn, K):
        away = np.linalg.norm((drawn.joints - one.joints).reshape(NUM, -1), axis=1)
        assert one.draw == np.argmin(away)
        assert away.min() > 1e-3  # no draw itself


@pytest.mark.parametrize(("name", "rows"), [("disc", slice(5)), ("small discs", slice(5, 10))])
def test_of_few_draws_it_is_the_best_of_all_combinations(name, rows):
    """Five draws under one root: 5⁵ ways to combine their limbs, under 5 sets of lengths; where
    discs are small, the ways that point most nearly as the centre do not explain the detection."""
    model, frame = scene(name)
    drawn = drawer(model, root="candidates", num_samples=NUM)(frame, key(1)).take(rows)
    seen, centre = drawn.posterior.observations[0], drawn.joints.mean(axis=0)
    wanted, every = directions(centre), directions(drawn.joints)
    best, nearest, pose = np.inf, np.inf, np.empty(0)
    counts = np.isfinite(seen.reach)

    def explains(joints: np.ndarray) -> bool:
        off = np.linalg.norm(joints[:, :2] - np.asarray(seen.target), axis=1)
        return bool((off <= seen.reach)[counts].all())

    for lengths in drawn.bone_length:
        for rows in itertools.product(range(5), repeat=len(LIMBS)):
            joints, off, bone_of = drawn.joints[0].copy(), 0.0, 0
            for limb, row in zip(LIMBS, rows, strict=True):
                for bone in limb.bones:
                    length = lengths[bone.length_group]
                    joints[bone.end] = joints[PARENTS[bone.end]] + length * every[row, bone_of]
                    off += length**2 * np.sum((every[row, bone_of] - wanted[bone_of]) ** 2)
                    bone_of += 1
            nearest = min(nearest, off)
            if off < best and explains(joints):
                best, pose = off, joints
    assert (nearest < best) == (name == "small discs")
    (one,) = compose(drawn, 1)
    assert one.joints == pytest.approx(pose, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["disc", "faults"])
def test_a_result_gives_what_its_draws_give(name):
    model, frame = scene(name)
    posterior = frame.posterior(model)
    result = inference.sample(
        model, frame, key=key(2), root="uncertain", num_samples=200, num_roots=300
    )
    drawn = DrawnUnder.of(result, posterior)
    assert len(drawn.joints) == 200
    root = posterior.root_prior.root(drawn.points.take(7))
    joints = model.joints(root.view, *model.pose_of(drawn.joints[7], drawn.bone_length[7]))
    assert np.asarray(joints) == pytest.approx(drawn.joints[7], abs=1e-9)
    assert drawn.faults.outlier.any() == (name == "faults")  # in four of a hundred draws
    for one, other in zip(inference.composed(result, posterior, 3), compose(drawn, 3), strict=True):
        assert np.array_equal(one.joints, other.joints)


def test_draws_that_are_alike_give_fewer():
    same = fixed().take(np.zeros(20, int))
    (one,) = compose(same, 3)
    assert one.joints == pytest.approx(same.joints[0], abs=1e-9)
    assert (one.weight, one.draw) == (1.0, 0)


@pytest.mark.parametrize("k", [0, NUM + 1])
def test_k_out_of_range_is_refused(k):
    with pytest.raises(BadInput, match=f"choose k from 1 to {NUM}"):
        compose(fixed(), k)
