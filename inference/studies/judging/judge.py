"""The verdict on anybody's posterior: `judge_coverage`.

Half of the chance of a false alarm goes to tests of the levels (ranks of every quantity, highest
density, energy balls, TARP, a classifier), corrected by Holm, half to the test of where
(`where.locally`)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.studies.calibration.quantities import (
    CLASSIFIER,
    ENERGY_BALL,
    LOG_DENSITY,
    TARP,
)
from poseterior.inference.studies.calibration.verdict import (
    CALIBRATED,
    FALSE_ALARM,
    FEWEST_SIMULATIONS,
    MISCALIBRATED,
    Calibration,
    judge,
)
from poseterior.inference.studies.intervals import Interval
from poseterior.inference.studies.judging.brought import FEWEST_INSTANCES, Brought, One
from poseterior.inference.studies.judging.files import WHICH_FILE
from poseterior.inference.studies.judging.learned import as_numbers, features, learned_levels
from poseterior.inference.studies.judging.where import (
    SHOWN,
    Columns,
    Locally,
    central,
    curves,
    locally,
    share_held,
)
from poseterior.inference.studies.levels import (
    cut_open,
    distance_level,
    effective_number,
    energy_level,
    rank_level,
)
from poseterior.probmodel.failures import BadInput

FAILURES_NAMED = 3


@dataclass(frozen=True)
class Judged:
    """What was found.

    Attributes
    ----------
    level : `(simulation, quantity)`
        Where each truth stands among its draws, 0 to 1; uniform if the posterior is right. NaN of
        instances that failed.
    calibration
        The tests of the levels.
    local, map
        Where it fails, and coverage by bins of each covariate; None without covariates.
    effective : `(simulation,)`
        Number of draws of equal weight that the draws are worth.
    verdict, sentence
        Of all tests together, with one false-alarm rate.
    notes
        Sentences on what makes the verdict weaker than it looks.
    """

    level: xr.DataArray
    calibration: Calibration
    local: Locally | None
    map: xr.Dataset | None
    effective: np.ndarray
    verdict: str
    sentence: str
    notes: tuple[str, ...]

    @property
    def covered(self) -> dict[str, list[Interval]]:
        """How often central intervals of 50, 80 and 95 % hold the truth, by quantity."""
        columns = {name: self.level.sel(quantity=name).values for name in self.quantities}
        known = {name: column[np.isfinite(column)] for name, column in columns.items()}
        return {
            name: [share_held(central(column, nominal)) for nominal in SHOWN]
            for name, column in known.items()
            if len(column)
        }

    @property
    def quantities(self) -> list[str]:
        """Those of the user's own that were looked at, without what is made of all of them."""
        return own_quantities(self.level.dropna("quantity", how="all"))

    @property
    def tree(self) -> xr.DataTree:
        """Everything, with the group `prior_sbc` that `arviz_plots.plot_ecdf_pit` reads."""
        table = self.level.dropna("quantity", how="all").dropna("simulation")
        ranks = {
            name.replace(" ", "_"): (("chain", "draw"), table.sel(quantity=name).values[None])
            for name in table.quantity.values.tolist()
        }
        groups = {
            "simulation": self.level.to_dataset(name="level"),
            "prior_sbc": xr.Dataset(ranks, coords={"chain": [0]}),
            "tests": self.calibration.tests,
        }
        tree = xr.DataTree.from_dict(groups | ({} if self.map is None else {"map": self.map}))
        tree.attrs.update(verdict=self.verdict, sentence=self.sentence)
        return tree


def own_quantities(level: xr.DataArray) -> list[str]:
    """The quantities of a table of levels, without what is made of all of them."""
    made = {LOG_DENSITY, ENERGY_BALL, TARP, CLASSIFIER}
    return [name for name in level.quantity.values.tolist() if name not in made]


def judge_coverage(
    draws: Any,
    truth: Any,
    weights: Any = None,
    log_density: Any = None,
    covariates: Any = None,
    *,
    names: Sequence[str] | None = None,
    circular: Sequence[str] = (),
    seed: int = 0,
    false_alarm: float = FALSE_ALARM,
) -> Judged:
    """Are these posteriors calibrated, and where do they fail? Of independent instances, each with
    draws of its posterior and its truth.

    Parameters
    ----------
    draws
        `(instances, draws, quantities)`: an array, an xarray Dataset or a mapping of arrays
        `(instances, draws, ...)` by name.
    truth
        `(instances, quantities)`, in the same form.
    weights
        `(instances, draws)` of weighted draws (importance sampling, nested samplers), 0 or more.
    log_density
        A pair: log densities `(instances,)` of the truths and `(instances, draws)` of the draws,
        each up to a constant of its instance.
    covariates
        `(instances, covariates)`, or by name: numbers or words that what was seen decides, not the
        truth.
    names
        Of the quantities, where they have none.
    circular
        The names of those that are angles, in radians: they are ranked by arcs.
    seed
        Of ties, references, the classifier and permutations.
    false_alarm
        Chance that a right posterior is accused, over all tests together.

    Returns
    -------
    Judged
        Verdict, tests, and where it fails.

    Raises
    ------
    BadInput
        Where shapes do not agree, truths are not finite, weights are negative or all zero, draws
        are constant, a covariate has one value, or there are fewer than 20 instances.

    Notes
    -----
    Talts et al. 2018 and Modrák et al. 2023 (ranks), Lemos et al. 2023 (TARP), Linhart et al. 2023
    (a classifier that sees what was seen); ranks by what is learned of other instances keep their
    level exactly. Weighted ranks are uniform up to the reciprocal of the effective number.
    """
    brought = Brought.of(
        draws,
        truth,
        weights=weights,
        log_density=log_density,
        covariates=covariates,
        names=names,
        circular=circular,
    )
    return judge_brought(brought, seed=seed, false_alarm=false_alarm)


def judge_brought(brought: Brought, *, seed: int = 0, false_alarm: float = FALSE_ALARM) -> Judged:
    """The same of what was read from a file (`files.read_brought`)."""
    level, effective, failures = _levels(brought, seed)
    found = judge_levels(level, brought.covariates, seed=seed, false_alarm=false_alarm)
    notes = (*brought.notes(effective), *failures[:FAILURES_NAMED], *found.notes)
    return replace(found, effective=effective, notes=notes)


def judge_levels(
    level: xr.DataArray,
    covariates: Columns,
    *,
    seed: int = 0,
    false_alarm: float = FALSE_ALARM,
) -> Judged:
    """The verdict on levels (simulation, quantity) that are there already, as those of
    `coverage.nc`, NaN for instances that failed. Raises `BadInput` as `judge_coverage`, but for
    covariates of one value, which are left out."""
    judged = level.notnull().any("quantity").values
    notes = list(_of_files(covariates, judged))
    covariates = _varied({name: np.asarray(one)[judged] for name, one in covariates.items()})
    share = false_alarm / 2 if covariates else false_alarm
    table = level.to_dataset(name="level")
    calibration = judge(table, false_alarm=share, fewest=FEWEST_INSTANCES)
    local = map_ = None
    own = [name for name in level.quantity.values if name != CLASSIFIER]
    ranked = level.sel(quantity=own)[judged]
    if covariates:
        map_ = curves(ranked, covariates)
        try:
            local = locally(ranked, covariates, seed, own_quantities(level))
        except BadInput as error:
            notes.append(str(error))
    size = int(calibration.tests["size"].max())
    if size < FEWEST_SIMULATIONS:
        notes.append(
            f"{size} instances notice gross faults only: draws of 0.8 times the spread need"
            f" {FEWEST_SIMULATIONS} or more"
        )
    verdict = calibration.verdict
    sentence = calibration.sentence
    if local is not None and local.p_value < share:
        if verdict == CALIBRATED:
            sentence = f"right on average only; {local.sentence}"
            verdict = MISCALIBRATED
        else:
            sentence = f"{sentence}. Where: {local.sentence}"
    elif local is not None:
        sentence = f"{sentence}; no part of the instances differs (p {local.p_words})"
    effective = np.full(level.sizes["simulation"], np.nan)
    return Judged(
        level=level,
        calibration=calibration,
        local=local,
        map=map_,
        effective=effective,
        verdict=verdict,
        sentence=sentence,
        notes=tuple(notes),
    )


def _of_files(covariates: Columns, judged: np.ndarray) -> Iterator[str]:
    """In words how many instances failed of which file, where they are of several."""
    if WHICH_FILE in covariates and not judged.all():
        files = np.asarray(covariates[WHICH_FILE])
        each = [(name, files == name) for name in np.unique(files)]
        said = [f"{(own & ~judged).sum()} of {own.sum()} of {name}" for name, own in each]
        yield f"failed are {', '.join(said)}"


def _varied(columns: Columns) -> Columns:
    """Those covariates on which something can depend."""
    return {name: one for name, one in columns.items() if len(np.unique(one)) > 1}


def _levels(brought: Brought, seed: int) -> tuple[xr.DataArray, np.ndarray, list[str]]:
    """Levels (simulation, quantity), effective numbers `(simulation,)`, and why some instances are
    not judged; one instance is held at a time."""
    angles = [name in brought.circular for name in brought.names]
    context = as_numbers(brought.covariates, len(brought))
    level = np.full((len(brought), len(brought.names) + 3), np.nan)
    effective = np.full(len(brought), np.nan)
    shown: list[np.ndarray | None] = [None] * len(brought)
    failures = []
    other = _unwound(_last(brought), angles)
    for index in range(len(brought)):
        found = brought.one(index)
        if isinstance(found, str):
            failures.append(f"instance {index} is not judged: {found}")
            continue
        _require_spread(found, index, brought.names)
        one = _unwound(found, angles)
        rng = np.random.default_rng([seed, index])
        level[index] = _ranked(one, other, rng)
        effective[index] = _worth(one)
        shown[index] = features(one, context[index], rng)
        other = one
    names = [*brought.names, LOG_DENSITY, ENERGY_BALL, TARP, CLASSIFIER]
    table = xr.DataArray(
        np.column_stack([level, learned_levels(shown, seed)]),
        dims=("simulation", "quantity"),
        coords={"simulation": np.arange(len(level)), "quantity": names},
    )
    return table, effective, failures


def _last(brought: Brought) -> One:
    """The last instance that can be judged. Raises `BadInput` where none can."""
    found: One | str = ""
    for index in reversed(range(len(brought))):
        found = brought.one(index)
        if not isinstance(found, str):
            return found
    raise BadInput(f"no instance can be judged; of instance 0 {found}")


def _ranked(one: One, other: One, rng: np.random.Generator) -> np.ndarray:
    """`(q + 3,)` levels. TARP's reference is a draw of another instance, which nothing of this one
    decides."""
    level = rank_level(one.truth, one.draws, rng, one.weights)
    density = np.nan
    if one.log_density is not None:
        density = float(rank_level(one.log_density[0], one.log_density[1:], rng, one.weights))
    middle = other.draws.mean(axis=0)
    scale = other.draws.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    truth = (one.truth - middle) / scale
    draws = (one.draws - middle) / scale
    reference = (other.draws[rng.integers(len(other.draws))] - middle) / scale
    ball = energy_level(truth, draws, rng, one.weights)
    far = distance_level(truth, draws, reference, rng, one.weights)
    return np.array([*level, density, ball, far])


def _unwound(one: One, angles: Sequence[bool]) -> One:
    """Angles as arcs."""
    if not any(angles):
        return one
    truth = one.truth.copy()
    draws = one.draws.copy()
    truth[angles], draws[:, angles] = cut_open(truth[angles], draws[:, angles], one.weights)
    return one._replace(truth=truth, draws=draws)


def _worth(one: One) -> float:
    return float(len(one.draws)) if one.weights is None else effective_number(one.weights)


def _require_spread(one: One, index: int, names: Sequence[str]) -> None:
    """Raises `BadInput` where no draw of an instance differs from another."""
    if (np.ptp(one.draws, axis=0) == 0).all():
        raise BadInput(
            f"all {len(one.draws)} draws of instance {index} are the same ({names[0]} ="
            f" {one.draws[0, 0]:.4g}); a posterior of one point is no posterior, so look at the"
            " sampler"
        )
