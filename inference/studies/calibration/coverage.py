"""How real poses are covered, from a `coverage.nc` of them: by joint and kind, the field's ECE,
sharpness, reasons.

An instance without draws counts as a miss at every level; it has no spread.
"""

from typing import NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.studies.calibration.ece import Ece, Interval, coverage, ece
from poseterior.inference.studies.calibration.exclusions import Rank, from_text, ranking
from poseterior.inference.studies.measured import (
    MeasureScore,
    MeasureStandings,
    scores_of_measures,
)
from poseterior.probmodel.measures import MEASURES

NOMINAL = (0.5, 0.8, 0.95)
COVERED_KINDS = ("lateral", "depth", "whole")


class CoverageSummary(NamedTuple):
    """`covered`: by (kind, nominal level) over all joints; `by_joint`: by (kind, nominal) of each
    of the nine; `ece`; medians over instances of the root-mean-square `lateral` and `depth` spread
    (mm) and of the log `evidence`; `without_draws`, `excluded` and `reasons` of all `size`
    instances."""

    size: int
    covered: dict[tuple[str, float], Interval]
    by_joint: dict[tuple[str, float], list[Interval]]
    ece: Ece
    lateral: float
    depth: float
    evidence: float
    without_draws: int
    excluded: Interval
    reasons: list[Rank]


def summary(tree: xr.DataTree) -> CoverageSummary:
    """Of a tree with columns `recording`, `unit_mm` and `reasons` (`coverage.nc` of real poses).
    Intervals draw whole recordings anew."""
    found = tree["simulation"].to_dataset()
    recording = found.recording.values
    covered = {}
    by_joint = {}
    for kind in COVERED_KINDS:
        for nominal in NOMINAL:
            covered[kind, nominal] = coverage(found[kind].values, nominal, recording)
            by_joint[kind, nominal] = [
                coverage(column, nominal, recording) for column in found[kind].values.T
            ]
    reasons = [from_text(text) for text in found.reasons.values.tolist()]
    held = np.array([0.0 if one else 1.0 for one in reasons])
    inside = coverage(np.where(held > 0, 0.0, np.nan), 0.5, recording)
    return CoverageSummary(
        size=len(recording),
        covered=covered,
        by_joint=by_joint,
        ece=ece(found.whole.values, found.stand_in.values, recording),
        lateral=_spread(found.spread_lateral, found.unit_mm),
        depth=_spread(found.spread_depth, found.unit_mm),
        evidence=float(np.median(found.log_evidence.values[_drawn(found)]))
        if _drawn(found).any()
        else np.nan,
        without_draws=int((~_drawn(found)).sum()),
        excluded=Interval(1 - inside.value, 1 - inside.high, 1 - inside.low),
        reasons=ranking(reasons),
    )


def measure_scores(tree: xr.DataTree) -> list[MeasureScore]:
    """How joint angles, lengths (mm) and steps are covered, of a tree as of `summary`. Intervals
    draw whole recordings anew; an instance without draws counts nowhere."""
    recording = tree["simulation"].recording.values
    return scores_of_measures(*measure_standings(tree), recording)


def measure_standings(tree: xr.DataTree) -> MeasureStandings:
    """`(n, q)` each: the standings of all instances, lengths in mm, of a tree as of `summary`."""
    found = tree["simulation"].to_dataset()
    lengths = np.array([MEASURES[name].kind == "length" for name in found.measure.values])
    scale = np.where(lengths, found.unit_mm.values[:, None], 1.0)
    level, error, width = (found[f"measure_{name}"].values for name in MeasureStandings._fields)
    return MeasureStandings(level, scale * error, scale * width)


def _drawn(found: xr.Dataset) -> np.ndarray:
    return np.isfinite(found.spread_depth.values).all(axis=1)


def _spread(spread: xr.DataArray, unit: xr.DataArray) -> float:
    """Median over instances of the root mean square over joints, in mm."""
    root = np.sqrt(np.mean(spread.values**2, axis=1)) * unit.values
    return float(np.nanmedian(root)) if np.isfinite(root).any() else np.nan
