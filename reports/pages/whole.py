"""Whether the posterior of torso, camera and pose together means what it says: writes
reports/whole.md.

    python -m poseterior.reports.pages.whole work

A thousand simulations from the model itself, about half an hour on one core; `work` keeps what
is done, and a run that was stopped goes on there.
"""

from pathlib import Path

import numpy as np
import xarray as xr

from poseterior.inference.studies.calibration import calibrate, judge
from poseterior.inference.studies.calibration.quantities import OF_ROOT
from poseterior.probmodel import PoseModel
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.reports.figures.coverage import ranks_figure
from poseterior.reports.pages.page import Page, Values, Work, run
from poseterior.reports.tables import Sheet, sheet_of
from poseterior.reports.tables.coverage import families_table, p_text
from poseterior.reports.tables.words import spoken

WHOLE_SIMULATIONS = 1000
WHOLE_ROOTS, WHOLE_DRAWS, WHOLE_SEED = 300, 400, 7
WHOLE_BUDGET = 30_000_000
"""Most proposals for a simulation."""


def simulated(work: Path) -> xr.Dataset:
    """The simulations by weighted roots."""
    tree = calibrate(
        PoseModel(),
        seed=WHOLE_SEED,
        num_simulations=WHOLE_SIMULATIONS,
        num_samples=WHOLE_DRAWS,
        root=UNCERTAIN,
        num_roots=WHOLE_ROOTS,
        max_proposals=WHOLE_BUDGET,
        out=work / "coverage.nc",
    )
    return tree["simulation"].to_dataset()


def roots_table(tests: xr.Dataset) -> Sheet:
    """The tests of what a root is made of: p-values, and those corrected for all questions."""
    asked = [name for name in OF_ROOT if name in tests.quantity.values]
    rows = []
    for name in asked:
        one = tests.sel(quantity=name)
        p_values = (p_text(float(one[kind])) for kind in ("p_value", "adjusted"))
        rows.append((spoken(name), *p_values))
    return sheet_of(("of the root", "p", "p, corrected for all"), rows)


def main(work: Work) -> Page:
    """Does what is left of the simulations, then writes the page."""
    right = simulated(work)
    verdict = judge(right)
    number = right.num_draws.values
    values: Values = {
        "simulations": f"{WHOLE_SIMULATIONS:,}",
        "roots": WHOLE_ROOTS,
        "draws": WHOLE_DRAWS,
        "fewest": int(number.min()),
        "middle": int(np.median(number)),
        "sentence": f"{verdict.verdict}: {verdict.sentence}",
        "families": families_table({"weighted roots": verdict}),
        "of_root": roots_table(verdict.tests),
    }
    return Page("whole", values, {"whole": ranks_figure(right)})


if __name__ == "__main__":
    run(main)
