"""The judge's findings as a picture: ranks, depth, mode shares, distance against seconds.

A colour is a sampler; its runs from one depth flip are dashed and hollow, those from dispersed
starts, and samplers that need none, are solid.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator

from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import (
    DASHES,
    DPI,
    FAINT,
    INK,
    LEGEND,
    SMALL,
    Style,
    entitle,
    note,
    page,
    tidy,
)
from poseterior.reports.tables.words import spoken

EXACT_COLOUR = "#8A8A8A"
MODES = 8
CONTOUR_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of depth that are shown."""
LATE = "(one flip)"
"""How the label of a run that started in one mode ends."""


class PlottedRun(NamedTuple):
    """How a run is drawn: its label, the colour of its sampler, and whether it started in one
    mode."""

    label: str
    colour: str
    late: bool

    @property
    def line(self) -> Style:
        """As a line."""
        return {"color": self.colour, "lw": 1.2, "ls": DASHES if self.late else "-"}

    @property
    def dot(self) -> Style:
        """As a dot."""
        face = "white" if self.late else self.colour
        return {"marker": "o", "ms": 3.2, "mec": self.colour, "mew": 0.9, "mfc": face, "ls": ""}


def comparison_figure(tree: xr.DataTree) -> Figure:
    """Four panels from a `comparison.nc`; samplers without draws appear in none of the first
    three."""
    runs = _runs([str(label) for label in tree["summary"].sampler.values])
    figure = page(10.5, 7.4 + 0.1 * len(runs), dpi=DPI)
    figure.set_layout_engine("constrained", w_pad=0.15, h_pad=0.12)
    axes = figure.subplots(2, 2)
    draws = tree["draws"].to_dataset()
    _ranks(axes[0, 0], draws, runs)
    _depth(axes[0, 1], draws, tree, runs)
    _modes(axes[1, 0], tree, runs)
    _course(axes[1, 1], tree["course"].to_dataset(), tree.attrs["epsilon"], runs)
    for axis in axes.flat:
        tidy(axis)
        axis.spines[:].set_color(FAINT)
        axis.tick_params(labelsize=SMALL, color=FAINT)
        axis.xaxis.label.set(size=SMALL, color=INK)
        axis.yaxis.label.set(size=SMALL, color=INK)
    handles = [Line2D([], [], label=run.label, **run.line) for run in runs]
    handles.append(Line2D([], [], color=EXACT_COLOUR, lw=4, label="exact draws"))
    figure.legend(
        handles=handles,
        loc="outside lower left",
        ncols=6,
        frameon=False,
        fontsize=LEGEND,
        labelcolor=INK,
    )
    return figure


def _runs(labels: Sequence[str]) -> list[PlottedRun]:
    names = list(dict.fromkeys(label.partition(" ")[0] for label in labels))
    light = [tuple(0.5 + 0.5 * part for part in to_rgb(colour)) for colour in PALETTE]
    colours = [
        *PALETTE,
        *("#{:02x}{:02x}{:02x}".format(*(round(255 * x) for x in one)) for one in light),
    ]
    of_name = {name: colours[index % len(colours)] for index, name in enumerate(names)}
    return [
        PlottedRun(label, of_name[label.partition(" ")[0]], label.endswith(LATE))
        for label in labels
    ]


def _shown(draws: xr.Dataset, label: str) -> np.ndarray:
    values = draws["value"].sel(sampler=label).values
    return values[np.isfinite(values).all(axis=1)]


def _ranks(axes: Axes, draws: xr.Dataset, runs: Sequence[PlottedRun]) -> None:
    """How far the distribution of the ranks is from uniform, for each sampler's worst
    coordinate."""
    exact = np.sort(draws["exact"].values, axis=0)
    levels = np.linspace(0, 1, 101)
    for run in runs:
        values = _shown(draws, run.label)
        if not len(values):
            continue
        off = np.zeros((len(levels), values.shape[1]))
        for column in range(values.shape[1]):
            rank = np.searchsorted(exact[:, column], values[:, column]) / len(exact)
            off[:, column] = np.searchsorted(np.sort(rank), levels) / len(rank) - levels
        worst = int(np.abs(off[1:-1]).max(axis=0).argmax())
        axes.plot(levels, off[:, worst], **run.line)
    axes.axhline(0, color=EXACT_COLOUR, lw=2, zorder=1)
    axes.set(xlabel="rank among the exact draws", ylabel="share of draws below − rank", xlim=(0, 1))
    entitle(axes, "Ranks, worst coordinate")


def _depth(axes: Axes, draws: xr.Dataset, tree: xr.DataTree, runs: Sequence[PlottedRun]) -> None:
    """Quantiles of the depth of the joint that is farthest off in any sampler, over those of the
    exact draws."""
    if "joints" not in tree.children:
        note(axes, "no draws to compare")
        return
    joint = str(tree["joints"].w1_depth.max("sampler").idxmax("joint").item())
    low, lower, middle, upper, high = np.quantile(
        draws["exact"].sel(coordinate=f"{joint} z").values, CONTOUR_LEVELS
    )
    axes.axvspan(low, high, color=EXACT_COLOUR, alpha=0.18, lw=0)
    axes.axvspan(lower, upper, color=EXACT_COLOUR, alpha=0.3, lw=0)
    axes.axvline(middle, color=EXACT_COLOUR, lw=2)
    for row, run in enumerate(runs):
        values = _shown(draws.sel(coordinate=[f"{joint} z"]), run.label)
        if not len(values):
            continue
        found = np.quantile(values[:, 0], CONTOUR_LEVELS)
        axes.plot(found[[0, 4]], [row, row], **run.line)
        axes.plot(found[[1, 3]], [row, row], **run.line | {"lw": 3.5, "ls": "-"})
        axes.plot(found[2], row, zorder=4, **run.dot)
    axes.set_yticks(range(len(runs)), [run.label for run in runs])
    axes.set_ylim(len(runs) - 0.5, -0.5)
    axes.set_xlabel("← towards the camera     body units     away →")
    entitle(axes, f"Depth of the {spoken(joint)}: median, half, 90 % of the draws")


def _modes(axes: Axes, tree: xr.DataTree, runs: Sequence[PlottedRun]) -> None:
    if "modes" not in tree.children:
        note(axes, "no draws to compare")
        return
    modes = tree["modes"].to_dataset().isel(mode=slice(0, MODES))
    place = np.arange(modes.sizes["mode"])
    axes.bar(place, modes["exact_share"], color=EXACT_COLOUR, alpha=0.4, width=0.9)
    there = {str(label) for label in modes.sampler.values}
    own = [run for run in runs if run.label in there]
    for index, run in enumerate(own):
        aside = 0.7 * ((index + 0.5) / len(own) - 0.5)
        axes.plot(place + aside, modes["share"].sel(sampler=run.label), **run.dot)
    axes.set_xticks(place, [str(mode) for mode in modes.mode.values], rotation=30, ha="right")
    axes.set_ylabel("share of draws")
    entitle(axes, "Depth flips: each bone t(owards) the camera or a(way)")


def _course(axes: Axes, course: xr.Dataset, epsilon: float, runs: Sequence[PlottedRun]) -> None:
    own = [run for run in runs if np.isfinite(course.seconds.sel(sampler=run.label)).any()]
    if not own:
        note(axes, "no draws to compare")
        return
    for run in own:
        one = course.sel(sampler=run.label)
        axes.loglog(one.seconds, one.distance, **run.dot | run.line)
    axes.axhline(epsilon, color=EXACT_COLOUR, lw=1, ls=":")
    axes.set(xlabel="seconds", ylabel="sliced Wasserstein distance, standard deviations")
    axes.minorticks_off()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
    entitle(axes, "Distance to the exact draws")
