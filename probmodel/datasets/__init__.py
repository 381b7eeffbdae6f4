"""Data sets of poses whose truth is known, each with a 2D detection: one reader whatever the file.

Motion capture (ASF/AMC, BVH, TRC, C3D, .npz of recordings) is seen by synthetic cameras, with true
or noisy 2D; Human3.6M comes with its own (VideoPose3D's two files), and so does a session of
calibrated cameras, each judged by the others; a plain .npz holds anything else.

    data = read_data_set("actions_train.npz", frames=2000, noise=Noise("gaussian", 0.02))
    case = data.case(7).hiding(2).turned(30)     # a pose, its detection without two joints, turned
"""

import os
from collections.abc import Mapping
from pathlib import Path

from poseterior.probmodel.datasets.capture import from_motions
from poseterior.probmodel.datasets.cases import Case, DataSet, body_height
from poseterior.probmodel.datasets.human36m import is_human36m, read_human36m
from poseterior.probmodel.datasets.noise import EXACT, Noise
from poseterior.probmodel.datasets.plain import is_plain, read_plain, write_plain
from poseterior.probmodel.datasets.sessions import from_session
from poseterior.probmodel.datasets.views import VIEWS, View
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.motion import KINDS, holds_motion, read_motion
from poseterior.probmodel.sessions import is_session, read_session

__all__ = [
    "EXACT",
    "VIEWS",
    "Case",
    "DataSet",
    "Noise",
    "View",
    "body_height",
    "brings_detections",
    "from_motions",
    "from_session",
    "read_data_set",
    "read_human36m",
    "write_plain",
]


def brings_detections(path: Path) -> bool:
    """Whether a data set has 2D joints of its own, so that no synthetic camera is needed."""
    return is_human36m(path) or is_session(path) or is_plain(path)


def read_data_set(
    path: str | os.PathLike,
    *,
    frames: int | None = None,
    noise: Noise = EXACT,
    seed: int = 0,
    detections: str = "gt",
    perspective: bool = False,
    names: Mapping[str, str] | None = None,
    layout: str | None = None,
) -> DataSet:
    """The data set at a path, whatever its kind.

    Parameters
    ----------
    path
        Motion capture, Human3.6M (the folder of VideoPose3D's files, or its 3D file), a session of
        calibrated cameras (Pose2Sim's folder), or a plain .npz.
    frames
        How many are taken, as many of each action as of any other. By default all; of motion
        capture each frame is then seen once, by the views in turn.
    noise, seed
        The error of synthetic detections, and its seed.
    detections
        Which of Human3.6M's 2D files: `data_2d_h36m_<detections>.npz`.
    perspective
        Whether the lenses of calibrated cameras are known, and poses in their axes.
    names
        Motion capture's names of joints → ours, as `read_motion` takes them.
    layout
        The order of the joints in a session's detections, as `read_session` takes it.

    Returns
    -------
    DataSet
        Its cases, in millimetres and camera axes.

    Raises
    ------
    BadInput
        Where it is no data set of this skeleton in millimetres, a frame is not finite or has no
        action, noise is asked for where the file has detections of its own, or perspective where
        there are no calibrated cameras.
    """
    path = Path(path)
    if frames is not None:
        require_some(frames, "frames")
    if perspective and not is_session(path):
        raise BadInput(
            f"perspective needs calibrated cameras, which {path} has not; leave it out, or give a"
            " folder in Pose2Sim's layout"
        )
    if layout is not None and not is_session(path):
        raise BadInput(f"{path} is no session of detections, which have a layout; leave it out")
    if not brings_detections(path):
        if path.is_dir() and not holds_motion(path):
            raise BadInput(
                f"{path} is no data set: it holds neither a file of motion capture ({KINDS}) nor"
                " the calibration of cameras (.qca.txt or .toml); give a folder with one of these"
            )
        motions = read_motion(path, names=names)
        return from_motions(motions, path.name, frames=frames, noise=noise, seed=seed)
    if names is not None:
        raise BadInput(f"{path} is no motion capture, whose joints have names; leave them out")
    if noise != EXACT:
        raise BadInput(
            f"{path} brings its own 2D joints, to which no noise is added; leave the noise out"
        )
    if is_human36m(path):
        return read_human36m(path, detections, frames)
    if is_session(path):
        data = from_session(read_session(path, layout=layout), perspective=perspective)
    else:
        data = read_plain(path)
    return data if frames is None else data.spread(frames)
