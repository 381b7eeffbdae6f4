"""The runs of reports/coverage.md under the model: exact draws, posteriors that have to fail, a
sampler that is not exact, and the tests themselves on a posterior in closed form.

Every stage leaves its result in a folder and is not done twice.
"""

import time
from pathlib import Path

import xarray as xr

from poseterior.inference.baselines.catalogue import ONE_FLIP
from poseterior.inference.studies.calibration import calibrate
from poseterior.inference.studies.calibration.controls import (
    DISTORTIONS,
    IGNORING,
    LITERAL_RECIPE,
    distorted,
    following_the_recipe,
    ignoring,
)
from poseterior.inference.studies.calibration.posteriors import Sampler, sampler_of
from poseterior.inference.studies.calibration.toy import sizes
from poseterior.probmodel import PoseModel
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.pages.page import kept, kept_json

EXACT_SIMULATIONS, SIMULATED_DRAWS = 1000, 1000
BASE_MEASURES = (("angle", "area"), ("area", "area"), ("angle", "box"))
"""Of upper and lower bones."""
CONTROLLED, RECIPES, RECIPE_DRAWS = 300, 400, 60
JUDGED_BASELINES = (("emcee", ONE_FLIP),)
JUDGED_SIMULATIONS, BASELINE_EVALUATIONS = 100, 10_000
REPETITIONS, TOYS, TOY_DRAWS = 200, 100, 50


def exact(work: Path, data: Path) -> None:
    """1,000 simulations × 1,000 exact draws in every measure, and what they cost."""
    for upper, lower in BASE_MEASURES:
        path = work / f"exact-{upper}-{lower}.nc"
        model = PoseModel(upper=upper, lower=lower)
        kept_json(path.with_suffix(".json"), _clocked, model, path)


def _clocked(model: PoseModel, path: Path) -> list[float]:
    """Seconds of the processor, and of the clock."""
    started = time.perf_counter()
    cpu = time.process_time()
    calibrate(
        model,
        "rejection",
        root=CANDIDATES,
        num_simulations=EXACT_SIMULATIONS,
        num_samples=SIMULATED_DRAWS,
        out=path,
    )
    return [time.process_time() - cpu, time.perf_counter() - started]


def controls(work: Path, data: Path) -> None:
    """Wrong posteriors on the first simulations, by the same tests."""
    model = PoseModel()
    right = sampler_of("rejection", model, SIMULATED_DRAWS, root=CANDIDATES)
    wrong: dict[str, tuple[Sampler, int]] = {
        name: (distorted(right, spoil), CONTROLLED) for name, spoil in DISTORTIONS.items()
    }
    wrong[IGNORING] = ignoring(model, SIMULATED_DRAWS), CONTROLLED
    wrong[LITERAL_RECIPE] = following_the_recipe(model, RECIPE_DRAWS), RECIPES
    for number, (name, (sampler, count)) in enumerate(wrong.items()):
        partial = work / f"partial-{number}.nc"
        kept(work / f"control-{number}.nc", _calibrated, model, sampler, count, name, partial)


def _calibrated(
    model: PoseModel, sampler: Sampler, number: int, name: str, out: Path | None = None
) -> xr.DataTree:
    """So many simulations, by a sampler of that name."""
    tree = calibrate(model, sampler, root=CANDIDATES, num_simulations=number, out=out)
    tree.attrs["sampler"] = name
    return tree


def baselines(work: Path, data: Path) -> None:
    """A sampler that is not exact, on the first of the same simulations."""
    model = PoseModel()
    for name, start in JUDGED_BASELINES:
        path = work / f"baseline-{name}-{start}.nc".replace(" ", "-")
        draw = sampler_of(
            name,
            model,
            BASELINE_EVALUATIONS,
            root=CANDIDATES,
            max_proposals=BASELINE_EVALUATIONS,
            start=start,
        )
        kept(path, _calibrated, model, draw, JUDGED_SIMULATIONS, f"{name}, started {start}")


def toy(work: Path, data: Path) -> None:
    """How often each test rejects a right posterior in closed form."""
    kept_json(work / "toy.json", _sizes)


def _sizes() -> dict[str, list[float]]:
    found = sizes(REPETITIONS, TOYS, TOY_DRAWS)
    return {name: p_values.tolist() for name, p_values in found.items()}
