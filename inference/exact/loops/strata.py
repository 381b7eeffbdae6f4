"""Strata: where a limb may be, cut small, with a proven bound on each piece. Compiled; in body
units.

A stratum is a bin of the shared lengths × a sub-cell of the upper bone's table × pieces of the
lower bone's rectangle. Given an upper direction and lengths, the directions that put the next joint
into its disc lie in a rectangle of the chart (x, α) whose area is dx dα (`rectangle`); its α range,
in front and behind, is cut into pieces, and a piece is dropped where the hinge allows nothing in
it. Where the hinge's own box is smaller than what is left, that is the stratum's region instead
(mask 0). Weight: prior mass of the sub-cell × bound on the region's area / the hinge's area.

Bounds add up how far things can move inside a stratum: u by `chord`, the joint by that times the
length, the disc's centre by `shift`, the hinge's frame by `turn`. Nothing is estimated."""

import functools
import math
from typing import NamedTuple

import numpy as np

from inference.exact.loops.bins import alias_table
from inference.exact.loops.bounds import (
    BLOCK,
    GEOMETRY,
    MASK,
    REGION,
    SIZE,
    STRIDE,
    WEIGHT,
    bound_regions,
)
from inference.exact.loops.numbers import Rows, compiled, inlined, rows_of
from inference.exact.loops.rectangles import SLACK
from probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION
from probmodel.kinematics import PARALLEL

TRIPLE, OFFSET, BOUNDS, AREA, MASS, BOX, NUM_COLUMNS = 0, 9, 10, 14, 15, 16, 20
"""Columns of a limb's table: the hinge's triple, offset, bounds and area, the cell's prior mass,
the hinge's box."""


Axes = tuple[float, float, float, float, float, float]
"""Reference direction of the lower frames and its fallback, as numbers."""


class Sight(NamedTuple):
    """A limb in front of a camera: `frame` `(3, 3)` its local frame in camera axes; `target` `(2,
    2)` the detected joints minus its start, body units; `radius` `(2,)` of their discs, infinite
    where nothing was seen."""

    frame: np.ndarray
    target: np.ndarray
    radius: np.ndarray


class Build(NamedTuple):
    """What the model says of a limb. `cells` `(7200, NUM_COLUMNS)`; `axes` of the lower frame;
    `by_area` the upper measure; `flat` whether the lower measure is "box"; `bones` one or two."""

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
    """The strata of one limb. `subs` `(s, 5)`: cell, sine and cosine of the middle azimuth, and of
    elevation: sine and cosine of the middle, or the sines at the edges (measure "area"). `entries`
    `(n, 4)` in order of their bins: share and partner of the bin's alias table, sub-cell, bound on
    a region's area; `pieces` `(n,)` masks; `starts` `(bins + 1,)`; `totals` `(bins,)` weight of
    each bin."""

    subs: np.ndarray
    entries: np.ndarray
    pieces: np.ndarray
    starts: np.ndarray
    totals: np.ndarray


@inlined
def lower_axes(u0: float, u1: float, u2: float, axes: Axes) -> tuple[float, ...]:
    """`frames.lower_frame` for one parent: v, w, and the sine of the angle to the reference
    direction."""
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


class Grid(NamedTuple):
    """Trigonometry of sub-cells, by column and by line. `azimuth` `(120 · sub, 2)`: sine and cosine
    of the middle; `elevation` `(60 · sub, 6)`: sine and cosine of the middle, sines at the edges,
    how far as a chord a corner is from the middle, and the share of a cell's surface."""

    azimuth: np.ndarray
    elevation: np.ndarray


@functools.cache
def grid(sub: int) -> Grid:
    """Of cells cut into `sub` × `sub`."""
    width = CELL / sub
    azimuth = (np.arange(NUM_AZIMUTH * sub) + 0.5) * width - np.pi
    edges = np.arange(NUM_ELEVATION * sub + 1) * width - np.pi / 2
    middle, bottom, top = edges[:-1] + width / 2, edges[:-1], edges[1:]
    corners = [
        np.cos(edge) * np.cos(middle) * np.cos(width / 2) + np.sin(edge) * np.sin(middle)
        for edge in (bottom, top)
    ]
    chord = np.sqrt(np.maximum(2 - 2 * np.minimum(*corners), 0.0)) + SLACK
    height = np.sin(top) - np.sin(bottom)
    share = height / np.repeat(height.reshape(-1, sub).sum(axis=1), sub) / sub
    return Grid(
        np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1),
        np.stack(
            [np.sin(middle), np.cos(middle), np.sin(bottom), np.sin(top), chord, share], axis=1
        ),
    )


@compiled
def _sub_cells(
    sight: Sight, build: Build, low: float, high: float, sub: int, cut: Grid, whole: Grid
) -> tuple[np.ndarray, np.ndarray]:
    """The sub-cells from which the upper bone's joint can reach its disc with a length in [low,
    high]: `Strata.subs` `(s, 5)`, and what the strata need to know of them `(s, GEOMETRY)`."""
    frame, cells = rows_of(sight.frame), build.cells
    target0, target1, radius = sight.target[0, 0], sight.target[0, 1], sight.radius[0]
    near, found = np.empty(len(cells), np.int64), 0
    for cell in range(len(cells)):
        if cells[cell, MASS] > 0:
            u0, u1, u2 = _middle(whole, cell // NUM_ELEVATION, cell % NUM_ELEVATION)
            near[found] = cell
            chord = whole.elevation[cell % NUM_ELEVATION, 4]
            found += int(
                _in_reach(frame, u0, u1, u2, target0, target1, radius + high * chord, low, high)
            )
    place, number = np.empty((found * sub * sub, 2), np.int64), 0
    for n in range(found):
        for across in range(sub):
            for along in range(sub):
                column, line = (
                    near[n] // NUM_ELEVATION * sub + across,
                    near[n] % NUM_ELEVATION * sub + along,
                )
                u0, u1, u2 = _middle(cut, column, line)
                place[number, 0], place[number, 1] = column, line
                chord = cut.elevation[line, 4]
                number += int(
                    _in_reach(frame, u0, u1, u2, target0, target1, radius + high * chord, low, high)
                )
    subs, geometry = np.empty((number, 5)), np.zeros((number, GEOMETRY))
    for n in range(number):
        column, line = place[n]
        cell = column // sub * NUM_ELEVATION + line // sub
        first = 2 if build.by_area else 0
        subs[n, 0], subs[n, 1], subs[n, 2] = cell, cut.azimuth[column, 0], cut.azimuth[column, 1]
        subs[n, 3], subs[n, 4] = cut.elevation[line, first], cut.elevation[line, first + 1]
        geometry[n, 3] = cut.elevation[line, 4]
        geometry[n, 5] = cells[cell, MASS] * (
            cut.elevation[line, 5] if build.by_area else 1 / sub**2
        )
        _describe(frame, build, _middle(cut, column, line), cells[cell], geometry[n])
    return subs, geometry


@inlined
def _middle(cut: Grid, column: int, line: int) -> tuple[float, float, float]:
    """The direction in the middle of a sub-cell."""
    planar = cut.elevation[line, 1]
    return planar * cut.azimuth[column, 1], planar * cut.azimuth[column, 0], cut.elevation[line, 0]


@inlined
def _in_reach(
    frame: Rows,
    u0: float,
    u1: float,
    u2: float,
    target0: float,
    target1: float,
    slack: float,
    low: float,
    high: float,
) -> bool:
    """Whether a bone along u, of some length in [low, high], can end within `slack` of the
    target."""
    end0 = -(frame[0] * u0 + frame[1] * u1 + frame[2] * u2)
    end1 = -(frame[3] * u0 + frame[4] * u1 + frame[5] * u2)
    square = end0 * end0 + end1 * end1
    length = (end0 * target0 + end1 * target1) / (square if square > 0 else 1.0)
    length = min(max(length, low), high)
    return math.hypot(target0 - length * end0, target1 - length * end1) <= slack + SLACK


@compiled
def _describe(
    frame: Rows,
    build: Build,
    upper: tuple[float, float, float],
    cell: np.ndarray,
    geometry: np.ndarray,
) -> None:
    """The rest of a sub-cell's `GEOMETRY`: the upper bone's image, and the lower bone's hinge in
    camera axes."""
    f00, f01, f02, f10, f11, f12, f20, f21, f22 = frame
    u0, u1, u2 = upper
    geometry[0], geometry[1] = -(f00 * u0 + f01 * u1 + f02 * u2), -(f10 * u0 + f11 * u1 + f12 * u2)
    geometry[2] = math.hypot(geometry[0], geometry[1])
    if build.bones == 1:
        return
    v0, v1, v2, w0, w1, w2, sine = lower_axes(u0, u1, u2, build.axes)
    geometry[4] = frame_turn(sine, geometry[3])
    for row in range(3):
        t0, t1, t2 = cell[3 * row], cell[3 * row + 1], cell[3 * row + 2]
        h0, h1, h2 = (
            u0 * t0 + v0 * t1 + w0 * t2,
            u1 * t0 + v1 * t1 + w1 * t2,
            u2 * t0 + v2 * t1 + w2 * t2,
        )
        geometry[6 + 3 * row] = -(f00 * h0 + f01 * h1 + f02 * h2)
        geometry[7 + 3 * row] = -(f10 * h0 + f11 * h1 + f12 * h2)
        geometry[8 + 3 * row] = -(f20 * h0 + f21 * h1 + f22 * h2)
    for column in range(5):
        geometry[15 + column] = cell[OFFSET + column]
    geometry[20] = max(cell[BOX + 1] - cell[BOX], 0.0) * min(
        max(cell[BOX + 3] - cell[BOX + 2], 0.0), 2 * np.pi
    )
    geometry[5] /= cell[AREA]


@compiled
def frame_turn(sine: float, chord: float) -> float:
    """How far, as a chord, any vector can turn with the lower frame while the parent bone moves by
    `chord`, from where its angle to the reference direction has this sine: the frame's azimuth
    turns fast near the reference."""
    if chord >= 0.999 * sine:
        return 2.0
    ratio = chord / sine
    half = ratio / math.sqrt(2 + 2 * math.sqrt(1 - ratio * ratio))  # the sine of half the angle
    return min(2.0, chord + 2 * half + SLACK)


def stratify(
    sight: Sight, build: Build, edges1: np.ndarray, edges2: np.ndarray, sub: int
) -> Strata:
    """The strata of one limb for the bins between the edges (body units) of its bones' lengths; of
    one bone, the second edges are of no account but in number."""
    subs, geometry = _sub_cells(sight, build, edges1[0], edges1[-1], sub, grid(sub), grid(1))
    return Strata(subs, *_stratify(sight, build, geometry, edges1, edges2))


@compiled
def _stratify(
    sight: Sight, build: Build, geometry: np.ndarray, edges1: np.ndarray, edges2: np.ndarray
) -> tuple[np.ndarray, ...]:
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
                bound_regions(
                    size,
                    sight.target[1, 0],
                    sight.target[1, 1],
                    sight.radius[1],
                    edges1[one],
                    edges1[one + 1],
                    edges2[two],
                    edges2[two + 1],
                    block,
                )
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
    """Copies what is known of the sub-cells `near` to a block; of one bone, nothing else is to be
    found."""
    for n in range(near.size):
        s = near[n]
        for column in range(GEOMETRY):
            block[column * STRIDE + n] = geometry[s, column]
        block[WEIGHT + n], block[REGION + n], block[MASK + n] = geometry[s, 5], 1.0, 0.0


@compiled
def _enter(
    size: int,
    near: np.ndarray,
    block: np.ndarray,
    entries: np.ndarray,
    pieces: np.ndarray,
    weight: np.ndarray,
    first: int,
    found: int,
) -> int:
    """Adds the strata of a block to the table; returns how many there are now."""
    for n in range(size):
        weight[found - first] = block[WEIGHT + n]
        entries[found, 2], entries[found, 3] = near[n], block[REGION + n]
        pieces[found] = np.uint8(block[MASK + n])
        found += int(block[WEIGHT + n] > 0)
    return found


@compiled
def _reached(sight: Sight, geometry: np.ndarray, low: float, high: float, near: np.ndarray) -> int:
    """Writes to `near` the sub-cells from which a length in [low, high] can reach the first disc;
    returns how many."""
    target0, target1, radius = sight.target[0, 0], sight.target[0, 1], sight.radius[0]
    middle, spread, found = (low + high) / 2, (high - low) / 2, 0
    for s in range(geometry.shape[0]):
        chord = geometry[s, 3]
        off = math.hypot(middle * geometry[s, 0] - target0, middle * geometry[s, 1] - target1)
        if off <= radius + spread * min(1.0, geometry[s, 2] + chord) + middle * chord + SLACK:
            near[found] = s
            found += 1
    return found
