"""Exact draws by the plainest route, in NumPy, from the published description of the tables: a
second implementation.

Nothing of the product is imported but the names of joints. A group of limbs is drawn from the prior
(cell, place in the cell, uniform direction on the whole sphere until the plane and box allow it)
and kept iff all seen joints lie in their discs. Left-handed system, bones parent minus child, as
the tables have it."""

import numpy as np

from poseterior.probmodel.skeleton import GROUPS, JOINT_INDEX, TORSO_JOINTS

SWAP = [0, 2, 1]


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def _frame(torso: dict[str, np.ndarray], legs: bool) -> np.ndarray:
    right, left = ("right_hip", "left_hip") if legs else ("right_shoulder", "left_shoulder")
    u = _unit(torso[right] - torso[left])
    v = torso["pelvis"] - torso["thorax"]
    v = _unit(v - (v @ u) * u)
    return np.stack([u, v, np.cross(u, v)], axis=1)


def _uniform_lower(limits, bone, column, row, rng):
    """Directions uniform per steradian on what the plane and the box of each draw's own cell
    leave."""
    result = np.full((len(column), 3), np.nan)
    normal, tangent, offset, box = (
        np.asarray(table)[bone, column, row]
        for table in (limits.normal, limits.tangent, limits.offset, limits.bounds)
    )
    second = _unit(tangent - np.sum(tangent * normal, axis=-1, keepdims=True) * normal)
    third = np.cross(normal, second)
    left = np.arange(len(column))
    while len(left):
        b = _unit(rng.normal(size=(len(left), 3)))
        u1, u2, u3 = (np.sum(axis[left] * b, axis=-1) for axis in (normal, second, third))
        ok = (u1 + offset[left] < 0) & (u2 >= box[left, 0]) & (u2 <= box[left, 1])
        ok &= (u3 >= box[left, 2]) & (u3 <= box[left, 3])
        result[left[ok]] = b[ok]
        left = left[~ok]
    return result


def propose_group(limits, lengths, torso, name, number, rng):
    """Lengths `(n, bones)` and joints by name `(n, 3)` of a group drawn from the prior (upper
    measure "angle", lower "area"); `torso` `(6, 3)` in right-handed camera axes, as are the
    joints."""
    swapped = {
        joint: point[SWAP] for joint, point in zip(TORSO_JOINTS, np.asarray(torso), strict=True)
    }
    frame = _frame(swapped, name == "legs")
    groups = [bone.length_group for bone in GROUPS[name][0].bones]
    low, high, alpha, beta = (np.asarray(field)[groups] for field in lengths)
    size = low + (high - low) * rng.beta(alpha, beta, (number, len(groups)))
    joints = {}
    for limb in GROUPS[name]:
        start = swapped[TORSO_NAME[limb.bones[0].start]]
        cells = np.argwhere(np.asarray(limits.occupied)[limb.upper])
        column, row = cells[rng.integers(len(cells), size=number)].T
        azimuth = np.radians(-180 + 3 * (column + rng.uniform(size=number)))
        elevation = np.radians(-90 + 3 * (row + rng.uniform(size=number)))
        local = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            -1,
        )
        upper = local @ frame.T
        end = start - size[:, :1] * upper
        joints[limb.bones[0].end] = end
        if limb.lower is not None:
            v = _unit(np.cross(frame @ np.asarray(limits.reference), upper))
            axes = np.stack([upper, v, np.cross(upper, v)], axis=-1)
            lower = np.einsum(
                "nij,nj->ni", axes, _uniform_lower(limits, limb.lower, column, row, rng)
            )
            joints[limb.bones[1].end] = end - size[:, 1:] * lower
    return size, {joint: point[:, SWAP] for joint, point in joints.items()}


TORSO_NAME = {JOINT_INDEX[name]: name for name in TORSO_JOINTS}


def accepted(joints, camera, keypoints, radius):
    """`(n,)` bool: every seen joint within its disc."""
    ok = True
    for joint, points in joints.items():
        if np.isfinite(radius[joint]):
            image = camera.scale * points[:, :2] + camera.translation
            ok &= np.sum((image - keypoints[joint]) ** 2, axis=-1) <= radius[joint] ** 2
    return np.broadcast_to(ok, len(next(iter(joints.values()))))


def brute_force(limits, lengths, frame, name, number, seed, keep=accepted):
    """Accepted lengths `(m, bones)`, joints `{joint: (m, 3)}`, the number proposed, for a frame's
    first candidate; `keep` says which are accepted."""
    rng = np.random.default_rng(seed)
    candidate = frame.candidates[0]
    torso = np.asarray(candidate.torso) @ np.asarray(candidate.camera.rotation).T
    radius = frame.likelihood.spread(frame.detection, float(candidate.camera.scale))
    sizes, parts = [], []
    for start in range(0, number, CHUNK):
        size, joints = propose_group(limits, lengths, torso, name, min(CHUNK, number - start), rng)
        ok = keep(joints, candidate.camera, frame.detection.keypoints, radius)
        sizes.append(size[ok])
        parts.append({joint: points[ok] for joint, points in joints.items()})
    return (
        np.concatenate(sizes),
        {joint: np.concatenate([part[joint] for part in parts]) for joint in parts[0]},
        number,
    )


CHUNK = 200_000
