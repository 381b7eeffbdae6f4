"""Strata: where a limb may be, cut small, with a proven bound on each piece. Compiled;
in body units.

A stratum is a bin of the shared lengths × a sub-cell of the upper bone's table × pieces
of the lower bone's rectangle. Given an upper direction and lengths, the directions that
put the next joint into its disc lie in a rectangle of the chart (x, α) whose area is dx
dα (`rectangle`); its α range, in front and behind, is cut into pieces, and a piece is
dropped where the hinge allows nothing in it. Where the hinge's own box is smaller than
what is left, that is the stratum's region instead (mask 0). Weight: prior mass of the
sub-cell × bound on the region's area / the hinge's area.

Bounds add up how far things can move inside a stratum: u by `chord`, the joint by that
times the length, the disc's centre by `shift`, the hinge's frame by `turn`. Nothing is
estimated."""

import functools
import itertools
import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.bounds import bound_regions
from poseterior.inference.exact.loops.numbers import compiled, inlined
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
    Strata,
)
from poseterior.inference.exact.loops.vectors import (
    Axes,
    Plane,
    Vector,
    axes_of,
    image_of,
    into,
    lower_axes,
    minus,
    out_of,
)
from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION


class Resolution(NamedTuple):
    """How finely to cut: bins of the two lengths, and sub-cells along a cell's side."""

    first: int
    second: int
    sub: int

    @property
    def pieces(self) -> int:
        """Strata that a cell of the table is cut into."""
        return self.first * self.second * self.sub**2


@functools.cache
def grid(sub: int) -> Grid:
    """Of cells cut into `sub` × `sub`."""
    width = CELL / sub
    azimuth = (np.arange(NUM_AZIMUTH * sub) + 0.5) * width - np.pi
    edges = np.arange(NUM_ELEVATION * sub + 1) * width - np.pi / 2
    middle = edges[:-1] + width / 2
    bottom = edges[:-1]
    top = edges[1:]
    corners = [
        np.cos(edge) * np.cos(middle) * np.cos(width / 2) + np.sin(edge) * np.sin(middle)
        for edge in (bottom, top)
    ]
    chord = np.sqrt(np.maximum(2 - 2 * np.minimum(*corners), 0.0)) + SLACK
    height = np.sin(top) - np.sin(bottom)
    share = height / np.repeat(height.reshape(-1, sub).sum(axis=1), sub) / sub
    azimuths = np.zeros(azimuth.size, AZIMUTHS)
    elevations = np.zeros(middle.size, ELEVATIONS)
    azimuths["sine"] = np.sin(azimuth)
    azimuths["cosine"] = np.cos(azimuth)
    elevations["sine"] = np.sin(middle)
    elevations["cosine"] = np.cos(middle)
    elevations["bottom"] = np.sin(bottom)
    elevations["top"] = np.sin(top)
    elevations["chord"] = chord
    elevations["share"] = share
    return Grid(azimuths, elevations, sub)


@compiled
def _sub_cells(
    problem: LimbProblem, tables: LimbTables, lengths: Plane, cut: Grid, whole: Grid
) -> tuple[np.ndarray, np.ndarray]:
    """The sub-cells from which the upper bone's joint can reach its disc with a length
    between the two: `SUBS` `(s,)` and `GEOMETRY` `(s,)`."""
    axes = axes_of(problem.axes)
    disc = problem.target[0, 0], problem.target[0, 1], problem.reach[0]
    cells = tables.cells
    sub = cut.sub
    near = np.empty(cells.size, np.int64)
    count = 0
    for cell in range(cells.size):
        if cells[cell].mass > 0:
            near[count] = cell
            place = cell // NUM_ELEVATION, cell % NUM_ELEVATION
            count += int(_in_reach(axes, disc, lengths, whole, place))
    places = np.empty((count * sub * sub, 2), np.int64)
    number = 0
    for n in range(count):
        for across in range(sub):
            for along in range(sub):
                column = near[n] // NUM_ELEVATION * sub + across
                line = near[n] % NUM_ELEVATION * sub + along
                places[number, 0] = column
                places[number, 1] = line
                number += int(_in_reach(axes, disc, lengths, cut, (column, line)))
    subs = np.empty(number, SUBS)
    geometry = np.zeros(number, GEOMETRY)
    for n in range(number):
        place = places[n, 0], places[n, 1]
        _describe(axes, tables, cut, place, subs[n], geometry[n])
    return subs, geometry


@inlined
def _middle(cut: Grid, place: tuple[int, int]) -> Vector:
    """The direction in the middle of a sub-cell, of which column and line are given."""
    azimuth = cut.azimuth[place[0]]
    elevation = cut.elevation[place[1]]
    planar = elevation.cosine
    return planar * azimuth.cosine, planar * azimuth.sine, elevation.sine


@compiled
def _in_reach(axes: Axes, disc: Vector, lengths: Plane, cut: Grid, place: tuple[int, int]) -> bool:
    """Whether a bone from a sub-cell, of some length between the two, can end in its
    `disc`, centre and radius."""
    end0, end1 = image_of(axes, _middle(cut, place))
    square = end0 * end0 + end1 * end1
    length = (end0 * disc[0] + end1 * disc[1]) / (square if square > 0 else 1.0)
    length = min(max(length, lengths[0]), lengths[1])
    slack = disc[2] + lengths[1] * cut.elevation[place[1]].chord + SLACK
    off0 = disc[0] - length * end0
    off1 = disc[1] - length * end1
    return off0 * off0 + off1 * off1 <= slack * slack


@compiled
def _describe(
    axes: Axes,
    tables: LimbTables,
    cut: Grid,
    place: tuple[int, int],
    row: Record,
    geometry: Record,
) -> None:
    """Fills a sub-cell's row of `SUBS` and of `GEOMETRY`."""
    column, line = place
    azimuth = cut.azimuth[column]
    elevation = cut.elevation[line]
    row.cell = column // cut.sub * NUM_ELEVATION + line // cut.sub
    row.sin_azimuth = azimuth.sine
    row.cos_azimuth = azimuth.cosine
    row.lift = elevation.bottom if tables.by_area else elevation.sine
    row.fall = elevation.top if tables.by_area else elevation.cosine
    cell = tables.cells[row.cell]
    u = _middle(cut, place)
    geometry.chord = elevation.chord
    geometry.mass = cell.mass * (elevation.share if tables.by_area else 1 / cut.sub**2)
    geometry.image0, geometry.image1 = image_of(axes, u)
    geometry.spread = math.sqrt(geometry.image0**2 + geometry.image1**2)
    if tables.bones == 1:
        return
    v, w, sine = lower_axes(u, tables.reference)
    geometry.turn = frame_turn(sine, geometry.chord)
    for first in range(0, 9, 3):
        axis = cell.triple[first], cell.triple[first + 1], cell.triple[first + 2]
        seen0, seen1, seen2 = minus(into(axes, out_of((u, v, w), axis)))
        geometry.triple[first] = seen0
        geometry.triple[first + 1] = seen1
        geometry.triple[first + 2] = seen2
    geometry.offset = cell.offset
    geometry.low2 = cell.low2
    geometry.high2 = cell.high2
    geometry.low3 = cell.low3
    geometry.high3 = cell.high3
    turn = max(cell.box_last - cell.box_first, 0.0)
    geometry.box_area = max(cell.box_high - cell.box_low, 0.0) * min(turn, 2 * np.pi)
    geometry.mass /= cell.area


@compiled
def frame_turn(sine: float, chord: float) -> float:
    """How far, as a chord, any vector can turn with the lower frame while the parent
    bone moves by `chord`, from where its angle to the reference direction has this
    sine: the frame's azimuth turns fast near the reference."""
    if chord >= 0.999 * sine:
        return 2.0
    ratio = chord / sine
    half = ratio / math.sqrt(2 + 2 * math.sqrt(1 - ratio * ratio))  # the sine of half the angle
    return min(2.0, chord + 2 * half + SLACK)


class StrataBuffer(NamedTuple):
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
        """So many ranges of bins of the two lengths, about as much work each; some may
        be empty."""
        work = np.cumsum(np.repeat(self.reached, len(self.edges[1]) - 1))
        cuts = np.searchsorted(work, work[-1] * np.arange(1, number) / number)
        return list(itertools.pairwise([0, *cuts.tolist(), len(work)]))


def strata_buffer(
    problem: LimbProblem, tables: LimbTables, edges: tuple[np.ndarray, np.ndarray], sub: int
) -> StrataBuffer:
    """The first step of cutting a limb into strata: its sub-cells.

    Parameters
    ----------
    edges : `(bins + 1,)` each, of the bins of its bones' lengths, body units; of one
        bone, only the number of the second counts
    sub : sub-cells along a cell's side
    """
    span = float(edges[0][0]), float(edges[0][-1])
    subs, geometry = _sub_cells(problem, tables, span, grid(sub), grid(1))
    near, reached = _all_reached(problem, geometry, edges[0])
    bins = len(edges[1]) - 1
    starts = np.repeat(np.cumsum(reached) - reached, bins) * bins
    starts += np.outer(reached, np.arange(bins)).ravel()
    most = bins * int(reached.sum())
    # Room for all, since bins are filled in side by side; what is dropped leaves a gap
    # behind it.
    alias = np.empty(most, ALIAS)
    entries = np.empty(most, ENTRIES)
    strata = Strata(subs, alias, entries, starts, np.zeros_like(starts), np.zeros(len(starts)))
    return StrataBuffer(
        problem, tables, edges, geometry=geometry, near=near, reached=reached, strata=strata
    )


@compiled
def _all_reached(
    problem: LimbProblem, geometry: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`near` and `reached` of a `StrataBuffer`."""
    bins = edges.size - 1
    near = np.empty((bins, geometry.size), np.int64)
    reached = np.empty(bins, np.int64)
    for one in range(bins):
        reached[one] = _reached(problem, geometry, edges[one], edges[one + 1], near[one])
    return near, reached


@compiled
def fill_in(buffer: StrataBuffer, begin: int, end: int) -> None:
    """The second step: the strata of the bins [begin, end), those of the second length
    innermost. Ranges of bins may be filled in side by side."""
    problem, tables, edges, geometry, near, reached, strata = buffer
    edges1, edges2 = edges
    bins2 = edges2.size - 1
    starts = strata.starts
    target = problem.target[1, 0], problem.target[1, 1]
    blocks = np.empty(geometry.size // SUB_BLOCK + 1, REGIONS)
    weight = np.empty(geometry.size)
    for index in range(begin, end):
        one = index // bins2
        two = index % bins2
        bin1 = edges1[one], edges1[one + 1]
        bin2 = edges2[two], edges2[two + 1]
        first = starts[index]
        filled = first
        for start in range(0, reached[one], SUB_BLOCK):
            block = blocks[start // SUB_BLOCK]
            subs = near[one, start : min(start + SUB_BLOCK, reached[one])]
            # What is known of the sub-cells serves all bins of the second length.
            if two == 0 or index == begin:
                _pack(subs, geometry, block)
            if tables.bones == 2:
                bound_regions(subs.size, target, problem.reach[1], bin1, bin2, block)
            filled += _enter(subs, block, strata.entries[filled:], weight[filled - first :])
        strata.ends[index] = filled
        if filled > first:
            own = strata.alias[first:filled]
            strata.totals[index] = alias_table(weight[: filled - first], own)


@compiled
def _pack(subs: np.ndarray, geometry: np.ndarray, block: Record) -> None:
    """Copies what is known of sub-cells to a block; of one bone, nothing else is to be
    found."""
    for n in range(subs.size):
        known = geometry[subs[n]].known
        for column in range(known.size):
            block.known[column, n] = known[column]
        block.weight[n] = block.mass[n]
        block.region[n] = 1.0
        block.mask[n] = 0.0


@compiled
def _enter(subs: np.ndarray, block: Record, entries: np.ndarray, weight: np.ndarray) -> int:
    """Adds the strata of a block to the table; returns how many they are. Without a
    branch: every row is written, and the next one takes its place where it has no
    weight."""
    count = 0
    for n in range(subs.size):
        entry = entries[count]
        weight[count] = block.weight[n]
        entry.region = block.region[n]
        entry.sub = subs[n]
        entry.mask = np.uint8(block.mask[n])
        count += int(block.weight[n] > 0)
    return count


@compiled
def _reached(
    problem: LimbProblem, geometry: np.ndarray, low: float, high: float, near: np.ndarray
) -> int:
    """Writes to `near` the sub-cells from which a length in [low, high] can reach the
    first disc; returns how many."""
    target0 = problem.target[0, 0]
    target1 = problem.target[0, 1]
    radius = problem.reach[0]
    middle = (low + high) / 2
    spread = (high - low) / 2
    count = 0
    for s in range(geometry.size):
        row = geometry[s]
        off0 = middle * row.image0 - target0
        off1 = middle * row.image1 - target1
        moves = spread * min(1.0, row.spread + row.chord) + middle * row.chord
        slack = radius + moves + SLACK
        near[count] = s
        count += int(off0 * off0 + off1 * off1 <= slack * slack)
    return count
