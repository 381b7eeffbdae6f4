"""The verdict on anybody's posterior: ranks against their band, and coverage by covariates."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.studies.calibration.uniformity import ECDF_LEVELS, difference
from poseterior.inference.studies.judging.judge import Judged
from poseterior.inference.studies.judging.where import SHOWN
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.coverage import ranks_band
from poseterior.reports.figures.style import INK, LEGEND, SMALL, TITLE, page, tidy
from poseterior.reports.tables.judging import worst

MOST_PANELS, IN_A_ROW = 7, 4


def judged_figure(found: Judged) -> Figure:
    """Left the distribution functions of the levels, as `arviz_plots.plot_ecdf_pit` has them; then
    the map: what central intervals of the `worst` quantity hold, by each covariate, with
    bands that keep 95 % along a curve."""
    covariates = [] if found.map is None else found.map.covariate.values[:MOST_PANELS].tolist()
    number = 1 + len(covariates)
    rows, columns = math.ceil(number / IN_A_ROW), min(number, IN_A_ROW)
    figure = page(3.0 * columns, 2.6 * rows)
    first, *others = figure.subplots(rows, columns, squeeze=False).ravel()
    _ranks(first, found)
    for axes in others[len(covariates) :]:
        axes.set_axis_off()
    for axes, covariate in zip(others, covariates, strict=False):
        _curve(axes, found, covariate)
    if covariates:
        others[0].set_ylabel(f"held, {worst(found)}", fontsize=SMALL)
    return figure


def _ranks(axes: Axes, found: Judged) -> None:
    level = found.level
    sizes = np.isfinite(level.values).sum(axis=0)
    ranks_band(axes, int(sizes.max()))
    for number, name in enumerate(found.quantities):
        values = level.sel(quantity=name).values
        colour = PALETTE[number % len(PALETTE)]
        known = values[np.isfinite(values)]
        axes.plot(
            ECDF_LEVELS, difference(known), lw=0.9, color=colour, gid=f"ranks {name}", label=name
        )
    if len(found.quantities) <= len(PALETTE):
        axes.legend(frameon=False, fontsize=LEGEND)
    axes.set_title("ranks", fontsize=TITLE)
    axes.set_xlabel("level", fontsize=SMALL)
    axes.set_ylabel("share below − level", fontsize=SMALL)
    tidy(axes)
    axes.tick_params(labelsize=SMALL)


def _curve(axes: Axes, found: Judged, covariate: str) -> None:
    assert found.map is not None
    part = found.map.sel(covariate=covariate, quantity=worst(found))
    words = [str(one) for one in part.words.values if one]
    places = np.arange(len(words))
    for number, nominal in enumerate(SHOWN):
        one = part.sel(nominal=nominal).isel(bin=slice(len(words)))
        colour = PALETTE[number]
        axes.axhline(nominal, color=INK, lw=0.6, ls="--")
        axes.fill_between(places, one.low, one.high, color=colour, alpha=0.2, lw=0)
        axes.vlines(places, one.low, one.high, color=colour, lw=0.6)
        axes.plot(
            places, one.share, "o-", color=colour, ms=3, lw=1.1, gid=f"held {nominal:g} {covariate}"
        )
    axes.set_xticks(places, words, rotation=30, ha="right")
    axes.set_ylim(0, 1.02)
    axes.set_title(covariate, fontsize=TITLE)
    tidy(axes)
    axes.tick_params(labelsize=SMALL)
