"""The pruned proposal for one limb: draw where a detection can be met, before asking whether the
limits allow it.

Upper bone: cells of the table that can put its joint near the disc, in proportion to mass × a
bound. Lower bone: a rectangle in one of two charts of the sphere, whichever is smaller: the *patch*
around the directions that put the joint near its disc, or the *box* around the directions that the
hinge allows. In both charts area is dx dα with (x, √(1-x²) sin α, √(1-x²) cos α) in some
orthonormal frame (Archimedes), so that drawing by area is drawing uniformly.

Lengths are left open here: a limb is kept iff *some* length in the prior's range explains its
detections. Limbs that share lengths are put together, and the lengths drawn, afterwards
(`rejection`). Everything that is dropped, is dropped because of a proven bound; nothing is
estimated."""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from poseterior.probmodel.anatomy.limits import CELL, NUM_AZIMUTH, NUM_ELEVATION
from poseterior.probmodel.directions.cells import Cells, cell_centres, row_sines
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.kinematics import direction, lower_axes
from tests.witnesses.limbs import Group

SLACK = 1e-9
"""Bounds are widened by this much (relative, or body units), so that rounding never makes them less
than bounds."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Plan:
    """How to propose one limb: running `sums` `(7201,)` of the cells' proposal mass; `bound`
    `(7200,)` the largest area of a rectangle in the cell; `patch` `(7200,)` whether the rectangle
    is a patch or the hinge's box; `box` `(7200, 4)` the latter's x and α ranges."""

    sums: jax.Array
    bound: jax.Array
    patch: jax.Array
    box: jax.Array

    @property
    def mass(self) -> jax.Array:
        """`()`: total proposal mass. Acceptance × mass = the prior probability of what is
        accepted."""
        return self.sums[-1]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Limb:
    """One limb as `patches` sees it: lengths as ranges, everything in body units; see
    `limbs.Group`."""

    frame: jax.Array
    target: jax.Array
    radius: jax.Array
    low: jax.Array
    high: jax.Array
    cells: Cells
    hinges: Hinge
    reference: jax.Array
    fallback: jax.Array


@jax.jit
def limbs_of(group: Group) -> list[Limb]:
    """The limbs of a group, one by one."""
    columns = (group.frame, group.target, group.radius, group.cells, group.hinges, group.fallback)
    limbs = []
    for index in range(group.num_limbs):
        frame, target, radius, cells, hinges, fallback = jax.tree.map(
            lambda leaf, row=index: leaf[row], columns
        )
        low, high = jnp.asarray(group.lengths.low), jnp.asarray(group.lengths.high)
        limbs.append(
            Limb(frame, target, radius, low, high, cells, hinges, group.reference, fallback)
        )
    return limbs


def patch_rectangle(
    distance: jax.Array, radius: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The rectangle around the unit vectors whose image lies in a disc: |x| ≤ width, low ≤ α ≤ high
    or, behind the rim, π - high ≤ α ≤ π - low.

    x runs along the image's tangent direction, √(1-x²) sin α along the line from the origin to the
    disc's centre at `distance`. Area: 4 · width · (high - low). The ellipse sin α = const touches
    the disc at x = 0, hence the ends; where the disc crosses the rim of the unit disc both sheets
    meet at α = π/2."""
    crossing = (1 + distance**2 - radius**2) / (2 * jnp.maximum(distance, 1e-300))
    # On the rim, points beyond `crossing` lie in the disc; it holds the rim's widest point, or its
    # own, or neither.
    chord = jnp.sqrt(jnp.clip(1 - crossing**2, 0.0, 1.0))
    width = jnp.where(
        crossing <= 0, 1.0, jnp.where(crossing < distance, chord, jnp.minimum(radius, 1.0))
    )
    low = jnp.arcsin(jnp.clip(distance - radius, -1.0, 1.0))
    high = jnp.arcsin(jnp.clip(distance + radius, -1.0, 1.0))
    return jnp.where(distance - radius < 1, width, 0.0), low, high


def _like(point: jax.Array, other: jax.Array) -> jax.Array:
    return jnp.broadcast_to(point, jnp.broadcast_shapes(point.shape, other.shape))


def to_segment(point: jax.Array, end: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """Distance from `point` to the segment {l · end, low ≤ l ≤ high}."""
    square = jnp.sum(end**2, axis=-1)
    along = jnp.sum(_like(point, end) * end, axis=-1) / jnp.where(square > 0, square, 1.0)
    nearest = jnp.clip(along, low, high)[..., None] * end
    return jnp.linalg.norm(_like(point, end) - nearest, axis=-1)


def _feasible(
    point: jax.Array, end: jax.Array, radius: jax.Array, low: jax.Array, high: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The lengths l in [low, high] with |point - l · end| ≤ radius: an interval, empty where it
    comes out reversed."""
    a, b, c = end @ end, end @ point, point @ point - radius**2
    root = b * b - a * c
    middle, half = (
        b / jnp.maximum(a, 1e-300),
        jnp.sqrt(jnp.maximum(root, 0.0)) / jnp.maximum(a, 1e-300),
    )
    first, last = jnp.maximum(low, middle - half), jnp.minimum(high, middle + half)
    everything = jnp.isinf(radius)
    first, last = jnp.where(everything, low, first), jnp.where(everything, high, last)
    return first, jnp.where((root < 0) & ~everything, first - 1.0, last)


def _to_parallelogram(
    point: jax.Array, one: jax.Array, other: jax.Array, low: jax.Array, high: jax.Array
) -> jax.Array:
    """Distance from `point` to {l · one + m · other}, (l, m) between `low` `(2,)` and `high`
    `(2,)`."""
    determinant = one[0] * other[1] - one[1] * other[0]
    safe = jnp.where(determinant == 0, 1.0, determinant)
    l = (point[0] * other[1] - point[1] * other[0]) / safe
    m = (one[0] * point[1] - one[1] * point[0]) / safe
    inside = (determinant != 0) & (low[0] <= l) & (l <= high[0]) & (low[1] <= m) & (m <= high[1])
    sides = jnp.stack(
        [
            to_segment(point - low[0] * one, other, low[1], high[1]),
            to_segment(point - high[0] * one, other, low[1], high[1]),
            to_segment(point - low[1] * other, one, low[0], high[0]),
            to_segment(point - high[1] * other, one, low[0], high[0]),
        ]
    )
    return jnp.where(inside, 0.0, jnp.min(sides))


def cell_sizes() -> jax.Array:
    """`(120, 60)`: how far, as a chord, a direction in the cell can be from its centre (a corner is
    farthest)."""
    row = jnp.arange(NUM_ELEVATION)
    centre = direction(0.0 * row, (row + 0.5) * CELL - jnp.pi / 2)
    corners = [direction(0.0 * row + CELL / 2, (row + side) * CELL - jnp.pi / 2) for side in (0, 1)]
    chord = jnp.max(
        jnp.stack([jnp.linalg.norm(corner - centre, axis=-1) for corner in corners]), axis=0
    )
    return jnp.broadcast_to(chord + SLACK, (NUM_AZIMUTH, NUM_ELEVATION))


def _log_mass(cells: Cells) -> jax.Array:
    """`(120, 60)`: prior probability of each cell."""
    columns = jnp.diff(cells.rows, axis=-1)
    return columns / cells.total


@jax.jit
def plan_limb(limb: Limb) -> Plan:
    """Bounds every cell's proposal and drops the cells from which no detection can be met."""
    size = cell_sizes()
    end = -jnp.einsum("ij,abj->abi", limb.frame[:2], cell_centres())
    near = (
        to_segment(limb.target[0], end, limb.low[0], limb.high[0])
        <= limb.radius[0] + limb.high[0] * size + SLACK
    )
    mass = jnp.where(near, _log_mass(limb.cells), 0.0)
    if limb.target.shape[0] == 1:
        flat = jnp.zeros(mass.size)
        return Plan(_sums(mass), flat + 1.0, flat > 0, jnp.zeros((mass.size, 4)))
    middle, half = (limb.low + limb.high) / 2, (limb.high - limb.low) / 2
    distance = jnp.linalg.norm(_like(limb.target[1], end) - middle[0] * end, axis=-1) / middle[1]
    shift = middle[0] * size / middle[1] + SLACK
    image = jnp.minimum(jnp.linalg.norm(end, axis=-1) + size, 1.0)
    radius = (limb.radius[1] + half[0] * image + half[1]) / middle[1] + SLACK
    # The rectangle grows with the radius; its width falls with the distance, its ends both rise
    # with it.
    closest = jnp.maximum(distance - shift, 0.0)
    width, low, _ = patch_rectangle(closest, radius)
    _, _, high = patch_rectangle(distance + shift, radius)
    patch_area = 4 * width * (high - low) * (1 + SLACK)
    box = limb.hinges.box
    box_area = jnp.maximum(box[..., 1] - box[..., 0], 0.0) * jnp.clip(
        box[..., 3] - box[..., 2], 0.0, 2 * jnp.pi
    )
    bound = jnp.minimum(patch_area, box_area)
    total = limb.hinges.total
    mass = jnp.where(mass > 0, mass * bound / jnp.where(total > 0, total, jnp.inf), 0.0)
    return Plan(_sums(mass), bound.ravel(), (patch_area < box_area).ravel(), box.reshape(-1, 4))


def _sums(mass: jax.Array) -> jax.Array:
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(mass.ravel())])


@functools.partial(jax.jit, static_argnames="num")
def propose_limb(
    key: jax.Array, limb: Limb, plan: Plan, num: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """`num` proposals: upper `(num, 3)` and lower `(num, 3)` local directions, and which of them
    are kept `(num,)`.

    Kept ones are independent draws of the prior's directions given that some lengths in range
    explain the limb."""
    uniform = jax.random.uniform(key, (6, num))
    cell = jnp.clip(
        jnp.searchsorted(plan.sums, uniform[0] * plan.mass, side="right") - 1,
        0,
        plan.bound.size - 1,
    )
    return jax.vmap(functools.partial(_propose, limb, plan))(cell, uniform[1:].T)


def _propose(
    limb: Limb, plan: Plan, cell: jax.Array, uniform: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    upper = _in_cell(limb.cells.measure, cell, uniform[0], uniform[1])
    end = -limb.frame[:2] @ upper
    first, last = _feasible(limb.target[0], end, limb.radius[0], limb.low[0], limb.high[0])
    kept = first <= last
    if limb.target.shape[0] == 1:
        return upper, upper, kept
    hinge = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[cell], limb.hinges)
    bone_axes = limb.frame @ lower_axes(upper, limb.reference, limb.fallback)
    # Chart of the patch, in camera axes: tangent, towards the disc's centre, depth.
    middle, half = (limb.low + limb.high) / 2, (limb.high - limb.low) / 2
    centre = -(limb.target[1] - middle[0] * end) / middle[1]
    distance = jnp.linalg.norm(centre)
    radius = (limb.radius[1] + half[0] * jnp.linalg.norm(end) + half[1]) / middle[1] + SLACK / 2
    width, low, high = patch_rectangle(distance, radius)
    towards = jnp.where(
        distance > 0, centre / jnp.where(distance > 0, distance, 1.0), jnp.array([1.0, 0.0])
    )
    across = jnp.array([-towards[1], towards[0]])
    patch_axes = jnp.zeros((3, 3)).at[:2, 0].set(across).at[:2, 1].set(towards).at[2, 2].set(1.0)
    front = uniform[3] < 0.5
    turn = low + (high - low) * jnp.where(front, 2 * uniform[3], 2 * uniform[3] - 1)
    # Chart of the hinge's box: e2, e3, -n.
    box_axes = (
        bone_axes @ (hinge.triple[jnp.array([1, 2, 0])] * jnp.array([[1.0], [1.0], [-1.0]])).T
    )
    box, patch = plan.box[cell], plan.patch[cell]
    x = jnp.where(patch, width * (2 * uniform[2] - 1), box[0] + (box[1] - box[0]) * uniform[2])
    arc = jnp.minimum(box[3] - box[2], 2 * jnp.pi)
    angle = jnp.where(patch, jnp.where(front, turn, jnp.pi - turn), box[2] + arc * uniform[3])
    rho = jnp.sqrt(jnp.maximum(1 - x**2, 0.0))
    chart = jnp.stack([x, rho * jnp.sin(angle), rho * jnp.cos(angle)])
    bone = jnp.where(patch, patch_axes, box_axes) @ chart
    lower = bone_axes.T @ bone
    area = jnp.where(patch, 4 * width * (high - low), plan.bound[cell])
    density = jnp.abs(hinge.triple[0] @ lower) if limb.hinges.measure == "box" else 1.0
    kept &= (
        (jnp.abs(x) <= 1) & hinge.contains(lower) & (uniform[4] * plan.bound[cell] < area * density)
    )
    lows, highs = jnp.stack([first, limb.low[1]]), jnp.stack([last, limb.high[1]])
    kept &= _to_parallelogram(limb.target[1], end, -bone[:2], lows, highs) <= limb.radius[1]
    return upper, lower, kept


def _in_cell(measure: str, cell: jax.Array, across: jax.Array, along: jax.Array) -> jax.Array:
    """A direction in a cell, by the cell's measure."""
    column, row = cell // NUM_ELEVATION, cell % NUM_ELEVATION
    azimuth = (column + across) * CELL - jnp.pi
    if measure == "angle":
        return direction(azimuth, (row + along) * CELL - jnp.pi / 2)
    low, high = row_sines(row)
    return direction(azimuth, jnp.arcsin(jnp.clip(low + along * (high - low), -1.0, 1.0)))
