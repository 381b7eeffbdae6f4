"""A session of calibrated cameras as a data set: each camera's detection of each frame, whose truth
the other cameras triangulate.

Poses are in the axes of the weak-perspective camera that explains the truth's projections best, as
for Human3.6M; what it leaves unexplained is perspective. Keypoints are without the lens'
distortion. A camera's film is a recording."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from probmodel.datasets.cases import DataSet
from probmodel.datasets.views import resection
from probmodel.failures import BadInput
from probmodel.sessions import Session, Triangulated

FEWEST_CAMERAS = 3
"""So that two are left to see depth where one is judged."""


class JudgedView(NamedTuple):
    """One camera, and what the others say.

    Attributes
    ----------
    camera : its number.
    rows : `(n,)` the frames in which the others see all joints.
    world : their joints `(n, 15, 3)`, with covariance.
    seen : `(n, 15, 2)` straightened pixels where the camera would see these joints.
    """

    camera: int
    rows: np.ndarray
    world: Triangulated
    seen: np.ndarray


def judged_views(session: Session) -> Iterator[JudgedView]:
    """Every camera of a session with the others' truth. Raises `BadInput` where they are too few,
    or do not see the whole person."""
    if len(session.cameras) < FEWEST_CAMERAS:
        raise BadInput(
            f"{session.name} has {len(session.cameras)} cameras; to judge one of them by the"
            f" others needs {FEWEST_CAMERAS}"
        )
    for number, camera in enumerate(session.straight):
        world = session.world(without=number)
        rows = np.flatnonzero(np.isfinite(world.points).all(axis=(1, 2)))
        if not len(rows):
            raise BadInput(
                f"without {session.labels[number]} no frame of {session.name} shows every joint to"
                " two cameras; give a session with more cameras, or more of the person"
            )
        points = world.points[rows]
        some = Triangulated(points, world.covariance[rows], world.weight[:, rows])
        yield JudgedView(number, rows, some, camera.project(points))


def from_session(session: Session) -> DataSet:
    """The cases of a session, camera by camera. Raises `BadInput` as `judged_views`."""
    parts = [_of_view(session, view) for view in judged_views(session)]
    poses, keypoints, score, scale, translation, recording = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    who = np.full(len(poses), session.name)
    return DataSet(session.name, poses, keypoints, score, scale, translation, who, who, recording)


def _of_view(session: Session, view: JudgedView) -> tuple[np.ndarray, ...]:
    """Poses, keypoints, scores, scales, translations and recordings of a camera's cases."""
    points = view.world.points - view.world.points[:, :1]
    rotation, scale, translation = resection(points, view.seen)
    recording = np.full(len(points), f"{session.name} {session.labels[view.camera]}")
    return (
        points @ np.swapaxes(rotation, -1, -2),
        session.keypoints[view.camera][view.rows],
        session.score[view.camera][view.rows],
        scale,
        translation,
        recording,
    )
