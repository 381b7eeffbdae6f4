"""The problem of one group of limbs, in body units: where its joints may be, given torso and camera.

Exact rejection treats head, arms and legs apart (given torso and camera they are independent). Each proposal makes
draws of a group; `explains` is the one accept step behind all of them.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from probmodel.cells import Cells
from probmodel.frames import lower_frame, upper_frames
from probmodel.hinges import Hinge
from probmodel.lengths import LengthPrior
from probmodel.model import PoseModel
from probmodel.observation import Observation
from probmodel.skeleton import GROUPS, TORSO_INDEX


class Draws(NamedTuple):
    """Draws of a group: `length` `(n, bones)` shared by its limbs, `upper` `(n, limbs, 3)`, `lower` `(n, limbs, 3)`
    local directions (of no account in a group whose limbs have one bone)."""

    length: jax.Array
    upper: jax.Array
    lower: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Group:
    """A group of limbs in front of a camera. Leaves start with the number of limbs, `lengths` with that of bones.

    `frame` `(limbs, 3, 3)`: local frames in camera axes. `target` `(limbs, bones, 2)`: detected joints minus the
    limb's start, in the image, body units. `radius` `(limbs, bones)`: body units, infinite where nothing was seen.
    """

    frame: jax.Array
    target: jax.Array
    radius: jax.Array
    cells: Cells
    hinges: Hinge
    lengths: LengthPrior
    reference: jax.Array
    fallback: jax.Array
    name: str = dataclasses.field(metadata={"static": True})

    @property
    def num_limbs(self) -> int:
        return self.target.shape[0]

    @property
    def num_bones(self) -> int:
        return self.target.shape[1]

    def limb(self, index: int) -> "Group":
        """The group that consists of one of the limbs."""
        parts = {
            field: jax.tree.map(lambda leaf: leaf[index : index + 1], getattr(self, field))
            for field in ("frame", "target", "radius", "cells", "hinges", "fallback")
        }
        return dataclasses.replace(self, **parts)

    def reach(self, draws: Draws) -> jax.Array:
        """Image positions `(n, limbs, bones, 2)` of the joints minus the limb's start, body units."""
        return jax.vmap(lambda *draw: _reach(self, *draw))(*draws)

    def explains(self, draws: Draws) -> jax.Array:
        """The accept step, `(n,)` bool: whether each seen joint of the group lies within its disc."""
        offset = self.reach(draws) - self.target
        return jnp.all(jnp.sum(offset**2, axis=-1) <= self.radius**2, axis=(-2, -1))


def _reach(group: Group, length: jax.Array, upper: jax.Array, lower: jax.Array) -> jax.Array:
    first = -length[0] * jnp.einsum("lij,lj->li", group.frame[:, :2], upper)
    if group.num_bones == 1:
        return first[:, None]
    local = jax.vmap(lower_frame, (0, None, 0))(upper, group.reference, group.fallback)
    second = first - length[1] * jnp.einsum("lij,ljk,lk->li", group.frame[:, :2], local, lower)
    return jnp.stack([first, second], axis=1)


def build_group(model: PoseModel, observation: Observation, name: str) -> Group:
    """The problem of one of `skeleton.GROUPS`. Everything is measured from where each limb starts at the torso."""
    limbs = GROUPS[name]
    scale = float(np.asarray(observation.camera.scale))
    keypoints, seen = np.asarray(observation.keypoints), np.asarray(observation.has_factor)
    ends = np.array([[bone.end for bone in limb.bones] for limb in limbs])
    starts = np.array([limb.bones[0].start for limb in limbs])
    torso = np.asarray(observation.view)
    image = np.full((len(seen), 2), np.nan)
    image[list(TORSO_INDEX)] = np.asarray(observation.camera.image(torso))
    target = np.where(seen[ends][..., None], (keypoints[ends] - image[starts][:, None]) / scale, 0.0)
    radius = np.where(seen[ends], np.asarray(observation.radius)[ends] / scale, np.inf)
    uppers = np.array([limb.upper for limb in limbs])
    lowers = np.array([0 if limb.lower is None else limb.lower for limb in limbs])
    lengths = np.array([bone.length_group for bone in limbs[0].bones])
    return Group(
        frame=upper_frames(torso)[uppers],
        target=jnp.asarray(target),
        radius=jnp.asarray(radius),
        cells=jax.tree.map(lambda leaf: leaf[uppers], model.cells),
        hinges=jax.tree.map(lambda leaf: leaf[lowers], model.hinges),
        lengths=LengthPrior(*(jnp.asarray(field)[lengths] for field in model.lengths)),
        reference=jnp.asarray(model.limits.reference),
        fallback=jnp.asarray(model.limits.fallback)[lowers],
        name=name,
    )
