"""Calibration and coverage: ranks against their band, nominal against empirical coverage."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.studies.calibration.ece import ECE_LEVELS, shares
from poseterior.inference.studies.calibration.quantities import (
    ENERGY_BALL,
    HINGES,
    LOG_DENSITY,
    MISFIT,
    OF_POSE,
    OF_ROOT,
    TARP,
)
from poseterior.inference.studies.calibration.uniformity import ECDF_LEVELS, band, difference
from poseterior.inference.studies.calibration.verdict import BY_COORDINATES, levels_by_quantity
from poseterior.probmodel.measures import MEASURES
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import INK, page, tidy
from poseterior.reports.tables.words import spoken

BAND = "#BBBBBB"
PROBABILITY = 0.95
MOST_NAMED = 9
"""Quantities of a panel that are named beside it."""
PANELS = {
    "joints, to the side": [name for name in OF_POSE if name.endswith((" x", " y"))],
    "joints, depth": [name for name in OF_POSE if name.endswith(" z")],
    "lengths and depth flips": [
        name for name in OF_POSE if name.startswith("length") or name.endswith("away")
    ],
    "pose and model": [*HINGES, LOG_DENSITY, MISFIT, ENERGY_BALL, TARP],
    "root": list(OF_ROOT),
}
"""The quantities of every panel; that of the root is shown where it was asked for."""
MEASURE_PANELS = {
    "elbows and knees": [
        name for name in MEASURES if name.endswith(("knee_flexion", "elbow_flexion"))
    ],
    "shoulders": [name for name in MEASURES if "shoulder" in name],
    "hips": [name for name in MEASURES if "hip" in name],
    "against the vertical": [
        name
        for name in MEASURES
        if (name.endswith("_elevation") and "shoulder" not in name)
        or name.startswith(("trunk", "head", "neck"))
    ],
    "lengths": [name for name, one in MEASURES.items() if one.kind == "length"],
}
"""The same of measures."""


def ranks_figure(simulation: xr.Dataset, title: str = "", of: str = BY_COORDINATES) -> Figure:
    """Empirical minus uniform distribution function of every quantity's levels, a panel a kind,
    with the band in which 95 % of right posteriors stay everywhere (for one quantity). `of`
    coordinates or measures, as `judge`."""
    level = levels_by_quantity(simulation, of)
    known = {
        name: quantities
        for name, quantities in (PANELS if of == BY_COORDINATES else MEASURE_PANELS).items()
        if np.isfinite(level.sel(quantity=quantities).values).any()
    }
    figure = page(3 * len(known), 2.7)
    axes = figure.subplots(1, len(known), sharey=True, squeeze=False)[0]
    for axis, (name, quantities) in zip(axes, known.items(), strict=True):
        table = level.sel(quantity=quantities).values
        table = table[np.isfinite(table).any(axis=1)]
        _band(axis, len(table))
        for column, (values, quantity) in enumerate(zip(table.T, quantities, strict=True)):
            if np.isfinite(values).all() and len(values):
                few = len(quantities) <= MOST_NAMED
                colour = PALETTE[column % len(PALETTE)]
                axis.plot(
                    ECDF_LEVELS,
                    difference(values),
                    lw=1.1 if few else 0.7,
                    gid=f"ranks {quantity}",
                    color=colour,
                    label=spoken(quantity) if few else None,
                )
        if len(quantities) <= MOST_NAMED:
            axis.legend(frameon=False, fontsize=6.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("level", fontsize=8)
        _tidy(axis)
    axes[0].set_ylabel("share below − level", fontsize=8)
    if title:
        figure.suptitle(title, fontsize=9)
    return figure


def _band(axis: Axes, size: int) -> None:
    low, high = band(max(size, 1), PROBABILITY)
    axis.fill_between(
        ECDF_LEVELS, low - ECDF_LEVELS, high - ECDF_LEVELS, color=BAND, alpha=0.5, lw=0, gid="band"
    )
    axis.axhline(0, color=INK, lw=0.6)


def controls_figure(found: Mapping[str, xr.Dataset], quantities: Sequence[str]) -> Figure:
    """Some quantities' levels of several posteriors, a panel each."""
    lines = -(-len(found) // 4)
    figure = page(10.5, 2.3 * lines)
    axes = np.atleast_1d(figure.subplots(lines, 4, sharex=True)).ravel()
    for axis in axes[len(found) :]:
        axis.axis("off")
    for axis, (name, simulation) in zip(axes, found.items(), strict=False):
        table = simulation["level"].sel(quantity=list(quantities)).values
        table = table[np.isfinite(table).all(axis=1)]
        _band(axis, len(table))
        for column, quantity in enumerate(quantities):
            axis.plot(
                ECDF_LEVELS,
                difference(table[:, column]),
                lw=1.1,
                label=spoken(quantity),
                color=PALETTE[column],
            )
        axis.set_title(name, fontsize=8.5)
        _tidy(axis)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=len(quantities),
        frameon=False,
        fontsize=8,
    )
    return figure


def coverage_figure(found: Mapping[str, xr.Dataset]) -> Figure:
    """Nominal against empirical coverage over all joints, a line for each of several sets, to the
    side, in depth, and over all axes."""
    figure = page(10.5, 3.5)
    axes = figure.subplots(1, 3, sharey=True)
    titles = {"lateral": "to the side", "depth": "depth", "whole": "all axes"}
    for axis, (kind, title) in zip(axes, titles.items(), strict=True):
        axis.plot([0, 1], [0, 1], color=INK, lw=0.6)
        for number, (name, simulation) in enumerate(found.items()):
            axis.plot(
                ECE_LEVELS,
                shares(simulation[kind].values).mean(axis=1),
                lw=1.4,
                label=name,
                gid=f"{kind} {name}",
                color=PALETTE[number % len(PALETTE)],
            )
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("nominal coverage", fontsize=8)
        _tidy(axis)
    axes[0].set_ylabel("empirical coverage", fontsize=8)
    axes[0].legend(frameon=False, fontsize=7.5, loc="upper left")
    return figure


def _tidy(axes: Axes) -> None:
    tidy(axes)
    axes.tick_params(labelsize=7)
