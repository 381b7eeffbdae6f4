"""A detector's law, learned: simulated detectors' laws are recovered within the errors that are
said, from truth and from cameras alone; a filmed person's law holds on frames it has not seen."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from poseterior.inference.studies.errorlaws import (
    Learned,
    Pairs,
    learn,
    pairs_of_data,
    pairs_of_session,
    shares_within,
)
from poseterior.inference.studies.errorlaws.judge import LEVELS, standings
from poseterior.inference.studies.errorlaws.learn import in_common, jackknife_groups, still_to_come
from poseterior.inference.studies.errorlaws.mixture import Mixture, log_density
from poseterior.inference.studies.errorlaws.pairs import PATTERNS
from poseterior.inference.studies.intervals import Interval
from poseterior.probmodel import BadInput
from poseterior.probmodel.datasets import VIEWS, DataSet, from_motions
from poseterior.probmodel.errors.detector import OUTLIER_RADIUS, DetectorErrors, ScoreFactor
from poseterior.probmodel.errors.laws import Gaussian, Student
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.sessions import read_session
from poseterior.probmodel.sessions.session import HIPS
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from tests.filmed import filmed, moving

RNG = np.random.default_rng(7)
SIGMA = RNG.uniform(0.03, 0.09, NUM_JOINTS)
INLIER = RNG.uniform(0.80, 0.97, NUM_JOINTS)
BIAS = RNG.normal(size=(NUM_JOINTS, 2)) * 0.03
EXCHANGE = (0.04, 0.03, 0.02)
FACTOR = np.array([1.6, 1.0, 1 / 1.6])
"""Of the spread, by thirds of the scores."""
SHOULDERS = [JOINT_INDEX["right_shoulder"], JOINT_INDEX["left_shoulder"]]
FREEDOM = 5.0
NUMBER = 500
FALSE_ALARM = 1e-3
"""Of each test that compares a law with its estimate, all its parameters together."""


def simulated(
    number: int,
    law: str,
    seed: int,
    bias: float = 1.0,
    exchange: tuple[float, float, float] = EXCHANGE,
) -> Pairs:
    """Pairs of a detector whose law is known, drawn without the product's help."""
    rng = np.random.default_rng(seed)
    truth = PoseDictionary.default().mean[:, :2] + 0.1 * rng.normal(size=(number, NUM_JOINTS, 2))
    pattern = rng.choice(4, number, p=[1 - sum(exchange), *exchange])
    seen = np.stack([one[PATTERNS[row]] for one, row in zip(truth, pattern, strict=True)])
    score = rng.permutation((np.arange(number * NUM_JOINTS) + 0.5) / (number * NUM_JOINTS))
    score = score.reshape(number, NUM_JOINTS)
    kind = (3 * score).astype(int)
    error = rng.normal(size=seen.shape)
    if law == "student":
        error = error / np.sqrt(rng.chisquare(FREEDOM, kind.shape) / FREEDOM)[..., None]
    inlier = bias * BIAS + (SIGMA * FACTOR[kind])[..., None] * error
    angle, size = rng.uniform(0, 2 * np.pi, kind.shape), np.sqrt(rng.uniform(size=kind.shape))
    far = OUTLIER_RADIUS * size[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    good = rng.uniform(size=kind.shape) < INLIER
    recording = np.array([f"film {row % 40}" for row in range(number)])
    doubt = np.zeros((*kind.shape, 2, 2))
    detected = seen + np.where(good[..., None], inlier, far)
    return Pairs("simulated", detected, truth, doubt, score, recording, placed=True)


def deviations(found: Learned, law: str) -> np.ndarray:
    """Every estimate minus the truth, in standard errors."""
    errors = found.errors
    estimate = np.column_stack([errors.sigma, errors.inlier, errors.bias])
    # The record's factors have a geometric mean of one over the detections, as the true ones have
    # but for chance: only the product with sigma is compared.
    shift = np.log(errors.score.sigma_factor[1])
    estimate[:, 0] *= np.exp(shift)
    true = np.column_stack([SIGMA, INLIER, BIAS])
    parts = [((estimate - true) / errors.se).ravel()]
    parts.append((np.array(errors.exchange) - EXCHANGE) / found.exchange_se)
    if law == "student":
        parts.append(np.array([(errors.law.df - FREEDOM) / found.df_se]))
    return np.concatenate(parts)


def bound(number: int) -> float:
    """Standard errors within which so many estimates all lie, but for `FALSE_ALARM`: the standard
    errors are a jackknife's of twenty groups."""
    return float(stats.t.isf(FALSE_ALARM / (2 * number), 19))


@pytest.fixture(scope="module")
def gaussian() -> Learned:
    return learn(simulated(NUMBER, "gaussian", 1))


@pytest.mark.slow
def test_a_simulated_detectors_law_is_recovered_within_its_errors(gaussian: Learned) -> None:
    found = deviations(gaussian, "gaussian")
    assert np.abs(found).max() < bound(len(found))
    # Errors that are said to be far too large would hide everything.
    assert np.mean(found**2) > 0.5
    assert np.mean(found**2) < 2.0
    factor = np.array(gaussian.errors.score.sigma_factor)
    assert factor == pytest.approx(FACTOR, rel=0.03)


def test_who_forgets_the_outliers_is_caught(gaussian: Learned) -> None:
    """The negative control: bias and standard deviation of all errors as they come."""
    errors = gaussian.pairs.errors[0]
    spread = errors.std(axis=(0, 2))
    apart = (spread - SIGMA) / gaussian.errors.se[:, 0]
    assert apart.min() > 10 * bound(NUM_JOINTS)


def test_who_forgets_the_exchanges_calls_them_outliers() -> None:
    """Of knees and ankles, which are exchanged with the legs and with the body."""
    pairs = simulated(NUMBER, "gaussian", 1)
    alone = np.mean(np.linalg.norm(pairs.errors[0] - BIAS, axis=-1) < 5 * FACTOR[0] * SIGMA, axis=0)
    knee = JOINT_INDEX["left_knee"]
    assert alone[knee] < INLIER[knee] - 0.02


@pytest.mark.slow
def test_a_students_law_is_recovered_within_its_errors() -> None:
    found = deviations(learn(simulated(2500, "student", 2), law="student"), "student")
    assert np.abs(found).max() < bound(len(found))


def test_the_densities_are_scipys() -> None:
    points = np.random.default_rng(0).normal(size=(200, 2)) * 2
    square = np.sum(points**2, axis=1)
    normal = stats.multivariate_normal(np.zeros(2)).logpdf(points)
    student = stats.multivariate_t(np.zeros(2), df=3.5).logpdf(points)
    assert log_density(square, np.inf) == pytest.approx(normal)
    assert log_density(square, 3.5) == pytest.approx(student)
    assert not np.allclose(log_density(square, 3.0), student, atol=0.01)


@pytest.mark.parametrize("law", ["gaussian", "student"])
def test_standings_under_the_true_law_are_uniform(law: str) -> None:
    """Kolmogorov–Smirnov on 30,000 standings, false alarm 1e-3 each; a law three tenths too narrow
    must fail. Without bias, so that outliers' discs and inliers' regions have one centre."""

    def true_law(scale: float) -> DetectorErrors:
        own = Student(FREEDOM) if law == "student" else Gaussian()
        score = ScoreFactor((1 / 3, 2 / 3), tuple(FACTOR.tolist()))
        return DetectorErrors(own, SIGMA * scale, INLIER, np.zeros_like(BIAS), score=score)

    pairs = simulated(2000, law, 3, bias=0.0, exchange=(0.0, 0.0, 0.0))
    right, wrong = (standings(true_law(scale), pairs).ravel() for scale in (1.0, 0.7))
    assert stats.kstest(right, "uniform").pvalue > 1e-3
    assert stats.kstest(wrong, "uniform").pvalue < 1e-9


def test_a_law_from_cameras_alone_is_the_detectors() -> None:
    """Four cameras, errors of 12 mm each way, no truth: what is left of each joint's spread is
    within five standard errors of it (60 frames × 4 cameras × 2 less three coordinates of the
    joint and two of the shift: 1 in 2 · 10⁻⁶ for each of 15 joints). Without regard to the truth's
    own error it is a third too large, which must fail."""
    rng = np.random.default_rng(0)
    session = filmed(moving(60), 12.0 * rng.normal(size=(4, 60, NUM_JOINTS, 2)))
    pairs = pairs_of_session(session, perspective=True)
    half = 5 / np.sqrt(2 * 60 * (4 * 2 - 3 - 2))
    found = learn(pairs).errors
    limbs = [joint for joint in range(NUM_JOINTS) if not (~pairs.anchors[:, joint]).all()]
    sigma = found.sigma * session.unit / 12.0
    assert np.abs(sigma - 1).max() < half
    assert np.abs(sigma[limbs].mean() - 1) < half / np.sqrt(len(limbs))
    assert np.nanmin(found.inlier) > 0.99
    sure = Pairs(**{**vars_of(pairs), "doubt": np.zeros_like(pairs.doubt)})
    assert (learn(sure).errors.sigma * session.unit / 12.0)[limbs].mean() > 1 + half


def vars_of(pairs: Pairs) -> dict[str, object]:
    """The fields of pairs."""
    return {field.name: getattr(pairs, field.name) for field in dataclasses.fields(pairs)}


def test_weak_perspective_belongs_to_the_law_where_the_focal_length_is_unknown() -> None:
    """Without any error, what is left is perspective alone: none with the calibrated cameras."""
    session = filmed(moving(12), np.zeros((4, 12, NUM_JOINTS, 2)))
    exact, weak = (pairs_of_session(session, perspective=way) for way in (True, False))
    assert np.abs(exact.errors[0]).max() < 1e-9
    left = np.linalg.norm(weak.errors[0], axis=-1) * session.unit
    assert 5 < np.median(left) < 60


def test_pairs_of_a_data_set_are_in_body_units() -> None:
    """Motion capture whose detections are moved by a tenth of a body unit to the right."""
    body = 330 * PoseDictionary.default().mean + np.zeros((40, 1, 1))
    data = from_motions([Motion(body, 30.0, "standing/one", "a")], "x", frames=16, views=VIEWS)
    unit = data.case(0).unit
    moved = data.keypoints + data.scale[:, None, None] * unit * np.array([0.1, 0.0])
    fields = {field.name: getattr(data, field.name) for field in dataclasses.fields(data)}
    pairs = pairs_of_data(DataSet(**{**fields, "keypoints": moved}))
    assert pairs.errors[0] == pytest.approx(np.broadcast_to([0.1, 0.0], (16, 15, 2)), abs=1e-9)
    assert pairs.placed
    hidden = DataSet(
        **{**fields, "keypoints": np.where(np.arange(15)[:, None] == 4, np.nan, moved)}
    )
    assert not pairs_of_data(hidden).seen[:, 4].any()


def test_recordings_are_left_out_whole() -> None:
    names = np.array(["a", "b", "c", "d", "e"]).repeat(3)
    assert jackknife_groups(names).tolist() == np.arange(5).repeat(3).tolist()
    many = np.array([f"{row:03}" for row in range(100)])
    assert len(set(jackknife_groups(many))) == 20
    one = jackknife_groups(np.array(["a"] * 60))
    assert np.bincount(one).tolist() == [3] * 20
    assert (np.diff(one) >= 0).all()


def test_a_law_from_four_recordings_holds_in_the_next() -> None:
    """Recordings with biases of their own, two spreads large, by plain means in the place of the
    fit: over 100 learned laws, regions of 50, 80 and 95 % of the law that is written hold as many
    of 20 new recordings' errors, within 2.5 % (five standard errors). The law as it is fitted
    must miss by thrice as much."""
    rng = np.random.default_rng(5)
    levels, number = np.array([0.5, 0.8, 0.95]), 4
    written, fitted = [], []

    def recordings(count: int) -> np.ndarray:
        bias = 2 * rng.normal(size=(count, 1, NUM_JOINTS, 2))
        return bias + rng.normal(size=(count, 30, NUM_JOINTS, 2))

    def mixture(errors: np.ndarray) -> Mixture:
        bias = errors.mean(axis=(0, 1))
        sigma = np.sqrt(np.mean((errors - bias) ** 2, axis=(0, 1, 3)))
        return Mixture(sigma, np.ones(NUM_JOINTS), bias, np.inf, np.eye(4)[0], np.ones(1))

    for _ in range(100):
        errors, new = recordings(number), recordings(20)
        whole = mixture(errors)
        parts = [mixture(np.delete(errors, one, axis=0)) for one in range(number)]
        columns = np.stack([np.column_stack([one.sigma, one.inlier, one.bias]) for one in parts])
        se = np.sqrt((number - 1) * columns.var(axis=0))
        sigma, df = still_to_come(whole, se, np.ones(NUM_JOINTS, bool))
        square = np.sum((new - whole.bias) ** 2, axis=-1)
        inside = stats.f.cdf(square / sigma**2 / 2, 2, df)[..., None] <= levels
        written.append(inside.mean(axis=(0, 1, 2)))
        inside = -np.expm1(-square / whole.sigma**2 / 2)[..., None] <= levels
        fitted.append(inside.mean(axis=(0, 1, 2)))
    assert np.mean(written, axis=0) == pytest.approx(levels, abs=0.025)
    assert (np.mean(fitted, axis=0) < levels - 0.075).all()


def test_a_law_from_many_recordings_is_as_it_was_fitted() -> None:
    whole = Mixture(SIGMA, INLIER, BIAS, np.inf, np.eye(4)[0], np.ones(1))
    se = 0.02 * np.column_stack([SIGMA, SIGMA, SIGMA, SIGMA])
    sigma, df = still_to_come(whole, se, np.ones(NUM_JOINTS, bool))
    assert sigma == pytest.approx(SIGMA, rel=1e-3)
    assert df == np.inf
    known = np.arange(NUM_JOINTS) == 0
    _, df = still_to_come(dataclasses.replace(whole, df=10.0), 10 * se, known)
    assert df == pytest.approx(1 / (1 / 10 + 2 * 0.2**2))


def together(share: float, number: int = 2000) -> Pairs:
    """Pairs of a detector both of whose hips err with that share of their variance in common."""
    rng = np.random.default_rng(11)
    truth = PoseDictionary.default().mean[:, :2] + np.zeros((number, 1, 2))
    error = rng.normal(size=truth.shape)
    common = rng.normal(size=(number, 1, 2))
    error[:, HIPS] = np.sqrt(1 - share) * error[:, HIPS] + np.sqrt(share) * common
    recording = np.array([f"film {row % 40}" for row in range(number)])
    doubt, score = np.zeros((*error.shape, 2)), np.ones(error.shape[:2])
    detected = truth + SIGMA[:, None] * error
    return Pairs("together", detected, truth, doubt, score, recording, placed=True)


def misses_of_the_hips_middle(errors: DetectorErrors, pairs: Pairs) -> int:
    """How many of their midpoints' coordinates lie beyond 95 % of a law of independent hips."""
    middle = (pairs.detected - pairs.truth - errors.bias)[:, HIPS].mean(axis=1)
    spread = np.sqrt(np.sum(errors.sigma[HIPS] ** 2)) / 2
    law = stats.t(errors.law.df) if isinstance(errors.law, Student) else stats.norm
    return int(np.sum(np.abs(middle) > law.ppf(0.975) * spread))


def test_hips_that_err_together_say_less_of_their_middle() -> None:
    """At 1e-3 each. A law of the same spreads without what hips have in common is caught, and hips
    that err by themselves have nothing in common."""
    pairs = together(0.6)
    found = learn(pairs)
    error = stats.norm.isf(FALSE_ALARM / 2) * (1 - 0.6**2) / np.sqrt(2 * len(pairs))
    common = in_common(found.fit.expected)
    assert common[HIPS] == pytest.approx(0.6, abs=error + 0.01)  # outliers by mistake: 0.01
    assert not np.delete(common, [*HIPS, *SHOULDERS]).any()
    number, fewest = 2 * len(pairs), FALSE_ALARM / 2
    low, high = stats.binom.ppf([fewest, 1 - fewest], number, 0.05)
    assert low <= misses_of_the_hips_middle(found.errors, pairs) <= high
    sigma = np.array(found.errors.sigma)
    sigma[HIPS] = found.fit.mixture.sigma[HIPS]
    assert misses_of_the_hips_middle(dataclasses.replace(found.errors, sigma=sigma), pairs) > high
    alone = in_common(learn(together(0.0)).fit.expected)
    assert alone.max() < stats.norm.isf(FALSE_ALARM / 2) / np.sqrt(2 * len(pairs))


def test_bad_requests_are_refused() -> None:
    pairs = simulated(30, "gaussian", 0)
    with pytest.raises(BadInput, match="there is no law 'disc' to be learned"):
        learn(pairs, law="disc")
    with pytest.raises(BadInput, match="has 12 detections of a joint at most; a law needs 20"):
        learn(pairs.take(np.arange(12)))


def test_a_joint_that_is_never_seen_is_not_known() -> None:
    pairs = simulated(60, "gaussian", 0)
    detected = pairs.detected.copy()
    detected[:, 4] = np.nan
    errors = learn(Pairs(**{**vars_of(pairs), "detected": detected})).errors
    assert np.flatnonzero(~errors.known).tolist() == [4]
    assert errors.pairs[4] == 0


@pytest.mark.slow
def test_the_second_half_of_a_film_is_covered_by_the_law_of_the_first(shared_data: Path) -> None:
    """Four cameras: regions of 50, 80 and 95 % hold as many of the residuals of the half that was
    not learned from, within intervals of 95 % from drawing cameras anew. The law as it was fitted
    must fail all three: there the person moves more."""
    session = read_session(shared_data / "multicamera")
    first, second = (session.take(range(start, start + 50)) for start in (0, 50))
    found = learn(pairs_of_session(first), truth=pairs_of_session(first, perspective=True))
    assert found.truth_fit is not None
    pairs = pairs_of_session(second)

    def shares(errors: DetectorErrors) -> list[Interval]:
        standing = standings(errors, pairs, found.truth_fit.mixture.sigma)
        return shares_within(standing, pairs.recording)

    for level, share in zip(LEVELS, shares(found.errors), strict=True):
        assert share.low < level < share.high
        assert share.value == pytest.approx(level, abs=0.05)
    sigma = found.fit.mixture.sigma
    fitted = dataclasses.replace(found.errors, law=Gaussian(), sigma=sigma)
    for level, share in zip(LEVELS, shares(fitted), strict=True):
        assert share.high < level
