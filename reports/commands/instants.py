"""`poseterior hypotheses SESSION`: one body from all views of calibrated cameras → draws, k diverse
hypotheses, a picture of every view and a table, in the world's axes and mm."""

import json

from poseterior.inference import Result
from poseterior.inference.draws import COMPLETE
from poseterior.inference.hypothesis import Hypothesis, hypotheses
from poseterior.inference.instants import sample_instant
from poseterior.probmodel.failures import OutOfBudget
from poseterior.probmodel.level import doubtful
from poseterior.probmodel.sessions.turning import said_of
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.views import views_figure
from poseterior.reports.options import Screen
from poseterior.reports.settings import HypothesesSettings
from poseterior.reports.tables.views import places_table, views_table


def run(settings: HypothesesSettings, screen: Screen) -> None:
    """The job. Raises `BadInput`, or `OutOfBudget` after saving what was drawn."""
    import jax

    sampling = settings.sampling
    with console.progress("the session", screen.quiet):
        session = settings.session
        instant = settings.instant(session)
        model = settings.prior.model()
        wrong = said_of(session, [view.label for view in instant.views])
    for sentence in [*wrong, *doubtful(*instant.up)]:
        console.warn(sentence)
    out = console.output_folder(settings.out)
    with console.progress("bodies and their limbs", screen.quiet) as step:
        result = sample_instant(
            model,
            instant,
            key=jax.random.key(sampling.seed),
            num_samples=sampling.num_samples,
            max_proposals=sampling.max_proposals,
            progress=step,
        )
    if not result.num_draws:
        raise OutOfBudget(result.sentence)
    result.save(out / "posterior.nc", double=settings.double)
    chosen = hypotheses(result, settings.k, seed=sampling.seed)
    own = {"unit": "mm, the axes of the calibration", "up": instant.up[0]}
    text = as_text(chosen, result, sampling.seed, **own)
    console.write_text(out / "hypotheses.json", text)
    save_figure(views_figure(result.tree, chosen), out / "hypotheses.png")
    places, views = places_table(result.tree), views_table(result.tree)
    weights = [one.weight for one in chosen]
    console.show(
        screen.json,
        {"joints": places.json(), "views": views.json(), "weights": weights, "out": str(out)},
        places,
        views,
        f"Written to {out}: posterior.nc, hypotheses.json, hypotheses.png",
    )
    if result.status != COMPLETE:
        raise OutOfBudget(f"{result.sentence} (what there is, is saved in {out})")


def as_text(chosen: list[Hypothesis], result: Result, seed: int, **own: str | int) -> str:
    """The text of hypotheses.json, with what it says of its `own`."""
    attrs = result.tree.attrs
    about = {key: attrs[key] for key in ("source", "limits", "measures", "versions")}
    listed = [hypothesis.as_json() for hypothesis in chosen]
    return json.dumps({"hypotheses": listed, "seed": seed, **own, **about}, indent=1) + "\n"
