"""What bounds a stratum: the lower bone's region for blocks of sub-cells and one bin of
lengths. Compiled; body units.

Bounds add up how far things can move inside a stratum, each in the direction that
counts: the disc's centre away from where the bone starts (`radial`, which changes the
rectangle) and aside (`beside`, which turns the chart about the line of sight), the
hinge's frame by `turn`, a direction inside its piece by what it has along the hinge's
axes. Nothing is estimated.

As in `blocks`, the loop is plain, over columns of one array, so that it becomes vector
instructions."""

import math
from typing import NamedTuple

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.rectangles import ROWS, SLACK, largest_rectangle, rectangle
from poseterior.inference.exact.loops.series import arcsine, cosine, sine, smaller
from poseterior.inference.exact.loops.tables import Record
from poseterior.inference.exact.loops.vectors import Plane, Vector


class Chart(NamedTuple):
    """The chart around a disc, and how far its directions may be off.

    Attributes
    ----------
    towards : the direction of the disc's centre
    width : |x| is no more
    drop : how far √(1-x²) is below 1, at most
    loose : how far directions may move beside the chart, at most
    """

    towards: Plane
    width: float
    drop: float
    loose: float


@compiled
def bound_regions(
    number: int, target: Plane, radius: float, bin1: Plane, bin2: Plane, block: Record
) -> None:
    """Fills `weight`, `region` and `mask` of a block of `number` sub-cells, for lengths
    from one end of the bins to the other; the target is the lower bone's."""
    high1 = bin1[1]
    length1 = (bin1[0] + bin1[1]) / 2
    spread1 = (bin1[1] - bin1[0]) / 2
    length2 = (bin2[0] + bin2[1]) / 2
    spread2 = (bin2[1] - bin2[0]) / 2
    small = radius / bin2[1]
    large = radius / bin2[0]
    shrink = 1 / length2
    most = 1 / bin2[0]
    for n in range(number):
        image0 = block.image0[n]
        image1 = block.image1[n]
        chord = block.chord[n]
        centre0 = (target[0] - length1 * image0) * shrink
        centre1 = (target[1] - length1 * image1) * shrink
        distance = math.sqrt(centre0 * centre0 + centre1 * centre1)
        scale = 1 / (distance if distance > 1e-300 else 1e-300)
        towards0 = centre0 * scale if distance > 0 else 1.0
        towards1 = centre1 * scale
        along = image0 * towards0 + image1 * towards1
        across = image1 * towards0 - image0 * towards1
        # A length of the lower bone moves the centre along its own direction only.
        stretch = spread1 * math.fabs(along) + distance * spread2
        radial = (high1 * part_moves(along, chord) + stretch) * most + SLACK
        beside = (high1 * part_moves(across, chord) + spread1 * math.fabs(across)) * most + SLACK
        nearest = distance - radial
        farthest = math.sqrt((distance + radial) * (distance + radial) + beside * beside)
        turned = beside / (nearest if nearest > 1e-9 else 1e-9)  # at least the angle
        nearest = nearest if nearest > 0 else 0.0
        width, lowest, _ = rectangle(nearest, large)
        low = arcsine(farthest - small)
        high = arcsine(nearest + small)
        highest = arcsine(farthest + large)
        # What moves beside the rectangle: the hinge's frame, and the chart about the
        # line of sight.
        edge = farthest + large
        loose = (
            block.turn[n] + (turned if turned < 2 else 2.0) * (edge if edge < 1 else 1.0) + SLACK
        )
        rest = 1 - width * width
        drop = 1 - math.sqrt(rest if rest > 0 else 0.0) + SLACK
        chart = Chart((towards0, towards1), width, drop, loose)
        # Row k is [lowest + k/4 (high - lowest), low + (k + 1)/4 (highest - low)]: from
        # one to the next its middle turns by the same angle. Row by row, written out: a
        # loop in here would keep this one from becoming vector instructions.
        below = (high - lowest) * 0.125
        above = (highest - low) * 0.125
        middle = (lowest + low) * 0.5 + above
        half = (low - lowest) * 0.5 + above
        step = below + above
        wider = above - below
        angle0 = sine(middle), cosine(middle)
        turn = sine(step), cosine(step)
        front0, behind0 = _row(block, n, angle0, half, chart)
        angle1 = _sum_of_angles(angle0, turn)
        front1, behind1 = _row(block, n, angle1, half + wider, chart)
        angle2 = _sum_of_angles(angle1, turn)
        front2, behind2 = _row(block, n, angle2, half + 2 * wider, chart)
        angle3 = _sum_of_angles(angle2, turn)
        front3, behind3 = _row(block, n, angle3, half + 3 * wider, chart)
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
def part_moves(part: float, chord: float) -> float:
    """How far at most a part of a unit vector changes, the part being what it has along
    some unit vector, while it moves by `chord`: what is along the vector itself is of
    second order."""
    rest = 1 - part * part
    return chord * math.sqrt(rest if rest > 0 else 0.0) + 0.5 * chord * chord


@inlined
def _sum_of_angles(one: Plane, other: Plane) -> Plane:
    """Sine and cosine of the sum of two angles, of each of which sine and cosine are
    given."""
    return one[0] * other[1] + one[1] * other[0], one[1] * other[1] - one[0] * other[0]


@inlined
def _row(block: Record, n: int, middle: Plane, half: float, chart: Chart) -> tuple[float, float]:
    """Whether the hinge may allow a direction with |x| ≤ width and α within `half` of a
    `middle`, whose sine and cosine are given, in front and behind: 1 or 0."""
    half = half if half > 0 else 0.0
    # What f(α) of `_part` has beyond its tangent.
    wider = Chart(chart.towards, chart.width, chart.drop, chart.loose + 0.5 * half * half)
    front = _bends(block, n, middle, half, wider)
    return front, _bends(block, n, (middle[0], -middle[1]), half, wider)


@inlined
def _bends(block: Record, n: int, middle: Plane, half: float, chart: Chart) -> float:
    """1 where the hinge may allow a direction of a piece; else 0. `middle` is sine and
    cosine of the middle α, the cosine negative behind."""
    normal = block.normal0[n], block.normal1[n], block.normal2[n]
    second = block.second0[n], block.second1[n], block.second2[n]
    third = block.third0[n], block.third1[n], block.third2[n]
    u1, off1 = _part(normal, middle, half, chart)
    u2, off2 = _part(second, middle, half, chart)
    u3, off3 = _part(third, middle, half, chart)
    within2 = smaller(u2 - block.low2[n], block.high2[n] - u2) + off2
    within3 = smaller(u3 - block.low3[n], block.high3[n] - u3) + off3
    least = smaller(off1 - u1 - block.offset[n], smaller(within2, within3)) + chart.loose
    return 1.0 if least >= 0 else 0.0


@inlined
def _part(axis: Vector, middle: Plane, half: float, chart: Chart) -> tuple[float, float]:
    """What the middle of a piece has along an axis h of the hinge, and how far from
    that its directions x · across + √(1-x²) (sin α · towards ± cos α · away) are but
    for half²/2: with f(α) what stands in brackets has along h, width |h · across| +
    half |f'| + drop |f|."""
    height, deep = middle
    along = axis[0] * chart.towards[0] + axis[1] * chart.towards[1]
    across = axis[1] * chart.towards[0] - axis[0] * chart.towards[1]
    part = along * height + axis[2] * deep
    slope = along * deep - axis[2] * height
    off = chart.width * math.fabs(across) + half * math.fabs(slope) + chart.drop * math.fabs(part)
    return part, off
