"""CSV and .npz: one row a pose, with the standard deviations of every coordinate where there are
any."""

import csv
from pathlib import Path

import numpy as np

from poseterior.probmodel.arrays import write_tables
from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.exports.clip import UNITS, Clip

ADVICE = "choose another --out"
_COLUMNS = [f"{joint}_{axis}" for joint in JOINTS for axis in "xyz"]


def write_csv(clip: Clip, path: Path, unit: str) -> None:
    """A table with the columns index, of a film frame, time_s, name, weight (hypotheses only),
    JOINT_x_UNIT …, where there are any the standard deviations JOINT_x_sd_UNIT …, and of measures
    that were asked for MEASURE_deg or MEASURE_UNIT, and MEASURE_sd_…; a missing pose is empty, and
    a frame that is not there has no row."""
    columns = [f"{name}_{unit}" for name in _COLUMNS]
    if clip.spread is not None:
        columns += [f"{name}_sd_{unit}" for name in _COLUMNS]
    columns += [head for one in clip.measures for head in one.heads(unit)]
    weight = [] if clip.weights is None else ["weight"]
    with (
        replacing(path, ADVICE) as partial,
        partial.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file,
    ):
        rows, times, frames = csv.writer(file), clip.times, clip.frames
        frame = ["frame"] if clip.film else []
        rows.writerow(["index", *frame, "time_s", "name", *weight, *columns])
        for index, name in enumerate(clip.names):
            number = [frames[index]] if clip.film else []
            head = [index, *number, f"{times[index]:.6f}", name]
            if clip.weights is not None:
                head.append(f"{clip.weights[index]:.6f}")
            rows.writerow([*head, *_texts(clip, index, unit)])


def _texts(clip: Clip, index: int, unit: str) -> list[str]:
    """A pose's numbers, to a thousandth of a millimetre."""
    scale = UNITS[unit]
    blocks = [clip.joints] if clip.spread is None else [clip.joints, clip.spread]
    digits = 6 if scale == 1 else 3
    places = scale * np.concatenate([block[index].ravel() for block in blocks])
    measured = [
        column[index]
        for one in clip.measures
        for column in one.in_unit(unit)[1:]
        if column is not None
    ]
    numbers = [*places, *measured]
    return [f"{number:.{digits}f}" if np.isfinite(number) else "" for number in numbers]


def write_npz(clip: Clip, path: Path, unit: str) -> None:
    """Arrays for NumPy: `joints` `(n, 15, 3)`, `spread` and `weights` where there are any, `times`
    in seconds, of a film `frames` (as texts, since numbers may be long), and the names of poses,
    joints and axes; `unit` is that of lengths."""
    arrays = {
        "joints": UNITS[unit] * clip.joints,
        "times": clip.times,
        "names": np.array(clip.names),
        "joint_names": np.array(JOINTS),
        "axes": np.array(["right", "up", "towards the camera"]),
        "unit": np.array(unit),
    }
    if clip.film:
        arrays["frames"] = np.array([str(number) for number in clip.frames])
    if clip.spread is not None:
        arrays["spread"] = UNITS[unit] * clip.spread
    if clip.weights is not None:
        arrays["weights"] = clip.weights
    write_tables(path, arrays)
