"""Tables of calibration and coverage."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from poseterior.inference.studies.calibration.coverage import NOMINAL, CoverageSummary
from poseterior.inference.studies.calibration.ece import Ece, Interval
from poseterior.inference.studies.calibration.exclusions import LENGTH, LIMIT, TAU, Rank
from poseterior.inference.studies.calibration.quantities import MOVING_NAMES
from poseterior.inference.studies.calibration.verdict import Calibration
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, number, sheet_of
from poseterior.reports.tables.words import spoken

WORST = 5
"""Quantities that are shown by name, smallest p-values first."""
COVERED = [(kind, nominal) for kind in ("lateral", "depth") for nominal in NOMINAL]
"""The kinds of regions, in the order of the columns."""


def p_text(value: float | None) -> str:
    """Writes a p-value in few digits; one that is too small for a number is said to be so."""
    if value is None:
        return NOTHING
    if value < 1e-300:
        return "< 1e-300"
    return f"{value:.2g}" if value < 0.01 else f"{value:.2f}"


def share(interval: Interval) -> str:
    """Writes a share with its interval."""
    return f"{interval.value:.0%} ({interval.low:.0%}–{interval.high:.0%})"


def uniformity_table(calibration: Calibration) -> Sheet:
    """The kinds of tests, then the quantities with the smallest p-values."""
    found = calibration.tests
    size = int(found["size"].max())
    rows: list[tuple] = [
        (family, p_text(value), "", str(size)) for family, value in calibration.families.items()
    ]
    for index in np.argsort(found.p_value.values)[:WORST]:
        one = found.isel(quantity=int(index))
        name = f"  {spoken(str(one.quantity.item()))}"
        p_values = (p_text(float(one[kind])) for kind in ("p_value", "adjusted"))
        rows.append((name, *p_values, str(int(one["size"]))))
    head = ("test", "p", "p, corrected for all", "simulations")
    return sheet_of(head, rows, title="Are the ranks uniform?")


def families_table(found: Mapping[str, Calibration]) -> Sheet:
    """Each posterior, by name: p-values of the kinds of tests, and the verdict."""
    names = list(dict.fromkeys(family for one in found.values() for family in one.families))
    rows = [
        (
            name,
            *(one.families.get(family) for family in names),
            int(one.tests["size"].max()),
            one.verdict,
        )
        for name, one in found.items()
    ]
    families = [Column(family, form=p_text) for family in names]
    verdict = Column("verdict", left=True)
    return sheet_of(["posterior", *families, Column("simulations", form=str), verdict], rows)


def calibration_json(calibration: Calibration) -> dict[str, Any]:
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


def joints_table(found: CoverageSummary) -> Sheet:
    """Nominal against empirical coverage of each joint, to the side and in depth, with the field's
    ECE."""
    rows = [
        (
            spoken(joint),
            *(found.by_joint[region][index] for region in COVERED),
            float(found.ece.joint[index]),
        )
        for index, joint in enumerate(MOVING_NAMES)
    ]
    rows.append(("all", *(found.covered[region] for region in COVERED), found.ece.whole.value))
    regions = [Column(head, form=share) for head in _heads()]
    return sheet_of(["joint", *regions, Column("ECE", form="{:.3f}".format)], rows)


def brief_table(found: CoverageSummary) -> Sheet:
    """As `joints_table`, narrow enough for a terminal: intervals over all joints together only."""
    rows: list[tuple] = [
        (spoken(joint), *(found.by_joint[region][index].value for region in COVERED))
        for index, joint in enumerate(MOVING_NAMES)
    ]
    for words, field in (("all", "value"), ("95 % interval from", "low"), ("to", "high")):
        rows.append((words, *(getattr(found.covered[region], field) for region in COVERED)))
    regions = [Column(head, form="{:.0%}".format) for head in _heads()]
    joint = Column("joint", whole=True)
    return sheet_of([joint, *regions], rows, title="Covered, nominally and in truth")


def _heads() -> list[str]:
    return [f"{kind} {nominal:.0%}" for kind, nominal in COVERED]


def settings_table(
    found: Iterable[tuple[Sequence[str], CoverageSummary]], head: Sequence[str]
) -> Sheet:
    """Each setting, named by its key under `head`: coverage of 50 % and 95 % regions, ECE and its
    floor, exclusions, sharpness."""
    regions = [(kind, nominal) for kind in ("lateral", "depth") for nominal in (0.5, 0.95)]
    rows = [
        (
            *key,
            *(one.covered[region] for region in regions),
            one.ece,
            one.excluded,
            one.without_draws,
            f"{one.lateral:.0f}, {one.depth:.0f}",
            one.evidence,
            one.size,
        )
        for key, one in found
    ]
    columns = [
        *(Column(one, left=True) for one in head),
        *(Column(f"{kind} {100 * nominal:.0f} %", form=share) for kind, nominal in regions),
        Column("ECE (its floor)", form=_ece),
        Column("truth excluded", form=share),
        Column("no draws"),
        Column("spread lateral, depth (mm)"),
        Column("log evidence"),
        Column("poses"),
    ]
    return sheet_of(columns, rows)


def _ece(found: Ece) -> str:
    whole = found.whole
    return f"{whole.value:.3f} ({whole.low:.3f}–{whole.high:.3f}; {found.floor:.3f})"


def reasons_table(found: Sequence[Rank], size: int) -> Sheet:
    """Why truths are excluded, commonest first, of `size` instances."""
    rows = [
        (rank.label, f"{rank.excluded} ({rank.excluded / size:.0%})", rank.alone, _amounts(rank))
        for rank in found
    ]
    return sheet_of(("reason", "excludes", "it alone", "by, in the median"), rows, title="Why")


def _amounts(rank: Rank) -> str:
    words = {LIMIT: "{:.1f}°", LENGTH: "{:.1%} of a length", TAU: "{:.2f} τ"}
    parts = [words[kind].format(much) for kind, much in rank.amounts.items()]
    return ", ".join(parts) or NOTHING


def summary_json(found: CoverageSummary) -> dict[str, Any]:
    """The summary as plain values."""
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
