"""Left and right that stay in a film: exchanges of sides that motion tells of."""

import dataclasses
import itertools

import numpy as np
import pytest

from poseterior.inference import film_of, open_stream, sample_film, sample_frames
from poseterior.inference.estimators import Estimating
from poseterior.inference.films import sides
from poseterior.inference.films.sides import EXCHANGE_LASTS, in_chain, straightness, with_sides
from poseterior.inference.footage import Item
from poseterior.probmodel import BadInput, Detection, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, ORDERS, FaultPrior
from poseterior.probmodel.errors.times import ErrorTimes
from poseterior.probmodel.skeleton import JOINT_INDEX
from tests.scenes import key, prior_scene

RATE, UNIT, NOISE = 30.0, 200.0, 0.03
"""Frames a second, pixels of a body unit, and body units by which keypoints stray."""
FEW = FaultPrior.of(0.0, 0.05)
LIKELIHOOD = Likelihood(factor=2 * NOISE, faults=FEW)


def walking(frames: int, rng: np.random.Generator) -> np.ndarray:
    """`(frames, 15, 2)` body units: somebody walks to the right, arms and legs in turn, so that
    they pass each other in the image twice a second."""
    phase = 2 * np.pi * np.arange(frames) / RATE
    found = np.zeros((frames, 15, 2))
    swing = {"knee": 0.3, "ankle": 0.7, "elbow": 0.2, "wrist": 0.5, "hip": 0.1, "shoulder": 0.1}
    height = {"shoulder": 0.0, "elbow": 1.0, "wrist": 2.0, "hip": 1.6, "knee": 3.0, "ankle": 4.3}
    for side, sign in (("left", 1), ("right", -1)):
        for kind, size in swing.items():
            # Arms go against legs; what is nearer to the camera lies a little lower.
            way = sign if kind in ("knee", "ankle", "hip") else -sign
            found[:, JOINT_INDEX[f"{side}_{kind}"], 0] = way * size * np.sin(phase)
            found[:, JOINT_INDEX[f"{side}_{kind}"], 1] = height[kind] + 0.05 * sign
    for kind in ("hip", "shoulder"):  # seen a little from the front
        found[:, [JOINT_INDEX[f"{side}_{kind}"] for side in ("left", "right")], 0] += [0.2, -0.2]
    found[..., 0] += phase[:, None] / 4
    return found + NOISE * rng.standard_normal(found.shape)


def items_of(keypoints: np.ndarray, exchange: np.ndarray) -> list[Item]:
    """Frames of these keypoints, under the names that exchanges leave them."""
    found = []
    for row, (own, one) in enumerate(zip(UNIT * keypoints, exchange, strict=True)):
        named = Detection(own[ORDERS[one]], np.ones(15), "skeleton", "walk", 0)
        found.append(Item(f"walk_{row:03d}/0", named))
    return found


def planted(frames: int, runs: dict[int, tuple[str, int]]) -> np.ndarray:
    """What is exchanged: by the first frame of a run, what and for how many frames."""
    found = np.zeros(frames, int)
    for first, (what, number) in runs.items():
        found[first : first + number] = EXCHANGE_INDEX[what]
    return found


RUNS = {
    **{8: ("legs", 1), 20: ("arms", 5), 37: ("body", 1), 50: ("legs", 30)},
    **{90: ("body", 5), 100: ("upper half", 3), 110: ("lower half", 3)},
}


def told(items: list[Item]) -> np.ndarray:
    """The most probable exchange of each frame."""
    rest = np.array([item.exchange for item in items])
    return np.column_stack([1 - rest.sum(axis=1), rest]).argmax(axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_runs_of_exchanged_sides_are_found_though_legs_pass_each_other(seed):
    """120 frames with 48 exchanged ones, halves with hips and shoulders among them."""
    exchange = planted(120, RUNS)
    keypoints = walking(120, np.random.default_rng(seed))
    found = told(with_sides(items_of(keypoints, exchange), RATE, LIKELIHOOD))
    assert (found != exchange).mean() < 0.03
    assert not told(with_sides(items_of(keypoints, 0 * exchange), RATE, LIKELIHOOD)).any()


def test_control_without_motion_nothing_is_found(monkeypatch):
    monkeypatch.setattr(sides, "OVERLAP", 0.0)
    items = items_of(walking(120, np.random.default_rng(0)), planted(120, RUNS))
    assert not told(with_sides(items, RATE, LIKELIHOOD)).any()


def test_a_chain_is_the_sum_over_all_that_may_have_been():
    """Against every one of 6⁵ courses, by its own probability; probabilities of zero stay."""
    rng = np.random.default_rng(1)
    moments = np.array([0.0, 0.1, 0.15, 0.6, 0.7])
    prior = np.array([0.7, 0.1, 0.1, 0.0, 0.0, 0.1])
    weight = rng.random((3, 6, 6, 6))
    total = np.zeros((5, 6))
    for course in itertools.product(range(6), repeat=5):
        chance = prior[course[0]]
        for row, (one, other) in enumerate(itertools.pairwise(course)):
            stays = np.exp(-(moments[row + 1] - moments[row]) / EXCHANGE_LASTS)
            chance *= stays * (one == other) + (1 - stays) * prior[other]
        for row in range(3):
            chance *= weight[row][course[row : row + 3]]
        total[range(5), course] += chance
    expected = total / total.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(in_chain(weight, moments, prior), expected, atol=1e-14)
    assert np.abs(in_chain(weight[::-1], moments, prior) - expected).max() > 0.01  # control


TIMES = ErrorTimes(0.2, 0.5, 0.3, 0.4, 0.1, 0.4, RATE, np.full(4, np.nan))


def weight_by_hand(points, deviation, moments, times, at, course) -> float:
    """Log weight of one course of three frames, joint by joint: Student's law of how far the third
    lies from where the first two lead."""
    first, second = moments[at + 1] - moments[at], moments[at + 2] - moments[at + 1]
    on = second / first
    parts = np.array([on, -1 - on, 1.0])
    total = 0.0
    for kind, bend in sides.BENDS.items():
        scale = bend * ((first + second) * 15) ** sides.GROWTH
        left, right = JOINT_INDEX[f"left_{kind}"], JOINT_INDEX[f"right_{kind}"]
        spread = [np.mean(deviation[at + row, [left, right]] ** 2) ** 0.5 for row in range(3)]
        noise = 0.0
        for one, other in itertools.product(range(3), repeat=2):
            apart = abs(moments[at + one] - moments[at + other])
            alike = float(one == other)
            if times is not None:
                alike *= times.quick
                alike += times.constant + times.slow * np.exp(-apart / times.seconds)
            noise += parts[one] * parts[other] * alike * spread[one] * spread[other]
        for joint in (left, right):
            where = [points[at + row, ORDERS[course[row]][joint]] for row in range(3)]
            bent = sum(part * one for part, one in zip(parts, where, strict=True))
            total -= 2 / 3 * np.log(1 + bent @ bent / (2 * (scale**2 + noise)))
    return total


@pytest.mark.parametrize("times", [None, TIMES])
def test_weights_are_those_of_every_joint_by_hand(times):
    rng = np.random.default_rng(2)
    points = 0.2 * rng.standard_normal((4, 15, 2))
    deviation = 0.05 + 0.1 * rng.random((4, 15))
    moments = np.array([0.0, 0.03, 0.09, 0.11])
    found = np.log(straightness(points, deviation, moments, times))
    for at in range(2):
        courses = [*itertools.product(range(6), repeat=3)]
        by_hand = [weight_by_hand(points, deviation, moments, times, at, one) for one in courses]
        np.testing.assert_allclose(found[at].ravel(), by_hand - np.max(by_hand), atol=1e-10)
    other = np.log(straightness(points, 2 * deviation, moments, times))
    assert np.abs(other - found).max() > 0.1  # control


def test_joints_that_are_not_seen_on_both_sides_say_nothing():
    points = walking(9, np.random.default_rng(3))
    deviation, moments = np.full((9, 15), NOISE), np.arange(9) / RATE
    whole = straightness(points, deviation, moments, None)
    points[4, JOINT_INDEX["left_ankle"]] = np.nan
    part = straightness(points, deviation, moments, None)
    assert (np.abs(whole - part).max(axis=(1, 2, 3)) > 0).tolist() == [0, 0, 1, 1, 1, 0, 0]
    points[4] = np.nan
    nothing = straightness(points, deviation, moments, None)
    np.testing.assert_array_equal(nothing[2:5], 1)


def test_frames_are_told_in_the_order_of_their_numbers_and_gaps_count():
    exchange = planted(120, RUNS)
    items = items_of(walking(120, np.random.default_rng(0)), exchange)
    items[30] = items[30]._replace(frame="nothing is seen; look again")
    del items[70:75]
    found = [*with_sides(items, RATE, LIKELIHOOD)]
    order = np.random.default_rng(5).permutation(len(items))
    mixed = [*with_sides([items[row] for row in order], RATE, LIKELIHOOD)]
    assert [found[row] for row in order] == mixed
    assert found[30] == items[30]
    seen = np.delete(np.arange(120), [30, *range(70, 75)])
    rest = [one for at, one in enumerate(found) if at != 30]
    assert (told(rest) != exchange[seen]).mean() < 0.03


def test_a_frame_that_cannot_be_drawn_says_nothing_and_stops_no_other():
    """Of a score so far below the others that its joint has no radius."""
    exchange = planted(120, RUNS)
    items = items_of(walking(120, np.random.default_rng(0)), exchange)
    score = np.ones(15)
    score[JOINT_INDEX["left_knee"]] = 5e-324
    items[70] = items[70]._replace(frame=dataclasses.replace(items[70].frame, score=score))
    with pytest.raises(BadInput, match="too far below the others"):
        LIKELIHOOD.detected(items[70].frame)
    assert (told(with_sides(items, RATE, LIKELIHOOD)) != exchange).mean() < 0.03


def test_little_or_nothing_to_tell_leaves_frames_as_they_are():
    items = items_of(walking(5, np.random.default_rng(0)), np.zeros(5, int))
    assert with_sides(items, RATE, Likelihood()) == items
    assert with_sides(items[:2], RATE, LIKELIHOOD) == items[:2]


def test_a_probability_that_rounding_takes_beyond_one_is_one():
    assert sides._rounded(np.array([1 + 4e-16, 0, 0, 0, 0, 0])) == (0.0,) * 5


def test_where_no_limbs_are_seen_nothing_is_told():
    items = items_of(walking(5, np.random.default_rng(0)), np.zeros(5, int))
    dots = np.zeros((15, 2))
    still = [one._replace(frame=dataclasses.replace(one.frame, keypoints=dots)) for one in items]
    assert with_sides(still, RATE, LIKELIHOOD) == still


def test_few_values_are_told_and_none_is_beyond_doubt():
    rng = np.random.default_rng(6)
    exchange = planted(120, RUNS)
    items = with_sides(items_of(walking(120, rng), exchange), RATE, LIKELIHOOD)
    assert len({item.exchange for item in items}) < 12
    for item in items:
        FaultPrior(exchange=item.exchange)  # what is left for "none" is above zero
    quiet = with_sides(items_of(walking(120, rng), 0 * exchange), RATE, LIKELIHOOD)
    assert sum(item.exchange == (0.0,) * 5 for item in quiet) > 80


def test_frames_are_drawn_as_motion_tells(tmp_path):
    """The same detection, of which motion says that its legs are exchanged with odds of one, and of
    nine: the odds of its draws are nine times as large, too. By eight other keys and twice as many
    roots the logarithm of the ratio is 2.21 ± 0.08 (that of nine: 2.20), of one key ± 0.3."""
    model = PoseModel()
    scene = prior_scene(model, 3, factor=0.6)
    legs, likelihood = EXCHANGE_INDEX["legs"], dataclasses.replace(scene.likelihood, faults=FEW)
    odds = [0.5, 0.9]
    said = np.zeros((2, 5))
    said[:, legs - 1] = odds
    items = [
        Item(f"frame {row}", scene.detection, tuple(each)) for row, each in enumerate(said.tolist())
    ]
    sample_frames(
        model,
        items,
        key=key(0),
        out=tmp_path,
        estimating=Estimating(likelihood=likelihood),
        num_roots=400,
        num_samples=400,
        k=1,
    )
    found = open_stream(tmp_path)["summary"].exchange.values
    assert found[:, [0, legs]].sum(axis=1) == pytest.approx(1)
    even, more = found[:, legs] / found[:, 0]
    assert 0 < even < 1
    assert np.log(more / even) == pytest.approx(np.log(9), abs=1.0)


def test_films_have_the_rate_by_which_sides_were_told(tmp_path):
    """A film of three frames in which nothing is exchanged: of another rate it is refused, as a
    film and where it goes on; and what is impossible in a frame has probability zero there."""
    model = PoseModel()
    scene = prior_scene(model, 3, factor=0.6)
    likelihood = dataclasses.replace(scene.likelihood, faults=FEW)
    frames = [Item(f"frame_{row}/0", scene.detection) for row in range(3)]
    given = {
        "key": key(0),
        "estimating": Estimating(likelihood=likelihood),
        "num_paths": 20,
        "num_roots": 60,
        "k": 2,
    }
    out = sample_film(model, frames, rate=RATE, out=tmp_path / "film", **given)
    tree = open_stream(out / "frames")
    assert tree.attrs["sides_told_at"] == RATE
    exchange = tree["summary"].exchange.values
    assert np.isfinite(exchange).all()
    assert exchange[:, 0].min() > 0.5
    with pytest.raises(BadInput, match="told from how they follow each other at 30 a second"):
        film_of(out / "frames", rate=60.0, out=tmp_path / "other")
    with pytest.raises(BadInput, match=r"sides_told_at is 30\.0, not 60\.0"):
        sample_film(model, frames, rate=60.0, out=out, **given)
