"""Blocks of attempts at a limb, column by column: every step is one plain loop over the columns of
one array.

Such loops have no branches and call nothing, so that the compiler turns them into vector
instructions; what needs look-ups or random numbers, and the packing of what is left, is done in
loops of its own (`attempts`). A step writes to the column `passed` a number that is positive where
the attempt goes on."""

import math

from poseterior.inference.exact.loops.numbers import Rows, compiled, inlined
from poseterior.inference.exact.loops.rectangles import ROWS, rectangle
from poseterior.inference.exact.loops.series import cosine, sine, small_sine_cosine, smaller
from poseterior.inference.exact.loops.strata import lower_axes
from poseterior.inference.exact.loops.tables import Record, Reference


@compiled
def raise_upper(
    number: int,
    half: float,
    by_area: bool,
    axes: Rows,
    target0: float,
    target1: float,
    square: float,
    block: Record,
) -> None:
    """The upper bone inside its sub-cell, `half` as wide (radians), and where it ends in the image;
    passed where that lies in the disc around the target whose squared radius is given."""
    f00, f01, f02, f10, f11, f12, _, _, _ = axes
    for n in range(number):
        turned, kept = small_sine_cosine((2 * block.across[n] - 1) * half)
        sin_azimuth = block.sin_azimuth[n] * kept + block.cos_azimuth[n] * turned
        cos_azimuth = block.cos_azimuth[n] * kept - block.sin_azimuth[n] * turned
        lift, fall, along = block.lift[n], block.fall[n], block.along[n]
        if by_area:
            u2 = lift + along * (fall - lift)
            rest = 1 - u2 * u2
            planar = math.sqrt(rest if rest > 0 else 0.0)
        else:
            turned, kept = small_sine_cosine((2 * along - 1) * half)
            u2, planar = lift * kept + fall * turned, fall * kept - lift * turned
        u0, u1, length = planar * cos_azimuth, planar * sin_azimuth, block.length1[n]
        end0, end1 = (
            -length * (f00 * u0 + f01 * u1 + f02 * u2),
            -length * (f10 * u0 + f11 * u1 + f12 * u2),
        )
        off0, off1 = end0 - target0, end1 - target1
        block.u0[n], block.u1[n], block.u2[n], block.end0[n], block.end1[n] = (
            u0,
            u1,
            u2,
            end0,
            end1,
        )
        block.passed[n] = square - (off0 * off0 + off1 * off1)


@compiled
def see_disc(number: int, target0: float, target1: float, radius: float, block: Record) -> None:
    """The disc of the next joint from where the upper bone ends, in lengths of the lower one, and
    the rectangle around its directions; passed in proportion to a piece's area over the stratum's
    bound."""
    for n in range(number):
        shrink = 1 / block.length2[n]
        centre0, centre1 = (
            (target0 - block.end0[n]) * shrink,
            (target1 - block.end1[n]) * shrink,
        )
        distance, reach = math.sqrt(centre0 * centre0 + centre1 * centre1), radius * shrink
        width, low, high = rectangle(distance, reach)
        height = (high - low) * (1 / ROWS)
        block.centre0[n], block.centre1[n], block.distance[n], block.radius[n] = (
            centre0,
            centre1,
            distance,
            reach,
        )
        block.width[n], block.low[n], block.height[n] = width, low, height
        block.passed[n] = 2 * width * height - block.test[n] * block.bound[n]


@compiled
def lower_in_piece(number: int, axes: Rows, reference: Reference, block: Record) -> None:
    """The lower bone in a piece of the rectangle, `along` counting from the lowest row: x across,
    √(1-x²) sin α towards the disc's centre, in front or behind as `side` says; passed where disc
    and hinge allow it."""
    f00, f01, f02, f10, f11, f12, f20, f21, f22 = axes
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
        d0, d1 = towards0 * t - towards1 * x, towards1 * t + towards0 * x
        # Into the local frame; bones are parent minus child, hence the sign.
        p0, p1, p2 = (
            -(f00 * d0 + f10 * d1 + f20 * z),
            -(f01 * d0 + f11 * d1 + f21 * z),
            -(f02 * d0 + f12 * d1 + f22 * z),
        )
        u0, u1, u2 = block.u0[n], block.u1[n], block.u2[n]
        v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, reference)
        q0, q1, q2 = (
            u0 * p0 + u1 * p1 + u2 * p2,
            v0 * p0 + v1 * p1 + v2 * p2,
            w0 * p0 + w1 * p1 + w2 * p2,
        )
        block.q0[n], block.q1[n], block.q2[n] = q0, q1, q2
        h1, h2, h3 = _in_triple(block, n, q0, q1, q2)
        block.passed[n] = _allowed(block, n, d0, d1, h1, h2, h3)


@compiled
def lower_in_box(number: int, axes: Rows, reference: Reference, block: Record) -> None:
    """The lower bone by area in the box around all that the hinge allows: `across` is its u2,
    `along` its α; passed as above."""
    f00, f01, f02, f10, f11, f12, _, _, _ = axes
    for n in range(number):
        h2, angle = block.across[n], block.along[n]
        half_turns = math.floor(angle * (1 / math.pi) + 0.5)
        rest = angle - half_turns * math.pi  # within ±π/2, where the series hold
        way = 1 - 2 * (half_turns - 2 * math.floor(half_turns * 0.5))
        across = 1 - h2 * h2
        rho = math.sqrt(across if across > 0 else 0.0) * way
        h1, h3 = -rho * cosine(rest), rho * sine(rest)
        q0 = block.normal0[n] * h1 + block.second0[n] * h2 + block.third0[n] * h3
        q1 = block.normal1[n] * h1 + block.second1[n] * h2 + block.third1[n] * h3
        q2 = block.normal2[n] * h1 + block.second2[n] * h2 + (block.third2[n] * h3)
        u0, u1, u2 = block.u0[n], block.u1[n], block.u2[n]
        v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, reference)
        p0, p1, p2 = (
            u0 * q0 + v0 * q1 + w0 * q2,
            u1 * q0 + v1 * q1 + w1 * q2,
            u2 * q0 + v2 * q1 + w2 * q2,
        )
        d0, d1 = -(f00 * p0 + f01 * p1 + f02 * p2), -(f10 * p0 + f11 * p1 + f12 * p2)
        block.q0[n], block.q1[n], block.q2[n] = q0, q1, q2
        block.passed[n] = _allowed(block, n, d0, d1, h1, h2, h3)


@inlined
def _in_triple(
    block: Record, n: int, q0: float, q1: float, q2: float
) -> tuple[float, float, float]:
    """A direction in the hinge's triple."""
    return (
        block.normal0[n] * q0 + block.normal1[n] * q1 + block.normal2[n] * q2,
        block.second0[n] * q0 + block.second1[n] * q1 + block.second2[n] * q2,
        block.third0[n] * q0 + block.third1[n] * q1 + block.third2[n] * q2,
    )


@inlined
def _allowed(block: Record, n: int, d0: float, d1: float, h1: float, h2: float, h3: float) -> float:
    """Positive where the bone's end lies in its disc, the hinge allows it, and the measure keeps it
    (`test` is zero for measure "area")."""
    off0, off1 = d0 - block.centre0[n], d1 - block.centre1[n]
    least = block.radius[n] * block.radius[n] - (off0 * off0 + off1 * off1)
    least = smaller(least, -(h1 + block.offset[n]))
    least = smaller(least, h2 - block.low2[n])
    least = smaller(least, block.high2[n] - h2)
    least = smaller(least, h3 - block.low3[n])
    least = smaller(least, block.high3[n] - h3)
    return smaller(least, (h1 if h1 > 0 else -h1) - block.test[n])
