"""The posterior by brute force: what the product claims, computed by the plainest route in NumPy.

Nothing of the product is imported. Tables of limits, lengths and torsos are handed in as arrays;
skeleton, projection, error laws, faults and exchanges are written out here once more, from
docs/model.md and the published description of the tables. Limbs are drawn from the prior (cell,
place in the cell, uniform direction until plane and box allow it), roots from a plain proposal,
and weighed by formulas. `tests/inference/test_oracle.py` holds every sampler against this.

The tables have a left-handed system, and bones are parent minus child.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

JOINTS = (
    *("pelvis", "thorax", "right_shoulder", "right_elbow", "right_wrist"),
    *("left_shoulder", "left_elbow", "left_wrist", "head"),
    *("right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle"),
)
ROW = {name: row for row, name in enumerate(JOINTS)}
TORSO_ROWS = ("pelvis", "thorax", "right_shoulder", "left_shoulder", "right_hip", "left_hip")
"""The rows of a torso `(6, 3)`."""


class Chain(NamedTuple):
    """A limb: the torso's joint that it hangs from, its rows in the tables of upper and of lower
    bones, its joints."""

    start: str
    upper: int
    lower: int | None
    joints: tuple[str, ...]


CHAINS = {
    "head": (Chain("thorax", 0, None, ("head",)),),
    "arms": (
        Chain("right_shoulder", 1, 0, ("right_elbow", "right_wrist")),
        Chain("left_shoulder", 2, 1, ("left_elbow", "left_wrist")),
    ),
    "legs": (
        Chain("right_hip", 3, 2, ("right_knee", "right_ankle")),
        Chain("left_hip", 4, 3, ("left_knee", "left_ankle")),
    ),
}
LENGTHS = {"head": [0], "arms": [1, 2], "legs": [3, 4]}
"""The columns of the lengths of each group's bones."""
SWAP = [0, 2, 1]
CHUNK = 200_000


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
    """Lengths `(n, bones)` and joints by row `(n, 3)` of a group drawn from the prior (upper
    measure "angle", lower "area"); `torso` `(6, 3)` in right-handed camera axes, as are the
    joints."""
    swapped = {
        joint: point[SWAP] for joint, point in zip(TORSO_ROWS, np.asarray(torso), strict=True)
    }
    frame = _frame(swapped, name == "legs")
    low, high, alpha, beta = (np.asarray(field)[LENGTHS[name]] for field in lengths)
    size = low + (high - low) * rng.beta(alpha, beta, (number, len(low)))
    joints = {}
    for limb in CHAINS[name]:
        start = swapped[limb.start]
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
        joints[ROW[limb.joints[0]]] = end
        if limb.lower is not None:
            v = _unit(np.cross(frame @ np.asarray(limits.reference), upper))
            axes = np.stack([upper, v, np.cross(upper, v)], axis=-1)
            lower = np.einsum(
                "nij,nj->ni", axes, _uniform_lower(limits, limb.lower, column, row, rng)
            )
            joints[ROW[limb.joints[1]]] = end - size[:, 1:] * lower
    return size, {joint: point[:, SWAP] for joint, point in joints.items()}


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


# Error laws: densities of an error by its squared length, both in spreads.

CUT = 1 - math.exp(-4.5)
"""Of a Gaussian's mass within three standard deviations; other laws are cut where as much is
left."""
FREEDOM = 5.0


def disc(square: np.ndarray) -> np.ndarray:
    """Uniform."""
    return (square <= 1) / math.pi


def gaussian(square: np.ndarray) -> np.ndarray:
    """Standard deviation a half, cut at three of them."""
    return np.where(square <= 9 / 4, 2 / math.pi * np.exp(-2 * square) / CUT, 0.0)


def student(square: np.ndarray) -> np.ndarray:
    """Scale a half, five degrees of freedom."""
    far = FREEDOM * math.expm1(9 / FREEDOM) / 4
    inside = 2 / math.pi * (1 + 4 * square / FREEDOM) ** (-FREEDOM / 2 - 1) / CUT
    return np.where(square <= far, inside, 0.0)


DENSITIES = {"disc": disc, "gaussian": gaussian, "student": student}
WIDEST = 2.6
"""Spreads: no law reaches farther."""
TORSO = ("right_shoulder", "left_shoulder", "right_hip", "left_hip")
ARM = ("right_elbow", "right_wrist")
"""The keypoints of the small cases."""
MIRRORED = {
    name: name.replace("right", "LEFT").replace("left", "right").replace("LEFT", "left")
    for name in JOINTS
}
NEAREST = 1.5
"""Body units: no pelvis is nearer to a lens."""


class Lens(NamedTuple):
    """Focal length and principal point, pixels."""

    focal: float
    principal: np.ndarray


@dataclasses.dataclass(frozen=True)
class Beliefs:
    """What is believed of how the keypoints of a small case came about: the name of a law,
    `spread` (body units) and `bias` of each keypoint, the probability `outlier` that it lies
    anywhere within `far` body units, those of exchanges ("arms", "legs", "body"), how upright
    people are, and the power of the scale by which a control's prior is wrong."""

    law: str
    spread: Mapping[str, float]
    bias: Mapping[str, np.ndarray]
    outlier: Mapping[str, float] = dataclasses.field(default_factory=dict)
    far: float = 8.0
    exchange: Mapping[str, float] = dataclasses.field(default_factory=dict)
    upright: float = 0.0
    wrong_power: float = 0.0

    def wider(self, factor: float) -> "Beliefs":
        """Control: the same law with other spreads."""
        spread = {name: factor * size for name, size in self.spread.items()}
        return dataclasses.replace(self, spread=spread)


class Roots(NamedTuple):
    """Torsos by row of the dictionary `(n,)`, rotations `(n, 3, 3)`, scales `(n,)` in pixels a body
    unit, where the pelvis is seen `(n, 2)`, and log densities of having proposed them `(n,)`."""

    torso: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    pelvis: np.ndarray
    log_proposal: np.ndarray

    def take(self, rows: np.ndarray) -> "Roots":
        """Some of them."""
        return Roots(*(column[rows] for column in self))


def seen(points: np.ndarray, roots: Roots, lens: Lens | None) -> tuple[np.ndarray, np.ndarray]:
    """Where points `(n, k, 3)` beside the pelvis are seen, pixels `(n, k, 2)`, and how many pixels
    a body unit has there `(n, k)`."""
    scale, pelvis = roots.scale[:, None], roots.pelvis[:, None]
    if lens is None:
        unit = np.broadcast_to(scale, points.shape[:2])
        return unit[..., None] * points[..., :2] + pelvis, unit
    away = lens.focal / scale
    across = (pelvis - lens.principal) * (away / lens.focal)[..., None] + points[..., :2]
    unit = lens.focal / (away + points[..., 2])
    return lens.principal + unit[..., None] * across, unit


class Odds(NamedTuple):
    """Densities per square pixel of a keypoint under what a joint is: an inlier's, an outlier's,
    with their prior probabilities multiplied in where it is a limb's."""

    inlier: np.ndarray
    outlier: np.ndarray


def odds(image: np.ndarray, unit: np.ndarray, at: np.ndarray, name: str, given: Beliefs) -> Odds:
    """Of a joint seen at `image` `(..., 2)` whose keypoint stands `at` some pixels."""
    gap = (image - at) / unit[..., None]
    size = given.spread[name]
    square = np.sum((gap + given.bias[name]) ** 2, axis=-1) / size**2
    inlier = DENSITIES[given.law](square) / (size * unit) ** 2
    outlier = disc(np.sum(gap**2, axis=-1) / given.far**2) / (given.far * unit) ** 2
    return Odds(inlier * (unit > 0), outlier * (unit > 0))


class SmallCase(NamedTuple):
    """Keypoints, in pixels by name, of shoulders, hips and the right arm; and the tables."""

    at: Mapping[str, np.ndarray]
    limits: object
    lengths: tuple[np.ndarray, ...]
    torsos: np.ndarray
    lens: Lens | None = None
    definition: Mapping[str, np.ndarray] = {}
    """How far from a torso's joint, body axes and units, lies what the detector calls so: `(3,)`,
    or `(J, 3)` of each torso."""


def weigh_torsos(case: SmallCase, roots: Roots, given: Beliefs) -> dict[str, np.ndarray]:
    """Prior and likelihood of the torso's keypoints: "plain" of no exchange, or one that leaves
    the torso alone; "turned" where left and right are exchanged; "left_hip" the part of plain in
    which that keypoint is an outlier. Over the density of the proposal."""
    rows = [TORSO_ROWS.index(name) for name in TORSO]
    everyone = np.zeros((len(case.torsos), 3))
    defined = np.stack([everyone + case.definition.get(name, 0.0) for name in TORSO], axis=1)
    points = (case.torsos[:, rows] + defined)[roots.torso]
    points = np.einsum("nij,nkj->nki", roots.rotation, points)
    image, unit = seen(points, roots, case.lens)
    own, other = {}, {}
    for column, name in enumerate(TORSO):
        own[name] = odds(image[:, column], unit[:, column], case.at[name], name, given)
        key = MIRRORED[name]
        other[name] = odds(image[:, column], unit[:, column], case.at[key], key, given)
    plain = np.prod([own[name].inlier for name in TORSO], axis=0)
    total, hip = plain, np.zeros(len(plain))
    whole = 1.0
    for name in TORSO:
        chance = given.outlier.get(name, 0.0)
        others = np.prod([own[one].inlier for one in TORSO if one != name], axis=0)
        part = chance / (1 - chance) * own[name].outlier * others
        total, whole = total + part, whole + chance / (1 - chance)
        hip = part if name == "left_hip" else hip
    prior = np.exp(-given.upright * (roots.rotation[:, 1, 1] + 1) - roots.log_proposal)
    prior *= roots.scale**given.wrong_power / len(case.torsos)
    if given.upright:
        # Haar's measure on how the back points is uniform in its cosine.
        prior *= 2 * given.upright / -math.expm1(-2 * given.upright)
    if case.lens is not None:
        prior = np.where(roots.scale <= case.lens.focal / NEAREST, prior, 0.0)
    turned = np.prod([other[name].inlier for name in TORSO], axis=0)
    return {
        "plain": prior * total / whole,
        "turned": prior * turned,
        "left_hip": prior * hip / whole,
    }


def weigh_arms(
    case: SmallCase, roots: Roots, arms: Mapping[str, np.ndarray], given: Beliefs
) -> dict[str, np.ndarray]:
    """Likelihood `(n, k)` of the keypoints of the right arm where they are of the right arm, "own",
    and of the left one, "other", whose joints are `arms` `(n, k, 3)`; "own_out" and "other_out"
    the parts of them in which the wrist's is an outlier."""
    found = {}
    for side, mirrored in (("own", False), ("other", True)):
        both = []
        for name in ARM:
            image, unit = seen(arms[MIRRORED[name] if mirrored else name], roots, case.lens)
            chance = given.outlier.get(name, 0.0)
            near, far = odds(image, unit, case.at[name], name, given)
            both.append(Odds((1 - chance) * near, chance * far))
        elbow, wrist = both
        found[side] = (elbow.inlier + elbow.outlier) * (wrist.inlier + wrist.outlier)
        found[f"{side}_out"] = (elbow.inlier + elbow.outlier) * wrist.outlier
    return found


NAMES = (
    *("log scale", "pelvis x", "pelvis y", "chest z", "back z"),
    *("upper arm", "forearm", "elbow z", "wrist x", "wrist z", "left wrist z"),
)
"""What is compared by mean and deviation."""
FLAGS = ("first torso", "wrist outlier", "hip outlier", "arms exchanged", "body exchanged")
"""And by mean alone: probabilities."""


class Moments(NamedTuple):
    """Log evidence, means of `NAMES` and their squares about `centre`, means of `FLAGS`, all with
    standard errors."""

    log_evidence: float
    log_evidence_se: float
    centre: np.ndarray
    mean: np.ndarray
    mean_se: np.ndarray

    def apart(self, other: "Moments") -> np.ndarray:
        """`(1 + 2 m + f,)`: every difference in standard errors, the evidence's first; 0 where
        both say the same without a doubt."""
        gap = np.append(self.log_evidence - other.log_evidence, self.mean - other.mean)
        error = np.append(
            math.hypot(self.log_evidence_se, other.log_evidence_se),
            np.hypot(self.mean_se, other.mean_se),
        )
        return np.divide(gap, error, out=np.where(gap == 0, 0.0, np.inf), where=error > 0)


def moments(
    weight: np.ndarray,
    values: np.ndarray,
    flags: np.ndarray,
    cluster: np.ndarray,
    centre: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The centre, and the weighted means of values `(n, m)`, their squares about the centre (their
    own mean, if none is given) and flags `(n, f)`, with standard errors: draws of one `cluster`
    `(n,)` err together."""
    share = weight / weight.sum()
    centre = share @ values if centre is None else centre
    columns = np.concatenate([values, (values - centre) ** 2, flags], axis=1)
    mean = share @ columns
    _, cluster = np.unique(cluster, return_inverse=True)
    sums = np.stack([np.bincount(cluster, share * one) for one in (columns - mean).T])
    return centre, mean, np.sqrt(np.sum(sums**2, axis=1))


class Effort(NamedTuple):
    """Roots of a `pilot` that finds where others are `proposed`; how many of these are `taken`, and
    get so many `arms` of the prior each."""

    pilot: int = 200_000
    proposed: int = 200_000
    taken: int = 20_000
    arms: int = 40


FULL = Effort()
POOL = 200_000
NEAR, TURN, GROWTH = 300, 0.25, 0.15
"""Kernels of the proposal, and their deviations in radians and log scale."""
SCALES = (math.log(15.0), math.log(800.0))
PLAIN = 0.15
"""The share of roots that are proposed by no kernel."""
PLACES = ((0.8, 0.25), (0.2, 0.8))
"""Shares and deviations, body units, of the pelvis about where keypoints have it on average."""
LEFT_OUT = (None, *TORSO)


def pelvis_of(case: SmallCase, roots: Roots) -> np.ndarray:
    """`(n, 6, 2)`: where the pelvis would be seen if the torso's keypoints were right on average:
    all, all but each, and all exchanged."""
    rows = [TORSO_ROWS.index(name) for name in TORSO]
    points = np.einsum("nij,nkj->nki", roots.rotation, case.torsos[roots.torso][:, rows])
    scale = roots.scale[:, None, None]

    def each(turned: bool) -> np.ndarray:
        at = np.array([case.at[MIRRORED[name] if turned else name] for name in TORSO])
        if case.lens is None:
            return at - scale * points[..., :2]
        grown = 1 + points[..., 2:] * scale / case.lens.focal
        return case.lens.principal + (at - case.lens.principal) * grown - scale * points[..., :2]

    own = each(False)
    kept = [[name != left_out for name in TORSO] for left_out in LEFT_OUT]
    means = [own[:, one].mean(axis=1) for one in kept]
    return np.stack([*means, each(True).mean(axis=1)], axis=1)


def propose(case: SmallCase, near: Roots | None, number: int, rng: np.random.Generator) -> Roots:
    """Roots: torso uniform; rotation uniform and log scale uniform on a wide interval, or most of
    them near some known roots; the pelvis near where keypoints have it."""
    torso = rng.integers(len(case.torsos), size=number)
    rotation = Rotation.random(number, rng=rng)
    log_scale = rng.uniform(*SCALES, number)
    density = np.full(number, 1 / (SCALES[1] - SCALES[0]))
    if near is not None:
        kernel = rng.integers(len(near.scale), size=number)
        turn = Rotation.from_rotvec(rng.normal(scale=TURN, size=(number, 3)))
        moved = Rotation.from_matrix(near.rotation[kernel]) * turn
        grown = np.log(near.scale[kernel]) + rng.normal(scale=GROWTH, size=number)
        plain = rng.uniform(size=number) < PLAIN
        matrix = np.where(plain[:, None, None], rotation.as_matrix(), moved.as_matrix())
        rotation, log_scale = Rotation.from_matrix(matrix), np.where(plain, log_scale, grown)
        inside = (log_scale > SCALES[0]) & (log_scale < SCALES[1])
        density = PLAIN * density * inside
        density += (1 - PLAIN) * _near(near, rotation.as_matrix(), log_scale)
    blank = Roots(torso, rotation.as_matrix(), np.exp(log_scale), np.zeros((number, 2)), density)
    places = pelvis_of(case, blank)
    chosen = places[np.arange(number), rng.integers(places.shape[1], size=number)]
    wide = rng.choice([size for _, size in PLACES], number, p=[share for share, _ in PLACES])
    deviation = (wide * blank.scale)[:, None]
    pelvis = chosen + deviation * rng.normal(size=(number, 2))
    square = np.sum((pelvis[:, None] - places) ** 2, axis=-1) / blank.scale[:, None] ** 2
    there = np.zeros(number)
    for share, size in PLACES:
        there += share * np.exp(-square / (2 * size**2)).mean(axis=1) / (2 * math.pi * size**2)
    log_proposal = np.log(density * there) - 2 * log_scale
    return Roots(
        torso, blank.rotation, blank.scale, pelvis, log_proposal - math.log(len(case.torsos))
    )


def _near(near: Roots, rotation: np.ndarray, log_scale: np.ndarray) -> np.ndarray:
    """Density of the kernels, with respect to Haar's measure × log scale. That of a rotation
    vector of length t has (1 - cos t)/(4π² t²) of Haar's measure a unit of volume."""
    total = np.zeros(len(log_scale))
    flat = near.rotation.reshape(len(near.scale), 9)
    for start in range(0, len(total), 20_000):
        part = slice(start, start + 20_000)
        cosine = (rotation[part].reshape(-1, 9) @ flat.T - 1) / 2
        angle = np.arccos(np.clip(cosine, -1, 1))
        per_haar = 4 * math.pi**2 * angle**2 / np.maximum(1 - cosine, 1e-12)
        apart = (log_scale[part, None] - np.log(near.scale)) / GROWTH
        # A turn beyond π is one the other way round; at a deviation of 0.25 there is none.
        kernel = per_haar * np.exp(-((angle / TURN) ** 2 + apart**2) / 2)
        total[part] = kernel.mean(axis=1) / ((2 * math.pi) ** 2 * TURN**3 * GROWTH)
    return total


def under_roots(
    case: SmallCase, rows: Mapping[Any, Beliefs], seed: int, effort: Effort = FULL
) -> dict[Any, Moments]:
    """The posterior of torso, camera and right arm, under all beliefs from the same proposals.

    Terms of the sums are independent: a root is taken with a probability, and counts for its
    inverse.
    """
    rng = np.random.default_rng(seed)

    def weights(roots: Roots) -> dict[Any, dict[str, np.ndarray]]:
        return {name: weigh_torsos(case, roots, given) for name, given in rows.items()}

    def importance(torsos: dict[Any, dict[str, np.ndarray]]) -> np.ndarray:
        each = [one["plain"] + one["turned"] for one in torsos.values()]
        return np.mean([one / one.sum() for one in each], axis=0)

    pilot = propose(case, None, effort.pilot, rng)
    near = pilot.take(rng.choice(effort.pilot, NEAR, p=importance(weights(pilot))))
    roots = propose(case, near, effort.proposed, rng)
    torsos = weights(roots)
    chance = np.minimum(effort.taken * importance(torsos), 1.0)
    taken = np.flatnonzero(rng.uniform(size=effort.proposed) < chance)
    some, counted = roots.take(taken), 1 / chance[taken]
    values, arms = _arms(case, some, effort.arms, rng)
    found = {}
    for name, given in rows.items():
        own = {part: weight[taken] for part, weight in torsos[name].items()}
        arm = weigh_arms(case, some, arms, given)
        found[name] = _moments_of(values, counted / effort.proposed, own, arm, given)
    return found


def _arms(
    case: SmallCase, roots: Roots, number: int, rng: np.random.Generator
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """`NAMES` and the first flag `(n · number, m + 1)`, and both arms' joints `(n, number, 3)`, in
    camera axes."""
    pools = [
        propose_group(case.limits, case.lengths, one, "arms", POOL, rng) for one in case.torsos
    ]
    pick = rng.integers(POOL, size=(len(roots.scale), number))
    size = np.array([size for size, _ in pools])[roots.torso[:, None], pick]
    arms = {}
    for name in (*ARM, *(MIRRORED[one] for one in ARM)):
        pool = np.array([joints[ROW[name]] for _, joints in pools])
        points = pool[roots.torso[:, None], pick]
        arms[name] = np.einsum("nij,nkj->nki", roots.rotation, points)
    root = [np.log(roots.scale), *roots.pelvis.T, roots.rotation[:, 2, 2], roots.rotation[:, 2, 1]]
    columns = [np.repeat(one, number) for one in root]
    columns += [size[..., 0].ravel(), size[..., 1].ravel(), arms["right_elbow"][..., 2].ravel()]
    columns += [arms["right_wrist"][..., 0].ravel(), arms["right_wrist"][..., 2].ravel()]
    columns += [arms["left_wrist"][..., 2].ravel(), np.repeat(roots.torso == 0, number)]
    return np.stack(columns, axis=1), arms


def _moments_of(
    values: np.ndarray,
    counted: np.ndarray,
    torso: Mapping[str, np.ndarray],
    arm: Mapping[str, np.ndarray],
    given: Beliefs,
) -> Moments:
    """Patterns of faults summed: of an exchange of legs, of which nothing is seen, only the prior
    says anything."""
    arms, body = given.exchange.get("arms", 0.0), given.exchange.get("body", 0.0)
    plain, turned = (counted * torso[part] for part in ("plain", "turned"))
    parts = {
        "none": (1 - arms - body) * plain[:, None] * arm["own"],
        "arms": arms * plain[:, None] * arm["other"],
        "body": body * turned[:, None] * arm["other"],
    }
    weight = parts["none"] + parts["arms"] + parts["body"]
    wrist = (1 - arms - body) * plain[:, None] * arm["own_out"]
    wrist += (arms * plain + body * turned)[:, None] * arm["other_out"]
    hip = np.divide(torso["left_hip"], torso["plain"], out=np.zeros(len(plain)), where=plain > 0)
    hips = hip[:, None] * (parts["none"] + parts["arms"])
    each = weight.mean(axis=1)
    mean = each.sum()
    # Of n independent terms n · variance is their sum of squares, but for mean²/n.
    error = math.sqrt(np.sum(each**2))
    some = weight.ravel() > 0

    def given_all(part: np.ndarray) -> np.ndarray:
        return part.ravel()[some] / weight.ravel()[some]

    shares = [given_all(part) for part in (wrist, hips, parts["arms"], parts["body"])]
    flags = np.column_stack([values[some, -1], *shares])
    cluster = np.repeat(np.arange(len(plain)), weight.shape[1])[some]
    told = moments(weight.ravel()[some], values[some, :-1], flags, cluster)
    return Moments(math.log(mean), error / mean, *told)


class Candidate(NamedTuple):
    """A fixed root: the torso `(6, 3)` in camera axes, scale, where the pelvis is seen, and the
    weight that its torso has beside the others'."""

    torso: np.ndarray
    scale: float
    pelvis: np.ndarray


FIXED_NAMES = ("upper arm", "forearm", "elbow x", "elbow z", "wrist x", "wrist z")


def under_candidates(
    case: SmallCase,
    candidates: tuple[Candidate, ...],
    rows: Mapping[Any, tuple[Beliefs, Beliefs]],
    number: int,
    seed: int,
) -> dict[Any, Moments]:
    """The paper's posterior: a mixture over candidates, each as probable before as its torso is
    likely; beliefs of a row are those of limbs, and those of torsos (scores are normalised among
    either). The evidence is that of the limbs over the mixture's peak, by which it is quoted."""
    rng = np.random.default_rng(seed)
    found: dict[Any, list[tuple[float, np.ndarray]]] = {name: [] for name in rows}
    values = []
    for candidate in candidates:
        size, joints = propose_group(
            case.limits, case.lengths, candidate.torso, "arms", number, rng
        )
        elbow, wrist = (joints[ROW[name]] for name in ARM)
        values.append(np.column_stack([size, elbow[:, [0, 2]], wrist[:, [0, 2]]]))
        for name, (limbs, torsos) in rows.items():
            prior = 1.0
            for keypoint, point in zip(TORSO_ROWS, candidate.torso, strict=True):
                if keypoint in TORSO:
                    prior *= _density(case, candidate, point[None], keypoint, torsos)[0]
            likely = np.ones(number)
            for keypoint, points in zip(ARM, (elbow, wrist), strict=True):
                likely = likely * _density(case, candidate, points, keypoint, limbs)
            peak = math.prod(
                DENSITIES[limbs.law](np.zeros(1))[0] / (limbs.spread[one] * candidate.scale) ** 2
                for one in ARM
            )
            found[name].append((prior * peak, prior * likely))
    result = {}
    for name, parts in found.items():
        weight = np.concatenate([likely for _, likely in parts])
        some = weight > 0
        which = np.repeat(np.arange(len(parts)), number)
        scale = sum(peak for peak, _ in parts)
        variance = sum(np.var(likely) / number for _, likely in parts)
        mean = sum(np.mean(likely) for _, likely in parts)
        flags = (which == 0)[some, None].astype(float)
        told = moments(weight[some], np.concatenate(values)[some], flags, np.flatnonzero(some))
        result[name] = Moments(math.log(mean / scale), math.sqrt(variance) / mean, *told)
    return result


def _density(
    case: SmallCase, candidate: Candidate, points: np.ndarray, name: str, given: Beliefs
) -> np.ndarray:
    image = candidate.scale * points[:, :2] + candidate.pelvis
    unit = np.full(len(points), candidate.scale)
    return odds(image, unit, case.at[name], name, given).inlier
