"""Directions of a pose, and the axes of its trunk, in which angles of shoulders and hips are
counted.

Axes are those of the International Society of Biomechanics: forward (X), up (Y), to the right (Z),
right-handed. A left limb is looked at in a mirror, as Wu et al. (2005) ask for: its third axis
points to the left, so that one formula does for both sides. The camera's own vertical is the only
one that is known: where it looks down by ten degrees, so does every vertical here."""

import numpy as np

from poseterior.probmodel.skeleton import JOINT_INDEX

UPWARD = np.array([0.0, -1.0, 0.0])
"""In camera axes, where y points down."""
SIDES = ("right", "left")


def place(joints: np.ndarray, name: str) -> np.ndarray:
    """`(..., 3)`: where a joint is."""
    return joints[..., JOINT_INDEX[name], :]


def between(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    """`(..., 3)`: the vector from one joint to another."""
    return place(joints, end) - place(joints, start)


def unit_vector(vector: np.ndarray) -> np.ndarray:
    """Vectors `(..., 3)` over their lengths; NaN where there is none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def across(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """`(..., 3)`: what of vectors is perpendicular to a unit axis."""
    return vector - np.sum(vector * axis, axis=-1, keepdims=True) * axis


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """`(...)`: degrees from 0 to 180 between two vectors `(..., 3)`; NaN where one has no length.

    By the half angle (Kahan 2006), which loses no digits near 0 and 180."""
    one = unit_vector(first)
    other = unit_vector(second)
    apart = np.linalg.norm(one - other, axis=-1)
    together = np.linalg.norm(one + other, axis=-1)
    return 2 * np.degrees(np.arctan2(apart, together))


def components(vector: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """`(..., 3)`: a vector's forward, upward and lateral part; axes are rows `(..., 3, 3)`."""
    return np.einsum("...ij,...j->...i", axes, vector)


def thorax_axes(joints: np.ndarray, side: str) -> np.ndarray:
    """`(..., 3, 3)`: forward, up along the back, and to the `side` along the shoulders.

    The back from pelvis to thorax stands for the line of Wu et al. (2005) from between xiphoid
    process and T8 to between incisura jugularis and C7."""
    up = unit_vector(between(joints, "pelvis", "thorax"))
    right = unit_vector(across(between(joints, "left_shoulder", "right_shoulder"), up))
    return _axes(np.cross(up, right), up, right, side)


def pelvis_axes(joints: np.ndarray, side: str) -> np.ndarray:
    """`(..., 3, 3)`: forward, up, and to the `side` along the hips.

    The line of the hips stands for that of the anterior superior iliac spines (Wu et al. 2002), the
    back, from pelvis to thorax, for the pelvis' own height, which fifteen joints do not tell."""
    right = unit_vector(between(joints, "left_hip", "right_hip"))
    up = unit_vector(across(between(joints, "pelvis", "thorax"), right))
    return _axes(np.cross(up, right), up, right, side)


def standing_axes(joints: np.ndarray, side: str = "right") -> np.ndarray:
    """`(..., 3, 3)`: forward on the level, vertically up, and on the level to the `side` along the
    hips."""
    right = unit_vector(across(between(joints, "left_hip", "right_hip"), UPWARD))
    up = np.broadcast_to(UPWARD, right.shape)
    return _axes(np.cross(up, right), up, right, side)


def _axes(forward: np.ndarray, up: np.ndarray, right: np.ndarray, side: str) -> np.ndarray:
    lateral = right if side == "right" else -right
    return np.stack([forward, up, lateral], axis=-2)
