"""Tables of people and cameras that were never seen: coverage by axis and by person."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from poseterior.inference.studies.person_views import LEVELS, Honesty
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, sheet_of, written

WAYS_OFF = ("to the side", "down", "in depth")


def honesty_table(found: Honesty, middle: str, gap: np.ndarray) -> Sheet:
    """By axis: how many truths the intervals cover, with an interval over people, their width, and
    the error of the mean, where joints are placed about a `middle`, which is detected a `gap`
    `(2,)` mm to the right and down beside the truth."""
    rows = [
        (
            name,
            *(_share(found, level, axis) for level in range(len(LEVELS))),
            found.ece[axis],
            found.width[axis],
            found.error[axis],
        )
        for axis, name in enumerate(WAYS_OFF)
    ]
    columns = [
        Column("limbs' joints", left=True),
        *(Column(f"{level:.0%} intervals cover", left=True) for level in LEVELS),
        Column("ECE", form=written("{:.3f}")),
        Column(f"{LEVELS[-1]:.0%} wide (mm)", form=written("{:.0f}")),
        Column("error of the mean (mm)", form=written("{:.0f}")),
    ]
    caption = (
        f"{found.silent} of {found.views} views say nothing: no draws, or no true {middle}."
        f" Detected {middle} lie {gap[0]:.0f} mm to the right of the true ones and"
        f" {gap[1]:.0f} mm below them in the image (medians): what is placed about them is off by"
        " as much."
    )
    title = f"People and cameras never seen, about the {middle}"
    return sheet_of(columns, rows, title=title, caption=caption)


def people_table(people: Mapping[str, Honesty]) -> Sheet:
    """By person, the worst first: views, and how many truths 95 % intervals cover by axis."""
    known = {name: np.nan_to_num(one.covered[1], nan=1.0).min() for name, one in people.items()}
    rows = [
        (name, people[name].views, *people[name].covered[1])
        for name in sorted(known, key=known.get)  # type: ignore[arg-type]
    ]
    axes = [Column(f"{axis} {LEVELS[-1]:.0%}", form=written("{:.0%}")) for axis in WAYS_OFF]
    return sheet_of([Column("person", left=True), Column("views", form=str), *axes], rows)


def honesty_json(
    found: Mapping[str, Honesty],
    people: Mapping[str, Mapping[str, Honesty]],
    gaps: Mapping[str, np.ndarray],
) -> dict[str, Any]:
    """The same as plain values, by what joints are placed about."""
    return {
        middle: _plain(one)
        | {"beside_truth": _values(gaps[middle])}
        | {"by_person": {name: _plain(own) for name, own in people[middle].items()}}
        for middle, one in found.items()
    }


def _plain(found: Honesty) -> dict[str, Any]:
    return {name: _values(value) for name, value in found._asdict().items()}


def _values(value: Any) -> Any:
    """Numbers, and None in the place of what is not known."""
    if isinstance(value, int):
        return value
    return [
        _values(row) if np.ndim(row) else (float(row) if np.isfinite(row) else None)
        for row in value
    ]


def _share(found: Honesty, level: int, axis: int) -> str:
    value, low, high = (part[level, axis] for part in (found.covered, found.low, found.high))
    return f"{value:.0%} ({low:.0%} to {high:.0%})" if np.isfinite(value) else NOTHING
