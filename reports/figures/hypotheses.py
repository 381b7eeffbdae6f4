"""Detections and hypotheses from three sides, together and one by one.

save_figure(hypotheses_figure(tree, hypotheses), path)
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS
from poseterior.reports.figures.body import draw_detection, draw_image
from poseterior.reports.figures.colours import (
    COLOURS,
    DRAW_COLOUR,
    LEFT_LIMBS,
    LIMB_OF,
    MAX_NAMED,
    SEGMENTS,
    hypothesis_colours,
)
from poseterior.reports.figures.legend import (
    colour_handles,
    draw_legend,
    legend_height,
    style_handles,
)
from poseterior.reports.figures.style import (
    DASHES,
    DPI,
    FAINT,
    INK,
    SMALL,
    Style,
    blank,
    entitle,
    footnote,
    note,
    page,
)
from poseterior.reports.figures.window import WINDOW_DRAWS, Window, cropped, window_of
from poseterior.reports.tables.posterior import (
    LIKELY_FAULT,
    faults_of,
    heaviest,
    is_uncertain,
    projected,
    values,
)
from poseterior.reports.tables.sheet import percent
from poseterior.reports.tables.words import undetected

if TYPE_CHECKING:
    from poseterior.inference.hypothesis import Hypothesis

SHEET_WIDTH, HIGHEST = 10.5, 4.2
"""Inches: the width of the page, and the most that its panels are high."""
GAP, TOP, NOTES, SIDE = 0.3, 0.33, 0.5, 0.12
"""Inches between panels, above them for a title, below for notes, and at the page's edges."""
HIGHEST_ALONE, WIDEST_ALONE = 1.9, 1.7
"""Inches that a panel of a single hypothesis has at most."""


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


class Flat(NamedTuple):
    """What a view shows, in its two axes and body units: `draws` `(n, 15, 2)`, hypotheses
    `(k, 15, 2)`, and the `truth` `(15, 2)` if it is known."""

    draws: np.ndarray
    hypotheses: np.ndarray
    truth: np.ndarray | None

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners that hold all of the poses and nearly all of the draws."""
        named = [self.hypotheses] if self.truth is None else [self.hypotheses, self.truth[None]]
        points = np.concatenate(named).reshape(-1, 2)
        if len(self.draws):
            most = np.quantile(self.draws, [0.03, 0.97], axis=0).reshape(-1, 2)
            points = np.concatenate([points, most])
        if not len(points):
            return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
        return points.min(axis=0) - 0.15, points.max(axis=0) + 0.15


PANES = (
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
    """Detections with their discs; the hypotheses from the camera, over the image, from the side
    and from above, over some of the draws; and below each of them alone, from the side.

    Parameters
    ----------
    tree
        A posterior.
    hypotheses
        Of its draws, the heaviest first.
    image
        `(H, W, 3)`, drawn under the detections, and under what the camera sees of the hypotheses.
    truth
        `(15, 3)` in camera axes and body units, drawn in black; from the camera where the heaviest
        candidate would see it.

    Raises
    ------
    BadInput
        Where the image is not one, or shows none of the detected joints.
    """
    window = window_of(tree, image)
    flats = [_flattened(tree, hypotheses, truth, view) for view in PANES]
    colours = colour_handles(hypotheses)
    draws = len(flats[0].draws)
    styles = style_handles(truth is not None, draws)
    alone = hypotheses[:MAX_NAMED] if len(hypotheses) > 1 else []
    figure, axes, singles = _panels(
        window, [flat.extent() for flat in flats], len(alone), legend_height(colours)
    )
    _draw_detections(axes[0], tree, window, image)
    if image is not None:
        low = axes[1].get_xlim()
        high = axes[1].get_ylim()
        part = cropped(image, window)
        camera = _heaviest_camera(tree)
        draw_image(axes[1], part.pixels, 0.35, (part.corners - camera.translation) / camera.scale)
        axes[1].set(xlim=low, ylim=high)
    for axis, view, flat in zip(axes[1:], PANES, flats, strict=True):
        _draw_view(axis, view, flat)
    _scale_bar(axes[1])
    for rank, (axis, one) in enumerate(zip(singles, alone, strict=True)):
        _draw_alone(axis, flats[1], rank, one)
    draw_legend(figure, colours, styles)
    return figure


class Seen(NamedTuple):
    """Where a camera sees the pelvis, `translation` `(2,)` in pixels, and its `scale`, pixels per
    body unit."""

    translation: np.ndarray
    scale: float


def _heaviest_camera(tree: xr.DataTree) -> Seen:
    index = heaviest(tree)
    translation, scale = (values(tree, "constant_data", name) for name in ("translation", "scale"))
    return Seen(translation[index], float(scale[index]))


def _flattened(
    tree: xr.DataTree,
    hypotheses: Sequence["Hypothesis"],
    truth: np.ndarray | None,
    view: Pane,
) -> Flat:
    """A view of a posterior. From the camera, every pose is where its own camera sees it, in units
    of the heaviest candidate's: there it lies over the image."""
    axes = [view.across, view.along]
    if view is PANES[0]:
        camera = _heaviest_camera(tree)
        drawn, chosen = (
            (points - camera.translation) / camera.scale
            for points in (values(tree, "posterior", "keypoints"), projected(tree, hypotheses))
        )
    else:
        drawn = values(tree, "posterior", "joints")[..., axes]
        chosen = np.array([one.joints[:, axes] for one in hypotheses])
    chosen = chosen.reshape(-1, NUM_JOINTS, 2)
    return Flat(drawn[:WINDOW_DRAWS], chosen, None if truth is None else truth[:, axes])


def _panels(
    window: Window, boxes: list[tuple[np.ndarray, np.ndarray]], alone: int, below: float
) -> tuple[Figure, list[Axes], list[Axes]]:
    """Axes in a row, tops aligned, the last three to one scale; under them a row of `alone` axes,
    all as the view from the side; `below` inches free for the legend. The page is `SHEET_WIDTH`
    wide and as high as what is shown then needs, within limits."""
    spans = np.array([high - low for low, high in boxes])
    pixels = window.high - window.low
    # In units of the row's height.
    shapes = np.concatenate([[pixels / pixels[1]], spans / spans[:, 1].max()])
    free = SHEET_WIDTH - 2 * SIDE - 3 * GAP
    sizes = shapes * min(free / shapes[:, 0].sum(), HIGHEST)
    gap = GAP + max(0.0, free - sizes[:, 0].sum()) / 3
    small = spans[1] * min(HIGHEST_ALONE / spans[1, 1], WIDEST_ALONE / spans[1, 0])
    small *= min(1.0, (SHEET_WIDTH - 2 * SIDE) / max(1, alone) / (small[0] + GAP))
    second = small[1] + TOP + 0.1 if alone else 0.0
    total = TOP + sizes[0, 1] + NOTES + second + below
    figure = page(SHEET_WIDTH, total, dpi=DPI, layout=None)
    lefts = SIDE + np.concatenate([[0.0], np.cumsum(sizes[:-1, 0] + gap)])
    titles = ("Detections", *(view.title for view in PANES))
    axes = [
        _panel(figure, (left, total - TOP - size[1]), size, title)
        for left, size, title in zip(lefts, sizes, titles, strict=True)
    ]
    for axis, view, (low, high) in zip(axes[1:], PANES, boxes, strict=True):
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(*((high[1], low[1]) if view.flip else (low[1], high[1])))
    step = (SHEET_WIDTH - 2 * SIDE) / max(1, alone)
    singles = [_panel(figure, (SIDE + step * one, below), small, "") for one in range(alone)]
    for axis in singles:
        axis.set(xlim=axes[2].get_xlim(), ylim=axes[2].get_ylim())
    return figure, axes, singles


def _panel(figure: Figure, corner: tuple[float, float], size: np.ndarray, title: str) -> Axes:
    """Empty axes of a size at a place of the page, inches."""
    whole = figure.get_size_inches()
    axis = figure.add_axes((*(np.array(corner) / whole), *(size / whole)))
    entitle(axis, title, pad=5)
    axis.set_aspect("equal", adjustable="box", anchor="NW")
    blank(axis)
    return axis


def _draw_detections(
    axis: Axes, tree: xr.DataTree, window: Window, image: np.ndarray | None
) -> None:
    keypoints = values(tree, "observed_data", "keypoints")
    radius = values(tree, "constant_data", "radius")[heaviest(tree)]
    if image is not None:
        part = cropped(image, window)
        draw_image(axis, part.pixels, 0.6, part.corners)
    draws = values(tree, "posterior", "keypoints")[:WINDOW_DRAWS]
    # The torso's joints have clouds of their own only where they move.
    for joint in range(NUM_JOINTS) if is_uncertain(tree) else LIMB_OF:
        u, v = draws[:, joint].T
        cloud = axis.scatter(u, v, s=3, color=COLOURS[joint], alpha=0.22, zorder=1)
        cloud.set(linewidths=0, gid=f"cloud {JOINTS[joint]}")
    draw_detection(axis, keypoints, radius, 1.3)
    faults = faults_of(tree)
    wrong = (
        [name for name, share in faults.outlier.items() if share > LIKELY_FAULT] if faults else []
    )
    for name in wrong:
        at = keypoints[JOINT_INDEX[name]]
        axis.plot(*at, "x", color=INK, ms=9, mew=1.6, zorder=6, gid=f"outlier {name}")
    axis.set_xlim(window.low[0], window.high[0])
    axis.set_ylim(window.high[1], window.low[1])
    axis.spines[:].set_visible(True)
    axis.spines[:].set(color="#CCCCCC", lw=0.6)
    lost = [
        undetected(JOINTS[joint]) for joint in LIMB_OF if not np.isfinite(keypoints[joint]).all()
    ]
    sentences = ["purple: right, green: left"]
    sentences += [] if is_uncertain(tree) else ["torso and camera: held fixed"]
    sentences += faults.lines if faults else []
    footnote(axis, *sentences, *(["not detected: " + ", ".join(lost)] if lost else []))


def _draw_view(axis: Axes, view: Pane, flat: Flat) -> None:
    _draw_draws(axis, flat, 0.09)
    number = len(flat.hypotheses)
    colours = hypothesis_colours(number)
    pens = [Pen(colour, 1.6 if rank < MAX_NAMED else 0.6) for rank, colour in enumerate(colours)]
    for rank in reversed(range(number)):  # the heaviest on top
        gid = f"hypothesis {rank + 1}"
        _draw_pose(axis, flat.hypotheses[rank], pens[rank], gid, 10 + number - rank)
    if flat.truth is not None:
        _draw_pose(axis, flat.truth, Pen("black", 1.0, dashed=True), "truth", 11 + number)
    if not len(flat.draws):
        note(axis, "no draws")
    if view.hint:
        footnote(axis, view.hint)


def _draw_alone(axis: Axes, flat: Flat, rank: int, one: "Hypothesis") -> None:
    """One hypothesis from the side, its share as the title; all five of them make a tangle."""
    _draw_draws(axis, flat, 0.05)
    colour = hypothesis_colours(rank + 1)[rank]
    _draw_pose(axis, flat.hypotheses[rank], Pen(colour, 1.4), f"alone {rank + 1}", 10)
    if flat.truth is not None:
        _draw_pose(axis, flat.truth, Pen("black", 0.8, dashed=True), "truth", 11)
    words = percent(one.weight) + (" alone, from the side" if rank == 0 else "")
    axis.set_title(words, loc="left", fontsize=SMALL, color=INK, pad=3)


def _draw_draws(axis: Axes, flat: Flat, alpha: float) -> None:
    options: Style = {"colors": DRAW_COLOUR, "lw": 0.5, "alpha": alpha, "zorder": 1, "gid": "draws"}
    axis.add_collection(LineCollection(list(_bones(flat.draws, SEGMENTS)), **options))


def _bones(points: np.ndarray, segments: Sequence[tuple[int, int]]) -> np.ndarray:
    """`(..., 3 segments, 2)`: the bones of poses `(..., 15, 2)` as one line with gaps: a line for
    each bone takes matplotlib ten times as long."""
    path = np.full((*points.shape[:-2], len(segments), 3, 2), np.nan)
    path[..., :2, :] = points[..., np.array(segments), :]
    return path.reshape(*points.shape[:-2], 3 * len(segments), 2)


def _draw_pose(axis: Axes, points: np.ndarray, pen: Pen, gid: str, zorder: int) -> None:
    """Right limbs and torso solid, left limbs dashed and ending in hollow joints."""
    for left in (False, True):
        segments = [pair for pair in SEGMENTS if (pair[1] in LEFT_LIMBS) == left]
        ends = points[[joint for joint in LIMB_OF if (joint in LEFT_LIMBS) == left]]
        line: Style = {"color": pen.colour, "lw": pen.width, "zorder": zorder, "gid": gid}
        axis.plot(*_bones(points, segments).T, ls=DASHES if pen.dashed or left else "-", **line)
        dots: Style = {"mec": pen.colour, "mew": pen.width / 2, "zorder": zorder + 0.5, "gid": gid}
        axis.plot(*ends.T, "o", ms=1 + pen.width, mfc="white" if left else pen.colour, **dots)


def _scale_bar(axis: Axes) -> None:
    left = axis.get_xlim()[0]
    bottom = max(axis.get_ylim())
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
