"""A data set as a plain .npz, for whatever has no reader of its own.

Arrays: `poses` (N, 15, 3) in millimetres, right-handed, joints in the order of `skeleton.JOINTS`;
`keypoints` (N, 15, 2) pixels, NaN where missing; `action` and `subject` (N,) texts. Optional:
`score` (N, 15), else 1 where seen; `recording` (N,), else the subject and action; `scale` (N,)
pixels a mm and `translation` (N, 2) of the true camera, then the poses must be in its axes (x
right, y down, z away), else the camera is fitted; `midpoints` texts, which of thorax and pelvis are
midpoints of shoulders and hips, else none; `doubt` (N, 15, 3, 3), covariances of the poses' own
errors, mm², in their axes."""

from pathlib import Path

import numpy as np

from poseterior.probmodel.arrays import doubles, npz_names, possible, read_tables, write_tables
from poseterior.probmodel.datasets.cases import COLUMNS, DataSet
from poseterior.probmodel.datasets.views import resection
from poseterior.probmodel.detections import LARGEST_NUMBER, is_label
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.motion.recording import require_depth
from poseterior.probmodel.skeleton import NUM_JOINTS

NEEDED = ("poses", "keypoints", "action", "subject")
_WHAT, _ADVICE = "data set", f"give an .npz with {', '.join(NEEDED)}"


def is_plain(path: Path) -> bool:
    """Whether it is an .npz with `poses` or `keypoints`."""
    return bool({"poses", "keypoints"} & npz_names(path, _WHAT, _ADVICE))


def read_plain(path: Path) -> DataSet:
    """Reads a plain .npz. Raises `BadInput` as `DataSet` does, and where an array is missing or is
    not of its kind."""
    arrays = read_tables(path, _WHAT, _ADVICE, NEEDED)
    poses, keypoints = (
        _numbers(arrays[name], name, (NUM_JOINTS, size), path)
        for name, size in (("poses", 3), ("keypoints", 2))
    )
    number = len(poses)
    if len(keypoints) != number:
        raise BadInput(
            f"{path}: there are {number} poses, but {len(keypoints)} sets of keypoints; give one"
            " each"
        )
    labels = {name: _texts(arrays[name], name, number, path) for name in ("action", "subject")}
    together = np.char.add(np.char.add(labels["subject"], " "), labels["action"])
    labels["recording"] = (
        _texts(arrays["recording"], "recording", number, path)
        if "recording" in arrays
        else together
    )
    seen = np.isfinite(keypoints).all(axis=-1)
    score = _numbers(arrays.get("score", np.ones(seen.shape)), "score", (NUM_JOINTS,), path)
    if score.shape != seen.shape:
        raise BadInput(
            f"{path}: score has shape {score.shape}, which must be {seen.shape}; one for each joint"
        )
    require_depth(poses, path)
    poses, doubt = poses - poses[:, :1], arrays.get("doubt")
    if doubt is not None:
        doubt = _numbers(doubt, "doubt", (NUM_JOINTS, 3, 3), path)
    if "scale" in arrays and "translation" in arrays:
        scale = _numbers(arrays["scale"], "scale", (), path)
        translation = _numbers(arrays["translation"], "translation", (2,), path)
    else:
        rotation, scale, translation = resection(poses, keypoints)
        fitted = np.isfinite(rotation).all(axis=(1, 2))
        turn = np.where(fitted[:, None, None], np.nan_to_num(rotation), np.eye(3))
        poses = poses @ np.swapaxes(turn, -1, -2)
        if doubt is not None:
            doubt = turn[:, None] @ doubt @ np.swapaxes(turn, -1, -2)[:, None]
    keypoints = np.where((seen & (score != 0))[..., None], keypoints, np.nan)
    return DataSet(
        name=path.name,
        poses=poses,
        keypoints=keypoints,
        score=np.where(seen, score, 0.0),
        scale=scale,
        translation=translation,
        action=labels["action"],
        subject=labels["subject"],
        recording=labels["recording"],
        midpoints=_midpoints(arrays.get("midpoints", np.array([], str)), path),
        doubt=doubt,
    )


def write_plain(data: DataSet, path: Path) -> None:
    """Writes what `read_plain` reads, atomically. Raises `BadInput` where it cannot be written, and
    on cases whose lenses are known, for which such a file has no room."""
    if data.lens is not None:
        raise BadInput(f"{path} has no room for lenses; write the cases without perspective")
    columns = {name: getattr(data, name) for name in COLUMNS}
    columns |= {} if data.doubt is None else {"doubt": data.doubt}
    columns |= {"midpoints": np.array(data.midpoints)} if data.midpoints else {}
    write_tables(path, columns)


def _numbers(value: np.ndarray, name: str, row: tuple[int, ...], path: Path) -> np.ndarray:
    """`(N, *row)` as float64, NaN where missing. Raises `BadInput` on text, on another shape, and
    on numbers that cannot be places or scores."""
    wanted = ", ".join(map(str, ("N", *row)))
    if value.dtype.kind not in "fiu" or not value.ndim or value.shape[1:] != row:
        raise BadInput(
            f"{path}: {name} has shape {shown(value.shape)} and type {shown(str(value.dtype))},"
            f" where numbers ({wanted}) are needed; bring other skeletons to these fifteen joints"
        )
    numbers = doubles(value)
    if not possible(np.nan_to_num(numbers, nan=0.0, posinf=np.inf, neginf=-np.inf)):
        raise BadInput(f"{path}: {name} holds a number beyond ±{LARGEST_NUMBER:g}; leave it out")
    return numbers


def _midpoints(value: np.ndarray, path: Path) -> tuple[str, ...]:
    names = _texts(value, "midpoints", value.size, path)
    return tuple(dict.fromkeys(names.tolist()))


def _texts(value: np.ndarray, name: str, number: int, path: Path) -> np.ndarray:
    if value.shape != (number,) or value.dtype.kind not in "US":
        raise BadInput(
            f"{path}: {name} must be {number} texts in one row, but has shape"
            f" {shown(value.shape)} and type {shown(str(value.dtype))}"
        )
    texts = np.char.decode(value, "utf-8", "replace") if value.dtype.kind == "S" else value
    for text in np.unique(texts):
        if not is_label(str(text)):
            raise BadInput(f"{path}: {name} holds {shown(str(text))}, which is no name")
    return texts
