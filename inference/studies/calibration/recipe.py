"""The paper's recipe for lower bones, to the letter: what it draws is a control, not the model.

It has no density (docs/model.md § 2); the model's measure "box" is the recipe restricted to where
it has one."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from numpyro.distributions import Distribution, constraints

from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.directions.supports import directions

_State = tuple[jax.Array, jax.Array, jax.Array]  # attempts made, key, direction


class RecipeDirection(Distribution):
    """Directions `(3,)` with u2, u3 uniform in the box and u1 = ±√max(1-u2²-u3², 0), renormalised;
    the sign is random where both are valid.

    Where the box sticks out of the unit disc, the clamp puts mass on a great circle.

    Parameters
    ----------
    hinge
        Leaves may start with batch axes.
    attempts
        How often a draw is made again while neither sign is valid; then it comes back invalid.
    """

    arg_constraints: dict[str, Any] = {}  # noqa: RUF012
    pytree_data_fields = ("hinge",)
    pytree_aux_fields = ("attempts",)

    def __init__(
        self, hinge: Hinge, *, attempts: int = 100, validate_args: bool | None = None
    ) -> None:
        self.hinge = hinge
        self.attempts = attempts
        super().__init__(
            batch_shape=jnp.shape(hinge.offset), event_shape=(3,), validate_args=validate_args
        )

    @constraints.dependent_property(is_discrete=False, event_dim=1)
    def support(self) -> constraints.Constraint:
        return directions(self.hinge, len(self.batch_shape))

    def sample(self, key: jax.Array, sample_shape: tuple[int, ...] = ()) -> jax.Array:
        """Unit vectors `sample_shape + batch_shape + (3,)`."""
        return _recipes(self.hinge, key, (*sample_shape, *self.batch_shape), self.attempts)

    def log_prob(self, value: ArrayLike) -> jax.Array:
        """Always an error: the clamp gives a great circle positive probability."""
        raise TypeError(
            "the paper's literal recipe has no density: the clamp √max(1-u2²-u3², 0) puts positive"
            ' probability on a great circle; use HingedDirection with measure "area" (eq. 8) or'
            ' "box" (the recipe inside the disc)'
        )


@functools.partial(jax.jit, static_argnums=(2, 3))
def _recipes(hinge: Hinge, key: jax.Array, shape: tuple[int, ...], attempts: int) -> jax.Array:
    keys = jax.random.split(key, shape)
    one = functools.partial(_recipe, attempts=attempts)
    for _ in range(hinge.offset.ndim):
        one = jax.vmap(one)
    for _ in range(len(shape) - hinge.offset.ndim):
        one = jax.vmap(one, in_axes=(None, 0))
    return one(hinge, keys)


def _recipe(hinge: Hinge, key: jax.Array, attempts: int) -> jax.Array:
    bounds = hinge.bounds

    def attempt(state: _State) -> _State:
        step, key, _ = state
        key, for_box, for_sign = jax.random.split(key, 3)
        u2, u3 = jax.random.uniform(for_box, (2,), minval=bounds[0::2], maxval=bounds[1::2])
        u1 = jnp.sqrt(jnp.maximum(1 - u2**2 - u3**2, 0.0))
        both = jnp.stack([jnp.stack([-u1, u2, u3]), jnp.stack([u1, u2, u3])])
        both = (both / jnp.linalg.norm(both, axis=-1, keepdims=True)) @ hinge.triple
        valid = jax.vmap(hinge.contains)(both)
        behind = jnp.where(valid.all(), jax.random.bernoulli(for_sign), valid[1] & ~valid[0])
        chosen = jnp.where(behind, both[1], both[0])
        return step + 1, key, chosen

    def unfinished(state: _State) -> jax.Array:
        return (state[0] < attempts) & ~hinge.contains(state[2])

    outside = hinge.triple[0]  # the normal itself is never valid, so the loop runs at least once
    return jax.lax.while_loop(unfinished, attempt, (jnp.zeros((), int), key, outside))[2]
