"""What bounds a stratum: the lower bone's region for blocks of sub-cells and one bin of lengths.
Compiled; body units.

Bounds add up how far things can move inside a stratum: the upper bone by `chord`, its image by that
times the length, the disc's centre by `shift`, the hinge's frame by `turn`. Nothing is estimated.
As in `blocks`, the loop is plain, over columns of one array, so that it becomes vector
instructions."""

import math

from inference.exact.loops.numbers import compiled, inlined
from inference.exact.loops.rectangles import ROWS, SLACK, largest_rectangle, rectangle
from inference.exact.loops.series import arcsine, cosine, sine, smaller
from inference.exact.loops.tables import Record


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
    block: Record,
) -> None:
    """Fills `weight`, `region` and `mask` of a block of `number` sub-cells; the target is the lower
    bone's."""
    length1, spread1, length2, spread2 = (
        (low1 + high1) / 2,
        (high1 - low1) / 2,
        (low2 + high2) / 2,
        (high2 - low2) / 2,
    )
    small, large, shrink, most = radius / high2, radius / low2, 1 / length2, 1 / low2
    for n in range(number):
        image0, image1, chord = block.image0[n], block.image1[n], block.chord[n]
        centre0, centre1 = (
            (target0 - length1 * image0) * shrink,
            (target1 - length1 * image1) * shrink,
        )
        distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
        shift = (high1 * chord + spread1 * block.spread[n] + distance * spread2) * most + SLACK
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
            block.turn[n]
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
        box = block.box_area[n]
        use_box = box < area * count
        possible = count > 0 and nearest - large < 1
        block.region[n] = box if use_box else area
        block.mask[n] = 0.0 if use_box else mask
        block.weight[n] = block.mass[n] * (box if use_box else area * count) if possible else 0.0


@inlined
def _row(
    block: Record,
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
def _bends(block: Record, n: int, d0: float, d1: float, d2: float, reach: float) -> float:
    """1 where the hinge may allow a direction within `reach` of this one, camera axes; else 0."""
    u1 = block.normal0[n] * d0 + block.normal1[n] * d1 + block.normal2[n] * d2
    u2 = block.second0[n] * d0 + block.second1[n] * d1 + block.second2[n] * d2
    u3 = block.third0[n] * d0 + block.third1[n] * d1 + block.third2[n] * d2
    least = reach - u1 - block.offset[n]
    least = smaller(least, u2 - block.low2[n] + reach)
    least = smaller(least, block.high2[n] + reach - u2)
    least = smaller(least, u3 - block.low3[n] + reach)
    least = smaller(least, block.high3[n] + reach - u3)
    return 1.0 if least >= 0 else 0.0
