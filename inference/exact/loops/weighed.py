"""Attempts at the limbs of many roots, each with a weight, for an evidence without bias of every
root. Compiled; in body units.

Nothing is cut or set up. An attempt draws the upper bone uniformly from the rectangle around the
directions that put its joint into its disc, looks up what the prior has there, and draws the lower
bone from the smaller of two regions: the rectangle of its own disc, or its hinge's box. What
explains both detections counts by prior over proposal, so that the mean weight is the evidence.

Both limbs of a group make some attempts under each of some lengths (`pairs`).

A Gaussian error is uniform in a disc of random radius (Khintchine): with ρ² = σ² χ²(4 degrees of
freedom), its density over the peak is E 2σ²/ρ² 1[|e| ≤ ρ]. A prior that is uniform in angles has no
bound by area at the poles: the first attempt under all lengths goes to the lines of cells around
them, and all count by the mixture of both proposals (docs/model.md § 9)."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import draw_lengths
from poseterior.inference.exact.loops.numbers import (
    Rows,
    Stream,
    compiled,
    inlined,
    load,
    rows_of,
    store,
    uniform,
)
from poseterior.inference.exact.loops.rectangles import rectangle
from poseterior.inference.exact.loops.series import arcsine, azimuth, circle, cosine, sine
from poseterior.inference.exact.loops.strata import lower_axes
from poseterior.inference.exact.loops.tables import LengthBins, LimbTables, Record, Reference
from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION

_EDGES = np.sin(np.arange(NUM_ELEVATION + 1) * CELL - np.pi / 2)
HEIGHT = _EDGES[1:] - _EDGES[:-1]
"""`(60,)`: differences of the sine of the elevation, by line of cells."""
LEAST = 1e-300
"""A square, in the place of zero."""

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
    count, cells = 0, tables.cells
    for row in range(len(states)):
        stream = load(states[row])
        first = _sight(axes[row, 0], target[row, 0], reach[row, 0], deviation[row, 0])
        second = _sight(axes[row, 1], target[row, 1], reach[row, 1], deviation[row, 1])
        optic1, optic2 = optics[row, 0], optics[row, 1]
        for trial in range(length1.shape[1]):
            one, two = length1[row, trial], length2[row, trial]
            aim = _aim(first.target0 / one, first.target1 / one, first.reach / one)
            for attempt in range(each):
                radius, share, stream = _radius(first, stream)
                if first.deviation > 0:
                    aim = _aim(aim.centre0, aim.centre1, radius / one)
                if aim.area <= 0:
                    continue
                if attempt == 0 and not tables.by_area:
                    d0, d1, d2, stream = _near_pole(first.frame, stream)
                else:
                    d0, d1, d2, stream = _in_rectangle(aim, stream)
                square1 = _square(optic1, d0 * one - first.target0, d1 * one - first.target1)
                if square1 > radius * radius:
                    continue
                u0, u1, u2 = upper = _local(first.frame, d0, d1, d2)
                column, line = _cell_of(u0, u1, u2)
                cell = cells[column * NUM_ELEVATION + line]
                if cell.mass <= 0:
                    continue
                away = optic1.start + one * _along(optic1, u0, u1, u2)
                weight = away * away * share * cell.mass / CELL
                weight *= _over_proposal(tables.by_area, line, u2, aim.area, 1 / each)
                lower, square2 = (0.0, 0.0, 0.0), 0.0
                if tables.bones == 2:
                    lower, square2, ratio, stream = _attempt_lower(
                        stream,
                        second,
                        optic2,
                        upper,
                        cell,
                        one,
                        two,
                        tables.reference,
                        tables.flat,
                    )
                    weight *= ratio
                if weight > 0:
                    _write(found[count], trial, weight, square1, square2, upper, lower)
                    count += 1
        ends[row] = count
        store(states[row], stream)


class JointSight(NamedTuple):
    """Of one joint under one root what `attempt_rows` is given, in numbers."""

    frame: Rows
    target0: float
    target1: float
    reach: float
    deviation: float


@compiled
def _sight(axes: np.ndarray, target: np.ndarray, reach: float, deviation: float) -> JointSight:
    return JointSight(rows_of(axes), target[0], target[1], reach, deviation)


class Aim(NamedTuple):
    """What a bone of length one is to reach: a disc around `centre0` and `centre1`, at a
    `distance`, the rectangle around its directions, and the rectangles' area, in front and behind
    together."""

    centre0: float
    centre1: float
    distance: float
    width: float
    low: float
    high: float
    area: float


@inlined
def _aim(centre0: float, centre1: float, radius: float) -> Aim:
    distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
    width, low, high = rectangle(distance, radius)
    return Aim(centre0, centre1, distance, width, low, high, 4 * width * (high - low))


@inlined
def _write(
    entry: Record,
    trial: int,
    weight: float,
    square1: float,
    square2: float,
    upper: Direction,
    lower: Direction,
) -> None:
    entry.trial, entry.weight = trial, weight
    entry.square[0], entry.square[1] = square1, square2
    entry.upper[0], entry.upper[1], entry.upper[2] = upper
    entry.lower[0], entry.lower[1], entry.lower[2] = lower


@inlined
def _radius(sight: JointSight, stream: Stream) -> tuple[float, float, Stream]:
    """The radius of a disc in which the error is uniform, and what it counts."""
    reach, deviation = sight.reach, sight.deviation
    if deviation == 0:
        return reach, 1.0, stream
    one, stream = uniform(stream)
    two, stream = uniform(stream)
    square = max(-2 * math.log((1 - one) * (1 - two)), LEAST)
    return min(deviation * math.sqrt(square), reach), 2 / square, stream


@inlined
def _in_rectangle(aim: Aim, stream: Stream) -> tuple[float, float, float, Stream]:
    """A direction of the rectangle around a disc, uniform by area, in front or behind; camera
    axes."""
    distance, low, high = aim.distance, aim.low, aim.high
    across, stream = uniform(stream)
    along, stream = uniform(stream)
    front = along < 0.5
    x = aim.width * (2 * across - 1)
    rest = max(0.0, 1 - x * x)
    t = math.sqrt(rest) * sine(low + (high - low) * (2 * along - (0.0 if front else 1.0)))
    z = math.sqrt(max(0.0, rest - t * t))
    towards0 = aim.centre0 / distance if distance > 1e-300 else 1.0
    towards1 = aim.centre1 / distance if distance > 1e-300 else 0.0
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
    above = height < 0.5
    from_pole = CELL * (2 * height - (0.0 if above else 1.0))
    planar, lift = sine(from_pole), cosine(from_pole) * (1.0 if above else -1.0)
    sin_azimuth, cos_azimuth = circle(turn)
    u0, u1 = planar * cos_azimuth, planar * sin_azimuth
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


@inlined
def _cell_of(u0: float, u1: float, u2: float) -> tuple[int, int]:
    """The column and the line of a local direction's cell."""
    column = min(int((azimuth(u0, u1) + math.pi) / CELL), NUM_AZIMUTH - 1)
    return column, min(int((arcsine(u2) + math.pi / 2) / CELL), NUM_ELEVATION - 1)


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


@inlined
def _attempt_lower(
    stream: Stream,
    sight: JointSight,
    optic: Record,
    upper: Direction,
    cell: Record,
    length1: float,
    length: float,
    reference: Reference,
    flat: bool,
) -> tuple[Direction, float, float, Stream]:
    """The bone below an `upper` one: its direction, the squared distance of its joint from where
    that was detected, what the attempt counts, and the stream after it. Where it fails it counts 0,
    and the direction says nothing."""
    u0, u1, u2 = upper
    d0, d1 = _across(sight.frame, u0, u1, u2)
    gap0, gap1 = sight.target0 - length1 * d0, sight.target1 - length1 * d1
    begins = optic.start + length1 * _along(optic, u0, u1, u2)
    radius, share, stream = _radius(sight, stream)
    aim = _aim(gap0 / length, gap1 / length, radius / length)
    turn = min(max(cell.box_last - cell.box_first, 0.0), 2 * math.pi)
    box = max(cell.box_high - cell.box_low, 0.0) * turn
    region = min(aim.area, box)
    if region <= 0:
        return upper, 0.0, 0.0, stream
    v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, reference)
    triple = cell.triple
    if aim.area <= box:
        d0, d1, d2, stream = _in_rectangle(aim, stream)
        p0, p1, p2 = _local(sight.frame, d0, d1, d2)
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
        rho = math.sqrt(max(0.0, 1 - h2 * h2))
        sin_angle, cos_angle = circle((cell.box_first + turn * along) / (2 * math.pi))
        h1, h3 = -rho * cos_angle, rho * sin_angle
        q0 = triple[0] * h1 + triple[3] * h2 + triple[6] * h3
        q1 = triple[1] * h1 + triple[4] * h2 + triple[7] * h3
        q2 = triple[2] * h1 + triple[5] * h2 + triple[8] * h3
        p0 = u0 * q0 + v0 * q1 + w0 * q2
        p1 = u1 * q0 + v1 * q1 + w1 * q2
        p2 = u2 * q0 + v2 * q1 + w2 * q2
        d0, d1 = _across(sight.frame, p0, p1, p2)
    square = _square(optic, length * d0 - gap0, length * d1 - gap1)
    if square > radius * radius or h1 + cell.offset > 0:
        return upper, square, 0.0, stream
    if h2 < cell.low2 or h2 > cell.high2 or h3 < cell.low3 or h3 > cell.high3:
        return upper, square, 0.0, stream
    away = begins + length * _along(optic, p0, p1, p2)
    share *= away * away
    return (q0, q1, q2), square, share * region / cell.area * (abs(h1) if flat else 1.0), stream
