"""The posterior as one value: what is believed of poses, of detectors' errors, and of the root.

`Posterior(model, likelihood, detection, roots)` owns the program, its mixture over roots and their
weights; samplers, streams, studies and pictures ask it. `Estimate` is the same without the model,
which is what an estimator makes of a detection. See docs/model.md § 7; for roots that are not
held fixed, `uncertain` and § 9.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.programs import kept
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.uncertain import UncertainPosterior


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of one detection: a mixture over roots, the prior's atoms.

    Attributes
    ----------
    model
        The prior of poses.
    likelihood
        How detections err.
    detection
        What was detected.
    roots
        The candidates for torso and camera, all of equal prior mass.
    estimator
        Where they come from.
    """

    model: PoseModel
    likelihood: Likelihood
    detection: Detection
    roots: tuple[Candidate, ...]
    estimator: str = ""

    @functools.cached_property
    def observations(self) -> tuple[Observation, ...]:
        """The detection under each root."""
        with jax.ensure_compile_time_eval():  # numbers, also where a sampler traces the program
            return tuple(self.likelihood.observe(self.detection, one.root) for one in self.roots)

    @functools.cached_property
    def log_root_weights(self) -> np.ndarray:
        """`(roots,)`: log probability of each root given the torso's detected joints alone.

        Where no root has all of them within reach, they say nothing and are left out.
        """
        if len(self.roots) == 1:
            return np.zeros(1)
        with jax.ensure_compile_time_eval():  # as above
            torso = [self.likelihood.log_torso(self.detection, one.root) for one in self.roots]
        log_weight = np.array(torso) if np.isfinite(torso).any() else np.zeros(len(self.roots))
        return log_weight - np.logaddexp.reduce(log_weight)

    @functools.cached_property
    def log_weights(self) -> np.ndarray:
        """`(roots,)`: what weighs each root beside its log evidence, which is the prior's mean of
        the likelihood over its peak (for discs, of the indicator). Normalised."""
        if len(self.roots) == 1:
            return np.zeros(1)
        peaks = np.array([float(_log_peak(observation)) for observation in self.observations])
        log_weight = self.log_root_weights + peaks
        return log_weight - np.logaddexp.reduce(log_weight)

    def program(self) -> jax.Array:
        """NumPyro model of the whole mixture: site `root`, then those of `PoseModel.posterior`.
        Returns the joints `(15, 3)` in camera axes, body units of the root drawn."""
        import numpyro  # takes as long as JAX to import, and only programs need it
        from numpyro.distributions import CategoricalLogits

        index = numpyro.sample("root", CategoricalLogits(jnp.asarray(self.log_root_weights)))
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *self.observations)
        return self.model.posterior(jax.tree.map(lambda leaf: leaf[index], stacked))

    @property
    def converged(self) -> bool:
        """Whether the estimator came to an end for every root."""
        return all(candidate.converged for candidate in self.roots)


@kept
def _log_peak(observation: Observation) -> jax.Array:
    """Compiled as one, since every operation by itself takes longer to compile than to be done."""
    return observation.log_peak


@dataclass(frozen=True)
class Estimate:
    """A detection with the roots that are left open, best reprojection first: everything of its
    posterior but the model. `posterior` holds the roots fixed, `uncertain` holds none.

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

    def posterior(self, model: PoseModel) -> Posterior:
        """The posterior under a model of poses, roots held fixed.

        Parameters
        ----------
        model
            The prior of poses.

        Returns
        -------
        Posterior
            The mixture over the candidates.

        Raises
        ------
        BadInput
            Where the likelihood has outliers or exchanged sides, or the model a belief of how the
            body is turned or a focal length, which fixed roots leave no room for; where there is no
            candidate.
        """
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
        self._require_root()
        return Posterior(model, self.likelihood, self.detection, self.candidates, self.estimator)

    def uncertain(self, model: PoseModel) -> UncertainPosterior:
        """The posterior under a model of poses in which torso and camera are uncertain too."""
        seen = model if self.lens is None else model.seen_by(self.lens)
        return UncertainPosterior(
            seen, self.likelihood, self.detection, self.candidates, self.estimator
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
                " with an uncertain root, `uncertain(model)`"
            )
