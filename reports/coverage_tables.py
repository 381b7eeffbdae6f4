"""Calibration and coverage as tables: rows of texts first, which a terminal, a page and JSON show
alike."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.table import Table

from inference.studies.calibration.coverage import NOMINAL, CoverageSummary
from inference.studies.calibration.ece import Interval
from inference.studies.calibration.exclusions import LENGTH, LIMIT, TAU, Rank
from inference.studies.calibration.quantities import MOVING_NAMES
from inference.studies.calibration.verdict import Calibration
from reports.tables import spoken

WORST = 5
"""Quantities that are shown by name, smallest p-values first."""


class Rows(NamedTuple):
    """A table: its head, and rows of texts."""

    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def markdown(table: Rows) -> str:
    """The table for a page; all columns but the first are numbers."""
    lines: Iterable[Sequence[str]] = [
        table.head,
        ["---"] + ["---:"] * (len(table.head) - 1),
        *table.rows,
    ]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def terminal(table: Rows, title: str) -> Table:
    """The table for a terminal."""
    shown = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for number, heading in enumerate(table.head):
        shown.add_column(heading, justify="right" if number else "left", no_wrap=not number)
    for row in table.rows:
        shown.add_row(*row)
    return shown


def p_text(value: float) -> str:
    """A p-value in few digits; what is too small for a number is said so."""
    if value < 1e-300:
        return "< 1e-300"
    return f"{value:.2g}" if value < 0.01 else f"{value:.2f}"


def tests(calibration: Calibration) -> Rows:
    """The kinds of tests, then the quantities with the smallest p-values."""
    found = calibration.tests
    size = int(found["size"].max())
    rows = [
        (family, p_text(value), "", str(size)) for family, value in calibration.families.items()
    ]
    for number in np.argsort(found.p_value.values)[:WORST]:
        one = found.isel(quantity=int(number))
        rows.append(
            (
                f"  {spoken(str(one.quantity.item()))}",
                p_text(float(one.p_value)),
                p_text(float(one.adjusted)),
                str(int(one["size"])),
            )
        )
    return Rows(("test", "p", "p, corrected for all", "simulations"), rows)


def families(found: Mapping[str, Calibration]) -> Rows:
    """One row for each posterior, by name: p-values of the kinds of tests, and the verdict."""
    names = list(dict.fromkeys(family for one in found.values() for family in one.families))
    rows = []
    for name, one in found.items():
        values = [
            p_text(one.families[family]) if family in one.families else "–" for family in names
        ]
        rows.append((name, *values, str(int(one.tests["size"].max())), one.verdict))
    return Rows(("posterior", *names, "simulations", "verdict"), rows)


def tests_json(calibration: Calibration) -> dict[str, Any]:
    """The verdict, and every test, as plain values."""
    found = calibration.tests
    return {
        "verdict": calibration.verdict,
        "sentence": calibration.sentence,
        "false_alarm": found.attrs["false_alarm"],
        "failed": found.attrs["num_failed"],
        "families": calibration.families,
        "tests": [
            {
                "quantity": str(name),
                **{field: float(found[field].sel(quantity=name)) for field in found.data_vars},
            }
            for name in found.quantity.values
        ],
    }


def percent(interval: Interval) -> str:
    """A share with its interval."""
    return f"{interval.value:.0%} ({interval.low:.0%}–{interval.high:.0%})"


def by_joint(found: CoverageSummary) -> Rows:
    """Nominal against empirical coverage of each joint, to the side and in depth, with the field's
    ECE."""
    head = (
        "joint",
        *(f"{kind} {nominal:.0%}" for kind in ("lateral", "depth") for nominal in NOMINAL),
        "ECE",
    )
    rows = []
    for number, joint in enumerate(MOVING_NAMES):
        columns = [
            percent(found.by_joint[kind, nominal][number])
            for kind in ("lateral", "depth")
            for nominal in NOMINAL
        ]
        rows.append((spoken(joint), *columns, f"{found.ece.joint[number]:.3f}"))
    whole = [
        percent(found.covered[kind, nominal])
        for kind in ("lateral", "depth")
        for nominal in NOMINAL
    ]
    rows.append(("all", *whole, f"{found.ece.whole.value:.3f}"))
    return Rows(head, rows)


def briefly(found: CoverageSummary) -> Rows:
    """As `by_joint`, narrow enough for a terminal: intervals over all joints together only."""
    columns = [(kind, nominal) for kind in ("lateral", "depth") for nominal in NOMINAL]
    rows = [
        (spoken(joint), *(f"{found.by_joint[column][number].value:.0%}" for column in columns))
        for number, joint in enumerate(MOVING_NAMES)
    ]
    rows.append(("all", *(f"{found.covered[column].value:.0%}" for column in columns)))
    for side, words in (("low", "95 % interval from"), ("high", "to")):
        rows.append((words, *(f"{getattr(found.covered[column], side):.0%}" for column in columns)))
    return Rows(("joint", *(f"{kind} {nominal:.0%}" for kind, nominal in columns)), rows)


def grid(found: Mapping[tuple[str, ...], CoverageSummary], head: Sequence[str]) -> Rows:
    """One row for each setting, named by its key: coverage of 50 % and 95 % regions, exclusions,
    ECE and its floor, sharpness."""
    columns = (
        "lateral 50 %",
        "lateral 95 %",
        "depth 50 %",
        "depth 95 %",
        "ECE (its floor)",
        "truth excluded",
        "no draws",
        "spread lateral, depth (mm)",
        "log evidence",
        "poses",
    )
    rows = []
    for key, one in found.items():
        covered = [
            percent(one.covered[kind, nominal])
            for kind in ("lateral", "depth")
            for nominal in (0.5, 0.95)
        ]
        rows.append(
            (
                *key,
                *covered,
                (
                    f"{one.ece.whole.value:.3f} ({one.ece.whole.low:.3f}–{one.ece.whole.high:.3f};"
                    f" {one.ece.floor:.3f})"
                ),
                percent(one.excluded),
                str(one.without_draws),
                f"{one.lateral:.0f}, {one.depth:.0f}",
                f"{one.evidence:.1f}",
                str(one.size),
            )
        )
    return Rows((*head, *columns), rows)


def reasons(found: Sequence[Rank], size: int) -> Rows:
    """Why truths are excluded, commonest first, of `size` instances."""
    words = {LIMIT: "{:.1f}°", LENGTH: "{:.1%} of a length", TAU: "{:.2f} τ"}
    rows = []
    for rank in found:
        amounts = ", ".join(words[kind].format(much) for kind, much in rank.amounts.items()) or "–"
        rows.append(
            (rank.label, f"{rank.excluded} ({rank.excluded / size:.0%})", str(rank.alone), amounts)
        )
    return Rows(("reason", "excludes", "it alone", "by, in the median"), rows)


def summary_json(found: CoverageSummary) -> dict[str, Any]:
    """The summary as plain values."""

    def number(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    return {
        "poses": found.size,
        "coverage": [
            {
                "kind": kind,
                "nominal": nominal,
                "empirical": one.value,
                "low": one.low,
                "high": one.high,
            }
            for (kind, nominal), one in found.covered.items()
        ],
        "by_joint": [
            {"joint": MOVING_NAMES[row], "kind": kind, "nominal": nominal, "empirical": one.value}
            for (kind, nominal), many in found.by_joint.items()
            for row, one in enumerate(many)
        ],
        "ece": {
            "value": found.ece.whole.value,
            "low": found.ece.whole.low,
            "high": found.ece.whole.high,
            "floor": number(found.ece.floor),
            "joint": dict(zip(MOVING_NAMES, found.ece.joint.tolist(), strict=True)),
        },
        "spread_mm": {"lateral": number(found.lateral), "depth": number(found.depth)},
        "log_evidence": number(found.evidence),
        "without_draws": found.without_draws,
        "excluded": found.excluded.value,
        "reasons": [
            {"reason": one.label, "count": one.excluded, "alone": one.alone, "amounts": one.amounts}
            for one in found.reasons
        ],
    }
