"""The posterior where torso and camera, the *root*, are uncertain too: `docs/model.md`, § 9.

`UncertainPosterior` owns the NumPyro program of root, pose and detection and its log joint density.
Every seen joint that counts carries the same error law, the torso's as well as the limbs', and
their scores are normalised together. `Posterior`, whose roots are atoms, is the paper's method.
"""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro

from probmodel.detections import Detection
from probmodel.likelihood import Likelihood
from probmodel.model import PoseModel, log_joint
from probmodel.observation import Observation
from probmodel.pose import Pose
from probmodel.roots import Candidate, RootPoint, RootPrior
from probmodel.skeleton import TORSO_INDEX

if TYPE_CHECKING:
    from probmodel.likelihood import ErrorLaw


class DetectedJoints(NamedTuple):
    """A detection before any root: what `Observation` is made of once there is one; a pytree.

    Attributes
    ----------
    keypoints : `(15, 2)` pixels, 0 where a joint does not count.
    spread : `(15,)` of each joint's error in body units, the same under every root; infinite where
        a joint does not count.
    law : the errors' law.
    """

    keypoints: np.ndarray | jax.Array
    spread: np.ndarray | jax.Array
    law: "ErrorLaw"

    def under(self, prior: RootPrior, point: RootPoint) -> Observation:
        """The detection under one root; a formula of JAX."""
        root = prior.root(point)
        target = root.camera.to_plane(self.keypoints)
        counts = jnp.isfinite(jnp.asarray(self.spread))[:, None]
        return Observation(root, jnp.where(counts, target, 0.0), self.spread, self.law)


@dataclass(frozen=True, eq=False)
class UncertainPosterior:
    """The posterior of one detection over poses and roots together.

    Attributes
    ----------
    model : the prior of poses, and the dictionary of torsos.
    likelihood : how detections err; its `joints` count, and the torso's beside them.
    detection : what was detected.
    candidates : an estimator's roots; the posterior does not depend on them, they name the ways the
        person may face.
    estimator : where the candidates come from.
    """

    model: PoseModel
    likelihood: Likelihood
    detection: Detection
    candidates: tuple[Candidate, ...] = ()
    estimator: str = ""

    @property
    def prior(self) -> RootPrior:
        """The prior of the root."""
        return RootPrior(self.model.torsos)

    @functools.cached_property
    def detected(self) -> DetectedJoints:
        """The joints that count, with one normalisation of the scores over all of them."""
        joints = sorted({*TORSO_INDEX, *self.likelihood.joints})
        spread = self.likelihood.spread(self.detection, 1.0, joints)
        keypoints = np.where(np.isfinite(spread)[:, None], self.detection.keypoints, 0.0)
        return DetectedJoints(keypoints, spread, self.likelihood.law)

    @property
    def log_peak(self) -> float:
        """Log likelihood of a pose that projects onto every target under a root of scale 1; under
        one of scale s it is lower by 2 log s for every joint that counts."""
        spread = self.detected.spread[np.isfinite(self.detected.spread)]
        return float(np.sum(self.likelihood.law.log_peak - 2 * np.log(spread)))

    def observe(self, point: RootPoint) -> Observation:
        """The detection under one root."""
        return self.detected.under(self.prior, jax.tree.map(jnp.asarray, point))

    def program(self) -> jax.Array:
        """NumPyro model of all: sites torso, rotation, log_scale, translation, then those of
        `PoseModel.posterior`. Returns the joints `(15, 3)` in camera axes, body units of the root
        drawn."""
        return self.model.posterior(self.observe(self.prior.compose(numpyro.sample)))

    def log_joint(self, points: RootPoint, poses: Pose) -> jax.Array:
        """`(n,)`: log joint density of roots and poses `(n, ...)` with the detection, that of the
        program; -inf outside. With respect to counting (torso) × Haar's × log scale × area (pixels)
        and the base measures of poses and detections."""
        return log_joints(self.model, self.detected, points, poses)


@jax.jit
def log_joints(
    model: PoseModel, detected: DetectedJoints, points: RootPoint, poses: Pose
) -> jax.Array:
    """`UncertainPosterior.log_joint`, compiled once a shape."""
    prior = RootPrior(model.torsos)

    def one(point: RootPoint, pose: Pose) -> jax.Array:
        return prior.log_density(point) + log_joint(model, detected.under(prior, point), *pose)

    return jax.vmap(one)(jax.tree.map(jnp.asarray, points), jax.tree.map(jnp.asarray, poses))
