"""`poseterior compare`: samplers on one frame, judged by exact draws: a table, comparison.nc and a
picture."""

from poseterior.probmodel.failures import BadInput
from poseterior.reports import console, doubts
from poseterior.reports.options import ROUTES, Screen
from poseterior.reports.settings import CONTESTANTS, CompareSettings

FEWEST_EXACT = 100
"""Draws of exact rejection with which it can be judged."""


def run(settings: CompareSettings, screen: Screen) -> None:
    """Writes comparison.nc and comparison.png. What samplers have done is kept in `runs`: the next
    call takes it up. Raises `BadInput`, or `OutOfBudget` where there are no exact draws."""
    from poseterior.inference.baselines.catalogue import BASELINES
    from poseterior.inference.studies.comparison import contest, routes
    from poseterior.reports.figures import save_figure
    from poseterior.reports.figures.comparison import comparison_figure
    from poseterior.reports.tables.comparison import NARROW, WIDE, comparison_table

    if not settings.seconds > 0:
        raise BadInput(f"--seconds must be more than 0, not {settings.seconds:g}")
    if settings.num_samples < FEWEST_EXACT:
        raise BadInput(f"--num-samples must be at least {FEWEST_EXACT}, not {settings.num_samples}")
    said = settings.samplers or (ROUTES[0] if settings.rooting.rooted else CONTESTANTS)
    samplers = [name.strip() for name in said.split(",") if name.strip()]
    check = routes.check_routes if settings.rooting.rooted else contest.check_names
    check(samplers)
    out = console.output_folder(settings.out)
    with console.progress("torso and camera", screen.quiet):
        model = settings.rooting.model_of(settings.prior, settings.person, samplers)
        frame = settings.estimation.estimate(settings.person.detection, model)
        warnings = doubts.about(settings.person, model, settings.rooting, samplers)
    kept = ", runs" if {*samplers} & {*BASELINES} else ""
    found = routes.compare(
        model,
        frame,
        samplers,
        root=settings.rooting.root.prior,
        num_roots=settings.rooting.roots,
        seed=settings.seed,
        seconds=settings.seconds,
        max_evaluations=settings.max_evaluations,
        num_samples=settings.num_samples,
        exact_draws=settings.exact_draws,
        out=out,
        stage=lambda words: console.progress(words, screen.quiet),
    )
    with console.progress("picture", screen.quiet):
        save_figure(comparison_figure(found.tree), out / "comparison.png")
    sheet = comparison_table(found.tree)
    console.show(
        screen.json,
        {"samplers": sheet.json(), "out": str(out)},
        sheet if console.OUT.width >= WIDE else sheet.only(NARROW),
        *(f"{entry.label}: {entry.sentence}" for entry in found.entries),
        f"Written to {out}: comparison.nc, comparison.png{kept}",
    )
    for sentence in warnings:
        console.warn(sentence)
