"""Pairs of detections and truth, in body units in the plane of the image: what a law is learned
from."""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from poseterior.probmodel.body import body_unit
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.datasets.sessions import JudgedView, judged_views
from poseterior.probmodel.errors.detector import Exchange
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, ORDERS
from poseterior.probmodel.layouts import MIDPOINTS
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.sessions.session import HIPS
from poseterior.probmodel.skeleton import JOINT_INDEX

PATTERNS = [ORDERS[EXCHANGE_INDEX[name]] for name in ("none", *Exchange._fields)]
"""Which joint each detection is of: as it says, and with sides exchanged."""

FAR = 1e3
"""Body units: an error against a joint of the other side that nobody knows."""
MIDWAY = 1e-3
"""Body units within which a joint counts as a midpoint: a lens' distortion moves them by less."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Detections of `n` people beside the truth; lengths in body units, x right, y down.

    Attributes
    ----------
    name : of the data.
    detected : `(n, 15, 2)`, NaN where missing.
    truth : `(n, 15, 2)` where the joints truly are, NaN where nobody knows.
    doubt : `(n, 15, 2, 2)` covariance of the truth, for detections whose errors have a variance of
        one each way; zero where the truth is exact, or not known.
    score : `(n, 15)`.
    recording : `(n,)`; what is of one recording is alike.
    placed : whether the truth's place in the image is known. Where it is not (cameras whose
        calibration errs, too), what all joints of a person have in common says nothing of the
        detector, as a posterior knows no more of where the camera points.
    """

    name: str
    detected: np.ndarray
    truth: np.ndarray
    doubt: np.ndarray
    score: np.ndarray
    recording: np.ndarray
    placed: bool

    def __len__(self) -> int:
        return len(self.detected)

    @cached_property
    def errors(self) -> np.ndarray:
        """`(4, n, 15, 2)` under each of `PATTERNS`, 0 where missing."""
        errors = np.stack([self.detected - self.truth[:, joints] for joints in PATTERNS])
        return np.where(self.seen[..., None], np.nan_to_num(errors, nan=FAR), 0.0)

    @cached_property
    def seen(self) -> np.ndarray:
        """`(n, 15)`: which joints were detected and are known."""
        return np.isfinite(self.detected).all(axis=-1) & np.isfinite(self.truth).all(axis=-1)

    @cached_property
    def anchors(self) -> np.ndarray:
        """`(n, 15)`: the joints that say where a person is: those seen, but for midpoints of other
        joints, which would say it twice."""
        anchors = self.seen.copy()
        for name, ends in MIDPOINTS.items():
            middle, right, left = (JOINT_INDEX[joint] for joint in (name, *ends))
            between = (self.detected[:, right] + self.detected[:, left]) / 2
            with np.errstate(invalid="ignore"):
                apart = np.linalg.norm(self.detected[:, middle] - between, axis=-1)
            anchors[:, middle] &= ~(apart < MIDWAY)
        return anchors

    @cached_property
    def doubts(self) -> np.ndarray:
        """`(4, n, 15, 2, 2)`: `doubt` under each of `PATTERNS`."""
        return np.stack([self.doubt[:, joints] for joints in PATTERNS])

    def take(self, rows: np.ndarray) -> "Pairs":
        """Some of the people."""
        columns = ("detected", "truth", "doubt", "score", "recording")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    @cached_property
    def sha256(self) -> str:
        """Hash of the contents."""
        digest = hashlib.sha256()
        for array in (self.detected, self.truth, self.doubt, self.score):
            digest.update(np.ascontiguousarray(array, "<f8").tobytes())
        digest.update("\n".join(self.recording.tolist()).encode())
        return digest.hexdigest()


def size_of(data: DataSet) -> np.ndarray:
    """`(N,)` pixels a body unit, each person as large as in that pose."""
    return data.scale * np.array([body_unit(pose[None]) for pose in data.poses])


def pairs_of_data(data: DataSet, offsets: np.ndarray | None = None) -> Pairs:
    """The pairs of a data set whose truth is exact, each person as large as in that pose; `offsets`
    `(N, 15, 2)` are how far from the truth, body units in the image, the detector's points lie."""
    size = size_of(data)[:, None, None]
    exact = (data.scale[:, None, None] * data.poses[..., :2] + data.translation[:, None]) / size
    exact = exact if offsets is None else exact + offsets
    doubt = np.zeros((*data.score.shape, 2, 2))
    return Pairs(
        data.name, data.keypoints / size, exact, doubt, data.score, data.recording, placed=True
    )


def pairs_of_session(session: Session, *, perspective: bool = False) -> Pairs:
    """The pairs of a session: every camera beside what the other cameras triangulate.

    Parameters
    ----------
    session
        Of three cameras at least.
    perspective
        Whether the truth is seen through the calibrated camera. Otherwise it falls along the line
        of sight to the hips, and what perspective adds to that belongs to the law: so a posterior
        needs it that does not know the focal length, and whose depth is along that line.

    Raises
    ------
    BadInput
        As `judged_views`.
    """
    parts = [_of_view(session, view, perspective) for view in judged_views(session)]
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    detected, truth, doubt, score, recording = columns
    return Pairs(session.name, detected, truth, doubt, score, recording, placed=False)


def _of_view(session: Session, view: JudgedView, perspective: bool) -> tuple[np.ndarray, ...]:
    """Detections, truths, doubts, scores and recordings of one camera."""
    rows = view.rows
    scale = session.scale[view.camera][rows]
    slope = session.straight[view.camera].slope(view.world.points) / scale[:, None, None, None]
    doubt = slope @ view.world.covariance @ np.swapaxes(slope, -1, -2)
    size = session.unit * scale[:, None, None]
    truth = view.seen / size
    if not perspective:
        hips = session.straight[view.camera].project(view.world.points[:, HIPS].mean(axis=1))
        flat = session.along_sight(view.camera, view.world.points)[..., :2]
        truth = flat / session.unit + hips[:, None] / size
    label = session.labels[view.camera]
    return (
        session.keypoints[view.camera][rows] / size,
        truth,
        np.nan_to_num(doubt),
        session.score[view.camera][rows],
        np.full(len(rows), f"{session.name} {label}"),
    )
