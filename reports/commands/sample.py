"""`poseterior sample`: posterior draws of one person by a named sampler, as netCDF and a page."""

from poseterior.inference.draws import COMPLETE
from poseterior.inference.drawsfile import sample_to_file
from poseterior.inference.hypothesis import hypotheses
from poseterior.inference.sampler import sampler_of
from poseterior.probmodel.failures import BadInput, OutOfBudget
from poseterior.reports import console, doubts, tables
from poseterior.reports.interactive.page import write_page
from poseterior.reports.interactive.person import person_page
from poseterior.reports.options import ROUTES, Screen
from poseterior.reports.settings import SampleSettings

NUM_HYPOTHESES = 5
"""On the page, which stand for the draws."""


def _task(settings: SampleSettings, sampler: str) -> str:
    weighed = settings.rooting.rooted and sampler in ROUTES
    return "roots and their limbs" if weighed else f"draws by {sampler}"


def run(settings: SampleSettings, screen: Screen) -> None:
    """Writes posterior.nc and its page. Raises `BadInput`, or `OutOfBudget` after saving what was
    drawn."""
    import jax

    out, sampling = console.output_file(settings.out), settings.sampling
    page = console.output_file(out.with_suffix(".html"))
    if page == out:
        raise BadInput(f"{out} is the name of the page; give --out a name that ends in .nc")
    sampler = sampler_of(settings.rooting.root.prior, settings.sampler).name
    with console.progress("torso and camera", screen.quiet):
        model = settings.rooting.model_of(settings.prior, settings.person, [sampler])
        frame = settings.estimation.estimate(settings.person.detection, model)
        warnings = doubts.about(settings.person, model, settings.rooting, [sampler])
    with console.progress(_task(settings, sampler), screen.quiet) as step:
        result = sample_to_file(
            out,
            model,
            frame,
            key=jax.random.key(sampling.seed),
            sampler=settings.sampler,
            num_samples=sampling.num_samples,
            max_proposals=sampling.max_proposals,
            chains=settings.chains,
            root=settings.rooting.root.prior,
            num_roots=settings.rooting.roots,
            most_roots=settings.rooting.most,
            double=settings.double,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    with console.progress("page", screen.quiet):
        photo, number = settings.person.detected.photo, result.shown.num_draws
        chosen = hypotheses(result.shown, min(NUM_HYPOTHESES, number), seed=sampling.seed)
        write_page(person_page(result, chosen, image=photo, warnings=warnings), page)
    sheet = tables.candidates_table(result.tree)
    found = {"candidates": sheet.json(), "out": str(out), "page": str(page)}
    lines = tables.summary_lines(result)
    written = f"Written to {out} and {page.name}"
    console.show(screen.json, tables.summary_json(result) | found, *lines, sheet, written)
    for sentence in warnings:
        console.warn(sentence)
    if settings.open:
        console.open_page(page)
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")
