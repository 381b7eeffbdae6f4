"""Why a detection has no explanation: which joint is out of reach, and by how much.

Bounds, not estimates: a joint reported here as out of reach is so for every pose that the limits
and lengths allow."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from inference.exact.naive import group_prior
from inference.exact.patches import cell_sizes, to_segment
from inference.exact.problem import Group
from probmodel.directions.cells import cell_centres
from probmodel.skeleton import GROUPS, JOINTS

TRIALS = 1 << 15
"""Draws of the prior among which the nearest miss is looked for."""


class OutOfReach(NamedTuple):
    """A detected joint that no possible pose brings into its disc: `excess` is the missing
    distance, body units."""

    joint: str
    limb: str
    excess: float

    def sentence(self, scale: float) -> str:
        """What a user can act on; `scale` in pixels per body unit."""
        return (
            f"{self.joint} was detected {self.excess * scale:.0f} px ({self.excess:.2f} limb"
            f" lengths) farther than any possible {self.limb} reaches, its radius included; mend or"
            " drop that detection, raise its radius, or try another --person"
        )


def out_of_reach(name: str, group: Group) -> list[OutOfReach]:
    """The seen joints of a group that are out of reach for every occupied direction and every
    length in range."""
    excess = np.asarray(_excess(group))
    return [
        OutOfReach(JOINTS[bone.end], limb.name, float(excess[row, column]))
        for row, limb in enumerate(GROUPS[name])
        for column, bone in enumerate(limb.bones)
        if excess[row, column] > 0
    ]


@jax.jit
def _excess(group: Group) -> jax.Array:
    """`(limbs, bones)`: at least how far each joint stays from its disc, body units; negative where
    it may reach it."""
    low, high, size = jnp.asarray(group.lengths.low), jnp.asarray(group.lengths.high), cell_sizes()

    def one(
        frame: jax.Array, target: jax.Array, radius: jax.Array, occupied: jax.Array, column: int
    ) -> jax.Array:
        end = -jnp.einsum("ij,abj->abi", frame[:2], cell_centres())
        distance = to_segment(target[column], end, low[0], high[0])
        missing = distance - high[0] * size - (high[1] if column else 0.0)
        return jnp.min(jnp.where(occupied, missing, jnp.inf)) - radius[column]

    each = jax.vmap(one, in_axes=(0, 0, 0, 0, None))
    columns = [
        each(group.frame, group.target, group.radius, group.cells.occupied, column)
        for column in range(group.num_bones)
    ]
    return jnp.stack(columns, axis=-1)


class Miss(NamedTuple):
    """The nearest that draws of the prior came to explaining a group: `excess` is how far `joint`
    still was from its disc, body units (negative: some draws do explain the group)."""

    joint: str
    excess: float

    def sentence(self, scale: float) -> str:
        """In words; `scale` in pixels per body unit."""
        if self.excess <= 0:
            return "possible poses there are, but few"
        return (
            f"in the nearest of {TRIALS} possible poses {self.joint} misses its disc by"
            f" {self.excess * scale:.0f} px"
        )


def nearest_miss(name: str, group: Group) -> Miss:
    """How near draws of the prior come to explaining a group that rejection could not fill."""
    reach = np.asarray(group.reach(group_prior(jax.random.key(0), group, TRIALS)))
    beyond = np.linalg.norm(reach - np.asarray(group.target), axis=-1) - np.asarray(group.radius)
    worst = beyond.reshape(TRIALS, -1).max(axis=1)
    nearest = int(np.argmin(worst))
    limb, bone = np.unravel_index(np.argmax(beyond[nearest]), beyond.shape[1:])
    return Miss(JOINTS[GROUPS[name][limb].bones[bone].end], float(worst[nearest]))
