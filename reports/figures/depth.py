"""How far the depth of each joint is known.

save_figure(depth_figure(tree), path)
"""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.probmodel.skeleton import JOINTS, TORSO_INDEX
from poseterior.reports.figures.colours import COLOURS, LIMB_OF, OTHER_COLOUR
from poseterior.reports.figures.style import DPI, FAINT, INK, SMALL, TEXT, TITLE, Style, note, page
from poseterior.reports.tables.posterior import heaviest, is_uncertain, values
from poseterior.reports.tables.words import spoken, undetected


def depth_figure(tree: xr.DataTree) -> Figure:
    """Per joint: the posterior of its depth relative to the pelvis, parted by candidate; and its
    standard deviations in depth and across the image. Body units. The torso has rows where it is
    drawn with the pose, and a word where it is held fixed."""
    uncertain = is_uncertain(tree)
    joints = [*LIMB_OF, *(TORSO_INDEX[1:] if uncertain else ())]
    figure = page(7.2, 3.9 + 0.4 * (len(joints) - len(LIMB_OF)), dpi=DPI)
    ridges, spreads = figure.subplots(1, 2, sharey=True, width_ratios=[2.4, 1])
    _draw_ridges(ridges, tree, joints)
    _draw_spreads(spreads, tree, joints)
    seen = values(tree, "observed_data", "score") > 0
    names = [
        spoken(JOINTS[joint]) if seen[joint] else f"{undetected(JOINTS[joint])} (not detected)"
        for joint in joints
    ]
    if not uncertain:
        names.append("torso and camera")
        spreads.annotate(
            "held fixed",
            (0, len(joints)),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=SMALL,
            color=FAINT,
        )
    ridges.set_yticks(range(len(names)), names, fontsize=TEXT)
    ridges.set_ylim(len(names) - 0.5, -0.95)
    for axis in (ridges, spreads):
        axis.tick_params(labelsize=SMALL, length=0, axis="y")
        axis.tick_params(labelsize=SMALL, color=FAINT, axis="x")
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
    lighter = values(tree, "posterior", "candidate") != heaviest(tree)
    reach = max(1.0, 1.05 * np.abs(depth).max()) if len(depth) else 1.0
    edges = np.linspace(-reach, reach, 161)
    for row, joint in enumerate(joints):
        _draw_ridge(axis, row, joint, [depth[~lighter, joint], depth[lighter, joint]], edges)
        if len(depth):
            ends = np.quantile(depth[:, joint], [0.05, 0.95])
            line: Style = {"color": COLOURS[joint], "lw": 2, "solid_capstyle": "butt"}
            axis.plot(ends, [row, row], gid=f"interval {JOINTS[joint]}", **line)
    if not len(depth):
        note(axis, "no draws", 0.02)
    if lighter.any():
        words = f"grey: facing the other way, {100 * lighter.mean():.0f} %"
        note(axis, words, 1, 1.02, ha="right", va="baseline", gid="note")
    axis.axvline(0, color=FAINT, lw=0.6, ls=":", zorder=1)
    axis.set_xlim(-reach, reach)
    axis.set_title("Depth behind the pelvis", loc="left", fontsize=TITLE, fontweight="bold")
    axis.set_xlabel("← towards the camera     body units     away →", fontsize=SMALL, color=INK)


def _draw_ridge(
    axis: Axes, row: int, joint: int, parts: list[np.ndarray], edges: np.ndarray
) -> None:
    """The density of the heaviest candidate's draws, and of the lighter ones' standing on it, grey:
    together they are the posterior's."""
    heavy, light = (_density(part, edges) for part in parts)
    height = 0.85 / max(1e-12, (heavy + light).max())
    middle = (edges[1:] + edges[:-1]) / 2
    base = row - height * heavy
    own: Style = {"color": COLOURS[joint], "alpha": 0.55, "gid": f"depth {JOINTS[joint]}"}
    axis.fill_between(middle, row, base, lw=0, zorder=2, **own)
    other: Style = {"color": OTHER_COLOUR, "alpha": 0.8}
    axis.fill_between(middle, base, base - height * light, lw=0, zorder=2, **other)


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
            across = np.sqrt((spread[joint, :2] ** 2).mean())
            depth = spread[joint, 2]
            colour = COLOURS[joint]
            axis.plot([across, depth], [row, row], color=colour, lw=1, zorder=2)
            dot: Style = {"color": colour, "ms": 4, "zorder": 3}
            axis.plot(across, row, "o", mfc="white", gid=f"across {JOINTS[joint]}", **dot)
            axis.plot(depth, row, "o", gid=f"sd {JOINTS[joint]}", **dot)
    axis.set_xlim(left=0)
    axis.set_title("Standard deviation", loc="left", fontsize=TITLE, fontweight="bold")
    axis.set_xlabel("○ across the image   ● in depth", fontsize=SMALL, color=INK)
