"""The lines of a contest: what a sampler drew, from one start, judged by exact draws.

known = truth(model, frame, key=key)
entry, _ = enter_baseline(model, known, "emcee", start, key=key, allowance=Allowance(seconds=30))
"""

import dataclasses
import math
import time
import zlib
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior.inference.baselines.catalogue import (
    BASELINES,
    STARTS,
    draws_of,
    starting_points,
)
from poseterior.inference.baselines.run import Allowance, Clock, Run, check_packages, run
from poseterior.inference.baselines.target import Density, Target
from poseterior.inference.benchmark.external.entries import external_sampler, external_samplers
from poseterior.inference.benchmark.external.posterior import PosteriorTarget
from poseterior.inference.draws import COMPLETE
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.importance.weighted import APART
from poseterior.inference.results import Result, tree_of
from poseterior.inference.sampler import SAMPLERS, sample
from poseterior.inference.studies.comparison.cost import course
from poseterior.inference.studies.comparison.judge import judge
from poseterior.inference.studies.comparison.pace import pace
from poseterior.inference.studies.comparison.record import SHOWN_DRAWS, Entry
from poseterior.inference.studies.comparison.sample import Sample, read_sample, sample_of
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, Posterior
from poseterior.probmodel.root_priors import CANDIDATES

PILOT_DRAWS = 500
"""Draws by which the candidate is chosen."""
EXACT_REFERENCE = 20_000
"""Exact draws that the judge compares with."""
MOST_COMPARED = 20_000
"""Draws of a baseline that are judged, at most, taken evenly along its paths."""
ENDLESS = 1 << 40
"""More draws than any budget brings."""
Stage = Callable[[str], AbstractContextManager[Any]]
"""What is shown while something, said in words, is at work."""


@dataclass(frozen=True)
class Truth:
    """Exact draws under one candidate: the frame with that candidate, their tree and sample, and
    what they cost."""

    frame: Estimate
    tree: xr.DataTree
    sample: Sample

    @property
    def evidence(self) -> tuple[float, float]:
        """Log evidence and its standard error."""
        return self.tree.attrs["log_evidence"], self.tree.attrs["log_evidence_se"]


class Comparison(NamedTuple):
    """What `compare` found.

    Attributes
    ----------
    entries
        A line for every sampler and start.
    tree
        All of it as one tree (`record.comparison_tree`).
    """

    entries: list[Entry]
    tree: xr.DataTree


def truth_of(frame: Estimate, result: Result) -> Truth:
    """Exact draws to judge by. Raises `OutOfBudget` where they are not complete."""
    if result.status != COMPLETE:
        raise OutOfBudget(f"the exact draws to judge by are not complete: {result.sentence}")
    return Truth(frame, result.tree, read_sample(result.tree, "the exact draws"))


def place_of(out: Path | None, name: str, start: str) -> Path | None:
    """Where a baseline's run is kept; its folder is made."""
    if out is None:
        return None
    (out / "runs").mkdir(exist_ok=True)
    label = f"{name} {start}".strip().replace(" ", "-")
    return out / "runs" / f"{label}.npz"


def truth(
    model: PoseModel, frame: Estimate, *, key: jax.Array, number: int = EXACT_REFERENCE
) -> Truth:
    """Exact draws under the candidate with the largest weight. Raises `OutOfBudget` where there are
    none."""
    if len(frame.candidates) > 1:
        pilot = sample(
            model,
            frame,
            root=CANDIDATES,
            key=jax.random.fold_in(key, 0),
            num_samples=PILOT_DRAWS,
        )
        best = int(np.argmax(pilot.tree["constant_data"].weight.values))
        frame = dataclasses.replace(frame, candidates=(frame.candidates[best],))
    result = sample(
        model, frame, root=CANDIDATES, key=jax.random.fold_in(key, 1), num_samples=number
    )
    return truth_of(frame, result)


def check_names(names: Sequence[str]) -> None:
    """Raises `BadInput` on a sampler that does not exist or whose package is missing, before any
    work is done."""
    known = (*SAMPLERS, *external_samplers())
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise BadInput(
            f"there is no sampler {unknown[0] if unknown else ''!r}; choose from {', '.join(known)}"
        )
    for name in names:
        if name in BASELINES:
            check_packages(name, BASELINES[name])
        elif name not in SAMPLERS:
            external_sampler(name).require(name)


def number_of(name: str) -> int:
    """By which a sampler's key is made, whoever else there is."""
    return 1 + SAMPLERS.index(name) if name in SAMPLERS else zlib.crc32(name.encode())


def starts_of(name: str) -> tuple[str, ...]:
    """The starts that a sampler is run from; one without a name where it needs none."""
    return STARTS if name in BASELINES and BASELINES[name].starts else ("",)


def enter_exact(
    model: PoseModel,
    known: Truth,
    name: str,
    *,
    key: jax.Array,
    num_samples: int,
    clock: Clock = time.perf_counter,
) -> Entry:
    """A line of exact rejection, drawn anew with another key. It is drawn twice, the same: the
    first time everything is compiled, the second time the clock runs, as with baselines up to where
    draws are given names."""
    result = sample(
        model, known.frame, sampler=name, root=CANDIDATES, key=key, num_samples=num_samples
    )
    started = clock()
    ExactRejection(name).draw(known.frame.posterior(model, CANDIDATES), key, num_samples)
    seconds = clock() - started
    return enter_draws(known, name, result, (result.tree.attrs["num_proposals"], seconds))


def enter_draws(
    known: Truth, name: str, result: Result, cost: tuple[float, float], *, thinned: bool = False
) -> Entry:
    """A line of draws that needed no start, for so many proposals and seconds; where they are
    `thinned`, those that are not independent are left out."""
    attributes = result.tree.attrs
    evidence = attributes["log_evidence"], attributes["log_evidence_se"]
    if not result.num_draws:
        return Entry.without_draws(name, "", result.sentence, cost, evidence)
    found = read_sample(result.tree, f"the draws of {name}")
    if thinned:
        found = found.first(min(1.0, attributes["effective_roots"] / APART / found.num_draws))
    work = Work(*cost, 1.0, found.num_draws, 0)
    return entry_of(name, "", found, known, work=work, evidence=evidence, sentence=result.sentence)


def enter_external(
    model: PoseModel, known: Truth, name: str, *, key: jax.Array, allowance: Allowance
) -> Entry:
    """A line of an external sampler, begun anew at every call; where it brought no draws, or what
    cannot be any, its sentence says so."""
    target = PosteriorTarget.of(known.frame.posterior(model, CANDIDATES))
    seed = int(jax.random.randint(key, (), 0, 1 << 31))
    sentence = f"{name} brought no draws of {target.name}: the budget is too small; allow more"
    started = time.perf_counter()
    try:
        outcome = external_sampler(name).run(name, target, seed, allowance)
    except BadInput as error:
        outcome = None
        sentence = str(error)
    seconds = time.perf_counter() - started
    if outcome is None:
        return Entry.without_draws(name, "", sentence, (0, seconds))
    submission = outcome.submission
    points, steps = _thinned(submission.points, outcome.steps)
    poses = target.density.poses(key, points)
    found = sample_of(target.joints_of(poses), poses.length, f"the draws of {name}")
    cost = submission.evaluations, submission.seconds
    if not math.isfinite(cost[1]):
        cost = submission.evaluations, seconds
    work = Work(*cost, outcome.kept, steps, outcome.given)
    evidence = submission.log_evidence, submission.log_evidence_se
    return entry_of(name, "", found, known, work=work, evidence=evidence)


def _thinned(points: np.ndarray, steps: int) -> tuple[np.ndarray, int]:
    """At most about `MOST_COMPARED` draws of `(chain, draw, d)`, taken evenly along every path of
    so many steps; and how many steps of a path are left."""
    chains, draws, dim = points.shape
    length = steps if steps > 1 else draws
    paths = points.reshape(chains, -1, length, dim)[
        :, :, :: max(1, chains * draws // MOST_COMPARED)
    ]
    return paths.reshape(chains, -1, dim), paths.shape[2] if steps > 1 else 1


def enter_baseline(
    model: PoseModel,
    known: Truth,
    name: str,
    start: str,
    **settings: Any,
) -> tuple[Entry, xr.DataTree | None]:
    """A line of a baseline, and its draws, or none where its budget brought none; `settings` are
    those of `baselines.run.run`."""
    posterior = known.frame.posterior(model, CANDIDATES)
    return enter_chains(posterior, Target.of(posterior), known, name, start, **settings)


def enter_chains(
    posterior: Posterior,
    target: Density,
    known: Truth,
    name: str,
    start: str,
    *,
    key: jax.Array,
    **settings: Any,
) -> tuple[Entry, xr.DataTree | None]:
    """As `enter_baseline`, on the target of any posterior."""
    done = run(
        BASELINES[name],
        name,
        target,
        key=key,
        starts=starting_points(target, known.tree, start) if start else None,
        most=MOST_COMPARED,
        **settings,
    )
    evidence = done.log_evidence, done.log_evidence_se
    if not done.num_draws:
        cost = done.cost.num_proposals, done.cost.wall_time
        return Entry.without_draws(name, start, done.sentence, cost, evidence), None
    tree = tree_of(draws_of(posterior, target, done, key))
    found = read_sample(tree, f"the draws of {name}")
    work = _work_of(done, BASELINES[name].starts)
    return entry_of(name, start, found, known, work=work, evidence=evidence), tree


class Work(NamedTuple):
    """What draws cost: evaluations (NaN where nobody says), seconds, the share `kept` of them that
    brought draws; `steps`, how many draws in a row are one path; `given`, the exact draws that the
    start was given."""

    evaluations: float
    seconds: float
    kept: float
    steps: int
    given: int


def _work_of(done: Run, given: int) -> Work:
    """Of a baseline's run."""
    info = done.info
    return Work(
        done.cost.num_proposals,
        done.cost.wall_time,
        info.get("kept", 1.0),
        int(info["steps"]),
        given,
    )


def entry_of(
    name: str,
    start: str,
    found: Sample,
    known: Truth,
    *,
    work: Work,
    evidence: tuple[float, float],
    sentence: str = "",
) -> Entry:
    """The line of draws `found`: judged by the truth, with their course and pace; a `sentence` says
    more than the judgement's."""
    verdict = judge(found, known.sample, evidence=evidence, exact_evidence=known.evidence)
    way = course(found, known.sample, work.seconds, work.kept)
    speed = pace(
        found, known.sample, effective=verdict.mixing.worst, given=work.given, steps=work.steps
    )
    shown = evidence if math.isfinite(evidence[0]) else (math.nan, math.nan)
    some = found.flat[:: max(1, found.num_draws // SHOWN_DRAWS)][:SHOWN_DRAWS]
    return Entry(
        sampler=name,
        start=start,
        judgement=verdict,
        sentence=sentence or verdict.sentence,
        num_draws=found.num_draws,
        evaluations=work.evaluations,
        seconds=work.seconds,
        course=way,
        pace=speed,
        log_evidence=shown[0],
        log_evidence_se=shown[1],
        draws=some,
    )
