"""Figures of an evaluation: errors by action and by missing joints, PCK curves."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.studies.evaluation.conditions import Condition, alike
from poseterior.inference.studies.evaluation.metrics import pck
from poseterior.inference.studies.evaluation.scores import (
    Interval,
    Values,
    clustered,
    common,
    errors_of,
    pose_errors,
    usable,
)
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, Style, page, tidy
from poseterior.reports.tables.evaluation import ESTIMATOR_NAMES, Labels, rows_of

CURVE_COLOURS = {"zhou": PALETTE[0], "akhter-black": PALETTE[1], "dictionary": PALETTE[2]}
GREY = "#444444"
CURVE_DPI = 150
FURTHEST = 200.0
"""mm: where the PCK curves end."""
STYLES = (("-", 4.5, 0.3), ("--", 2.2, 0.8), (":", 1.2, 1.0), ("-.", 1.0, 1.0))
"""Line style, width and opacity by angle: curves that coincide are still all seen."""


def _tidy(axes: Axes) -> None:
    tidy(axes)
    axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)


def errors_figure(
    results: Mapping[Condition, Values], base: Condition, labels: Labels, ks: Sequence[int]
) -> Figure:
    """Mean error of every row by action and, where joints were made missing, by their number."""
    levels = sorted({condition.missing for condition in results if condition.rotate == base.rotate})
    own = {one.way: results[one] for one in alike(results, base)}
    if len(levels) == 1:
        figure = page(8.5, 4.2, dpi=CURVE_DPI)
        _actions_panel(figure.subplots(), own, labels, ks)
        return figure
    figure = page(11.0, 4.2, dpi=CURVE_DPI)
    left, right = figure.subplots(1, 2, width_ratios=(2.2, 1))
    _actions_panel(left, own, labels, ks)
    by_level = {
        one.way: [results[one._replace(missing=level)] for level in levels]
        for one in alike(results, base)
    }
    _missing_panel(right, by_level, levels, labels, min(ks))
    return figure


def _actions_panel(
    axes: Axes, results: Mapping[str, Values], labels: Labels, ks: Sequence[int]
) -> None:
    actions = sorted(set(labels.action.tolist()))
    markers = dict(zip(rows_of(ks), ("s", "o", "^", "D", "v", "P"), strict=False))
    for index, (name, values) in enumerate(results.items()):
        own = usable(values)
        colour = _colour(name)
        at = np.arange(len(actions)) + 0.24 * (index - (len(results) - 1) / 2)
        for row, marker in markers.items():
            errors = pose_errors(values, row)
            there = [own & (labels.action == action) for action in actions]
            means = [errors[rows].mean() if rows.any() else np.nan for rows in there]
            axes.plot(at, means, marker, ms=5, color=colour, mfc=_fill(row, colour))
        axes.plot([], [], "-", lw=4, color=colour, label=ESTIMATOR_NAMES.get(name, name))
    for row, marker in markers.items():
        words = "best of all draws" if row == "all" else _label(row)
        axes.plot([], [], marker, ms=5, color=GREY, mfc=_fill(row, GREY), label=words)
    ticks = [action.replace("_", "\n") for action in actions]
    axes.set_xticks(range(len(actions)), ticks, fontsize=8)
    axes.set(ylabel="mean joint error, mm")
    _finish(axes, 3)


def _missing_panel(
    axes: Axes,
    results: Mapping[str, Sequence[Values]],
    levels: Sequence[int],
    labels: Labels,
    k: int,
) -> None:
    """`results` by way, in the order of the `levels`."""
    for index, (name, many) in enumerate(results.items()):
        own = common(many)
        colour = _colour(name)
        at = np.array(levels) + 0.05 * (index - (len(results) - 1) / 2)
        for row, style in (("single", "-"), (k, "--")):
            found = [clustered(pose_errors(one, row)[own], labels.recording[own]) for one in many]
            bars: Style = {"capsize": 2, "lw": 1.2, "ls": style, "mfc": _fill(row, colour)}
            means = [one.value for one in found]
            around = whiskers(found)
            axes.errorbar(at, means, around, marker="o", ms=4, color=colour, **bars)
    for row, style in (("single", "-o"), (k, "--o")):
        axes.plot([], [], style, color=GREY, mfc=_fill(row, GREY), ms=4, label=_label(row))
    axes.set(xlabel="limb joints missing")
    axes.set_xticks(levels)
    _finish(axes, 2)


def whiskers(found: Sequence[Interval]) -> np.ndarray:
    """`(2, n)`: how far intervals reach below and above their values."""
    return np.array([[one.value - one.low, one.high - one.value] for one in found]).T


def _fill(row: str | int, colour: str) -> str:
    return "white" if row == "single" else colour


def _label(row: str | int) -> str:
    return "single estimate" if row == "single" else f"best of {row}"


def _finish(axes: Axes, columns: int) -> None:
    axes.set_ylim(0, None)
    place: Style = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
    axes.legend(frameon=False, fontsize=8, ncols=columns, **place)
    _tidy(axes)


def pck_curves(
    results: Mapping[Condition, Values], base: Condition, k: int
) -> dict[tuple[str, float, str], np.ndarray]:
    """Share of joints within 0, 1, … mm, by way, angle and row, over the frames that all angles
    share."""
    curves = {}
    thresholds = np.arange(FURTHEST + 1)
    for name in dict.fromkeys(condition.way for condition in results):
        turned = {
            condition.rotate: values
            for condition, values in results.items()
            if condition.way == name and condition.missing == base.missing
        }
        own = common(list(turned.values()))
        for angle, values in turned.items():
            for row in ("single", k):
                errors = errors_of(values, row)[own]
                curves[name, angle, _label(row)] = pck(errors, thresholds)
    return curves


def pck_figure(curves: Mapping[tuple[str, float, str], np.ndarray]) -> Figure:
    """A panel for each estimator; colours tell rows, styles tell angles."""
    names = list(dict.fromkeys(name for name, _, _ in curves))
    figure = page(3.8 * len(names), 3.6, dpi=CURVE_DPI)
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, name in zip(panels, names, strict=True):
        angles = sorted({angle for own, angle, _ in curves if own == name})
        for (own, angle, label), curve in curves.items():
            if own == name:
                colour = FAINT if label.startswith("single") else _colour(name)
                style, width, alpha = STYLES[angles.index(angle) % len(STYLES)]
                words = f"{label}, {_angle(angle)}"
                axes.plot(curve, ls=style, color=colour, lw=width, alpha=alpha, label=words)
        axes.set(title=ESTIMATOR_NAMES.get(name, name), xlabel="threshold, mm")
        axes.set(xlim=(0, FURTHEST), ylim=(0, 1))
        axes.legend(frameon=False, fontsize=7, loc="lower right")
        _tidy(axes)
    panels[0].set_ylabel("share of joints within it (PCK)")
    return figure


def _angle(angle: float) -> str:
    return "original" if angle == 0 else f"turned by {angle:g}°"


def _colour(name: str) -> str:
    return CURVE_COLOURS.get(name, PALETTE[4])
