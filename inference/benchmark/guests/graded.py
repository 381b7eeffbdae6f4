"""What guests share: the graded likelihood that they climb, and how its draws become draws of the
target."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark.programs import in_jax
from poseterior.inference.benchmark.submission import Submission, submit
from poseterior.inference.benchmark.target import FrozenTarget

HARDNESS = 50.0
"""Of the walls: a joint's area grows by a fiftieth, which leaves most draws inside."""
CLOCK = time.process_time


class Outcome(NamedTuple):
    """What a sampler brought.

    Attributes
    ----------
    submission
        Its draws.
    given
        How many exact draws it was started with.
    kept
        The share of the work that brought draws, evenly; 0 where all of them come at the end.
    steps
        How many draws in a row are the path of one walker; 1 where they are no paths.
    """

    submission: Submission
    given: int = 0
    kept: float = 0.0
    steps: int = 1


Guest = Callable[[FrozenTarget, int, Allowance], Outcome | None]
"""Draws of a target, by a seed, at most so dear; None where none came inside the walls."""


def graded(target: FrozenTarget) -> Callable[[np.ndarray], float]:
    """The graded likelihood of one point in JAX, compiled."""
    density = in_jax(target)
    compiled = jax.jit(lambda point: density.log_graded(point, HARDNESS))
    compiled(np.zeros(target.dim))
    return lambda point: float(compiled(point))


def inside(
    target: FrozenTarget,
    points: np.ndarray,
    log_weights: np.ndarray,
    error: float,
    cost: dict[str, float],
) -> Submission | None:
    """Draws of the graded likelihood as draws of the target: those outside weigh nothing.

    Parameters
    ----------
    target
        What they are to be draws of.
    points : `(n, d)`
        Points of R^d.
    log_weights : `(n,)`
        Where the error of the evidence is known, those of points inside add up to it.
    error
        Of the log evidence; NaN where there is none.
    cost
        Evaluations and seconds.

    Returns
    -------
    Submission or None
        None where no draw is inside.
    """
    counted = np.where(target.misfit(points) <= 1, log_weights, -np.inf)
    if not np.isfinite(counted).any():
        return None
    stated: dict[str, Any] = {name: np.array(value) for name, value in cost.items()}
    if np.isfinite(error):
        stated["log_evidence"] = np.logaddexp.reduce(counted)
        stated["log_evidence_se"] = np.array(error)
    return submit(target, points=points, log_weights=counted, where="the draws", **stated)
