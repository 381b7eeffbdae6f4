"""What is ranked: numbers of a pose, and numbers of a pose together with what was seen of it.

Numbers of the pose alone cannot tell a posterior that ignores what was seen from a right one: the
prior passes them (Modrák et al. 2023). Log density, misfit, energy ball and TARP can."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.studies.flips import FLIPPING, away
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.model import PoseModel, log_joint
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import BONES, JOINTS, LENGTH_GROUPS, LOWER_BONES

MOVING = tuple(bone.end for bone in BONES)
"""The nine joints that move when the torso is given."""
MOVING_NAMES = tuple(JOINTS[joint] for joint in MOVING)
OF_POSE = (
    *(f"{name} {axis}" for name in MOVING_NAMES for axis in "xyz"),
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"{bone.name} points away" for bone in FLIPPING),
)
LOG_DENSITY, MISFIT, ENERGY_BALL, TARP = "log density", "misfit", "energy ball", "TARP"
CLASSIFIER = "classifier"
"""What a classifier says of truth and draws: of anybody's posterior, which knows no pose."""
HINGES = tuple(f"{bone.name} from its plane" for bone in LOWER_BONES)
"""How far a lower bone points away from its hinge's plane, a sine: where the measures of lower
bones differ most."""
OF_MODEL = (*HINGES, LOG_DENSITY, MISFIT)
"""Known where the model is; `TARP` where there was a reference."""
OF_BOTH = (*OF_MODEL, ENERGY_BALL, TARP)
OF_ROOT = (
    "log scale",
    *(f"pelvis {axis} in the image" for axis in "xy"),
    *(f"{name} {axis}" for name in ("back", "chest") for axis in "xyz"),
)
"""Known where the root is uncertain: how large and where the person is seen, and the ways back and
chest point."""
QUANTITIES = (*OF_POSE, *OF_BOTH, *OF_ROOT)
RANKED_TOGETHER = 512


def of_pose(joints: np.ndarray) -> np.ndarray:
    """`(n, 40)`: coordinates, bone lengths (left and right averaged) and depth flips of poses `(n,
    15, 3)`, camera axes, in the order of `OF_POSE`."""
    ends = joints[:, MOVING].reshape(len(joints), -1)
    return np.concatenate([ends, lengths(joints), away(joints)], axis=1)


def lengths(joints: np.ndarray) -> np.ndarray:
    """`(n, 5)`: the lengths of the groups, left and right averaged, of poses `(n, 15, 3)`."""
    found = np.linalg.norm(joints[:, MOVING] - joints[:, [bone.start for bone in BONES]], axis=-1)
    group = np.array([bone.length_group for bone in BONES])
    return np.stack(
        [found[:, group == number].mean(axis=1) for number in range(len(LENGTH_GROUPS))], axis=1
    )


def of_both(model: PoseModel, observation: Observation, joints: np.ndarray) -> np.ndarray:
    """`(n, 6)`: of poses `(n, 15, 3)` in camera axes and body units, in the order of `OF_MODEL`:
    sines of the lower bones from their planes, log joint density (-inf outside), and the largest
    distance of a seen joint from its detection, in radii τ."""
    rows = in_chunks(
        functools.partial(_of_both, model, observation),
        joints,
        lengths(joints),
        size=RANKED_TOGETHER,
    )
    return np.concatenate([rows[0], np.stack(rows[1:], axis=1)], axis=1)


@jax.jit
def _of_both(
    model: PoseModel, observation: Observation, joints: jax.Array, length: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    poses = model.pose_of(joints, length)
    return _sines(model, poses), log_joint(model, observation, *poses), observation.misfit(joints)


def _sines(model: PoseModel, poses: Pose) -> jax.Array:
    """`(n, 4)`: of lower bones from their planes."""
    return -jnp.sum(model.hinges_at(poses.upper).triple[..., 0, :] * poses.lower, axis=-1)


def of_rooted(posterior: Posterior, points: RootPoint, joints: np.ndarray) -> np.ndarray:
    """`(n, 6)`: as `of_both`, of poses `(n, 15, 3)` each with its own root `(n, ...)`: the log
    joint density is that of root and pose, without any fault of the detector."""
    look = functools.partial(_of_rooted, posterior.model, posterior.detected)
    leaves = jax.tree.leaves(points)
    rows = in_chunks(look, *leaves, joints, lengths(joints), size=RANKED_TOGETHER)
    return np.concatenate([rows[0], np.stack(rows[1:], axis=1)], axis=1)


@jax.jit
def _of_rooted(
    model: PoseModel, detected: DetectedJoints, *fields: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    prior = TorsoCameraPrior.of(model)

    def one(
        point: RootPoint, joints: jax.Array, length: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        observation = detected.under(prior, point, Faults.none())
        poses = model.pose_of(joints[None], length[None])
        pose = jax.tree.map(lambda part: part[0], poses)
        density = prior.log_density(point) + log_joint(model, observation, *pose)
        return _sines(model, poses)[0], density, observation.misfit(joints)

    return jax.vmap(one)(RootPoint(*fields[:-2]), *fields[-2:])


def of_root(points: RootPoint) -> np.ndarray:
    """`(n, 9)`: numbers of roots `(n, ...)`, in the order of `OF_ROOT`."""
    ways = np.swapaxes(np.asarray(points.rotation)[:, :, 1:], 1, 2).reshape(-1, 6)
    scale = np.asarray(points.log_scale)[:, None]
    return np.concatenate([scale, np.asarray(points.translation), ways], axis=1)
