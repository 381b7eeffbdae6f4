"""Rotations: a law of them, uniform on SO(3) or of upright bodies, its support, and the bijection
from R³.

Base measure of every density is Haar's, normalised to one: the uniform law has density one. The
bijection sends a vector x to the rotation of the quaternion (1, x) (the Rodrigues vector, or Cayley
map); it leaves out the half turns alone, which have no mass.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints
from numpyro.distributions.transforms import ParameterFreeTransform, biject_to

LOG_HALF_SPHERE = 2 * math.log(math.pi)
"""Log of the surface of half the sphere of quaternions, π²."""


def rotation_of(quaternion: ArrayLike) -> jax.Array:
    """Rotations `(..., 3, 3)` of quaternions `(..., 4)`, scalar first, of any length but zero."""

    def one(quaternion: jax.Array) -> jax.Array:
        w, v = quaternion[0], quaternion[1:]
        x, y, z = v
        cross = jnp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turned = (w**2 - v @ v) * jnp.eye(3) + 2 * jnp.outer(v, v) + 2 * w * cross
        return turned / (quaternion @ quaternion)

    return jnp.vectorize(one, signature="(q)->(i,j)")(jnp.asarray(quaternion))


def rodrigues(rotation: ArrayLike) -> jax.Array:
    """`(..., 3)`: the vectors x of the quaternions (1, x) of rotations `(..., 3, 3)`; very long
    near half turns."""

    def one(r: jax.Array) -> jax.Array:
        # 4 q qᵀ, which is linear in the rotation; its row with the largest diagonal is the best.
        (a, b, c), (d, e, f), (g, h, i) = r
        products = jnp.array(
            [
                [1 + a + e + i, h - f, c - g, d - b],
                [h - f, 1 + a - e - i, b + d, c + g],
                [c - g, b + d, 1 - a + e - i, f + h],
                [d - b, c + g, f + h, 1 - a - e + i],
            ]
        )
        row = products[jnp.argmax(jnp.diagonal(products))]
        tiny = jnp.finfo(row.dtype).eps ** 2
        scalar = jnp.where(jnp.abs(row[0]) < tiny, tiny, row[0])
        return row[1:] / scalar

    return jnp.vectorize(one, signature="(i,j)->(x)")(jnp.asarray(rotation))


class _Rotations(constraints.ParameterFreeConstraint):
    """Matrices `(3, 3)` that are orthonormal, up to rounding, with determinant one."""

    event_dim = 2

    def __call__(self, x: ArrayLike) -> jax.Array:
        x = jnp.asarray(x)
        off = jnp.swapaxes(x, -1, -2) @ x - jnp.broadcast_to(jnp.eye(3, dtype=x.dtype), x.shape)
        near = jnp.max(jnp.abs(off), axis=(-1, -2)) < 1000 * jnp.finfo(x.dtype).eps
        return near & (jnp.linalg.det(x) > 0)

    def feasible_like(self, prototype: ArrayLike) -> jax.Array:
        """The identity, for every event of `prototype`."""
        return jnp.broadcast_to(jnp.eye(3), jnp.shape(prototype))


rotations = _Rotations()


class RotationTransform(ParameterFreeTransform):
    """R³ → SO(3) without the half turns: x ↦ the rotation of the quaternion (1, x)."""

    domain = constraints.real_vector
    codomain = rotations

    def __call__(self, x: ArrayLike) -> jax.Array:
        x = jnp.asarray(x)
        return rotation_of(jnp.concatenate([jnp.ones_like(x[..., :1]), x], axis=-1))

    def _inverse(self, y: ArrayLike) -> jax.Array:
        return rodrigues(y)

    def log_abs_det_jacobian(
        self, x: ArrayLike, y: ArrayLike, intermediates: Any = None
    ) -> jax.Array:
        """Log of Haar's measure per unit of volume, -log π² (1 + |x|²)²."""
        return -LOG_HALF_SPHERE - 2 * jnp.log1p(jnp.sum(jnp.asarray(x) ** 2, axis=-1))

    def forward_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        return (*shape[:-1], 3, 3)

    def inverse_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        return shape[:-1]


@biject_to.register(_Rotations)
def _to_rotations(constraint: _Rotations) -> RotationTransform:
    return RotationTransform()


class UprightRotation(Distribution):
    """A rotation `(3, 3)` from body axes to camera axes whose second column, the way the back
    points, scatters about the image's vertical (von Mises & Fisher's law on the sphere); the way
    that the chest points is uniform about it. At concentration 0 it is uniform on SO(3): no turn of
    it changes its law.

    Parameters
    ----------
    concentration
        κ ≥ 0: the tilt's standard deviation each way is about 1/√κ radians.
    """

    arg_constraints: dict[str, Any] = {  # noqa: RUF012 — NumPyro's own protocol
        "concentration": constraints.nonnegative
    }
    support = rotations

    def __init__(
        self, concentration: ArrayLike = 0.0, *, validate_args: bool | None = None
    ) -> None:
        self.concentration = jnp.asarray(concentration, float)
        super().__init__(self.concentration.shape, (3, 3), validate_args=validate_args)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Rotations `sample_shape + batch_shape + (3, 3)`."""
        shape = (*sample_shape, *self.batch_shape)
        level_key, turn_key, side_key = jax.random.split(key, 3)
        level = jax.random.uniform(level_key, shape)
        concentration = jnp.broadcast_to(self.concentration, shape)
        k = jnp.where(concentration > NEARLY_FLAT, concentration, 1.0)
        cosine = 1 + jnp.log(level + (1 - level) * jnp.exp(-2 * k)) / k
        cosine = jnp.where(concentration > NEARLY_FLAT, cosine, 2 * level - 1)
        turn = jax.random.uniform(turn_key, shape, maxval=2 * math.pi)
        sine = jnp.sqrt(jnp.maximum(1 - cosine**2, 0.0))
        up = jnp.stack([sine * jnp.cos(turn), -cosine, sine * jnp.sin(turn)], axis=-1)
        left = jax.random.normal(side_key, (*shape, 3))
        left = left - jnp.sum(left * up, axis=-1, keepdims=True) * up
        left = left / jnp.linalg.norm(left, axis=-1, keepdims=True)
        return jnp.stack([left, up, jnp.cross(left, up)], axis=-1)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Log density with respect to Haar's measure on SO(3), -inf elsewhere."""
        value = jnp.asarray(value)
        shape = jnp.broadcast_shapes(value.shape[:-2], self.batch_shape)
        concentration = jnp.broadcast_to(self.concentration, shape)
        upright = jnp.broadcast_to(-value[..., 1, 1], shape)
        found = log_upright_peak(concentration) + concentration * (upright - 1)
        return jnp.where(jnp.broadcast_to(rotations(value), shape), found, -jnp.inf)


NEARLY_FLAT = 1e-6
"""Concentrations up to this are taken for 0."""


def log_upright_peak(concentration: ArrayLike) -> jax.Array:
    """Log of the largest density of `UprightRotation`, that of an upright body: 2κ / (1 -
    exp(-2κ))."""
    k = jnp.asarray(concentration, float)
    safe = jnp.where(k > NEARLY_FLAT, k, 1.0)
    return jnp.where(k > NEARLY_FLAT, jnp.log(2 * safe) - jnp.log(-jnp.expm1(-2 * safe)), 0.0)
