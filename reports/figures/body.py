"""A detection as it is drawn: bones, joints and discs, in pixels."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle

from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.figures.colours import COLOURS, SEGMENTS
from poseterior.reports.figures.style import Style


def draw_detection(
    axes: Axes, keypoints: np.ndarray, radius: np.ndarray | None, width: float
) -> None:
    """Draws the joints that were seen.

    Parameters
    ----------
    axes
        Where to draw.
    keypoints
        `(15, 2)`, NaN where missing.
    radius
        `(15,)` of the discs, NaN where there is none.
    width
        Of the bones, points.
    """
    seen = np.isfinite(keypoints).all(axis=1)
    for parent, joint in SEGMENTS:
        if seen[parent] and seen[joint]:
            axes.plot(
                *keypoints[[parent, joint]].T,
                color=COLOURS[joint],
                lw=width,
                zorder=3,
                solid_capstyle="round",
                gid=f"bone {JOINTS[joint]}",
            )
    for joint in np.flatnonzero(seen).tolist():
        colour = COLOURS[joint]
        name = JOINTS[joint]
        dot: Style = {
            "color": colour,
            "mec": "white",
            "mew": 0.5,
            "zorder": 4,
            "gid": f"joint {name}",
        }
        axes.plot(*keypoints[joint], "o", ms=width + 1.9, **dot)
        if radius is not None and np.isfinite(radius[joint]):
            centre = tuple(keypoints[joint])
            fill = (*to_rgb(colour), 0.12)
            disc = Circle(centre, radius[joint], fc=fill, ec=colour, lw=0.8, zorder=2)
            disc.set_gid(f"disc {name}")
            axes.add_patch(disc)


def draw_image(axes: Axes, image: np.ndarray, alpha: float, corners: np.ndarray) -> None:
    """Lays an image `(H, W, 3)` under the axes; `corners` `(2, 2)` are where its upper left and its
    lower right one lie."""
    (left, top), (right, bottom) = corners.tolist()
    axes.imshow(image, extent=(left, right, bottom, top), alpha=alpha, zorder=0).set_gid("image")
