"""Bone lengths: five groups, shared by left and right, each low + (high - low)·Beta(α, β), in body
units (eq. 6; docs/model.md § 2).

`BoneLength` is the distribution of the five; its numbers are learned (`population.LengthPrior`).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.special import betainc, gammaln, ndtri, xlog1py, xlogy
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from poseterior.probmodel.anatomy.population import LengthPrior
from poseterior.probmodel.directions.regions import invert_monotone
from poseterior.probmodel.directions.supports import same_rank


class BoneLength(Distribution):
    """Lengths `(5,)` of `skeleton.LENGTH_GROUPS`, body units (eq. 6).

    Parameters
    ----------
    prior
        Ranges and shapes of the lengths.
    validate_args
        Whether values are checked (NumPyro's switch).
    """

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012 — NumPyro's own protocol
    pytree_data_fields = ("prior",)

    def __init__(self, prior: LengthPrior, *, validate_args: bool | None = None) -> None:
        self.prior = LengthPrior(*(jnp.asarray(field) for field in prior))
        shape = jnp.shape(self.prior.low)
        super().__init__(
            batch_shape=shape[:-1], event_shape=shape[-1:], validate_args=validate_args
        )

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return constraints.independent(constraints.interval(self.prior.low, self.prior.high), 1)

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Lengths `sample_shape + batch_shape + (5,)`."""
        shape = (*sample_shape, *self.batch_shape, *self.event_shape)
        return self.at(jax.random.beta(key, self.prior.alpha, self.prior.beta, shape))

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Log density with respect to length in body units, -inf outside the ranges."""
        fraction, span, alpha, beta = self._fraction(value)
        inside = (fraction >= 0) & (fraction <= 1)
        each = _log_beta(jnp.where(inside, fraction, 0.5), alpha, beta) - jnp.log(span)
        return jnp.sum(jnp.where(inside, each, -jnp.inf), axis=-1)

    def transport(self, cube: ArrayLike) -> jax.Array:
        """Lengths at points `(..., 5)` of the unit cube: the quantile functions."""
        return self.at(_beta_quantile(jnp.asarray(cube), self.prior.alpha, self.prior.beta))

    def inverse(self, value: ArrayLike) -> jax.Array:
        """The point `(..., 5)` of the unit cube of some lengths: the distribution functions."""
        fraction, _, alpha, beta = self._fraction(value)
        return betainc(*jnp.broadcast_arrays(alpha, beta, jnp.clip(fraction, 0.0, 1.0)))

    def fraction(self, value: ArrayLike) -> jax.Array:
        """Where in the ranges lengths `(..., 5)` lie: the inverse of `at`."""
        return self._fraction(value)[0]

    def _fraction(self, value: ArrayLike) -> list[jax.Array]:
        """Where in the ranges lengths lie, the ranges' widths, and the Beta parameters, of one
        rank."""
        value, low, high, alpha, beta = same_rank(value, *self.prior)
        return [(value - low) / (high - low), high - low, alpha, beta]

    def at(self, fraction: ArrayLike) -> jax.Array:
        """Lengths `(..., 5)` at fractions of the ranges."""
        fraction, low, high = same_rank(fraction, self.prior.low, self.prior.high)
        # Rounding may carry a fraction of one past the end of the range.
        return jnp.clip(low + (high - low) * fraction, low, high)


def _log_beta(x: jax.Array, alpha: jax.Array, beta: jax.Array) -> jax.Array:
    # From log gammas: betaln of jax 0.12 is off by 1e-8.
    constant = gammaln(alpha + beta) - gammaln(alpha) - gammaln(beta)
    return xlogy(alpha - 1, x) + xlog1py(beta - 1, -x) + constant


def _beta_quantile(probability: jax.Array, alpha: ArrayLike, beta: ArrayLike) -> jax.Array:
    def one(probability: jax.Array, alpha: jax.Array, beta: jax.Array) -> jax.Array:
        smallest = jnp.finfo(probability.dtype).tiny
        largest = 1 - jnp.finfo(probability.dtype).epsneg

        def below(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
            inside = jnp.clip(x, smallest, largest)
            slope = jnp.exp(_log_beta(inside, alpha, beta))
            return betainc(alpha, beta, x), slope, (alpha - 1) / inside - (beta - 1) / (1 - inside)

        zero = jnp.zeros_like(probability)
        noise = 64 * jnp.finfo(probability.dtype).eps * probability
        x = invert_monotone(
            below, probability, zero, zero + 1, _beta_guess(probability, alpha, beta), noise
        )
        # Where the density vanishes at an end, the distribution function is exactly 0 or 1 on part
        # of the range.
        return jnp.where(probability <= 0, 0.0, jnp.where(probability >= 1, 1.0, x))

    return jnp.vectorize(one)(*same_rank(probability, alpha, beta))


def _beta_guess(probability: jax.Array, alpha: jax.Array, beta: jax.Array) -> jax.Array:
    """Roughly the quantile: where both parameters exceed one, from the normal quantile (Abramowitz
    & Stegun, 26.5.22), otherwise from the power laws at the two ends."""
    # Where the approximation does not hold, harmless parameters keep it from being NaN.
    a, b = jnp.maximum(alpha, 1.001), jnp.maximum(beta, 1.001)
    edge = jnp.finfo(probability.dtype).eps
    y = -ndtri(jnp.clip(probability, edge, 1 - edge))
    p, q = 1 / (2 * a - 1), 1 / (2 * b - 1)
    h, curve = 2 / (p + q), (y**2 - 3) / 6
    w = y * jnp.sqrt(jnp.maximum(h + curve, 0.0)) / h - (q - p) * (curve + 5 / 6 - 2 / (3 * h))
    bell = a / (a + b * jnp.exp(2 * w))
    left, right = (alpha * probability) ** (1 / alpha), 1 - (beta * (1 - probability)) ** (1 / beta)
    return jnp.where(
        (alpha > 1) & (beta > 1), bell, jnp.where(probability < beta / (alpha + beta), left, right)
    )
