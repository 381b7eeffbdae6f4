"""The posterior as one value: what is believed of poses, of torso and camera, and of detectors'
errors, and what was detected.

`Posterior(model, likelihood, detection, root_prior)` owns the program and its log joint density;
samplers, streams, studies and pictures ask it. Torso and camera, the *root*, have a prior of their
own: `Candidates`, the paper's method, or a `TorsoCameraPrior`. `Estimate` is the same before either
is chosen, which is what an estimator makes of a detection. See docs/model.md § 7 and § 9.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import FaultPrior, Faults
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel, log_joint
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import (
    ROOT_PRIORS,
    UNCERTAIN,
    Candidates,
    RootPrior,
    TorsoCameraPrior,
)
from poseterior.probmodel.roots import Candidate


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of one detection over roots, poses and a detector's faults together.

    Attributes
    ----------
    model
        The prior of poses.
    likelihood
        How detections err.
    detection
        What was detected.
    root_prior
        What is believed of torso and camera.
    candidates
        An estimator's roots. Under a `TorsoCameraPrior` the posterior does not depend on them: they
        name the ways the person may face.
    estimator
        Where the candidates come from.
    """

    model: PoseModel
    likelihood: Likelihood
    detection: Detection
    root_prior: RootPrior
    candidates: tuple[Candidate, ...] = ()
    estimator: str = ""

    @functools.cached_property
    def detected(self) -> DetectedJoints:
        """The joints that count, with one normalisation of the scores over all of them."""
        joints = self.root_prior.counted(self.likelihood.joints)
        return self.likelihood.detected(self.detection, joints, self.root_prior.people)

    @property
    def faults(self) -> FaultPrior:
        """The prior of the detector's faults."""
        return self.likelihood.faults

    @functools.cached_property
    def observations(self) -> tuple[Observation, ...]:
        """The detection under each candidate."""
        return tuple(self.detected.at(one.root) for one in self.candidates)

    @functools.cached_property
    def log_weights(self) -> np.ndarray:
        """`(candidates,)`: what weighs each of `Candidates` beside its log evidence, which is the
        prior's mean of the likelihood over its peak (for discs, of the indicator). Normalised."""
        assert isinstance(self.root_prior, Candidates)
        if len(self.candidates) == 1:
            return np.zeros(1)
        peaks = np.array([float(_log_peak(observation)) for observation in self.observations])
        log_weight = self.root_prior.log_weight + peaks
        return log_weight - np.logaddexp.reduce(log_weight)

    @property
    def log_peak(self) -> float:
        """`DetectedJoints.log_peak` without any fault."""
        return float(self.detected.log_peak())

    @property
    def converged(self) -> bool:
        """Whether the estimator came to an end for every candidate."""
        return all(candidate.converged for candidate in self.candidates)

    def program(self) -> jax.Array:
        """NumPyro model of all: the sites of the root's prior (`root`, the candidate's number; or
        torso, rotation, log_scale, translation); exchange, torso_outlier and limb_outlier where
        there may be faults; then those of `PoseModel.posterior`. Returns the joints `(15, 3)` in
        camera axes, body units of the root drawn."""
        import numpyro  # takes as long as JAX to import, and only programs need it

        point = self.root_prior.compose(numpyro.sample)
        faults = None
        if self.faults.any:
            faults = self.faults.compose(self.detected.counts, numpyro.sample)
        return self.model.posterior(self.detected.under(self.root_prior, point, faults))

    def log_joint(self, points: Any, poses: Pose, faults: Faults | None = None) -> jax.Array:
        """Log joint density of roots, poses and patterns of faults with the detection, that of the
        program. With respect to the root prior's base measure × counting (faults) and the base
        measures of poses and detections.

        Parameters
        ----------
        points
            Roots, as the root's prior has them, leaves start with n.
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
            faults = self.faults.none(len(poses.length))
        return log_joints(
            self.model, self.detected, self.root_prior, self.faults, points, poses, faults
        )


@kept
def log_joints(
    model: PoseModel,
    detected: DetectedJoints,
    prior: RootPrior,
    faulty: FaultPrior,
    points: Any,
    poses: Pose,
    faults: Faults,
) -> jax.Array:
    """`Posterior.log_joint`, compiled once a shape."""

    def one(point: Any, pose: Pose, faults: Faults) -> jax.Array:
        log_prior = prior.log_density(point) + faulty.log_prob(detected.counts, faults)
        return log_prior + log_joint(model, detected.under(prior, point, faults), *pose)

    return jax.vmap(one)(*jax.tree.map(jnp.asarray, (points, poses, faults)))


@kept
def _log_peak(observation: Observation) -> jax.Array:
    """Compiled as one, since every operation by itself takes longer to compile than to be done."""
    return observation.log_peak


@dataclass(frozen=True)
class Estimate:
    """A detection with the roots that are left open, best reprojection first: everything of its
    posterior but the model and the prior of the root.

    Attributes
    ----------
    detection
        What was detected.
    candidates
        The roots.
    likelihood
        How detections err.
    estimator
        Where the candidates come from.
    lens
        Of the camera that saw this person, if it is known, whatever the model's cameras are.
    """

    detection: Detection
    candidates: tuple[Candidate, ...]
    likelihood: Likelihood = PAPER
    estimator: str = ""
    lens: Lens | None = None

    def posterior(self, model: PoseModel, root: str = UNCERTAIN) -> Posterior:
        """The posterior under a model of poses.

        Parameters
        ----------
        model
            The prior of poses.
        root
            One of `ROOT_PRIORS`: "uncertain", torso and camera as `TorsoCameraPrior` has them; or
            "candidates", the paper's method, a mixture over those of the estimator.

        Returns
        -------
        Posterior
            Of poses, roots and faults.

        Raises
        ------
        BadInput
            On another name; and under candidates where the likelihood has outliers or exchanged
            sides, or the model a belief of how the body is turned or a focal length, which they
            leave no room for; where there is no candidate.
        """
        require_root_prior(root)
        if root == UNCERTAIN:
            seen = model if self.lens is None else model.seen_by(self.lens)
            prior: RootPrior = TorsoCameraPrior.of(seen)
        else:
            self._require_plain(model)
            self._require_root()
            seen, prior = model, Candidates.of(self.candidates, self._log_torso)
        given = seen, self.likelihood, self.detection, prior
        return Posterior(*given, candidates=self.candidates, estimator=self.estimator)

    @property
    def _log_torso(self) -> np.ndarray:
        """`(candidates,)`: log likelihood of the torso's detected joints under each candidate.
        Where none has all of them within reach, they say nothing and are left out."""
        if len(self.candidates) == 1:
            return np.zeros(1)
        torso = [self.likelihood.log_torso(self.detection, one.root) for one in self.candidates]
        return np.array(torso) if np.isfinite(torso).any() else np.zeros(len(torso))

    def _require_plain(self, model: PoseModel) -> None:
        """Raises `BadInput` on what candidates leave no room for."""
        if model.upright:
            raise BadInput(
                "a belief that people are upright needs torso and camera to be uncertain; choose"
                " the root 'uncertain', or leave it out"
            )
        if (self.lens or model.lens) is not None:
            raise BadInput(
                "a known focal length needs torso and camera to be uncertain; choose the root"
                " 'uncertain', or leave it out"
            )
        if self.likelihood.faults.any:
            raise BadInput(
                "outliers and exchanges need torso and camera to be uncertain; choose the root"
                " 'uncertain' where there is the choice, or an error law without them"
            )

    @property
    def best(self) -> Candidate:
        """The best candidate. Raises `BadInput` where there is none."""
        self._require_root()
        return self.candidates[0]

    @property
    def observation(self) -> Observation:
        """The detection under the best candidate."""
        return self.likelihood.observe(self.detection, self.best.root)

    @property
    def pose(self) -> np.ndarray | None:
        """`(15, 3)`: the estimator's single 3D pose, that of the best candidate, in camera axes and
        body units."""
        return self.best.pose

    @property
    def converged(self) -> bool:
        """Whether the estimator came to an end for every candidate."""
        return all(candidate.converged for candidate in self.candidates)

    def _require_root(self) -> None:
        if not self.candidates:
            raise BadInput(
                f"{self.detection.where} has no torso and camera to hold fixed; take its posterior"
                " with an uncertain root"
            )


def require_root_prior(root: str) -> None:
    """Raises `BadInput` where there is no prior of torso and camera of that name."""
    if root not in ROOT_PRIORS:
        raise BadInput(f"there is no root {root!r}; choose one of {', '.join(ROOT_PRIORS)}")
