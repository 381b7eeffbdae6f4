"""What our external samplers share: the graded likelihood that they climb, and how its draws become
draws of the target."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from poseterior.inference.benchmark.forms import SamplerTarget
from poseterior.inference.benchmark.programs import in_jax
from poseterior.inference.benchmark.submission import Submission, submit

HARDNESS = 50.0
"""Of the walls: a joint's area grows by a fiftieth, which leaves most draws inside."""


def graded(target: SamplerTarget) -> Callable[[np.ndarray], float]:
    """The graded likelihood of one point in JAX, compiled."""
    density = in_jax(target)
    compiled = jax.jit(lambda point: density.log_graded(point, HARDNESS))
    compiled(np.zeros(target.dim))
    return lambda point: float(compiled(point))


def inside(
    target: SamplerTarget,
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
