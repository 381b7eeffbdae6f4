"""What bounds a stratum: the lower bone's region for blocks of sub-cells and one bin of lengths.
Compiled; body units.

Bounds add up how far things can move inside a stratum: the upper bone by `chord`, its image by that
times the length, the disc's centre by `shift`, the hinge's frame by `turn`. Nothing is estimated.
As in `blocks`, the loop is plain, over columns of one array, so that it becomes vector
instructions."""

import math

import numpy as np

from inference.exact.loops.numbers import compiled, inlined
from inference.exact.loops.rectangles import ROWS, SLACK, largest_rectangle, rectangle
from inference.exact.loops.series import arcsine, cosine, sine, smaller

BLOCK = 256
STRIDE = BLOCK + 8
"""From column to column: not a power of two, or all columns would want the same place in the
nearest cache."""
IMAGE0, IMAGE1, SPREAD, CHORD, TURN, MASS = (STRIDE * column for column in range(6))
HINGE = STRIDE * 6
OFFSET, LOW2, HIGH2, LOW3, HIGH3, BOX_AREA = (STRIDE * column for column in range(15, 21))
GEOMETRY = 21
"""Columns of what is known of a sub-cell: the upper bone's image (2), its length, the chord, the
frame's turn, the prior mass over the hinge's area, the hinge's three rows in camera axes, turned to
point from the lower bone's start to its end (9), the hinge's offset and bounds (5), the area of its
box."""
WEIGHT, REGION, MASK = (STRIDE * column for column in range(GEOMETRY, GEOMETRY + 3))
"""Columns of what is found: the strata's weight, 0 where nothing is possible; the bound on the area
of a piece, and which are kept; or the area of the hinge's box, and 0."""
SIZE = STRIDE * (GEOMETRY + 3)


@compiled
def bound_regions(
    number: int,
    target0: float,
    target1: float,
    radius: float,
    low1: float,
    high1: float,
    low2: float,
    high2: float,
    block: np.ndarray,
) -> None:
    """Fills the last three columns of a block of `number` sub-cells; the target is the lower
    bone's."""
    length1, spread1, length2, spread2 = (
        (low1 + high1) / 2,
        (high1 - low1) / 2,
        (low2 + high2) / 2,
        (high2 - low2) / 2,
    )
    small, large, shrink, most = radius / high2, radius / low2, 1 / length2, 1 / low2
    for n in range(number):
        image0, image1, chord = block[IMAGE0 + n], block[IMAGE1 + n], block[CHORD + n]
        centre0, centre1 = (
            (target0 - length1 * image0) * shrink,
            (target1 - length1 * image1) * shrink,
        )
        distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
        shift = (high1 * chord + spread1 * block[SPREAD + n] + distance * spread2) * most + SLACK
        nearest, farthest = distance - shift, distance + shift
        nearest = nearest if nearest > 0 else 0.0
        width, lowest, _ = rectangle(nearest, large)
        low, high, highest = (
            arcsine(farthest - small),
            arcsine(nearest + small),
            arcsine(farthest + large),
        )
        # What moves beside the rectangle: the hinge's frame, and the chart about the line of sight.
        apart = shift < 0.7 * distance
        scale = 1 / (distance if distance > 1e-300 else 1e-300)
        edge = farthest + large
        loose = (
            block[TURN + n]
            + 1.1 * (shift * scale if apart else 2.0) * (edge if edge < 1 else 1.0)
            + SLACK
        )
        flat = width * width * (1.1 if width < 0.5 else 2.5)  # at least arcsin² of the width
        towards0, towards1 = (centre0 * scale if distance > 0 else 1.0), centre1 * scale
        view = towards0, towards1, flat, loose
        # Row by row, written out: a loop in here would keep this one from becoming vector
        # instructions.
        front0, behind0 = _row(block, n, lowest, low + (highest - low) * 0.25, *view)
        front1, behind1 = _row(
            block, n, lowest + (high - lowest) * 0.25, low + (highest - low) * 0.5, *view
        )
        front2, behind2 = _row(
            block, n, lowest + (high - lowest) * 0.5, low + (highest - low) * 0.75, *view
        )
        front3, behind3 = _row(block, n, lowest + (high - lowest) * 0.75, highest, *view)
        mask = (
            front0
            + 2 * front1
            + 4 * front2
            + 8 * front3
            + 16 * behind0
            + 32 * behind1
            + 64 * behind2
            + 128 * behind3
        )
        count = front0 + front1 + front2 + front3 + behind0 + behind1 + behind2 + behind3
        area = largest_rectangle(nearest, farthest, large) * (1 / ROWS)
        box = block[BOX_AREA + n]
        use_box = box < area * count
        possible = count > 0 and nearest - large < 1
        block[REGION + n] = box if use_box else area
        block[MASK + n] = 0.0 if use_box else mask
        block[WEIGHT + n] = (
            block[MASS + n] * (box if use_box else area * count) if possible else 0.0
        )


@inlined
def _row(
    block: np.ndarray,
    n: int,
    first: float,
    last: float,
    towards0: float,
    towards1: float,
    flat: float,
    loose: float,
) -> tuple[float, float]:
    """Whether the hinge may allow a direction with α in [first, last], in front and behind: 1 or
    0."""
    middle, half = (first + last) * 0.5, (last - first) * 0.5
    half = half if half > 0 else 0.0
    reach = (math.sqrt(flat + half * half) + loose) * (1 + SLACK)
    height, depth = sine(middle), cosine(middle)
    d0, d1 = height * towards0, height * towards1
    return _bends(block, n, d0, d1, depth, reach), _bends(block, n, d0, d1, -depth, reach)


@inlined
def _bends(block: np.ndarray, n: int, d0: float, d1: float, d2: float, reach: float) -> float:
    """1 where the hinge may allow a direction within `reach` of this one, camera axes; else 0."""
    u1 = block[HINGE + n] * d0 + block[HINGE + STRIDE + n] * d1 + block[HINGE + 2 * STRIDE + n] * d2
    u2 = (
        block[HINGE + 3 * STRIDE + n] * d0
        + block[HINGE + 4 * STRIDE + n] * d1
        + block[HINGE + 5 * STRIDE + n] * d2
    )
    u3 = (
        block[HINGE + 6 * STRIDE + n] * d0
        + block[HINGE + 7 * STRIDE + n] * d1
        + block[HINGE + 8 * STRIDE + n] * d2
    )
    least = reach - u1 - block[OFFSET + n]
    least = smaller(least, u2 - block[LOW2 + n] + reach)
    least = smaller(least, block[HIGH2 + n] + reach - u2)
    least = smaller(least, u3 - block[LOW3 + n] + reach)
    least = smaller(least, block[HIGH3 + n] + reach - u3)
    return 1.0 if least >= 0 else 0.0
