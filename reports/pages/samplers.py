"""Baseline samplers on eight frames, each from two starts, judged by exact draws: writes
reports/samplers.md and its picture from what `reports.pages.contests` has left in a folder.

    python -m poseterior.reports.pages.samplers [WORK]
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.baselines.catalogue import BASELINES
from poseterior.reports.figures.comparison import comparison_figure
from poseterior.reports.pages.contests import CHECK, CLOCKED, CONTEST_WORK, LONGER, SUITE
from poseterior.reports.pages.page import Page, Values, Work, run
from poseterior.reports.tables import Column, Sheet, sheet_of
from poseterior.reports.tables.comparison import comparison_table

PICTURED = "all seen"
EVIDENCES = ("smc", "nss", "nautilus")
PATHLESS = ("nss", "nautilus")
"""Whose draws are no path, so that there is no pace at which they go on once they have settled."""
LABELS = (
    "rejection",
    *(f"{name}{start}" for name in BASELINES for start in ("", "-dispersed", "-one-flip")),
)
"""Names of the files of lines, in the order of the page."""


class Best(NamedTuple):
    """The best line of a frame by some measure, a second, how many times as many exact draws there
    are, and whether both are bounds."""

    value: float
    label: str
    ratio: float
    bound: bool


def joined(folder: Path) -> xr.DataTree | None:
    """The lines of one frame as one comparison; `exact_seconds` `(line, draws)` is how long exact
    rejection took beside each."""
    paths = (folder / f"{label}.nc" for label in LABELS)
    trees = [xr.open_datatree(path).load() for path in paths if path.exists()]
    if len(trees) < 2:
        return None
    labels = [str(tree["summary"].sampler.item()) for tree in trees]
    groups = {}
    for name in trees[0].children:
        parts = [tree[name].to_dataset() for tree in trees if name in tree.children]
        groups[name] = xr.concat(
            parts, "sampler", data_vars="minimal", coords="minimal", compat="override", join="outer"
        )
        if name != "modes":
            groups[name] = groups[name].reindex(sampler=labels)
    found = xr.DataTree.from_dict(groups)
    seconds = np.array(
        [[tree.attrs[f"exact_seconds_{draws}"] for draws in CLOCKED] for tree in trees]
    )
    least = min(tree.attrs["allowed"] for tree in trees[1:])
    found.attrs = {**trees[0].attrs, "exact_seconds": seconds, "allowed_least": least}
    return found


def exact_rates(tree: xr.DataTree) -> np.ndarray:
    """`(2,)`: exact draws a second for each of `CLOCKED`, median over the times beside the
    lines."""
    return np.array(CLOCKED) / np.median(tree.attrs["exact_seconds"], axis=0)


def summary(trees: Mapping[str, xr.DataTree]) -> Sheet:
    """One line a frame: exact rejection against the best baseline, whichever start, by either
    measure."""
    columns = (
        "frame",
        Column("d", form=str),
        "log evidence",
        Column("exact draws/s, of 10,000", form="{:,.0f}".format),
        Column("of 100,000", form="{:,.0f}".format),
        Column("best earned/s", "earned", _best),
        Column("ratio", "earned ratio", _ratio),
        Column("best settled/s", "settled", _best),
        Column("ratio", "settled ratio", _ratio),
        Column("exact: to 0.1 sd", form=_seconds),
        Column("first baseline", form=_seconds),
        "lines that differ",
    )
    return sheet_of(columns, [_summary_line(name, tree) for name, tree in trees.items()])


def _seconds(value: float) -> str:
    return "never" if np.isinf(value) else f"{value:.2g} s"


def _best(best: Best) -> str:
    return f"{'≤ ' * best.bound}{best.value:.3g} ({best.label})" if best.value else "none"


def _ratio(best: Best) -> str:
    return f"{'≥ ' * best.bound}{best.ratio:,.0f}" if best.value else "–"


def _summary_line(name: str, tree: xr.DataTree) -> list[Any]:
    found = tree["summary"].to_dataset()
    exact = found.isel(sampler=0)
    rest = found.isel(sampler=slice(1, None))
    few, many = exact_rates(tree)
    walks = rest.sel(sampler=~rest.sampler.isin(PATHLESS))
    earned = best_of(rest, "ess_per_second", many)
    settled = best_of(walks, "settled_per_second", many)
    differ = rest.verdict.values == "differs"
    judged = rest.verdict.values != "no draws"
    return [
        name,
        tree.attrs["dim"],
        float(tree.attrs["exact_log_evidence"]),
        few,
        many,
        *(earned, earned, settled, settled),
        float(exact.seconds_to_distance),
        float(np.min(rest.seconds_to_distance.values)),
        f"{differ.sum()} of {judged.sum()}",
    ]


def best_of(lines: xr.Dataset, measure: str, exact: float) -> Best:
    """The line with the largest of a measure, where there are `exact` draws a second."""
    best = lines.isel(sampler=int(np.argmax(lines[measure].values)))
    value = float(best[measure])
    bound = measure == "settled_per_second" and not float(best.time_known)
    return Best(value, str(best.sampler.item()), exact / value if value else np.nan, bound)


def evidences(trees: Mapping[str, xr.DataTree]) -> Sheet:
    """Evidence of those that know it, against the exact one; flagged beyond three standard errors
    of the difference."""
    rows = []
    for name, tree in trees.items():
        known = float(tree.attrs["exact_log_evidence"]), float(tree.attrs["exact_log_evidence_se"])
        found = tree["summary"].to_dataset()
        others = (_evidence(found, sampler, known) for sampler in EVIDENCES)
        rows.append([name, f"{known[0]:.2f} ± {known[1]:.2f}", *others])
    return sheet_of(("frame", "exact", *EVIDENCES), rows)


def _evidence(found: xr.Dataset, sampler: str, known: tuple[float, float]) -> str:
    if sampler not in found.sampler.values:
        return "–"
    one = found.sel(sampler=sampler)
    value = float(one.log_evidence)
    error = float(one.log_evidence_se)
    if np.isnan(value):
        return f"none in {float(one.seconds):.0f} s"
    off = (value - known[0]) / np.hypot(error, known[1])
    flag = f", **off by {off:+.1f} errors**" if abs(off) > 3 else ""
    return f"{value:.2f} ± {error:.2f}{flag}"


def samplers_of(tree: xr.DataTree) -> set[str]:
    """Names of the samplers that ran."""
    return {str(label).split(" (")[0] for label in tree["summary"].sampler.values}


def absent(trees: Mapping[str, xr.DataTree]) -> str:
    """A sentence that says which samplers have not been run on which frames; empty where all
    have."""
    parts = []
    for name, tree in trees.items():
        ran = samplers_of(tree)
        if left := [sampler for sampler in BASELINES if sampler not in ran]:
            parts.append(f"on *{name}* {', '.join(left)}")
    return f"Not run yet: {'; '.join(parts)}." if parts else ""


def values_of(trees: Mapping[str, xr.DataTree]) -> Values:
    """What fills the page, from the comparisons of the frames by name."""
    suite = {name: tree for name, tree in trees.items() if name != CHECK}
    ran = set().union(*map(samplers_of, trees.values()))
    notes = [f"- **{name}**: {row.note}" for name, row in BASELINES.items() if name in ran]
    tables = [f"### {name}\n\n{comparison_table(tree).markdown()}" for name, tree in suite.items()]
    return {
        "setup": "\n".join(notes),
        "summary": summary(suite),
        "check": comparison_table(trees[CHECK]),
        "evidence": evidences(trees),
        "tables": "\n\n".join(tables),
        "seconds": f"{min(tree.attrs['allowed_least'] for tree in trees.values()):g}",
        "absent": absent(trees),
        "patience": ", ".join(f"{name} {times}" for name, times in LONGER.items()),
    }


def main(work: Work = CONTEST_WORK) -> Page:
    """Writes the page and its picture from what is in the folder."""
    found = {name: joined(work / f"{number}") for number, name in enumerate(SUITE)}
    trees = {name: tree for name, tree in found.items() if tree is not None}
    return Page("samplers", values_of(trees), {"samplers": comparison_figure(trees[PICTURED])})


if __name__ == "__main__":
    run(main)
