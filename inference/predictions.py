"""What posterior draws say of the detection: new detections of each, and how likely the one that
was made is; the groups posterior_predictive and log_likelihood of ArviZ."""

import numpy as np
import xarray as xr

from probmodel.chunks import in_chunks
from probmodel.detections import Detection
from probmodel.likelihood import ErrorLaw
from probmodel.skeleton import JOINTS

_STREAM = 1
"""Tells the random numbers of predictions from those of the draws, which have the same seed."""


def prediction_groups(
    law: ErrorLaw,
    detection: Detection,
    keypoints: np.ndarray,
    spread: np.ndarray,
    words: list[int],
) -> dict[str, xr.Dataset]:
    """The two groups, of one chain.

    Parameters
    ----------
    law : the errors' law.
    detection : the one that was made.
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
    seen = np.flatnonzero(np.isfinite(spread).all(axis=0) if len(spread) else np.zeros(len(JOINTS)))
    units = {"units": "pixels"}
    dims = ("chain", "draw")
    coords = {"chain": [0], "draw": np.arange(len(keypoints))}
    made = (
        (*dims, "joint", "uv"),
        _new_detections(law, keypoints, spread, rng)[None],
        units,
    )
    likely = (
        (*dims, "detected"),
        _log_likelihood(law, detection.keypoints[seen], keypoints[:, seen], spread[:, seen])[None],
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
    law: ErrorLaw, keypoints: np.ndarray, spread: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """`(n, 15, 2)`: the projected joints plus an error of the law each."""
    if not len(keypoints):
        return keypoints
    distance = in_chunks(law.distance, rng.random(keypoints.shape[:2]))
    angle = 2 * np.pi * rng.random(keypoints.shape[:2])
    errors = np.where(np.isfinite(spread), spread * distance, np.nan)
    return keypoints + errors[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _log_likelihood(
    law: ErrorLaw, detected: np.ndarray, keypoints: np.ndarray, spread: np.ndarray
) -> np.ndarray:
    """`(n, seen)`: log density of each detected joint, given each draw."""
    if not len(keypoints):
        return np.empty((0, len(detected)))
    square = np.sum(((detected - keypoints) / spread[..., None]) ** 2, axis=-1)
    # Every draw lies within the reach: what is beyond it is so by rounding, from the camera's plane
    # to pixels.
    ratio = in_chunks(law.log_ratio, np.minimum(square, law.reach**2))
    return law.log_peak + ratio - 2 * np.log(spread)
