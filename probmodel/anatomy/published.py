"""Importer of the published joint-limit model of Akhter & Black (CVPR 2015),
`jointAngleModel_v2.mat`.

The file is for research only and is not part of this package; whoever has it can check and sample
under it. Its bones are parent minus child in a left-handed system, as in `kinematics`, so
directions are taken over as they are. What changes is the order of the bones, the base of the
indices and the size of the tables (a last empty row and column are cut). The usual way in:
`read_published(path)`.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from poseterior.probmodel.anatomy.limits import GRID, AnatomicalLimits
from poseterior.probmodel.arrays import doubles, possible, read_mat
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import LOWER_BONES, UPPER_BONES

_BONE_OF_CHILD = {
    "head": 8,
    "right_upper_arm": 3,
    "left_upper_arm": 6,
    "right_upper_leg": 10,
    "left_upper_leg": 14,
    "right_forearm": 4,
    "left_forearm": 7,
    "right_lower_leg": 11,
    "left_lower_leg": 15,
}
"""One-based number of each bone among the sixteen of the published skeleton."""
_STORED = (GRID[0] + 1, GRID[1] + 1)
_NUM_BONES, _NUM_CHILDREN, _DEGREES = 16, 11, 3
_TABLES = {"sepPlane": 4, "E2": 3, "bounds": 4}
_MODEL_VARIABLES = ("jmp", "chlds", "prnts", "angleSprd", *_TABLES)
_POSE_VARIABLES = ("a", "di")


def read_published(
    path: str | os.PathLike, static_pose: str | os.PathLike | None = None
) -> AnatomicalLimits:
    """Limits named "akhter-black" from the published .mat file.

    Parameters
    ----------
    path
        Of `jointAngleModel_v2.mat`.
    static_pose
        Of the published `staticPose.mat`, from which the reference direction `a` and the static
        bones `di` are read; by default from the model itself.

    Returns
    -------
    AnatomicalLimits
        For poses in right-handed axes, as everywhere here.

    Raises
    ------
    BadInput
        Where a file is not a MATLAB file, is truncated, lacks a variable, or holds tables of other
        shapes.
    """
    path = Path(path)
    model = _read_mat(path)
    pose_path = path if static_pose is None else Path(static_pose)
    pose = model if static_pose is None else _read_mat(pose_path)
    _require(model, _MODEL_VARIABLES, path)
    _require(pose, _POSE_VARIABLES, pose_path)
    children, parents = (_indices(model, key, path) for key in ("chlds", "prnts"))
    degrees = _numbers(model["jmp"], "jmp", path).ravel()
    if degrees.tolist() != [_DEGREES]:
        raise BadInput(
            f"{path}: jmp is {degrees.tolist()}, the published model has cells of {_DEGREES}"
            " degrees"
        )

    upper = [_entry(children, bone.name, path) for bone in UPPER_BONES]
    lower = [_entry(children, bone.name, path) for bone in LOWER_BONES]
    occupied = np.stack([_occupancy(model["angleSprd"], entry, path) for entry in upper])
    planes, tangents, bounds = (
        np.stack([_table(model, key, entry, path) for entry in lower]) for key in _TABLES
    )
    static = _numbers(pose["di"], "di", pose_path)
    if static.shape != (3, _NUM_BONES):
        raise BadInput(
            f"{pose_path}: di has shape {static.shape}, the published static pose has (3,"
            f" {_NUM_BONES})"
        )
    fallback = static[:, parents[lower] - 1].T
    size = np.linalg.norm(fallback, axis=-1, keepdims=True)
    if not (size > 0).all():
        raise BadInput(f"{pose_path}: a bone of the static pose di has no length")
    limits = AnatomicalLimits(
        occupied=occupied,
        normal=planes[..., :3],
        tangent=tangents,
        offset=planes[..., 3],
        bounds=bounds,
        reference=_numbers(pose["a"], "a", pose_path).ravel(),
        fallback=fallback / size,
        name="akhter-black",
    )
    limits.verify(str(path))
    return limits


def _read_mat(path: Path) -> dict[str, Any]:
    advice = "give the path of the published jointAngleModel_v2.mat"
    return read_mat(path, (*_MODEL_VARIABLES, *_POSE_VARIABLES), "MATLAB file", advice)


def _require(variables: Mapping[str, Any], names: tuple[str, ...], path: Path) -> None:
    missing = [name for name in names if name not in variables]
    if missing:
        raise BadInput(
            f"{path} lacks {', '.join(missing)}, so it is not the published joint-limit model"
        )


def _numbers(value: Any, key: str, path: Path) -> np.ndarray:
    """As float64: the file keeps bin sizes and indices as uint8, whose arithmetic overflows."""
    value = np.asarray(value)
    if value.dtype.kind not in "buif":
        raise BadInput(
            f"{path}: {key} holds no real numbers, so this is not the published joint-limit model"
        )
    numbers = doubles(value)
    if not possible(np.nan_to_num(numbers, nan=0.0, posinf=np.inf, neginf=-np.inf)):
        raise BadInput(f"{path}: {key} holds a number that is not finite, or beyond reason")
    return numbers


def _indices(model: Mapping[str, Any], key: str, path: Path) -> np.ndarray:
    indices = _numbers(model[key], key, path).ravel().astype(int)
    if indices.size != _NUM_CHILDREN or indices.min() < 1 or indices.max() > _NUM_BONES:
        raise BadInput(
            f"{path}: {key} does not hold {_NUM_CHILDREN} bone numbers from 1 to {_NUM_BONES}"
        )
    return indices


def _entry(children: np.ndarray, bone: str, path: Path) -> int:
    entries = np.flatnonzero(children == _BONE_OF_CHILD[bone])
    if entries.size != 1:
        raise BadInput(
            f"{path}: chlds names the {bone.replace('_', ' ')} {entries.size} times, not once"
        )
    return int(entries[0])


def _cell(cells: Any, key: str, entry: int, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """One entry of a MATLAB cell array."""
    cells = np.asarray(cells)
    if cells.dtype != object or cells.size != _NUM_CHILDREN:
        raise BadInput(f"{path}: {key} is not a cell array of {_NUM_CHILDREN} entries")
    table = _numbers(cells.ravel()[entry], key, path)
    if table.shape != shape:
        raise BadInput(
            f"{path}: entry {entry + 1} of {key} has shape {table.shape}, the published model has"
            f" {shape}"
        )
    return table


def _trim(table: np.ndarray, empty: np.ndarray, key: str, path: Path) -> np.ndarray:
    """Cuts the row at 180° of azimuth and the column at 90° of elevation, in which no bin can
    lie."""
    if not (empty[-1].all() and empty[:, -1].all()):
        raise BadInput(
            f"{path}: a table of {key} is filled in its last row or column, which must be empty"
        )
    return table[:-1, :-1]


def _occupancy(cells: Any, entry: int, path: Path) -> np.ndarray:
    table = _cell(cells, "angleSprd", entry, _STORED, path) > 0
    return _trim(table, ~table, "angleSprd", path)


def _table(model: Mapping[str, Any], key: str, entry: int, path: Path) -> np.ndarray:
    """A table where there is a plane; the published `E2` holds numbers elsewhere too."""
    table = _cell(model[key], key, entry, (*_STORED, _TABLES[key]), path)
    plane = _cell(model["sepPlane"], "sepPlane", entry, (*_STORED, _TABLES["sepPlane"]), path)
    empty = np.isnan(plane[..., 3])
    return _trim(np.where(empty[..., None], np.nan, table), empty, "sepPlane", path)
