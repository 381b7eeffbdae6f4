"""What intervals say and what they cover, for people and cameras that were never seen."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.studies.person_views import JUDGED, ViewLevels, inside
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import page, tidy
from poseterior.reports.tables.person_views import WAYS_OFF

NOMINALS = np.linspace(0.0, 1.0, 41)


def levels_figure(about: Mapping[str, Sequence[ViewLevels]]) -> Figure:
    """The share of truths in central intervals, by the intervals' own level, an axis a line; a
    picture for each midpoint about which joints are placed."""
    figure = page(6.4, 3.2)
    pictures = figure.subplots(1, len(about))
    for axes, (middle, judged) in zip(pictures, about.items(), strict=True):
        _levels(axes, judged)
        axes.set_title(f"about the {middle}", loc="left", fontsize=8)
    return figure


def _levels(axes: Axes, judged: Sequence[ViewLevels]) -> None:
    level = np.stack([one.level[list(JUDGED)] for one in judged])
    axes.plot([0, 1], [0, 1], color="#BBBBBB", lw=1)
    for row, name in enumerate(WAYS_OFF):
        own = level[..., row][np.isfinite(level[..., row])]
        if len(own):
            share = [inside(own, nominal).mean() for nominal in NOMINALS]
            axes.plot(NOMINALS, share, color=PALETTE[row], label=name, lw=1.4)
    axes.set_xlabel("an interval's level", fontsize=8)
    axes.set_ylabel("share of truths in it", fontsize=8)
    axes.legend(frameon=False, fontsize=7)
    tidy(axes)
