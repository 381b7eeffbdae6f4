"""The judge: it says "differs" as often as it should where all is well, and where something is
wrong at n = 2,000.

Size: counts of rejections over 200 repetitions lie in the binomial interval at 0.1 % (both tails);
seeds are fixed. Negative controls, each caught with 2,000 draws: a sampler that never leaves one
depth flip, lengths 5 % too narrow, emcee started in one point, the half-updated ensembles of
NumPyro ≤ 0.21."""

import functools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from arviz_stats.base import array_stats
from numpyro.infer import AIES, ESS
from scipy.signal import lfilter
from scipy.stats import binom

from poseterior import inference
from poseterior.inference.baselines.chains import Walk
from poseterior.inference.baselines.ensemble import EmceeKernel, NumPyroKernel
from poseterior.inference.baselines.target import Target
from poseterior.inference.studies.comparison import Judgement, comparison_tree, judge
from poseterior.inference.studies.comparison.cost import course
from poseterior.inference.studies.comparison.distances import (
    energy,
    mmd,
    pairwise,
    sliced_wasserstein,
    wasserstein,
)
from poseterior.inference.studies.comparison.judge import (
    AGREES,
    CANNOT_TELL,
    DIFFERS,
    UNMIXED,
    _coordinates,
    _evidence,
    _verdict,
)
from poseterior.inference.studies.comparison.judge import Test as OneTest
from poseterior.inference.studies.comparison.mixing import mean_ess, mixing
from poseterior.inference.studies.comparison.modes import counts_by_mode, modes, same_shares
from poseterior.inference.studies.comparison.pace import autocorrelation_times, pace, uncrossed
from poseterior.inference.studies.comparison.permutation import classifier_test, permutation_tests
from poseterior.inference.studies.comparison.power import POWER, seen
from poseterior.inference.studies.comparison.ranks import all_together, each_coordinate, scores
from poseterior.inference.studies.comparison.record import Entry
from poseterior.inference.studies.comparison.sample import (
    NAMES,
    Sample,
    read_sample,
    sample_of,
)
from poseterior.inference.studies.flips import codes
from poseterior.inference.studies.intervals import permuted
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.root_priors import CANDIDATES
from tests.scenes import ALL_BUT_AN_ARM, key, prior_scene
from tests.wrong_samplers import HalfUpdatedAIES, HalfUpdatedESS

SEEN = [0, 4]
"""The bones of the seen arm among those that flip."""
REPETITIONS = 200
DRAWS = 2000
FEW = 99
"""Permutations where the other tests decide: fewer could not, at any level used here."""


def between(count: int, rate: float) -> bool:
    """Whether `count` of the repetitions is what `rate` allows, at 0.1 %."""
    return binom.ppf(0.0005, REPETITIONS, rate) <= count <= binom.ppf(0.9995, REPETITIONS, rate)


@functools.cache
def arm():
    """One arm seen: the model, the frame, and 20,000 exact draws as joints and lengths."""
    model = PoseModel()
    frame = prior_scene(model, 1, missing=ALL_BUT_AN_ARM)
    tree = inference.sample(model, frame, key=key(11), num_samples=20_000, root="candidates").tree
    return model, frame, tree["posterior"].joints.values[0], tree["posterior"].bone_length.values[0]


def exact_pair(number: int, reference: int, seed: int) -> tuple[Sample, Sample]:
    """Two disjoint lots of exact draws."""
    _, _, joints, length = arm()
    rows = np.random.default_rng(seed).permutation(len(joints))
    one, other = rows[:number], rows[number : number + reference]
    return sample_of(joints[None, one], length[None, one]), sample_of(
        joints[None, other], length[None, other]
    )


def reference() -> Sample:
    """The exact draws that the negative controls are judged by: the last 15,000."""
    _, _, joints, length = arm()
    return sample_of(joints[None, 5000:], length[None, 5000:])


@pytest.mark.slow
def test_tests_of_independent_draws_reject_at_their_level():
    """Energy, MMD, ranks of lengths and of joints, modes: 60 against 180 exact draws, 5 %."""
    rejected = dict.fromkeys(("energy", "mmd", "lengths", "joints", "modes"), 0)
    for repetition in range(REPETITIONS):
        one, other = exact_pair(60, 180, repetition)
        rng = np.random.default_rng(repetition)
        p = {
            name: found[1]
            for name, found in permutation_tests(one.flat, other.flat, rng, permutations=99).items()
        }
        p["lengths"] = all_together(one.flat[:, :5], other.flat[:, :5])[1]
        p["joints"] = all_together(one.flat[:, 5:14], other.flat[:, 5:14])[1]
        p["modes"] = same_shares(counts_by_mode(one.away[0][:, SEEN], other.away[0][:, SEEN]))[1]
        for name in rejected:
            rejected[name] += p[name] <= 0.05
    assert all(between(count, 0.05) for count in rejected.values()), rejected


@pytest.mark.sweep
def test_the_verdict_on_exact_draws_is_wrong_at_its_level():
    """200 whole judgements at 5 %; Holm is conservative, so only too many are a fault."""
    wrong = 0
    for repetition in range(REPETITIONS):
        one, other = exact_pair(400, 1200, 1000 + repetition)
        wrong += judge(one, other, seed=repetition, level=0.05, permutations=199).verdict == DIFFERS
    assert wrong <= binom.ppf(0.999, REPETITIONS, 0.05), wrong


def chains(rho: float, seed: int) -> np.ndarray:
    """`(4, 1000, 2)`: autoregressive chains of a standard normal law."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(4, 1000, 2)) * math.sqrt(1 - rho**2)
    noise[:, 0] = rng.normal(size=(4, 2))
    return lfilter([1.0], [1.0, -rho], noise, axis=1)


@pytest.mark.slow
def test_rank_tests_of_autocorrelated_chains_keep_their_size():
    """Autocorrelation 0.9: with the measured effective size 5 % (up to 10 %, for it is estimated);
    negative control: with the number of draws in its place more than half of the tests reject."""
    with_ess = without = 0
    for repetition in range(REPETITIONS):
        draws = chains(0.9, repetition)
        exact = np.random.default_rng(10_000 + repetition).normal(size=(8000, 2))
        with_ess += each_coordinate(draws, exact)[0][0, 0] < 0.05
        shuffled = (
            np.random.default_rng(repetition).permutation(draws.reshape(-1, 2)).reshape(draws.shape)
        )
        without += each_coordinate(shuffled, exact)[0][0, 0] < 0.05
    assert with_ess <= binom.ppf(0.9995, REPETITIONS, 0.1), with_ess
    assert without > REPETITIONS / 2, without


def test_a_permutation_test_counts_the_draws_themselves():
    """However far apart two samples are, no p-value is below one in as many orders as were
    tried, the given one among them."""
    rng = np.random.default_rng(0)
    found = permutation_tests(
        rng.normal(size=(40, 2)), rng.normal(size=(40, 2)) + 50, rng, permutations=19
    )
    assert {p_value for _, p_value in found.values()} == {1 / 20}


def test_rank_tests_know_that_the_exact_draws_are_few():
    """2,000 draws against 150 exact ones of the same normal law, 5 % in 100 repetitions (0.1 % that
    more than 13 reject); without 1/N some three quarters would."""
    alone = together = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        draws, exact = rng.normal(size=(4, 500, 2)), rng.normal(size=(150, 2))
        alone += each_coordinate(draws, exact)[0][0, 0] < 0.05
        together += all_together(draws.reshape(-1, 2), exact)[1] < 0.05
    assert max(alone, together) <= binom.ppf(0.9995, 100, 0.05), (alone, together)


@pytest.mark.parametrize("kind", [0, 1])
def test_nine_runs_of_ten_catch_what_a_verdict_says_that_it_would_have_seen(kind):
    """A normal coordinate shifted, or wider, by what is said, 150 times with 400 draws against
    3,000: nine in ten are caught, 0.1 % either way; of a change of two thirds of it far fewer."""
    rng, level, runs = np.random.default_rng(kind), 0.01, 150
    exact = rng.normal(size=(3000, 1))
    ess, counts = np.full((1, 2), 400.0), np.array([[200, 200], [1500, 1500]])
    found = seen(ess, 3000, counts, 0.5, 1, level)
    change = (found.shift, found.spread)[kind]

    def caught(change: float) -> int:
        draws = rng.normal(size=(runs, 400))
        draws = draws * (1 + change) if kind else draws + change
        p = (each_coordinate(one[None, :, None], rng.normal(size=exact.shape)) for one in draws)
        return sum(found[0][0, kind] < level / 2 for found in p)

    assert binom.ppf(0.0005, runs, POWER) <= caught(change) <= binom.ppf(0.9995, runs, POWER + 0.05)
    assert caught(change * 2 / 3) < 0.75 * runs


def test_nine_runs_of_ten_catch_what_modes_are_said_to_show():
    """Draws moved out of the commonest of four modes, and a mode that none has, 150 runs each: nine
    in ten are caught, of half the change far fewer."""
    rng, level, runs = np.random.default_rng(0), 0.002, 150
    share, number = np.array([0.4, 0.3, 0.2, 0.1]), 600
    counts = np.stack([number * share, 1e6 * share])
    found = seen(np.full((1, 2), 400.0), 3000, counts, share[0], 1, level)
    rest = share[1:] / share[1:].sum()

    def caught(drawn: np.ndarray, known: np.ndarray) -> int:
        counts = rng.multinomial(number, drawn, size=runs)
        return sum(same_shares(np.stack([one, 1e6 * known]))[1] < level for one in counts)

    moved = share + found.moved * np.array([-1, *rest])
    least, most = binom.ppf([0.0005, 0.9995], runs, [POWER - 0.02, POWER + 0.05])
    assert least <= caught(moved, share) <= most
    assert caught((share + moved) / 2, share) < 0.6 * runs
    missing = np.array([0, *rest]), np.array([found.missing, *(1 - found.missing) * rest])
    assert caught(*missing) >= least
    rarer = np.array([found.missing / 3, *(1 - found.missing / 3) * rest])
    assert caught(missing[0], rarer) < 0.6 * runs


def test_a_test_by_permutations_is_bounded_by_their_number() -> None:
    """By the rule of three where none was as extreme: never by what doubles can hold."""
    assert permuted(1 / 1000, 999) == "< 0.003"
    assert permuted(2 / 1000, 999) == "= 0.002"


def test_permutation_tests_do_not_know_whose_draws_are_whose():
    """Both sides are divided by the spread of both: whichever comes first, the statistic is the
    same, and so it is in any unit. (By the exact draws' spread alone the two would differ.)"""
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(60, 3)), rng.normal(size=(60, 3)) * 1.5
    there, back = (
        permutation_tests(*pair, np.random.default_rng(1), permutations=19)
        for pair in ((one, other), (7 * other, 7 * one))
    )
    assert there["energy"][0] == pytest.approx(back["energy"][0], rel=1e-5)


def test_modes_may_be_known_better_than_by_the_exact_draws_at_hand():
    """A mode that 2 % of a million draws have, and none of the 4,000 at hand, is not one that may
    not be: independent draws of the million's law are no fault, while against those at hand they
    are. What is told of is found by its code."""
    rng = np.random.default_rng(5)
    law = np.array([0.5, 0.48, 0.02, 0])
    own = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], bool)
    draws = own[rng.choice(4, 3000, p=law)]
    exact = own[rng.choice(2, 4000, p=[0.5, 0.5])]
    known = {code: 1e6 * share for code, share in enumerate(law[:3])}
    assert same_shares(counts_by_mode(draws, exact, known))[1] > 1e-3
    assert same_shares(counts_by_mode(draws, exact))[1] < 1e-6
    assert same_shares(counts_by_mode(exact, exact, known))[1] < 1e-6


def test_draws_that_are_not_independent_are_thinned_by_twice_their_time():
    """Every exact draw ten times over, in a row: an autocorrelation time of ten, and twice that
    leaves half as many as there are independent ones. The worst of forty estimates of the time
    decides, which is up to five times as large."""
    one, other = exact_pair(DRAWS, 15_000, 2)
    repeated = Sample(
        np.repeat(one.values, 10, axis=1).reshape(4, 5000, -1),
        np.repeat(one.away, 10, axis=1).reshape(4, 5000, -1),
    )
    found = judge(repeated, other, permutations=FEW)
    sizes = {test.size for test in found.tests if "thinned" in test.assumption}
    assert len(sizes) == 1
    assert DRAWS / 10 < sizes.pop() < DRAWS / 2
    assert found.verdict == AGREES, found.sentence


@pytest.mark.parametrize(("smallest", "verdict"), [(0.0015, DIFFERS), (0.0025, AGREES)])
def test_the_level_is_shared_by_all_tests(smallest, verdict):
    """Five tests at 1 %: the smallest p-value has to be below 0.2 %."""
    one, other = exact_pair(200, 400, 3)
    tests = [OneTest("a test", 0.0, p_value, 200, "") for p_value in (0.5, smallest, 0.3, 0.9, 0.2)]
    moved = mixing(one.values, other.flat.std(axis=0))
    found = modes(one.away[0], other.away[0], 200.0)
    assert _verdict(tests, moved, 200.0, found, 400, 0.01)[0] == verdict


@pytest.mark.parametrize(("rhat", "verdict"), [(1.09, AGREES), (3.44, UNMIXED), (np.nan, AGREES)])
def test_chains_that_are_apart_do_not_agree(rhat, verdict):
    one, other = exact_pair(200, 400, 3)
    moved = mixing(one.values, other.flat.std(axis=0))._replace(rhat=np.array([1.0, rhat]))
    found = modes(one.away[0], other.away[0], 200.0)
    said, sentence = _verdict([], moved, 200.0, found, 400, 0.01)
    assert said == verdict
    assert ("R-hat 3.44" in sentence) == (verdict == UNMIXED)


@pytest.mark.parametrize(
    ("number", "worst", "more"),
    [(1000, 50.0, "1,000"), (1000, 99.0, "11"), (12_345, 7.0, "170,000")],
)
def test_who_cannot_tell_is_told_how_many_draws_more(number, worst, more):
    """More draws of the same worth, rounded up to two digits, make a hundred effective ones."""
    one, other = exact_pair(200, 400, 3)
    moved = mixing(one.values, other.flat.std(axis=0))
    found = modes(one.away[0], other.away[0], 200.0)
    said, sentence = _verdict([], moved, worst, found, number, 0.01)
    assert said == CANNOT_TELL
    assert f"run some {more} more" in sentence
    assert (number + int(more.replace(",", ""))) * worst / number >= 100 - 1e-9


def test_the_worst_coordinate_is_corrected_for_their_number():
    """64 p-values of nothing: the test of the worst of them rejects at 5 % in 5 % of 400 cases (too
    many: 0.1 %); without the correction it would in 96 %."""
    rng = np.random.default_rng(0)
    ess = np.ones((32, 2))
    said = [_coordinates(rng.uniform(size=(32, 2)), ess, NAMES) for _ in range(400)]
    assert sum(test.p_value < 0.05 for test in said) <= binom.ppf(0.999, 400, 0.05)
    assert any(test.p_value < 0.05 for test in said)


def test_the_evidence_of_a_sampler_has_an_error_too():
    """Two evidences that err by 0.1 and 0.02 about the same: 5 % in 400 cases (0.1 %, both tails);
    with the exact one's error alone some 85 % would reject."""
    rng = np.random.default_rng(0)
    rejected = sum(
        _evidence((rng.normal(-4, 0.1), 0.1), (rng.normal(-4, 0.02), 0.02)).p_value < 0.05
        for _ in range(400)
    )
    assert binom.ppf(0.0005, 400, 0.05) <= rejected <= binom.ppf(0.9995, 400, 0.05)


def test_independent_draws_miss_what_they_are_expected_to():
    """300 times 50 draws of eight modes, half of them rare: what they miss is on average what is
    expected (4 standard errors)."""
    rng = np.random.default_rng(4)
    shares = np.array([0.5, 0.4, 0.04, 0.02, 0.01, 0.01, 0.01, 0.01])
    patterns = (np.arange(8)[:, None] >> np.arange(3)) % 2 > 0
    exact = patterns[rng.choice(8, 20_000, p=shares)]
    found = [modes(patterns[rng.choice(8, 50, p=shares)], exact, 50.0) for _ in range(300)]
    missed = np.array([one.missed for one in found])
    expected = found[0].expected_missed
    assert expected > 0.02
    assert abs(missed.mean() - expected) < 4 * missed.std() / math.sqrt(len(missed))


def test_what_was_missed_stands_beside_what_must_be():
    one, other = exact_pair(500, 15_000, 4)
    found = judge(one, other, permutations=FEW)
    assert found.modes.missed > 0
    assert f"{found.modes.missed:.1%} of the mass in modes never visited" in found.sentence
    assert f"would miss {found.modes.expected_missed:.1%}" in found.sentence


def test_exact_draws_agree():
    one, other = exact_pair(DRAWS, 15_000, 1)
    found = judge(one, other, permutations=FEW)
    assert found.verdict == AGREES, found.sentence
    assert {test.name.split(",")[0].split(" of ")[0] for test in found.tests} >= {
        "energy",
        "mmd",
        "ranks",
        "modes",
    }
    assert all(test.assumption and test.size > 0 for test in found.tests)


def test_a_sampler_that_never_leaves_one_flip_is_caught():
    _, _, joints, length = arm()
    everything = sample_of(joints[None], length[None])
    first_two = codes(everything.away[0][:, SEEN])
    assert len(np.unique(first_two)) > 1
    rows = np.flatnonzero(first_two == np.bincount(first_two).argmax())[:DRAWS]
    found = judge(sample_of(joints[None, rows], length[None, rows]), reference(), permutations=FEW)
    assert found.verdict == DIFFERS


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_lengths_five_percent_too_narrow_are_caught(seed):
    model, frame, joints, length = arm()
    rows = slice(DRAWS * seed // 2, DRAWS * seed // 2 + DRAWS)
    poses = model.pose_of(joints[rows], length[rows])
    narrow = length.mean(axis=0) + 0.95 * (length[rows] - length.mean(axis=0))
    view = frame.observation.view
    moved = np.asarray(model.joints(view, narrow, poses.upper, poses.lower))
    found = judge(sample_of(moved[None], narrow[None]), reference(), permutations=FEW)
    assert found.verdict == DIFFERS, found.sentence


@functools.cache
def low_target() -> tuple[Target, np.ndarray]:
    """The arm's posterior and exact starting points in it."""
    model, frame, joints, length = arm()
    target = Target.of(frame.posterior(model, CANDIDATES))
    return target, target.points_of(model.pose_of(joints[:5000], length[:5000]))


def evenly(points: np.ndarray) -> np.ndarray:
    """2,000 of the draws `(chain, draw, d)`."""
    every = max(1, points.shape[0] * points.shape[1] // DRAWS)
    return points[:, ::every][:, : DRAWS // points.shape[0]]


def judged(walk: Walk, rounds: int):
    """Runs a walk for some rounds and judges 2,000 of its draws, evenly taken."""
    target, _ = low_target()
    for _ in range(rounds):
        walk.more()
    few = evenly(walk.drawn(key(0)).points)
    poses = target.poses(key(1), few)
    joints = target.model.joints(target.observation.view, *poses)
    return judge(
        sample_of(np.asarray(joints), np.asarray(poses.length)), reference(), permutations=FEW
    )


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_autocorrelation_times_against_their_closed_form(rho):
    """(1 + ρ)/(1 - ρ) of an autoregressive chain, four standard errors wide (Sokal 1997, √(2 (2·5 +
    1)/n) · τ^1.5)."""
    draws = np.concatenate([chains(rho, seed) for seed in range(8)])
    times, closed = autocorrelation_times(draws)
    truth = (1 + rho) / (1 - rho)
    error = truth * math.sqrt(2 * 11 * truth / draws[..., 0].size)
    assert closed.all()
    np.testing.assert_allclose(times, truth, atol=4 * error)


def test_short_paths_bound_slow_times_by_their_slope():
    """256 walkers, 70 steps, an autocorrelation time of 19,999: it is bounded at some 0.6 of that;
    without the slope a path could not tell it from its own length."""
    rho = 0.9999
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(256, 70, 40)) * math.sqrt(1 - rho**2)
    noise[:, 0] = rng.normal(size=(256, 40))
    times, closed = autocorrelation_times(lfilter([1.0], [1.0, -rho], noise, axis=1))
    truth = (1 + rho) / (1 - rho)
    assert not closed.any()
    assert 0.3 * truth < np.median(times) < truth
    assert times.max() < 2 * truth


def test_walkers_that_stay_earn_nothing():
    """Every start an exact draw, and hardly a step away from it: ArviZ sees as many effective draws
    as walkers."""
    one, other = exact_pair(128, 5000, 7)
    steps = 40
    still = np.repeat(one.values.reshape(4, 32, 1, -1), steps, axis=2)
    still = still + 1e-6 * np.random.default_rng(0).normal(size=still.shape)
    still = Sample(
        still.reshape(4, 32 * steps, -1), np.repeat(one.away.reshape(4, 32, -1), steps, axis=1)
    )
    effective = mixing(still.values, other.flat.std(axis=0)).worst
    assert 16 < effective < 256
    found = pace(still, other, effective=effective, given=128, steps=steps)
    assert found.earned < 64
    assert not found.known
    assert found.settled < 256  # at most that, it says
    moving = pace(other, other, effective=5000.0, given=0, steps=5000)
    assert moving.known
    assert moving.settled > 3000


def switching(walkers: int, steps: int, rate: float, seed: int) -> np.ndarray:
    """`(walkers, steps)` bool: chains that cross either way at this rate, started in balance."""
    rng = np.random.default_rng(seed)
    crossed = rng.uniform(size=(walkers, steps)) < rate
    crossed[:, 0] = rng.uniform(size=walkers) < 0.5
    return np.cumsum(crossed, axis=1) % 2 > 0


def test_a_flip_that_nobody_crossed_is_bounded_by_the_rule_of_three():
    """128 walkers × 40 steps that cross once in 10,000 steps: the draws are worth 0.51, and what is
    said is a bound of that, not 7.8e-14, which divides by rounding error. In 200 runs, those where
    somebody crosses among them, it is below the truth hardly ever (5 %, false alarm 1e-4)."""
    exact = np.random.default_rng(0).uniform(size=(1, 10_000, 1)) < 0.5
    rate, wrong, silent = 3e-4, 0, 0  # about 1.5 crossings in 128 walkers × 39 steps
    for seed in range(200):
        (bound,) = uncrossed(switching(128, 40, rate, seed)[..., None], exact, 40)
        wrong += bound > 1 / rate
        silent += bound > 0
    assert silent > 20
    assert wrong <= binom.ppf(0.9999, 200, 0.05)
    all_in_one = np.zeros((4, 40 * 32, 1), bool)
    assert uncrossed(all_in_one, exact, 40)[0] == pytest.approx(2 * 128 * 39 / 2 / 3, rel=0.05)
    one, other = exact_pair(128 * 40, 10_000, 9)
    away = np.array(one.away.reshape(128, 40, -1))
    away[..., SEEN[0]] = switching(128, 40, 0.0, 0)
    still = Sample(one.values.reshape(4, -1, one.values.shape[-1]), away.reshape(4, 32 * 40, -1))
    found = pace(still, other, effective=100.0, given=0, steps=40)
    assert 0.51 < found.settled < 10
    assert not found.known


@pytest.fixture(scope="module")
def clouds() -> tuple[Sample, Sample]:
    """Sixteen walkers that draw at random from clouds of forty exact draws of their own, and exact
    draws."""
    one, other = exact_pair(640, 5000, 12)
    rows = np.random.default_rng(0).integers(40, size=(16, 5000)) + 40 * np.arange(16)[:, None]
    return Sample(one.flat[rows], one.away.reshape(640, -1)[rows]), other


def test_walkers_apart_for_good_are_worth_what_tells_them_apart(clouds):
    """Hardly any autocorrelation, and 16 × 40 draws in all, whatever the number of steps."""
    drawn, other = clouds
    effective = mixing(drawn.values, other.flat.std(axis=0)).worst
    assert effective < 2000
    found = pace(drawn, other, effective=effective, given=0, steps=5000)
    assert drawn.num_draws / found.time > 10_000  # what the paths promise
    assert found.settled == effective
    assert not found.known


@pytest.mark.slow
def test_chains_that_scatter_are_worth_what_they_agree_on(clouds):
    """640: less than four times as much in every one of 32 coordinates (a scatter of 15 degrees of
    freedom is too small by that in 1 of 640); ArviZ alone says 54,000 for one: the negative
    control. Independent draws in as many chains keep half of their number at least."""
    drawn, other = clouds
    found = scores(drawn.values, other.flat)[..., 0]
    varies = [series for series in np.moveaxis(found, -1, 0) if np.ptp(series)]
    said = [float(array_stats.ess(one, chain_axis=0, draw_axis=1, method="mean")) for one in varies]
    assert max(said) > 40 * 640
    assert max(mean_ess(one) for one in varies) < 4 * 640
    assert mean_ess(np.random.default_rng(1).normal(size=(16, 500))) > 4000


def of_normal(kernel) -> Judgement:
    """Judges 2,000 draws of NumPyro's ensemble on a standard normal law of 32 coordinates, started
    in it."""
    rng = np.random.default_rng(0)
    stepper = NumPyroKernel(kernel, 64, 0, lambda before, after: jnp.asarray(64))
    walk = Walk(stepper, key(3), rng.normal(size=(256, 32)), runs=4, ensemble=True, steps=32)
    for _ in range(64):
        walk.more()
    few = evenly(walk.drawn(key(0)).points)
    exact = rng.normal(size=(1, 15_000, 32))
    return judge(Sample(few, few[..., :8] > 0), Sample(exact, exact[..., :8] > 0), permutations=FEW)


def normal_potential(x):
    return 0.5 * jnp.sum(x**2)


@pytest.mark.slow
def test_the_half_updated_ensemble_of_numpyro_up_to_0_21_is_caught_and_the_mended_one_is_not():
    """Differential moves, its default: variance 0.71 instead of 1."""
    assert of_normal(HalfUpdatedAIES(potential_fn=normal_potential)).verdict == DIFFERS
    assert of_normal(AIES(potential_fn=normal_potential)).verdict != DIFFERS


@pytest.mark.slow
def test_the_half_updated_slice_sampler_is_caught_too():
    assert (
        of_normal(HalfUpdatedESS(potential_fn=normal_potential, randomize_split=False)).verdict
        == DIFFERS
    )
    assert of_normal(ESS(potential_fn=normal_potential, randomize_split=False)).verdict != DIFFERS


@pytest.mark.slow
def test_emcee_started_in_one_point_is_caught():
    target, starts = low_target()
    import emcee

    kernel = EmceeKernel(target, emcee.moves.StretchMove())
    walk = Walk(kernel, key(3), np.repeat(starts[:1], 256, axis=0), runs=4, ensemble=True, steps=32)
    found = judged(walk, 2)
    assert found.verdict == DIFFERS
    assert "did not move" in found.sentence


def test_stuck_chains_are_not_believed():
    """ArviZ alone would say ESS = N and R-hat = 1 of copies of one chain or of constant ones."""
    rng = np.random.default_rng(0)
    assert mixing(np.repeat(rng.normal(size=(4, 1, 3)), 500, axis=1), np.ones(3)).stuck
    alive = rng.normal(size=(4, 500, 3))
    assert not mixing(alive, np.ones(3)).stuck
    alive[2, :, 1] = 1e-12 * alive[2, :, 1]
    assert mixing(alive, np.ones(3)).stuck
    assert not mixing(alive, np.array([1.0, 0.0, 1.0])).stuck  # a coordinate that may stand still


def test_few_effective_draws_cannot_tell():
    one, other = exact_pair(60, 5000, 4)
    found = judge(one, other, permutations=FEW)
    assert found.verdict == CANNOT_TELL
    assert "effective draws" in found.sentence


@pytest.mark.slow
def test_evidence_is_judged_by_its_stated_error():
    one, other = exact_pair(DRAWS, 15_000, 5)
    good = judge(one, other, evidence=(-4.2, 0.1), exact_evidence=(-4.1, 0.01), permutations=FEW)
    bad = judge(one, other, evidence=(-4.2, 0.01), exact_evidence=(-4.1, 0.01), permutations=FEW)
    assert good.verdict == bad.verdict == AGREES  # of draws
    assert good.evidence is not None
    assert bad.evidence is not None
    assert bad.evidence.p_value < 0.01 < good.evidence.p_value
    for known in ((math.nan, 0.1), (-4.2, math.nan)):
        unknown = judge(one, other, evidence=known, exact_evidence=(-4.1, 0.01), permutations=FEW)
        assert unknown.evidence is None


def test_distances_against_closed_forms():
    """W1 of a shifted and of a stretched normal law; energy and MMD by their double sums; sliced W1
    of a shift."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(200_000, 1))
    assert wasserstein(x, x + 0.3)[0] == pytest.approx(0.3)
    assert wasserstein(x, 2 * x)[0] == pytest.approx(math.sqrt(2 / math.pi), rel=0.01)
    one, other = rng.normal(size=(40, 3)), rng.normal(size=(30, 3)) + 0.5
    distance = pairwise(one, other)
    labels = (np.arange(70) < 40)[None]
    by_hand = 2 * np.linalg.norm(one[:, None] - other, axis=-1).mean()
    by_hand -= (
        np.linalg.norm(one[:, None] - one, axis=-1).mean()
        + np.linalg.norm(other[:, None] - other, axis=-1).mean()
    )
    assert energy(distance, labels)[0] == pytest.approx(by_hand, rel=1e-4)
    kernel = np.exp(-0.5 * (distance / np.median(distance[distance > 0])) ** 2)
    squared = kernel[:40, :40].mean() + kernel[40:, 40:].mean() - 2 * kernel[:40, 40:].mean()
    assert mmd(distance, labels)[0] == pytest.approx(squared, rel=1e-3)
    # Along a random direction in one dimension a shift of one standard deviation is one standard
    # deviation.
    assert sliced_wasserstein(x[:50_000] + 1.0, x[50_000:]) == pytest.approx(1.0, abs=0.03)


def test_c2st_sees_what_is_plain_and_nothing_where_there_is_nothing():
    rng = np.random.default_rng(2)
    x, y = rng.normal(size=(1000, 2)), rng.normal(size=(1000, 2))
    assert classifier_test(x, y, rng)[1] > 1e-3
    assert classifier_test(x, y + 1, rng)[1] < 1e-6


def test_modes_count_what_was_missed():
    rng = np.random.default_rng(3)
    exact = rng.uniform(size=(4000, 2)) < np.array([0.5, 0.1])
    never = exact[~exact[:, 1]]
    found = modes(never, exact, 1000.0)
    assert found.missed == pytest.approx(exact[:, 1].mean(), abs=1e-12)
    assert found.expected_missed < 1e-6
    assert same_shares(counts_by_mode(never[:500], exact))[1] < 1e-6
    assert same_shares(counts_by_mode(exact[:500], exact[500:]))[1] > 1e-3


def test_rare_modes_are_put_together():
    """Of 100 draws against 900, a mode of which fewer than five are expected on either side is
    none of its own: those of 4.9, 1 and 0.1 in a hundred are one."""
    shares = np.array([0.5, 0.44, 0.049, 0.01, 0.001])
    own = np.array([[place >> bit & 1 for bit in range(3)] for place in range(5)], bool)
    few, many = (np.repeat(own, np.round(number * shares).astype(int), 0) for number in (100, 900))
    counts = counts_by_mode(few, many)
    np.testing.assert_array_equal(counts, [[50, 44, 6], [450, 396, 54]])


def test_chains_apart_are_worth_what_their_means_say():
    """Sixteen chains of 500 independent normal draws, each about a place of its own, a tenth of a
    standard deviation from the others: their mean is known as from a thousand, where ArviZ, which
    sees no autocorrelation, says 7,300."""
    rng = np.random.default_rng(0)
    series = rng.normal(size=(16, 500)) + 0.1 * rng.normal(size=(16, 1))
    expected = series.var() / (series.mean(axis=1).var(ddof=1) / 16)
    assert mean_ess(series) == pytest.approx(expected)
    assert expected < 1500
    assert mean_ess(rng.normal(size=(16, 500))) > 5000


def test_draws_that_are_not_finite_or_none_are_refused():
    _, _, joints, length = arm()
    broken = joints[None, :10].copy()
    broken[0, 3, 4, 2] = np.nan
    with pytest.raises(BadInput, match="not finite in 1 of 10"):
        sample_of(broken, length[None, :10])
    with pytest.raises(BadInput, match="are none"):
        sample_of(joints[None, :0], length[None, :0])


@pytest.mark.slow
def test_the_tree_of_a_comparison_holds_every_sampler(tmp_path):
    one, other = exact_pair(DRAWS, 5000, 6)
    verdict = judge(one, other, permutations=FEW)
    way = course(one, other, 2.0, 0.5)
    assert way.seconds[-1] == pytest.approx(2.0)
    assert way.seconds_to(1e9) == way.seconds[0]
    assert way.seconds_to(0.0) == math.inf
    speed = pace(one, other, effective=verdict.mixing.worst, given=100, steps=DRAWS)
    entries = [
        Entry(
            "rejection", "", verdict, "fine", DRAWS, 100, 2.0, way, speed, -4.0, 0.1, one.flat[:50]
        ),
        Entry("nuts", "one flip", None, "no draws", 0, 10, 1.0, None, None, math.nan, math.nan),
    ]
    tree = comparison_tree(entries, other, {"source": "a scene"})
    assert list(tree["summary"].sampler.values) == ["rejection", "nuts (one flip)"]
    assert (
        tree["tests"].p_value.sel(sampler="rejection", test="energy").item()
        == verdict.tests[0].p_value
    )
    assert np.isnan(tree["tests"].p_value.sel(sampler="nuts (one flip)")).all()
    assert tree["modes"].exact_share.sum().item() == pytest.approx(1.0)
    assert tree["coordinates"].sizes["coordinate"] == len(NAMES)
    tree.to_netcdf(tmp_path / "comparison.nc")


def test_a_sampler_of_torso_and_camera_may_bring_no_draw():
    joints = np.zeros((1, 10, 15, 3))
    exact = Sample(np.zeros((1, 10, len(NAMES))), np.zeros((1, 10, 8), bool))
    rooted = exact.with_roots(joints, np.ones((1, 10)), joints[:, :, 0, :2])
    none = Entry.without_draws("random-walk", "", "the budget was too small", (10, 1.0))
    tree = comparison_tree([none], rooted, {})
    assert np.isnan(tree["draws"].value).all()
    assert tree["draws"].sizes["coordinate"] == len(rooted.names)


def test_a_tree_without_poses_is_refused():
    import xarray as xr

    with pytest.raises(BadInput, match="lack"):
        read_sample(xr.DataTree.from_dict({"posterior": xr.Dataset()}))
