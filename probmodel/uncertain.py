"""The posterior where torso and camera, the *root*, are uncertain too: docs/model.md § 9.

`UncertainPosterior` owns the NumPyro program of root, pose and detection and its log joint density.
Every seen joint that counts carries the same error law, the torso's as well as the limbs', and
their scores are normalised together. A detector's faults (`faults`), where the likelihood has
some, are discrete sites of the program. `Posterior`, whose roots are atoms, is the paper's method.
"""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import ORDERS, FaultPrior, Faults
from poseterior.probmodel.errors.laws import WithOutliers
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.model import PoseModel, log_joint
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.programs import kept
from poseterior.probmodel.roots import Candidate, RootPoint, RootPrior
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX

if TYPE_CHECKING:
    from poseterior.probmodel.errors.laws import ErrorLaw


class DetectedJoints(NamedTuple):
    """A detection before any root: what `Observation` is made of once there is one; a pytree.

    Attributes
    ----------
    keypoints
        `(15, 2)` pixels, 0 where a joint does not count.
    spread
        `(15,)` of each joint's error in body units, the same under every root; infinite where
        a joint does not count.
    bias
        `(15, 2)` of each keypoint, body units.
    far
        How far from its joint an outlier may lie, body units.
    law
        The errors' law.
    """

    keypoints: np.ndarray | jax.Array
    spread: np.ndarray | jax.Array
    bias: np.ndarray | jax.Array
    far: float | jax.Array
    law: "ErrorLaw"

    @property
    def counts(self) -> jax.Array:
        """`(15,)` bool: the keypoints that count."""
        return jnp.isfinite(jnp.asarray(self.spread))

    def read(self, faults: Faults) -> "DetectedJoints":
        """The detection as a pattern of faults has it: what is exchanged put back, outliers with
        their own spread and law; a formula of JAX."""
        order = jnp.asarray(ORDERS)[faults.exchange]
        spread = jnp.asarray(self.spread)[order]
        outlier = jnp.asarray(faults.outlier)[order] & jnp.isfinite(spread)
        return DetectedJoints(
            jnp.asarray(self.keypoints)[order],
            jnp.where(outlier, self.far, spread),
            jnp.where(outlier[:, None], 0.0, jnp.asarray(self.bias)[order]),
            self.far,
            WithOutliers(self.law, outlier),
        )

    def rays(self, lens: Lens | None) -> np.ndarray | jax.Array:
        """`(15, 2)`: of each joint's line of sight, how far it runs to the side for one in depth; 0
        without a lens, and where a joint does not count."""
        if lens is None:
            return np.zeros((NUM_JOINTS, 2))
        slope = (jnp.asarray(self.keypoints) - jnp.asarray(lens.principal)[None]) / lens.focal
        return jnp.where(self.counts[:, None], slope, 0.0)

    def under(self, prior: RootPrior, point: RootPoint, faults: Faults) -> Observation:
        """The detection under one root and a pattern of faults; a formula of JAX."""
        root, read = prior.root(point), self.read(faults)
        target = root.camera.to_plane(read.keypoints) - read.bias
        return Observation(
            root, jnp.where(read.counts[:, None], target, 0.0), read.spread, read.law, read.bias
        )

    def log_peak(self) -> jax.Array:
        """`()`: log likelihood of a pose that projects onto every target under a root of scale 1;
        under one of scale s it is lower by 2 log s for every joint that counts."""
        spread = jnp.where(self.counts, jnp.asarray(self.spread), 1.0)
        return jnp.sum(jnp.where(self.counts, self.law.log_peak - 2 * jnp.log(spread), 0.0))


@dataclass(frozen=True, eq=False)
class UncertainPosterior:
    """The posterior of one detection over poses and roots together.

    Attributes
    ----------
    model
        The prior of poses, and the dictionary of torsos.
    likelihood
        How detections err; its `joints` count, and the torso's beside them.
    detection
        What was detected.
    candidates
        An estimator's roots; the posterior does not depend on them, they name the ways the person
        may face.
    estimator
        Where the candidates come from.
    """

    model: PoseModel
    likelihood: Likelihood
    detection: Detection
    candidates: tuple[Candidate, ...] = ()
    estimator: str = ""

    @property
    def prior(self) -> RootPrior:
        """The prior of the root."""
        return RootPrior.of(self.model)

    @functools.cached_property
    def detected(self) -> DetectedJoints:
        """The joints that count, with one normalisation of the scores over all of them."""
        joints = sorted({*TORSO_INDEX, *self.likelihood.joints})
        spread = self.likelihood.spread(self.detection, 1.0, joints)
        keypoints = np.where(np.isfinite(spread)[:, None], self.detection.keypoints, 0.0)
        return DetectedJoints(
            keypoints, spread, self.likelihood.bias, self.faults.reach, self.likelihood.law
        )

    @property
    def faults(self) -> FaultPrior:
        """The prior of the detector's faults."""
        return self.likelihood.faults

    @property
    def log_peak(self) -> float:
        """`DetectedJoints.log_peak` without any fault."""
        return float(self.detected.log_peak())

    def program(self) -> jax.Array:
        """NumPyro model of all: sites torso, rotation, log_scale, translation; exchange,
        torso_outlier and limb_outlier where there may be faults; then those of
        `PoseModel.posterior`. Returns the joints `(15, 3)` in camera axes, body units of the root
        drawn."""
        import numpyro  # takes as long as JAX to import, and only programs need it

        point = self.prior.compose(numpyro.sample)
        faults = Faults.none()
        if self.faults.any:
            faults = self.faults.compose(self.detected.counts, numpyro.sample)
        return self.model.posterior(self.detected.under(self.prior, point, faults))

    def log_joint(self, points: RootPoint, poses: Pose, faults: Faults | None = None) -> jax.Array:
        """Log joint density of roots, poses and patterns of faults with the detection, that of the
        program. With respect to counting (torso, faults) × Haar's × log scale × area (pixels) and
        the base measures of poses and detections.

        Parameters
        ----------
        points
            Roots, leaves start with n.
        poses
            Poses, leaves start with n.
        faults
            Which detections are faults, leaves start with n; by default none.

        Returns
        -------
        Array
            `(n,)`; −inf outside.
        """
        if faults is None:
            faults = Faults.none(len(np.asarray(points.torso)))
        return log_joints(self.model, self.detected, self.faults, points, poses, faults)


@kept
def log_joints(
    model: PoseModel,
    detected: DetectedJoints,
    faulty: FaultPrior,
    points: RootPoint,
    poses: Pose,
    faults: Faults,
) -> jax.Array:
    """`UncertainPosterior.log_joint`, compiled once a shape."""
    prior = RootPrior.of(model)

    def one(point: RootPoint, pose: Pose, faults: Faults) -> jax.Array:
        log_prior = prior.log_density(point) + faulty.log_prob(detected.counts, faults)
        return log_prior + log_joint(model, detected.under(prior, point, faults), *pose)

    return jax.vmap(one)(*jax.tree.map(jnp.asarray, (points, poses, faults)))
