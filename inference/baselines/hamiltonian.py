"""Hamiltonian Monte Carlo on a smoothed posterior, NUTS and HMC, made exact by weights.

Where a joint ends to be explained, at the rim of its disc, the likelihood has no gradient: the rim
is replaced by a soft wall σ(SHARPNESS · (1 - d²/reach²)). What is drawn inside all rims is weighted
by the inverse of its walls (at most 2 to the number of discs), the rest by zero; how far such
weights can be trusted is Pareto k̂ (Vehtari et al. 2024), which is reported. Chains are independent.

Limits are steps without a slope: a path takes no notice of them until its end is judged, which is
exact, and may be refused."""

import functools
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.chains import Walk
from poseterior.inference.baselines.ensemble import NumPyroKernel
from poseterior.inference.baselines.run import Baseline, Drawn, Method
from poseterior.inference.baselines.target import Slopes
from poseterior.inference.resampling import systematic
from poseterior.probmodel.chunks import in_chunks

CHAINS = 16
WARM_UP = 200
"""Steps in which step size and mass matrix are tuned; fewer than 100 do not find a step size on
this posterior."""
NUTS_STEPS = 20
DEPTH = 7
"""Doublings of a path of NUTS at most; its default, 10, spends a million gradients on the warm-up
alone."""
LEAPS = 32
"""Steps of a path of plain HMC."""
SHARPNESS = 8.0
"""At 1.2 τ a wall has fallen to 3 %; about half of the draws on a whole body are inside all
discs."""


GROWTH = 1.2
"""Weights are looked at again whenever the evaluations have become so many times as many."""


class Smoothed:
    """A walk on the smoothed posterior, whose draws are resampled in proportion to their weights,
    chain by chain. `held` is what there was when weights were last looked at."""

    def __init__(self, target: Slopes, walk: Walk) -> None:
        self._target, self._walk = target, walk
        self.held = self._looked = 0

    @property
    def evaluations(self) -> int:
        return self._walk.evaluations

    def more(self) -> bool:
        goes_on = self._walk.more()
        if self._walk.held and self.evaluations >= GROWTH * self._looked:
            self._weigh(self._walk.points)
        return goes_on

    def state(self) -> dict[str, np.ndarray]:
        return {**self._walk.state(), "weighed": np.array([self.held, self._looked])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self._walk.restore(state)
        self.held, self._looked = (int(count) for count in state["weighed"])

    def drawn(self, key: jax.Array) -> Drawn:
        """Draws by systematic resampling in the order of each chain, as many as the chain has
        inside on average."""
        raw = self._walk.drawn(key)
        chains, number, dim = raw.points.shape
        if not number:
            return raw
        log_weight = self._weigh(raw.points)
        inside, keep = np.isfinite(log_weight), self.held // chains
        info = {
            **raw.info,
            "inside": float(inside.mean()),
            "pareto_k": _pareto_k(log_weight[inside]),
        }
        if not keep:
            return Drawn(np.empty((chains, 0, dim)), np.nan, np.nan, info)
        weight = np.exp(log_weight - log_weight.max())
        offset = float(jax.random.uniform(key))
        rows = [systematic(one, keep, offset) for one in weight]
        info["steps"] = keep
        return Drawn(
            np.stack([part[row] for part, row in zip(raw.points, rows, strict=True)]),
            np.nan,
            np.nan,
            info,
        )

    def _weigh(self, points: np.ndarray) -> np.ndarray:
        """`(chain, draw)`: log weights, by which `held` is known. A chain that is never inside has
        nothing to offer, and its neighbours may not speak for it."""
        chains, number, dim = points.shape
        log_weight = _log_weights(self._target, points.reshape(-1, dim)).reshape(chains, number)
        inside = np.isfinite(log_weight)
        keep = inside.sum() // chains if inside.any(axis=1).all() else 0
        self.held, self._looked = int(chains * keep), self.evaluations
        return log_weight


def _log_weights(target: Slopes, points: np.ndarray) -> np.ndarray:
    """`(n,)`: log weights of draws of the smoothed posterior, -inf outside."""
    walls, misfit = in_chunks(lambda part: _walls(target, part), points)
    return np.where(misfit <= 1, -walls, -np.inf)


@jax.jit
def _walls(target: Slopes, points: jax.Array) -> tuple[jax.Array, jax.Array]:
    return target.log_walls(points, SHARPNESS), target.misfit(points)


def _pareto_k(log_weight: np.ndarray) -> float:
    """Pareto k̂ of weights `(n,)` in any order; NaN where there are too few, or the largest are all
    the same."""
    if len(log_weight) < 100:
        return np.nan
    from arviz_stats.base import array_stats

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it warns of is the number that is returned
        try:
            return float(array_stats.psislw(log_weight)[1])
        except ValueError:  # a tail without a shape
            return np.nan


def _hamiltonian(target: Slopes, key: jax.Array, starts: np.ndarray, kernel: str) -> Method:
    from numpyro.infer import HMC, NUTS

    def potential(point: jax.Array) -> jax.Array:
        return -target.log_smooth(point, SHARPNESS)

    made: Any
    if kernel == "nuts":
        made = NUTS(potential_fn=potential, max_tree_depth=DEPTH)
    else:
        # Its default, a path of length 2π, takes millions of steps where the walls force a short
        # step.
        made = HMC(potential_fn=potential, trajectory_length=None, num_steps=LEAPS)
    stepper = NumPyroKernel(made, CHAINS, WARM_UP, lambda before, after: jnp.sum(after.num_steps))
    return Smoothed(target, Walk(stepper, key, starts, runs=1, ensemble=False, steps=NUTS_STEPS))


GRADIENTS = {
    "nuts": Baseline(
        functools.partial(_hamiltonian, kernel="nuts"),
        CHAINS,
        "NumPyro NUTS on soft walls, reweighted; paths of 127 steps at most, 200 steps of warm-up",
    ),
    "hmc": Baseline(
        functools.partial(_hamiltonian, kernel="hmc"),
        CHAINS,
        "NumPyro HMC on soft walls, reweighted; paths of 32 steps, 200 steps of warm-up",
    ),
}
