"""Strata: where a limb may be, cut small, with a proven bound on each piece. Compiled; in body units.

A stratum is a bin of the shared lengths × a sub-cell of the upper bone's table × pieces of the lower bone's rectangle.
Given an upper direction and lengths, the directions that put the next joint into its disc lie in a rectangle of the
chart (x, α) whose area is dx dα (`rectangle`); its α range, in front and behind, is cut into pieces, and a piece is
dropped where the hinge allows nothing in it. Where the hinge's own box is smaller than what is left, that is the
stratum's region instead (mask 0). Weight: prior mass of the sub-cell × bound on the region's area / the hinge's area.

Bounds add up how far things can move inside a stratum: u by `chord`, the joint by that times the length, the disc's
centre by `shift`, the hinge's frame by `turn`. Nothing is estimated.
"""

import math
from typing import NamedTuple

import numpy as np

from inference.samplers.bins import alias_table
from inference.samplers.bounds import BLOCK, GEOMETRY, MASK, REGION, SIZE, STRIDE, WEIGHT, bound_regions
from inference.samplers.numbers import compiled, inlined
from inference.samplers.rectangles import SLACK
from probmodel.frames import PARALLEL
from probmodel.limits import CELL, NUM_ELEVATION

TRIPLE, OFFSET, BOUNDS, AREA, MASS, BOX, NUM_COLUMNS = 0, 9, 10, 14, 15, 16, 20
"""Columns of a limb's table: the hinge's triple, offset, bounds and area, the cell's prior mass, the hinge's box."""


Axes = tuple[float, float, float, float, float, float]
"""Reference direction of the lower frames and its fallback, as numbers."""


class Sight(NamedTuple):
    """A limb in front of a camera: `frame` `(3, 3)` its local frame in camera axes; `target` `(2, 2)` the detected
    joints minus its start, body units; `radius` `(2,)` of their discs, infinite where nothing was seen."""

    frame: np.ndarray
    target: np.ndarray
    radius: np.ndarray


class Build(NamedTuple):
    """What the model says of a limb. `cells` `(7200, NUM_COLUMNS)`; `axes` of the lower frame; `by_area` the upper
    measure; `flat` whether the lower measure is "box"; `bones` one or two."""

    cells: np.ndarray
    axes: Axes
    by_area: bool
    flat: bool
    bones: int


class Resolution(NamedTuple):
    """How finely to cut: bins of the two lengths, and sub-cells along a cell's side."""

    first: int
    second: int
    sub: int

    @property
    def pieces(self) -> int:
        """Strata that a cell of the table is cut into."""
        return self.first * self.second * self.sub**2


class Strata(NamedTuple):
    """The strata of one limb. `subs` `(s, 5)`: cell, sine and cosine of the middle azimuth, and of elevation: sine and
    cosine of the middle, or the sines at the edges (measure "area"). `entries` `(n, 4)` in order of their bins: share
    and partner of the bin's alias table, sub-cell, bound on a region's area; `pieces` `(n,)` masks; `starts`
    `(bins + 1,)`; `totals` `(bins,)` weight of each bin."""

    subs: np.ndarray
    entries: np.ndarray
    pieces: np.ndarray
    starts: np.ndarray
    totals: np.ndarray


@inlined
def lower_axes(u0: float, u1: float, u2: float, axes: Axes) -> tuple[float, ...]:
    """`frames.lower_frame` for one parent: v, w, and the sine of the angle to the reference direction."""
    a0, a1, a2, f0, f1, f2 = axes
    v0, v1, v2 = a1 * u2 - a2 * u1, a2 * u0 - a0 * u2, a0 * u1 - a1 * u0
    square = v0 * v0 + v1 * v1 + v2 * v2
    parallel = square < PARALLEL**2
    v0 = u1 * f2 - u2 * f1 if parallel else v0
    v1 = u2 * f0 - u0 * f2 if parallel else v1
    v2 = u0 * f1 - u1 * f0 if parallel else v2
    scale = 1 / math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = v0 * scale, v1 * scale, v2 * scale
    return v0, v1, v2, u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0, math.sqrt(square)


def sub_cells(sight: Sight, build: Build, low: float, high: float, sub: int) -> tuple[np.ndarray, np.ndarray]:
    """The sub-cells from which the upper bone's joint can reach its disc with a length in [low, high]: `Strata.subs`
    `(s, 5)`, and what the strata need to know of them `(s, GEOMETRY)`."""
    occupied = np.flatnonzero(build.cells[:, MASS])
    middle, chord, *_ = _middles(occupied, 0, 0, 1)
    cell = occupied[_near(sight, middle, chord, low, high)]
    cell, across, along = (part.ravel() for part in np.meshgrid(cell, np.arange(sub), np.arange(sub), indexing="ij"))
    upper, chord, azimuth, bottom, top = _middles(cell, across, along, sub)
    kept = _near(sight, upper, chord, low, high)
    cell, upper, chord, azimuth, bottom, top = (part[kept] for part in (cell, upper, chord, azimuth, bottom, top))
    if build.by_area:
        elevation = np.sin(bottom), np.sin(top)
        floor = (cell % NUM_ELEVATION) * CELL - np.pi / 2
        share = (np.sin(top) - np.sin(bottom)) / (np.sin(floor + CELL) - np.sin(floor)) / sub
    else:
        elevation = np.sin((bottom + top) / 2), np.cos((bottom + top) / 2)
        share = np.full(len(cell), 1 / sub**2)
    subs = np.stack([cell, np.sin(azimuth), np.cos(azimuth), *elevation], axis=1)
    geometry = np.zeros((len(cell), GEOMETRY))
    geometry[:, :2] = -upper @ sight.frame[:2].T
    geometry[:, 2], geometry[:, 3] = np.hypot(geometry[:, 0], geometry[:, 1]), chord
    geometry[:, 5] = build.cells[cell, MASS] * share
    if build.bones == 2 and len(cell):
        local, sine = lower_axes_of(upper, build.axes)
        geometry[:, 4] = frame_turn(sine, chord)
        triple = build.cells[cell, :9].reshape(-1, 3, 3)
        geometry[:, 6:15] = -(sight.frame @ local @ triple.transpose(0, 2, 1)).transpose(0, 2, 1).reshape(-1, 9)
        geometry[:, 15:20] = build.cells[cell, OFFSET : BOUNDS + 4]
        low, high, first, last = build.cells[cell, BOX : BOX + 4].T
        geometry[:, 20] = np.maximum(high - low, 0) * np.clip(last - first, 0, 2 * np.pi)
        geometry[:, 5] /= build.cells[cell, AREA]
    return subs, geometry


def _middles(cell: np.ndarray, across: np.ndarray | int, along: np.ndarray | int, sub: int) -> tuple[np.ndarray, ...]:
    """Of sub-cells: the direction `(n, 3)` in the middle, how far as a chord a corner is from it, the middle's azimuth,
    and the elevations of the two edges."""
    width = CELL / sub
    azimuth = (cell // NUM_ELEVATION) * CELL - np.pi + (across + 0.5) * width
    bottom = (cell % NUM_ELEVATION) * CELL - np.pi / 2 + along * width
    middle, top = bottom + width / 2, bottom + width
    upper = np.stack([np.cos(middle) * np.cos(azimuth), np.cos(middle) * np.sin(azimuth), np.sin(middle)], axis=-1)
    cosine = [
        np.cos(edge) * np.cos(middle) * np.cos(width / 2) + np.sin(edge) * np.sin(middle) for edge in (bottom, top)
    ]
    chord = np.sqrt(np.maximum(2 - 2 * np.minimum(*cosine), 0.0)) + SLACK
    return upper, chord, azimuth, bottom, top


def _near(sight: Sight, upper: np.ndarray, chord: np.ndarray, low: float, high: float) -> np.ndarray:
    """Which directions, moved by up to a chord, can put the joint into the first disc with some length in range."""
    end = -upper @ sight.frame[:2].T
    square = np.sum(end**2, axis=-1)
    length = np.clip(end @ sight.target[0] / np.where(square > 0, square, 1.0), low, high)
    distance = np.linalg.norm(sight.target[0] - length[:, None] * end, axis=-1)
    return distance <= sight.radius[0] + high * chord + SLACK


def frame_turn(sine: np.ndarray, chord: np.ndarray) -> np.ndarray:
    """How far, as a chord, any vector can turn with the lower frame while the parent bone moves by `chord`, from where
    its angle to the reference direction has this sine: the frame's azimuth turns fast near the reference."""
    slow = chord < 0.999 * sine
    ratio = np.where(slow, chord, 0.0) / np.where(slow, sine, 1.0)
    return np.where(slow, np.minimum(2.0, chord + 2 * np.sin(np.arcsin(ratio) / 2) + SLACK), 2.0)


def lower_axes_of(upper: np.ndarray, axes: Axes) -> tuple[np.ndarray, np.ndarray]:
    """`lower_axes` of many parents `(n, 3)`: the frames `(n, 3, 3)`, columns u, v, w, and the sines `(n,)`."""
    reference, fallback = np.array(axes[:3]), np.array(axes[3:])
    usual = np.cross(reference, upper)
    sine = np.linalg.norm(usual, axis=-1)
    v = np.where(sine[:, None] < PARALLEL, np.cross(upper, fallback), usual)
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return np.stack([upper, v, np.cross(upper, v)], axis=-1), sine


def stratify(sight: Sight, build: Build, edges1: np.ndarray, edges2: np.ndarray, sub: int) -> Strata:
    """The strata of one limb for the bins between the edges (body units) of its bones' lengths; of one bone, the second
    edges are of no account but in number."""
    subs, geometry = sub_cells(sight, build, edges1[0], edges1[-1], sub)
    return Strata(subs, *_stratify(sight, build, geometry, edges1, edges2))


@compiled
def _stratify(sight: Sight, build: Build, geometry: np.ndarray, edges1: np.ndarray,
              edges2: np.ndarray) -> tuple[np.ndarray, ...]:  # fmt: skip
    """The rest of `Strata`."""
    number, bins1, bins2 = geometry.shape[0], edges1.size - 1, edges2.size - 1
    near, blocks = np.empty(number, np.int64), np.empty((number // BLOCK + 1, SIZE))
    most = 1 << 12
    entries, pieces = np.empty((most, 4)), np.empty(most, np.uint8)
    starts, totals = np.zeros(bins1 * bins2 + 1, np.int64), np.zeros(bins1 * bins2)
    weight, found = np.empty(number), 0
    for index in range(bins1 * bins2):
        one, two = index // bins2, index % bins2
        if two == 0:
            reached = _reached(sight, geometry, edges1[one], edges1[one + 1], near)
            for start in range(0, reached, BLOCK):
                _pack(geometry, near[start : min(start + BLOCK, reached)], blocks[start // BLOCK])
        if found + reached > most:
            most = 2 * most + reached
            entries, pieces = _longer(entries, most), _longer(pieces, most)
        first = found
        for start in range(0, reached, BLOCK):
            block, size = blocks[start // BLOCK], min(BLOCK, reached - start)
            if build.bones == 2:
                bound_regions(size, sight.target[1, 0], sight.target[1, 1], sight.radius[1], edges1[one],
                              edges1[one + 1], edges2[two], edges2[two + 1], block)  # fmt: skip
            found = _enter(size, near[start:], block, entries, pieces, weight, first, found)
        starts[index + 1] = found
        if found > first:
            totals[index] = weight[: found - first].sum()
            alias_table(weight[: found - first], entries[first:found])
    return entries[:found], pieces[:found], starts, totals


@compiled
def _longer(array: np.ndarray, size: int) -> np.ndarray:
    longer = np.empty((size, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    return longer


@compiled
def _pack(geometry: np.ndarray, near: np.ndarray, block: np.ndarray) -> None:
    """Copies what is known of the sub-cells `near` to a block; of one bone, nothing else is to be found."""
    for n in range(near.size):
        s = near[n]
        for column in range(GEOMETRY):
            block[column * STRIDE + n] = geometry[s, column]
        block[WEIGHT + n], block[REGION + n], block[MASK + n] = geometry[s, 5], 1.0, 0.0


@compiled
def _enter(size: int, near: np.ndarray, block: np.ndarray, entries: np.ndarray, pieces: np.ndarray,
           weight: np.ndarray, first: int, found: int) -> int:  # fmt: skip
    """Adds the strata of a block to the table; returns how many there are now."""
    for n in range(size):
        weight[found - first] = block[WEIGHT + n]
        entries[found, 2], entries[found, 3] = near[n], block[REGION + n]
        pieces[found] = np.uint8(block[MASK + n])
        found += int(block[WEIGHT + n] > 0)
    return found


@compiled
def _reached(sight: Sight, geometry: np.ndarray, low: float, high: float, near: np.ndarray) -> int:
    """Writes to `near` the sub-cells from which a length in [low, high] can reach the first disc; returns how many."""
    target0, target1, radius = sight.target[0, 0], sight.target[0, 1], sight.radius[0]
    middle, spread, found = (low + high) / 2, (high - low) / 2, 0
    for s in range(geometry.shape[0]):
        chord = geometry[s, 3]
        off = math.hypot(middle * geometry[s, 0] - target0, middle * geometry[s, 1] - target1)
        if off <= radius + spread * min(1.0, geometry[s, 2] + chord) + middle * chord + SLACK:
            near[found] = s
            found += 1
    return found
