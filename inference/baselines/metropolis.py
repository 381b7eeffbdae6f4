"""Walkers that know nothing but the density where they stand: random-walk Metropolis, the floor,
and sample-adaptive MCMC, whose walkers carry a cloud of points each. All in R^d; walkers are
independent of each other."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.chains import Trace, walking
from poseterior.inference.baselines.ensemble import NumPyroKernel
from poseterior.inference.baselines.run import Baseline
from poseterior.inference.baselines.target import Density
from poseterior.probmodel.transport import CUBE_DIM

WALKERS = 128
WALK_STEPS = 64
ACCEPTANCE = 0.234
"""The acceptance that random-walk Metropolis is tuned to (Roberts, Gelman & Gilks 1997)."""
ADAPTIVE_WALKERS = 16
ADAPTIVE_STEPS = 256
WALL = 1e6
"""Potential energy outside the support, for a sampler that does not understand an infinite one."""


class Stride(NamedTuple):
    """A walker of random-walk Metropolis: `point` `(d,)`, its log density, the log of its step's
    scale, its key."""

    point: jax.Array
    log_density: jax.Array
    log_scale: jax.Array
    key: jax.Array


def metropolis(
    log_density: Any, walker: Stride, root: jax.Array, gain: jax.Array
) -> tuple[Stride, jax.Array]:
    """One step with the proposal N(0, exp(2 log_scale) · root rootᵀ), and whether it was accepted;
    `gain` tunes the scale towards `ACCEPTANCE` (0: not at all)."""
    key, for_step, for_choice = jax.random.split(walker.key, 3)
    step = jnp.exp(walker.log_scale) * (root @ jax.random.normal(for_step, walker.point.shape))
    proposal = walker.point + step
    log_proposal = log_density(proposal)
    accepted = jnp.log(jax.random.uniform(for_choice)) < log_proposal - walker.log_density
    log_scale = walker.log_scale + gain * (accepted - ACCEPTANCE)
    point = jnp.where(accepted, proposal, walker.point)
    return (
        Stride(point, jnp.where(accepted, log_proposal, walker.log_density), log_scale, key),
        accepted,
    )


def root_of_covariance(points: jax.Array) -> jax.Array:
    """`(d, d)`: a Cholesky factor of the covariance of points `(n, d)`, a little widened so that it
    exists."""
    covariance = jnp.atleast_2d(jnp.cov(points, rowvar=False))
    floor = 1e-9 + 1e-6 * jnp.mean(jnp.diag(covariance))
    return jnp.linalg.cholesky(covariance + floor * jnp.eye(points.shape[-1]))


class MetropolisKernel:
    """Random-walk Metropolis with the covariance of the starting points; the scale is tuned in the
    warm-up."""

    walkers = WALKERS
    warm_up = 8 * WALK_STEPS

    def __init__(self, target: Density) -> None:
        self._target = target

    def start(self, key: jax.Array, points: np.ndarray) -> Any:
        scale = jnp.full(WALKERS, np.log(2.38 / np.sqrt(points.shape[1])))
        place = jnp.asarray(points)
        state = Stride(
            place, self._target.log_density(place), scale, jax.random.split(key, WALKERS)
        )
        return state, root_of_covariance(place), jnp.zeros((), int)

    def advance(self, state: Any, steps: int) -> tuple[Any, Trace]:
        walkers, root, done = state
        tuning = jnp.where(done < self.warm_up, 1.0, 0.0)
        # What one walker found in its corner is not for its life: from then on all take the mean
        # scale.
        scale = jnp.where(tuning > 0, walkers.log_scale, jnp.mean(walkers.log_scale))
        walkers = walkers._replace(log_scale=scale)
        walkers, points = _stride(self._target, walkers, root, tuning, steps)
        return (walkers, root, done + steps), Trace(np.asarray(points), steps * WALKERS)


@functools.partial(jax.jit, static_argnums=4)
def _stride(
    target: Density, walkers: Stride, root: jax.Array, gain: jax.Array, steps: int
) -> tuple[Stride, jax.Array]:
    one = jax.vmap(functools.partial(metropolis, target.log_density), in_axes=(0, None, None))

    def step(walkers: Stride, _: None) -> tuple[Stride, jax.Array]:
        after = one(walkers, root, gain)[0]
        return after, after.point

    return jax.lax.scan(step, walkers, None, length=steps)


class AdaptiveKernel(NumPyroKernel):
    """NumPyro's sample-adaptive MCMC, one evaluation a step.

    Its clouds begin with starting points, for points around them would be outside. Up to NumPyro
    0.22 two things are wrong with it (`tests/inference/test_baselines.py`). A proposal of density
    zero is taken into the cloud and never leaves it: outside, the density is `WALL` here. And with
    a dense covariance, its default, it samples another law, because its rank-one update of a
    Cholesky factor is no such update in two dimensions or more: here the covariance is diagonal.
    """

    def __init__(self, target: Density) -> None:
        from numpyro.infer import SA

        self._potential = lambda point: jnp.minimum(-target.log_density(point), WALL)
        # Its documentation's default, as far as there are points.
        self._cloud = 2 * min(target.dim, CUBE_DIM)
        kernel = SA(potential_fn=self._potential, adapt_state_size=self._cloud, dense_mass=False)
        super().__init__(
            kernel,
            ADAPTIVE_WALKERS,
            8 * ADAPTIVE_STEPS,
            lambda before, after: jnp.asarray(ADAPTIVE_WALKERS),
        )

    def start(self, key: jax.Array, points: np.ndarray) -> Any:
        clouds = jnp.asarray(points).reshape(ADAPTIVE_WALKERS, -1, points.shape[1])[
            :, : self._cloud
        ]
        state = super().start(key, np.asarray(clouds[:, 0]))
        potential = jax.vmap(jax.vmap(self._potential))(clouds)
        adapted = state.adapt_state._replace(zs=clouds, pes=potential)
        return state._replace(z=clouds[:, 0], potential_energy=potential[:, 0], adapt_state=adapted)


WALKS = {
    "random-walk": Baseline(
        walking(MetropolisKernel, steps=WALK_STEPS),
        WALKERS,
        "random-walk Metropolis, covariance of the starts, scale tuned to 0.234",
    ),
    "sa": Baseline(
        walking(AdaptiveKernel, steps=ADAPTIVE_STEPS),
        ADAPTIVE_WALKERS * 2 * CUBE_DIM,
        "NumPyro sample-adaptive MCMC with a diagonal covariance, clouds of 2d points in the"
        " support",
    ),
}
