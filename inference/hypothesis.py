"""Diverse hypotheses from many poses (§ 4 of the paper): k-means++, then for each centroid the
nearest actual pose.

Poses come from exact draws (`hypotheses(result)`), or from the paper's deterministic grid
(`grid_poses`). A centroid itself may be impossible, an actual pose never is."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.clusters import clusters
from poseterior.inference.machines import calm_blas
from poseterior.inference.results import Result
from poseterior.probmodel.anatomy.limits import cell_of
from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.kinematics import direction
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.skeleton import GROUPS, JOINTS, Limb

NUM_ANGLES = 15
"""Azimuths, and polar angles, of the grid for upper bones (Stage I of the paper)."""
OFF_BORDER = 1e-8
"""Radians by which the grid is moved."""
NUM_BOX = 5
"""Points a side of the box for lower bones."""


class Hypothesis(NamedTuple):
    """One of k answers.

    Attributes
    ----------
    joints : `(15, 3)`
        Camera axes, body units.
    weight
        The share of poses in its cluster.
    draw
        The number of the draw it is; of a composed one, of the draw nearest to it.
    keypoints : `(15, 2)`
        Where a composed one falls in the image, pixels; None where it is a draw, which has its own.
    """

    joints: np.ndarray
    weight: float
    draw: int
    keypoints: np.ndarray | None = None

    def as_json(self) -> dict:
        """The form it has in hypotheses.json."""
        found = {"joints": _named(self.joints, 6), "weight": self.weight, "draw": self.draw}
        return found if self.keypoints is None else found | {"keypoints": _named(self.keypoints, 3)}


def _named(points: np.ndarray, digits: int) -> dict[str, list[float]]:
    return {
        name: [round(float(value), digits) for value in point]
        for name, point in zip(JOINTS, points, strict=True)
    }


def require_k(k: int, number: int) -> None:
    """Raises `BadInput` where k hypotheses cannot be chosen among so many poses."""
    if not 1 <= k <= number:
        raise BadInput(
            f"{k} hypotheses cannot be chosen among {number} poses; choose k from 1 to {number}"
        )


def hypotheses(result: Result, k: int = 5, *, seed: int = 0) -> list[Hypothesis]:
    """Diverse poses among a result's draws.

    Parameters
    ----------
    result
        What `sample` returned.
    k
        How many.
    seed
        Of k-means++.

    Returns
    -------
    list of Hypothesis
        Heaviest cluster first; fewer than `k` where there are fewer distinct draws.

    Raises
    ------
    BadInput
        Where k is not from 1 to the number of draws.
    """
    joints = np.asarray(result.tree["posterior"]["joints"])
    return diverse(joints.reshape(-1, *joints.shape[-2:]), k, seed=seed)


def diverse(joints: np.ndarray, k: int, *, seed: int = 0) -> list[Hypothesis]:
    """Diverse ones of some poses: by k-means++ over all joint coordinates, the pose nearest to each
    centre.

    Parameters
    ----------
    joints : `(n, 15, 3)`
        The poses, in any axes and unit.
    k
        How many.
    seed
        Of k-means++.

    Returns
    -------
    list of Hypothesis
        Heaviest cluster first; fewer than `k` where there are fewer distinct poses.

    Raises
    ------
    BadInput
        Where k is not from 1 to n.
    """
    require_k(k, len(joints))
    flat = np.asarray(joints, float).reshape(len(joints), -1)
    with calm_blas():
        fit = clusters(flat, k, seed)
    found = []
    for cluster, centre in enumerate(fit.centres):
        members = np.flatnonzero(fit.labels == cluster)
        if len(members):  # fewer distinct poses than k leave clusters empty
            offset = flat[members] - centre
            nearest = members[np.argmin(np.einsum("nd,nd->n", offset, offset))]
            found.append(Hypothesis(joints[nearest], len(members) / len(joints), int(nearest)))
    return sorted(found, key=lambda hypothesis: -hypothesis.weight)


def grid_poses(
    model: PoseModel, observation: Observation, *, most: int = 10_000, seed: int = 0
) -> np.ndarray:
    """Stage I of the paper: poses from the grid of directions, at the mean bone lengths, that the
    limits allow and that explain the observation.

    Limbs are filtered one by one and combine freely, since their lengths are fixed here.

    Parameters
    ----------
    model
        The prior of poses.
    observation
        The detection under one candidate.
    most
        Where the product of what is left of each limb is larger, so many random ones of it.
    seed
        Of that choice.

    Returns
    -------
    ndarray
        `(n, 15, 3)`, camera axes, body units; empty where nothing is left of a limb.
    """
    from poseterior.probmodel.anatomy.lengths import (
        BoneLength,
    )  # imports NumPyro, which few hypotheses need

    alpha, beta = np.asarray(model.lengths.alpha), np.asarray(model.lengths.beta)
    length = np.asarray(BoneLength(model.lengths).at(alpha / (alpha + beta)))
    limbs = [limb for members in GROUPS.values() for limb in members]
    choices = [_limb_grid(model, observation, limb, length) for limb in limbs]
    sizes = [len(choice.length) for choice in choices]
    if not all(sizes):
        return np.empty((0, len(JOINTS), 3))
    picks = _combinations(sizes, most, seed)
    poses = Pose.blank(len(picks))
    for column, (limb, choice) in enumerate(zip(limbs, choices, strict=True)):
        GroupDraws(*(part[picks[:, column]] for part in choice)).fill(poses, (limb,))
    return np.asarray(model.joints(np.asarray(observation.view), *poses))


def _combinations(sizes: list[int], most: int, seed: int) -> np.ndarray:
    total = float(np.prod([float(size) for size in sizes]))
    if total <= most:
        return np.array(list(itertools.product(*map(range, sizes))))
    rng = np.random.default_rng(seed)
    return np.stack([rng.integers(0, size, most) for size in sizes], axis=1)


def _limb_grid(
    model: PoseModel, observation: Observation, limb: Limb, length: np.ndarray
) -> GroupDraws:
    """The directions of one limb's bones on the grid that are possible and explain its
    detections."""
    upper = _upper_grid(jax.tree.map(lambda leaf: leaf[limb.upper], model.cells))
    lower = upper
    if limb.lower is not None:
        below = jax.tree.map(lambda leaf: leaf[limb.lower], model.hinges)
        upper, lower = _lower_grid(below, upper)
    sizes = length[[bone.length_group for bone in limb.bones]]
    sizes = np.broadcast_to(sizes, (len(upper), len(sizes)))
    draws = GroupDraws(sizes, upper[:, None], lower[:, None])
    poses = Pose.blank(len(upper))
    draws.fill(poses, (limb,))
    within = np.asarray(observation.within(model.joints(np.asarray(observation.view), *poses)))
    kept = within[:, [bone.end for bone in limb.bones]].all(axis=1)
    return GroupDraws(*(part[kept] for part in draws))


def _upper_grid(cells: Cells) -> np.ndarray:
    steps = (np.arange(NUM_ANGLES) + 0.5) / NUM_ANGLES
    azimuth, polar = np.meshgrid((2 * steps - 1) * np.pi, steps * np.pi, indexing="ij")
    # The grid's angles are borders of the tables' cells; off them, rounding decides nothing.
    azimuth, polar = azimuth + OFF_BORDER, polar + OFF_BORDER
    vectors = np.asarray(direction(azimuth, np.pi / 2 - polar)).reshape(-1, 3)
    return vectors[np.asarray(jax.vmap(cells.contains)(jnp.asarray(vectors)))]


def _lower_grid(below: Hinge, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every upper direction with the grid of its own box, in front of and behind the plane, where
    possible."""
    column, line = (np.asarray(index) for index in cell_of(upper))
    hinges = jax.tree.map(lambda leaf: np.asarray(leaf)[column, line], below)
    steps = (np.arange(NUM_BOX) + 0.5) / NUM_BOX
    low, high = hinges.bounds[:, 0::2, None], hinges.bounds[:, 1::2, None]
    u2, u3 = np.moveaxis(low + steps * (high - low), 1, 0)
    u2, u3 = np.broadcast_arrays(u2[:, :, None], u3[:, None, :])
    square = 1 - u2**2 - u3**2
    u1 = np.sqrt(np.maximum(square, 0.0))
    both = np.stack([np.stack([-u1, u2, u3], axis=-1), np.stack([u1, u2, u3], axis=-1)], axis=1)
    lower = np.einsum("nsabi,nij->nsabj", both, hinges.triple).reshape(len(upper), -1, 3)
    valid = np.asarray(
        jax.vmap(lambda hinge, many: jax.vmap(hinge.contains)(many))(hinges, jnp.asarray(lower))
    )
    # Outside the unit disc there is no direction; the paper clamps there, which leaves the law
    # without a density.
    valid = valid & np.broadcast_to((square > 0)[:, None], both.shape[:-1]).reshape(len(upper), -1)
    which, point = np.nonzero(valid)
    return upper[which], lower[which, point]
