"""Nested samplers of other libraries on a frozen target, as they come: dynesty and UltraNest."""

import numpy as np

from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark.external.entries import CLOCK, ExternalSampler, SamplerRun
from poseterior.inference.benchmark.external.graded import HARDNESS, graded, inside
from poseterior.inference.benchmark.forms import SamplerTarget


def dynesty(target: SamplerTarget, seed: int, allowance: Allowance) -> SamplerRun | None:
    """dynesty's static sampler, everything as it comes; one point at a time, in JAX."""
    import dynesty as package

    rng = np.random.default_rng(seed)
    log_likelihood = graded(target)
    started = CLOCK()
    sampler = package.NestedSampler(log_likelihood, target.prior_transform, target.dim, rstate=rng)
    for _ in sampler.sample(add_live=False):
        if not allowance.allows(sampler.ncall, CLOCK() - started):
            break
    for _ in sampler.add_live_points():
        pass
    found = sampler.results
    seconds = CLOCK() - started
    log_weights = np.asarray(found.logwt)
    cost = {"evaluations": int(np.sum(found.ncall)), "seconds": seconds}
    error = float(found.logzerr[-1])
    submission = inside(target, np.asarray(found.samples), log_weights, error, cost)
    return None if submission is None else SamplerRun(submission)


class _Spent(Exception):
    """Raised within UltraNest, which has no limit of its own to the time it takes."""


def ultranest(target: SamplerTarget, seed: int, allowance: Allowance) -> SamplerRun | None:
    """UltraNest's reactive sampler, everything as it comes; many points at a time, in NumPy. It has
    no draws before it is through."""
    from ultranest import ReactiveNestedSampler

    np.random.seed(seed)  # noqa: NPY002 — the global state is what it draws from
    started = CLOCK()
    evaluations = 0

    def log_likelihood(cube: np.ndarray) -> np.ndarray:
        nonlocal evaluations
        if not allowance.allows(evaluations, CLOCK() - started):
            raise _Spent
        evaluations += len(cube)
        return target.log_graded(target.prior_transform(cube), HARDNESS)

    names = list(target.coordinates)
    try:
        sampler = ReactiveNestedSampler(names, log_likelihood, vectorized=True)
        found = sampler.run(show_status=False, viz_callback=False)
    except _Spent:
        return None
    weighted = found["weighted_samples"]
    with np.errstate(divide="ignore"):
        log_weights = np.log(weighted["weights"]) + found["logz"]
    points = target.prior_transform(np.asarray(weighted["upoints"]))
    cost = {"evaluations": evaluations, "seconds": CLOCK() - started}
    submission = inside(target, points, log_weights, float(found["logzerr"]), cost)
    return None if submission is None else SamplerRun(submission)


DYNESTY = ExternalSampler(
    dynesty,
    "dynesty's static sampler, 500 live points",
    needs="dynesty",
    install=".[external]",
)
ULTRANEST = ExternalSampler(
    ultranest,
    "UltraNest's reactive sampler, MLFriends, vectorised",
    needs="ultranest",
    install=".[ultranest]",
)
