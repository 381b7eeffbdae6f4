"""The likelihood's spreads, error laws and observations: by hand, and against other routes."""

import dataclasses
import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from poseterior.probmodel.detections import LIMB_JOINTS
from poseterior.probmodel.errors.detector import DetectorErrors
from poseterior.probmodel.errors.faults import FaultPrior
from poseterior.probmodel.errors.laws import LAWS, Gaussian
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from tests.goodness import floor
from tests.probmodel.test_detections import (
    ELBOW,
    HEAD,
    ONES,
    SCORES,
    WRIST,
    detection,
    with_entry,
)


def test_spread_by_hand() -> None:
    """Two observed joints with scores 0.2 and 0.6: alpha 0.5 and 1.5, radii 0.25 · 60 / alpha = 30
    and 10 pixels; a joint that does not count may lie anywhere."""
    score = np.zeros(NUM_JOINTS)
    score[[ELBOW, WRIST]] = 0.2, 0.6
    score[JOINT_INDEX["pelvis"]] = 7  # of the torso: no factor, and no part in the mean
    person = detection(score)
    expected = np.full(NUM_JOINTS, np.inf)
    expected[[ELBOW, WRIST]] = 30, 10
    np.testing.assert_allclose(Likelihood().spread(person, 60), expected)
    np.testing.assert_allclose(Likelihood(factor=0.5).spread(person, 60), 2 * expected)


def test_the_head_takes_part_in_the_mean_unless_left_out() -> None:
    person = detection(with_entry(ONES, HEAD, 2))
    assert person.alpha()[HEAD] == pytest.approx(2 / (10 / 9))
    without = Likelihood(joints=LIMB_JOINTS).spread(person, 4)
    assert np.isinf(without[HEAD])
    np.testing.assert_allclose(without[list(LIMB_JOINTS)], 1)


@settings(deadline=None)
@given(SCORES, st.floats(1e-6, 1e6))
def test_only_the_ratios_of_scores_matter(score: list[float], unit: float) -> None:
    """Detectors score in 0..1, 0..6 or above 1: the radii are the same."""
    scaled = Likelihood().spread(detection(np.array(score) * unit), 50)
    np.testing.assert_allclose(scaled, Likelihood().spread(detection(score), 50), rtol=1e-9)


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, 1e300])
def test_spread_refuses_a_scale_or_factor_that_is_none(value: float) -> None:
    with pytest.raises(BadInput, match="scale of the radii must lie between 0 and"):
        Likelihood().spread(detection(), value)
    with pytest.raises(BadInput, match="factor of the radii must lie between 0 and"):
        Likelihood(factor=value).spread(detection(), 1)


def test_a_spread_that_is_not_finite_is_refused_by_name() -> None:
    with pytest.raises(
        BadInput, match=r"score of right_elbow in person 0 of f is 5e-324, too far below"
    ):
        Likelihood().spread(detection(with_entry(ONES * 1e9, ELBOW, 5e-324)), 1)


def test_likelihoods_that_differ_in_anything_have_other_hashes() -> None:
    """Down to the last digit of one joint's learned spread, which words leave out."""
    learned = DetectorErrors.default()
    sigma = learned.sigma.copy()
    sigma[4] = np.nextafter(sigma[4], 1)
    others = [
        Likelihood(),
        Likelihood(Gaussian()),
        Likelihood(factor=np.nextafter(0.25, 1)),
        Likelihood(joints=LIMB_JOINTS),
        Likelihood(faults=FaultPrior.of(0.01, 0.0)),
        Likelihood.of(learned),
        Likelihood.of(dataclasses.replace(learned, sigma=sigma)),
    ]
    assert len({one.sha256 for one in others}) == len(others)
    assert Likelihood().sha256 == Likelihood().sha256


DENSITIES = {
    "disc": (1.0, lambda length: np.ones_like(length)),
    "gaussian": (1.5, lambda length: stats.norm.pdf(2 * length)),
    "student": (
        0.5 * math.sqrt(5 * math.expm1(9 / 5)),
        lambda length: stats.multivariate_t([0, 0], 0.25, df=5).pdf(length[:, None] * [1, 0]),
    ),
}
"""Of the laws: where they end, and a density along a ray, but for its constant."""


@pytest.mark.parametrize("name", LAWS)
def test_errors_fall_in_all_directions_as_densely_as_their_law_says(name: str) -> None:
    """20,000 of each: lengths by the integral of SciPy's density, the circle by its sixteenths.
    False alarms: one in 10,000. The control has errors a twentieth longer, and one sixteenth left
    out."""
    reach, density = DENSITIES[name]
    length = np.linspace(0, reach, 4001)
    below = integrate.cumulative_trapezoid(length * density(length), length, initial=0)
    errors = np.asarray(LAWS[name]().sample(jax.random.key(0), (20_000,)))

    def worst(errors: np.ndarray) -> float:
        far, way = np.hypot(*errors.T), np.arctan2(*errors.T)
        quantile = np.interp(far, length, below / below[-1])
        counts = np.histogram(way, 16, (-math.pi, math.pi))[0]
        return min(stats.kstest(quantile, "uniform").pvalue, stats.chisquare(counts).pvalue)

    assert worst(errors) > floor(2)
    assert worst(1.05 * errors) < floor(2)
    assert worst(errors[np.arctan2(*errors.T) < math.pi * 7 / 8]) < floor(2)
