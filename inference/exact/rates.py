"""What exact rejection keeps count of: rates, which are evidence, the budget, and the
draws held."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from poseterior.probmodel.pose import GroupDraws

ZERO_ACCEPTANCE_LIMIT = 1 << 24
"""Pruned proposals without one success after which a group is given up: its rate is
below 3e-7 with 99 % confidence."""


class Rate(NamedTuple):
    """Accepted out of proposed, and the mass of the proposal: probability = mass ·
    accepted / proposed. A success may count in part, with its likelihood over the
    peak."""

    proposed: int
    accepted: float
    mass: float = 1.0

    @property
    def log_probability(self) -> float:
        """Log of the estimated probability; -inf where nothing was accepted."""
        return (
            math.log(self.mass * self.accepted / self.proposed)
            if self.accepted and self.mass
            else -math.inf
        )

    @property
    def variance(self) -> float:
        """Variance of `log_probability` (binomial, delta method); infinite where
        nothing was accepted."""
        return (1 - self.accepted / self.proposed) / self.accepted if self.accepted else math.inf


class Pooled(NamedTuple):
    """Rates of several proposals for one probability, each as good as its number of
    proposals over its mass."""

    rates: tuple[Rate, ...]

    @property
    def accepted(self) -> float:
        """Successes of all of them."""
        return sum(rate.accepted for rate in self.rates)

    @property
    def log_probability(self) -> float:
        """Log of the estimated probability; -inf where nothing was accepted."""
        effort = sum(rate.proposed / rate.mass for rate in self.rates if rate.mass)
        return math.log(self.accepted / effort) if self.accepted else -math.inf

    @property
    def variance(self) -> float:
        """Variance of `log_probability` (binomials, delta method); infinite where
        nothing was accepted."""
        if not self.accepted:
            return math.inf
        return (
            sum(rate.accepted**2 * rate.variance for rate in self.rates if rate.accepted)
            / self.accepted**2
        )


@dataclass
class Budget:
    """How many proposals may still be made; shared by everything that draws for one
    frame. One with a `whole` is an allowance out of that larger one. `watch` is called
    whenever proposals are about to be made."""

    proposals: int
    spent: int = 0
    whole: "Budget | None" = None
    watch: Callable[[], None] | None = None

    @property
    def left(self) -> int:
        """How many proposals may still be made."""
        own = self.proposals - self.spent
        return own if self.whole is None else min(own, self.whole.left)

    def spend(self, number: int) -> bool:
        """Whether `number` more proposals may be made; counts them if so."""
        if self.watch:
            self.watch()
        if self.spent + number > self.proposals or (
            self.whole is not None and not self.whole.spend(number)
        ):
            return False
        self.spent += number
        return True


class GroupSampler(Protocol):
    """Exact draws of one or more groups. `more` asks for draws, `draws` holds them,
    `forget` lets go of them, `rates` say what all of them cost."""

    def more(self, number: int, budget: Budget) -> bool:
        """Goes on until `number` draws are held in all; False where the budget ends
        first."""

    @property
    def held(self) -> int:
        """Number of draws held."""

    def draws(self) -> dict[str, GroupDraws]:
        """All draws held, by group."""

    def forget(self, number: int) -> None:
        """Lets go of the first `number` draws, which have gone elsewhere."""

    @property
    def rates(self) -> Sequence[Rate | Pooled]:
        """The rates whose product is the evidence."""

    @property
    def slowest(self) -> str:
        """Name of the group that draws wait for."""

    @property
    def impossible(self) -> bool:
        """Whether there is proof that no draw exists: the bounds leave nothing."""

    @property
    def given_up(self) -> bool:
        """Whether it has been given up: the bounds leave nothing, or a great many
        proposals brought nothing at all."""


class RowBuffer:
    """Rows that arrive in batches, are copied, and leave from the front."""

    def __init__(self) -> None:
        self._columns: tuple[np.ndarray, ...] = ()
        self._room = self.size = 0

    def reserve(self, number: int) -> None:
        """Says how many rows there will be, if no more than that are to come."""
        self._room = max(self._room, number)

    def add(self, *rows: np.ndarray) -> None:
        size = self.size + len(rows[0])
        if not self._columns or size > len(self._columns[0]):
            room = max(self._room, size, 2 * self.size)
            fresh = tuple(np.empty((room, *part.shape[1:]), part.dtype) for part in rows)
            for new, old in zip(fresh, self._columns, strict=bool(self._columns)):
                new[: self.size] = old[: self.size]
            self._columns = fresh
        for column, part in zip(self._columns, rows, strict=True):
            column[self.size : size] = part
        self.size = size

    def all(self) -> tuple[np.ndarray, ...]:
        return tuple(column[: self.size] for column in self._columns)

    def take(self, number: int) -> tuple[np.ndarray, ...]:
        rows = self.all()
        self._columns = tuple(column[number:] for column in self._columns)
        self.size -= number
        return tuple(column[:number] for column in rows)
