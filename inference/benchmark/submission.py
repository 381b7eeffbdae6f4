"""Draws that somebody wants judged: read from a file, or given as arrays, and refused where they
cannot be draws of the target.

An .npz holds one of `points`, `box`, `cube` (the charts of `target`), `(n, d)`, or `(chain, draw,
d)` for Markov chains; and where there are any, `weights` or `log_weights` of as many draws,
`log_evidence` with `log_evidence_se`, `evaluations`, and `seconds`. An .npy holds points. The
group posterior of ArviZ's netCDF may hold the same, `(chain, draw, d)`.

Draws with weights are a set: nested samplers sort them, so their order says nothing of how they
were made, and the verdict is the same in any."""

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from poseterior.inference.benchmark.forms import SamplerTarget
from poseterior.inference.resampling import WEIGHTS, counting, let_pass, merged, weights_of
from poseterior.probmodel.arrays import HDF5, ArrayFile, plain_numbers, read_array, read_tables
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import opened

NETCDF = (".nc", ".nc4", ".h5", ".hdf5")
CHARTS = ("points", "box", "cube")
STATED = ("log_evidence", "log_evidence_se", "evaluations", "seconds")
FEWEST_OF_CHAIN = 4
"""Draws of a chain, of which fewer tell nothing of it."""
SINGLE_ROUNDING = 1e-5
"""How far beyond its reach, in reaches, a joint may lie by the rounding of 32-bit numbers."""
DRAWS_FILE, DRAWS_ADVICE = "file of draws", "write one with numpy.savez('draws.npz', points=draws)"


@dataclass(frozen=True)
class Submission:
    """Draws of a target.

    Attributes
    ----------
    points : `(chain, draw, d)`, equally weighted, as points of R^d.
    given : how many draws there were; where they came with weights, `points` are those that a
        draw's weight over the largest one let pass.
    log_evidence, log_evidence_se : as the sampler states them, NaN where it does not.
    evaluations, seconds : what the draws cost, NaN where it is not said.
    """

    points: np.ndarray
    given: int
    log_evidence: float = math.nan
    log_evidence_se: float = math.nan
    evaluations: float = math.nan
    seconds: float = math.nan


def read_submission(path: str | os.PathLike, target: SamplerTarget) -> Submission:
    """The draws in a file. Raises `BadInput` as `submit`, and where it is no such file."""
    if Path(path).suffix.lower() == ".npy":
        return submit(target, points=read_array(path, DRAWS_FILE, DRAWS_ADVICE), where=str(path))
    if Path(path).suffix.lower() in NETCDF:
        return submit(target, **_posterior(Path(path)), where=str(path))
    arrays = read_tables(path, DRAWS_FILE, DRAWS_ADVICE)
    unknown = sorted(set(arrays) - {*CHARTS, *WEIGHTS, *STATED})
    if unknown:
        known = ", ".join((*CHARTS, *WEIGHTS, *STATED))
        raise BadInput(f"{path} has an array {shown(unknown[0])}; it may have {known}")
    return submit(target, **arrays, where=str(path))


def _posterior(path: Path) -> dict[str, np.ndarray]:
    """What the posterior of ArviZ's netCDF holds of the arrays that an .npz may have."""
    group = "posterior/"
    with opened(path, DRAWS_FILE, DRAWS_ADVICE) as file:
        found = ArrayFile(file, str(path), DRAWS_FILE, DRAWS_ADVICE)
        found.require(HDF5)
        names = [name.removeprefix(group) for name in found.names() if name.startswith(group)]
        wanted = [name for name in (*CHARTS, *WEIGHTS, *STATED) if name in names]
        arrays = found.read([group + name for name in wanted])
    if not names:
        raise BadInput(f"{path} has no group posterior, as ArviZ writes one; {DRAWS_ADVICE}")
    if not set(CHARTS) & set(wanted):
        raise BadInput(
            f"the group posterior of {path} has {shown(names)}, but none of {', '.join(CHARTS)};"
            " give one of these as a variable (chain, draw, coordinate of the target)"
        )
    return {name.removeprefix(group): values for name, values in arrays.items()}


def submit(target: SamplerTarget, *, where: str = "the draws", **arrays: np.ndarray) -> Submission:
    """Draws as arrays, by the names that they have in a file.

    Raises
    ------
    BadInput
        Where they have another shape, are not finite, lie outside of the support, stand still, or
        have weights that cannot be any.
    """
    chart, values = _chart(arrays, target, where)
    log_weights = weights_of(arrays, values.shape[:-1], where)
    numbers = {name: _number(arrays, name, where) for name in STATED}
    if log_weights is not None:
        counts = counting(log_weights)
        given = int(counts.sum())
        rows, log_weights = merged(values[counts], log_weights[counts])
        values = rows[None]
    else:
        given = values.shape[0] * values.shape[1]
    points = _points(chart, values, target, where)
    _require_support(points, target, where)
    if log_weights is not None:
        points = points[:, let_pass(log_weights, np.random.default_rng(0))]
    _require_motion(points, where)
    return Submission(points, given, **numbers)


def _chart(
    arrays: dict[str, np.ndarray], target: SamplerTarget, where: str
) -> tuple[str, np.ndarray]:
    """The name of the chart, and the draws in it as `(chain, draw, d)`."""
    named = [name for name in CHARTS if name in arrays]
    if len(named) != 1:
        said = " and ".join(named) or "none"
        raise BadInput(
            f"{where} must have one of {', '.join(CHARTS)}, but has {said}; {DRAWS_ADVICE}"
        )
    values = plain_numbers(arrays[named[0]], f"{named[0]} of {where}")
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[-1] != target.dim or not values.size:
        raise BadInput(
            f"{named[0]} of {where} has shape {np.shape(arrays[named[0]])}; {target.name} needs"
            f" (draws, {target.dim}) or (chains, draws, {target.dim})"
        )
    broken = ~np.isfinite(values).all(axis=-1)
    if broken.any():
        raise BadInput(
            f"{int(broken.sum()):,} of {broken.size:,} draws of {where} have a coordinate that is"
            " not finite; leave them out, or run anew"
        )
    return named[0], values


def _number(arrays: dict[str, np.ndarray], name: str, where: str) -> float:
    if name not in arrays:
        return math.nan
    value = plain_numbers(arrays[name], f"{name} of {where}")
    if value.size != 1:
        raise BadInput(f"{name} of {where} has shape {value.shape}; give one number")
    found = float(value.reshape(()))
    if not math.isfinite(found):
        raise BadInput(f"{name} of {where} is {found:g}; give a finite number, or leave it out")
    if name != "log_evidence" and found <= 0:
        raise BadInput(f"{name} of {where} is {found:g}; it must be a number above 0")
    return found


def _points(chart: str, values: np.ndarray, target: SamplerTarget, where: str) -> np.ndarray:
    """The draws as points of R^d."""
    if chart == "points":
        return values
    outside = ~((values >= 0) & (values <= 1)).all(axis=-1)
    if outside.any():
        raise BadInput(
            f"{int(outside.sum()):,} of {outside.size:,} draws of {where} lie outside of the unit"
            f" {chart}; its coordinates are between 0 and 1"
        )
    return target.points_of_box(values) if chart == "box" else target.prior_transform(values)


def _require_support(points: np.ndarray, target: SamplerTarget, where: str) -> None:
    misfits = target.misfits(points.reshape(-1, target.dim))
    outside = (misfits > 1 + SINGLE_ROUNDING).any(axis=-1)
    if outside.any():
        worst = int(np.argmax(misfits.max(axis=0)))
        raise BadInput(
            f"{int(outside.sum()):,} of {len(outside):,} draws of {where} lie outside of the"
            f" support: {target.seen_joints[worst]} lies up to {misfits[:, worst].max():.3g} times"
            " its reach away from where it was detected; give them weight 0, or leave them out"
        )


def _require_motion(points: np.ndarray, where: str) -> None:
    if points.shape[1] < FEWEST_OF_CHAIN:
        raise BadInput(
            f"{where} come to {points.shape[1]} draws a chain, weights considered; the judge needs"
            f" {FEWEST_OF_CHAIN} at least, so run the sampler on"
        )
    still = (points == points[:, :1]).all(axis=(1, 2))
    if still.any():
        raise BadInput(
            f"chain {int(np.argmax(still))} of {where} stands still: its {points.shape[1]:,} draws"
            f" are one and the same ({int(still.sum())} of {len(still)} chains do); run it on, or"
            " leave it out"
        )
