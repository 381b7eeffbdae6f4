"""Weighted draws of a nested sampler (dynesty) of the two moons' posterior beside truths, as a file
that `poseterior coverage judge` reads.

    python examples/posteriors/nested.py two_moons_nested.npz

Needs dynesty."""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import dynesty
import numpy as np
from two_moons import NAMES, log_likelihood_moons, simulated

SEED = 50
INSTANCES = 100
LIVE_POINTS = 60
LEFT_OUT = 1e-2
"""Draws of less than this share of the largest weight are not written."""


def main(path: Path) -> None:
    """Samples every instance, and writes draws with their log weights; what a shorter run lacks
    weighs nothing."""
    rng = np.random.default_rng(SEED)
    truth, seen = simulated(INSTANCES, rng)
    runs = [_sampled(one, rng) for one in seen]
    most = max(len(weights) for _, weights in runs)
    draws = np.zeros((INSTANCES, most, 2), np.float32)
    log_weights = np.full((INSTANCES, most), -np.inf, np.float16)
    for row, (points, weights) in enumerate(runs):
        draws[row, : len(points)] = points
        log_weights[row, : len(points)] = weights
    made = {
        "seed": SEED,
        "live points": LIVE_POINTS,
        "versions": {one: version(one) for one in ("dynesty", "numpy")},
    }
    np.savez_compressed(
        path,
        draws=draws,
        truth=truth.astype(np.float32),
        names=np.array(NAMES),
        log_weights=log_weights,
        covariates=seen.astype(np.float32),
        covariate_names=np.array(["seen 0", "seen 1"]),
        made=np.array(json.dumps(made)),
    )


def _sampled(seen: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draws, and their log weights."""
    sampler = dynesty.NestedSampler(
        lambda point: float(log_likelihood_moons(point[None], seen)[0]),
        lambda unit: 2 * unit - 1,
        ndim=2,
        nlive=LIVE_POINTS,
        bootstrap=0,
        rstate=rng,
    )
    sampler.run_nested(print_progress=False)
    found = sampler.results
    log_weights = found.logwt - found.logwt.max()
    kept = log_weights > np.log(LEFT_OUT)
    return found.samples[kept], log_weights[kept]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
