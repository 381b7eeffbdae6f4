"""`poseterior sample`: posterior draws of one person by a named sampler, as netCDF."""

from inference.results import COMPLETE, FIXED
from inference.sampler import sample
from probmodel.failures import OutOfBudget
from reports import console, tables
from reports.options import Screen
from reports.settings import SampleSettings


def _task(settings: SampleSettings) -> str:
    fixed = settings.rooting.root == FIXED
    return f"draws by {settings.sampler}" if fixed else "roots and their limbs"


def run(settings: SampleSettings, screen: Screen) -> None:
    """Writes posterior.nc. Raises `BadInput`, or `OutOfBudget` after saving what was drawn."""
    import jax

    out, sampling = console.output_file(settings.out), settings.sampling
    with console.progress("torso and camera", screen.quiet):
        model = settings.prior.model()
        frame = settings.estimation.estimate(settings.person.detection, model)
    with console.progress(_task(settings), screen.quiet) as step:
        result = sample(
            model,
            frame,
            key=jax.random.key(sampling.seed),
            sampler=settings.sampler,
            num_samples=sampling.num_samples,
            max_proposals=sampling.max_proposals,
            chains=settings.chains,
            root=settings.rooting.root,
            num_roots=settings.rooting.roots,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    result.save(out)
    if screen.json:
        found = {"candidates": tables.candidates_table(result.tree).json(), "out": str(out)}
        console.show_json(tables.summary_json(result) | found)
    else:
        for line in tables.summary_lines(result):
            console.say(line)
        console.OUT.print(tables.candidates_table(result.tree))
        console.say(f"Written to {out}")
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")
