"""Regions of the unit sphere with a density, each given as a map from the unit square: the geometry of the prior.

A region is one event's worth of parameters. It knows whether it `contains` a unit vector, the `log_density` of one
(per unit of surface), the `transport` from the unit square that turns uniform numbers into its law, and the `inverse`.
Distributions (`directions`), supports and bijections (`supports`) and the unit cube (`cube`) are all read off these.
"""

import abc

import jax
import jax.numpy as jnp


class Region(abc.ABC):
    """Part of the sphere with a probability density; a frozen pytree, formulas for one event."""

    @abc.abstractmethod
    def contains(self, vector: jax.Array) -> jax.Array:
        """`()` bool: whether the unit vector `(3,)` lies in the region."""

    @abc.abstractmethod
    def log_density(self, vector: jax.Array) -> jax.Array:
        """`()`: log density per steradian at a unit vector `(3,)`, as if inside; not masked."""

    @abc.abstractmethod
    def transport(self, square: jax.Array) -> jax.Array:
        """Unit vector `(3,)` at a point `(2,)` of the unit square; uniform points become draws of the density."""

    @abc.abstractmethod
    def inverse(self, vector: jax.Array) -> jax.Array:
        """The point `(2,)` of the unit square that `transport` sends to a unit vector `(3,)` of the region."""


def invert_monotone(function, slope, target: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:  # type: ignore[no-untyped-def]
    """Solves function(x) = target for x in [low, high], function increasing there with derivative `slope(x)`.

    Newton's method kept inside a shrinking bracket, to the last bits. Differentiable in `target` (slope 1/slope(x)),
    not in the bracket: the derivative is that of the implicit function, not of the iterations.
    """
    fixed = jax.lax.stop_gradient(target)
    close = 8 * jnp.finfo(jnp.result_type(fixed)).eps

    def unfinished(state):  # type: ignore[no-untyped-def]
        step, low, high, _, last = state
        return (step < 80) & (high - low > close) & (jnp.abs(last) > close / 4)

    def narrow(state):  # type: ignore[no-untyped-def]
        step, low, high, x, _ = state
        error = function(x) - fixed
        low, high = jnp.where(error < 0, x, low), jnp.where(error < 0, high, x)
        newton = x - error / jnp.maximum(slope(x), jnp.finfo(error.dtype).tiny)
        inside = (newton >= low) & (newton <= high)
        after = jnp.where(inside, newton, (low + high) / 2)
        return step + 1, low, high, after, jnp.where(error == 0, 0.0, after - x)

    low, high = jax.lax.stop_gradient((low, high))
    start = (low + high) / 2
    solution = jax.lax.while_loop(unfinished, narrow, (0, low, high, start, jnp.full_like(start, jnp.inf)))[3]
    solution = jax.lax.stop_gradient(jnp.clip(solution, low, high))
    flat = jnp.maximum(jax.lax.stop_gradient(slope(solution)), jnp.finfo(solution.dtype).tiny)
    return solution + (target - fixed) / flat
