"""Calibration and coverage as pictures: ranks against their band, nominal against empirical
coverage, misses.

Made without pyplot; `reports.figures.save_figure` writes them.
"""

import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from inference.studies.calibration.ece import LEVELS, shares
from inference.studies.calibration.exclusions import Reason
from inference.studies.calibration.quantities import (
    ENERGY_BALL,
    HINGES,
    LOG_DENSITY,
    MISFIT,
    OF_POSE,
    TARP,
)
from inference.studies.calibration.uniformity import LEVELS as POINTS
from inference.studies.calibration.uniformity import band, difference
from probmodel.skeleton import BONES, JOINT_INDEX, NUM_JOINTS, PARENTS
from reports.figures import HYPOTHESIS_COLOURS

INK, FAINT, TRUTH = "#222222", "#BBBBBB", "#222222"
RED = "#D55E00"
PROBABILITY = 0.95
PANELS = {
    "joints, to the side": [name for name in OF_POSE if name.endswith((" x", " y"))],
    "joints, depth": [name for name in OF_POSE if name.endswith(" z")],
    "lengths and depth flips": [
        name for name in OF_POSE if name.startswith("length") or name.endswith("away")
    ],
    "pose and model": [*HINGES, LOG_DENSITY, MISFIT, ENERGY_BALL, TARP],
}


def ranks_figure(simulation: xr.Dataset, title: str = "") -> Figure:
    """Empirical minus uniform distribution function of every quantity's levels, in four panels,
    with the band in which 95 % of right posteriors stay everywhere (for one quantity)."""
    figure = Figure(figsize=(12, 2.7), layout="constrained")
    axes = figure.subplots(1, len(PANELS), sharey=True)
    for axis, (name, quantities) in zip(axes, PANELS.items(), strict=True):
        table = simulation["level"].sel(quantity=quantities).values
        table = table[np.isfinite(table).any(axis=1)]
        _band(axis, len(table))
        for column, (values, quantity) in enumerate(zip(table.T, quantities, strict=True)):
            if np.isfinite(values).all() and len(values):
                few = len(quantities) < 9
                colour = HYPOTHESIS_COLOURS[column % len(HYPOTHESIS_COLOURS)]
                axis.plot(
                    POINTS,
                    difference(values),
                    lw=1.1 if few else 0.7,
                    gid=f"ranks {quantity}",
                    color=colour,
                    label=quantity.replace("_", " ") if few else None,
                )
        if len(quantities) < 9:
            axis.legend(frameon=False, fontsize=6.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("level", fontsize=8)
        _tidy(axis)
    axes[0].set_ylabel("share below − level", fontsize=8)
    if title:
        figure.suptitle(title, fontsize=9)
    return figure


def _band(axis: Axes, size: int) -> None:
    low, high = band(max(size, 1), PROBABILITY)
    axis.fill_between(POINTS, low - POINTS, high - POINTS, color=FAINT, alpha=0.5, lw=0, gid="band")
    axis.axhline(0, color=INK, lw=0.6)


def controls_figure(found: Mapping[str, xr.Dataset], quantities: Sequence[str]) -> Figure:
    """Some quantities' levels of several posteriors, a panel each."""
    figure = Figure(figsize=(10.5, 2.3 * -(-len(found) // 4)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(-(-len(found) // 4), 4, sharex=True, sharey=False)).ravel()
    for axis in axes[len(found) :]:
        axis.axis("off")
    for axis, (name, simulation) in zip(axes, found.items(), strict=False):
        table = simulation["level"].sel(quantity=list(quantities)).values
        table = table[np.isfinite(table).all(axis=1)]
        _band(axis, len(table))
        for column, quantity in enumerate(quantities):
            axis.plot(
                POINTS,
                difference(table[:, column]),
                lw=1.1,
                label=quantity.replace("_", " "),
                color=HYPOTHESIS_COLOURS[column],
            )
        axis.set_title(name, fontsize=8.5)
        _tidy(axis)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=len(quantities),
        frameon=False,
        fontsize=8,
    )
    return figure


def coverage_figure(found: Mapping[str, xr.Dataset]) -> Figure:
    """Nominal against empirical coverage over all joints, a line for each of several sets, to the
    side, in depth, and over all axes."""
    figure = Figure(figsize=(10.5, 3.5), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    titles = {"lateral": "to the side", "depth": "depth", "whole": "all axes"}
    for axis, (kind, title) in zip(axes, titles.items(), strict=True):
        axis.plot([0, 1], [0, 1], color=INK, lw=0.6)
        for number, (name, simulation) in enumerate(found.items()):
            axis.plot(
                LEVELS,
                shares(simulation[kind].values).mean(axis=1),
                lw=1.4,
                label=name,
                gid=f"{kind} {name}",
                color=HYPOTHESIS_COLOURS[number % len(HYPOTHESIS_COLOURS)],
            )
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("nominal coverage", fontsize=8)
        _tidy(axis)
    axes[0].set_ylabel("empirical coverage", fontsize=8)
    axes[0].legend(frameon=False, fontsize=7.5, loc="upper left")
    return figure


class Miss(NamedTuple):
    """A true pose that its posterior excludes: what the panel is called, detections `keypoints`
    `(15, 2)` (NaN where missing) and their `radius` `(15,)`, the true pose `truth` `(15, 3)` in
    pixels, the same bones on the estimated torso `hung` `(15, 3)` in pixels, and the reasons."""

    title: str
    keypoints: np.ndarray
    radius: np.ndarray
    truth: np.ndarray
    hung: np.ndarray
    reasons: list[Reason]


def misses_figure(misses: Sequence[Miss]) -> Figure:
    """Each miss from the camera (with detections and discs) and from the side; what is broken is
    orange."""
    figure = Figure(figsize=(3.5 * len(misses), 5.0), layout="constrained")
    axes = figure.subplots(1, 2 * len(misses))
    for number, miss in enumerate(misses):
        front, side = axes[2 * number], axes[2 * number + 1]
        broken = _broken_joints(miss.reasons)
        _skeleton(front, miss.truth[:, :2], TRUTH, broken, dashed=True)
        _skeleton(front, miss.hung[:, :2], "#0072B2", broken)
        for joint in np.flatnonzero(np.isfinite(miss.keypoints).all(axis=1)):
            front.plot(
                *miss.keypoints[joint], "+", color=RED if joint in broken else INK, ms=5, mew=1
            )
            if np.isfinite(miss.radius[joint]):
                turn = np.linspace(0, 2 * np.pi, 60)
                ring = miss.keypoints[joint] + miss.radius[joint] * np.stack(
                    [np.cos(turn), np.sin(turn)], axis=1
                )
                front.plot(*ring.T, color=RED if joint in broken else FAINT, lw=0.8)
        _skeleton(side, miss.truth[:, [2, 1]], TRUTH, broken, dashed=True)
        _skeleton(side, miss.hung[:, [2, 1]], "#0072B2", broken)
        front.set_title(miss.title, fontsize=8, loc="left")
        side.set_title("from the side,\naway from the camera →", fontsize=7, loc="left")
        words = [textwrap.fill(reason.sentence, 34) for reason in miss.reasons[:2]]
        front.set_xlabel("\n".join(words), fontsize=6.5, loc="left")
        rows = np.concatenate([miss.truth[:, 1], miss.hung[:, 1], miss.keypoints[:, 1]])
        middle, half = (
            (np.nanmax(rows) + np.nanmin(rows)) / 2,
            0.55 * np.ptp(rows[np.isfinite(rows)]) + 10,
        )
        for axis in (front, side):
            axis.set_ylim(middle - half, middle + half)
        for axis in (front, side):
            axis.set_aspect("equal")
            axis.invert_yaxis()
            axis.set_xticks([])
            axis.set_yticks([])
            axis.spines[:].set_visible(False)
    return figure


def _broken_joints(reasons: Sequence[Reason]) -> set[int]:
    """Joints at the ends of what is broken."""
    ends = {bone.name: bone.end for bone in BONES}
    parts = {reason.broken.part for reason in reasons}
    return {ends[part] for part in parts if part in ends} | {
        JOINT_INDEX[part] for part in parts if part in JOINT_INDEX
    }


def _skeleton(
    axis: Axes, points: np.ndarray, colour: str, broken: set[int], *, dashed: bool = False
) -> None:
    for joint in range(1, NUM_JOINTS):
        both = points[[PARENTS[joint], joint]]
        bad = joint in broken and not dashed
        axis.plot(
            *both.T,
            color=RED if bad else colour,
            lw=2.2 if bad else 1.4,
            ls=(0, (2, 1.2)) if dashed else "-",
            zorder=1 if dashed else 2,
        )


def _tidy(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=7)
