"""Parallel tempering of another library on a frozen target, as it comes: reddemcee."""

import itertools
from typing import Any

import numpy as np

from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark.external.entries import CLOCK, ExternalSampler, SamplerRun
from poseterior.inference.benchmark.external.graded import graded, inside
from poseterior.inference.benchmark.forms import SamplerTarget

TEMPERATURES = 10
WALKERS_PER_DIM = 4
"""Walkers of a temperature, as a multiple of the dimension."""
SWEEP_STEPS = 50
"""Steps between two looks at the clock."""
BURN_IN = 0.25


def reddemcee(target: SamplerTarget, seed: int, allowance: Allowance) -> SamplerRun | None:
    """reddemcee's adaptive parallel tempering, everything as it comes, in the cube."""
    from reddemcee import PTSampler

    np.random.seed(seed)  # noqa: NPY002 — the global state is what it begins with
    density = graded(target)
    counted = itertools.count(1)

    def log_likelihood(cube: np.ndarray) -> float:
        next(counted)
        return density(target.prior_transform(cube)) if _flat(cube) == 0 else -np.inf

    walkers = WALKERS_PER_DIM * target.dim
    sampler = PTSampler(walkers, target.dim, log_likelihood, _flat, ntemps=TEMPERATURES)
    state: Any = np.random.default_rng(seed).uniform(size=(TEMPERATURES, walkers, target.dim))
    started = CLOCK()
    evaluations = 0
    while allowance.allows(evaluations, CLOCK() - started):
        state = sampler.run_mcmc(state, nsweeps=SWEEP_STEPS, progress=False)
        evaluations = next(counted)
    seconds = CLOCK() - started
    cold = np.asarray(sampler.get_chain())[0]
    kept = cold[int(BURN_IN * len(cold)) :]
    # One walker's path after the other.
    points = target.prior_transform(np.moveaxis(kept, 1, 0).reshape(-1, target.dim))
    cost = {"evaluations": evaluations, "seconds": seconds}
    submission = inside(target, points, np.zeros(len(points)), np.nan, cost)
    return None if submission is None else SamplerRun(submission, kept=1 - BURN_IN)


def _flat(cube: np.ndarray) -> float:
    """Log density of the prior at a point of the cube."""
    return 0.0 if np.all((cube >= 0) & (cube <= 1)) else -np.inf


REDDEMCEE = ExternalSampler(
    reddemcee,
    "reddemcee's parallel tempering, ten temperatures",
    needs="reddemcee",
    install=".[external]",
)
