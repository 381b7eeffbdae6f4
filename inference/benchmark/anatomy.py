"""The prior of a pose in plain NumPy, on tables that are frozen with the benchmark: fractions in
[0, 1] become lengths and directions, and these become joints.

It says what `probmodel` says (docs/model.md § 2, measures "angle" and "area") and shares no code
with it, so that a target needs neither JAX nor a compiler, and a change of either is seen by the
other: `tests/inference/test_benchmark.py` holds the two together. The usual way in:
`FrozenAnatomy.default()`.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from math import lgamma

import numpy as np

from poseterior.probmodel.arrays import read_tables
from poseterior.probmodel.skeleton import (
    BONES,
    JOINT_INDEX,
    NUM_JOINTS,
    NUM_LENGTHS,
    NUM_LOWER,
    NUM_UPPER,
    TORSO_INDEX,
    Limb,
)

NUM_AZIMUTH, NUM_ELEVATION = 120, 60
CELL = np.pi / 60
"""Side of a cell of an upper bone's table, in azimuth and in elevation."""
CUBE_DIM = NUM_LENGTHS + 2 * NUM_UPPER + 2 * NUM_LOWER
"""Fractions of a pose: five lengths, two for each upper bone, two for each lower bone."""
PARALLEL = 1e-8
"""Below this sine of the angle between parent and reference direction, the fallback counts."""
ITERATIONS = 80
_EPS = float(np.finfo(float).eps)
ANATOMY_FILE = "anatomy.npz"
"""The tables in `inference.benchmark.data`: a file of `probmodel.Anatomy`."""
Rising = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Of places x and the rows they belong to: the function's values there, and its slopes."""


def column_of_upper(bone: int) -> int:
    """Where the two fractions of an upper bone begin."""
    return NUM_LENGTHS + 2 * bone


def column_of_lower(bone: int) -> int:
    """Where the two fractions of a lower bone begin."""
    return NUM_LENGTHS + 2 * (NUM_UPPER + bone)


def root(square: np.ndarray) -> np.ndarray:
    """Square root, 0 below zero."""
    return np.sqrt(np.maximum(square, 0.0))


def cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Cross products `(..., 3)`; a fifth of NumPy's own time for a single one."""
    a = one[..., 0]
    b = one[..., 1]
    c = one[..., 2]
    x = other[..., 0]
    y = other[..., 1]
    z = other[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


@dataclass(frozen=True)
class Lengths:
    """Bone lengths of the five groups: `low + (high - low) · Beta(alpha, beta)`, `(5,)` each, body
    units (eq. 6)."""

    low: np.ndarray
    high: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray

    def at(self, fractions: np.ndarray) -> np.ndarray:
        """Lengths `(..., 5)` at fractions of the ranges."""
        return np.clip(self.low + (self.high - self.low) * fractions, self.low, self.high)

    @functools.cached_property
    def log_constants(self) -> np.ndarray:
        """`(5,)`: logs of the Beta densities' constants."""
        pairs = zip(self.alpha.tolist(), self.beta.tolist(), strict=True)
        return np.array([lgamma(a + b) - lgamma(a) - lgamma(b) for a, b in pairs])


@dataclass(frozen=True)
class UpperBones:
    """Directions of the upper bones, uniform in both angles on the occupied cells (eq. 7).

    `columns` `(5, 121)`: running sums of occupied cells over azimuth; `rows` `(5, 120, 61)`: over
    elevation, within each azimuth.
    """

    columns: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, occupied: np.ndarray) -> "UpperBones":
        """The cells of tables `(5, 120, 60)` bool."""
        rows = _running_sums(np.where(occupied, CELL**2, 0.0))
        return cls(_running_sums(rows[..., -1]), rows)

    def transport(self, bone: int, square: np.ndarray) -> np.ndarray:
        """Unit vectors `(n, 3)` in the torso's local axes at points `(n, 2)` of the unit square."""
        columns = np.broadcast_to(self.columns[bone], (len(square), NUM_AZIMUTH + 1))
        column, across = _pick(columns, square[:, 0])
        row, along = _pick(self.rows[bone, column], square[:, 1])
        azimuth = (column + across) * CELL - np.pi
        elevation = (row + along) * CELL - np.pi / 2
        planar = np.cos(elevation)
        return np.stack(
            [planar * np.cos(azimuth), planar * np.sin(azimuth), np.sin(elevation)], axis=-1
        )


def cell_of(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth and elevation indices `(n,)` of the cells in which unit vectors `(n, 3)` lie."""
    x, y, z = vector.T
    azimuth = np.arctan2(y, x)
    elevation = np.arctan2(z, np.hypot(x, y))
    column = np.floor((azimuth + np.pi) / CELL).astype(int) % NUM_AZIMUTH
    row = np.floor((elevation + np.pi / 2) / CELL).astype(int)
    return column, np.clip(row, 0, NUM_ELEVATION - 1)


def _running_sums(weight: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((*weight.shape[:-1], 1)), np.cumsum(weight, axis=-1)], axis=-1)


def _bin(sums: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Of rows of running sums `(n, k)`, the bin `(n,)` in which each target lies: the last one
    whose lower edge is at most the target, and never one beyond all that holds anything."""
    below = np.sum(sums <= target[:, None], axis=-1) - 1
    last = np.argmax(sums >= sums[:, -1:], axis=-1) - 1
    return np.clip(below, 0, np.maximum(last, 0))


def _pick(sums: np.ndarray, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bin into which a fraction of the whole falls, and how far into it."""
    target = fraction * sums[:, -1]
    index = _bin(sums, target)
    rows = np.arange(len(sums))
    start = sums[rows, index]
    width = sums[rows, index + 1] - sums[rows, index]
    return index, np.clip((target - start) / np.where(width > 0, width, 1.0), 0.0, 1.0)


@dataclass(frozen=True)
class LowerBones:
    """Directions of the lower bones, uniform per steradian on what a plane and a box leave of the
    sphere (eq. 8), for every cell of the parent that has a plane.

    `number` `(4, 120, 60)`: which hinge belongs to a cell, -1 for none. Of each hinge: `triple`
    `(h, 3, 3)`, rows n, e2, e3; `offset` `(h,)`; `bounds` `(h, 4)`; `nodes` `(h, 12)`, values of
    u2 between which the ends of the intervals are smooth; `pattern` `(h, 11, 4)`, how the
    intervals' total length is made of `ends` between two nodes; `areas` `(h, 12)`, the area below
    each node, steradians.
    """

    number: np.ndarray
    triple: np.ndarray
    offset: np.ndarray
    bounds: np.ndarray
    nodes: np.ndarray
    pattern: np.ndarray
    areas: np.ndarray

    @classmethod
    def of(
        cls,
        has_plane: np.ndarray,
        normal: np.ndarray,
        tangent: np.ndarray,
        offset: np.ndarray,
        bounds: np.ndarray,
    ) -> "LowerBones":
        """From the tables of the cells that have a plane, in their order."""
        number = np.where(has_plane, np.cumsum(has_plane).reshape(has_plane.shape) - 1, -1)
        first = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        second = tangent - np.sum(tangent * first, axis=-1, keepdims=True) * first
        second = second / np.linalg.norm(second, axis=-1, keepdims=True)
        triple = np.stack([first, second, cross(first, second)], axis=-2)
        nodes = _nodes(offset, bounds)
        middles = (nodes[:, 1:] + nodes[:, :-1]) / 2
        pattern = _pattern(offset[:, None], bounds[:, None], middles)
        heights = primitives(offset[:, None], bounds[:, None], nodes)
        rises = np.sum(pattern * np.diff(heights, axis=1), axis=-1)
        areas = _running_sums(np.maximum(rises, 0.0))
        return cls(number, triple, offset, bounds, nodes, pattern, areas)

    def transport(self, bone: int, parent: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Unit vectors `(n, 3)` in the parent's local axes at points `(n, 2)` of the unit square,
        where the parent has the local direction `parent` `(n, 3)`."""
        hinge = self.number[(bone, *cell_of(parent))]
        offset = self.offset[hinge]
        bounds = self.bounds[hinge]
        u2 = self._quantile(hinge, square[:, 0])
        low, high = _intervals(offset, bounds, u2)
        length = np.maximum(high - low, 0.0)
        before = np.cumsum(length, axis=-1) - length
        rest = square[:, 1] * np.sum(length, axis=-1)
        count = np.sum((before <= rest[:, None]) & (length > 0), axis=-1)
        rows = np.arange(len(u2))
        full_first = np.argsort(length <= 0, axis=-1, kind="stable")
        which = full_first[rows, np.clip(count - 1, 0, 2)]
        start = low[rows, which]
        end = high[rows, which]
        place = np.clip(start + rest - before[rows, which], start, np.maximum(end, start))
        rho = root(1 - u2**2)
        u3 = rho * np.sin(place)
        u1 = root(rho**2 - u3**2)
        local = np.stack([np.where(which > 0, u1, -u1), u2, u3], axis=-1)
        return np.einsum("ni,nij->nj", local, self.triple[hinge])

    def _quantile(self, hinge: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """u2 `(n,)` below which this fraction of each hinge's area lies."""
        areas = self.areas[hinge]
        nodes = self.nodes[hinge]
        whole = areas[:, -1]
        target = fraction * whole
        piece = _bin(areas, target)
        rows = np.arange(len(hinge))
        offset = self.offset[hinge]
        bounds = self.bounds[hinge]
        pattern = self.pattern[hinge, piece]
        base = areas[rows, piece]
        low = nodes[rows, piece]
        high = nodes[rows, piece + 1]
        origin = np.sum(pattern * primitives(offset, bounds, low), axis=-1)
        rise = areas[rows, piece + 1] - base
        start = low + (high - low) * (target - base) / np.where(rise > 0, rise, 1.0)

        def below(u2: np.ndarray, some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            given = offset[some], bounds[some], u2
            area = np.sum(pattern[some] * primitives(*given), axis=-1)
            slope = np.sum(pattern[some] * ends(*given), axis=-1)
            return base[some] - origin[some] + area - target[some], slope

        return _newton(below, np.clip(start, low, high), low, high, 4 * _EPS * (1 + whole))


def _newton(
    below: Rising,
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    noise: np.ndarray,
) -> np.ndarray:
    """Zeros `(n,)` of functions that rise on [low, high], by Newton's method inside a shrinking
    bracket, until the function is as small as its rounding error `noise` or x stands still."""
    x = x.copy()
    low = low.copy()
    high = high.copy()
    left = np.arange(len(x))
    for _ in range(ITERATIONS):
        if not len(left):
            break
        error, slope = below(x[left], left)
        low[left] = np.where(error < 0, x[left], low[left])
        high[left] = np.where(error < 0, high[left], x[left])
        step = x[left] - error / np.maximum(slope, np.finfo(float).tiny)
        middle = (low[left] + high[left]) / 2
        after = np.where((step >= low[left]) & (step <= high[left]), step, middle)
        exact = np.abs(error) <= noise[left]
        narrow = high[left] - low[left] <= 2 * _EPS
        done = exact | narrow | (np.abs(after - x[left]) <= 2 * _EPS)
        x[left] = np.where(exact, x[left], after)
        left = left[~done]
    return x


def _nodes(offset: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """`(h, 12)`: where an end meets the rim of the disc, the plane the rim, or an end the plane,
    within the bounds of u2."""
    first = np.maximum(bounds[:, 0], -1.0)
    last = np.minimum(bounds[:, 1], 1.0)
    squares = bounds[:, 2:] ** 2
    plane = offset[:, None] ** 2
    kinks = root(1 - np.concatenate([squares, plane, squares + plane], axis=-1))
    inner = np.clip(np.concatenate([-kinks, kinks], axis=-1), first[:, None], last[:, None])
    return np.concatenate([first[:, None], np.sort(inner, axis=-1), last[:, None]], axis=-1)


def _to_rim(level: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x clipped to where |x| ≤ √(1-c²), and √(1-x²-c²) there."""
    limit = root(1 - level**2)
    free = np.clip(x, -limit, limit)
    return free, root((limit - free) * (limit + free))


def _arctan(opposite: np.ndarray, adjacent: np.ndarray) -> np.ndarray:
    """arctan(opposite/adjacent) for adjacent ≥ 0; 0 at the origin."""
    return np.arctan2(opposite, np.where((opposite == 0) & (adjacent == 0), 1.0, adjacent))


def ends(offset: np.ndarray, bounds: np.ndarray, u2: np.ndarray) -> np.ndarray:
    """`(..., 4)`: at u2, the angles β at which the intervals can end: bnd3, bnd4, the plane in
    front, the plane behind."""
    levels = (bounds[..., 2], bounds[..., 3], np.abs(offset))
    low, high, plane = (_arctan(level, _to_rim(level, u2)[1]) for level in levels)
    quarter = np.full_like(plane, np.pi / 2)
    cut = quarter - plane
    front = np.where(offset > 0, cut, quarter)
    behind = np.where(offset < 0, cut, quarter)
    return np.stack([low, high, front, behind], axis=-1)


def primitives(offset: np.ndarray, bounds: np.ndarray, u2: np.ndarray) -> np.ndarray:
    """`(..., 4)`: integrals of `ends` over u2 from 0."""
    levels = (bounds[..., 2], bounds[..., 3], np.abs(offset))
    low, high, plane = (_arcsine_primitive(level, u2) for level in levels)
    quarter = np.pi / 2 * u2
    cut = quarter - plane
    front = np.where(offset > 0, cut, quarter)
    behind = np.where(offset < 0, cut, quarter)
    return np.stack(np.broadcast_arrays(low, high, front, behind), axis=-1)


def _arcsine_primitive(level: np.ndarray, x: np.ndarray) -> np.ndarray:
    """∫₀ˣ arcsin(clip(c/√(1-t²), -1, 1)) dt (docs/model.md § 2)."""
    free, rest = _to_rim(level, x)
    angle = free * _arctan(level, rest) + level * _arctan(free, rest) - _arctan(free * level, rest)
    return angle + np.sign(level) * np.pi / 2 * (x - free)


_LOW, _HIGH, _FRONT, _BEHIND = np.eye(4)


def _selection(found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper ends `(..., 3, 4)` of the intervals (in front, behind above, behind below) as
    coefficients of the `ends` `(..., 4)`."""
    low, high, front, behind = (found[..., column, None] for column in range(4))
    lower = [
        np.where(low >= -front, _LOW, -_FRONT),
        np.where(low >= behind, _LOW, _BEHIND),
        np.broadcast_to(_LOW, found.shape),
    ]
    upper = [
        np.where(high <= front, _HIGH, _FRONT),
        np.broadcast_to(_HIGH, found.shape),
        np.where(high <= -behind, _HIGH, -_BEHIND),
    ]
    return np.stack(lower, axis=-2), np.stack(upper, axis=-2)


def _intervals(
    offset: np.ndarray, bounds: np.ndarray, u2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Ends `(n, 3)`, `(n, 3)` of the intervals at u2; one with its ends the wrong way round is
    empty."""
    found = ends(offset, bounds, u2)
    lower, upper = _selection(found)
    return (
        np.einsum("nij,nj->ni", lower, found),
        np.einsum("nij,nj->ni", upper, found),
    )


def _pattern(offset: np.ndarray, bounds: np.ndarray, u2: np.ndarray) -> np.ndarray:
    """`(..., 4)`: the intervals' total length at u2 as coefficients of `ends`."""
    found = ends(offset, bounds, u2)
    lower, upper = _selection(found)
    each = upper - lower
    length = np.einsum("...ij,...j->...i", each, found)
    return np.sum(np.where(length[..., None] > 0, each, 0.0), axis=-2)


@dataclass(frozen=True)
class FrozenAnatomy:
    """All that the prior of a pose is made of; `reference` `(3,)` and `fallback` `(4, 3)` fix the
    axes of lower bones; `torsos` `(48, 6, 3)`, body axes, body units, are those of the
    dictionary."""

    lengths: Lengths
    upper: UpperBones
    lower: LowerBones
    reference: np.ndarray
    fallback: np.ndarray
    torsos: np.ndarray

    @classmethod
    @functools.cache
    def default(cls) -> "FrozenAnatomy":
        """That of the benchmark, read once."""
        with resources.as_file(
            resources.files("poseterior.inference.benchmark.data") / ANATOMY_FILE
        ) as path:
            tables = read_tables(path, "table of the benchmark", "install poseterior anew")
        shape = (NUM_LOWER, NUM_AZIMUTH, NUM_ELEVATION)
        occupied = np.unpackbits(tables["occupied"]).astype(bool).reshape(NUM_UPPER, *shape[1:])
        has_plane = np.unpackbits(tables["has_plane"]).astype(bool).reshape(shape)
        planes = (tables[key].astype(float) for key in ("normal", "tangent", "offset", "bounds"))
        lengths = (
            tables[f"length_{key}"].astype(float) for key in ("low", "high", "alpha", "beta")
        )
        return cls(
            Lengths(*lengths),
            UpperBones.of(occupied),
            LowerBones.of(has_plane, *planes),
            tables["reference"].astype(float),
            tables["fallback"].astype(float),
            tables["torsos"].astype(float),
        )

    def joints(
        self, view: np.ndarray, fractions: np.ndarray, limbs: tuple[Limb, ...]
    ) -> np.ndarray:
        """Forward kinematics.

        Parameters
        ----------
        view : `(6, 3)` or `(n, 6, 3)`
            The torso, or that of each, in the axes in which the joints are wanted, body units.
        fractions : `(n, 23)`
        limbs
            Those that are wanted; the joints of others are zero.

        Returns
        -------
        joints : `(n, 15, 3)`
        """
        joints = np.zeros((len(fractions), NUM_JOINTS, 3))
        joints[:, list(TORSO_INDEX)] = view
        axes = upper_axes(view)
        length = self.lengths.at(fractions[:, :NUM_LENGTHS])

        def hang(bone: int, directions: np.ndarray) -> None:
            one = BONES[bone]
            size = length[:, one.length_group, None]
            joints[:, one.end] = joints[:, one.start] - size * directions

        for limb in limbs:
            local_axes = axes[..., limb.upper, :, :]
            first = column_of_upper(limb.upper)
            parent = self.upper.transport(limb.upper, fractions[:, first : first + 2])
            hang(limb.upper, np.einsum("...ij,...j->...i", local_axes, parent))
            if limb.lower is None:
                continue
            first = column_of_lower(limb.lower)
            local = self.lower.transport(limb.lower, parent, fractions[:, first : first + 2])
            turned = lower_axes(parent, self.reference, self.fallback[limb.lower])
            hang(
                NUM_UPPER + limb.lower,
                np.einsum("...ij,...jk,...k->...i", local_axes, turned, local),
            )
        return joints


def upper_axes(view: np.ndarray) -> np.ndarray:
    """`(..., 5, 3, 3)`: local axes of the upper bones, columns, in the axes of the torsos `(..., 6,
    3)`."""
    pelvis, thorax, right_shoulder, left_shoulder, right_hip, left_hip = np.moveaxis(view, -2, 0)
    legs = (JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"])
    shoulders = _left_handed(right_shoulder - left_shoulder, pelvis - thorax)
    hips = _left_handed(right_hip - left_hip, pelvis - thorax)
    each = [hips if one.start in legs else shoulders for one in BONES[:NUM_UPPER]]
    return np.stack(each, axis=-3)


def _left_handed(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    u = u / np.linalg.norm(u, axis=-1, keepdims=True)
    v = v - np.sum(u * v, axis=-1, keepdims=True) * u
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return np.stack([u, v, -cross(u, v)], axis=-1)


def lower_axes(parent: np.ndarray, reference: np.ndarray, fallback: np.ndarray) -> np.ndarray:
    """`(n, 3, 3)`: local axes of a lower bone, columns, in those of its parent `(n, 3)`."""
    usual = cross(reference, parent)
    parallel = np.sum(usual**2, axis=-1, keepdims=True) < PARALLEL**2
    v = np.where(parallel, cross(parent, fallback), usual)
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return np.stack([parent, v, cross(parent, v)], axis=-1)
