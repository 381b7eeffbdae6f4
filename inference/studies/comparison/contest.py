"""Several samplers on one frame, each from two starts, judged by exact draws.

found = compare_candidate(model, frame, ["rejection", "emcee"], seconds=30)
found.tree["summary"].to_dataframe()
"""

import contextlib
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
from poseterior.inference.baselines.run import Allowance, Clock, Run, check_law, check_packages, run
from poseterior.inference.baselines.target import Density, Target
from poseterior.inference.benchmark.external.entries import external_sampler, external_samplers
from poseterior.inference.benchmark.external.posterior import PosteriorTarget
from poseterior.inference.draws import COMPLETE
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.results import Result, save_tree, tree_of
from poseterior.inference.sampler import SAMPLERS, sample
from poseterior.inference.store import locked
from poseterior.inference.studies.comparison.cost import course
from poseterior.inference.studies.comparison.judge import judge
from poseterior.inference.studies.comparison.pace import pace
from poseterior.inference.studies.comparison.record import SHOWN_DRAWS, Entry, comparison_tree
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


def compare_candidate(
    model: PoseModel,
    frame: Estimate,
    samplers: Sequence[str],
    *,
    seed: int = 0,
    seconds: float | None = 30.0,
    max_evaluations: int | None = None,
    num_samples: int = 10_000,
    exact_draws: int = EXACT_REFERENCE,
    out: Path | None = None,
    stage: Stage = contextlib.nullcontext,
) -> Comparison:
    """Lets samplers draw from a frame's posterior, under the candidate with the largest weight, and
    judges each by exact draws.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates.
    samplers
        Names of `SAMPLERS`, and of `benchmark.external_samplers()`.
    seed
        Of all draws.
    seconds, max_evaluations
        What each baseline may spend from each of its starts; None: no limit.
    num_samples
        Draws of exact rejection as an entrant.
    exact_draws
        Draws that all are judged by.
    out
        A folder: `comparison.nc` is written there after every sampler, and what baselines have done
        is kept in `runs`, where the next call takes it up.
    stage
        Called with what is done next, in words; what it returns is entered meanwhile.

    Returns
    -------
    Comparison
        A line for every sampler and start.

    Raises
    ------
    BadInput
        On a sampler that does not exist, does not draw under the law of errors or whose package is
        missing, before any work is done; where `runs` holds another run, or another process is
        writing to `out`.
    OutOfBudget
        Where there are no exact draws.
    """
    check_names([*samplers])
    for name in {*samplers} & {*BASELINES}:
        check_law(name, BASELINES[name], frame.likelihood.law)
    allowance = Allowance(max_evaluations, seconds)
    key = jax.random.key(seed)
    with locked(out) if out else contextlib.nullcontext():
        with stage("exact draws"):
            known = truth(model, frame, key=jax.random.fold_in(key, 0), number=exact_draws)
        attributes = {
            "source": frame.detection.source,
            "person": frame.detection.person,
            "seed": seed,
            "seconds": math.inf if seconds is None else seconds,
            "exact_draws": known.sample.num_draws,
        }
        found = Comparison([], xr.DataTree())
        for name, start in [(one, start) for one in samplers for start in starts_of(one)]:
            # Its own key, whoever else is asked, so that runs can be taken up.
            own = jax.random.fold_in(key, _number_of(name))
            place = place_of(out, name, start)
            with stage(f"{name} {start}".strip()):
                if name in BASELINES:
                    entry, _ = enter_baseline(
                        model,
                        known,
                        name,
                        start,
                        key=own,
                        allowance=allowance,
                        num_samples=ENDLESS,
                        save_to=place,
                    )
                elif name in SAMPLERS:
                    entry = enter_exact(model, known, name, key=own, num_samples=num_samples)
                else:
                    entry = enter_external(model, known, name, key=own, allowance=allowance)
            entries = [*found.entries, entry]
            found = Comparison(entries, comparison_tree(entries, known.sample, attributes))
            if out:
                save_tree(found.tree, out / "comparison.nc")
    return found


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


def check_names(names: list[str]) -> None:
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


def _number_of(name: str) -> int:
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
    attributes = result.tree.attrs
    evidence = attributes["log_evidence"], attributes["log_evidence_se"]
    found = read_sample(result.tree, f"the draws of {name}")
    work = Work(attributes["num_proposals"], seconds, 1.0, found.num_draws, 0)
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
