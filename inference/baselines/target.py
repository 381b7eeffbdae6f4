"""The posterior of one candidate as a target for samplers that do not know what a pose is: a
density on R^d or a cube. `rooted.RootedTarget` is that of torso, camera and pose together; what
samplers of R^d ask of either is `Density`.

Only coordinates that some seen joint depends on are `active`; the others follow the prior whatever
the rest does, are drawn from it exactly (`poses`), and no sampler has to walk along them. Every
active coordinate is a fraction: of a bone length's range, Beta distributed, or one of the two of a
direction in its unit square, uniform. Three charts:

- points `(..., d)` of R^d, the logits of the fractions: the unconstrained space of
  `PoseModel.posterior` in NumPyro;
- points of the unit cube, where the prior is flat (lengths by their quantiles):
  `probmodel.transport` restricted to `active`;
- poses, as lengths and directions: a `Pose`.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Protocol, Self

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import GROUPS, LENGTH_GROUPS, NUM_LENGTHS, NUM_LOWER, NUM_UPPER
from poseterior.probmodel.transport import (
    CUBE_DIM,
    from_cube,
    from_fractions,
    log_density_of_logits,
    to_fractions,
)

COORDINATES = (
    *(f"length of {group}" for group in LENGTH_GROUPS),
    *(f"upper {bone} {axis}" for bone in range(NUM_UPPER) for axis in "uv"),
    *(f"lower {bone} {axis}" for bone in range(NUM_LOWER) for axis in "uv"),
)
"""Names of the 23 coordinates, in the order of `probmodel.transport`."""


class Density(Protocol):
    """What samplers of R^d, and `run`, ask of a target."""

    @property
    def dim(self) -> int:
        """How many coordinates there are."""

    def log_density(self, points: ArrayLike) -> jax.Array:
        """`(...)`: log posterior density at points `(..., d)` of R^d, per unit of R^d, but for a
        constant."""

    def misfit(self, points: ArrayLike) -> jax.Array:
        """`(...)`: the largest distance of a seen joint from its detection, in reaches."""

    def poses(self, key: jax.Array, points: ArrayLike) -> Pose:
        """Poses at points of R^d; what no seen joint depends on is drawn from the prior."""

    def roots(self, points: ArrayLike) -> Any:
        """The roots at points `(n, d)` of R^d, as the posterior's prior of the root has them."""

    def faults(self, key: jax.Array, points: ArrayLike) -> Faults:
        """Which detections are faults at points `(n, d)` of R^d."""

    def points_at(self, roots: Any, poses: Pose) -> np.ndarray:
        """Points `(n, d)` of R^d of roots and poses."""

    def points_in(self, draws: xr.Dataset) -> np.ndarray:
        """Points `(n, d)` of R^d of the draws of a result with one chain."""


def everywhere(signature: str = "(d)->()") -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Makes of a method that says something of one point `(d,)` one of points `(..., d)`, with
    what comes after it the same for all of them."""

    def of_points(one: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(one)
        def method(target: Any, points: ArrayLike, *given: Any) -> Any:
            each = jnp.vectorize(lambda point: one(target, point, *given), signature=signature)
            return each(jnp.asarray(points))

        return method

    return of_points


class Slopes(Density, Protocol):
    """What samplers that follow slopes ask of a target besides."""

    def log_smooth(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """`(...)`: as `log_density` at points `(..., d)` of R^d, with a soft wall
        Π σ(sharpness · (1 - d²/reach²)) where joints end to be explained."""

    def log_walls(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """`(...)`: the log of the walls alone, at most 0."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class LimbChart:
    """R^k → poses: the logits of the fractions that a seen joint depends on.

    Attributes
    ----------
    model
        The prior of poses.
    active
        Which coordinates of the unit cube these are.
    """

    model: PoseModel
    active: tuple[int, ...] = dataclasses.field(metadata={"static": True})

    @property
    def dim(self) -> int:
        """How many coordinates are active."""
        return len(self.active)

    def log_base(self, points: jax.Array) -> jax.Array:
        """`(...)`: normalised log density of the prior at points of R^d: logits of Beta
        variables."""
        return log_density_of_logits(*self.shape, points)

    def pose(self, points: jax.Array) -> Pose:
        """Poses at points of R^d, with what is not active in the middle of its range."""
        return from_fractions(self.model, self._complete(jax.nn.sigmoid(points)))

    def points_of(self, poses: Pose) -> np.ndarray:
        """Points `(n, d)` of R^d of poses inside the prior's support."""
        return np.asarray(_points(self, Pose(*(jnp.asarray(part) for part in poses))))

    def poses(self, key: jax.Array, points: ArrayLike) -> Pose:
        """Poses at points of R^d; what no seen joint depends on is drawn from the prior.

        Parameters
        ----------
        key
            Of those draws.
        points : `(..., d)`
            Points of R^d.

        Returns
        -------
        Pose
            Leaves start with `...`.
        """
        points = np.asarray(points)
        # NumPy's Beta variables: those of JAX take longer to compile than all the rest.
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        alpha, beta = (np.asarray(part) for part in self._whole_shape)
        rest = rng.beta(alpha, beta, (*points.shape[:-1], CUBE_DIM)).reshape(-1, CUBE_DIM)
        flat = in_chunks(functools.partial(_poses, self), points.reshape(-1, self.dim), rest)
        return jax.tree.map(lambda leaf: leaf.reshape(*points.shape[:-1], *leaf.shape[1:]), flat)

    @property
    def _whole_shape(self) -> tuple[jax.Array, jax.Array]:
        lengths, ones = self.model.lengths, jnp.ones(CUBE_DIM - NUM_LENGTHS)
        alpha, beta = (
            jnp.concatenate([jnp.asarray(part), ones]) for part in (lengths.alpha, lengths.beta)
        )
        return alpha, beta

    @property
    def shape(self) -> tuple[jax.Array, jax.Array]:
        """Beta parameters alpha, beta `(d,)` of the active fractions: those of lengths, and 1 of
        all else, which is uniform."""
        alpha, beta = self._whole_shape
        return alpha[jnp.array(self.active)], beta[jnp.array(self.active)]

    def _complete(self, fractions: jax.Array) -> jax.Array:
        """All 23 fractions; what is not active lies in the middle, where it makes no difference."""
        whole = jnp.full((*fractions.shape[:-1], CUBE_DIM), 0.5)
        return whole.at[..., jnp.array(self.active)].set(fractions)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Target(LimbChart):
    """The posterior of the limbs, given one candidate: prior × likelihood over its peak; under
    discs, the indicator that every seen joint is inside its own. The usual way in is `of`.

    Attributes
    ----------
    model, active
        As in `LimbChart`.
    observation
        The detection under the candidate.
    """

    observation: Observation

    @classmethod
    def of(cls, posterior: Posterior) -> Self:
        """The target of a posterior with one root.

        Parameters
        ----------
        posterior
            Of an estimate with one candidate.

        Returns
        -------
        Target
            Its coordinates are those that a seen joint depends on.

        Raises
        ------
        BadInput
            Where there are more roots, or nothing is seen.
        """
        where = posterior.detection.where
        if len(posterior.candidates) != 1:
            raise BadInput(
                f"{where} has {len(posterior.candidates)} torso-and-camera candidates, but this"
                " sampler draws under one; estimate with num_candidates=1 (on the command line"
                " --candidates 1)"
            )
        observation = posterior.observations[0]
        active = active_coordinates(np.asarray(observation.seen))
        if not active:
            raise BadInput(
                f"{where} has no seen limb joint: its posterior is the prior; use rejection"
            )
        return cls(posterior.model, active, observation)

    @jax.jit
    def log_density(self, points: ArrayLike) -> jax.Array:
        """`(...)`: log posterior density at points `(..., d)` of R^d, per unit of R^d, but for the
        evidence."""
        points = jnp.asarray(points)
        return self.log_base(points) + self.log_likelihood(points)

    @jax.jit
    def log_likelihood(self, points: ArrayLike) -> jax.Array:
        """`(...)`: log of the likelihood over its peak at points `(..., d)` of R^d."""
        return jnp.sum(self.observation.log_ratios(self.joints(points)), axis=-1)

    def joints(self, points: ArrayLike) -> jax.Array:
        """`(..., 15, 3)`: joints at points of R^d, camera axes, body units; what no seen joint
        depends on lies anywhere."""
        return self._joints(self.pose(jnp.asarray(points)))

    @jax.jit
    def log_smooth(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """As of `Slopes`."""
        points = jnp.asarray(points)
        smooth = self.observation.log_smooth(self.joints(points), sharpness)
        return self.log_base(points) + smooth

    @jax.jit
    def log_walls(self, points: ArrayLike, sharpness: ArrayLike) -> jax.Array:
        """As of `Slopes`."""
        return self.observation.log_walls(self.joints(points), sharpness)

    @jax.jit
    def log_graded(self, points: ArrayLike, hardness: ArrayLike) -> jax.Array:
        """`(...)`: log of a likelihood with slopes for walls at points of R^d: within reach the
        likelihood over its peak, beyond falling from there by `hardness` · (d²/reach² - 1) for
        every joint; a normalised prior is not in it."""
        return jnp.sum(self.observation.log_graded(self.joints(points), hardness), axis=-1)

    @jax.jit
    def misfit(self, points: ArrayLike) -> jax.Array:
        """`(...)`: the largest distance of a seen joint from its detection, in reaches, at points
        of R^d; a pose explains the detection iff it is at most 1."""
        return self.observation.misfit(self.joints(points))

    @jax.jit
    def misfit_in_cube(self, cube: ArrayLike) -> jax.Array:
        """`(...)`: as `misfit`, at points `(..., d)` of the unit cube; infinite outside of it."""
        cube = jnp.asarray(cube)
        inside = jnp.all((cube >= 0) & (cube <= 1), axis=-1)
        poses = from_cube(self.model, self._complete(jnp.clip(cube, 0, 1)))
        return jnp.where(inside, self.observation.misfit(self._joints(poses)), jnp.inf)

    def prior_points(self, key: jax.Array, number: int) -> jax.Array:
        """Points of R^d from the prior.

        Parameters
        ----------
        key
            Of the draws.
        number
            How many.

        Returns
        -------
        Array
            `(number, d)`.
        """
        fraction = jax.random.beta(key, *self.shape, (number, self.dim))
        return _logit(fraction)

    def roots(self, points: ArrayLike) -> np.ndarray:
        """As of a `Density`: the only candidate."""
        return np.zeros(len(np.asarray(points)), int)

    def faults(self, key: jax.Array, points: ArrayLike) -> Faults:
        """As of a `Density`: none.

        Parameters
        ----------
        key
            Of draws that there are not.
        points : `(n, d)`
            Points of R^d.

        Returns
        -------
        Faults
            Leaves start with n.
        """
        return Faults.none(len(np.asarray(points)))

    def points_at(self, roots: Any, poses: Pose) -> np.ndarray:
        """As of a `Density`.

        Parameters
        ----------
        roots
            The only candidate, over and over.
        poses
            Inside the prior's support, leaves start with n.

        Returns
        -------
        ndarray
            `(n, d)`.
        """
        return self.points_of(poses)

    def points_in(self, draws: xr.Dataset) -> np.ndarray:
        """As of a `Density`."""
        joints, length = draws.joints.values[0], draws.bone_length.values[0]
        return self.points_of(self.model.pose_of(joints, length))

    @jax.jit
    def poses_in_cube(self, key: jax.Array, cube: ArrayLike) -> Pose:
        """As `poses`, from points of the unit cube."""
        cube = jnp.asarray(cube)
        rest = jax.random.uniform(key, (*cube.shape[:-1], CUBE_DIM))
        return from_cube(self.model, rest.at[..., jnp.array(self.active)].set(cube))

    def _joints(self, poses: Pose) -> jax.Array:
        return self.model.joints(self.observation.view, *poses)


def active_coordinates(seen: np.ndarray) -> tuple[int, ...]:
    """Coordinates that the seen joints `(15,)` depend on."""
    found: set[int] = set()
    for limb in (limb for limbs in GROUPS.values() for limb in limbs):
        last = max((number for number, bone in enumerate(limb.bones) if seen[bone.end]), default=-1)
        for number, bone in enumerate(limb.bones[: last + 1]):
            lower = limb.lower if number else None
            first = NUM_LENGTHS + 2 * (limb.upper if lower is None else NUM_UPPER + lower)
            found |= {bone.length_group, first, first + 1}
    return tuple(sorted(found))


def _logit(fraction: jax.Array) -> jax.Array:
    eps = jnp.finfo(fraction.dtype).eps
    inside = jnp.clip(fraction, eps, 1 - eps)
    return jnp.log(inside) - jnp.log1p(-inside)


@jax.jit
def _points(target: LimbChart, poses: Pose) -> jax.Array:
    return _logit(to_fractions(target.model, poses)[..., jnp.array(target.active)])


@jax.jit
def _poses(target: LimbChart, points: jax.Array, rest: jax.Array) -> Pose:
    whole = rest.at[..., jnp.array(target.active)].set(jax.nn.sigmoid(points))
    return from_fractions(target.model, whole)
