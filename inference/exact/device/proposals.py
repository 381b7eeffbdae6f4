"""One proposal of a group of limbs, in JAX, to be vectorised by `jax.vmap`: what
`loops.proposals` and `loops.blocks` do for the processor, step by step.

All limbs are tried, whether or not the first fits: on a device for which this is meant
neighbours wait for each other anyway. Vectors are three numbers each; as arrays of
three, or matrices, they would be small products for a library instead of one loop over
the proposals."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from poseterior.inference.exact.device.tables import (
    DeviceLengths,
    DeviceLimb,
    DevicePlan,
    real,
    whole,
)
from poseterior.inference.exact.loops.bins import PER_BIN
from poseterior.inference.exact.loops.rectangles import COUNT, PICK, ROWS
from poseterior.inference.exact.loops.tables import (
    ALIAS,
    BOX,
    CELLS,
    ENTRIES,
    LIMITS,
    SLICES,
    SUBS,
    TRIPLE,
)
from poseterior.probmodel.kinematics import PARALLEL

A_LENGTH = 3
A_LIMB = 7
NUMBERS = 1 + 2 * A_LENGTH + 2 * A_LIMB
"""Random numbers of a proposal at most: one for its bins, three a length, seven a
limb."""

Number = jax.Array
Vector = tuple[Number, Number, Number]
Triple = tuple[Vector, Vector, Vector]


class Measures(NamedTuple):
    """Whether the measure of upper bones is "area", and whether that of lower ones is
    "box"."""

    by_area: bool
    flat: bool


def propose(uniform: jax.Array, plan: DevicePlan, measures: Measures) -> tuple[jax.Array, Number]:
    """One proposal of a group.

    Parameters
    ----------
    uniform : `(NUMBERS,)` random numbers
    plan : of the group
    measures : of its directions

    Returns
    -------
    `(2 + 6 · limbs,)` its two lengths (of one bone the same twice), the limbs' upper
    directions and then their lower ones; and whether all limbs fit.
    """
    bins = _pick(uniform[0], 0, len(plan.bins), plan.bins)
    own = [bins]
    if len(plan.lengths) == 2:
        own = [*jnp.divmod(bins, len(plan.lengths[1].slices) // PER_BIN)]
    lengths = []
    limbs = []
    passed = jnp.array(True)
    used = 1
    for index, law in zip(own, plan.lengths, strict=True):
        length, kept = _length(uniform[used : used + A_LENGTH], index, law)
        lengths.append(length)
        passed = passed & kept
        used = used + A_LENGTH
    for limb in plan.limbs:
        numbers = uniform[used : used + A_LIMB]
        upper, lower, kept = _limb(numbers, limb, bins, lengths, plan.half, measures)
        limbs.append((upper, lower))
        passed = passed & kept
        used = used + A_LIMB
    directions = [number for part in zip(*limbs, strict=True) for bone in part for number in bone]
    return jnp.stack([lengths[0], lengths[-1], *directions]), passed


def _pick(uniform: Number, first: Number | int, size: Number | int, alias: jax.Array) -> Number:
    """An entry of those from `first` on, by their alias table."""
    column = (uniform * size).astype(int)
    row = alias[first + column]
    (share,) = real(row, ALIAS, "share")
    own = uniform * size - column < share
    return first + jnp.where(own, column, whole(row, ALIAS, "partner"))


def _length(uniform: jax.Array, index: Number, lengths: DeviceLengths) -> tuple[Number, Number]:
    """A length proposed in a bin, and whether it is kept: `bins.draw_lengths`, once."""
    low, span, alpha, beta = lengths.law
    place = _pick(uniform[0], index * PER_BIN, PER_BIN, lengths.alias)
    start, width, envelope = real(lengths.slices[place], SLICES, "start", "width", "envelope")
    first = place == 0
    last = place == len(lengths.slices) - 1
    power = width * uniform[1] ** (1 / jnp.where(first, alpha, beta))
    inside = start + width * uniform[1]
    fraction = jnp.where(first, power, jnp.where(last, 1 - power, inside))
    rise = fraction ** (alpha - 1)
    fall = (1 - fraction) ** (beta - 1)
    # In the outermost slices one factor is drawn by its power law.
    density = jnp.where(first, 1.0, rise) * jnp.where(last, 1.0, fall)
    return low + span * fraction, uniform[2] * envelope < density


def _limb(
    uniform: jax.Array,
    limb: DeviceLimb,
    bins: Number,
    lengths: list[Number],
    half: Number,
    measures: Measures,
) -> tuple[Vector, Vector, Number]:
    """One proposal of a limb: its directions, and whether it fits."""
    place = _pick(uniform[0], limb.starts[bins], limb.sizes[bins], limb.alias)
    entry = limb.entries[place]
    sub = limb.subs[whole(entry, ENTRIES, "sub")]
    u = _upper(uniform[1:3], sub, half, measures.by_area)
    frame = _triple(limb.axes)
    end = [-lengths[0] * _dot(frame[axis], u) for axis in range(2)]
    passed = _square([end[axis] - limb.target[0, axis] for axis in range(2)]) <= limb.reach[0] ** 2
    if len(lengths) == 1:
        nothing = jnp.zeros_like(u[0])
        return u, (nothing, nothing, nothing), passed
    joint = _joint(limb, lengths[1], end, frame, u, limb.cells[whole(sub, SUBS, "cell")])
    q, left = _lower(uniform[3:5], whole(entry, ENTRIES, "mask"), joint)
    (region,) = real(entry, ENTRIES, "region")
    passed &= (uniform[5] * region < left) & _allowed(q, joint)
    if measures.flat:
        passed &= uniform[6] < jnp.abs(_dot(joint.hinge[0], q))
    return u, q, passed


def _upper(uniform: jax.Array, sub: jax.Array, half: Number, by_area: bool) -> Vector:
    """An upper bone in its sub-cell: `blocks.raise_upper`."""
    sine, cosine, lift, fall = real(sub, SUBS, "sin_azimuth", "cos_azimuth", "lift", "fall")
    across, along = ((2 * uniform[number] - 1) * half for number in range(2))
    if by_area:
        u2 = lift + uniform[1] * (fall - lift)
        planar = _root(1 - u2 * u2)
    else:
        u2 = lift * jnp.cos(along) + fall * jnp.sin(along)
        planar = fall * jnp.cos(along) - lift * jnp.sin(along)
    turned = jnp.sin(across)
    kept = jnp.cos(across)
    return planar * (cosine * kept - sine * turned), planar * (sine * kept + cosine * turned), u2


class _Joint(NamedTuple):
    """Between two bones of a limb: the disc of the lower one's end, its centre from the
    joint and its radius in lengths of that bone; the limb's frame and the lower one's,
    lines of the first and columns of the second; the hinge's triple and the row of
    `CELLS`."""

    centre: list[Number]
    radius: Number
    frame: Triple
    axes: Triple
    hinge: Triple
    cell: jax.Array


def _joint(
    limb: DeviceLimb, length: Number, end: list[Number], frame: Triple, u: Vector, cell: jax.Array
) -> _Joint:
    n0, n1, n2, s0, s1, s2, t0, t1, t2 = real(cell, CELLS, *TRIPLE)
    return _Joint(
        [(limb.target[1, axis] - end[axis]) / length for axis in range(2)],
        limb.reach[1] / length,
        frame,
        _lower_axes(u, limb.reference),
        ((n0, n1, n2), (s0, s1, s2), (t0, t1, t2)),
        cell,
    )


def _lower(uniform: jax.Array, mask: Number, joint: _Joint) -> tuple[Vector, Number]:
    """A lower bone in the region of a stratum, and what this joint leaves of a piece's
    area, which the stratum's bound is compared with. The region is the hinge's box, or
    pieces of the rectangle around the disc: charts (x, α) of the sphere both, in axes
    of their own."""
    box_low, box_high, box_first, box_last = real(joint.cell, CELLS, *BOX)
    distance = jnp.sqrt(_square(joint.centre))
    width, low, high = _rectangle(distance, joint.radius)
    height = (high - low) / ROWS
    is_box = mask == 0
    along = uniform[1] * jnp.asarray(COUNT)[mask]
    number = along.astype(int)
    piece = jnp.asarray(PICK)[mask, number].astype(int)
    in_box = jnp.clip(box_low + (box_high - box_low) * uniform[0], -1.0, 1.0)
    turn = jnp.minimum(box_last - box_first, 2 * jnp.pi) * uniform[1]
    x = jnp.where(is_box, in_box, width * (2 * uniform[0] - 1))
    angle = jnp.where(is_box, box_first + turn, low + height * (along - number + piece % ROWS))
    rho = _root(1 - x * x)
    ahead = jnp.where(is_box | (piece < ROWS), 1.0, -1.0)
    chart = x, rho * jnp.sin(angle), rho * jnp.cos(angle) * ahead
    normal, second, third = joint.hinge
    hinged = _out_of((second, third, _minus(normal)), chart)
    far = jnp.where(distance > 0, distance, 1.0)
    towards0 = jnp.where(distance > 0, joint.centre[0] / far, 1.0)
    towards1 = joint.centre[1] / far
    seen = (
        towards0 * chart[1] - towards1 * chart[0],
        towards1 * chart[1] + towards0 * chart[0],
        chart[2],
    )
    # Into the local frame; bones are parent minus child, hence the sign.
    local = _into(joint.axes, _out_of(joint.frame, _minus(seen)))
    q0, q1, q2 = (jnp.where(is_box, *pair) for pair in zip(hinged, local, strict=True))
    return (q0, q1, q2), jnp.where(is_box, jnp.inf, 2 * width * height)


def _rectangle(distance: Number, radius: Number) -> tuple[Number, Number, Number]:
    """`rectangles.rectangle`."""
    crossing = (1 + distance**2 - radius**2) / (2 * jnp.maximum(distance, 1e-300))
    width = jnp.where(crossing < distance, _root(1 - crossing**2), jnp.minimum(radius, 1.0))
    low, high = (jnp.clip(distance + sign * radius, -1.0, 1.0) for sign in (-1, 1))
    return jnp.where(crossing > 0, width, 1.0), jnp.arcsin(low), jnp.arcsin(high)


def _allowed(q: Vector, joint: _Joint) -> Number:
    """Whether a lower bone's end lies in its disc, and the hinge allows it."""
    seen = _into(joint.frame, _out_of(joint.axes, q))
    passed = _square([seen[axis] + joint.centre[axis] for axis in range(2)]) <= joint.radius**2
    offset, low2, high2, low3, high3 = real(joint.cell, CELLS, *LIMITS)
    h1, h2, h3 = _into(joint.hinge, q)
    passed &= (h1 + offset < 0) & (low2 <= h2) & (h2 <= high2) & (low3 <= h3) & (h3 <= high3)
    return passed


def _lower_axes(u: Vector, reference: jax.Array) -> Triple:
    """`kinematics.lower_axes`."""
    a0, a1, a2, f0, f1, f2 = reference
    usual = _cross((a0, a1, a2), u)
    other = _cross(u, (f0, f1, f2))
    parallel = _dot(usual, usual) < PARALLEL**2
    v0, v1, v2 = (jnp.where(parallel, *pair) for pair in zip(other, usual, strict=True))
    scale = 1 / jnp.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    v = v0 * scale, v1 * scale, v2 * scale
    return u, v, _cross(u, v)


def _triple(matrix: jax.Array) -> Triple:
    """Its lines."""
    return tuple(tuple(line) for line in matrix)  # type: ignore[return-value]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Vector, b: Vector) -> Number:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _minus(a: Vector) -> Vector:
    return -a[0], -a[1], -a[2]


def _into(axes: Triple, vector: Vector) -> Vector:
    """A vector's numbers along three axes."""
    return _dot(axes[0], vector), _dot(axes[1], vector), _dot(axes[2], vector)


def _out_of(axes: Triple, numbers: Vector) -> Vector:
    """The vector that has such numbers along three axes."""
    columns = zip(*axes, strict=True)
    first, second, third = (_dot(column, numbers) for column in columns)
    return first, second, third


def _square(offset: list[Number]) -> Number:
    return offset[0] ** 2 + offset[1] ** 2


def _root(square: Number) -> Number:
    return jnp.sqrt(jnp.maximum(square, 0.0))
