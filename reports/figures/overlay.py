"""The overlay: what a reader made of a file, drawn over the image, so that a wrong order is seen at
once.

    save_figure(overlay_figure(detection, radius, image=image), path)

Every joint has its name and score beside it, its bones in the colours of the other figures (purple
right, green left), and the disc of the likelihood around it.
"""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.probmodel.detections import FACE, Detection
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.figures.body import draw_detection, draw_image
from poseterior.reports.figures.colours import COLOURS
from poseterior.reports.figures.style import DPI, LEGEND, Style, blank, entitle, note, page
from poseterior.reports.figures.window import corners_of
from poseterior.reports.tables.words import spoken, undetected

OVERLAY_WIDTH = 8.0
"""Inches, names on both sides included."""
COLUMN = 1.75
"""Inches for the names on either side."""
ABOVE, BELOW = 0.35, 0.4
"""Inches for the title and the note."""
HIGHEST = 9.0
LEAST_LINE = 0.17
"""Inches between two names."""
FACE_COLOUR = "#B8860B"


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
    """A detection over its image.

    Parameters
    ----------
    detection
        What was read.
    radius
        `(15,)` of the discs in pixels, NaN where there is none.
    image
        `(H, W, 3)`.
    warned
        Whether the title refers to warnings.
    """
    low, high = _window(detection, radius)
    wide, tall = high - low
    inner = OVERLAY_WIDTH - 2 * COLUMN
    height = float(np.clip(inner * tall / wide, 3.0, HIGHEST))
    whole = height + ABOVE + BELOW
    figure = page(OVERLAY_WIDTH, whole, dpi=DPI, layout=None)
    axis = figure.add_axes(
        (COLUMN / OVERLAY_WIDTH, BELOW / whole, inner / OVERLAY_WIDTH, height / whole)
    )
    blank(axis)
    axis.spines[:].set(visible=True, color="#CCCCCC", lw=0.6)
    if image is not None:
        draw_image(axis, image, 0.75, corners_of(image))
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(high[1], low[1])
    axis.set_aspect("equal", adjustable="box")
    draw_detection(axis, detection.keypoints, radius, 2.2)
    _draw_face(axis, detection)
    _write_labels(axis, detection, height)
    title = f"{detection.layout}, person {detection.person}"
    title += " (see the warnings)" if warned else ""
    entitle(axis, title)
    joints = zip(JOINTS, detection.seen, strict=True)
    lost = [undetected(name) for name, seen in joints if not seen]
    words = "purple: right, green: left" + (f"; not detected: {', '.join(lost)}" if lost else "")
    note(axis, words, y=-0.015, fontsize=LEGEND, gid="note")
    return figure


def _window(detection: Detection, radius: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    seen = detection.seen
    points = detection.keypoints[seen]
    if detection.face is not None:
        points = np.concatenate([points, detection.face[detection.face[:, 2] > 0, :2]])
    reach = 0.0 if radius is None else float(np.nan_to_num(radius[seen]).max(initial=0.0))
    if not len(points):
        return np.zeros(2), np.ones(2)
    low = points.min(axis=0)
    high = points.max(axis=0)
    # A joint that is hardly seen has a disc larger than the person.
    reach = min(reach, 0.3 * (high - low).max())
    low = low - reach
    high = high + reach
    margin = max(0.08 * (high - low).max(), 1.0)
    middle = (low + high) / 2
    half = (high - low) / 2 + margin
    half = np.maximum(half, half[::-1] * np.array([0.5, 0.6]))
    return middle - half, middle + half


def _draw_face(axis: Axes, detection: Detection) -> None:
    if detection.face is None:
        return
    for name, (x, y, score) in zip(FACE, detection.face, strict=True):
        if score > 0:
            dot: Style = {"color": FACE_COLOUR, "mec": "white", "mew": 0.4, "gid": f"face {name}"}
            axis.plot(x, y, "D", ms=2.5, zorder=4, **dot)


def _write_labels(axis: Axes, detection: Detection, height: float) -> None:
    """Names and scores in a column on either side, in the order of their points, with a line to
    each."""
    labels = [
        Label(
            f"{spoken(JOINTS[joint])} {detection.score[joint]:.2f}",
            detection.keypoints[joint],
            COLOURS[joint],
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
                fontsize=LEGEND,
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
