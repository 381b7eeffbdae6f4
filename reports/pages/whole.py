"""Whether the posterior of torso, camera and pose together means what it says: writes
reports/whole.md.

    python -m poseterior.reports.pages.whole work

A thousand simulations from the model itself before each camera, about half an hour on one core for
each; `work` keeps what is done, and a run that was stopped goes on there.
"""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from poseterior.inference.sampler import WEIGHTED
from poseterior.inference.studies.calibration import calibrate, judge
from poseterior.inference.studies.calibration.assess import Answer
from poseterior.inference.studies.calibration.posteriors import Sampler, independent_roots
from poseterior.inference.studies.calibration.quantities import OF_ROOT
from poseterior.inference.studies.calibration.simulations import (
    FARTHEST_SEEN,
    NEAREST_SEEN,
    Instance,
)
from poseterior.inference.studies.calibration.verdict import Calibration
from poseterior.probmodel import Lens, PoseModel
from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.reports.figures.coverage import ranks_figure
from poseterior.reports.pages.page import Page, Values, Work, run
from poseterior.reports.tables import Sheet, sheet_of
from poseterior.reports.tables.coverage import families_table, p_text
from poseterior.reports.tables.words import spoken

WHOLE_SIMULATIONS, CONTROLS = 1000, 100
WHOLE_ROOTS, WHOLE_DRAWS, WHOLE_SEED = 300, 400, 7
WHOLE_BUDGET = 30_000_000
"""Most proposals for a simulation."""
METRES = MILLIMETRES / 1000
"""Of a body unit."""
LENS = Lens.unknown(1920.0, np.array([960.0, 540.0]))
WEAK, UNKNOWN_LENS, BLIND = "weak perspective", "focal length unknown", "unknown, believed weak"


@functools.cache
def _weakly() -> Sampler:
    return independent_roots(PoseModel(), WHOLE_DRAWS, WHOLE_ROOTS, max_proposals=WHOLE_BUDGET)


def blind(index: int, instance: Instance, key: jax.Array) -> Answer:
    """The control: draws under weak perspective of what a lens saw, which are then said to be of
    its middle focal length."""
    answer = _weakly()(index, instance, key)
    assert answer.points is not None
    middle = np.full(len(answer.joints), LENS.number // 2)
    return answer._replace(points=answer.points._replace(lens=middle))


WAYS: dict[str, tuple[Callable[[], PoseModel], str | Sampler, int]] = {
    WEAK: (PoseModel, WEIGHTED, WHOLE_SIMULATIONS),
    UNKNOWN_LENS: (lambda: PoseModel(lens=LENS), WEIGHTED, WHOLE_SIMULATIONS),
    BLIND: (lambda: PoseModel(lens=LENS), blind, CONTROLS),
}
"""The model, who draws, and how many simulations, by what is believed of the camera."""


def simulated(work: Path, way: str) -> xr.Dataset:
    """The simulations by weighted roots."""
    model, sampler, number = WAYS[way]
    tree = calibrate(
        model(),
        sampler,
        seed=WHOLE_SEED,
        num_simulations=number,
        num_samples=WHOLE_DRAWS,
        root=UNCERTAIN,
        num_roots=WHOLE_ROOTS,
        max_proposals=WHOLE_BUDGET,
        out=work / f"{way.replace(', ', '-').replace(' ', '-')}.nc",
    )
    return tree["simulation"].to_dataset()


def roots_table(verdicts: Mapping[str, Calibration]) -> Sheet:
    """The tests of what a root is made of: p-values, in brackets those corrected for all
    questions."""
    asked = [name for name in OF_ROOT if name in verdicts[WEAK].tests.quantity.values]
    rows = []
    for name in asked:
        ones = [verdict.tests.sel(quantity=name) for verdict in verdicts.values()]
        texts = (f"{p_text(float(one.p_value))} ({p_text(float(one.adjusted))})" for one in ones)
        rows.append((spoken(name), *texts))
    return sheet_of(("of the root, p", *verdicts), rows)


def main(work: Work) -> Page:
    """Does what is left of the simulations, then writes the page."""
    found = {way: simulated(work, way) for way in WAYS}
    verdicts = {way: judge(simulation) for way, simulation in found.items()}
    numbers = {way: found[way].num_draws.values for way in (WEAK, UNKNOWN_LENS)}
    sentences = [f"- *{way}*: {one.verdict}: {one.sentence}." for way, one in verdicts.items()]
    values: Values = {
        "simulations": f"{WHOLE_SIMULATIONS:,}",
        "controls": CONTROLS,
        "roots": WHOLE_ROOTS,
        "draws": WHOLE_DRAWS,
        "fewest": min(int(number.min()) for number in numbers.values()),
        "middle": int(np.median(numbers[WEAK])),
        "middle_unknown": int(np.median(numbers[UNKNOWN_LENS])),
        "near": f"{METRES * NEAREST_SEEN:.0f}",
        "far": f"{METRES * FARTHEST_SEEN:.0f}",
        "sentences": "\n".join(sentences),
        "families": families_table(verdicts),
        "of_root": roots_table({way: verdicts[way] for way in numbers}),
    }
    pictures = {
        "whole": ranks_figure(found[WEAK]),
        "whole-unknown": ranks_figure(found[UNKNOWN_LENS]),
    }
    return Page("whole", values, pictures)


if __name__ == "__main__":
    run(main)
