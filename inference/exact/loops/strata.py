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
import itertools
import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.bounds import bound_regions
from poseterior.inference.exact.loops.numbers import Rows, compiled, inlined, rows_of
from poseterior.inference.exact.loops.rectangles import SLACK
from poseterior.inference.exact.loops.tables import (
    ALIAS,
    AZIMUTHS,
    ELEVATIONS,
    ENTRIES,
    GEOMETRY,
    REGIONS,
    SUB_BLOCK,
    SUBS,
    Grid,
    LimbProblem,
    LimbTables,
    Record,
    Reference,
    Strata,
)
from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION
from poseterior.probmodel.kinematics import PARALLEL


class Resolution(NamedTuple):
    """How finely to cut: bins of the two lengths, and sub-cells along a cell's side."""

    first: int
    second: int
    sub: int

    @property
    def pieces(self) -> int:
        """Strata that a cell of the table is cut into."""
        return self.first * self.second * self.sub**2


@inlined
def lower_axes(u0: float, u1: float, u2: float, reference: Reference) -> tuple[float, ...]:
    """`kinematics.lower_frame` for one parent: v, w, and the sine of the angle to the reference
    direction."""
    a0, a1, a2, f0, f1, f2 = reference
    v0, v1, v2 = a1 * u2 - a2 * u1, a2 * u0 - a0 * u2, a0 * u1 - a1 * u0
    square = v0 * v0 + v1 * v1 + v2 * v2
    parallel = square < PARALLEL**2
    v0 = u1 * f2 - u2 * f1 if parallel else v0
    v1 = u2 * f0 - u0 * f2 if parallel else v1
    v2 = u0 * f1 - u1 * f0 if parallel else v2
    scale = 1 / math.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v0, v1, v2 = v0 * scale, v1 * scale, v2 * scale
    return v0, v1, v2, u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0, math.sqrt(square)


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
    azimuths, elevations = np.zeros(azimuth.size, AZIMUTHS), np.zeros(middle.size, ELEVATIONS)
    azimuths["sine"], azimuths["cosine"] = np.sin(azimuth), np.cos(azimuth)
    elevations["sine"], elevations["cosine"] = np.sin(middle), np.cos(middle)
    elevations["bottom"], elevations["top"] = np.sin(bottom), np.sin(top)
    elevations["chord"], elevations["share"] = chord, share
    return Grid(azimuths, elevations)


@compiled
def _sub_cells(
    problem: LimbProblem,
    tables: LimbTables,
    low: float,
    high: float,
    sub: int,
    cut: Grid,
    whole: Grid,
) -> tuple[np.ndarray, np.ndarray]:
    """The sub-cells from which the upper bone's joint can reach its disc with a length in [low,
    high]: `SUBS` `(s,)` and `GEOMETRY` `(s,)`."""
    axes, cells = rows_of(problem.axes), tables.cells
    near, found = np.empty(cells.size, np.int64), 0
    for cell in range(cells.size):
        if cells[cell].mass > 0:
            near[found] = cell
            column, line = cell // NUM_ELEVATION, cell % NUM_ELEVATION
            found += int(_in_reach(axes, problem, whole, column, line, low, high))
    columns, lines = np.empty(found * sub * sub, np.int64), np.empty(found * sub * sub, np.int64)
    number = 0
    for n in range(found):
        for across in range(sub):
            for along in range(sub):
                column = near[n] // NUM_ELEVATION * sub + across
                line = near[n] % NUM_ELEVATION * sub + along
                columns[number], lines[number] = column, line
                number += int(_in_reach(axes, problem, cut, column, line, low, high))
    subs, geometry = np.empty(number, SUBS), np.zeros(number, GEOMETRY)
    for n in range(number):
        _describe(axes, tables, cut, columns[n], lines[n], sub, subs[n], geometry[n])
    return subs, geometry


@inlined
def _middle(cut: Grid, column: int, line: int) -> tuple[float, float, float]:
    """The direction in the middle of a sub-cell."""
    azimuth, elevation = cut.azimuth[column], cut.elevation[line]
    planar = elevation.cosine
    return planar * azimuth.cosine, planar * azimuth.sine, elevation.sine


@compiled
def _in_reach(
    axes: Rows,
    problem: LimbProblem,
    cut: Grid,
    column: int,
    line: int,
    low: float,
    high: float,
) -> bool:
    """Whether a bone from a sub-cell, of some length in [low, high], can end in its disc."""
    u0, u1, u2 = _middle(cut, column, line)
    target0, target1 = problem.target[0, 0], problem.target[0, 1]
    end0 = -(axes[0] * u0 + axes[1] * u1 + axes[2] * u2)
    end1 = -(axes[3] * u0 + axes[4] * u1 + axes[5] * u2)
    square = end0 * end0 + end1 * end1
    length = (end0 * target0 + end1 * target1) / (square if square > 0 else 1.0)
    length = min(max(length, low), high)
    slack = problem.reach[0] + high * cut.elevation[line].chord + SLACK
    off0, off1 = target0 - length * end0, target1 - length * end1
    return off0 * off0 + off1 * off1 <= slack * slack


@compiled
def _describe(
    axes: Rows,
    tables: LimbTables,
    cut: Grid,
    column: int,
    line: int,
    sub: int,
    row: Record,
    geometry: Record,
) -> None:
    """Fills a sub-cell's row of `SUBS` and of `GEOMETRY`."""
    f00, f01, f02, f10, f11, f12, f20, f21, f22 = axes
    azimuth, elevation = cut.azimuth[column], cut.elevation[line]
    row.cell = column // sub * NUM_ELEVATION + line // sub
    row.sin_azimuth, row.cos_azimuth = azimuth.sine, azimuth.cosine
    row.lift = elevation.bottom if tables.by_area else elevation.sine
    row.fall = elevation.top if tables.by_area else elevation.cosine
    cell = tables.cells[row.cell]
    u0, u1, u2 = _middle(cut, column, line)
    geometry.chord = elevation.chord
    geometry.mass = cell.mass * (elevation.share if tables.by_area else 1 / sub**2)
    geometry.image0 = -(f00 * u0 + f01 * u1 + f02 * u2)
    geometry.image1 = -(f10 * u0 + f11 * u1 + f12 * u2)
    geometry.spread = math.sqrt(geometry.image0**2 + geometry.image1**2)
    if tables.bones == 1:
        return
    v0, v1, v2, w0, w1, w2, sine = lower_axes(u0, u1, u2, tables.reference)
    geometry.turn = frame_turn(sine, geometry.chord)
    for first in range(0, 9, 3):
        t0, t1, t2 = cell.triple[first], cell.triple[first + 1], cell.triple[first + 2]
        h0 = u0 * t0 + v0 * t1 + w0 * t2
        h1 = u1 * t0 + v1 * t1 + w1 * t2
        h2 = u2 * t0 + v2 * t1 + w2 * t2
        geometry.triple[first] = -(f00 * h0 + f01 * h1 + f02 * h2)
        geometry.triple[first + 1] = -(f10 * h0 + f11 * h1 + f12 * h2)
        geometry.triple[first + 2] = -(f20 * h0 + f21 * h1 + f22 * h2)
    geometry.offset = cell.offset
    geometry.low2, geometry.high2 = cell.low2, cell.high2
    geometry.low3, geometry.high3 = cell.low3, cell.high3
    turn = max(cell.box_last - cell.box_first, 0.0)
    geometry.box_area = max(cell.box_high - cell.box_low, 0.0) * min(turn, 2 * np.pi)
    geometry.mass /= cell.area


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


class Sketch(NamedTuple):
    """A limb of which it is known how many strata it has at most, not yet which.

    Attributes
    ----------
    problem, tables
        Which limb.
    edges
        Of the bins of its bones' lengths, body units.
    geometry
        `(s,)` `GEOMETRY` of the sub-cells.
    near, reached
        `(bins of the first length, s)` and `(bins,)`: the sub-cells from which the upper bone's
        joint can reach its disc with such a length, and how many there are.
    strata
        With room for all.
    """

    problem: LimbProblem
    tables: LimbTables
    edges: tuple[np.ndarray, np.ndarray]
    geometry: np.ndarray
    near: np.ndarray
    reached: np.ndarray
    strata: Strata

    def spans(self, number: int) -> list[tuple[int, int]]:
        """So many ranges of bins of the two lengths, about as much work each; some may be empty."""
        work = np.cumsum(np.repeat(self.reached, len(self.edges[1]) - 1))
        cuts = np.searchsorted(work, work[-1] * np.arange(1, number) / number)
        return list(itertools.pairwise([0, *cuts.tolist(), len(work)]))


def sketch(
    problem: LimbProblem, tables: LimbTables, edges1: np.ndarray, edges2: np.ndarray, sub: int
) -> Sketch:
    """The first step of cutting a limb into strata: its sub-cells.

    Parameters
    ----------
    edges1, edges2 : `(bins + 1,)` edges of the bins of its bones' lengths, body units; of one bone,
        only the number of the second counts
    sub : sub-cells along a cell's side
    """
    subs, geometry = _sub_cells(problem, tables, edges1[0], edges1[-1], sub, grid(sub), grid(1))
    near, reached = _all_reached(problem, geometry, edges1)
    bins = len(edges2) - 1
    starts = np.repeat(np.cumsum(reached) - reached, bins) * bins
    starts += np.outer(reached, np.arange(bins)).ravel()
    most = bins * int(reached.sum())
    # Room for all, since bins are filled in side by side; what is dropped leaves a gap behind it.
    alias, entries = np.empty(most, ALIAS), np.empty(most, ENTRIES)
    strata = Strata(subs, alias, entries, starts, np.zeros_like(starts), np.zeros(len(starts)))
    return Sketch(problem, tables, (edges1, edges2), geometry, near, reached, strata)


def fill_in(found: Sketch, span: tuple[int, int]) -> None:
    """The second step: the strata of a range of bins. Ranges may be filled in side by side."""
    problem, tables, edges, geometry, near, reached, strata = found
    _stratify(problem, tables, geometry, near, reached, *edges, *span, strata)


@compiled
def _all_reached(
    problem: LimbProblem, geometry: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`near` and `reached` of a `Sketch`."""
    bins = edges.size - 1
    near, reached = np.empty((bins, geometry.size), np.int64), np.empty(bins, np.int64)
    for one in range(bins):
        reached[one] = _reached(problem, geometry, edges[one], edges[one + 1], near[one])
    return near, reached


@compiled
def _stratify(
    problem: LimbProblem,
    tables: LimbTables,
    geometry: np.ndarray,
    near: np.ndarray,
    reached: np.ndarray,
    edges1: np.ndarray,
    edges2: np.ndarray,
    begin: int,
    end: int,
    strata: Strata,
) -> None:
    """Fills in the strata of the bins [begin, end), those of the second length innermost."""
    number, bins2, starts = geometry.size, edges2.size - 1, strata.starts
    blocks, weight = np.empty(number // SUB_BLOCK + 1, REGIONS), np.empty(number)
    for index in range(begin, end):
        one, two = index // bins2, index % bins2
        first = found = starts[index]
        for start in range(0, reached[one], SUB_BLOCK):
            block, size = blocks[start // SUB_BLOCK], min(SUB_BLOCK, reached[one] - start)
            if two == 0 or index == begin:
                _pack(size, geometry, near[one], start, block)
            if tables.bones == 2:
                bound_regions(
                    size,
                    problem.target[1, 0],
                    problem.target[1, 1],
                    problem.reach[1],
                    edges1[one],
                    edges1[one + 1],
                    edges2[two],
                    edges2[two + 1],
                    block,
                )
            found = _enter(size, near[one], start, block, strata.entries, weight, first, found)
        strata.ends[index] = found
        if found > first:
            own = strata.alias[first:found]
            strata.totals[index] = alias_table(weight[: found - first], own)


@compiled
def _pack(size: int, geometry: np.ndarray, near: np.ndarray, start: int, block: Record) -> None:
    """Copies what is known of `size` of the sub-cells `near` to a block; of one bone, nothing else
    is to be found."""
    for n in range(size):
        known = geometry[near[start + n]].known
        for column in range(known.size):
            block.known[column, n] = known[column]
        block.weight[n], block.region[n], block.mask[n] = block.mass[n], 1.0, 0.0


@compiled
def _enter(
    size: int,
    near: np.ndarray,
    start: int,
    block: Record,
    entries: np.ndarray,
    weight: np.ndarray,
    first: int,
    found: int,
) -> int:
    """Adds the strata of a block to the table; returns how many there are now."""
    for n in range(size):
        entry, weight[found - first] = entries[found], block.weight[n]
        entry.region, entry.sub = block.region[n], near[start + n]
        entry.mask = np.uint8(block.mask[n])
        found += int(block.weight[n] > 0)
    return found


@compiled
def _reached(
    problem: LimbProblem, geometry: np.ndarray, low: float, high: float, near: np.ndarray
) -> int:
    """Writes to `near` the sub-cells from which a length in [low, high] can reach the first disc;
    returns how many."""
    target0, target1, radius = problem.target[0, 0], problem.target[0, 1], problem.reach[0]
    middle, spread, found = (low + high) / 2, (high - low) / 2, 0
    for s in range(geometry.size):
        row = geometry[s]
        off0, off1 = middle * row.image0 - target0, middle * row.image1 - target1
        moves = spread * min(1.0, row.spread + row.chord) + middle * row.chord
        slack = radius + moves + SLACK
        near[found] = s
        found += int(off0 * off0 + off1 * off1 <= slack * slack)
    return found
