"""The one face of all samplers: `sample(model, frame, sampler=…, key=…, num_samples=…)` →
`Result`."""

import functools
import time

import jax

from inference.baselines.catalogue import BASELINES, sample_baseline
from inference.exact.mixture import MAX_PROPOSALS, PROPOSALS, Progress, draw_mixture
from inference.results import Result, build_tree
from probmodel.failures import BadInput
from probmodel.model import PoseModel
from probmodel.posterior import Estimate

SAMPLERS = (*PROPOSALS, *BASELINES)
"""Every sampler by its name: exact rejection first, then the baselines."""


def sample(
    model: PoseModel,
    frame: Estimate,
    *,
    key: jax.Array,
    sampler: str = "rejection",
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> Result:
    """Draws from the posterior of a detection, the mixture over its candidates.

    Parameters
    ----------
    model : the prior of poses.
    frame : the detection with its candidates, as `estimate_torso` gives it.
    key : of all draws: the same key, the same draws.
    sampler : one of `SAMPLERS`. Exact rejection draws independently from the posterior itself; a
        baseline draws chains under one candidate, started in exact draws.
    num_samples : how many draws.
    max_proposals : most proposals, or evaluations of the density. Where they end first, or where no
        pose is possible, the result says so in `status` and `sentence`, and holds what there is.
    progress : called now and then with the draws made and wanted.

    Raises
    ------
    BadInput
        On an unknown sampler, or a number of samples below one.
    """
    if sampler not in PROPOSALS and sampler not in BASELINES:
        raise BadInput(f"there is no sampler {sampler!r}; choose one of {', '.join(SAMPLERS)}")
    posterior = frame.posterior(model)
    if sampler in BASELINES and num_samples > 0:
        return sample_baseline(
            posterior,
            functools.partial(sample, model, frame, key=jax.random.fold_in(key, 0)),
            key=key,
            sampler=sampler,
            num_samples=num_samples,
            max_evaluations=max_proposals,
            progress=progress,
        )
    started = time.perf_counter()
    mixture = draw_mixture(
        posterior,
        key=key,
        sampler=sampler,
        num_samples=num_samples,
        max_proposals=max_proposals,
        progress=progress,
    )
    attributes = {
        **mixture.attributes,
        "wall_time_s": time.perf_counter() - started,
        "status": mixture.status,
    }
    tree = build_tree(posterior, mixture.parts, attributes, mixture.rng)
    return Result(tree, mixture.status, mixture.sentence)
