"""Human3.6M as VideoPose3D keeps it: `data_3d_h36m.npz` and, beside it, `data_2d_h36m_<name>.npz`.

positions_3d[subject][action] is (T, 32, 3), metres, axes of the room; positions_2d[subject][action]
holds, for each of four cameras, (T, 17, 2) pixels. The files do not hold the cameras: a
weak-perspective one is fitted to every frame (`views.resection`), and turns its pose into camera
axes. Human3.6M may not be redistributed."""

import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from poseterior.probmodel.datasets.cases import DataSet
from poseterior.probmodel.datasets.pickles import read_object
from poseterior.probmodel.datasets.views import resection
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.layouts import H36M_17
from poseterior.probmodel.rows import evenly, shares
from poseterior.probmodel.skeleton import JOINTS

FILE_3D = "data_3d_h36m.npz"
SEVENTEEN = (0, 1, 2, 3, 6, 7, 8, 12, 13, 14, 15, 17, 18, 19, 25, 26, 27)
"""Where the joints of `layouts.H36M_17` are among the recording's 32; the others repeat or do not
move."""
SUBJECTS = ("S1", "S5", "S6", "S7", "S8", "S9", "S11")


class _Take(NamedTuple):
    """One action of one subject seen by one camera."""

    subject: str
    action: str
    camera: int
    poses: np.ndarray
    keypoints: np.ndarray


def is_human36m(path: Path) -> bool:
    """Whether it is VideoPose3D's 3D file, or a folder that has it."""
    return path.name.startswith("data_3d_") or (path / FILE_3D).is_file()


def read_human36m(path: Path, detections: str = "gt", frames: int | None = None) -> DataSet:
    """All subjects, cameras and actions; `Walking 1` and `Walking 2` are one action.

    Parameters
    ----------
    path
        VideoPose3D's 3D file, or the folder that has it.
    detections
        Which 2D file, as in `read_data_set`. Its joints have no scores: they are 1.
    frames
        How many, as many of each action as of any other, evenly over its takes. By default all;
        the paper has about every 80th, 26,380.

    Raises
    ------
    BadInput
        Where a file is missing or is not VideoPose3D's, or the two do not go together.
    """
    file = path / FILE_3D if path.is_dir() else path
    beside = file.with_name(
        file.name.replace("data_3d_", "data_2d_").replace(".npz", f"_{detections}.npz")
    )
    for needed in (file, beside):
        if not needed.exists():
            raise BadInput(
                f"there is no {needed.name} in {needed.parent}; VideoPose3D's two files belong"
                " together"
            )
    takes = _takes(
        read_object(file, "positions_3d"), read_object(beside, "positions_2d"), file, beside
    )
    by_action: dict[str, list[_Take]] = {}
    for take in takes:
        by_action.setdefault(take.action.split(" ")[0], []).append(take)
    numbers = [None] * len(by_action) if frames is None else shares(frames, len(by_action))
    parts = [
        part
        for action, number in zip(sorted(by_action), numbers, strict=True)
        for part in _thinned(by_action[action], number)
    ]
    return _data_set(parts, file)


def _takes(three: Any, two: Any, file: Path, beside: Path) -> list[_Take]:
    if not (_is_tree(three) and _is_tree(two)):
        raise BadInput(
            f"{file} or {beside.name} is no dictionary of subjects and actions, as VideoPose3D"
            " writes it"
        )
    takes = []
    for subject in sorted(three, key=lambda name: (len(name), name)):
        for action in sorted(three[subject]):
            poses = three[subject][action]
            if not _is_array(poses, (32, 3)):
                raise BadInput(
                    f"{file}: {subject} {action} has {_form(poses)}, Human3.6M has (T, 32, 3)"
                )
            cameras = two.get(subject, {}).get(action)
            if not isinstance(cameras, list) or not cameras:
                raise BadInput(
                    f"{beside} lacks {subject} {action}, which {file.name} has; the two must go"
                    " together"
                )
            for number, points in enumerate(cameras):
                if not _is_array(points, (H36M_17.count, 2)):
                    raise BadInput(
                        f"{beside}: {subject} {action} has {_form(points)}, which must be (T, 17,"
                        " 2)"
                    )
                # Videos run on for some frames after the motion capture ends.
                length = min(len(poses), len(points))
                if length:
                    takes.append(_Take(subject, action, number, poses[:length], points[:length]))
    if not takes:
        raise BadInput(f"{file} and {beside.name} hold no frame; give VideoPose3D's own files")
    return takes


def _is_array(value: Any, row: tuple[int, ...]) -> bool:
    """Whether it is an array `(T, *row)` of numbers."""
    return isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.shape[1:] == row


def _form(value: Any) -> str:
    return f"shape {shown(value.shape)}" if isinstance(value, np.ndarray) else shown(value)


def _is_tree(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and bool(value)
        and all(isinstance(actions, dict) for actions in value.values())
    )


def _thinned(takes: list[_Take], number: int | None) -> list[_Take]:
    """`number` of the frames of takes, evenly."""
    if number is None:
        return takes
    edges = np.cumsum([0, *(len(take.poses) for take in takes)])
    rows = evenly(edges[-1], number)
    own = [rows[(rows >= low) & (rows < high)] - low for low, high in itertools.pairwise(edges)]
    return [
        take._replace(poses=take.poses[some], keypoints=take.keypoints[some])
        for take, some in zip(takes, own, strict=True)
    ]


def _possible(keypoints: np.ndarray) -> bool:
    """Whether all pixels that are given can be some."""
    return bool((np.isnan(keypoints) | (np.abs(keypoints) <= LARGEST_NUMBER)).all())


def _data_set(takes: list[_Take], file: Path) -> DataSet:
    joints = [H36M_17.points.index(name) for name in JOINTS]
    poses = np.concatenate(
        [1000 * take.poses[:, SEVENTEEN][:, joints].astype(np.float64) for take in takes]
    )
    keypoints = np.concatenate([take.keypoints[:, joints].astype(np.float64) for take in takes])
    if not ((np.abs(poses) <= LARGEST_NUMBER).all() and _possible(keypoints)):
        raise BadInput(
            f"{file} or its 2D joints hold a coordinate that is not finite, or beyond"
            f" ±{LARGEST_NUMBER:g}; leave that action out"
        )
    rotation, scale, translation = resection(poses, keypoints)
    poses = (poses - poses[:, :1]) @ np.swapaxes(rotation, -1, -2)

    def labels(text: list[str]) -> np.ndarray:
        return np.repeat(text, [len(take.poses) for take in takes])

    return DataSet(
        name=file.name,
        poses=poses,
        keypoints=keypoints,
        score=np.ones(keypoints.shape[:2]),
        scale=scale,
        translation=translation,
        action=labels([take.action.split(" ")[0] for take in takes]),
        subject=labels([take.subject for take in takes]),
        recording=labels([f"{take.subject} {take.action}" for take in takes]),
        midpoints=H36M_17.midpoints,
    )
