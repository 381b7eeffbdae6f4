"""The routes to draws of torso, camera and pose together, judged by rejection.

found = compare_routes(model, frame)
found.tree["summary"].to_dataframe()
"""

import contextlib
import functools
from collections.abc import Sequence
from pathlib import Path

import jax

from inference.drawers import sampler_under
from inference.results import UNCERTAIN, Result, save_tree
from inference.sampler import sample
from inference.store import locked
from inference.studies.comparison.contest import (
    Comparison,
    Stage,
    Truth,
    Work,
    entry_of,
    truth_of,
)
from inference.studies.comparison.record import Entry, comparison_tree
from inference.studies.comparison.sample import read_sample
from inference.uncertain.routes import REJECTION, ROUTES, WEIGHTED
from inference.uncertain.weighted import APART, NUM_ROOTS
from probmodel.failures import BadInput
from probmodel.model import PoseModel
from probmodel.posterior import Estimate

REFERENCE = 1000
"""Draws by rejection that the judge compares with: some minutes."""


def compare_routes(
    model: PoseModel,
    frame: Estimate,
    samplers: Sequence[str] = (WEIGHTED,),
    *,
    seed: int = 0,
    num_samples: int = 10_000,
    num_roots: int = NUM_ROOTS,
    exact_draws: int = REFERENCE,
    out: Path | None = None,
    stage: Stage = contextlib.nullcontext,
) -> Comparison:
    """Lets samplers draw torso, camera and pose of a frame together, and judges each by rejection:
    some draws a second, which are independent.

    Parameters
    ----------
    model, frame
        As in `compare`.
    samplers
        Names of `ROUTES`.
    seed, num_samples
        As in `compare`; of weighted roots as many draws are judged as are independent.
    num_roots
        From how many roots weighted ones draw; of the pilot run of rejection.
    exact_draws
        Draws that all are judged by.
    out, stage
        As in `compare`.

    Returns
    -------
    Comparison
        A line for every sampler.

    Raises
    ------
    BadInput
        On a sampler that holds the root fixed, and as `sample` does.
    OutOfBudget
        Where the exact draws are not complete.
    """
    check_routes(samplers)
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
            own = jax.random.fold_in(key, 1 + ROUTES.index(name))
            with stage(name):
                result = draw(key=own, sampler=name, num_samples=num_samples)
            entries.append(_enter_route(known, name, result))
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
        return Entry(name, "", None, result.sentence, 0, *cost, None, None, *evidence)
    found = read_sample(result.tree, f"the draws of {name}")
    if name == WEIGHTED:
        found = found.first(min(1.0, attributes["effective_roots"] / APART / found.num_draws))
    work = Work(*cost, 1.0, found.num_draws, 0)
    return entry_of(name, "", found, known, result.sentence, work, evidence)


def check_routes(names: Sequence[str]) -> None:
    """Raises `BadInput` where there is no name, or one that holds the root fixed."""
    for name in names:
        sampler_under(UNCERTAIN, name)
    if not names:
        raise BadInput(f"there is no sampler; choose from {', '.join(ROUTES)}")
