"""Tables of an evaluation, as Markdown, CSV, and on the screen: errors by action, missing joints,
metrics, relations.

A `Sheet` holds cells as they are (texts, numbers, estimates with intervals); how they look is
decided at the end."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import rich.table
from rich import box

from inference.studies.evaluation.bias import ANGLES, Bias
from inference.studies.evaluation.conditions import Condition
from inference.studies.evaluation.metrics import THRESHOLD
from inference.studies.evaluation.relations import Relation
from inference.studies.evaluation.scores import (
    Interval,
    Values,
    clustered,
    common,
    lost,
    pose_errors,
    summary,
    usable,
)

Cell = str | int | float | Interval | None
NOTHING = "–"
MOST_COLUMNS = 6
"""Of a table on a terminal."""
NAMES = {"akhter-black": "Akhter & Black", "zhou": "Zhou et al.", "dictionary": "dictionary fit"}
PAPER_TABLE_1 = {
    ("akhter-black", "single"): 134.48,
    ("akhter-black", 5): 109.79,
    ("zhou", "single"): 89.46,
    ("zhou", 5): 89.23,
    ("zhou", 20): 82.93,
    ("zhou", "all"): 67.99,
}
"""Mean errors of the paper's Table 1 in mm: Human3.6M, 2D by Stacked Hourglass. (Chen et al.:
153.51.)"""
PAPER_TABLE_2 = {"single": (116.11, 147.98, 175.04), 5: (98.24, 108.61, 122.32)}
"""Of its Table 2, Akhter & Black, true 2D, by missing joints 0, 1, 2."""


METRICS_CAPTION = (
    "Per pose: each frame's least mean error (the paper's best of k); per batch: one rank for all"
    " frames (P-Best); per joint: each joint's least error (J-Best). Unscaled: per pose by"
    " similarity alone, as others report. PCK, its area (to 150 mm) and CPS (all joints within t,"
    " to 300 mm) are of the per-pose choice. Flips: distinct depth flips of the eight limb bones."
    " Spread: root mean square distance of the draws from their mean. Possible: share of poses that"
    " break no limit, by construction 100 % of draws."
)
RELATIONS_CAPTION = (
    "Shares are 1 − after/before, millimetres a difference of gains; intervals: bootstrap of whole"
    " recordings. A relation holds, or does not, where the whole interval says so; otherwise it is"
    " undecided."
)


class Sheet(NamedTuple):
    """A table: the `name` of its file, `title`, `head`, `rows` and `caption`."""

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str

    def markdown(self) -> str:
        """As Markdown, with its title and caption."""
        lines = [
            self.head,
            ["---", *["---:"] * (len(self.head) - 1)],
            *([shown(c) for c in row] for row in self.rows),
        ]
        body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
        return f"### {self.title}\n\n{body}\n\n*{self.caption}*\n"

    def csv(self) -> str:
        """As CSV: numbers as they are, an estimate in three columns."""
        wide = [
            any(isinstance(row[column], Interval) for row in self.rows)
            for column in range(len(self.head))
        ]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(
            [
                text
                for name, three in zip(self.head, wide, strict=True)
                for text in ([name, f"{name} low", f"{name} high"] if three else [name])
            ]
        )
        for row in self.rows:
            writer.writerow(
                [
                    text
                    for cell, three in zip(row, wide, strict=True)
                    for text in _plain(cell, 3 if three else 1)
                ]
            )
        return out.getvalue()

    def narrow(self) -> "Sheet":
        """Without the columns between the first and the last two, where there are many."""
        if len(self.head) <= MOST_COLUMNS:
            return self
        return self._replace(
            head=[self.head[0], *self.head[-2:]], rows=[[row[0], *row[-2:]] for row in self.rows]
        )

    def screen(self) -> rich.table.Table:
        """For a terminal."""
        table = rich.table.Table(
            title=self.title,
            title_justify="left",
            caption=self.caption,
            caption_justify="left",
            box=box.SIMPLE_HEAD,
            title_style="bold",
            caption_style="dim",
        )
        for index, name in enumerate(self.head):
            table.add_column(name, justify="right" if index else "left")
        for row in self.rows:
            table.add_row(*(shown(cell) for cell in row))
        return table


def shown(cell: Cell) -> str:
    """A cell as people read it: one decimal place, an interval as ± half its width."""
    if isinstance(cell, Interval):
        if not np.isfinite(cell.value):
            return NOTHING
        return (
            f"{cell.value:.1f}"
            if not np.isfinite(cell.half)
            else f"{cell.value:.1f} ± {cell.half:.1f}"
        )
    if isinstance(cell, float):
        return f"{cell:.1f}" if np.isfinite(cell) else NOTHING
    return NOTHING if cell is None else f"{cell:,}" if isinstance(cell, int) else cell


def _plain(cell: Cell, columns: int) -> list[str]:
    values: list[Cell] = [*cell] if isinstance(cell, Interval) else [cell, *[None] * (columns - 1)]
    return [
        "" if v is None or (isinstance(v, float) and not np.isfinite(v)) else _number(v)
        for v in values
    ]


def _number(value: Cell) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def plain(cell: Cell) -> object:
    """A cell for JSON, which has no word for NaN."""
    if isinstance(cell, Interval):
        return {name: plain(value) for name, value in cell._asdict().items()}
    return None if isinstance(cell, float) and not np.isfinite(cell) else cell


def row_name(estimator: str, row: str | int) -> str:
    """A row of a condition in words."""
    name = NAMES.get(estimator, estimator)
    words = {"single": "single estimate", "all": "all samples"}
    return f"{name}, {words[row] if isinstance(row, str) else f'best of {row}'}"


def rows_of(ks: Sequence[int]) -> list[str | int]:
    """The rows of an estimator: single, k, all samples."""
    return ["single", *sorted(ks), "all"]


class Labels(NamedTuple):
    """Who does what in the frames of a data set `(N,)`."""

    action: np.ndarray
    recording: np.ndarray


def table_1(
    results: Mapping[Condition, Values],
    base: Condition,
    labels: Labels,
    ks: Sequence[int],
    external: Mapping[str, np.ndarray],
    caption: str,
) -> Sheet:
    """Errors by action. `external`: mean errors `(N,)` of others' predictions, by name."""
    actions = sorted(set(labels.action.tolist()))
    rows: list[list[Cell]] = []
    for estimator in dict.fromkeys(condition.estimator for condition in results):
        values = results[base._replace(estimator=estimator)]
        for row in rows_of(ks):
            errors = np.where(usable(values), pose_errors(values, row), np.nan)
            paper = PAPER_TABLE_1.get((estimator, row))
            rows.append([row_name(estimator, row), *_by_action(errors, labels, actions), paper])
    for name, errors in external.items():
        rows.append([name, *_by_action(errors, labels, actions), None])
    return Sheet(
        "table1",
        "Table 1: mean joint error by action, mm",
        ["", *actions, "average", "paper"],
        rows,
        caption,
    )


def _by_action(errors: np.ndarray, labels: Labels, actions: Sequence[str]) -> list[Cell]:
    """The mean of each action, and their mean with its interval."""
    there = np.isfinite(errors)
    means: list[Cell] = [
        float(errors[own].mean()) if (own := there & (labels.action == action)).any() else None
        for action in actions
    ]
    # Every action counts alike, as in the paper: its frames weigh what makes up for their number.
    sizes = {action: max(1, int((there & (labels.action == action)).sum())) for action in actions}
    weight = np.array([1.0 / sizes[action] for action in labels.action])[there]
    both = np.stack([errors[there] * weight, weight], axis=1)
    return [*means, clustered(both, labels.recording[there], lambda m: m[..., 0] / m[..., 1])]


def table_2(
    results: Mapping[Condition, Values], base: Condition, labels: Labels, k: int, caption: str
) -> Sheet:
    """Errors by number of missing joints, over the frames that all of them share."""
    levels = sorted({condition.missing for condition in results if condition.rotate == base.rotate})
    rows: list[list[Cell]] = []
    for estimator in dict.fromkeys(condition.estimator for condition in results):
        many = [results[Condition(estimator, level, base.rotate)] for level in levels]
        own = common(many)
        for row in ("single", k, "all"):
            cells: list[Cell] = [
                clustered(pose_errors(one, row)[own], labels.recording[own]) for one in many
            ]
            rows.append([row_name(estimator, row), *cells, int(own.sum())])
        if estimator == "akhter-black":
            for row in ("single", k):
                paper = dict(enumerate(PAPER_TABLE_2.get(row, ())))
                rows.append(
                    [
                        f"  the paper's: {row_name(estimator, row)}",
                        *(paper.get(level) for level in levels),
                        None,
                    ]
                )
    head = ["", *(f"{level} missing" for level in levels), "frames"]
    return Sheet(
        "table2", "Table 2: mean joint error with limb joints missing, mm", head, rows, caption
    )


def metrics_table(
    results: Mapping[Condition, Values], base: Condition, ks: Sequence[int], caption: str
) -> Sheet:
    """All metrics of the base condition, each under its own name."""
    head = [
        "",
        "per pose",
        "unscaled",
        "per batch",
        "per joint",
        f"PCK@{THRESHOLD:.0f} %",
        "area %",
        "CPS mm",
        "flips",
        "spread mm",
        "possible %",
    ]
    rows: list[list[Cell]] = []
    for estimator in dict.fromkeys(condition.estimator for condition in results):
        values = results[base._replace(estimator=estimator)]
        if not usable(values).any():
            continue
        for row in rows_of(ks):
            s = summary(values, row)
            rows.append(
                [
                    row_name(estimator, row),
                    s.per_pose,
                    s.unscaled,
                    s.per_batch,
                    s.per_joint,
                    100 * s.pck,
                    100 * s.pck_area,
                    s.cps,
                    s.flips,
                    s.spread,
                    100 * s.valid,
                ]
            )
    return Sheet("metrics", "Metrics", head, rows, caption)


def relations_table(found: Sequence[Relation], caption: str) -> Sheet:
    """The paper's relations and whether they hold."""
    rows: list[list[Cell]] = []
    for relation in found:
        factor, unit = (100.0, " %") if relation.unit == "share" else (1.0, " mm")
        value, low, high = (factor * part for part in relation.found)
        words = f"{value:+.1f}{unit} ({low:+.1f} to {high:+.1f})".replace("-", "−")
        rows.append([relation.words, relation.paper, words, relation.verdict, relation.frames])
    head = ["relation", "paper", "found (95 % interval)", "verdict", "frames"]
    return Sheet("relations", "The paper's relations", head, rows, caption)


def frames_table(results: Mapping[Condition, Values]) -> Sheet:
    """How many frames came to what end, and why some were lost."""
    rows: list[list[Cell]] = []
    for condition, values in results.items():
        gone = lost(values)
        why = "; ".join(f"{number} {status}" for status, number in gone.status.items()) or NOTHING
        reason = gone.reasons[0] if gone.reasons else NOTHING
        rows.append([condition.name, len(values["num_draws"]), gone.number, why, reason])
    caption = (
        "Lost: frames without enough draws for the largest k; they are in no row of their"
        " condition."
    )
    return Sheet(
        "frames",
        "Frames",
        ["condition", "frames", "lost", "how", "the first reason"],
        rows,
        caption,
    )


def pck_table(curves: Mapping[tuple[str, float, str], np.ndarray]) -> Sheet:
    """The curves, one column each."""
    head = ["mm", *(f"{name} {angle:g} {label}" for name, angle, label in curves)]
    rows: list[list[Cell]] = [
        [mm, *(float(v) for v in values)]
        for mm, values in enumerate(zip(*curves.values(), strict=True))
    ]
    return Sheet(
        "pck",
        "Share of joints within a distance",
        head,
        rows,
        "Best of k: the frame's best hypothesis.",
    )


def bias_tables(bias: Bias) -> list[Sheet]:
    """Likelihood of actions, and how much of the prior is visited."""
    actions: list[list[Cell]] = [
        [one.action, one.poses, one.mixture, one.uniform, 100 * one.possible]
        for one in bias.actions
    ]
    spread = [
        _range(one)
        for one in (
            [a.mixture.value for a in bias.actions],
            [a.uniform.value for a in bias.actions],
        )
    ]
    caption = (
        "Mean log likelihood, nats a pose above the mean of the actions. Gaussian mixture:"
        f" {bias.components} components fitted to the other half of {bias.poses:,} poses; from the"
        f" least to the most likely action it spans {spread[0]:.1f} nats, the uniform prior (by"
        f" area) {spread[1]:.1f}, of the poses it holds possible."
    )
    first = Sheet(
        "bias",
        "Bias: how likely the actions are",
        ["action", "poses", "Gaussian mixture", "uniform prior", "possible %"],
        actions,
        caption,
    )
    head = [
        "part",
        *(f"data within {angle:.0f}° %" for angle in ANGLES),
        *(f"prior itself within {angle:.0f}° %" for angle in ANGLES),
    ]
    rows: list[list[Cell]] = [
        [v.part, *(100 * s for s in v.data), *(100 * s for s in v.prior)] for v in bias.visits
    ]
    caption = (
        "Share of the prior's draws for which some pose of the data set has all bones of the part"
        " pointing within the angle; and for which one of as many other draws of the prior has."
    )
    return [
        first,
        Sheet("visits", "Bias: how much of the prior is ever visited", head, rows, caption),
    ]


def _range(values: Iterable[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return max(known) - min(known) if known else float("nan")
