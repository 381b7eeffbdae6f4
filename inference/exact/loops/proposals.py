"""The draw–project–test loop over strata. Compiled; in body units.

Bins of lengths are visited in order, so that their tables stay in the nearest cache.
All proposals draw lengths, then the first limb, then, where that explains its
detections, the second. A proposal draws a stratum, an upper direction in its sub-cell,
asks whether the joint lies in its disc, draws a lower direction in the stratum's
region, and asks for the rest. What passes is a draw of the prior that passes the
indicator: no step is made again after a later one has failed.

A limb's proposals are made in blocks, step by step: look-ups and random numbers here,
what is computed of them in `blocks`; after each step the proposals that go on are
packed together."""

import numpy as np

from poseterior.inference.exact.loops.bins import draw_lengths
from poseterior.inference.exact.loops.blocks import (
    lower_in_box,
    lower_in_piece,
    raise_upper,
    see_disc,
)
from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.rectangles import COUNT, PICK, ROWS
from poseterior.inference.exact.loops.tables import (
    BLOCK,
    Bodies,
    CutLimb,
    LengthBins,
    Record,
    Strata,
    Workspace,
)
from poseterior.inference.exact.loops.vectors import axes_of
from poseterior.probmodel.anatomy.limits import CELL


@compiled
def propose_lengths(
    state: np.ndarray,
    ends: np.ndarray,
    start: int,
    bins: tuple[LengthBins, LengthBins],
    two: bool,
    workspace: Workspace,
) -> int:
    """Draws the lengths of the proposals from number `start` on, as many as the
    workspace holds, bin by bin, the last of bin b being number ends[b] - 1; returns how
    many there are."""
    bins1, bins2 = bins
    number2 = bins2.mass.size
    most = min(workspace.rows.size, ends[-1] - start)
    number = 0
    for index in range(np.searchsorted(ends, start, side="right"), ends.size):
        last = min(most, ends[index] - start)
        if last == number:
            continue
        draw_lengths(bins1, index // number2, state, workspace.length1[number:last])
        if two:
            draw_lengths(bins2, index % number2, state, workspace.length2[number:last])
        for n in range(number, last):
            workspace.bins[n] = index
            workspace.rows[n] = n
        number = last
        if number == most:
            break
    return number


@compiled
def add_bodies(
    state: np.ndarray,
    number: int,
    workspaces: tuple[Workspace, Workspace],
    order: np.ndarray,
    bodies: Bodies,
    held: int,
) -> int:
    """Adds the first `number` proposals that passed all limbs to `bodies`, which holds
    so many already; returns how many it holds now. Each takes the place of one of those
    that are there, itself included, which goes to the end: then every order is as
    likely as any other."""
    first, second = workspaces
    stream = load(state)
    two = order.size == 2
    length = bodies.length
    for n in range(number):
        i = second.accepted[n] if two else n
        row = first.accepted[i]
        at, stream = uniform(stream)
        place = int(at * (held + 1))
        length[held, 0] = length[place, 0]
        length[held, 1] = length[place, 1]
        length[place, 0] = first.length1[row]
        length[place, 1] = first.length2[row]
        _put(first, i, bodies, order[0], place, held)
        if two:
            _put(second, n, bodies, order[1], place, held)
        held += 1
    store(state, stream)
    return held


@compiled
def _put(workspace: Workspace, i: int, bodies: Bodies, limb: int, place: int, end: int) -> None:
    """Moves a limb's directions from `place` to the `end`, and puts those of proposal
    `i` there."""
    upper = bodies.upper
    lower = bodies.lower
    for axis in range(3):
        upper[end, limb, axis] = upper[place, limb, axis]
        lower[end, limb, axis] = lower[place, limb, axis]
        upper[place, limb, axis] = workspace.upper[i, axis]
        lower[place, limb, axis] = workspace.lower[i, axis]


@compiled
def propose_limb(
    state: np.ndarray, limb: CutLimb, sub: int, number: int, workspace: Workspace
) -> int:
    """One proposal of a limb for each of the first `number` of the workspace's `rows`,
    with the lengths and in the bins there. Writes the places in `rows` of those that
    pass to `accepted`, in order, and their directions to `upper` and `lower`; returns
    how many."""
    problem, tables, strata = limb
    axes = axes_of(problem.axes)
    half = CELL / sub / 2
    target = problem.target
    reach = problem.reach
    first = target[0, 0], target[0, 1], reach[0] ** 2
    second = target[1, 0], target[1, 1], reach[1]
    pieces = workspace.pieces[0]
    boxes = workspace.boxes[0]
    left = workspace.left
    slot = workspace.slot
    accepted = workspace.accepted
    passed = 0
    for start in range(0, number, BLOCK):
        size = min(BLOCK, number - start)
        _draw_strata(state, strata, start, size, workspace)
        raise_upper(size, half, tables.by_area, axes, first, pieces)
        size = _sift(size, pieces, left)
        if tables.bones == 1:
            for n in range(size):
                accepted[passed] = start + left[n]
                _copy(pieces, left[n], workspace, passed)
                for axis in range(3):
                    workspace.lower[passed, axis] = 0.0
                passed += 1
            continue
        _pack_upper(state, strata, start, size, workspace)
        see_disc(size, second, pieces)
        size = _sift(size, pieces, left)
        count = _pack_boxes(state, limb, size, workspace)
        lower_in_box(count, axes, tables.reference, boxes)
        count = _pack_pieces(state, limb, size, workspace)
        lower_in_piece(count, axes, tables.reference, pieces)
        for n in range(size):
            i = slot[n]
            accepted[passed] = start + workspace.place[left[n]]
            # Copied in any case, and counted where it has passed: the next one takes
            # its place.
            if i >= 0:
                _copy(pieces, i, workspace, passed)
                passed += int(pieces.passed[i] > 0)
            else:
                _copy(boxes, ~i, workspace, passed)
                passed += int(boxes.passed[~i] > 0)
    return passed


@inlined
def _copy(block: Record, i: int, workspace: Workspace, n: int) -> None:
    upper = workspace.upper
    lower = workspace.lower
    upper[n, 0] = block.u0[i]
    upper[n, 1] = block.u1[i]
    upper[n, 2] = block.u2[i]
    lower[n, 0] = block.q0[i]
    lower[n, 1] = block.q1[i]
    lower[n, 2] = block.q2[i]


@compiled
def _draw_strata(
    state: np.ndarray, strata: Strata, start: int, size: int, workspace: Workspace
) -> None:
    """A stratum for each of `size` rows, by the alias table of its bin; the random
    numbers of the upper direction."""
    block = workspace.pieces[0]
    entry = workspace.entry
    entries = strata.entries
    subs = strata.subs
    starts = strata.starts
    ends = strata.ends
    stream = load(state)
    for n in range(size):
        row = workspace.rows[start + n]
        first = starts[workspace.bins[row]]
        at, stream = uniform(stream)
        at *= ends[workspace.bins[row]] - first
        column = int(at)
        own = strata.alias[first + column]
        # Without a branch, which would be guessed wrong half of the time.
        entry[n] = first + own.partner + (column - own.partner) * int(at - column < own.share)
        block.length1[n] = workspace.length1[row]
    for n in range(size):
        sub = subs[entries[entry[n]].sub]
        block.sin_azimuth[n] = sub.sin_azimuth
        block.cos_azimuth[n] = sub.cos_azimuth
        block.lift[n] = sub.lift
        block.fall[n] = sub.fall
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        block.across[n] = across
        block.along[n] = along
    store(state, stream)


@compiled
def _sift(size: int, block: Record, left: np.ndarray) -> int:
    """Writes to `left` which proposals have passed; returns how many. Without a branch:
    every number is written, and the next one takes its place where it has not
    passed."""
    passed = 0
    for n in range(size):
        left[passed] = n
        passed += int(block.passed[n] > 0)
    return passed


@compiled
def _pack_upper(
    state: np.ndarray, strata: Strata, start: int, size: int, workspace: Workspace
) -> None:
    """Packs what `see_disc` needs. A box needs no test of its area: its bound is 0
    here."""
    block = workspace.pieces[0]
    entry = workspace.entry
    stream = load(state)
    for n in range(size):
        i = workspace.left[n]
        entry[n] = entry[i]
        workspace.place[n] = i
        block.u0[n] = block.u0[i]
        block.u1[n] = block.u1[i]
        block.u2[n] = block.u2[i]
        block.end0[n] = block.end0[i]
        block.end1[n] = block.end1[i]
        block.length2[n] = workspace.length2[workspace.rows[start + i]]
        stratum = strata.entries[entry[n]]
        block.bound[n] = stratum.region * int(stratum.mask != 0)
        test, stream = uniform(stream)
        block.test[n] = test
    store(state, stream)


@compiled
def _pack_boxes(state: np.ndarray, limb: CutLimb, size: int, workspace: Workspace) -> int:
    """Copies the proposals whose stratum is a box to a block of their own, with random
    numbers for the lower bone. Writes to `slot` their places there as ~place, and 0 for
    the others; returns how many there are."""
    _, tables, strata = limb
    block = workspace.pieces[0]
    boxes = workspace.boxes[0]
    stream = load(state)
    count = 0
    for n in range(size):
        i = workspace.left[n]
        workspace.slot[n] = 0
        stratum = strata.entries[workspace.entry[i]]
        if stratum.mask == 0:
            cell = tables.cells[strata.subs[stratum.sub].cell]
            across, stream = uniform(stream)
            along, stream = uniform(stream)
            u2 = cell.box_low + (cell.box_high - cell.box_low) * across
            turn = min(cell.box_last - cell.box_first, 2 * np.pi)
            boxes.across[count] = min(1.0, max(-1.0, u2))
            boxes.along[count] = cell.box_first + turn * along
            boxes.test[count] = 0.0
            if tables.flat:
                boxes.test[count], stream = uniform(stream)
            _pack_lower(cell, block, i, boxes, count)
            workspace.slot[n] = ~count
            count += 1
    store(state, stream)
    return count


@compiled
def _pack_pieces(state: np.ndarray, limb: CutLimb, size: int, workspace: Workspace) -> int:
    """Packs the proposals whose stratum is made of pieces, with random numbers for the
    lower bone. Writes their places to `slot`; returns how many there are."""
    _, tables, strata = limb
    block = workspace.pieces[0]
    stream = load(state)
    count = 0
    for n in range(size):
        if workspace.slot[n] < 0:
            continue
        i = workspace.left[n]
        stratum = strata.entries[workspace.entry[i]]
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        along *= COUNT[stratum.mask]
        number = int(along)
        piece = PICK[stratum.mask, number]
        block.across[count] = across
        block.along[count] = along - number + piece % ROWS
        block.side[count] = 1.0 - 2.0 * int(piece >= ROWS)
        block.test[count] = 0.0
        if tables.flat:
            block.test[count], stream = uniform(stream)
        block.width[count] = block.width[i]
        block.low[count] = block.low[i]
        block.height[count] = block.height[i]
        block.distance[count] = block.distance[i]
        _pack_lower(tables.cells[strata.subs[stratum.sub].cell], block, i, block, count)
        workspace.slot[n] = count
        count += 1
    store(state, stream)
    return count


@inlined
def _pack_lower(cell: Record, block: Record, i: int, packed: Record, n: int) -> None:
    """What every lower bone needs of proposal `i`: its disc, its parent, its hinge."""
    packed.centre0[n] = block.centre0[i]
    packed.centre1[n] = block.centre1[i]
    packed.radius[n] = block.radius[i]
    packed.u0[n] = block.u0[i]
    packed.u1[n] = block.u1[i]
    packed.u2[n] = block.u2[i]
    for column in range(cell.hinge.size):
        packed.hinge[column, n] = cell.hinge[column]
