"""A film's poses as one body: bones of one length, and a torso that is rigid, in all frames.

Means of draws, and filtered poses, are of no body: their bones shrink. `Body.of` tells the body
from poses that are of one each, `Body.posed` puts it into others."""

from dataclasses import dataclass

import numpy as np

from poseterior.probmodel.skeleton import JOINT_INDEX, PARENTS, TORSO_INDEX

_RIGID = [joint for joint in TORSO_INDEX if joint != JOINT_INDEX["pelvis"]]
_FREE = [joint for joint in range(1, len(PARENTS)) if joint not in _RIGID]
_ROUNDS = 5
"""Of alignment of torsos to their mean."""


@dataclass(frozen=True, eq=False)
class Body:
    """A body without a pose.

    Attributes
    ----------
    torso
        `(5, 3)`: thorax, shoulders and hips about the pelvis.
    length
        `(15,)`: of the bones that end in the other joints; NaN for pelvis and torso.
    """

    torso: np.ndarray
    length: np.ndarray

    @staticmethod
    def of(poses: np.ndarray) -> "Body":
        """The body of poses `(n, 15, 3)` in their own units: bones of their median length, and the
        mean of their torsos, turned onto each other, grown to the median distances from the
        pelvis."""
        length = np.full(len(PARENTS), np.nan)
        parents = [PARENTS[joint] for joint in _FREE]
        bones = np.linalg.norm(poses[:, _FREE] - poses[:, parents], axis=-1)
        length[_FREE] = np.median(bones, axis=0)
        torsos = poses[:, _RIGID] - poses[:, :1]
        mean = torsos[0]
        for _ in range(_ROUNDS):
            mean = (torsos @ turns(torsos, mean)).mean(axis=0)
        reach = np.median(np.linalg.norm(torsos, axis=-1), axis=0)
        return Body(mean * (reach / np.linalg.norm(mean, axis=-1))[:, None], length)

    def grown(self, factor: float) -> "Body":
        """The same, so many times as large."""
        return Body(factor * self.torso, factor * self.length)

    def posed(self, poses: np.ndarray) -> np.ndarray:
        """`(n, 15, 3)`: the body with its pelvis where `poses` have theirs, its torso turned onto
        theirs, and its bones along theirs; NaN where these are."""
        body = np.full(poses.shape, np.nan)
        there = np.isfinite(poses).all(axis=(1, 2))
        given, found = poses[there], poses[there].copy()
        torsos = given[:, _RIGID] - given[:, :1]
        found[:, _RIGID] = given[:, :1] + self.torso @ turns(self.torso[None], torsos)
        for joint in _FREE:
            bone = given[:, joint] - given[:, PARENTS[joint]]
            size = np.linalg.norm(bone, axis=-1, keepdims=True)
            found[:, joint] = found[:, PARENTS[joint]] + self.length[joint] * bone / size
        body[there] = found
        return body


def turns(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """`(n, 3, 3)`: the rotations R for which points · R lie nearest to others, in least squares.

    Parameters
    ----------
    points, onto
        `(n, m, 3)`, or of which one is `(m, 3)`; about the point about which they are turned.
    """
    u, _, vt = np.linalg.svd(np.swapaxes(points, -1, -2) @ onto)
    proper = np.ones((len(u), 3))
    proper[:, 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return (u * proper[:, None, :]) @ vt
