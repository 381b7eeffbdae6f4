"""The draw–project–test loop over strata. Compiled; in body units.

Bins of lengths are visited in order, so that their tables stay in the nearest cache. All attempts
draw lengths, then the first limb, then, where that explains its detections, the second. An attempt
draws a stratum, an upper direction in its sub-cell, asks whether the joint lies in its disc, draws
a lower direction in the stratum's region, and asks for the rest. What passes is a draw of the prior
that passes the indicator: no step is made again after a later one has failed.

A limb's attempts are made in blocks, step by step: look-ups and random numbers here, what is
computed of them in `blocks`; after each step the attempts that go on are packed together."""

from typing import NamedTuple

import numpy as np

from inference.exact.loops.bins import LengthBins, draw_lengths
from inference.exact.loops.blocks import (
    ACROSS,
    ALONG,
    BLOCK,
    BOUND,
    CENTRE0,
    CENTRE1,
    COS_AZIMUTH,
    DISTANCE,
    END0,
    END1,
    FALL,
    HEIGHT,
    HINGE,
    HINGE_COLUMNS,
    LENGTH1,
    LENGTH2,
    LIFT,
    LOW,
    PASSED,
    Q0,
    Q1,
    Q2,
    RADIUS,
    SIDE,
    SIN_AZIMUTH,
    SIZE,
    STRIDE,
    TEST,
    U0,
    U1,
    U2,
    WIDTH,
    lower_in_box,
    lower_in_piece,
    raise_upper,
    see_disc,
)
from inference.exact.loops.numbers import compiled, inlined, load, rows_of, store, uniform
from inference.exact.loops.rectangles import COUNT, PICK, ROWS
from inference.exact.loops.strata import BOX, Build, Sight, Strata
from probmodel.anatomy.limits import CELL

Limb = tuple[Sight, Build, Strata]


class Desk(NamedTuple):
    """What one thread writes on; made once, since memory that is new to a process is slow. Of each
    attempt: `length1`, `length2`, `bins`, `rows`, `kept`, and `found` `(n, 6)`; of a block:
    `pieces`, `boxes`, `entry`, `place`, `left` and `slot`."""

    length1: np.ndarray
    length2: np.ndarray
    bins: np.ndarray
    rows: np.ndarray
    kept: np.ndarray
    found: np.ndarray
    pieces: np.ndarray
    boxes: np.ndarray
    entry: np.ndarray
    place: np.ndarray
    left: np.ndarray
    slot: np.ndarray


def desk(most: int) -> Desk:
    """A desk for batches of up to `most` attempts."""

    def places(size: int) -> np.ndarray:
        return np.zeros(size, np.int64)

    return Desk(
        length1=np.ones(most),
        length2=np.ones(most),
        bins=places(most),
        rows=places(most),
        kept=places(most),
        found=np.zeros((most, 6)),
        pieces=np.zeros(SIZE),
        boxes=np.zeros(SIZE),
        entry=places(BLOCK),
        place=places(BLOCK),
        left=places(BLOCK),
        slot=places(BLOCK),
    )


@compiled
def attempt_bodies(
    state: np.ndarray,
    counts: np.ndarray,
    bins1: LengthBins,
    bins2: LengthBins,
    limbs: tuple[Limb, Limb],
    sub: int,
    desk: Desk,
    draws: np.ndarray,
) -> tuple[int, int]:
    """Attempts at a group of limbs, `counts` `(bins,)` of them in each bin of the lengths; of one
    limb, given twice, where `draws` has eight columns only.

    Fills rows of `draws` `(counts.sum(), 2 + 6 · limbs)`: the lengths, then each limb's upper and
    lower direction in their local frames. Returns how many rows it filled, and how many attempts
    passed the first limb."""
    length1, length2, bins, rows, kept, found = (
        desk.length1,
        desk.length2,
        desk.bins,
        desk.rows,
        desk.kept,
        desk.found,
    )
    number, number2 = 0, bins2.mass.size
    for index in range(counts.size):
        last = number + counts[index]
        if last == number:
            continue
        draw_lengths(bins1.shape, bins1.slices, index // number2, state, length1[number:last])
        if limbs[0][1].bones == 2:
            draw_lengths(bins2.shape, bins2.slices, index % number2, state, length2[number:last])
        for n in range(number, last):
            bins[n], rows[n] = index, n
        number = last
    passed = _attempt_limb(state, limbs[0], sub, rows[:number], desk)
    for n in range(passed):
        row = kept[n]
        rows[n], draws[n, 0], draws[n, 1] = row, length1[row], length2[row]
        draws[n, 2:8] = found[n]
    if draws.shape[1] == 8:
        return passed, passed
    done = _attempt_limb(state, limbs[1], sub, rows[:passed], desk)
    for n in range(done):
        draws[n, :8] = draws[kept[n], :8]
        draws[n, 8:] = found[n]
    return done, passed


@compiled
def _attempt_limb(state: np.ndarray, limb: Limb, sub: int, rows: np.ndarray, desk: Desk) -> int:
    """One attempt at a limb for each of `rows`, with the lengths and in the bins there. Writes the
    places in `rows` of those that pass to `kept`, in order, and their directions to `found`;
    returns how many."""
    sight, build, strata = limb
    frame, two, half = rows_of(sight.frame), build.bones == 2, CELL / sub / 2
    square1, radius2 = sight.radius[0] ** 2, sight.radius[1]
    pieces, boxes, entry, place = desk.pieces, desk.boxes, desk.entry, desk.place
    left, slot = desk.left, desk.slot
    kept, found, passed = desk.kept, desk.found, 0
    for start in range(0, rows.size, BLOCK):
        size = min(BLOCK, rows.size - start)
        _draw_strata(
            state, strata, desk.bins, desk.length1, rows[start : start + size], entry, pieces
        )
        raise_upper(
            size,
            half,
            build.by_area,
            frame,
            sight.target[0, 0],
            sight.target[0, 1],
            square1,
            pieces,
        )
        size = _sift(size, pieces, left)
        if not two:
            for n in range(size):
                kept[passed] = start + left[n]
                _copy(pieces, left[n], found, passed)
                found[passed, 3:] = 0.0
                passed += 1
            continue
        _pack_upper(state, strata, desk.length2, rows[start:], size, left, entry, place, pieces)
        see_disc(size, sight.target[1, 0], sight.target[1, 1], radius2, pieces)
        size = _sift(size, pieces, left)
        count = _pack_boxes(state, build, strata, size, left, entry, pieces, boxes, slot)
        lower_in_box(count, frame, build.axes, boxes)
        count = _pack_pieces(state, build, strata, size, left, entry, pieces, slot)
        lower_in_piece(count, frame, build.axes, pieces)
        for n in range(size):
            i = slot[n]
            kept[passed] = start + place[left[n]]
            if i >= 0:
                _copy(pieces, i, found, passed)
                passed += int(pieces[PASSED + i] > 0)
            else:
                _copy(boxes, ~i, found, passed)
                passed += int(boxes[PASSED + ~i] > 0)
    return passed


@inlined
def _copy(block: np.ndarray, i: int, found: np.ndarray, row: int) -> None:
    found[row, 0], found[row, 1], found[row, 2] = block[U0 + i], block[U1 + i], block[U2 + i]
    found[row, 3], found[row, 4], found[row, 5] = block[Q0 + i], block[Q1 + i], block[Q2 + i]


@compiled
def _draw_strata(
    state: np.ndarray,
    strata: Strata,
    bins: np.ndarray,
    lengths1: np.ndarray,
    rows: np.ndarray,
    entry: np.ndarray,
    block: np.ndarray,
) -> None:
    """A stratum for each row, by the alias table of its bin; the random numbers of the upper
    direction."""
    entries, subs, starts = strata.entries, strata.subs, strata.starts
    stream = load(state)
    for n in range(rows.size):
        row = rows[n]
        first = starts[bins[row]]
        at, stream = uniform(stream)
        at *= starts[bins[row] + 1] - first
        column = int(at)
        own, partner = first + column, first + int(entries[first + column, 1])
        # Without a branch, which would be guessed wrong half of the time.
        entry[n] = partner + (own - partner) * int(at - column < entries[own, 0])
        block[LENGTH1 + n] = lengths1[row]
    for n in range(rows.size):
        sub = np.uint64(entries[entry[n], 2])
        block[SIN_AZIMUTH + n], block[COS_AZIMUTH + n] = subs[sub, 1], subs[sub, 2]
        block[LIFT + n], block[FALL + n] = subs[sub, 3], subs[sub, 4]
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        block[ACROSS + n], block[ALONG + n] = across, along
    store(state, stream)


@compiled
def _sift(size: int, block: np.ndarray, left: np.ndarray) -> int:
    """Writes to `left` which attempts have passed; returns how many."""
    found = 0
    for n in range(size):
        left[found] = n
        found += int(block[PASSED + n] > 0)
    return found


@compiled
def _pack_upper(
    state: np.ndarray,
    strata: Strata,
    lengths2: np.ndarray,
    rows: np.ndarray,
    size: int,
    left: np.ndarray,
    entry: np.ndarray,
    place: np.ndarray,
    block: np.ndarray,
) -> None:
    """Packs what `see_disc` needs. A box needs no test of its area: its bound is 0 here."""
    entries, masks = strata.entries, strata.pieces
    stream = load(state)
    for n in range(size):
        i = left[n]
        entry[n], place[n] = entry[i], i
        block[U0 + n], block[U1 + n], block[U2 + n] = block[U0 + i], block[U1 + i], block[U2 + i]
        block[END0 + n], block[END1 + n] = block[END0 + i], block[END1 + i]
        block[LENGTH2 + n] = lengths2[rows[i]]
        block[BOUND + n] = entries[entry[n], 3] * int(masks[entry[n]] != 0)
        test, stream = uniform(stream)
        block[TEST + n] = test
    store(state, stream)


@compiled
def _pack_boxes(
    state: np.ndarray,
    build: Build,
    strata: Strata,
    size: int,
    left: np.ndarray,
    entry: np.ndarray,
    block: np.ndarray,
    boxes: np.ndarray,
    slot: np.ndarray,
) -> int:
    """Copies the attempts whose stratum is a box to a block of their own, with random numbers for
    the lower bone. Writes to `slot` their places there as ~place, and 0 for the others; returns how
    many there are."""
    cells, subs, entries, masks = build.cells, strata.subs, strata.entries, strata.pieces
    stream = load(state)
    found = 0
    for n in range(size):
        i = left[n]
        slot[n] = 0
        if masks[entry[i]] == 0:
            cell = np.uint64(subs[np.uint64(entries[entry[i], 2]), 0])
            across, stream = uniform(stream)
            along, stream = uniform(stream)
            low, first = cells[cell, BOX], cells[cell, BOX + 2]
            boxes[ACROSS + found] = min(1.0, max(-1.0, low + (cells[cell, BOX + 1] - low) * across))
            boxes[ALONG + found] = first + min(cells[cell, BOX + 3] - first, 2 * np.pi) * along
            boxes[TEST + found] = 0.0
            if build.flat:
                boxes[TEST + found], stream = uniform(stream)
            _pack_hinge(cells, cell, block, i, boxes, found)
            slot[n] = ~found
            found += 1
    store(state, stream)
    return found


@compiled
def _pack_pieces(
    state: np.ndarray,
    build: Build,
    strata: Strata,
    size: int,
    left: np.ndarray,
    entry: np.ndarray,
    block: np.ndarray,
    slot: np.ndarray,
) -> int:
    """Packs the attempts whose stratum is made of pieces, with random numbers for the lower bone.
    Writes their places to `slot`; returns how many there are."""
    cells, subs, entries, masks = build.cells, strata.subs, strata.entries, strata.pieces
    stream = load(state)
    found = 0
    for n in range(size):
        if slot[n] < 0:
            continue
        i = left[n]
        mask = masks[entry[i]]
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        along *= COUNT[mask]
        number = int(along)
        piece = PICK[mask, number]
        block[ACROSS + found], block[ALONG + found] = across, along - number + piece % ROWS
        block[SIDE + found] = 1.0 - 2.0 * int(piece >= ROWS)
        block[TEST + found] = 0.0
        if build.flat:
            block[TEST + found], stream = uniform(stream)
        block[WIDTH + found], block[LOW + found], block[HEIGHT + found] = (
            block[WIDTH + i],
            block[LOW + i],
            block[HEIGHT + i],
        )
        block[DISTANCE + found] = block[DISTANCE + i]
        _pack_hinge(
            cells, np.uint64(subs[np.uint64(entries[entry[i], 2]), 0]), block, i, block, found
        )
        slot[n] = found
        found += 1
    store(state, stream)
    return found


@inlined
def _pack_hinge(
    cells: np.ndarray, cell: np.uint64, block: np.ndarray, i: int, packed: np.ndarray, n: int
) -> None:
    """What every lower bone needs of attempt `i`: its disc, its parent, its hinge."""
    packed[CENTRE0 + n], packed[CENTRE1 + n], packed[RADIUS + n] = (
        block[CENTRE0 + i],
        block[CENTRE1 + i],
        block[RADIUS + i],
    )
    packed[U0 + n], packed[U1 + n], packed[U2 + n] = block[U0 + i], block[U1 + i], block[U2 + i]
    for column in range(HINGE_COLUMNS):
        packed[HINGE + column * STRIDE + n] = cells[cell, column]
