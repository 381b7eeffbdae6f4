"""What posterior draws say of the detection: new detections of each, and how likely the one that
was made is: what ArviZ's groups posterior_predictive and log_likelihood hold."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.laws import ErrorLaw, WithOutliers
from poseterior.probmodel.programs import kept

_STREAM = 1
"""Tells the random numbers of predictions from those of the draws, which have the same seed."""

FLAT_LAW = (
    "left out: the law of errors is flat within its reach, so that every draw makes a detection"
    " equally likely, and none reaches where it could not have been; leaving one out (az.loo) would"
    " weigh nothing, and be sure of it"
)
"""Why there is no log likelihood under such a law."""


class KeypointsRead(NamedTuple):
    """The detection as each draw reads it; joints that do not count have an infinite spread.

    Attributes
    ----------
    detected : `(n, 15, 2)`, where joints were detected, pixels.
    bias : `(n, 15, 2)`, how far beside them they lie in the mean, pixels.
    spread : `(n, 15)`, of every joint's error under the root of each draw, pixels.
    outlier : `(n, 15)` bool, which are outliers.
    """

    detected: np.ndarray
    bias: np.ndarray
    spread: np.ndarray
    outlier: np.ndarray


def new_detections(
    law: ErrorLaw, read: KeypointsRead, keypoints: np.ndarray, words: list[int], block: int = 0
) -> np.ndarray:
    """The projected joints plus a bias and an error of the law each.

    Parameters
    ----------
    law
        The errors' law.
    read
        The detection that was made.
    keypoints
        `(n, 15, 2)`, the draws projected, pixels.
    words
        Of the seed.
    block
        The number of the block that the draws are, where a result is made in several.

    Returns
    -------
    ndarray
        `(n, 15, 2)` pixels, NaN where a joint does not count.
    """
    if not len(keypoints):
        return keypoints
    rng = np.random.default_rng([*words, _STREAM, block])
    far = functools.partial(_far, law)
    distance = in_chunks(far, read.outlier, rng.random(keypoints.shape[:2]))
    angle = 2 * np.pi * rng.random(keypoints.shape[:2])
    errors = np.where(np.isfinite(read.spread), read.spread * distance, np.nan)
    return (
        keypoints
        + read.bias
        + errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    )


@kept
def _far(law: ErrorLaw, outlier: jax.Array, uniform: jax.Array) -> jax.Array:
    """How far errors reach, in spreads."""
    return WithOutliers(law, outlier).distance(uniform)


def log_likelihood(law: ErrorLaw, read: KeypointsRead, keypoints: np.ndarray) -> np.ndarray:
    """`(n, 15)`: log density of each detected joint per square pixel, given each draw, whose
    `keypoints` are `(n, 15, 2)` pixels; 0 where it does not count."""
    if not len(keypoints):
        return np.empty(keypoints.shape[:2])
    counts = np.isfinite(read.spread)
    gap = np.where(counts[..., None], read.detected - read.bias - keypoints, 0.0)
    square = np.sum((gap / read.spread[..., None]) ** 2, axis=-1)
    found = in_chunks(functools.partial(_density, law), read.outlier, square)
    return np.where(counts, found - 2 * np.log(np.where(counts, read.spread, 1.0)), 0.0)


@kept
def _density(law: ErrorLaw, outlier: jax.Array, square: jax.Array) -> jax.Array:
    """Log densities of errors whose squares, in spreads, are given. Every draw lies within the
    reach: what is beyond it is so by rounding, from the camera's plane to pixels."""
    laws = WithOutliers(law, outlier)
    return laws.log_peak + laws.log_ratio(jnp.minimum(square, laws.reach**2))
