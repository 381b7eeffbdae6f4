"""True poses that their posteriors exclude."""

import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from poseterior.inference.studies.calibration.exclusions import Reason
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX
from poseterior.reports.figures.colours import PALETTE, SEGMENTS
from poseterior.reports.figures.style import INK, blank, page

HUNG, BROKEN = PALETTE[:2]
RING = "#BBBBBB"


class Exclusion(NamedTuple):
    """A true pose that its posterior excludes.

    Attributes
    ----------
    title
        What the panel is called.
    keypoints
        Detections `(15, 2)`, NaN where missing.
    radius
        Of their discs `(15,)`, pixels.
    truth
        The true pose `(15, 3)`, pixels.
    hung
        The same bones on the estimated torso, `(15, 3)`, pixels.
    reasons
        What is broken, the most telling first.
    """

    title: str
    keypoints: np.ndarray
    radius: np.ndarray
    truth: np.ndarray
    hung: np.ndarray
    reasons: list[Reason]


def misses_figure(misses: Sequence[Exclusion]) -> Figure:
    """Each miss from the camera (with detections and discs) and from the side; what is broken is
    orange."""
    figure = page(3.5 * len(misses), 5.0)
    axes = figure.subplots(1, 2 * len(misses))
    for miss, front, side in zip(misses, axes[0::2], axes[1::2], strict=True):
        broken = _broken_joints(miss.reasons)
        _draw_detections(front, miss, broken)
        for axis, across in ((front, 0), (side, 2)):
            _skeleton(axis, miss.truth[:, [across, 1]], INK, set(), dashed=True)
            _skeleton(axis, miss.hung[:, [across, 1]], HUNG, broken)
        front.set_title(miss.title, fontsize=8, loc="left")
        side.set_title("from the side,\naway from the camera →", fontsize=7, loc="left")
        words = [textwrap.fill(reason.sentence, 34) for reason in miss.reasons[:2]]
        front.set_xlabel("\n".join(words), fontsize=6.5, loc="left")
        rows = np.concatenate([miss.truth[:, 1], miss.hung[:, 1], miss.keypoints[:, 1]])
        low = np.nanmin(rows)
        high = np.nanmax(rows)
        middle = (low + high) / 2
        half = 0.55 * (high - low) + 10
        for axis in (front, side):
            axis.set_ylim(middle + half, middle - half)
            axis.set_aspect("equal")
            blank(axis)
    return figure


def _draw_detections(axes: Axes, miss: Exclusion, broken: set[int]) -> None:
    for joint in np.flatnonzero(np.isfinite(miss.keypoints).all(axis=1)).tolist():
        bad = joint in broken
        place = miss.keypoints[joint]
        axes.plot(*place, "+", color=BROKEN if bad else INK, ms=5, mew=1)
        if np.isfinite(miss.radius[joint]):
            colour = BROKEN if bad else RING
            axes.add_patch(Circle(tuple(place), miss.radius[joint], fill=False, ec=colour, lw=0.8))


def _broken_joints(reasons: Sequence[Reason]) -> set[int]:
    """Joints at the ends of what is broken."""
    ends = {bone.name: bone.end for bone in BONES} | JOINT_INDEX
    return {ends[part] for reason in reasons if (part := reason.broken.part) in ends}


def _skeleton(
    axes: Axes, points: np.ndarray, colour: str, broken: set[int], *, dashed: bool = False
) -> None:
    for parent, joint in SEGMENTS:
        bad = joint in broken
        axes.plot(
            *points[[parent, joint]].T,
            color=BROKEN if bad else colour,
            lw=2.2 if bad else 1.4,
            ls=(0, (2, 1.2)) if dashed else "-",
            zorder=1 if dashed else 2,
        )
