"""Samplers of other libraries on a frozen target, as they come: dynesty and reddemcee.

Both climb the graded likelihood from the prior, because an indicator gives nested and tempered
samplers nothing to climb; their draws outside of the walls get no weight. Both ask for one point at
a time, and get the form in JAX. Each is an extra (`pip install 'poseterior[guests]'`)."""

import itertools
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from inference.baselines.run import Allowance
from inference.benchmark.programs import in_jax
from inference.benchmark.submission import Submission, submit
from inference.benchmark.target import FrozenTarget

HARDNESS = 50.0
"""Of the walls: a joint's area grows by a fiftieth, which leaves most draws inside."""
TEMPERATURES = 10
WALKERS = 4
"""Walkers of a temperature, as a multiple of the dimension."""
STEPS = 50
"""Steps between two looks at the clock."""
BURN_IN = 0.25
CLOCK = time.process_time
Guest = Callable[[FrozenTarget, int, Allowance], Submission | None]
"""Draws of a target; None where none came inside the walls."""


def dynesty(target: FrozenTarget, seed: int, allowance: Allowance) -> Submission | None:
    """dynesty's static sampler, everything as it comes."""
    import dynesty as package

    rng, log_likelihood = np.random.default_rng(seed), _graded(target)
    started = CLOCK()
    sampler = package.NestedSampler(log_likelihood, target.prior_transform, target.dim, rstate=rng)
    for _ in sampler.sample(add_live=False):
        if not allowance.allows(sampler.ncall, CLOCK() - started):
            break
    for _ in sampler.add_live_points():
        pass
    found, seconds = sampler.results, CLOCK() - started
    log_weights = np.asarray(found.logwt)
    cost = {"evaluations": int(np.sum(found.ncall)), "seconds": seconds}
    error = float(found.logzerr[-1])
    return _inside(target, np.asarray(found.samples), log_weights, error, cost)


def reddemcee(target: FrozenTarget, seed: int, allowance: Allowance) -> Submission | None:
    """reddemcee's adaptive parallel tempering, everything as it comes, in the cube."""
    from reddemcee import PTSampler

    np.random.seed(seed)  # noqa: NPY002 — the global state is what it begins with
    graded, counted = _graded(target), itertools.count(1)

    def log_likelihood(cube: np.ndarray) -> float:
        next(counted)
        return graded(target.prior_transform(cube)) if _flat(cube) == 0 else -np.inf

    walkers = WALKERS * target.dim
    sampler = PTSampler(walkers, target.dim, log_likelihood, _flat, ntemps=TEMPERATURES)
    state: Any = np.random.default_rng(seed).uniform(size=(TEMPERATURES, walkers, target.dim))
    started, evaluations = CLOCK(), 0
    while allowance.allows(evaluations, CLOCK() - started):
        state = sampler.run_mcmc(state, nsweeps=STEPS, progress=False)
        evaluations = next(counted)
    seconds = CLOCK() - started
    cold = np.asarray(sampler.get_chain())[0]
    kept = cold[int(BURN_IN * len(cold)) :]
    # One walker's path after the other.
    points = target.prior_transform(np.moveaxis(kept, 1, 0).reshape(-1, target.dim))
    cost = {"evaluations": evaluations, "seconds": seconds}
    return _inside(target, points, np.zeros(len(points)), np.nan, cost)


GUESTS: dict[str, tuple[Guest, str]] = {
    "dynesty": (dynesty, "dynesty's static sampler, 500 live points"),
    "reddemcee": (reddemcee, "reddemcee's parallel tempering, ten temperatures"),
}
"""Each guest, by the name of its package, and how it is set up."""


def _graded(target: FrozenTarget) -> Callable[[np.ndarray], float]:
    """The graded likelihood of one point in JAX, compiled."""
    density = in_jax(target)
    compiled = jax.jit(lambda point: density.log_graded(point, HARDNESS))
    compiled(np.zeros(target.dim))
    return lambda point: float(compiled(point))


def _flat(cube: np.ndarray) -> float:
    """Log density of the prior at a point of the cube."""
    return 0.0 if np.all((cube >= 0) & (cube <= 1)) else -np.inf


def _inside(
    target: FrozenTarget,
    points: np.ndarray,
    log_weights: np.ndarray,
    error: float,
    cost: dict[str, float],
) -> Submission | None:
    """Draws of the graded likelihood as draws of the target: those outside weigh nothing. Where
    the error of the evidence is known, the weights of those inside add up to it."""
    inside = np.where(target.misfit(points) <= 1, log_weights, -np.inf)
    if not np.isfinite(inside).any():
        return None
    stated: dict[str, Any] = {name: np.array(value) for name, value in cost.items()}
    if np.isfinite(error):
        stated["log_evidence"] = np.logaddexp.reduce(inside)
        stated["log_evidence_se"] = np.array(error)
    return submit(target, points=points, log_weights=inside, where="the draws", **stated)
