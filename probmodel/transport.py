"""The transport: the unit cube [0, 1]^23 → a pose, and back. Uniform points of the cube become
draws of the prior.

Coordinates 0-4: bone lengths; 5-14: upper bones, two each; 15-22: lower bones, two each. The torso
is given. In cube coordinates the prior is flat, and under discs the posterior is flat on a region.
The *fractions* of a pose are the same coordinates, but for lengths, which are fractions of their
ranges: Beta variables, with no quantile function to compute.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.scipy.special import gammaln
from jax.typing import ArrayLike

from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.skeleton import NUM_LENGTHS, NUM_LOWER, NUM_UPPER

CUBE_DIM = NUM_LENGTHS + 2 * NUM_UPPER + 2 * NUM_LOWER
_CUTS = (NUM_LENGTHS, NUM_LENGTHS + 2 * NUM_UPPER)
_Map = Callable[[Any, Any], jax.Array]


@jax.jit
def from_cube(model: PoseModel, cube: ArrayLike) -> Pose:
    """The pose at points `(..., 23)` of the unit cube."""
    return _forth(model, jnp.asarray(cube), lambda law, part: law.transport(part))


@jax.jit
def to_cube(model: PoseModel, pose: Pose) -> jax.Array:
    """The points `(..., 23)` of the unit cube that `from_cube` sends to a pose inside the prior's
    support."""
    return _back(model, pose, lambda law, length: law.inverse(length))


def from_fractions(model: PoseModel, fractions: jax.Array) -> Pose:
    """The pose of fractions `(..., 23)`."""
    return _forth(model, fractions, lambda law, part: law.at(part))


def to_fractions(model: PoseModel, pose: Pose) -> jax.Array:
    """The fractions `(..., 23)` of a pose inside the prior's support."""
    return _back(model, pose, lambda law, length: law.fraction(length))


def log_density_of_logits(alpha: jax.Array, beta: jax.Array, points: jax.Array) -> jax.Array:
    """`(...)`: normalised log density, at points `(..., d)` of R^d, of the logits of independent
    fractions with Beta parameters `(d,)`, `(d,)`."""
    # From log gammas: betaln of jax 0.12 is off by 1e-8 and more.
    constant = jnp.sum(gammaln(alpha) + gammaln(beta) - gammaln(alpha + beta))

    def one(point: jax.Array) -> jax.Array:
        up, down = jax.nn.log_sigmoid(point), jax.nn.log_sigmoid(-point)
        return jnp.sum(alpha * up + beta * down) - constant

    return jnp.vectorize(one, signature="(d)->()")(points)


def _forth(model: PoseModel, coordinates: jax.Array, lengths: _Map) -> Pose:
    parts = jnp.split(coordinates, _CUTS, axis=-1)
    given = dict(zip(("bone_length", "upper", "lower"), parts, strict=True))

    def step(site: str, law: Any) -> jax.Array:
        if site == "bone_length":
            return lengths(law, given[site])
        return law.transport(given[site].reshape(*given[site].shape[:-1], -1, 2))

    return model.compose(step)


def _back(model: PoseModel, pose: Pose, lengths: _Map) -> jax.Array:
    given = dict(zip(("bone_length", "upper", "lower"), pose, strict=True))
    parts = []

    def step(site: str, law: Any) -> jax.Array:
        value = jnp.asarray(given[site])
        if site == "bone_length":
            parts.append(lengths(law, value))
        else:
            square = law.inverse(value)
            parts.append(square.reshape(*square.shape[:-2], -1))
        return value

    model.compose(step)
    return jnp.concatenate(parts, axis=-1)
