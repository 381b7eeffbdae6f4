"""The runs of reports/coverage.md under the model: exact draws, posteriors that have to fail, a
sampler that is not exact, and the tests themselves on a posterior in closed form.

Every stage leaves its result in a folder and is not done twice.
"""

import json
import time
from pathlib import Path

from poseterior.inference.baselines.catalogue import ONE_FLIP
from poseterior.inference.results import save_tree
from poseterior.inference.studies.calibration import calibrate, judge
from poseterior.inference.studies.calibration.controls import (
    DISTORTIONS,
    IGNORING,
    RECIPE,
    distorted,
    following_the_recipe,
    ignoring,
)
from poseterior.inference.studies.calibration.posteriors import Sampler, sampler_of
from poseterior.inference.studies.calibration.toy import sizes
from poseterior.probmodel import PoseModel
from poseterior.probmodel.root_priors import CANDIDATES

SIMULATIONS, DRAWS = 1000, 1000
MEASURES = (("angle", "area"), ("area", "area"), ("angle", "box"))
"""Of upper and lower bones."""
CONTROLLED, RECIPES, RECIPE_DRAWS = 300, 400, 60
BASELINES = (("emcee", ONE_FLIP),)
JUDGED, EVALUATIONS = 100, 10_000
REPETITIONS, TOYS, TOY_DRAWS = 200, 100, 50


def exact(work: Path, data: Path) -> None:
    """1,000 simulations × 1,000 exact draws in every measure, and what they cost."""
    for upper, lower in MEASURES:
        path = work / f"exact-{upper}-{lower}.nc"
        cost = path.with_suffix(".json")
        if cost.exists():
            continue
        model = PoseModel.paper(upper=upper, lower=lower)
        started, cpu = time.perf_counter(), time.process_time()
        calibrate(
            model,
            "rejection",
            root=CANDIDATES,
            num_simulations=SIMULATIONS,
            num_samples=DRAWS,
            out=path,
        )
        cost.write_text(json.dumps([time.process_time() - cpu, time.perf_counter() - started]))


def controls(work: Path, data: Path) -> None:
    """Wrong posteriors on the first simulations, by the same tests."""
    model = PoseModel.paper()
    right = sampler_of("rejection", model, DRAWS, root=CANDIDATES)
    wrong: dict[str, tuple[Sampler, int]] = {
        name: (distorted(right, spoil), CONTROLLED) for name, spoil in DISTORTIONS.items()
    }
    wrong[IGNORING] = ignoring(model, DRAWS), CONTROLLED
    wrong[RECIPE] = following_the_recipe(model, RECIPE_DRAWS), RECIPES
    for number, (name, (sampler, count)) in enumerate(wrong.items()):
        path = work / f"control-{number}.nc"
        if not path.exists():
            tree = calibrate(
                model,
                sampler,
                root=CANDIDATES,
                num_simulations=count,
                out=work / f"partial-{number}.nc",
            )
            tree.attrs["sampler"] = name
            save_tree(tree, path)
            print(name, judge(tree["simulation"].to_dataset()).families, flush=True)


def baselines(work: Path, data: Path) -> None:
    """A sampler that is not exact, on the first of the same simulations."""
    model = PoseModel.paper()
    for name, start in BASELINES:
        path = work / f"baseline-{name}-{start}.nc".replace(" ", "-")
        if not path.exists():
            draw = sampler_of(
                name, model, EVALUATIONS, root=CANDIDATES, max_proposals=EVALUATIONS, start=start
            )
            tree = calibrate(model, draw, root=CANDIDATES, num_simulations=JUDGED)
            tree.attrs["sampler"] = f"{name}, started {start}"
            save_tree(tree, path)


def toy(work: Path, data: Path) -> None:
    """How often each test rejects a right posterior in closed form."""
    path = work / "toy.json"
    if not path.exists():
        found = sizes(REPETITIONS, TOYS, TOY_DRAWS)
        path.write_text(json.dumps({name: p_values.tolist() for name, p_values in found.items()}))
