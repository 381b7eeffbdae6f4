"""The posterior of one candidate as a target for samplers that do not know what a pose is: a
density on R^d or a cube.

Only coordinates that some seen joint depends on are `active`; the others follow the prior whatever
the rest does, are drawn from it exactly (`poses`), and no sampler has to walk along them. Every
active coordinate is a fraction: of a bone length's range, Beta distributed, or one of the two of a
direction in its unit square, uniform. Three charts:

- points `(..., d)` of R^d, the logits of the fractions: the unconstrained space of `PoseModel.posterior` in NumPyro;
- points of the unit cube, where the prior is flat (lengths by their quantiles): `probmodel.transport` restricted to
`active`;
- poses, as lengths and directions: a `Configuration`.
"""

import dataclasses
import functools
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaln
from jax.typing import ArrayLike

from inference.candidates import Frame
from probmodel.chunks import in_chunks
from probmodel.directions.distributions import HingedDirection, OccupiedDirection
from probmodel.failures import BadInput
from probmodel.kinematics import articulation
from probmodel.model import PoseModel
from probmodel.observation import Observation
from probmodel.skeleton import GROUPS, LENGTH_GROUPS, NUM_LENGTHS, NUM_LOWER, NUM_UPPER
from probmodel.transport import CUBE_DIM, Configuration, from_cube

COORDINATES = (
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"upper {bone} {axis}" for bone in range(NUM_UPPER) for axis in "uv"),
    *(f"lower {bone} {axis}" for bone in range(NUM_LOWER) for axis in "uv"),
)
"""Names of the 23 coordinates, in the order of `probmodel.transport`."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Target:
    """The posterior of the limbs, given one candidate: prior × indicator that every seen joint is
    inside its disc."""

    model: PoseModel
    observation: Observation
    active: tuple[int, ...] = dataclasses.field(metadata={"static": True})

    @classmethod
    def of(cls, model: PoseModel, frame: Frame) -> Self:
        """The target of a frame with one candidate. Raises `BadInput` where there are more, or
        nothing is seen."""
        if len(frame.candidates) != 1:
            raise BadInput(
                f"{frame.detection.where} has {len(frame.candidates)} torso-and-camera candidates,"
                " but this sampler draws under one; keep one with --candidates 1"
            )
        observation = frame.observation(frame.candidates[0])
        active = _active(np.asarray(observation.has_factor))
        if not active:
            raise BadInput(
                f"{frame.detection.where} has no seen limb joint: its posterior is the prior; use"
                " rejection"
            )
        return cls(model, observation, active)

    @property
    def dim(self) -> int:
        """How many coordinates are active."""
        return len(self.active)

    @jax.jit
    def log_density(self, points: ArrayLike) -> jax.Array:
        """`(...)`: log posterior density at points `(..., d)` of R^d, per unit of R^d, but for the
        evidence."""
        points = jnp.asarray(points)
        return self.log_base(points) + jnp.where(self.misfit(points) <= 1, 0.0, -jnp.inf)

    @jax.jit
    def log_smooth(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """`(...)`: as `log_density`, with a soft wall Π σ(sharpness · (1 - d²/τ²)) in place of each
        disc's rim."""
        points = jnp.asarray(points)
        return self.log_base(points) + self.log_walls(points, sharpness)

    def log_walls(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """`(...)`: log of the soft walls at points of R^d, at most 0."""

        def wall(square: jax.Array) -> jax.Array:
            return jnp.sum(jnp.where(self._seen, jax.nn.log_sigmoid(sharpness * (1 - square)), 0.0))

        return jnp.vectorize(wall, signature="(j)->()")(
            self._squares(self._configuration(jnp.asarray(points)))
        )

    @jax.jit
    def misfit(self, points: ArrayLike) -> jax.Array:
        """`(...)`: the largest distance of a seen joint from its detection, in radii τ, at points
        of R^d; a pose explains the detection iff it is at most 1."""
        return self._misfit(self._configuration(jnp.asarray(points)))

    @jax.jit
    def misfit_in_cube(self, cube: ArrayLike) -> jax.Array:
        """`(...)`: as `misfit`, at points `(..., d)` of the unit cube; infinite outside of it."""
        cube = jnp.asarray(cube)
        inside = jnp.all((cube >= 0) & (cube <= 1), axis=-1)
        misfit = self._misfit(from_cube(self.model, self._complete(jnp.clip(cube, 0, 1))))
        return jnp.where(inside, misfit, jnp.inf)

    def log_base(self, points: jax.Array) -> jax.Array:
        """`(...)`: normalised log density of the prior at points of R^d: logits of Beta
        variables."""
        alpha, beta = self._shape
        constant = gammaln(alpha + beta) - gammaln(alpha) - gammaln(beta)

        def one(point: jax.Array) -> jax.Array:
            return jnp.sum(
                alpha * jax.nn.log_sigmoid(point) + beta * jax.nn.log_sigmoid(-point) + constant
            )

        return jnp.vectorize(one, signature="(d)->()")(points)

    def prior_points(self, key: jax.Array, number: int) -> jax.Array:
        """`(number, d)` points of R^d from the prior."""
        fraction = jax.random.beta(key, *self._shape, (number, self.dim))
        return _logit(fraction)

    def points_of(self, poses: Configuration) -> np.ndarray:
        """Points `(n, d)` of R^d of poses inside the prior's support."""
        return np.asarray(_points(self, Configuration(*(jnp.asarray(part) for part in poses))))

    def poses(self, key: jax.Array, points: ArrayLike) -> Configuration:
        """Poses at points `(..., d)` of R^d; what no seen joint depends on is drawn from the
        prior."""
        points = np.asarray(points)
        # NumPy's Beta variables: those of JAX take longer to compile than all the rest.
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        alpha, beta = (np.asarray(part) for part in self._whole_shape)
        rest = rng.beta(alpha, beta, (*points.shape[:-1], CUBE_DIM)).reshape(-1, CUBE_DIM)
        flat = in_chunks(functools.partial(_poses, self), points.reshape(-1, self.dim), rest)
        return jax.tree.map(lambda leaf: leaf.reshape(*points.shape[:-1], *leaf.shape[1:]), flat)

    @jax.jit
    def poses_in_cube(self, key: jax.Array, cube: ArrayLike) -> Configuration:
        """As `poses`, from points of the unit cube."""
        cube = jnp.asarray(cube)
        rest = jax.random.uniform(key, (*cube.shape[:-1], CUBE_DIM))
        return from_cube(self.model, rest.at[..., jnp.array(self.active)].set(cube))

    @property
    def _seen(self) -> jax.Array:
        return self.observation.has_factor

    @property
    def _whole_shape(self) -> tuple[jax.Array, jax.Array]:
        lengths, ones = self.model.lengths, jnp.ones(CUBE_DIM - NUM_LENGTHS)
        alpha, beta = (
            jnp.concatenate([jnp.asarray(part), ones]) for part in (lengths.alpha, lengths.beta)
        )
        return alpha, beta

    @property
    def _shape(self) -> tuple[jax.Array, jax.Array]:
        """Beta parameters `(d,)`, `(d,)` of the active fractions."""
        alpha, beta = self._whole_shape
        return alpha[jnp.array(self.active)], beta[jnp.array(self.active)]

    def _complete(self, fractions: jax.Array) -> jax.Array:
        """All 23 fractions; what is not active lies in the middle, where it makes no difference."""
        whole = jnp.full((*fractions.shape[:-1], CUBE_DIM), 0.5)
        return whole.at[..., jnp.array(self.active)].set(fractions)

    def _configuration(self, points: jax.Array) -> Configuration:
        return _from_fractions(self.model, self._complete(jax.nn.sigmoid(points)))

    def _squares(self, poses: Configuration) -> jax.Array:
        """`(..., 15)`: d²/τ² of the joints, 0 where one has no factor."""
        joints = self.model.joints(self.observation.view, *poses)
        return jnp.vectorize(self._squares_of_one, signature="(j,x)->(j)")(joints)

    def _squares_of_one(self, joints: jax.Array) -> jax.Array:
        seen = self._seen
        offset = self.observation.camera.image(joints)
        offset = offset - jnp.where(seen[:, None], jnp.asarray(self.observation.keypoints), 0.0)
        square = (
            jnp.sum(offset**2, axis=-1)
            / jnp.where(seen, jnp.asarray(self.observation.radius), 1.0) ** 2
        )
        return jnp.where(seen, square, 0.0)

    def _misfit(self, poses: Configuration) -> jax.Array:
        return jnp.sqrt(jnp.max(self._squares(poses), axis=-1))


def read_poses(model: PoseModel, joints: ArrayLike, length: ArrayLike) -> Configuration:
    """Lengths and local directions of poses given as joints `(n, 15, 3)` (any axes) and lengths
    `(n, 5)`."""
    reference, fallback = jnp.asarray(model.limits.reference), jnp.asarray(model.limits.fallback)
    parts = articulation(joints, reference, fallback)
    return Configuration(jnp.asarray(length), parts.upper, parts.lower)


def _active(seen: np.ndarray) -> tuple[int, ...]:
    """Coordinates that the seen joints `(15,)` depend on."""
    found: set[int] = set()
    for limb in (limb for limbs in GROUPS.values() for limb in limbs):
        last = max((number for number, bone in enumerate(limb.bones) if seen[bone.end]), default=-1)
        for number, bone in enumerate(limb.bones[: last + 1]):
            lower = limb.lower if number else None
            first = NUM_LENGTHS + 2 * (limb.upper if lower is None else NUM_UPPER + lower)
            found |= {bone.length_group, first, first + 1}
    return tuple(sorted(found))


def _from_fractions(model: PoseModel, fractions: jax.Array) -> Configuration:
    low, high = jnp.asarray(model.lengths.low), jnp.asarray(model.lengths.high)
    parts = jnp.split(fractions, [NUM_LENGTHS, NUM_LENGTHS + 2 * NUM_UPPER], axis=-1)
    batch = fractions.shape[:-1]
    upper = OccupiedDirection(model.cells).transport(parts[1].reshape(*batch, NUM_UPPER, 2))
    lower = HingedDirection(model.hinges_at(upper)).transport(
        parts[2].reshape(*batch, NUM_LOWER, 2)
    )
    length = jnp.vectorize(lambda fraction: low + (high - low) * fraction, signature="(g)->(g)")(
        parts[0]
    )
    return Configuration(length, upper, lower)


def _logit(fraction: jax.Array) -> jax.Array:
    eps = jnp.finfo(fraction.dtype).eps
    inside = jnp.clip(fraction, eps, 1 - eps)
    return jnp.log(inside) - jnp.log1p(-inside)


@jax.jit
def _points(target: Target, poses: Configuration) -> jax.Array:
    model = target.model
    low, high = jnp.asarray(model.lengths.low), jnp.asarray(model.lengths.high)
    length = jnp.vectorize(lambda length: (length - low) / (high - low), signature="(g)->(g)")(
        poses.length
    )
    upper = OccupiedDirection(model.cells).inverse(poses.upper)
    lower = HingedDirection(model.hinges_at(poses.upper)).inverse(poses.lower)
    batch = poses.length.shape[:-1]
    fractions = [length, upper.reshape(*batch, -1), lower.reshape(*batch, -1)]
    return _logit(jnp.concatenate(fractions, axis=-1)[..., jnp.array(target.active)])


@jax.jit
def _poses(target: Target, points: jax.Array, rest: jax.Array) -> Configuration:
    whole = rest.at[..., jnp.array(target.active)].set(jax.nn.sigmoid(points))
    return _from_fractions(target.model, whole)
