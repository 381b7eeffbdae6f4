"""Errors of single estimates under noise, and beside the best of several hypotheses."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.studies.evaluation.scores import Interval
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, Style, page, tidy

BAR_COLOURS = {
    "mean pose": FAINT,
    "dictionary fit": PALETTE[4],
    "Akhter & Black": PALETTE[1],
    "Zhou et al.": PALETTE[0],
}
NUDGES = {"mean pose": -4, "dictionary fit": 5}
"""Points by which a name is moved up, so that it does not lie on another."""
BARS: Style = {"marker": "o", "ms": 4, "capsize": 2, "elinewidth": 0.8}


def estimators_figure(
    noise: Sequence[float],
    by_noise: Mapping[str, Sequence[Interval]],
    missing: Sequence[int],
    by_missing: Mapping[tuple[str, str], Sequence[Interval]],
) -> Figure:
    """Two panels of errors with their intervals.

    Parameters
    ----------
    noise
        Levels of noise, as shares of the body height.
    by_noise
        Errors at these levels, by estimator.
    missing
        Numbers of missing joints.
    by_missing
        Errors with so many missing, by estimator and which pose: the first of an estimator's is
        drawn solid, the other dashed.
    """
    figure = page(9.6, 3.9, dpi=150)
    left, right = figure.subplots(1, 2, sharey=True)
    for index, (name, found) in enumerate(by_noise.items()):
        at = 100 * np.array(noise) + 0.07 * (index - 1.5)
        means, halves = _means(found)
        left.errorbar(at, means, halves, color=BAR_COLOURS[name], **BARS)
        place: Style = {"textcoords": "offset points", "va": "center", "fontsize": 8}
        end = (100 * noise[-1], means[-1])
        away = (10, NUDGES.get(name, 0))
        left.annotate(name, end, away, color=BAR_COLOURS[name], annotation_clip=False, **place)
    left.set(xlabel="2D noise, % of the body height (no joint missing)", xlim=(-0.3, 7.2))
    left.set_ylabel("mean joint error, mm")
    left.set_xticks([100 * level for level in noise])
    poses = list(dict.fromkeys(pose for _, pose in by_missing))
    for index, ((name, pose), found) in enumerate(by_missing.items()):
        at = np.array(missing) + 0.04 * (index - 1.5)
        colour = BAR_COLOURS[name]
        first = pose == poses[0]
        line: Style = {"ls": "-" if first else "--", "mfc": colour if first else "white"}
        right.errorbar(at, *_means(found), color=colour, **BARS, **line)
    for name in dict.fromkeys(name for name, _ in by_missing):
        right.plot([], [], "-", color=BAR_COLOURS[name], label=name)
    right.plot([], [], "-o", color=INK, ms=4, label=poses[0])
    right.plot([], [], "--o", color=INK, ms=4, mfc="white", label=poses[1])
    right.legend(frameon=False, fontsize=8, loc="upper left", ncols=2)
    right.set_xlabel("limb joints missing (true 2D)")
    right.set_xticks(missing)
    for axes in (left, right):
        tidy(axes)
        axes.set_ylim(0, None)
        axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)
    return figure


def _means(found: Sequence[Interval]) -> tuple[list[float], list[float]]:
    return [one.value for one in found], [one.half for one in found]
