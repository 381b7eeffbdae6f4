"""The leaderboard in pictures: a row a sampler, a column a target; and how the ratio of exact draws
to the best other grows with the dimension."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from poseterior.inference.benchmark.catalogue import load, targets
from poseterior.inference.studies.comparison.judge import (
    AGREES,
    CANNOT_TELL,
    DIFFERS,
    UNMIXED,
)
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import INK, SMALL, page, tidy
from poseterior.reports.tables.leaderboard import (
    Line,
    contests,
    entered,
    pace_of,
    ranking,
    verdict_of,
)

VERDICT_COLOURS = {AGREES: PALETTE[2], DIFFERS: PALETTE[1], UNMIXED: "#F0E442"}
"""Of the verdicts; any other is white."""
DIMENSIONS = (4, 36)
"""Between which all targets are, with room for their names."""
MARKS = {CANNOT_TELL: "?", "no draws": "·"}
"""What stands in a cell that has no number to believe."""


def standings(lines: Sequence[Line]) -> Figure:
    """A row a sampler in the order of the ranking, a column a target: the colour is the verdict,
    the number what it earned a second."""
    own = entered(lines)
    rows = [str(record["sampler"]) for record in ranking(lines).records]
    shown = [name for name in targets() if any(one["target"] == name for one in own)]
    figure = page(1.2 + 0.5 * len(shown), 1.5 + 0.24 * len(rows))
    axes = figure.subplots()
    for one in own:
        _cell(axes, shown.index(one["target"]), rows.index(one["sampler"]), one)
    axes.set_xticks(range(len(shown)), [f"{name}, {load(name).dim}" for name in shown])
    axes.tick_params(axis="x", rotation=40, labeltop=True, labelbottom=False, length=0)
    for label in axes.get_xticklabels():
        label.set(ha="left", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(labelsize=SMALL + 1)
    axes.set(xlim=(-0.5, len(shown) - 0.5), ylim=(len(rows) - 0.5, -0.5))
    axes.spines[:].set_visible(False)
    return figure


def _cell(axes: Axes, column: int, row: int, line: Line) -> None:
    said = verdict_of(line)
    colour = VERDICT_COLOURS.get(said, "white")
    place = (column - 0.48, row - 0.46)
    axes.add_patch(Rectangle(place, 0.96, 0.92, color=colour, alpha=0.55, lw=0))
    number = "" if said in MARKS else _short(pace_of(line))
    axes.text(
        *(column, row, MARKS.get(said, number)),
        ha="center",
        va="center",
        fontsize=SMALL,
        color=INK,
        gid=f"{line['sampler']} {line['target']}",
    )


def _short(pace: float) -> str:
    """A rate in four characters."""
    if pace >= 1000:
        return f"{pace / 1000:.0f}k"
    return f"{pace:.0f}" if pace >= 10 else f"{pace:.1f}"


def growth(lines: Sequence[Line]) -> Figure:
    """The ratios of exact draws to the best other, against the dimension."""
    found = contests(lines)
    figure = page(8.6, 3.8)
    left, right = figure.subplots(1, 2)
    earned = [(one["dim"], one["ratio"], one["target"], False) for one in found if one["ratio"]]
    _ratios(left, earned)
    alone = [one["target"] for one in found if one["ratio"] is None]
    said = f"no other that was run agrees on {len(alone)} of {len(found)}" if alone else ""
    left.set_title(f"effective draws earned a second\n{said}", fontsize=SMALL + 0.5)
    timed = [
        (one["dim"], one["times"], one["target"], one["first"] is None)
        for one in found
        if one["times"]
    ]
    _ratios(right, timed)
    right.set_title(
        "time to 0.1 sd, the other's over that of exact draws\ntriangles: more than this; none that"
        " was run came there",
        fontsize=SMALL + 0.5,
    )
    return figure


def _ratios(axes: Axes, points: list[tuple[int, float, str, bool]]) -> None:
    """Ratios `(dimension, ratio, name, whether it is a bound)`, each with its name beside it."""
    for dim, ratio, name, bound in points:
        soft = name.endswith("-soft")
        axes.plot(
            dim,
            ratio,
            "^" if bound else "o",
            color=PALETTE[1] if bound else PALETTE[0],
            ms=5,
            fillstyle="none" if soft else "full",
        )
    axes.set(yscale="log", xlabel="dimensions", ylabel="exact draws ahead, times")
    axes.set_xlim(*DIMENSIONS)
    axes.margins(y=0.3)
    _name(axes, [point[:3] for point in points])
    tidy(axes)


def _name(axes: Axes, named: list[tuple[int, float, str]]) -> None:
    """Writes the names of all points of a dimension above or below them in turn, in their order
    from above."""
    for place, dim in enumerate(sorted({one[0] for one in named})):
        own = sorted((one[1:] for one in named if one[0] == dim), reverse=True)
        above = place % 2 == 0
        axes.annotate(
            "\n".join(words for _, words in own),
            (dim, own[0][0] if above else own[-1][0]),
            xytext=(0, 5 if above else -5),
            textcoords="offset points",
            ha="center",
            va="bottom" if above else "top",
            fontsize=6,
        )
