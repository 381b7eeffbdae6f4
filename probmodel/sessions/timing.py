"""Whether cameras are in step. What a camera sees too late differs from what the others triangulate
along the way that joints go, by the more the quicker they go."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.sessions.pinhole import Pinhole
from poseterior.probmodel.sessions.session import Session, seen_without

FEWEST_CAMERAS, SHORTEST_SESSION = 3, 30
"""With which anything is said."""
HANG_TOGETHER = 15
"""Frames whose errors hang together."""
MOST_ROUNDS = 12
"""In which cameras are put into step, and asked again."""
OUT_OF_STEP = 5.0
"""Standard errors from which a camera is out of step."""
ANOTHERS = 0.1
"""Of the largest lag: what it may leave of itself in the other cameras'."""
NORMAL = 1.4826
"""Standard deviations of a normal law in its median absolute value."""
_FAR = 3.0
"""Standard deviations from which a residual counts less."""


class Lags(NamedTuple):
    """By how many `frames` `(C,)` cameras are behind their median, negative where one is ahead, and
    the standard `error` of each."""

    frames: np.ndarray
    error: np.ndarray

    @property
    def sure(self) -> np.ndarray:
        """`(C,)`: whether a camera is out of step beyond doubt: by half a frame at least, and not
        for another's sake, which is far more so."""
        size = np.abs(self.frames)
        return (size > OUT_OF_STEP * self.error) & (size > max(0.5, ANOTHERS * size.max()))

    def said(self, labels: Sequence[str], used: Collection[str] | None = None) -> list[str]:
        """A sentence for each camera that is out of step, of those that are `used`: all, if none
        are named."""
        return [
            f"{labels[row]} is {abs(self.frames[row]):.1f} frames"
            f" {'behind' if self.frames[row] > 0 else 'ahead of'} the other cameras"
            f" (± {2 * self.error[row]:.1f}): its detections are of another moment; put them into"
            " step, or leave that camera out"
            for row in map(int, np.flatnonzero(self.sure))
            if used is None or labels[row] in used
        ]


def lags_of(session: Session) -> Lags | None:
    """By how much cameras lag; None where too few say too little.

    Residuals of each camera from what the others triangulate are regressed on how joints move in
    its image (least squares; what stays the same is left out, and what is far off counts less),
    with errors over stretches of frames. Where one is out of step, the worst is put into step, and
    all are asked anew.
    """
    number, total = len(session.cameras), len(session)
    if number < FEWEST_CAMERAS or total < SHORTEST_SESSION:
        return None
    times = np.array(session.numbers, float)
    lag = np.zeros(number)
    for _ in range(MOST_ROUNDS):
        views = [_at(times, view, own) for view, own in zip(session.keypoints, lag, strict=True)]
        keypoints = np.stack(views)
        score = np.where(np.isfinite(keypoints).all(axis=-1), session.score, 0.0)
        behind, error = _behind(session.straight, times, keypoints, score)
        if not (np.abs(behind) > OUT_OF_STEP * error).any():
            break
        # One at a time: what one leaves of itself in the others goes with it.
        worst = np.argmax(np.abs(behind))
        lag[worst] += behind[worst]
    found = lag + behind
    return Lags(found - np.median(found), error)


def _at(times: np.ndarray, view: np.ndarray, lag: float) -> np.ndarray:
    """Keypoints `(F, 15, 2)` as they are `lag` later, NaN beyond the ends and beside gaps."""
    if not lag:
        return view
    flat = view.reshape(len(times), -1).T
    later = [np.interp(times + lag, times, one, np.nan, np.nan) for one in flat]
    return np.stack(later, axis=-1).reshape(view.shape)


def _behind(
    cameras: tuple[Pinhole, ...], times: np.ndarray, keypoints: np.ndarray, score: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """By how many frames cameras are behind all others, and standard errors `(C,)`."""
    found = []
    for number, camera in enumerate(cameras):
        image = camera.project(seen_without(number, cameras, keypoints, score).points)
        found.append(_slope(keypoints[number] - image, np.gradient(image, times, axis=0)))
    slope, error = np.transpose(found)
    return -slope, error


def _slope(off: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
    """Of residuals `(F, 15, 2)` along the way that joints go, and its standard error, which is
    infinite where nothing moves."""
    with np.errstate(all="ignore"):
        off = off - np.nanmedian(off, axis=0)
        spread = NORMAL * np.nanmedian(np.abs(off), axis=(0, 2))[:, None]
    weight = 1 / (spread**2 + off**2 / _FAR**2)
    known = np.isfinite(weight) & np.isfinite(speed)
    weight, off, speed = (np.where(known, part, 0.0) for part in (weight, off, speed))
    product = (weight * off * speed).sum(axis=(1, 2))
    square = (weight * speed**2).sum(axis=(1, 2))
    if not square.any():
        return 0.0, np.inf
    slope = product.sum() / square.sum()
    left = product - slope * square
    stretches = np.add.reduceat(left, np.arange(0, len(left), HANG_TOGETHER))
    return slope, np.sqrt(np.sum(stretches**2)) / square.sum()
