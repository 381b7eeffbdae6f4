"""Scores: what came out of every frame, summed up in numbers with intervals, whole recordings being
drawn anew.

Frames without enough draws (`lost`) are left out of every row of a condition, single estimates too,
so that rows can be compared; how many they are stands beside them."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from inference.studies.evaluation import metrics
from inference.studies.intervals import TAIL, Interval

SAMPLES = 2000
"""Bootstrap samples."""
Values = Mapping[str, np.ndarray]
"""What came out of every frame, by field (`outcome.Protocol.fields`)."""


def clustered(
    columns: ArrayLike,
    cluster: np.ndarray,
    statistic: Callable[[np.ndarray], np.ndarray] = lambda means: means[..., 0],
) -> Interval:
    """A statistic of the means of columns `(n,)` or `(n, c)`, with its interval (bootstrap,
    percentiles) when whole clusters, the recordings `(n,)`, are drawn anew. `statistic` maps means
    `(..., c)` to `(...)`.

    NaN where there is nothing; the interval is NaN where there is one recording, which says nothing
    about others."""
    if not len(cluster):
        return Interval(np.nan, np.nan, np.nan)
    table = np.asarray(columns, float).reshape(len(cluster), -1)
    _, owner = np.unique(cluster, return_inverse=True)
    sizes = np.bincount(owner).astype(float)
    sums = np.stack([np.bincount(owner, weights=column) for column in table.T], axis=1)
    value = float(statistic(table.mean(axis=0)))
    if len(sizes) < 2:
        return Interval(value, np.nan, np.nan)
    picks = np.random.default_rng(0).integers(0, len(sizes), (SAMPLES, len(sizes)))
    means = sums[picks].sum(axis=1) / sizes[picks].sum(axis=1, keepdims=True)
    low, high = np.quantile(statistic(means), [TAIL, 1 - TAIL])
    return Interval(value, float(low), float(high))


def usable(values: Values) -> np.ndarray:
    """`(N,)`: the frames that have enough draws."""
    return np.isfinite(values["all"]).all(axis=-1)


def errors_of(values: Values, row: str | int) -> np.ndarray:
    """`(N, 15)` joint errors in mm of one pose a frame: "single", "all" (the best of all draws), or
    the best of k."""
    if isinstance(row, str):
        return values[row].astype(float)
    many = values[f"hypotheses_{row}"].astype(float)
    means = many.mean(axis=-1)
    best = np.where(np.isfinite(means), means, np.inf).argmin(axis=-1)
    return np.take_along_axis(many, best[:, None, None], axis=1)[:, 0]


def pose_errors(values: Values, row: str | int) -> np.ndarray:
    """`(N,)`: the mean over joints of `errors_of`."""
    return errors_of(values, row).mean(axis=-1)


def unscaled_errors(values: Values, row: str | int) -> np.ndarray:
    """`(N,)`: mean joint errors after similarity alignment alone, of the same kind of pose."""
    if isinstance(row, str):
        return values[f"{row}_unscaled"].astype(float)
    return values[f"hypotheses_{row}_unscaled"].astype(float).min(axis=-1)


class Metrics(NamedTuple):
    """Metrics of one row of a condition, over its usable frames; None where the row has no such
    thing."""

    per_pose: float
    unscaled: float
    per_batch: float | None
    per_joint: float | None
    pck: float
    pck_area: float
    cps: float
    flips: float | None
    spread: float | None
    valid: float


def summary(values: Values, row: str | int) -> Metrics:
    """All metrics of a row. Draws, and hypotheses, which are draws, are possible by
    construction."""
    rows = usable(values)
    errors = errors_of(values, row)[rows]
    per_batch = per_joint = flips = spread = None
    valid = 1.0
    if row == "single":
        valid = float(values["single_valid"][rows].all(axis=-1).mean())
    elif row == "all":
        per_joint = float(values["all_by_joint"][rows].mean())
        flips, spread = float(values["flips"][rows].mean()), float(values["spread"][rows].mean())
    else:
        many = values[f"hypotheses_{row}"][rows].astype(float)
        per_batch, per_joint = (
            metrics.best_per_batch(many),
            float(metrics.best_per_joint(many).mean()),
        )
        flips = float(values[f"flips_{row}"][rows].mean())
    pck = float(metrics.pck(errors, [metrics.THRESHOLD])[0])
    return Metrics(
        float(errors.mean()),
        float(unscaled_errors(values, row)[rows].mean()),
        per_batch,
        per_joint,
        pck,
        metrics.pck_area(errors),
        metrics.cps(errors),
        flips,
        spread,
        valid,
    )


class Lost(NamedTuple):
    """Frames without enough draws: how many came to which end, and some of the reasons."""

    number: int
    status: dict[str, int]
    reasons: list[str]


def lost(values: Values, most: int = 3) -> Lost:
    """What was lost of a condition."""
    rows = np.flatnonzero(~usable(values))
    status = Counter(values["status"][rows].tolist())
    reasons = values["sentence"][rows[:most]].tolist()
    return Lost(len(rows), dict(sorted(status.items())), reasons)


def common(many: Sequence[Values]) -> np.ndarray:
    """`(N,)`: the frames usable in all of several conditions."""
    return np.all([usable(values) for values in many], axis=0)
