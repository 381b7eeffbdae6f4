"""Samplers with faults that were published once: negative controls of the judge."""

import jax
import jax.numpy as jnp
from numpyro.infer import AIES, ESS, SA
from numpyro.infer.ensemble import EnsembleSamplerState

from poseterior.inference.baselines.ensemble import NumPyroKernel
from poseterior.inference.baselines.metropolis import AdaptiveKernel
from poseterior.inference.baselines.target import Target


class HalfUpdatedAIES(AIES):
    """Affine-invariant ensembles as NumPyro ≤ 0.21 had them: the second half of the walkers finds
    its partners among themselves, who move at the same time (mended in its pull request 2189)."""

    def sample(self, state, model_args, model_kwargs):
        return half_updated(self, state)


class HalfUpdatedESS(ESS):
    """Ensemble slice sampling of NumPyro ≤ 0.21, with the same fault."""

    def sample(self, state, model_args, model_kwargs):
        return half_updated(self, state)


def half_updated(kernel, state):
    z, inner, rng_key = state
    rng_key, _ = jax.random.split(rng_key)
    half = len(z) // 2
    first, inner = kernel.update_active_chains(z[:half], z[half:], inner)
    second, inner = kernel.update_active_chains(z[half:], z[half:], inner)
    return EnsembleSamplerState(jnp.concatenate([first, second]), inner, rng_key)


class DenseAdaptiveKernel(AdaptiveKernel):
    """Sample-adaptive MCMC as NumPyro 0.22 has it by default, with a dense covariance."""

    def __init__(self, target: Target) -> None:
        super().__init__(target)
        kernel = SA(potential_fn=self._potential, adapt_state_size=self._cloud, dense_mass=True)
        NumPyroKernel.__init__(self, kernel, self.walkers, self.warm_up, self._evaluations_of)
