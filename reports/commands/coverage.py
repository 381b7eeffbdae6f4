"""`poseterior coverage`: is a sampler's posterior calibrated; and does it cover real poses, and if
not, why?"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from inference.results import save_tree, versions
from inference.studies.calibration import run as calibration
from inference.studies.calibration.coverage import summary
from inference.studies.calibration.exclusions import as_text, exclusions
from inference.studies.calibration.posteriors import sampler_of
from inference.studies.calibration.real import TRUE, by_the_likelihood, instances, stand_real
from inference.studies.calibration.record import instances_tree, standings_tree
from inference.studies.calibration.simulations import simulate
from inference.studies.calibration.verdict import FEWEST, judge
from probmodel import BadInput, PoseModel
from probmodel.datasets import Noise, read_data_set
from reports import console
from reports.figures import save_figure
from reports.figures.coverage import coverage_figure, ranks_figure
from reports.options import Belief
from reports.tables.coverage import (
    brief_table,
    calibration_json,
    reasons_table,
    share,
    summary_json,
    uniformity_table,
)

LIKELIHOOD = "likelihood"


class Request(NamedTuple):
    """Which sampler, with how many draws of each instance, from which seed, where to; τ's
    factor."""

    sampler: str
    num_samples: int
    seed: int
    out: Path
    factor: float
    max_proposals: int


class Real(NamedTuple):
    """Which poses: a data set, how many frames of it, by what 2D errors, how many joints missing,
    and whose torso and camera."""

    data: Path
    frames: int
    noise: str
    missing: int
    estimator: str


def simulated(
    belief: Belief, request: Request, num_simulations: int, *, quiet: bool, as_json: bool
) -> None:
    """Calibration under the model: coverage.nc and coverage.png. A run that was stopped goes on.
    Raises `BadInput` on fewer simulations than the tests need, before any work is done."""
    if num_simulations < FEWEST:
        raise BadInput(
            f"{num_simulations} simulations are too few: the tests need at least {FEWEST}"
        )
    out = console.output_folder(request.out)
    model = belief.model()
    with console.progress(f"simulations by {request.sampler}", quiet) as step:
        tree = calibration.calibrate(
            model,
            request.sampler,
            seed=request.seed,
            num_simulations=num_simulations,
            num_samples=request.num_samples,
            factor=request.factor,
            max_proposals=request.max_proposals,
            out=out / "coverage.nc",
            progress=step,
        )
    simulation = tree["simulation"].to_dataset()
    found = judge(simulation)
    save_figure(ranks_figure(simulation, found.sentence), out / "coverage.png")
    if as_json:
        console.show_json(calibration_json(found) | {"out": str(out)})
        return
    console.OUT.print(uniformity_table(found))
    console.say(f"{found.verdict}: {found.sentence}")
    console.say(f"Written to {out}: coverage.nc, coverage.png")


def write_simulations(
    belief: Belief, request: Request, num_simulations: int, *, quiet: bool, as_json: bool
) -> None:
    """Only the simulations, for samplers that run elsewhere: simulations.nc."""
    if num_simulations < 1:
        raise BadInput(f"the number of simulations must be at least 1, not {num_simulations}")
    out = console.output_folder(request.out)
    with console.progress("simulations", quiet):
        tree = instances_tree(
            simulate(belief.model(), request.seed, 0, num_simulations, factor=request.factor)
        )
    save_tree(tree, out / "simulations.nc")
    if as_json:
        console.show_json({"num_simulations": num_simulations, "out": str(out)})
    else:
        path = out / "simulations.nc"
        console.say(
            f"{num_simulations} simulations written to {path}; judge draws of them with --sampler"
            " FILE"
        )


def real(belief: Belief, request: Request, real: Real, *, quiet: bool, as_json: bool) -> None:
    """Coverage of real poses: coverage.nc and coverage.png. Raises `BadInput` on a bad data set,
    noise or estimator."""
    out = console.output_folder(request.out)
    model = belief.model()
    with console.progress("poses, torsos and cameras", quiet):
        noise = Noise() if real.noise == LIKELIHOOD else Noise.parse(real.noise)
        data = read_data_set(real.data, frames=real.frames, noise=noise, seed=request.seed)
        cases = [case.hiding(real.missing, request.seed) for case in data]
        if real.noise == LIKELIHOOD:
            cases = [by_the_likelihood(case, request.factor, request.seed) for case in cases]
        known = instances(cases, model, real.estimator, factor=request.factor)
    sampler_of(request.sampler, model, request.num_samples)
    with console.progress(f"posteriors by {request.sampler}", quiet) as step:
        standings = stand_real(
            model,
            known,
            sampler=request.sampler,
            seed=request.seed,
            num_samples=request.num_samples,
            max_proposals=request.max_proposals,
            progress=step,
        )
    columns = {
        "recording": np.array([case.recording for case in cases]),
        "unit_mm": np.array([case.unit for case in cases]),
        "reasons": np.array([as_text(one) for one in exclusions(model, cases, known)]),
    }
    tree = standings_tree(standings, _about(model, request, real, data.sha256), columns)
    save_tree(tree, out / "coverage.nc")
    found = summary(tree)
    simulation = tree["simulation"].to_dataset()
    curves = coverage_figure({f"torso and camera: {real.estimator}": simulation})
    save_figure(curves, out / "coverage.png")
    if as_json:
        console.show_json(summary_json(found) | {"out": str(out)})
    else:
        _say(tree, out)


def _about(model: PoseModel, request: Request, real: Real, sha256: str) -> dict:
    return {
        "sampler": request.sampler,
        "seed": request.seed,
        "num_samples": request.num_samples,
        "factor": request.factor,
        "data": f"{real.data.name} {sha256}",
        "noise": real.noise,
        "missing": real.missing,
        "estimator": real.estimator,
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


__all__ = ["LIKELIHOOD", "TRUE", "Real", "Request", "real", "simulated", "write_simulations"]
