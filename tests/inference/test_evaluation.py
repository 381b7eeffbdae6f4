"""Metrics, scores, relations and the bias study: against closed forms and second routes, on errors
made for them."""

import dataclasses
import math

import jax
import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import special_ortho_group

from poseterior.inference.prior import sample_prior
from poseterior.inference.studies.evaluation import bias, metrics
from poseterior.inference.studies.evaluation.conditions import Condition, conditions
from poseterior.inference.studies.evaluation.outcome import Protocol, judge_block
from poseterior.inference.studies.evaluation.relations import (
    FAILS,
    HOLDS,
    OPEN,
    Relation,
    relations,
)
from poseterior.inference.studies.evaluation.scores import (
    clustered,
    errors_of,
    lost,
    summary,
    unscaled_errors,
)
from poseterior.inference.studies.intervals import Interval
from poseterior.probmodel import Anatomy, BadInput, PoseModel
from poseterior.probmodel.datasets import from_motions
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import BONE_NAMES
from poseterior.reports.commands.evaluate import Predictions, findings
from poseterior.reports.tables import Sheet

RNG = np.random.default_rng(0)
ERRORS = RNG.gamma(2.0, 40.0, size=(50, 6, 15))
"""Of 50 poses, six hypotheses each."""


# --- metrics


def test_the_three_bests_are_three_things():
    """Second route: loops, as a reader of their definitions would write them."""
    means = [[float(np.mean(ERRORS[n, h])) for h in range(6)] for n in range(50)]
    per_pose = [min(row) for row in means]
    per_batch = min(math.fsum(means[n][h] for n in range(50)) / 50 for h in range(6))
    per_joint = [
        sum(min(ERRORS[n, h, j] for h in range(6)) for j in range(15)) / 15 for n in range(50)
    ]
    assert metrics.best_per_batch(ERRORS) == pytest.approx(per_batch)
    assert metrics.best_per_joint(ERRORS) == pytest.approx(per_joint)
    assert np.mean(per_joint) < np.mean(per_pose) < per_batch


def test_two_hypotheses_told_apart_by_hand():
    """Two poses of two joints, worked out on paper."""
    errors = np.array([[[1.0, 3.0], [4.0, 0.0]], [[6.0, 2.0], [2.0, 4.0]]])
    assert metrics.best_per_batch(errors) == 2.5
    assert metrics.best_per_joint(errors).tolist() == [0.5, 2.0]


def test_pck_is_the_distribution_function_of_errors():
    thresholds = np.array([0.0, 10.0, 80.0, 150.0, 1e9])
    expected = [(t >= ERRORS).mean() for t in thresholds]
    assert metrics.pck(ERRORS, thresholds) == pytest.approx(expected)
    holed = ERRORS.copy()
    holed[0, 0, 0] = np.nan
    assert metrics.pck(holed, [1e9])[0] == 1.0


def test_a_joint_at_the_threshold_is_correct():
    assert metrics.pck([149.0, 150.0, 151.0, np.nan], [150.0])[0] == pytest.approx(2 / 3)


def test_areas_are_those_under_the_curves():
    """Against the trapezoidal rule over 30,001 thresholds."""
    fine = np.linspace(0, 150, 30_001)
    assert metrics.pck_area(ERRORS) == pytest.approx(
        trapezoid(metrics.pck(ERRORS, fine), fine) / 150, abs=1e-4
    )
    fine, worst = np.linspace(0, 300, 30_001), ERRORS[:, 0].max(axis=-1)
    share = (worst[:, None] <= fine).mean(axis=0)
    assert metrics.cps(ERRORS[:, 0]) == pytest.approx(trapezoid(share, fine), abs=0.02)
    assert metrics.cps(np.zeros((3, 15))) == 300.0
    assert metrics.cps(np.full((3, 15), 301.0)) == 0.0


def test_spread_of_a_normal_cloud():
    """Independent coordinates of standard deviation s: s·√3, to four standard errors."""
    cloud = RNG.normal(scale=2.0, size=(4000, 15, 3))
    assert metrics.spread(cloud) == pytest.approx(
        2.0 * math.sqrt(3), rel=4 / math.sqrt(2 * 4000 * 45)
    )
    assert metrics.spread(cloud[:1]) == 0.0


def test_depth_flips_are_counted():
    pose = np.zeros((15, 3))
    pose[:, 2] = np.arange(15)  # every bone of the limbs points away
    near = pose.copy()
    near[4, 2] = -100.0  # a forearm towards the camera
    assert metrics.distinct_flips(np.stack([pose, pose, near, near])) == 2
    assert metrics.distinct_flips(RNG.normal(size=(100_000, 15, 3))) == 256


# --- conditions


def test_missing_joints_and_turns_are_not_crossed():
    found = conditions(("zhou",), (0, 1, 2), (0.0, 30.0, 60.0), ("candidates",))
    assert [(c.missing, c.rotate) for c in found] == [(0, 0), (1, 0), (2, 0), (0, 30), (0, 60)]
    assert found[3].name == "zhou-missing-0-rotate-30"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((("hmr",), (0,), (0.0,)), "no estimator 'hmr'"),
        ((("zhou", "zhou"), (0,), (0.0,)), "none twice"),
        (((), (0,), (0.0,)), "estimators must name at least one"),
        ((("zhou",), (9,), (0.0,)), "9 limb joints cannot be missing"),
        ((("zhou",), (0,), (math.nan,)), "cannot be turned by nan"),
    ],
)
def test_conditions_that_are_none_are_refused(arguments, words):
    with pytest.raises(BadInput, match=words):
        conditions(*arguments)


# --- frames


def waving(seed: int, frames: int = 30) -> np.ndarray:
    """Poses `(frames, 15, 3)` in mm that differ a little, smoothly."""
    way = np.random.default_rng(seed).normal(size=(15, 3)) * 30
    return 330 * PoseDictionary.default().mean + np.linspace(0, 1, frames)[:, None, None] * way


DATA = from_motions(
    [Motion(waving(0), 30.0, "walking/one", "a"), Motion(waving(1), 30.0, "running/one", "b")],
    "two",
    frames=6,
)
PROTOCOL = Protocol(Anatomy.default(), PoseDictionary.default(), num_samples=40, ks=(3, 5))


@pytest.fixture(scope="module")
def judged() -> dict[str, np.ndarray]:
    return judge_block(PROTOCOL, Condition("zhou"), DATA, 0)


def test_a_frame_comes_out_as_it_does_by_hand(judged):
    """Second route: the public functions, one frame, in a row."""
    from poseterior import inference
    from poseterior.inference.sampler import sample
    from poseterior.inference.studies.errors import aligned_errors, joint_errors

    case = DATA.case(2)
    frames = inference.estimate_torsos([one.detection for one in DATA], "zhou", num_candidates=1)
    assert judged["single"][2] == pytest.approx(joint_errors(frames[2].pose, case.pose), abs=1e-3)
    result = sample(
        PROTOCOL.model,
        frames[2],
        key=jax.random.fold_in(jax.random.key(0), 2),
        num_samples=40,
        root="candidates",
    )
    draws = np.asarray(result.tree["posterior"].joints)[0]
    errors = joint_errors(draws, case.pose)
    assert judged["all"][2].mean() == pytest.approx(errors.mean(axis=1).min(), abs=1e-3)
    assert judged["all_by_joint"][2] == pytest.approx(errors.min(axis=0), abs=1e-3)
    assert judged["all_unscaled"][2] == pytest.approx(
        aligned_errors(draws, case.pose).mean(axis=1).min(), abs=1e-3
    )
    chosen = [hypothesis.draw for hypothesis in inference.diverse(draws.astype(np.float32), 3)]
    assert judged["hypotheses_3"][2] == pytest.approx(errors[chosen], abs=1e-3)
    assert judged["status"].tolist() == ["complete"] * 6


def test_hypotheses_may_be_composed(judged):
    """Of the same draws, and judged by the same errors."""
    from poseterior import inference
    from poseterior.inference.studies.errors import joint_errors

    protocol = dataclasses.replace(PROTOCOL, composed=True)
    found = judge_block(protocol, Condition("zhou"), DATA.take(np.array([2])), 2)
    assert np.array_equal(found["all"][0], judged["all"][2])
    (frame,) = inference.estimate_torsos([DATA.case(2).detection], "zhou", num_candidates=1)
    result = inference.sample(
        PROTOCOL.model,
        frame,
        key=jax.random.fold_in(jax.random.key(0), 2),
        num_samples=40,
        root="candidates",
    )
    chosen = inference.composed(result, frame.posterior(PROTOCOL.model, CANDIDATES), 3)
    errors = joint_errors(np.array([one.joints for one in chosen]), DATA.case(2).pose)
    assert found["hypotheses_3"][0] == pytest.approx(errors, abs=1e-3)
    assert not np.allclose(found["hypotheses_3"][0], judged["hypotheses_3"][2], atol=1.0)


@pytest.mark.slow
def test_upright_is_believed_where_the_root_is_uncertain():
    """And nowhere else, where a torso is held fixed."""
    from poseterior import inference
    from tests.scenes import drawer

    protocol = dataclasses.replace(PROTOCOL, upright=8.0, num_roots=60)
    plain = dataclasses.replace(PROTOCOL, num_roots=60)
    way, one = Condition("zhou", root="uncertain"), DATA.take(np.array([2]))
    found, other = (judge_block(each, way, one, 2) for each in (protocol, plain))
    assert found["log_evidence"][0] != other["log_evidence"][0]
    (frame,) = inference.estimate_torsos([DATA.case(2).detection], "zhou", num_candidates=1)
    believing = PoseModel.from_anatomy(PROTOCOL.anatomy, upright=8.0)
    draw = drawer(believing, root="uncertain", num_samples=40, num_roots=60)
    drawn = draw(frame, jax.random.fold_in(jax.random.key(0), 2))
    assert found["log_evidence"][0] == drawn.log_evidence
    fixed = [judge_block(each, Condition("zhou"), one, 2)["all"] for each in (protocol, plain)]
    assert np.array_equal(*fixed)


def test_a_frame_alone_is_the_frame_in_its_block(judged):
    """Its randomness comes from its number; only the estimators' last bits know the company."""
    alone = judge_block(PROTOCOL, Condition("zhou"), DATA.take(np.array([4])), 4)
    for name in ("single", "all", "hypotheses_5"):
        assert alone[name][0] == pytest.approx(judged[name][4], abs=1e-3)
    other = judge_block(PROTOCOL, Condition("zhou"), DATA.take(np.array([4])), 5)
    assert not np.array_equal(other["all"][0], alone["all"][0])


def test_a_bad_frame_is_recorded_and_the_others_go_on(judged):
    keypoints, score = DATA.keypoints.copy(), DATA.score.copy()
    keypoints[1, :12], score[1, :12] = np.nan, 0.0  # three joints are left
    score[3, 4] = -1.0
    spoilt = dataclasses.replace(DATA, keypoints=keypoints, score=score)
    found = judge_block(PROTOCOL, Condition("zhou"), spoilt, 0)
    status, sentence = found["status"], found["sentence"]
    assert status.tolist() == [
        "complete",
        "bad input",
        "complete",
        "bad input",
        "complete",
        "complete",
    ]
    assert "too few" in sentence[1] or "at least" in sentence[1]
    assert "score of right_wrist" in sentence[3]
    assert found["all"][0] == pytest.approx(judged["all"][0], abs=1e-3)
    gone = lost(found)
    assert (gone.number, gone.status) == (2, {"bad input": 2})


@pytest.mark.parametrize("ks", [(), (5, 5), (0,), (41,)])
def test_k_beyond_the_draws_is_refused(ks):
    with pytest.raises(BadInput, match="k must be different numbers from 1 to the 40 draws"):
        dataclasses.replace(PROTOCOL, ks=ks)


# --- scores


def test_the_interval_of_a_mean_covers_it():
    """100 samples of 40 recordings with five equal frames each: a 95 % interval must miss 5 times,
    and misses more than 14 times with probability 2e-4 (binomial, at the bootstrap's own 93.5 %:
    1e-3). Frames taken for independent, the negative control, miss far more often."""
    rng = np.random.default_rng(1)
    missed = naive = 0
    for _ in range(100):
        values = np.repeat(rng.normal(size=40), 5)
        found = clustered(values, np.repeat(np.arange(40), 5))
        assert found.value == pytest.approx(values.mean())
        missed += not found.low <= 0 <= found.high
        found = clustered(values, np.arange(200))
        naive += not found.low <= 0 <= found.high
    assert missed <= 14
    assert naive > 20


def test_one_recording_says_nothing_about_others():
    found = clustered(np.arange(5.0), np.zeros(5))
    assert found.value == 2.0
    assert math.isnan(found.half)


def made(
    single: float, best: float, best_20: float, everything: float, number: int = 60
) -> dict[str, np.ndarray]:
    """Frames with given mean errors, a little noise, and nothing lost."""
    rng = np.random.default_rng(5)

    def joints(mean: float, *shape: int) -> np.ndarray:
        return mean * (1 + 0.05 * rng.normal(size=(number, *shape, 1))) * np.ones(15)

    def many(mean: float, k: int) -> np.ndarray:
        return np.concatenate([joints(3 * mean, k - 1), joints(mean, 1)], axis=1)

    return {
        "single": joints(single),
        "all": joints(everything),
        "hypotheses_5": many(best, 5),
        "hypotheses_20": many(best_20, 20),
    }


RECORDING = np.repeat([f"r{i}" for i in range(20)], 3)


def verdicts(**made_of: dict[str, np.ndarray]) -> dict[str, str]:
    results = {
        Condition("akhter-black", missing): made_of[f"m{missing}"]
        for missing in range(len(made_of))
    }
    found = relations(results, RECORDING, (5, 20), Condition("akhter-black"))
    return {relation.words.split(": ")[1]: relation.verdict for relation in found}


def test_the_papers_own_numbers_hold():
    """Errors made after the paper's tables: what it says of them is found."""
    found = verdicts(m0=made(134.5, 109.8, 102.0, 83.0), m1=made(170.0, 120.0, 110.0, 90.0))
    assert set(found.values()) == {HOLDS}
    assert len(found) == 4


def test_what_does_not_hold_is_said():
    found = verdicts(m0=made(60.0, 54.0, 60.0, 70.0), m1=made(60.0, 56.0, 60.0, 70.0))
    assert found["the best of 5 beats the single estimate by 15 % or more"] == FAILS
    assert found["the best of 20 is better than the best of 5"] == FAILS
    assert found["the best of all draws is better than the best of 20"] == FAILS
    assert (
        verdicts(m0=made(100.0, 83.5, 80.0, 70.0))[
            "the best of 5 beats the single estimate by 15 % or more"
        ]
        == OPEN
    )


def test_a_relation_holds_where_its_whole_interval_does():
    """A gain of 20 % that may be none, that is one, that is a loss for certain."""
    said = {
        Relation("", "", Interval(0.2, low, high), 0.0, math.inf, "share", 60).verdict: low
        for low, high in ((-0.1, 0.5), (0.1, 0.3), (-0.3, -0.1))
    }
    assert said == {OPEN: -0.1, HOLDS: 0.1, FAILS: -0.3}


def test_a_row_of_k_is_its_best_hypothesis():
    values = made(1.0, 2.0, 3.0, 4.0)
    assert errors_of(values, 5) == pytest.approx(values["hypotheses_5"][:, -1])
    values |= {
        "hypotheses_5_unscaled": np.tile([5.0, 1.0, 2.0], (60, 1)),
        "flips_5": np.full(60, 3),
    }
    assert unscaled_errors(values, 5) == pytest.approx(1.0)
    found = summary(values, 5)
    assert found.per_batch == pytest.approx(2.0, rel=0.02)
    assert found.flips == 3.0


# --- tables


def test_tables_say_what_came_out(judged, tmp_path):
    results = {Condition("zhou"): judged, Condition("zhou", 1): judged}
    predictions = np.stack([case.pose for case in DATA]) * 2 + 7
    np.save(tmp_path / "perfect.npy", predictions)
    external = {"perfect": Predictions.read(tmp_path / "perfect.npy", DATA)}
    found = findings(results, DATA, Condition("zhou"), PROTOCOL, external, None, "six frames")
    sheets = {sheet.name: sheet for sheet in found.sheets}
    rows = {str(row[0]): row for row in sheets["table1"].rows}
    assert list(sheets["table1"].head) == ["", "running", "walking", "average", "paper"]
    assert rows["perfect"][1] == pytest.approx(0.0, abs=1e-6)
    single = judged["single"].mean(axis=1)
    assert rows["Zhou et al., single estimate"][1] == pytest.approx(
        single[DATA.action == "running"].mean(), rel=1e-6
    )
    assert sheets["table2"].rows[0][1].value == pytest.approx(single.mean(), rel=1e-6)
    assert "| Zhou et al., best of 3 |" in sheets["table1"].markdown()
    assert (
        sheets["table1"].csv().splitlines()[0]
        == ",running,walking,average,average low,average high,paper"
    )
    assert set(found.figures) == {"errors", "pck"}
    assert isinstance(sheets["pck"], Sheet)


def test_predictions_for_other_frames_are_refused(tmp_path):
    np.save(tmp_path / "few.npy", np.ones((4, 15, 3)))
    with pytest.raises(BadInput, match="predictions for 4 frames, but two has 6"):
        Predictions.read(tmp_path / "few.npy", DATA)
    np.save(tmp_path / "flat.npy", np.ones((6, 15, 3)))
    with pytest.raises(BadInput, match=r"flat\.npy: a pose has its thorax on the joint before it"):
        Predictions.read(tmp_path / "flat.npy", DATA)


# --- bias


@pytest.mark.slow
def test_how_much_is_visited_is_the_cap_of_a_sphere():
    """One pose visits, of one uniform direction, the cap (1 − cos a)/2; to four standard errors of
    4,000 draws."""
    uniform = special_ortho_group.rvs(3, size=4000, random_state=1)[:, :1]
    judged = np.repeat(uniform, 9, axis=1)
    one = np.tile([0.0, 0.0, 1.0], (1, 9, 1))
    head = bias.visits(one, judged, judged)[0]
    for angle, share in zip(bias.ANGLES, head.data, strict=True):
        cap = (1 - math.cos(math.radians(angle))) / 2
        assert share == pytest.approx(cap, abs=4 * math.sqrt(cap / 4000))
    assert head.prior == (1.0, 1.0, 1.0)


def test_a_part_is_visited_where_all_its_bones_are():
    """A draw whose right forearm alone points elsewhere: neither its right arm nor both arms nor
    the whole body are visited."""
    one = np.tile([0.0, 0.0, 1.0], (1, 9, 1))
    judged = one.copy()
    judged[0, BONE_NAMES.index("right_forearm")] = [0.0, 1.0, 0.0]
    found = {visits.part: visits.data[-1] for visits in bias.visits(one, judged, judged)}
    unseen = {part for part, share in found.items() if share == 0}
    assert unseen == {"right arm", "both arms", "whole body"}


def test_directions_do_not_know_the_camera_or_the_size():
    torso = PoseDictionary.default().torso
    turn = special_ortho_group.rvs(3, random_state=2)
    assert bias.directions(1.7 * DATA.poses @ turn.T + 9, torso) == pytest.approx(
        bias.directions(DATA.poses, torso)
    )


@pytest.mark.slow
def test_the_uniform_prior_is_the_models_own():
    """The density of drawn poses, found again from their joints, but for the lengths."""
    model = PoseModel(upper="area", lower="area")
    tree = sample_prior(model, key=jax.random.key(1), num_samples=50)
    joints = np.asarray(tree["prior"].joints)[0]
    from poseterior.probmodel.anatomy.lengths import BoneLength

    lengths = np.asarray(tree["prior"].bone_length)[0]
    own = np.asarray(tree["sample_stats_prior"].lp)[0] - np.asarray(
        BoneLength(model.lengths).log_prob(lengths)
    )
    found = bias.log_prior(model, joints)
    assert np.isfinite(found).all()
    assert np.ptp(found - own) < 1e-6


@pytest.mark.slow
def test_the_study_of_a_common_and_a_rare_action():
    """Nine recordings of one pose and one of another: the mixture prefers the common one, the prior
    less so."""
    rng = np.random.default_rng(0)
    base = 330 * PoseDictionary.default().mean

    def recording(seed: int, action: str, frames: int) -> Motion:
        other = np.random.default_rng(99 if action == "rare" else 7).normal(size=(15, 3)) * 60
        return Motion(
            base + other + rng.normal(size=(frames, 15, 3)) * 8, 1.0, f"{action}/{seed}", "a"
        )

    many = [recording(seed, "common", 40) for seed in range(10)] + [
        recording(seed, "rare", 10) for seed in range(2)
    ]
    data = from_motions(many, "made")
    found = bias.bias_study(data, Anatomy.default())
    common_, rare = found.actions
    assert (common_.poses, rare.poses) == (400, 20)
    assert common_.mixture.value - rare.mixture.value > 2
    assert found.picture.shape == (840, 2)
    whole = found.visits[-1]
    assert whole.part == "whole body"
    assert whole.data[0] <= whole.data[-1] < 0.05
    with pytest.raises(BadInput, match="needs at least 200"):
        bias.bias_study(data.take(np.arange(20)), Anatomy.default())
