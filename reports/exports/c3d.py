"""C3D: joints as points, with the spread of the draws as their residuals; written by the package
`c3d`."""

import warnings
from pathlib import Path

import numpy as np

from poseterior.probmodel.failures import BadInput, installing
from poseterior.probmodel.files import replacing
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS
from poseterior.reports.exports.clip import UNITS, Clip

MOST_C3D_FRAMES = 65_535
"""The header counts frames in sixteen bits."""
_INTEGERS, _RESIDUALS = 32_000, 127
"""Largest coordinate, if the file is ever converted to whole numbers, and largest residual, both in
steps of POINT:SCALE (the C3D user guide)."""


def write_c3d(clip: Clip, path: Path, unit: str) -> None:
    """Points of the joints' names. A residual is the root mean square distance of the draws from
    their mean, in the unit of the points and to a 127th of the largest; 0 where nothing is known of
    it, -1 where there is no pose.

    Readers differ over which byte of a point's last word is the residual, and which says what
    cameras saw the point (ezc3d takes the high one, py-c3d the low one): it is written in both, and
    no camera is meant. The package ezc3d would write it in the high one alone, in whole units, of
    which those beyond 255 begin again at 0.

    Raises `BadInput` where the package `c3d` is missing, or there are more poses than a C3D file
    counts."""
    try:
        import c3d
    except ImportError:
        raise BadInput(
            f"C3D files need the package c3d; {installing('export')}; or choose another --to"
        ) from None
    clip = clip.regular()
    if len(clip.joints) > MOST_C3D_FRAMES:
        raise BadInput(
            f"a C3D file counts {MOST_C3D_FRAMES:,} frames at most, not {len(clip.joints):,}; give"
            " fewer --draws, or choose another --to"
        )
    points = UNITS[unit] * clip.joints
    radius = np.zeros(points.shape[:2]) if clip.radius is None else UNITS[unit] * clip.radius
    scale = max(np.nanmax(np.abs(points)) / _INTEGERS, np.nanmax(radius) / _RESIDUALS)
    writer = c3d.Writer(point_rate=clip.pace, analog_rate=0.0, point_scale=-scale, point_units=unit)
    writer.set_point_labels(list(JOINTS))
    writer.set_screen_axis("+X", "+Y")
    nothing = np.empty((0, 0))
    writer.add_frames([(row, nothing) for row in _rows(points, radius, scale)])
    with (
        replacing(path, "choose another --out") as partial,
        partial.open("wb") as file,
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", message="No analog data found", category=UserWarning)
        writer.write(file)


def _rows(points: np.ndarray, radius: np.ndarray, scale: float) -> np.ndarray:
    """`(n, 15, 5)`: x, y, z, residual (-1: no point), and the byte of the cameras."""
    rows = np.zeros((len(points), NUM_JOINTS, 5), np.float32)
    there = np.isfinite(points).all(axis=-1)
    rows[..., :3] = np.where(there[..., None], points, 0.0)
    steps = np.round(np.where(there, radius, 0.0) / scale)
    rows[..., 3] = np.where(there, steps * scale, -1.0)
    rows[..., 4] = steps
    return rows
