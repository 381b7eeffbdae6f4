"""A second checker of poses under the published tables, written from the description of that file
alone.

It shares no code and no convention with the package: axes are swapped into the tables' left-handed
system, bones and cells are counted from one, and the .mat file is read here. Usual way in:
`valid_bones(joints, mat_path)`."""

from pathlib import Path

import numpy as np
import scipy.io

FIFTEEN_TO_SEVENTEEN = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, None, 12, 13, 14, None]
"""The published skeleton has feet, which no bone checked here needs."""
ORDER = (8, 3, 6, 10, 14, 4, 7, 11, 15)
"""Bones, counted from one: head, upper arms (R, L), upper legs (R, L), forearms (R, L), lower legs
(R, L)."""
PARENT_OF_LOWER = {4: 3, 7: 6, 11: 10, 15: 14}


def valid_bones(joints: np.ndarray, mat_path: Path) -> np.ndarray:
    """`(N, 9)` bool for right-handed poses `(N, 15, 3)`."""
    model = scipy.io.loadmat(mat_path)
    entry_of = {int(bone): i for i, bone in enumerate(model["chlds"][0])}
    reference, static = model["a"][:, 0].astype(float), model["di"].astype(float)
    left_handed = np.asarray(joints, float)[:, :, [0, 2, 1]]
    return np.array([_valid_pose(pose, model, entry_of, reference, static) for pose in left_handed])


def _valid_pose(pose, model, entry_of, reference, static):
    bones = _bones(pose, model["edges"])
    frames = {bone: _torso_frame(bones, legs=bone in (10, 14)) for bone in (8, 3, 6, 10, 14)}
    verdict = {}
    for bone, frame in frames.items():
        azimuth, elevation = _bins(frame.T @ bones[bone])
        verdict[bone] = bool(model["angleSprd"][0, entry_of[bone]][azimuth, elevation])
    for bone, parent in PARENT_OF_LOWER.items():
        frame = frames[parent]
        where = _bins(frame.T @ bones[parent])
        axes = _limb_frame(bones[parent], frame, reference, static[:, parent - 1])
        verdict[bone] = _valid_lower(model, entry_of[bone], where, axes.T @ bones[bone])
    return [verdict[bone] for bone in ORDER]


def _bones(pose, edges):
    """Unit bones by number, parent minus child; those of the feet are left out."""
    bones = {}
    for number, (parent, child) in enumerate(edges.astype(int), start=1):
        start, end = FIFTEEN_TO_SEVENTEEN[parent - 1], FIFTEEN_TO_SEVENTEEN[child - 1]
        if start is not None and end is not None:
            bones[number] = pose[start] - pose[end]
    lengths = {number: np.sqrt(sum(bone**2)) for number, bone in bones.items()}
    bones["across shoulders"], bones["across hips"] = bones[5] - bones[2], bones[13] - bones[9]
    return bones | {number: bones[number] / lengths[number] for number in lengths}


def _torso_frame(bones, *, legs):
    first = bones["across hips"] if legs else bones["across shoulders"]
    first = first / np.linalg.norm(first)
    second = bones[1] - (bones[1] @ first) * first
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


def _limb_frame(parent, torso_frame, reference, static):
    second = np.cross(torso_frame @ reference, parent)
    if np.linalg.norm(second) < 1e-8:
        second = np.cross(parent, torso_frame @ static)
    second = second / np.linalg.norm(second)
    return np.column_stack([parent, second, np.cross(parent, second)])


def _bins(local):
    x, y, z = local
    azimuth, elevation = np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(np.clip(z, -1, 1)))
    return int((azimuth + 180) // 3), int((elevation + 90) // 3)


def _valid_lower(model, entry, where, local):
    plane = model["sepPlane"][0, entry][where]
    if np.isnan(plane).any() or plane[:3] @ local + plane[3] > 0:
        return False
    first = plane[:3] / np.linalg.norm(plane[:3])
    second = model["E2"][0, entry][where]
    second = second - (second @ first) * first
    second = second / np.linalg.norm(second)
    third = np.cross(first, second)
    low2, high2, low3, high3 = model["bounds"][0, entry][where]
    return bool(low2 <= second @ local <= high2 and low3 <= third @ local <= high3)
