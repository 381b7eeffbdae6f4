"""Errors of 3D poses: mean joint error after limb scaling and similarity alignment, of one pose or the best of many.

As in the paper: bones get the true lengths, then the pose is moved, turned and scaled onto the true one. Errors are in
the units of the true poses. Plain arrays throughout.
"""

import numpy as np
from numpy.typing import ArrayLike

from probmodel.dictionaries import bone_vectors, with_lengths


def similarity_aligned(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Poses `(..., J, 3)` moved, turned and scaled (not reflected) onto `truth` `(..., J, 3)` by least squares.

    Source: Umeyama (1991). Raises `ValueError` where shapes do not fit.
    """
    joints, truth = np.asarray(joints, float), np.asarray(truth, float)
    if joints.shape[-2:] != truth.shape[-2:] or joints.shape[-1:] != (3,):
        raise ValueError(f"poses of shapes {joints.shape} and {truth.shape} cannot be compared")
    middle, aim = joints.mean(axis=-2, keepdims=True), truth.mean(axis=-2, keepdims=True)
    moved = joints - middle
    u, size, vt = np.linalg.svd(np.swapaxes(truth - aim, -1, -2) @ moved)
    sign = np.ones(size.shape)
    sign[..., -1] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * sign[..., None, :]) @ vt
    square = np.sum(moved**2, axis=(-1, -2))
    scale = np.sum(size * sign, axis=-1) / np.where(square > 0, square, 1.0)
    return scale[..., None, None] * moved @ np.swapaxes(rotation, -1, -2) + aim


def limb_scaled(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Poses `(..., 15, 3)` whose bones keep their directions and have the lengths of those of `truth`.

    Raises `BadInput` where a bone of `joints` has length zero.
    """
    lengths = np.linalg.norm(bone_vectors(np.asarray(truth, float)), axis=-1)
    return with_lengths(np.asarray(joints, float), lengths)


def joint_errors(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Distances `(..., 15)` of joints from the true ones, after limb scaling, then similarity alignment."""
    return np.linalg.norm(similarity_aligned(limb_scaled(joints, truth), truth) - np.asarray(truth), axis=-1)


def mean_joint_error(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """`(...)`: the mean over joints of `joint_errors`."""
    return joint_errors(joints, truth).mean(axis=-1)


def best_of(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """`(...)`: the least `mean_joint_error` among hypotheses `(..., k, 15, 3)` of poses `truth` `(..., 15, 3)`."""
    return mean_joint_error(joints, np.asarray(truth)[..., None, :, :]).min(axis=-1)
