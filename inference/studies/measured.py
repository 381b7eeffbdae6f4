"""Measures against the truth: where it stands among the draws, how far the mean is off, and how
wide the interval is; and what many people's posteriors come to.

Where the truth itself errs, draws are given such errors before it is ranked among them. A circle is
cut opposite to the mean of draws and truth together: nothing in it knows which is the truth, so
that its rank is uniform if it is one more draw."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from poseterior.inference.studies.intervals import TAIL, Interval, of_share
from poseterior.inference.studies.levels import rank_level
from poseterior.inference.summaries import centre, interval, unrolled
from poseterior.probmodel.measures import MEASURES, Measure, turned

ALL_MEASURES = tuple(MEASURES.values())
GIVEN = 1e-9
"""Where all draws lie as near together as that, they were told: as are the trunk's measures where
the torso is given. Nothing is asked of them."""
LARGE = 10.0
"""Degrees from which an error is a large one."""


class MeasureStandings(NamedTuple):
    """Of each measure `(q,)`: the truth's `level` among the draws, uniform if they are right; the
    `error` of the draws' mean, and the `width` of the central interval of 95 %; NaN where the
    truth's pose does not determine it, or where it was given."""

    level: np.ndarray
    error: np.ndarray
    width: np.ndarray


def values_of(joints: np.ndarray, chosen: Sequence[Measure] = ALL_MEASURES) -> np.ndarray:
    """`(..., q)`: measures of poses `(..., 15, 3)`."""
    return np.stack([one.of(joints) for one in chosen], axis=-1)


def levels_of(
    truth: np.ndarray,
    draws: np.ndarray,
    rng: np.random.Generator,
    chosen: Sequence[Measure] = ALL_MEASURES,
) -> np.ndarray:
    """`(q,)`: the levels of values `(q,)` among those of draws `(n, q)`."""
    both = np.concatenate([truth[None], draws])
    circular = np.array([one.circular for one in chosen])
    line = np.where(circular, unrolled(both, True), both)
    return rank_level(line[0], line[1:], rng)


def standings_of(
    truth: np.ndarray, seen: np.ndarray, draws: np.ndarray, rng: np.random.Generator
) -> MeasureStandings:
    """How a pose `(15, 3)` stands to draws `(n, 15, 3)`, and to the same `seen` with such errors as
    it may have itself."""
    known = values_of(truth)
    values = values_of(draws)
    found = np.full((2, len(ALL_MEASURES)), np.nan)
    for column, one in enumerate(ALL_MEASURES):
        held = values[np.isfinite(values[:, column]), column]
        if len(held) and np.isfinite(known[column]):
            low, high = interval(held, 1 - 2 * TAIL, one.circular)
            found[:, column] = turned(centre(held, one.circular) - known[column], one), high - low
    found[:, ~(found[1] > GIVEN)] = np.nan
    level = levels_of(known, values_of(seen), rng)
    return MeasureStandings(np.where(np.isfinite(found[0]), level, np.nan), *found)


def no_standings() -> MeasureStandings:
    """Where there are too few draws to say."""
    return MeasureStandings(*np.full((3, len(ALL_MEASURES)), np.nan))


class MeasureScore(NamedTuple):
    """What comes of a measure in many people or frames.

    Attributes
    ----------
    name, unit : the measure.
    size : in how many the truth determines it, and there are draws.
    covered : how often central intervals of 95 % hold the truth.
    error : the median of the mean's absolute error.
    width : the median width of the intervals.
    rank : Spearman's correlation of width and absolute error.
    area : under the curve with which the width tells errors above `LARGE` from the others; NaN
        where there are none of one kind, and of lengths.
    """

    name: str
    unit: str
    size: int
    covered: Interval
    error: float
    width: float
    rank: float
    area: float


def scores_of_measures(
    level: np.ndarray, error: np.ndarray, width: np.ndarray, cluster: np.ndarray, unit: str = "mm"
) -> list[MeasureScore]:
    """The score of each measure, of levels, errors and widths `(n, q)`, with intervals over the
    clusters `(n,)`; lengths are in `unit`. Without those that nothing is known of."""
    units = [unit if one.kind == "length" else one.unit for one in ALL_MEASURES]
    known = np.isfinite(level) & np.isfinite(error) & np.isfinite(width)
    return [
        score(
            one.name,
            units[column],
            level[rows, column],
            error[rows, column],
            width[rows, column],
            cluster[rows],
        )
        for column, (one, rows) in enumerate(zip(ALL_MEASURES, known.T, strict=True))
        if rows.any()
    ]


def score(
    name: str,
    unit: str,
    level: np.ndarray,
    error: np.ndarray,
    width: np.ndarray,
    cluster: np.ndarray,
) -> MeasureScore:
    """The score of levels, errors and widths `(n,)`, all of them known."""
    size = np.abs(error)
    held = (level >= TAIL) & (level <= 1 - TAIL)
    varied = len(size) > 2 and np.ptp(size) > 0 and np.ptp(width) > 0
    return MeasureScore(
        name=name,
        unit=unit,
        size=len(size),
        covered=of_share(held, cluster),
        error=float(np.median(size)),
        width=float(np.median(width)),
        rank=float(stats.spearmanr(width, size).statistic) if varied else np.nan,
        area=area_of(width, size > LARGE) if unit == "degrees" else np.nan,
    )


def area_of(values: np.ndarray, wrong: np.ndarray) -> float:
    """How often a value `(n,)` of one that is `wrong` is above that of one that is not, ties
    counted half: the area under the receiver's curve (Mann & Whitney 1947). NaN where there are
    none of one kind."""
    number = int(wrong.sum())
    if not 0 < number < len(wrong):
        return np.nan
    ranks = stats.rankdata(values)[wrong].sum()
    return float((ranks - number * (number + 1) / 2) / (number * (len(wrong) - number)))
