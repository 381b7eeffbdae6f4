"""The posterior of torso, camera and pose together as a target for samplers of R^d (docs/model.md
§ 9, "Baselines").

After the limbs' coordinates, which are those of `target.LimbChart`, come seven of the root, so that
every point of R^d is a root and a pose:

- the torso: the logit of a fraction, the unit interval being cut into equal parts, one for each;
- the rotation: a vector of R³, whose Cayley map turns the middle of the candidates' rotations; it
  leaves out half turns from there, which have no mass;
- log scale;
- the place: how far the pelvis falls from a fixed point of the image, in body units, so that it
  depends on the scale by little.

The priors of the last two are flat and have no mass: there is no cube, and no draw of the prior, to
begin with.
"""

import dataclasses
import functools
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax.typing import ArrayLike

from poseterior.inference.baselines.target import LimbChart, active_coordinates, everywhere
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import ORDERS, FaultPrior, Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint, nearest_rotation
from poseterior.probmodel.rotations import RotationTransform
from poseterior.probmodel.summed import SummedFaults

ROOT_COORDINATES = ("torso", *(f"turn {axis}" for axis in "xyz"), "log scale", "place u", "place v")
"""Names of the seven that follow the limbs'."""
FACING = np.diag([1.0, -1.0, -1.0])
"""The rotation of somebody upright who faces the camera."""
_CAYLEY = RotationTransform()


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class RootedTarget:
    """The posterior of root and pose on R^d. The usual way in is `of`.

    Attributes
    ----------
    limbs
        The coordinates of the pose, with the model.
    prior
        Of the root.
    detected
        What was detected.
    order : `(J,)`
        The torsos by their first principal component: those that stand next to each other are
        alike, so that a small step is a small change.
    turn : `(3, 3)`
        The rotation at the middle of the chart.
    centre : `(2,)`
        The point of the image from which places are measured, pixels.
    faulty
        How often the detector errs; faults are summed out.
    """

    limbs: LimbChart
    prior: TorsoCameraPrior
    detected: DetectedJoints
    order: jax.Array
    turn: jax.Array
    centre: jax.Array
    faulty: FaultPrior

    @classmethod
    def of(cls, posterior: Posterior) -> Self:
        """The target of a posterior with an uncertain root.

        Parameters
        ----------
        posterior
            Its candidates decide where the middle of the chart is, and nothing else.

        Returns
        -------
        RootedTarget
            Its coordinates are those that a seen joint depends on, whatever sides are exchanged.

        Raises
        ------
        BadInput
            Where no limb joint is seen, and where the focal length may be one of several.
        """
        where, detected, faults = posterior.detection.where, posterior.detected, posterior.faults
        counts = np.asarray(detected.counts)
        active = active_coordinates(counts[ORDERS[faults.exchanges]].any(axis=0))
        if not active:
            raise BadInput(
                f"{where} has no seen limb joint: its poses are those of the prior; use"
                " weighted-roots"
            )
        if TorsoCameraPrior.of(posterior.model).lenses > 1:
            raise BadInput(
                "a focal length that is not known has no coordinate in R^d; use weighted-roots or"
                " rejection, or give the focal length in pixels"
            )
        cameras = [np.asarray(one.camera.rotation) for one in posterior.candidates] or [FACING]
        return cls(
            limbs=LimbChart(posterior.model, active),
            prior=TorsoCameraPrior.of(posterior.model),
            detected=detected,
            order=jnp.asarray(_alike(np.asarray(posterior.model.torsos))),
            turn=jnp.asarray(nearest_rotation(np.mean(cameras, axis=0))),
            centre=jnp.asarray(np.asarray(detected.keypoints)[counts].mean(axis=0)),
            faulty=faults,
        )

    @property
    def dim(self) -> int:
        """How many coordinates there are."""
        return self.limbs.dim + len(ROOT_COORDINATES)

    @jax.jit
    @everywhere()
    def log_density(self, point: jax.Array) -> jax.Array:
        """`(...)`: log joint density of root, pose and detection at points `(..., d)` of R^d, per
        unit of R^d; what no seen joint depends on is integrated out, and so are faults."""
        return _known(self._log_prior(point) + self._summed.log_likelihood(*self._placed(point)))

    @jax.jit
    @everywhere()
    def log_smooth(self, point: jax.Array, sharpness: ArrayLike) -> jax.Array:
        """As of `Slopes`, of a detector without faults."""
        observation, joints = self._observed(point)
        smooth = observation.log_unit(joints) + observation.log_smooth(joints, sharpness)
        return _known(self._log_prior(point) + smooth)

    @jax.jit
    @everywhere()
    def log_walls(self, point: jax.Array, sharpness: ArrayLike) -> jax.Array:
        """As of `Slopes`, of a detector without faults."""
        observation, joints = self._observed(point)
        return _known(observation.log_walls(joints, sharpness))

    @jax.jit
    @everywhere()
    def log_volume(self, point: jax.Array) -> jax.Array:
        """`(...)`: log of the base measure of roots (counting × Haar's × log scale × area of the
        image) per unit of R^7, at points `(..., d)` of R^d."""
        return self._log_volume(point)

    @jax.jit
    @everywhere()
    def misfit(self, point: jax.Array) -> jax.Array:
        """`(...)`: the largest distance of a seen joint, the torso's among them, from its
        detection, in reaches, at points of R^d; under the pattern of faults that explains most."""
        return self._summed.misfit(*self._placed(point))

    @jax.jit
    def roots(self, points: ArrayLike) -> RootPoint:
        """The roots at points `(..., d)` of R^d; leaves start with `...`."""
        shapes = "(d)->(),(i,j),(),(k)"
        roots = jnp.vectorize(lambda point: tuple(self._root(point))[:4], signature=shapes)
        return RootPoint(*roots(jnp.asarray(points)[..., self.limbs.dim :]))

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
        return self.limbs.poses(key, np.asarray(points)[..., : self.limbs.dim])

    def faults(self, key: jax.Array, points: ArrayLike) -> Faults:
        """Which detections are faults at points of R^d, drawn given root and pose.

        Parameters
        ----------
        key
            Of those draws.
        points : `(n, d)`
            Points of R^d inside the support.

        Returns
        -------
        Faults
            Leaves start with n.
        """
        points = np.asarray(points)
        if not (self.faulty.any and len(points)):
            return Faults.none(len(points))
        keys = np.asarray(jax.random.key_data(jax.random.split(key, len(points))))
        return Faults(*in_chunks(functools.partial(_faults, self), points, keys))

    def points_at(self, roots: RootPoint, poses: Pose) -> np.ndarray:
        """Points of R^d of roots and poses; each torso in the middle of its part.

        Parameters
        ----------
        roots
            Leaves start with n.
        poses
            Inside the prior's support, leaves start with n.

        Returns
        -------
        ndarray
            `(n, d)`.
        """
        rank = np.argsort(np.asarray(self.order))[np.asarray(roots.torso)]
        part = (rank + 0.5) / len(self.order)
        scale = np.exp(np.asarray(roots.log_scale))[:, None]
        columns = [
            self.limbs.points_of(poses),
            (np.log(part) - np.log1p(-part))[:, None],
            np.asarray(_CAYLEY.inv(jnp.asarray(roots.rotation) @ self.turn.T)),
            np.asarray(roots.log_scale)[:, None],
            (np.asarray(roots.translation) - np.asarray(self.centre)) / scale,
        ]
        return np.concatenate(columns, axis=1)

    def points_in(self, draws: xr.Dataset) -> np.ndarray:
        """As of a `Density`."""
        torso, rotation, scale, place, joints, length = (
            draws[name].values[0]
            for name in ("torso", "rotation", "scale", "translation", "joints", "bone_length")
        )
        poses = self.limbs.model.pose_of(joints, length)
        return self.points_at(RootPoint(torso, rotation, np.log(scale), place), poses)

    def _root(self, own: jax.Array) -> RootPoint:
        """The root at its own coordinates `(7,)`."""
        number = len(self.order)
        part = jnp.clip(jnp.floor(jax.nn.sigmoid(own[0]) * number), 0, number - 1).astype(int)
        place = self.centre + jnp.exp(own[4]) * own[5:]
        return RootPoint(self.order[part], _CAYLEY(own[1:4]) @ self.turn, own[4], place)

    def _log_volume(self, point: jax.Array) -> jax.Array:
        own = point[self.limbs.dim :]
        # A torso counts one, and has a J-th of the unit interval.
        torso = jnp.log(len(self.order)) + jax.nn.log_sigmoid(own[0]) + jax.nn.log_sigmoid(-own[0])
        turn = _CAYLEY.log_abs_det_jacobian(own[1:4], _CAYLEY(own[1:4]))
        return torso + turn + 2 * own[4]

    def _log_prior(self, point: jax.Array) -> jax.Array:
        """Of root and pose, per unit of R^d."""
        root = self._root(point[self.limbs.dim :])
        own = self.limbs.log_base(point[: self.limbs.dim]) + self.prior.log_density(root)
        return own + self._log_volume(point)

    @property
    def _summed(self) -> SummedFaults:
        return SummedFaults(self.detected, self.faulty, self.prior)

    def _placed(self, point: jax.Array) -> tuple[RootPoint, jax.Array]:
        """The root at a point, and the joints of the pose there."""
        root = self._root(point[self.limbs.dim :])
        pose = self.limbs.pose(point[: self.limbs.dim])
        return root, self.limbs.model.joints(self.prior.root(root).view, *pose)

    def _observed(self, point: jax.Array) -> tuple[Observation, jax.Array]:
        """The detection without a fault under the root at a point, and the joints of the pose
        there."""
        if self.faulty.any:
            raise BadInput("a detector with faults has no slopes; leave its faults out")
        root, joints = self._placed(point)
        return self.detected.under(self.prior, root, Faults.none()), joints


def _known(log_density: jax.Array) -> jax.Array:
    """The log of a density also far out, where scales overflow and it is 0."""
    return jnp.where(jnp.isnan(log_density), -jnp.inf, log_density)


@jax.jit
def _faults(target: RootedTarget, points: jax.Array, keys: jax.Array) -> Faults:
    def one(point: jax.Array, key: jax.Array) -> Faults:
        return target._summed.draw(jax.random.wrap_key_data(key), *target._placed(point))

    return jax.vmap(one)(points, keys)


def _alike(torsos: np.ndarray) -> np.ndarray:
    """`(J,)`: torsos `(J, 6, 3)` in the order of their first principal component."""
    flat = torsos.reshape(len(torsos), -1)
    centred = flat - flat.mean(axis=0)
    return np.argsort(centred @ np.linalg.svd(centred, full_matrices=False)[2][0])
