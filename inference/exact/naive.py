"""Exact rejection as the textbook has it: bodies from the prior, kept where they
explain the detection, whole or group by group. Slow; it needs nothing but the program's
own pieces.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.exact.rates import Budget, Rate, RowBuffer
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.skeleton import GROUPS

BATCH = 1 << 15
"""Bodies proposed at a time; one compilation serves every batch of every frame."""


class PriorBodies:
    """Bodies from the prior. Each of `wholes`, a tuple of groups, is accepted as one,
    and all of them independently of each other, since the prior's groups are.

    Parameters
    ----------
    key : of all draws.
    model, observation : what is believed, under one root.
    wholes : the groups that are accepted together, e.g. `(("head",), ("arms",),
        ("legs",))`.
    """

    impossible = given_up = False  # draws from the prior go on to the end of the budget

    def __init__(
        self,
        key: jax.Array,
        model: PoseModel,
        observation: Observation,
        wholes: tuple[tuple[str, ...], ...],
    ) -> None:
        self._key = key
        self._model = model
        self._observation = observation
        self.wholes = wholes
        self._buffers = [RowBuffer() for _ in wholes]
        self._accepted = np.zeros(len(wholes), int)
        self._batches = 0

    @property
    def held(self) -> int:
        return min(buffer.size for buffer in self._buffers)

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number:
            if not budget.spend(BATCH):
                return False
            key = jax.random.fold_in(self._key, self._batches)
            poses, kept = propose(key, self._model, self._observation, self.wholes)
            self._batches += 1
            for index, buffer in enumerate(self._buffers):
                chosen = np.flatnonzero(np.asarray(kept[index]))
                self._accepted[index] += len(chosen)
                if buffer.size < number:  # the others' surplus would only fill the memory
                    buffer.add(*(np.asarray(part)[chosen] for part in poses))
        return True

    def draws(self) -> dict[str, GroupDraws]:
        return {
            name: GroupDraws.of(Pose(*buffer.all()), GROUPS[name])
            for whole, buffer in zip(self.wholes, self._buffers, strict=True)
            for name in whole
        }

    def forget(self, number: int) -> None:
        for buffer in self._buffers:
            buffer.take(number)

    @property
    def slowest(self) -> str:
        return self.wholes[int(np.argmin(self._accepted))][-1]

    @property
    def rates(self) -> list[Rate]:
        return [Rate(self._batches * BATCH, int(accepted)) for accepted in self._accepted]


@functools.partial(jax.jit, static_argnames="wholes")
def propose(
    key: jax.Array,
    model: PoseModel,
    observation: Observation,
    wholes: tuple[tuple[str, ...], ...],
) -> tuple[Pose, list[jax.Array]]:
    """Bodies from the prior, and which of them are kept for each of `wholes`."""
    for_pose, for_test = jax.random.split(key)
    poses = model.draw(for_pose, BATCH)
    log_ratios = observation.log_ratios(model.joints(observation.view, *poses))
    test = jnp.log1p(-jax.random.uniform(for_test, (len(wholes), BATCH)))
    kept = []
    for row, whole in enumerate(wholes):
        ends = jnp.array(
            [bone.end for name in whole for limb in GROUPS[name] for bone in limb.bones]
        )
        kept.append(test[row] <= jnp.sum(log_ratios[:, ends], axis=1))
    return poses, kept
