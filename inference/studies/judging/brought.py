"""What somebody brings to be judged: draws beside truths, with what belongs to them.

`Brought.of(draws, truth, ...)` takes arrays, xarray objects, and mappings of arrays by name as
bayesflow has them, refuses what cannot be judged in a sentence, and says in `notes` what makes a
verdict weaker than it looks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from poseterior.inference.resampling import counting, logs_of
from poseterior.inference.studies.judging.where import Columns, checked, share_held
from poseterior.inference.studies.levels import effective_number
from poseterior.probmodel.failures import BadInput

FEWEST_INSTANCES = 20
"""Below, no test is worth its name."""
FEWEST_WORTH = 9
"""Effective draws of an instance below which it counts as failed: its ranks would say next to
nothing."""
FEW_EFFECTIVE = 50
"""Effective draws below which weighted ranks are no longer uniform to a hundredth."""
MOST_ALIKE = 0.01
"""Share of draws that are copies of others, above which it is said."""
LOOKED_AT = 20
"""Instances that are looked at for copies."""


class One(NamedTuple):
    """One instance: `truth` `(q,)`, finite `draws` `(n, q)` that weigh something, their `weights`
    `(n,)` or None, and log densities `(1 + n,)`, the truth's first, or None."""

    truth: np.ndarray
    draws: np.ndarray
    weights: np.ndarray | None
    log_density: np.ndarray | None


@dataclass(frozen=True)
class Brought:
    """Draws beside truths.

    Attributes
    ----------
    draws : `(instances, draws, q)`
        An array, or whatever has a shape and gives an instance's draws by its number.
    truth : `(instances, q)`
    names
        Of the quantities.
    log_weights : `(instances, draws)` or None
    log_density : `(instances, 1 + draws)` or None
        Of the truth, then of the draws.
    covariates
        By name, `(instances,)` each.
    circular
        Names of quantities that are angles, in radians.
    """

    draws: Any
    truth: np.ndarray
    names: tuple[str, ...]
    log_weights: np.ndarray | None
    log_density: np.ndarray | None
    covariates: Columns
    circular: tuple[str, ...]

    @classmethod
    def of(
        cls,
        draws: Any,
        truth: Any,
        *,
        weights: Any = None,
        log_weights: Any = None,
        log_density: Any = None,
        covariates: Any = None,
        names: Sequence[str] | None = None,
        circular: Sequence[str] = (),
    ) -> "Brought":
        """As `judge_coverage` takes them. Raises `BadInput` as it."""
        table, found = _columns(draws, 2)
        known, ours = _columns(truth, 1)
        if ours is not None and found is not None and set(ours) != set(found):
            raise BadInput(
                f"draws have the quantities {', '.join(found)}, truths {', '.join(ours)}; give"
                " both the same names"
            )
        if ours is not None and found is not None:
            known = known[:, [ours.index(name) for name in found]]
        _require_shapes(np.shape(table), known)
        instances, number, quantities = np.shape(table)
        named = tuple(names or found or ours or (f"quantity {at}" for at in range(quantities)))
        if len(named) != quantities or len(set(named)) != quantities:
            raise BadInput(
                f"there are {quantities} quantities and {len(set(named))} different names; give"
                " each quantity one"
            )
        if unknown := set(circular) - set(named):
            raise BadInput(
                f"{', '.join(sorted(unknown))} shall be circular and is no quantity; known are"
                f" {', '.join(named)}"
            )
        _require_truths(known, named)
        return cls(
            draws=table,
            truth=known,
            names=named,
            log_weights=_log_weights(weights, log_weights, (instances, number)),
            log_density=_log_density(log_density, (instances, number)),
            covariates=checked(_named_columns(covariates), instances),
            circular=tuple(circular),
        )

    def __len__(self) -> int:
        return len(self.truth)

    def one(self, index: int) -> One | str:
        """An instance as it is judged, or why it cannot be."""
        draws = np.asarray(self.draws[index], float)
        weights = None
        keep = np.ones(len(draws), bool)
        if self.log_weights is not None:
            keep = counting(self.log_weights[index])
            if not keep.any():
                return "all weights are zero"
            weights = np.exp(self.log_weights[index][keep] - self.log_weights[index].max())
        draws = draws[keep]
        if not np.isfinite(draws).all():
            return f"{int((~np.isfinite(draws)).any(axis=1).sum())} draws are not finite"
        effective = len(draws) if weights is None else effective_number(weights)
        if effective < FEWEST_WORTH:
            return f"its draws are worth {effective:.1f} of equal weight"
        density = self.log_density
        if density is not None:
            density = density[index][np.concatenate([[True], keep])]
        return One(self.truth[index], draws, weights, density)

    def notes(self, effective: np.ndarray) -> Iterator[str]:
        """Sentences on what makes the verdict weaker than it looks; `effective` `(instances,)`
        number of draws, NaN of those that failed."""
        if self.log_weights is not None:
            some = effective[np.isfinite(effective)]
            worth = f"weighted draws are worth {np.median(some):.0f} of equal weight (median)"
            few = int((some < FEW_EFFECTIVE).sum())
            weak = f", fewer than {FEW_EFFECTIVE} for {few} instances: their ranks are approximate"
            yield f"{worth}{weak if few else ''}"
        alike = [self._copies(index) for index in range(0, len(self), -(-len(self) // LOOKED_AT))]
        if np.median(alike) > MOST_ALIKE:
            yield (
                f"{np.median(alike):.0%} of an instance's draws are copies of others (median):"
                " ranks take draws to be independent, so thin chains, and bring resampled draws"
                " with their weights instead"
            )

    def _copies(self, index: int) -> float:
        draws = np.asarray(self.draws[index], float)
        if self.log_weights is not None:
            draws = draws[counting(self.log_weights[index])]
        steps = [len(np.unique(column)) <= np.sqrt(len(column)) for column in draws.T]
        if all(steps):  # discrete quantities have to repeat
            return 0.0
        return 1 - len(np.unique(draws, axis=0)) / max(len(draws), 1)


def _columns(given: Any, leading: int) -> tuple[Any, list[str] | None]:
    """A table whose last axis is the quantities, and their names where they have any: of arrays,
    mappings of arrays, and xarray objects. `leading` axes are instances (and draws)."""
    if hasattr(given, "data_vars"):
        given = {str(name): given[name] for name in given.data_vars}
    if not isinstance(given, Mapping):
        return (given if hasattr(given, "fetch") else np.asarray(given, float)), None
    parts = []
    names: list[str] = []
    for name, values in given.items():
        column = np.asarray(values, float)
        if column.ndim < leading:
            raise BadInput(
                f"{name} has shape {column.shape}; it needs {leading} axes at least, instances"
                f"{' and draws' if leading > 1 else ''} first"
            )
        flat = column.reshape(*column.shape[:leading], -1)
        parts.append(flat)
        shape = column.shape[leading:]
        names += (
            [name]
            if not shape
            else [f"{name}[{', '.join(map(str, place))}]" for place in np.ndindex(*shape)]
        )
    if not parts or len({part.shape[:leading] for part in parts}) > 1:
        said = ", ".join(f"{name} {np.shape(values)}" for name, values in given.items())
        raise BadInput(f"the quantities have no instances in common ({said or 'none at all'})")
    return np.concatenate(parts, axis=-1), names


def _named_columns(covariates: Any) -> dict[str, np.ndarray]:
    if covariates is None:
        return {}
    if hasattr(covariates, "data_vars"):
        return {str(name): covariates[name].values for name in covariates.data_vars}
    if isinstance(covariates, Mapping):
        return {str(name): np.asarray(values) for name, values in covariates.items()}
    table = np.asarray(covariates)
    table = table[:, None] if table.ndim == 1 else table
    if table.ndim != 2:
        raise BadInput(f"covariates have shape {table.shape}; they need (instances, covariates)")
    return {f"covariate {at}": column for at, column in enumerate(table.T)}


def _require_shapes(shape: tuple[int, ...], truth: np.ndarray) -> None:
    if len(shape) != 3 or truth.ndim != 2 or (shape[0], shape[2]) != truth.shape or not shape[2]:
        raise BadInput(
            f"draws of shape {shape} and truths of shape {truth.shape} do not agree; they need"
            " (instances, draws, quantities) and (instances, quantities)"
        )
    if shape[1] < FEWEST_WORTH:
        raise BadInput(
            f"{shape[1]} draws an instance are too few to rank a truth among; give at least"
            f" {FEWEST_WORTH}, and some hundred to see tails"
        )


def _require_truths(truth: np.ndarray, names: Sequence[str]) -> None:
    bad = ~np.isfinite(truth)
    if bad.any():
        row, column = (int(at) for at in np.argwhere(bad)[0])
        raise BadInput(
            f"{int(bad.any(axis=1).sum())} of {len(truth)} truths are not finite, the first"
            f" {names[column]} of instance {row}; leave out what is not known"
        )
    if len(truth) < FEWEST_INSTANCES:
        held = share_held(np.arange(len(truth)) < len(truth) // 2) if len(truth) else None
        said = (
            f": of intervals of 50 % that held {len(truth) // 2} of them no more could be said than"
            f" that they hold {held.low:.0%} to {held.high:.0%}"
            if held
            else ""
        )
        raise BadInput(
            f"{len(truth)} instances are too few for a verdict{said}; give at least"
            f" {FEWEST_INSTANCES}"
        )


def _log_weights(weights: Any, log_weights: Any, shape: tuple[int, int]) -> np.ndarray | None:
    if weights is None and log_weights is None:
        return None
    if weights is not None and log_weights is not None:
        raise BadInput("there are weights and log_weights; leave one out")
    values = np.asarray(weights if log_weights is None else log_weights, float)
    if values.shape != shape:
        raise BadInput(
            f"weights have shape {values.shape} for draws {shape}; give each draw of each instance"
            " one"
        )
    return logs_of(values, "weights" if log_weights is None else "log_weights")


def _log_density(given: Any, shape: tuple[int, int]) -> np.ndarray | None:
    """`(instances, 1 + draws)` of a pair (of truths, of draws)."""
    if given is None:
        return None
    try:
        truth, draws = (np.asarray(part, float) for part in given)
    except (TypeError, ValueError):
        truth = draws = np.empty(0)
    if truth.shape != shape[:1] or draws.shape != shape:
        raise BadInput(
            f"log densities have shapes {truth.shape} and {draws.shape}; they need a pair, of"
            f" truths {shape[:1]} and of draws {shape}"
        )
    return np.concatenate([truth[:, None], draws], axis=1)
