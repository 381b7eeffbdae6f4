"""The film of a stream as a page: hypotheses frame by frame, and bands of depth over time."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.stream import LEVELS, frame_and_person
from poseterior.inference.summaries import unrolled
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from poseterior.reports.figures.colours import hypothesis_colours, measure_colour
from poseterior.reports.interactive.page import assemble, packed
from poseterior.reports.tables.frames import film_table, people_of_film, stream_lines
from poseterior.reports.tables.words import spoken

MOST_BYTES = 4_000_000
"""Of poses and bands on a page; of a longer film it holds frames evenly spread."""


def film_page(
    tree: xr.DataTree,
    title: str,
    *,
    fragments: Sequence[str] = (),
    measured: xr.Dataset | None = None,
) -> str:
    """The page of a stream.

    Parameters
    ----------
    tree
        As `inference.open_stream` gives it.
    title
        What the film is called.
    fragments
        Names of people who were left out.
    measured
        The stream's measures, as `inference.measures` gives them, where draws were kept.

    Raises
    ------
    BadInput
        Where the stream has no pose, or no quantiles of depth, which earlier versions did not keep.
    """
    summary = tree["summary"].to_dataset()
    if "depth" not in summary:
        raise BadInput(
            f"{title} is a stream of an earlier version, without quantiles of depth; make it again"
            " in another folder"
        )
    if not np.isfinite(summary["mean"].values).any():
        raise BadInput(f"{title} has no frame with a pose; its summary says why")
    names = [frame_and_person(str(name)) for name in summary.frame.values]
    frames = list(dict.fromkeys(frame for frame, _ in names))
    people = sorted({person for _, person in names}, key=lambda name: (len(name), name))
    poses = tree["hypotheses"].joints.values
    quantiles = _quantiles(measured, len(names))
    shown = _shown(len(frames), poses.shape[1], len(people), quantiles.shape[1])
    place = {frames[index]: row for row, index in enumerate(shown)}
    rows = [(place.get(frame), person) for frame, person in names]
    data = {
        "frames": [frames[index] for index in shown],
        "people": [_person(person, rows, tree, len(shown), quantiles) for person in people],
        "measures": _named(measured),
        "k": poses.shape[1],
        "in_world": "view" in summary.dims,
        "levels": list(LEVELS),
        "hypothesis_colours": hypothesis_colours(poses.shape[1]),
        "start": JOINT_INDEX["right_wrist"],
    }
    return assemble(
        "film",
        title,
        data,
        facts=stream_lines(summary, fragments),
        warnings=_left_out(len(frames), len(shown)),
        sentences=[],
        sheets=[people_of_film(summary), film_table(summary)],
    )


def _shown(frames: int, k: int, people: int, measures: int) -> np.ndarray:
    """Which frames a page holds."""
    numbers = NUM_JOINTS * (3 * k + len(LEVELS)) + measures * len(LEVELS)
    of_frame = people * 4 * numbers * 4 / 3  # base64 has a third more
    return evenly(frames, max(1, int(MOST_BYTES / of_frame)))


def _named(measured: xr.Dataset | None) -> list[dict[str, str]]:
    """The measures that a page shows, in words, with their units and colours."""
    if measured is None:
        return []
    return [
        {
            "name": spoken(str(name)),
            "unit": str(one.attrs["units"]),
            "colour": measure_colour(str(name)),
        }
        for name, one in measured.items()
    ]


def _quantiles(measured: xr.Dataset | None, items: int) -> np.ndarray:
    """`(items, measures, levels)`: of the draws of each item of a stream."""
    if measured is None:
        return np.zeros((items, 0, len(LEVELS)))
    found = np.full((items, len(measured), len(LEVELS)), np.nan)
    for column, one in enumerate(measured.values()):
        for row, draws in enumerate(one.transpose("frame", "draw").values):
            held = draws[np.isfinite(draws)]
            if len(held):
                line = unrolled(held, bool(one.attrs["circular"]))
                found[row, column] = np.quantile(line, LEVELS)
    return found


def _person(
    person: str,
    rows: list[tuple[int | None, str]],
    tree: xr.DataTree,
    frames: int,
    quantiles: np.ndarray,
) -> dict[str, Any]:
    """Everything of one person, NaN in frames without."""
    own = [
        (index, row) for index, (row, one) in enumerate(rows) if one == person and row is not None
    ]
    poses, summary = tree["hypotheses"].joints.values, tree["summary"].to_dataset()
    found = np.full((frames, *poses.shape[1:]), np.nan)
    bands = np.full((frames, NUM_JOINTS, len(LEVELS)), np.nan)
    measures = np.full((frames, *quantiles.shape[1:]), np.nan)
    words = ["not in this frame"] * frames
    for index, row in own:
        found[row], bands[row] = poses[index], summary.depth.values[index]
        measures[row] = quantiles[index]
        words[row] = str(summary.sentence.values[index])
    return {
        "name": person or "0",
        "poses": packed(found.reshape(-1, 3 * NUM_JOINTS)),
        "bands": packed(bands),
        "measures": packed(measures),
        "words": words,
    }


def _left_out(frames: int, shown: int) -> Iterable[str]:
    if shown < frames:
        yield (
            f"The film has {frames:,} frames; this page holds {shown:,} of them, evenly spread, so"
            " that it stays small."
        )
