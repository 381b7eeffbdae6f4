"""What intervals say and what they cover, for people and cameras that were never seen."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.studies.person_views import JUDGED, ViewLevels, inside
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import page, tidy
from poseterior.reports.tables.person_views import WAYS_OFF

NOMINALS = np.linspace(0.0, 1.0, 41)


def levels_figure(judged: Sequence[ViewLevels]) -> Figure:
    """The share of truths in central intervals, by the intervals' own level, an axis a line."""
    level = np.stack([one.level[list(JUDGED)] for one in judged])
    figure = page(3.4, 3.2)
    axes = figure.subplots()
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
    return figure
