"""The overlay: what a reader made of a file, drawn over the image, so that a wrong order is seen at
once.

`overlay_figure(detection, radius, image=…)`, then `figures.save_figure`. Every joint has its name
and score beside it, its bones in the colours of the other figures (purple right, green left), and
the disc of the likelihood around it."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from probmodel.detections import FACE, Detection
from probmodel.skeleton import GROUPS, JOINTS, NUM_JOINTS, PARENTS
from reports.figures import DPI, FAINT, INK, LIMB_COLOURS, TORSO_COLOUR
from reports.tables import spoken

PAGE = 8.0
"""Inches: the width of the figure, names on both sides included."""
COLUMN = 1.75
"""Inches for the names on either side."""
HIGHEST = 9.0
LEAST_LINE = 0.17
"""Inches between two names."""
FACE_COLOUR = "#B8860B"
_TEXT, _TITLE = 7.5, 9.0
_LIMB_OF = {
    bone.end: limb.name for limbs in GROUPS.values() for limb in limbs for bone in limb.bones
}
_COLOURS = [
    LIMB_COLOURS[_LIMB_OF[joint]] if joint in _LIMB_OF else TORSO_COLOUR
    for joint in range(NUM_JOINTS)
]


class Label(NamedTuple):
    """A name to be written beside the picture, and the point `(2,)` that it belongs to."""

    text: str
    point: np.ndarray
    colour: str


def overlay_figure(
    detection: Detection,
    radius: np.ndarray | None = None,
    *,
    image: np.ndarray | None = None,
    warned: bool = False,
) -> Figure:
    """The joints of `detection` over the `image` `(H, W, 3)` if given, discs of `radius` `(15,)`
    pixels where known."""
    low, high = _window(detection, radius)
    wide, tall = high - low
    inner = PAGE - 2 * COLUMN
    height = float(np.clip(inner * tall / wide, 3.0, HIGHEST))
    figure = Figure(figsize=(PAGE, height + 0.75), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axis = figure.add_axes(
        (COLUMN / PAGE, 0.4 / (height + 0.75), inner / PAGE, height / (height + 0.75))
    )
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(high[1], low[1])
    axis.set_aspect("equal", adjustable="box")
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set(color="#CCCCCC", lw=0.6)
    if image is not None:
        extent = (-0.5, image.shape[1] - 0.5, image.shape[0] - 0.5, -0.5)
        axis.imshow(image, extent=extent, alpha=0.75, zorder=0).set_gid("image")
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(high[1], low[1])
    _draw_body(axis, detection, radius)
    _draw_face(axis, detection)
    _write_labels(axis, detection, height)
    title = f"{detection.layout}, person {detection.person}" + (
        " (see the warnings)" if warned else ""
    )
    axis.set_title(title, loc="left", fontsize=_TITLE, fontweight="bold", color=INK)
    missing = [spoken(JOINTS[joint]) for joint in range(NUM_JOINTS) if not detection.seen[joint]]
    note = "purple: right, green: left" + (f"; missing: {', '.join(missing)}" if missing else "")
    axis.text(
        0, -0.015, note, transform=axis.transAxes, va="top", fontsize=_TEXT, color=FAINT, gid="note"
    )
    return figure


def _window(detection: Detection, radius: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    seen = detection.seen
    points = detection.keypoints[seen]
    if detection.face is not None:
        points = np.concatenate([points, detection.face[detection.face[:, 2] > 0, :2]])
    reach = 0.0 if radius is None else float(np.nan_to_num(radius[seen]).max(initial=0.0))
    if not len(points):
        return np.zeros(2), np.ones(2)
    low, high = points.min(axis=0), points.max(axis=0)
    reach = min(
        reach, 0.3 * (high - low).max()
    )  # a joint hardly seen has a disc that is larger than the person
    low, high = low - reach, high + reach
    margin = max(0.08 * (high - low).max(), 1.0)
    middle, half = (low + high) / 2, (high - low) / 2 + margin
    half = np.maximum(half, half[::-1] * np.array([0.5, 0.6]))
    return middle - half, middle + half


def _draw_body(axis: Axes, detection: Detection, radius: np.ndarray | None) -> None:
    for joint, parent in enumerate(PARENTS):
        if parent >= 0 and detection.seen[[joint, parent]].all():
            axis.plot(
                *detection.keypoints[[parent, joint]].T,
                color=_COLOURS[joint],
                lw=2.2,
                zorder=3,
                solid_capstyle="round",
                gid=f"bone {JOINTS[joint]}",
            )
    for joint in np.flatnonzero(detection.seen).tolist():
        x, y = detection.keypoints[joint]
        axis.plot(
            x,
            y,
            "o",
            ms=4,
            color=_COLOURS[joint],
            mec="white",
            mew=0.6,
            zorder=4,
            gid=f"joint {JOINTS[joint]}",
        )
        if radius is not None and np.isfinite(radius[joint]):
            face, edge = (*to_rgb(_COLOURS[joint]), 0.10), _COLOURS[joint]
            disc = Circle((x, y), radius[joint], fc=face, ec=edge, lw=0.8, zorder=2)
            disc.set_gid(f"disc {JOINTS[joint]}")
            axis.add_patch(disc)


def _draw_face(axis: Axes, detection: Detection) -> None:
    if detection.face is None:
        return
    for name, (x, y, score) in zip(FACE, detection.face, strict=True):
        if score > 0:
            axis.plot(
                x,
                y,
                "D",
                ms=2.5,
                color=FACE_COLOUR,
                mec="white",
                mew=0.4,
                zorder=4,
                gid=f"face {name}",
            )


def _write_labels(axis: Axes, detection: Detection, height: float) -> None:
    """Names and scores in a column on either side, in the order of their points, with a line to
    each."""
    labels = [
        Label(
            f"{spoken(JOINTS[joint])} {detection.score[joint]:.2f}",
            detection.keypoints[joint],
            _COLOURS[joint],
        )
        for joint in np.flatnonzero(detection.seen)
    ]
    if not labels:
        return
    by_side = sorted(labels, key=lambda label: label.point[0])
    half = (len(by_side) + 1) // 2
    for column, anchor, part in ((-0.02, "right", by_side[:half]), (1.02, "left", by_side[half:])):
        part = sorted(part, key=lambda label: label.point[1])
        wanted = [float(axis.transLimits.transform(label.point)[1]) for label in part]
        for label, place in zip(part, _spread(wanted, LEAST_LINE / height), strict=True):
            axis.annotate(
                label.text,
                xy=tuple(label.point),
                xycoords="data",
                xytext=(column, place),
                textcoords="axes fraction",
                ha=anchor,
                va="center",
                fontsize=_TEXT,
                color=label.colour,
                annotation_clip=False,
                gid=f"name {label.text}",
                arrowprops={"arrowstyle": "-", "color": label.colour, "lw": 0.4, "alpha": 0.7},
            )


def _spread(places: list[float], least: float) -> list[float]:
    """`places`, falling, moved apart to `least` from each other and kept between 1 and 0 where they
    fit."""
    spread: list[float] = []
    for place in places:
        spread.append(min(place, spread[-1] - least) if spread else min(place, 1.0))
    for index in range(len(spread) - 1, -1, -1):
        floor = least * (len(spread) - 1 - index)
        spread[index] = max(spread[index], min(floor, 1 - least * index))
    return spread
