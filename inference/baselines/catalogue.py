"""The table of baselines, the two starts, and the sampler that each of them is. Those of `ROOTED`
draw torso and camera with the pose, too.

A start "dispersed" over the exact posterior flatters, because the walkers are where they should be
before the first step; a start in "one flip" (the commonest pattern of limbs towards and away from
the camera) shows what a sampler finds by itself."""

import dataclasses
from collections.abc import Iterator
from typing import Any

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
    Run,
    check_law,
    check_packages,
    run,
)
from poseterior.inference.baselines.target import Density, Target
from poseterior.inference.baselines.tempering import TEMPERINGS
from poseterior.inference.draws import (
    COMPLETE,
    OUT_OF_BUDGET,
    Draws,
    KnownRoots,
    Progress,
    Sampler,
    key_words,
)
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.importance.weighted import (
    FEWEST_EFFECTIVE,
    NUM_ROOTS,
    WeightedSampler,
)
from poseterior.inference.results import tree_of
from poseterior.inference.studies.flips import away, codes
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN

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


@dataclasses.dataclass(frozen=True)
class BaselineSampler(Sampler):
    """Draws of a baseline, as many in every chain, started in draws that are right. They are not
    independent, and not exact: `inference.studies.comparison` says how good they are. Under an
    uncertain root chains that are worth too few draws are no answer, and the status says so.

    Attributes
    ----------
    name, max_proposals
        As of a `Sampler`: one of `BASELINES`, or of `ROOTED` under an uncertain root.
    num_roots
        From how many weighted roots the draws are made that it is started in, under an uncertain
        root.
    """

    num_roots: int = NUM_ROOTS

    def _blocks(
        self,
        posterior: Posterior,
        key: jax.Array,
        number: int,
        block: int,
        progress: Progress | None,
    ) -> Iterator[Draws]:
        target, baseline = target_of(posterior), BASELINES[self.name]
        _check(self.name, number)
        check_law(self.name, baseline, posterior.likelihood.law)
        starts = self._starts(posterior, target, key) if baseline.starts else None
        done = run(
            baseline,
            self.name,
            target,
            key=key,
            starts=starts,
            num_samples=number,
            allowance=Allowance(evaluations=self.max_proposals),
            progress=progress,
        )
        draws = draws_of(posterior, target, _thinned(done, number), key)
        yield _judged(self, draws) if posterior.root_prior.name == UNCERTAIN else draws

    def _starts(self, posterior: Posterior, target: Density, key: jax.Array) -> np.ndarray:
        """Points of draws that are right. Raises `OutOfBudget` where there are none."""
        right: Sampler = ExactRejection()
        if posterior.root_prior.name == UNCERTAIN:
            right = WeightedSampler(num_roots=self.num_roots, max_proposals=self.max_proposals)
        draws = right.draw(posterior, jax.random.fold_in(key, 0), STARTING)
        if not len(draws):
            raise OutOfBudget(f"{self.name} has nowhere to start: {draws.sentence}")
        return target.points_at(draws.points, draws.poses)


def target_of(posterior: Posterior) -> Density:
    """The posterior on R^d. Raises `BadInput` where it has no coordinates to walk along."""
    if posterior.root_prior.name == CANDIDATES:
        return Target.of(posterior)
    # It needs NumPyro, and imports it.
    from poseterior.inference.baselines.rooted import RootedTarget

    return RootedTarget.of(posterior)


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


def draws_of(posterior: Posterior, target: Density, run: Run, key: jax.Array) -> Draws:
    """A run's chains as draws."""
    chains, number = run.poses.length.shape[:2]
    flat = run.points.reshape(chains * number, target.dim)
    points = target.roots(flat)
    draws = Draws(
        posterior,
        points=points,
        poses=Pose(*(np.asarray(part).reshape(-1, *part.shape[2:]) for part in run.poses)),
        faults=target.faults(jax.random.fold_in(key, 5), flat),
        known=_known(posterior, points, run, len(flat)),
        attributes={
            "sampler": run.sampler,
            "seed": key_words(key),
            "num_proposals": run.cost.num_proposals,
            "acceptance_rate": run.cost.acceptance_rate,
            "log_evidence": run.log_evidence,
            "log_evidence_se": run.log_evidence_se,
            "wall_time_s": run.cost.wall_time,
            "status": run.status,
            **{f"info_{name}": value for name, value in run.info.items()},
        },
        status=run.status,
        sentence=run.sentence,
        chains=chains,
    )
    if posterior.root_prior.name == CANDIDATES:
        return draws
    worth = {"num_roots": len(flat)} | _mixed(draws)
    return dataclasses.replace(draws, attributes=draws.attributes | worth)


def _known(posterior: Posterior, points: Any, run: Run, number: int) -> KnownRoots:
    """The one candidate with its evidence; or the roots of all draws, of which there is none."""
    if posterior.root_prior.name == CANDIDATES:
        evidence = run.log_evidence, run.log_evidence_se
        return KnownRoots(np.zeros(1, int), np.ones(1), lambda rows: evidence)
    return KnownRoots(points, np.full(number, 1 / max(number, 1)), lambda rows: (np.nan, np.nan))


def _judged(sampler: BaselineSampler, draws: Draws) -> Draws:
    """The draws, and whether they are worth enough."""
    started = {"starts": f"{STARTING} draws from {sampler.num_roots} weighted roots"}
    draws = dataclasses.replace(draws, attributes=draws.attributes | started)
    if draws.status != COMPLETE or draws.effective_roots >= FEWEST_EFFECTIVE:
        return draws
    sentence = (
        f"the draws of {sampler.name} for {draws.posterior.detection.where} are worth"
        f" {draws.effective_roots:.1f} independent ones, too few for an answer (at least"
        f" {FEWEST_EFFECTIVE}); ask for more draws, or take weighted-roots"
    )
    about = draws.attributes | {"status": OUT_OF_BUDGET}
    return dataclasses.replace(draws, status=OUT_OF_BUDGET, sentence=sentence, attributes=about)


def _mixed(draws: Draws) -> dict[str, float]:
    """How well chains mixed, in every coordinate of pose and root: `effective_roots` are the
    effective draws of the worst one, `rhat` is the largest."""
    from poseterior.inference.studies.comparison.mixing import mixing
    from poseterior.inference.studies.comparison.sample import read_sample

    if not len(draws):
        return {"effective_roots": 0.0, "rhat": np.nan}
    found = read_sample(tree_of(draws))
    mixed = mixing(found.values, found.flat.std(axis=0))
    known = not mixed.stuck and bool(np.isfinite(mixed.bulk).any())
    return {
        "effective_roots": mixed.worst if known else 1.0,
        "rhat": float(np.nanmax(mixed.rhat)) if known else np.nan,
    }
