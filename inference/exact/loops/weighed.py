"""Attempts at the limbs of many roots, each with a weight, for an evidence without bias of every
root. Compiled; in body units.

Nothing is cut or set up. An attempt draws the upper bone uniformly from the rectangle around the
directions that put its joint into its disc, looks up what the prior has there, and draws the lower
bone from the smaller of two regions: the rectangle of its own disc, or its hinge's box. What
explains both detections counts by prior over proposal, so that the mean weight is the evidence.

Both limbs of a group make some attempts under each of some lengths: given the lengths they are
independent, so the mean over the lengths of the products of their means is the group's evidence.

A Gaussian error is uniform in a disc of random radius (Khintchine): with ρ² = σ² χ²(4 degrees of
freedom), its density over the peak is E 2σ²/ρ² 1[|e| ≤ ρ]. A prior that is uniform in angles has no
bound by area at the poles: the first attempt under every lengths goes to the lines of cells around
them, and all count by the mixture of both proposals (docs/model.md § 9)."""

import math

import numpy as np

from inference.exact.loops.bins import draw_lengths
from inference.exact.loops.numbers import (
    Rows,
    Stream,
    compiled,
    inlined,
    load,
    rows_of,
    store,
    uniform,
)
from inference.exact.loops.rectangles import rectangle
from inference.exact.loops.strata import lower_axes
from inference.exact.loops.tables import LengthBins, LimbTables, Record
from probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION

_EDGES = np.sin(np.arange(NUM_ELEVATION + 1) * CELL - np.pi / 2)
HEIGHT = _EDGES[1:] - _EDGES[:-1]
"""`(60,)`: differences of the sine of the elevation, by line of cells."""
LEAST = 1e-300
"""A squared radius, for a uniform number that is exactly zero."""

FOUND = np.dtype(
    [
        ("trial", np.int64),
        ("weight", float),
        ("square", float, (2,)),
        ("upper", float, (3,)),
        ("lower", float, (3,)),
    ],
    align=True,
)
"""Attempts that explain their detections: under which lengths, the weight, the squared distances of
the joints from their targets, directions in local frames (the lower one zero in limbs of one bone).
"""
OPTICS = np.dtype(
    [("start", float), ("slope", float, (3,)), ("stretch", float, (3,))],
    align=True,
)
"""How one joint of a limb is seen. Its distance from the camera over the pelvis' is `start` +
`slope` · what of the limb leads to it, in the upper bone's local frame; under weak perspective 1.
What lies beside the line of sight becomes what lies beside it in a plane parallel to the image by a
symmetric matrix, the `stretch` xx, xy, yy; where the line runs straight on, the identity."""
Direction = tuple[float, float, float]


@compiled
def draw_trials(states: np.ndarray, bins: LengthBins, lengths: np.ndarray) -> None:
    """Fills `lengths` `(n, trials)` with draws of the prior, those of each root by its own of the
    `states` `(n, 4)`."""
    for row in range(len(lengths)):
        draw_lengths(bins, 0, states[row], lengths[row])


@compiled
def attempt_rows(
    states: np.ndarray,
    axes: np.ndarray,
    target: np.ndarray,
    reach: np.ndarray,
    deviation: np.ndarray,
    optics: np.ndarray,
    tables: LimbTables,
    length1: np.ndarray,
    length2: np.ndarray,
    each: int,
    found: np.ndarray,
    ends: np.ndarray,
) -> None:
    """Makes `each` attempts at one limb under every root and every one of its lengths.

    Parameters
    ----------
    states : `(n, 4)` of each root's random numbers, written on
    axes : `(n, 2, 3, 3)` the limb's local frame in the axes in which each joint is seen
    target : `(n, 2, 2)` the detected joints minus the limb's start, in the same axes
    reach : `(n, 2)` how far from there joints may fall, infinite where nothing was seen
    deviation : `(n, 2)` of errors that are Gaussian within the reach; 0 where they are uniform
    optics : `(n, 2)` `OPTICS`
    tables : what the model says of the limb
    length1, length2 : `(n, trials)` of its bones
    each : attempts, two at least
    found : `(n · trials · each,)` `FOUND`, written on
    ends : `(n,)` written on: where in `found` each root's end
    """
    count = 0
    for row in range(len(states)):
        stream, frame = load(states[row]), rows_of(axes[row, 0])
        second = rows_of(axes[row, 1])
        for trial in range(length1.shape[1]):
            one, two = length1[row, trial], length2[row, trial]
            for attempt in range(each):
                entry = found[count]
                weight, stream = _attempt(
                    stream,
                    frame,
                    second,
                    target[row],
                    reach[row],
                    deviation[row],
                    optics[row],
                    tables,
                    one,
                    two,
                    attempt == 0 and not tables.by_area,
                    1 / each,
                    entry,
                )
                entry.trial, entry.weight = trial, weight
                count += int(weight > 0)
        ends[row] = count
        store(states[row], stream)


@inlined
def _radius(reach: float, deviation: float, stream: Stream) -> tuple[float, float, Stream]:
    """The radius of a disc in which the error is uniform, and what it counts."""
    if deviation == 0:
        return reach, 1.0, stream
    one, stream = uniform(stream)
    two, stream = uniform(stream)
    square = max(-2 * (math.log1p(-one) + math.log1p(-two)), LEAST)
    return min(deviation * math.sqrt(square), reach), 2 / square, stream


@inlined
def _in_rectangle(
    centre0: float, centre1: float, distance: float, size: tuple, stream: Stream
) -> tuple[float, float, float, Stream]:
    """A direction of the rectangle `size` around a disc, uniform by area, in front or behind;
    camera axes."""
    width, low, high = size
    across, stream = uniform(stream)
    along, stream = uniform(stream)
    front = along < 0.5
    x = width * (2 * across - 1)
    rest = max(0.0, 1 - x * x)
    t = math.sqrt(rest) * math.sin(low + (high - low) * (2 * along - (0.0 if front else 1.0)))
    z = math.sqrt(max(0.0, rest - t * t))
    towards0 = centre0 / distance if distance > 1e-300 else 1.0
    towards1 = centre1 / distance if distance > 1e-300 else 0.0
    return (
        towards0 * t - towards1 * x,
        towards1 * t + towards0 * x,
        z if front else -z,
        stream,
    )


@inlined
def _near_pole(frame: Rows, stream: Stream) -> tuple[float, float, float, Stream]:
    """A direction in the two outermost lines of cells, uniform in angles; camera axes, from joint
    to joint."""
    turn, stream = uniform(stream)
    height, stream = uniform(stream)
    azimuth, above = 2 * math.pi * turn, height < 0.5
    from_pole = CELL * (2 * height - (0.0 if above else 1.0))
    planar, lift = math.sin(from_pole), math.cos(from_pole) * (1.0 if above else -1.0)
    u0, u1 = planar * math.cos(azimuth), planar * math.sin(azimuth)
    return (
        -(frame[0] * u0 + frame[1] * u1 + frame[2] * lift),
        -(frame[3] * u0 + frame[4] * u1 + frame[5] * lift),
        -(frame[6] * u0 + frame[7] * u1 + frame[8] * lift),
        stream,
    )


@inlined
def _local(frame: Rows, d0: float, d1: float, d2: float) -> Direction:
    """From camera axes; bones are parent minus child, hence the sign."""
    return (
        -(frame[0] * d0 + frame[3] * d1 + frame[6] * d2),
        -(frame[1] * d0 + frame[4] * d1 + frame[7] * d2),
        -(frame[2] * d0 + frame[5] * d1 + frame[8] * d2),
    )


@inlined
def _across(frame: Rows, u0: float, u1: float, u2: float) -> tuple[float, float]:
    """What a bone of local direction `u` moves across the line of sight, from joint to joint."""
    return (
        -(frame[0] * u0 + frame[1] * u1 + frame[2] * u2),
        -(frame[3] * u0 + frame[4] * u1 + frame[5] * u2),
    )


@inlined
def _along(optic: Record, u0: float, u1: float, u2: float) -> float:
    """What a bone of local direction `u` and length one adds to the distance over the pelvis'."""
    return optic.slope[0] * u0 + optic.slope[1] * u1 + optic.slope[2] * u2


@inlined
def _square(optic: Record, off0: float, off1: float) -> float:
    """The squared distance in a plane parallel to the image of what lies `off` beside the line of
    sight."""
    x = optic.stretch[0] * off0 + optic.stretch[1] * off1
    y = optic.stretch[1] * off0 + optic.stretch[2] * off1
    return x * x + y * y


@compiled
def _attempt(
    stream: Stream,
    frame: Rows,
    second: Rows,
    target: np.ndarray,
    reach: np.ndarray,
    deviation: np.ndarray,
    optics: np.ndarray,
    tables: LimbTables,
    length1: float,
    length2: float,
    polar: bool,
    capped: float,
    entry: Record,
) -> tuple[float, Stream]:
    """One attempt, `polar` as a share `capped` of them is, written to `entry`; its weight, 0 where
    it fails, and the stream after it."""
    radius, share, stream = _radius(reach[0], deviation[0], stream)
    centre0, centre1 = target[0, 0] / length1, target[0, 1] / length1
    distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
    size = rectangle(distance, radius / length1)
    area = 4 * size[0] * (size[2] - size[1])
    if area <= 0:
        return 0.0, stream
    if polar:
        d0, d1, d2, stream = _near_pole(frame, stream)
    else:
        d0, d1, d2, stream = _in_rectangle(centre0, centre1, distance, size, stream)
    optic = optics[0]
    square = _square(optic, d0 * length1 - target[0, 0], d1 * length1 - target[0, 1])
    if square > radius * radius:
        return 0.0, stream
    u0, u1, u2 = _local(frame, d0, d1, d2)
    column = min(int((math.atan2(u1, u0) + math.pi) / CELL), NUM_AZIMUTH - 1)
    lift = math.asin(min(1.0, max(-1.0, u2)))
    line = min(int((lift + math.pi / 2) / CELL), NUM_ELEVATION - 1)
    cell = tables.cells[column * NUM_ELEVATION + line]
    if cell.mass <= 0:
        return 0.0, stream
    away = optic.start + length1 * _along(optic, u0, u1, u2)
    weight = away * away * share * cell.mass / CELL
    weight *= _over_proposal(tables.by_area, line, u2, area, capped)
    entry.upper[0], entry.upper[1], entry.upper[2] = u0, u1, u2
    entry.square[0], entry.square[1] = square, 0.0
    if tables.bones == 1:
        entry.lower[0] = entry.lower[1] = entry.lower[2] = 0.0
        return weight, stream
    d0, d1 = _across(second, u0, u1, u2)
    gap0, gap1 = target[1, 0] - length1 * d0, target[1, 1] - length1 * d1
    optic = optics[1]
    begins = optic.start + length1 * _along(optic, u0, u1, u2)
    lower, stream = _attempt_lower(
        stream,
        second,
        gap0,
        gap1,
        reach[1],
        deviation[1],
        optic,
        begins,
        tables,
        length2,
        cell,
        entry,
    )
    return weight * lower, stream


@inlined
def _over_proposal(by_area: bool, line: int, lift: float, area: float, capped: float) -> float:
    """CELL × the prior's density in a cell of mass one over that of what is proposed: uniform in
    the rectangle, and a share `capped` near the poles, uniform in angles."""
    if by_area:
        return area / HEIGHT[line]
    planar = math.sqrt(max(1 - lift * lift, LEAST))
    near = 1 / (4 * math.pi * CELL) if line == 0 or line == NUM_ELEVATION - 1 else 0.0
    proposed = (1 - capped) * planar / area + capped * near
    return 1 / (CELL * proposed)


@compiled
def _attempt_lower(
    stream: Stream,
    frame: Rows,
    gap0: float,
    gap1: float,
    reach: float,
    deviation: float,
    optic: Record,
    begins: float,
    tables: LimbTables,
    length: float,
    cell: Record,
    entry: Record,
) -> tuple[float, Stream]:
    """The lower bone, whose joint is detected at `gap` from where it starts, as far away as
    `begins` says: what the attempt counts, 0 where it fails, and the stream after it."""
    radius, share, stream = _radius(reach, deviation, stream)
    centre0, centre1 = gap0 / length, gap1 / length
    distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
    size = rectangle(distance, radius / length)
    patch = 4 * size[0] * (size[2] - size[1])
    turn = min(max(cell.box_last - cell.box_first, 0.0), 2 * math.pi)
    box = max(cell.box_high - cell.box_low, 0.0) * turn
    region = min(patch, box)
    if region <= 0:
        return 0.0, stream
    u0, u1, u2 = entry.upper[0], entry.upper[1], entry.upper[2]
    v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, tables.reference)
    triple = cell.triple
    if patch <= box:
        d0, d1, d2, stream = _in_rectangle(centre0, centre1, distance, size, stream)
        p0, p1, p2 = _local(frame, d0, d1, d2)
        q0 = u0 * p0 + u1 * p1 + u2 * p2
        q1 = v0 * p0 + v1 * p1 + v2 * p2
        q2 = w0 * p0 + w1 * p1 + w2 * p2
        h1 = triple[0] * q0 + triple[1] * q1 + triple[2] * q2
        h2 = triple[3] * q0 + triple[4] * q1 + triple[5] * q2
        h3 = triple[6] * q0 + triple[7] * q1 + triple[8] * q2
    else:
        across, stream = uniform(stream)
        along, stream = uniform(stream)
        h2 = cell.box_low + (cell.box_high - cell.box_low) * across
        rho, angle = math.sqrt(max(0.0, 1 - h2 * h2)), cell.box_first + turn * along
        h1, h3 = -rho * math.cos(angle), rho * math.sin(angle)
        q0 = triple[0] * h1 + triple[3] * h2 + triple[6] * h3
        q1 = triple[1] * h1 + triple[4] * h2 + triple[7] * h3
        q2 = triple[2] * h1 + triple[5] * h2 + triple[8] * h3
        p0 = u0 * q0 + v0 * q1 + w0 * q2
        p1 = u1 * q0 + v1 * q1 + w1 * q2
        p2 = u2 * q0 + v2 * q1 + w2 * q2
        d0, d1 = _across(frame, p0, p1, p2)
    square = _square(optic, length * d0 - gap0, length * d1 - gap1)
    if square > radius * radius or h1 + cell.offset > 0:
        return 0.0, stream
    if h2 < cell.low2 or h2 > cell.high2 or h3 < cell.low3 or h3 > cell.high3:
        return 0.0, stream
    entry.square[1] = square
    entry.lower[0], entry.lower[1], entry.lower[2] = q0, q1, q2
    away = begins + length * _along(optic, p0, p1, p2)
    share *= away * away
    return share * region / cell.area * (abs(h1) if tables.flat else 1.0), stream


@compiled
def combine_rows(
    states: np.ndarray,
    first: np.ndarray,
    ends1: np.ndarray,
    second: np.ndarray,
    ends2: np.ndarray,
    trials: int,
    each: int,
    evidence: np.ndarray,
    kept: np.ndarray,
) -> None:
    """The evidence of a group of two limbs under every root, and draws of it.

    Parameters
    ----------
    states : `(n, 4)` of each root's random numbers, written on
    first, ends1, second, ends2 : of both limbs, as `attempt_rows` left them
    trials, each : lengths, and attempts under each of them
    evidence : `(n,)` written on
    kept : `(n, most, 2)` written on: the places of both limbs' attempts of as many draws, alike in
        weight; left as they are where there is no evidence
    """
    one, two, product = np.empty(trials), np.empty(trials), np.empty(trials)
    from1, from2 = np.empty(trials + 1, np.int64), np.empty(trials + 1, np.int64)
    begin1, begin2 = 0, 0
    for row in range(len(states)):
        _sums(first, begin1, ends1[row], one, from1)
        _sums(second, begin2, ends2[row], two, from2)
        begin1, begin2 = ends1[row], ends2[row]
        total = 0.0
        for trial in range(trials):
            total += one[trial] * two[trial]
            product[trial] = total
        evidence[row] = total / (trials * float(each) ** 2)
        if total <= 0:
            continue
        stream, most, trial = load(states[row]), kept.shape[1], 0
        offset, stream = uniform(stream)
        for n in range(most):
            while product[trial] < total * (n + offset) / most and trial < trials - 1:
                trial += 1
            while one[trial] * two[trial] <= 0:  # rounding, at the very end
                trial -= 1
            test, stream = uniform(stream)
            kept[row, n, 0] = _picked(first, from1[trial], from1[trial + 1], test * one[trial])
            test, stream = uniform(stream)
            kept[row, n, 1] = _picked(second, from2[trial], from2[trial + 1], test * two[trial])
        store(states[row], stream)


@compiled
def _sums(found: np.ndarray, begin: int, end: int, sums: np.ndarray, starts: np.ndarray) -> None:
    """The weights of each trial, summed, and where in `found` each begins."""
    sums[:] = 0.0
    place = begin
    for trial in range(sums.size):
        starts[trial] = place
        while place < end and found[place].trial == trial:
            sums[trial] += found[place].weight
            place += 1
    starts[sums.size] = place


@compiled
def _picked(found: np.ndarray, begin: int, end: int, level: float) -> int:
    """Where the sum of the weights from `begin` on passes a level."""
    place, last = begin, begin
    while place < end:
        weight = found[place].weight
        if weight > 0:
            last = place
            if level < weight:
                return place
        level -= weight
        place += 1
    return last
