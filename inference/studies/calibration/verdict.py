"""What the levels say: one test of uniformity for each quantity, all of them held to one
false-alarm rate.

Holm's procedure corrects for the number of tests, however they depend on each other. "calibrated"
means that no test rejects with so many simulations, no more; too few simulations are refused, and
failures are counted."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.studies.calibration.quantities import (
    CLASSIFIER,
    ENERGY_BALL,
    LOG_DENSITY,
    TARP,
)
from poseterior.inference.studies.calibration.uniformity import uniformity
from poseterior.probmodel.failures import BadInput

BY_COORDINATES, BY_MEASURES = SUBJECTS = "coordinates", "measures"
"""What a posterior is judged by."""
FALSE_ALARM = 0.01
"""Chance that a right posterior is said to be miscalibrated, over all tests together."""
FEWEST_SIMULATIONS = 100
"""Simulations below which nothing is said: fewer would not notice draws of 0.8 times the spread.
Where some of as many failed, the others are judged."""
FEW_FAILURES = 0.01
"""With a larger share of failures the others prove nothing: which ones fail may depend on the
truth."""
SMALLEST = 1e-300
"""A p-value below which doubles say nothing."""
CALIBRATED, MISCALIBRATED, CANNOT_TELL = "calibrated", "miscalibrated", "cannot tell"


class Calibration(NamedTuple):
    """`tests`, with the dimension `quantity`: `statistic` (smallest binomial tail), `p_value`,
    `adjusted` (Holm's) and `size`; the `verdict` and a `sentence` for it."""

    tests: xr.Dataset
    verdict: str
    sentence: str

    def p_value(self, quantity: str) -> float:
        """Of one quantity, before the correction."""
        return float(self.tests.p_value.sel(quantity=quantity))

    @property
    def families(self) -> dict[str, float]:
        """p-values of the ranks (SBC: the smallest one, corrected by Holm), of the regions of
        highest density, of the energy balls, of TARP
        and of the classifier; without what was not looked at."""
        single = {
            "highest density": LOG_DENSITY,
            "energy balls": ENERGY_BALL,
            "TARP": TARP,
            "classifier": CLASSIFIER,
        }
        known = set(self.tests.quantity.values)
        ranks = [name for name in self.tests.quantity.values if name not in single.values()]
        found = (
            {"ranks (SBC)": float(holm(self.tests.p_value.sel(quantity=ranks).values).min())}
            if ranks
            else {}
        )
        return found | {
            family: self.p_value(name) for family, name in single.items() if name in known
        }


def judge(
    simulation: xr.Dataset,
    *,
    of: str = BY_COORDINATES,
    false_alarm: float = FALSE_ALARM,
    fewest: int = FEWEST_SIMULATIONS,
) -> Calibration:
    """The verdict on levels by (simulation, quantity), NaN where an instance failed: `of`
    coordinates and whatever else is known of a pose, or of measures.

    Where more than `FEW_FAILURES` of them failed, which ones may depend on the truth: then a
    quantity counts against the sampler only if it did so whatever the levels of the failed ones.
    Those that are left are judged, however many there were to be. Raises `BadInput` where there are
    fewer than `fewest` simulations, or all of them failed."""
    table = levels_by_quantity(simulation, of)
    total = len(table)
    failed = int((~np.isfinite(table.values).any(axis=1)).sum())
    if total < fewest or failed == total:
        lost = f", {failed} of them failed" if failed else ""
        raise BadInput(f"there are {total} simulations{lost}; the tests need at least {fewest}")
    columns = {
        name: column[np.isfinite(column)]
        for name, column in zip(table.quantity.values.tolist(), table.values.T, strict=True)
        if np.isfinite(column).any()
    }
    found = [uniformity(column) for column in columns.values()]
    p_values = np.array([test.p_value for test in found])
    tests = xr.Dataset(
        {
            "statistic": ("quantity", [test.statistic for test in found]),
            "p_value": ("quantity", p_values),
            "adjusted": ("quantity", holm(p_values)),
            "size": ("quantity", [test.size for test in found]),
        },
        coords={"quantity": list(columns)},
        attrs={"false_alarm": false_alarm, "multiplicity": "Holm", "num_failed": failed},
    )
    rejects = float(tests.adjusted.min()) < false_alarm
    proven = rejects and (
        failed <= FEW_FAILURES * total
        or min(uniformity(one, failed).p_value for one in columns.values()) * len(columns)
        < false_alarm
    )
    return Calibration(tests, *_verdict(tests, failed, total, rejects, proven))


def levels_by_quantity(simulation: xr.Dataset, of: str) -> xr.DataArray:
    """Levels by (simulation, quantity), of one of `SUBJECTS`."""
    if of == BY_COORDINATES:
        return simulation["level"]
    return simulation["measure_level"].rename(measure="quantity")


def _sizes(tests: xr.Dataset) -> str:
    """Of how many simulations the tests are, in words; the classifier's is of half of them."""
    size = tests["size"].values[tests.quantity.values != CLASSIFIER]
    least, most = int(size.min()), int(size.max())
    return f"{least} to {most}" if least < most else str(most)


def _verdict(
    tests: xr.Dataset, failed: int, total: int, rejects: bool, proven: bool
) -> tuple[str, str]:
    worst = tests.isel(quantity=int(np.argmin(tests.adjusted.values)))
    number = tests.sizes["quantity"]
    p_value, adjusted = (_bounded(float(one)) for one in (worst.p_value, worst.adjusted))
    said = f"{worst.quantity.item()}: p {p_value}, over all {number} tests {adjusted}"
    missing = f"; the sampler failed on {failed} of {total} simulations" if failed else ""
    many = failed > FEW_FAILURES * total
    if proven:
        whatever = ", whatever these would have said" if many else ""
        return MISCALIBRATED, f"{said}, with {int(worst['size'])} simulations{missing}{whatever}"
    if many:
        others = f"that alone may be why {said}" if rejects else "no test rejects on the others"
        return CANNOT_TELL, f"the sampler failed on {failed} of {total} simulations; {others}"
    return (
        CALIBRATED,
        (
            f"no test of {number} rejects at {tests.attrs['false_alarm']:g} with"
            f" {_sizes(tests)} simulations{missing}"
        ),
    )


def _bounded(p_value: float) -> str:
    """A p-value in words: none is 0, though doubles may end there."""
    return f"= {p_value:.2g}" if p_value > SMALLEST else f"< {SMALLEST:g}"


def holm(p_values: np.ndarray) -> np.ndarray:
    """p-values `(n,)` corrected for their number (Holm 1979): rejecting those below α errs at all
    with chance ≤ α."""
    order = np.argsort(p_values)
    steps = np.maximum.accumulate(p_values[order] * np.arange(len(p_values), 0, -1))
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(steps, 1.0)
    return corrected
