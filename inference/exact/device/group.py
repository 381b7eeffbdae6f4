"""Exact rejection by strata on JAX's device, a GPU above all. `DeviceGroup` is a
`GroupSampler`.

The strata are those of `exact.groups`, cut by the processor, whose compiled loops make
the first batch, from which it is decided how finely to cut. All other proposals, from
the random numbers to the draws in their places, are one program on the device, which
goes on until there are enough; nothing comes back but how many there are. A processor
runs it too, more slowly than its loops."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.exact.device.proposals import NUMBERS, Measures, propose
from poseterior.inference.exact.device.tables import DevicePlan, device_plan
from poseterior.inference.exact.groups import (
    PILOT_BATCH,
    GroupTables,
    StratifiedGroup,
    group_tables,
)
from poseterior.inference.exact.loops.tables import LimbProblem
from poseterior.inference.exact.problem import limb_problems, log_ratios
from poseterior.inference.exact.rates import ZERO_ACCEPTANCE_LIMIT, Budget, Rate
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.skeleton import GROUPS

ROUNDS = 1 << 10
"""Rounds of a program at most, after which the budget is asked again."""
LEAST = 1 << 11
"""Draws that there is room for at least."""


class Size(NamedTuple):
    """Proposals side by side, and how often in a round: that many are made without
    asking whether there are enough draws."""

    batch: int
    repeats: int

    @property
    def proposals(self) -> int:
        """Of a round."""
        return self.batch * self.repeats


SIZES = {"cpu": Size(1 << 14, 1)}
"""By the kind of device."""
SIZE = Size(1 << 18, 8)
"""Of every other kind: what a GPU's cache holds, as often as it takes to hide the
asking."""


class Thinning(NamedTuple):
    """What draws within reach are thinned by, where the law of errors is not flat."""

    model: PoseModel
    observation: Observation


class Kind(NamedTuple):
    """What a program is made for."""

    group: str
    measures: Measures
    size: Size


class _State(NamedTuple):
    """Of a program: the draws, how many there are, how many rounds have been made, and
    how many proposals were accepted."""

    room: jax.Array
    held: jax.Array
    made: jax.Array
    accepted: jax.Array


@functools.partial(jax.jit, static_argnames="kind", donate_argnames="room")
def _fill(
    key: jax.Array,
    plan: DevicePlan,
    thinning: Thinning | None,
    *,
    room: jax.Array,
    held: int,
    number: int,
    begin: int,
    rounds: int,
    kind: Kind,
) -> _State:
    """Rounds of proposals, from round number `begin` on, until `room` holds `number`
    draws, or so many `rounds` have been made. Draws stand in the order of their
    proposals; those for which there is no room any more count, and are gone."""
    size = kind.size

    def go_on(state: _State) -> jax.Array:
        return (state.held < number) & (state.made < rounds)

    def batch(repeat: jax.Array, state: _State) -> _State:
        own = jax.random.fold_in(key, (begin + state.made) * size.repeats + repeat)
        words, test = jax.random.split(own)
        uniform = jax.random.uniform(words, (NUMBERS, size.batch))
        each = jax.vmap(lambda own: propose(own, plan, kind.measures), 1, (1, 0))
        columns, passed = each(uniform)
        if thinning is not None:
            level = jnp.log1p(-jax.random.uniform(test, passed.shape))
            passed &= level <= _log_ratios(columns, thinning, kind.group)
        count = jnp.cumsum(passed)
        most = room.shape[1]
        # What has failed would go to a place of its own outside: all places are
        # different.
        nowhere = most + jnp.arange(size.batch)
        place = jnp.where(passed, state.held + count - 1, nowhere)
        return _State(
            state.room.at[:, place].set(columns, mode="drop", unique_indices=True),
            jnp.minimum(state.held + count[-1], most),
            state.made,
            state.accepted + count[-1],
        )

    def one_round(state: _State) -> _State:
        after = jax.lax.fori_loop(0, size.repeats, batch, state)
        return after._replace(made=after.made + 1)

    return jax.lax.while_loop(go_on, one_round, _State(room, *map(jnp.asarray, (held, 0, 0))))


def _log_ratios(columns: jax.Array, thinning: Thinning, group: str) -> jax.Array:
    """`problem.log_ratio_of` for proposals of a group."""
    limbs = GROUPS[group]
    blank = Pose.blank(columns.shape[1])
    poses = place_group(Pose(*map(jnp.asarray, blank)), columns, group)
    ratios = log_ratios(thinning.model, thinning.observation, poses)
    return ratios[:, np.array([bone.end for limb in limbs for bone in limb.bones])].sum(axis=1)


def place_group(poses: Pose, columns: jax.Array, group: str) -> Pose:
    """Poses `(n, ...)` on the device with a group's part, from `n` of a program's
    draws."""
    limbs = GROUPS[group]
    length, upper, lower = parts_of(columns, len(limbs))
    used = np.array([bone.length_group for bone in limbs[0].bones])
    lowers = np.array([limb.lower for limb in limbs if limb.lower is not None], int)
    return Pose(
        poses.length.at[:, used].set(length[:, : len(used)]),
        poses.upper.at[:, np.array([limb.upper for limb in limbs])].set(upper),
        poses.lower.at[:, lowers].set(lower[:, : len(lowers)]),
    )


def parts_of[A: (jax.Array, np.ndarray)](columns: A, limbs: int) -> tuple[A, A, A]:
    """Lengths `(n, 2)`, upper and lower directions `(n, limbs, 3)` of a program's
    draws."""
    length = columns[:2]
    upper = columns[2 : 2 + 3 * limbs]
    lower = columns[2 + 3 * limbs :]
    return length.T, upper.T.reshape(-1, limbs, 3), lower.T.reshape(-1, limbs, 3)


@functools.partial(jax.jit, donate_argnums=0)
def _moved(fresh: jax.Array, old: jax.Array) -> jax.Array:
    """The old draws in a larger room."""
    return fresh.at[:, : old.shape[1]].set(old)


@jax.jit
def _without(room: jax.Array, number: int) -> jax.Array:
    """The draws after the first so many, at the front."""
    return jnp.roll(room, -number, axis=1)


class DeviceGroup(StratifiedGroup):
    """Exact draws of one group, proposed on JAX's device; see the module."""

    STRATUM_COST = 0.7
    PROPOSAL_COST = 0.01

    def __init__(
        self,
        key: jax.Array,
        name: str,
        tables: GroupTables,
        limbs: tuple[LimbProblem, ...],
        thinning: Thinning | None = None,
    ) -> None:
        super().__init__(key, name, tables, limbs)
        build = tables.builds[0]
        size = SIZES.get(jax.default_backend(), SIZE)
        self._key = key
        self._thinning = thinning
        self._kind = Kind(name, Measures(build.by_area, build.flat), size)
        self._held = self._rounds_made = 0
        self._ready = dict[int, DevicePlan]()
        with jax.enable_x64(True):
            self._room = jnp.zeros((2 + 6 * len(limbs), 0))

    @property
    def held(self) -> int:
        return self._held

    @property
    def room(self) -> jax.Array:
        """`(2 + 6 · limbs, room)` on the device, a column as `proposals.propose`
        returns it; the first `held` are draws."""
        return self._room

    def more(self, number: int, budget: Budget) -> bool:
        with jax.enable_x64(True):
            if self._held < number and not (self._ready or self.impossible):
                if not budget.spend(PILOT_BATCH):
                    return False
                self._run([PILOT_BATCH])
            while self._held < number and not self.given_up:
                self._refine(number)
                rounds = min(budget.left // self._kind.size.proposals, self._rounds())
                if self.impossible or rounds == 0:
                    break
                budget.spend(self._go_on(number, rounds))
        return self._held >= number

    def _rounds(self) -> int:
        """Rounds after which it is time to look: where nothing is found there comes an
        end."""
        return (
            ROUNDS
            if self._rates[-1].accepted
            else -(-ZERO_ACCEPTANCE_LIMIT // self._kind.size.proposals)
        )

    def _go_on(self, number: int, rounds: int) -> int:
        """Goes on until there are `number` draws, for so many rounds at most; returns
        the number of proposals."""
        if self._room.shape[1] < number:
            room = 1 << (max(number, LEAST) - 1).bit_length()
            self._room = _moved(jnp.zeros((len(self._room), room)), self._room)
        if self.level not in self._ready:
            plan, mass = device_plan(self._plan, self._tables, self._limbs)
            # The processor's first batch has shown how finely to cut, and counts no
            # longer.
            before = self._rates[:-1] if self._ready else []
            self._ready = {self.level: plan}
            self._rates = [*before, Rate(0, 0, mass)]
        state = _fill(
            self._key,
            self._ready[self.level],
            self._thinning,
            room=self._room,
            held=self._held,
            number=number,
            begin=self._rounds_made,
            rounds=rounds,
            kind=self._kind,
        )
        self._room = state.room
        self._held = int(state.held)
        made = int(state.made)
        self._rounds_made += made
        rate = self._rates[-1]
        proposals = made * self._kind.size.proposals
        accepted = rate.accepted + int(state.accepted)
        self._rates[-1] = Rate(rate.proposed + proposals, accepted, rate.mass)
        return proposals

    def draws(self) -> dict[str, GroupDraws]:
        columns = np.asarray(self._room)[:, : self._held]
        length, upper, lower = parts_of(columns, len(self._limbs))
        return {self.name: GroupDraws(length[:, : len(self._tables.lengths)], upper, lower)}

    def forget(self, number: int) -> None:
        with jax.enable_x64(True):
            self._room = _without(self._room, number)
        self._held -= number


def device_groups(key: jax.Array, model: PoseModel, observation: Observation) -> list[DeviceGroup]:
    """A sampler of each of `skeleton.GROUPS`, with keys of their own."""
    tables = group_tables(model)
    problems = limb_problems(observation)
    thinning = None if observation.law.follows(0.0) else Thinning(model, observation)
    return [
        DeviceGroup(jax.random.fold_in(key, index), name, tables[name], problems[name], thinning)
        for index, name in enumerate(GROUPS)
    ]
