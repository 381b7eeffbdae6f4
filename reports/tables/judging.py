"""Tables of the verdict on anybody's posterior."""

from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.studies.intervals import Interval
from poseterior.inference.studies.judging.judge import Judged
from poseterior.inference.studies.judging.repair import NO_POSTERIOR, Recalibration
from poseterior.inference.studies.judging.where import SHOWN
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.tables.coverage import calibration_json, p_text, share
from poseterior.reports.tables.posterior import values
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, number, sheet_of

RECALIBRATED = (0.5, 0.95)
MOST_ROWS = 12
"""Quantities that are shown, those of the smallest p-values."""


def covered_table(found: Judged) -> Sheet:
    """What each quantity's central intervals hold, and its rank test; then the tests of all
    together."""
    p_value = dict(
        zip(
            found.calibration.tests.quantity.values.tolist(),
            found.calibration.tests.p_value.values.tolist(),
            strict=True,
        )
    )
    own = sorted(found.covered, key=p_value.__getitem__)[:MOST_ROWS]
    rows: list[tuple] = [
        (name, *map(share, found.covered[name]), p_text(p_value[name]))
        for name in found.covered
        if name in own
    ]
    blank = [NOTHING] * len(SHOWN)
    rows += [(name, *blank, p_text(value)) for name, value in found.calibration.families.items()]
    if found.local is not None:
        rows.append(("where (trees of splits)", *blank, found.local.p_words.removeprefix("= ")))
    head = [Column("", left=True), *(Column(f"{nominal:.0%}") for nominal in SHOWN), Column("p")]
    return sheet_of(head, rows, title="What central intervals hold")


def map_table(found: Judged) -> Sheet:
    """Coverage of the `worst` quantity's intervals, by bins of each covariate."""
    assert found.map is not None
    quantity = worst(found)
    rows = []
    for covariate in found.map.covariate.values:
        part = found.map.sel(covariate=covariate, quantity=quantity)
        for place, words in enumerate(part.words.values):
            at = part.isel(bin=place)
            if words and np.isfinite(at.share.values).all():  # of a bin whose truths are known
                held = (at.sel(nominal=nominal) for nominal in SHOWN)
                shares = (Interval(*map(float, (one.share, one.low, one.high))) for one in held)
                rows.append((str(covariate), str(words), *map(share, shares)))
    head = [Column("covariate", left=True), Column("", left=True)]
    head += [Column(f"{nominal:.0%}") for nominal in SHOWN]
    return sheet_of(head, rows, title=f"Where: {quantity}")


def worst(found: Judged) -> str:
    """The quantity that the map shows: that of the test of where, or of the least p-value."""
    if found.local is not None:
        return found.local.quantity
    tests = found.calibration.tests.sel(quantity=list(found.covered))
    return str(tests.quantity.values[int(np.argmin(tests.p_value.values))])


def recalibrated_table(tree: xr.DataTree, repair: Recalibration) -> Sheet:
    """Intervals of joints' coordinates, those of the draws and recalibrated ones, body units.
    Raises `BadInput` where the recalibration knows no coordinate, or is by groups."""
    if repair.covariate:
        raise BadInput(
            f"the recalibration is by {repair.covariate}, which a posterior does not have; make"
            " one of all instances together, or ask Recalibration.interval in Python"
        )
    joints = values(tree, "posterior", "joints")
    records = []
    for joint, name in enumerate(JOINTS):
        for axis, letter in enumerate("xyz"):
            if (quantity := f"{name} {letter}") in repair.quantities:
                draws = joints[:, joint, axis]
                held = {
                    f"{nominal:.0%}": [
                        number(end) for end in repair.interval(draws, quantity, nominal)
                    ]
                    for nominal in RECALIBRATED
                }
                own = [float(end) for end in np.quantile(draws, [0.025, 0.975])]
                records.append({"quantity": quantity, "posterior 95%": own} | held)
    if not records:
        raise BadInput(
            "the recalibration knows no joint's coordinate, such as right_wrist z, only"
            f" {', '.join(repair.quantities[:5])}; make one of a coverage.nc of poses"
        )
    head = [Column("coordinate", "quantity", left=True)]
    head += [Column(name, name, _ends) for name in ("posterior 95%", "50%", "95%")]
    return Sheet(head, records, "Recalibrated intervals", f"{NO_POSTERIOR}. Body units.")


def _ends(ends: list[float | None]) -> str:
    low, high = ("∞" if end is None else f"{end:+.2f}" for end in ends)
    return f"{'−' if low == '∞' else ''}{low} … {high}"


def judged_json(found: Judged) -> dict[str, Any]:
    """The verdict as plain values."""
    local = found.local and {
        "p_value": found.local.p_value,
        "quantity": found.local.quantity,
        "where": found.local.leaf.words,
        "size": int(found.local.leaf.inside.sum()),
        "covered": found.local.covered._asdict(),
        "elsewhere": found.local.elsewhere._asdict(),
        "sentence": found.local.sentence,
    }
    return {
        **calibration_json(found.calibration),
        "verdict": found.verdict,
        "sentence": found.sentence,
        "covered": {
            name: [
                one._asdict() | {"nominal": nominal}
                for nominal, one in zip(SHOWN, intervals, strict=True)
            ]
            for name, intervals in found.covered.items()
        },
        "local": local,
        "notes": list(found.notes),
    }
