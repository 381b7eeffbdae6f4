"""How long a detector's errors last: what of them stays over a film, what wanders, what is new in
every frame.

    times = times_of_session(read_session("S01/"), rate=60.0)
    times.constant, times.slow, times.quick, times.seconds

Errors of neighbouring frames hang together, so that a hundred frames say far less than a hundred
times as much as one.
"""

import numpy as np

from poseterior.inference.studies.errorlaws.pairs import pairs_of_session
from poseterior.probmodel.datasets.sessions import judged_views
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.sessions import Session

SLOWEST_FILM, FASTEST_FILM = 1.0, 1000.0
"""Frames a second."""
FEWEST_STEPS = 20
"""Frames of a film from which anything is learned."""
LONGEST_SHARE = 1 / 3
"""Of the film: the longest time over which errors are compared, and at most `LONGEST_LAG`."""
LONGEST_LAG = 1.0
"""Seconds."""
SHORTEST_LAST = 0.5
"""Frames: errors that last for less cannot be told from those of one frame."""
CANDIDATE_TIMES = 200
ASTRAY = 5.0
"""Robust standard deviations of a joint's errors, beyond which one is an outlier and left out."""


MEDIAN_LENGTH = 1.177
"""Of a Gaussian error in the plane, in its standard deviations each way."""


def error_times(errors: np.ndarray, rate: float) -> ErrorTimes:
    """The parts of errors by how they differ between frames.

    Half the mean squared difference of errors that lie a time apart has the quick part, and so much
    of the slow one as has been forgotten by then; its curve is fitted by least squares. What the
    mean square has beyond it is constant: so the film's length biases none of them.

    Parameters
    ----------
    errors : `(recordings, frames, joints, 2)`
        Of one unit; NaN where missing.
    rate
        Frames a second.

    Returns
    -------
    ErrorTimes
        Of all joints together, each as large as it is.

    Raises
    ------
    BadInput
        On a rate that cannot be, on too few frames, and where no joint was seen in succession.
    """
    if not SLOWEST_FILM <= rate <= FASTEST_FILM:  # false for NaN too
        raise BadInput(
            f"a film has from {SLOWEST_FILM:g} to {FASTEST_FILM:g} frames a second, not {rate:g}"
        )
    if errors.shape[1] < FEWEST_STEPS:
        raise BadInput(
            f"how long errors last is learned from {FEWEST_STEPS} frames at least, not"
            f" {errors.shape[1]}; take a longer film"
        )
    kept = _without_outliers(errors)
    whole = _parts(kept, rate)
    recordings = len(kept)
    if recordings < 2:
        return ErrorTimes(*whole, rate, np.full(4, np.nan))
    left = [_parts(np.delete(kept, one, axis=0), rate)[:4] for one in range(recordings)]
    se = np.sqrt((recordings - 1) * np.var(left, axis=0))
    return ErrorTimes(*whole, rate, se)


def times_of_session(session: Session, rate: float, *, perspective: bool = False) -> ErrorTimes:
    """The parts of a detector's errors, every camera beside what the others triangulate.

    What all joints of a person have in common in a frame is left out, as it says nothing of the
    detector. The truth's own errors are a part of these, of the constant ones for the most.

    Parameters
    ----------
    session
        Of three cameras at least, its frames in succession.
    rate
        Frames a second.
    perspective
        As of `pairs_of_session`.

    Returns
    -------
    ErrorTimes
        In body units.

    Raises
    ------
    BadInput
        As `error_times` and `pairs_of_session`.
    """
    pairs = pairs_of_session(session, perspective=perspective)
    weight = (pairs.anchors / np.maximum(pairs.anchors.sum(axis=1, keepdims=True), 1))[..., None]
    found = np.where(pairs.seen[..., None], pairs.detected - pairs.truth, np.nan)
    found = found - np.sum(weight * np.nan_to_num(found), axis=1, keepdims=True)
    rows = [view.rows for view in judged_views(session)]
    errors = np.full((len(rows), len(session), *found.shape[1:]), np.nan)
    starts = np.cumsum([0, *map(len, rows)])
    for camera, frames in enumerate(rows):
        errors[camera, frames] = found[starts[camera] : starts[camera + 1]]
    return error_times(errors, rate)


def _without_outliers(errors: np.ndarray) -> np.ndarray:
    """Errors with NaN in the place of those that lie too far from zero for their joint."""
    size = np.linalg.norm(errors, axis=-1)
    kept = errors.copy()
    for joint in range(errors.shape[2]):
        own = size[..., joint]
        usual = np.median(own[np.isfinite(own)]) / MEDIAN_LENGTH if np.isfinite(own).any() else 0.0
        kept[:, :, joint][own > ASTRAY * usual] = np.nan
    return kept


def _parts(errors: np.ndarray, rate: float) -> tuple[float, float, float, float, float, float]:
    """Shares, seconds, the standard deviation of errors, and the longest time that is told."""
    frames = errors.shape[1]
    longest = max(3, min(round(LONGEST_SHARE * frames), round(LONGEST_LAG * rate)))
    lags = np.arange(1, longest + 1)
    differences = [errors[:, lag:] - errors[:, :-lag] for lag in lags]
    pairs = np.array([np.isfinite(one).sum() for one in differences])
    curve = np.array([np.nansum(one**2) / 2 for one in differences]) / np.maximum(pairs, 1)
    whole = float(np.nansum(errors**2) / max(np.isfinite(errors).sum(), 1))
    if not (pairs[0] and whole > 0):
        raise BadInput(
            "no joint was seen beside its truth in frames that follow each other; give a film whose"
            " frames are in succession"
        )
    times = np.geomspace(SHORTEST_LAST / rate, longest / rate, CANDIDATE_TIMES)
    fits = [_fitted(curve, pairs, 1 - np.exp(-lags / rate / one)) for one in times]
    best = int(np.argmin([miss for _, _, miss in fits]))
    quick, slow, _ = fits[best]
    constant = max(whole - quick - slow, 0.0)
    total = constant + slow + quick
    shares = constant / total, slow / total, quick / total
    return *shares, float(times[best]), float(np.sqrt(whole)), float(times[-1])


def _fitted(
    curve: np.ndarray, pairs: np.ndarray, forgotten: np.ndarray
) -> tuple[float, float, float]:
    """Quick and slow variances, neither of them negative, by least squares, and what is missed."""
    from scipy.optimize import nnls

    weight = np.sqrt(pairs)
    columns = np.stack([np.ones_like(forgotten), forgotten], axis=1)
    (quick, slow), miss = nnls(weight[:, None] * columns, weight * curve)
    return float(quick), float(slow), float(miss)
