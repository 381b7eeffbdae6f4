"""Calibration: the test of uniformity against simulation, levels on a toy posterior in closed form,
verdicts, controls.

False-alarm rates stand beside every statistical test; each has a control that must fail.
"""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
import xarray as xr
from arviz_stats.base import array_stats
from scipy import stats

from poseterior.inference.draws import COMPLETE
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.machines import Machines
from poseterior.inference.results import log_density, save_tree
from poseterior.inference.studies.calibration import (
    assess,
    band,
    calibrate,
    judge,
    simulate,
    uniformity,
)
from poseterior.inference.studies.calibration.assess import FAILED, Answer, check_draws
from poseterior.inference.studies.calibration.controls import (
    DISTORTIONS,
    distorted,
    following_the_recipe,
    ignoring,
)
from poseterior.inference.studies.calibration.posteriors import (
    FromFile,
    independent,
    sampler_of,
)
from poseterior.inference.studies.calibration.quantities import (
    HINGES,
    MISFIT,
    OF_POSE,
    QUANTITIES,
    TARP,
    of_both,
    of_pose,
)
from poseterior.inference.studies.calibration.simulations import HIDDEN, Instance
from poseterior.inference.studies.calibration.toy import Toy, sizes
from poseterior.inference.studies.calibration.uniformity import ECDF_LEVELS, difference
from poseterior.inference.studies.calibration.verdict import (
    CALIBRATED,
    CANNOT_TELL,
    MISCALIBRATED,
    holm,
)
from poseterior.inference.studies.levels import (
    energy_level,
    median_levels,
    rank_level,
    stand_in_levels,
)
from poseterior.probmodel import BadInput, Likelihood, PoseModel
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import JOINT_INDEX

RNG = np.random.default_rng


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


# --- uniformity


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 20, 300])
def test_p_values_are_what_simulation_says(size: int) -> None:
    """The law of the statistic by its Markov chain against 1,000 simulated samples; five standard
    errors, so a false alarm in 2 million for each of 9 comparisons."""
    p_values = np.array(
        [uniformity(values).p_value for values in RNG(size).uniform(size=(1000, size))]
    )
    for level in (0.05, 0.2, 0.5):
        share = np.mean(p_values <= level)
        assert share <= level + 5 * np.sqrt(level * (1 - level) / 1000)
        if (
            size >= 100
        ):  # small samples have few values of the statistic, and the test keeps below its level
            assert share >= level - 0.03 - 5 * np.sqrt(level * (1 - level) / 1000)


def test_the_band_and_the_test_say_the_same() -> None:
    low, high = band(200, 0.95)
    left = []
    for values in RNG(0).uniform(size=(600, 200)):
        share = difference(values) + ECDF_LEVELS
        inside = (share >= low - 1e-12).all() and (share <= high + 1e-12).all()
        assert inside == (uniformity(values).p_value > 0.05)
        left.append(not inside)
    assert abs(np.mean(left) - 0.05) < 0.045  # five standard errors


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("narrow", stats.beta(1.5, 1.5)),
        ("wide", stats.beta(0.7, 0.7)),
        ("shifted", stats.beta(1.3, 1.0)),
        ("always covered", stats.uniform(0, 0.9)),
    ],
)
def test_what_is_not_uniform_is_rejected(name: str, law: object) -> None:
    found = uniformity(law.rvs(1000, random_state=RNG(1)))  # type: ignore[attr-defined]
    assert found.p_value < 1e-4, (name, found)
    assert found.size == 1000


@pytest.mark.parametrize("shape", [1.0, 1.3, 0.75])
def test_arviz_decides_alike(shape: float) -> None:
    """Another library's test of the same, on right, narrow and wide values (from its version 1.3.3
    on: earlier ones scale by the range of the values, and take 0.9 times uniform ones for
    uniform)."""
    values = RNG(3).beta(shape, shape, size=(100, 300))
    ours = np.array([uniformity(one).p_value for one in values])
    theirs = np.array([float(array_stats.uniformity_test(one)[0]) for one in values])
    assert np.mean((ours < 0.05) == (theirs < 0.05)) >= 0.85
    assert stats.spearmanr(ours, theirs).statistic > 0.8
    assert float(array_stats.uniformity_test(0.9 * RNG(4).uniform(size=300))[0]) < 1e-3


def test_extreme_values_have_tiny_p_values() -> None:
    assert uniformity(np.zeros(1000)).p_value < 1e-100
    assert 0 < uniformity(np.full(20, 0.5)).p_value < 1e-4


@pytest.mark.parametrize("values", [[], [0.5, np.nan], [1.5]])
def test_what_cannot_be_levels_is_refused(values: list) -> None:
    with pytest.raises(ValueError, match="0 to 1"):
        uniformity(np.array(values))


# --- levels on a toy


@pytest.mark.slow
def test_every_test_has_its_size_on_a_posterior_in_closed_form() -> None:
    """200 repetitions at level 0.05: at most 20 rejections (binomial, false alarm 0.002 for each of
    four tests)."""
    for name, p_values in sizes(200, 60, 30).items():
        rejected = int(np.sum(p_values < 0.05))
        assert rejected <= 20, (name, rejected)
        assert np.sum(p_values < 0.5) >= 60, (
            name,
            "the test is far too timid",
        )  # false alarm below 1e-7


WRONG = {
    "narrower": (
        lambda toy: toy.mean[:, None] + 0.8 * (toy.draws - toy.mean[:, None]),
        {"ranks", "energy balls", "TARP"},
    ),
    "ignores what was seen": (lambda toy: toy.prior_draws, {"TARP"}),
    "uncorrelated": (
        lambda toy: np.stack(
            [toy.draws[:, RNG(axis).permutation(toy.draws.shape[1]), axis] for axis in range(3)], 2
        ),
        {"highest density"},
    ),
}
"""Spoilt toys, and the tests that have to reject them."""


@pytest.mark.parametrize("name", WRONG)
def test_wrong_toys_are_rejected(name: str) -> None:
    rng = RNG(3)
    toy = Toy(600, 60, rng)
    spoil, blamed = WRONG[name]
    found = toy.p_values(spoil(toy), rng)
    for test in blamed:
        assert found[test] < 1e-3, found
    if name == "ignores what was seen":
        assert found["ranks"] > 1e-3, (
            "the prior passes ranks of the parameters: that is why TARP is there"
        )


def test_ties_are_broken_evenly() -> None:
    """Coins: the level of a discrete quantity is uniform (n = 1,000; false alarm 0.001)."""
    rng = RNG(4)
    levels = [
        float(rank_level(rng.integers(2), rng.integers(2, size=50), rng)) for _ in range(1000)
    ]
    assert uniformity(np.array(levels)).p_value > 0.001
    untied = [np.mean(rng.integers(2, size=50) < rng.integers(2)) for _ in range(1000)]
    assert uniformity(np.array(untied)).p_value < 1e-10


def test_ranks_of_what_is_outside() -> None:
    draws = np.array([[-np.inf], [-np.inf], [0.0]])
    assert rank_level(np.array([1.0]), draws, RNG(0))[0] >= 0.75
    assert rank_level(np.array([np.nan]), draws, RNG(0))[0] <= 0.75
    with pytest.raises(ValueError, match="cannot rank"):
        rank_level(np.zeros(3), np.zeros((5, 2)), RNG(0))


def test_energy_balls_rank_draws_that_they_are_not_made_of() -> None:
    """Truth and twelve draws of one law, 1,000 times: levels are uniform (false alarm 0.001). Draws
    that are centres lie nearer to themselves, and would push the truth outwards."""
    rng = RNG(5)
    levels = [energy_level(rng.normal(size=2), rng.normal(size=(12, 2)), rng) for _ in range(1000)]
    assert uniformity(np.array(levels)).p_value > 0.001


def test_median_levels_by_hand() -> None:
    draws = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])[:, None, None]
    assert median_levels(np.array([[0.5]]), draws) == pytest.approx(0.2)
    assert median_levels(np.array([[1.5]]), draws) == pytest.approx(0.6)
    assert median_levels(np.array([[9.0]]), draws) == pytest.approx(1.0)
    np.testing.assert_allclose(stand_in_levels(draws, np.array([2, 0])).ravel(), [0.0, 0.75])


# --- verdicts


def test_a_truth_that_errs_is_ranked_among_draws_that_err(model: PoseModel) -> None:
    """Sixty truths from the draws' own law, told with errors twice as large: levels are uniform
    where the errors' size is told too (Kolmogorov–Smirnov, 1e-3 for all), and not where it is
    kept."""
    one = simulate(model, 0, 0, 1)[0]
    rng = np.random.default_rng(2)
    doubt = np.zeros((15, 15, 3, 3))
    doubt[range(1, 15), range(1, 15)] = 0.04 * np.eye(3)

    def levels(told: np.ndarray | None) -> np.ndarray:
        found = []
        for _ in range(60):
            both = one.joints + 0.1 * rng.normal(size=(101, 15, 3))
            errors = 0.2 * rng.normal(size=(15, 3))
            both[:, 0] = errors[0] = 0.0
            instance = Instance(one.frame, both[0] + errors, told)
            standing = assess(instance, Answer(both[1:]), rng)
            found.append(np.concatenate([standing.whole, standing.lateral, standing.depth]))
            assert standing.spread_depth == pytest.approx(0.1, rel=0.4)  # the draws' own
        return np.transpose(found)

    right, wrong = levels(doubt), levels(None)
    for level in right:
        assert stats.kstest(level, "uniform").pvalue > 1e-3 / len(right)
    for level in wrong:
        assert stats.kstest(level, "uniform").pvalue < 1e-3


def test_holm() -> None:
    np.testing.assert_allclose(holm(np.array([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    assert holm(np.array([0.9, 0.8])).max() == 1.0


def table(levels: np.ndarray) -> xr.Dataset:
    blank = np.full((len(levels), len(QUANTITIES)), np.nan)
    blank[:, : levels.shape[1]] = levels
    return xr.Dataset(
        {"level": (("simulation", "quantity"), blank)}, coords={"quantity": list(QUANTITIES)}
    )


def test_verdicts() -> None:
    """A right sampler is called calibrated in 100 of 100 tables, of which one may fail (false alarm
    0.26 for two)."""
    assert (
        sum(judge(table(RNG(n).uniform(size=(150, 5)))).verdict != CALIBRATED for n in range(100))
        <= 4
    )
    narrow = RNG(0).beta(2, 2, size=(150, 5))
    found = judge(table(narrow))
    assert found.verdict == MISCALIBRATED
    assert "with 150 simulations" in found.sentence
    assert found.tests.attrs["multiplicity"] == "Holm"
    lost = RNG(1).uniform(size=(150, 5))
    lost[:10] = np.nan
    found = judge(table(lost))
    assert found.verdict == CANNOT_TELL
    assert "failed on 10 of 150" in found.sentence


def test_failed_simulations_come_before_miscalibration() -> None:
    """A sampler that fails where the truth is large looks miscalibrated on the rest, which proves
    nothing; one that is wrong whatever the failed ones would have said is."""
    right = RNG(2).uniform(size=(400, 5))
    selective = np.where(right > 0.85, np.nan, right)
    selective[:, 1:] = np.where(np.isnan(selective[:, :1]), np.nan, right[:, 1:])
    found = judge(table(selective))
    assert float(found.tests.adjusted.min()) < 1e-3
    assert found.verdict == CANNOT_TELL, found.sentence
    assert "of 400 simulations; that alone may be why" in found.sentence
    wrong = RNG(3).beta(3, 3, size=(400, 5))
    wrong[:20] = np.nan
    found = judge(table(wrong))
    assert found.verdict == MISCALIBRATED
    assert "failed on 20 of 400 simulations, whatever these would have said" in found.sentence


@pytest.mark.parametrize("lost", [1, 10])
def test_no_value_that_was_lost_leads_to_a_larger_p_value(lost: int) -> None:
    """Whatever is put in for what was lost: ends, middle, evenly."""
    values = RNG(lost).beta(1.5, 1.5, size=200)
    bound = uniformity(values, lost).p_value
    assert bound > uniformity(values).p_value
    for more in (np.zeros(lost), np.ones(lost), np.linspace(0, 1, lost), np.repeat([0, 1], lost)):
        assert uniformity(np.append(values, more[:lost])).p_value <= bound


def test_too_few_simulations_are_refused() -> None:
    with pytest.raises(BadInput, match="99 simulations; the tests need at least 100"):
        judge(table(RNG(0).uniform(size=(99, 5))))
    lost = np.full((110, 5), np.nan)
    with pytest.raises(BadInput, match="110 simulations, 110 of them failed; the tests need"):
        judge(table(lost))


def test_what_is_left_of_a_hundred_simulations_is_judged() -> None:
    """One of them failed: 99 are said to be calibrated, and narrow ones to be none."""
    levels = RNG(0).uniform(size=(100, 5))
    levels[7] = np.nan
    found = judge(table(levels))
    assert found.verdict == CALIBRATED
    assert "99 simulations; the sampler failed on 1 of 100 simulations" in found.sentence
    assert judge(table(levels**3)).verdict == MISCALIBRATED


# --- poses


@pytest.mark.slow
def test_quantities_of_draws_are_the_samplers_own(model: PoseModel) -> None:
    """Log density by way of the joints against the sampler's, lengths and depth against its
    columns."""
    for instance in simulate(model, 3, 0, 4):
        posterior = instance.frame.posterior(model, CANDIDATES)
        draws = ExactRejection().draw(posterior, jax.random.key(1), 300)
        *_, density, misfit = of_both(model, instance.frame.observation, draws.joints).T
        np.testing.assert_allclose(density, log_density(draws), atol=1e-6)
        assert (misfit <= 1).all()
        values = of_pose(draws.joints)
        np.testing.assert_allclose(values[:, 27:32], draws.bone_length, atol=1e-12)
        elbow = JOINT_INDEX["left_elbow"]
        np.testing.assert_allclose(
            values[:, OF_POSE.index("left_elbow z")], draws.joints[:, elbow, 2]
        )


def test_simulations_are_draws_of_the_model(model: PoseModel) -> None:
    """The truth is possible, explains its detection, and does not depend on the block that it is
    made in."""
    some = simulate(model, 0, 0, 24)
    for number, instance in enumerate(some):
        *_, density, misfit = of_both(model, instance.frame.observation, instance.joints[None])[0]
        assert np.isfinite(density)
        assert misfit <= 1
        missing = {JOINT_INDEX[name] for name in HIDDEN[number % len(HIDDEN)]}
        assert set(np.flatnonzero(~instance.frame.detection.seen)) == missing
    again = simulate(model, 0, 20, 4)
    np.testing.assert_array_equal(again[1].joints, some[21].joints)
    np.testing.assert_array_equal(
        again[1].frame.detection.keypoints, some[21].frame.detection.keypoints
    )
    assert not np.array_equal(simulate(model, 1, 21, 1)[0].joints, some[21].joints)


def test_detections_fill_their_discs(model: PoseModel) -> None:
    """(d/τ)² is uniform (n = some 1,900 joints; false alarm 0.001)."""
    squares = []
    for instance in simulate(model, 5, 0, 250):
        observation = instance.frame.observation
        seen = np.asarray(observation.seen)
        camera, detection = observation.root.camera, instance.frame.detection
        far = np.asarray(camera.image(instance.joints)) - detection.keypoints
        radius = observation.reach * camera.scale
        squares += list((np.sum(far**2, axis=1) / radius**2)[seen])
    assert uniformity(np.array(squares)).p_value > 0.001


@pytest.mark.slow
def test_exact_draws_are_calibrated(model: PoseModel) -> None:
    """120 simulations here, 1,000 in every measure in the report (false alarm 0.01 over 44
    tests, and 0.01 over those of joint angles, lengths and steps)."""
    tree = calibrate(model, "rejection", num_simulations=120, num_samples=100, root="candidates")
    found = judge(tree["simulation"].to_dataset())
    assert found.verdict == CALIBRATED, found.sentence
    assert set(found.families) == {"ranks (SBC)", "highest density", "energy balls", "TARP"}
    measured = judge(tree["simulation"].to_dataset(), of="measures")
    assert measured.verdict == CALIBRATED, measured.sentence
    assert set(measured.families) == {"ranks (SBC)"}
    assert "right_hip_rotation" in measured.tests.quantity
    assert "trunk_inclination" not in measured.tests.quantity  # given with the torso
    assert tree["prior_sbc"].joints.dims == ("chain", "draw", "joint", "axis")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("upper", "lower"), [("angle", "area"), ("area", "area"), ("angle", "box")]
)
def test_every_measure_is_calibrated(upper: str, lower: str) -> None:
    """Another seed than the report's; false alarm 0.01 for each measure."""
    tree = calibrate(
        PoseModel(upper=upper, lower=lower),
        "rejection",
        seed=11,
        num_simulations=200,
        num_samples=100,
        root="candidates",
    )
    found = judge(tree["simulation"].to_dataset())
    assert found.verdict == CALIBRATED, found.sentence


@pytest.mark.slow
def test_another_measure_is_noticed(model: PoseModel) -> None:
    """Draws under the box measure are judged under the default: a wrong prior, the negative
    control."""
    wrong = sampler_of("rejection", PoseModel(lower="box"), 100, root="candidates")
    tree = calibrate(model, wrong, num_simulations=150, root="candidates")
    assert judge(tree["simulation"].to_dataset()).verdict == MISCALIBRATED


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTORTIONS)
def test_distorted_posteriors_fail(model: PoseModel, name: str) -> None:
    tree = calibrate(
        model,
        distorted(sampler_of("rejection", model, 100, root="candidates"), DISTORTIONS[name]),
        num_simulations=100,
        root="candidates",
    )
    found = judge(tree["simulation"].to_dataset())
    assert found.verdict == MISCALIBRATED, (name, found.sentence)
    assert (
        min(found.families["energy balls"], found.families["TARP"], found.families["ranks (SBC)"])
        < 0.01
    )


@pytest.mark.slow
def test_a_posterior_that_ignores_the_image_fails(model: PoseModel) -> None:
    """TARP and the misfit see it."""
    tree = calibrate(model, ignoring(model, 100), num_simulations=100, root="candidates")
    found = judge(tree["simulation"].to_dataset())
    assert found.verdict == MISCALIBRATED
    assert found.p_value(TARP) < 1e-4
    assert found.p_value(MISFIT) < 1e-10
    coordinates = [
        float(found.tests.p_value.sel(quantity=f"{name} z"))
        for name in ("right_elbow", "left_ankle")
    ]
    assert min(coordinates) > 1e-4, "ranks of the pose alone cannot see it"


@pytest.mark.sweep
def test_the_literal_recipe_fails_under_equation_8(model: PoseModel) -> None:
    tree = calibrate(model, following_the_recipe(model, 60), num_simulations=300, root="candidates")
    found = judge(tree["simulation"].to_dataset())
    assert found.verdict == MISCALIBRATED
    assert min(found.p_value(name) for name in HINGES) < 1e-4


@pytest.mark.slow
def test_the_recipes_draws_explain_the_detection(model: PoseModel) -> None:
    """Second route for the control itself: every pose puts every seen joint into its disc."""
    for index, instance in enumerate(simulate(model, 0, 0, 4)):
        draws = following_the_recipe(model, 30)(index, instance, jax.random.key(index)).joints
        *_, misfit = of_both(model, instance.frame.observation, draws).T
        assert (misfit <= 1 + 1e-9).all()


# --- chains, files, failures


def chains(rho: float, rng: np.random.Generator, number: int = 4, draws: int = 500) -> np.ndarray:
    """Autoregressive chains of poses."""
    noise = rng.normal(size=(number, draws, 15, 3))
    found = np.zeros_like(noise)
    found[:, 0] = noise[:, 0]
    for step in range(1, draws):
        found[:, step] = rho * found[:, step - 1] + np.sqrt(1 - rho**2) * noise[:, step]
    return found


def test_chains_are_thinned_to_their_effective_number() -> None:
    free, tied = independent(chains(0.0, RNG(0))), independent(chains(0.9, RNG(0)))
    assert len(free) > 600
    assert 20 < len(tied) < 300  # 2,000 draws are worth 2,000 · (1 - ρ)/(1 + ρ) = 105
    assert len(independent(np.repeat(chains(0.0, RNG(0), 4, 1), 100, axis=1))) == 0, (
        "chains that stand still"
    )


@pytest.mark.slow
def test_failures_are_counted_and_said(model: PoseModel) -> None:
    right = sampler_of("rejection", model, 20, root="candidates")

    def sometimes(index: int, instance: Instance, key: jax.Array) -> Answer:
        return (
            Answer(np.empty((0, 15, 3)), sentence="gave up")
            if index % 10 == 0
            else right(index, instance, key)
        )

    tree = calibrate(model, sometimes, num_simulations=120, root="candidates")
    simulation = tree["simulation"].to_dataset()
    assert int((simulation.status == FAILED).sum()) == 12
    assert simulation.sentence.values[10] == "gave up"
    assert tree["prior_sbc"].sizes["draw"] == 108
    assert judge(simulation).verdict == CANNOT_TELL
    assert judge(simulation).tests.attrs["num_failed"] == 12


def test_draws_of_a_file(model: PoseModel, tmp_path: Path) -> None:
    """The same draws by name and by file; a simulation without draws is a failure."""
    right = sampler_of("rejection", model, 20, root="candidates")
    some = simulate(model, 0, 0, 6)
    joints = np.stack(
        [
            right(index, instance, jax.random.fold_in(jax.random.key(0), index)).joints
            for index, instance in enumerate(some)
        ]
    )
    joints[4] = np.nan
    np.savez(tmp_path / "draws.npz", joints=joints)
    by_file = calibrate(
        model, str(tmp_path / "draws.npz"), num_simulations=6, num_samples=20, root="candidates"
    )
    by_name = calibrate(model, "rejection", num_simulations=6, num_samples=20, root="candidates")
    one, other = (tree["simulation"].to_dataset() for tree in (by_file, by_name))
    np.testing.assert_array_equal(one.level[2], other.level[2])
    assert one.status[4] == FAILED
    assert "20 of 20 draws" in str(one.sentence[4].item())
    with pytest.raises(BadInput, match="draws for 6 simulations; ask for as many"):
        calibrate(model, str(tmp_path / "draws.npz"), num_simulations=7, root="candidates")


@pytest.mark.parametrize("kind", ["weights", "log_weights"])
@pytest.mark.parametrize("suffix", [".npz", ".nc"])
def test_weights_of_a_file_count(model: PoseModel, tmp_path: Path, suffix: str, kind: str) -> None:
    """Draws of zero weight are not there, whatever they are, and those of half the weight are half
    as often taken; without their weights all are."""
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(6, 400, 15, 3))
    weights = np.tile(np.repeat([0.0, 1.0, 0.5], [100, 100, 200]), (6, 1))
    joints[:, :100] = np.nan
    weights[4] = 0.0
    with np.errstate(divide="ignore"):
        given = weights if kind == "weights" else np.log(weights) - 700
    path = tmp_path / f"draws{suffix}"
    if suffix == ".npz":
        np.savez(path, joints=joints, **{kind: given})
    else:
        dims = ("chain", "draw")
        named = {"joints": ((*dims, "joint", "axis"), joints), kind: (dims, given)}
        save_tree(xr.DataTree.from_dict({"posterior": xr.Dataset(named)}), path)
    draw = FromFile.read(path)
    instance, key = simulate(model, 0, 0, 1)[0], jax.random.key(3)
    whole, half = 0, 0
    for index in (0, 1, 2, 3, 5):
        answer = draw(index, instance, jax.random.fold_in(key, index))
        assert answer.status == COMPLETE
        taken = [np.flatnonzero((joints[index] == one).all(axis=(1, 2))) for one in answer.joints]
        rows = np.concatenate(taken)
        assert len(np.unique(rows)) == len(rows) == len(answer.joints)
        whole, half = whole + int((rows < 200).sum()), half + int((rows >= 200).sum())
    assert whole == 500
    assert abs(half - 500) < 4 * np.sqrt(1000 / 4)  # binomial: 6 in 100,000
    failed = draw(4, instance, key)
    assert failed.status == FAILED
    assert failed.sentence == f"all weights of simulation 4 in {path.name} are zero"
    assert draw.sha256 != FromFile(path, draw.joints).sha256


@pytest.mark.parametrize(
    ("arrays", "match"),
    [
        ({"weights": np.ones((6, 19))}, r"weights of .* are 114 for 120 draws"),
        ({"weights": -np.ones((6, 20))}, "120 of 120 weights of .* are negative"),
        ({"log_weights": np.full((6, 20), np.nan)}, "hold a number that is not finite"),
        ({"weights": np.ones((6, 20)), "log_weights": np.ones((6, 20))}, "has both weights and"),
        ({"weights": np.zeros((6, 20))}, "all weights of .* are zero"),
        ({"weight": np.ones((6, 20))}, r"has an array 'weight'; it may have joints, weights, log"),
        ({"logwt": np.ones((6, 20))}, "has an array 'logwt'"),
    ],
)
def test_weights_that_cannot_be_any_are_refused(
    tmp_path: Path, arrays: dict[str, np.ndarray], match: str
) -> None:
    np.savez(tmp_path / "draws.npz", joints=np.zeros((6, 20, 15, 3)), **arrays)
    with pytest.raises(BadInput, match=match):
        FromFile.read(tmp_path / "draws.npz")


@pytest.mark.parametrize(
    ("shape", "match"),
    [
        ((6, 20, 17, 3), r"shape \(6, 20, 17, 3\); they need \(simulations, draws, 15, 3\)"),
        ((20, 15, 3), "they need"),
    ],
)
def test_files_of_other_dimensions_are_refused(
    model: PoseModel, tmp_path: Path, shape: tuple, match: str
) -> None:
    np.save(tmp_path / "draws.npy", np.zeros(shape))
    with pytest.raises(BadInput, match=match):
        calibrate(model, str(tmp_path / "draws.npy"), num_simulations=6, root="candidates")


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (
            lambda model: calibrate(model, "magic", root="candidates"),
            "no sampler 'magic'; choose one of rejection",
        ),
        (
            lambda model: calibrate(model, "rejection", num_simulations=0, root="candidates"),
            "simulations must be at least 1",
        ),
        (
            lambda model: calibrate(model, "rejection", num_samples=0, root="candidates"),
            "samples must be at least 1",
        ),
        (lambda model: calibrate(model, "missing.npz", root="candidates"), "missing.npz"),
        (lambda model: check_draws(np.zeros((5, 17, 3)), "a pose"), r"need \(draws, 15, 3\)"),
        (lambda model: check_draws(np.full((5, 15, 3), np.nan), "a pose"), "not finite"),
    ],
)
def test_bad_input(model: PoseModel, call: object, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        call(model)  # type: ignore[operator]


@pytest.mark.slow
def test_a_run_goes_on_to_the_same_bits(model: PoseModel, tmp_path: Path) -> None:
    settings = {"num_samples": 12, "seed": 2, "root": "candidates"}
    whole = calibrate(model, "rejection", num_simulations=110, **settings)  # type: ignore[arg-type]
    path = tmp_path / "coverage.nc"
    calibrate(model, "rejection", num_simulations=60, out=path, **settings)  # type: ignore[arg-type]
    done: list[int] = []
    resumed = calibrate(
        model,
        "rejection",
        num_simulations=110,
        out=path,
        progress=lambda now, all: done.append(now),
        **settings,
    )  # type: ignore[arg-type]
    assert done == [50, 100, 110]
    for name in ("level", "depth", "stand_in", "log_evidence"):
        np.testing.assert_array_equal(resumed["simulation"][name], whole["simulation"][name])
    with xr.open_datatree(path) as stored:
        np.testing.assert_array_equal(stored["prior_sbc"].joints, whole["prior_sbc"].joints)
    with pytest.raises(BadInput, match="another run \\(its seed"):
        calibrate(
            model,
            "rejection",
            num_simulations=110,
            out=path,
            num_samples=12,
            seed=3,
            root="candidates",
        )
    kept = {one: one.stat().st_mtime_ns for one in (tmp_path / "coverage.blocks").iterdir()}
    shorter = calibrate(model, "rejection", num_simulations=55, out=path, **settings)  # type: ignore[arg-type]
    first = resumed["simulation"].to_dataset().isel(simulation=slice(55))
    assert shorter["simulation"].to_dataset().identical(first)
    assert {one: one.stat().st_mtime_ns for one in kept} == kept


def test_draws_of_another_file_of_that_name_are_another_run(
    model: PoseModel, tmp_path: Path
) -> None:
    path = tmp_path / "draws.npy"
    for scale in (1.0, 2.0):
        np.save(path, scale * RNG(0).normal(size=(6, 12, 15, 3)))
        if scale == 1.0:
            calibrate(
                model, str(path), num_simulations=6, out=tmp_path / "coverage.nc", root="candidates"
            )
    with pytest.raises(BadInput, match="another run \\(its draws"):
        calibrate(
            model, str(path), num_simulations=6, out=tmp_path / "coverage.nc", root="candidates"
        )


@pytest.mark.slow
def test_workers_calibrate_to_the_same_bits(model: PoseModel) -> None:
    settings = {"num_simulations": 55, "num_samples": 12, "root": "candidates"}
    here = calibrate(model, "rejection", **settings)  # type: ignore[arg-type]
    there = calibrate(model, "rejection", machines=Machines(2), **settings)  # type: ignore[arg-type]
    assert there.identical(here)


def test_too_few_draws_are_a_failure(model: PoseModel) -> None:
    instance = simulate(model, 0, 0, 1)[0]
    found = assess(instance, Answer(np.repeat(instance.joints[None], 3, axis=0)), RNG(0))
    assert found.status == FAILED
    assert "3 independent draws, at least 9" in found.sentence


def test_how_near_a_limit_draws_are_does_not_tell_which_is_the_truth(model: PoseModel) -> None:
    """As a covariate of levels must not: it is the same whichever of them is called the truth,
    though the least distances of poses themselves differ."""
    both = np.stack([instance.joints for instance in simulate(model, 0, 0, 20)])
    least = np.nanmin(model.limits.margin(both), axis=1)
    order = np.argsort(least)
    frame = simulate(model, 0, 0, 1)[0].frame

    def told(rows: np.ndarray) -> float:
        instance = Instance(frame, both[rows[0]])
        answer = Answer(both[rows[1:]])
        return assess(instance, answer, RNG(0), limits=model.limits).nearest_limit

    assert told(order) == told(order[::-1]) == pytest.approx(np.median(least))
    assert least[order[-1]] > 2 * least[order[0]]


def test_the_log_density_is_the_models(model: PoseModel) -> None:
    """Outside the discs it is -inf, and so is its level at the bottom: the truth of another
    detection."""
    one, other = simulate(model, 0, 0, 2)
    observation = one.frame.observation
    assert not np.isfinite(of_both(model, observation, other.joints[None])[0, -2])
    moved = dataclasses.replace(one.frame, likelihood=Likelihood(factor=1e-4))
    observation = moved.observation
    assert of_both(model, observation, one.joints[None])[0, -1] > 1
