"""A mixture of inliers and outliers, fitted to errors by expectation and maximisation.

An inlier's error is a bias plus a Gaussian or a bivariate Student's t; an outlier is anywhere in a
disc. Latent are: whether a detection is an inlier, the sides' pattern (exchanged or not), the part
of an error that is the truth's own, the scale of a t, and, where the truth's place is not known,
the shift of a person, whose prior is flat. Every step is in closed form (Dempster, Laird & Rubin
1977; Liu & Rubin 1995 for the t), but for one root for the degrees of freedom. The shift's
posterior is taken apart from the inliers' (a mean field).
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, gammaln

from poseterior.inference.studies.errorlaws.pairs import PATTERNS, Pairs
from poseterior.probmodel.errors.detector import OUTLIER_RADIUS
from poseterior.probmodel.errors.laws import FEWEST_DF
from poseterior.probmodel.skeleton import NUM_JOINTS

STEPS, TOLERANCE = 400, 1e-4
"""Of the iteration: it ends when no spread or share changes by more than the tolerance."""
FREEDOM = (FEWEST_DF, 200.0)
"""Between which degrees of freedom are looked for."""
SMALLEST = 1e-5
"""Body units: no spread is taken for smaller, so that errors of zero leave a density."""
FEWEST_EXCHANGED = 1e-3
"""People: a pattern of which fewer are expected is given up."""
LOG_OUTLIER = -np.log(np.pi * OUTLIER_RADIUS**2)


@dataclass(frozen=True, eq=False)
class Mixture:
    """The parameters.

    Attributes
    ----------
    sigma : `(15,)` body units.
    inlier : `(15,)`.
    bias : `(15, 2)` body units.
    df : degrees of freedom; infinite for a Gaussian.
    pattern : `(4,)` probabilities of `pairs.PATTERNS`.
    factor : `(k,)` of the spread, by class of score.
    """

    sigma: np.ndarray
    inlier: np.ndarray
    bias: np.ndarray
    df: float
    pattern: np.ndarray
    factor: np.ndarray

    @property
    def possible(self) -> np.ndarray:
        """Which of the patterns there are, the detector's own first: `p` in what follows."""
        return np.flatnonzero((self.pattern > 0) | (np.arange(len(PATTERNS)) == 0))

    def change(self, other: "Mixture") -> float:
        """The largest difference of a spread (relative), a bias (in spreads) or a share."""
        with np.errstate(divide="ignore"):
            freedom = abs(1 / self.df - 1 / other.df)
        apart = (
            self.sigma / other.sigma - 1,
            self.inlier - other.inlier,
            (self.bias - other.bias) / other.sigma[:, None],
            self.pattern - other.pattern,
            self.factor / other.factor - 1,
        )
        return max(freedom, *(float(np.abs(one).max()) for one in apart))


@dataclass(frozen=True, eq=False)
class Expected:
    """What is latent, given the parameters.

    Attributes
    ----------
    pattern : `(p, n)` probabilities.
    inlier : `(p, n, 15)` probability that a detection is there and an inlier, given the pattern.
    shift, shift_covariance : `(p, n, 2)` and `(p, n, 2, 2)`.
    precision : `(p, n, 15, 2, 2)` of an inlier's error, the truth's own included.
    left : `(p, n, 15, 2)` errors without bias and shift.
    stretch : `(p, n, 15)` of a t: the mean of its gamma variable; 1 for a Gaussian.
    log_likelihood : of all pairs.
    """

    pattern: np.ndarray
    inlier: np.ndarray
    shift: np.ndarray
    shift_covariance: np.ndarray
    precision: np.ndarray
    left: np.ndarray
    stretch: np.ndarray
    log_likelihood: float


@dataclass(frozen=True, eq=False)
class Fit:
    """The fitted mixture, with what is latent in the pairs; `converged` says whether the iteration
    came to rest."""

    mixture: Mixture
    expected: Expected
    converged: bool


def start(pairs: Pairs, law: str, classes: int) -> Mixture:
    """Robust first values: medians."""
    errors = np.where(pairs.seen[..., None], pairs.errors[0], np.nan)
    with np.errstate(all="ignore"):
        if not pairs.placed:
            errors = errors - _median(errors, axis=1)[:, None]
        bias = _median(errors, axis=0)
        far = _median(np.linalg.norm(errors - bias, axis=-1), axis=0)
    # The median of |e| is 1.18 standard deviations.
    sigma = np.maximum(far / 1.18, SMALLEST)
    return Mixture(
        sigma=sigma,
        inlier=np.full(NUM_JOINTS, 0.95),
        bias=bias,
        df=5.0 if law == "student" else np.inf,
        pattern=np.array([0.97, 0.01, 0.01, 0.01]),
        factor=np.ones(classes),
    )


def fit(
    pairs: Pairs, first: Mixture, score_class: np.ndarray, truth_sigma: np.ndarray | None = None
) -> Fit:
    """The mixture that explains pairs best, from `first` on.

    Parameters
    ----------
    score_class
        `(n, 15)` classes of the scores, rows of `factor`.
    truth_sigma
        `(15,)` spreads of the detections from which the truth was triangulated; by default those
        that are fitted.
    """
    mixture = first
    expected = expect(pairs, mixture, score_class, truth_sigma, None)
    for _ in range(STEPS):
        found = maximise(pairs, mixture, expected, score_class)
        change = found.change(mixture)
        mixture = found
        same = len(expected.pattern) == len(mixture.possible)
        expected = expect(pairs, mixture, score_class, truth_sigma, expected if same else None)
        if change < TOLERANCE:
            return Fit(mixture, expected, True)
    return Fit(mixture, expected, False)


def expect(
    pairs: Pairs,
    mixture: Mixture,
    score_class: np.ndarray,
    truth_sigma: np.ndarray | None,
    before: Expected | None,
) -> Expected:
    """What is latent, given parameters; the shift goes by the inliers of `before`."""
    variance = (mixture.sigma * mixture.factor[score_class]) ** 2
    own = mixture.sigma if truth_sigma is None else truth_sigma
    rows = mixture.possible
    truth = np.stack([own[PATTERNS[row]] for row in rows])[:, None] ** 2
    covariance = truth[..., None, None] * pairs.doubts[rows]
    covariance = covariance + variance[..., None, None] * np.eye(2)
    precision = inverse(covariance)
    errors = pairs.errors[rows] - mixture.bias
    shape = errors.shape[:2]
    shift, doubt = np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
    if not pairs.placed:
        trust = np.where(pairs.anchors, 1.0, 0.0) * np.ones((len(rows), 1, 1))
        if before is not None:
            trust = trust * before.inlier * before.stretch
        weight = trust[..., None, None] * precision
        doubt = inverse(weight.sum(axis=2))
        shift = (doubt @ (weight @ errors[..., None]).sum(axis=2))[..., 0]
    left = errors - shift[:, :, None]
    square = quadratic(precision, left)
    log_inlier = log_density(square, mixture.df) + np.log(determinant(precision)) / 2
    with np.errstate(divide="ignore"):  # a share may be 0 or 1
        log_inlier = log_inlier + np.log(mixture.inlier)
        log_outlier = LOG_OUTLIER + np.log1p(-mixture.inlier)
        log_pattern = np.log(mixture.pattern[rows])
    log_joint = np.where(pairs.seen, np.logaddexp(log_inlier, log_outlier), 0.0)
    log_person = log_pattern[:, None] + log_joint.sum(axis=2)
    log_total = np.logaddexp.reduce(log_person, axis=0)
    stretch = np.ones_like(square)
    if np.isfinite(mixture.df):
        stretch = (mixture.df + 2) / (mixture.df + square)
    return Expected(
        pattern=np.exp(log_person - log_total),
        inlier=np.where(pairs.seen, np.exp(log_inlier - log_joint), 0.0),
        shift=shift,
        shift_covariance=doubt,
        precision=precision,
        left=left,
        stretch=stretch,
        log_likelihood=float(log_total.sum()),
    )


def maximise(
    pairs: Pairs, mixture: Mixture, expected: Expected, score_class: np.ndarray
) -> Mixture:
    """The parameters that make what is expected likeliest."""
    weight = expected.pattern[..., None] * expected.inlier
    mass = np.maximum(weight.sum(axis=(0, 1)), 1e-12)
    pull = (weight * expected.stretch)[..., None, None] * expected.precision
    unbiased = expected.left + mixture.bias
    middle = np.einsum("znjab,znjb->ja", pull, unbiased)
    normal = pull.sum(axis=(0, 1)) + 1e-12 * np.eye(2)
    bias = np.linalg.solve(normal, middle[..., None])[..., 0]
    if not pairs.placed:
        bias = bias - bias.mean(axis=0)
    own = _own_squares(mixture, expected, score_class)
    factor_here = mixture.factor[score_class]
    variance = (weight * own / factor_here**2).sum(axis=(0, 1)) / (2 * mass)
    sigma = np.maximum(np.sqrt(variance), SMALLEST)
    factor = _factors(mixture.factor, weight * own / sigma**2, weight, score_class)
    people = (expected.pattern[..., None] * pairs.seen).sum(axis=(0, 1))
    return dataclasses.replace(
        mixture,
        sigma=sigma,
        inlier=np.minimum(mass / np.maximum(people, 1e-9), 1.0),
        bias=bias,
        df=_freedom(mixture.df, expected.stretch, weight),
        pattern=_patterns(mixture, expected),
        factor=factor,
    )


def _patterns(mixture: Mixture, expected: Expected) -> np.ndarray:
    """`(4,)` shares of people."""
    people = np.zeros(len(PATTERNS))
    people[mixture.possible] = expected.pattern.sum(axis=1)
    people[people < FEWEST_EXCHANGED] = 0.0
    return people / people.sum()


def _own_squares(mixture: Mixture, expected: Expected, score_class: np.ndarray) -> np.ndarray:
    """`(p, n, 15)`: expected squares of the part of errors that is the detector's own, in both
    directions together, stretched."""
    variance = (mixture.sigma * mixture.factor[score_class]) ** 2
    part = variance[..., None, None] * expected.precision
    mean = (part @ expected.left[..., None])[..., 0]
    wander = part @ expected.shift_covariance[:, :, None] @ part
    spread = np.sum(mean**2, axis=-1) + wander[..., 0, 0] + wander[..., 1, 1]
    rest = variance * (2 - part[..., 0, 0] - part[..., 1, 1])
    return expected.stretch * spread + rest


def _factors(
    before: np.ndarray, squares: np.ndarray, weight: np.ndarray, score_class: np.ndarray
) -> np.ndarray:
    """The factor of each class of score, their mean over the pairs (of logs) being none."""
    if len(before) == 1:
        return before
    rows = score_class.ravel()
    mass = np.bincount(rows, weight.sum(axis=0).ravel(), len(before))
    square = np.bincount(rows, squares.sum(axis=0).ravel(), len(before))
    factor = np.sqrt(np.maximum(square, 1e-12) / np.maximum(2 * mass, 1e-12))
    return factor / np.exp(np.sum(mass * np.log(factor)) / mass.sum())


def _freedom(before: float, stretch: np.ndarray, weight: np.ndarray) -> float:
    """Degrees of freedom whose gamma variables have the expected logs and means."""
    if not np.isfinite(before):
        return before
    log_stretch = np.log(stretch) + digamma((before + 2) / 2) - np.log((before + 2) / 2)
    mean = float(np.sum(weight * (log_stretch - stretch)) / weight.sum())

    def slope(df: float) -> float:
        return float(np.log(df / 2) - digamma(df / 2) + 1 + mean)

    low, high = FREEDOM
    if slope(high) >= 0:
        return high
    return low if slope(low) <= 0 else float(brentq(slope, low, high))


def log_density(square: np.ndarray, df: float) -> np.ndarray:
    """Log density of a Gaussian or t in the plane at squared distances in units of its scale."""
    if not np.isfinite(df):
        return -square / 2 - np.log(2 * np.pi)
    constant = gammaln((df + 2) / 2) - gammaln(df / 2) - np.log(df * np.pi)
    return constant - (df + 2) / 2 * np.log1p(square / df)


def quadratic(form: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """`(...)`: vᵀ A v of `(..., 2, 2)` and `(..., 2)`."""
    x, y = vectors[..., 0], vectors[..., 1]
    both = form[..., 0, 1] + form[..., 1, 0]
    return form[..., 0, 0] * x**2 + both * x * y + form[..., 1, 1] * y**2


def determinant(form: np.ndarray) -> np.ndarray:
    """`(...)` of `(..., 2, 2)`."""
    return form[..., 0, 0] * form[..., 1, 1] - form[..., 0, 1] * form[..., 1, 0]


def inverse(form: np.ndarray) -> np.ndarray:
    """`(..., 2, 2)`."""
    found = np.empty_like(form)
    found[..., 0, 0], found[..., 1, 1] = form[..., 1, 1], form[..., 0, 0]
    found[..., 0, 1], found[..., 1, 0] = -form[..., 0, 1], -form[..., 1, 0]
    return found / determinant(form)[..., None, None]


def _median(values: np.ndarray, axis: int) -> np.ndarray:
    """Of what is there; 0 where nothing is."""
    empty = np.isnan(values).all(axis=axis, keepdims=True)
    return np.nanmedian(np.where(empty, 0.0, values), axis=axis)
