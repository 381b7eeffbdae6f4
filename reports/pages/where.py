"""Writes reports/where.md: where posteriors of real poses hold the truth, by what was seen, and
what recalibration brings on people that it was not made from.

    python -m poseterior.reports.pages.where ../shared/data work

`work` keeps what the tables are made of."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy import stats

from poseterior.inference.studies.calibration import cover
from poseterior.inference.studies.calibration.quantities import MOVING_NAMES
from poseterior.inference.studies.calibration.real import read_cases
from poseterior.inference.studies.calibration.record import COVARIATES
from poseterior.inference.studies.intervals import of_share
from poseterior.inference.studies.judging.files import Levels, joined
from poseterior.inference.studies.judging.judge import Judged, judge_levels
from poseterior.inference.studies.judging.repair import recalibrate
from poseterior.inference.studies.judging.where import SHOWN, central
from poseterior.inference.studies.person_views import even, levels_tree, of_the_person
from poseterior.probmodel import DetectorErrors
from poseterior.probmodel.datasets import Case, Noise, from_motions
from poseterior.probmodel.datasets.person_views import read_person_views
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.sessions import read_session
from poseterior.reports.figures.judging import judged_figure
from poseterior.reports.pages.page import Data, Page, Work, kept, kept_json, run
from poseterior.reports.pages.people import HALVES, strangers
from poseterior.reports.pages.strangers import (
    UNKNOWN,
    judged,
    mediapipe,
    read,
    views_of_session,
)
from poseterior.reports.tables.coverage import share
from poseterior.reports.tables.judging import map_table, worst
from poseterior.reports.tables.sheet import Column, Sheet, sheet_of

COVERED_DRAWS = 200
"""Draws of a pose, of as many roots."""
PLACES = {
    "across the image": tuple(f"{name} {axis}" for name in MOVING_NAMES for axis in "xy"),
    "depth": tuple(f"{name} z" for name in MOVING_NAMES),
    "head's depth": ("head z",),
    "length of the head": ("length of head",),
    "length of the forearm": ("length of forearm",),
}


CAPTURES = {
    "the calibrated cameras": ("multicamera", "none"),
    "motion capture": ("cmu/actions_train.npz", "gaussian:0.01"),
}
"""Of the data pack, and the noise of their detections."""
OF_PEOPLE, TOGETHER_VIEWS = "motion capture of 18 people", "all views"
ROOM = "mvor/mvor.npz"
FILM_VIEWS = 100
"""Of the film by each detector, evenly over its four cameras, and of the operating room."""
MIDDLE = "shoulders"
"""About which views are judged."""
CAPTURED_POSES, PEOPLES_POSES = 60, 90


SEED = 49


def main(data: Data, work: Work) -> Page:
    """Draws what is left to be drawn, then writes the page."""
    found = {
        name: _levels(
            work / f"{Path(path).stem}.nc",
            PoseModel(),
            *read_cases(data / path, frames=CAPTURED_POSES, noise=noise),
        )
        for name, (path, noise) in CAPTURES.items()
    }
    parts, people = [], []
    for number, some in enumerate(strangers(work, data)):
        frames, noise = PEOPLES_POSES // HALVES, Noise("gaussian", 0.01)
        cases = list(from_motions(some.motions, "CMU", frames=frames, noise=noise))
        parts.append(_levels(work / f"people-{number}.nc", some.model, cases, {}))
        people += [case.subject for case in cases]
    found[OF_PEOPLE] = xr.concat(parts, "simulation")
    every = {name: _judgeable(table) for name, table in found.items()} | _views(data, work)
    said = {name: judge_levels(*one, seed=SEED) for name, one in every.items()}
    level = found[OF_PEOPLE]["level"]
    return Page(
        "where",
        {
            "covered_draws": COVERED_DRAWS,
            "held": _held_table(found),
            "judged": _judged_table(said),
            "worst": worst(said[TOGETHER_VIEWS]),
            "map": map_table(said[TOGETHER_VIEWS]),
            "film_views": FILM_VIEWS,
            "recalibrated": _recalibrated_table(level, np.array(people)),
            "people": len({*people}),
            "poses": len(people),
        },
        {"where": judged_figure(said[TOGETHER_VIEWS])},
    )


def _levels(path: Path, model: PoseModel, cases: list[Case], source: dict[str, Any]) -> xr.Dataset:
    """Levels (simulation, quantity), the recording of each simulation, and its covariates."""
    tree = kept(path, _covered, model, cases, source)
    return tree["simulation"].to_dataset().merge(tree["covariates"].to_dataset())


def _judgeable(table: xr.Dataset) -> Levels:
    columns = {name: table[name].values for name in COVARIATES if name in table}
    return table["level"], columns


def _views(data: Path, work: Path) -> dict[str, Levels]:
    """Views of the film by two detectors and of the operating room, about the shoulders, under the
    embedded law before a camera whose focal length is not known; each, and all of them together."""
    film = read_session(data / "multicamera")
    room = even(list(filter(of_the_person, read_person_views(data / ROOM))), FILM_VIEWS)
    every = {
        "film, OpenPose": views_of_session(film, film.people, FILM_VIEWS),
        "film, MediaPipe": views_of_session(film, mediapipe(film, data).people, FILM_VIEWS),
        "operating room, OpenPose": room,
    }
    found: dict[str, Levels] = {}
    for name, views in every.items():
        laws = [DetectorErrors.default()] * len(views)
        path = work / f"{name.replace(', ', '-').replace(' ', '-')}-where.json"
        outcome = kept_json(path, judged, views, {}, laws, UNKNOWN, name)
        tree = levels_tree(views, {MIDDLE: read(outcome, MIDDLE)})
        seen = tree["covariates"].to_dataset()
        columns = {str(name): column.values for name, column in seen.items()}
        found[name] = tree["simulation"].to_dataset()["level"], columns
    return found | {TOGETHER_VIEWS: joined(found)}


def _covered(model: PoseModel, cases: list[Case], source: dict[str, Any]) -> xr.DataTree:
    return cover(model, cases, source=source, num_samples=COVERED_DRAWS, num_roots=COVERED_DRAWS)


def _held_table(found: Mapping[str, xr.Dataset]) -> Sheet:
    rows = [
        (
            name,
            *(
                share(
                    of_share(
                        central(table["level"].sel(quantity=list(some)).values, 0.5),
                        table["recording"].values,
                    )
                )
                for some in PLACES.values()
            ),
        )
        for name, table in found.items()
    ]
    return sheet_of([Column("50 % intervals hold", left=True), *map(Column, PLACES)], rows)


def _judged_table(said: Mapping[str, Judged]) -> Sheet:
    """What `coverage judge` says of each, and where."""
    rows = [
        (name, f"{len(one.level):,}", one.verdict, one.local.sentence if one.local else "–")
        for name, one in said.items()
    ]
    return sheet_of(("of", "instances", "verdict", "where most"), rows)


def _recalibrated_table(level: xr.DataArray, people: np.ndarray) -> Sheet:
    """By kind and nominal level: what the draws' own intervals hold, and what those hold that were
    recalibrated on everybody else."""
    rows = []
    for name, some in PLACES.items():
        few = level.sel(quantity=list(some))
        for nominal in SHOWN:
            reach = _reach(few, people, nominal)
            holds = np.abs(2 * few.values - 1) <= reach
            taken = float(np.median(reach))
            wider = stats.norm.ppf((1 + taken) / 2) / stats.norm.ppf((1 + nominal) / 2)
            rows.append(
                (
                    name,
                    f"{nominal:.0%}",
                    share(of_share(central(few.values, nominal), people)),
                    share(of_share(holds, people)),
                    f"{taken:.0%}" if taken <= 1 else "no bound",
                    f"{wider:.2f}" if taken < 1 else "∞",
                )
            )
    head = [Column("", left=True), Column("nominal"), Column("own interval holds")]
    head += [Column(name) for name in ("recalibrated holds", "interval taken", "times as wide")]
    return sheet_of(head, rows)


def _reach(level: xr.DataArray, people: np.ndarray, nominal: float) -> np.ndarray:
    """`(simulation, quantity)`: the nominal level of the draws' own interval that holds as much of
    everybody else."""
    reach = np.empty(level.shape)
    for who in np.unique(people):
        repair = recalibrate(level[people != who])
        reach[people == who] = [repair.reach(name, nominal) for name in repair.quantities]
    return reach


if __name__ == "__main__":
    run(main)
