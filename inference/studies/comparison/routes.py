"""Samplers of torso, camera and pose together, judged by rejection.

found = compare(model, frame)
found.tree["summary"].to_dataframe()
"""

import contextlib
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from poseterior.inference.baselines.catalogue import BASELINES, DISPERSED, ROOTED
from poseterior.inference.baselines.rooted import RootedTarget
from poseterior.inference.baselines.run import Allowance, check_packages
from poseterior.inference.importance.weighted import APART, NUM_ROOTS
from poseterior.inference.results import Result, save_tree
from poseterior.inference.sampler import (
    REJECTION,
    ROOTED_SAMPLERS,
    WEIGHTED,
    sample,
    sampler_of,
)
from poseterior.inference.store import locked
from poseterior.inference.studies.comparison import contest
from poseterior.inference.studies.comparison.contest import (
    ENDLESS,
    Comparison,
    Stage,
    Truth,
    Work,
    compare_candidate,
    enter_chains,
    entry_of,
    place_of,
    truth_of,
)
from poseterior.inference.studies.comparison.record import Entry, comparison_tree
from poseterior.inference.studies.comparison.sample import read_sample
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, require_root_prior
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN

ROUTE_REFERENCE = 1000
"""Draws by rejection that the judge compares with: some minutes."""


def compare(
    model: PoseModel,
    frame: Estimate,
    samplers: Sequence[str] | None = None,
    *,
    root: str = UNCERTAIN,
    num_roots: int = NUM_ROOTS,
    exact_draws: int | None = None,
    **settings: Any,
) -> Comparison:
    """Lets samplers draw from a frame's posterior, and judges each by exact draws.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates.
    samplers
        Those that draw under the root; by default weighted roots, or exact rejection.
    root
        One of `ROOT_PRIORS`: torso, camera and pose together, or the pose under the candidate with
        the largest weight.
    num_roots
        From how many roots weighted ones draw; of the pilot run of rejection.
    exact_draws
        Draws that all are judged by; by default as many as take some minutes at most.
    settings
        `seed`, `seconds`, `max_evaluations`, `num_samples`, `out`, `stage`, as `compare_candidate`
        takes them.

    Returns
    -------
    Comparison
        A line for every sampler.

    Raises
    ------
    BadInput, OutOfBudget
        As `compare_candidate` and `compare_routes`.
    """
    require_root_prior(root)
    if root == CANDIDATES:
        names = ("rejection",) if samplers is None else samplers
        number = contest.EXACT_REFERENCE if exact_draws is None else exact_draws
        return compare_candidate(model, frame, names, exact_draws=number, **settings)
    return compare_routes(
        model,
        frame,
        (WEIGHTED,) if samplers is None else samplers,
        num_roots=num_roots,
        exact_draws=ROUTE_REFERENCE if exact_draws is None else exact_draws,
        **settings,
    )


def compare_routes(
    model: PoseModel,
    frame: Estimate,
    samplers: Sequence[str] = (WEIGHTED,),
    *,
    seed: int = 0,
    seconds: float | None = 30.0,
    max_evaluations: int | None = None,
    num_samples: int = 10_000,
    num_roots: int = NUM_ROOTS,
    exact_draws: int = ROUTE_REFERENCE,
    out: Path | None = None,
    stage: Stage = contextlib.nullcontext,
) -> Comparison:
    """Lets samplers draw torso, camera and pose of a frame together, and judges each by rejection:
    a few dozen draws a second, which are independent.

    Parameters
    ----------
    model, frame
        As in `compare`.
    samplers
        Names of `ROOTED_SAMPLERS`.
    seed, seconds, max_evaluations, num_samples
        As in `compare_candidate`, but that baselines have one start, dispersed over the exact
        draws: of few draws with seven coordinates more, too few stand in one flip. Of weighted
        roots as many draws are judged as are independent.
    num_roots
        From how many roots weighted ones draw; of the pilot run of rejection.
    exact_draws
        Draws that all are judged by.
    out, stage
        As in `compare_candidate`.

    Returns
    -------
    Comparison
        A line for every sampler.

    Raises
    ------
    BadInput
        On a sampler that holds the root fixed, whose package is missing, and as `sample` does.
    OutOfBudget
        Where the exact draws are not complete.
    """
    check_routes(samplers)
    posterior = frame.posterior(model)
    allowance = Allowance(max_evaluations, seconds)
    # Before any work is done.
    target = RootedTarget.of(posterior) if {*samplers} & {*ROOTED} else None
    key = jax.random.key(seed)
    draw = functools.partial(sample, model, frame, root=UNCERTAIN, num_roots=num_roots)
    with locked(out) if out else contextlib.nullcontext():
        with stage("exact draws"):
            result = draw(
                key=jax.random.fold_in(key, 0), sampler=REJECTION, num_samples=exact_draws
            )
            known = truth_of(frame, result)
        attributes = {
            "source": frame.detection.source,
            "person": frame.detection.person,
            "seed": seed,
            "root": UNCERTAIN,
            "exact_draws": known.sample.num_draws,
            "cut_off": known.tree.attrs["cut_off"],
        }
        entries: list[Entry] = []
        for name in samplers:
            own = jax.random.fold_in(key, 1 + ROOTED_SAMPLERS.index(name))
            with stage(name):
                if target and name in ROOTED:
                    entry, _ = enter_chains(
                        posterior,
                        target,
                        known,
                        name,
                        DISPERSED,
                        key=own,
                        allowance=allowance,
                        num_samples=ENDLESS,
                        save_to=place_of(out, name, DISPERSED),
                    )
                else:
                    result = draw(key=own, sampler=name, num_samples=num_samples)
                    entry = _enter_route(known, name, result)
            entries.append(entry)
            found = Comparison(entries, comparison_tree(entries, known.sample, attributes))
            if out:
                save_tree(found.tree, out / "comparison.nc")
    return found


def _enter_route(known: Truth, name: str, result: Result) -> Entry:
    """A line of draws with an uncertain root; those that are not independent are left out."""
    attributes = result.tree.attrs
    evidence = attributes["log_evidence"], attributes["log_evidence_se"]
    cost = attributes["num_proposals"], attributes["wall_time_s"]
    if not result.num_draws:
        return Entry.without_draws(name, "", result.sentence, cost, evidence)
    found = read_sample(result.tree, f"the draws of {name}")
    if name == WEIGHTED:
        found = found.first(min(1.0, attributes["effective_roots"] / APART / found.num_draws))
    work = Work(*cost, 1.0, found.num_draws, 0)
    return entry_of(name, "", found, known, work=work, evidence=evidence, sentence=result.sentence)


def check_routes(names: Sequence[str]) -> None:
    """Raises `BadInput` where there is no name, or one that holds the root fixed, or whose package
    is missing."""
    for name in names:
        sampler_of(UNCERTAIN, name)
        if name in ROOTED:
            check_packages(name, BASELINES[name])
    if not names:
        raise BadInput(f"there is no sampler; choose from {', '.join(ROOTED_SAMPLERS)}")
