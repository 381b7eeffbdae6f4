"""Exact rejection by strata: the fast way on a processor. `StratifiedGroup` is a `GroupSampler`.

A group starts with few strata, and is cut finer as soon as the attempts still to be made cost more
than the cutting (`docs/model.md`, § 4: set-up and acceptance trade against each other). Draws of
every resolution are draws of the same posterior, so all are kept, and their rates are pooled."""

import functools
import os
import threading
import weakref
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np

from inference.exact.loops.attempts import Desk, attempt_bodies, desk
from inference.exact.loops.bins import LengthBins, length_bins
from inference.exact.loops.numbers import seeded, words_of
from inference.exact.loops.strata import (
    AREA,
    BOUNDS,
    BOX,
    MASS,
    NUM_COLUMNS,
    OFFSET,
    Build,
    Resolution,
    Sight,
    Strata,
    stratify,
)
from inference.exact.problem import LogRatio
from inference.exact.rates import HOPELESS, Budget, Pile, Pooled, Rate
from probmodel.model import PoseModel
from probmodel.pose import GroupDraws
from probmodel.skeleton import GROUPS

RESOLUTIONS = (
    Resolution(4, 3, 1),
    Resolution(6, 4, 2),
    Resolution(10, 8, 2),
    Resolution(16, 12, 3),
)
"""From few strata to many."""
GAIN = (1.9, 1.5, 1.4)
"""By how much the acceptance grows, roughly, from one resolution to the next."""
STRATUM, ATTEMPT = 1.0, 0.55
"""What a stratum costs to set up, and an attempt, in 100 ns: only their ratio counts, and only for
speed."""
ATTEMPTS = 1 << 14
"""Attempts made at a time."""
FIRST = 1 << 11
"""Attempts of the first batch, which shows how a group fares."""


class GroupTables(NamedTuple):
    """What the model says of a group of limbs: a `Build` each, and the parameters `(bones, 4)` of
    their lengths."""

    builds: tuple[Build, ...]
    lengths: np.ndarray


_known: dict[int, tuple[weakref.ref, dict[str, GroupTables]]] = {}
"""By the identity of the model, which is no key itself; an entry goes when its model goes."""


def group_tables(model: PoseModel) -> dict[str, GroupTables]:
    """The model's tables as the compiled loops read them, by group; made once a model."""
    identity = id(model)
    if identity not in _known or _known[identity][0]() is not model:
        found = {name: _group(model, limbs) for name, limbs in GROUPS.items()}
        _known[identity] = weakref.ref(model, lambda _: _known.pop(identity, None)), found
    return _known[identity][1]


def _group(model: PoseModel, limbs: Sequence) -> GroupTables:
    lengths = np.stack([np.asarray(field) for field in model.lengths], axis=1)
    used = [bone.length_group for bone in limbs[0].bones]
    return GroupTables(
        tuple(_build(model, limb.upper, limb.lower) for limb in limbs),
        np.ascontiguousarray(lengths[used], dtype=float),
    )


def _build(model: PoseModel, upper: int, lower: int | None) -> Build:
    cells = np.zeros((model.cells.occupied[0].size, NUM_COLUMNS))
    cells[:, MASS] = (
        np.diff(model.cells.rows[upper], axis=-1) / np.asarray(model.cells.total)[upper]
    ).ravel()
    axes = np.zeros(6)
    if lower is not None:
        hinges = model.hinges
        cells[:, AREA] = np.asarray(hinges.total)[lower].ravel()
        cells[cells[:, AREA] <= 0, MASS] = 0.0  # nothing is possible below such a cell
        for start, width, leaf in (
            (0, 9, hinges.triple),
            (OFFSET, 1, hinges.offset),
            (BOUNDS, 4, hinges.bounds),
            (BOX, 4, hinges.box),
        ):
            cells[:, start : start + width] = np.asarray(leaf)[lower].reshape(len(cells), width)
        axes = np.concatenate([model.limits.reference, np.asarray(model.limits.fallback)[lower]])
    a0, a1, a2, f0, f1, f2 = axes.tolist()
    return Build(
        cells,
        (a0, a1, a2, f0, f1, f2),
        model.upper == "area",
        model.lower == "box",
        1 if lower is None else 2,
    )


_own = threading.local()


def _desk(most: int) -> Desk:
    """This thread's own, with room for so many attempts."""
    if getattr(_own, "most", 0) < most:
        _own.desk, _own.most = desk(most), most
    return _own.desk


@functools.cache
def _workers() -> ThreadPoolExecutor:
    """One thread a core; the compiled loops are free of Python's lock. Only tasks that wait for
    nothing go here."""
    return ThreadPoolExecutor(os.cpu_count())


class Plan(NamedTuple):
    """Strata of a group at one resolution; `share` `(bins,)` of the attempts, and the proposal's
    whole `mass`."""

    sub: int
    bins: tuple[LengthBins, LengthBins]
    strata: tuple[Strata, ...]
    share: np.ndarray
    mass: float

    @property
    def size(self) -> int:
        """How many strata there are."""
        return sum(len(strata.pieces) for strata in self.strata)


def plan_group(tables: GroupTables, limbs: tuple[Sight, ...], resolution: Resolution) -> Plan:
    """Cuts a group at a resolution. Attempts × `mass` × acceptance rate = the prior probability of
    what is accepted."""
    two = tables.builds[0].bones == 2
    low, high, alpha, beta = tables.lengths[0]
    first = length_bins(low, high, alpha, beta, resolution.first)
    low, high, alpha, beta = tables.lengths[-1]
    second = length_bins(low, high, alpha, beta, resolution.second if two else 1)

    def one(sight: Sight, build: Build) -> Strata:
        return stratify(sight, build, first.edges, second.edges, resolution.sub)

    strata = tuple(_workers().map(one, limbs, tables.builds))
    prior = np.outer(first.mass, second.mass).ravel() if two else first.mass
    weight = prior * np.prod([limb.totals for limb in strata], axis=0)
    mass = float(weight.sum())
    return Plan(resolution.sub, (first, second), strata, weight / mass if mass else weight, mass)


class StratifiedGroup:
    """Exact draws of one group, cut as finely as the number of draws asked for makes worth while;
    see the module."""

    def __init__(
        self,
        key: jax.Array,
        name: str,
        tables: GroupTables,
        limbs: tuple[Sight, ...],
        log_ratio: LogRatio | None = None,
    ) -> None:
        self._log_ratio = log_ratio
        self.name, self._tables, self._limbs = name, tables, limbs
        self._words = words_of(key)
        self._pile = Pile()
        self.level = self._batches = 0
        self._order = list(range(len(limbs)))
        self._plan = self.plan_at(0)
        self._rates = [Rate(0, 0, self._plan.mass)]

    @property
    def held(self) -> int:
        return self._pile.size

    @property
    def impossible(self) -> bool:
        return self._plan.mass == 0

    @property
    def hopeless(self) -> bool:
        tried = sum(rate.proposed for rate in self._rates)
        return self.impossible or (self.held == 0 and tried >= HOPELESS)

    @property
    def slowest(self) -> str:
        return self.name

    @property
    def rates(self) -> list[Pooled]:
        return [Pooled(tuple(self._rates))]

    def more(self, number: int, budget: Budget) -> bool:
        while self.held < number and not self.hopeless:
            self._refine(number)
            sizes = []
            for size in self._sizes(number):
                if not budget.spend(size):
                    break
                sizes.append(size)
            if not sizes:
                break
            self._run(sizes)
        return self.held >= number

    def _sizes(self, number: int) -> list[int]:
        """Attempts of the batches that are expected to bring what is missing."""
        rate = self._rates[-1]
        if not rate.accepted:
            return [FIRST if rate.proposed == 0 else ATTEMPTS]
        missing = (number - self.held) * rate.proposed / rate.accepted
        return [ATTEMPTS] * min(int(missing // ATTEMPTS), 64) or [
            FIRST * (int(missing // FIRST) + 1)
        ]

    def _refine(self, number: int) -> None:
        """Cuts finer where that will cost less than it saves."""
        rate = self._rates[-1]
        if not rate.proposed or self.level + 1 == len(RESOLUTIONS):
            return
        acceptance = max(rate.accepted, 0.5) / rate.proposed
        saved = (
            (number - self.held)
            / acceptance
            * (1 - max(1 / GAIN[self.level], acceptance))
            * ATTEMPT
        )
        growth = RESOLUTIONS[self.level + 1].pieces / RESOLUTIONS[self.level].pieces
        if saved > growth * self._plan.size * STRATUM:
            self.level += 1
            self._plan = self.plan_at(self.level)
            self._rates.append(Rate(0, 0, self._plan.mass))

    def plan_at(self, level: int) -> Plan:
        """The group cut at one of the resolutions."""
        return plan_group(self._tables, self._limbs, RESOLUTIONS[level])

    def _run(self, sizes: list[int]) -> None:
        numbers = range(self._batches, self._batches + len(sizes))
        tried = through = found = 0
        for size, (rows, passed) in zip(
            sizes, _workers().map(self._batch, numbers, sizes), strict=True
        ):
            rate, tried, through = self._rates[-1], tried + size, through + passed
            self._rates[-1] = Rate(rate.proposed + size, rate.accepted + len(rows), rate.mass)
            self._pile.add(rows)
            found += len(rows)
        self._batches += len(sizes)
        # The limb that fails more often goes first: then the other is seldom tried in vain.
        if len(self._limbs) == 2 and through**2 > found * tried:
            self._order = self._order[::-1]

    def _batch(self, number: int, attempts: int) -> tuple[np.ndarray, int]:
        """The draws `(n, 2 + 6 · limbs)` of batch `number`, in random order, and how many passed
        their first limb."""
        plan, rng = (
            self._plan,
            np.random.default_rng(np.random.SeedSequence(self._words, spawn_key=(number, 0))),
        )
        counts = rng.multinomial(attempts, plan.share)
        rows = np.empty((attempts, 2 + 6 * len(self._limbs)))
        limbs = [
            (self._limbs[row], self._tables.builds[row], plan.strata[row]) for row in self._order
        ]
        state, pair = seeded(self._words, number, 1), (limbs[0], limbs[-1])
        found, passed = attempt_bodies(
            state, counts, *plan.bins, pair, plan.sub, _desk(attempts), rows
        )
        rows = rows[rng.permutation(found)]
        if self._order[0]:
            rows[:, 2:8], rows[:, 8:] = rows[:, 8:], rows[:, 2:8].copy()
        if self._log_ratio is not None and found:
            rows = rows[np.log1p(-rng.uniform(size=found)) <= self._log_ratio(self._named(rows))]
        return rows, passed

    def draws(self) -> dict[str, GroupDraws]:
        return {self.name: self._named(self._pile.all()[0])}

    def _named(self, rows: np.ndarray) -> GroupDraws:
        vectors = rows[:, 2:].reshape(len(rows), len(self._limbs), 2, 3)
        return GroupDraws(rows[:, : len(self._tables.lengths)], vectors[:, :, 0], vectors[:, :, 1])
