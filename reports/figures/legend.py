"""The legend of the figure of hypotheses: colours tell hypotheses, styles tell sides."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from poseterior.reports.figures.colours import DRAW_COLOUR, MAX_NAMED, OTHER_COLOUR, PALETTE
from poseterior.reports.figures.style import DASHES, FAINT, INK, LEGEND, SMALL, Style
from poseterior.reports.tables.words import facing_words, pose_facing

if TYPE_CHECKING:
    from poseterior.inference.hypothesis import Hypothesis

LINE, FLIP_COLUMNS = 0.19, 5
"""Inches between lines, and columns."""


def colour_handles(hypotheses: Sequence["Hypothesis"]) -> list[Line2D]:
    """What the colours mean."""
    handles = [
        _handle(
            f"{100 * one.weight:.0f} %, {facing_words(pose_facing(one.joints))}",
            color=colour,
            lw=1.6,
        )
        for one, colour in zip(hypotheses, PALETTE, strict=False)
    ]
    if rest := hypotheses[MAX_NAMED:]:
        share = 100 * sum(one.weight for one in rest)
        handles.append(_handle(f"{share:.0f} %, {len(rest)} more", color=OTHER_COLOUR, lw=0.6))
    return handles


def style_handles(truth: bool, draws: int) -> list[Line2D]:
    """What the styles of lines mean."""
    limb: Style = {"color": INK, "lw": 1.2, "marker": "o", "ms": 2.6}
    handles = [
        _handle("right limbs", **limb),
        _handle("left limbs", **limb, ls=DASHES, mfc="white"),
    ]
    if truth:
        handles.append(_handle("truth", color="black", lw=1.0, ls=DASHES))
    if draws:
        handles.append(_handle(f"{draws} posterior draws", color=DRAW_COLOUR, lw=0.8, alpha=0.6))
    return handles


def _handle(label: str, **style: Any) -> Line2D:
    return Line2D([], [], label=label, **style)


def legend_height(colours: list[Line2D]) -> float:
    """Inches that the legend needs: one line for styles, and what the colours take."""
    return 0.12 + LINE * (1 - (-len(colours) // FLIP_COLUMNS))


def draw_legend(figure: Figure, colours: list[Line2D], styles: list[Line2D]) -> None:
    """Two blocks at the foot of the page."""
    width, height = figure.get_size_inches()
    if colours:
        figure.text(
            1 - 0.12 / width,
            0.08 / height,
            "colours: share of the draws, where the chest faces",
            ha="right",
            va="bottom",
            fontsize=SMALL,
            color=FAINT,
        )
    for handles, bottom in ((styles, 0.08), (colours, 0.08 + LINE)):
        legend = figure.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.1 / width, bottom / height),
            frameon=False,
            fontsize=LEGEND,
            ncols=FLIP_COLUMNS,
            handlelength=2.2,
            labelspacing=0.3,
            columnspacing=1.6,
            borderaxespad=0,
            borderpad=0,
            labelcolor=INK,
        )
        figure.add_artist(legend)
