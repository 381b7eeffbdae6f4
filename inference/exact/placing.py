"""Joints and keypoints of draws that share a few roots, a million of them in a fifth of a second of
one core: the roots' axes are computed once, and memory is passed over once."""

import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.exact.groups import workers
from poseterior.inference.exact.loops.placing import SharedRoots, place_rows
from poseterior.probmodel.camera import Perspective
from poseterior.probmodel.chunks import CHUNK
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import Root
from poseterior.probmodel.skeleton import NUM_JOINTS


def place_shared(
    model: PoseModel, roots: Root, points: np.ndarray, poses: Pose
) -> tuple[np.ndarray, np.ndarray]:
    """Where draws are.

    Parameters
    ----------
    model
        Of the poses.
    roots
        Leaves start with r.
    points : `(n,)`
        Which of the roots each draw has.
    poses
        Leaves start with n.

    Returns
    -------
    joints, keypoints
        `(n, 15, 3)` in camera axes, body units; `(n, 15, 2)` pixels.
    """
    number, shared = len(points), _shared(model, roots)
    rows = _own(points, np.int64)
    own = Pose(*(_own(column, float) for column in poses))
    joints, keypoints = np.empty((number, NUM_JOINTS, 3)), np.empty((number, NUM_JOINTS, 2))

    def fill(begin: int) -> None:
        place_rows(begin, min(begin + CHUNK, number), rows, own, shared, joints, keypoints)

    list(workers().map(fill, range(0, number, CHUNK)))
    return joints, keypoints


def _shared(model: PoseModel, roots: Root) -> SharedRoots:
    """What the loop knows of roots."""
    torso, camera = roots
    view = np.einsum("rij,rkj->rki", camera.rotation, torso)
    scale, translation = np.asarray(camera.scale), np.asarray(camera.translation)
    nearness, aside = np.zeros_like(scale), np.zeros_like(translation)
    if isinstance(camera, Perspective):
        focal, principal = np.asarray(camera.lens.focal), np.asarray(camera.lens.principal)
        nearness, aside = scale / focal, (translation - principal) / focal[:, None]
    limits = model.limits
    axes = upper_axes(view)
    given = view, axes, scale, translation, nearness, aside, limits.reference, limits.fallback
    return SharedRoots(*(_own(column, float) for column in given))


def _own(column: ArrayLike, kind: type) -> np.ndarray:
    """An array as loops are compiled for: contiguous, and of memory that can be written to."""
    return np.require(column, kind, ("C", "W"))
