"""The table of baselines, the two starts, and a baseline's draws as a DataTree: what
`inference.sample` needs of them. Those of `ROOTED` draw torso and camera with the pose, too.

A start "dispersed" over the exact posterior flatters, because the walkers are where they should be
before the first step; a start in "one flip" (the commonest pattern of limbs towards and away from
the camera) shows what a sampler finds by itself."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import xarray as xr

from poseterior.inference.baselines.chains import CAPACITY
from poseterior.inference.baselines.ensemble import ENSEMBLES
from poseterior.inference.baselines.hamiltonian import GRADIENTS
from poseterior.inference.baselines.metropolis import WALKS
from poseterior.inference.baselines.nested import NESTED
from poseterior.inference.baselines.run import (
    Allowance,
    Baseline,
    Progress,
    Run,
    check_law,
    check_packages,
    run,
)
from poseterior.inference.baselines.target import Density, Target
from poseterior.inference.baselines.tempering import TEMPERINGS
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.importance.tree import BASE_MEASURE, draw_columns, side_data, sides
from poseterior.inference.importance.weighted import FEWEST_EFFECTIVE, verdict, weigh_roots
from poseterior.inference.joined import CHAINED
from poseterior.inference.results import (
    COMPLETE,
    OUT_OF_BUDGET,
    UNCERTAIN,
    Result,
    RootDraws,
    assemble,
    build_tree,
    key_words,
)
from poseterior.inference.studies.flips import away, codes
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.uncertain import UncertainPosterior

if TYPE_CHECKING:
    from poseterior.inference.baselines.rooted import RootedTarget

BASELINES: dict[str, Baseline] = {**ENSEMBLES, **GRADIENTS, **WALKS, **TEMPERINGS, **NESTED}
"""Every baseline by its name."""
DISPERSED, ONE_FLIP = "dispersed", "one flip"
STARTS = (DISPERSED, ONE_FLIP)
STARTING = 1000
"""Exact draws from which a baseline is started where nothing else is said."""
ROOTED = (*ENSEMBLES, *WALKS)
"""Those that ask for no more than a `Density`, and can draw torso and camera with the pose: the
others need a prior that has a mass, or bring too few draws (NUTS, HMC)."""


def starting_points(target: Density, exact: xr.DataTree, start: str) -> np.ndarray:
    """Points `(n, d)` of R^d from the exact draws of a tree with one candidate. Raises `BadInput`
    on an unknown start."""
    if start not in STARTS:
        raise BadInput(f"there is no start {start!r}; choose one of {', '.join(STARTS)}")
    draws = exact["posterior"].to_dataset()
    points = target.points_in(draws)
    if start == DISPERSED:
        return points
    flips = codes(away(draws.joints.values[0]))
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
    says how good they are. Raises as `Target.of` and `check_law`, and `BadInput` where chains are
    asked for more than they keep."""
    target, baseline = Target.of(posterior), BASELINES[sampler]
    _check(sampler, num_samples)
    check_law(sampler, baseline, posterior.likelihood.law)
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


def sample_rooted(
    posterior: UncertainPosterior,
    *,
    key: jax.Array,
    sampler: str,
    num_samples: int,
    num_roots: int,
    max_proposals: int,
    progress: Progress | None,
) -> Result:
    """As `sample_baseline`, of torso, camera and pose, by one of `ROOTED`, started in draws from
    `num_roots` weighted roots. Where the chains are worth too few draws, the status says so. Raises
    as `RootedTarget.of` and `weigh_roots`, and `OutOfBudget` where there is nowhere to start."""
    from poseterior.inference.baselines.rooted import (
        RootedTarget,
    )  # it needs NumPyro, and imports it

    target = RootedTarget.of(posterior)
    _check(sampler, num_samples)
    root_key, draw_key = jax.random.split(jax.random.fold_in(key, 0))
    roots = weigh_roots(posterior, key=root_key, num_roots=num_roots, max_proposals=max_proposals)
    points, poses, _ = roots.draw(np.random.default_rng(words_of(draw_key)), STARTING)
    if not len(poses.length):
        raise OutOfBudget(f"{sampler} has nowhere to start: {verdict(roots)[1]}")
    done = run(
        BASELINES[sampler],
        sampler,
        target,
        key=key,
        starts=target.points_of(points, poses),
        num_samples=num_samples,
        allowance=Allowance(evaluations=max_proposals),
        progress=progress,
    )
    tree = rooted_tree(posterior, target, _thinned(done, num_samples), key)
    status, sentence = done.status, done.sentence
    if status == COMPLETE and tree.attrs["effective_roots"] < FEWEST_EFFECTIVE:
        status = tree.attrs["status"] = OUT_OF_BUDGET
        sentence = (
            f"the draws of {sampler} for {posterior.detection.where} are worth"
            f" {tree.attrs['effective_roots']:.1f} independent ones, too few for an answer (at"
            f" least {FEWEST_EFFECTIVE}); ask for more draws, or take weighted-roots"
        )
    tree.attrs["starts"] = f"{STARTING} draws from {len(roots.log_weight)} weighted roots"
    return Result(tree, status, sentence)


def _check(sampler: str, num_samples: int) -> None:
    """Raises `BadInput` where its package is missing, or chains are asked for more than they
    keep."""
    baseline = BASELINES[sampler]
    check_packages(sampler, baseline)
    if baseline.starts and num_samples > CAPACITY:
        raise BadInput(
            f"{sampler} keeps {CAPACITY:,} draws at most, spread over its whole run, not"
            f" {num_samples:,}; ask for fewer"
        )


def _thinned(done: Run, number: int) -> Run:
    """The run with draws left out evenly, until a few more than `number` are left."""
    chains, draws = done.poses.length.shape[:2]
    rows = np.unique(
        np.linspace(0, draws - 1, min(draws, -(-number // max(chains, 1)))).astype(int)
    )
    poses = jax.tree.map(lambda leaf: leaf[:, rows], done.poses)
    return dataclasses.replace(done, points=done.points[:, rows], poses=poses)


def baseline_tree(posterior: Posterior, run: Run, key: jax.Array) -> xr.DataTree:
    """The DataTree of the contract, with a baseline's chains; the posterior has the one root that
    it drew under."""
    part = RootDraws(_flat(run.poses), run.log_evidence, run.log_evidence_se, 1.0)
    tree = build_tree(posterior, [part], _attributes(run, key), rng=None)
    return _in_chains(tree, run)


def rooted_tree(
    posterior: UncertainPosterior, target: "RootedTarget", run: Run, key: jax.Array
) -> xr.DataTree:
    """The DataTree of an uncertain root, with a baseline's chains: a root for every draw.
    `effective_roots` are the effective draws of the worst coordinate, `rhat` is the largest."""
    poses = _flat(run.poses)
    number = len(poses.length)
    flat = run.points.reshape(number, target.dim)
    points = RootPoint(*(np.asarray(part) for part in target.roots(flat)))
    faults = target.faults(jax.random.fold_in(key, 5), flat)
    columns = draw_columns(posterior, points, poses, faults)
    columns["candidate"] = sides(posterior, points)
    constant = side_data(
        posterior, points, np.full(number, 1 / max(number, 1)), lambda rows: (np.nan, np.nan)
    )
    about = {
        "root": UNCERTAIN,
        "num_roots": number,
        "converged": int(all(one.converged for one in posterior.candidates)),
    }
    tree = assemble(posterior, columns, constant, BASE_MEASURE, about | _attributes(run, key))
    tree = _in_chains(tree, run)
    tree.attrs.update(_mixed(tree) if number else {"effective_roots": 0.0, "rhat": np.nan})
    return tree


def _mixed(tree: xr.DataTree) -> dict[str, float]:
    """How well chains mixed, in every coordinate of pose and root."""
    from poseterior.inference.studies.comparison.mixing import mixing
    from poseterior.inference.studies.comparison.sample import read_sample

    found = read_sample(tree)
    mixed = mixing(found.values, found.flat.std(axis=0))
    known = not mixed.stuck and bool(np.isfinite(mixed.bulk).any())
    return {
        "effective_roots": mixed.worst if known else 1.0,
        "rhat": float(np.nanmax(mixed.rhat)) if known else np.nan,
    }


def _flat(poses: Pose) -> Pose:
    """Poses of all chains, one after the other."""
    return Pose(*(np.asarray(part).reshape(-1, *part.shape[2:]) for part in poses))


def _attributes(run: Run, key: jax.Array) -> dict[str, Any]:
    return {
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


def _in_chains(tree: xr.DataTree, run: Run) -> xr.DataTree:
    """The tree of one chain with the chains of the run."""
    for group in CHAINED:
        chains = _chained(tree[group].to_dataset(), *run.poses.length.shape[:2])
        tree[group] = xr.DataTree(chains)
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
