"""Exact rejection against a second implementation, its four proposals against each other, and
against wrong samplers.

False alarms: every family of p-values is held to 0.001 altogether (Bonferroni), every evidence to 3
standard errors (0.3 % each); seeds are fixed, so a pass stays a pass."""

import dataclasses
import functools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2, ks_2samp

from poseterior import inference
from poseterior.inference.draws import COMPLETE, IMPOSSIBLE, OUT_OF_BUDGET
from poseterior.inference.exact import mixture
from poseterior.inference.exact.mixture import PROPOSALS, ExactRejection
from poseterior.inference.exact.problem import limb_problems
from poseterior.inference.exact.rates import Budget
from poseterior.inference.exact.reach import out_of_reach
from poseterior.inference.sampler import MAKERS
from poseterior.probmodel import Anatomy, PoseModel
from poseterior.probmodel.anatomy.limits import NUM_ELEVATION, cell_of
from poseterior.probmodel.kinematics import lower_axes
from poseterior.probmodel.skeleton import GROUPS, JOINTS, LENGTH_GROUPS, TORSO_INDEX
from tests.oracle import brute_force
from tests.scenes import ALL_BUT_AN_ARM, key, moved, prior_scene
from tests.sweeps import sweep
from tests.witnesses.limbs import Draws, build_groups
from tests.witnesses.patches import limbs_of, patch_rectangle, plan_limb
from tests.witnesses.pruned import PriorGroups, PrunedGroup, group_prior, pruned

FAMILY = 1e-3
"""False-alarm rate of one family of tests."""


@pytest.fixture(scope="module", autouse=True)
def _with_the_witness() -> Iterator[None]:
    """The witness draws like any other sampler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PROPOSALS, "pruned", pruned)
        patch.setitem(MAKERS["candidates"], "pruned", ExactRejection)
        yield


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


def smallest(pairs) -> float:
    """Smallest p-value of two-sample Kolmogorov–Smirnov tests, times their number."""
    values = [ks_2samp(*pair).pvalue for pair in pairs]
    return min(values) * len(values)


def columns(result: inference.Result, name: str):
    """Lengths and joint coordinates of one group, as columns by label."""
    posterior = result.tree["posterior"]
    found = {}
    for bone in GROUPS[name][0].bones:
        found[LENGTH_GROUPS[bone.length_group]] = posterior.bone_length.values[
            0, :, bone.length_group
        ]
    for limb in GROUPS[name]:
        for bone in limb.bones:
            for axis in range(3):
                found[f"{JOINTS[bone.end]} {'xyz'[axis]}"] = posterior.joints.values[
                    0, :, bone.end, axis
                ]
    return found


@pytest.mark.parametrize("sampler", sweep(["rejection", "pruned"], ["rejection"]))
@pytest.mark.parametrize(("seed", "missing"), [(6, ("head",)), (5, ("right_wrist", "left_ankle"))])
def test_rejection_follows_the_second_implementation(model, sampler, seed, missing):
    """Lengths and all joint coordinates of head, arms and legs; evidence per group within 3
    standard errors."""
    frame = prior_scene(model, seed, factor=0.7, missing=missing)
    result = inference.sample(
        model, frame, sampler=sampler, key=key(seed), num_samples=4000, root="candidates"
    )
    pairs, log_evidence, variance = [], 0.0, 0.0
    for name in GROUPS:
        size, joints, proposed = brute_force(
            model.limits, model.lengths, frame, name, 250_000, seed
        )
        assert len(size) >= 200, f"brute force accepted only {len(size)} {name}"
        ours = columns(result, name)
        theirs = dict(
            zip(
                [LENGTH_GROUPS[bone.length_group] for bone in GROUPS[name][0].bones],
                size.T,
                strict=True,
            )
        )
        theirs |= {
            f"{JOINTS[joint]} {'xyz'[axis]}": points[:, axis]
            for joint, points in joints.items()
            for axis in range(3)
        }
        pairs += [(ours[label], theirs[label]) for label in ours]
        log_evidence += np.log(len(size) / proposed)
        variance += 1 / len(size)
    assert smallest(pairs) > FAMILY
    error = np.hypot(result.tree.attrs["log_evidence_se"], np.sqrt(variance))
    assert abs(result.tree.attrs["log_evidence"] - log_evidence) < 3 * error


def test_draws_of_two_roots_are_shared_as_the_mixture_says(model):
    """The truth and the same camera 15 % larger, one arm seen: every seen joint, torso and limb
    alike, weighs a root by scale⁻², and so does the share of draws of the prior that explain the
    arm, by brute force. Shares and evidence within 4 standard errors; equal shares, and shares by
    evidence alone, are 0.1 and more away. The error is that of independent ones, by numerical
    derivatives."""
    frame = prior_scene(model, 3, factor=1.0, missing=ALL_BUT_AN_ARM)
    (truth,) = frame.candidates
    camera = truth.camera._replace(scale=1.15 * truth.camera.scale)
    both = truth, dataclasses.replace(truth, camera=camera)
    hits, tried = [], 100_000
    for seed, one in enumerate(both):
        alone = dataclasses.replace(frame, candidates=(one,))
        size, *_ = brute_force(model.limits, model.lengths, alone, "arms", tried, seed)
        hits.append(len(size))
    seen = len(TORSO_INDEX) + 2
    prior = np.array([1.0, 1.15 ** (-2 * seen)])
    prior, rate = prior / prior.sum(), np.array(hits) / tried
    weight = prior * rate
    share = weight / weight.sum()
    away = [abs(share[0] - other) for other in (0.5, rate[0] / rate.sum())]
    assert min(away) > 0.1
    frame = dataclasses.replace(frame, candidates=both)
    result = inference.sample(model, frame, key=key(1), num_samples=4000, root="candidates")
    constant, drawn = result.tree["constant_data"], result.tree["posterior"].candidate.values
    errors = constant.log_evidence_se.values
    known = np.sum(share[0] * share[1] * np.array([*errors, *(np.array(hits) ** -0.5)]) ** 2)
    assert abs(np.mean(drawn == 0) - share[0]) < 4 * np.sqrt(known + share.prod() / 4000)
    np.testing.assert_allclose(constant.weight.values, share, atol=4 * np.sqrt(known))
    attrs = result.tree.attrs
    relative = np.sqrt(np.sum(share**2 / np.array(hits)))
    error = np.hypot(attrs["log_evidence_se"], relative)
    assert abs(attrs["log_evidence"] - np.log(weight.sum())) < 4 * error < 0.2
    logs = constant.log_evidence.values
    slopes = [
        (mixed(prior, logs + step) - mixed(prior, logs - step)) / 2e-6 for step in 1e-6 * np.eye(2)
    ]
    by_slopes = np.sqrt(np.sum((slopes * errors) ** 2))
    assert attrs["log_evidence_se"] == pytest.approx(by_slopes, rel=1e-3)


def mixed(prior, logs) -> float:
    """Log evidence of a mixture."""
    return float(np.log(prior @ np.exp(logs)))


@functools.lru_cache
def coupled_scene():
    """Both legs seen: their shared lengths couple them."""
    model = PoseModel()
    frame = prior_scene(model, 8, factor=0.5)
    return model, frame, build_groups(model, frame.observation)["legs"]


def drawn(sampler, number: int) -> Draws:
    assert sampler.more(number, Budget(10**9))
    (draws,) = sampler.draws().values()
    return Draws(*(np.asarray(leaf)[:number] for leaf in draws))


@pytest.mark.slow
def test_shared_lengths_shift_as_brute_force_says_and_lengths_per_side_do_not():
    """Negative control: lengths drawn for each side apart must fail where shared ones pass (legs,
    20,000 draws)."""
    model, frame, legs = coupled_scene()
    exact = drawn(PrunedGroup(key(0), "legs", legs), 20_000)
    size, _, _ = brute_force(model.limits, model.lengths, frame, "legs", 3_000_000, 3)
    assert len(size) > 250
    per_side = drawn(PrunedGroup(key(1), "legs", legs.limb(1)), 20_000)
    shared = [(exact.length[:, column], size[:, column]) for column in range(2)]
    apart = [(per_side.length[:, column], size[:, column]) for column in range(2)]
    assert smallest(shared) > FAMILY
    assert smallest(apart) < FAMILY
    # Against the exact draws, which are more, the wrong ones stand out beyond doubt.
    assert (
        smallest((exact.length[:, column], per_side.length[:, column]) for column in range(2))
        < 1e-12
    )


@pytest.mark.slow
def test_redrawing_only_the_lower_bone_is_another_law():
    """Negative control: upper bones accepted by their own disc, lower ones drawn until theirs
    fits."""
    _, _, legs = coupled_scene()
    exact = drawn(PrunedGroup(key(0), "leg", legs.limb(0)), 4000)
    again = drawn(PrunedGroup(key(9), "leg", legs.limb(0)), 4000)
    knee_only = dataclasses.replace(legs.limb(0), radius=legs.limb(0).radius.at[:, 1].set(jnp.inf))
    wrong = drawn(PriorGroups(key(2), {"leg": knee_only}), 4000)

    def elevation(draws):
        return draws.upper[:, 0, 2], draws.upper[:, 0, 1], draws.upper[:, 0, 0]

    assert smallest(zip(elevation(exact), elevation(again), strict=True)) > FAMILY
    assert smallest(zip(elevation(exact), elevation(wrong), strict=True)) < FAMILY / 100


@pytest.mark.sweep
@pytest.mark.parametrize("factor", [0.02, 0.25, 1.5])
@pytest.mark.parametrize(("upper", "lower"), [("angle", "area"), ("area", "box")])
def test_bounds_are_bounds(upper, lower, factor):
    """Tries to break the pruned proposal: poses of the prior, their own detections, tiny to huge
    discs. A pose explains them, so its cells must be kept, its lower bones lie in their rectangles,
    and the rectangles within their bounds."""
    model = PoseModel(upper=upper, lower=lower)
    observation = prior_scene(model, 3).observation
    for name in ("arms", "legs"):
        group = build_groups(model, observation)[name]
        draws = group_prior(key(4), group, 400)
        reach = group.reach(draws)
        rng = np.random.default_rng(5)
        radius = factor * rng.uniform(0.3, 2, group.radius.shape)
        angle, distance = (
            rng.uniform(0, 2 * np.pi, reach.shape[:-1]),
            radius * np.sqrt(rng.uniform(size=reach.shape[:-1])),
        )
        target = reach + distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for row in range(group.num_limbs):
            check = functools.partial(_violations, limbs_of(group)[row], jnp.asarray(radius[row]))
            items = (target[:, row], draws.upper[:, row], draws.lower[:, row])
            broken = jax.lax.map(lambda item, check=check: check(*item), items, batch_size=50)
            assert not np.asarray(broken).any()


def _violations(limb, radius, target, upper, lower):
    """`(3,)` bool: cell dropped, outside the rectangle, rectangle above its bound."""
    limb = dataclasses.replace(limb, target=target, radius=radius)
    plan = plan_limb(limb)
    column, row = cell_of(upper)
    cell = column * NUM_ELEVATION + row
    dropped = plan.sums[cell + 1] <= plan.sums[cell]
    # The rectangle again, from its definition.
    middle, half = (limb.low + limb.high) / 2, (limb.high - limb.low) / 2
    end = -limb.frame[:2] @ upper
    centre = -(target[1] - middle[0] * end) / middle[1]
    distance = jnp.linalg.norm(centre)
    width, low, high = patch_rectangle(
        distance, (radius[1] + half[0] * jnp.linalg.norm(end) + half[1]) / middle[1]
    )
    bone = limb.frame @ lower_axes(upper, limb.reference, limb.fallback) @ lower
    towards = centre / distance
    x = bone[0] * -towards[1] + bone[1] * towards[0]
    angle = jnp.arcsin(jnp.clip((bone[:2] @ towards) / jnp.sqrt(1 - x**2), -1, 1))
    outside_patch = (jnp.abs(x) > width + 1e-9) | (angle < low - 1e-9) | (angle > high + 1e-9)
    hinge = jax.tree.map(lambda leaf: leaf[column, row], limb.hinges)
    u1, u2, u3 = hinge.triple @ lower
    turn = jnp.arctan2(u3, -u1)
    box = plan.box[cell]
    outside_box = (u2 < box[0]) | (u2 > box[1]) | (turn < box[2]) | (turn > box[3])
    outside = jnp.where(plan.patch[cell], outside_patch, outside_box)
    above = plan.patch[cell] & (4 * width * (high - low) > plan.bound[cell])
    return jnp.stack([dropped, outside, above])


@pytest.mark.slow
def test_bounds_test_can_fail():
    """Negative control of the test above: bounds made for too short a range of lengths are
    caught."""
    model = PoseModel()
    frame = prior_scene(model, 3)
    group = build_groups(model, frame.observation)["legs"]
    draws = group_prior(key(4), group, 200)
    limb = dataclasses.replace(limbs_of(group)[0], high=limbs_of(group)[0].low + 1e-3)
    reach = group.reach(draws)
    radius = jnp.full(2, 0.02)
    items = (reach[:, 0], draws.upper[:, 0], draws.lower[:, 0])
    broken = jax.lax.map(lambda item: _violations(limb, radius, *item), items, batch_size=50)
    assert np.asarray(broken).any()


def test_same_key_same_draws_and_a_longer_run_goes_on_with_them(model):
    frame = prior_scene(model, 2)
    observation = frame.observation
    arms = build_groups(model, observation)["arms"]
    first, longer = (
        drawn(PrunedGroup(key(7), "arms", arms), 500),
        drawn(PrunedGroup(key(7), "arms", arms), 900),
    )
    other = drawn(PrunedGroup(key(8), "arms", arms), 500)
    assert np.array_equal(first.upper, longer.upper[:500])
    assert not np.array_equal(first.upper, other.upper)
    one, two = (
        inference.sample(model, frame, key=key(3), num_samples=300, root="candidates")
        for _ in range(2)
    )
    assert np.array_equal(one.tree["posterior"].joints, two.tree["posterior"].joints)


def test_blocks_are_other_draws_and_count_proposals_together(model):
    """Of 60 draws in blocks of 20 none comes twice. The acceptance rate is of all until then."""
    posterior = prior_scene(model, 2).posterior(model, "candidates")
    blocks = list(ExactRejection().blocks(posterior, key(0), 60, block=20))
    lengths = np.concatenate([block.bone_length for block in blocks])
    assert len(np.unique(lengths, axis=0)) == 60
    for made, block in zip((20, 40, 60), blocks, strict=True):
        proposals = block.attributes["num_proposals"]
        assert block.attributes["acceptance_rate"] == made / proposals


def test_every_draw_is_possible_and_explains_the_detection(model):
    frame = prior_scene(model, 6, missing=("left_wrist", "head"))
    result = inference.sample(model, frame, key=key(0), num_samples=2000, root="candidates")
    posterior, constant = result.tree["posterior"], result.tree["constant_data"]
    assert model.limits.check(posterior.joints.values).valid.all()
    offset = np.linalg.norm(posterior.keypoints - result.tree["observed_data"].keypoints, axis=-1)
    radius = constant.radius.values[posterior.candidate.values]
    assert np.all((offset <= radius * (1 + 1e-12)) | np.isnan(radius))
    assert np.isfinite(result.tree["sample_stats"].lp).all()


def test_a_wrist_out_of_reach_is_named_with_its_distance(model):
    frame = moved(prior_scene(model, 2), "right_wrist", (2000.0, 0.0))
    result = inference.sample(model, frame, key=key(0), num_samples=100, root="candidates")
    assert result.status == IMPOSSIBLE
    assert result.num_draws == 0
    assert "right_wrist" in result.sentence
    assert 1500 < float(result.sentence.split(" px")[0].split()[-1]) < 2000


def test_what_a_pose_reaches_is_not_called_out_of_reach(model):
    """Poses of the prior, whose joints are detected where they are: whatever is said to be out of
    reach is a bound that is none. A detection a limb farther is out of reach."""
    for seed in range(12):
        frame = prior_scene(model, seed, factor=1e-6)
        assert out_of_reach(model, limb_problems(frame.observation)) == []
        far = moved(frame, "left_wrist", (400.0, 0.0))
        assert {one.joint for one in out_of_reach(model, limb_problems(far.observation))} == {
            "left_wrist"
        }


@pytest.mark.slow
def test_where_the_bounds_leave_nothing_no_budget_is_blamed(model, monkeypatch):
    """One group is enough for that, and nobody has to say which joint is out of reach."""
    monkeypatch.setattr(mixture, "out_of_reach", lambda model, problems: [])
    frame = moved(prior_scene(model, 2), "right_wrist", (2000.0, 0.0))
    result = inference.sample(model, frame, key=key(0), num_samples=100, root="candidates")
    assert result.status == IMPOSSIBLE
    assert "the bounds leave no possible arms" in result.sentence


def test_an_exhausted_budget_returns_what_there_is(model):
    frame = prior_scene(model, 2)
    result = inference.sample(
        model, frame, key=key(0), num_samples=10_000, max_proposals=200_000, root="candidates"
    )
    assert result.status == OUT_OF_BUDGET
    assert 0 < result.num_draws < 10_000
    assert f"{result.num_draws} of 10000" in result.sentence
    assert model.limits.check(result.tree["posterior"].joints.values).valid.all()


@pytest.mark.parametrize("sampler", sweep([*PROPOSALS, "pruned"], ["rejection"]))
def test_every_sampler_has_the_same_face(model, sampler):
    """Same arguments, same result: tree, status, sentence, evidence with its error."""
    seen = ("right_wrist", "left_knee")
    missing = tuple(
        name
        for name in JOINTS
        if name.split("_")[-1] in ("elbow", "wrist", "knee", "ankle", "head") and name not in seen
    )
    frame = prior_scene(model, 4, factor=0.8, missing=missing)
    result = inference.sample(
        model, frame, sampler=sampler, key=key(0), num_samples=50, root="candidates"
    )
    assert result.status == COMPLETE
    assert result.num_draws == 50
    assert result.tree.attrs["sampler"] == sampler
    assert 0 < result.tree.attrs["log_evidence_se"] < 1


@pytest.mark.sweep
def test_the_proposals_agree():
    """Whole body, per group, pruned, by strata: the same coordinates (one family) and the same
    evidence within 3 standard errors, in every pair of measures, where the whole body can run: five
    joints missing, wide discs."""
    pairs, scores = [], []
    for upper, lower in [("angle", "area"), ("area", "box")]:
        model = PoseModel(upper=upper, lower=lower)
        missing = ("head", "right_elbow", "right_knee", "left_ankle", "left_elbow")
        frame = prior_scene(model, 11, factor=1.0, missing=missing)
        results = [
            inference.sample(
                model, frame, sampler=name, key=key(index), num_samples=1500, root="candidates"
            )
            for index, name in enumerate(PROPOSALS)
        ]
        for other in results[1:]:
            for name in GROUPS:
                ours, theirs = columns(results[0], name), columns(other, name)
                pairs += [(ours[label], theirs[label]) for label in ours]
            one, two = results[0].tree.attrs, other.tree.attrs
            error = np.hypot(one["log_evidence_se"], two["log_evidence_se"])
            scores.append((one["log_evidence"] - two["log_evidence"]) / error)
    assert smallest(pairs) > FAMILY
    assert np.abs(scores).max() < 3


@pytest.mark.slow
def test_the_standard_error_of_the_evidence_is_one(model):
    """Forty runs with other keys: the spread of their evidences is what they say, chi-square at 0.1
    %, both tails."""
    frame = prior_scene(model, 2)
    attrs = [
        inference.sample(
            model, frame, key=key(100 + run), num_samples=500, root="candidates"
        ).tree.attrs
        for run in range(40)
    ]
    values, errors = (
        np.array([item[name] for item in attrs]) for name in ("log_evidence", "log_evidence_se")
    )
    statistic = np.sum(((values - np.average(values, weights=errors**-2)) / errors) ** 2)
    assert chi2.ppf(0.0005, 39) < statistic < chi2.ppf(0.9995, 39)


@pytest.mark.sweep
def test_published_limits_in_every_measure_follow_per_group_rejection(shared_data):
    anatomy = Anatomy.load(shared_data / "akhter_black" / "jointAngleModel_v2.mat")
    pairs, scores = [], []
    for upper in ("angle", "area"):
        for lower in ("area", "box"):
            model = PoseModel.from_anatomy(anatomy, upper=upper, lower=lower)
            frame = prior_scene(model, 0, factor=0.8)
            one = inference.sample(model, frame, key=key(1), num_samples=3000, root="candidates")
            two = inference.sample(
                model,
                frame,
                sampler="rejection-group",
                key=key(2),
                num_samples=800,
                root="candidates",
            )
            for name in GROUPS:
                ours, theirs = columns(one, name), columns(two, name)
                pairs += [(ours[label], theirs[label]) for label in ours]
            error = np.hypot(one.tree.attrs["log_evidence_se"], two.tree.attrs["log_evidence_se"])
            scores.append((one.tree.attrs["log_evidence"] - two.tree.attrs["log_evidence"]) / error)
    assert smallest(pairs) > FAMILY
    assert np.abs(scores).max() < 3
