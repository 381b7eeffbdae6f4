"""The judge's findings as a table, as plain values, and as Markdown."""

import math

import rich.box
import rich.table
import xarray as xr

from inference.studies.comparison.distances import MILLIMETRES

COLUMNS = (
    "sampler",
    "verdict",
    "ESS",
    "earned/s",
    "settled/s",
    "R-hat",
    "smallest p",
    "missed",
    "depth off",
    "to 0.1 sd",
    "log evidence",
)
NARROW = ("sampler", "verdict", "ESS", "earned/s", "R-hat", "missed", "depth off")
WIDE = 120


def rows(tree: xr.DataTree) -> list[list[str]]:
    """One row a sampler, in the order of `COLUMNS`: effective draws of the worst coordinate, those
    beyond the exact draws of the start a second, those by the autocorrelation time a second (≤
    where paths are too short), largest R-hat, smallest p-value of the tests, share of the mass in
    modes never visited, largest W1 of a joint's depth for a person of 1.7 m, seconds until the
    sliced Wasserstein distance is 0.1 standard deviations."""
    return [[found[column] for column in COLUMNS] for found in map(_row, comparison_json(tree))]


def comparison_json(tree: xr.DataTree) -> list[dict]:
    """The summary as plain values, None where there is none."""
    summary = tree["summary"].to_dataset()
    found = []
    for label in summary.sampler.values:
        line = {name: _plain(summary[name].sel(sampler=label).item()) for name in summary.data_vars}
        found.append({"sampler": str(label), **line, **_worst(tree, str(label))})
    return found


def _worst(tree: xr.DataTree, label: str) -> dict:
    if "tests" not in tree.children:
        return {"smallest_p": None, "depth_mm": None}
    tests = tree["tests"].p_value.sel(sampler=label)
    decisive = tests.sel(test=[name for name in tests.test.values if name != "C2ST"]).min().item()
    depth = tree["joints"].w1_depth.sel(sampler=label).max().item() * MILLIMETRES
    return {"smallest_p": _plain(decisive), "depth_mm": _plain(depth)}


def _plain(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _row(line: dict) -> dict[str, str]:
    return {
        "sampler": line["sampler"],
        "verdict": line["verdict"],
        "ESS": _number(line["ess_worst"]),
        "earned/s": _number(line["ess_per_second"]),
        "settled/s": _settled(line),
        "R-hat": "–" if line["rhat_worst"] is None else f"{line['rhat_worst']:.2f}",
        "smallest p": "–" if line["smallest_p"] is None else f"{line['smallest_p']:.2g}",
        "missed": "–" if line["missed_mass"] is None else f"{line['missed_mass']:.1%}",
        "depth off": "–" if line["depth_mm"] is None else f"{line['depth_mm']:.0f} mm",
        "to 0.1 sd": _reached(line),
        "log evidence": "–" if line["log_evidence"] is None else _evidence(line),
    }


def _reached(line: dict) -> str:
    if line["verdict"] == "no draws":
        return "–"
    return (
        "never" if line["seconds_to_distance"] is None else f"{line['seconds_to_distance']:.2g} s"
    )


def _settled(line: dict) -> str:
    found = _number(line["settled_per_second"])
    return found if line["time_known"] or found == "–" else f"≤ {found}"


def _number(value: float | None) -> str:
    if not value:
        return "–"
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def _evidence(line: dict) -> str:
    return f"{line['log_evidence']:.2f} ± {line['log_evidence_se']:.2f}"


def comparison_table(tree: xr.DataTree, width: int) -> rich.table.Table:
    """The table for a terminal of so many characters; a narrow one gets the columns that matter
    most."""
    columns = COLUMNS if width >= WIDE else NARROW
    table = rich.table.Table(box=rich.box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in columns:
        table.add_column(name, no_wrap=name in ("sampler", "verdict"))
    for row in rows(tree):
        found = dict(zip(COLUMNS, row, strict=True))
        table.add_row(*(found[name] for name in columns))
    return table


def markdown(tree: xr.DataTree) -> str:
    """The table for a page."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "| --- " * len(COLUMNS) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows(tree))])
