"""Joint angles, lengths and steps on their way to other software: OpenSim's .mot and .sto, and
columns of a table."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from poseterior.inference.summaries import centre, deviation
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import replacing
from poseterior.probmodel.measures import Measure
from poseterior.reports.exports.clip import Clip, MeasureColumn

OPENSIM = {
    f"{side}_{ours}": f"{theirs}_{side[0]}"
    for side in ("right", "left")
    for ours, theirs in {
        "hip_flexion": "hip_flexion",
        "hip_adduction": "hip_adduction",
        "hip_rotation": "hip_rotation",
        "knee_flexion": "knee_angle",
        "elbow_flexion": "elbow_flex",
    }.items()
}
"""Coordinates of OpenSim's full-body model (Rajagopal et al. 2016) that count as ours do."""
TAB = "\t"


def of_poses(
    joints: np.ndarray, draws: np.ndarray | None, chosen: Sequence[Measure], metres: float
) -> tuple[MeasureColumn, ...]:
    """Of poses `(n, 15, 3)`, beside the deviations of all draws `(m, 15, 3)`; both in camera axes
    and body units of so many metres."""
    return tuple(
        MeasureColumn(
            one,
            _scaled(one, metres) * one.of(joints),
            None
            if draws is None
            else np.full(len(joints), _scaled(one, metres) * _spread(one, one.of(draws))),
        )
        for one in chosen
    )


def of_frames(
    items: Sequence[str | None],
    drawn: Mapping[str, xr.Dataset],
    chosen: Sequence[Measure],
    metres: float,
) -> tuple[MeasureColumn, ...]:
    """Mean and deviation of the draws of every frame, each an item of a stream (None: not in that
    frame), in body units of so many metres."""
    joints = [
        None if name is None else drawn[name].joints.values[0].astype(float) for name in items
    ]
    columns = []
    for one in chosen:
        rows = [_mean_and_spread(one, poses) for poses in joints]
        values, spread = _scaled(one, metres) * np.array(rows).T
        columns.append(MeasureColumn(one, values, spread))
    return tuple(columns)


def _scaled(one: Measure, metres: float) -> float:
    return metres if one.kind == "length" else 1.0


def _spread(one: Measure, draws: np.ndarray) -> float:
    held = draws[np.isfinite(draws)]
    return float(deviation(held, one.circular)) if len(held) else np.nan


def _mean_and_spread(one: Measure, poses: np.ndarray | None) -> tuple[float, float]:
    draws = np.empty(0) if poses is None else one.of(poses)
    held = draws[np.isfinite(draws)]
    if not len(held):
        return np.nan, np.nan
    return float(centre(held, one.circular)), float(deviation(held, one.circular))


def write_motion(clip: Clip, path: Path, unit: str) -> None:
    """OpenSim's table of coordinates over time: time in seconds, angles in degrees; beside it
    NAME_sd.sto with the standard deviations of the draws, where there are any. Poses without a
    value have no row. Coordinates that OpenSim's full-body model (Rajagopal et al. 2016) counts in
    the same way have its names."""
    columns = [one.in_unit(unit) for one in clip.measures]
    values = np.array([one.values for one in columns])
    rows = np.flatnonzero(np.isfinite(values).all(axis=0))
    if not len(rows):
        raise BadInput("no pose determines all of these measures; ask for fewer with --measure")
    names = [OPENSIM.get(one.measure.name, one.measure.name) for one in columns]
    _write(path, names, clip.times[rows], values[:, rows])
    spreads = [one.spread for one in columns if one.spread is not None]
    if spreads:
        beside = path.with_name(f"{path.stem}_sd.sto")
        _write(beside, names, clip.times[rows], np.array(spreads)[:, rows])


def _write(path: Path, names: list[str], times: np.ndarray, values: np.ndarray) -> None:
    head = [
        path.stem,
        "version=1",
        f"nRows={len(times)}",
        f"nColumns={1 + len(names)}",
        "inDegrees=yes",
        "endheader",
        TAB.join(["time", *names]),
    ]
    lines = [
        TAB.join([f"{time:.6f}", *(f"{value:.6f}" for value in row)])
        for time, row in zip(times, values.T, strict=True)
    ]
    with replacing(path, "choose another --out") as partial:
        partial.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")
