"""The paper's relations between rows of its tables: which of them hold on a data set, with
intervals over recordings.

A relation holds where the whole interval says so, does not hold where the whole interval denies it,
and is undecided otherwise. Frames that one of its rows lacks count in neither."""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.evaluation.conditions import Condition, alike
from poseterior.inference.studies.evaluation.scores import (
    Interval,
    Values,
    clustered,
    common,
    pose_errors,
    usable,
)
from poseterior.probmodel.root_priors import CANDIDATES

HOLDS, FAILS, OPEN = "holds", "does not hold", "undecided"
RELATION_GAIN = 0.15
"""What the best of five must gain on Akhter & Black's single estimate."""
ABOUT = 0.05
"""How far apart errors are, relatively, that are "about equal"."""
INF = float("inf")


class Relation(NamedTuple):
    """A relation: in words, what the paper found, what was found, and the range in which it must
    lie."""

    words: str
    paper: str
    found: Interval
    low: float
    high: float
    unit: str
    frames: int

    @property
    def verdict(self) -> str:
        """Holds, does not hold, or undecided."""
        if not np.isfinite([self.found.low, self.found.high]).all():
            return OPEN
        if self.low <= self.found.low and self.found.high <= self.high:
            return HOLDS
        return FAILS if self.found.high < self.low or self.found.low > self.high else OPEN


def relations(
    results: Mapping[Condition, Values], recording: np.ndarray, ks: Sequence[int], base: Condition
) -> list[Relation]:
    """Those relations that the conditions at hand allow; `base` is the first of them, its estimator
    aside."""
    few = min(ks)
    many = max(ks)
    ways = alike(results, base)
    found = [_against_single(way, results[way], recording, few) for way in ways]
    for way in ways:
        values = results[way]
        if many > few:
            words = f"{way.way}: the best of {many} is better than the best of {few}"
            found.append(_gain(words, "7 % (Zhou)", values, few, many, recording))
        words = f"{way.way}: the best of all draws is better than the best of {many}"
        found.append(_gain(words, "18 % (Zhou)", values, many, "all", recording))
    for way in ways:
        levels = sorted(one.missing for one in results if one._replace(missing=way.missing) == way)
        for one, more in itertools.pairwise(levels):
            pair = [results[way._replace(missing=number)] for number in (one, more)]
            found.append(_growth(way.way, one, more, pair, recording, few))
    return found


def _against_single(way: Condition, values: Values, recording: np.ndarray, k: int) -> Relation:
    gain = _gain("", "", values, "single", k, recording)
    single = "the single estimate"
    if way.root != CANDIDATES:
        single = f"the single estimate of {way.estimator}"
    if way.estimator == "akhter-black":
        words = f"{way.way}: the best of {k} beats {single} by 15 % or more"
        return gain._replace(words=words, paper="18 %", low=RELATION_GAIN)
    if way == way._replace(estimator="zhou", root=CANDIDATES):
        words = f"{way.way}: the best of {k} about equals {single} (within 5 %)"
        return gain._replace(words=words, paper="0.3 %", low=-ABOUT, high=ABOUT)
    words = f"{way.way}: the best of {k} beats {single}"
    return gain._replace(words=words, paper="(not in the paper)")


def _gain(
    words: str,
    paper: str,
    values: Values,
    before: str | int,
    after: str | int,
    recording: np.ndarray,
) -> Relation:
    """The share by which errors fall from one row to another: it must be above zero."""
    rows = usable(values)
    columns = np.stack(
        [pose_errors(values, before)[rows], pose_errors(values, after)[rows]], axis=1
    )
    estimate = clustered(columns, recording[rows], lambda means: 1 - means[..., 1] / means[..., 0])
    return Relation(
        words=words,
        paper=paper,
        found=estimate,
        low=0.0,
        high=INF,
        unit="share",
        frames=int(rows.sum()),
    )


_PAPER_GAIN = {(0, 1): "+21.5 mm", (1, 2): "+13.4 mm", (0, 2): "+34.9 mm"}
"""Growth of A&B's error less that of the best of five, true 2D."""


def _growth(
    way: str, one: int, more: int, pair: Sequence[Values], recording: np.ndarray, k: int
) -> Relation:
    rows = common(pair)
    gains = [(pose_errors(values, "single") - pose_errors(values, k))[rows] for values in pair]
    estimate = clustered(gains[1] - gains[0], recording[rows])
    words = f"{way}: the gain of the best of {k} grows from {one} to {more} missing joints"
    paper = f"{_PAPER_GAIN[one, more]} (A&B)" if (one, more) in _PAPER_GAIN else "–"
    return Relation(
        words=words,
        paper=paper,
        found=estimate,
        low=0.0,
        high=INF,
        unit="mm",
        frames=int(rows.sum()),
    )
