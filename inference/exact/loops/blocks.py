"""Blocks of attempts at a limb, column by column: every step is one plain loop over the columns of
one array.

Such loops have no branches and call nothing, so that the compiler turns them into vector
instructions; what needs look-ups or random numbers, and the packing of what is left, is done in
loops of its own (`attempts`). A step writes to the column `PASSED` a number that is positive where
the attempt goes on."""

import math

import numpy as np

from inference.exact.loops.numbers import Rows, compiled, inlined
from inference.exact.loops.rectangles import ROWS, rectangle
from inference.exact.loops.series import cosine, sine, small_sine_cosine, smaller
from inference.exact.loops.strata import BOUNDS, OFFSET, Axes, lower_axes

BLOCK = 512
"""Attempts in a block: what a core keeps at hand."""
STRIDE = BLOCK + 8
"""From column to column: not a power of two, or all columns would want the same place in the
nearest cache."""
(
    SIN_AZIMUTH,
    COS_AZIMUTH,
    LIFT,
    FALL,
    ACROSS,
    ALONG,
    LENGTH1,
    LENGTH2,
    U0,
    U1,
    U2,
    END0,
    END1,
    TEST,
    BOUND,
    PASSED,
) = (STRIDE * column for column in range(16))
CENTRE0, CENTRE1, DISTANCE, RADIUS, WIDTH, LOW, HEIGHT, SIDE, Q0, Q1, Q2 = (
    STRIDE * column for column in range(16, 27)
)
HINGE = STRIDE * 27
"""The first of the columns of the hinge: triple, offset, bounds."""
HINGE_COLUMNS = BOUNDS + 4
SIZE = STRIDE * (27 + HINGE_COLUMNS)
"""Numbers in a block."""


@compiled
def raise_upper(
    number: int,
    half: float,
    by_area: bool,
    frame: Rows,
    target0: float,
    target1: float,
    square: float,
    block: np.ndarray,
) -> None:
    """The upper bone inside its sub-cell, `half` as wide (radians), and where it ends in the image;
    passed where that lies in the disc around the target whose squared radius is given."""
    f00, f01, f02, f10, f11, f12, _, _, _ = frame
    for n in range(number):
        turned, kept = small_sine_cosine((2 * block[ACROSS + n] - 1) * half)
        sin_azimuth = block[SIN_AZIMUTH + n] * kept + block[COS_AZIMUTH + n] * turned
        cos_azimuth = block[COS_AZIMUTH + n] * kept - block[SIN_AZIMUTH + n] * turned
        lift, fall, along = block[LIFT + n], block[FALL + n], block[ALONG + n]
        if by_area:
            u2 = lift + along * (fall - lift)
            rest = 1 - u2 * u2
            planar = math.sqrt(rest if rest > 0 else 0.0)
        else:
            turned, kept = small_sine_cosine((2 * along - 1) * half)
            u2, planar = lift * kept + fall * turned, fall * kept - lift * turned
        u0, u1, length = planar * cos_azimuth, planar * sin_azimuth, block[LENGTH1 + n]
        end0, end1 = (
            -length * (f00 * u0 + f01 * u1 + f02 * u2),
            -length * (f10 * u0 + f11 * u1 + f12 * u2),
        )
        off0, off1 = end0 - target0, end1 - target1
        block[U0 + n], block[U1 + n], block[U2 + n], block[END0 + n], block[END1 + n] = (
            u0,
            u1,
            u2,
            end0,
            end1,
        )
        block[PASSED + n] = square - (off0 * off0 + off1 * off1)


@compiled
def see_disc(number: int, target0: float, target1: float, radius: float, block: np.ndarray) -> None:
    """The disc of the next joint from where the upper bone ends, in lengths of the lower one, and
    the rectangle around its directions; passed in proportion to a piece's area over the stratum's
    bound."""
    for n in range(number):
        shrink = 1 / block[LENGTH2 + n]
        centre0, centre1 = (
            (target0 - block[END0 + n]) * shrink,
            (target1 - block[END1 + n]) * shrink,
        )
        distance, reach = math.sqrt(centre0 * centre0 + centre1 * centre1), radius * shrink
        width, low, high = rectangle(distance, reach)
        height = (high - low) * (1 / ROWS)
        block[CENTRE0 + n], block[CENTRE1 + n], block[DISTANCE + n], block[RADIUS + n] = (
            centre0,
            centre1,
            distance,
            reach,
        )
        block[WIDTH + n], block[LOW + n], block[HEIGHT + n] = width, low, height
        block[PASSED + n] = 2 * width * height - block[TEST + n] * block[BOUND + n]


@compiled
def lower_in_piece(number: int, frame: Rows, axes: Axes, block: np.ndarray) -> None:
    """The lower bone in a piece of the rectangle, `ALONG` counting from the lowest row: x across,
    √(1-x²) sin α towards the disc's centre, in front or behind as `SIDE` says; passed where disc
    and hinge allow it."""
    f00, f01, f02, f10, f11, f12, f20, f21, f22 = frame
    for n in range(number):
        x = block[WIDTH + n] * (2 * block[ACROSS + n] - 1)
        rest = 1 - x * x
        rest = rest if rest > 0 else 0.0
        t = math.sqrt(rest) * sine(block[LOW + n] + block[HEIGHT + n] * block[ALONG + n])
        deep = rest - t * t
        z = math.sqrt(deep if deep > 0 else 0.0) * block[SIDE + n]
        distance = block[DISTANCE + n]
        scale = 1 / (distance if distance > 1e-300 else 1e-300)
        towards0 = block[CENTRE0 + n] * scale if distance > 0 else 1.0
        towards1 = block[CENTRE1 + n] * scale
        d0, d1 = towards0 * t - towards1 * x, towards1 * t + towards0 * x
        # Into the local frame; bones are parent minus child, hence the sign.
        p0, p1, p2 = (
            -(f00 * d0 + f10 * d1 + f20 * z),
            -(f01 * d0 + f11 * d1 + f21 * z),
            -(f02 * d0 + f12 * d1 + f22 * z),
        )
        u0, u1, u2 = block[U0 + n], block[U1 + n], block[U2 + n]
        v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, axes)
        q0, q1, q2 = (
            u0 * p0 + u1 * p1 + u2 * p2,
            v0 * p0 + v1 * p1 + v2 * p2,
            w0 * p0 + w1 * p1 + w2 * p2,
        )
        block[Q0 + n], block[Q1 + n], block[Q2 + n] = q0, q1, q2
        h1, h2, h3 = _in_triple(block, n, q0, q1, q2)
        block[PASSED + n] = _allowed(block, n, d0, d1, h1, h2, h3)


@compiled
def lower_in_box(number: int, frame: Rows, axes: Axes, block: np.ndarray) -> None:
    """The lower bone by area in the box around all that the hinge allows: `ACROSS` is its u2,
    `ALONG` its α; passed as above."""
    f00, f01, f02, f10, f11, f12, _, _, _ = frame
    for n in range(number):
        h2, angle = block[ACROSS + n], block[ALONG + n]
        half_turns = math.floor(angle * (1 / math.pi) + 0.5)
        rest = angle - half_turns * math.pi  # within ±π/2, where the series hold
        way = 1 - 2 * (half_turns - 2 * math.floor(half_turns * 0.5))
        across = 1 - h2 * h2
        rho = math.sqrt(across if across > 0 else 0.0) * way
        h1, h3 = -rho * cosine(rest), rho * sine(rest)
        q0 = (
            block[HINGE + n] * h1
            + block[HINGE + 3 * STRIDE + n] * h2
            + block[HINGE + 6 * STRIDE + n] * h3
        )
        q1 = (
            block[HINGE + STRIDE + n] * h1
            + block[HINGE + 4 * STRIDE + n] * h2
            + block[HINGE + 7 * STRIDE + n] * h3
        )
        q2 = (
            block[HINGE + 2 * STRIDE + n] * h1
            + block[HINGE + 5 * STRIDE + n] * h2
            + (block[HINGE + 8 * STRIDE + n] * h3)
        )
        u0, u1, u2 = block[U0 + n], block[U1 + n], block[U2 + n]
        v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, axes)
        p0, p1, p2 = (
            u0 * q0 + v0 * q1 + w0 * q2,
            u1 * q0 + v1 * q1 + w1 * q2,
            u2 * q0 + v2 * q1 + w2 * q2,
        )
        d0, d1 = -(f00 * p0 + f01 * p1 + f02 * p2), -(f10 * p0 + f11 * p1 + f12 * p2)
        block[Q0 + n], block[Q1 + n], block[Q2 + n] = q0, q1, q2
        block[PASSED + n] = _allowed(block, n, d0, d1, h1, h2, h3)


@inlined
def _in_triple(
    block: np.ndarray, n: int, q0: float, q1: float, q2: float
) -> tuple[float, float, float]:
    """A direction in the hinge's triple."""
    return (
        block[HINGE + n] * q0 + block[HINGE + STRIDE + n] * q1 + block[HINGE + 2 * STRIDE + n] * q2,
        block[HINGE + 3 * STRIDE + n] * q0
        + block[HINGE + 4 * STRIDE + n] * q1
        + block[HINGE + 5 * STRIDE + n] * q2,
        block[HINGE + 6 * STRIDE + n] * q0
        + block[HINGE + 7 * STRIDE + n] * q1
        + block[HINGE + 8 * STRIDE + n] * q2,
    )


@inlined
def _allowed(
    block: np.ndarray, n: int, d0: float, d1: float, h1: float, h2: float, h3: float
) -> float:
    """Positive where the bone's end lies in its disc, the hinge allows it, and the measure keeps it
    (`TEST` is zero for measure "area")."""
    off0, off1 = d0 - block[CENTRE0 + n], d1 - block[CENTRE1 + n]
    least = block[RADIUS + n] * block[RADIUS + n] - (off0 * off0 + off1 * off1)
    least = smaller(least, -(h1 + block[HINGE + OFFSET * STRIDE + n]))
    least = smaller(least, h2 - block[HINGE + BOUNDS * STRIDE + n])
    least = smaller(least, block[HINGE + (BOUNDS + 1) * STRIDE + n] - h2)
    least = smaller(least, h3 - block[HINGE + (BOUNDS + 2) * STRIDE + n])
    least = smaller(least, block[HINGE + (BOUNDS + 3) * STRIDE + n] - h3)
    return smaller(least, (h1 if h1 > 0 else -h1) - block[TEST + n])
