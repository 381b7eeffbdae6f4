"""What the best test finds of exchanged legs."""

import numpy as np
import pytest
from scipy.stats import norm

from poseterior.reports.pages.exchanges import found


@pytest.mark.parametrize("alarms", [0.02, 0.1])
def test_the_best_test_of_two_bells_has_their_power(alarms: float) -> None:
    """Of two normal laws, d apart, log likelihood ratios are normal with mean d²/2 and deviation d:
    the best test at a rate α finds Φ(d - z), z = Φ⁻¹(1 - α) (Neyman & Pearson). Of 200,000: within
    0.01, some five standard errors, the threshold's own included; a test that forgets what false
    alarms cost is farther off."""
    apart = 1.5
    gain = apart**2 / 2 + apart * np.random.default_rng(0).normal(size=(2, 100_000))
    power = norm.cdf(apart - norm.isf(alarms))
    np.testing.assert_allclose(found(gain, alarms), power, atol=0.01)
    assert abs((gain > 0).mean() - power) > 0.05


def test_legs_that_nothing_else_explains_are_found_always() -> None:
    assert found(np.array([np.inf, 3.0, 2.0, 1.0]), 0.02) == 1
    assert found(np.full(50, -1.0), 0.02) == 0
