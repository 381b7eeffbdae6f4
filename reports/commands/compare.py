"""`poseterior compare`: samplers on one frame, judged by exact draws: a table, comparison.nc and a
picture."""

from probmodel.failures import BadInput
from reports import console
from reports.options import Screen
from reports.settings import CompareSettings

FEWEST = 100
"""Draws of exact rejection with which it can be judged."""


def run(settings: CompareSettings, screen: Screen) -> None:
    """Writes comparison.nc and comparison.png. What samplers have done is kept in `runs`: the next
    call takes it up. Raises `BadInput`, or `OutOfBudget` where there are no exact draws."""
    from inference.studies.comparison import contest
    from reports.figures import save_figure
    from reports.figures.comparison import comparison_figure
    from reports.tables.comparison import NARROW, WIDE, comparison_table

    if not settings.seconds > 0:
        raise BadInput(f"--seconds must be more than 0, not {settings.seconds:g}")
    if settings.num_samples < FEWEST:
        raise BadInput(f"--num-samples must be at least {FEWEST}, not {settings.num_samples}")
    samplers = [name.strip() for name in settings.samplers.split(",") if name.strip()]
    contest.check_names(samplers)
    out = console.output_folder(settings.out)
    with console.progress("torso and camera", screen.quiet):
        model = settings.prior.model()
        frame = settings.estimation.estimate(settings.person.detection, model)
    found = contest.compare(
        model,
        frame,
        samplers,
        seed=settings.seed,
        seconds=settings.seconds,
        max_evaluations=settings.max_evaluations,
        num_samples=settings.num_samples,
        out=out,
        stage=lambda words: console.progress(words, screen.quiet),
    )
    with console.progress("picture", screen.quiet):
        save_figure(comparison_figure(found.tree), out / "comparison.png")
    sheet = comparison_table(found.tree)
    if screen.json:
        console.show_json({"samplers": sheet.json(), "out": str(out)})
    else:
        console.OUT.print(sheet if console.OUT.width >= WIDE else sheet.only(NARROW))
        for entry in found.entries:
            console.say(f"{entry.label}: {entry.sentence}")
        console.say(f"Written to {out}: comparison.nc, comparison.png, runs")
