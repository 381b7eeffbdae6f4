"""How biased a prior learned from motion capture is, and how little of what is possible motion
capture ever visits.

The paper's introduction: a Gaussian mixture fitted to motion capture finds some actions far
likelier than others, because they were recorded more often; the uniform prior does not. Poses are
described by the directions of their nine free bones in the axes of the torso: nine unit vectors,
whatever the person's size and the camera."""

from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.prior import sample_prior
from poseterior.inference.studies.evaluation.scores import Interval, clustered
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.body import aligned
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.kinematics import articulation
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.skeleton import BONE_NAMES, BONES

COMPONENTS = 20
"""Of the mixture; fewer where poses are few."""
MOST_POSES = 20_000
LEAST_POSES = 200
PICTURED = 600
"""Poses of each kind in the picture: more of them hide each other."""
BIAS_POSES = 1000
"""Draws of the prior of which it is asked whether they were visited."""
ANGLES = (10.0, 20.0, 30.0)
"""Degrees within which a pose counts as visited."""
LIMB_ENDS = {
    "head": ("head",),
    "right arm": ("right_upper_arm", "right_forearm"),
    "left arm": ("left_upper_arm", "left_forearm"),
    "right leg": ("right_upper_leg", "right_lower_leg"),
    "left leg": ("left_upper_leg", "left_lower_leg"),
    "both arms": ("right_upper_arm", "right_forearm", "left_upper_arm", "left_forearm"),
    "whole body": BONE_NAMES,
}


class ActionBias(NamedTuple):
    """An action: how many poses, how likely they are under the mixture and under the uniform prior
    (nats a pose above the mean over actions), and the share of them that the prior holds
    possible."""

    action: str
    poses: int
    mixture: Interval
    uniform: Interval
    possible: float


class Visits(NamedTuple):
    """Part of the body: the share of the prior within each of `ANGLES` of some pose of the data
    set, and of as many poses of the prior itself, which is as much as so many poses could visit."""

    part: str
    data: tuple[float, ...]
    prior: tuple[float, ...]


class Bias(NamedTuple):
    """The study: `actions`, `visits`, and for the picture `picture` `(n, 2)` with the action of
    each pose, "" for draws of the prior."""

    actions: list[ActionBias]
    visits: list[Visits]
    picture: np.ndarray
    picture_action: np.ndarray
    poses: int
    components: int


def directions(joints: np.ndarray, torso: np.ndarray) -> np.ndarray:
    """`(N, 9, 3)`: unit vectors along the free bones of poses `(N, 15, 3)`, in the axes of `torso`
    `(6, 3)`."""
    placed = aligned(joints, torso)
    ends, starts = ([getattr(bone, side) for bone in BONES] for side in ("end", "start"))
    bones = placed[:, ends] - placed[:, starts]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def bias_study(data: DataSet, anatomy: Anatomy, *, seed: int = 0) -> Bias:
    """The study of a data set, in the proportions in which it is recorded. Raises `BadInput` where
    poses are few."""
    if len(data) < LEAST_POSES:
        raise BadInput(
            f"{data.name} has {len(data)} poses; the bias study needs at least {LEAST_POSES}: leave"
            " it out"
        )
    data = data.take(np.arange(0, len(data), -(-len(data) // MOST_POSES)))
    torso = PoseDictionary.default().torso
    poses = data.corrected(data.poses)
    own = directions(poses, torso)
    model = PoseModel.from_anatomy(anatomy, upper="area", lower="area")
    number = BIAS_POSES + len(data)
    drawn = np.asarray(
        sample_prior(model, key=jax.random.key(seed), num_samples=number)["prior"].joints
    )[0]
    prior = directions(drawn, torso)
    components = max(2, min(COMPONENTS, len(data) // 100))
    mixture = held_out_likelihood(own.reshape(len(own), -1), data, components, seed)
    picture, action = _picture(own, prior, data.action, seed)
    actions = _actions(data, mixture, log_prior(model, poses))
    found = visits(own, prior[:BIAS_POSES], prior[BIAS_POSES:])
    return Bias(actions, found, picture, action, len(data), components)


def _actions(data: DataSet, mixture: np.ndarray, uniform: np.ndarray) -> list[ActionBias]:
    possible = np.isfinite(uniform)
    rows = {action: data.action == action for action in data.actions}
    mean_mixture = np.mean([mixture[own].mean() for own in rows.values()])
    mean_uniform = np.mean(
        [uniform[own & possible].mean() for own in rows.values() if (own & possible).any()] or [0.0]
    )
    return [
        ActionBias(
            action,
            int(own.sum()),
            clustered(mixture[own] - mean_mixture, data.recording[own]),
            clustered((uniform - mean_uniform)[own & possible], data.recording[own & possible]),
            float(possible[own].mean()),
        )
        for action, own in rows.items()
    ]


def held_out_likelihood(
    features: np.ndarray, data: DataSet, components: int, seed: int
) -> np.ndarray:
    """`(N,)`: log likelihood of each pose under a Gaussian mixture fitted to the other half:
    recordings by turns, or where an action has one recording, its first and second half."""
    from sklearn.mixture import GaussianMixture

    half = _halves(data)
    found = np.empty(len(features))
    for side in (0, 1):
        mixture = GaussianMixture(
            components, reg_covar=1e-3, random_state=seed, max_iter=200, init_params="k-means++"
        )
        found[half == side] = mixture.fit(features[half != side]).score_samples(
            features[half == side]
        )
    return found


def _halves(data: DataSet) -> np.ndarray:
    half = np.empty(len(data), int)
    for action in data.actions:
        rows = np.flatnonzero(data.action == action)
        names, owner = np.unique(data.recording[rows], return_inverse=True)
        half[rows] = owner % 2 if len(names) > 1 else np.arange(len(rows)) * 2 // len(rows)
    return half


def log_prior(model: PoseModel, joints: np.ndarray) -> np.ndarray:
    """`(N,)`: log density of the bones' directions under the uniform prior, but for a constant;
    -inf where a pose is impossible."""
    reference = np.asarray(model.limits.reference)
    fallback = np.asarray(model.limits.fallback)
    low = np.asarray(model.lengths.low)
    high = np.asarray(model.lengths.high)

    def one(poses: jax.Array) -> jax.Array:
        local = articulation(poses, reference, fallback)
        length = jax.numpy.broadcast_to((low + high) / 2, (len(poses), len(low)))
        return model.log_prior(length, local.upper, local.lower)

    return np.asarray(in_chunks(jax.jit(one), joints))


def visits(own: np.ndarray, judged: np.ndarray, rivals: np.ndarray) -> list[Visits]:
    """How much of the prior the poses `own` `(N, 9, 3)` visit, limb by limb and whole: the share of
    its draws `judged` of which all bones of the part point within an angle of where some one pose's
    do; and what `rivals`, draws of the prior, visit."""

    def shares(nearest: np.ndarray) -> tuple[float, ...]:
        return tuple(float(np.mean(nearest >= np.cos(np.radians(angle)))) for angle in ANGLES)

    data = _nearest(judged, own)
    prior = _nearest(judged, rivals)
    return [Visits(part, shares(data[part]), shares(prior[part])) for part in LIMB_ENDS]


def _nearest(judged: np.ndarray, many: np.ndarray) -> dict[str, np.ndarray]:
    """By part, `(M,)`: of each the cosine of the least angle within which all bones of one of the
    `many` poses lie."""
    found = {part: np.full(len(judged), -1.0) for part in LIMB_ENDS}
    for start in range(0, len(many), 1000):
        block = many[start : start + 1000]
        cosines = {name: judged[:, bone] @ block[:, bone].T for bone, name in enumerate(BONE_NAMES)}
        for part, names in LIMB_ENDS.items():
            worst = np.minimum.reduce([cosines[name] for name in names])
            found[part] = np.maximum(found[part], worst.max(axis=1))
    return found


def _picture(
    own: np.ndarray, prior: np.ndarray, action: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """t-SNE of some poses and as many draws of the prior."""
    from sklearn.manifold import TSNE

    rng = np.random.default_rng(seed)
    number = min(PICTURED, len(own), len(prior))
    rows = rng.permutation(len(own))[:number]
    both = np.concatenate([own[rows], prior[:number]]).reshape(2 * number, -1)
    placed = TSNE(perplexity=30, init="pca", random_state=seed).fit_transform(both)
    return placed, np.concatenate([action[rows], np.full(number, "", dtype=action.dtype)])
