"""Calibration under the model: simulate, draw, line up, again and again; what `poseterior coverage`
runs.

tree = calibrate(model, "rejection", seed=0, num_simulations=1000, out=Path("coverage.nc"))
judge(tree["simulation"].to_dataset())          # verdict and p-values
arviz_plots.plot_ecdf_pit(tree)                 # the ranks

Every simulation has a seed of its own: a run that was stopped goes on to the same bits, and so does
a longer one. Memory holds one block of simulations."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from inference.exact.mixture import MAX_PROPOSALS
from inference.results import versions
from inference.roots import estimate_torsos
from inference.studies.calibration.assess import Standing, assess
from inference.studies.calibration.posteriors import Sampler, sampler_of
from inference.studies.calibration.quantities import QUANTITIES
from inference.studies.calibration.record import resume, save, standings_tree
from inference.studies.calibration.simulations import BLOCK, Instance, simulate
from probmodel.failures import BadInput
from probmodel.model import PoseModel

NUM_SAMPLES = 1000
REFERENCE = "zhou"
"""The estimator whose pose is TARP's reference: it looks at every joint."""
Progress = Callable[[int, int], None]


def calibrate(
    model: PoseModel,
    sampler: str | Sampler,
    *,
    seed: int = 0,
    num_simulations: int = 1000,
    num_samples: int = NUM_SAMPLES,
    reference: str = REFERENCE,
    factor: float = 0.25,
    max_proposals: int = MAX_PROPOSALS,
    out: Path | None = None,
    progress: Progress | None = None,
) -> xr.DataTree:
    """`num_simulations` poses of the prior, each seen once, and `num_samples` draws of a sampler's
    posterior for each.

    `sampler`: a name, a file of draws (`posteriors.sampler_of`), or a function. `reference` names
    the estimator of TARP's reference poses. With `out`, the tree is written after every block, and
    an earlier run of the same settings there is continued. Raises `BadInput` where the sampler is
    not one, its draws have other dimensions, or `out` holds another run."""
    if num_simulations < 1:
        raise BadInput(f"the number of simulations must be at least 1, not {num_simulations}")
    draw = (
        sampler_of(sampler, model, num_samples, max_proposals=max_proposals)
        if isinstance(sampler, str)
        else sampler
    )
    settings = {
        "sampler": (
            sampler if isinstance(sampler, str) else getattr(sampler, "__name__", "a function")
        ),
        "seed": seed,
        "num_samples": num_samples,
        "reference": reference,
        "factor": factor,
        "max_proposals": max_proposals,
        "quantities": len(QUANTITIES),
        "limits": f"{model.limits.name} {model.limits.sha256}",
        "measures": f"upper {model.upper}, lower {model.lower}",
        "versions": versions(),
    }
    standings = [] if out is None else resume(out, settings)[:num_simulations]
    standings = (
        standings[: len(standings) // BLOCK * BLOCK]
        if len(standings) < num_simulations
        else standings
    )
    tree = standings_tree(standings, settings) if standings else None
    while len(standings) < num_simulations:
        first = len(standings)
        some = simulate(model, seed, first, min(BLOCK, num_simulations - first), factor=factor)
        standings = standings + stand(model, draw, some, seed, first, reference)
        tree = standings_tree(standings, settings)
        if out is not None:
            save(tree, out)
        if progress:
            progress(len(standings), num_simulations)
    assert tree is not None
    return tree


def stand(
    model: PoseModel,
    draw: Sampler,
    instances: Sequence[Instance],
    seed: int,
    first: int,
    reference: str = REFERENCE,
) -> list[Standing]:
    """The standings of simulations in a row, numbered from `first`."""
    poses = references(instances, reference)

    def one(row: int) -> Standing:
        index = first + row
        key = jax.random.fold_in(jax.random.key(seed), index)
        posterior = draw(index, instances[row], key)
        rng = np.random.default_rng([seed, index, 1])
        return assess(instances[row], posterior, rng, model=model, reference=poses[row])

    with ThreadPoolExecutor(os.cpu_count()) as workers:
        return list(workers.map(one, range(len(instances))))


def references(instances: Sequence[Instance], estimator: str) -> np.ndarray:
    """`(n, 15, 3)`: the estimator's poses in the body units of each instance; they depend on what
    was seen alone."""
    frames = estimate_torsos(
        [instance.frame.detection for instance in instances], estimator, num_candidates=1
    )
    found = []
    for instance, frame in zip(instances, frames, strict=True):
        assert frame.pose is not None
        unit = float(frame.candidates[0].camera.scale) / float(
            instance.frame.candidates[0].camera.scale
        )
        found.append(frame.pose * unit)
    return np.stack(found)
