"""Residuals against the fitted error law: joint by joint, and all together."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from poseterior.inference.studies.errorlaws import Learned
from poseterior.inference.studies.errorlaws.mixture import log_density, quadratic
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, SMALL, entitle, note, page, tidy

REGION_LEVELS = (0.5, 0.95)
"""Of the inliers, within the circles."""
REACH = 4.0
"""Spreads that are shown to each side; what lies beyond is counted."""
FARTHEST_ERROR = 1e3
"""Spreads at which the histogram ends."""


def residuals_figure(found: Learned) -> Figure:
    """Fifteen clouds of residuals with the law's circles, and the histogram of their sizes beside
    the law's density."""
    figure = page(11.5, 5.0, dpi=150)
    grid = figure.add_gridspec(3, 8)
    for joint in range(NUM_JOINTS):
        _draw_joint(figure.add_subplot(grid[joint // 5, joint % 5]), found, joint)
    _draw_sizes(figure.add_subplot(grid[:, 5:]), found)
    return figure


def sizes(found: Learned) -> np.ndarray:
    """`(n, 15)` of the residuals, in spreads (the truth's own error included), NaN where there is
    none."""
    expected = found.fit.expected
    size = np.sqrt(quadratic(expected.precision[0], expected.left[0]))
    return np.where(found.pairs.seen & found.errors.known, size, np.nan)


def _draw_joint(axes: Axes, found: Learned, joint: int) -> None:
    axes.set_title(JOINTS[joint].replace("_", " "), loc="left", fontsize=SMALL + 0.5, color=INK)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=SMALL - 1.5)
    if not found.errors.known[joint]:
        note(axes, "not seen", x=0.3, y=0.55)
        return
    expected = found.fit.expected
    pairs = found.pairs
    seen = pairs.seen[:, joint]
    points = expected.left[0, seen, joint]
    inlier = expected.inlier[0, seen, joint] > 0.5
    reach = REACH * found.errors.sigma[joint]
    for rows, colour in ((inlier, PALETTE[0]), (~inlier, PALETTE[1])):
        axes.plot(*points[rows].T, ".", ms=1.5, color=colour, alpha=0.5)
    for level in REGION_LEVELS:
        size = 2 * float(found.errors.law.distance(level)) * found.errors.sigma[joint]
        axes.add_patch(Circle((0, 0), size, fill=False, lw=0.9, color=INK))
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach))
    beyond = int((np.abs(points) > reach).any(axis=1).sum())
    if beyond:
        note(axes, f"{beyond} beyond", x=0.03, y=0.1)


def _draw_sizes(axes: Axes, found: Learned) -> None:
    errors = found.errors
    mixture = found.fit.mixture
    size = sizes(found)
    known = ~np.isnan(size)
    top = min(max(float(np.nanmax(size)), REACH), FARTHEST_ERROR)
    edges = np.concatenate([np.linspace(0, REACH, 41), np.geomspace(REACH, top + 1, 15)[1:]])
    axes.hist(
        np.minimum(size[known], top),
        edges.tolist(),
        density=True,
        color=PALETTE[5],
        label="residuals",
    )
    at = (edges[:-1] + edges[1:]) / 2
    weight = known.sum(axis=0) / known.sum()
    share = np.where(errors.known, np.nan_to_num(errors.inlier), 0.0) @ weight
    inside = 2 * np.pi * at * np.exp(log_density(at**2, mixture.df))
    law = share * inside
    for joint in range(NUM_JOINTS):
        if errors.known[joint]:
            wide = errors.outlier_radius / errors.sigma[joint]
            outside = np.where(at <= wide, 2 * at / wide**2, 0.0)
            law = law + weight[joint] * (1 - errors.inlier[joint]) * outside
    axes.plot(at, law, color=INK, lw=1.4, label="the law")
    axes.plot(at, inside, color=FAINT, lw=1.0, ls=":", label="its inliers alone")
    axes.set_yscale("log")
    axes.set_xscale("symlog", linthresh=REACH)
    axes.set(xlim=(0, edges[-1]), ylim=(1e-6, 2.0))
    axes.set_xlabel("size of the residual, spreads", fontsize=SMALL + 1)
    axes.set_ylabel("density", fontsize=SMALL + 1)
    entitle(axes, "All joints")
    axes.legend(fontsize=SMALL + 0.5, frameon=False)
    axes.tick_params(labelsize=SMALL)
    tidy(axes)
