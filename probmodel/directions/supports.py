"""Supports of the custom distributions as NumPyro constraints, each with its registered bijection
from R².

`directions(region)`: unit vectors in a region of the sphere. `disc(centre, radius)`: points in a
disc of the image. Log determinants are with respect to surface on the sphere and area in the
image."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import constraints
from numpyro.distributions.transforms import Transform, biject_to

from poseterior.probmodel.directions.regions import Region


@functools.partial(jax.jit, static_argnums=(0, 1))
def over_batch(function: Any, batch_ndim: int, parameters: Any, value: ArrayLike) -> jax.Array:
    """Applies a formula for one event to a batch.

    Parameters
    ----------
    function
        function(parameters, event). Compiled once for each function and shape, so give it a
        function that lasts, not a new lambda.
    batch_ndim
        Number of batch axes with which the leaves of `parameters` start.
    parameters
        A pytree.
    value : `(*sample, *batch, n)`
        May lack leading batch axes or have length 1 there.

    Returns
    -------
    `(*sample, *batch, ...)`
    """
    value = jnp.asarray(value)
    batch_shape = jnp.shape(jax.tree.leaves(parameters)[0])[:batch_ndim]
    value = jnp.broadcast_to(
        value, (*jnp.broadcast_shapes(value.shape[:-1], batch_shape), value.shape[-1])
    )
    for _ in range(batch_ndim):
        function = jax.vmap(function)
    for _ in range(value.ndim - 1 - batch_ndim):
        function = jax.vmap(function, in_axes=(None, 0))
    return function(parameters, value)


def is_inside(region: Region, vector: jax.Array) -> jax.Array:
    """`()` bool: whether `vector` `(3,)` has length one, up to rounding, and lies in the region."""
    norm = jnp.linalg.norm(vector)
    return (jnp.abs(norm - 1) < 1000 * jnp.finfo(norm.dtype).eps) & region.contains(vector)


class _Directions(constraints.Constraint):
    """Unit vectors `(3,)` in a region of the sphere."""

    event_dim = 1

    def __init__(self, region: Region, batch_ndim: int = 0) -> None:
        self.region = region
        self.batch_ndim = batch_ndim

    def __call__(self, x: ArrayLike) -> jax.Array:
        return over_batch(is_inside, self.batch_ndim, self.region, x)

    def feasible_like(self, prototype: ArrayLike) -> jax.Array:
        """A direction of the region for every event of `prototype`."""
        middle = jnp.full((*jnp.shape(prototype)[:-1], 2), 0.5)
        return over_batch(type(self.region).transport, self.batch_ndim, self.region, middle)

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (self.region,), (("region",), {"batch_ndim": self.batch_ndim})

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Directions) or self.batch_ndim != other.batch_ndim:
            return False
        mine, theirs = jax.tree.leaves(self.region), jax.tree.leaves(other.region)
        same_kind = jax.tree.structure(self.region) == jax.tree.structure(other.region)  # type: ignore[operator]
        return same_kind and all(
            bool(jnp.array_equal(a, b)) for a, b in zip(mine, theirs, strict=True)
        )

    __hash__ = None  # type: ignore[assignment]


def same_rank(*arrays: ArrayLike) -> list[jax.Array]:
    """The arrays with leading axes of length 1, so that none is promoted in silence."""
    ndim = max(jnp.ndim(array) for array in arrays)
    return [
        jnp.reshape(array, (1,) * (ndim - jnp.ndim(array)) + jnp.shape(array)) for array in arrays
    ]


class _Disc(constraints.Constraint):
    """Points `(2,)` of a closed disc."""

    event_dim = 1

    def __init__(self, centre: ArrayLike, radius: ArrayLike) -> None:
        self.centre = centre
        self.radius = radius

    def __call__(self, x: ArrayLike) -> jax.Array:
        x, centre, radius = same_rank(x, self.centre, jnp.asarray(self.radius)[..., None])
        return jnp.sum((x - centre) ** 2, axis=-1) <= radius[..., 0] ** 2

    def feasible_like(self, prototype: ArrayLike) -> jax.Array:
        """The centre, for every event of `prototype`."""
        return jnp.broadcast_to(jnp.asarray(self.centre), jnp.shape(prototype))

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (self.centre, self.radius), (("centre", "radius"), {})

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, _Disc)
            and bool(jnp.array_equal(self.centre, other.centre))
            and bool(jnp.array_equal(self.radius, other.radius))
        )

    __hash__ = None  # type: ignore[assignment]


directions = _Directions
disc = _Disc


class DirectionTransform(Transform):
    """R² → a region of the sphere: the logistic function into the unit square, then the region's
    transport."""

    domain = constraints.real_vector

    def __init__(self, region: Region, batch_ndim: int = 0) -> None:
        self.region = region
        self.batch_ndim = batch_ndim

    @property
    def codomain(self) -> constraints.Constraint:
        return _Directions(self.region, self.batch_ndim)

    def __call__(self, x: ArrayLike) -> jax.Array:
        square = jax.nn.sigmoid(jnp.asarray(x))
        return over_batch(type(self.region).transport, self.batch_ndim, self.region, square)

    def _inverse(self, y: ArrayLike) -> jax.Array:
        square = over_batch(type(self.region).inverse, self.batch_ndim, self.region, y)
        tiny = jnp.finfo(square.dtype).tiny
        return jnp.log(jnp.maximum(square, tiny)) - jnp.log(jnp.maximum(1 - square, tiny))

    def log_abs_det_jacobian(
        self, x: ArrayLike, y: ArrayLike, intermediates: Any = None
    ) -> jax.Array:
        """Log of the surface swept per unit of the plane: that of the logistic function, less the
        region's log density."""
        x = jnp.asarray(x)
        logistic = jnp.sum(jax.nn.log_sigmoid(x) + jax.nn.log_sigmoid(-x), axis=-1)
        return logistic - over_batch(type(self.region).log_density, self.batch_ndim, self.region, y)

    def forward_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        return (*shape[:-1], 3)

    def inverse_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        return (*shape[:-1], 2)

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (self.region,), (("region",), {"batch_ndim": self.batch_ndim})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DirectionTransform) and self.codomain == other.codomain

    __hash__ = None  # type: ignore[assignment]


class DiscTransform(Transform):
    """R² → a disc, x ↦ centre + radius · x / √(1 + |x|²)."""

    domain = constraints.real_vector

    def __init__(self, centre: ArrayLike, radius: ArrayLike) -> None:
        self.centre = centre
        self.radius = radius

    @property
    def codomain(self) -> constraints.Constraint:
        return _Disc(self.centre, self.radius)

    def __call__(self, x: ArrayLike) -> jax.Array:
        x = jnp.asarray(x)
        squashed = x / jnp.sqrt(1 + jnp.sum(x**2, axis=-1, keepdims=True))
        squashed, centre, radius = same_rank(
            squashed, self.centre, jnp.asarray(self.radius)[..., None]
        )
        return centre + radius * squashed

    def _inverse(self, y: ArrayLike) -> jax.Array:
        y, centre, radius = same_rank(y, self.centre, jnp.asarray(self.radius)[..., None])
        squashed = (y - centre) / radius
        rest = 1 - jnp.sum(squashed**2, axis=-1, keepdims=True)
        return squashed / jnp.sqrt(jnp.maximum(rest, jnp.finfo(rest.dtype).eps))

    def log_abs_det_jacobian(
        self, x: ArrayLike, y: ArrayLike, intermediates: Any = None
    ) -> jax.Array:
        square, radius = same_rank(jnp.sum(jnp.asarray(x) ** 2, axis=-1), self.radius)
        return 2 * jnp.log(radius) - 2 * jnp.log1p(square)

    def tree_flatten(self) -> tuple[tuple, tuple]:
        return (self.centre, self.radius), (("centre", "radius"), {})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DiscTransform) and self.codomain == other.codomain

    __hash__ = None  # type: ignore[assignment]


@biject_to.register(_Directions)
def _to_directions(constraint: _Directions) -> DirectionTransform:
    return DirectionTransform(constraint.region, constraint.batch_ndim)


@biject_to.register(_Disc)
def _to_disc(constraint: _Disc) -> DiscTransform:
    return DiscTransform(constraint.centre, constraint.radius)
