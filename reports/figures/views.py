"""Every view with its detections and the hypotheses in it, and the scene from the side and from
above with the cameras.

save_figure(views_figure(tree, hypotheses), path)
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from poseterior.reports.figures.body import draw_detection
from poseterior.reports.figures.colours import SEGMENTS, hypothesis_colours
from poseterior.reports.figures.style import DPI, FAINT, INK, SMALL, TITLE, page
from poseterior.reports.tables.posterior import values

if TYPE_CHECKING:
    from poseterior.inference.hypothesis import Hypothesis

VIEWS_A_ROW = 4
PANEL = 2.6
"""Inches."""
BESIDE = 0.15
"""Of a person's height, that is shown around it."""
SCENE_SIDES = ("From the side", 0, 2), ("From above", 0, 1)
"""Of the scene: which of the world's axes run across and along."""


def views_figure(tree: xr.DataTree, hypotheses: Sequence["Hypothesis"]) -> Figure:
    """Detections with the hypotheses over them, view by view, and the scene.

    Parameters
    ----------
    tree
        A posterior of several views.
    hypotheses
        Of its draws, the heaviest first.

    Returns
    -------
    Figure
        In straightened pixels, and metres.
    """
    labels = [str(label) for label in tree["posterior"].coords["view"].values]
    panels = len(labels) + len(SCENE_SIDES)
    across = min(panels, VIEWS_A_ROW)
    down = -(-panels // across)
    figure = page(PANEL * across, PANEL * down, dpi=DPI)
    axes = np.atleast_1d(figure.subplots(down, across, squeeze=False)).ravel().tolist()
    keypoints = values(tree, "posterior", "keypoints")
    for row, label in enumerate(labels):
        chosen = [keypoints[one.draw, row] for one in hypotheses]
        seen = values(tree, "observed_data", "keypoints")[row]
        _title(axes[row], label)
        _draw_view(axes[row], seen, chosen)
    for axis, (title, first, second) in zip(axes[len(labels) :], SCENE_SIDES, strict=False):
        _title(axis, title)
        _draw_scene(axis, tree, hypotheses, [first, second])
    for axis in axes[panels:]:
        axis.set_axis_off()
    return figure


def _title(axis: Axes, text: str) -> None:
    axis.set_title(text, loc="left", fontsize=TITLE, fontweight="bold", color=INK)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=SMALL, colors=FAINT)


def _draw_view(axis: Axes, seen: np.ndarray, chosen: list[np.ndarray]) -> None:
    draw_detection(axis, seen, None, 1.3)
    _draw_poses(axis, np.array(chosen))
    points = np.concatenate([*chosen, seen[np.isfinite(seen).all(axis=1)]])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = BESIDE * (high - low).max()
    axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(high[1] + margin, low[1] - margin))


def _draw_scene(
    axis: Axes, tree: xr.DataTree, hypotheses: Sequence["Hypothesis"], axes: list[int]
) -> None:
    """The hypotheses and the cameras, each with the way that it looks."""
    _draw_poses(axis, np.array([one.joints[:, axes] / 1000 for one in hypotheses]))
    centre = values(tree, "constant_data", "camera_centre") / 1000
    ahead = centre + 0.6 * values(tree, "constant_data", "camera_rotation")[:, 2]
    labels = tree["posterior"].coords["view"].values
    for label, start, end in zip(labels, centre[:, axes], ahead[:, axes], strict=True):
        axis.plot(*np.stack([start, end]).T, color=FAINT, lw=0.8)
        axis.plot(*start, "s", color=INK, ms=3, gid=f"camera {label}")
        axis.annotate(str(label), start, fontsize=SMALL, color=FAINT)
    axis.set_xlabel(f"{'xyz'[axes[0]]} (m)", fontsize=SMALL)
    axis.set_ylabel(f"{'xyz'[axes[1]]} (m)", fontsize=SMALL)


def _draw_poses(axis: Axes, poses: np.ndarray) -> None:
    """Poses `(k, 15, 2)`, the heaviest on top."""
    for rank, colour in reversed(list(enumerate(hypothesis_colours(len(poses))))):
        lines = [poses[rank][list(segment)] for segment in SEGMENTS]
        one = LineCollection(lines, colors=colour, linewidths=1.0, zorder=10 + len(poses) - rank)
        one.set_gid(f"hypothesis {rank + 1}")
        axis.add_collection(one)
    axis.autoscale_view()
