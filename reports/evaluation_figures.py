"""Figures of an evaluation: errors by action and by missing joints, PCK curves, the bias of motion
capture."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from inference.studies.evaluation.bias import ANGLES, Bias
from inference.studies.evaluation.conditions import Condition
from inference.studies.evaluation.metrics import pck
from inference.studies.evaluation.scores import (
    Values,
    clustered,
    common,
    errors_of,
    pose_errors,
    usable,
)
from reports.evaluation_tables import NAMES, Labels, rows_of

COLOURS = {"akhter-black": "#D55E00", "zhou": "#0072B2", "dictionary": "#009E73"}
"""Okabe & Ito's palette."""
FURTHEST = 200.0
"""mm: where the PCK curves end."""
STYLES = (("-", 4.5, 0.3), ("--", 2.2, 0.8), (":", 1.2, 1.0), ("-.", 1.0, 1.0))
"""Line style, width and opacity by angle: curves that coincide are still all seen."""


def _page(width: float, height: float) -> Figure:
    page = Figure(figsize=(width, height), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(page)
    return page


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)


def errors_figure(
    results: Mapping[Condition, Values], base: Condition, labels: Labels, ks: Sequence[int]
) -> Figure:
    """Mean error of every row by action and, where joints were made missing, by their number."""
    levels = sorted({condition.missing for condition in results if condition.rotate == base.rotate})
    estimators = list(dict.fromkeys(condition.estimator for condition in results))
    page = _page(11.0 if len(levels) > 1 else 8.5, 4.2)
    grid = (
        page.subplots(1, 2, width_ratios=(2.2, 1), squeeze=False)[0]
        if len(levels) > 1
        else [page.subplots()]
    )
    _actions_panel(
        grid[0], {name: results[base._replace(estimator=name)] for name in estimators}, labels, ks
    )
    if len(levels) > 1:
        _missing_panel(grid[1], results, base, labels, min(ks), estimators, levels)
    return page


def _actions_panel(
    axes: Axes, results: Mapping[str, Values], labels: Labels, ks: Sequence[int]
) -> None:
    actions = sorted(set(labels.action.tolist()))
    markers = ("s", "o", "^", "D", "v", "P")
    for index, (name, values) in enumerate(results.items()):
        own = usable(values)
        for row, marker in zip(rows_of(ks), markers, strict=False):
            errors = pose_errors(values, row)
            there = [own & (labels.action == action) for action in actions]
            means = [errors[rows].mean() if rows.any() else np.nan for rows in there]
            at = np.arange(len(actions)) + 0.24 * (index - (len(results) - 1) / 2)
            axes.plot(
                at,
                means,
                marker,
                ms=5,
                color=_colour(name),
                mfc="white" if row == "single" else _colour(name),
            )
    for name in results:
        axes.plot([], [], "-", lw=4, color=_colour(name), label=NAMES.get(name, name))
    for row, marker in zip(rows_of(ks), markers, strict=False):
        words = {"single": "single estimate", "all": "best of all draws"}.get(
            str(row), f"best of {row}"
        )
        axes.plot(
            [],
            [],
            marker,
            ms=5,
            color="#444444",
            mfc="white" if row == "single" else "#444444",
            label=words,
        )
    axes.set_xticks(
        range(len(actions)), [action.replace("_", "\n") for action in actions], fontsize=8
    )
    axes.set(ylabel="mean joint error, mm")
    axes.set_ylim(0, None)
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    _tidy(axes)


def _missing_panel(
    axes: Axes,
    results: Mapping[Condition, Values],
    base: Condition,
    labels: Labels,
    k: int,
    estimators: Sequence[str],
    levels: Sequence[int],
) -> None:
    for index, name in enumerate(estimators):
        many = [results[Condition(name, level, base.rotate)] for level in levels]
        own = common(many)
        for row, style in (("single", "-"), (k, "--")):
            found = [clustered(pose_errors(one, row)[own], labels.recording[own]) for one in many]
            bars = np.array([[one.value - one.low, one.high - one.value] for one in found]).T
            at = np.array(levels) + 0.05 * (index - (len(estimators) - 1) / 2)
            axes.errorbar(
                at,
                [one.value for one in found],
                bars,
                ls=style,
                marker="o",
                ms=4,
                capsize=2,
                lw=1.2,
                color=_colour(name),
                mfc="white" if row == "single" else _colour(name),
            )
    axes.plot([], [], "-o", color="#444444", mfc="white", ms=4, label="single estimate")
    axes.plot([], [], "--o", color="#444444", ms=4, label=f"best of {k}")
    axes.set(xlabel="limb joints missing")
    axes.set_xticks(levels)
    axes.set_ylim(0, None)
    axes.legend(frameon=False, fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    _tidy(axes)


def pck_curves(
    results: Mapping[Condition, Values], base: Condition, k: int
) -> dict[tuple[str, float, str], np.ndarray]:
    """Share of joints within 0, 1, … mm, by estimator, angle and row, over the frames that all
    angles share."""
    curves = {}
    for name in dict.fromkeys(condition.estimator for condition in results):
        turned = {
            c.rotate: v
            for c, v in results.items()
            if c.estimator == name and c.missing == base.missing
        }
        own = common(list(turned.values()))
        for angle, values in turned.items():
            for row in ("single", k):
                label = "single estimate" if row == "single" else f"best of {k}"
                curves[name, angle, label] = pck(
                    errors_of(values, row)[own], np.arange(FURTHEST + 1)
                )
    return curves


def pck_figure(curves: Mapping[tuple[str, float, str], np.ndarray]) -> Figure:
    """A panel an estimator; colours tell rows, styles tell angles."""
    names = list(dict.fromkeys(name for name, _, _ in curves))
    page = _page(3.8 * len(names), 3.6)
    for axes, name in zip(
        page.subplots(1, len(names), sharey=True, squeeze=False)[0], names, strict=True
    ):
        angles = sorted({angle for own, angle, _ in curves if own == name})
        for (own, angle, label), curve in curves.items():
            if own == name:
                colour = "#777777" if label.startswith("single") else _colour(name)
                style, width, alpha = STYLES[angles.index(angle) % len(STYLES)]
                label = f"{label}, {_angle(angle)}"
                axes.plot(curve, ls=style, color=colour, lw=width, alpha=alpha, label=label)
        axes.set(
            title=NAMES.get(name, name), xlabel="threshold, mm", xlim=(0, FURTHEST), ylim=(0, 1)
        )
        axes.legend(frameon=False, fontsize=7, loc="lower right")
        _tidy(axes)
    page.axes[0].set_ylabel("share of joints within it (PCK)")
    return page


def _angle(angle: float) -> str:
    return "original" if angle == 0 else f"turned by {angle:g}°"


def bias_figure(bias: Bias) -> Figure:
    """t-SNE of the data set beside the prior; likelihood of actions; how much of the prior is
    visited."""
    page = _page(12.5, 4.2)
    left, middle, right = page.subplots(1, 3, width_ratios=(1.3, 1, 1))
    prior = bias.picture_action == ""
    left.plot(*bias.picture[prior].T, ".", ms=3, color="#BBBBBB", label="draws of the prior")
    palette = (
        "#0072B2",
        "#D55E00",
        "#009E73",
        "#E69F00",
        "#CC79A7",
        "#56B4E9",
        "#8C6D31",
        "#000000",
    )
    actions = sorted(set(bias.picture_action[~prior].tolist()))
    for index, action in enumerate(actions):
        own = bias.picture_action == action
        marker = ".x"[index // len(palette) % 2]
        left.plot(
            *bias.picture[own].T, marker, ms=4, color=palette[index % len(palette)], label=action
        )
    left.set(title="t-SNE of bone directions", xticks=[], yticks=[])
    left.legend(
        frameon=False,
        fontsize=6.5,
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        markerscale=2,
    )
    place = np.arange(len(bias.actions))
    for shift, field, colour, label in (
        (-0.15, "mixture", "#D55E00", "Gaussian mixture"),
        (0.15, "uniform", "#777777", "uniform prior"),
    ):
        found = [getattr(one, field) for one in bias.actions]
        values = np.array([one.value for one in found])
        bars = np.array([[one.value - one.low, one.high - one.value] for one in found]).T
        middle.errorbar(
            values,
            place + shift,
            xerr=np.nan_to_num(bars),
            fmt="o",
            ms=4,
            capsize=2,
            color=colour,
            label=label,
        )
    middle.axvline(0, color="#BBBBBB", lw=0.8)
    middle.set_yticks(place, [f"{one.action} ({one.poses:,})" for one in bias.actions], fontsize=7)
    middle.set(xlabel="log likelihood − mean, nats a pose", title="How likely the actions are")
    middle.legend(frameon=False, fontsize=7)
    middle.invert_yaxis()
    parts = [one.part for one in bias.visits]
    for index, angle in enumerate(ANGLES):
        at, shade = np.arange(len(parts)) + 0.27 * (index - 1), 1 - 0.3 * index
        blue = (0.0, 0.45 * shade, 0.70 * shade)
        right.barh(
            at, [v.data[index] for v in bias.visits], 0.25, color=blue, label=f"within {angle:.0f}°"
        )
        right.plot([v.prior[index] for v in bias.visits], at, "|", ms=6, color="#222222")
    right.plot([], [], "|", ms=6, color="#222222", label="as many draws of the prior")
    right.set_yticks(range(len(parts)), parts, fontsize=8)
    right.set(xlabel="share of the prior", title="How much of the prior is visited", xlim=(0, 1))
    right.invert_yaxis()
    right.legend(
        frameon=False, fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14)
    )
    for axes in (middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    return page


def _colour(name: str) -> str:
    return COLOURS.get(name, "#CC79A7")
