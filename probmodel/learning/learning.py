"""Learning an anatomy from motion capture: occupancy tables, planes and boxes, bone lengths,
torsos.

The criterion is Akhter & Black's (CVPR 2015): what was seen is possible, so every training pose is
valid under the limits learned from it. What was not seen is possible as far as a stated tolerance
goes (`Tolerance`). The usual way in: `learn_from(paths)`, or `learn(motions)` on recordings that
were read already."""

import dataclasses
import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import cKDTree

from probmodel.anatomy.lengths import LengthPrior
from probmodel.anatomy.limits import CELL, GRID, NUM_AZIMUTH, NUM_ELEVATION, AnatomicalLimits
from probmodel.anatomy.population import Anatomy
from probmodel.failures import BadInput
from probmodel.kinematics import articulation
from probmodel.learning.overlap import cell_areas, cell_centres, fibonacci
from probmodel.motion import Motion, read_motion
from probmodel.skeleton import (
    BONES,
    LENGTH_GROUPS,
    LOWER_BONES,
    MIRROR,
    NUM_LENGTHS,
    NUM_LOWER,
    NUM_UPPER,
    TORSO_INDEX,
    UPPER_BONES,
)

REFERENCE = np.array([1.0, 0.0, 0.0])
"""The line through the shoulders or hips: only a limb stretched out exactly sideways is parallel to
it, and limits learned from mirrored poses are mirror images of each other."""
FALLBACK = np.tile([0.0, 1.0, 0.0], (NUM_LOWER, 1))
SPINNING = 20.0
"""Degrees from the reference within which a lower frame turns by more than a few degrees inside one
parent cell."""
LEARNING_RATE = 30.0
"""Frames a second that are learned from; neighbouring frames of 120 Hz capture say the same."""
Progress = Callable[[str, int, int], None]
"""Called with what is being done, steps done, and steps in all."""


@dataclasses.dataclass(frozen=True)
class Tolerance:
    """How far beyond what was seen a bone may go. Degrees, but for `samples`.

    `head`, `arm`, `leg`: an upper bone's direction this close to a seen one is possible. `closing`:
    gaps between possible directions that are narrower than twice this are filled (dilation, then
    erosion), and so are holes without a way out. `neighbourhood`: a lower bone is judged by what
    was seen while its parent was this close, or as close as the `samples` nearest distinct
    observations where there are fewer. `lower`: margin around planes and boxes."""

    head: float = 4.0
    arm: float = 10.0
    leg: float = 8.0
    closing: float = 10.0
    neighbourhood: float = 25.0
    samples: int = 30
    lower: float = 4.0

    def __post_init__(self) -> None:
        values = dataclasses.asdict(self)
        bad = [
            name
            for name, value in values.items()
            if not 0 <= value <= (np.inf if name == "samples" else 90)
        ]
        if bad or self.samples < 1:
            raise BadInput(
                f"the tolerance {(bad or ['samples'])[0]} is {values[(bad or ['samples'])[0]]}; "
                "degrees are 0 to 90, samples at least 1"
            )

    @property
    def upper(self) -> tuple[float, ...]:
        """`head`, `arm` or `leg`, in the order of `skeleton.UPPER_BONES`."""
        return tuple(getattr(self, bone.name.rsplit("_", 1)[-1]) for bone in UPPER_BONES)


class Poses(NamedTuple):
    """Cleaned poses of all subjects: `joints` `(N, 15, 3)` in body units, and the index of the
    subject `(N,)`."""

    joints: np.ndarray
    subject: np.ndarray


def learn_from(
    paths: Sequence[str | os.PathLike], progress: Progress | None = None, **settings: object
) -> Anatomy:
    """Reads motion capture (`read_all`) and learns from all of it; `settings` are those of
    `learn`."""
    return learn(read_all(paths, progress), progress=progress, **settings)  # type: ignore[arg-type]


def read_all(paths: Sequence[str | os.PathLike], progress: Progress | None = None) -> list[Motion]:
    """All recordings of several files and folders of motion capture (`motion.read_motion`)."""
    motions: list[Motion] = []
    for done, path in enumerate(paths):
        if progress is not None:
            progress(f"reading {path}", done, len(paths))
        motions += read_motion(path)
    return motions


def learn(
    motions: Sequence[Motion],
    *,
    tolerance: Tolerance = Tolerance(),
    mirror: bool = True,
    num_torsos: int = 48,
    name: str = "learned",
    progress: Progress | None = None,
) -> Anatomy:
    """Limits, lengths and torsos from recordings; glitches are dropped, and `mirror` adds every
    pose's mirror image.

    Raises `BadInput` where no usable frame is left or a bone has length zero.
    """
    poses = gather(motions)
    limits = learn_limits(poses.joints, tolerance, mirror=mirror, name=name, progress=progress)
    lengths = learn_lengths(poses)
    torsos = learn_torsos(poses.joints, num_torsos, mirror=mirror)
    return Anatomy(limits, LengthPrior(*(single(field) for field in lengths)), single(torsos))


def single(values: ArrayLike) -> np.ndarray:
    """Rounded to float32, in which tables are stored, so that storing loses nothing."""
    return np.asarray(values).astype(np.float32).astype(np.float64)


# --- poses
# -----------------------------------------------------------------------------------------------------------


def gather(motions: Sequence[Motion]) -> Poses:
    """Drops glitches, thins to 30 Hz, and scales each subject to body units (mean limb bone length
    1)."""
    by_subject: dict[str, list[np.ndarray]] = {}
    for motion in motions:
        joints = motion.without_jumps().at_rate(LEARNING_RATE).joints
        if len(joints):
            by_subject.setdefault(motion.subject, []).append(joints)
    if not by_subject:
        raise BadInput(
            "the motion capture holds no usable frame; give recordings of at least a tenth of a"
            " second"
        )
    blocks = [np.concatenate(blocks) for blocks in by_subject.values()]
    for subject, block in zip(by_subject, blocks, strict=True):
        if not (bone_lengths(block) > 0).all():
            raise BadInput(
                f"subject {subject} has a bone of length zero in a frame; leave that recording out"
            )
    joints = np.concatenate([(block - block[:, :1]) / body_unit(block) for block in blocks])
    return Poses(joints, np.repeat(np.arange(len(blocks)), [len(block) for block in blocks]))


def bone_lengths(joints: np.ndarray) -> np.ndarray:
    """Lengths `(N, 9)` of `skeleton.BONES` in poses `(N, 15, 3)`."""
    starts, ends = [bone.start for bone in BONES], [bone.end for bone in BONES]
    return np.linalg.norm(joints[:, starts] - joints[:, ends], axis=-1)


def body_unit(joints: np.ndarray) -> float:
    """Mean length of the eight limb bones over poses `(N, 15, 3)` of one subject."""
    limbs = [i for i, bone in enumerate(BONES) if bone.name != "head"]
    return float(bone_lengths(joints)[:, limbs].mean())


def mirror_pose(joints: np.ndarray) -> np.ndarray:
    """The mirror image of poses `(..., 15, 3)`: x is negated, left and right exchange their
    names."""
    return joints[..., list(MIRROR), :] * np.array([-1.0, 1.0, 1.0])


# --- limits
# ----------------------------------------------------------------------------------------------------------


def learn_limits(
    joints: np.ndarray,
    tolerance: Tolerance,
    *,
    mirror: bool = True,
    name: str = "learned",
    progress: Progress | None = None,
) -> AnatomicalLimits:
    """Limits from poses `(N, 15, 3)`, in which all of them are valid; with `mirror`, their mirror
    images are too, and the tables of the left side are the mirror image of those of the right."""
    if mirror:
        joints = np.concatenate([joints, mirror_pose(joints)])
    with jax.enable_x64(True):
        local = articulation(joints, REFERENCE, FALLBACK)
        upper, lower = np.asarray(local.upper), np.asarray(local.lower)
    tables = {key: np.full((NUM_LOWER, *GRID, *shape), np.nan) for key, shape in _TABLES.items()}
    occupied = np.zeros((NUM_UPPER, *GRID), bool)
    for bone, radius in enumerate(tolerance.upper):
        occupied[bone] = occupancy(upper[:, bone], radius, tolerance.closing)
    for bone, part in enumerate(LOWER_BONES):
        if progress is not None:
            progress(f"limits of the {part.name.replace('_', ' ')}", bone, NUM_LOWER)
        if mirror and part.name.startswith("left"):
            _mirror_tables(occupied, tables, bone)
        else:
            _learn_lower(
                tables,
                bone,
                np.argwhere(occupied[bone + 1]),
                upper[:, bone + 1],
                lower[:, bone],
                tolerance,
            )
    if mirror:
        occupied[0] |= _mirror_cells(occupied[0])
    if progress is not None:
        progress("limits", NUM_LOWER, NUM_LOWER)
    return AnatomicalLimits(
        occupied=occupied,
        **{key: single(table) for key, table in tables.items()},
        reference=REFERENCE,
        fallback=FALLBACK,
        name=name,
    )


_TABLES: dict[str, tuple[int, ...]] = {
    "normal": (3,),
    "tangent": (3,),
    "offset": (),
    "bounds": (4,),
}


def _learn_lower(
    tables: dict[str, np.ndarray],
    bone: int,
    cells: np.ndarray,
    parent: np.ndarray,
    lower: np.ndarray,
    tolerance: Tolerance,
) -> None:
    seen = Observations.gather(parent, lower)
    for column, row in cells:
        fit = fit_cell(seen.around(column, row, tolerance), tolerance.lower)
        for key, table in tables.items():
            table[bone, column, row] = getattr(fit, key)


def _mirror_cells(table: np.ndarray) -> np.ndarray:
    """A table `(120, 60, ...)` of the other side: mirrored directions have azimuth 180° minus the
    azimuth."""
    return table[(NUM_AZIMUTH // 2 - 1 - np.arange(NUM_AZIMUTH)) % NUM_AZIMUTH]


def _mirror_tables(occupied: np.ndarray, tables: dict[str, np.ndarray], left: int) -> None:
    """Fills a left limb's tables from those of the right limb, which come one before them.

    Mirrored, a local frame (u, v, w) of a lower bone becomes (u, v, −w), since v = reference × u
    and the reference is the mirrored axis. So third components change their sign, and with the
    handedness of the plane's triple so does e3."""
    occupied[left + 1] = _mirror_cells(occupied[left])
    for table in tables.values():
        table[left] = _mirror_cells(table[left - 1])
    for key in ("normal", "tangent"):
        tables[key][left, ..., 2] *= -1
    tables["bounds"][left] = tables["bounds"][left][..., [0, 1, 3, 2]] * np.array([1, 1, -1, -1])


def _cell_points(column: ArrayLike, row: ArrayLike) -> np.ndarray:
    """Unit vectors `(..., 3)` at places in the grid of cells; a half is the middle of a cell."""
    azimuth, elevation = np.asarray(column) * CELL - np.pi, np.asarray(row) * CELL - np.pi / 2
    planar = np.cos(elevation)
    return np.stack(
        [planar * np.cos(azimuth), planar * np.sin(azimuth), np.sin(elevation)], axis=-1
    )


def cells_of(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `limits.cell_of`, on the host."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    column = np.floor((np.arctan2(y, x) + np.pi) / CELL).astype(int) % NUM_AZIMUTH
    row = np.floor((np.arctan2(z, np.hypot(x, y)) + np.pi / 2) / CELL).astype(int)
    return column, np.clip(row, 0, NUM_ELEVATION - 1)


def _chord(degrees: float) -> float:
    return 2 * np.sin(np.radians(degrees) / 2)


def occupancy(vectors: np.ndarray, radius: float, closing: float) -> np.ndarray:
    """Occupied cells `(120, 60)` from unit vectors `(N, 3)`: those that hold one or whose centre
    lies within `radius` degrees of one, closed by `closing` degrees, without holes."""
    seen = np.zeros(GRID, bool)
    seen[cells_of(vectors)] = True
    # A thousandth of a radian is far below a cell; thinning makes the search ten times faster.
    grown = seen | _within(np.unique(vectors.round(3), axis=0), radius)
    centres = cell_centres()
    dilated = grown | _within(centres[grown], closing)
    closed = dilated if dilated.all() else grown | (dilated & ~_within(centres[~dilated], closing))
    return _fill_holes(closed)


def _within(vectors: np.ndarray, degrees: float) -> np.ndarray:
    """Cells `(120, 60)` whose centres lie within `degrees` of one of `vectors` `(N, 3)`."""
    distance, _ = cKDTree(vectors).query(
        cell_centres().reshape(-1, 3), distance_upper_bound=_chord(degrees)
    )
    return np.isfinite(distance).reshape(GRID)


def _fill_holes(occupied: np.ndarray) -> np.ndarray:
    """Occupies every free patch but the largest; patches are connected across azimuth ±180° and
    over the poles."""
    labels, count = ndimage.label(~np.pad(occupied, ((1, 1), (0, 0)), mode="wrap"))
    labels, areas = labels[1:-1], cell_areas()
    graph = np.arange(count + 1)
    pairs = list(zip(labels[0], labels[-1], strict=True))
    for row in (labels[:, 0], labels[:, -1]):
        free = row[row > 0]
        pairs += [(free[0], label) for label in free[1:]]
    for a, b in pairs:
        if a and b and graph[a] != graph[b]:
            graph[graph == graph[b]] = graph[a]
    labels = graph[labels]
    sizes = np.bincount(labels.ravel(), weights=areas.ravel(), minlength=count + 1)
    sizes[0] = 0
    return occupied | (labels != sizes.argmax())


class Observations(NamedTuple):
    """What was seen of a lower bone: parent directions and the bone's own direction, both `(N,
    3)`."""

    parent: np.ndarray
    lower: np.ndarray
    thinned: np.ndarray
    """Indices of distinct observations: one for each pair of cubes (`_cubes`)."""
    tree: cKDTree
    by_cell: dict[int, np.ndarray]

    @classmethod
    def gather(cls, parent: np.ndarray, lower: np.ndarray) -> "Observations":
        """From local unit vectors `(N, 3)` each."""
        own = np.ravel_multi_index(cells_of(parent), GRID)
        thinned = np.unique(_cubes(parent) * CUBES**3 + _cubes(lower), return_index=True)[1]
        order = np.argsort(own, kind="stable")
        cells, first = np.unique(own[order], return_index=True)
        by_cell = dict(zip(cells.tolist(), np.split(order, first[1:]), strict=True))
        return cls(parent, lower, thinned, cKDTree(parent[thinned]), by_cell)

    def around(self, column: int, row: int, tolerance: Tolerance) -> np.ndarray:
        """Directions `(n, 3)` of the lower bone, in the local frame, seen in and near a cell of the
        parent."""
        centre = _cell_points(column + 0.5, row + 0.5)
        far = np.max(self.tree.query(centre, k=min(tolerance.samples, len(self.thinned)))[0])
        radius = max(far * (1 + 1e-9), _chord(tolerance.neighbourhood))
        carried = self._carried(
            self.thinned[self.tree.query_ball_point(centre, radius)], column, row
        )
        own = self.by_cell.get(column * NUM_ELEVATION + row)
        return carried if own is None else np.concatenate([carried, self.lower[own]])

    def _carried(self, near: np.ndarray, column: int, row: int) -> np.ndarray:
        """Neighbours' directions as seen from the cell: the lower bone is carried along when its
        parent swings there by the shortest way, because the local frame itself spins fast where the
        parent nears the reference."""
        in_torso = np.einsum("nij,nj->ni", local_frames(self.parent[near]), self.lower[near])
        corners = np.array([(0.5, 0.5), (0.1, 0.1), (0.1, 0.9), (0.9, 0.1), (0.9, 0.9)])
        points = _cell_points(column + corners[:, 0], row + corners[:, 1])
        if abs(points[0] @ REFERENCE) < np.cos(np.radians(SPINNING)):
            points = points[:1]
        moved = [
            local_frames(point[None])[0].T @ _swing(self.parent[near], in_torso, point).T
            for point in points
        ]
        return np.concatenate([directions.T for directions in moved])


def local_frames(parent: np.ndarray) -> np.ndarray:
    """`frames.lower_frame` of parent directions `(N, 3)`, on the host: `(N, 3, 3)`, columns u, v,
    w."""
    v = np.cross(REFERENCE, parent)
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    v = np.where(size > 1e-8, v / np.maximum(size, 1e-300), np.cross(parent, FALLBACK[0]))
    return np.stack([parent, v, np.cross(parent, v)], axis=-1)


def _swing(start: np.ndarray, vectors: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Turns each of `vectors` `(N, 3)` by the shortest rotation that takes its unit vector of
    `start` to `end` `(3,)`.

    Rodrigues' formula with axis s × e: x cos + (axis × x) + axis (axis·x) / (1 + cos).
    """
    axis = np.cross(start, end)
    cosine = start @ end
    along = np.einsum("ni,ni->n", axis, vectors) / np.maximum(1 + cosine, 1e-6)
    return vectors * cosine[:, None] + np.cross(axis, vectors) + axis * along[:, None]


class CellFit(NamedTuple):
    """Plane and box of one cell, as in `limits.AnatomicalLimits`."""

    normal: np.ndarray
    tangent: np.ndarray
    offset: float
    bounds: np.ndarray


def fit_cell(directions: np.ndarray, margin: float) -> CellFit:
    """The plane that cuts off the largest cap without directions `(n, 3)`, a hemisphere at most,
    and the smallest box around them in it; both moved outwards by `margin` degrees."""
    coarse = _thin(directions)
    normal = largest_empty_cap(coarse)
    tangent = smallest_box(coarse, normal)
    offset = min(0.0, -_widen((directions @ normal).max(), margin))
    across, along = directions @ tangent, directions @ np.cross(normal, tangent)
    bounds = [
        _widen(across.min(), -margin),
        _widen(across.max(), margin),
        _widen(along.min(), -margin),
        _widen(along.max(), margin),
    ]
    return CellFit(normal, tangent, offset, np.array(bounds))


CUBES = 32
"""Observations that share a cube, of which this many divide [−1, 1], are one: 3.6° on a side."""


def _cubes(directions: np.ndarray) -> np.ndarray:
    """Index `(n,)` of the cube in which each of `directions` `(n, 3)` lies."""
    return np.clip(
        np.floor((directions + 1) * (CUBES / 2)).astype(int), 0, CUBES - 1
    ) @ CUBES ** np.arange(3)


def _thin(directions: np.ndarray) -> np.ndarray:
    """One of `directions` for each cube: enough to place a plane, whose offset is then exact."""
    return directions[np.unique(_cubes(directions), return_index=True)[1]]


def _widen(value: float, degrees: float) -> float:
    """The sine of an angle, moved by `degrees`; at most a right angle."""
    angle = np.arcsin(np.clip(value, -1, 1)) + np.radians(degrees)
    return float(np.sin(np.clip(angle, -np.pi / 2, np.pi / 2)))


_COARSE = fibonacci(1500)
_FINE = fibonacci(40_000)
_FINE = _FINE[_FINE[:, 2] > np.cos(np.radians(5))]


def largest_empty_cap(directions: np.ndarray) -> np.ndarray:
    """Centre `(3,)` of the largest spherical cap without any of `directions` `(n, 3)`: the plane
    with the smallest |d| has it as its normal. Where all directions fit in a hemisphere, the cap is
    larger than one, and its centre is opposite to the middle of the directions. Found to within 3°:
    candidates are 5° apart, the best is refined."""
    coarse = _COARSE[(directions @ _COARSE.T).max(axis=0).argmin()]
    fine = _swing(np.tile([0.0, 0.0, 1.0], (len(_FINE), 1)), _FINE, coarse)
    normal = fine[(directions @ fine.T).max(axis=0).argmin()]
    return normal / np.linalg.norm(normal)


def smallest_box(directions: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The tangent `(3,)` of the plane in which the box around projected `directions` `(n, 3)` has
    the least area."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angles = np.radians(np.arange(0, 90, 2))
    cosine, sine = np.cos(angles), np.sin(angles)
    x, y = directions @ first, directions @ second
    across, along = np.outer(x, cosine) + np.outer(y, sine), np.outer(y, cosine) - np.outer(x, sine)
    best = (np.ptp(across, axis=0) * np.ptp(along, axis=0)).argmin()
    return cosine[best] * first + sine[best] * second


# --- lengths
# ---------------------------------------------------------------------------------------------------------

SPREAD_FLOOR = 0.05
"""Least standard deviation of a bone length, as a share of its mean. Tables of human proportions
(segment lengths over stature) give some 3–6 %, more than a handful of subjects can show."""
ALLOWANCE = 2.0
"""The range reaches this many standard deviations beyond the shortest and the longest that was
seen."""


def learn_lengths(poses: Poses) -> LengthPrior:
    """Ranges and Beta distributions of the five length groups, by moments; each subject counts
    alike.

    Limb bones of a recording are rigid, so a limb length's spread is between subjects. The head's
    bone is a chain, whose length varies with the pose as well; its spread includes that."""
    groups = [
        [i for i, bone in enumerate(BONES) if bone.length_group == group]
        for group in range(NUM_LENGTHS)
    ]
    lengths = bone_lengths(poses.joints)
    by_subject = [
        np.stack(
            [lengths[poses.subject == subject][:, group].mean(axis=-1) for group in groups], axis=-1
        )
        for subject in np.unique(poses.subject)
    ]
    means = _distinct(np.stack([length.mean(axis=0) for length in by_subject]))
    mean = means.mean(axis=0)
    within = np.mean([length.var(axis=0) for length in by_subject], axis=0)
    between = means.var(axis=0, ddof=1) if len(means) > 1 else np.zeros(NUM_LENGTHS)
    spread = np.maximum(np.sqrt(within + between), SPREAD_FLOOR * mean)
    low = np.min([length.min(axis=0) for length in by_subject], axis=0) - ALLOWANCE * spread
    high = np.max([length.max(axis=0) for length in by_subject], axis=0) + ALLOWANCE * spread
    low = np.maximum(low, 0.1 * mean)
    share, variance = (mean - low) / (high - low), (spread / (high - low)) ** 2
    strength = np.maximum(share * (1 - share) / variance - 1, 2.0)
    return LengthPrior(low, high, share * strength, (1 - share) * strength)


def _distinct(means: np.ndarray) -> np.ndarray:
    """Subjects `(S, 5)` whose lengths are not those of an earlier one to 0.1 %: some data sets
    share a skeleton."""
    keep: list[np.ndarray] = []
    for mean in means:
        if all(np.abs(mean[1:] / other[1:] - 1).max() > 1e-3 for other in keep):
            keep.append(mean)
    return np.stack(keep)


# --- torsos
# ----------------------------------------------------------------------------------------------------------


def learn_torsos(joints: np.ndarray, count: int, *, mirror: bool) -> np.ndarray:
    """A dictionary `(count, 6, 3)` of torsos that were seen, each the nearest to one centre of
    k-means.

    Torsos are in body axes: turned about the pelvis onto their mean (Procrustes), whose y axis runs
    to its thorax and whose x axis to its left. With `mirror`, half of the dictionary is the mirror
    image of the other half."""
    from sklearn.cluster import KMeans  # It takes a second to import, and only learning needs it.

    torsos = joints[:, list(TORSO_INDEX)]
    everything = np.concatenate([torsos, mirror_torso(torsos)]) if mirror else torsos
    torsos = _aligned(torsos, mean_torso(everything))
    clusters = min(count // 2 if mirror else count, len(torsos))
    flat = torsos.reshape(len(torsos), -1)
    centres = KMeans(clusters, n_init=4, random_state=0).fit(flat).cluster_centers_
    nearest = np.unique(cKDTree(flat).query(centres)[1])
    chosen = torsos[nearest]
    return np.concatenate([chosen, mirror_torso(chosen)]) if mirror else chosen


def mean_torso(torsos: np.ndarray) -> np.ndarray:
    """The mean `(6, 3)` of torsos `(N, 6, 3)`, in body axes, after each was turned onto it."""
    mean = _body_axes(torsos).mean(axis=0)
    for _ in range(5):
        mean = _body_axes(_aligned(torsos, mean).mean(axis=0)[None])[0]
    return mean


def mirror_torso(torsos: np.ndarray) -> np.ndarray:
    """The mirror image of torsos `(..., 6, 3)`."""
    return torsos[..., [0, 1, 3, 2, 5, 4], :] * np.array([-1.0, 1.0, 1.0])


def _body_axes(torsos: np.ndarray) -> np.ndarray:
    """Torsos `(N, 6, 3)` turned about the pelvis: y along pelvis→thorax, x towards the left
    shoulder and hip."""
    torsos = torsos - torsos[:, :1]
    up = torsos[:, 1] / np.linalg.norm(torsos[:, 1], axis=-1, keepdims=True)
    left = torsos[:, 3] - torsos[:, 2] + torsos[:, 5] - torsos[:, 4]
    left = left - np.sum(left * up, axis=-1, keepdims=True) * up
    left /= np.linalg.norm(left, axis=-1, keepdims=True)
    return np.einsum("naj,ntj->nta", np.stack([left, up, np.cross(left, up)], axis=1), torsos)


def _aligned(torsos: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Torsos `(N, 6, 3)` turned about the pelvis onto `mean` `(6, 3)`."""
    torsos = torsos - torsos[:, :1]
    return np.einsum("nab,ntb->nta", align_torsos(torsos, mean), torsos)


def align_torsos(torsos: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Rotations `(N, 3, 3)` about the pelvis, at the origin, of `torsos` `(N, 6, 3)` onto `mean`
    `(6, 3)` (Kabsch)."""
    u, _, vt = np.linalg.svd(np.einsum("ta,ntb->nab", mean, torsos))
    sign = np.sign(np.linalg.det(u @ vt))
    u[..., -1] *= sign[:, None]
    return u @ vt


assert [bone.length_group for bone in UPPER_BONES[:1]] == [LENGTH_GROUPS.index("head")]
