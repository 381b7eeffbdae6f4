"""How joint angles, lengths and steps are covered: posteriors against the truth."""

from collections.abc import Mapping, Sequence

import numpy as np

from poseterior.inference.studies.measured import LARGE, MeasureScore
from poseterior.reports.tables.measures import DIGITS, SIGNS
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, percents, sheet_of
from poseterior.reports.tables.words import spoken

SCORES_CAPTION = (
    "Covered: how often central 95 % intervals hold the truth, with its 95 % interval over"
    " recordings. Error of the posterior mean and width of the intervals: medians. Rank: Spearman's"
    f" correlation of width and error. Area: how well the width tells errors above {LARGE:g}° from"
    " the others (0.5: not at all)."
)


def measure_scores_table(
    found: Mapping[str, Sequence[MeasureScore]],
    *,
    title: str = "Measures",
    caption: str = SCORES_CAPTION,
) -> Sheet:
    """Each measure of every way, by name; with one way, that has no column."""
    several = len(found) > 1
    rows = [
        [
            f"{way}, {spoken(one.name)}" if several else spoken(one.name),
            one.covered,
            _number(one.error, one.unit),
            _number(one.width, one.unit),
            one.rank,
            one.area,
            one.size,
        ]
        for way, scores in found.items()
        for one in scores
    ]
    covered = Column("covered", form=percents, whole=True)
    numbers = [Column(head, form=_two) for head in ("rank", "area")]
    head: list[str | Column] = ["measure", covered, "error", "width", *numbers, "of"]
    return sheet_of(head, rows, name="measures", title=title, caption=caption)


def _number(value: float, unit: str) -> str:
    return f"{value:.{DIGITS[unit]}f}{SIGNS[unit]}"


def _two(value: float) -> str:
    return f"{value:.2f}".replace("-", "−") if np.isfinite(value) else NOTHING
