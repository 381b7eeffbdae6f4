"""Does the posterior mean what it says? Writes reports/coverage.md and its pictures.

    python -m poseterior.reports.pages.coverage ../shared/data WORK [STAGE…]

Every stage leaves its result in the folder WORK and is not done twice; the page is written when all
are there. With names of stages, only those are done. About half an hour on two cores.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import xarray as xr

from poseterior.inference.estimators import ESTIMATORS
from poseterior.inference.studies.calibration import Instance, judge
from poseterior.inference.studies.calibration.choices import CHOICES
from poseterior.inference.studies.calibration.coverage import summary
from poseterior.inference.studies.calibration.ece import ece
from poseterior.inference.studies.calibration.exclusions import (
    Rank,
    Reason,
    exclusions,
    from_text,
    hung,
    ranking,
)
from poseterior.inference.studies.calibration.quantities import ENERGY_BALL, LOG_DENSITY, TARP
from poseterior.inference.studies.calibration.real import TRUE, instances
from poseterior.probmodel.datasets import Case
from poseterior.reports.figures.coverage import controls_figure, coverage_figure, ranks_figure
from poseterior.reports.figures.misses import Exclusion, misses_figure
from poseterior.reports.pages.page import Data, Page, Values, Work, run
from poseterior.reports.pages.real import (
    BELIEFS,
    KS,
    REAL_CELLS,
    REAL_ROOTS,
    cases,
    cell_path,
    choices,
    hold_out,
    real,
    sensitivity,
)
from poseterior.reports.pages.simulated import (
    BASE_MEASURES,
    BASELINE_EVALUATIONS,
    CONTROLLED,
    JUDGED_SIMULATIONS,
    baselines,
    controls,
    exact,
    toy,
)
from poseterior.reports.tables import Column, Sheet, sheet_of
from poseterior.reports.tables.coverage import (
    families_table,
    joints_table,
    reasons_table,
    settings_table,
)

STAGES = {
    "exact": exact,
    "toy": toy,
    "real": real,
    "controls": controls,
    "choices": choices,
    "sensitivity": sensitivity,
    "baselines": baselines,
}
SHOWN_QUANTITIES = ("right_wrist z", "left_knee x", LOG_DENSITY, ENERGY_BALL, TARP)
"""Quantities whose ranks are drawn for every control."""
Stages = Annotated[list[str] | None, typer.Argument(help="Only these.")]
Trees = Mapping[tuple[str, ...], xr.DataTree]
"""By torso and camera, 2D error, and how many joints are missing."""


def read(path: Path) -> xr.DataTree:
    """A tree, in memory."""
    with xr.open_datatree(path) as tree:
        return tree.load()


def simulations(work: Path, pattern: str) -> dict[str, xr.Dataset]:
    """Simulations by the name of their sampler."""
    trees = map(read, sorted(work.glob(pattern)))
    return {tree.attrs["sampler"]: tree["simulation"].to_dataset() for tree in trees}


def toy_table(found: Mapping[str, Sequence[float]]) -> Sheet:
    """How often each test rejects, from its p-values."""
    levels = {"rejects at 1 %": 0.01, "at 5 %": 0.05, "at 20 %": 0.2}
    rows = [
        (
            name,
            *(float(np.mean(np.array(p_values) <= level)) for level in levels.values()),
            len(p_values),
        )
        for name, p_values in found.items()
    ]
    return sheet_of(
        ["test", *(Column(head, form="{:.1%}".format) for head in levels), "repetitions"], rows
    )


def judged_table(found: Mapping[str, xr.Dataset]) -> Sheet:
    """The tests on several posteriors; beside them the field's ECE of the same simulations, and its
    floor."""
    sheet = families_table({name: judge(simulation) for name, simulation in found.items()})
    records = [
        {**record, "ece": _ece(simulation)}
        for record, simulation in zip(sheet.records, found.values(), strict=True)
    ]
    *columns, verdict = sheet.columns
    return Sheet([*columns, Column("field's ECE (floor)", "ece"), verdict], records)


def _ece(simulation: xr.Dataset) -> str:
    number = np.arange(simulation.sizes["simulation"])
    found = ece(simulation.whole.values, simulation.stand_in.values, number)
    return f"{found.whole.value:.3f} ({found.floor:.3f})"


def reasons_of(trees: Trees, *, estimated: bool) -> tuple[list[Rank], int]:
    """Why truths are excluded, commonest first, and of how many; under estimated torsos and
    cameras, or under the true ones."""
    texts = [
        text
        for (estimator, *_), tree in trees.items()
        if (estimator != TRUE) == estimated
        for text in tree["simulation"].reasons.values.tolist()
    ]
    return ranking([from_text(text) for text in texts]), len(texts)


def misses(work: Path, data: Path, labels: Sequence[str]) -> list[Exclusion]:
    """One picture for each reason: of the instances that it excludes, those with the fewest other
    reasons first, the one at a quarter."""
    held = hold_out(work, data)
    found: dict[str, list[tuple[int, Exclusion]]] = {label: [] for label in labels}
    some = cases(held, "detector")
    for estimator in ESTIMATORS:
        views = instances(some, held.model, estimator, poses=held.dictionary, num_candidates=1)
        why = exclusions(held.model, some, views)
        for case, instance, reasons in zip(some, views, why, strict=True):
            for label in {reason.label for reason in reasons} & set(labels):
                title = f"{label}\n({estimator}, subject {case.subject})"
                miss = _miss(title, case, instance, reasons, label)
                found[label].append((len(reasons), miss))
    chosen = [sorted(many, key=lambda one: one[0]) for many in found.values() if many]
    return [many[len(many) // 4][1] for many in chosen]


def _miss(title: str, case: Case, instance: Instance, why: list[Reason], label: str) -> Exclusion:
    candidate = instance.frame.best
    joints = hung(case, candidate) * float(candidate.camera.scale)
    pixels = joints + np.append(np.asarray(candidate.camera.translation), 0.0)
    first = sorted(why, key=lambda reason: reason.label != label)
    radius = instance.frame.observation.reach * candidate.camera.scale
    return Exclusion(title, case.detection.keypoints, radius, case.pixels, pixels, first)


def choices_table(found: xr.Dataset) -> Sheet:
    """Best-of-k errors by way of choosing, and modes represented."""
    rows = []
    for way in CHOICES:
        for name, words, form in (
            ("error", "the truth", "{:.0f} mm"),
            ("floor", "one more draw", "{:.0f} mm"),
            ("modes", "modes represented", "{:.0%}"),
        ):
            values = found[name].sel(way=way).mean("pose").values
            rows.append((way, words, *map(form.format, values)))
    against = Column("against", left=True)
    return sheet_of(["chosen by", against, *(f"k = {k}" for k in KS)], rows)


def page(work: Work, data: Data) -> Page:
    """The page and its pictures, all stages done."""
    paths = [work / f"exact-{upper}-{lower}.nc" for upper, lower in BASE_MEASURES]
    exacts = {
        f"upper {upper}, lower {lower}": read(path)["simulation"].to_dataset()
        for (upper, lower), path in zip(BASE_MEASURES, paths, strict=True)
    }
    costs = [json.loads(path.with_suffix(".json").read_text()) for path in paths]
    first = next(iter(exacts.values()))
    wrong = simulations(work, "control-*.nc")
    others = simulations(work, "baseline-*.nc")
    trees: Trees = {
        (estimator, error, str(missing)): read(cell_path(work, estimator, error, missing))
        for estimator, error, missing in REAL_CELLS
    }
    variants = [read(work / f"variant-{number}.nc") for number in range(len(BELIEFS))]
    summaries = {key: summary(tree) for key, tree in trees.items()}
    estimated, own = (reasons_of(trees, estimated=whose) for whose in (True, False))
    controlled = {"exact rejection": first.isel(simulation=slice(CONTROLLED)), **wrong}
    beside = {"exact rejection": first.isel(simulation=slice(JUDGED_SIMULATIONS)), **others}
    changed = [((tree.attrs["variant"],), summary(tree)) for tree in variants]
    values: Values = {
        "measures": judged_table(exacts),
        "cost": ", ".join(f"{cpu:.0f} s" for cpu, _ in costs),
        "toy": toy_table(json.loads((work / "toy.json").read_text())),
        "controls": judged_table(controlled),
        "baselines": judged_table(beside),
        "real": settings_table(summaries.items(), ("torso and camera", "2D error", "missing")),
        "joints": joints_table(summaries["zhou", "detector", "0"]),
        "joints_true": joints_table(summaries[TRUE, "detector", "0"]),
        "reasons": reasons_table(*estimated),
        "reasons_true": reasons_table(*own),
        "choices": choices_table(read(work / "choices.nc")["choices"].to_dataset()),
        "sensitivity": settings_table(changed, ("variant",)),
        "judged": JUDGED_SIMULATIONS,
        "evaluations": f"{BASELINE_EVALUATIONS:,}",
        "poses": summaries[TRUE, "detector", "0"].size,
    }
    curves = {name: trees[name, "detector", "0"]["simulation"].to_dataset() for name in REAL_ROOTS}
    commonest = [rank.label for rank in estimated[0][:3]]
    pictures = {
        "coverage": ranks_figure(first),
        "coverage_controls": controls_figure({"exact": first, **wrong}, SHOWN_QUANTITIES),
        "coverage_real": coverage_figure(curves),
        "coverage_misses": misses_figure(misses(work, data, commonest)),
    }
    return Page("coverage", values, pictures)


def main(data: Data, work: Work, stages: Stages = None) -> Page | None:
    """Does what is left of the stages (all, if none is named), and fills the page from them."""
    for name in stages or STAGES:
        STAGES[name](work, data)
    return None if stages else page(work, data)


if __name__ == "__main__":
    run(main)
