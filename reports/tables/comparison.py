"""The judge's findings, one row a sampler.

*ESS* is that of the worst coordinate. *earned/s* are the effective draws beyond the exact ones that
the start was given, a second; *settled/s* are draws over their autocorrelation time, a second (≤
where paths are too short to know that time). *smallest p* is that of the tests, *missed* the share
of the mass in modes never visited, *would see* the smallest shift and widening of a coordinate, in
its standard deviations, that 90 % of runs would have caught by so many effective draws, *depth off*
the largest W1 of a joint's depth for a person of 1.7 m, and *to 0.1 sd* the seconds until the
sliced Wasserstein distance falls below 0.1 standard deviations.
"""

import xarray as xr

from poseterior.inference.studies.comparison.judge import AGREES, UNMIXED
from poseterior.inference.studies.comparison.mixing import CHAINS_APART
from poseterior.probmodel.body import MILLIMETRES
from poseterior.reports.tables.sheet import (
    NOTHING,
    Column,
    Record,
    Sheet,
    fixed,
    number,
    significant,
    written,
)

NARROW = ("sampler", "verdict", "ESS", "earned/s", "R-hat", "missed", "depth off")
"""The columns that matter most, for a narrow terminal."""
WIDE = 120
"""Characters that all columns need."""


def comparison_table(tree: xr.DataTree) -> Sheet:
    """The table of a `comparison.nc`; its records hold the whole summary."""
    summary = tree["summary"].to_dataset()
    records = []
    for label in map(str, summary.sampler.values):
        own = summary.sel(sampler=label)
        record: dict[str, object] = {"sampler": label}
        record |= {str(name): _plain(own[name].item()) for name in summary.data_vars}
        # In the record too, for who reads no table.
        records.append(record | _worst(tree, label) | {"by_its_start": gift_sentence(record)})
    gifts = [str(record["by_its_start"]) for record in records if record["by_its_start"]]
    return Sheet(COMPARED_COLUMNS, records, caption=". ".join(gifts))


def gift_sentence(record: Record) -> str:
    """The sentence without which it would mislead to say that a sampler agrees: that it has, for
    the most part, what it was given.

    Parameters
    ----------
    record
        With `sampler`, its `verdict`, its `start` (empty where no exact draws were given),
        `ess_worst`, `ess_per_second` (those earned), `seconds` and `rhat_worst`.

    Returns
    -------
    str
        Empty where it does not agree, was given nothing, or has earned more than it was given and
        its chains are one sample.
    """
    if record["verdict"] not in (AGREES, UNMIXED) or not record["start"]:
        return ""
    earned = (record["ess_per_second"] or 0.0) * record["seconds"]
    apart = record["rhat_worst"]
    worth = record["ess_worst"]
    far = apart is not None and apart > CHAINS_APART
    if earned >= worth / 2 and not far:
        return ""
    said = f", and R-hat {apart:.2f} says that its chains are still far apart" if far else ""
    return (
        f"{record['sampler']} agrees because it was started in exact draws: of its {worth:,.0f}"
        f" effective draws it has earned {earned:,.0f}{said}"
    )


def _worst(tree: xr.DataTree, label: str) -> dict[str, object]:
    if "tests" not in tree.children:
        return {"smallest_p": None, "depth_mm": None}
    tests = tree["tests"].p_value.sel(sampler=label)
    decisive = tests.sel(test=[name for name in tests.test.values if name != "C2ST"])
    depth = tree["joints"].w1_depth.sel(sampler=label).max().item() * MILLIMETRES
    return {"smallest_p": number(decisive.min().item()), "depth_mm": number(depth)}


def _plain(value: object) -> object:
    return number(value) if isinstance(value, float) else value


def _count(value: float | None) -> str:
    if not value:
        return NOTHING
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def _settled(record: Record) -> str:
    pace = _count(record["settled_per_second"])
    return pace if record["time_known"] or pace == NOTHING else f"≤ {pace}"


def _reached(record: Record) -> str:
    if record["verdict"] == "no draws":
        return NOTHING
    seconds = record["seconds_to_distance"]
    return "never" if seconds is None else significant(2, " s")(seconds)


def _evidence(record: Record) -> str:
    value = record["log_evidence"]
    error = record["log_evidence_se"]
    return NOTHING if value is None else f"{value:.2f} ± {error:.2f}"


def _seen(record: Record) -> str:
    shift, spread = record.get("seen_shift"), record.get("seen_spread")
    return NOTHING if shift is None or spread is None else f"{shift:.2f} sd, {spread:.0%}"


COMPARED_COLUMNS: tuple[Column, ...] = (
    Column("sampler", left=True, whole=True),
    Column("verdict", left=True, whole=True),
    Column("ESS", "ess_worst", _count),
    Column("earned/s", "ess_per_second", _count),
    Column("settled/s", _settled),
    Column("R-hat", "rhat_worst", fixed(2)),
    Column("smallest p", "smallest_p", significant(2)),
    Column("missed", "missed_mass", written("{:.1%}")),
    Column("would see", _seen),
    Column("depth off", "depth_mm", fixed(0, " mm")),
    Column("to 0.1 sd", _reached),
    Column("log evidence", _evidence),
)
