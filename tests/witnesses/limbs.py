"""The problem of one group of limbs, in body units: where its joints may be, given torso and
camera.

Exact rejection treats head, arms and legs apart (given torso and camera they are independent). Each
proposal makes draws of a group; `explains` is the one accept step behind all of them."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.anatomy.population import LengthPrior
from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.kinematics import lower_axes, upper_axes
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.skeleton import GROUPS, TORSO_INDEX


class Draws(NamedTuple):
    """Draws of a group: `length` `(n, bones)` shared by its limbs, `upper` `(n, limbs, 3)`, `lower`
    `(n, limbs, 3)` local directions (of no account in a group whose limbs have one bone)."""

    length: jax.Array | np.ndarray
    upper: jax.Array | np.ndarray
    lower: jax.Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Group:
    """A group of limbs in front of a camera. Leaves start with the number of limbs, `lengths` with
    that of bones.

    `frame` `(limbs, 3, 3)`: local frames in camera axes. `target` `(limbs, bones, 2)`: detected
    joints minus the limb's start, in the image, body units. `radius` `(limbs, bones)`: body units,
    infinite where nothing was seen."""

    frame: jax.Array
    target: jax.Array
    radius: jax.Array
    cells: Cells
    hinges: Hinge
    lengths: LengthPrior
    reference: jax.Array
    fallback: jax.Array

    @property
    def num_limbs(self) -> int:
        return self.target.shape[0]

    @property
    def num_bones(self) -> int:
        return self.target.shape[1]

    def limb(self, row: int) -> "Group":
        """The group that consists of one of the limbs, with lengths of its own."""
        names = ("frame", "target", "radius", "cells", "hinges", "fallback")
        parts = {
            name: jax.tree.map(lambda leaf: leaf[row : row + 1], getattr(self, name))
            for name in names
        }
        return dataclasses.replace(self, **parts)

    def reach(self, draws: Draws) -> jax.Array:
        """Image positions `(n, limbs, bones, 2)` of the joints minus the limb's start, body
        units."""
        return jax.vmap(lambda *draw: _reach(self, *draw))(*draws)

    def explains(self, draws: Draws) -> jax.Array:
        """The accept step, `(n,)` bool: whether each seen joint of the group lies within its
        disc."""
        return jax.vmap(lambda *draw: _explains(self, *draw))(*draws)


def _explains(group: Group, length: jax.Array, upper: jax.Array, lower: jax.Array) -> jax.Array:
    offset = _reach(group, length, upper, lower) - group.target
    return jnp.all(jnp.sum(offset**2, axis=-1) <= group.radius**2)


def _reach(group: Group, length: jax.Array, upper: jax.Array, lower: jax.Array) -> jax.Array:
    first = -length[0] * jnp.einsum("lij,lj->li", group.frame[:, :2], upper)
    if group.num_bones == 1:
        return first[:, None]
    local = jax.vmap(lower_axes, (0, None, 0))(upper, group.reference, group.fallback)
    second = first - length[1] * jnp.einsum("lij,ljk,lk->li", group.frame[:, :2], local, lower)
    return jnp.stack([first, second], axis=1)


@jax.jit
def build_groups(model: PoseModel, observation: Observation) -> dict[str, Group]:
    """The problems of `skeleton.GROUPS`, by name. Everything is measured from where each limb
    starts at the torso."""
    torso = observation.view
    frames, seen = upper_axes(torso), observation.seen
    target, radius = (
        jnp.asarray(observation.target),
        observation.law.reach * jnp.asarray(observation.spread),
    )
    image = dict(zip(TORSO_INDEX, observation.root.camera.flatten(torso), strict=True))
    groups = {}
    for name, limbs in GROUPS.items():
        ends = np.array([[bone.end for bone in limb.bones] for limb in limbs])
        start = jnp.stack([image[limb.bones[0].start] for limb in limbs])
        uppers = np.array([limb.upper for limb in limbs])
        lowers = np.array([0 if limb.lower is None else limb.lower for limb in limbs])
        lengths = np.array([bone.length_group for bone in limbs[0].bones])
        offset = target[ends] - start[:, None]
        groups[name] = Group(
            frame=frames[uppers],
            target=jnp.where(seen[ends][..., None], offset, 0.0),
            radius=radius[ends],
            cells=_pick(model.cells, uppers),
            hinges=_pick(model.hinges, lowers),
            lengths=_pick(model.lengths, lengths),
            reference=jnp.asarray(model.limits.reference),
            fallback=jnp.asarray(model.limits.fallback)[lowers],
        )
    return groups


def _pick(tree: Any, index: np.ndarray) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], tree)
