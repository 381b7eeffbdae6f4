"""The leaderboard in pictures: a row a sampler, a panel a target, so that twenty samplers need no
legend; and how the ratio of exact draws to the best other grows with the dimension."""

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.benchmark.catalogue import load, targets
from poseterior.inference.benchmark.entrants import GIFT
from poseterior.inference.studies.comparison.judge import AGREES, DIFFERS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, SMALL, TEXT, TITLE, page, tidy
from poseterior.reports.tables.leaderboard import SECONDS, Line, contests, pace_of

LEGEND_COLUMNS = 7
"""Panels in a row."""
VERDICT_COLOURS = {AGREES: PALETTE[2], DIFFERS: PALETTE[1]}
"""Of the verdicts; any other is grey."""
DIMENSIONS = (4, 36)
"""Between which all targets are, with room for their names."""
LEAST_PACE = 0.01
"""Effective draws a second below which all are drawn alike."""


def paces(lines: Sequence[Line]) -> Figure:
    """What each sampler earns a second on each target."""
    figure = _dots(lines, lambda one: max(pace_of(one), LEAST_PACE))
    figure.supxlabel("effective draws earned a CPU second", fontsize=TEXT)
    return figure


def times(lines: Sequence[Line]) -> Figure:
    """How long each sampler takes to come within 0.1 sd on each target."""
    figure = _dots(lines, lambda one: one["to_distance"])
    figure.supxlabel("CPU seconds to 0.1 standard deviations", fontsize=TEXT)
    return figure


def _label(line: Line) -> str:
    return line["sampler"] + (" (given)" if line["start"] == GIFT else "")


def _dots(lines: Sequence[Line], value: Callable[[Line], float | None]) -> Figure:
    """Small multiples: a row a sampler and start, best ones above; a cross at the left where it ran
    and has no value."""
    own = [one for one in lines if one["budget"] == SECONDS]
    shown = [name for name in targets() if any(one["target"] == name for one in own)]
    rows = -(-len(shown) // LEGEND_COLUMNS)
    columns = min(len(shown), LEGEND_COLUMNS)
    labels = _ranked(own)
    figure = page(1.1 + 1.25 * columns, (0.8 + 0.14 * len(labels)) * rows)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes, target in zip(panels, shown, strict=False):
        _panel(axes, [one for one in own if one["target"] == target], labels, value)
        axes.set_title(f"{target}, {load(target).dim}", fontsize=TITLE - 1)
    panels[0].set_yticks(range(len(labels)), labels)
    panels[0].set_ylim(len(labels) - 0.5, -0.5)
    return figure


def _ranked(lines: Sequence[Line]) -> list[str]:
    """Labels of the rows, those first that agree most often, and then those that earn most."""
    agreeing: dict[str, tuple[int, float]] = {}
    for one in lines:
        number, most = agreeing.get(_label(one), (0, 0.0))
        agreeing[_label(one)] = number + (one["verdict"] == AGREES), max(most, pace_of(one))
    return sorted(agreeing, key=lambda label: agreeing[label], reverse=True)


def _panel(
    axes: Axes,
    lines: Sequence[Line],
    labels: list[str],
    value: Callable[[Line], float | None],
) -> None:
    for one in lines:
        row = labels.index(_label(one))
        place = value(one) if "earned" in one else None
        if place is None:
            axes.plot(0.04, row, "x", color=FAINT, ms=3.5, transform=axes.get_yaxis_transform())
            continue
        axes.plot(
            place,
            row,
            "o",
            color=VERDICT_COLOURS.get(one["verdict"], FAINT),
            ms=4.5,
            fillstyle="none" if one["start"] == GIFT else "full",
            gid=f"{_label(one)} {one['target']}",
        )
    axes.set(xscale="log")
    axes.grid(axis="y", color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL, length=2)
    axes.tick_params(axis="y", length=0)
    tidy(axes)


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
