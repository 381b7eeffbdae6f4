"""What weights, ranks, modes and levels come to, number by number: small cases that can be written
out, so that a fault in a statistic is seen without a run of a sampler."""

import itertools
import math

import numpy as np
import pytest
import xarray as xr
from scipy import integrate, stats

from poseterior.inference.resampling import (
    counting,
    effective,
    inclusion,
    let_pass,
    logs_of,
    merged,
    shares,
    systematic,
    tempered,
    times,
    weights_of,
)
from poseterior.inference.studies.calibration.uniformity import (
    ECDF_LEVELS,
    band,
    difference,
    uniformity,
)
from poseterior.inference.studies.calibration.verdict import (
    CALIBRATED,
    CANNOT_TELL,
    MISCALIBRATED,
    Calibration,
    _bounded,
    judge,
)
from poseterior.inference.studies.comparison.mixing import Mixing, mean_ess, mixing
from poseterior.inference.studies.comparison.modes import counts_by_mode, modes, same_shares
from poseterior.inference.studies.comparison.permutation import (
    _some,
    classifier_test,
    permutation_tests,
)
from poseterior.inference.studies.comparison.power import _noncentrality, _shift, _wider, seen
from poseterior.inference.studies.comparison.ranks import all_together, each_coordinate, scores
from poseterior.probmodel import BadInput

NOTHING = -np.inf


# Weights.


def test_shares_have_sum_one_and_are_worth_so_many_equal_ones() -> None:
    np.testing.assert_allclose(shares(np.log([1.0, 3.0]) - 800), [0.25, 0.75])
    np.testing.assert_array_equal(shares(np.array([NOTHING, 5.0])), [0, 1])
    np.testing.assert_array_equal(shares(np.full(3, NOTHING)), np.zeros(3))
    assert effective(np.array([0.1, 0.2, 0.7])) == pytest.approx(1 / 0.54)
    assert effective(np.zeros(3)) == 0


@pytest.mark.parametrize(
    ("last", "share"),
    [(math.log(9), 0.75), (math.log(2), 2 / 3)],
    ids=["the square root", "worth enough as they are"],
)
def test_weights_are_flattened_until_they_are_worth_enough(last: float, share: float) -> None:
    """1 / (s² + (1 - s)²) is 1.6 where s is 3/4."""
    found = tempered(np.array([0.0, last, NOTHING]), 1.6)
    np.testing.assert_allclose(found, [1 - share, share, 0], atol=1e-9)
    np.testing.assert_array_equal(tempered(np.full(2, NOTHING), 1.6), np.zeros(2))


def test_rows_are_taken_by_one_offset() -> None:
    """At (i + 0.2) / 4 of the sums 1/4, 3/4 and 1."""
    weight = np.array([1.0, 2.0, 1.0])
    np.testing.assert_array_equal(systematic(weight, 4, 0.2), [0, 1, 1, 2])
    np.testing.assert_array_equal(times(weight, 4, 0.2), [1, 2, 1])
    np.testing.assert_array_equal(times(weight, 1, 0.9), [0, 0, 1])
    nothing = systematic(weight, 0, 0.2)
    assert nothing.shape == (0,)
    assert nothing.dtype.kind == "i"


def test_no_row_is_taken_behind_the_last() -> None:
    """Where sums one by one end below the sum of all, by rounding."""
    rng, offset = np.random.default_rng(0), np.nextafter(1, 0)
    weights = (rng.exponential(size=1000) for _ in range(100))
    weight = next(one for one in weights if np.cumsum(one)[-1] / one.sum() < offset)
    np.testing.assert_array_equal(systematic(weight, 1, offset), [999])


@pytest.mark.parametrize(
    ("weight", "number", "expected"),
    [
        ([1, 1, 1, 1], 2, [0.5, 0.5, 0.5, 0.5]),
        ([8, 1, 1, 0], 2, [1, 0.5, 0.5, 0]),
        ([100, 10, 1, 1], 3, [1, 1, 0.5, 0.5]),
        ([2, 1, 1], 2, [1, 0.5, 0.5]),
        ([1, 1, 0], 3, [1, 1, 0]),
        ([0, 3, 0], 1, [0, 1, 0]),
    ],
)
def test_nobody_is_taken_twice(weight: list[float], number: int, expected: list[float]) -> None:
    np.testing.assert_allclose(inclusion(np.array(weight, float), number), expected)


def test_what_counts_has_a_share_that_is_a_number() -> None:
    """The smallest is e^-708.4 of the largest."""
    found = counting(np.array([5.0, -703.0, -704.0, -1e300, NOTHING]))
    np.testing.assert_array_equal(found, [True, True, False, False, False])
    assert not counting(np.full(2, NOTHING)).any()


@pytest.mark.parametrize("order", [*itertools.permutations(range(3))])
def test_the_same_draw_has_the_sum_of_its_weights(order: tuple[int, ...]) -> None:
    rows = list(order)
    draws, total = merged(np.array([[1.0], [2.0], [1.0]])[rows], np.log([1.0, 2.0, 3.0])[rows])
    assert dict(zip(draws[:, 0], total, strict=True)) == pytest.approx(
        {1.0: math.log(4), 2.0: math.log(2)}
    )


def test_weights_of_a_file_become_logs() -> None:
    given = {"weights": np.array([[0.0, 1.0], [3.0, 2.0]])}
    expected = [NOTHING, 0, math.log(3), math.log(2)]
    np.testing.assert_allclose(weights_of(given, (4,), "a.npz"), expected)
    np.testing.assert_array_equal(logs_of(np.array([NOTHING, 5.0]), "log_weights"), [NOTHING, 5])
    assert weights_of({"draws": np.zeros(4)}, (4,), "a.npz") is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"weights": np.ones(4), "log_weights": np.ones(4)}, "has both weights and log_weights"),
        ({"weights": np.ones(3)}, "are 3 for 4 draws"),
        ({"weights": np.array([1.0, np.nan, 1, 1])}, "a number that is not finite"),
        ({"log_weights": np.array([1.0, np.inf, 1, 1])}, "a number that is not finite"),
        ({"weights": np.array([1.0, -1, -2, 0])}, "2 of 4 weights of a.npz are negative"),
        ({"weights": np.zeros(4)}, "all weights of a.npz are zero"),
        ({"log_weights": np.full(4, NOTHING)}, "all weights of a.npz are zero"),
    ],
)
def test_what_is_no_weight_is_refused(given: dict[str, np.ndarray], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        weights_of(given, (4,), "a.npz")


def test_draws_pass_by_their_weight_over_the_largest() -> None:
    """10,000 of half the largest weight: 4 standard errors."""
    log_weights = np.repeat([-7.0, -7.0 - math.log(2), NOTHING], 10_000)
    held = let_pass(log_weights, np.random.default_rng(0)).reshape(3, -1).mean(axis=1)
    assert (held[0], held[2]) == (1, 0)
    assert abs(held[1] - 0.5) < 4 * 0.005


# Ranks.

KNOWN = np.array([[1.0], [2.0], [3.0], [4.0]])
RANKED = {-1.0: 0.1, 1.5: 0.3, 2.0: 0.4, 9.0: 0.9}
"""Values, and their ranks among four: (how many lie below, ties by half, + 1/2) / 5."""


def polynomials(u: np.ndarray) -> np.ndarray:
    """Of Legendre, of second and third order."""
    return np.stack([math.sqrt(3) * (2 * u - 1), math.sqrt(5) * (6 * u**2 - 6 * u + 1)], axis=-1)


def test_scores_are_polynomials_of_ranks() -> None:
    values = np.array([*RANKED])[:, None]
    expected = polynomials(np.array([*RANKED.values()]))[:, None]
    np.testing.assert_allclose(scores(values, KNOWN), expected)
    twice = np.stack([values, values[::-1]])
    np.testing.assert_allclose(scores(twice, KNOWN), np.stack([expected, expected[::-1]]))


def test_a_coordinate_is_judged_by_the_mean_of_its_scores() -> None:
    """Of 200 draws among 50; a coordinate that does not vary is not judged."""
    rng = np.random.default_rng(1)
    draws, exact = rng.normal(0.3, 1, (1, 200, 2)), rng.normal(size=(50, 2))
    exact[:, 1] = 0.0
    p_values, ess = each_coordinate(draws, exact)
    below = (exact[:, 0] < draws[0, :, :1]).sum(axis=1)
    mean = polynomials((below + 0.5) / 51).mean(axis=0)
    expected = 2 * stats.norm.sf(np.abs(mean) / np.sqrt(1 / ess[0] + 1 / 50))
    np.testing.assert_allclose(p_values[0], expected)
    assert np.isnan(p_values[1]).all()
    assert (ess[0] > 100).all()


def test_all_scores_are_judged_by_hotelling() -> None:
    """T² of two scores, whose covariance is that of the exact draws."""
    rng = np.random.default_rng(2)
    draws, exact = rng.normal(0.3, 1, (40, 1)), rng.normal(size=(60, 1))
    square, p_value = all_together(draws, exact)
    own = polynomials((np.arange(60) + 1.0) / 61)  # each a tie with itself
    mean = scores(draws, exact)[:, 0].mean(axis=0)
    expected = mean @ np.linalg.inv(np.cov(own.T)) @ mean / (1 / 40 + 1 / 60)
    assert square == pytest.approx(expected)
    assert p_value == pytest.approx(stats.f.sf(expected * 58 / (2 * 59), 2, 58))


# Modes.

AWAY = np.array([[False, False]] * 5 + [[False, True]] * 3 + [[True, False]] * 2)


def test_modes_stand_by_how_often_they_are_exact() -> None:
    found = modes(np.array([[False, False]] * 3 + [[False, True]]), AWAY, 2.0)
    np.testing.assert_array_equal(found.patterns, [[False, False], [False, True], [True, False]])
    np.testing.assert_allclose(found.exact, [0.5, 0.3, 0.2])
    np.testing.assert_allclose(found.share, [0.75, 0.25, 0])
    assert found.missed == pytest.approx(0.2)
    assert found.expected_missed == pytest.approx(0.5 * 0.25 + 0.3 * 0.49 + 0.2 * 0.64)


def patterns(*counts: int) -> np.ndarray:
    """So many draws of the first patterns of three bones."""
    codes = np.repeat(np.arange(len(counts)), counts)
    return (codes[:, None] >> np.arange(3)) % 2 > 0


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ((60, 34, 3, 3), (60, 36, 2, 2), [[60, 34, 6], [60, 36, 4]]),
        ((60, 35, 5), (60, 35, 5), [[60, 35, 5], [60, 35, 5]]),
        ((60, 36, 4), (500, 490, 10), [[60, 36, 4], [500, 490, 10]]),
    ],
    ids=["two rare ones", "just common enough", "one rare one"],
)
def test_modes_of_which_fewer_than_five_are_expected_are_one(
    ours: tuple[int, ...], theirs: tuple[int, ...], expected: list[list[int]]
) -> None:
    """By their share of both sets, in the smaller one."""
    np.testing.assert_array_equal(counts_by_mode(patterns(*ours), patterns(*theirs)), expected)


def test_what_is_known_of_modes_stands_in_the_place_of_exact_draws() -> None:
    """One mode was drawn by nobody; another, which we alone drew, is rare and stands last."""
    known = {0: 500.0, 1: 300.0, 3: 200.0}
    found = counts_by_mode(patterns(50, 30, 20), patterns(5, 5), known)
    np.testing.assert_array_equal(found, [[50, 30, 0, 20], [500, 300, 200, 0]])


def test_shares_of_modes_are_compared_by_chi_square() -> None:
    """n (ad - bc)² / (rows × columns), of one degree of freedom."""
    statistic, p_value = same_shares(np.array([[10, 20], [20, 10]]))
    assert statistic == pytest.approx(60 * 300**2 / 30**4)
    assert p_value == pytest.approx(stats.chi2.sf(statistic, 1))
    assert same_shares(np.array([[10], [20]])) == (0.0, 1.0)


# Chains.


def walks(chains: int, still: int) -> np.ndarray:
    """`(chain, 100, 2)`: independent draws; the second coordinate of some chains stands still."""
    values = np.random.default_rng(3).normal(size=(chains, 100, 2))
    values[:still, :, 1] = 0.5
    return values


@pytest.mark.parametrize(("still", "stuck"), [(0, False), (1, False), (2, True)])
def test_chains_of_which_more_than_one_in_twenty_stands_still_are_stuck(
    still: int, stuck: bool
) -> None:
    found = mixing(walks(20, still), np.ones(2))
    assert found.stuck == stuck
    assert (found.worst == 1.0) == stuck
    assert found.unique == 1.0
    assert np.isnan(found.rhat).all() == stuck


def test_draws_that_repeat_are_no_draws() -> None:
    """One in fifty is distinct, or somewhat fewer."""
    for distinct, stuck in ((20, False), (19, True)):
        values = np.random.default_rng(4).normal(size=(1, distinct, 1))
        found = mixing(np.tile(values, (1, 53, 1))[:, :1000], np.ones(1))
        assert found.unique == distinct / 1000
        assert found.stuck == stuck


def test_what_the_exact_draws_do_not_vary_is_not_asked_of_chains() -> None:
    values = walks(4, 4)
    found = mixing(values, np.array([1.0, 0.0]))
    assert not found.stuck
    assert np.isfinite([found.bulk[0], found.tail[0], found.rhat[0]]).all()
    assert np.isnan([found.bulk[1], found.tail[1], found.rhat[1]]).all()
    assert found.worst == min(found.bulk[0], found.tail[0]) <= 400
    assert found.worst_rhat == found.rhat[0]
    short = mixing(values[:, :3], np.array([1.0, 0.0]))
    assert np.isnan(short.bulk).all()
    assert math.isnan(short.worst_rhat)


def test_the_worst_coordinate_counts() -> None:
    bulk, tail, rhat = np.array([[9.0, 4.0, np.nan], [5.0, 7.0, np.nan], [1.0, 1.2, np.nan]])
    found = Mixing(bulk, tail, rhat, 1.0, False)
    assert (found.worst, found.worst_rhat) == (4.0, 1.2)


def test_of_what_nothing_is_known_every_draw_counts() -> None:
    assert mean_ess(np.zeros((2, 50))) == 100
    assert mean_ess(np.random.default_rng(5).normal(size=(2, 3))) == 6
    assert mean_ess(np.tile([0.0, 1.0], (1, 50))) <= 100


# What could have been seen.


@pytest.mark.parametrize("size", [0.1, 0.7])
def test_smallest_changes_are_those_whose_scores_have_these_means(size: float) -> None:
    """Means of the polynomials of a normal law's ranks, by quadrature."""

    def mean(order: int, moved: float, ratio: float) -> float:
        def part(x: float) -> float:
            u = stats.norm.cdf(ratio * x + moved)
            return float(polynomials(np.array(u))[order] * stats.norm.pdf(x))

        return float(integrate.quad(part, -9, 9)[0])

    assert _shift(mean(0, size, 1.0)) == pytest.approx(size, rel=1e-6)
    assert _wider(mean(1, 0.0, 1 + size)) == pytest.approx(size, rel=1e-6)


def test_no_change_has_scores_beyond_the_largest() -> None:
    assert _shift(math.sqrt(3)) == _wider(math.sqrt(5)) == math.inf
    assert math.isfinite(_shift(1.7) + _wider(2.2))
    assert _noncentrality(0.01, 0) == math.inf


def test_what_a_run_could_have_seen() -> None:
    """Of three coordinates, one of which does not vary, and two modes; five tests share 5 %."""
    ess = np.array([[100.0, 80.0], [np.nan, np.nan], [400.0, 50.0]])
    found = seen(ess, 1000, np.array([[60, 40], [600, 400]]), 0.6, 5, 0.05)
    sure = stats.norm.isf(0.01 / 4 / 2) + stats.norm.ppf(0.9)
    assert found.shift == pytest.approx(_shift(sure * math.sqrt(1 / 100 + 1 / 1000)))
    assert found.spread == pytest.approx(_wider(sure * math.sqrt(1 / 50 + 1 / 1000)))
    apart, worth = _noncentrality(0.01, 1), 1 / (1 / 100 + 1 / 1000)
    assert stats.ncx2.sf(stats.chi2.isf(0.01, 1), 1, apart) == pytest.approx(0.9)
    assert found.moved == pytest.approx(math.sqrt(apart * 0.6 * 0.4 / worth))
    assert found.missing == pytest.approx(apart / (worth + apart))
    assert f", or a mode of {found.missing:.1%} that no draw has" in found.sentence
    assert f"by {found.shift:.2g} or wider by {found.spread:.0%} of its" in found.sentence
    alone = seen(ess, 1000, np.array([[100], [1000]]), 1.0, 5, 0.05)
    assert alone.missing == math.inf
    assert "mode" not in alone.sentence


# Permutations.


def test_a_coin_is_right_a_hundred_times_as_seldom_as_two_to_the_minus_hundred() -> None:
    """Sides far apart: a hundred draws are held out, and none is taken for the other's."""
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(100, 2)), rng.normal(size=(100, 2)) + 50
    assert classifier_test(one, other, rng) == (1.0, pytest.approx(0.5**100, abs=0))


def test_a_permutation_is_as_far_or_not() -> None:
    """Three and three draws that are far apart: of 20 ways to deal them out two are as far, so that
    p is 0.1 (4 standard errors of 999 permutations). Units do not matter."""
    one, other = np.array([[0.0], [1.0], [2.0]]), np.array([[100.0], [101.0], [102.0]])
    for scale in (1.0, 1e-6):
        found = permutation_tests(scale * one, scale * other, np.random.default_rng(0))
        for _, p_value in found.values():
            assert abs(p_value - 0.1) < 4 * 0.0095
    few = permutation_tests(one, other, np.random.default_rng(0), permutations=4)
    assert all((5 * p_value).is_integer() and p_value >= 0.2 for _, p_value in few.values())


def test_of_too_many_draws_some_take_part() -> None:
    draws, rng = np.arange(30.0)[:, None], np.random.default_rng(0)
    assert _some(draws, rng, 30) is draws
    some = _some(draws, rng, 20)
    assert len(np.unique(some)) == len(some) == 20


# Uniformity.


def every_pair() -> np.ndarray:
    """`(100, 100)`: the statistic of two values, by the hundredths that they lie in."""
    cells = np.arange(100)
    counts = (cells[:, None, None] < np.arange(1, 100)).astype(int) + (
        cells[None, :, None] < np.arange(1, 100)
    )
    below = stats.binom.cdf(counts, 2, ECDF_LEVELS)
    above = 1 - stats.binom.cdf(counts - 1, 2, ECDF_LEVELS)
    return np.minimum(1, 2 * np.minimum(below, above).min(axis=-1))


def test_the_law_of_the_statistic_is_that_of_all_cases() -> None:
    """Two values: ten thousand pairs of hundredths, each as likely as any other."""
    statistic = every_pair()
    for one, other in itertools.product([0, 3, 20, 50, 77, 99], repeat=2):
        found = uniformity((np.array([one, other]) + 0.5) / 100)
        assert found.statistic == pytest.approx(statistic[one, other])
        expected = np.mean(statistic <= statistic[one, other] * (1 + 1e-9))
        assert found.p_value == pytest.approx(expected, abs=1e-9)
        assert found.size == 2


def test_a_band_holds_the_cases_that_are_not_rejected() -> None:
    low, high = band(2, 0.9)
    cells = np.arange(100)
    share = (cells[:, None, None] < np.arange(1, 100)) * 0.5 + (
        cells[None, :, None] < np.arange(1, 100)
    ) * 0.5
    inside = ((low <= share) & (share <= high)).all(axis=-1)
    statistic = every_pair()
    p_values = np.array([np.mean(statistic <= one * (1 + 1e-9)) for one in statistic.ravel()])
    assert inside.mean() >= 0.9
    np.testing.assert_array_equal(inside.ravel(), p_values > 0.1)


def test_a_distribution_function_stands_beside_the_uniform_one() -> None:
    found = difference(np.array([0.005, 0.5]))
    assert found[[0, 48, 49, 98]] == pytest.approx([0.49, 0.01, 0.5, 0.01])


def test_no_p_value_is_said_to_be_zero() -> None:
    assert _bounded(0.0123) == "= 0.012"
    assert _bounded(0.0) == _bounded(1e-300) == "< 1e-300"


EVEN = (np.arange(200) + 0.5) / 200


def judged(one: np.ndarray, other: np.ndarray, failed: int) -> Calibration:
    """The verdict on two quantities, of which the last so many simulations failed."""
    levels = np.stack([one, other], axis=1)
    levels[len(levels) - failed :] = np.nan
    dims = ("simulation", "quantity")
    return judge(xr.Dataset({"level": (dims, levels)}, coords={"quantity": ["one", "other"]}))


MIXED = np.random.default_rng(6).permutation(EVEN)


@pytest.mark.parametrize(
    ("other", "failed", "verdict", "said"),
    [
        (MIXED, 0, CALIBRATED, "no test of 2 rejects at 0.01 with 200 simulations"),
        (MIXED, 2, CALIBRATED, "with 198 simulations; the sampler failed on 2 of 200 simulations"),
        (MIXED, 3, CANNOT_TELL, "failed on 3 of 200 simulations; no test rejects on the others"),
        (0.25 + MIXED / 2, 0, MISCALIBRATED, "with 200 simulations"),
        (0.25 + MIXED / 2, 2, MISCALIBRATED, "the sampler failed on 2 of 200 simulations"),
        (0.25 + MIXED / 2, 3, MISCALIBRATED, "200 simulations, whatever these would have said"),
        (0.7 * MIXED, 80, CANNOT_TELL, "failed on 80 of 200 simulations; that alone may be why"),
    ],
)
def test_one_failure_in_a_hundred_is_forgiven(
    other: np.ndarray, failed: int, verdict: str, said: str
) -> None:
    """Of more, which ones may depend on the truth: 80 levels that are not known may lie in the
    three tenths where none of the others lies, but 3 cannot fill the outer half."""
    found = judged(MIXED[::-1], other, failed)
    assert found.verdict == verdict, found.sentence
    assert found.sentence.endswith(said) or said in found.sentence
    p_values = [uniformity(one[: 200 - failed]).p_value for one in (MIXED[::-1], other)]
    assert found.tests.p_value.values == pytest.approx(p_values)
    assert found.tests.adjusted.values.min() == pytest.approx(min(1.0, 2 * min(p_values)))
    assert found.families == {"ranks (SBC)": pytest.approx(min(1.0, 2 * min(p_values)))}


@pytest.mark.parametrize(
    ("number", "failed", "said"),
    [
        (99, 0, "there are 99 simulations; the tests need at least 100"),
        (99, 9, "there are 99 simulations, 9 of them failed; "),
        (100, 100, "there are 100 simulations, 100 of them failed; "),
    ],
)
def test_too_few_simulations_say_nothing(number: int, failed: int, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        judged(EVEN[:number], EVEN[:number], failed)


@pytest.mark.parametrize("values", [[], [0.5, -0.1], [1.1], [np.nan]])
def test_what_is_no_level_is_refused(values: list[float]) -> None:
    with pytest.raises(ValueError, match="values from 0 to 1, at least one"):
        uniformity(np.array(values))
