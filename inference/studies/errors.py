"""Errors of 3D poses: distances of joints from the true ones after similarity alignment, with or
without limb scaling.

As in the paper: bones get the true lengths (`limb_scaled`), then the pose is moved, turned and
scaled onto the true one (`similarity_aligned`). Errors are in the units of the true poses. Plain
arrays throughout; a joint that is missing is NaN, does not count in the alignment, and has the
error NaN."""

import numpy as np
from numpy.typing import ArrayLike

from poseterior.probmodel.body import bone_vectors, with_lengths
from poseterior.probmodel.skeleton import PARENTS


def similarity_aligned(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Poses `(..., J, 3)` moved, turned and scaled (not reflected) onto `truth` `(..., J, 3)` by
    least squares.

    Source: Umeyama (1991). Raises `ValueError` where shapes do not fit.
    """
    joints = np.asarray(joints, float)
    truth = np.asarray(truth, float)
    if joints.shape[-2:] != truth.shape[-2:] or joints.shape[-1:] != (3,):
        raise ValueError(f"poses of shapes {joints.shape} and {truth.shape} cannot be compared")
    seen = np.isfinite(joints).all(axis=-1, keepdims=True) & np.isfinite(truth).all(
        axis=-1, keepdims=True
    )
    number = np.maximum(seen.sum(axis=-2, keepdims=True), 1)
    middle, aim = (
        np.sum(np.where(seen, poses, 0.0), axis=-2, keepdims=True) / number
        for poses in (joints, truth)
    )
    moved, wanted = (
        np.where(seen, poses - place, 0.0) for poses, place in ((joints, middle), (truth, aim))
    )
    u, size, vt = np.linalg.svd(np.swapaxes(wanted, -1, -2) @ moved)
    sign = np.ones(size.shape)
    sign[..., -1] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * sign[..., None, :]) @ vt
    square = np.sum(moved**2, axis=(-1, -2))
    scale = np.sum(size * sign, axis=-1) / np.where(square > 0, square, 1.0)
    return np.where(
        seen, scale[..., None, None] * moved @ np.swapaxes(rotation, -1, -2) + aim, np.nan
    )


def limb_scaled(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Poses `(..., 15, 3)` whose bones keep their directions and have the lengths of those of
    `truth`.

    Beyond a missing joint there is no direction: its limb ends there. Raises `BadInput` where a
    bone of `joints` has length zero."""
    joints = np.asarray(joints, float)
    truth = np.asarray(truth, float)
    lost = ~np.isfinite(joints).all(axis=-1)
    for joint, parent in enumerate(PARENTS[1:], start=1):  # parents come before their children
        lost[..., joint] |= lost[..., parent]
    lengths = np.linalg.norm(bone_vectors(truth), axis=-1)
    if not lost.any():
        return with_lengths(joints, lengths)
    whole = np.where(lost[..., None], truth + np.zeros_like(joints), joints)
    return np.where(lost[..., None], np.nan, with_lengths(whole, lengths))


def joint_errors(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Distances `(..., 15)` of joints from the true ones, after limb scaling, then similarity
    alignment."""
    return aligned_errors(limb_scaled(joints, truth), truth)


def aligned_errors(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """Distances `(..., J)` after similarity alignment alone, which most others report."""
    return np.linalg.norm(similarity_aligned(joints, truth) - np.asarray(truth, float), axis=-1)


def mean_joint_error(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """`(...)`: the mean of `joint_errors` over the joints that are there."""
    return np.nanmean(joint_errors(joints, truth), axis=-1)


def best_of(joints: ArrayLike, truth: ArrayLike) -> np.ndarray:
    """`(...)`: the least `mean_joint_error` among hypotheses `(..., k, 15, 3)` of poses `truth`
    `(..., 15, 3)`."""
    return mean_joint_error(joints, np.asarray(truth)[..., None, :, :]).min(axis=-1)
