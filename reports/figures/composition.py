"""What hypotheses gain on the single estimate that they start from, by how they are chosen."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.studies.intervals import Interval
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.evaluation import CURVE_DPI, whiskers
from poseterior.reports.figures.style import FAINT, page, tidy


def gains_figure(gains: Mapping[str, Sequence[Interval]], ways: Sequence[str], k: int) -> Figure:
    """Gains in percent with their intervals.

    Parameters
    ----------
    gains
        By how hypotheses are chosen: one for each of the ways to have a root.
    ways
        What these are called.
    k
        Of how many hypotheses the best is taken.

    Returns
    -------
    Figure
        A row of points for each way.
    """
    figure = page(8.5, 0.8 + 0.75 * len(ways), dpi=CURVE_DPI)
    axes = figure.subplots()
    place = np.arange(len(ways))
    shifts = np.linspace(-0.2, 0.2, len(gains))
    for shift, colour, (name, found) in zip(shifts, PALETTE, gains.items(), strict=False):
        axes.errorbar(
            [one.value for one in found],
            place + shift,
            xerr=whiskers(found),
            fmt="o",
            ms=5,
            capsize=2,
            color=colour,
            label=name,
        )
    axes.axvline(0, color=FAINT, lw=0.8)
    axes.set_yticks(place, list(ways))
    axes.set_xlabel(f"gain of the best of {k} on Akhter & Black's single estimate, %")
    axes.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=3)
    axes.invert_yaxis()
    tidy(axes)
    return figure
