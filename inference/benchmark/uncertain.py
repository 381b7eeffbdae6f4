"""A frozen target with an uncertain root in JAX: the product's own posterior in the coordinates of
the target, with gradients wherever there is one. The torso's coordinate has none: the density jumps
in it, as it does where a direction passes from one cell to the next.

The usual way in is `programs.in_jax`. Of `inference.baselines.target.Target` it has what samplers
of R^d ask for, and not the cube and the starts of the product's own baselines."""

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from poseterior.inference.baselines.target import everywhere
from poseterior.inference.benchmark.root import BoxedRoot
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.rotations import rotation_of
from poseterior.probmodel.transport import CUBE_DIM, from_fractions, log_density_of_logits


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class UncertainTarget:
    """The posterior of pose and root, on R^d.

    Attributes
    ----------
    model
        The prior of poses, with the torsos of the target in their order.
    detected
        What was detected.
    scale, place
        The box of `BoxedRoot`.
    alpha, beta : `(d,)`
        Of the prior on the box, Beta distributions.
    active
        Which fractions of a pose are coordinates.
    """

    model: PoseModel
    detected: DetectedJoints
    scale: jax.Array
    place: jax.Array
    alpha: jax.Array
    beta: jax.Array
    active: tuple[int, ...] = dataclasses.field(metadata={"static": True})

    @classmethod
    def of(cls, target: FrozenTarget, root: BoxedRoot, posterior: Posterior) -> "UncertainTarget":
        """The target in JAX.

        Parameters
        ----------
        target
            Whose coordinates these are.
        root
            Its own.
        posterior
            What the product has for it.
        """
        box = jnp.asarray(root.scale), jnp.asarray(root.place)
        alpha, beta = map(jnp.asarray, target.prior_shape)
        active = tuple(target.active.tolist())
        return cls(posterior.model, posterior.detected, *box, alpha, beta, active)

    @property
    def dim(self) -> int:
        """How many coordinates there are."""
        return len(self.alpha)

    @jax.jit
    def log_density(self, points: ArrayLike) -> jax.Array:
        """`(...)`: log density at points `(..., d)` of R^d, per unit of R^d, but for the
        evidence."""
        return self.log_base(points) + self.log_likelihood(points)

    @jax.jit
    @everywhere()
    def log_likelihood(self, point: jax.Array) -> jax.Array:
        """`(...)`: log of the likelihood over its peak at points `(..., d)` of R^d."""
        observation, joints = self._observed(point)
        return self._log_growth(observation) + jnp.sum(observation.log_ratios(joints))

    @jax.jit
    @everywhere()
    def log_graded(self, point: jax.Array, hardness: ArrayLike) -> jax.Array:
        """`(...)`: log of a likelihood with slopes for walls, as `FrozenTarget.log_graded`."""
        observation, joints = self._observed(point)
        each = observation.log_graded(joints, hardness)
        return self._log_growth(observation) + jnp.sum(each)

    @jax.jit
    @everywhere()
    def misfit(self, point: jax.Array) -> jax.Array:
        """`(...)`: the largest distance of a seen joint from its detection, in reaches."""
        observation, joints = self._observed(point)
        return observation.misfit(joints)

    @jax.jit
    @everywhere("(d)->(j,x)")
    def joints(self, point: jax.Array) -> jax.Array:
        """`(..., 15, 3)`: joints at points of R^d, camera axes, body units; what no seen joint
        depends on lies anywhere."""
        return self._observed(point)[1]

    @jax.jit
    def log_base(self, points: ArrayLike) -> jax.Array:
        """`(...)`: normalised log density of the prior at points of R^d: logits of Beta
        variables."""
        return log_density_of_logits(self.alpha, self.beta, jnp.asarray(points))

    def parts(self, point: jax.Array) -> tuple[RootPoint, Pose]:
        """The root and the pose at one point `(d,)` of R^d; what no seen joint depends on is in the
        middle of its range."""
        box = jax.nn.sigmoid(point)
        active = jnp.array(self.active)
        fractions = jnp.full(CUBE_DIM, 0.5).at[active].set(box[: len(self.active)])
        return self._root(point[len(self.active) :]), from_fractions(self.model, fractions)

    def _root(self, point: jax.Array) -> RootPoint:
        box = jax.nn.sigmoid(point)
        number = len(self.model.torsos)
        torso = jnp.clip(jnp.floor(box[0] * number), 0, number - 1).astype(int)
        yaw, roll = (jnp.pi * (2 * box[one] - 1) for one in (1, 3))
        # The angle whose sine is 2·box - 1, without the arcsine's infinite slope at its ends.
        tilt = 2 * jnp.arctan(jnp.tanh(point[2] / 4))
        # Somebody who faces the camera is turned by half a turn about its horizontal axis.
        turns = (_about(2, roll), _about(0, tilt + jnp.pi), _about(1, yaw))
        rotation = turns[0] @ turns[1] @ turns[2]
        low, high = jnp.log(self.scale)
        place = self.place[0] + (self.place[1] - self.place[0]) * box[5:]
        return RootPoint(torso, rotation, low + (high - low) * box[4], place)

    def _observed(self, point: jax.Array) -> tuple[Observation, jax.Array]:
        """The detection under the root at one point, and the joints of its pose."""
        root, pose = self.parts(point)
        prior = TorsoCameraPrior(self.model.torsos, self.model.upright)
        observation = self.detected.under(prior, root, Faults.none())
        return observation, self.model.joints(observation.view, *pose)

    def _log_growth(self, observation: Observation) -> jax.Array:
        """Log of the peak under a root, over that under the least scale."""
        growth = jnp.log(observation.root.camera.scale / self.scale[0])
        return -2 * jnp.sum(observation.seen) * growth


def _about(axis: int, angle: jax.Array) -> jax.Array:
    """`(3, 3)`: the rotation by an angle about one of the axes."""
    quaternion = jnp.zeros(4).at[0].set(jnp.cos(angle / 2)).at[axis + 1].set(jnp.sin(angle / 2))
    return rotation_of(quaternion)
