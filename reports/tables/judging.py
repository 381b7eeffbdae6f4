"""Tables of the verdict on anybody's posterior."""

from typing import Any

import numpy as np

from poseterior.inference.studies.judging.judge import Judged
from poseterior.inference.studies.judging.where import SHOWN
from poseterior.reports.tables.coverage import calibration_json, p_text, share
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, sheet_of

MOST_ROWS = 12
"""Quantities that are shown, those of the smallest p-values."""


def covered_table(found: Judged) -> Sheet:
    """What each quantity's central intervals hold, and its rank test; then the tests of all
    together."""
    p_value = dict(zip(found.calibration.tests.quantity.values.tolist(),
                       found.calibration.tests.p_value.values.tolist(), strict=True))
    own = sorted(found.covered, key=p_value.__getitem__)[:MOST_ROWS]
    rows: list[tuple] = [
        (name, *map(share, found.covered[name]), p_text(p_value[name]))
        for name in found.covered if name in own
    ]
    blank = [NOTHING] * len(SHOWN)
    rows += [(name, *blank, p_text(value)) for name, value in found.calibration.families.items()]
    if found.local is not None:
        rows.append(("where (trees of splits)", *blank, p_text(found.local.p_value)))
    head = [Column("", left=True), *(Column(f"{nominal:.0%}") for nominal in SHOWN), Column("p")]
    return sheet_of(head, rows, title="What central intervals hold")


def map_table(found: Judged) -> Sheet:
    """Coverage of 50 % intervals of the quantity that fails most, by bins of each covariate."""
    assert found.map is not None
    quantity = worst(found)
    rows = []
    for covariate in found.map.covariate.values:
        part = found.map.sel(covariate=covariate, quantity=quantity)
        for place, words in enumerate(part.words.values):
            if words:
                at = part.isel(bin=place)
                rows.append((str(covariate), str(words), *(
                    f"{float(at.share.sel(nominal=nominal)):.0%}"
                    f" ({float(at.low.sel(nominal=nominal)):.0%}–"
                    f"{float(at.high.sel(nominal=nominal)):.0%})"
                    for nominal in SHOWN
                )))
    head = [Column("covariate", left=True), Column("", left=True)]
    head += [Column(f"{nominal:.0%}") for nominal in SHOWN]
    return sheet_of(head, rows, title=f"Where: {quantity}")


def worst(found: Judged) -> str:
    """The quantity that the map shows: that of the test of where, or of the least p-value."""
    if found.local is not None:
        return found.local.quantity
    tests = found.calibration.tests.sel(quantity=list(found.covered))
    return str(tests.quantity.values[int(np.argmin(tests.p_value.values))])


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
            name: [one._asdict() | {"nominal": nominal}
                   for nominal, one in zip(SHOWN, intervals, strict=True)]
            for name, intervals in found.covered.items()
        },
        "local": local,
        "notes": list(found.notes),
    }
