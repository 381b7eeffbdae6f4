"""A second route to the same draws, in JAX: limbs pruned one by one where some lengths explain
them, then put together, their lengths drawn once; and groups of limbs straight from the prior.

It shares neither bounds nor loops with the product's strata. Nothing is redrawn after acceptance,
so every draw is independent and exact.
"""

import functools
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.exact.rates import ZERO_ACCEPTANCE_LIMIT, Budget, Rate, RowBuffer
from poseterior.probmodel.anatomy.lengths import BoneLength
from poseterior.probmodel.anatomy.limits import cell_of
from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import GroupDraws
from tests.witnesses.limbs import Draws, Group, build_groups
from tests.witnesses.patches import Limb, Plan, limbs_of, plan_limb, propose_limb

BATCH = 1 << 15
"""Proposals made at a time; one compilation serves every batch of every frame."""
PAIRS = 1 << 12
"""Limbs put together at a time."""
HOPELESS_PAIRS = 1 << 20
"""The same for limbs put together, whose rate is far higher where their lengths can agree at all:
below 5e-6."""


@dataclass
class LimbStream:
    """Independent draws of one limb for which some lengths in range explain its detections."""

    key: jax.Array
    limb: Limb
    plan: Plan
    batches: int = 0
    accepted: int = 0
    buffer: RowBuffer = field(default_factory=RowBuffer)

    def run(self, budget: Budget) -> bool:
        """One more batch of proposals; False where the budget does not allow it."""
        if not budget.spend(BATCH):
            return False
        upper, lower, kept = propose_limb(
            jax.random.fold_in(self.key, self.batches), self.limb, self.plan, BATCH
        )
        chosen = np.flatnonzero(np.asarray(kept))
        self.batches += 1
        self.accepted += len(chosen)
        self.buffer.add(np.asarray(upper)[chosen], np.asarray(lower)[chosen])
        return True

    @property
    def rate(self) -> Rate:
        return Rate(self.batches * BATCH, self.accepted, float(self.plan.mass))


class PrunedGroup:
    """Limbs pruned one by one, put together, lengths drawn once; see the module."""

    impossible = False

    def __init__(self, key: jax.Array, name: str, group: Group) -> None:
        self.name, self.group = name, group
        self._key = jax.random.fold_in(key, 0)
        self.streams = [
            LimbStream(jax.random.fold_in(key, index + 1), limb, plan_limb(limb))
            for index, limb in enumerate(limbs_of(group))
        ]
        self._buffer, self._gone = RowBuffer(), 0
        self._chunks = self._tried = 0

    @property
    def given_up(self) -> bool:
        empty = any(stream.rate.mass == 0 for stream in self.streams)
        barren = any(
            stream.accepted == 0 and stream.rate.proposed >= ZERO_ACCEPTANCE_LIMIT
            for stream in self.streams
        )
        return empty or barren or (self.held + self._gone == 0 and self._tried >= HOPELESS_PAIRS)

    @property
    def held(self) -> int:
        return self._buffer.size

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number:
            going_on = not self.given_up and min(
                self.streams, key=lambda stream: stream.buffer.size
            ).run(budget)
            # Few are put together as soon as few are wanted, or when nothing more will come.
            enough = min(PAIRS, number - self.held) if going_on else 1
            while (ready := min(stream.buffer.size for stream in self.streams)) >= enough:
                self._put_together(min(ready, PAIRS))
            if not going_on:
                break
        return self.held >= number

    def _put_together(self, number: int) -> None:
        limbs = [stream.buffer.take(number) for stream in self.streams]
        upper, lower = (np.zeros((PAIRS, len(limbs), 3)) for _ in range(2))
        for index, (first, second) in enumerate(limbs):
            upper[:number, index], lower[:number, index] = first, second
        length = _lengths(jax.random.fold_in(self._key, self._chunks), self.group)
        accepted = _explains(self.group, Draws(length, upper, lower))
        chosen = np.flatnonzero(np.asarray(accepted)[:number])
        self._chunks += 1
        self._tried += number
        self._buffer.add(length[chosen], upper[chosen], lower[chosen])

    def draws(self) -> dict[str, GroupDraws]:
        return {self.name: GroupDraws(*self._buffer.all())}

    def forget(self, number: int) -> None:
        self._buffer.take(number)
        self._gone += number

    @property
    def slowest(self) -> str:
        return self.name

    @property
    def rates(self) -> list[Rate]:
        return [
            *(stream.rate for stream in self.streams),
            Rate(self._tried, self.held + self._gone),
        ]


def _lengths(key: jax.Array, group: Group) -> np.ndarray:
    """`(PAIRS, bones)` lengths from the prior. NumPy draws Beta numbers ten times faster than JAX
    on a CPU, and has nothing to compile."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    low, high, alpha, beta = (np.asarray(field) for field in group.lengths)
    return np.clip(low + (high - low) * rng.beta(alpha, beta, (PAIRS, len(low))), low, high)


@jax.jit
def _explains(group: Group, draws: Draws) -> jax.Array:
    return group.explains(draws)


class PriorGroups:
    """Draws of several groups straight from the prior, accepted together: whole bodies, or one
    group alone."""

    def __init__(self, key: jax.Array, groups: dict[str, Group]) -> None:
        self._key, self.groups = key, groups
        self._buffer, self._gone = RowBuffer(), 0
        self._batches = 0

    @property
    def held(self) -> int:
        return self._buffer.size

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number:
            if not budget.spend(BATCH):
                return False
            proposals, accepted = _from_prior(
                jax.random.fold_in(self._key, self._batches), list(self.groups.values())
            )
            chosen = np.flatnonzero(np.asarray(accepted))
            self._batches += 1
            self._buffer.add(*(np.asarray(leaf)[chosen] for leaf in jax.tree.leaves(proposals)))
        return True

    def draws(self) -> dict[str, GroupDraws]:
        leaves = self._buffer.all()
        return {
            name: GroupDraws(*leaves[3 * index : 3 * index + 3])
            for index, name in enumerate(self.groups)
        }

    def forget(self, number: int) -> None:
        self._buffer.take(number)
        self._gone += number

    @property
    def given_up(self) -> bool:
        return False  # draws from the prior go on to the end of the budget

    @property
    def slowest(self) -> str:
        return max(self.groups, key=lambda name: self.groups[name].target.size)

    @property
    def rates(self) -> list[Rate]:
        return [Rate(self._batches * BATCH, self.held + self._gone)]


@jax.jit
def _from_prior(key: jax.Array, groups: list[Group]) -> tuple[list[Draws], jax.Array]:
    proposals = [
        group_prior(jax.random.fold_in(key, index), group, BATCH)
        for index, group in enumerate(groups)
    ]
    accepted = [group.explains(draws) for group, draws in zip(groups, proposals, strict=True)]
    return proposals, jnp.all(jnp.stack(accepted), axis=0)


@functools.partial(jax.jit, static_argnames="num")
def group_prior(key: jax.Array, group: Group, num: int) -> Draws:
    """`num` draws of a group from the prior: lengths, upper directions, lower directions given the
    upper ones."""
    for_length, for_upper, for_lower = jax.random.split(key, 3)
    length = BoneLength(group.lengths).sample(for_length, (num,))
    upper = OccupiedDirection(group.cells).sample(for_upper, (num,))
    if group.num_bones == 1:
        return Draws(length, upper, upper)
    column, row = cell_of(upper)
    hinges = jax.tree.map(lambda leaf: leaf[jnp.arange(group.num_limbs), column, row], group.hinges)
    return Draws(length, upper, HingedDirection(hinges).sample(for_lower))


def pruned(key: jax.Array, model: PoseModel, observation: Observation) -> list[PrunedGroup]:
    """The witness as a row of `inference.exact.mixture.PROPOSALS`."""
    groups = build_groups(model, observation)
    return [
        PrunedGroup(jax.random.fold_in(key, index), *item)
        for index, item in enumerate(groups.items())
    ]
