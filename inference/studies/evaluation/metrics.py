"""Metrics of many hypotheses for many poses. "Best of k" is three different things, and they are
named apart.

Errors are distances of joints from the true ones, `(..., 15)`, whatever the alignment; NaN where a
joint is missing."""

import numpy as np
from numpy.typing import ArrayLike

from poseterior.inference.studies.flips import away, codes

PCK_MM = 150.0
"""mm: the usual threshold of PCK, and where the area under its curve ends."""
FARTHEST = 300.0
"""mm: where the area under the curve of correct poses ends."""


def best_per_batch(errors: ArrayLike) -> float:
    """Of `errors` `(N, k, 15)` the least mean over all poses of the hypotheses of one rank: one
    choice for all poses, which needs no truth of a single one (D3DP's P-Best)."""
    return float(np.nanmean(np.asarray(errors), axis=-1).mean(axis=0).min())


def best_per_joint(errors: ArrayLike) -> np.ndarray:
    """`(N,)`: the mean over joints of the least error of each joint among the hypotheses `(N, k,
    15)`: a pose patched together with the truth in hand (D3DP's J-Best)."""
    return np.nanmean(np.asarray(errors).min(axis=-2), axis=-1)


def pck(errors: ArrayLike, thresholds: ArrayLike) -> np.ndarray:
    """`(T,)`: share of joints that lie within each of the `thresholds` `(T,)`; missing joints do
    not count."""
    flat = np.asarray(errors, float).ravel()
    flat = np.sort(flat[np.isfinite(flat)])
    return np.searchsorted(flat, np.asarray(thresholds, float), side="right") / max(len(flat), 1)


def pck_area(errors: ArrayLike, limit: float = PCK_MM) -> float:
    """The area under the curve of `pck` from 0 to `limit`, as a share of it: exact, not a sum over
    thresholds."""
    return float(np.nanmean(np.maximum(0.0, 1.0 - np.asarray(errors, float) / limit)))


def cps(errors: ArrayLike, limit: float = FARTHEST) -> float:
    """Correct poses score: the area, in mm, under the share of poses whose joints *all* lie within
    t, t = 0 … `limit`.

    Source: Wandt et al. (2021). Exact: a pose adds what its worst joint leaves of `limit`.
    """
    return float(np.mean(np.maximum(0.0, limit - np.nanmax(np.asarray(errors, float), axis=-1))))


def spread(joints: ArrayLike) -> float:
    """How far draws `(n, 15, 3)` of a pose lie apart: root mean square distance from their mean,
    over all joints."""
    joints = np.asarray(joints, float)
    return float(np.sqrt(np.mean(np.sum((joints - joints.mean(axis=0)) ** 2, axis=-1))))


def distinct_flips(joints: ArrayLike) -> int:
    """How many depth flips of the eight limb bones occur among poses `(n, 15, 3)` in camera
    axes."""
    return len(np.unique(codes(away(np.asarray(joints)))))
