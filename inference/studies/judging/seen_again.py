"""One joint of a detection seen once more: what posterior SBC takes for the second data set of our
own samplers, which draw given one detection of each joint.

A sampler is given the middle between both keypoints in their place. Error laws fall with distance,
so that a pose that explains both keypoints explains the middle too, and better than one of them:
draws of that posterior, weighed by the density of both keypoints over that of the middle, are
draws given both, and no weight exceeds the law's peak."""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior.inference.draws import COMPLETE, Draws, Sampler, over_draws
from poseterior.inference.importance.weighted import APART, WeightedSampler
from poseterior.inference.resampling import effective, shares
from poseterior.inference.results import result_of
from poseterior.inference.studies.judging.brought import Brought
from poseterior.probmodel.errors.faults import ORDERS, Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import RootPrior

OF_JOINT = ("towards the second", "beside", "depth")
"""Of the joint that is seen again: how far it falls from the middle between its keypoints in the
image, along and beside the line from the first to the second, pixels; and how far behind the pelvis
it is, body units. Of draws that are too narrow the truth lies nearer to the first."""
FEWEST_WEIGHTED = 20
"""Effective draws of a replicate: where there are fewer, more are drawn."""
MORE = (1, 8, 8)
"""How many times as many as before, of so many times the roots."""


class SeenAgain(NamedTuple):
    """A joint, and its two keypoints `(2,)`, pixels."""

    posterior: Posterior
    joint: int
    keypoint: np.ndarray

    @property
    def between(self) -> Posterior:
        """The posterior with the middle in both keypoints' place."""
        detection = self.posterior.detection
        keypoints = detection.keypoints.copy()
        keypoints[self.joint] = self._middle
        return dataclasses.replace(
            self.posterior, detection=dataclasses.replace(detection, keypoints=keypoints)
        )

    def log_likelihood(self, draws: Draws) -> np.ndarray:
        """`(n,)`: log density of both keypoints, per square pixel each."""
        return self._log_density(draws, self._first) + self._log_density(draws, self.keypoint)

    def log_weight(self, draws: Draws) -> np.ndarray:
        """`(n,)`: of draws from `between`, up to rounding at the ends of reaches."""
        middle = self._log_density(draws, self._middle)
        return self.log_likelihood(draws) - np.where(np.isfinite(middle), middle, np.inf)

    def quantities(self, draws: Draws) -> np.ndarray:
        """`(n, 3)`: `OF_JOINT`."""
        along, down = self.keypoint - self._first
        axes = np.array([[along, -down], [down, along]]) / np.hypot(along, down)
        depth = draws.joints[:, self.joint, 2:]
        offset = (draws.keypoints[:, self.joint] - self._middle) @ axes
        return np.concatenate([offset, depth], axis=1)

    @property
    def _first(self) -> np.ndarray:
        return self.posterior.detection.keypoints[self.joint]

    @property
    def _middle(self) -> np.ndarray:
        return (self._first + self.keypoint) / 2

    def _log_density(self, draws: Draws, keypoint: np.ndarray) -> np.ndarray:
        detected = self.posterior.detected
        only = np.arange(len(detected.keypoints)) == self.joint
        alone = detected._replace(
            keypoints=np.where(only[:, None], keypoint, 0.0),
            spread=np.where(only, detected.spread, np.inf),
        )
        given = draws.posterior.model, draws.prior, alone
        return over_draws(_log_density, given, draws.points, draws.poses, draws.faults)


@kept
def _log_density(
    model: PoseModel,
    prior: RootPrior,
    detected: DetectedJoints,
    points: Any,
    poses: Pose,
    faults: Faults,
) -> jax.Array:
    def one(point: Any, pose: Pose, faults: Faults) -> jax.Array:
        seen = detected.under(prior, point, faults)
        return seen.log_density(model.joints(seen.view, *pose))

    return jax.vmap(one)(points, poses, faults)


def new_keypoints(draws: Draws) -> np.ndarray:
    """`(n, 15, 2)` pixels: a new detection of each draw, with its errors and faults, in the
    detection's own order of joints; NaN where a joint does not count."""
    predicted = result_of(draws).tree["posterior_predictive"].keypoints.values
    rows = np.arange(len(draws))[:, None]
    return predicted.reshape(len(draws), -1, 2)[rows, ORDERS[draws.faults.exchange]]


def seen_again(
    posterior: Posterior, sampler: Sampler, key: jax.Array, number: int, num_samples: int
) -> Brought:
    """Truths drawn from a posterior, each with draws given one more keypoint that was simulated of
    it, of the joints that count in turn.

    Raises `BadInput` where the sampler cannot draw so many independent truths."""
    truth_key, key = jax.random.split(key)
    truths = sampler.draw(posterior, truth_key, number)
    if truths.status != COMPLETE:
        raise BadInput(truths.sentence)
    if independent(truths) < number:
        raise BadInput(
            f"draws of this detection are worth {independent(truths)} independent ones, and"
            f" {number} replicates need as many; ask for fewer replicates, or bring a sampler of"
            " more roots"
        )
    keypoints = new_keypoints(truths)
    counted = np.flatnonzero(posterior.detected.counts)
    truth, draws, log_weights, density = [], [], [], []
    for row in range(number):
        joint = int(counted[row % len(counted)])
        again = SeenAgain(posterior, joint, keypoints[row, joint])
        own = truths.take(slice(row, row + 1))
        some, log_weight = _given_both(again, sampler, jax.random.fold_in(key, row), num_samples)
        truth.append(again.quantities(own)[0])
        draws.append(again.quantities(some))
        log_weights.append(log_weight)
        density.append(np.concatenate([again.log_likelihood(part) for part in (own, some)]))
    most = max(map(len, draws))
    densities = np.stack([_filled(one, most + 1) for one in density])
    return Brought.of(
        np.stack([np.resize(one, (most, len(OF_JOINT))) for one in draws]),
        np.stack(truth),
        names=OF_JOINT,
        log_weights=np.stack([_filled(one, most) for one in log_weights]),
        log_density=(densities[:, 0], densities[:, 1:]),
    )


def _given_both(
    again: SeenAgain, sampler: Sampler, key: jax.Array, number: int
) -> tuple[Draws, np.ndarray]:
    """Draws given both keypoints, and their log weights."""
    for times in MORE:
        number *= times
        if isinstance(sampler, WeightedSampler):
            sampler = dataclasses.replace(sampler, num_roots=times * sampler.num_roots)
        draws = sampler.draw(again.between, key, number)
        draws = draws.take(slice(independent(draws)))
        log_weight = again.log_weight(draws)
        if effective(shares(log_weight)) >= FEWEST_WEIGHTED:
            break
    return draws, log_weight


def _filled(values: np.ndarray, number: int) -> np.ndarray:
    """`(number,)`: draws that are not there weigh nothing."""
    return np.concatenate([values, np.full(number - len(values), -np.inf)])


def independent(draws: Draws) -> int:
    """How many of the first draws hardly ever share a root: all of them where roots are not
    weighted."""
    roots = draws.effective_roots
    return len(draws) if np.isnan(roots) else min(len(draws), int(roots / APART))
