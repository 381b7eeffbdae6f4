"""The draw–project–test loop over strata. Compiled; in body units.

Bins of lengths are visited in order, so that their tables stay in the nearest cache. All attempts
draw lengths, then the first limb, then, where that explains its detections, the second. An attempt
draws a stratum, an upper direction in its sub-cell, asks whether the joint lies in its disc, draws
a lower direction in the stratum's region, and asks for the rest. What passes is a draw of the prior
that passes the indicator: no step is made again after a later one has failed.

A limb's attempts are made in blocks, step by step: look-ups and random numbers here, what is
computed of them in `blocks`; after each step the attempts that go on are packed together."""

import numpy as np

from poseterior.inference.exact.loops.bins import draw_lengths
from poseterior.inference.exact.loops.blocks import (
    lower_in_box,
    lower_in_piece,
    raise_upper,
    see_disc,
)
from poseterior.inference.exact.loops.numbers import (
    compiled,
    inlined,
    load,
    rows_of,
    store,
    uniform,
)
from poseterior.inference.exact.loops.rectangles import COUNT, PICK, ROWS
from poseterior.inference.exact.loops.tables import (
    BLOCK,
    Bodies,
    CutLimb,
    Desk,
    LengthBins,
    LimbTables,
    Record,
    Strata,
)
from poseterior.probmodel.anatomy.limits import CELL


@compiled
def attempt_lengths(
    state: np.ndarray,
    ends: np.ndarray,
    start: int,
    bins1: LengthBins,
    bins2: LengthBins,
    two: bool,
    desk: Desk,
) -> int:
    """Draws the lengths of the attempts from number `start` on, as many as the desk holds, bin by
    bin, the last of bin b being number ends[b] - 1; returns how many there are."""
    number, number2 = 0, bins2.mass.size
    most = min(desk.rows.size, ends[-1] - start)
    for index in range(np.searchsorted(ends, start, side="right"), ends.size):
        last = min(most, ends[index] - start)
        if last == number:
            continue
        draw_lengths(bins1, index // number2, state, desk.length1[number:last])
        if two:
            draw_lengths(bins2, index % number2, state, desk.length2[number:last])
        for n in range(number, last):
            desk.bins[n], desk.rows[n] = index, n
        number = last
        if number == most:
            break
    return number


@compiled
def hand_over(
    state: np.ndarray,
    number: int,
    first: Desk,
    second: Desk,
    order: np.ndarray,
    bodies: Bodies,
    found: int,
) -> int:
    """Adds the first `number` attempts that passed all limbs to `bodies`, of which there are
    `found`; returns how many there are now. Each takes the place of one of those that are there,
    itself included, which goes to the end: then every order is as likely as any other."""
    stream, two = load(state), order.size == 2
    for n in range(number):
        i = second.kept[n] if two else n
        row = first.kept[i]
        at, stream = uniform(stream)
        place = int(at * (found + 1))
        length = bodies.length
        length[found, 0], length[found, 1] = length[place, 0], length[place, 1]
        length[place, 0], length[place, 1] = first.length1[row], first.length2[row]
        _put(first, i, bodies, order[0], place, found)
        if two:
            _put(second, n, bodies, order[1], place, found)
        found += 1
    store(state, stream)
    return found


@compiled
def _put(desk: Desk, i: int, bodies: Bodies, limb: int, place: int, end: int) -> None:
    """Moves a limb's directions from `place` to the `end`, and puts those of attempt `i` there."""
    upper, lower = bodies.upper, bodies.lower
    for axis in range(3):
        upper[end, limb, axis] = upper[place, limb, axis]
        lower[end, limb, axis] = lower[place, limb, axis]
        upper[place, limb, axis] = desk.upper[i, axis]
        lower[place, limb, axis] = desk.lower[i, axis]


@compiled
def attempt_limb(state: np.ndarray, limb: CutLimb, sub: int, number: int, desk: Desk) -> int:
    """One attempt at a limb for each of the first `number` of the desk's `rows`, with the lengths
    and in the bins there. Writes the places in `rows` of those that pass to `kept`, in order, and
    their directions to `upper` and `lower`; returns how many."""
    problem, tables, strata = limb
    axes, half = rows_of(problem.axes), CELL / sub / 2
    target, reach, reference = problem.target, problem.reach, tables.reference
    pieces, boxes = desk.pieces[0], desk.boxes[0]
    left, slot, kept, passed = desk.left, desk.slot, desk.kept, 0
    for start in range(0, number, BLOCK):
        size = min(BLOCK, number - start)
        _draw_strata(state, strata, desk, start, size, pieces)
        square = reach[0] ** 2
        raise_upper(size, half, tables.by_area, axes, target[0, 0], target[0, 1], square, pieces)
        size = _sift(size, pieces, left)
        if tables.bones == 1:
            for n in range(size):
                kept[passed] = start + left[n]
                _copy(pieces, left[n], desk, passed)
                desk.lower[passed, 0] = desk.lower[passed, 1] = desk.lower[passed, 2] = 0.0
                passed += 1
            continue
        _pack_upper(state, strata, desk, start, size, pieces)
        see_disc(size, target[1, 0], target[1, 1], reach[1], pieces)
        size = _sift(size, pieces, left)
        count = _pack_boxes(state, tables, strata, desk, size, pieces, boxes)
        lower_in_box(count, axes, reference, boxes)
        count = _pack_pieces(state, tables, strata, desk, size, pieces)
        lower_in_piece(count, axes, reference, pieces)
        for n in range(size):
            i = slot[n]
            kept[passed] = start + desk.place[left[n]]
            if i >= 0:
                _copy(pieces, i, desk, passed)
                passed += int(pieces.passed[i] > 0)
            else:
                _copy(boxes, ~i, desk, passed)
                passed += int(boxes.passed[~i] > 0)
    return passed


@inlined
def _copy(block: Record, i: int, desk: Desk, n: int) -> None:
    upper, lower = desk.upper, desk.lower
    upper[n, 0], upper[n, 1], upper[n, 2] = block.u0[i], block.u1[i], block.u2[i]
    lower[n, 0], lower[n, 1], lower[n, 2] = block.q0[i], block.q1[i], block.q2[i]


@compiled
def _draw_strata(
    state: np.ndarray, strata: Strata, desk: Desk, start: int, size: int, block: Record
) -> None:
    """A stratum for each of `size` rows, by the alias table of its bin; the random numbers of the
    upper direction."""
    entries, subs, starts, ends = strata.entries, strata.subs, strata.starts, strata.ends
    stream, entry = load(state), desk.entry
    for n in range(size):
        row = desk.rows[start + n]
        first = starts[desk.bins[row]]
        at, stream = uniform(stream)
        at *= ends[desk.bins[row]] - first
        column = int(at)
        own = strata.alias[first + column]
        # Without a branch, which would be guessed wrong half of the time.
        entry[n] = first + own.partner + (column - own.partner) * int(at - column < own.share)
        block.length1[n] = desk.length1[row]
    for n in range(size):
        sub = subs[entries[entry[n]].sub]
        block.sin_azimuth[n], block.cos_azimuth[n] = sub.sin_azimuth, sub.cos_azimuth
        block.lift[n], block.fall[n] = sub.lift, sub.fall
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        block.across[n], block.along[n] = across, along
    store(state, stream)


@compiled
def _sift(size: int, block: Record, left: np.ndarray) -> int:
    """Writes to `left` which attempts have passed; returns how many."""
    found = 0
    for n in range(size):
        left[found] = n
        found += int(block.passed[n] > 0)
    return found


@compiled
def _pack_upper(
    state: np.ndarray, strata: Strata, desk: Desk, start: int, size: int, block: Record
) -> None:
    """Packs what `see_disc` needs. A box needs no test of its area: its bound is 0 here."""
    entry = desk.entry
    stream = load(state)
    for n in range(size):
        i = desk.left[n]
        entry[n], desk.place[n] = entry[i], i
        block.u0[n], block.u1[n], block.u2[n] = block.u0[i], block.u1[i], block.u2[i]
        block.end0[n], block.end1[n] = block.end0[i], block.end1[i]
        block.length2[n] = desk.length2[desk.rows[start + i]]
        stratum = strata.entries[entry[n]]
        block.bound[n] = stratum.region * int(stratum.mask != 0)
        test, stream = uniform(stream)
        block.test[n] = test
    store(state, stream)


@compiled
def _pack_boxes(
    state: np.ndarray,
    tables: LimbTables,
    strata: Strata,
    desk: Desk,
    size: int,
    block: Record,
    boxes: Record,
) -> int:
    """Copies the attempts whose stratum is a box to a block of their own, with random numbers for
    the lower bone. Writes to `slot` their places there as ~place, and 0 for the others; returns how
    many there are."""
    stream, found = load(state), 0
    for n in range(size):
        i = desk.left[n]
        desk.slot[n] = 0
        stratum = strata.entries[desk.entry[i]]
        if stratum.mask == 0:
            cell = tables.cells[strata.subs[stratum.sub].cell]
            across, stream = uniform(stream)
            along, stream = uniform(stream)
            u2 = cell.box_low + (cell.box_high - cell.box_low) * across
            turn = min(cell.box_last - cell.box_first, 2 * np.pi)
            boxes.across[found] = min(1.0, max(-1.0, u2))
            boxes.along[found] = cell.box_first + turn * along
            boxes.test[found] = 0.0
            if tables.flat:
                boxes.test[found], stream = uniform(stream)
            _pack_lower(cell, block, i, boxes, found)
            desk.slot[n] = ~found
            found += 1
    store(state, stream)
    return found


@compiled
def _pack_pieces(
    state: np.ndarray, tables: LimbTables, strata: Strata, desk: Desk, size: int, block: Record
) -> int:
    """Packs the attempts whose stratum is made of pieces, with random numbers for the lower bone.
    Writes their places to `slot`; returns how many there are."""
    stream, found = load(state), 0
    for n in range(size):
        if desk.slot[n] < 0:
            continue
        i = desk.left[n]
        stratum = strata.entries[desk.entry[i]]
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        along *= COUNT[stratum.mask]
        number = int(along)
        piece = PICK[stratum.mask, number]
        block.across[found], block.along[found] = across, along - number + piece % ROWS
        block.side[found] = 1.0 - 2.0 * int(piece >= ROWS)
        block.test[found] = 0.0
        if tables.flat:
            block.test[found], stream = uniform(stream)
        block.width[found], block.low[found] = block.width[i], block.low[i]
        block.height[found], block.distance[found] = block.height[i], block.distance[i]
        _pack_lower(tables.cells[strata.subs[stratum.sub].cell], block, i, block, found)
        desk.slot[n] = found
        found += 1
    store(state, stream)
    return found


@inlined
def _pack_lower(cell: Record, block: Record, i: int, packed: Record, n: int) -> None:
    """What every lower bone needs of attempt `i`: its disc, its parent, its hinge."""
    packed.centre0[n], packed.centre1[n] = block.centre0[i], block.centre1[i]
    packed.radius[n] = block.radius[i]
    packed.u0[n], packed.u1[n], packed.u2[n] = block.u0[i], block.u1[i], block.u2[i]
    for column in range(cell.hinge.size):
        packed.hinge[column, n] = cell.hinge[column]
