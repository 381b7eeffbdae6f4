"""A body from two views by another route: draws of one view's posterior, by the sampler that knows
a focal length, weighed by what the other view says of them."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
import pytest

from poseterior.inference.draws import place
from poseterior.inference.importance.views.weighted import WeightedViews, weigh_refined
from poseterior.probmodel import Gaussian, Likelihood, PoseModel
from poseterior.probmodel.instant import Instant, InstantPosterior
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import WorldPoint
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from tests.inference.test_views import bodies, seen, straight

INSTANTS, RUNS = 20, 6
DRAWN, ROOTS = 5000, 1000
WIDE, WIDER_STILL = (Likelihood(Gaussian(), factor=factor) for factor in (0.6, 0.8))
SEEN_TWICE = {*TORSO_INDEX, JOINT_INDEX["right_elbow"]}
ASKED = [JOINT_INDEX[name] for name in ("right_elbow", "right_wrist", "left_knee")]


class Asked(NamedTuple):
    """Of runs of one route: the log of each one's evidence `(RUNS,)`, and the means of quantities
    `(RUNS, q)`."""

    evidence: np.ndarray
    means: np.ndarray


def half_seen(row: int, model: PoseModel) -> Instant:
    """A body all of whose joints one camera sees, and another one torso and an elbow."""
    points, _, world = bodies(model, INSTANTS, seed=7)
    size = math.exp(points.log_size[row])
    first, second = seen(straight(4)[:2], world[row], size, WIDE, seed=row).views
    score = np.where([joint in SEEN_TWICE for joint in range(NUM_JOINTS)], 0.5, 0.0)
    keypoints = np.where(score[:, None] > 0, second.detection.keypoints, np.nan)
    person = dataclasses.replace(second.detection, keypoints=keypoints, score=score)
    views = first, dataclasses.replace(second, detection=person)
    return Instant("half seen", views).judged_by(WIDE, WIDER_STILL)


def quantities(points: WorldPoint, poses: Pose, posterior: InstantPosterior) -> np.ndarray:
    """`(n, 19)`: log size, three joints in the world, mm, and the squares of these about a place
    that both routes share."""
    size = np.exp(points.log_size)[:, None, None]
    joints = points.place[:, None] + size * np.asarray(place(posterior, points, poses)[0])
    flat = joints[:, ASKED].reshape(len(size), -1)
    return np.column_stack([points.log_size, flat, (flat - [0.0, 0.0, 950.0] * 3) ** 2])


def by_one_view(instant: Instant, model: PoseModel, run: int) -> tuple[float, np.ndarray]:
    """The log evidence, and means `(2, q)` from draws of the first view's posterior: by weights,
    and as if the second had not been."""
    both, alone = instant.posterior(model), instant.seen_by([0]).posterior(model)
    drawn = WeightedViews(num_roots=ROOTS).draw(alone, jax.random.key(run), DRAWN)
    pair = drawn.points, drawn.poses
    level = np.asarray(both.log_joint(*pair)) - np.asarray(alone.log_joint(*pair))
    whole = np.logaddexp.reduce(level)
    found, share = quantities(*pair, alone), np.exp(level - whole)
    evidence = drawn.attributes["log_evidence"] + whole - math.log(DRAWN)
    return evidence, np.stack([share @ found, found.mean(axis=0)])


def by_both_views(instant: Instant, model: PoseModel, run: int) -> tuple[float, np.ndarray]:
    """The same by the product."""
    posterior = instant.posterior(model)
    roots = weigh_refined(posterior, jax.random.key(100 + run), ROOTS)
    points, poses, _, _ = roots.draw_whole(np.random.default_rng(run), DRAWN)
    return roots.log_evidence, quantities(points, poses, posterior).mean(axis=0)


def asked(route: Callable, instant: Instant, model: PoseModel) -> Asked:
    found = [route(instant, model, run) for run in range(RUNS)]
    return Asked(*(np.array(part) for part in zip(*found, strict=True)))


def whole(runs: Asked, kept: np.ndarray) -> np.ndarray:
    """Log evidence and means of some runs together, each of which counts as its evidence does."""
    level = runs.evidence[kept]
    weight = np.exp(level - level.max())
    log_mean = level.max() + math.log(weight.mean())
    return np.append(log_mean, weight @ runs.means[kept] / weight.sum())


def judged(runs: Asked) -> tuple[np.ndarray, np.ndarray]:
    """Estimates, and standard errors by the jackknife over runs."""
    every = np.arange(RUNS)
    without = np.array([whole(runs, every[every != run]) for run in every])
    return whole(runs, every), np.sqrt((RUNS - 1) * without.var(axis=0))


def apart(one: list[Asked], other: list[Asked]) -> tuple[np.ndarray, np.ndarray]:
    """By quantity: the sum of differences over instants in its standard errors, and the root mean
    square of single ones in theirs."""
    (first, first_se), (second, second_se) = (
        (np.array(part) for part in zip(*map(judged, runs), strict=True)) for runs in (one, other)
    )
    off, error = first - second, np.hypot(first_se, second_se)
    # All instants count alike, whatever they say.
    single = off / error
    return single.sum(axis=0) / math.sqrt(len(single)), np.sqrt(np.mean(single**2, axis=0))


@pytest.mark.sweep
def test_bodies_of_two_views_are_those_of_one_view_weighed_by_the_other() -> None:
    """At 20 instants, evidence and 19 means; their signed sums within 5 of 1.3 standard deviations
    (a t of few runs scatters as much; false alarms below 1 in 10,000 for all 20 together), and
    root mean squares below 2. Controls that must fail: the second view left out, and its evidence
    half a nat too high."""
    model = PoseModel()
    instants = [half_seen(row, model) for row in range(INSTANTS)]
    product = [asked(by_both_views, one, model) for one in instants]
    both_ways = [asked(by_one_view, one, model) for one in instants]
    other, left_out = (
        [one._replace(means=one.means[:, way]) for one in both_ways] for way in (0, 1)
    )
    signed, single = apart(product, other)
    print("signed", signed.round(1), "single", single.round(2))
    errors = [np.array([judged(runs)[1] for runs in part])[:, 0] for part in (product, other)]
    print("standard errors of evidence", *(np.median(part).round(3) for part in errors))
    assert np.abs(signed).max() < 5 * 1.3
    assert single.max() < 2
    print("left out", apart(product, left_out)[1].round(1))
    assert apart(product, left_out)[1][1:].max() > 3
    higher = [one._replace(evidence=one.evidence + 0.5) for one in other]
    print("half a nat", apart(product, higher)[0][0])
    assert abs(apart(product, higher)[0][0]) > 5 * 1.3
