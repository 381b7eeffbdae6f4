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

from probmodel.faults import LIMB_INDEX, ORDERS, FaultPrior, Faults, faults_of
from probmodel.observation import Observation
from probmodel.roots import RootPoint, RootPrior
from probmodel.skeleton import NUM_JOINTS, TORSO_INDEX
from probmodel.uncertain import DetectedJoints

NUM_UNIFORMS = 2 + len(LIMB_INDEX)
"""Random numbers that decide a pattern: its exchange, the torso's outlier, each limb joint."""
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
    prior: RootPrior

    @property
    def exchanges(self) -> np.ndarray:
        """`(e,)`: those that there may be, as indices into `EXCHANGES`."""
        return np.flatnonzero([True, *self.faults.exchange])

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
        return logsumexp(_log_exchanges(self._log_states(point, joints)))

    def draw(self, uniform: jax.Array, point: RootPoint, joints: jax.Array) -> Faults:
        """A pattern given root and pose.

        Parameters
        ----------
        uniform : `(NUM_UNIFORMS,)`
            Random numbers between 0 and 1.
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
        row = _chosen(uniform[0], _log_exchanges(states))
        torso = _chosen(uniform[1], states.torso[row])
        limbs = jax.vmap(_chosen)(uniform[2:], states.limbs[row])
        return faults_of(jnp.asarray(self.exchanges)[row], torso, limbs)

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

        def squares(observation: Observation) -> jax.Array:
            return observation.squares(joints) / observation.law.reach**2

        torso, limbs = self._by_state(point, squares)
        prior = self._log_prior()
        torso = jnp.where(jnp.isfinite(prior.torso), torso.max(axis=-1), jnp.inf).min(axis=-1)
        limbs = jnp.where(jnp.isfinite(prior.limbs), limbs, jnp.inf).min(axis=-1)
        return jnp.sqrt(jnp.min(jnp.maximum(torso, limbs.max(axis=-1))))

    def _log_states(self, point: RootPoint, joints: jax.Array) -> States:
        """Of prior and likelihood together; of the exchange, of its prior."""
        torso, limbs = self._by_state(point, lambda observation: observation.log_densities(joints))
        prior = self._log_prior()
        return States(prior.exchange, prior.torso + torso.sum(axis=-1), prior.limbs + limbs)

    def _log_prior(self) -> States:
        """By the laws of `FaultPrior.compose`."""

        def under(exchange: int) -> States:
            laws: dict[str, Any] = {}

            def step(site: str, law: Any) -> jax.Array:
                laws[site] = law
                shape = law.batch_shape + law.event_shape
                return jnp.full(shape, exchange if site == "exchange" else 0)

            self.faults.compose(self.detected.counts, step)
            astray = laws["limb_outlier"].base_dist.probs
            states = (
                laws["exchange"].probs[exchange],
                laws["torso_outlier"].probs,
                jnp.stack([1 - astray, astray], axis=-1),
            )
            return States(*map(jnp.log, states))

        return jax.tree.map(lambda *each: jnp.stack(each), *map(under, self.exchanges))

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

            return jax.vmap(one)(jnp.asarray(self.exchanges))

        near, far = read(False), read(True)
        torso, limbs = np.array(TORSO_INDEX), np.array(LIMB_INDEX)
        return (
            jnp.where(_ASTRAY, far[:, None, torso], near[:, None, torso]),
            jnp.stack([near[:, limbs], far[:, limbs]], axis=-1),
        )


def _log_exchanges(states: States) -> jax.Array:
    """`(e,)`: each exchange with all states of torso and limbs."""
    torso = logsumexp(states.torso, axis=-1)
    return states.exchange + torso + logsumexp(states.limbs, axis=-1).sum(axis=-1)


def _chosen(uniform: jax.Array, log_weight: jax.Array) -> jax.Array:
    """`()`: one of the states `(n,)`, as probable as it weighs."""
    below = jnp.cumsum(jax.nn.softmax(log_weight))
    return jnp.minimum(jnp.sum(uniform * below[-1] >= below), len(log_weight) - 1)
