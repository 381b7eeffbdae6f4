"""Intervals that hold what they say, from a posterior that does not: split conformal prediction on
the levels of instances whose truth is known (Vovk, Gammerman & Shafer 2005; per group: Mondrian).

    repair = recalibrate(found.level, by=("score", score))
    low, high = repair.interval(draws, "wrist z", 0.95, value=0.8)

A central interval of the draws holds the truth where the level lies near one half; so how far out
the intervals must reach is a quantile of ``|2 level - 1|`` over the instances. One more instance
that is exchangeable with them is held with at least the nominal chance, at every sample size,
whatever the posterior; where too few instances or too extreme levels leave no bound, the interval
has none. What comes out is intervals, one quantity at a time, and no posterior any more."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.studies.judging.where import by_value
from poseterior.inference.studies.levels import effective_number
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import replacing

THIRDS = 3
"""Groups of a covariate of numbers, of as many instances each."""
NO_POSTERIOR = "recalibrated intervals, one quantity at a time; no posterior any more"
_WHAT = "file of recalibration"
_ADVICE = "write one with `poseterior coverage judge FILE --recalibrate OUT.json`"


@dataclass(frozen=True)
class Recalibration:
    """How far out intervals must reach.

    Attributes
    ----------
    scores
        By group and quantity, `|2 level - 1|` `(instances,)` in ascending order.
    covariate
        Whose groups they are; empty where there is one group.
    edges
        Between groups of numbers; empty where the groups are the covariate's values.
    """

    scores: dict[str, dict[str, np.ndarray]]
    covariate: str = ""
    edges: tuple[float, ...] = ()

    @property
    def quantities(self) -> list[str]:
        """Those that can be recalibrated."""
        return list(next(iter(self.scores.values())))

    def group(self, value: Any = None) -> str:
        """The group of a covariate's value.

        Parameters
        ----------
        value
            A number or a word, as the covariate has them.

        Returns
        -------
        str
            Its name in `scores`.

        Raises
        ------
        BadInput
            Where there is none.
        """
        if not self.covariate:
            return ""
        if self.edges and value is not None:
            return str(int(np.searchsorted(self.edges, float(value))))
        if str(value) not in self.scores:
            raise BadInput(
                f"{self.covariate} {value} is no group of the recalibration; known are"
                f" {', '.join(self.scores)}"
            )
        return str(value)

    def reach(self, quantity: str, nominal: float, value: Any = None) -> float:
        """The nominal level of the draws' own central interval that is to be taken.

        Parameters
        ----------
        quantity
            One of `quantities`.
        nominal
            The share that the interval shall hold.
        value
            Of the covariate, where there are groups.

        Returns
        -------
        float
            Infinite where too few instances bound it.

        Raises
        ------
        BadInput
            On an unknown quantity, level or group.
        """
        if not 0 < nominal < 1:
            raise BadInput(f"the interval's level must lie between 0 and 1, not {nominal}")
        known = self.scores[self.group(value)]
        if quantity not in known:
            raise BadInput(
                f"{quantity} is no quantity of the recalibration; known are {', '.join(known)}"
            )
        scores = known[quantity]
        place = int(np.ceil((len(scores) + 1) * nominal * (1 - 1e-12)))
        return float(scores[place - 1]) if place <= len(scores) else np.inf

    def interval(
        self,
        draws: np.ndarray,
        quantity: str,
        nominal: float,
        value: Any = None,
        weights: np.ndarray | None = None,
    ) -> tuple[float, float]:
        """The recalibrated interval of draws.

        Parameters
        ----------
        draws : `(n,)`
            Of one quantity.
        quantity, nominal, value
            As `reach` takes them.
        weights : `(n,)`
            Where they have any.

        Returns
        -------
        float, float
            Infinite where it has no bound.

        Raises
        ------
        BadInput
            As `reach`.
        """
        reach = self.reach(quantity, nominal, value)
        weights = np.ones(len(draws)) if weights is None else weights
        low = _bound(draws, weights, reach)
        return low, -_bound(-draws, weights, reach)

    def save(self, path: Path, provenance: dict[str, Any]) -> None:
        """Writes it as JSON, whole or not at all.

        Parameters
        ----------
        path
            The file.
        provenance
            What it shall say besides: seed, source, versions.
        """
        record = {
            "what": NO_POSTERIOR,
            "covariate": self.covariate,
            "edges": list(self.edges),
            "scores": {
                group: {name: values.tolist() for name, values in many.items()}
                for group, many in self.scores.items()
            },
        }
        with replacing(path) as partial:
            Path(partial).write_text(json.dumps(record | provenance), encoding="utf-8")


def _bound(draws: np.ndarray, weights: np.ndarray, reach: float) -> float:
    """The lower bound: the first draw with so much of the others below that no truth whose level
    lies inside can lie below it."""
    worth = effective_number(weights)
    order = np.argsort(draws)
    up_to = worth * np.cumsum(weights[order]) / weights.sum()
    tail = (worth + 1) * (1 - reach) / 2
    if not tail >= 1:
        return -np.inf
    place = int(np.searchsorted(up_to, (tail - 1) * (1 + 1e-12), side="right"))
    return float(draws[order[min(place, len(draws) - 1)]])


def recalibrate(level: xr.DataArray, by: tuple[str, np.ndarray] | None = None) -> Recalibration:
    """From levels (simulation, quantity) of instances with truths, for each group of a covariate
    `by` (its name and values `(simulation,)`) where one is given.

    Parameters
    ----------
    level
        As `judge_coverage` finds them.
    by
        The covariate of the groups; none: all instances together.

    Returns
    -------
    Recalibration
        How far out intervals must reach.

    Raises
    ------
    BadInput
        Where the covariate's values do not match the levels.
    """
    values = level.values
    if by is None:
        return Recalibration({"": _scores(level.quantity.values, values)})
    name, column = by
    column = np.asarray(column)
    if column.shape != (len(values),):
        raise BadInput(
            f"{name} has shape {column.shape} for {len(values)} instances; give each one value"
        )
    if by_value(column):
        groups = {str(one): column == one for one in np.unique(column)}
        edges: tuple[float, ...] = ()
    else:
        edges = tuple(np.unique(np.quantile(column, np.arange(1, THIRDS) / THIRDS)).tolist())
        place = np.searchsorted(edges, column)
        groups = {str(at): place == at for at in range(len(edges) + 1)}
    return Recalibration(
        {key: _scores(level.quantity.values, values[inside]) for key, inside in groups.items()},
        name,
        edges,
    )


def _scores(names: np.ndarray, levels: np.ndarray) -> dict[str, np.ndarray]:
    found = {}
    for name, column in zip(names.tolist(), levels.T, strict=True):
        known = column[np.isfinite(column)]
        lost = len(column) - len(known)  # a posterior without draws holds nothing
        found[name] = np.concatenate([np.sort(np.abs(2 * known - 1)), np.full(lost, np.inf)])
    return found


def read_recalibration(path: Path) -> Recalibration:
    """Raises `BadInput` where the file is none of `Recalibration.save`."""
    record = read_json(path, _WHAT, _ADVICE)
    try:
        scores = {
            str(group): {str(name): np.array(values, float) for name, values in many.items()}
            for group, many in record["scores"].items()
        }
        edges = tuple(float(edge) for edge in record["edges"])
        covariate = str(record["covariate"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadInput(f"{path} is no {_WHAT} ({type(error).__name__}); {_ADVICE}") from None
    ordered = all(
        values.ndim == 1 and (np.diff(values) >= 0).all() and (values >= 0).all()
        for many in scores.values()
        for values in many.values()
    )
    if not scores or not ordered:
        raise BadInput(f"{path} is no {_WHAT}: its scores are not in ascending order; {_ADVICE}")
    return Recalibration(scores, covariate, edges)
