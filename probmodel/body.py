"""Geometry of a whole body given as joints: bones, body units, mirror images, body axes.

Poses are `(..., 15, 3)` in the order of `skeleton.JOINTS`, torsos `(..., 6, 3)` in that of
`skeleton.TORSO_JOINTS`. One body unit is the mean length of the eight limb bones. Body axes: x to
the person's left, y up along the back, z forward, the pelvis at the origin (docs/model.md)."""

import numpy as np

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, JOINTS, LIMB_JOINTS, MIRROR, PARENTS, TORSO_INDEX

MILLIMETRES = 350.0
"""One body unit of a person of 1.7 m: upper arm, forearm, thigh and shank are 0.186, 0.146, 0.245
and 0.246 of the stature (Drillis & Contini, Body segment parameters, 1966), on average 0.206 ·
1700 mm."""
_MIRROR_TORSO = [TORSO_INDEX.index(MIRROR[joint]) for joint in TORSO_INDEX]
_SIDEWAYS = np.array([-1.0, 1.0, 1.0])


def bone_vectors(joints: np.ndarray) -> np.ndarray:
    """`(..., 14, 3)`: from each joint's parent to the joint, for all joints but the pelvis."""
    return joints[..., 1:, :] - joints[..., list(PARENTS[1:]), :]


def bone_lengths(joints: np.ndarray) -> np.ndarray:
    """`(..., 9)`: lengths of `skeleton.BONES`, in the unit of `joints`."""
    return np.linalg.norm(bone_vectors(joints), axis=-1)[..., [bone.end - 1 for bone in BONES]]


def body_unit(joints: np.ndarray) -> float:
    """Mean length of the eight limb bones (not the head) over poses `(..., 15, 3)` of one
    person."""
    lengths = np.linalg.norm(bone_vectors(joints), axis=-1)
    return float(lengths[..., [joint - 1 for joint in LIMB_JOINTS]].mean())


def with_lengths(joints: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Gives bones new lengths and leaves their directions and the pelvis as they are.

    Parameters
    ----------
    joints : `(..., 15, 3)`
    lengths : `(..., 14)`, one for each of `bone_vectors`

    Returns
    -------
    joints : `(..., 15, 3)`

    Raises
    ------
    BadInput
        Where a bone has length zero, and so no direction.
    """
    vectors = bone_vectors(joints)
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not (size > 0).all():
        bone = JOINTS[1 + int(np.argwhere(~(size > 0))[0][-2])]
        raise BadInput(
            f"a pose has its {bone} on the joint before it, so that this bone has no direction"
        )
    vectors = vectors / size * np.asarray(lengths)[..., None]
    found = joints.copy()
    for joint, parent in enumerate(PARENTS[1:], start=1):  # parents come before their children
        found[..., joint, :] = found[..., parent, :] + vectors[..., joint - 1, :]
    return found


def mirror_pose(joints: np.ndarray) -> np.ndarray:
    """The mirror image of poses `(..., 15, 3)`: x changes its sign, left and right their names."""
    return joints[..., list(MIRROR), :] * _SIDEWAYS


def mirror_torso(torsos: np.ndarray) -> np.ndarray:
    """The mirror image of torsos `(..., 6, 3)`."""
    return torsos[..., _MIRROR_TORSO, :] * _SIDEWAYS


def align_torsos(torsos: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Rotations about the pelvis that bring torsos nearest to another one, in the sense of least
    squares (Kabsch 1976).

    Parameters
    ----------
    torsos : `(N, 6, 3)`, pelvis at the origin
    target : `(6, 3)`, pelvis at the origin

    Returns
    -------
    rotations : `(N, 3, 3)`, proper
    """
    u, _, vt = np.linalg.svd(np.einsum("ta,ntb->nab", target, torsos))
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return u @ vt


def aligned(joints: np.ndarray, torso: np.ndarray) -> np.ndarray:
    """Poses `(N, 15, 3)` moved and turned so that their torsos lie on `torso` `(6, 3)`, the pelvis
    at the origin."""
    joints = joints - joints[:, :1]
    return _turned(joints, align_torsos(joints[:, list(TORSO_INDEX)], torso))


def mean_torso(torsos: np.ndarray) -> np.ndarray:
    """The mean `(6, 3)` of torsos `(N, 6, 3)`, in body axes, each turned onto it first."""
    torsos = torsos - torsos[:, :1]
    mean = _body_axes(torsos).mean(axis=0)
    for _ in range(5):
        turned = _turned(torsos, align_torsos(torsos, mean))
        mean = _body_axes(turned.mean(axis=0)[None])[0]
    return mean


def _turned(points: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    return np.einsum("nab,njb->nja", rotations, points)


def _body_axes(torsos: np.ndarray) -> np.ndarray:
    """Torsos `(N, 6, 3)`, pelvis at the origin, turned into body axes: y along the back, x towards
    left shoulder and hip."""
    up = torsos[:, 1] / np.linalg.norm(torsos[:, 1], axis=-1, keepdims=True)
    left = torsos[:, 3] - torsos[:, 2] + torsos[:, 5] - torsos[:, 4]
    left = left - np.sum(left * up, axis=-1, keepdims=True) * up
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    return _turned(torsos, np.stack([left, up, np.cross(left, up)], axis=1))
