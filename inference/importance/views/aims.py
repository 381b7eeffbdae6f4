"""Where a bone is to point so that its end is where the views have it: proposals on the sphere.

Lines of sight pin a joint down to a Gaussian in space, wide along the line where one view sees it
alone. On the sphere around the joint before, that has one mode, or two where the bone points
towards the views or away from them. A proposal is a Student's t in the plane that touches the
sphere at a mode, cast onto the sphere (gnomonic), whose density is known.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from poseterior.inference.importance.views.sights import Sights
from poseterior.probmodel.rig import CameraRig

FREEDOM_OF_AIM = 4
"""Degrees of freedom of the proposals: tails that no likelihood outruns; even, so that powers are
products."""
BLUNT = 4.0
"""The least precision of a proposal, one over square radians."""
TRUST_STEPS = 8
"""Of reweighting lines of sight that do not meet."""
ODD = 3.0
"""Standard deviations beyond which a line of sight counts less and less."""
NEWTON_STEPS = 4
LEAST_SHARE = 0.1
"""Of either mode."""
SEEN_WRONGLY = 0.05
"""The share of joints, about, of which their views do not say where they are."""
LEAST_REACH = 0.02
"""Of a bone's length: the least standard deviation of its ends' distance."""


class SpatialAim(NamedTuple):
    """A Gaussian in space in its own axes: its mean, `point` `(3,)` mm; `axes` `(3, 3)`, in
    columns, the vaguest first; and its `precision` `(3,)` along them, per mm²."""

    point: jax.Array
    axes: jax.Array
    precision: jax.Array


def aim_of(
    rig: CameraRig, sights: Sights, trust: jax.Array, size: jax.Array, place: jax.Array
) -> SpatialAim:
    """Where one joint is, by its lines of sight in views of some `trust` `(C,)`, and within some
    body units of a body's `place`."""
    unbiased = (
        sights.keypoint
        - sights.bias * (rig.focal * size / jnp.maximum(rig.view(place)[:, 2], 1.0))[:, None]
    )
    ray = rig.rays(unbiased)
    across = jnp.eye(3)[None] - ray[:, :, None] * ray[:, None, :]
    sharp = jnp.where(sights.counts, trust * 4 / (sights.spread * size) ** 2, 0.0)
    vague = 1 / (2 * size) ** 2

    def solve(weight: jax.Array) -> tuple[jax.Array, jax.Array]:
        normal = jnp.einsum("c,cab->ab", weight * sharp, across) + vague * jnp.eye(3)
        right = jnp.einsum("c,cab,cb->a", weight * sharp, across, rig.centre) + vague * place
        return _solved(normal, right), normal

    def reweighted(_: Any, weight: jax.Array) -> jax.Array:
        point, _ = solve(weight)
        off = jnp.einsum("cab,cb->ca", across, point[None] - rig.centre)
        return 1 / (1 + sharp * jnp.sum(off**2, axis=-1) / ODD**2)

    weight = jax.lax.fori_loop(0, TRUST_STEPS, reweighted, jnp.ones_like(sharp))
    point, normal = solve(weight)
    precision, axes = jnp.linalg.eigh(normal)
    return SpatialAim(point, axes, precision)


def _solved(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """`(3,)`: the solution of a positive definite system, by cross products: many times quicker
    than a library's call for each."""
    a, b, c = matrix
    across = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)])
    return right @ across / jnp.dot(a, across[0])


class Reach(NamedTuple):
    """How far a joint is from where the next one in its chain is seen: that `point` `(3,)`, the
    `length` of the bone between them, and the `sd` of the distance, mm."""

    point: jax.Array
    length: jax.Array
    sd: jax.Array

    def log_share(self, end: jax.Array) -> jax.Array:
        """`()`: about the log likelihood of a joint at `end` `(3,)` by the one after it, which may
        be seen wrongly."""
        off = (jnp.linalg.norm(end - self.point) - self.length) / self.sd
        return jnp.log(SEEN_WRONGLY + (1 - SEEN_WRONGLY) * jnp.exp(-(off**2) / 2))


def with_next(aim: SpatialAim, after: SpatialAim, length: jax.Array) -> tuple[SpatialAim, Reach]:
    """An aim at a joint that also knows how far the next one in the chain is, by the distance's
    slope; and that distance by itself. The less is known of either place, the less this says."""
    apart = aim.point - after.point
    along = apart / (jnp.linalg.norm(apart) + 1e-9)
    bend = jnp.sum(1 / aim.precision) / (2 * length)
    variance = jnp.sum((after.axes.T @ along) ** 2 / after.precision)
    sharp = 1 / (variance + bend**2)
    normal = (aim.axes * aim.precision[None]) @ aim.axes.T
    normal = normal + sharp * jnp.outer(along, along)
    step = sharp * (length - jnp.linalg.norm(apart)) * along
    precision, axes = jnp.linalg.eigh(normal)
    found = SpatialAim(aim.point + _solved(normal, step), axes, precision)
    return found, Reach(after.point, length, jnp.sqrt(variance) + LEAST_REACH * length)


class AimModes(NamedTuple):
    """Two modes of an aim on a sphere, in the aim's axes: their `centre` `(2, 3)`, two directions
    across them, `across` `(2, 3, 2)`, the proposals' `precision` `(2, 2, 2)` there, and their
    `share` `(2,)`."""

    centre: jax.Array
    across: jax.Array
    precision: jax.Array
    share: jax.Array


def modes_of(aim: SpatialAim, start: jax.Array, length: jax.Array) -> AimModes:
    """Those on a sphere of some `length` in mm around `start` `(3,)`: the best, by a Lagrange
    multiplier, and its mirror image along the vaguest axis."""
    goal = aim.axes.T @ (aim.point - start) / length
    precision = aim.precision * length**2
    pull = precision * goal
    least = precision[0] * (1 - 1e-6)
    multiplier = jnp.maximum(-least, jnp.linalg.norm(pull) - precision[2])

    def newton(_: Any, multiplier: jax.Array) -> jax.Array:
        point = pull / (precision + multiplier)
        norm = jnp.linalg.norm(point) + 1e-300
        bend = jnp.sum(point**2 / (precision + multiplier)) + 1e-300
        return jnp.maximum(-least, multiplier + norm**2 / bend * (norm - 1))

    multiplier = jax.lax.fori_loop(0, NEWTON_STEPS, newton, multiplier)
    best = pull / (precision + multiplier)
    best = jnp.where(jnp.sum(best**2) > 0, best, jnp.array([1.0, 0.0, 0.0]))
    best = best / jnp.linalg.norm(best)
    centre = jnp.stack([best, best * jnp.array([-1.0, 1.0, 1.0])])
    across = jax.vmap(_across)(centre)
    bend = jnp.einsum("kia,i,kib->kab", across, precision, across) + BLUNT * jnp.eye(2)[None]
    misfit = jnp.sum(precision[None] * (centre - goal[None]) ** 2, axis=-1)
    share = jax.nn.softmax(-misfit / 4 - jnp.log(jnp.linalg.det(bend)) / 2)
    return AimModes(centre, across, bend, LEAST_SHARE + (1 - 2 * LEAST_SHARE) * share)


def _across(centre: jax.Array) -> jax.Array:
    """`(3, 2)`: two directions at right angles to a unit vector and to each other (Duff et al.
    2017)."""
    x, y, z = centre
    sign = jnp.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return jnp.array([[1 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])


def draw_direction(modes: AimModes, which: jax.Array, square: jax.Array) -> jax.Array:
    """`(3,)`: a direction of one mode's proposal, in the aim's axes, at a point `(2,)` of the unit
    square."""
    nu = FREEDOM_OF_AIM
    radius = jnp.sqrt(nu * jnp.expm1(-2 / nu * jnp.log1p(-square[0])))
    angle = 2 * jnp.pi * square[1]
    bend = modes.precision[which]
    a = jnp.sqrt(bend[0, 0])
    b = bend[0, 1] / a
    c = jnp.sqrt(bend[1, 1] - b**2)
    # The inverse of the Cholesky factor's transpose.
    second = radius * jnp.sin(angle) / c
    first = (radius * jnp.cos(angle) - b * second) / a
    found = modes.centre[which] + modes.across[which] @ jnp.array([first, second])
    return found / jnp.linalg.norm(found)


def aimed_density(modes: AimModes, direction: jax.Array) -> jax.Array:
    """`()`: density per steradian of a direction `(3,)` in the aim's axes, of both modes'
    proposals: without logarithms, each of which would take longer than all the rest."""
    nu = FREEDOM_OF_AIM

    def one(centre: jax.Array, across: jax.Array, bend: jax.Array) -> jax.Array:
        ahead = direction @ centre
        off = across.T @ direction / jnp.where(ahead > 1e-9, ahead, 1.0)
        level = jnp.sqrt(bend[0, 0] * bend[1, 1] - bend[0, 1] ** 2) / (2 * jnp.pi)
        level /= (1 + off @ bend @ off / nu) ** (nu // 2 + 1)
        stretch = 1 + off @ off
        return jnp.where(ahead > 1e-9, level * stretch * jnp.sqrt(stretch), 0.0)

    each = jax.vmap(one)(modes.centre, modes.across, modes.precision)
    return each @ modes.share
