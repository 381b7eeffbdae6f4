"""Where posteriors of real poses hold the truth, and what recalibration brings on people that it
was not made from: tables of reports/judging.md."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy import stats

from poseterior.inference.studies.calibration import cover
from poseterior.inference.studies.calibration.quantities import MOVING_NAMES
from poseterior.inference.studies.calibration.real import read_cases
from poseterior.inference.studies.intervals import of_share
from poseterior.inference.studies.judging.repair import recalibrate
from poseterior.inference.studies.judging.where import SHOWN, central
from poseterior.probmodel.datasets import Case, Noise, from_motions
from poseterior.probmodel.model import PoseModel
from poseterior.reports.pages.page import kept
from poseterior.reports.pages.people import HALVES, strangers
from poseterior.reports.tables.coverage import share
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
OF_PEOPLE = "motion capture of 18 people"
CAPTURED_POSES, PEOPLES_POSES = 60, 90


class OnOurs(NamedTuple):
    """What posteriors of real poses hold, what recalibrated ones hold of others, and of how many
    people and poses the latter is."""

    held: Sheet
    recalibrated: Sheet
    people: int
    poses: int


def on_ours(data: Path, work: Path) -> OnOurs:
    """Of the data pack; the levels are kept in the folder."""
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
    levels, recordings = zip(*parts, strict=True)
    together: xr.DataArray = xr.concat(list(levels), "simulation")
    found[OF_PEOPLE] = together, np.concatenate(recordings)
    return OnOurs(
        _held_table(found),
        _recalibrated_table(found[OF_PEOPLE][0], np.array(people)),
        len({*people}),
        len(people),
    )


def _levels(
    path: Path, model: PoseModel, cases: list[Case], source: dict[str, Any]
) -> tuple[xr.DataArray, np.ndarray]:
    """Levels (simulation, quantity), and the recording of each simulation."""
    tree = kept(path, _covered, model, cases, source)
    found = tree["simulation"].to_dataset()
    return found["level"], found["recording"].values


def _covered(model: PoseModel, cases: list[Case], source: dict[str, Any]) -> xr.DataTree:
    return cover(model, cases, source=source, num_samples=COVERED_DRAWS, num_roots=COVERED_DRAWS)


def _held_table(found: Mapping[str, tuple[xr.DataArray, np.ndarray]]) -> Sheet:
    rows = [
        (
            name,
            *(
                share(of_share(central(level.sel(quantity=list(some)).values, 0.5), recording))
                for some in PLACES.values()
            ),
        )
        for name, (level, recording) in found.items()
    ]
    return sheet_of([Column("50 % intervals hold", left=True), *map(Column, PLACES)], rows)


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
