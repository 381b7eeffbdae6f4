"""`poseterior coverage`: is a sampler's posterior calibrated; and does it cover real poses, and if
not, why?"""

from pathlib import Path

import numpy as np
import xarray as xr

from inference.results import save_tree, versions
from inference.studies.calibration import run as calibration
from inference.studies.calibration.coverage import summary
from inference.studies.calibration.exclusions import as_text, exclusions
from inference.studies.calibration.posteriors import sampler_of
from inference.studies.calibration.real import by_the_likelihood, instances, stand_real
from inference.studies.calibration.record import instances_tree, standings_tree
from inference.studies.calibration.simulations import simulate
from inference.studies.calibration.verdict import FEWEST, judge
from probmodel import BadInput, Likelihood, PoseModel
from probmodel.datasets import Noise, read_data_set
from reports import console
from reports.figures import save_figure
from reports.figures.coverage import coverage_figure, ranks_figure
from reports.options import Screen
from reports.settings import CoverageSettings
from reports.tables.coverage import (
    brief_table,
    calibration_json,
    reasons_table,
    share,
    summary_json,
    uniformity_table,
)

LIKELIHOOD = "likelihood"


def run(settings: CoverageSettings, screen: Screen) -> None:
    """One of the three: simulations judged, simulations written, real poses."""
    if settings.dataset is not None:
        real(settings, screen)
    elif settings.simulate_only:
        write_simulations(settings, screen)
    else:
        simulated(settings, screen)


def simulated(settings: CoverageSettings, screen: Screen) -> None:
    """Calibration under the model: coverage.nc and coverage.png. A run that was stopped goes on.
    Raises `BadInput` on fewer simulations than the tests need, before any work is done."""
    num_simulations, sampling = settings.num_simulations, settings.sampling
    if num_simulations < FEWEST:
        raise BadInput(
            f"{num_simulations} simulations are too few: the tests need at least {FEWEST}"
        )
    out = console.output_folder(settings.out)
    model = settings.prior.model()
    with console.progress(f"simulations by {settings.sampler}", screen.quiet) as step:
        tree = calibration.calibrate(
            model,
            settings.sampler,
            seed=sampling.seed,
            num_simulations=num_simulations,
            num_samples=sampling.num_samples,
            factor=settings.factor,
            max_proposals=sampling.max_proposals,
            out=out / "coverage.nc",
            progress=step,
        )
    simulation = tree["simulation"].to_dataset()
    found = judge(simulation)
    save_figure(ranks_figure(simulation, found.sentence), out / "coverage.png")
    if screen.json:
        console.show_json(calibration_json(found) | {"out": str(out)})
        return
    console.OUT.print(uniformity_table(found))
    console.say(f"{found.verdict}: {found.sentence}")
    console.say(f"Written to {out}: coverage.nc, coverage.png")


def write_simulations(settings: CoverageSettings, screen: Screen) -> None:
    """Only the simulations, for samplers that run elsewhere: simulations.nc."""
    num_simulations = settings.num_simulations
    if num_simulations < 1:
        raise BadInput(f"the number of simulations must be at least 1, not {num_simulations}")
    out = console.output_folder(settings.out)
    with console.progress("simulations", screen.quiet):
        model, seed = settings.prior.model(), settings.sampling.seed
        tree = instances_tree(simulate(model, seed, 0, num_simulations, factor=settings.factor))
    save_tree(tree, out / "simulations.nc")
    if screen.json:
        console.show_json({"num_simulations": num_simulations, "out": str(out)})
    else:
        path = out / "simulations.nc"
        console.say(
            f"{num_simulations} simulations written to {path}; judge draws of them with --sampler"
            " FILE"
        )


def real(settings: CoverageSettings, screen: Screen) -> None:
    """Coverage of real poses: coverage.nc and coverage.png. Raises `BadInput` on a bad data set,
    noise or estimator."""
    assert settings.dataset is not None
    sampling = settings.sampling
    out = console.output_folder(settings.out)
    model = settings.prior.model()
    with console.progress("poses, torsos and cameras", screen.quiet):
        noise = Noise() if settings.noise == LIKELIHOOD else Noise.parse(settings.noise)
        data = read_data_set(
            settings.dataset, frames=settings.frames, noise=noise, seed=sampling.seed
        )
        cases = [case.hiding(settings.missing, sampling.seed) for case in data]
        if settings.noise == LIKELIHOOD:
            cases = [by_the_likelihood(case, settings.factor, sampling.seed) for case in cases]
        likelihood = Likelihood(factor=settings.factor)
        known = instances(cases, model, settings.estimator, likelihood=likelihood)
    sampler_of(settings.sampler, model, sampling.num_samples)
    with console.progress(f"posteriors by {settings.sampler}", screen.quiet) as step:
        standings = stand_real(
            model,
            known,
            sampler=settings.sampler,
            seed=sampling.seed,
            num_samples=sampling.num_samples,
            max_proposals=sampling.max_proposals,
            progress=step,
        )
    columns = {
        "recording": np.array([case.recording for case in cases]),
        "unit_mm": np.array([case.unit for case in cases]),
        "reasons": np.array([as_text(one) for one in exclusions(model, cases, known)]),
    }
    about = _about(model, settings) | {"data": f"{settings.dataset.name} {data.sha256}"}
    tree = standings_tree(standings, about, columns)
    save_tree(tree, out / "coverage.nc")
    found = summary(tree)
    simulation = tree["simulation"].to_dataset()
    curves = coverage_figure({f"torso and camera: {settings.estimator}": simulation})
    save_figure(curves, out / "coverage.png")
    if screen.json:
        console.show_json(summary_json(found) | {"out": str(out)})
    else:
        _say(tree, out)


def _about(model: PoseModel, settings: CoverageSettings) -> dict:
    return {
        "sampler": settings.sampler,
        "seed": settings.sampling.seed,
        "num_samples": settings.sampling.num_samples,
        "factor": settings.factor,
        "noise": settings.noise,
        "missing": settings.missing,
        "estimator": settings.estimator,
        "limits": f"{model.limits.name} {model.limits.sha256}",
        "measures": f"upper {model.upper}, lower {model.lower}",
        "versions": versions(),
    }


def _say(tree: xr.DataTree, out: Path) -> None:
    found = summary(tree)
    console.OUT.print(brief_table(found))
    excluded = share(found.excluded)
    console.say(
        f"{excluded} of {found.size} true poses are excluded; {found.without_draws} posteriors lack"
        " draws."
    )
    if found.reasons:
        console.OUT.print(reasons_table(found.reasons, found.size))
    console.say(
        f"ECE {found.ece.whole.value:.3f}, that of a right posterior {found.ece.floor:.3f}; spread"
        f" to the side {found.lateral:.0f} mm, in depth {found.depth:.0f} mm; log evidence"
        f" {found.evidence:.1f} (medians)"
    )
    console.say(f"Written to {out}: coverage.nc, coverage.png")
