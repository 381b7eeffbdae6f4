"""Attempts as one program on JAX's device: the law of the compiled loops, draws that stay there.

False alarms: every family of p-values is held to 0.001 altogether (Bonferroni), differences of log
evidences to 4 standard errors; seeds are fixed. The device is a processor here, as anywhere without
a GPU: the program is the same.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from poseterior import inference
from poseterior.inference.draws import COMPLETE, IMPOSSIBLE, OUT_OF_BUDGET
from poseterior.inference.exact import groups
from poseterior.inference.exact.device import group as device
from poseterior.inference.exact.device.group import LEAST, DeviceGroup, Size, device_groups
from poseterior.inference.exact.device.proposals import _lower_axes, _rectangle
from poseterior.inference.exact.device.tables import padded, real, whole
from poseterior.inference.exact.groups import PILOT_BATCH, StratifiedGroup, group_tables
from poseterior.inference.exact.loops.rectangles import rectangle
from poseterior.inference.exact.loops.tables import ENTRIES, SUBS
from poseterior.inference.exact.mixture import RootSampler
from poseterior.inference.exact.problem import limb_problems
from poseterior.inference.exact.rates import Budget
from poseterior.probmodel import BadInput, PoseModel, kinematics
from poseterior.probmodel.example import example
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import GROUPS, JOINT_INDEX
from tests.scenes import key, prior_scene
from tests.sweeps import sweep
from tests.witnesses.limbs import build_groups

FAMILY = 1e-3
PLENTY = Budget(10**12)


@pytest.fixture(scope="module")
def model() -> PoseModel:
    return PoseModel()


@pytest.fixture(scope="module")
def frame(model):
    return prior_scene(model, 2)


@pytest.fixture(scope="module")
def easy(model):
    """The same in discs four times as large."""
    return prior_scene(model, 2, factor=1.0)


def both(model, frame, name, seed) -> tuple[DeviceGroup, StratifiedGroup]:
    tables, limbs = group_tables(model)[name], limb_problems(frame.observation)[name]
    ours = DeviceGroup(key(seed), name, tables, limbs)
    return ours, StratifiedGroup(key(seed + 1), name, tables, limbs)


def columns_of(sampler, number) -> np.ndarray:
    draws = sampler.draws()[sampler.name]
    return np.concatenate([part[:number].reshape(number, -1) for part in draws], axis=1)


def difference(one, other) -> float:
    """Of two samplers' log evidences, in standard errors."""
    (first,), (second,) = one.rates, other.rates
    error = np.sqrt(first.variance + second.variance)
    return (first.log_probability - second.log_probability) / error


def smallest(one: np.ndarray, other: np.ndarray) -> float:
    """The smallest p-value of all coordinates' Kolmogorov–Smirnov tests, times their number."""
    values = [stats.ks_2samp(*pair).pvalue for pair in zip(one.T, other.T, strict=True)]
    return min(values) * len(values)


@pytest.mark.parametrize("name", sweep(GROUPS, ["legs"]))
def test_draws_are_those_of_the_loops(model, frame, name):
    """Every coordinate of 8,000, the evidence, and what the program of the model projects."""
    ours, loops = both(model, frame, name, 1)
    for sampler in (ours, loops):
        assert sampler.more(8000, PLENTY)
    assert smallest(columns_of(ours, 8000), columns_of(loops, 8000)) > FAMILY
    assert abs(difference(ours, loops)) < 4
    group = build_groups(model, frame.observation)[name]
    assert np.asarray(group.explains(ours.draws()[name])).all()


def test_draws_for_other_discs_are_not(model, easy):
    """The control: of the right arm's discs, one that is a sixth smaller."""
    _, loops = both(model, easy, "arms", 1)
    problems = limb_problems(easy.observation)["arms"]
    smaller = problems[0]._replace(reach=problems[0].reach * [1.0, 5 / 6])
    wrong = DeviceGroup(key(1), "arms", group_tables(model)["arms"], (smaller, problems[1]))
    for sampler in (wrong, loops):
        assert sampler.more(8000, PLENTY)
    assert abs(difference(wrong, loops)) > 6
    assert smallest(columns_of(wrong, 8000), columns_of(loops, 8000)) < FAMILY / 100


@pytest.mark.slow
def test_large_samples_are_the_same_in_law(model, frame):
    """300,000 draws of the arms."""
    ours, loops = both(model, frame, "arms", 11)
    for sampler in (ours, loops):
        assert sampler.more(300_000, PLENTY)
    assert smallest(columns_of(ours, 300_000), columns_of(loops, 300_000)) > FAMILY
    assert abs(difference(ours, loops)) < 4


def test_same_key_same_draws_and_more_are_added_at_the_end(model, frame):
    """However many are asked for at once; the first may be let go of."""
    one, again, other = (both(model, frame, "arms", seed)[0] for seed in (7, 7, 8))
    for sampler in (one, again, other):
        assert sampler.more(500, PLENTY)
    first = columns_of(one, 500)
    assert np.array_equal(first, columns_of(again, 500))
    assert not np.array_equal(first, columns_of(other, 500))
    assert one.held > 500
    assert one.more(4 * LEAST, PLENTY)
    assert np.array_equal(first, columns_of(one, 500))
    assert len(np.unique(columns_of(one, 4 * LEAST), axis=0)) == 4 * LEAST
    later, held = columns_of(one, 700)[500:], one.held
    one.forget(500)
    assert one.held == held - 500
    assert np.array_equal(columns_of(one, 200), later)


def test_draws_that_have_no_room_count(model, easy):
    """Ten draws are asked for, a batch brings more than there is room for: rates say what came."""
    ours, loops = both(model, easy, "arms", 3)
    assert ours.more(10, PLENTY)
    assert loops.more(20_000, PLENTY)
    (rate,) = ours.rates
    assert ours.held == LEAST < rate.accepted
    assert abs(difference(ours, loops)) < 4


def test_no_more_is_attempted_than_the_budget_allows(model, frame):
    ours, _ = both(model, frame, "legs", 3)
    whole_rounds = Budget(PILOT_BATCH + 2 * ours._kind.size.proposals + 5)
    assert not ours.more(10**6, whole_rounds)
    assert whole_rounds.spent == PILOT_BATCH + 2 * ours._kind.size.proposals
    assert 0 < ours.held < 10**6
    none, _ = both(model, frame, "legs", 3)
    assert not none.more(10, Budget(PILOT_BATCH - 1))
    assert none.held == 0


@pytest.mark.slow
def test_a_round_is_so_many_batches(model, frame, monkeypatch):
    """The same attempts in rounds of one or of four batches: the same first draws."""
    found = []
    for repeats in (1, 4):
        monkeypatch.setitem(device.SIZES, "cpu", Size(1 << 12, repeats))
        ours, _ = both(model, frame, "arms", 5)
        assert ours.more(2000, PLENTY)
        assert ours.rates[0].rates[-1].proposed % (repeats << 12) == 0
        found.append(columns_of(ours, 2000))
    assert np.array_equal(*found)


def test_a_program_serves_all_frames_whose_tables_have_the_same_room(model, easy):
    """Compiled once a shape: another seed and another error radius add none where the rooms are
    alike."""
    ours, _ = both(model, easy, "head", 1)
    assert ours.more(100, PLENTY)
    before = device._fill._cache_size()
    for seed in (2, 3):
        other = DeviceGroup(
            key(seed),
            "head",
            group_tables(model)["head"],
            limb_problems(prior_scene(model, 2, factor=0.99).observation)["head"],
        )
        assert other.more(100, PLENTY)
    assert device._fill._cache_size() == before


@pytest.mark.slow
def test_where_nothing_fits_there_comes_an_end(model, frame, monkeypatch):
    """Proof that there is no draw; or many attempts in vain where there is one, and no more of
    them."""
    problems, tables = limb_problems(frame.observation)["legs"], group_tables(model)["legs"]
    out = problems[0]._replace(target=problems[0].target + 50.0)
    nobody = DeviceGroup(key(0), "legs", tables, (out, problems[1]))
    assert nobody.impossible
    assert not nobody.more(10, PLENTY)
    for module in (device, groups):
        monkeypatch.setattr(module, "ZERO_ACCEPTANCE_LIMIT", 1 << 16)
    some = both(model, frame, "legs", 1)[1]
    assert some.more(1, PLENTY)
    places = build_groups(model, frame.observation)["legs"].reach(some.draws()["legs"])[0]
    dots = tuple(
        problem._replace(target=np.asarray(place), reach=np.full(2, 1e-4))
        for problem, place in zip(problems, places, strict=True)
    )
    budget, rare = Budget(10**9), DeviceGroup(key(0), "legs", tables, dots)
    assert not rare.more(10, budget)
    assert not rare.impossible
    assert rare.given_up
    assert 1 << 16 <= budget.spent <= (1 << 16) + PILOT_BATCH


def test_numbers_are_read_from_the_words_of_a_row(model):
    """By the names of their fields; beyond a table there is room up to a power of two."""
    strata = np.zeros(3, ENTRIES)
    strata["region"], strata["sub"], strata["mask"] = [0.5, 2.0, -1.0], [7, 4e9, 0], [255, 1, 128]
    rows = jnp.asarray(padded(strata, 5))
    assert rows.shape == (8, 2)
    assert not rows[3:].any()
    for name, read in (
        ("region", lambda row: real(row, ENTRIES, "region")[0]),
        ("sub", lambda row: whole(row, ENTRIES, "sub")),
        ("mask", lambda row: whole(row, ENTRIES, "mask")),
    ):
        assert [float(read(row)) for row in rows[:3]] == strata[name].astype(float).tolist()
    subs = np.zeros(1, SUBS)
    subs["cell"], subs["fall"] = 7199, 0.25
    (row,) = jnp.asarray(padded(subs, 1))
    assert int(whole(row, SUBS, "cell")) == 7199
    assert float(real(row, SUBS, "lift", "fall")[1]) == 0.25


def test_formulas_are_those_of_the_loops_and_of_the_program():
    rng = np.random.default_rng(0)
    for distance, radius in [*rng.uniform(0, 2.5, (200, 2)), (0.0, 0.5), (0.3, 0.0), (3.0, 1.0)]:
        found = [float(part) for part in _rectangle(jnp.array(distance), jnp.array(radius))]
        np.testing.assert_allclose(found, rectangle(distance, radius), atol=1e-12)
    reference, fallback = np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.0, 1.0])
    for u in [*rng.normal(size=(20, 3)), reference]:
        u = u / np.linalg.norm(u)
        axes = _lower_axes(tuple(jnp.asarray(u)), jnp.asarray([*reference, *fallback]))
        wanted = np.asarray(kinematics.lower_axes(u, reference, fallback)).T
        np.testing.assert_allclose(np.asarray(axes), wanted, atol=1e-12)


@pytest.fixture(scope="module")
def photo(model):
    frame = inference.estimate_torso(example().detection)
    return dataclasses.replace(frame, likelihood=dataclasses.replace(frame.likelihood, factor=1.0))


@pytest.mark.slow
def test_draws_that_stay_are_those_that_come_home(model, photo):
    """Poses on the device: the groups' draws in their places; all within reach of what was
    seen, by the program's projection, and an evidence as precise as it says."""
    draws = inference.resident_draws(model, photo, key=key(3), num_samples=3000)
    assert all(isinstance(part, jax.Array) for part in draws.poses)
    assert all(len(part) == 3000 and part.dtype == float for part in draws.poses)
    observation = photo.posterior(model, CANDIDATES).observations[0]
    home = device_groups(key(3), model, observation)
    assert RootSampler(model, observation, home).more(3000, PLENTY)
    for one in home:
        limbs, own = GROUPS[one.name], one.draws()[one.name]
        upper = draws.poses.upper[:, np.array([limb.upper for limb in limbs])]
        assert np.array_equal(upper, own.upper[:3000])
        used = np.array([bone.length_group for bone in limbs[0].bones])
        assert np.array_equal(draws.poses.length[:, used], own.length[:3000])
        if limbs[0].lower is not None:
            lower = draws.poses.lower[:, np.array([limb.lower for limb in limbs])]
            assert np.array_equal(lower, own.lower[:3000])
    joints = jax.jit(jax.vmap(lambda *pose: model.joints(observation.view, *pose)))(*draws.poses)
    assert np.isfinite(np.asarray(observation.log_ratios(joints))).all()
    known = inference.evidence(model, photo, key=key(1))["body"]
    error = np.hypot(known.standard_error, draws.log_evidence_se)
    assert abs(known.log_evidence - draws.log_evidence) < 4 * error


def test_what_cannot_be_drawn_is_said(model, photo):
    with pytest.raises(BadInput, match="at least 1, not 0"):
        inference.resident_draws(model, photo, key=key(0), num_samples=0)
    with pytest.raises(BadInput, match="no candidate 7; choose from 0 to"):
        inference.resident_draws(model, photo, key=key(0), num_samples=5, candidate=7)
    few = inference.resident_draws(model, photo, key=key(0), num_samples=5, max_proposals=10)
    assert len(few.poses.length) == 0
    assert few.num_proposals == 0


@pytest.mark.slow
def test_a_command_draws_on_the_device(model, photo):
    """The whole way home: the same face as every sampler."""
    result = inference.sample(
        model, photo, sampler="rejection-device", key=key(0), num_samples=2000, root="candidates"
    )
    assert result.status == COMPLETE
    assert result.num_draws == 2000
    assert model.limits.check(result.tree["posterior"].joints.values).valid.all()
    short = inference.sample(
        model,
        photo,
        sampler="rejection-device",
        key=key(0),
        num_samples=10**6,
        max_proposals=300_000,
        root="candidates",
    )
    assert short.status == OUT_OF_BUDGET
    keypoints = np.array(photo.detection.keypoints)
    keypoints[JOINT_INDEX["left_ankle"]] += 5000.0
    gone = dataclasses.replace(
        photo, detection=dataclasses.replace(photo.detection, keypoints=keypoints)
    )
    nobody = inference.sample(
        model, gone, sampler="rejection-device", key=key(0), num_samples=10, root="candidates"
    )
    assert nobody.status == IMPOSSIBLE
