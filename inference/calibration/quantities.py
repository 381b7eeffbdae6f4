"""What is ranked: numbers of a pose, and numbers of a pose together with what was seen of it.

Numbers of the pose alone cannot tell a posterior that ignores what was seen from a right one: the prior passes them
(Modrák et al. 2023). Log density, misfit, energy ball and TARP can.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from inference.flips import FLIPPING, away
from inference.target import read_poses
from probmodel.chunks import in_chunks
from probmodel.model import PoseModel, log_joint
from probmodel.observation import Observation
from probmodel.skeleton import BONES, JOINTS, LENGTH_GROUPS

MOVING = tuple(bone.end for bone in BONES)
"""The nine joints that move when the torso is given."""
MOVING_NAMES = tuple(JOINTS[joint] for joint in MOVING)
OF_POSE = (
    *(f"{name} {axis}" for name in MOVING_NAMES for axis in "xyz"),
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"{bone.name} points away" for bone in FLIPPING),
)
LOG_DENSITY, MISFIT, ENERGY_BALL, TARP = OF_BOTH = ("log density", "misfit", "energy ball", "TARP")
"""`TARP` is missing where there was no reference."""
QUANTITIES = (*OF_POSE, *OF_BOTH)
CHUNK = 512


def of_pose(joints: np.ndarray) -> np.ndarray:
    """`(n, 40)`: coordinates, bone lengths (left and right averaged) and depth flips of poses `(n, 15, 3)`, camera
    axes, in the order of `OF_POSE`."""
    ends = joints[:, MOVING].reshape(len(joints), -1)
    return np.concatenate([ends, lengths(joints), away(joints)], axis=1)


def lengths(joints: np.ndarray) -> np.ndarray:
    """`(n, 5)`: the lengths of the groups, left and right averaged, of poses `(n, 15, 3)`."""
    found = np.linalg.norm(joints[:, MOVING] - joints[:, [bone.start for bone in BONES]], axis=-1)
    group = np.array([bone.length_group for bone in BONES])
    return np.stack([found[:, group == number].mean(axis=1) for number in range(len(LENGTH_GROUPS))], axis=1)


def of_both(model: PoseModel, observation: Observation, joints: np.ndarray) -> np.ndarray:
    """`(n, 2)`: log joint density (-inf outside) of poses `(n, 15, 3)` in camera axes and body units, and the largest
    distance of a seen joint from its detection, in radii τ."""
    rows = in_chunks(functools.partial(_of_both, model, observation), joints, lengths(joints), size=CHUNK)
    return np.stack(rows, axis=1)


@jax.jit
def _of_both(model: PoseModel, observation: Observation, joints: jax.Array,
             length: jax.Array) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    seen = observation.has_factor
    offset = observation.camera.image(joints) - jnp.where(seen[:, None], jnp.asarray(observation.keypoints), 0.0)[None]
    far = jnp.linalg.norm(offset, axis=-1) / jnp.where(seen, jnp.asarray(observation.radius), jnp.inf)[None]
    return log_joint(model, observation, *read_poses(model, joints, length)), far.max(axis=1)
