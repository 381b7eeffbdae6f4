"""What the limbs say of many roots: each root's evidence without bias from a fixed number of
attempts, and the draws that these attempts bring.

Every root is cut coarsely (`RESOLUTION`), which costs next to nothing, and every group of limbs
makes the same number of attempts under every root. "Until one is accepted" would not do: the mean
of such a rate is not the rate. Groups share nothing, so a product of their estimates is unbiased
too; the two limbs of a group are attempted together, with lengths in common.
"""

import functools
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from inference.exact.groups import GroupTables, attempt_group, group_tables, plan_group, workers
from inference.exact.loops.numbers import seeded
from inference.exact.loops.strata import Resolution
from inference.exact.loops.tables import Bodies
from inference.exact.problem import limbs_of
from inference.exact.rates import Rate
from inference.resampling import systematic
from probmodel.chunks import in_chunks
from probmodel.faults import Faults
from probmodel.kinematics import upper_axes
from probmodel.model import PoseModel
from probmodel.pose import GroupDraws, Pose
from probmodel.roots import RootPoint, RootPrior
from probmodel.skeleton import GROUPS
from probmodel.uncertain import DetectedJoints, UncertainPosterior

RESOLUTION = Resolution(2, 2, 1)
"""How finely each root is cut: set-up and attempts then cost about as much."""
ATTEMPTS = {"head": 256, "arms": 2048, "legs": 2048}
"""Attempts at each group under each root, enough for some dozens of draws under roots that
matter."""
KEPT = 64
"""Most draws that are kept of a group under one root: any of them are as good as all."""
POOL = 4096
"""Draws of the prior that stand for it: for groups of which nothing was seen, which are the same
under every root, and for what the others promise."""
BLOCK = 512
"""Roots that are worked on at a time, which bounds the memory."""


class LimbDraws(NamedTuple):
    """What attempts at one group brought under one root: the `rate` of successes, each counted with
    its likelihood over the peak, and `draws`, in random order, as often as that says."""

    rate: Rate
    draws: GroupDraws


class Views(NamedTuple):
    """What limbs see of roots: local `axes` `(n, 5, 3, 3)` of the upper bones in camera axes, where
    the torso's joints fall, `start` `(n, 6, 2)`, the detections, `target` `(n, 15, 2)`, and how far
    from there joints may fall, `reach` `(n, 15)`; body units."""

    axes: Any
    start: Any
    target: Any
    reach: Any


def limb_draws(
    posterior: UncertainPosterior, points: RootPoint, faults: Faults, words: list[int]
) -> Iterator[dict[str, LimbDraws]]:
    """For each of the roots and patterns of faults `(n, ...)`, the attempts at its limbs by group;
    root `i` has random numbers of its own, whatever comes before it."""
    tables, free = group_tables(posterior.model), free_groups(posterior, words)
    for start in range(0, len(points.torso), BLOCK):
        part = slice(start, start + BLOCK)
        some = points.take(part), faults.take(part)
        views = views_of(posterior, *some)
        rows = range(len(views.target))
        numbers = [start + row for row in rows]
        attempt = functools.partial(_attempt, tables, free, words, views)
        found = list(workers().map(attempt, rows, numbers, chunksize=1))
        yield from _weighed(posterior, *some, found, words, start)


def views_of(posterior: UncertainPosterior, points: RootPoint, faults: Faults) -> Views:
    """The views of roots and patterns `(n, ...)`, compiled once."""
    look = functools.partial(_look, posterior.model, posterior.detected)
    return in_chunks(look, *map(np.asarray, points), *faults, size=BLOCK)


@jax.jit
def _look(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> Views:
    prior = RootPrior(model.torsos, model.upright)

    def one(point: RootPoint, faults: Faults) -> Views:
        observation = detected.under(prior, point, faults)
        view = observation.view
        return Views(
            upper_axes(view),
            observation.root.camera.flatten(view),
            jnp.asarray(observation.target),
            observation.law.reach * observation.spread,
        )

    return jax.vmap(one)(RootPoint(*fields[:4]), Faults(*fields[4:]))


def _attempt(
    tables: dict[str, GroupTables],
    free: dict[str, GroupDraws],
    words: list[int],
    views: Views,
    row: int,
    number: int,
) -> dict[str, tuple[Rate, GroupDraws]]:
    """All groups under one root: rates and draws within reach."""
    problems = limbs_of(*(np.array(part[row], float) for part in views))
    found = {}
    for index, (name, limbs) in enumerate(problems.items()):
        rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(number, index, 0)))
        if name in free:
            some = rng.choice(POOL, KEPT, replace=False)
            found[name] = Rate(KEPT, KEPT), GroupDraws(*(part[some] for part in free[name]))
            continue
        plan = plan_group(tables[name], limbs, RESOLUTION, alone=True)
        bodies = NOTHING[len(limbs)]
        if plan.mass:
            state, order = seeded(words, number, index, 1), list(range(len(limbs)))
            attempts = (plan, tables[name], limbs, order, rng, state, ATTEMPTS[name])
            bodies, _ = attempt_group(*attempts)
        bones = len(tables[name].lengths)
        draws = GroupDraws(bodies.length[:, :bones], bodies.upper, bodies.lower)
        found[name] = Rate(ATTEMPTS[name], len(draws.length), plan.mass), draws
    return found


NOTHING = {
    limbs: Bodies(np.zeros((0, 2)), np.zeros((0, limbs, 3)), np.zeros((0, limbs, 3)))
    for limbs in (1, 2)
}
"""No draws, by the number of a group's limbs."""


def free_groups(posterior: UncertainPosterior, words: list[int]) -> dict[str, GroupDraws]:
    """Draws of the prior for the groups of which no joint counts."""
    counts = np.isfinite(posterior.detected.spread)
    free = [
        name
        for name, limbs in GROUPS.items()
        if not any(counts[bone.end] for limb in limbs for bone in limb.bones)
    ]
    if not free:
        return {}
    poses = prior_poses(posterior.model, words)
    return {name: GroupDraws.of(poses, GROUPS[name]) for name in free}


def prior_poses(model: PoseModel, words: list[int]) -> Pose:
    """`POOL` draws of the prior."""
    key = jax.random.wrap_key_data(jnp.asarray(words, jnp.uint32))
    return Pose(*map(np.asarray, _prior(model, key)))


@jax.jit
def _prior(model: PoseModel, key: jax.Array) -> Pose:
    return model.draw(key, POOL)


def _weighed(
    posterior: UncertainPosterior,
    points: RootPoint,
    faults: Faults,
    found: Sequence[dict[str, tuple[Rate, GroupDraws]]],
    words: list[int],
    first: int,
) -> list[dict[str, LimbDraws]]:
    """Draws of a block of roots with their rates.

    Where the error law is not flat, a success counts with its likelihood over the peak, and draws
    are taken anew by it. To keep each or not, by the same ratio, would be as right: but four joints
    of a Gaussian keep one draw in 400, and the rate is then hardly ever known.
    """
    results: list[dict[str, LimbDraws]] = [{} for _ in found]
    for index, name in enumerate(GROUPS):
        draws = [one[name][1] for one in found]
        rates = [one[name][0] for one in found]
        if not posterior.detected.law.flat:
            rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(first, index, 2)))
            ratios = _ratios(posterior, points, faults, name, draws)
            rates = [
                rate._replace(accepted=float(own.sum()))
                for rate, own in zip(rates, ratios, strict=True)
            ]
            draws = [_anew(some, own, rng) for some, own in zip(draws, ratios, strict=True)]
        for row, (some, rate) in enumerate(zip(draws, rates, strict=True)):
            kept = GroupDraws(*(part[:KEPT] for part in some))
            results[row][name] = LimbDraws(rate, kept)
    return results


def _anew(draws: GroupDraws, ratio: np.ndarray, rng: np.random.Generator) -> GroupDraws:
    """`KEPT` draws, each as often as its ratio says, in random order; none where there are none."""
    if not ratio.any():
        return GroupDraws(*(part[:0] for part in draws))
    rows = rng.permutation(systematic(ratio, KEPT, rng.uniform()))
    return GroupDraws(*(part[rows] for part in draws))


def _ratios(
    posterior: UncertainPosterior,
    points: RootPoint,
    faults: Faults,
    name: str,
    draws: list[GroupDraws],
) -> list[np.ndarray]:
    """Of each draw of a group, a part for each root, the likelihood over the peak."""
    sizes = [len(some.length) for some in draws]
    if not sum(sizes):
        return [np.zeros(0) for _ in sizes]
    poses = Pose.blank(sum(sizes))
    GroupDraws(*(np.concatenate(part) for part in zip(*draws, strict=True))).fill(
        poses, GROUPS[name]
    )
    rows = np.repeat(np.arange(len(sizes)), sizes)
    ratios = in_chunks(
        functools.partial(_log_ratios, posterior.model, posterior.detected),
        *points.take(rows),
        *faults.take(rows),
        *poses,
    )
    ends = [bone.end for limb in GROUPS[name] for bone in limb.bones]
    whole = np.exp(ratios[:, ends].sum(axis=1, dtype=float))
    return np.split(whole, np.cumsum(sizes)[:-1])


@jax.jit
def _log_ratios(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    """`(n, 15)`: log likelihood of each joint over its peak, for roots and poses `(n, ...)`."""
    prior = RootPrior(model.torsos, model.upright)

    def one(point: RootPoint, faults: Faults, pose: Pose) -> jax.Array:
        observation = detected.under(prior, point, faults)
        return observation.log_ratios(model.joints(observation.view, *pose))

    return jax.vmap(one)(RootPoint(*fields[:4]), Faults(*fields[4:6]), Pose(*fields[6:]))


def log_evidence(found: dict[str, LimbDraws]) -> float:
    """Log of the unbiased estimate of the limbs' evidence under one root."""
    return math.fsum(one.rate.log_probability for one in found.values())


def picks(rng: np.random.Generator, held: int, number: int) -> np.ndarray:
    """`(number,)`: which of so many draws held are taken, each as often as the others, in random
    order."""
    rounds = -(-number // held)
    orders = itertools.repeat(None, rounds)
    return np.concatenate([rng.permutation(held) for _ in orders])[:number]
