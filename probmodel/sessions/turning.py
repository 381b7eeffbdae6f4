"""Whether a camera points elsewhere than its calibration says. If it does, all that it sees is
shifted alike, whatever the joint; cameras that face each other are told apart as the person comes
nearer to one of them."""

import warnings
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.sessions.session import Session
from poseterior.probmodel.sessions.timing import (
    FEWEST_CAMERAS,
    HANG_TOGETHER,
    NORMAL,
    SHORTEST_SESSION,
    lags_of,
)
from poseterior.probmodel.skeleton import NUM_JOINTS

AS_CALIBRATED, TURNED_BY = 0.25, 2.0
"""Degrees about each axis, standard deviations, by which a camera points beside its calibration,
and by which it does if it is turned."""
TURNED_SELDOM = 0.02
"""How probable it is of each camera, before anything was seen."""
BEYOND_DOUBT = 0.75
"""How probable it has to be that a camera is turned before it is named."""
OTHERWISE_WRONG = 4.0
"""Degrees: folders whose cameras are exchanged look like more."""
NO_ERROR = 1e-6
"""Radians: errors that are smaller are none."""
_FAR = 3.0
"""Standard deviations from which a residual counts less."""


class Turns(NamedTuple):
    """Of each camera `(C,)`: the `probability` that it alone is turned; and by how many `degrees`
    it is if so, with their standard `error`."""

    probability: np.ndarray
    degrees: np.ndarray
    error: np.ndarray

    @property
    def sure(self) -> np.ndarray:
        """`(C,)`: whether a camera is held to be turned; one at most, and none that would be turned
        by so much that something else is wrong."""
        return (self.probability > BEYOND_DOUBT) & (self.degrees < OTHERWISE_WRONG)

    def said(self, labels: Sequence[str], used: Collection[str] | None = None) -> list[str]:
        """A sentence for the camera that is turned, if one is, and is `used`: all are, if none are
        named."""
        return [
            f"{labels[row]} is turned by {self.degrees[row]:.1f} degrees"
            f" (± {2 * self.error[row]:.1f}) against its calibration, with probability"
            f" {self.probability[row]:.2f}: calibrate it anew, or leave that camera out"
            for row in map(int, np.flatnonzero(self.sure))
            if used is None or labels[row] in used
        ]


def turns_of(session: Session) -> Turns | None:
    """Which camera is turned; None where too few say too little.

    Each camera points by a Gaussian of `AS_CALIBRATED` beside its calibration, or one of them by
    one of `TURNED_BY`; each joint's detections err in each camera by the same for the whole
    session, and by what is new about every `HANG_TOGETHER` frames. Joints of the world are free, so
    that what they may explain is taken out. All this is linear in small turns, and Gaussian.

    Parameters
    ----------
    session
        Whose cameras are in step (`timing.lags_of`): a late camera may look like one that is
        turned.

    Returns
    -------
    Turns or None
        None with fewer than `FEWEST_CAMERAS` cameras or `SHORTEST_SESSION` frames.
    """
    number = len(session.cameras)
    if number < FEWEST_CAMERAS or len(session) < SHORTEST_SESSION:
        return None
    precision, pull = _information(session)
    usual, turned = np.radians([AS_CALIBRATED, TURNED_BY])
    # Row 0: that none is turned; then, that each is.
    spread = np.where(np.eye(1 + number, dtype=bool)[:, 1:], turned, usual)
    before = np.repeat(spread, 3, axis=1) ** -2.0
    covariance = np.linalg.inv(precision + before[:, :, None] * np.eye(3 * number))
    mean = covariance @ pull
    level = mean @ pull + np.linalg.slogdet(covariance)[1] + np.log(before).sum(axis=1)
    share = np.full(1 + number, TURNED_SELDOM)
    share[0] = 1 - number * TURNED_SELDOM
    share *= np.exp((level - level.max()) / 2)
    rows = np.arange(number)
    own = mean[1:].reshape(number, number, 3)[rows, rows]
    doubt = covariance[1:].reshape(number, number, 3, number, 3)[rows, rows, :, rows]
    size = np.linalg.norm(own, axis=1)
    error = np.sqrt(np.einsum("ca,cab,cb->c", own, doubt, own)) / size
    return Turns(share[1:] / share.sum(), np.degrees(size), np.degrees(error))


def said_of(session: Session, used: Collection[str] | None = None) -> list[str]:
    """What is wrong with a session's cameras, of those that are `used` (all, if none are named): a
    sentence for each that is out of step, or, where all are in step, for one that is turned."""
    lags = lags_of(session)
    if lags and lags.sure.any():
        return lags.said(session.labels, used)
    turns = turns_of(session)
    return turns.said(session.labels, used) if turns else []


def _information(session: Session) -> tuple[np.ndarray, np.ndarray]:
    """What residuals say of all cameras' turns: the precision `(3C, 3C)` and the mean times it, of
    a Gaussian; where joints are, and what their lasting errors may be, is summed out."""
    off, slope, turn = _linear(session)
    number, views = len(off), off.shape[2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # joints that a camera never saw
        usual = np.nanmedian(off, axis=0)
        common = np.nanmedian(usual, axis=0)
    sizes = [np.nanmedian(np.abs(part)) for part in (off - usual, usual - common)]
    # Of a joint's 2 C numbers its place takes three.
    freedom = 1 - 3 / (2 * views)
    quick, lasting = np.maximum(NORMAL * np.array(sizes), NO_ERROR) ** 2 / freedom
    far = np.sum((off - usual) ** 2, axis=-1) / quick
    trust = np.where(np.isfinite(far), 1 / np.sqrt(1 + far / _FAR**2), 0.0)
    weight = np.repeat(trust, 2, axis=-1)[..., None] / np.sqrt(quick * HANG_TOGETHER)
    turns, lasts = slice(0, 3 * views), slice(3 * views, 5 * views)
    precision, pull = np.zeros((3 * views, 3 * views)), np.zeros(3 * views)
    each = np.broadcast_to(np.eye(2 * views), (number, 2 * views, 2 * views))
    for joint in range(NUM_JOINTS):
        seen = off[:, joint].reshape(number, -1, 1)
        rows = np.concatenate([turn[:, joint], each, seen], axis=-1)
        place = slope[:, joint].reshape(number, -1, 3)
        rows, place = (np.nan_to_num(weight[:, joint] * part) for part in (rows, place))
        basis = np.linalg.qr(place)[0]
        rows -= basis @ (np.swapaxes(basis, 1, 2) @ rows)
        square = np.einsum("fai,faj->ij", rows, rows)
        square[lasts, lasts] += np.eye(2 * views) / lasting
        taken = square[turns, lasts] @ np.linalg.inv(square[lasts, lasts])
        precision += square[turns, turns] - taken @ square[lasts, turns]
        pull += square[turns, -1] - taken @ square[lasts, -1]
    return precision, pull


def _linear(session: Session) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where keypoints are beside the projected joints of all cameras, `(F, 15, C, 2)`, over the
    focal lengths, NaN where missing; and how these images move with the joints, `(..., 3)` a mm,
    and with rotation vectors of all cameras in their own axes, `(F, 15, 2C, 3C)`."""
    world, views = session.world.points, len(session.cameras)
    off, slope = [], []
    turn = np.zeros((*world.shape[:2], views, 2, views, 3))
    for number, camera in enumerate(session.straight):
        far = camera.view(world)
        x, y = np.moveaxis(far[..., :2] / far[..., 2:], -1, 0)
        off.append((session.keypoints[number] - camera.project(world)) / camera.focal[0])
        slope.append(camera.slope(world) / camera.focal[0])
        across = [[-x * y, 1 + x**2, -y], [-1 - y**2, x * y, x]]
        turn[:, :, number, :, number] = np.moveaxis(np.array(across), (0, 1), (2, 3))
    shape = *world.shape[:2], 2 * views, 3 * views
    return np.stack(off, axis=2), np.stack(slope, axis=2), turn.reshape(shape)
