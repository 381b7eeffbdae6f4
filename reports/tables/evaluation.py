"""Tables of an evaluation: errors by action, missing joints, metrics, relations."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from poseterior.inference.studies.evaluation.conditions import Condition, alike
from poseterior.inference.studies.evaluation.metrics import PCK_MM
from poseterior.inference.studies.evaluation.relations import Relation
from poseterior.inference.studies.evaluation.samples import BESTS
from poseterior.inference.studies.evaluation.scores import (
    Interval,
    SampleScores,
    Values,
    clustered,
    common,
    lost,
    pose_errors,
    sample_scores,
    summary,
    usable,
)
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, percents, sheet_of

PAPERS_FRAMES = 26_385
"""Of the paper's evaluation on Human3.6M."""
MOST_COLUMNS = 6
"""Of a table on a terminal."""
ESTIMATOR_NAMES = {
    "akhter-black": "Akhter & Black",
    "zhou": "Zhou et al.",
    "dictionary": "dictionary fit",
}
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


BEST_CAPTION = (
    "Per pose: each frame's least mean error over 15 joints among its first N samples, in random"
    " order, mean over frames. Root-aligned: the pelvises are one point, nothing else is moved, and"
    " a body unit is the person's true mean limb length. Procrustes: moved, turned and scaled."
    " Others' predictions are taken in the order of their file; root-aligned only if they are in"
    " millimetres. Under the true root torso and camera are the truth's own."
)
CALIBRATION_CAPTION = (
    "ECE: Pierzchlewicz et al. (2022), of 200 samples, all joints but the pelvis; its floor is what"
    " a right posterior has with as many frames. x, y, depth: how often central 95 % intervals hold"
    " the coordinates of elbows, wrists, knees and ankles, pelvis at the origin; beyond all: share"
    " of these that lie beyond every sample. Where the truth itself errs, as what other cameras"
    " triangulate does, samples are given such errors. In brackets 95 % intervals over recordings."
    " Published"
    " ECE on Human3.6M: Sharma 0.36, Wehrbein 0.18, cGNF 0.08, all rooted at the true pelvis."
)
SHARPNESS_CAPTION = (
    "2D error: mean distance of samples of seen joints from the truth in the image, at the person's"
    " distance. Width: of the 95 % intervals of limb joints. Effective roots: median over frames."
)


def row_name(way: Condition, row: str | int) -> str:
    """A row of a condition in words; beside a root that depends on no estimator stands an
    estimator's single estimate."""
    if row == "single" and way.root != CANDIDATES:
        return f"{way.way} ({ESTIMATOR_NAMES.get(way.estimator, way.estimator)}, single estimate)"
    words = {"single": "single estimate", "all": "all samples"}
    name = ESTIMATOR_NAMES.get(way.way, way.way)
    return f"{name}, {words[row] if isinstance(row, str) else f'best of {row}'}"


def rows_of(ks: Sequence[int]) -> list[str | int]:
    """The rows of an estimator: single, k, all samples."""
    return ["single", *sorted(ks), "all"]


class Labels(NamedTuple):
    """Who does what in the frames of a data set `(N,)`."""

    action: np.ndarray
    recording: np.ndarray


def narrow(sheet: Sheet) -> Sheet:
    """For a terminal: of many columns only the first and the last two."""
    head = sheet.head
    return sheet if len(head) <= MOST_COLUMNS else sheet.only([head[0], *head[-2:]])


def table_1(
    results: Mapping[Condition, Values],
    base: Condition,
    labels: Labels,
    ks: Sequence[int],
    external: Mapping[str, np.ndarray],
    caption: str,
) -> Sheet:
    """Errors by action.

    Parameters
    ----------
    results
        What came out of every frame, by condition.
    base
        The condition whose rows are shown, for every estimator and root.
    labels
        Actions and recordings of the frames.
    ks
        Numbers of hypotheses.
    external
        Mean errors `(N,)` of others' predictions, in mm, by name.
    caption
        What the numbers are of.
    """
    actions = sorted(set(labels.action.tolist()))
    rows: list[list[Any]] = []
    for way in alike(results, base):
        values = results[way]
        for row in rows_of(ks):
            errors = np.where(usable(values), pose_errors(values, row), np.nan)
            paper = PAPER_TABLE_1.get((way.way, row))
            rows.append([row_name(way, row), *_by_action(errors, labels, actions), paper])
    rows += [
        [name, *_by_action(errors, labels, actions), None] for name, errors in external.items()
    ]
    title = "Table 1: mean joint error by action, mm"
    head = ["", *actions, "average", "paper"]
    return sheet_of(head, rows, name="table1", title=title, caption=caption)


def _by_action(
    errors: np.ndarray, labels: Labels, actions: Sequence[str]
) -> list[float | Interval | None]:
    """The mean of each action, and their mean with its interval."""
    there = np.isfinite(errors)
    own = {action: there & (labels.action == action) for action in actions}
    means = [float(errors[rows].mean()) if rows.any() else None for rows in own.values()]
    # Every action counts alike, as in the paper: its frames weigh what makes up for their number.
    sizes = {action: max(1, int(rows.sum())) for action, rows in own.items()}
    weight = np.array([1.0 / sizes[action] for action in labels.action])[there]
    both = np.stack([errors[there] * weight, weight], axis=1)
    return [*means, clustered(both, labels.recording[there], lambda m: m[..., 0] / m[..., 1])]


def table_2(
    results: Mapping[Condition, Values], base: Condition, labels: Labels, k: int, caption: str
) -> Sheet:
    """Errors by number of missing joints, over the frames that all of them share."""
    levels = sorted({condition.missing for condition in results if condition.rotate == base.rotate})
    rows: list[list[Any]] = []
    for way in alike(results, base):
        many = [results[way._replace(missing=level)] for level in levels]
        own = common(many)
        recording = labels.recording[own]
        for row in ("single", k, "all"):
            errors = (clustered(pose_errors(one, row)[own], recording) for one in many)
            rows.append([row_name(way, row), *errors, int(own.sum())])
        if way.way == "akhter-black":
            for row in ("single", k):
                paper = dict(enumerate(PAPER_TABLE_2.get(row, ())))
                name = f"  the paper's: {row_name(way, row)}"
                rows.append([name, *(paper.get(level) for level in levels), None])
    title = "Table 2: mean joint error with limb joints missing, mm"
    head = ["", *(f"{level} missing" for level in levels), "frames"]
    return sheet_of(head, rows, name="table2", title=title, caption=caption)


def metrics_table(results: Mapping[Condition, Values], base: Condition, ks: Sequence[int]) -> Sheet:
    """All metrics of the base condition, each under its own name."""
    rows: list[list[Any]] = []
    for way in alike(results, base):
        values = results[way]
        for row in rows_of(ks) if usable(values).any() else ():
            found = summary(values, row)
            in_percent = {name: 100 * getattr(found, name) for name in ("pck", "pck_area", "valid")}
            rows.append([row_name(way, row), *found._replace(**in_percent)])
    head = [
        "",
        "per pose",
        "unscaled",
        "per batch",
        "per joint",
        f"PCK@{PCK_MM:.0f} %",
        "area %",
        "CPS mm",
        "flips",
        "spread mm",
        "possible %",
    ]
    return sheet_of(head, rows, name="metrics", title="Metrics", caption=METRICS_CAPTION)


def scores_of(
    results: Mapping[Condition, Values],
    base: Condition,
    recording: np.ndarray,
    external: Mapping[str, Values],
) -> dict[str, SampleScores]:
    """What the samples of every way are worth, and those of others' predictions, by name."""
    ours = {
        ESTIMATOR_NAMES.get(way.way, way.way): sample_scores(results[way], recording)
        for way in alike(results, base)
    }
    return ours | {name: sample_scores(values, recording) for name, values in external.items()}


def best_table(found: Mapping[str, SampleScores]) -> Sheet:
    """The best of N samples, root-aligned and after a similarity."""
    rows = [
        [f"{name}, {words}", *getattr(one, field), one.frames]
        for name, one in found.items()
        for words, field in (("root-aligned", "best_root"), ("Procrustes", "best_procrustes"))
    ]
    head = ["", *(f"N = {number}" for number in BESTS), "frames"]
    title = "Best of N samples: mean joint error, mm"
    return sheet_of(head, rows, name="best", title=title, caption=BEST_CAPTION)


def calibration_table(found: Mapping[str, SampleScores]) -> Sheet:
    """Do samples mean what they say: the field's ECE, and coverage by axis."""
    rows = [
        [
            name,
            one.ece and one.ece.whole,
            one.ece and one.ece.floor,
            *(one.axes or (None,) * 3),
            one.beyond,
        ]
        for name, one in found.items()
    ]
    errors = [Column(head, form=_ece) for head in ("ECE", "its floor")]
    shares = [Column(head, form=_percents) for head in ("x", "y", "depth", "beyond all")]
    head = [Column(""), *errors, *shares]
    title = "Calibration of the samples"
    return sheet_of(head, rows, name="calibration", title=title, caption=CALIBRATION_CAPTION)


def sharpness_table(found: Mapping[str, SampleScores]) -> Sheet:
    """What calibration alone does not say: how wide intervals are, how far samples lie from what
    was seen, on how many roots they rest."""
    rows = [[name, one.across, *one.width, one.effective] for name, one in found.items()]
    head = ("", "2D error", "width x", "width y", "width depth", "effective roots")
    title = "Sharpness of the samples, mm"
    return sheet_of(head, rows, name="sharpness", title=title, caption=SHARPNESS_CAPTION)


def _percents(value: Interval | float | None) -> str:
    """A share with its interval, in percent."""
    if value is None or isinstance(value, float):
        return NOTHING if value is None or np.isnan(value) else f"{value:.1%}".replace("%", " %")
    return percents(value)


def _ece(value: Interval | float | None) -> str:
    if value is None or isinstance(value, float):
        return NOTHING if value is None or np.isnan(value) else f"{value:.3f}"
    if np.isnan(value.low):
        return f"{value.value:.3f}"
    return f"{value.value:.3f} ({value.low:.3f}–{value.high:.3f})"


def relations_table(found: Sequence[Relation], caption: str = RELATIONS_CAPTION) -> Sheet:
    """The paper's relations and whether they hold."""
    rows = [[one.words, one.paper, _found(one), one.verdict, one.frames] for one in found]
    head = (
        "relation",
        "paper",
        "found (95 % interval)",
        Column("verdict", left=True),
        "frames",
    )
    title = "The paper's relations"
    return sheet_of(head, rows, name="relations", title=title, caption=caption)


def _found(relation: Relation) -> str:
    if not relation.frames:
        return NOTHING
    factor, unit = (100.0, " %") if relation.unit == "share" else (1.0, " mm")
    value, low, high = (factor * part for part in relation.found)
    return f"{value:+.1f}{unit} ({low:+.1f} to {high:+.1f})".replace("-", "−")


def frames_table(results: Mapping[Condition, Values]) -> Sheet:
    """How many frames came to what end, and why some were lost."""
    rows: list[list[Any]] = []
    for condition, values in results.items():
        gone = lost(values)
        why = "; ".join(f"{number} {status}" for status, number in gone.status.items()) or NOTHING
        reason = gone.reasons[0] if gone.reasons else NOTHING
        rows.append([condition.name, len(values["num_draws"]), gone.number, why, reason])
    head = (
        "condition",
        "frames",
        "lost",
        Column("how", left=True),
        Column("the first reason", left=True),
    )
    caption = (
        "Lost: frames without enough draws for the largest k; they are in no row of their"
        " condition."
    )
    return sheet_of(head, rows, name="frames", title="Frames", caption=caption)


def pck_table(curves: Mapping[tuple[str, float, str], np.ndarray]) -> Sheet:
    """The curves, one column each."""
    head = ["mm", *(f"{name} {angle:g} {label}" for name, angle, label in curves)]
    rows = [
        [mm, *map(float, shares)] for mm, shares in enumerate(zip(*curves.values(), strict=True))
    ]
    title = "Share of joints within a distance"
    caption = "Best of k: the frame's best hypothesis."
    return sheet_of(head, rows, name="pck", title=title, caption=caption)
