"""Calibration under the model (`calibrate`) and coverage of real poses (`cover`): simulate or look,
draw, line up, again and again.

    tree = calibrate(model, "rejection", num_simulations=1000, out=Path("coverage.nc"))
    judge(tree["simulation"].to_dataset())          # verdict and p-values
    arviz_plots.plot_ecdf_pit(tree)                 # the ranks

    cases, source = read_cases(Path("recordings.npz"), frames=100)
    summary(cover(model, cases, estimator="zhou", source=source))

Every simulation has a seed of its own: a run that was stopped is resumed with the same bits, and so
is a longer one. With `out`, what was done is kept in blocks beside that file
(`inference.store.Store`)."""

import functools
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr

from poseterior.inference.draws import MAX_PROPOSALS
from poseterior.inference.estimators import estimate_torsos
from poseterior.inference.machines import HERE, Machines, in_threads
from poseterior.inference.results import provenance, save_tree
from poseterior.inference.sampler import MAKERS, MANY_ROOTS, WEIGHTED
from poseterior.inference.store import Block, Groups, Store, fill, locked
from poseterior.inference.studies.calibration import real
from poseterior.inference.studies.calibration.assess import Answer, Standing, assess
from poseterior.inference.studies.calibration.exclusions import exclusions
from poseterior.inference.studies.calibration.posteriors import (
    FromFile,
    Sampler,
    independent_roots,
    sampler_of,
)
from poseterior.inference.studies.calibration.quantities import QUANTITIES
from poseterior.inference.studies.calibration.record import (
    COVARIATES,
    case_columns,
    coverage_tree,
    seen_columns,
    standings_table,
)
from poseterior.inference.studies.calibration.simulations import (
    SIMULATIONS_PER_BLOCK,
    Instance,
    LensWindow,
    simulate,
)
from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.datasets import Case
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import require_root_prior
from poseterior.probmodel.root_priors import UNCERTAIN

NUM_SAMPLES = 1000
COMPARED_ESTIMATOR = "zhou"
"""The estimator whose pose is TARP's reference: it looks at every joint."""
SIMULATION_GROUP = "simulation"
Progress = Callable[[int, int], None]


def calibrate(
    model: PoseModel,
    sampler: str | Sampler | None = None,
    *,
    seed: int = 0,
    num_simulations: int = 1000,
    num_samples: int = NUM_SAMPLES,
    reference: str = COMPARED_ESTIMATOR,
    likelihood: Likelihood = PAPER,
    root: str = UNCERTAIN,
    num_roots: int = MANY_ROOTS,
    max_proposals: int = MAX_PROPOSALS,
    out: Path | None = None,
    machines: Machines = HERE,
    progress: Progress | None = None,
) -> xr.DataTree:
    """Poses of the prior, each seen once, and draws of a sampler's posterior for each.

    Parameters
    ----------
    model
        The prior of poses.
    sampler
        A name, a file of draws (`posteriors.sampler_of`), or a function; by default what
        `inference.sample` takes.
    seed
        Of simulations and draws.
    num_simulations, num_samples
        How many poses, and how many draws for each.
    reference
        The estimator of TARP's reference poses.
    likelihood
        How detections err, in simulations and posteriors.
    root, num_roots
        What torso and camera are in simulations and posteriors, and from how many roots draws are
        made where they are uncertain: of weighted ones as many draws, then, as are independent.
    max_proposals
        Most proposals for a simulation.
    out
        The file to write; an earlier run of the same settings there is resumed.
    machines
        Who does the work.
    progress
        Called with the number of simulations done, and of all of them.

    Returns
    -------
    DataTree
        Ranks of the truth among the draws, by quantity, and what the tests need besides.

    Raises
    ------
    BadInput
        Where the sampler is not one, its draws have other dimensions, `out` holds another run, or
        another process is writing to it.
    """
    require_some(num_simulations, "simulations")
    sampler = _named(sampler, root)
    if sampler == WEIGHTED:
        draw = independent_roots(model, num_samples, num_roots, max_proposals=max_proposals)
    else:
        draw = _sampler(sampler, model, num_samples, max_proposals, root, num_roots)
    if model.lens is not None:
        draw = functools.partial(_within, LensWindow.of(model.lens), draw)
    settings = {
        **_asked(sampler, draw),
        **_common(model, seed, num_samples, likelihood, max_proposals),
        "study": "calibration",
        **_rooted(root, num_roots),
        "reference": reference,
        "quantities": len(QUANTITIES),
    }
    starts = range(0, num_simulations, SIMULATIONS_PER_BLOCK)
    parts = [range(num_simulations)[first : first + SIMULATIONS_PER_BLOCK] for first in starts]
    blocks = [
        Block(number, f"simulations {some[0]} to {some[-1]}", {}, len(some), some)
        for number, some in enumerate(parts)
    ]
    task = _Simulated(model, draw, seed, reference, likelihood, root)
    return _run(task, blocks, settings, out, machines, progress)


def cover(
    model: PoseModel,
    cases: Sequence[Case],
    *,
    estimator: str = real.TRUE,
    sampler: str | Sampler | None = None,
    seed: int = 0,
    num_samples: int = real.NUM_SAMPLES,
    likelihood: Likelihood = PAPER,
    root: str = UNCERTAIN,
    num_roots: int = MANY_ROOTS,
    max_proposals: int = real.INSTANCE_PROPOSALS,
    source: Mapping[str, Any] | None = None,
    out: Path | None = None,
    machines: Machines = HERE,
    progress: Progress | None = None,
) -> xr.DataTree:
    """How the posteriors of real poses stand to the truth, and why some exclude it; `summary` of
    `calibration.coverage` reads the tree.

    Parameters
    ----------
    model
        The prior of poses.
    cases
        Poses whose truth is known, with their detections (`real.read_cases`).
    estimator
        Whose torso and camera are given: an estimator's, or the true ones. Nobody's where the root
        is uncertain: then truths are excluded by what the model itself holds impossible.
    sampler, seed, num_samples, likelihood
        As in `calibrate`.
    root, num_roots
        What torso and camera are in the posteriors, and from how many roots draws are made where
        they are uncertain.
    max_proposals
        As in `calibrate`.
    source
        What the tree shall say of where the cases come from.
    out, machines, progress
        As in `calibrate`.

    Returns
    -------
    DataTree
        Ranks and distances, case by case.

    Raises
    ------
    BadInput
        As `calibrate`, on an unknown estimator, and on one where the root is uncertain.
    """
    if not cases:
        raise BadInput("there are no poses to cover; give at least one")
    if root == UNCERTAIN and estimator != real.TRUE:
        raise BadInput(
            f"where the root is uncertain nobody's torso and camera are given; leave the estimator"
            f" {estimator} out"
        )
    sampler = _named(sampler, root)
    draw = _sampler(sampler, model, num_samples, max_proposals, root, num_roots)
    settings = {
        **_asked(sampler, draw),
        **_common(model, seed, num_samples, likelihood, max_proposals),
        "study": "coverage of real poses",
        "estimator": estimator,
        **_rooted(root, num_roots),
        "poses": len(cases),
        **(source or {}),
    }
    blocks = []
    for number, first in enumerate(range(0, len(cases), SIMULATIONS_PER_BLOCK)):
        some = cases[first : first + SIMULATIONS_PER_BLOCK]
        words = f"poses {first} to {first + len(some) - 1}"
        made_of = {"poses": _fingerprint(some)}
        blocks.append(Block(number, words, made_of, len(some), (first, some)))
    task = _Covered(model, draw, seed, estimator, likelihood, root)
    return _run(task, blocks, settings, out, machines, progress)


@dataclass(frozen=True)
class _Simulated:
    """The task of a block of simulations, of which it is told the numbers."""

    model: PoseModel
    draw: Sampler
    seed: int
    reference: str
    likelihood: Likelihood
    root: str

    def __call__(self, numbers: range) -> Groups:
        some = simulate(
            self.model,
            self.seed,
            numbers.start,
            len(numbers),
            likelihood=self.likelihood,
            root=self.root,
        )
        poses = references(some, self.reference)
        found = stand(
            self.draw,
            some,
            self.seed,
            numbers.start,
            model=self.model,
            poses=poses,
            limits=self.model.limits,
        )
        seen = seen_columns([instance.frame.detection for instance in some])
        return {SIMULATION_GROUP: standings_table(found, numbers.start, seen)}


@dataclass(frozen=True)
class _Covered:
    """The task of a block of real poses, of which it is told the number of the first."""

    model: PoseModel
    draw: Sampler
    seed: int
    estimator: str
    likelihood: Likelihood
    root: str

    def __call__(self, block: tuple[int, Sequence[Case]]) -> Groups:
        first, cases = block
        known = real.instances(cases, self.model, self.estimator, likelihood=self.likelihood)
        found = stand(self.draw, known, self.seed, first, limits=self.model.limits)
        reasons = exclusions(self.model, cases, known, self.root)
        return {SIMULATION_GROUP: standings_table(found, first, case_columns(cases, reasons))}


def stand(
    draw: Sampler,
    instances: Sequence[Instance],
    seed: int,
    first: int = 0,
    *,
    model: PoseModel | None = None,
    poses: Iterable[np.ndarray | None] | None = None,
    limits: AnatomicalLimits | None = None,
) -> list[Standing]:
    """The standings of instances in a row, numbered from `first`; `model`, reference `poses` and
    `limits` as in `assess`."""

    def one(index: int, instance: Instance, pose: np.ndarray | None) -> Standing:
        answer = draw(index, instance, jax.random.fold_in(jax.random.key(seed), index))
        rng = np.random.default_rng([seed, index, 1])
        return assess(instance, answer, rng, model=model, reference=pose, limits=limits)

    numbers = range(first, first + len(instances))
    return in_threads(one, numbers, instances, poses or [None] * len(instances))


def references(instances: Sequence[Instance], estimator: str) -> list[np.ndarray]:
    """The estimator's poses `(15, 3)` in the body units of each instance; they depend on what was
    seen alone."""
    frames = estimate_torsos(
        [instance.frame.detection for instance in instances], estimator, num_candidates=1
    )
    found = []
    for instance, frame in zip(instances, frames, strict=True):
        assert frame.pose is not None
        unit = float(frame.best.camera.scale) / float(instance.frame.best.camera.scale)
        found.append(frame.pose * unit)
    return found


def _run(
    task: Callable[[Any], Groups],
    blocks: Sequence[Block],
    settings: Mapping[str, Any],
    out: Path | None,
    machines: Machines,
    progress: Progress | None,
) -> xr.DataTree:
    """The tree of all blocks, kept beside `out` where that is given, and written to it."""
    found: dict[int, xr.Dataset] = {}
    done = 0
    wanted = sum(block.size for block in blocks)

    def take(block: Block, groups: Groups) -> None:
        nonlocal done
        found[block.number] = groups[SIMULATION_GROUP].isel(simulation=slice(block.size))
        done += block.size
        if progress:
            progress(done, wanted)

    def tree() -> xr.DataTree:
        table = xr.concat([found[block.number] for block in blocks], dim="simulation")
        return coverage_tree(table, dict(settings))

    if out is None:
        fill(None, machines, task, blocks, take)
        return tree()
    folder = out.with_suffix(".blocks")
    with locked(folder):
        fill(Store.begin(folder, settings), machines, task, blocks, take)
        save_tree(tree(), out)
    return tree()


def _named(sampler: str | Sampler | None, root: str) -> str | Sampler:
    require_root_prior(root)
    return next(iter(MAKERS[root])) if sampler is None else sampler


def _sampler(
    sampler: str | Sampler,
    model: PoseModel,
    number: int,
    budget: int,
    root: str,
    num_roots: int,
) -> Sampler:
    if isinstance(sampler, str):
        return sampler_of(
            sampler, model, number, max_proposals=budget, root=root, num_roots=num_roots
        )
    return sampler


def _within(
    window: LensWindow, draw: Sampler, index: int, instance: Instance, key: jax.Array
) -> Answer:
    """Of a posterior's draws those in the window in which the truth was drawn."""
    answer = draw(index, instance, key)
    if answer.points is None:
        return answer
    held = window.holds(answer.points)
    return answer._replace(joints=answer.joints[held], points=answer.points.take(held))


def _rooted(root: str, num_roots: int) -> dict[str, Any]:
    return {"root": root} | ({"num_roots": num_roots} if root == UNCERTAIN else {})


def _asked(sampler: str | Sampler, draw: Sampler) -> dict[str, Any]:
    """Who draws; draws of a file are known by their content."""
    name = sampler if isinstance(sampler, str) else getattr(sampler, "__name__", "a function")
    return {"sampler": name} | ({"draws": draw.sha256} if isinstance(draw, FromFile) else {})


def _common(
    model: PoseModel, seed: int, num_samples: int, likelihood: Likelihood, max_proposals: int
) -> dict[str, Any]:
    """What both studies are asked for besides."""
    return {
        "seed": seed,
        "num_samples": num_samples,
        "likelihood": f"{likelihood.words} {likelihood.sha256}",
        "max_proposals": max_proposals,
        "measured": len(MEASURES),
        "covariates": len(COVARIATES),
        **provenance(model),
    }


def _fingerprint(cases: Sequence[Case]) -> str:
    digest = hashlib.sha256()
    for case in cases:
        digest.update(f"{case.number} {case.recording}".encode("utf-8", "backslashreplace"))
        for array in (
            case.pose,
            case.detection.keypoints,
            case.detection.score,
            case.scale,
            case.translation,
            *(case.lens or ()),
        ):
            digest.update(np.ascontiguousarray(array, "<f8").data)
    return digest.hexdigest()
