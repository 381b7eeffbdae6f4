"""Poses of a film in parts that go on from frame to frame, and put together again.

How the torso is turned, and the directions of bones in the axes of shoulders and hips, by which
joint limits are told: put on another torso, or with other lengths, a limb stays as possible as it
was."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.roots import nearest_rotation
from poseterior.probmodel.skeleton import (
    BONES,
    LOWER_BONES,
    NUM_JOINTS,
    PARENTS,
    TORSO_INDEX,
    UPPER_BONES,
)

_UPPER_OF = [*range(len(UPPER_BONES))] + [
    next(at for at, upper in enumerate(UPPER_BONES) if upper.end == PARENTS[bone.end])
    for bone in LOWER_BONES
]
"""For each bone the upper bone of its limb."""
LIMB_BONES = tuple(
    tuple(bone for bone, upper in enumerate(_UPPER_OF) if upper == limb)
    for limb in range(len(UPPER_BONES))
)
"""The rows in `BONES` of the bones of each limb, and of the head, from the torso outwards."""


class Parts(NamedTuple):
    """What moves.

    Attributes
    ----------
    turn : `(..., 3, 3)`
        From body axes to the camera's.
    direction : `(..., 9, 3)`
        Of `BONES`, parent minus child, in the axes of their upper bone (`kinematics.upper_axes`).
    place : `(..., 3)`
        Of the pelvis before the camera, body units; NaN where it is not known.
    """

    turn: np.ndarray
    direction: np.ndarray
    place: np.ndarray

    def over_time(self, function: Callable[[np.ndarray], np.ndarray]) -> "Parts":
        """A linear function of each, along the first axis; directions and rotations made such
        again."""
        turn, direction, place = map(function, self)
        return Parts(nearest_rotation(turn), _units(direction), place)


class PathBodies(NamedTuple):
    """What does not: torsos `(n, 6, 3)` in body axes, the pelvis at the origin, and lengths
    `(n, 5)` of `LENGTH_GROUPS`, body units."""

    torso: np.ndarray
    length: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        """`(n, 9, 3, 3)`: of each bone's upper bone, in body axes."""
        return np.asarray(_upper_axes(self.torso))[:, _UPPER_OF]

    @property
    def bone_length(self) -> np.ndarray:
        """`(n, 9)`."""
        return self.length[:, [bone.length_group for bone in BONES]]


_upper_axes = jax.jit(upper_axes)


def taken_apart(
    joints: np.ndarray, length: np.ndarray, like: np.ndarray
) -> tuple[Parts, PathBodies]:
    """The parts of poses.

    Parameters
    ----------
    joints : `(n, 15, 3)`
        In the camera's axes, the pelvis at the origin, body units.
    length : `(n, 5)`
        Of `LENGTH_GROUPS`.
    like : `(6, 3)`
        A torso in body axes; others lie in theirs as they lie nearest to it.

    Returns
    -------
    Parts
        Without places.
    PathBodies
        The poses' own.
    """
    torso = joints[:, list(TORSO_INDEX)]
    turn = np.swapaxes(align_torsos(torso, like), 1, 2)
    bones = np.stack([joints[:, bone.start] - joints[:, bone.end] for bone in BONES], axis=1)
    body = PathBodies(torso @ turn, length)
    direction = np.einsum("nbij,nki,nbk->nbj", body.axes, turn, bones)
    return Parts(turn, _units(direction), np.full((len(joints), 3), np.nan)), body


def put_together(parts: Parts, body: PathBodies) -> np.ndarray:
    """The joints `(..., n, 15, 3)` of parts `(..., n)` on so many bodies, in the camera's axes, the
    pelvis at the origin."""
    bones = np.einsum("nbij,...nbj->...nbi", body.axes, parts.direction)
    bones *= body.bone_length[..., None]
    joints = np.zeros((*bones.shape[:-2], NUM_JOINTS, 3))
    joints[..., list(TORSO_INDEX), :] = body.torso
    for row, bone in enumerate(BONES):
        joints[..., bone.end, :] = joints[..., bone.start, :] - bones[..., row, :]
    return np.einsum("...ij,...bj->...bi", parts.turn, joints)


def _units(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
