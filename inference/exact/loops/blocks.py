"""Blocks of proposals for a limb, column by column: every step is one plain loop over
the columns of one array.

Such loops have no branches and call nothing, so that the compiler turns them into
vector instructions; what needs look-ups or random numbers, and the packing of what is
left, is done in loops of its own (`proposals`). A step writes to the column `passed` a
number that is positive where the proposal goes on."""

import math

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.rectangles import ROWS, rectangle
from poseterior.inference.exact.loops.series import cosine, sine, small_sine_cosine, smaller
from poseterior.inference.exact.loops.tables import Record
from poseterior.inference.exact.loops.vectors import (
    Axes,
    Plane,
    Reference,
    Vector,
    dot,
    image_of,
    into,
    lower_axes,
    minus,
    out_of,
)


@compiled
def raise_upper(
    number: int, half: float, by_area: bool, axes: Axes, disc: Vector, block: Record
) -> None:
    """The upper bone inside its sub-cell, `half` as wide (radians), and where it ends
    in the image; passed where that lies in the `disc`: centre and squared radius."""
    centre0, centre1, square = disc
    for n in range(number):
        sin_turn, cos_turn = small_sine_cosine((2 * block.across[n] - 1) * half)
        sin_azimuth = block.sin_azimuth[n] * cos_turn + block.cos_azimuth[n] * sin_turn
        cos_azimuth = block.cos_azimuth[n] * cos_turn - block.sin_azimuth[n] * sin_turn
        lift = block.lift[n]
        fall = block.fall[n]
        along = block.along[n]
        if by_area:
            u2 = lift + along * (fall - lift)
            rest = 1 - u2 * u2
            planar = math.sqrt(rest if rest > 0 else 0.0)
        else:
            sin_turn, cos_turn = small_sine_cosine((2 * along - 1) * half)
            u2 = lift * cos_turn + fall * sin_turn
            planar = fall * cos_turn - lift * sin_turn
        u = planar * cos_azimuth, planar * sin_azimuth, u2
        length = block.length1[n]
        end0 = -length * dot(axes[0], u)
        end1 = -length * dot(axes[1], u)
        off0 = end0 - centre0
        off1 = end1 - centre1
        block.u0[n] = u[0]
        block.u1[n] = u[1]
        block.u2[n] = u[2]
        block.end0[n] = end0
        block.end1[n] = end1
        block.passed[n] = square - (off0 * off0 + off1 * off1)


@compiled
def see_disc(number: int, disc: Vector, block: Record) -> None:
    """The `disc` of the next joint, centre and radius, from where the upper bone ends,
    in lengths of the lower one, and the rectangle around its directions; passed in
    proportion to a piece's area over the stratum's bound."""
    for n in range(number):
        shrink = 1 / block.length2[n]
        centre0 = (disc[0] - block.end0[n]) * shrink
        centre1 = (disc[1] - block.end1[n]) * shrink
        distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
        radius = disc[2] * shrink
        width, low, high = rectangle(distance, radius)
        height = (high - low) * (1 / ROWS)
        block.centre0[n] = centre0
        block.centre1[n] = centre1
        block.distance[n] = distance
        block.radius[n] = radius
        block.width[n] = width
        block.low[n] = low
        block.height[n] = height
        block.passed[n] = 2 * width * height - block.test[n] * block.bound[n]


@compiled
def lower_in_piece(number: int, axes: Axes, reference: Reference, block: Record) -> None:
    """The lower bone in a piece of the rectangle, `along` counting from the lowest row:
    x across, √(1-x²) sin α towards the disc's centre, in front or behind as `side`
    says; passed where disc and hinge allow it."""
    for n in range(number):
        x = block.width[n] * (2 * block.across[n] - 1)
        rest = 1 - x * x
        rest = rest if rest > 0 else 0.0
        t = math.sqrt(rest) * sine(block.low[n] + block.height[n] * block.along[n])
        deep = rest - t * t
        z = math.sqrt(deep if deep > 0 else 0.0) * block.side[n]
        distance = block.distance[n]
        scale = 1 / (distance if distance > 1e-300 else 1e-300)
        towards0 = block.centre0[n] * scale if distance > 0 else 1.0
        towards1 = block.centre1[n] * scale
        seen = towards0 * t - towards1 * x, towards1 * t + towards0 * x
        bone = minus(out_of(axes, (seen[0], seen[1], z)))
        u = block.u0[n], block.u1[n], block.u2[n]
        v, w, _ = lower_axes(u, reference)
        lower = into((u, v, w), bone)
        _write_lower(block, n, lower)
        block.passed[n] = _allowed(block, n, seen, into(_hinge(block, n), lower))


@compiled
def lower_in_box(number: int, axes: Axes, reference: Reference, block: Record) -> None:
    """The lower bone by area in the box around all that the hinge allows: `across` is
    its u2, `along` its α; passed as above."""
    for n in range(number):
        h2 = block.across[n]
        angle = block.along[n]
        half_turns = math.floor(angle * (1 / math.pi) + 0.5)
        rest = angle - half_turns * math.pi  # within ±π/2, where the series hold
        way = 1 - 2 * (half_turns - 2 * math.floor(half_turns * 0.5))
        across = 1 - h2 * h2
        rho = math.sqrt(across if across > 0 else 0.0) * way
        hinged = -rho * cosine(rest), h2, rho * sine(rest)
        lower = out_of(_hinge(block, n), hinged)
        u = block.u0[n], block.u1[n], block.u2[n]
        v, w, _ = lower_axes(u, reference)
        seen = image_of(axes, out_of((u, v, w), lower))
        _write_lower(block, n, lower)
        block.passed[n] = _allowed(block, n, seen, hinged)


@inlined
def _hinge(block: Record, n: int) -> Axes:
    """The hinge's triple."""
    return (
        (block.normal0[n], block.normal1[n], block.normal2[n]),
        (block.second0[n], block.second1[n], block.second2[n]),
        (block.third0[n], block.third1[n], block.third2[n]),
    )


@inlined
def _write_lower(block: Record, n: int, lower: Vector) -> None:
    block.q0[n] = lower[0]
    block.q1[n] = lower[1]
    block.q2[n] = lower[2]


@inlined
def _allowed(block: Record, n: int, seen: Plane, hinged: Vector) -> float:
    """Positive where the bone's end lies in its disc, the hinge allows it, and the
    measure keeps it (`test` is zero for measure "area"): the least of what is left to
    each of these bounds, since comparisons one by one would be branches."""
    h1, h2, h3 = hinged
    off0 = seen[0] - block.centre0[n]
    off1 = seen[1] - block.centre1[n]
    least = block.radius[n] * block.radius[n] - (off0 * off0 + off1 * off1)
    least = smaller(least, -(h1 + block.offset[n]))
    least = smaller(least, h2 - block.low2[n])
    least = smaller(least, block.high2[n] - h2)
    least = smaller(least, h3 - block.low3[n])
    least = smaller(least, block.high3[n] - h3)
    return smaller(least, (h1 if h1 > 0 else -h1) - block.test[n])
