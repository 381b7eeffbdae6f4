"""Weighted proposals for the limbs of many roots, for an evidence without bias of every
root. Compiled; in body units.

Nothing is cut or set up. A proposal draws the upper bone uniformly from the rectangle
around the directions that put its joint into its disc, looks up what the prior has
there, and draws the lower bone from the smaller of two regions: the rectangle of its
own disc, or its hinge's box. What explains both detections is weighted by prior over
proposal, so that the mean weight is the evidence.

Both limbs of a group get some proposals under each of some draws of the lengths
(`pairs`).

A Gaussian error is uniform in a disc of random radius (Khintchine): with ρ² = σ² χ²(4
degrees of freedom), its density over the peak is E 2σ²/ρ² 1[|e| ≤ ρ]. A prior that is
uniform in angles has no bound by area at the poles: the first proposal under every draw
of the lengths goes to the lines of cells around them, and all are weighted by the
mixture of both proposals (docs/model.md § 9)."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import draw_lengths
from poseterior.inference.exact.loops.numbers import (
    Stream,
    compiled,
    inlined,
    load,
    store,
    uniform,
)
from poseterior.inference.exact.loops.rectangles import rectangle
from poseterior.inference.exact.loops.series import arcsine, azimuth, circle, cosine, sine
from poseterior.inference.exact.loops.tables import LengthBins, LimbTables, Record
from poseterior.inference.exact.loops.vectors import (
    Plane,
    Reference,
    Rows,
    Vector,
    lower_axes,
    rows_of,
)
from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION

_EDGES = np.sin(np.arange(NUM_ELEVATION + 1) * CELL - np.pi / 2)
HEIGHT = _EDGES[1:] - _EDGES[:-1]
"""`(60,)`: differences of the sine of the elevation, by line of cells."""
LEAST = 1e-300
"""A square, in the place of zero."""


@compiled
def draw_length_rows(states: np.ndarray, bins: LengthBins, lengths: np.ndarray) -> None:
    """Fills `lengths` `(n, draws)` with draws of the prior, those of each root by its
    own of the `states` `(n, 4)`."""
    for row in range(len(lengths)):
        draw_lengths(bins, 0, states[row], lengths[row])


@compiled
def propose_rows(
    states: np.ndarray,
    frames: np.ndarray,
    tables: LimbTables,
    lengths: np.ndarray,
    per_length: int,
    accepted: np.ndarray,
) -> np.ndarray:
    """Makes `per_length` proposals for one limb under every root and every draw of its
    lengths.

    Parameters
    ----------
    states : `(n, 4)` of each root's random numbers, written on
    frames : `(n, 2)` `SIGHT_FRAMES` of its joints
    tables : what the model says of the limb
    lengths : `(2, n, draws)` of its bones
    per_length : two at least
    accepted : `(n · draws · per_length,)` `ACCEPTED`, written on

    Returns
    -------
    `(n,)` where in `accepted` the rows of each root end.
    """
    count = 0
    cells = tables.cells
    rule = LowerRule(tables.reference, tables.flat)
    ends = np.empty(len(states), np.int64)
    for row in range(len(states)):
        stream = load(states[row])
        first = _joint(frames[row, 0])
        second = _joint(frames[row, 1])
        for draw in range(lengths.shape[2]):
            length1 = lengths[0, row, draw]
            length2 = lengths[1, row, draw]
            aim = _aim(first.target0 / length1, first.target1 / length1, first.reach / length1)
            for number in range(per_length):
                radius, share, stream = _radius(first, stream)
                if first.deviation > 0:
                    aim = _aim(aim.centre0, aim.centre1, radius / length1)
                if aim.area <= 0:
                    continue
                if number == 0 and not tables.by_area:
                    d0, d1, d2, stream = _near_pole(first.axes, stream)
                else:
                    d0, d1, d2, stream = _in_rectangle(aim, stream)
                off0 = d0 * length1 - first.target0
                off1 = d1 * length1 - first.target1
                square1 = _square(first, off0, off1)
                if square1 > radius * radius:
                    continue
                u0, u1, u2 = upper = _local(first.axes, d0, d1, d2)
                column, line = _cell_of(u0, u1, u2)
                cell = cells[column * NUM_ELEVATION + line]
                if cell.mass <= 0:
                    continue
                # What is farther away appears smaller: its density per pixel is as much
                # larger. What is behind the camera was not seen.
                away = first.start + length1 * _along(first, u0, u1, u2)
                if away <= 0:
                    continue
                weight = away * away * share * cell.mass / CELL
                weight *= _over_proposal(tables.by_area, line, u2, aim.area, 1 / per_length)
                lower = 0.0, 0.0, 0.0
                square2 = 0.0
                if tables.bones == 2:
                    bone = UpperBone(upper, length1)
                    lower, square2, ratio, stream = _propose_lower(
                        stream, second, bone, cell, length2, rule
                    )
                    weight *= ratio
                if weight > 0:
                    _write(accepted[count], draw, weight, (square1, square2), upper, lower)
                    count += 1
        ends[row] = count
        store(states[row], stream)
    return ends


class LowerRule(NamedTuple):
    """What the model says of lower bones under every upper one: the `reference` of
    their frame, and whether their measure is `flat`, "box"."""

    reference: Reference
    flat: bool


class UpperBone(NamedTuple):
    """An upper bone: its local `direction` and its `length`."""

    direction: Vector
    length: float


class JointFrame(NamedTuple):
    """A row of `SIGHT_FRAMES` in registers: an array would be read anew for every
    proposal."""

    axes: Rows
    target0: float
    target1: float
    reach: float
    deviation: float
    start: float
    slope: Vector
    stretch: Vector


@compiled
def _joint(frame: Record) -> JointFrame:
    return JointFrame(
        rows_of(frame.axes),
        frame.target[0],
        frame.target[1],
        reach=frame.reach,
        deviation=frame.deviation,
        start=frame.start,
        slope=(frame.slope[0], frame.slope[1], frame.slope[2]),
        stretch=(frame.stretch[0], frame.stretch[1], frame.stretch[2]),
    )


class Aim(NamedTuple):
    """What a bone of length one is to reach: a disc around `centre0` and `centre1`, at
    a `distance`, the rectangle around its directions, and the rectangles' area, in
    front and behind together."""

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
    area = 4 * width * (high - low)  # of both rectangles, in front and behind
    return Aim(centre0, centre1, distance, width, low, high=high, area=area)


@inlined
def _write(
    row: Record, draw: int, weight: float, square: Plane, upper: Vector, lower: Vector
) -> None:
    """Fills a row of `ACCEPTED`."""
    row.draw = draw
    row.weight = weight
    row.square[0], row.square[1] = square
    row.upper[0], row.upper[1], row.upper[2] = upper
    row.lower[0], row.lower[1], row.lower[2] = lower


@inlined
def _radius(joint: JointFrame, stream: Stream) -> tuple[float, float, Stream]:
    """The radius of a disc in which the error is uniform, and the weight of that
    radius."""
    if joint.deviation == 0:
        return joint.reach, 1.0, stream
    one, stream = uniform(stream)
    two, stream = uniform(stream)
    square = max(-2 * math.log((1 - one) * (1 - two)), LEAST)
    return min(joint.deviation * math.sqrt(square), joint.reach), 2 / square, stream


@inlined
def _in_rectangle(aim: Aim, stream: Stream) -> tuple[float, float, float, Stream]:
    """A direction of the rectangle around a disc, uniform by area, in front or behind;
    in the joint's frame, from joint to joint."""
    distance = aim.distance
    low = aim.low
    high = aim.high
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
def _near_pole(axes: Rows, stream: Stream) -> tuple[float, float, float, Stream]:
    """A direction in the two outermost lines of cells, uniform in angles; in the
    joint's frame, from joint to joint."""
    turn, stream = uniform(stream)
    height, stream = uniform(stream)
    above = height < 0.5
    from_pole = CELL * (2 * height - (0.0 if above else 1.0))
    planar = sine(from_pole)
    lift = cosine(from_pole) * (1.0 if above else -1.0)
    sin_azimuth, cos_azimuth = circle(turn)
    u0 = planar * cos_azimuth
    u1 = planar * sin_azimuth
    return (
        -(axes[0] * u0 + axes[1] * u1 + axes[2] * lift),
        -(axes[3] * u0 + axes[4] * u1 + axes[5] * lift),
        -(axes[6] * u0 + axes[7] * u1 + axes[8] * lift),
        stream,
    )


@inlined
def _local(axes: Rows, d0: float, d1: float, d2: float) -> Vector:
    """From the joint's frame; bones are parent minus child, hence the sign."""
    return (
        -(axes[0] * d0 + axes[3] * d1 + axes[6] * d2),
        -(axes[1] * d0 + axes[4] * d1 + axes[7] * d2),
        -(axes[2] * d0 + axes[5] * d1 + axes[8] * d2),
    )


@inlined
def _across(axes: Rows, u0: float, u1: float, u2: float) -> tuple[float, float]:
    """What a bone of local direction `u` moves across the line of sight, from joint to
    joint."""
    return (
        -(axes[0] * u0 + axes[1] * u1 + axes[2] * u2),
        -(axes[3] * u0 + axes[4] * u1 + axes[5] * u2),
    )


@inlined
def _along(joint: JointFrame, u0: float, u1: float, u2: float) -> float:
    """What a bone of local direction `u` and length one adds to the distance over the
    pelvis'."""
    return joint.slope[0] * u0 + joint.slope[1] * u1 + joint.slope[2] * u2


@inlined
def _square(joint: JointFrame, off0: float, off1: float) -> float:
    """The squared distance in a plane parallel to the image of what lies `off` beside
    the line of sight."""
    x = joint.stretch[0] * off0 + joint.stretch[1] * off1
    y = joint.stretch[1] * off0 + joint.stretch[2] * off1
    return x * x + y * y


@inlined
def _cell_of(u0: float, u1: float, u2: float) -> tuple[int, int]:
    """The column and the line of a local direction's cell."""
    column = min(int((azimuth(u0, u1) + math.pi) / CELL), NUM_AZIMUTH - 1)
    return column, min(int((arcsine(u2) + math.pi / 2) / CELL), NUM_ELEVATION - 1)


@inlined
def _over_proposal(by_area: bool, line: int, lift: float, area: float, capped: float) -> float:
    """CELL × the prior's density in a cell of mass one over that of the proposal:
    uniform in the rectangle, and a share `capped` near the poles, uniform in angles."""
    if by_area:
        return area / HEIGHT[line]
    planar = math.sqrt(max(1 - lift * lift, LEAST))
    near = 1 / (4 * math.pi * CELL) if line == 0 or line == NUM_ELEVATION - 1 else 0.0
    proposed = (1 - capped) * planar / area + capped * near
    return 1 / (CELL * proposed)


@inlined
def _propose_lower(
    stream: Stream,
    joint: JointFrame,
    upper: UpperBone,
    cell: Record,
    length: float,
    rule: LowerRule,
) -> tuple[Vector, float, float, Stream]:
    """The bone below an `upper` one: its direction, the squared distance of its joint
    from where that was detected, the proposal's weight, and the stream after it. Where
    it fails the weight is 0, and the direction says nothing."""
    u0, u1, u2 = u = upper.direction
    d0, d1 = _across(joint.axes, u0, u1, u2)
    gap0 = joint.target0 - upper.length * d0
    gap1 = joint.target1 - upper.length * d1
    begins = joint.start + upper.length * _along(joint, u0, u1, u2)
    radius, share, stream = _radius(joint, stream)
    aim = _aim(gap0 / length, gap1 / length, radius / length)
    turn = min(max(cell.box_last - cell.box_first, 0.0), 2 * math.pi)
    box = max(cell.box_high - cell.box_low, 0.0) * turn
    in_rectangle = aim.area <= box
    region = aim.area if in_rectangle else box
    if region <= 0:
        return u, 0.0, 0.0, stream
    (v0, v1, v2), (w0, w1, w2), _ = lower_axes(u, rule.reference)
    triple = cell.triple
    if in_rectangle:
        d0, d1, d2, stream = _in_rectangle(aim, stream)
        p0, p1, p2 = _local(joint.axes, d0, d1, d2)
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
        h1 = -rho * cos_angle
        h3 = rho * sin_angle
        q0 = triple[0] * h1 + triple[3] * h2 + triple[6] * h3
        q1 = triple[1] * h1 + triple[4] * h2 + triple[7] * h3
        q2 = triple[2] * h1 + triple[5] * h2 + triple[8] * h3
        p0 = u0 * q0 + v0 * q1 + w0 * q2
        p1 = u1 * q0 + v1 * q1 + w1 * q2
        p2 = u2 * q0 + v2 * q1 + w2 * q2
        d0, d1 = _across(joint.axes, p0, p1, p2)
    square = _square(joint, length * d0 - gap0, length * d1 - gap1)
    if square > radius * radius or h1 + cell.offset > 0:
        return u, square, 0.0, stream
    if h2 < cell.low2 or h2 > cell.high2 or h3 < cell.low3 or h3 > cell.high3:
        return u, square, 0.0, stream
    away = max(begins + length * _along(joint, p0, p1, p2), 0.0)  # not behind the camera
    share *= away * away
    weight = share * region / cell.area * (abs(h1) if rule.flat else 1.0)
    return (q0, q1, q2), square, weight, stream
