"""How far depth is known over the frames of a stream.

save_figure(film_figure(tree["summary"].to_dataset()), path)
"""

import math

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from poseterior.inference.stream import frame_and_person
from poseterior.probmodel.formats.frames import frame_numbers
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.reports.figures.colours import COLOURS
from poseterior.reports.figures.style import DPI, FAINT, INK, SMALL, TEXT, entitle, page, tidy
from poseterior.reports.tables.words import spoken

SHOWN_ENDS = ("right_wrist", "left_wrist", "right_ankle", "left_ankle")
FILM_WIDTH, HEIGHT = 10.5, 5.2
"""Inches."""
BEHIND = "Depth behind the pelvis"
MOST_PEOPLE = 3
"""Of whom there is a column each; those with the most poses."""


def film_figure(summary: xr.Dataset) -> Figure:
    """Wrists and ankles of each person: median of the depth behind the pelvis, half of the draws,
    and 90 % of them, frame by frame; gaps where there is no pose. Body units. Of calibrated cameras
    along the level axis z.

    Parameters
    ----------
    summary
        Of a stream, as `inference.open_stream` gives it.
    """
    names = [frame_and_person(str(name)) for name in summary.frame.values]
    frames = list(dict.fromkeys(frame for frame, _ in names))
    numbers = frame_numbers(frames) or list(range(len(frames)))
    step = math.gcd(*(number - numbers[0] for number in numbers)) or 1
    places = [(number - min(numbers)) // step for number in numbers]
    place = dict(zip(frames, places, strict=True))
    people = _people(summary, [person for _, person in names])
    figure = page(FILM_WIDTH, HEIGHT, dpi=DPI)
    axes = figure.subplots(len(SHOWN_ENDS), len(people), sharex=True, sharey=True, squeeze=False)
    for column, person in enumerate(people):
        shown = min(numbers) + step * np.arange(max(places) + 1)
        bands = np.full((max(places) + 1, *summary.depth.shape[1:]), np.nan)
        for row, (frame, one) in enumerate(names):
            if one == person:
                bands[place[frame]] = summary.depth.values[row]
        for axis, end in zip(axes[:, column], SHOWN_ENDS, strict=True):
            _draw_bands(axis, shown, bands[:, JOINT_INDEX[end]], end)
        said = f", person {person}" if len(people) > 1 else ""
        along = "From the pelvis along the level axis z" if "view" in summary.dims else BEHIND
        title = f"{along}{said}"
        entitle(axes[0, column], title)
        axes[-1, column].set_xlabel(
            "frame     (median, half of the draws, 90 % of them; body units)",
            fontsize=SMALL,
            color=INK,
        )
    for axis, end in zip(axes[:, 0], SHOWN_ENDS, strict=True):
        axis.set_ylabel(spoken(end), fontsize=TEXT, color=INK)
    return figure


def _people(summary: xr.Dataset, owners: list[str]) -> list[str]:
    """Those with the most poses, in the order of their names."""
    counts = {
        person: sum(
            int(draws > 0)
            for owner, draws in zip(owners, summary.num_draws.values, strict=True)
            if owner == person
        )
        for person in owners
    }
    most = sorted(counts, key=lambda person: -counts[person])[:MOST_PEOPLE]
    return sorted(most, key=lambda person: (len(person), person))


def _draw_bands(axis: Axes, frames: np.ndarray, bands: np.ndarray, end: str) -> None:
    """Bands `(frames, 5)` of one joint, quantile by quantile, over the frames' numbers."""
    colour = COLOURS[JOINT_INDEX[end]]
    for low, high, alpha in ((0, 4, 0.2), (1, 3, 0.4)):
        gid = f"band {end} {low}"
        axis.fill_between(
            frames, bands[:, low], bands[:, high], color=colour, alpha=alpha, lw=0, gid=gid
        )
    marker = "." if len(bands) < 3 else None
    axis.plot(frames, bands[:, 2], color=colour, lw=1.2, marker=marker, gid=f"median {end}")
    axis.axhline(0, color=FAINT, lw=0.6, ls=":")
    tidy(axis)
    axis.spines[:].set_color(FAINT)
    axis.tick_params(labelsize=SMALL, color=FAINT)
