"""Measures of one body from two calibrated cameras, judged by what the other two triangulate. For
reports/cameras.md."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from poseterior.inference.studies.measured import (
    MeasureScore,
    scores_of_measures,
    standings_of,
)
from poseterior.probmodel.layouts import without_midpoints
from poseterior.probmodel.level import level_axes, up_of
from poseterior.probmodel.sessions import Session
from poseterior.reports.pages.honest import STRETCH


def measured_beside(
    session: Session,
    draws: np.ndarray,
    truth: np.ndarray,
    errors: np.ndarray,
    rng: np.random.Generator,
) -> list[list[float]]:
    """The standings of measures, lists of three, of draws `(n, 15, 3)` of the world, mm, which have
    the skeleton's thorax and pelvis, beside what other cameras triangulate, `truth` `(15, 3)`,
    with its `errors` `(n, 15, 3)`, which has the detector's."""
    axes = level_axes(up_of(np.stack([one.rotation for one in session.cameras]))[0])
    right = without_midpoints(truth, session.midpoints)
    stray = without_midpoints(truth + errors, session.midpoints) - right
    found = standings_of(right @ axes.T, (draws + stray) @ axes.T, draws @ axes.T, rng)
    return [part.tolist() for part in found]


def scores_of_pairs(found: Mapping[str, Mapping[str, Any]], way: str) -> list[MeasureScore]:
    """Of all pairs of cameras together, by stretches of the film."""
    every = list(found.values())
    parts = np.concatenate([np.array(one[way], float) for one in every])
    stretch = np.concatenate([np.array(one["rows"]) // STRETCH for one in every])
    level, error, width = np.moveaxis(parts, 1, 0)
    return scores_of_measures(level, error, width, stretch)
