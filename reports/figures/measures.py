"""Joint angles, lengths and steps: densities of one person's, bands over time of a film's."""

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.summaries import DensityCurve, density_of
from poseterior.probmodel.measures import wrapped
from poseterior.reports.figures.colours import measure_colour
from poseterior.reports.figures.style import DPI, FAINT, INK, SMALL, TEXT, page, tidy
from poseterior.reports.tables.words import spoken

MOST_PANELS = 12
"""Measures that a picture has; the first of those asked for."""
LEAST_SHOWN = 0.003
"""Of the largest density: what is lower is not shown at the ends."""
PANEL_WIDTH, PANEL_HEIGHT = 2.5, 1.6
"""Inches."""


def densities_figure(found: xr.Dataset, summed: xr.Dataset, names: Sequence[str]) -> Figure:
    """The density of each measure, its interval dark, its mean a line, two modes named.

    Parameters
    ----------
    found
        Draws, as `inference.measures` gives them.
    summed
        What `inference.measure_intervals` says of them.
    names
        Which of them; the first `MOST_PANELS`.
    """
    shown = names[:MOST_PANELS]
    columns = min(4, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = page(PANEL_WIDTH * columns, PANEL_HEIGHT * rows, dpi=DPI)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, name in zip(axes, shown, strict=False):
        one = found[name]
        draws = one.values.ravel()
        _density(axis, draws[np.isfinite(draws)], bool(one.attrs["circular"]), name)
        _title(axis, name, str(one.attrs["units"]), summed.sel(measure=name))
    for axis in axes[len(shown) :]:
        axis.set_visible(False)
    return figure


def _density(axis: Axes, draws: np.ndarray, circular: bool, name: str) -> None:
    tidy(axis)
    axis.set_yticks([])
    axis.tick_params(labelsize=SMALL, color=FAINT)
    axis.spines[:].set_color(FAINT)
    if not len(draws):
        return
    at, density = _where_it_is(density_of(draws, circular), draws, circular)
    axis.fill_between(
        at, density, color=measure_colour(name), alpha=0.25, lw=0, gid=f"density {name}"
    )
    axis.plot(at, density, color=measure_colour(name), lw=1.0)
    axis.set_ylim(bottom=0)


def _where_it_is(found: DensityCurve, draws: np.ndarray, circular: bool) -> DensityCurve:
    """The stretch in which there is something to see, on a line no longer than the draws are."""
    some = found.density > LEAST_SHOWN * found.density.max()
    if not circular:
        some &= (found.at >= draws.min()) & (found.at <= draws.max())
    rows = np.flatnonzero(some)
    part = slice(rows[0], rows[-1] + 1) if len(rows) else slice(None)
    return DensityCurve(found.at[part], found.density[part])


def _title(axis: Axes, name: str, unit: str, summed: xr.Dataset) -> None:
    mean, low, high = (float(summed[field]) for field in ("mean", "low", "high"))
    if not math.isfinite(mean):
        axis.set_title(f"{spoken(name)}: not determined", loc="left", fontsize=TEXT, color=INK)
        return
    left, right = axis.get_xlim()
    turn = 360.0 if unit == "degrees" else 0.0
    for place in {mean + shift for shift in (-turn, 0.0, turn)}:
        if left <= place <= right:
            axis.axvline(place, color=INK, lw=0.9, gid=f"mean {name}")
    for shift in {-turn, 0.0, turn}:
        ends = low + shift, high + shift
        axis.axvspan(*ends, 0, 0.04, color=measure_colour(name), lw=0, gid=f"interval {name}")
    axis.set_xlim(left, right)
    sign = "°" if unit == "degrees" else f" {unit}"
    digits = 0 if unit != "body units" else 2
    head = f"{spoken(name)}: {low:.{digits}f} to {high:.{digits}f}{sign}"
    axis.set_title(head.replace("-", "−"), loc="left", fontsize=SMALL, color=INK)


def bands_figure(summed: xr.Dataset, numbers: Sequence[int], names: Sequence[str]) -> Figure:
    """Mean and interval of each measure over the frames of one person's film; gaps where there is
    no pose.

    Parameters
    ----------
    summed
        What `inference.measure_intervals` says of every frame.
    numbers
        Of the frames, growing.
    names
        Which measures; the first `MOST_PANELS`.
    """
    shown = names[:MOST_PANELS]
    columns = 2 if len(shown) > 1 else 1
    rows = math.ceil(len(shown) / columns)
    figure = page(4.2 * columns, PANEL_HEIGHT * rows, dpi=DPI)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis, name in zip(axes, shown, strict=False):
        _band(axis, summed.sel(measure=name), numbers, name)
    for axis in axes[len(shown) :]:
        axis.set_visible(False)
    share = f"{100 * summed.attrs['probability']:g} %"
    axes[0].set_xlabel("")
    figure.supxlabel(f"frame     (mean, and {share} of the draws)", fontsize=SMALL, color=INK)
    return figure


def _band(axis: Axes, one: xr.Dataset, numbers: Sequence[int], name: str) -> None:
    regular = np.arange(numbers[0], numbers[-1] + 1)
    rows = np.full((3, len(regular)), np.nan)
    rows[:, np.asarray(numbers) - numbers[0]] = [one[key].values for key in ("mean", "low", "high")]
    mean = rows[0]
    if str(one.units.values) == "degrees":
        rows = rows + (continued(mean) - mean)
    colour = measure_colour(name)
    marker = "." if len(regular) < 3 else None
    axis.fill_between(regular, rows[1], rows[2], color=colour, alpha=0.3, lw=0, gid=f"band {name}")
    axis.plot(regular, rows[0], color=colour, lw=1.2, marker=marker, gid=f"mean {name}")
    axis.set_title(f"{spoken(name)}, {one.units.values}", loc="left", fontsize=TEXT, color=INK)
    axis.tick_params(labelsize=SMALL, color=FAINT)
    axis.spines[:].set_color(FAINT)
    tidy(axis)


def continued(degrees: np.ndarray) -> np.ndarray:
    """Angles one after the other without jumps of whole turns, over gaps too."""
    there = np.isfinite(degrees)
    found = degrees.copy()
    if there.any():
        steps = wrapped(np.diff(degrees[there], prepend=degrees[there][0]))
        found[there] = degrees[there][0] + np.cumsum(steps)
    return found
