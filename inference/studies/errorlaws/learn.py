"""Learning a law: the mixture, its standard errors by leaving recordings out, and the record, which
is for detections that were not learned from: what the fit does not know belongs to its spread."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from poseterior.inference.studies.errorlaws.mixture import (
    FREEDOM,
    Expected,
    Fit,
    Mixture,
    fit,
    start,
)
from poseterior.inference.studies.errorlaws.pairs import Pairs
from poseterior.probmodel.errors.detector import (
    OUTLIER_RADIUS,
    DetectorErrors,
    Exchange,
    ScoreFactor,
)
from poseterior.probmodel.errors.laws import Gaussian, Student
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.layouts import MIDPOINTS
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

if TYPE_CHECKING:
    from poseterior.inference.studies.errorlaws.definitions import Definitions

LEAST_PAIRS = 20
"""Of a joint, below which nothing is said of it."""
MOST_GROUPS, FEWEST_GROUPS = 20, 4
"""Groups of recordings that are left out in turn; where recordings are fewer, stretches of them."""
SCORE_CLASSES = 3
LEARNABLE = ("gaussian", "student")
"""The error laws that the mixture can be fitted with."""
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Learned:
    """A law, and what it was learned from.

    Attributes
    ----------
    errors : the record, with standard errors: the law of a detection that is still to come.
    fit : the mixture, and what is latent in the pairs.
    truth_fit : that of the detections from which the truth was triangulated; None where it is the
        same.
    pairs : those.
    exchange_se : `(3,)` standard errors of the probabilities of exchange.
    df_se : of the fitted degrees of freedom.
    """

    errors: DetectorErrors
    fit: Fit
    truth_fit: Fit | None
    pairs: Pairs
    exchange_se: np.ndarray
    df_se: float

    @property
    def common(self) -> np.ndarray:
        """`(15,)`: `in_common` of the pairs; by the root of one more spreads have been widened."""
        return in_common(self.fit.expected)


def learn(
    pairs: Pairs,
    *,
    law: str = "gaussian",
    truth: Pairs | None = None,
    about: dict[str, Any] | None = None,
    definitions: "Definitions | None" = None,
    times: ErrorTimes | None = None,
    progress: Progress | None = None,
) -> Learned:
    """The error law of a detector.

    Parameters
    ----------
    pairs
        Detections and truth.
    law
        `gaussian` or `student`: of the errors that are learned from. Those still to come have
        longer tails, see `still_to_come`.
    truth
        The same pairs with the truth as the calibrated cameras see it, for `pairs` whose truth
        weak-perspective cameras see: the truth's own error goes by the detector's, without what
        perspective adds to it.
    about
        What the record says of where it comes from, beside what this knows.
    definitions
        Where the detector's points lie beside the skeleton's joints, which the record says; how
        little that is known is their spread.
    times
        How long errors last, which the record says.
    progress
        Called with how many fits are done, and of how many.

    Raises
    ------
    BadInput
        On another law, or where no joint has `LEAST_PAIRS` pairs.
    """
    if law not in LEARNABLE:
        raise BadInput(
            f"there is no law {law!r} to be learned; choose among {', '.join(LEARNABLE)}"
        )
    count = pairs.seen.sum(axis=0)
    if count.max(initial=0) < LEAST_PAIRS:
        raise BadInput(
            f"{pairs.name} has {count.max(initial=0)} detections of a joint at most; a law needs"
            f" {LEAST_PAIRS}: take more frames"
        )
    edges = score_edges(pairs)
    groups = jackknife_groups(pairs.recording)
    said = progress or (lambda done, wanted: None)
    said(0, 1 + groups.max() + 1)
    whole = _fitted(pairs, truth, law, edges, (None, None))
    parts = []
    for group in range(groups.max() + 1):
        said(1 + group, 1 + groups.max() + 1)
        kept = np.flatnonzero(groups != group)
        some = None if truth is None else truth.take(kept)
        parts.append(_fitted(pairs.take(kept), some, law, edges, whole)[0].mixture)
    errors = _record(pairs, whole[0], parts, edges, count, about or {})
    errors = dataclasses.replace(errors, times=times)
    if definitions is not None:
        errors = defined(errors, definitions)
    return Learned(
        errors,
        whole[0],
        whole[1],
        pairs,
        _standard_error([part.pattern[1:] for part in parts]),
        float(_standard_error([np.array(part.df) for part in parts])) if law == "student" else 0.0,
    )


def _fitted(
    pairs: Pairs,
    truth: Pairs | None,
    law: str,
    edges: tuple[float, ...],
    before: tuple[Fit | None, Fit | None],
) -> tuple[Fit, Fit | None]:
    """The mixture, from those `before` on, and that of the truth's detections where it is
    another."""

    def fitted(some: Pairs, last: Fit | None, sigma: np.ndarray | None) -> Fit:
        score_class = np.searchsorted(np.asarray(edges), some.score, side="right")
        first = start(some, law, len(edges) + 1) if last is None else last.mixture
        return fit(some, first, score_class, sigma)

    if truth is None:
        return fitted(pairs, before[0], None), None
    own = fitted(truth, before[1], None)
    return fitted(pairs, before[0], own.mixture.sigma), own


def _record(
    pairs: Pairs,
    fitted: Fit,
    parts: list[Mixture],
    edges: tuple[float, ...],
    count: np.ndarray,
    about: dict[str, Any],
) -> DetectorErrors:
    mixture, known = fitted.mixture, count >= LEAST_PAIRS
    se = _standard_error([_columns(part) for part in parts])
    sigma, df = still_to_come(mixture, se, known)
    return DetectorErrors(
        Gaussian() if df == np.inf else Student(df),
        np.where(known, sigma * np.sqrt(1 + in_common(fitted.expected)), np.nan),
        np.where(known, mixture.inlier, np.nan),
        np.where(known[:, None], mixture.bias, np.nan),
        exchange=Exchange(*mixture.pattern[1:].tolist()),
        score=ScoreFactor(edges, tuple(mixture.factor.tolist())),
        outlier_radius=OUTLIER_RADIUS,
        pairs=np.where(known, count, 0),
        se=np.where(known[:, None], se, np.nan),
        learned={
            "from": pairs.name,
            "people": len(pairs),
            "recordings": len(np.unique(pairs.recording)),
            "pairs": int(count.sum()),
            "sha256": pairs.sha256,
            **about,
        },
    )


def defined(errors: DetectorErrors, definitions: "Definitions") -> DetectorErrors:
    """A record with these definitions of the joints that it knows."""
    mean, sd = (np.where(errors.known[:, None], part, 0.0) for part in definitions)
    return dataclasses.replace(errors, definition=mean, definition_sd=sd)


def still_to_come(mixture: Mixture, se: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, float]:
    """Spreads `(15,)` and degrees of freedom of errors in a recording that was not learned from.

    The mean of those learned from errs, and the spread about it is too small by the same variance,
    which is added twice. The spread errs too: known to a relative standard error r, it is as if
    estimated from 1/2r² independent errors, and what is to come then has a Student's t of as many
    degrees of freedom. One number for all joints, since a joint's own r is hardly known. Of a
    mixture that is a t itself the two scatters of the scale add: their inverse degrees of freedom.

    Parameters
    ----------
    se : `(15, 4)`
        Standard errors of sigma, inlier and the two of bias.
    known : `(15,)` bool
        The joints that count.
    """
    sigma = np.sqrt(mixture.sigma**2 + 2 * np.mean(se[:, 2:] ** 2, axis=1))
    relative = float(np.mean((se[known, 0] / mixture.sigma[known]) ** 2))
    scatter = 1 / mixture.df + 2 * relative
    df = max(1 / scatter, FREEDOM[0]) if scatter else np.inf
    return sigma, df if df < FREEDOM[1] else np.inf


def in_common(expected: Expected) -> np.ndarray:
    """`(15,)`: the correlation of a hip's, or a shoulder's, errors with those of the other side,
    both directions of the image together; 0 for other joints, and where it is negative.

    A law takes joints for independent, but says by two hips where their midpoint is. If their
    errors have correlation r, the midpoint's variance is 1 + r times what independent ones say.
    Spreads widened by its root say it rightly, and of the hips' difference too little rather than
    too much.
    """
    weight, left = expected.pattern[..., None] * expected.inlier, expected.left
    found = np.zeros(NUM_JOINTS)
    for right, other in MIDPOINTS.values():
        sides = [JOINT_INDEX[right], JOINT_INDEX[other]]
        both = weight[..., sides].prod(axis=-1)[..., None]
        one, two = np.moveaxis(left[..., sides, :], -2, 0)
        scale = np.sqrt(np.sum(both * one**2) * np.sum(both * two**2))
        found[sides] = max(float(np.sum(both * one * two) / scale), 0.0) if scale > 0 else 0.0
    return found


def _columns(mixture: Mixture) -> np.ndarray:
    """`(15, 4)`: sigma, inlier and the two of bias."""
    return np.column_stack([mixture.sigma, mixture.inlier, mixture.bias])


def _standard_error(parts: list[np.ndarray]) -> np.ndarray:
    """Of what was estimated with one group left out, group by group (Tukey's jackknife)."""
    values, number = np.stack(parts), len(parts)
    return np.sqrt((number - 1) * np.var(values, axis=0))


def jackknife_groups(recording: np.ndarray) -> np.ndarray:
    """`(n,)` groups 0, 1, …: whole recordings, `MOST_GROUPS` at most; stretches of equal length
    where recordings are fewer than `FEWEST_GROUPS`."""
    names, owner = np.unique(recording, return_inverse=True)
    if len(names) >= FEWEST_GROUPS:
        return owner % MOST_GROUPS
    groups = min(MOST_GROUPS, len(recording))
    return np.arange(len(recording)) * groups // len(recording)


def score_edges(pairs: Pairs) -> tuple[float, ...]:
    """Where scores are cut into `SCORE_CLASSES` classes of the same size; none where they are all
    alike."""
    scores = pairs.score[pairs.seen]
    if np.ptp(scores) == 0:
        return ()
    levels = np.linspace(0, 1, SCORE_CLASSES + 1)[1:-1]
    edges = np.unique(np.quantile(scores, levels))
    # An edge at the least score would leave a class empty.
    return tuple(edges[edges > scores.min()].tolist())


def mixture_of(errors: DetectorErrors) -> Mixture:
    """A record as a mixture; joints that it does not know have NaN."""
    exchange = np.array(errors.exchange)
    return Mixture(
        sigma=np.array(errors.sigma),
        inlier=np.array(errors.inlier),
        bias=np.array(errors.bias),
        df=errors.law.df if isinstance(errors.law, Student) else np.inf,
        pattern=np.array([1 - exchange.sum(), *exchange]),
        factor=np.array(errors.score.sigma_factor),
    )
