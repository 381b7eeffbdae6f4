"""`poseterior hypotheses`: a detector's file → posterior draws, k diverse hypotheses, a picture, a
page that turns and a table."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from poseterior.inference import Result
from poseterior.inference.composition import composed
from poseterior.inference.draws import COMPLETE
from poseterior.inference.drawsfile import sample_to_file
from poseterior.inference.hypothesis import Hypothesis, hypotheses
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.reports import console, doubts, tables
from poseterior.reports.commands import instants
from poseterior.reports.figures import (
    hypotheses_figure,
    save_figure,
)  # now: a first call waits here anyway
from poseterior.reports.interactive.page import write_page
from poseterior.reports.interactive.person import person_page
from poseterior.reports.options import Screen
from poseterior.reports.settings import HypothesesSettings
from poseterior.reports.tables.sheet import Sheet


def run(settings: HypothesesSettings, screen: Screen, *, truth: np.ndarray | None = None) -> None:
    """The main job. Raises `BadInput`, or `OutOfBudget` after saving what was drawn."""
    import jax

    k, sampling, photo = settings.k, settings.sampling, settings.person.detected.photo
    if k < 1:
        raise BadInput(f"the number of hypotheses must be at least 1, not {k}; give another --k")
    if k > sampling.num_samples:
        raise BadInput(f"--k {k} hypotheses need at least as many draws; raise --num-samples")
    if settings.person.is_session:
        instants.run(settings, screen)
        return
    with console.progress("torso and camera", screen.quiet):
        model = settings.rooting.model_of(settings.prior, settings.person)
        frame = settings.estimation.estimate(settings.person.detection, model)
        warnings = doubts.about(settings.person, model, settings.rooting)
    recalibrated = _recalibrated(settings.recalibrated) if settings.recalibrated else None
    out = console.output_folder(settings.out)
    task = "roots and their limbs" if settings.rooting.rooted else "exact draws"
    with console.progress(task, screen.quiet) as step:
        result = sample_to_file(
            out / "posterior.nc",
            model,
            frame,
            key=jax.random.key(sampling.seed),
            num_samples=sampling.num_samples,
            max_proposals=sampling.max_proposals,
            root=settings.rooting.root.prior,
            num_roots=settings.rooting.roots,
            most_roots=settings.rooting.most,
            double=settings.double,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    with console.progress("hypotheses and their pictures", screen.quiet):
        chosen = _chosen(settings, model, frame, result.shown)
        person = int(result.tree.attrs["person"])
        text = instants.as_text(chosen, result, sampling.seed, person=person)
        console.write_text(out / "hypotheses.json", text)
        picture = hypotheses_figure(result.shown.tree, chosen, image=photo, truth=truth)
        save_figure(picture, out / "hypotheses.png")
        page = person_page(result, chosen, image=photo, truth=truth, warnings=warnings)
        write_page(page, out / "hypotheses.html")
    intervals = recalibrated(result.shown.tree) if recalibrated else None
    if screen.json:
        held = {"recalibrated": intervals.json()} if intervals else {}
        console.show_json(summary(chosen, result, out) | held)
    else:
        show(chosen, result, out)
        if intervals:
            console.OUT.print(intervals)
    for sentence in warnings:
        console.warn(sentence)
    if settings.open:
        console.open_page(out / "hypotheses.html")
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")


def _recalibrated(path: Path) -> Callable[[xr.DataTree], Sheet]:
    """What makes a table of the recalibrated intervals of a posterior. What it needs takes a second
    to import, for which nobody else waits. Raises `BadInput` where the file is none."""
    from poseterior.inference.studies.judging.repair import read_recalibration
    from poseterior.reports.tables.judging import recalibrated_table

    repair = read_recalibration(path)
    return lambda tree: recalibrated_table(tree, repair)


def _chosen(
    settings: HypothesesSettings, model: PoseModel, frame: Estimate, shown: Result
) -> list[Hypothesis]:
    k, seed = min(settings.k, shown.num_draws), settings.sampling.seed
    if not settings.composed:
        return hypotheses(shown, k, seed=seed)
    posterior = frame.posterior(model, settings.rooting.root.prior)
    return composed(shown, posterior, k, seed=seed)


def summary(chosen: list[Hypothesis], result: Result, out: Path) -> dict:
    """The results as plain values."""
    return {
        "hypotheses": tables.hypotheses_table(chosen).json(),
        "candidates": tables.candidates_table(result.tree).json(),
        "joints": tables.posterior_table(result.shown.tree).json(),
        "summary": tables.summary_json(result),
        "out": str(out),
    }


def show(chosen: list[Hypothesis], result: Result, out: Path) -> None:
    """The results as tables."""
    for line in tables.summary_lines(result):
        console.say(line)
    for table in (
        tables.candidates_table(result.tree),
        tables.posterior_table(result.shown.tree),
        tables.hypotheses_table(chosen),
    ):
        console.OUT.print(table)
    console.say(f"Written to {out}: posterior.nc, hypotheses.json, hypotheses.png, hypotheses.html")
