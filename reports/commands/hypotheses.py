"""`poseterior hypotheses`: a detector's file → exact posterior draws, k diverse hypotheses, a
picture and a table."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inference import Result
from inference.hypothesis import Hypothesis, hypotheses
from inference.results import COMPLETE
from inference.sampler import sample
from probmodel.failures import BadInput, OutOfBudget
from reports import console, figures, tables
from reports.options import Belief, Sight


@dataclass(frozen=True)
class Request:
    """What is asked for: how many draws and hypotheses, from which seed, within which budget,
    written where."""

    out: Path
    k: int
    num_samples: int
    seed: int
    max_proposals: int
    image: Path | None = None


def run(
    sight: Sight,
    belief: Belief,
    request: Request,
    *,
    truth: np.ndarray | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """The main job. Raises `BadInput`, or `OutOfBudget` after saving what was drawn."""
    import jax

    if request.k < 1:
        raise BadInput(
            f"the number of hypotheses must be at least 1, not {request.k}; give another --k"
        )
    if request.k > request.num_samples:
        raise BadInput(
            f"--k {request.k} hypotheses need at least as many draws; raise --num-samples"
        )
    image = None if request.image is None else figures.read_image(request.image)
    with console.progress("torso and camera", quiet):
        model = belief.model()
        frame = sight.frame(model)
    out = console.output_folder(request.out)
    with console.progress("exact draws", quiet) as step:
        result = sample(
            model,
            frame,
            key=jax.random.key(request.seed),
            num_samples=request.num_samples,
            max_proposals=request.max_proposals,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    with console.progress("hypotheses and their picture", quiet):
        result.save(out / "posterior.nc")
        chosen = hypotheses(result, min(request.k, result.num_draws), seed=request.seed)
        console.write_text(out / "hypotheses.json", _as_text(chosen, result, request))
        picture = figures.hypotheses_figure(result.tree, chosen, image=image, truth=truth)
        figures.save_figure(picture, out / "hypotheses.png")
    if as_json:
        console.show_json(summary(chosen, result, out))
    else:
        show(chosen, result, out)
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")


def _as_text(chosen: list[Hypothesis], result: Result, request: Request) -> str:
    attrs = result.tree.attrs
    about = {key: attrs[key] for key in ("source", "limits", "measures", "versions")}
    whole = {
        "hypotheses": [hypothesis.as_json() for hypothesis in chosen],
        "seed": request.seed,
        "person": int(attrs["person"]),
        **about,
    }
    return json.dumps(whole, indent=1) + "\n"


def summary(chosen: list[Hypothesis], result: Result, out: Path) -> dict:
    """The results as plain values."""
    return {
        "hypotheses": tables.hypotheses_table(chosen).json(),
        "candidates": tables.candidates_table(result.tree).json(),
        "joints": tables.posterior_table(result.tree).json(),
        "summary": tables.summary_json(result),
        "out": str(out),
    }


def show(chosen: list[Hypothesis], result: Result, out: Path) -> None:
    """The results as tables."""
    for line in tables.summary_lines(result):
        console.say(line)
    for table in (
        tables.candidates_table(result.tree),
        tables.posterior_table(result.tree),
        tables.hypotheses_table(chosen),
    ):
        console.OUT.print(table)
    console.say(f"Written to {out}: posterior.nc, hypotheses.json, hypotheses.png")
