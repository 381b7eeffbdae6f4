"""What all figures share: sizes of text, a page to draw on.

Figures are made without pyplot: no screen, no global state. Artists carry a `gid` (such as "disc
right_knee") that names what they show.
"""

import textwrap
from typing import Any, Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Style = dict[str, Any]
"""Options of an artist."""
DPI = 200
INK, FAINT = "#222222", "#777777"
SMALL, LEGEND, TEXT, TITLE = 7.0, 7.5, 8.0, 9.0
"""Points."""
LETTERS = 19
"""Of `SMALL` size in an inch."""
DASHES = (0, (2.2, 1.1))


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


def entitle(axes: Axes, words: str, **options: Any) -> None:
    """Writes the title of a panel, bold, at its left."""
    given: Style = {"loc": "left", "fontsize": TITLE, "fontweight": "bold", "color": INK}
    axes.set_title(words, **given | options)


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
