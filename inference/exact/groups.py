"""Exact rejection by strata: the fast way on a processor. `StratifiedGroup` is a
`GroupSampler`.

A group starts with few strata, and is cut finer as soon as the proposals still to be
made cost more than the cutting (docs/model.md § 4: set-up and acceptance trade against
each other). Draws of every resolution are draws of the same posterior, so all are kept,
and their rates are pooled."""

import contextlib
import functools
import os
import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.exact import warm_up
from poseterior.inference.exact.loops.bins import length_bins
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.loops.proposals import add_bodies, propose_lengths, propose_limb
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.strata import Resolution, StrataBuffer, fill_in, strata_buffer
from poseterior.inference.exact.loops.tables import (
    Bodies,
    CutLimb,
    LengthBins,
    LimbProblem,
    LimbTables,
    Strata,
    Workspace,
    blank_bodies,
    cell_table,
    workspace_pair,
)
from poseterior.inference.exact.problem import LogRatio
from poseterior.inference.exact.rates import ZERO_ACCEPTANCE_LIMIT, Budget, Pooled, Rate, RowBuffer
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import GroupDraws
from poseterior.probmodel.skeleton import GROUPS

RESOLUTIONS = (
    Resolution(4, 3, 1),
    Resolution(8, 6, 1),
    Resolution(10, 8, 2),
    Resolution(20, 16, 2),
)
"""From few strata to many."""
GAIN = (1.0, 1.7, 2.9, 3.8)
"""How many times the acceptance of the first resolution each of them has, roughly."""
WORTH_A_THREAD = 1 << 15
"""Strata that a thread of their own is worth waking for."""
SMALLEST_BATCH = 1 << 14
"""Proposals of a batch at least, but for the last one."""
LARGEST_BATCH = 1 << 18
"""Proposals of a batch at most: many, since a bin's strata are at hand only while it is
visited."""
BATCHES = 8
"""Batches of one size that are made side by side."""
WORKSPACE_SIZE = 1 << 13
"""Proposals in a workspace."""
PILOT_BATCH = 1 << 11
"""Proposals of the first batch, which shows how a group fares."""


class GroupTables(NamedTuple):
    """What the model says of a group of limbs: `LimbTables` each, and the parameters
    `(bones, 4)` of their lengths."""

    builds: tuple[LimbTables, ...]
    lengths: np.ndarray


def memoised_by_model[Made](make: Callable[[PoseModel], Made]) -> Callable[[PoseModel], Made]:
    """`make`, whose results depend on limits and lengths, memoised by the identity of
    the model's cells: a model is no key itself, and those that `seen_by` makes of it
    share them. An entry goes when they go."""
    known: dict[int, tuple[weakref.ref, Made]] = {}

    @functools.wraps(make)
    def made(model: PoseModel) -> Made:
        identity = id(model.cells)
        if identity not in known or known[identity][0]() is not model.cells:
            gone = weakref.ref(model.cells, lambda _: known.pop(identity, None))
            known[identity] = gone, make(model)
        return known[identity][1]

    return made


@memoised_by_model
def group_tables(model: PoseModel) -> dict[str, GroupTables]:
    """The model's tables as the compiled loops read them, by group; memoised."""
    return {name: _group(model, limbs) for name, limbs in GROUPS.items()}


def _group(model: PoseModel, limbs: Sequence) -> GroupTables:
    lengths = np.stack([np.asarray(field) for field in model.lengths], axis=1)
    used = [bone.length_group for bone in limbs[0].bones]
    return GroupTables(
        tuple(_build(model, limb.upper, limb.lower) for limb in limbs),
        np.ascontiguousarray(lengths[used], dtype=float),
    )


def _build(model: PoseModel, upper: int, lower: int | None) -> LimbTables:
    rows = np.asarray(model.cells.rows)[upper]
    mass = np.diff(rows, axis=-1) / np.asarray(model.cells.columns)[upper, -1]
    hinge = None
    axes = np.zeros(6)
    if lower is not None:
        hinge = jax.tree.map(lambda leaf: np.asarray(leaf)[lower], model.hinges)
        axes = np.concatenate([model.limits.reference, np.asarray(model.limits.fallback)[lower]])
    a0, a1, a2, f0, f1, f2 = axes.tolist()
    return LimbTables(
        cell_table(mass, hinge),
        (a0, a1, a2, f0, f1, f2),
        model.upper == "area",
        model.lower == "box",
        1 if lower is None else 2,
    )


_own = threading.local()


def _workspaces() -> tuple[Workspace, Workspace]:
    """This thread's own."""
    if not hasattr(_own, "workspaces"):
        _own.workspaces = workspace_pair(WORKSPACE_SIZE)
    return _own.workspaces


class BodyBuffers:
    """What batches write their draws to, handed on from batch to batch and from frame
    to frame: memory that is new to a process is as slow as the draws themselves."""

    LARGEST = 1 << 17
    """Proposals of the largest buffer that is not given back to the system."""

    def __init__(self, limbs: int) -> None:
        self._limbs = limbs
        self._free = list[Bodies]()

    def take(self, proposals: int) -> Bodies:
        """A buffer for so many proposals."""
        with contextlib.suppress(IndexError):
            buffer = self._free.pop()
            if len(buffer.length) >= proposals:
                return buffer
        return blank_bodies(max(proposals, self.LARGEST), self._limbs)

    def give(self, buffer: Bodies) -> None:
        """Takes back what nobody reads any more."""
        if len(buffer.length) <= self.LARGEST and len(self._free) < BATCHES:
            self._free.append(buffer)


_body_buffers = {limbs: BodyBuffers(limbs) for limbs in (1, 2)}


@functools.cache
def workers() -> ThreadPoolExecutor:
    """One thread a core; the compiled loops are free of Python's lock. Only tasks that
    wait for nothing go here."""
    return ThreadPoolExecutor(os.cpu_count())


class Plan(NamedTuple):
    """Strata of a group at one resolution; `share` `(bins,)` of the proposals, and the
    proposal's whole `mass`."""

    sub: int
    bins: tuple[LengthBins, LengthBins]
    strata: tuple[Strata, ...]
    share: np.ndarray
    mass: float

    @property
    def size(self) -> int:
        """How many strata there are."""
        return sum(strata.size for strata in self.strata)


_bins = functools.lru_cache(maxsize=256)(length_bins)
"""Bins of lengths depend on the model and the resolution alone."""


def plan_group(
    tables: GroupTables,
    limbs: tuple[LimbProblem, ...],
    resolution: Resolution,
    *,
    alone: bool = False,
) -> Plan:
    """Cuts a group at a resolution. Proposals × `mass` × acceptance rate = the prior
    probability of what is accepted. `alone` keeps all work in the calling thread, which
    may be one of `workers`."""
    two = tables.builds[0].bones == 2
    first = _bins(*tables.lengths[0].tolist(), resolution.first)
    second = _bins(*tables.lengths[-1].tolist(), resolution.second if two else 1)
    strata = _cut(tables, limbs, (first.edges, second.edges), resolution.sub, alone)
    prior = np.outer(first.mass, second.mass).ravel() if two else first.mass
    weight = prior * np.prod([limb.totals for limb in strata], axis=0)
    mass = float(weight.sum())
    return Plan(resolution.sub, (first, second), strata, weight / mass if mass else weight, mass)


def _cut(
    tables: GroupTables,
    limbs: tuple[LimbProblem, ...],
    edges: tuple[np.ndarray, np.ndarray],
    sub: int,
    alone: bool,
) -> tuple[Strata, ...]:
    """The strata of every limb, by threads where there is enough to do."""

    def begun(limb: LimbProblem, build: LimbTables) -> StrataBuffer:
        return strata_buffer(limb, build, edges, sub)

    few = alone or len(limbs) == 1 or sub == 1
    buffers = list((map if few else workers().map)(begun, limbs, tables.builds))
    most = sum(len(buffer.strata.entries) for buffer in buffers)
    parts = 1 if alone else min(os.cpu_count() or 1, 1 + most // WORTH_A_THREAD)
    spans = [buffer.spans(parts) for buffer in buffers]

    def fill_part(part: int) -> None:
        for buffer, own in zip(buffers, spans, strict=True):
            fill_in(buffer, *own[part])

    # All of it by the workers, while this thread sleeps: one that it wakes shares its
    # core first.
    list((map if parts == 1 else workers().map)(fill_part, range(parts)))
    return tuple(buffer.strata for buffer in buffers)


def draw_group(
    plan: Plan,
    tables: GroupTables,
    limbs: tuple[LimbProblem, ...],
    order: list[int],
    rng: np.random.Generator,
    state: np.ndarray,
    *,
    proposals: int,
    buffer: Bodies | None = None,
) -> tuple[Bodies, int]:
    """Proposals of a group by a plan that has mass: the draws within reach, in random
    order, their limbs in the group's order; and how many proposals passed the limb that
    is first in `order`. `rng` shares the proposals out, `state` is that of the loops'
    random numbers; draws are written to the `buffer`, if there is one."""
    warm_up.wait()
    ends = np.cumsum(rng.multinomial(proposals, plan.share))
    workspaces = _workspaces()
    cut = [CutLimb(limbs[row], tables.builds[row], plan.strata[row]) for row in order]
    buffer = buffer or blank_bodies(proposals, len(limbs))
    two = tables.builds[0].bones == 2
    columns = np.array(order)
    passed = held = 0
    for start in range(0, proposals, WORKSPACE_SIZE):
        left = propose_lengths(state, ends, start, plan.bins, two, workspaces[0])
        for row, limb in enumerate(cut):
            left = propose_limb(state, limb, plan.sub, left, workspaces[row])
            passed += left if row == 0 else 0
        held = add_bodies(state, left, workspaces, columns, buffer, held)
    return Bodies(*(part[:held] for part in buffer)), passed


class StratifiedGroup:
    """Exact draws of one group, cut as finely as the number of draws asked for makes
    worth while; see the module."""

    STRATUM_COST = 1.0
    PROPOSAL_COST = 1.0
    """What a stratum costs to set up, and a proposal: only their ratio counts, and only
    for speed. From 0.5 to 1.4 the time of 100,000 draws changes by 1 % and is least
    here, while the set-up, of which fewer draws have most, takes a third less."""

    def __init__(
        self,
        key: jax.Array,
        name: str,
        tables: GroupTables,
        limbs: tuple[LimbProblem, ...],
        log_ratio: LogRatio | None = None,
    ) -> None:
        self._log_ratio = log_ratio
        self.name = name
        self._tables = tables
        self._limbs = limbs
        self._words = words_of(key)
        self._buffer = RowBuffer()
        self.level = self._batches = 0
        self._order = list(range(len(limbs)))
        self._plan = self.plan_at(0)
        self._rates = [Rate(0, 0, self._plan.mass)]

    @property
    def held(self) -> int:
        return self._buffer.size

    @property
    def impossible(self) -> bool:
        return self._plan.mass == 0

    @property
    def given_up(self) -> bool:
        proposed = sum(rate.proposed for rate in self._rates)
        accepted = any(rate.accepted for rate in self._rates)
        return self.impossible or (not accepted and proposed >= ZERO_ACCEPTANCE_LIMIT)

    @property
    def slowest(self) -> str:
        return self.name

    @property
    def rates(self) -> list[Pooled]:
        return [Pooled(tuple(self._rates))]

    def more(self, number: int, budget: Budget) -> bool:
        self._buffer.reserve(number + number // 16 + PILOT_BATCH)
        while self.held < number and not self.given_up:
            self._refine(number)
            if self.impossible:  # a finer cut may leave nothing where a coarser one left something
                break
            sizes = []
            for size in self._sizes(number, budget.left):
                if not budget.spend(size):
                    break
                sizes.append(size)
            if not sizes:
                break
            self._run(sizes)
        return self.held >= number

    def _sizes(self, number: int, affordable: int) -> list[int]:
        """Proposals of the batches that are expected to bring what is missing, or as
        much of it as is affordable."""
        rate = self._rates[-1]
        if not rate.accepted:
            return [SMALLEST_BATCH if rate.proposed else PILOT_BATCH]
        missing = int((number - self.held) * rate.proposed / rate.accepted)
        missing = min(missing, affordable, 1024 * rate.proposed)
        if missing < SMALLEST_BATCH:
            return [PILOT_BATCH * (missing // PILOT_BATCH + 1)]
        rounds = -(-missing // (BATCHES * LARGEST_BATCH))
        batches = min(rounds * BATCHES, missing // SMALLEST_BATCH)
        return [missing // batches] * batches

    def _refine(self, number: int) -> None:
        """Cuts as finely as will cost least, cutting included."""
        rate = self._rates[-1]
        if not rate.proposed:
            return
        missing = number - self.held
        acceptance = max(rate.accepted, 0.5) / rate.proposed

        def cost(level: int) -> float:
            gain = GAIN[level] / GAIN[self.level]
            proposals = missing / max(acceptance, min(1.0, gain * acceptance))
            growth = RESOLUTIONS[level].pieces / RESOLUTIONS[self.level].pieces
            strata = growth * self._plan.size if level > self.level else 0
            return strata * self.STRATUM_COST + proposals * self.PROPOSAL_COST

        level = min(range(self.level, len(RESOLUTIONS)), key=cost)
        if level > self.level:
            self.level = level
            self._plan = self.plan_at(level)
            self._rates.append(Rate(0, 0, self._plan.mass))

    def plan_at(self, level: int) -> Plan:
        """The group cut at one of the resolutions."""
        return plan_group(self._tables, self._limbs, RESOLUTIONS[level])

    def _run(self, sizes: list[int]) -> None:
        numbers = range(self._batches, self._batches + len(sizes))
        proposed = through = accepted = 0
        body_buffers = _body_buffers[len(self._limbs)]
        buffers = [body_buffers.take(size) for size in sizes]
        batches = workers().map(self._batch, numbers, sizes, buffers)
        for size, buffer, (bodies, passed) in zip(sizes, buffers, batches, strict=True):
            number = len(bodies.length)
            rate = self._rates[-1]
            self._rates[-1] = Rate(rate.proposed + size, rate.accepted + number, rate.mass)
            self._buffer.add(*bodies)
            body_buffers.give(buffer)
            proposed += size
            through += passed
            accepted += number
        self._batches += len(sizes)
        # The limb that fails more often goes first: then the other is seldom tried in
        # vain.
        if len(self._limbs) == 2 and through**2 > accepted * proposed:
            self._order = self._order[::-1]

    def _batch(
        self, number: int, proposals: int, buffer: Bodies | None = None
    ) -> tuple[Bodies, int]:
        """The draws of batch `number`, in random order, and how many passed their first
        limb."""
        rng = np.random.default_rng(np.random.SeedSequence(self._words, spawn_key=(number, 0)))
        state = seeded(self._words, number, 1)
        bodies, passed = draw_group(
            self._plan,
            self._tables,
            self._limbs,
            self._order,
            rng,
            state,
            proposals=proposals,
            buffer=buffer,
        )
        if self._log_ratio is not None and len(bodies.length):
            test = np.log1p(-rng.uniform(size=len(bodies.length)))
            kept = test <= self._log_ratio(self._named(bodies))
            bodies = Bodies(*(part[kept] for part in bodies))
        return bodies, passed

    def draws(self) -> dict[str, GroupDraws]:
        return {self.name: self._named(Bodies(*self._buffer.all()))}

    def forget(self, number: int) -> None:
        self._buffer.take(number)

    def _named(self, bodies: Bodies) -> GroupDraws:
        length, upper, lower = bodies
        return GroupDraws(length[:, : len(self._tables.lengths)], upper, lower)
