"""The strata of exact rejection: random numbers and lengths they are drawn with, and bounds that
must be bounds.

False alarms: every family of p-values is held to 0.001 altogether (Bonferroni); seeds are fixed.
"""

import dataclasses
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import inference
from inference.exact.groups import RESOLUTIONS, StratifiedGroup, group_tables, plan_group
from inference.exact.loops import numbers
from inference.exact.loops.attempts import attempt_bodies
from inference.exact.loops.bins import SLICES, alias_table, draw_lengths, length_bins
from inference.exact.loops.numbers import SOURCES, compiled, digest, load, seeded, store, uniform
from inference.exact.loops.rectangles import COUNT, ROWS, largest_rectangle, rectangle
from inference.exact.loops.series import arcsine, cosine, sine, small_sine_cosine
from inference.exact.loops.strata import Resolution, Sight
from inference.exact.loops.strata import _stratify as stratify_loop
from inference.exact.problem import limb_problems
from inference.exact.rates import Budget, Pooled, Rate
from probmodel import Anatomy, PoseModel
from probmodel.anatomy.limits import CELL, NUM_ELEVATION, cell_of
from probmodel.kinematics import lower_axes
from tests.goodness import energy_p_value
from tests.scenes import hidden, key, prior_scene
from tests.witnesses.limbs import build_groups
from tests.witnesses.patches import patch_rectangle
from tests.witnesses.pruned import PriorGroups, group_prior

FAMILY = 1e-3


@compiled
def _numbers(state, found):
    stream = load(state)
    for index in range(found.size):
        found[index], stream = uniform(stream)
    store(state, stream)


def test_the_numbers_are_numpys_to_the_bit():
    """Also across two calls: the stream goes on where it stopped."""
    state, found = seeded([7, 11], 3, 1), np.empty(1000)
    _numbers(state, found[:300])
    _numbers(state, found[300:])
    generator = np.random.Generator(
        np.random.SFC64(np.random.SeedSequence([7, 11], spawn_key=(3, 1)))
    )
    assert np.array_equal(found, generator.random(1000))
    assert not np.array_equal(seeded([7, 11], 3, 1), seeded([7, 11], 3, 2))


def test_compiled_loops_are_kept_by_the_state_of_all_their_sources():
    """What a compiled file imports from the product is a source too, or its change would go unseen;
    another text is another folder; and that is where the loops are."""
    root = Path(numbers.__file__).parents[3]
    texts = {source: (root / source).read_bytes() for source in SOURCES}
    for source in SOURCES:
        if source.startswith("inference"):
            imported = re.findall(
                r"^from ((?:inference|probmodel)[.\w]*) import",
                texts[source].decode(),
                re.MULTILINE,
            )
            assert {name.replace(".", "/") + ".py" for name in imported} <= set(SOURCES)
        changed = {**texts, source: texts[source] + b"\n"}
        assert digest(changed.values()) != digest(texts.values())
    for loop in (attempt_bodies, draw_lengths, rectangle):
        assert f"loops-{digest(texts.values())}" in loop.stats.cache_path


@pytest.mark.parametrize(
    ("alpha", "beta"), [(5.0, 7.0), (0.5, 0.7), (1.0, 1.0), (2.3, 60.0), (1.5, 0.4), (0.9, 3.0)]
)
def test_lengths_follow_the_prior_inside_their_bin(alpha, beta):
    """Kolmogorov–Smirnov against scipy's Beta in every bin, also where the density has no bound."""
    bins = length_bins(0.8, 1.2, alpha, beta, 4)
    law, values, cuts = stats.beta(alpha, beta), [], np.linspace(0, 1, 5)
    np.testing.assert_allclose(bins.mass, np.diff(law.cdf(cuts)), rtol=1e-9, atol=1e-300)
    for index in np.flatnonzero(bins.mass > 1e-12):
        lengths = np.empty(20_000)
        draw_lengths(bins.shape, bins.slices, index, seeded([1], index), lengths)
        low, high = law.cdf(cuts[index : index + 2])
        values.append(
            stats.kstest((law.cdf((lengths - 0.8) / 0.4) - low) / (high - low), "uniform").pvalue
        )
    assert min(values) * len(values) > FAMILY


def test_a_wrong_envelope_is_caught():
    """Negative control of the test above: an envelope 10 % too low in half of the slices."""
    bins = length_bins(0.8, 1.2, 5.0, 7.0, 4)
    slices = bins.slices.copy()
    slices[SLICES : SLICES + SLICES // 2, 4:] *= [0.0, 0.9]
    slices[SLICES : SLICES + SLICES // 2, 5] *= 0.9
    law, lengths = stats.beta(5.0, 7.0, loc=0.8, scale=0.4), np.empty(200_000)
    draw_lengths(bins.shape, slices, 1, seeded([1], 1), lengths)
    low, high = law.cdf(bins.edges[1:3])
    assert stats.kstest((law.cdf(lengths) - low) / (high - low), "uniform").pvalue < FAMILY


def test_alias_tables_hold_their_weights():
    """The mass that a table gives to each entry, summed over its columns, is the weight, zeros
    included."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 17, 400):
        weight = rng.exponential(size=size) * (rng.uniform(size=size) < 0.7) + (
            np.arange(size) == 0
        )
        table = np.zeros((size, 2))
        alias_table(weight, table)
        given = np.bincount(np.arange(size), table[:, 0], size)
        given += np.bincount(table[:, 1].astype(int), 1 - table[:, 0], size)
        np.testing.assert_allclose(given / size, weight / weight.sum(), atol=1e-12)


def test_the_series_are_sine_and_arcsine():
    """Against NumPy, ends and beyond included."""
    angles = np.concatenate([np.linspace(-np.pi / 2, np.pi / 2, 2001), [1e-300, 0.0]])
    small = np.linspace(-0.03, 0.03, 201)
    values = np.concatenate(
        [
            np.linspace(-1, 1, 2001),
            [0.5, np.nextafter(0.5, 1), 1e-200],
            np.array([-np.inf, -1.5, 7]),
        ]
    )
    for ours, theirs, where in (
        (sine, np.sin, angles),
        (cosine, np.cos, angles),
        (arcsine, lambda v: np.arcsin(np.clip(v, -1, 1)), values),
    ):
        np.testing.assert_allclose(
            [ours(value) for value in where], theirs(where), rtol=0, atol=5e-16
        )
    pairs = np.array([small_sine_cosine(value) for value in small])
    np.testing.assert_allclose(
        pairs, np.stack([np.sin(small), np.cos(small)], axis=1), rtol=0, atol=3e-16
    )


def test_the_rectangle_is_the_one_of_the_pruned_proposal_and_its_largest_is():
    """Against the JAX formula; the largest over a range against a fine grid of distances and
    radii."""
    rng = np.random.default_rng(1)
    for distance, radius in zip(rng.uniform(0, 1.6, 300), rng.uniform(0.01, 1.5, 300), strict=True):
        ours = rectangle(distance, radius)
        if distance - radius < 1:
            np.testing.assert_allclose(
                ours, patch_rectangle(jnp.asarray(distance), jnp.asarray(radius)), atol=1e-12
            )
        farthest = distance + rng.exponential(0.1)
        grid = [
            rectangle(d, r)
            for d in np.linspace(distance, farthest, 40)
            for r in np.linspace(0.8, 1, 5) * radius
        ]
        assert max(2 * w * (high - low) for w, low, high in grid) <= largest_rectangle(
            distance, farthest, radius
        )


def limb_draws(model, seed, number):
    """Every limb of two bones: its name, its place in the group, draws of the prior, and what they
    look like."""
    frame = prior_scene(model, seed)
    groups = build_groups(model, frame.observation)
    for name in ("arms", "legs"):
        draws = group_prior(key(seed), groups[name], number)
        reach = np.asarray(groups[name].reach(draws))
        for row in range(2):
            yield name, row, groups[name], [np.asarray(part) for part in draws], reach


def violation(strata, group, row, sight, resolution, edges, length, upper, lower) -> str:
    """What is wrong with the strata for a pose that explains the detection: its own stratum must be
    there, hold its lower bone, and be bounded. Empty where all is well. Angles are taken anew from
    the definitions."""
    column, line = (int(index) for index in cell_of(jnp.asarray(upper)))
    azimuth, elevation = np.arctan2(upper[1], upper[0]), np.arcsin(np.clip(upper[2], -1, 1))
    across = int(((azimuth + np.pi) / CELL - column) * resolution.sub)
    along = int(((elevation + np.pi / 2) / CELL - line) * resolution.sub)
    middle = (column + (across + 0.5) / resolution.sub) * CELL - np.pi
    one, two = (
        int(np.searchsorted(edge, size) - 1) for edge, size in zip(edges, length, strict=True)
    )
    index = one * resolution.second + two
    first, last = strata.starts[index], strata.starts[index + 1]
    subs = strata.subs[strata.entries[first:last, 2].astype(int)]
    height = np.sin((line + (along + 0.5) / resolution.sub) * CELL - np.pi / 2)
    wanted = np.array([column * NUM_ELEVATION + line, np.sin(middle), np.cos(middle), height])
    place = np.flatnonzero(np.all(np.abs(subs[:, :4] - wanted) < 1e-9, axis=1))
    if not len(place):
        return "dropped"
    entry = first + place[0]
    mask, bound = int(strata.pieces[entry]), strata.entries[entry, 3]
    frame = np.asarray(group.frame[row])
    bone = -frame @ np.asarray(lower_axes(upper, group.reference, group.fallback[row])) @ lower
    centre = (sight.target[1] + length[0] * frame[:2] @ upper) / length[1]
    distance = np.linalg.norm(centre)
    width, low, high = (
        float(part) for part in patch_rectangle(jnp.asarray(distance), sight.radius[1] / length[1])
    )
    if mask == 0:
        hinge = [
            np.asarray(leaf)[row, column, line] for leaf in (group.hinges.triple, group.hinges.box)
        ]
        u1, u2, u3 = hinge[0] @ lower
        turn, box = np.arctan2(u3, -u1), hinge[1]
        inside = box[0] <= u2 <= box[1] and box[2] <= turn <= box[3]
        return (
            ""
            if inside and bound >= (box[1] - box[0]) * min(box[3] - box[2], 2 * np.pi) - 1e-9
            else "box"
        )
    towards = centre / distance
    x, along = bone[1] * towards[0] - bone[0] * towards[1], bone[:2] @ towards
    angle = np.arcsin(np.clip(along / np.sqrt(1 - x**2), -1, 1))
    if abs(x) > width + 1e-9 or not low - 1e-9 <= angle <= high + 1e-9:
        return "outside"
    piece = min(int((angle - low) / (high - low) * ROWS), ROWS - 1) + (ROWS if bone[2] < 0 else 0)
    if not mask >> piece & 1:
        return "piece"
    return "" if 2 * width * (high - low) / ROWS <= bound else "bound"


def violations(model, seed, factor, resolution, tighten=1.0, number=60):
    """Poses of the prior against strata made for their own detections, jittered inside tiny to huge
    discs."""
    rng = np.random.default_rng(seed)
    found = []
    for name, row, group, (length, upper, lower), reach in limb_draws(model, seed, number):
        anatomy = group_tables(model)[name]
        anatomy = anatomy._replace(builds=anatomy.builds[row : row + 1])
        for n in range(len(length)):
            radius = factor * rng.uniform(0.3, 2, 2)
            turn, way = rng.uniform(0, 2 * np.pi, 2), radius * np.sqrt(rng.uniform(size=2))
            target = reach[n, row] + way[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
            sight = Sight(np.array(group.frame[row]), target, radius)
            narrow = sight._replace(radius=radius * tighten)
            plan = plan_group(anatomy, (narrow,), resolution)
            edges = [bins.edges for bins in plan.bins]
            found.append(
                violation(
                    plan.strata[0],
                    group,
                    row,
                    sight,
                    resolution,
                    edges,
                    length[n],
                    upper[n, row],
                    lower[n, row],
                )
            )
    return found


@pytest.mark.parametrize("factor", [0.01, 0.25, 1.5])
def test_bounds_are_bounds(factor):
    """Tries to break them: bones near the poles and the reference direction, foreshortened limbs,
    whatever the prior has in store, in 120 frames of one limb each."""
    assert not any(violations(PoseModel(), 0, factor, RESOLUTIONS[0], number=30))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.001, 0.05, 0.25, 1.0, 5.0])
def test_bounds_are_bounds_in_every_measure_and_table(shared_data, factor):
    for anatomy in (
        Anatomy.default(),
        Anatomy.load(shared_data / "akhter_black" / "jointAngleModel_v2.mat"),
    ):
        for upper, lower in (("angle", "area"), ("angle", "box")):
            model = PoseModel.from_anatomy(anatomy, upper=upper, lower=lower)
            for seed in (10, 11):
                assert not any(violations(model, seed, factor, RESOLUTIONS[0]))


@pytest.mark.slow
def test_bounds_are_bounds_where_cells_are_cut():
    for factor in (0.02, 0.3):
        assert not any(violations(PoseModel(), 20, factor, Resolution(6, 5, 2)))


def test_a_bound_two_percent_too_tight_is_caught():
    """Negative control of the tests above: strata made for discs 2 % too small."""
    assert any(violations(PoseModel(), 0, 0.05, RESOLUTIONS[0], tighten=0.98))


def stratified(model, frame, name, seed) -> StratifiedGroup:
    limbs = limb_problems(frame.observation)
    return StratifiedGroup(key(seed), name, group_tables(model)[name], limbs[name])


def test_same_key_same_draws_and_more_are_added_at_the_end():
    model = PoseModel()
    frame = prior_scene(model, 2)
    one, again, other = (stratified(model, frame, "arms", seed) for seed in (7, 7, 8))
    for sampler in (one, again, other):
        assert sampler.more(500, Budget(10**9))
    first = one.draws()["arms"].upper[:500].copy()
    assert np.array_equal(first, again.draws()["arms"].upper[:500])
    assert not np.array_equal(first, other.draws()["arms"].upper[:500])
    assert one.more(1500, Budget(10**9))
    assert np.array_equal(first, one.draws()["arms"].upper[:500])


def test_every_resolution_draws_from_one_law():
    """Energy-distance permutation test of coarse against fine strata, lengths and directions of the
    arms; and the evidence within 3 standard errors."""
    model = PoseModel()
    frame = prior_scene(model, 2)
    found = []
    for level in (0, 1, 3):
        sampler = stratified(model, frame, "arms", level)
        sampler._plan = sampler.plan_at(level)
        sampler._rates, sampler.level = [Rate(0, 0, sampler._plan.mass)], 3
        assert sampler.more(3000, Budget(10**9))
        found.append(
            (
                np.concatenate(
                    [part.reshape(len(part), -1) for part in sampler.draws()["arms"]], axis=1
                )[:1500],
                sampler.rates[0],
            )
        )
    rng = np.random.default_rng(3)
    values = [energy_p_value(found[0][0], other, rng) for other, _ in found[1:]]
    assert min(values) * len(values) > FAMILY
    for _, rate in found[1:]:
        error = np.sqrt(rate.variance + found[0][1].variance)
        assert abs(rate.log_probability - found[0][1].log_probability) < 3 * error
    # Finer is better: the acceptance rate grows.
    coarse, fine = found[0][1].rates[0], found[2][1].rates[0]
    assert coarse.accepted / coarse.proposed < fine.accepted / fine.proposed


def test_pooled_rates_are_one_rate_where_they_are_alike():
    whole, half = Rate(1000, 100, 0.5), Rate(500, 50, 0.5)
    np.testing.assert_allclose(Pooled((half, half)).log_probability, whole.log_probability)
    np.testing.assert_allclose(Pooled((half, half)).variance, whole.variance)
    assert Pooled((Rate(10, 0, 0.5),)).log_probability == -np.inf


def test_masks_keep_what_they_say():
    assert COUNT[0b1011] == 3
    assert COUNT.sum() == ROWS * 2 ** (2 * ROWS)


def test_a_frame_that_no_pose_explains_has_no_strata():
    model = PoseModel()
    frame = prior_scene(model, 2)
    keypoints = np.array(frame.detection.keypoints)
    keypoints[4] += 2000.0
    frame = dataclasses.replace(
        frame, detection=dataclasses.replace(frame.detection, keypoints=keypoints)
    )
    assert stratified(model, frame, "arms", 0).hopeless
    assert inference.sample(model, frame, key=key(0), num_samples=10).num_draws == 0


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_strata_follow_group_rejection_on_all_frames_of_the_benchmark(part):
    """The 64 frames, arms and legs of each, discs wide enough for draws of the prior to hit:
    energy-distance permutation tests of all coordinates together, Kolmogorov–Smirnov tests of each,
    evidence within 4 standard errors (6e-5 each). False-alarm rate 0.001 for each of the four
    parts."""
    model, rng = PoseModel(), np.random.default_rng(part)
    energies, coordinates = [], []
    for index in range(16 * part, 16 * part + 16):
        frame = prior_scene(model, index, factor=1.0, missing=hidden(index))
        groups = build_groups(model, frame.observation)
        for name in ("arms", "legs"):
            simple = PriorGroups(key(index), {name: groups[name]})
            assert simple.more(250, Budget(10**9))
            fast = stratified(model, frame, name, 1000 + index)
            assert fast.more(2000, Budget(10**9))
            ours, theirs = (columns_of(sampler.draws()[name]) for sampler in (fast, simple))
            energies.append(energy_p_value(ours[:500], theirs[:250], rng))
            coordinates += [
                stats.ks_2samp(*pair).pvalue for pair in zip(ours.T, theirs.T, strict=True)
            ]
            one, two = fast.rates[0], simple.rates[0]
            assert abs(one.log_probability - two.log_probability) < 4 * np.sqrt(
                one.variance + two.variance
            )
    assert min(energies) * len(energies) > FAMILY / 2
    assert min(coordinates) * len(coordinates) > FAMILY / 2


def columns_of(draws) -> np.ndarray:
    """All coordinates of a group's draws, `(n, …)`."""
    return np.concatenate([np.asarray(part).reshape(len(part), -1) for part in draws], axis=1)


@pytest.mark.slow
def test_strata_for_discs_too_small_draw_another_law(monkeypatch):
    """Negative control of the test above: strata made for discs of half the size, tested with the
    whole ones. (Two percent are caught by the bounds' own test; no test on draws could see
    them.)"""
    model = PoseModel()
    frame = prior_scene(model, 0, factor=1.0)
    right, wrong = (stratified(model, frame, "arms", seed) for seed in (1, 2))
    wrong._limbs = tuple(sight._replace(radius=sight.radius / 2) for sight in right._limbs)
    wrong._plan = wrong.plan_at(0)
    wrong._limbs = right._limbs
    monkeypatch.setattr(wrong, "_refine", lambda number: None)
    for sampler in (right, wrong):
        assert sampler.more(2000, Budget(10**9))
    pairs = zip(
        columns_of(right.draws()["arms"]).T, columns_of(wrong.draws()["arms"]).T, strict=True
    )
    assert min(stats.ks_2samp(*pair).pvalue for pair in pairs) < FAMILY / 14


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Explicitly requested dtype")
def test_the_loops_do_not_mind_32_bit_floats():
    """The same frame where JAX computes in 32 bits: the same evidence within 3 standard errors, no
    loop made anew."""
    frame = prior_scene(PoseModel(), 2)
    whole = inference.sample(PoseModel(), frame, key=key(0), num_samples=3000).tree.attrs
    compiled_before = len(stratify_loop.signatures)
    with jax.enable_x64(False):
        half = inference.sample(PoseModel(), frame, key=key(1), num_samples=3000).tree.attrs
    assert len(stratify_loop.signatures) == compiled_before
    error = np.hypot(whole["log_evidence_se"], half["log_evidence_se"])
    assert abs(whole["log_evidence"] - half["log_evidence"]) < 3 * error
