"""The verdict on draws of a frozen target: the judge of `inference.studies.comparison`, with exact
draws and the evidence of the target.

    judged = verdict(load("arm"), submit(load("arm"), points=draws))
    judged.judgement.verdict, judged.sentence"""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.benchmark.references import (
    mode_counts,
    reference,
    sample_at,
    shipped_points,
)
from poseterior.inference.benchmark.submission import Submission
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.studies.comparison.distances import in_spreads, wasserstein
from poseterior.inference.studies.comparison.judge import Judgement, judge
from poseterior.inference.studies.comparison.sample import Sample

MOST_JUDGED = 20_000
"""Draws that are judged at most, taken evenly along every chain."""


class Assessment(NamedTuple):
    """What there is to say of draws.

    Attributes
    ----------
    target : its name.
    judgement : the judge's tests, mixing and modes.
    draws, judged : how many were given, and how many were judged.
    worst_coordinate, worst_w1 : the coordinate whose law is farthest from the exact one, and how
        far in W1, in its standard deviations.
    evidence_error, evidence_error_se : stated log evidence less the exact one, nats, and the
        standard error of the difference; NaN where it is not stated.
    per_evaluation, per_second : effective draws of the worst coordinate; NaN where the cost is not
        stated.
    """

    target: str
    judgement: Judgement
    draws: int
    judged: int
    worst_coordinate: str
    worst_w1: float
    evidence_error: float
    evidence_error_se: float
    per_evaluation: float
    per_second: float


def exact_sample(target: FrozenTarget) -> Sample:
    """The exact draws that all are compared with: those that are in the package."""
    return sample_at(target, shipped_points(target.name)[None])


def verdict(
    target: FrozenTarget, submission: Submission, exact: Sample | None = None
) -> Assessment:
    """Judges draws.

    Parameters
    ----------
    target
        What they are draws of.
    submission
        The draws.
    exact
        As `exact_sample` gives them, for whoever judges several.

    Raises
    ------
    BadInput
        As `references.shipped_points`.
    """
    known = reference(target.name)
    exact = exact_sample(target) if exact is None else exact
    sample = sample_at(target, _thinned(submission.points))
    stated = submission.log_evidence, submission.log_evidence_se
    judgement = judge(
        sample,
        exact,
        evidence=stated,
        exact_evidence=(known.log_evidence, known.log_evidence_se),
        mode_counts=mode_counts(known, exact),
    )
    distances = wasserstein(*in_spreads(sample.flat, exact.flat, exact.flat.std(axis=0)))
    worst = int(np.argmax(distances))
    varying = np.array(exact.names)[exact.flat.std(axis=0) > 1e-12]
    effective = judgement.mixing.worst
    return Assessment(
        target=target.name,
        judgement=judgement,
        draws=submission.given,
        judged=sample.num_draws,
        worst_coordinate=str(varying[worst]),
        worst_w1=float(distances[worst]),
        evidence_error=stated[0] - known.log_evidence,
        evidence_error_se=math.hypot(stated[1], known.log_evidence_se),
        per_evaluation=effective / submission.evaluations,
        per_second=effective / submission.seconds,
    )


def _thinned(points: np.ndarray) -> np.ndarray:
    """At most `MOST_JUDGED` draws of `(chain, draw, d)`."""
    chains, draws, _ = points.shape
    return points[:, :: max(1, -(-chains * draws // MOST_JUDGED))]
