"""Directions of lower bones: the part of the sphere that a plane and a box leave (Akhter & Black
2015; eq. 8; docs/model.md § 2).

In the triple (n, e2, e3) of a hinge a unit vector is (u1, u2, u3); it is possible iff u1 + d < 0,
bnd1 ≤ u2 ≤ bnd2 and bnd3 ≤ u3 ≤ bnd4. With ρ = √(1 - u2²), u3 = ρ sin β and u1 = ∓ρ cos β (in
front, behind), surface is du2 dβ: for each u2 the possible β form up to three intervals, one in
front and two behind, whose total length integrates in closed form. Measure "area" is uniform per
steradian (eq. 8). Measure "box" is the paper's recipe restricted to the unit disc: u2 and u3
uniform where the box and the disc overlap, density ∝ |u1| per steradian."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from poseterior.probmodel.directions.regions import Region, invert_monotone

LOWER_MEASURES = ("area", "box")
MARGIN = 1e-9
"""By how much `Hinge.box` is wider than it need be, so that rounding never makes it too narrow."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hinge(Region):
    """One hinge with a measure; `build` derives the last four arrays from the first three.

    Parameters
    ----------
    triple : `(3, 3)`
        Rows n, e2, e3.
    offset, bounds : `()`, `(4,)`
        d of the plane; bounds of u2, then of u3.
    nodes : `(12,)`
        Values of u2 between which the intervals' ends are smooth.
    pattern : `(11, 4)`
        Between two nodes, the coefficients that make the total length of the intervals out of
        `_ends`.
    areas : `(12,)`
        The measure below each node.
    box : `(4,)`
        Ranges of u2 and of the angle α (u3 = ρ sin α, u1 = -ρ cos α, in front and behind) around
        all that is possible.
    measure
        One of `LOWER_MEASURES`.
    """

    triple: jax.Array
    offset: jax.Array
    bounds: jax.Array
    nodes: jax.Array
    pattern: jax.Array
    areas: jax.Array
    box: jax.Array
    measure: str = dataclasses.field(metadata={"static": True})

    @classmethod
    def build(
        cls, triple: ArrayLike, offset: ArrayLike, bounds: ArrayLike, measure: str = "area"
    ) -> "Hinge":
        """Hinges from `(..., 3, 3)`, `(...)`, `(..., 4)`. Raises `ValueError` on an unknown
        measure."""
        if measure not in LOWER_MEASURES:
            raise ValueError(
                f"the measure of lower bones is one of {', '.join(LOWER_MEASURES)}, not {measure!r}"
            )
        triple, offset, bounds = jnp.asarray(triple), jnp.asarray(offset), jnp.asarray(bounds)
        nodes, pattern, areas, box = _integrate_all(offset, bounds, measure)
        return cls(
            triple=triple,
            offset=offset,
            bounds=bounds,
            nodes=nodes,
            pattern=pattern,
            areas=areas,
            box=box,
            measure=measure,
        )

    @property
    def total(self) -> jax.Array:
        """`()`: measure of the possible directions; steradians for "area"."""
        return self.areas[..., -1]

    def contains(self, vector: jax.Array) -> jax.Array:
        """`()` bool: whether the unit vector `(3,)` is on the free side of the plane and in the
        box."""
        u1, u2, u3 = self.triple @ vector
        low2, high2, low3, high3 = self.bounds
        return (u1 + self.offset < 0) & (low2 <= u2) & (u2 <= high2) & (low3 <= u3) & (u3 <= high3)

    def log_density(self, vector: jax.Array) -> jax.Array:
        """`()`: log density per steradian."""
        if self.measure == "area":
            return -jnp.log(self.total)
        return jnp.log(jnp.abs(self.triple[0] @ vector)) - jnp.log(self.total)

    def transport(self, square: jax.Array) -> jax.Array:
        """Unit vector at a point of the unit square: u2 by its marginal law, then the place in the
        intervals."""
        u2 = self._quantile(square[0])
        low, high = _intervals(self.offset, self.bounds, u2, self.measure)
        length = jnp.maximum(high - low, 0.0)
        before = jnp.cumsum(length) - length
        rest = square[1] * jnp.sum(length)
        which = jnp.clip(jnp.sum((before <= rest) & (length > 0)) - 1, 0, 2)
        which = jnp.argsort(length <= 0, stable=True)[which]
        place = jnp.clip(
            low[which] + rest - before[which], low[which], jnp.maximum(high[which], low[which])
        )
        return self._vector(u2, place, which > 0)

    def inverse(self, vector: jax.Array) -> jax.Array:
        """The point of the unit square from which `transport` comes to `vector`."""
        u1, u2, u3 = self.triple @ vector
        u2 = jnp.clip(u2, self.nodes[0], self.nodes[-1])
        low, high = _intervals(self.offset, self.bounds, u2, self.measure)
        length = jnp.maximum(high - low, 0.0)
        place = _place(u1, u3, self.measure)
        which = jnp.where(u1 <= 0, 0, jnp.where(u3 > 0, 1, 2))
        before = jnp.cumsum(length) - length
        whole = jnp.sum(length)
        along = (before[which] + place - low[which]) / jnp.where(whole > 0, whole, 1.0)
        return jnp.clip(jnp.stack([self._cumulative(u2) / self.total, along]), 0.0, 1.0)

    def _vector(self, u2: jax.Array, place: jax.Array, behind: jax.Array) -> jax.Array:
        rho = jnp.sqrt(jnp.maximum(1 - u2**2, 0.0))
        u3 = rho * jnp.sin(place) if self.measure == "area" else place
        square = jnp.maximum(rho**2 - u3**2, 0.0)
        u1 = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
        return jnp.stack([jnp.where(behind, u1, -u1), u2, u3]) @ self.triple

    def _piece(self, u2: jax.Array) -> jax.Array:
        return jnp.clip(jnp.searchsorted(self.nodes, u2, side="right") - 1, 0, len(self.nodes) - 2)

    def _cumulative(self, u2: jax.Array, piece: jax.Array | None = None) -> jax.Array:
        """Measure of the possible directions below u2."""
        piece = self._piece(u2) if piece is None else piece
        rise = _primitives(self.offset, self.bounds, u2, self.measure)
        rise = rise - _primitives(self.offset, self.bounds, self.nodes[piece], self.measure)
        return self.areas[piece] + self.pattern[piece] @ rise

    def _quantile(self, fraction: jax.Array) -> jax.Array:
        target = fraction * self.total
        # The very end belongs to the last piece that holds anything.
        last = jnp.searchsorted(self.areas, self.total, side="left") - 1
        piece = jnp.clip(
            jnp.searchsorted(self.areas, target, side="right") - 1, 0, jnp.maximum(last, 0)
        )
        row, base = self.pattern[piece], self.areas[piece]
        low, high = self.nodes[piece], self.nodes[piece + 1]
        origin = row @ _primitives(self.offset, self.bounds, low, self.measure)

        def measure_below(u2: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            value = base - origin + row @ _primitives(self.offset, self.bounds, u2, self.measure)
            return (
                value,
                row @ _ends(self.offset, self.bounds, u2, self.measure),
                jnp.zeros_like(u2),
            )

        noise = 4 * jnp.finfo(target.dtype).eps * (1 + self.total)
        rise = self.areas[piece + 1] - base
        start = low + (high - low) * (target - base) / jnp.where(rise > 0, rise, 1.0)
        return invert_monotone(measure_below, target, low, high, start, noise)


def _root(square: jax.Array) -> jax.Array:
    """Square root, 0 below zero, with a finite gradient everywhere."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _arctan(opposite: jax.Array, adjacent: jax.Array) -> jax.Array:
    """arctan(opposite/adjacent) for adjacent ≥ 0; 0 at the origin, with a finite gradient there
    too."""
    origin = (opposite == 0) & (adjacent == 0)
    return jnp.arctan2(opposite, jnp.where(origin, 1.0, adjacent))


def _to_rim(level: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """x clipped to where |x| ≤ √(1-c²), and r = √(1-x²-c²) there. Angles are taken as arctangents
    over r: an arcsine of a ratio near one would lose half of the digits."""
    limit = _root(1 - level**2)
    free = jnp.clip(x, -limit, limit)
    return free, _root((limit - free) * (limit + free))


def _place(u1: jax.Array, u3: jax.Array, measure: str) -> jax.Array:
    """The coordinate in which the conditional law is uniform: β for "area", u3 for "box"."""
    return u3 if measure == "box" else _arctan(u3, jnp.abs(u1))


def _ends(offset: jax.Array, bounds: jax.Array, u2: jax.Array, measure: str) -> jax.Array:
    """`(4,)`: at u2, where the intervals can end: bnd3, bnd4, the plane in front, the plane behind.

    The plane cuts the front at |β| = arccos(d/ρ) (only for d > 0) and the back at |β| =
    arccos(-d/ρ); for "box" the same places as values of u3 = ρ sin β."""
    if measure == "box":
        rim = _root(1 - u2**2)
        low, high = jnp.clip(bounds[2], -rim, rim), jnp.clip(bounds[3], -rim, rim)
        cut = _root(rim**2 - offset**2)
    else:
        low, high, plane = (
            _arctan(level, _to_rim(level, u2)[1])
            for level in (bounds[2], bounds[3], jnp.abs(offset))
        )
        rim = jnp.full_like(plane, jnp.pi / 2)
        cut = rim - plane  # arccos(|d|/ρ) = π/2 - arcsin(|d|/ρ)
    return jnp.stack([low, high, jnp.where(offset > 0, cut, rim), jnp.where(offset < 0, cut, rim)])


def _primitives(offset: jax.Array, bounds: jax.Array, u2: jax.Array, measure: str) -> jax.Array:
    """`(4,)`: integrals of `_ends` over u2 from 0."""
    if measure == "box":
        low, high = (_clipped_primitive(bound, u2) for bound in (bounds[2], bounds[3]))
        whole, cut = _half_disc(u2, 0.0), _half_disc(u2, offset)
        return jnp.stack(
            [low, high, jnp.where(offset > 0, cut, whole), jnp.where(offset < 0, cut, whole)]
        )
    low, high, plane = (
        _arcsine_primitive(level, u2) for level in (bounds[2], bounds[3], jnp.abs(offset))
    )
    quarter = jnp.pi / 2 * u2
    cut = quarter - plane
    return jnp.stack(
        [low, high, jnp.where(offset > 0, cut, quarter), jnp.where(offset < 0, cut, quarter)]
    )


def _arcsine_primitive(level: jax.Array, x: jax.Array) -> jax.Array:
    """∫₀ˣ arcsin(clip(c/√(1-t²), -1, 1)) dt = x arctan(c/r) + c arctan(x/r) - arctan(xc/r) with r =
    √(1-x²-c²).

    The derivative in r vanishes like r²: the rounding of r, of the order √eps at the rim, does no
    harm."""
    free, rest = _to_rim(level, x)
    angle = free * _arctan(level, rest) + level * _arctan(free, rest) - _arctan(free * level, rest)
    return angle + jnp.sign(level) * jnp.pi / 2 * (x - free)


def _half_disc(x: jax.Array, level: jax.Array | float) -> jax.Array:
    """∫₀ˣ √(1 - c² - t²) dt, the integrand 0 beyond the rim; its derivative in the root vanishes at
    the rim."""
    free, rest = _to_rim(jnp.asarray(level, x.dtype), x)
    return (free * rest + (free**2 + rest**2) * _arctan(free, rest)) / 2


def _clipped_primitive(bound: jax.Array, x: jax.Array) -> jax.Array:
    """∫₀ˣ clip(c, -√(1-t²), √(1-t²)) dt."""
    free, _ = _to_rim(bound, x)
    return bound * free + jnp.sign(bound) * (_half_disc(x, 0.0) - _half_disc(free, 0.0))


def _selection(
    offset: jax.Array, bounds: jax.Array, u2: jax.Array, measure: str
) -> tuple[jax.Array, jax.Array]:
    """Lower and upper ends `(3, 4)` of the intervals (front, behind above, behind below) as rows
    over `_ends`."""
    low, high, front, behind = _ends(offset, bounds, u2, measure)
    e_low, e_high, e_front, e_behind = jnp.eye(4)
    lower = [
        jnp.where(low >= -front, e_low, -e_front),
        jnp.where(low >= behind, e_low, e_behind),
        e_low,
    ]
    upper = [
        jnp.where(high <= front, e_high, e_front),
        e_high,
        jnp.where(high <= -behind, e_high, -e_behind),
    ]
    return jnp.stack(lower), jnp.stack(upper)


def _intervals(
    offset: jax.Array, bounds: jax.Array, u2: jax.Array, measure: str
) -> tuple[jax.Array, jax.Array]:
    """Ends `(3,)`, `(3,)` of the intervals at u2; an interval whose ends are the wrong way round is
    empty."""
    ends = _ends(offset, bounds, u2, measure)
    lower, upper = _selection(offset, bounds, u2, measure)
    return lower @ ends, upper @ ends


@functools.partial(jax.jit, static_argnames="measure")
def _integrate_all(offset: jax.Array, bounds: jax.Array, measure: str) -> tuple[jax.Array, ...]:
    # One flat batch: a batch for every dimension would be traced once for each.
    shape = jnp.shape(offset)
    rows = jax.vmap(
        lambda offset, bounds: (*_integrate(offset, bounds, measure), _box(offset, bounds))
    )(offset.ravel(), jnp.broadcast_to(bounds, (*shape, 4)).reshape(-1, 4))
    return tuple(row.reshape(*shape, *row.shape[1:]) for row in rows)


def _integrate(
    offset: jax.Array, bounds: jax.Array, measure: str
) -> tuple[jax.Array, jax.Array, jax.Array]:
    first, last = jnp.maximum(bounds[0], -1.0), jnp.minimum(bounds[1], 1.0)
    squares = jnp.stack([bounds[2] ** 2, bounds[3] ** 2])
    # Where an end meets the rim of the disc, the plane the rim, or an end the plane.
    kinks = _root(1 - jnp.concatenate([squares, offset[None] ** 2, squares + offset**2]))
    inner = jnp.sort(jnp.clip(jnp.concatenate([-kinks, kinks]), first, last))
    nodes = jnp.concatenate([first[None], inner, last[None]])

    def pattern_at(u2: jax.Array) -> jax.Array:
        ends = _ends(offset, bounds, u2, measure)
        lower, upper = _selection(offset, bounds, u2, measure)
        row = upper - lower
        return jnp.where((row @ ends > 0)[:, None], row, 0.0).sum(axis=0)

    pattern = jax.vmap(pattern_at)((nodes[1:] + nodes[:-1]) / 2)
    heights = jax.vmap(lambda u2: _primitives(offset, bounds, u2, measure))(nodes)
    rises = jnp.sum(pattern * jnp.diff(heights, axis=0), axis=-1)
    return nodes, pattern, jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.maximum(rises, 0.0))])


def _box(offset: jax.Array, bounds: jax.Array) -> jax.Array:
    """`(4,)`: ranges of x = u2 and of α (u3 = ρ sin α, u1 = -ρ cos α) around all that a hinge
    allows."""
    first, last = jnp.clip(bounds[0], -1.0, 1.0), jnp.clip(bounds[1], -1.0, 1.0)
    largest = jnp.where(first * last <= 0, 1.0, jnp.sqrt(1 - jnp.minimum(first**2, last**2)))
    smallest = jnp.sqrt(jnp.maximum(1 - jnp.maximum(first**2, last**2), 0.0))

    def side(inner: jax.Array, outer: jax.Array) -> jax.Array:
        """The largest α towards u3 = outer > inner; the box's ends turn most where ρ is
        smallest."""
        ends = jnp.array([largest, smallest]) + 1e-300
        front = jnp.max(jnp.arcsin(jnp.clip(outer / ends, -1.0, 1.0)))
        inmost = jnp.min(jnp.arcsin(jnp.clip(inner / ends, -1.0, 1.0)))
        # |β| beyond which the back is allowed
        turn = jnp.arccos(jnp.clip(-offset / ends[1], -1.0, 1.0))
        has_back = (front > turn) & (offset < 0)
        return jnp.where(has_back, jnp.pi - jnp.maximum(turn, jnp.maximum(inmost, 0.0)), front)

    above, below = side(bounds[2], bounds[3]), side(-bounds[3], -bounds[2])
    return jnp.stack([first - MARGIN, last + MARGIN, -below - MARGIN, above + MARGIN])
