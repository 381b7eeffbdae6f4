"""What all figures share: colours, sizes of text, a page to draw on.

Figures are made without pyplot: no screen, no global state. Artists carry a `gid` (such as "disc
right_knee") that names what they show.
"""

import textwrap
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from probmodel.skeleton import GROUPS, NUM_JOINTS, PARENTS

Style = dict[str, Any]
"""Options of an artist."""
DPI = 200
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#8C6D31")
"""Okabe & Ito's, told apart with any colour vision; a brown in place of its black, which is the
truth's."""
LIMB_COLOURS = {
    "head": "#555555",
    "right arm": "#762A83",
    "right leg": "#B088BD",
    "left arm": "#1B7837",
    "left leg": "#73B87A",
}
"""Purple right, green left; arms dark, legs light."""
TORSO_COLOUR, OTHER_COLOUR = "#555555", "#9A9A9A"
INK, FAINT = "#222222", "#777777"
SMALL, LEGEND, TEXT, TITLE = 7.0, 7.5, 8.0, 9.0
"""Points."""
LETTERS = 19
"""Of `SMALL` size in an inch."""
DASHES = (0, (2.2, 1.1))
SEGMENTS = tuple((PARENTS[joint], joint) for joint in range(1, NUM_JOINTS))
LIMB_OF = {
    bone.end: limb.name for limbs in GROUPS.values() for limb in limbs for bone in limb.bones
}
"""The limb of each joint that moves."""
LEFT_LIMBS = {joint for joint, limb in LIMB_OF.items() if limb.startswith("left")}
COLOURS = [
    LIMB_COLOURS[LIMB_OF[joint]] if joint in LIMB_OF else TORSO_COLOUR
    for joint in range(NUM_JOINTS)
]
"""By joint."""


def page(
    width: float,
    height: float,
    *,
    dpi: int = 100,
    layout: Literal["constrained"] | None = "constrained",
) -> Figure:
    """An empty white figure, inches wide and high."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def tidy(axes: Axes) -> None:
    """Takes the upper and the right edge away."""
    axes.spines[["top", "right"]].set_visible(False)


def blank(axes: Axes) -> None:
    """Takes all edges and ticks away."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)


def note(axes: Axes, text: str, x: float = 0, y: float = 0.98, **options: Any) -> None:
    """Writes small and grey at a place in the axes, `x` and `y` from 0 to 1."""
    given: Style = {"va": "top", "fontsize": SMALL, "color": FAINT}
    axes.text(x, y, text, transform=axes.transAxes, **given | options)


def footnote(axes: Axes, *sentences: str) -> None:
    """Writes sentences below the axes, broken to their width."""
    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    width = axes.get_position().width * figure.get_figwidth()
    letters = max(12, int(width * LETTERS))
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence, letters)]
    note(axes, "\n".join(lines), y=-0.015, gid="note")
