"""What posterior draws say of the detection: new detections of each, and how likely the one that
was made is; the groups posterior_predictive and log_likelihood of ArviZ."""

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from probmodel.chunks import in_chunks
from probmodel.likelihood import ErrorLaw, WithOutliers
from probmodel.skeleton import JOINTS

_STREAM = 1
"""Tells the random numbers of predictions from those of the draws, which have the same seed."""


def prediction_groups(
    law: ErrorLaw,
    outlier: np.ndarray,
    detected: np.ndarray,
    keypoints: np.ndarray,
    spread: np.ndarray,
    words: list[int],
) -> dict[str, xr.Dataset]:
    """The two groups, of one chain.

    Parameters
    ----------
    law : the errors' law.
    outlier : `(n, 15)` bool, which joints' keypoints are outliers in each draw.
    detected : `(n, 15, 2)`, where joints were detected as each draw reads it, pixels.
    keypoints : `(n, 15, 2)`, the draws projected, pixels.
    spread : `(n, 15)`, every joint's spread under the root of each draw, pixels; infinite where it
        does not count.
    words : of the seed.

    Returns
    -------
    `posterior_predictive`: `keypoints` (chain, draw, joint, uv), pixels, NaN where a joint does not
    count. `log_likelihood`: `keypoints` (chain, draw, detected), of the joints that count, per
    square pixel.
    """
    rng = np.random.default_rng([*words, _STREAM])
    seen = np.flatnonzero(np.isfinite(spread).any(axis=0))
    units = {"units": "pixels"}
    dims = ("chain", "draw")
    coords = {"chain": [0], "draw": np.arange(len(keypoints))}
    made = (
        (*dims, "joint", "uv"),
        _new_detections(law, outlier, keypoints, spread, rng)[None],
        units,
    )
    likely = (
        (*dims, "detected"),
        _log_likelihood(law, outlier, detected, keypoints, spread)[None, :, seen],
        {"base_measure": "image area (px2)"},
    )
    return {
        "posterior_predictive": xr.Dataset(
            {"keypoints": made}, coords=coords | {"joint": list(JOINTS), "uv": list("uv")}
        ),
        "log_likelihood": xr.Dataset(
            {"keypoints": likely}, coords=coords | {"detected": [JOINTS[joint] for joint in seen]}
        ),
    }


def _new_detections(
    law: ErrorLaw,
    outlier: np.ndarray,
    keypoints: np.ndarray,
    spread: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """`(n, 15, 2)`: the projected joints plus an error of the law each."""
    if not len(keypoints):
        return keypoints

    def far(outlier: np.ndarray, uniform: np.ndarray) -> jax.Array:
        return WithOutliers(law, outlier).distance(uniform)

    distance = in_chunks(far, outlier, rng.random(keypoints.shape[:2]))
    angle = 2 * np.pi * rng.random(keypoints.shape[:2])
    errors = np.where(np.isfinite(spread), spread * distance, np.nan)
    return keypoints + errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _log_likelihood(
    law: ErrorLaw,
    outlier: np.ndarray,
    detected: np.ndarray,
    keypoints: np.ndarray,
    spread: np.ndarray,
) -> np.ndarray:
    """`(n, 15)`: log density of each detected joint, given each draw; 0 where it does not count."""
    if not len(keypoints):
        return np.empty(keypoints.shape[:2])
    counts = np.isfinite(spread)
    gap = np.where(counts[..., None], detected - keypoints, 0.0)
    square = np.sum((gap / spread[..., None]) ** 2, axis=-1)

    def density(outlier: np.ndarray, square: np.ndarray) -> jax.Array:
        laws = WithOutliers(law, outlier)
        # Every draw lies within the reach: what is beyond it is so by rounding, from the camera's
        # plane to pixels.
        return laws.log_peak + laws.log_ratio(jnp.minimum(square, laws.reach**2))

    found = in_chunks(density, outlier, square) - 2 * np.log(np.where(counts, spread, 1.0))
    return np.where(counts, found, 0.0)
