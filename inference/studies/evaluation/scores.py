"""Scores: what came out of every frame, summed up in numbers with intervals, whole recordings being
drawn anew.

Frames without enough draws (`lost`) are left out of every row of a condition, single estimates too,
so that rows can be compared; how many they are stands beside them."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from poseterior.inference.studies.calibration.ece import Ece, ece
from poseterior.inference.studies.evaluation import metrics
from poseterior.inference.studies.evaluation.samples import JUDGED_JOINTS
from poseterior.inference.studies.intervals import TAIL, Interval, of_share
from poseterior.inference.studies.measured import (
    MeasureScore,
    scores_of_measures,
)
from poseterior.probmodel.skeleton import LIMB_JOINTS

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
        flips = float(values["flips"][rows].mean())
        spread = float(values["spread"][rows].mean())
    else:
        many = values[f"hypotheses_{row}"][rows].astype(float)
        per_batch = metrics.best_per_batch(many)
        per_joint = float(metrics.best_per_joint(many).mean())
        flips = float(values[f"flips_{row}"][rows].mean())
    pck = float(metrics.pck(errors, [metrics.PCK_MM])[0])
    return Metrics(
        per_pose=float(errors.mean()),
        unscaled=float(unscaled_errors(values, row)[rows].mean()),
        per_batch=per_batch,
        per_joint=per_joint,
        pck=pck,
        pck_area=metrics.pck_area(errors),
        cps=metrics.cps(errors),
        flips=flips,
        spread=spread,
        valid=valid,
    )


class SampleScores(NamedTuple):
    """What `samples.of_samples` says of many poses, summed up; None, or NaN, where there are too
    few samples of each to say.

    Attributes
    ----------
    frames : how many poses.
    best_root, best_procrustes : mm, for every N of `BESTS`.
    ece : the field's calibration error, over all joints of which something was asked.
    axes : how often central intervals of 95 % hold the limb joints' x, y and depth.
    beyond : the share of the limb joints' coordinates that lie beyond all samples.
    across : mm, distance of samples from the truth in the image, seen joints.
    width : mm, of the limb joints' intervals in x, y and depth.
    effective : the median number of effective roots; NaN where the root is fixed.
    measures : of joint angles, lengths and steps, mm.
    """

    frames: int
    best_root: tuple[Interval, ...]
    best_procrustes: tuple[Interval, ...]
    ece: Ece | None
    axes: tuple[Interval, ...] | None
    beyond: float
    across: Interval
    width: tuple[float, ...]
    effective: float
    measures: list[MeasureScore]


SCORED_LIMBS = [JUDGED_JOINTS.index(joint) for joint in LIMB_JOINTS]
"""Where the limb joints stand among the judged ones."""


def sample_scores(values: Values, recording: np.ndarray) -> SampleScores:
    """Of the frames `(n,)` of whose samples something is known, with intervals over recordings."""
    rows = np.isfinite(values["best_procrustes"][:, 0])
    found = {name: values[name][rows] for name in values}
    recording = recording[rows]
    bests = {
        name: tuple(clustered(column, recording) for column in found[name].T)
        for name in ("best_root", "best_procrustes")
    }
    judged = np.isfinite(found["standing"][:, SCORED_LIMBS]).all(axis=(1, 2))
    standing, width = (found[name][judged][:, SCORED_LIMBS] for name in ("standing", "width"))
    held = (standing >= TAIL) & (standing <= 1 - TAIL)
    clusters = recording[judged]
    some = bool(judged.any())
    effective = found.get("effective_roots", np.full(len(recording), np.nan))
    return SampleScores(
        len(recording),
        best_root=bests["best_root"],
        best_procrustes=bests["best_procrustes"],
        ece=_ece(found["level"][judged], found["stand_in"][judged], clusters) if some else None,
        axes=tuple(of_share(held[..., axis], clusters) for axis in range(3)) if some else None,
        beyond=float(found["beyond"][judged][:, SCORED_LIMBS].mean()) if some else np.nan,
        across=clustered(found["across"], recording),
        width=tuple(width.mean(axis=(0, 1)).tolist()) if some else (np.nan,) * 3,
        effective=float(np.median(effective)) if len(effective) else np.nan,
        measures=scores_of_measures(
            found["measure_level"], found["measure_error"], found["measure_width"], recording
        ),
    )


def _ece(levels: np.ndarray, stand_in: np.ndarray, recording: np.ndarray) -> Ece:
    """Over the joints of which something was asked; its floor over those that move at all."""
    asked = np.isfinite(levels).all(axis=0)
    found = ece(levels[:, asked], stand_in[:, :, (stand_in > 0).any(axis=(0, 1))], recording)
    if len(np.unique(recording)) > 1:
        return found
    return found._replace(whole=Interval(found.whole.value, np.nan, np.nan))


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
