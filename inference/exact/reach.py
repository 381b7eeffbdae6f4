"""Why a detection has no explanation: which joint is out of reach, and by how much.

Bounds, not estimates: a joint reported here as out of reach is so for every pose that
the limits and lengths allow."""

from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.exact.loops.strata import grid
from poseterior.inference.exact.loops.tables import LimbProblem
from poseterior.probmodel.directions.cells import cell_centres
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.skeleton import GROUPS, JOINTS, Limb

TRIALS = 1 << 15
"""Draws of the prior among which the nearest miss is looked for."""


class OutOfReach(NamedTuple):
    """A detected joint that no possible pose brings within its reach: `excess` is the
    missing distance, body units."""

    joint: str
    limb: str
    excess: float

    def sentence(self, scale: float) -> str:
        """What a user can act on; `scale` in pixels per body unit."""
        return (
            f"{self.joint} was detected {self.excess * scale:.0f} px ({self.excess:.2f} limb"
            f" lengths) farther than any possible {self.limb} reaches, its radius included; mend or"
            " drop that detection, raise its radius, or try another person"
        )


def out_of_reach(
    model: PoseModel, problems: dict[str, tuple[LimbProblem, ...]]
) -> list[OutOfReach]:
    """The seen joints that are out of reach under one root, given the problem of every
    limb, for every occupied direction and every length in range."""
    found = []
    for name, limbs in GROUPS.items():
        for limb, problem in zip(limbs, problems[name], strict=True):
            for row, bone in enumerate(limb.bones):
                excess = _excess(model, limb, row, problem)
                if excess > 0:
                    found.append(OutOfReach(JOINTS[bone.end], limb.name, excess))
    return found


def _excess(model: PoseModel, limb: Limb, row: int, problem: LimbProblem) -> float:
    """At least how far the limb's joint `row` stays from its disc, body units; negative
    where it may reach it."""
    axes, target, reach = problem
    low, high = (
        np.asarray(ends)[[bone.length_group for bone in limb.bones]]
        for ends in (model.lengths.low, model.lengths.high)
    )
    end = -np.asarray(cell_centres()) @ axes[:2].T
    square = np.sum(end**2, axis=-1)
    along = np.clip(end @ target[row] / np.where(square > 0, square, 1.0), low[0], high[0])
    distance = np.linalg.norm(target[row] - along[..., None] * end, axis=-1)
    chord = grid(1).elevation["chord"]
    missing = distance - high[0] * chord - (high[1] if row else 0.0)
    occupied = np.asarray(model.cells.occupied)[limb.upper]
    return float(np.min(np.where(occupied, missing, np.inf)) - reach[row])


class Miss(NamedTuple):
    """The nearest that draws of the prior came to explaining a group: `excess` is how
    far `joint` still was beyond its reach, body units (negative: some draws do explain
    the group)."""

    joint: str
    excess: float

    def sentence(self, scale: float) -> str:
        """In words; `scale` in pixels per body unit."""
        if self.excess <= 0:
            return "poses that explain them exist, but they are rare"
        return (
            f"in the nearest of {TRIALS} possible poses {self.joint} misses its disc by"
            f" {self.excess * scale:.0f} px"
        )


def nearest_miss(model: PoseModel, observation: Observation, name: str) -> Miss:
    """How near draws of the prior come to explaining a group that rejection could not
    fill."""
    ends = [bone.end for limb in GROUPS[name] for bone in limb.bones]
    beyond = np.asarray(_beyond(model, observation))[:, ends]
    worst = beyond.max(axis=1)
    nearest = int(np.argmin(worst))
    return Miss(JOINTS[ends[int(np.argmax(beyond[nearest]))]], float(worst[nearest]))


@jax.jit
def _beyond(model: PoseModel, observation: Observation) -> jax.Array:
    """`(TRIALS, 15)`: how far joints of draws of the prior lie beyond their reaches,
    body units."""
    joints = model.joints(observation.view, *model.draw(jax.random.key(0), TRIALS))
    return observation.distances(joints) - observation.law.reach * observation.spread[None]
