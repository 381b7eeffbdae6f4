"""The dictionary estimator: fit every torso of the dictionary to the seen torso joints, keep the
best and its twin.

A weak-perspective fit is the least-squares problem min Σ score · |x̂ - s R₂ X - t|². With s R
written as the quadratic form of a quaternion q (s = |q|²) it has four unknowns and no constraint; t
follows from the weighted means."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from inference.roots.points import require_camera
from inference.roots.twins import SAME_ANGLE
from probmodel.body import with_lengths
from probmodel.camera import WeakPerspective
from probmodel.detections import Detection
from probmodel.learning.dictionaries import PoseDictionary
from probmodel.roots import Candidate
from probmodel.skeleton import BONES, NUM_JOINTS, TORSO_INDEX

_DEPTH = np.diag([1.0, 1.0, -1.0])


class TorsoFit(NamedTuple):
    """Fits of many torsos: `error` `(n,)` weighted mean square, `quaternion` `(n, 4)` scaled,
    scalar last."""

    error: np.ndarray
    quaternion: np.ndarray


def fit_dictionary(
    detection: Detection, torsos: np.ndarray, poses: PoseDictionary
) -> tuple[Candidate, ...]:
    """The best torso of `torsos` `(J, 6, 3)` with its camera, and the best on the other side of the
    depth ambiguity.

    It looks at the torso alone: the limbs of its single 3D pose are those of the mean pose of
    `poses`. Raises `BadInput` where the seen torso joints do not determine a camera: too few, or
    all on one point or one line."""
    require_camera(detection)
    seen = np.flatnonzero(detection.seen[list(TORSO_INDEX)])
    rows = np.array(TORSO_INDEX)[seen]
    target, weight = detection.keypoints[rows], detection.score[rows] / detection.score[rows].sum()
    points = torsos[:, seen]
    first = _best(
        _fit(points.mean(axis=0)[None].repeat(len(_starts()), 0), target, weight, _starts())
    )
    same = _fit(points, target, weight, np.tile(first, (len(points), 1)))
    twins = _fit(
        points, target, weight, np.stack([_twin(quaternion) for quaternion in same.quaternion])
    )
    # From either start the iteration may fall to either side; every fit is sorted by where it
    # ended.
    every = TorsoFit(
        np.concatenate([same.error, twins.error]),
        np.concatenate([same.quaternion, twins.quaternion]),
    )
    best = _best(every)
    distance_here = _angle(every.quaternion, best)
    distance_there = _angle(every.quaternion, _twin(best))
    other = (distance_there < distance_here) & (distance_here > SAME_ANGLE)
    picks = [int(np.argmin(every.error))]
    if other.any():
        picks.append(int(np.argmin(np.where(other, every.error, np.inf))))
    mean = with_lengths(poses.mean, poses.lengths)
    return tuple(_candidate(every, pick, torsos, seen, target, weight, mean) for pick in picks)


def with_limbs(torso: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """The pose `(15, 3)` of a `torso` `(6, 3)` whose limbs and head are those of the pose `mean`,
    all in body axes."""
    joints = np.zeros((NUM_JOINTS, 3))
    joints[list(TORSO_INDEX)] = torso
    for bone in BONES:  # upper bones come before those that hang from them
        joints[bone.end] = joints[bone.start] + mean[bone.end] - mean[bone.start]
    return joints


def _starts() -> np.ndarray:
    """Scaled quaternions `(96, 4)` over the sphere of views: yaw by 30°, three tilts, roll upright,
    lying, inverted."""
    upright = np.diag(
        [1.0, -1.0, -1.0]
    )  # body axes (left, up, forward) to camera axes, facing the camera
    turns = [
        Rotation.from_euler("zxy", [roll, tilt, yaw], degrees=True)
        for roll in (0, 90, 180, 270)
        for tilt in (-30, 30)
        for yaw in range(0, 360, 30)
    ]
    return np.stack([(turn * Rotation.from_matrix(upright)).as_quat() for turn in turns])


def _rows(quaternion: np.ndarray) -> np.ndarray:
    """First two rows `(n, 2, 3)` of |q|² R(q)."""
    x, y, z, w = quaternion.T
    first = np.stack(
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1
    )
    second = np.stack(
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)], axis=-1
    )
    return np.stack([first, second], axis=1)


def _slopes(quaternion: np.ndarray) -> np.ndarray:
    """Derivatives `(n, 4, 2, 3)` of `_rows`: the form is quadratic, so ∂/∂q_i = B(q + e_i) - B(q) -
    B(e_i)."""
    whole = _rows(quaternion)
    return np.stack(
        [_rows(quaternion + axis) - whole - _rows(axis[None]) for axis in np.eye(4)], axis=1
    )


def _fit(points: np.ndarray, target: np.ndarray, weight: np.ndarray, start: np.ndarray) -> TorsoFit:
    """Levenberg–Marquardt for n problems at once: `points` `(n, k, 3)`, `target` `(k, 2)`, `start`
    `(n, 4)`."""
    root = np.sqrt(weight)[:, None]
    points = (points - np.einsum("k,nkx->nx", weight, points)[:, None]) * root
    target = (target - weight @ target) * root
    size = np.sqrt(np.sum(target**2) / np.maximum(np.sum(points**2, axis=(1, 2)) * 2 / 3, 1e-300))
    quaternion = start / np.linalg.norm(start, axis=1, keepdims=True) * np.sqrt(size)[:, None]
    damping = np.full(len(points), 1e-2)
    residual = _residual(points, target, quaternion)
    error = np.sum(residual**2, axis=(1, 2))
    for _ in range(60):
        jacobian = np.einsum("nqux,nkx->nqku", _slopes(quaternion), points).reshape(
            len(points), 4, -1
        )
        normal = jacobian @ jacobian.transpose(0, 2, 1)
        gradient = np.einsum("nqr,nr->nq", jacobian, residual.reshape(len(points), -1))
        trace = np.trace(normal, axis1=1, axis2=2)
        normal = normal + (damping * trace)[:, None, None] * np.eye(4) + 1e-300 * np.eye(4)
        trial = quaternion + np.linalg.solve(normal, gradient[..., None])[..., 0]
        trial_residual = _residual(points, target, trial)
        trial_error = np.sum(trial_residual**2, axis=(1, 2))
        better = trial_error <= error
        quaternion = np.where(better[:, None], trial, quaternion)
        residual = np.where(better[:, None, None], trial_residual, residual)
        done = error - np.minimum(error, trial_error) <= 1e-14 * error
        error = np.minimum(error, trial_error)
        damping = np.clip(np.where(better, damping / 5, damping * 4), 1e-12, 1e8)
        if np.all(done & better):
            break
    return TorsoFit(error, quaternion)


def _residual(points: np.ndarray, target: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    return target - np.einsum("nux,nkx->nku", _rows(quaternion), points)


def _best(fit: TorsoFit) -> np.ndarray:
    return fit.quaternion[np.argmin(fit.error)]


def _twin(quaternion: np.ndarray) -> np.ndarray:
    """Where the mirror twin lies: reflected in depth, then turned so that the (flat) torso is left
    as it was."""
    rotation = _DEPTH @ Rotation.from_quat(quaternion).as_matrix() @ _DEPTH
    return Rotation.from_matrix(rotation).as_quat() * np.linalg.norm(quaternion)


def _angle(quaternions: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(quaternions).inv() * Rotation.from_quat(other)).magnitude()


def _candidate(
    fit: TorsoFit,
    pick: int,
    torsos: np.ndarray,
    seen: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray,
    mean: np.ndarray,
) -> Candidate:
    quaternion, index = fit.quaternion[pick], pick % len(torsos)
    scale, rotation = float(np.sum(quaternion**2)), Rotation.from_quat(quaternion).as_matrix()
    translation = weight @ (target - scale * torsos[index, seen] @ rotation[:2].T)
    camera = WeakPerspective(scale, rotation, translation)
    pose = with_limbs(torsos[index], mean) @ rotation.T
    error = float(fit.error[pick])
    return Candidate(index, torsos[index], camera, float(np.sqrt(error)), pose, objective=error)
