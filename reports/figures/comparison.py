"""The judge's findings as a picture: ranks, marginals of depth, mode shares, distance against
seconds."""

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.figures.style import page
from reports.tables.words import spoken

EXACT = "0.35"
MODES = 8


def comparison_figure(tree: xr.DataTree) -> Figure:
    """Four panels from a `comparison.nc`; samplers without draws appear in none of the first
    three."""
    labels = [str(label) for label in tree["summary"].sampler.values]
    colours = {label: colormaps["tab20"](index % 20) for index, label in enumerate(labels)}
    figure = page(12, 9)
    axes = figure.subplots(2, 2)
    draws = tree["draws"].to_dataset()
    _ranks(axes[0, 0], draws, colours)
    _depth(axes[0, 1], draws, tree, colours)
    _modes(axes[1, 0], tree, colours)
    _course(axes[1, 1], tree["course"].to_dataset(), tree.attrs["epsilon"], colours)
    handles = [Line2D([], [], color=colour, label=label) for label, colour in colours.items()]
    handles.append(Line2D([], [], color=EXACT, lw=3, label="exact"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _shown(draws: xr.Dataset, label: str) -> np.ndarray:
    values = draws["value"].sel(sampler=label).values
    return values[np.isfinite(values).all(axis=1)]


def _ranks(axes: Axes, draws: xr.Dataset, colours: dict) -> None:
    """How far the distribution of the ranks is from uniform, for each sampler's worst
    coordinate."""
    exact = np.sort(draws["exact"].values, axis=0)
    levels = np.linspace(0, 1, 101)
    for label, colour in colours.items():
        values = _shown(draws, label)
        if not len(values):
            continue
        off = np.zeros((len(levels), values.shape[1]))
        for column in range(values.shape[1]):
            rank = np.searchsorted(exact[:, column], values[:, column]) / len(exact)
            off[:, column] = np.searchsorted(np.sort(rank), levels) / len(rank) - levels
        worst = int(np.abs(off[1:-1]).max(axis=0).argmax())
        axes.plot(levels, off[:, worst], color=colour)
    axes.axhline(0, color=EXACT, lw=1)
    axes.set(
        xlabel="rank among the exact draws",
        ylabel="share of draws below − rank",
        title="Ranks, worst coordinate",
    )


def _depth(axes: Axes, draws: xr.Dataset, tree: xr.DataTree, colours: dict) -> None:
    """Depth of the joint that is farthest off in any sampler."""
    if "joints" not in tree.children:
        return
    joint = str(tree["joints"].w1_depth.max("sampler").idxmax("joint").item())
    exact = draws["exact"].sel(coordinate=f"{joint} z").values
    bins = np.linspace(exact.min() - 0.1, exact.max() + 0.1, 50).tolist()
    axes.hist(exact, bins, density=True, histtype="stepfilled", color=EXACT, alpha=0.35)
    for label, colour in colours.items():
        values = _shown(draws.sel(coordinate=[f"{joint} z"]), label)
        if len(values):
            axes.hist(values[:, 0], bins, density=True, histtype="step", color=colour, lw=1.4)
    words = f"depth of the {spoken(joint)}, body units (away from the camera)"
    axes.set(xlabel=words, ylabel="density", title="Depth")


def _modes(axes: Axes, tree: xr.DataTree, colours: dict) -> None:
    if "modes" not in tree.children:
        return
    modes = tree["modes"].to_dataset().isel(mode=slice(0, MODES))
    place = np.arange(modes.sizes["mode"])
    axes.bar(place, modes["exact_share"], color=EXACT, alpha=0.35, width=0.9)
    labels = [str(label) for label in modes.sampler.values]
    for index, label in enumerate(labels):
        aside = 0.7 * ((index + 0.5) / len(labels) - 0.5)
        axes.plot(place + aside, modes["share"].sel(sampler=label), "o", ms=4, color=colours[label])
    axes.set_xticks(place, [str(mode) for mode in modes.mode.values], rotation=60, fontsize=8)
    axes.set(ylabel="share of draws", title="Depth flips: each bone t(owards) the camera or a(way)")


def _course(axes: Axes, course: xr.Dataset, epsilon: float, colours: dict) -> None:
    for label, colour in colours.items():
        one = course.sel(sampler=label)
        if np.isfinite(one.seconds).any():
            axes.loglog(one.seconds, one.distance, "o-", ms=3, color=colour)
    axes.axhline(epsilon, color=EXACT, lw=1, ls=":")
    axes.set(
        xlabel="seconds",
        ylabel="sliced Wasserstein distance, standard deviations",
        title="Distance to the exact draws",
    )
