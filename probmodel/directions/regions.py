"""Regions of the unit sphere with a density, each given as a map from the unit square: the geometry
of the prior.

A region holds the parameters of one event. It knows whether it `contains` a unit vector, the
`log_density` of one (per steradian), the `transport` from the unit square that turns uniform
numbers into its law, and the `inverse`. Distributions (`distributions`), supports and bijections
(`supports`) and the transport of whole poses (`probmodel.transport`) all follow from these."""

import abc
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

Curve = Callable[[jax.Array], tuple[jax.Array, jax.Array, jax.Array]]
"""A function of one number that returns its value, its slope, and its second derivative over its
slope."""


class _Search(NamedTuple):
    step: jax.Array
    low: jax.Array
    high: jax.Array
    x: jax.Array
    done: jax.Array


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
        """Unit vector `(3,)` at a point `(2,)` of the unit square; uniform points become draws of
        the density."""

    @abc.abstractmethod
    def inverse(self, vector: jax.Array) -> jax.Array:
        """The point `(2,)` of the unit square that `transport` sends to a unit vector `(3,)` of the
        region."""


def invert_monotone(
    function: Curve,
    target: jax.Array,
    low: jax.Array,
    high: jax.Array,
    start: jax.Array,
    noise: ArrayLike,
) -> jax.Array:
    """Solves f(x) = target for x in [low, high], on which f increases.

    Halley's method, kept inside a shrinking bracket. Differentiable once, in `target` (slope 1/f′)
    and not in the bracket: the derivative is that of the implicit function, not of the iterations.

    Parameters
    ----------
    function
        Returns f, f′ and f″/f′ at x; with 0 for the last, the method is Newton's.
    target, low, high, start : `()`
    noise : `()`
        The rounding error of f: where f misses the target by no more, the search ends.
    """
    fixed, low, high, start = jax.lax.stop_gradient((target, low, high, start))
    close = 2 * jnp.finfo(jnp.result_type(fixed)).eps
    tiny = jnp.finfo(jnp.result_type(fixed)).tiny

    def unfinished(state: _Search) -> jax.Array:
        return ~state.done & (state.step < 80)

    def narrow(state: _Search) -> _Search:
        value, slope, bend = function(state.x)
        error = value - fixed
        low = jnp.where(error < 0, state.x, state.low)
        high = jnp.where(error < 0, state.high, state.x)
        newton = error / jnp.maximum(slope, tiny)
        after = state.x - newton / jnp.clip(1 - newton * bend / 2, 0.5, 2.0)
        after = jnp.where((after >= low) & (after <= high), after, (low + high) / 2)
        exact = jnp.abs(error) <= noise
        done = exact | (jnp.abs(after - state.x) <= close) | (high - low <= close)
        return _Search(state.step + 1, low, high, jnp.where(exact, state.x, after), done)

    # False in every element of a batch: `False` alone would not be batched like the rest.
    begin = _Search(jnp.zeros((), int), low, high, jnp.clip(start, low, high), jnp.isnan(fixed))
    solution = jax.lax.stop_gradient(jax.lax.while_loop(unfinished, narrow, begin).x)
    flat = jnp.maximum(jax.lax.stop_gradient(function(solution)[1]), tiny)
    return solution + (target - fixed) / flat
