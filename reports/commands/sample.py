"""`poseterior sample`: posterior draws of one person by a named sampler, as netCDF."""

from pathlib import Path

from inference.results import COMPLETE
from inference.sampler import sample
from probmodel.failures import OutOfBudget
from reports import console, tables
from reports.options import Belief, Sight


def run(
    sight: Sight,
    belief: Belief,
    sampler: str,
    out: Path,
    num_samples: int,
    seed: int,
    max_proposals: int,
    *,
    quiet: bool,
    as_json: bool,
) -> None:
    """Writes posterior.nc. Raises `BadInput`, or `OutOfBudget` after saving what was drawn."""
    import jax

    console.output_file(out)
    with console.progress("torso and camera", quiet):
        model = belief.model()
        frame = sight.frame(model)
    with console.progress(f"draws by {sampler}", quiet) as step:
        result = sample(
            model,
            frame,
            key=jax.random.key(seed),
            sampler=sampler,
            num_samples=num_samples,
            max_proposals=max_proposals,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    result.save(out)
    if as_json:
        found = {"candidates": tables.candidates_table(result.tree).json(), "out": str(out)}
        console.show_json(tables.summary_json(result) | found)
    else:
        for line in tables.summary_lines(result):
            console.say(line)
        console.OUT.print(tables.candidates_table(result.tree))
        console.say(f"Written to {out}")
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")
