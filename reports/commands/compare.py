"""`poseterior compare`: samplers on one frame, judged by exact draws: a table, comparison.nc and a
picture."""

from dataclasses import dataclass
from pathlib import Path

from probmodel.failures import BadInput
from reports import console
from reports.options import Belief, Sight


@dataclass(frozen=True)
class Request:
    """Which samplers, for how many seconds or evaluations from each start, how many exact draws,
    from which seed, where to."""

    samplers: tuple[str, ...]
    out: Path
    seconds: float
    max_evaluations: int | None
    num_samples: int
    seed: int


def run(sight: Sight, belief: Belief, request: Request, *, quiet: bool, as_json: bool) -> None:
    """Writes comparison.nc and comparison.png. What samplers have done is kept in `runs`: the next
    call takes it up. Raises `BadInput`, or `OutOfBudget` where there are no exact draws."""
    from inference.studies.comparison import contest
    from reports import comparison_figures, comparison_tables

    if not request.seconds > 0:
        raise BadInput(f"--seconds must be more than 0, not {request.seconds:g}")
    contest.check_names(list(request.samplers))
    out = console.output_folder(request.out)
    with console.progress("torso and camera", quiet):
        model = belief.model()
        frame = sight.frame(model)
    found = contest.compare(
        model,
        frame,
        request.samplers,
        seed=request.seed,
        seconds=request.seconds,
        max_evaluations=request.max_evaluations,
        num_samples=request.num_samples,
        out=out,
        stage=lambda words: console.progress(words, quiet),
    )
    with console.progress("picture", quiet):
        comparison_figures.save(found.tree, out / "comparison.png")
    if as_json:
        lines = comparison_tables.comparison_json(found.tree)
        console.show_json({"samplers": lines, "out": str(out)})
        return
    console.OUT.print(comparison_tables.comparison_table(found.tree, console.OUT.width))
    for entry in found.entries:
        console.say(f"{entry.label}: {entry.sentence}")
    console.say(f"Written to {out}: comparison.nc, comparison.png, runs")
