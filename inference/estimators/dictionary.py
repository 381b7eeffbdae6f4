"""The dictionary estimator: fit every torso of the dictionary to the seen torso joints, keep the
best and its twin.

A weak-perspective fit is the least-squares problem min Σ score · |x̂ - s R₂ X - t|². The two rows of
s R are one complex vector, the first plus i times the second, that is null (n · n = 0), and null
vectors are the quadratic forms of a spinor (α, β):

    n = (α² + β², i (β² − α²), −2i αβ),    s = |α|² + |β|²

(Cartan, "The Theory of Spinors", ch. III; α = x + iy and β = w + iz for the quaternion x, y, z, w).
With keypoints as complex numbers the fit has two complex unknowns and no constraint, and the twin
that is reflected in depth is (α, −β). t follows from the weighted means."""

import functools
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.inference.estimators.points import require_camera
from poseterior.inference.estimators.twins import SAME_ANGLE
from poseterior.probmodel.body import with_lengths
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import BONES, NUM_JOINTS, TORSO_INDEX

ITERATIONS = 60
TWIN = np.array([1, -1])
"""What a spinor is multiplied by to be its mirror twin's, which leaves a flat torso as it was."""


class TorsoFit(NamedTuple):
    """Fits of many torsos: `error` `(n,)` weighted mean square, `spinor` `(n, 2)`, complex."""

    error: np.ndarray
    spinor: np.ndarray


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
    points, starts = torsos[:, seen], _starts()
    first = _best(_fit(points.mean(axis=0)[None].repeat(len(starts), 0), target, weight, starts))
    same = _fit(points, target, weight, np.tile(first, (len(points), 1)))
    twins = _fit(points, target, weight, same.spinor * TWIN)
    # From either start the iteration may fall to either side; every fit is sorted by where it
    # ended.
    every = TorsoFit(
        np.concatenate([same.error, twins.error]), np.concatenate([same.spinor, twins.spinor])
    )
    best = _best(every)
    distance_here, distance_there = _angle(every.spinor, best), _angle(every.spinor, best * TWIN)
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


@functools.cache
def _starts() -> np.ndarray:
    """Spinors `(96, 2)` over the sphere of views: yaw by 30°, two tilts, roll upright, lying,
    inverted."""
    upright = np.diag(
        [1.0, -1.0, -1.0]
    )  # body axes (left, up, forward) to camera axes, facing the camera
    turns = [
        (roll, tilt, yaw)
        for roll in (0, 90, 180, 270)
        for tilt in (-30, 30)
        for yaw in range(0, 360, 30)
    ]
    turned = Rotation.from_euler("zxy", turns, degrees=True) * Rotation.from_matrix(upright)
    x, y, z, w = turned.as_quat().T
    return np.stack([x + 1j * y, w + 1j * z], axis=1)


def _fit(points: np.ndarray, target: np.ndarray, weight: np.ndarray, start: np.ndarray) -> TorsoFit:
    """Levenberg–Marquardt for n problems at once: `points` `(n, k, 3)`, `target` `(k, 2)`, `start`
    `(n, 2)`. What has converged is left alone, so that no problem depends on the others."""
    root = np.sqrt(weight)
    points = (points - np.einsum("k,nkx->nx", weight, points)[:, None]) * root[:, None]
    image = (target - weight @ target) @ [1, 1j] * root
    size = np.sum(points**2, axis=(1, 2)) * 2 / 3
    scale = np.sqrt(np.sum(np.abs(image) ** 2) / np.maximum(size, 1e-300))
    spinor = start * (np.sqrt(scale) / np.linalg.norm(start, axis=1))[:, None]
    plane, height = points[..., 0] + 1j * points[..., 1], points[..., 2]
    residual = image - _images(plane, height, spinor)
    error, damping = _square(residual), np.full(len(points), 1e-2)
    found, open_ = TorsoFit(error.copy(), spinor.copy()), np.arange(len(points))
    for _ in range(ITERATIONS):
        slope = _slopes(plane, height, spinor)
        across = slope.conj()
        normal = across @ slope.swapaxes(1, 2)
        diagonal = np.einsum("nii->ni", normal)  # a view
        diagonal += (damping * 2 * diagonal.sum(axis=1).real)[:, None] + 1e-300
        trial = spinor + np.linalg.solve(normal, across @ residual[..., None])[..., 0]
        trial_residual = image - _images(plane, height, trial)
        trial_error = _square(trial_residual)
        better = trial_error <= error
        going = ~better | (error - trial_error > 1e-14 * error)
        spinor = np.where(better[:, None], trial, spinor)
        residual = np.where(better[:, None], trial_residual, residual)
        error = np.minimum(error, trial_error)
        damping = np.clip(np.where(better, damping / 5, damping * 4), 1e-12, 1e8)
        found.error[open_], found.spinor[open_] = error, spinor
        if not going.all():
            open_, plane, height, spinor, residual, error, damping = (
                part[going] for part in (open_, plane, height, spinor, residual, error, damping)
            )
        if not open_.size:
            break
    return found


def _images(plane: np.ndarray, height: np.ndarray, spinor: np.ndarray) -> np.ndarray:
    """Where points fall, `(n, k)`, as complex numbers: n · X with X = (`plane`, `height`), the
    first two coordinates as one complex number."""
    alpha, beta = spinor[:, 0, None], spinor[:, 1, None]
    return alpha**2 * plane.conj() + beta**2 * plane - 2j * alpha * beta * height


def _slopes(plane: np.ndarray, height: np.ndarray, spinor: np.ndarray) -> np.ndarray:
    """Derivatives `(n, 2, k)` of `_images` by α and β."""
    alpha, beta = spinor[:, 0, None], spinor[:, 1, None]
    return np.stack(
        [
            2 * alpha * plane.conj() - 2j * beta * height,
            2 * beta * plane - 2j * alpha * height,
        ],
        axis=1,
    )


def _square(residual: np.ndarray) -> np.ndarray:
    return np.sum(residual.real**2 + residual.imag**2, axis=1)


def _best(fit: TorsoFit) -> np.ndarray:
    return fit.spinor[np.argmin(fit.error)]


def _angle(spinors: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Radians between the rotations of `spinors` `(n, 2)` and of another `(2,)`."""
    along = np.abs((spinors @ other.conj()).real)
    return 2 * np.arccos(
        np.minimum(along / (np.linalg.norm(spinors, axis=1) * np.linalg.norm(other)), 1)
    )


def _candidate(
    fit: TorsoFit,
    pick: int,
    torsos: np.ndarray,
    seen: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray,
    mean: np.ndarray,
) -> Candidate:
    alpha, beta = fit.spinor[pick]
    index, scale = pick % len(torsos), float(abs(alpha) ** 2 + abs(beta) ** 2)
    rotation = Rotation.from_quat([alpha.real, alpha.imag, beta.imag, beta.real]).as_matrix()
    translation = weight @ (target - scale * torsos[index, seen] @ rotation[:2].T)
    camera = WeakPerspective(scale, rotation, translation)
    pose = with_limbs(torsos[index], mean) @ rotation.T
    error = float(fit.error[pick])
    return Candidate(index, torsos[index], camera, float(np.sqrt(error)), pose, objective=error)
