"""Figures of a posterior: detections and hypotheses from three sides, and how far each joint's
depth is known.

`hypotheses_figure(tree, hypotheses)`, `depth_figure(tree)`, then `save_figure(figure, path)`.
Figures are made without pyplot: no screen, no global state. Artists carry a `gid` (such as "disc
right_knee") that names what they show."""

import os
import textwrap
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from PIL import Image, ImageOps

from probmodel.failures import BadInput
from probmodel.files import opened, replacing
from probmodel.skeleton import GROUPS, JOINTS, NUM_JOINTS, PARENTS
from reports.tables import facing_words, heaviest, pose_facing, spoken, values

if TYPE_CHECKING:
    from inference.hypothesis import Hypothesis

MAX_DRAWS = 150
"""Draws shown in the background of a panel; more of them make a grey block."""
MAX_PIXELS = 60_000_000
"""Images above this are refused before they are decoded: a small file can claim any size."""
DPI = 200
PAGE, HIGHEST = 10.5, 4.2
"""Inches: the width of the page of hypotheses, and the most that its panels are high."""
HYPOTHESIS_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#8C6D31")
"""Okabe & Ito's palette, told apart with any colour vision; a brown in place of its black, which is
the truth's."""
MAX_NAMED = len(HYPOTHESIS_COLOURS)
"""Hypotheses with a colour and an entry in the legend; the others are thin, grey and counted."""
LIMB_COLOURS = {
    "head": "#555555",
    "right arm": "#762A83",
    "right leg": "#B088BD",
    "left arm": "#1B7837",
    "left leg": "#73B87A",
}
"""Purple right, green left; arms dark, legs light."""
TORSO_COLOUR, DRAW_COLOUR, OTHER_COLOUR, INK, FAINT = (
    "#555555",
    "#8A8A8A",
    "#9A9A9A",
    "#222222",
    "#777777",
)
_SMALL, _LEGEND, _TEXT, _TITLE = 7.0, 7.5, 8.0, 9.0
_LINE, _COLUMNS = 0.19, 5
"""Inches between lines of a legend, and its columns."""
_DASHES = (0, (2.2, 1.1))
_SEGMENTS = tuple((PARENTS[joint], joint) for joint in range(1, NUM_JOINTS))
_LIMB_OF = {
    bone.end: limb.name for limbs in GROUPS.values() for limb in limbs for bone in limb.bones
}
_COLOUR_OF = {joint: LIMB_COLOURS[limb] for joint, limb in _LIMB_OF.items()}
_LEFT_LIMBS = {joint for joint, limb in _LIMB_OF.items() if limb.startswith("left")}


class View(NamedTuple):
    """A panel: its title, which camera axis runs along and which down (or up) the page, and a word
    on the depth."""

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
    View("From the camera", 0, 1, True, ""),
    View("From the side", 2, 1, True, "→ away from the camera"),
    View("From above", 0, 2, False, "↑ away from the camera"),
)


def hypotheses_figure(
    tree: xr.DataTree,
    hypotheses: Sequence["Hypothesis"],
    *,
    image: np.ndarray | None = None,
    truth: np.ndarray | None = None,
) -> Figure:
    """Detections with their discs (over the `image` `(H, W, 3)` if given), and the hypotheses from
    the camera, from the side and from above, in body units, over some of the draws; the `truth`
    `(15, 3)` in camera axes in black.

    Raises `BadInput` where the image is not one, or shows none of the detected joints.
    """
    draws = values(tree, "posterior", "joints")[:MAX_DRAWS]
    named = np.array(
        [*(hypothesis.joints for hypothesis in hypotheses), *([] if truth is None else [truth])]
    )
    window = _window(tree, image)
    boxes = [_extent(draws, named.reshape(-1, NUM_JOINTS, 3), view) for view in VIEWS]
    poses, styles = _legend_handles(hypotheses, truth is not None, len(draws))
    figure, axes = _page(window, boxes, 0.12 + _LINE * (1 + _legend_rows(poses)))
    _draw_detections(axes[0], tree, window, image)
    for axis, view, (low, high) in zip(axes[1:], VIEWS, boxes, strict=True):
        _draw_view(axis, view, draws, hypotheses, truth)
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(*((high[1], low[1]) if view.flip else (low[1], high[1])))
    _scale_bar(axes[1])
    _legend(figure, poses, styles)
    return figure


class Window(NamedTuple):
    """The part of the image that is shown: corners `(2,)`, pixels."""

    low: np.ndarray
    high: np.ndarray


def _window(tree: xr.DataTree, image: np.ndarray | None) -> Window:
    """What there is to see: discs, seen joints, nearly all draws; of an image only what lies around
    that."""
    keypoints = values(tree, "observed_data", "keypoints")
    radius = np.nan_to_num(values(tree, "constant_data", "radius")[heaviest(tree)])[:, None]
    seen = np.isfinite(keypoints).all(axis=1)
    points = np.concatenate([(keypoints - radius)[seen], (keypoints + radius)[seen]])
    projected = values(tree, "posterior", "keypoints")[:MAX_DRAWS].reshape(-1, 2)
    if len(projected):
        points = np.concatenate([points, np.quantile(projected, [0.01, 0.99], axis=0)])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * (high - low).max()
    low, high = low - margin, high + margin
    if image is not None:
        size = _image_size(image)
        if not ((keypoints[seen] >= 0) & (keypoints[seen] <= size)).all(axis=1).any():
            raise BadInput(
                f"the image is {size[0]} x {size[1]} pixels and none of the detected joints lies in"
                " it; give the image from which the detection was made."
            )
        low = np.maximum(low, np.minimum(0, points.min(axis=0)))
        high = np.minimum(high, np.maximum(size, points.max(axis=0)))
    # A panel of reasonable shape, whatever the pose: at least half as wide as high and as high as
    # wide.
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, half[::-1] * np.array([0.55, 0.75]))
    return Window(middle - half, middle + half)


def _image_size(image: np.ndarray) -> tuple[int, int]:
    if image.ndim != 3 or image.shape[2] not in (3, 4) or 0 in image.shape:
        raise BadInput(f"an image is an array of shape (height, width, 3), not {image.shape}.")
    return image.shape[1], image.shape[0]


def _extent(draws: np.ndarray, named: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
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


def _page(
    window: Window, boxes: list[tuple[np.ndarray, np.ndarray]], below: float
) -> tuple[Figure, list[Axes]]:
    """Axes in one row, tops aligned, the last three to one scale, `below` inches free for the
    legend.

    The page is `PAGE` wide and as high as what is shown then needs, within limits.
    """
    gap, top, notes, side = 0.3, 0.33, 0.42, 0.12
    spans = np.array([high - low for low, high in boxes])
    pixels = window.high - window.low
    shapes = np.concatenate(
        [[pixels / pixels[1]], spans / spans[:, 1].max()]
    )  # in units of the row's height
    free = PAGE - 2 * side - 3 * gap
    height = min(free / shapes[:, 0].sum(), HIGHEST)
    sizes = shapes * height
    gap += max(0.0, free - sizes[:, 0].sum()) / 3
    total = top + height + notes + below
    figure = Figure(figsize=(PAGE, total), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    left, axes = side, []
    for (wide, high), title in zip(
        sizes, ("Detections", *(view.title for view in VIEWS)), strict=True
    ):
        axis = figure.add_axes(
            (left / PAGE, (total - top - high) / total, wide / PAGE, high / total)
        )
        axis.set_title(title, loc="left", fontsize=_TITLE, fontweight="bold", color=INK, pad=5)
        axis.set_aspect("equal", adjustable="box", anchor="NW")
        axis.set_xticks([])
        axis.set_yticks([])
        axis.spines[:].set_visible(False)
        left += wide + gap
        axes.append(axis)
    return figure, axes


def _draw_detections(
    axis: Axes, tree: xr.DataTree, window: Window, image: np.ndarray | None
) -> None:
    keypoints = values(tree, "observed_data", "keypoints")
    radius = values(tree, "constant_data", "radius")[heaviest(tree)]
    if image is not None:
        size = _image_size(image)
        picture = axis.imshow(
            image, extent=(-0.5, size[0] - 0.5, size[1] - 0.5, -0.5), alpha=0.6, zorder=0
        )
        picture.set_gid("image")
    draws = values(tree, "posterior", "keypoints")[:MAX_DRAWS]
    for joint, colour in _COLOUR_OF.items():
        u, v = draws[:, joint].T
        axis.scatter(
            u,
            v,
            s=3,
            color=colour,
            alpha=0.22,
            linewidths=0,
            zorder=1,
            gid=f"cloud {JOINTS[joint]}",
        )
    for parent, joint in _SEGMENTS:
        if np.isfinite(keypoints[[parent, joint]]).all():
            axis.plot(
                *keypoints[[parent, joint]].T,
                color=_COLOUR_OF.get(joint, TORSO_COLOUR),
                lw=1.3,
                zorder=3,
                solid_capstyle="round",
                gid=f"bone {JOINTS[joint]}",
            )
    for joint, name in enumerate(JOINTS):
        colour = _COLOUR_OF.get(joint, TORSO_COLOUR)
        if np.isfinite(keypoints[joint]).all():
            axis.plot(
                *keypoints[joint],
                "o",
                ms=3.2,
                color=colour,
                mec="white",
                mew=0.5,
                zorder=4,
                gid=f"joint {name}",
            )
        if np.isfinite(radius[joint]):
            disc = Circle(
                tuple(keypoints[joint]),
                radius[joint],
                fc=(*to_rgb(colour), 0.12),
                ec=colour,
                lw=0.8,
                zorder=2,
            )
            disc.set_gid(f"disc {name}")
            axis.add_patch(disc)
    axis.set_xlim(window.low[0], window.high[0])
    axis.set_ylim(window.high[1], window.low[1])
    axis.spines[:].set_visible(True)
    axis.spines[:].set(color="#CCCCCC", lw=0.6)
    _footnote(axis, "purple: right, green: left", _missing(keypoints))


def _missing(keypoints: np.ndarray) -> str:
    names = [
        spoken(JOINTS[joint]) for joint in _COLOUR_OF if not np.isfinite(keypoints[joint]).all()
    ]
    return "missing: " + ", ".join(names) if names else ""


def _footnote(axis: Axes, *sentences: str) -> None:
    figure = axis.get_figure()
    assert isinstance(figure, Figure)
    width = axis.get_position().width * figure.get_figwidth()
    letters = max(12, int(width * 19))  # about 19 letters of this size fit into an inch
    lines = [line for sentence in sentences for line in textwrap.wrap(sentence, letters)]
    axis.text(
        0,
        -0.015,
        "\n".join(lines),
        transform=axis.transAxes,
        va="top",
        fontsize=_SMALL,
        color=FAINT,
        gid="note",
    )


def _draw_view(
    axis: Axes,
    view: View,
    draws: np.ndarray,
    hypotheses: Sequence["Hypothesis"],
    truth: np.ndarray | None,
) -> None:
    flat = [view.across, view.along]
    lines = draws[:, np.array(_SEGMENTS)][..., flat].reshape(-1, 2, 2)
    axis.add_collection(
        LineCollection(list(lines), colors=DRAW_COLOUR, lw=0.5, alpha=0.09, zorder=1, gid="draws")
    )
    colours = hypothesis_colours(len(hypotheses))
    pens = [Pen(colour, 1.6 if rank < MAX_NAMED else 0.6) for rank, colour in enumerate(colours)]
    for rank, hypothesis in reversed(list(enumerate(hypotheses))):  # the heaviest on top
        height = 10 + len(hypotheses) - rank
        _draw_pose(axis, hypothesis.joints[:, flat], pens[rank], f"hypothesis {rank + 1}", height)
    if truth is not None:
        _draw_pose(
            axis, truth[:, flat], Pen("black", 1.0, dashed=True), "truth", 11 + len(hypotheses)
        )
    if not len(draws):
        axis.text(
            0, 0.98, "no draws", transform=axis.transAxes, va="top", fontsize=_SMALL, color=FAINT
        )
    if view.hint:
        _footnote(axis, view.hint)


def hypothesis_colours(number: int) -> list[str]:
    """Colours of that many hypotheses, heaviest first; beyond the palette they share a grey."""
    return [*HYPOTHESIS_COLOURS, *[OTHER_COLOUR] * number][:number]


def _draw_pose(axis: Axes, points: np.ndarray, pen: Pen, gid: str, zorder: int) -> None:
    """Right limbs and torso solid, left limbs dashed and ending in hollow joints."""
    for left in (False, True):
        segments = [pair for pair in _SEGMENTS if (pair[1] in _LEFT_LIMBS) == left]
        ends = points[[joint for joint in _COLOUR_OF if (joint in _LEFT_LIMBS) == left]]
        # One line with gaps: a line a bone takes matplotlib ten times as long.
        path = np.full((3 * len(segments), 2), np.nan)
        path[0::3], path[1::3] = points[np.array(segments)].swapaxes(0, 1)
        axis.plot(
            *path.T,
            color=pen.colour,
            lw=pen.width,
            zorder=zorder,
            ls=_DASHES if pen.dashed or left else "-",
            gid=gid,
        )
        axis.plot(
            *ends.T,
            "o",
            ms=1 + pen.width,
            mfc="white" if left else pen.colour,
            mec=pen.colour,
            mew=pen.width / 2,
            zorder=zorder + 0.5,
            gid=gid,
        )


def _scale_bar(axis: Axes) -> None:
    left, bottom = axis.get_xlim()[0], max(axis.get_ylim())
    axis.plot(
        [left, left + 1],
        [bottom, bottom],
        color=INK,
        lw=1.2,
        clip_on=False,
        solid_capstyle="butt",
        gid="scale bar",
    )
    axis.annotate(
        "1 body unit",
        (left, bottom),
        xytext=(0, -3),
        textcoords="offset points",
        va="top",
        fontsize=_SMALL,
        color=FAINT,
    )


def _legend_handles(
    hypotheses: Sequence["Hypothesis"], truth: bool, draws: int
) -> tuple[list[Line2D], list[Line2D]]:
    """What the colours mean, and what the styles mean."""
    colours = hypothesis_colours(len(hypotheses))
    labels = [
        f"{100 * item.weight:.0f} %, {facing_words(pose_facing(item.joints))}"
        for item in hypotheses
    ]
    named = list(zip(colours, labels, strict=True))[:MAX_NAMED]
    poses = [Line2D([], [], color=colour, lw=1.6, label=label) for colour, label in named]
    rest = hypotheses[MAX_NAMED:]
    if rest:
        share = sum(item.weight for item in rest)
        poses.append(
            Line2D(
                [], [], color=OTHER_COLOUR, lw=0.6, label=f"{100 * share:.0f} %, {len(rest)} more"
            )
        )
    styles = [
        Line2D([], [], color=INK, lw=1.2, marker="o", ms=2.6, label="right limbs"),
        Line2D(
            [],
            [],
            color=INK,
            lw=1.2,
            ls=_DASHES,
            marker="o",
            ms=2.6,
            mfc="white",
            label="left limbs",
        ),
    ]
    if truth:
        styles.append(Line2D([], [], color="black", lw=1.0, ls=_DASHES, label="truth"))
    if draws:
        styles.append(
            Line2D([], [], color=DRAW_COLOUR, lw=0.8, alpha=0.6, label=f"{draws} posterior draws")
        )
    return poses, styles


def _legend_rows(poses: list[Line2D]) -> int:
    return -(-len(poses) // _COLUMNS)


def _legend(figure: Figure, poses: list[Line2D], styles: list[Line2D]) -> None:
    """Two blocks at the foot of the page."""
    height = figure.get_figheight()
    if poses:
        figure.text(
            1 - 0.12 / PAGE,
            0.08 / height,
            "colours: share of the draws, where the chest faces",
            ha="right",
            va="bottom",
            fontsize=_SMALL,
            color=FAINT,
        )
    for handles, bottom in ((styles, 0.08), (poses, 0.08 + _LINE)):
        legend = figure.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(0.1 / PAGE, bottom / height),
            frameon=False,
            fontsize=_LEGEND,
            ncols=_COLUMNS,
            handlelength=2.2,
            labelspacing=0.3,
            columnspacing=1.6,
            borderaxespad=0,
            borderpad=0,
            labelcolor=INK,
        )
        figure.add_artist(legend)


def depth_figure(tree: xr.DataTree) -> Figure:
    """Per joint: the posterior of its depth relative to the pelvis, parted by candidate; and how
    far it is known in depth and across the image (standard deviations). Body units."""
    figure = Figure(figsize=(7.2, 3.9), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    ridges, spreads = figure.subplots(1, 2, sharey=True, width_ratios=[2.4, 1])
    joints = list(_COLOUR_OF)
    _draw_ridges(ridges, tree, joints)
    if not values(tree, "posterior", "joints").size:
        ridges.text(
            0.02,
            0.98,
            "no draws",
            transform=ridges.transAxes,
            va="top",
            fontsize=_SMALL,
            color=FAINT,
        )
    _draw_spreads(spreads, tree, joints)
    seen = values(tree, "observed_data", "score") > 0
    names = [spoken(JOINTS[joint]) + ("" if seen[joint] else " (missing)") for joint in joints]
    ridges.set_yticks(range(len(joints)), names, fontsize=_TEXT)
    ridges.set_ylim(len(joints) - 0.5, -0.95)
    for axis in (ridges, spreads):
        axis.tick_params(labelsize=_SMALL, length=0, axis="y")
        axis.tick_params(labelsize=_SMALL, color=FAINT, axis="x")
        axis.spines[["left", "top", "right"]].set_visible(False)
        axis.spines["bottom"].set_color(FAINT)
        axis.hlines(
            range(len(joints)),
            0,
            1,
            transform=axis.get_yaxis_transform(),
            color="#DDDDDD",
            lw=0.6,
            zorder=0,
        )
    return figure


def _draw_ridges(axis: Axes, tree: xr.DataTree, joints: list[int]) -> None:
    depth = values(tree, "posterior", "joints")[:, :, 2]
    candidate = values(tree, "posterior", "candidate")
    best = heaviest(tree)
    reach = max(1.0, 1.05 * np.abs(depth).max()) if len(depth) else 1.0
    edges = np.linspace(-reach, reach, 161)
    for row, joint in enumerate(joints):
        # The lighter candidates, grey, stand on the heaviest one: together they are the posterior's
        # density.
        parts = [
            _density(depth[chosen, joint], edges)
            for chosen in (candidate == best, candidate != best)
        ]
        height = 0.85 / max(1e-12, (parts[0] + parts[1]).max())
        base = row - height * parts[0]
        middle = (edges[1:] + edges[:-1]) / 2
        colour = _COLOUR_OF[joint]
        axis.fill_between(
            middle,
            row,
            base,
            color=colour,
            alpha=0.55,
            lw=0,
            zorder=2,
            gid=f"depth {JOINTS[joint]}",
        )
        axis.fill_between(
            middle, base, base - height * parts[1], color=OTHER_COLOUR, alpha=0.8, lw=0, zorder=2
        )
        if len(depth):
            low, high = np.quantile(depth[:, joint], [0.05, 0.95])
            axis.plot(
                [low, high],
                [row, row],
                color=colour,
                lw=2,
                solid_capstyle="butt",
                gid=f"interval {JOINTS[joint]}",
            )
    share = float((candidate != best).mean()) if len(candidate) else 0.0
    if share > 0:
        axis.text(
            1,
            1.02,
            f"grey: facing the other way, {100 * share:.0f} %",
            transform=axis.transAxes,
            ha="right",
            fontsize=_SMALL,
            color=FAINT,
            gid="note",
        )
    axis.axvline(0, color=FAINT, lw=0.6, ls=":", zorder=1)
    axis.set_xlim(-reach, reach)
    axis.set_title("Depth behind the pelvis", loc="left", fontsize=_TITLE, fontweight="bold")
    axis.set_xlabel("← towards the camera     body units     away →", fontsize=_SMALL, color=INK)


def _density(sample: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """A histogram smoothed over two bins: unlike a kernel of one width, it keeps sharp ends and
    both of two modes."""
    counts, _ = np.histogram(sample, edges)
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / 2) ** 2)
    return np.convolve(counts, kernel / kernel.sum(), mode="same")


def _draw_spreads(axis: Axes, tree: xr.DataTree, joints: list[int]) -> None:
    draws = values(tree, "posterior", "joints")
    if len(draws):
        spread = draws.std(axis=0)
        for row, joint in enumerate(joints):
            across, depth = np.sqrt((spread[joint, :2] ** 2).mean()), spread[joint, 2]
            colour = _COLOUR_OF[joint]
            axis.plot([across, depth], [row, row], color=colour, lw=1, zorder=2)
            axis.plot(
                across,
                row,
                "o",
                mfc="white",
                mec=colour,
                ms=4,
                zorder=3,
                gid=f"across {JOINTS[joint]}",
            )
            axis.plot(depth, row, "o", color=colour, ms=4, zorder=3, gid=f"sd {JOINTS[joint]}")
    axis.set_xlim(left=0)
    axis.set_title("Standard deviation", loc="left", fontsize=_TITLE, fontweight="bold")
    axis.set_xlabel("○ across the image   ● in depth", fontsize=_SMALL, color=INK)


def save_figure(figure: Figure, path: str | os.PathLike) -> None:
    """Writes PNG, PDF or SVG, by the name's ending, whole or not at all. Raises `BadInput`, one
    sentence, where it cannot."""
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("png", "pdf", "svg"):
        raise BadInput(
            f"cannot write a figure to {path}; give it a name that ends in .png, .pdf or .svg."
        )
    with replacing(path) as partial:
        figure.savefig(partial, format=kind)


def read_image(path: str | os.PathLike) -> np.ndarray:
    """An image file as `(H, W, 3)` bytes, turned the way its camera was held. Raises `BadInput`,
    one sentence, where there is none, it is no image, is damaged, or has more than `MAX_PIXELS`
    pixels."""
    too_large = (
        f"{path} has more than {MAX_PIXELS // 1_000_000} million pixels; give a smaller image."
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with opened(path, "image", "check its name.") as file, Image.open(file) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise BadInput(too_large)
                return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    except (Image.DecompressionBombWarning, Image.DecompressionBombError):
        raise BadInput(too_large) from None
    except BadInput:
        raise
    except Exception as error:  # Pillow meets damaged files with errors of many kinds.
        raise BadInput(
            f"{path} is no image that can be read ({type(error).__name__}); give a PNG or JPEG."
        ) from None
