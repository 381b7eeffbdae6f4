"""The transport: the unit cube [0, 1]^23 → a pose, and back. Uniform points of the cube become
draws of the prior.

Coordinates 0–4: bone lengths; 5–14: upper bones, two each; 15–22: lower bones, two each. The torso
is given. In cube coordinates the prior is flat, and the posterior is flat on a region."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from probmodel.anatomy.lengths import BoneLength
from probmodel.directions.distributions import HingedDirection, OccupiedDirection
from probmodel.model import PoseModel
from probmodel.skeleton import NUM_LENGTHS, NUM_LOWER, NUM_UPPER

CUBE_DIM = NUM_LENGTHS + 2 * NUM_UPPER + 2 * NUM_LOWER


class Configuration(NamedTuple):
    """A pose without its torso: `length` `(..., 5)` of the groups, `upper` `(..., 5, 3)`, `lower`
    `(..., 4, 3)`."""

    length: jax.Array
    upper: jax.Array
    lower: jax.Array


@jax.jit
def from_cube(model: PoseModel, cube: ArrayLike) -> Configuration:
    """The configuration at points `(..., 23)` of the unit cube."""
    cube = jnp.asarray(cube)
    batch = cube.shape[:-1]
    length, upper, lower = jnp.split(cube, [NUM_LENGTHS, NUM_LENGTHS + 2 * NUM_UPPER], axis=-1)
    directions = OccupiedDirection(model.cells).transport(upper.reshape(*batch, NUM_UPPER, 2))
    hinged = HingedDirection(model.hinges_at(directions)).transport(
        lower.reshape(*batch, NUM_LOWER, 2)
    )
    return Configuration(BoneLength(model.lengths).transport(length), directions, hinged)


@jax.jit
def to_cube(model: PoseModel, configuration: Configuration) -> jax.Array:
    """The points `(..., 23)` of the unit cube that `from_cube` sends to a configuration inside the
    prior's support."""
    length = BoneLength(model.lengths).inverse(configuration.length)
    upper = OccupiedDirection(model.cells).inverse(configuration.upper)
    lower = HingedDirection(model.hinges_at(configuration.upper)).inverse(configuration.lower)
    batch = length.shape[:-1]
    return jnp.concatenate([length, upper.reshape(*batch, -1), lower.reshape(*batch, -1)], axis=-1)
