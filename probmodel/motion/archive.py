"""Recordings as arrays of joint positions in an .npz, of fifteen joints or of Akhter & Black's
seventeen."""

from pathlib import Path

import numpy as np

from poseterior.probmodel.arrays import doubles, possible, read_tables
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion.recording import FROM_SEVENTEEN, NPZ_RATE, Motion, require_depth
from poseterior.probmodel.skeleton import NUM_JOINTS


def read_archive(path: Path) -> list[Motion]:
    """The recordings of an .npz, one a key. Raises `BadInput` where it holds none or one of another
    shape."""
    arrays = read_tables(
        path, "file of recordings", "give an .npz of (T, 15, 3) or (T, 17, 3) positions"
    )
    if not arrays:
        raise BadInput(
            f"{path} holds no recording; its keys must hold (T, 15, 3) or (T, 17, 3) positions"
        )
    return [_npz_motion(path, key, value) for key, value in arrays.items()]


def _npz_motion(path: Path, key: str, value: np.ndarray) -> Motion:
    if (
        value.dtype.kind not in "fiu"
        or value.ndim != 3
        or value.shape[1:] not in ((NUM_JOINTS, 3), (17, 3))
    ):
        raise BadInput(
            f"{path}: '{key}' has shape {value.shape}, a recording has (T, {NUM_JOINTS}, 3) or (T,"
            " 17, 3)"
        )
    joints = doubles(value)
    if not possible(joints):
        raise BadInput(
            f"{path}: '{key}' has a coordinate that is not finite, or beyond"
            f" ±{LARGEST_NUMBER:g} mm; leave such frames out"
        )
    if len(joints) == 0:
        raise BadInput(f"{path}: '{key}' has no frames; leave it out")
    require_depth(joints, path)
    return Motion(
        joints if joints.shape[1] == NUM_JOINTS else joints[:, FROM_SEVENTEEN],
        NPZ_RATE,
        key,
        path.stem,
    )
