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
    call goes on there. Raises `BadInput`, or `OutOfBudget` where there are no exact draws."""
    import jax

    from inference.baselines.run import Allowance
    from inference.results import save_tree
    from inference.studies.comparison import contest
    from inference.studies.comparison.record import Entry, comparison_tree
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
    runs = console.output_folder(out / "runs")
    with console.progress("torso and camera", screen.quiet):
        model = settings.prior.model()
        frame = settings.estimation.estimate(settings.person.detection(), model)
    key = jax.random.key(settings.seed)
    with console.progress("exact draws", screen.quiet):
        known = contest.truth(model, frame, key=jax.random.fold_in(key, 0))
    allowance = Allowance(settings.max_evaluations, settings.seconds)
    entries: list[Entry] = []
    attributes = {
        "source": frame.detection.source,
        "person": frame.detection.person,
        "seed": settings.seed,
        "seconds": settings.seconds,
        "exact_draws": known.sample.num_draws,
    }
    everyone = contest.SAMPLERS
    for name in samplers:
        own = jax.random.fold_in(
            key, 1 + everyone.index(name)
        )  # whoever else is asked, so that runs go on
        for start in contest.starts_of(name):
            with console.progress(f"{name} {start}".strip(), screen.quiet):
                if name in contest.BASELINES:
                    save_to = runs / f"{name}-{start}.npz".replace(" ", "-").replace("-.", ".")
                    entry = contest.enter_baseline(
                        model,
                        known,
                        name,
                        start,
                        key=own,
                        allowance=allowance,
                        num_samples=contest.ENDLESS,
                        save_to=save_to,
                    )[0]
                else:
                    entry = contest.enter_exact(
                        model, known, name, key=own, num_samples=settings.num_samples
                    )
            entries.append(entry)
            save_tree(comparison_tree(entries, known.sample, attributes), out / "comparison.nc")
    tree = comparison_tree(entries, known.sample, attributes)
    with console.progress("picture", screen.quiet):
        save_figure(comparison_figure(tree), out / "comparison.png")
    sheet = comparison_table(tree)
    if screen.json:
        console.show_json({"samplers": sheet.json(), "out": str(out)})
    else:
        console.OUT.print(sheet if console.OUT.width >= WIDE else sheet.only(NARROW))
        for entry in entries:
            console.say(f"{entry.label}: {entry.sentence}")
        console.say(f"Written to {out}: comparison.nc, comparison.png, runs")
