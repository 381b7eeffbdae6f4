"""What bounds a stratum: the lower bone's region for blocks of sub-cells and one bin of lengths.
Compiled; body units.

Bounds add up how far things can move inside a stratum, each in the direction that counts: the
disc's centre away from where the bone starts (`radial`, which changes the rectangle) and aside
(`beside`, which turns the chart about the line of sight), the hinge's frame by `turn`, a direction
inside its piece by what it has along the hinge's axes. Nothing is estimated.

As in `blocks`, the loop is plain, over columns of one array, so that it becomes vector
instructions."""

import math

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.rectangles import ROWS, SLACK, largest_rectangle, rectangle
from poseterior.inference.exact.loops.series import arcsine, cosine, sine, smaller
from poseterior.inference.exact.loops.tables import Record


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
        scale = 1 / (distance if distance > 1e-300 else 1e-300)
        towards0, towards1 = (centre0 * scale if distance > 0 else 1.0), centre1 * scale
        along, across = (
            image0 * towards0 + image1 * towards1,
            image1 * towards0 - image0 * towards1,
        )
        # A length of the lower bone moves the centre along its own direction only.
        stretch = spread1 * math.fabs(along) + distance * spread2
        radial = (high1 * part_moves(along, chord) + stretch) * most + SLACK
        beside = (high1 * part_moves(across, chord) + spread1 * math.fabs(across)) * most + SLACK
        nearest, farthest = (
            distance - radial,
            math.sqrt((distance + radial) * (distance + radial) + beside * beside),
        )
        turned = beside / (nearest if nearest > 1e-9 else 1e-9)  # at least the angle
        nearest = nearest if nearest > 0 else 0.0
        width, lowest, _ = rectangle(nearest, large)
        low, high, highest = (
            arcsine(farthest - small),
            arcsine(nearest + small),
            arcsine(farthest + large),
        )
        # What moves beside the rectangle: the hinge's frame, and the chart about the line of sight.
        edge = farthest + large
        loose = (
            block.turn[n] + (turned if turned < 2 else 2.0) * (edge if edge < 1 else 1.0) + SLACK
        )
        rest = 1 - width * width
        drop = 1 - math.sqrt(rest if rest > 0 else 0.0) + SLACK
        view = towards0, towards1, width, drop, loose
        # Row k is [lowest + k/4 (high - lowest), low + (k + 1)/4 (highest - low)]: from one to the
        # next its middle turns by the same angle. Row by row, written out: a loop in here would
        # keep this one from becoming vector instructions.
        below, above = (high - lowest) * 0.125, (highest - low) * 0.125
        middle, half = (lowest + low) * 0.5 + above, (low - lowest) * 0.5 + above
        step, wider = below + above, above - below
        height, depth, rise, stay = sine(middle), cosine(middle), sine(step), cosine(step)
        front0, behind0 = _row(block, n, height, depth, half, *view)
        height, depth = height * stay + depth * rise, depth * stay - height * rise
        front1, behind1 = _row(block, n, height, depth, half + wider, *view)
        height, depth = height * stay + depth * rise, depth * stay - height * rise
        front2, behind2 = _row(block, n, height, depth, half + 2 * wider, *view)
        height, depth = height * stay + depth * rise, depth * stay - height * rise
        front3, behind3 = _row(block, n, height, depth, half + 3 * wider, *view)
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
    """How far at most a part of a unit vector changes, the part being what it has along some unit
    vector, while it moves by `chord`: what is along the vector itself is of second order."""
    rest = 1 - part * part
    return chord * math.sqrt(rest if rest > 0 else 0.0) + 0.5 * chord * chord


@inlined
def _row(
    block: Record,
    n: int,
    height: float,
    depth: float,
    half: float,
    towards0: float,
    towards1: float,
    width: float,
    drop: float,
    loose: float,
) -> tuple[float, float]:
    """Whether the hinge may allow a direction with |x| ≤ width and α within `half` of a middle,
    whose sine and cosine are `height` and `depth`, in front and behind: 1 or 0."""
    half = half if half > 0 else 0.0
    loose += 0.5 * half * half
    piece = towards0, towards1, width, half, drop, loose
    return _bends(block, n, height, depth, 1.0, *piece), _bends(
        block, n, height, depth, -1.0, *piece
    )


@inlined
def _bends(
    block: Record,
    n: int,
    height: float,
    depth: float,
    side: float,
    towards0: float,
    towards1: float,
    width: float,
    half: float,
    drop: float,
    loose: float,
) -> float:
    """1 where the hinge may allow a direction of a piece; else 0. `height` and `depth` are sine and
    cosine of the middle α, `side` is 1 in front and -1 behind."""
    piece = height, depth * side, towards0, towards1, width, half, drop
    u1, off1 = _part(block.normal0[n], block.normal1[n], block.normal2[n], *piece)
    u2, off2 = _part(block.second0[n], block.second1[n], block.second2[n], *piece)
    u3, off3 = _part(block.third0[n], block.third1[n], block.third2[n], *piece)
    within2 = smaller(u2 - block.low2[n], block.high2[n] - u2) + off2
    within3 = smaller(u3 - block.low3[n], block.high3[n] - u3) + off3
    least = smaller(off1 - u1 - block.offset[n], smaller(within2, within3)) + loose
    return 1.0 if least >= 0 else 0.0


@inlined
def _part(
    h0: float,
    h1: float,
    h2: float,
    height: float,
    deep: float,
    towards0: float,
    towards1: float,
    width: float,
    half: float,
    drop: float,
) -> tuple[float, float]:
    """What the middle of a piece has along the hinge's axis h, and how far from that its directions
    x · across + √(1-x²) (sin α · towards ± cos α · away) are but for half²/2: with f(α) what stands
    in brackets has along h, width |h · across| + half |f'| + drop |f|."""
    along, across = h0 * towards0 + h1 * towards1, h1 * towards0 - h0 * towards1
    middle, slope = along * height + h2 * deep, along * deep - h2 * height
    return middle, width * math.fabs(across) + half * math.fabs(slope) + drop * math.fabs(middle)
