"""Why a detection has no explanation: which joint is out of reach, and by how much.

Bounds, not estimates: a joint reported here as out of reach is so for every pose that the limits and lengths allow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from inference.samplers.limbs import Group
from inference.samplers.patches import cell_sizes, to_segment
from inference.samplers.rejection import group_prior
from probmodel.cells import cell_centres
from probmodel.skeleton import GROUPS, JOINTS


TRIALS = 1 << 15
"""Draws of the prior among which the nearest miss is looked for."""


class OutOfReach(NamedTuple):
    """A detected joint that no possible pose brings into its disc: `excess` is the missing distance, body units."""

    joint: str
    limb: str
    excess: float

    def sentence(self, scale: float) -> str:
        """What a user can act on; `scale` in pixels per body unit."""
        return (
            f"{self.joint} was detected {self.excess * scale:.0f} px ({self.excess:.2f} limb lengths) farther than any "
            f"possible {self.limb} reaches, its radius included; mend or drop that detection, raise its radius, or try "
            "another --person"
        )


def out_of_reach(group: Group) -> list[OutOfReach]:
    """The seen joints of a group that are out of reach for every occupied direction and every length in range."""
    found = []
    for index, limb in enumerate(GROUPS[group.name]):
        occupied = np.asarray(group.cells.occupied[index])
        end = -jnp.einsum("ij,abj->abi", group.frame[index, :2], cell_centres())
        size = cell_sizes()
        high = group.lengths.high
        for number, bone in enumerate(limb.bones):
            distance = to_segment(group.target[index, number], end, group.lengths.low[0], high[0])
            reach = high[0] * size + (high[1] if number else 0.0) + group.radius[index, number]
            excess = float(np.min(np.where(occupied, np.asarray(distance - reach), np.inf)))
            if excess > 0:
                found.append(OutOfReach(JOINTS[bone.end], limb.name, excess))
    return found


class Miss(NamedTuple):
    """The nearest that draws of the prior came to explaining a group: `excess` is how far `joint` still was from its
    disc, body units (negative: some draws do explain the group)."""

    joint: str
    excess: float

    def sentence(self, scale: float) -> str:
        """In words; `scale` in pixels per body unit."""
        if self.excess <= 0:
            return "possible poses there are, but few"
        return f"in the nearest of {TRIALS} possible poses {self.joint} misses its disc by {self.excess * scale:.0f} px"


def nearest_miss(group: Group) -> Miss:
    """How near draws of the prior come to explaining a group that rejection could not fill."""
    offset = np.linalg.norm(np.asarray(group.reach(group_prior(jax.random.key(0), group, TRIALS)) - group.target), axis=-1)
    beyond = offset - np.asarray(group.radius)
    worst = beyond.reshape(TRIALS, -1).max(axis=1)
    nearest = int(np.argmin(worst))
    limb, bone = np.unravel_index(np.argmax(beyond[nearest]), beyond.shape[1:])
    return Miss(JOINTS[GROUPS[group.name][limb].bones[bone].end], float(worst[nearest]))
