"""`poseterior coverage`: is a sampler's posterior calibrated; and does it cover real poses, and if
not, why?"""

from pathlib import Path
from typing import Any, NamedTuple

from inference.machines import HERE, Machines
from inference.results import save_tree
from inference.studies import calibration
from inference.studies.calibration.coverage import CoverageSummary
from inference.studies.calibration.record import instances_tree
from inference.studies.calibration.verdict import FEWEST
from probmodel import BadInput
from reports import console, coverage_figures, coverage_tables
from reports.figures import save_figure
from reports.options import Belief


class Request(NamedTuple):
    """Which sampler, with how many draws of each instance, from which seed, where to; τ's
    factor; who does the work."""

    sampler: str
    num_samples: int
    seed: int
    out: Path
    factor: float
    max_proposals: int
    machines: Machines = HERE

    def settings(self, out: Path) -> dict[str, Any]:
        """What both studies take of it, written to the file `out`."""
        return {
            "sampler": self.sampler,
            "seed": self.seed,
            "num_samples": self.num_samples,
            "factor": self.factor,
            "max_proposals": self.max_proposals,
            "machines": self.machines,
            "out": out,
        }


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
    """Calibration under the model: coverage.nc and coverage.png. A run that was stopped is resumed.
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
            num_simulations=num_simulations,
            **request.settings(out / "coverage.nc"),
            progress=step,
        )
    simulation = tree["simulation"].to_dataset()
    found = calibration.judge(simulation)
    save_figure(coverage_figures.ranks_figure(simulation, found.sentence), out / "coverage.png")
    if as_json:
        console.show_json(coverage_tables.tests_json(found) | {"out": str(out)})
        return
    console.OUT.print(
        coverage_tables.terminal(coverage_tables.tests(found), "Are the ranks uniform?")
    )
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
            calibration.simulate(
                belief.model(), request.seed, 0, num_simulations, factor=request.factor
            )
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
    """Coverage of real poses: coverage.nc and coverage.png. A run that was stopped is resumed.
    Raises `BadInput` on a bad data set, noise or estimator."""
    out = console.output_folder(request.out)
    model = belief.model()
    with console.progress("poses", quiet):
        cases, source = calibration.read_cases(
            real.data,
            frames=real.frames,
            noise=real.noise,
            missing=real.missing,
            factor=request.factor,
            seed=request.seed,
        )
    with console.progress(f"posteriors by {request.sampler}", quiet) as step:
        tree = calibration.cover(
            model,
            cases,
            estimator=real.estimator,
            source=source,
            **request.settings(out / "coverage.nc"),
            progress=step,
        )
    found = calibration.summary(tree)
    simulation = tree["simulation"].to_dataset()
    curves = coverage_figures.coverage_figure({f"torso and camera: {real.estimator}": simulation})
    save_figure(curves, out / "coverage.png")
    if as_json:
        console.show_json(coverage_tables.summary_json(found) | {"out": str(out)})
    else:
        _say(found, out)


def _say(found: CoverageSummary, out: Path) -> None:
    console.OUT.print(
        coverage_tables.terminal(coverage_tables.briefly(found), "Covered, nominally and in truth")
    )
    excluded = coverage_tables.percent(found.excluded)
    console.say(
        f"{excluded} of {found.size} true poses are excluded; {found.without_draws} posteriors lack"
        " draws."
    )
    if found.reasons:
        console.OUT.print(
            coverage_tables.terminal(coverage_tables.reasons(found.reasons, found.size), "Why")
        )
    console.say(
        f"ECE {found.ece.whole.value:.3f}, that of a right posterior {found.ece.floor:.3f}; spread"
        f" to the side {found.lateral:.0f} mm, in depth {found.depth:.0f} mm; log evidence"
        f" {found.evidence:.1f} (medians)"
    )
    console.say(f"Written to {out}: coverage.nc, coverage.png")
