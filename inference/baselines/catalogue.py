"""The table of baselines, the two starts, and a baseline's draws as a DataTree: what
`inference.sample` needs of them.

A start "dispersed" over the exact posterior flatters, because the walkers are where they should be
before the first step; a start in "one flip" (the commonest pattern of limbs towards and away from
the camera) shows what a sampler finds by itself."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import xarray as xr

from inference.baselines.chains import CAPACITY
from inference.baselines.ensemble import ENSEMBLES
from inference.baselines.hamiltonian import GRADIENTS
from inference.baselines.metropolis import WALKS
from inference.baselines.nested import NESTED
from inference.baselines.run import Allowance, Baseline, Progress, Run, check_packages, run
from inference.baselines.target import Target
from inference.baselines.tempering import TEMPERINGS
from inference.joined import CHAINED
from inference.results import Result, RootDraws, build_tree, key_words
from inference.studies.flips import away, codes
from probmodel.failures import BadInput
from probmodel.pose import Pose
from probmodel.posterior import Posterior

BASELINES: dict[str, Baseline] = {**ENSEMBLES, **GRADIENTS, **WALKS, **TEMPERINGS, **NESTED}
"""Every baseline by its name."""
DISPERSED, ONE_FLIP = "dispersed", "one flip"
STARTS = (DISPERSED, ONE_FLIP)
STARTING = 1000
"""Exact draws from which a baseline is started where nothing else is said."""


def starting_points(target: Target, exact: xr.DataTree, start: str) -> np.ndarray:
    """Points `(n, d)` of R^d from the exact draws of a tree with one candidate. Raises `BadInput`
    on an unknown start."""
    if start not in STARTS:
        raise BadInput(f"there is no start {start!r}; choose one of {', '.join(STARTS)}")
    posterior = exact["posterior"]
    joints, length = posterior.joints.values[0], posterior.bone_length.values[0]
    points = target.points_of(target.model.pose_of(joints, length))
    if start == DISPERSED:
        return points
    flips = codes(away(posterior.joints.values[0]))
    found, counts = np.unique(flips, return_counts=True)
    return points[flips == found[np.argmax(counts)]]


def sample_baseline(
    posterior: Posterior,
    exact: Callable[..., Result],
    *,
    key: jax.Array,
    sampler: str,
    num_samples: int,
    max_evaluations: int,
    progress: Progress | None,
) -> Result:
    """At least `num_samples` draws of a baseline, as many in every chain, started in draws of
    `exact(num_samples=…)`. They are not independent, and not exact: `inference.studies.comparison`
    says how good they are. Raises as `Target.of`, and `BadInput` where chains are asked for more
    than they keep."""
    target, baseline = Target.of(posterior), BASELINES[sampler]
    check_packages(sampler, baseline)
    if baseline.starts and num_samples > CAPACITY:
        raise BadInput(
            f"{sampler} keeps {CAPACITY:,} draws at most, spread over its whole run, not"
            f" {num_samples:,}; ask for fewer"
        )
    starts = (
        starting_points(target, exact(num_samples=STARTING).tree, DISPERSED)
        if baseline.starts
        else None
    )
    done = run(
        baseline,
        sampler,
        target,
        key=key,
        starts=starts,
        num_samples=num_samples,
        allowance=Allowance(evaluations=max_evaluations),
        progress=progress,
    )
    return Result(
        baseline_tree(posterior, _thinned(done, num_samples), key), done.status, done.sentence
    )


def _thinned(done: Run, number: int) -> Run:
    """The run with draws left out evenly, until a few more than `number` are left."""
    chains, draws = done.poses.length.shape[:2]
    rows = np.unique(
        np.linspace(0, draws - 1, min(draws, -(-number // max(chains, 1)))).astype(int)
    )
    return dataclasses.replace(done, poses=jax.tree.map(lambda leaf: leaf[:, rows], done.poses))


def baseline_tree(posterior: Posterior, run: Run, key: jax.Array) -> xr.DataTree:
    """The DataTree of the contract, with a baseline's chains; the posterior has the one root that
    it drew under."""
    chains, draws = run.poses.length.shape[:2]
    flat = Pose(*(np.asarray(part).reshape(chains * draws, *part.shape[2:]) for part in run.poses))
    part = RootDraws(flat, run.log_evidence, run.log_evidence_se, 1.0)
    attributes: dict[str, Any] = {
        "sampler": run.sampler,
        "seed": key_words(key),
        "num_proposals": run.cost.num_proposals,
        "acceptance_rate": run.cost.acceptance_rate,
        "log_evidence": run.log_evidence,
        "log_evidence_se": run.log_evidence_se,
        "wall_time_s": run.cost.wall_time,
        "status": run.status,
        **{f"info_{name}": value for name, value in run.info.items()},
    }
    tree = build_tree(posterior, [part], attributes, rng=None)
    for group in CHAINED:
        tree[group] = xr.DataTree(_chained(tree[group].to_dataset(), chains, draws))
    return tree


def _chained(flat: xr.Dataset, chains: int, draws: int) -> xr.Dataset:
    """One chain of `chains · draws` draws as the chains that it consists of."""
    found = {
        name: (
            variable.dims,
            np.asarray(variable).reshape(chains, draws, *variable.shape[2:]),
            variable.attrs,
        )
        for name, variable in flat.data_vars.items()
    }
    coords = {name: flat.coords[name] for name in flat.coords if name not in ("chain", "draw")}
    return xr.Dataset(
        found, coords={**coords, "chain": np.arange(chains), "draw": np.arange(draws)}
    )
