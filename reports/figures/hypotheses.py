"""Detections and hypotheses from three sides.

save_figure(hypotheses_figure(tree, hypotheses), path)
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from probmodel.skeleton import JOINTS, NUM_JOINTS
from reports.figures.body import draw_detection, draw_image
from reports.figures.colours import (
    COLOURS,
    DRAW_COLOUR,
    LEFT_LIMBS,
    LIMB_OF,
    MAX_NAMED,
    SEGMENTS,
    hypothesis_colours,
)
from reports.figures.legend import colour_handles, draw_legend, legend_height, style_handles
from reports.figures.style import (
    DASHES,
    DPI,
    FAINT,
    INK,
    SMALL,
    TITLE,
    Style,
    blank,
    footnote,
    note,
    page,
)
from reports.figures.window import MAX_DRAWS, Window, window_of
from reports.tables.posterior import heaviest, is_uncertain, values
from reports.tables.words import spoken

if TYPE_CHECKING:
    from inference.hypothesis import Hypothesis

WIDTH, HIGHEST = 10.5, 4.2
"""Inches: the width of the page, and the most that its panels are high."""


class Pane(NamedTuple):
    """A panel: its title, which camera axis runs across the page and which along it, whether the
    latter points down, and a word on the depth."""

    title: str
    across: int
    along: int
    flip: bool
    hint: str


class Pen(NamedTuple):
    """How a pose is drawn: colour, width of its lines in points, and whether all of them are
    dashed."""

    colour: str
    width: float
    dashed: bool = False


VIEWS = (
    Pane("From the camera", 0, 1, True, ""),
    Pane("From the side", 2, 1, True, "→ away from the camera"),
    Pane("From above", 0, 2, False, "↑ away from the camera"),
)


def hypotheses_figure(
    tree: xr.DataTree,
    hypotheses: Sequence["Hypothesis"],
    *,
    image: np.ndarray | None = None,
    truth: np.ndarray | None = None,
) -> Figure:
    """Detections with their discs; and the hypotheses from the camera, from the side and from
    above, in body units, over some of the draws.

    Parameters
    ----------
    tree
        A posterior.
    hypotheses
        The heaviest first.
    image
        `(H, W, 3)`, drawn under the detections.
    truth
        `(15, 3)` in camera axes, drawn in black.

    Raises
    ------
    BadInput
        Where the image is not one, or shows none of the detected joints.
    """
    draws = values(tree, "posterior", "joints")[:MAX_DRAWS]
    poses = [hypothesis.joints for hypothesis in hypotheses] + ([] if truth is None else [truth])
    named = np.array(poses).reshape(-1, NUM_JOINTS, 3)
    window = window_of(tree, image)
    boxes = [_extent(draws, named, view) for view in VIEWS]
    colours, styles = colour_handles(hypotheses), style_handles(truth is not None, len(draws))
    figure, axes = _panels(window, boxes, legend_height(colours))
    _draw_detections(axes[0], tree, window, image)
    for axis, view, (low, high) in zip(axes[1:], VIEWS, boxes, strict=True):
        _draw_view(axis, view, draws, hypotheses, truth)
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(*((high[1], low[1]) if view.flip else (low[1], high[1])))
    _scale_bar(axes[1])
    draw_legend(figure, colours, styles)
    return figure


def _extent(draws: np.ndarray, named: np.ndarray, view: Pane) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a view, body units, that hold all of the `named` poses `(n, 15, 3)` and nearly all
    of the draws."""
    flat = [view.across, view.along]
    points = named[:, :, flat].reshape(-1, 2)
    if len(draws):
        points = np.concatenate(
            [points, np.quantile(draws[:, :, flat], [0.03, 0.97], axis=0).reshape(-1, 2)]
        )
    if not len(points):
        return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    return points.min(axis=0) - 0.15, points.max(axis=0) + 0.15


def _panels(
    window: Window, boxes: list[tuple[np.ndarray, np.ndarray]], below: float
) -> tuple[Figure, list[Axes]]:
    """Axes in one row, tops aligned, the last three to one scale, `below` inches free for the
    legend. The page is `WIDTH` wide and as high as what is shown then needs, within limits."""
    gap, top, notes, side = 0.3, 0.33, 0.42, 0.12
    spans = np.array([high - low for low, high in boxes])
    pixels = window.high - window.low
    # In units of the row's height.
    shapes = np.concatenate([[pixels / pixels[1]], spans / spans[:, 1].max()])
    free = WIDTH - 2 * side - 3 * gap
    sizes = shapes * min(free / shapes[:, 0].sum(), HIGHEST)
    gap += max(0.0, free - sizes[:, 0].sum()) / 3
    total = top + sizes[0, 1] + notes + below
    figure = page(WIDTH, total, dpi=DPI, layout=None)
    left, axes = side, []
    titles = ("Detections", *(view.title for view in VIEWS))
    for (wide, high), title in zip(sizes, titles, strict=True):
        place = (left / WIDTH, (total - top - high) / total, wide / WIDTH, high / total)
        axis = figure.add_axes(place)
        axis.set_title(title, loc="left", fontsize=TITLE, fontweight="bold", color=INK, pad=5)
        axis.set_aspect("equal", adjustable="box", anchor="NW")
        blank(axis)
        left += wide + gap
        axes.append(axis)
    return figure, axes


def _draw_detections(
    axis: Axes, tree: xr.DataTree, window: Window, image: np.ndarray | None
) -> None:
    keypoints = values(tree, "observed_data", "keypoints")
    radius = values(tree, "constant_data", "radius")[heaviest(tree)]
    if image is not None:
        draw_image(axis, image, 0.6)
    draws = values(tree, "posterior", "keypoints")[:MAX_DRAWS]
    # The torso's joints have clouds of their own only where they move.
    for joint in range(NUM_JOINTS) if is_uncertain(tree) else LIMB_OF:
        u, v = draws[:, joint].T
        cloud = axis.scatter(u, v, s=3, color=COLOURS[joint], alpha=0.22, zorder=1)
        cloud.set(linewidths=0, gid=f"cloud {JOINTS[joint]}")
    draw_detection(axis, keypoints, radius, 1.3)
    axis.set_xlim(window.low[0], window.high[0])
    axis.set_ylim(window.high[1], window.low[1])
    axis.spines[:].set_visible(True)
    axis.spines[:].set(color="#CCCCCC", lw=0.6)
    lost = [spoken(JOINTS[joint]) for joint in LIMB_OF if not np.isfinite(keypoints[joint]).all()]
    footnote(axis, "purple: right, green: left", *(["missing: " + ", ".join(lost)] if lost else []))


def _draw_view(
    axis: Axes,
    view: Pane,
    draws: np.ndarray,
    hypotheses: Sequence["Hypothesis"],
    truth: np.ndarray | None,
) -> None:
    flat = [view.across, view.along]
    bones = list(draws[:, np.array(SEGMENTS)][..., flat].reshape(-1, 2, 2))
    options: Style = {"colors": DRAW_COLOUR, "lw": 0.5, "alpha": 0.09, "zorder": 1, "gid": "draws"}
    axis.add_collection(LineCollection(bones, **options))
    colours = hypothesis_colours(len(hypotheses))
    pens = [Pen(colour, 1.6 if rank < MAX_NAMED else 0.6) for rank, colour in enumerate(colours)]
    for rank, hypothesis in reversed(list(enumerate(hypotheses))):  # the heaviest on top
        height = 10 + len(hypotheses) - rank
        _draw_pose(axis, hypothesis.joints[:, flat], pens[rank], f"hypothesis {rank + 1}", height)
    if truth is not None:
        pen = Pen("black", 1.0, dashed=True)
        _draw_pose(axis, truth[:, flat], pen, "truth", 11 + len(hypotheses))
    if not len(draws):
        note(axis, "no draws")
    if view.hint:
        footnote(axis, view.hint)


def _draw_pose(axis: Axes, points: np.ndarray, pen: Pen, gid: str, zorder: int) -> None:
    """Right limbs and torso solid, left limbs dashed and ending in hollow joints."""
    for left in (False, True):
        segments = [pair for pair in SEGMENTS if (pair[1] in LEFT_LIMBS) == left]
        ends = points[[joint for joint in LIMB_OF if (joint in LEFT_LIMBS) == left]]
        # One line with gaps: a line for each bone takes matplotlib ten times as long.
        path = np.full((3 * len(segments), 2), np.nan)
        path[0::3], path[1::3] = points[np.array(segments)].swapaxes(0, 1)
        line: Style = {"color": pen.colour, "lw": pen.width, "zorder": zorder, "gid": gid}
        axis.plot(*path.T, ls=DASHES if pen.dashed or left else "-", **line)
        dots: Style = {"mec": pen.colour, "mew": pen.width / 2, "zorder": zorder + 0.5, "gid": gid}
        axis.plot(*ends.T, "o", ms=1 + pen.width, mfc="white" if left else pen.colour, **dots)


def _scale_bar(axis: Axes) -> None:
    left, bottom = axis.get_xlim()[0], max(axis.get_ylim())
    bar: Style = {"color": INK, "lw": 1.2, "solid_capstyle": "butt", "gid": "scale bar"}
    axis.plot([left, left + 1], [bottom, bottom], clip_on=False, **bar)
    axis.annotate(
        "1 body unit",
        (left, bottom),
        xytext=(0, -3),
        textcoords="offset points",
        va="top",
        fontsize=SMALL,
        color=FAINT,
    )
