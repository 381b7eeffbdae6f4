"""`poseterior coverage`: is a sampler's posterior calibrated; and does it cover real poses, and if
not, why?"""

import json
from pathlib import Path
from typing import Any

from poseterior.inference.results import save_tree, versions
from poseterior.inference.sampler import MAKERS
from poseterior.inference.studies import calibration, person_views
from poseterior.inference.studies.calibration.coverage import CoverageSummary
from poseterior.inference.studies.calibration.record import instances_tree
from poseterior.inference.studies.calibration.verdict import FEWEST_SIMULATIONS
from poseterior.probmodel import BadInput, Likelihood
from poseterior.probmodel.datasets.person_views import read_person_views
from poseterior.probmodel.failures import require_some
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.coverage import coverage_figure, ranks_figure
from poseterior.reports.figures.person_views import levels_figure
from poseterior.reports.options import Estimation, JudgedBy, Screen
from poseterior.reports.settings import CoverageSettings
from poseterior.reports.tables import Sheet
from poseterior.reports.tables.coverage import (
    brief_table,
    calibration_json,
    reasons_table,
    share,
    summary_json,
    uniformity_table,
)
from poseterior.reports.tables.measured import measure_scores_table
from poseterior.reports.tables.person_views import honesty_json, honesty_table, people_table


def run(settings: CoverageSettings, screen: Screen) -> None:
    """One of the four: simulations judged, simulations written, views of people, real poses."""
    if settings.of_views:
        viewed(settings, screen)
    elif settings.dataset is not None:
        real(settings, screen)
    elif settings.simulate_only:
        write_simulations(settings, screen)
    else:
        simulated(settings, screen)


def simulated(settings: CoverageSettings, screen: Screen) -> None:
    """Calibration under the model: coverage.nc and coverage.png. A run that was stopped goes on.
    Raises `BadInput` on fewer simulations than the tests need, before any work is done."""
    num_simulations = settings.num_simulations
    if num_simulations < FEWEST_SIMULATIONS:
        raise BadInput(
            f"{num_simulations} simulations are too few: the tests need at least"
            f" {FEWEST_SIMULATIONS}"
        )
    out = console.output_folder(settings.out)
    model = settings.rooting.model(settings.prior)
    with console.progress(f"simulations by {_drawer(settings)}", screen.quiet) as step:
        tree = calibration.calibrate(
            model,
            num_simulations=num_simulations,
            **_asked(settings, out / "coverage.nc"),
            progress=step,
        )
    simulation = tree["simulation"].to_dataset()
    found = calibration.judge(simulation, of=settings.of)
    save_figure(ranks_figure(simulation, found.sentence, of=settings.of), out / "coverage.png")
    console.show(
        screen.json,
        calibration_json(found) | {"out": str(out)},
        uniformity_table(found),
        f"{found.verdict}: {found.sentence}",
        f"Written to {out}: coverage.nc, coverage.png",
    )


def write_simulations(settings: CoverageSettings, screen: Screen) -> None:
    """Only the simulations, for samplers that run elsewhere: simulations.nc."""
    num_simulations = settings.num_simulations
    require_some(num_simulations, "simulations")
    out = console.output_folder(settings.out)
    with console.progress("simulations", screen.quiet):
        model, seed = settings.rooting.model(settings.prior), settings.sampling.seed
        likelihood = Likelihood(factor=settings.factor)
        some = calibration.simulate(
            model,
            seed,
            0,
            num_simulations,
            likelihood=likelihood,
            root=settings.rooting.root.prior,
        )
        tree = instances_tree(some)
    path = out / "simulations.nc"
    save_tree(tree, path)
    console.show(
        screen.json,
        {"num_simulations": num_simulations, "out": str(out)},
        f"{num_simulations} simulations written to {path}; judge draws of them with --sampler FILE",
    )


def real(settings: CoverageSettings, screen: Screen) -> None:
    """Coverage of real poses: coverage.nc and coverage.png. A run that was stopped is resumed.
    Raises `BadInput` on a bad data set, noise or estimator."""
    assert settings.dataset is not None
    out = console.output_folder(settings.out)
    model = settings.rooting.model(settings.prior)
    with console.progress("poses", screen.quiet):
        cases, source = calibration.read_cases(
            settings.dataset,
            frames=settings.frames,
            noise=settings.noise,
            missing=settings.missing,
            likelihood=Likelihood(factor=settings.factor),
            root=settings.rooting.root.prior,
            seed=settings.sampling.seed,
            perspective=settings.perspective,
        )
    with console.progress(f"posteriors by {_drawer(settings)}", screen.quiet) as step:
        tree = calibration.cover(
            model,
            cases,
            estimator=settings.estimator,
            source=source,
            **_asked(settings, out / "coverage.nc"),
            progress=step,
        )
    found = calibration.summary(tree)
    simulation = tree["simulation"].to_dataset()
    given = "uncertain" if settings.rooting.rooted else settings.estimator
    curves = coverage_figure({f"torso and camera: {given}": simulation})
    save_figure(curves, out / "coverage.png")
    if settings.of == JudgedBy.measures:
        measured = measure_scores_table({"": calibration.measure_scores(tree)})
        result: dict[str, Any] = {"measures": measured.json()}
        shown: list[Sheet | str] = [measured]
    else:
        result, shown = summary_json(found), _shown(found)
    written = f"Written to {out}: coverage.nc, coverage.png"
    console.show(screen.json, result | {"out": str(out)}, *shown, written)


def viewed(settings: CoverageSettings, screen: Screen) -> None:
    """Coverage of people whose truth is known in part: coverage.json, coverage.nc and coverage.png.
    Raises `BadInput` on a bad file or law, and where torso and camera are fixed."""
    assert settings.dataset is not None
    if not settings.rooting.rooted:
        raise BadInput("views of people come without torso and camera; choose --root uncertain")
    out = console.output_folder(settings.out)
    likelihood = Estimation(errors=settings.errors, factor=settings.factor).likelihood()
    model = settings.rooting.model(settings.prior)
    every = read_person_views(settings.dataset)
    of_them = [view for view in every if person_views.of_the_person(view)]
    views = person_views.even(of_them, settings.frames)
    units = person_views.units_of(views, model)
    judged = []
    with console.progress("posteriors of views", screen.quiet) as step:
        for number, view in enumerate(views):
            seen_by = model.seen_by(view.believed(settings.camera))
            seed = settings.sampling.seed + number
            numbers = settings.sampling.num_samples, settings.rooting.roots
            one = person_views.judge(view, units[view.person], seen_by, likelihood, seed, *numbers)
            judged.append(one)
            step(number + 1, len(views))
    about = {name: [one[name] for one in judged] for name in person_views.MIDDLES}
    found = {name: person_views.honesty(views, some) for name, some in about.items()}
    people = {name: person_views.by_person(views, some) for name, some in about.items()}
    gaps = {
        name: person_views.beside_truth(views, pair) for name, pair in person_views.MIDDLES.items()
    }
    said = honesty_json(found, people, gaps)
    console.write_text(out / "coverage.json", json.dumps(said, indent=1) + "\n")
    tree = person_views.levels_tree(views, about)
    tree.attrs.update(data=settings.dataset.name, versions=versions())
    save_tree(tree, out / "coverage.nc")
    save_figure(levels_figure(about), out / "coverage.png")
    shown: list[Sheet | str] = []
    for name in found:
        shown += [honesty_table(found[name], name, gaps[name]), people_table(people[name])]
    shown.append(
        f"Of {len(views)} views of {found['hips'].people} people; intervals are over people."
    )
    if strangers := len(every) - len(of_them):
        shown.append(
            f"{strangers} of {len(every)} views were left out: their median joint is detected more"
            f" than {person_views.ANOTHER:g} mm from where it truly is, on somebody else or nobody."
        )
    written = f"Written to {out}: coverage.json, coverage.nc, coverage.png"
    console.show(screen.json, said | {"out": str(out)}, *shown, written)


def _drawer(settings: CoverageSettings) -> str:
    return settings.sampler or next(iter(MAKERS[settings.rooting.root.prior]))


def _asked(settings: CoverageSettings, out: Path) -> dict[str, Any]:
    """What both studies take of the settings, written to the file `out`."""
    return {
        "sampler": settings.sampler,
        "seed": settings.sampling.seed,
        "num_samples": settings.sampling.num_samples,
        "likelihood": Likelihood(factor=settings.factor),
        "max_proposals": settings.sampling.max_proposals,
        "root": settings.rooting.root.prior,
        "num_roots": settings.rooting.roots,
        "machines": settings.workforce.machines(),
        "out": out,
    }


def _shown(found: CoverageSummary) -> list[Sheet | str]:
    reasons = [reasons_table(found.reasons, found.size)] if found.reasons else []
    return [
        brief_table(found),
        f"{share(found.excluded)} of {found.size} true poses are excluded; {found.without_draws}"
        " posteriors lack draws.",
        *reasons,
        f"ECE {found.ece.whole.value:.3f}, that of a right posterior {found.ece.floor:.3f}; spread"
        f" to the side {found.lateral:.0f} mm, in depth {found.depth:.0f} mm; log evidence"
        f" {found.evidence:.1f} (medians)",
    ]
