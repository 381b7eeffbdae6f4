"""A session of calibrated cameras as a data set: each camera's detection of each frame, whose truth
the other cameras triangulate.

Poses are in the axes of the weak-perspective camera that explains the truth's projections best, as
for Human3.6M; what it leaves unexplained is perspective. Or they are in those of the calibrated
camera itself, whose lens is then known. Keypoints are without the lens' distortion. The truth errs
too, by as much as the detections of which it is made. A camera's film is a recording."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.datasets.cases import DataSet
from poseterior.probmodel.datasets.views import resection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.sessions import Session, Triangulated
from poseterior.probmodel.skeleton import JOINTS, TORSO_INDEX

FEWEST_CAMERAS = 3
"""So that two are left to see depth where one is judged."""


class JudgedView(NamedTuple):
    """One camera, and what the others say.

    Attributes
    ----------
    camera : its number.
    rows : `(n,)` the frames in which the others see the whole torso.
    world : their joints `(n, 15, 3)`, with covariance; NaN where fewer than two see one.
    seen : `(n, 15, 2)` straightened pixels where the camera would see these joints.
    rotation, scale, translation : `(n, …)` of the weak-perspective cameras that explain `seen` best
        by poses in mm with the pelvis at the origin.
    """

    camera: int
    rows: np.ndarray
    world: Triangulated
    seen: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    translation: np.ndarray

    @property
    def whole(self) -> np.ndarray:
        """`(n,)`: in which of the frames every joint is known."""
        return np.isfinite(self.world.points).all(axis=(1, 2))


def judged_views(session: Session) -> Iterator[JudgedView]:
    """Every camera of a session with the others' truth. Raises `BadInput` where they are too few,
    or do not see the whole person."""
    if len(session.cameras) < FEWEST_CAMERAS:
        raise BadInput(
            f"{session.name} has {len(session.cameras)} cameras; to judge one of them by the"
            f" others needs {FEWEST_CAMERAS}"
        )
    for number, camera in enumerate(session.straight):
        world = session.without(number)
        rows = np.flatnonzero(np.isfinite(world.points[:, TORSO_INDEX]).all(axis=(1, 2)))
        if not len(rows):
            raise BadInput(
                f"without {session.labels[number]} no frame of {session.name} shows the torso to"
                " two cameras; give a session with more cameras, or more of the person"
            )
        points = world.points[rows]
        some = Triangulated(points, world.covariance[rows], world.weight[:, rows])
        seen = camera.project(points)
        yield JudgedView(
            number, rows, some, seen, *resection(np.nan_to_num(points - points[:, :1]), seen)
        )


def from_session(session: Session, *, perspective: bool = False) -> DataSet:
    """The cases of a session whose truth is whole, camera by camera; with `perspective` their
    lenses are known. Raises `BadInput` as `judged_views`, and where no case is whole."""
    look = _in_perspective if perspective else _of_view
    parts = [look(session, view) for view in judged_views(session)]
    poses, keypoints, score, scale, translation, recording, doubt, *lens = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    if not len(poses):
        raise BadInput(
            f"{session.name} has no frame in which two cameras beside the judged one see every"
            f" joint; a data set needs {', '.join(JOINTS)}: detect with a layout that has them"
        )
    who = np.full(len(poses), session.name)
    return DataSet(
        name=session.name,
        poses=poses,
        keypoints=keypoints,
        score=score,
        scale=scale,
        translation=translation,
        action=who,
        subject=who,
        recording=recording,
        lens=Lens(*lens) if lens else None,
        midpoints=session.midpoints,
        doubt=doubt,
    )


def _of_view(session: Session, view: JudgedView) -> tuple[np.ndarray, ...]:
    """Poses, keypoints, scores, scales, translations, recordings and doubts of a camera's cases."""
    whole = view.whole
    keypoints, score, recording = _seen(session, view)
    points, axes = view.world.points[whole], view.rotation[whole]
    return (
        (points - points[:, :1]) @ np.swapaxes(axes, -1, -2),
        keypoints,
        score,
        view.scale[whole],
        view.translation[whole],
        recording,
        _doubt(session, view, axes),
    )


def _seen(session: Session, view: JudgedView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keypoints, scores and recordings of a camera's cases."""
    rows, label = view.rows[view.whole], f"{session.name} {session.labels[view.camera]}"
    keypoints, score = session.keypoints[view.camera], session.score[view.camera]
    return keypoints[rows], score[rows], np.full(len(rows), label)


def _doubt(session: Session, view: JudgedView, axes: np.ndarray) -> np.ndarray:
    """`(n, 15, 3, 3)` mm²: covariances of the errors of a view's truths, in some axes `(..., 3,
    3)`."""
    own = view.world.covariance[view.whole] * session.stray[:, None, None] ** 2
    return axes[..., None, :, :] @ own @ np.swapaxes(axes, -1, -2)[..., None, :, :]


def _in_perspective(session: Session, view: JudgedView) -> tuple[np.ndarray, ...]:
    """The same in the calibrated camera's axes, focal lengths and principal points besides."""
    keypoints, score, recording = _seen(session, view)
    camera, number = session.straight[view.camera], len(recording)
    placed, focal = camera.view(view.world.points[view.whole]), float(camera.focal[0])
    pelvis = placed[:, :1]
    return (
        placed - pelvis,
        keypoints,
        score,
        focal / pelvis[:, 0, 2],
        camera.principal + focal * pelvis[:, 0, :2] / pelvis[:, 0, 2:],
        recording,
        _doubt(session, view, camera.rotation),
        np.full(number, focal),
        np.tile(camera.principal, (number, 1)),
    )
