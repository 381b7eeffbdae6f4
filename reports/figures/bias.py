"""The bias of motion capture: t-SNE beside the prior, likelihood of actions, how much of the prior
is visited."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.studies.evaluation.bias import ANGLES, Bias
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.evaluation import CURVE_DPI, whiskers
from poseterior.reports.figures.style import FAINT, INK, Style, page, tidy

LIGHT = "#BBBBBB"
ACTIONS = (*PALETTE, "#000000")
"""Colours of actions."""


def bias_figure(bias: Bias) -> Figure:
    """Three panels: bone directions of the data set and of the prior; how likely the actions are;
    how much of the prior is visited."""
    figure = page(12.5, 4.2, dpi=CURVE_DPI)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.3, 1, 1))
    _draw_picture(left, bias)
    _draw_actions(middle, bias)
    _draw_visits(right, bias)
    return figure


def _draw_picture(axes: Axes, bias: Bias) -> None:
    prior = bias.picture_action == ""
    axes.plot(*bias.picture[prior].T, ".", ms=3, color=LIGHT, label="draws of the prior")
    for index, action in enumerate(sorted(set(bias.picture_action[~prior].tolist()))):
        own = bias.picture[bias.picture_action == action]
        marker = ".x"[index // len(ACTIONS) % 2]
        colour = ACTIONS[index % len(ACTIONS)]
        axes.plot(*own.T, marker, ms=4, color=colour, label=action)
    axes.set(title="t-SNE of bone directions", xticks=[], yticks=[])
    place: Style = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}
    axes.legend(frameon=False, fontsize=6.5, ncols=3, markerscale=2, **place)


def _draw_actions(axes: Axes, bias: Bias) -> None:
    place = np.arange(len(bias.actions))
    for shift, field, colour, label in (
        (-0.15, "mixture", PALETTE[1], "Gaussian mixture"),
        (0.15, "uniform", FAINT, "uniform prior"),
    ):
        found = [getattr(one, field) for one in bias.actions]
        around = np.nan_to_num(whiskers(found))
        means = [one.value for one in found]
        dots: Style = {"fmt": "o", "ms": 4, "capsize": 2, "color": colour, "label": label}
        axes.errorbar(means, place + shift, xerr=around, **dots)
    axes.axvline(0, color=LIGHT, lw=0.8)
    axes.set_yticks(place, [f"{one.action} ({one.poses:,})" for one in bias.actions], fontsize=7)
    axes.set(xlabel="log likelihood − mean, nats a pose", title="How likely the actions are")
    axes.legend(frameon=False, fontsize=7)
    axes.invert_yaxis()
    tidy(axes)


def _draw_visits(axes: Axes, bias: Bias) -> None:
    parts = [one.part for one in bias.visits]
    for index, angle in enumerate(ANGLES):
        at = np.arange(len(parts)) + 0.27 * (index - 1)
        shade = 1 - 0.3 * index
        blue = (0.0, 0.45 * shade, 0.70 * shade)
        shares = [one.data[index] for one in bias.visits]
        axes.barh(at, shares, 0.25, color=blue, label=f"within {angle:.0f}°")
        axes.plot([one.prior[index] for one in bias.visits], at, "|", ms=6, color=INK)
    axes.plot([], [], "|", ms=6, color=INK, label="as many draws of the prior")
    axes.set_yticks(range(len(parts)), parts, fontsize=8)
    axes.set(xlabel="share of the prior", title="How much of the prior is visited", xlim=(0, 1))
    axes.invert_yaxis()
    place: Style = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14)}
    axes.legend(frameon=False, fontsize=7, ncols=2, **place)
    tidy(axes)
