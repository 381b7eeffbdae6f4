"""Poses of another estimator, read from a file, in place of an estimate of our own.

The file is an .npy, or an .npz with the array `joints`: `(15, 3)` for one person, `(N, 15, 3)` with
row n the person of that number in the file of detections, or `(N, H, 15, 3)` with H alternatives
each. Axes are the camera's (x right, y down, z away), units and position any: scale and place, and
what a turn still mends, are fitted to the detected joints. Joints stand in the order of
`skeleton.JOINTS`, or an array `names` in the .npz says in which."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from poseterior.inference.estimators.adjustment import adjust
from poseterior.inference.estimators.points import Points
from poseterior.inference.estimators.twins import Outcome, candidates_both_ways, mirrored
from poseterior.inference.estimators.whole_pose import candidate_from_pose
from poseterior.probmodel.arrays import doubles, possible, read_array, read_tables
from poseterior.probmodel.detections import LARGEST_NUMBER, Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import JOINTS, NUM_JOINTS

POSE_SUFFIXES = (".npz", ".npy")
SHAPES = f"({NUM_JOINTS}, 3), (people, {NUM_JOINTS}, 3) or (people, alternatives, {NUM_JOINTS}, 3)"


def read_poses(path: str | os.PathLike) -> np.ndarray:
    """Poses `(N, H, 15, 3)` of a file, people × alternatives. Raises `BadInput` where it is not one
    of poses."""
    path = Path(path)
    what, advice = (
        "file of poses",
        f"give an .npz with `joints` of shape {SHAPES}, or an .npy of that shape",
    )
    if path.suffix.lower() == ".npy":
        joints, names = read_array(path, what, advice), None
    else:
        arrays = read_tables(path, what, advice)
        if "joints" not in arrays:
            raise BadInput(f"{path} holds no array `joints`; {advice}")
        joints, names = arrays["joints"], arrays.get("names")
    if names is not None:
        joints = _in_order(joints, names, path)
    if (
        joints.dtype.kind not in "fiu"
        or joints.ndim not in (2, 3, 4)
        or joints.shape[-2:] != (NUM_JOINTS, 3)
    ):
        raise BadInput(f"{path}: joints have shape {joints.shape}; {advice}")
    joints = doubles(joints)
    if not joints.size or not possible(joints):
        raise BadInput(
            f"{path}: joints must be finite, at most {LARGEST_NUMBER:g} in size, and at least one"
            " pose of them"
        )
    return joints.reshape(1 if joints.ndim == 2 else len(joints), -1, NUM_JOINTS, 3)


def _in_order(joints: np.ndarray, names: np.ndarray, path: Path) -> np.ndarray:
    listed = [str(name) for name in np.atleast_1d(names)]
    missing = [name for name in JOINTS if name not in listed]
    if missing:
        raise BadInput(
            f"{path}: names lack {', '.join(missing)}; needed are the fifteen joints"
            f" {', '.join(JOINTS)}"
        )
    if joints.ndim < 2 or joints.shape[-2] != len(listed):
        raise BadInput(
            f"{path}: there are {len(listed)} names, but joints have shape {joints.shape}"
        )
    return joints[..., [listed.index(name) for name in JOINTS], :]


def fit_poses(
    detections: Sequence[Detection], poses: np.ndarray, torso: np.ndarray, where: str = "the poses"
) -> list[tuple[Candidate, ...]]:
    """Candidates from poses `(N, H, 15, 3)`, best reprojection first; a single pose comes with its
    mirror twin.

    `torso` `(6, 3)` defines the body axes. Raises `BadInput` where there is no pose for a person,
    too little is seen, or a pose has no size."""
    points = Points.gather(detections)
    found = []
    for number, detection in enumerate(detections):
        if detection.person >= len(poses):
            raise BadInput(
                f"{where} hold {len(poses)} people, so none for {detection.where}; they are counted"
                " from 0"
            )
        own = poses[detection.person]
        joints, outcome = _placed(
            points.take(np.array([number])), own, f"{where}, person {detection.person}"
        )
        if len(own) == 1:
            twin = mirrored(detection, candidate_from_pose(detection, joints[0], torso), joints[0])
            pair = Outcome(*(np.repeat(part, 2) for part in outcome))
            found += candidates_both_ways([detection], np.stack([joints[0], twin]), pair, torso)
        else:
            order = np.argsort(outcome.objective, kind="stable")
            ways = (
                candidate_from_pose(detection, joints[row], torso, **outcome.of(row))
                for row in order
            )
            found.append(tuple(ways))
    return found


def _placed(points: Points, poses: np.ndarray, where: str) -> tuple[np.ndarray, Outcome]:
    """Poses `(H, 15, 3)` scaled, moved and slightly turned onto one person's points: `(H, 15, 3)`
    in pixels."""
    extent = np.sqrt(
        np.sum((poses - poses.mean(axis=1, keepdims=True)) ** 2, axis=(1, 2)) / NUM_JOINTS
    )
    if not (extent > 1e-9 * np.abs(poses).max()).all():
        raise BadInput(f"{where}: all joints of a pose lie on one point, so that its scale is zero")
    many = points.repeat(len(poses))
    terms = (poses / extent[:, None, None])[:, None]
    fit = adjust(
        many.xy,
        many.weight,
        terms,
        np.tile(np.eye(3), (len(poses), 1, 1)),
        np.ones((len(poses), 1)),
    )
    if not (fit.coefficient > 1e-6).all():
        raise BadInput(
            f"{where}: a pose does not fit the detected joints at any scale; its axes must be the"
            " camera's"
        )
    outcome = Outcome(fit.objective, np.ones(len(poses), int), fit.converged)
    return many.pixels(fit.rotation, fit.coefficient, terms), outcome
