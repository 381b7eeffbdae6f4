"""A law judged by pairs that it has not seen: how many errors lie within its regions."""

import numpy as np
from scipy import stats

from poseterior.inference.studies.errorlaws.learn import mixture_of
from poseterior.inference.studies.errorlaws.mixture import determinant, expect, inverse, quadratic
from poseterior.inference.studies.errorlaws.pairs import Pairs
from poseterior.inference.studies.intervals import Interval, of_share
from poseterior.probmodel.errors.detector import DetectorErrors

LEVELS = (0.5, 0.8, 0.95)
ROUNDS = 20
"""Until inliers and shifts agree."""


def standings(
    errors: DetectorErrors, pairs: Pairs, truth_sigma: np.ndarray | None = None
) -> np.ndarray:
    """`(n, 15)`: the mass of the law within the ellipse about its bias on which an error lies, NaN
    where there is none. Uniform where the law is right.

    Where the truth's place is not known, a joint is judged with the shift that a person's other
    joints say; the truth's own doubt is a part of the law's covariance.

    Parameters
    ----------
    truth_sigma
        `(15,)` spreads of the detections from which the truth was triangulated; by default the
        law's.
    """
    mixture = mixture_of(errors)
    score_class = np.searchsorted(np.asarray(errors.score.edges), pairs.score, side="right")
    found = expect(pairs, mixture, score_class, truth_sigma, None)
    for _ in range(0 if pairs.placed else ROUNDS):
        found = expect(pairs, mixture, score_class, truth_sigma, found)
    precision, left = found.precision[0], found.left[0]
    if not pairs.placed:
        trust = pairs.anchors * found.inlier[0] * found.stretch[0]
        weight = trust[..., None, None] * precision
        others = weight.sum(axis=1, keepdims=True) - weight
        doubt = inverse(others)
        pull = weight @ (pairs.errors[0] - mixture.bias)[..., None]
        shift = doubt @ (pull.sum(axis=1, keepdims=True) - pull)
        left = pairs.errors[0] - mixture.bias - shift[..., 0]
        precision = inverse(inverse(precision) + doubt)
    square = quadratic(precision, left)
    inside = (
        stats.f.cdf(square / 2, 2, mixture.df)
        if np.isfinite(mixture.df)
        else (-np.expm1(-square / 2))
    )
    area = square / np.sqrt(determinant(precision))
    outside = np.minimum(area / errors.outlier_radius**2, 1.0)
    mass = mixture.inlier * inside + (1 - mixture.inlier) * outside
    return np.where(pairs.seen & errors.known, mass, np.nan)


def shares_within(
    standing: np.ndarray, recording: np.ndarray, levels: tuple[float, ...] = LEVELS
) -> list[Interval]:
    """The share of `standings` `(n, 15)` up to each level, with intervals from drawing whole
    recordings `(n,)` anew."""
    known = ~np.isnan(standing)
    owner = np.repeat(recording, known.sum(axis=1))
    return [of_share(standing[known] <= level, owner) for level in levels]
