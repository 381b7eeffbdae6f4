"""Rotations: the uniform law on SO(3), its support, and the bijection from R³.

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
from numpyro.distributions.transforms import Transform, biject_to

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


class _Rotations(constraints.Constraint):
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

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (), ((), {})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Rotations)

    __hash__ = None  # type: ignore[assignment]


rotations = _Rotations()


class RotationTransform(Transform):
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

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (), ((), {})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RotationTransform)

    __hash__ = None  # type: ignore[assignment]


@biject_to.register(_Rotations)
def _to_rotations(constraint: _Rotations) -> RotationTransform:
    return RotationTransform()


class UniformRotation(Distribution):
    """A rotation `(3, 3)`, uniform on SO(3): no turn of it changes its law.

    Parameters
    ----------
    batch_shape : of independent ones.
    """

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012 — NumPyro's own protocol
    support = rotations

    def __init__(
        self, batch_shape: tuple[int, ...] = (), *, validate_args: bool | None = None
    ) -> None:
        super().__init__(batch_shape=batch_shape, event_shape=(3, 3), validate_args=validate_args)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Rotations `sample_shape + batch_shape + (3, 3)`: quaternions uniform on their sphere."""
        shape = (*sample_shape, *self.batch_shape, 4)
        return rotation_of(jax.random.normal(key, shape))

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """0 on SO(3), -inf elsewhere."""
        value = jnp.asarray(value)
        inside = rotations(value)
        inside = jnp.broadcast_to(inside, jnp.broadcast_shapes(inside.shape, self.batch_shape))
        zero = jnp.zeros((), value.dtype)
        return jnp.where(inside, zero, -jnp.inf)
