"""Posteriors that are wrong in a known way: whoever trusts a test of calibration should see that it
rejects these.

A distortion takes right draws of one instance and spoils them; `ignoring` and
`following_the_recipe` are samplers of their own."""

import dataclasses
import functools
from collections.abc import Callable

import jax
import numpy as np

from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.studies.calibration.assess import Answer
from poseterior.inference.studies.calibration.posteriors import Sampler
from poseterior.inference.studies.calibration.quantities import MOVING
from poseterior.inference.studies.calibration.recipe import RecipeDirection
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import GROUPS, LOWER_BONES, UPPER_BONES
from poseterior.probmodel.transport import CUBE_DIM, from_cube

Distortion = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""Draws `(n, 15, 3)` of one instance → spoilt ones."""
NARROWED = MOVING[:7]
"""Head, elbows, knees and the right wrist and ankle … seven of the fifteen joints."""


def narrower(joints: np.ndarray, rng: np.random.Generator, factor: float = 0.8) -> np.ndarray:
    """All deviations from the mean pose, times `factor`."""
    middle = joints.mean(axis=0)
    return middle + factor * (joints - middle)


def swapped_axes(joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Deviations in depth take the place of those to the side, and the reverse."""
    middle = joints.mean(axis=0)
    return middle + (joints - middle)[..., [2, 1, 0]]


def some_joints_narrower(joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Seven of the fifteen joints ten times too narrow."""
    middle = joints.mean(axis=0)
    spoilt = joints.copy()
    some = list(NARROWED)
    spoilt[:, some] = middle[some] + 0.1 * (joints - middle)[:, some]
    return spoilt


def uncorrelated(joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Every joint as often where it should be as ever, but whatever the others do."""
    return np.stack(
        [joints[rng.permutation(len(joints)), joint] for joint in range(joints.shape[1])], axis=1
    )


DISTORTIONS: dict[str, Distortion] = {
    "spread × 0.8": narrower,
    "depth and lateral swapped": swapped_axes,
    "7 of 15 joints ten times too narrow": some_joints_narrower,
    "joints uncorrelated": uncorrelated,
}
IGNORING, LITERAL_RECIPE = "ignores the image", "the paper's literal recipe"


def distorted(sampler: Sampler, distortion: Distortion) -> Sampler:
    """The sampler's draws, spoilt."""

    def draw(index: int, instance: Instance, key: jax.Array) -> Answer:
        posterior = sampler(index, instance, key)
        rng = np.random.default_rng(np.asarray(jax.random.key_data(jax.random.fold_in(key, 1))))
        return posterior._replace(joints=distortion(posterior.joints, rng))

    return draw


def ignoring(model: PoseModel, number: int) -> Sampler:
    """Draws of the prior, given torso and camera, whatever was detected."""

    def draw(index: int, instance: Instance, key: jax.Array) -> Answer:
        cube = np.asarray(jax.random.uniform(key, (number, CUBE_DIM)))
        view = np.asarray(instance.frame.observation.view)
        return Answer(in_chunks(functools.partial(_prior, model, view), cube, size=512))

    return draw


@jax.jit
def _prior(model: PoseModel, view: jax.Array, cube: jax.Array) -> jax.Array:
    return model.joints(view, *from_cube(model, cube))


TRIES = 1 << 13
MOST_TRIES = 1 << 17
"""Bodies proposed at a time, and at most, by `following_the_recipe`."""


def following_the_recipe(model: PoseModel, number: int) -> Sampler:
    """The posterior under the paper's literal recipe for lower bones (clamp and great circle
    included), by rejection.

    Lengths and upper bones have one law under both; so exact bodies that explain the upper joints
    alone are given lower bones by the recipe, and kept, arms and legs apart, where those explain
    theirs."""

    def draw(index: int, instance: Instance, key: jax.Array) -> Answer:
        observation = instance.frame.observation
        upper_only = _without_lower(instance.frame)
        kept: dict[str, list[np.ndarray]] = {name: [] for name in GROUPS}
        tried = 0
        while min(_held(kept).values()) < number and tried < MOST_TRIES:
            own = jax.random.fold_in(key, tried)
            draws = ExactRejection().draw(upper_only.posterior(model, CANDIDATES), own, TRIES)
            length, upper, _ = draws.poses
            joints = np.asarray(_recipe(model, observation, own, length, upper))
            for name, right in _explained(observation, joints).items():
                kept[name].append(joints[right])
            tried += TRIES
        held = min(number, *_held(kept).values())
        return Answer(_joined(kept, held, np.asarray(observation.view)))

    return draw


def _without_lower(frame: Estimate) -> Estimate:
    """The frame whose likelihood looks at head, elbows and knees alone; their radii are those of
    the whole."""
    lower = [bone.end for bone in LOWER_BONES]
    keypoints = frame.detection.keypoints.copy()
    score = frame.detection.score.copy()
    mean = score[[joint for joint in frame.likelihood.joints if score[joint] > 0]].mean()
    keypoints[lower] = np.nan
    score[lower] = 0.0
    upper = [bone.end for bone in UPPER_BONES if score[bone.end] > 0]
    factor = (
        frame.likelihood.factor * mean / score[upper].mean()
    )  # τ = factor · scale · mean score / score
    return dataclasses.replace(
        frame,
        detection=dataclasses.replace(frame.detection, keypoints=keypoints, score=score),
        likelihood=dataclasses.replace(frame.likelihood, factor=factor),
    )


@jax.jit
def _recipe(
    model: PoseModel, observation: Observation, key: jax.Array, length: jax.Array, upper: jax.Array
) -> jax.Array:
    lower = RecipeDirection(model.hinges_at(upper)).sample(key)
    return model.joints(observation.view, length, upper, lower)


def _explained(observation: Observation, joints: np.ndarray) -> dict[str, np.ndarray]:
    """By group, which of the poses `(n, 15, 3)` put its seen lower joints into their discs."""
    seen = np.asarray(observation.seen)
    reached = np.asarray(observation.squares(joints)) <= observation.law.reach**2
    lower = {bone.end for bone in LOWER_BONES}
    found = {}
    for name, limbs in GROUPS.items():
        ends = [
            bone.end
            for limb in limbs
            for bone in limb.bones
            if bone.end in lower and seen[bone.end]
        ]
        found[name] = reached[:, ends].all(axis=1)
    return found


def _held(kept: dict[str, list[np.ndarray]]) -> dict[str, int]:
    return {name: sum(map(len, parts)) for name, parts in kept.items()}


def _joined(kept: dict[str, list[np.ndarray]], number: int, view: np.ndarray) -> np.ndarray:
    """Bodies of the groups' draws, which are independent of each other."""
    bodies = np.concatenate(kept["head"])[:number].copy() if number else np.empty((0, 15, 3))
    for name, limbs in GROUPS.items():
        ends = [bone.end for limb in limbs for bone in limb.bones]
        if number:
            bodies[:, ends] = np.concatenate(kept[name])[:number][:, ends]
    return bodies
