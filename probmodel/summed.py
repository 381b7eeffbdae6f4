"""The likelihood with a detector's faults summed out, for samplers that walk in R^d, and the faults
of the poses that those find (docs/model.md § 9, "Faults of the detector").

Given root and pose, a pattern of faults is an exchange, the torso's outlier, if there is one, and
for each joint of the limbs by itself whether it is one. So the sum over all patterns is, for each
exchange, one over seven states of the torso times a product, over joints, of sums over two.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.nn import logsumexp

from poseterior.probmodel.errors.faults import LIMB_INDEX, ORDERS, FaultPrior, Faults, faults_of
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX

_ASTRAY = np.eye(1 + len(TORSO_INDEX), len(TORSO_INDEX), -1, dtype=bool)
"""In each state of the torso, which of its joints is an outlier: none, then one after the other."""


class States(NamedTuple):
    """A number for each state of the parts of a pattern.

    Attributes
    ----------
    exchange : `(e,)`
        Of each exchange that there may be.
    torso : `(e, 7)`
        Under each of them, of no outlier among the torso's keypoints, and of each of those.
    limbs : `(e, 9, 2)`
        Of each of `LIMB_INDEX`, if it is no outlier, and if it is.
    """

    exchange: jax.Array
    torso: jax.Array
    limbs: jax.Array


class SummedFaults(NamedTuple):
    """A detection whose faults are summed out, a pytree.

    Attributes
    ----------
    detected
        What was detected.
    faults
        How often the detector errs.
    prior
        Of the root.
    """

    detected: DetectedJoints
    faults: FaultPrior
    prior: TorsoCameraPrior

    def log_likelihood(self, point: RootPoint, joints: jax.Array) -> jax.Array:
        """Summed over all patterns.

        Parameters
        ----------
        point
            One root.
        joints : `(15, 3)`
            Of one pose, in camera axes.

        Returns
        -------
        Array
            `()`: the log, per square pixel and joint seen.
        """
        return _log_sum(_log_exchanges(self._log_states(point, joints)))

    def draw(self, key: jax.Array, point: RootPoint, joints: jax.Array) -> Faults:
        """A pattern given root and pose.

        Parameters
        ----------
        key
            Of the draw.
        point
            One root.
        joints : `(15, 3)`
            Of one pose, in camera axes, which some pattern explains.

        Returns
        -------
        Faults
            One of them, as probable as the posterior has it.
        """
        states = self._log_states(point, joints)
        keys = jax.random.split(key, 3)
        row = jax.random.categorical(keys[0], _log_exchanges(states))
        torso = jax.random.categorical(keys[1], states.torso[row])
        limbs = jax.random.categorical(keys[2], states.limbs[row])
        return faults_of(jnp.asarray(self.faults.exchanges)[row], torso, limbs)

    def misfit(self, point: RootPoint, joints: jax.Array) -> jax.Array:
        """How far the pattern that explains a pose best is from doing so.

        Parameters
        ----------
        point
            One root.
        joints : `(15, 3)`
            Of one pose, in camera axes.

        Returns
        -------
        Array
            `()`: under that pattern, the largest distance of a seen joint from its detection, in
            reaches.
        """
        torso, limbs = self._by_state(point, lambda seen: seen.squares_in_reaches(joints))
        prior = self._log_prior()
        torso = jnp.where(jnp.isfinite(prior.torso), torso.max(axis=-1), jnp.inf).min(axis=-1)
        limbs = jnp.where(jnp.isfinite(prior.limbs), limbs, jnp.inf).min(axis=-1)
        return jnp.sqrt(jnp.min(jnp.maximum(torso, limbs.max(axis=-1))))

    def _log_states(self, point: RootPoint, joints: jax.Array) -> States:
        """Of prior and likelihood together; of the exchange, of its prior."""
        torso, limbs = self._by_state(point, lambda seen: seen.log_densities(joints))
        prior = self._log_prior()
        return States(prior.exchange, prior.torso + torso.sum(axis=-1), prior.limbs + limbs)

    def _log_prior(self) -> States:
        """By the laws of `FaultPrior.compose`."""

        def under(exchange: jax.Array) -> States:
            laws: dict[str, Any] = {}

            def step(site: str, law: Any) -> jax.Array:
                laws[site] = law
                return exchange if site == "exchange" else jnp.zeros(law.shape(), int)

            self.faults.compose(self.detected.counts, step)
            astray = laws["limb_outlier"].base_dist.probs
            states = (
                laws["exchange"].probs[exchange],
                laws["torso_outlier"].probs,
                jnp.stack([1 - astray, astray], axis=-1),
            )
            return States(*map(jnp.log, states))

        return jax.vmap(under)(jnp.asarray(self.faults.exchanges))

    def _by_state(
        self, point: RootPoint, number: Callable[[Observation], jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        """A number `(15,)` of every joint in each state: `(e, 7, 6)` of the torso's joints in each
        state of the torso, and `(e, 9, 2)` of the limbs'."""

        def read(outlier: bool) -> jax.Array:
            """`(e, 15)`, by keypoint: an exchange is its own inverse."""

            def one(exchange: jax.Array) -> jax.Array:
                faults = Faults(exchange, np.full(NUM_JOINTS, outlier))
                observation = self.detected.under(self.prior, point, faults)
                return number(observation)[jnp.asarray(ORDERS)[exchange]]

            return jax.vmap(one)(jnp.asarray(self.faults.exchanges))

        near = read(False)
        # Where there are no outliers, no state of theirs has a prior probability.
        far = read(True) if any(self.faults.outlier) else near
        torso, limbs = np.array(TORSO_INDEX), np.array(LIMB_INDEX)
        return (
            jnp.where(_ASTRAY, far[:, None, torso], near[:, None, torso]),
            jnp.stack([near[:, limbs], far[:, limbs]], axis=-1),
        )


def _log_exchanges(states: States) -> jax.Array:
    """`(e,)`: each exchange with all states of torso and limbs."""
    return states.exchange + _log_sum(states.torso) + _log_sum(states.limbs).sum(axis=-1)


def _log_sum(log_terms: jax.Array) -> jax.Array:
    """`(...)`: logs of sums over the last axis. Where no term is possible it is -inf, and its slope
    0: that of `logsumexp` is 0/0 there, and would make those of the other exchanges NaN."""
    possible = jnp.any(log_terms > -jnp.inf, axis=-1)
    safe = jnp.where(possible[..., None], log_terms, 0.0)
    return jnp.where(possible, logsumexp(safe, axis=-1), -jnp.inf)
