"""Exact rejection: draws of the prior that pass the indicator are draws of the posterior, and the rate is the evidence.

Three proposals stand behind one accept step (`limbs.Group.explains`): the whole body from the prior, each group of
limbs from the prior, and each group pruned. The pruned one draws limbs for which *some* lengths explain the detections
(`patches`), puts limbs that share lengths together, draws those lengths once from the prior, and asks the accept step.
Nothing is redrawn after acceptance, so every draw is independent and exact.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from inference.samplers.limbs import Draws, Group
from inference.samplers.patches import Limb, Plan, limbs_of, plan_limb, propose_limb
from probmodel.directions import HingedDirection, OccupiedDirection
from probmodel.lengths import BoneLength
from probmodel.limits import cell_of

BATCH = 1 << 15
"""Proposals made at a time; one compilation serves every batch of every frame."""
PAIRS = 1 << 12
"""Limbs put together at a time."""
HOPELESS = 1 << 24
"""Pruned proposals without one success after which a group is given up: its rate is below 3e-7 with 99 % confidence."""
HOPELESS_PAIRS = 1 << 20
"""The same for limbs put together, whose rate is far higher where their lengths can agree at all: below 5e-6."""


class Rate(NamedTuple):
    """Accepted out of proposed, and the mass of the proposal: probability = mass · accepted / proposed."""

    proposed: int
    accepted: int
    mass: float = 1.0

    @property
    def log_probability(self) -> float:
        """Log of the estimated probability; -inf where nothing was accepted."""
        return math.log(self.mass * self.accepted / self.proposed) if self.accepted and self.mass else -math.inf

    @property
    def variance(self) -> float:
        """Variance of `log_probability` (binomial, delta method); infinite where nothing was accepted."""
        return (1 - self.accepted / self.proposed) / self.accepted if self.accepted else math.inf


@dataclass
class Budget:
    """How many proposals may still be made; shared by everything that draws for one frame. One with a `whole` is an
    allowance out of that larger one."""

    proposals: int
    spent: int = 0
    whole: "Budget | None" = None

    def spend(self, number: int) -> bool:
        """Whether `number` more proposals may be made; counts them if so."""
        if self.spent + number > self.proposals or (self.whole is not None and not self.whole.spend(number)):
            return False
        self.spent += number
        return True


class GroupSampler(Protocol):
    """Exact draws of one or more groups. `more` asks for draws, `draws` holds them, `rates` say what they cost."""

    def more(self, number: int, budget: Budget) -> bool:
        """Goes on until `number` draws are held in all; False where the budget ends first."""

    @property
    def held(self) -> int:
        """Number of draws held."""

    def draws(self) -> dict[str, Draws]:
        """All draws held, by group."""

    @property
    def rates(self) -> list[Rate]:
        """The rates whose product is the evidence."""

    @property
    def slowest(self) -> str:
        """Name of the group that draws wait for."""

    @property
    def hopeless(self) -> bool:
        """Whether it has been given up: the bounds leave nothing, or a great many proposals brought nothing at all."""


class _Pile:
    """Rows that arrive in batches and leave from the front."""

    def __init__(self) -> None:
        self._parts: list[tuple[np.ndarray, ...]] = []
        self.size = 0

    def add(self, *rows: np.ndarray) -> None:
        if len(rows[0]):
            self._parts.append(rows)
            self.size += len(rows[0])

    def all(self) -> tuple[np.ndarray, ...]:
        if len(self._parts) > 1:
            self._parts = [tuple(np.concatenate(column) for column in zip(*self._parts, strict=True))]
        return self._parts[0]

    def take(self, number: int) -> tuple[np.ndarray, ...]:
        rows = self.all()
        self._parts = [tuple(column[number:] for column in rows)]
        self.size -= number
        return tuple(column[:number] for column in rows)


@dataclass
class LimbStream:
    """Independent draws of one limb for which some lengths in range explain its detections."""

    key: jax.Array
    limb: Limb
    plan: Plan
    batches: int = 0
    accepted: int = 0
    pile: _Pile = field(default_factory=_Pile)

    def run(self, budget: Budget) -> bool:
        """One more batch of proposals; False where the budget does not allow it."""
        if not budget.spend(BATCH):
            return False
        upper, lower, kept = propose_limb(jax.random.fold_in(self.key, self.batches), self.limb, self.plan, BATCH)
        chosen = np.flatnonzero(np.asarray(kept))
        self.batches += 1
        self.accepted += len(chosen)
        self.pile.add(np.asarray(upper)[chosen], np.asarray(lower)[chosen])
        return True

    @property
    def rate(self) -> Rate:
        return Rate(self.batches * BATCH, self.accepted, float(self.plan.mass))


class PrunedGroup:
    """Limbs pruned one by one, put together, lengths drawn once; see the module."""

    def __init__(self, key: jax.Array, name: str, group: Group) -> None:
        self.name, self.group = name, group
        self._key = jax.random.fold_in(key, 0)
        self.streams = [
            LimbStream(jax.random.fold_in(key, index + 1), limb, plan_limb(limb))
            for index, limb in enumerate(limbs_of(group))
        ]
        self._pile = _Pile()
        self._chunks = self._tried = 0

    @property
    def hopeless(self) -> bool:
        empty = any(stream.rate.mass == 0 for stream in self.streams)
        barren = any(stream.accepted == 0 and stream.rate.proposed >= HOPELESS for stream in self.streams)
        return empty or barren or (self.held == 0 and self._tried >= HOPELESS_PAIRS)

    @property
    def held(self) -> int:
        return self._pile.size

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number:
            going_on = not self.hopeless and min(self.streams, key=lambda stream: stream.pile.size).run(budget)
            # Few are put together as soon as few are wanted, or when nothing more will come.
            enough = min(PAIRS, number - self.held) if going_on else 1
            while (ready := min(stream.pile.size for stream in self.streams)) >= enough:
                self._put_together(min(ready, PAIRS))
            if not going_on:
                break
        return self.held >= number

    def _put_together(self, number: int) -> None:
        limbs = [stream.pile.take(number) for stream in self.streams]
        upper, lower = (np.zeros((PAIRS, len(limbs), 3)) for _ in range(2))
        for index, (first, second) in enumerate(limbs):
            upper[:number, index], lower[:number, index] = first, second
        length = _lengths(jax.random.fold_in(self._key, self._chunks), self.group)
        accepted = _explains(self.group, Draws(length, upper, lower))
        chosen = np.flatnonzero(np.asarray(accepted)[:number])
        self._chunks += 1
        self._tried += number
        self._pile.add(length[chosen], upper[chosen], lower[chosen])

    def draws(self) -> dict[str, Draws]:
        return {self.name: Draws(*self._pile.all())}

    @property
    def slowest(self) -> str:
        return self.name

    @property
    def rates(self) -> list[Rate]:
        return [*(stream.rate for stream in self.streams), Rate(self._tried, self.held)]


def _lengths(key: jax.Array, group: Group) -> np.ndarray:
    """`(PAIRS, bones)` lengths from the prior. NumPy draws Beta numbers ten times faster than JAX on a CPU, and has
    nothing to compile."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    low, high, alpha, beta = (np.asarray(field) for field in group.lengths)
    return np.clip(low + (high - low) * rng.beta(alpha, beta, (PAIRS, len(low))), low, high)


@jax.jit
def _explains(group: Group, draws: Draws) -> jax.Array:
    return group.explains(draws)


class PriorGroups:
    """Draws of several groups straight from the prior, accepted together: whole bodies, or one group alone."""

    def __init__(self, key: jax.Array, groups: dict[str, Group]) -> None:
        self._key, self.groups = key, groups
        self._pile = _Pile()
        self._batches = 0

    @property
    def held(self) -> int:
        return self._pile.size

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number:
            if not budget.spend(BATCH):
                return False
            proposals, accepted = _from_prior(jax.random.fold_in(self._key, self._batches), list(self.groups.values()))
            chosen = np.flatnonzero(np.asarray(accepted))
            self._batches += 1
            self._pile.add(*(np.asarray(leaf)[chosen] for leaf in jax.tree.leaves(proposals)))
        return True

    def draws(self) -> dict[str, Draws]:
        leaves = self._pile.all()
        return {name: Draws(*leaves[3 * index : 3 * index + 3]) for index, name in enumerate(self.groups)}

    @property
    def hopeless(self) -> bool:
        return False  # draws from the prior go on to the end of the budget

    @property
    def slowest(self) -> str:
        return max(self.groups, key=lambda name: self.groups[name].target.size)

    @property
    def rates(self) -> list[Rate]:
        return [Rate(self._batches * BATCH, self.held)]


@jax.jit
def _from_prior(key: jax.Array, groups: list[Group]) -> tuple[list[Draws], jax.Array]:
    proposals = [group_prior(jax.random.fold_in(key, index), group, BATCH) for index, group in enumerate(groups)]
    accepted = [group.explains(draws) for group, draws in zip(groups, proposals, strict=True)]
    return proposals, jnp.all(jnp.stack(accepted), axis=0)


@functools.partial(jax.jit, static_argnames="num")
def group_prior(key: jax.Array, group: Group, num: int) -> Draws:
    """`num` draws of a group from the prior: lengths, upper directions, lower directions given the upper ones."""
    for_length, for_upper, for_lower = jax.random.split(key, 3)
    length = BoneLength(group.lengths).sample(for_length, (num,))
    upper = OccupiedDirection(group.cells).sample(for_upper, (num,))
    if group.num_bones == 1:
        return Draws(length, upper, upper)
    column, row = cell_of(upper)
    hinges = jax.tree.map(lambda leaf: leaf[jnp.arange(group.num_limbs), column, row], group.hinges)
    return Draws(length, upper, HingedDirection(hinges).sample(for_lower))


Proposal = Callable[[jax.Array, dict[str, Group]], list[GroupSampler]]


def _pruned(key: jax.Array, groups: dict[str, Group]) -> list[GroupSampler]:
    return [PrunedGroup(jax.random.fold_in(key, index), *item) for index, item in enumerate(groups.items())]


def _per_group(key: jax.Array, groups: dict[str, Group]) -> list[GroupSampler]:
    return [PriorGroups(jax.random.fold_in(key, index), dict([item])) for index, item in enumerate(groups.items())]


def _whole_body(key: jax.Array, groups: dict[str, Group]) -> list[GroupSampler]:
    return [PriorGroups(key, groups)]


PROPOSALS: dict[str, Proposal] = {"pruned": _pruned, "group": _per_group, "prior": _whole_body}
"""How exact rejection proposes: the fast way, per group from the prior, the whole body from the prior."""
