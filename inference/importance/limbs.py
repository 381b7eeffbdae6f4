"""What the limbs say of many roots: each root's evidence without bias from a fixed number of
attempts, and the draws that these attempts bring.

Every group of limbs makes the same number of attempts under every root, each with a weight
(`loops.weighed`). "Until one is accepted" would not do: the mean of such a rate is not the rate.
Groups share nothing, so a product of their estimates is unbiased too; the two limbs of a group are
attempted under the same lengths.
"""

import functools
import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.exact import ahead
from poseterior.inference.exact.groups import GroupTables, group_tables, workers
from poseterior.inference.exact.loops.bins import length_bins
from poseterior.inference.exact.loops.pairs import combine_rows
from poseterior.inference.exact.loops.seeds import seeded_rows
from poseterior.inference.exact.loops.sights import see_rows
from poseterior.inference.exact.loops.tables import FOUND, OPTICS, blank_bodies
from poseterior.inference.exact.loops.weighed import attempt_rows, draw_trials
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.faults import ORDERS, Faults
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.likelihood import ErrorLaw, WithOutliers
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import GROUPS, NUM_JOINTS, NUM_UPPER, TORSO_INDEX

Effort = dict[int, tuple[int, int]]
"""By the number of limbs in a group: lengths of the bones under each root, and attempts at each
limb under each of them."""
EFFORT: Effort = {1: (128, 4), 2: (16, 16)}
"""Under roots that matter a group's evidence is then known to 10 to 30 %, which costs few effective
roots. Two limbs explain their detections in pairs, the more the more attempts they share a length
with; the head hangs on its length alone."""
LIMBS = tuple(limb for members in GROUPS.values() for limb in members)
ENDS = np.array([[bone.end for bone in (*limb.bones, *limb.bones)[:2]] for limb in LIMBS])
"""`(5, 2)`: the joints of each limb, from the torso outwards; the head's twice."""
CHAINED = np.array([limb.lower is not None for limb in LIMBS])
KEPT = 64
"""Draws that are kept of a group under one root: any of them are as good as all."""
POOL = 4096
"""Draws of the prior that stand for it: for groups of which nothing was seen, which are the same
under every root, and for what limbs promise."""
BLOCK = 1024
"""Roots that are worked on at a time, which bounds the memory."""
TASK = 64
"""Roots that a thread works on at a time."""


def attempts_of(effort: Effort) -> int:
    """Attempts at the limbs of one root."""
    return sum(math.prod(effort[len(limbs)]) * len(limbs) for limbs in GROUPS.values())


ATTEMPTS = attempts_of(EFFORT)


class LimbDraws(NamedTuple):
    """What attempts at one group brought under one root: the log of its estimated evidence, -inf
    where nothing explained the detections, and `draws`, all of one weight."""

    log_evidence: float
    draws: GroupDraws


class Views(NamedTuple):
    """What limbs see of roots, body units: local `axes` `(n, 5, 3, 3)` of the upper bones in camera
    axes, the torso's joints, `start` `(n, 6, 3)`, the detections, `target` `(n, 15, 2)`, how far
    from there joints may fall, `reach` `(n, 15)`, the `spread` `(n, 15)` of their errors; the lines
    of sight, `ray` `(n, 15, 2)`, and one over the pelvis' distance, `nearness` `(n,)`, which are 0
    where no focal length is known."""

    axes: Any
    start: Any
    target: Any
    reach: Any
    spread: Any
    ray: Any
    nearness: Any


def limb_draws(
    posterior: Posterior,
    points: RootPoint,
    faults: Faults,
    words: list[int],
    effort: Effort = EFFORT,
) -> Iterator[dict[str, LimbDraws]]:
    """For each of the roots and patterns of faults `(n, ...)`, the attempts at its limbs by group;
    root `i` has random numbers of its own, whatever comes before it."""
    tables, free = group_tables(posterior.model), free_groups(posterior, words)
    law = posterior.detected.law
    for start in range(0, len(points.torso), BLOCK):
        part = slice(start, start + BLOCK)
        some = points.take(part), faults.take(part)
        views, outlier = views_of(posterior, *some), outliers_of(posterior, some[1])
        rows = [slice(first, first + TASK) for first in range(0, len(outlier), TASK)]
        tasks = [
            (Views(*(column[row] for column in views)), outlier[row], start + row.start)
            for row in rows
        ]
        attempt = functools.partial(attempt_limbs, tables, free, words, law, effort)
        for found in workers().map(attempt, *zip(*tasks, strict=True)):
            yield from found


def views_of(posterior: Posterior, points: RootPoint, faults: Faults) -> Views:
    """The views of roots and patterns `(n, ...)`, compiled once."""
    look = functools.partial(_look, posterior.model, posterior.detected)
    return Views(*in_chunks(look, *map(np.asarray, points), *faults, size=BLOCK))


def blind(number: int) -> Views:
    """Views of so many roots that see nothing."""
    joints = np.ones((number, NUM_JOINTS))
    return Views(
        axes=np.tile(np.eye(3), (number, NUM_UPPER, 1, 1)),
        start=np.zeros((number, len(TORSO_INDEX), 3)),
        target=np.zeros((*joints.shape, 2)),
        reach=np.inf * joints,
        spread=joints,
        ray=np.zeros((*joints.shape, 2)),
        nearness=np.zeros(number),
    )


def outliers_of(posterior: Posterior, faults: Faults) -> np.ndarray:
    """`(n, 15)`: the joints whose keypoints are outliers in patterns of faults `(n, ...)`."""
    counts = np.isfinite(np.asarray(posterior.detected.spread))
    order = ORDERS[faults.exchange]
    return np.take_along_axis(faults.outlier, order, axis=1) & counts[order]


@kept
def _look(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> tuple[jax.Array, ...]:
    """The columns of `Views`."""
    prior, lens = TorsoCameraPrior.of(model), model.lens

    def one(point: RootPoint, faults: Faults) -> tuple[jax.Array, ...]:
        observation = detected.under(prior, point, faults)
        view = observation.view
        return (
            upper_axes(view),
            view,
            jnp.asarray(observation.target),
            jnp.asarray(observation.law.reach * observation.spread),
            jnp.asarray(observation.spread),
            jnp.asarray(detected.read(faults).rays(lens)),
            jnp.exp(point.log_scale) / (jnp.inf if lens is None else lens.focal),
        )

    return jax.vmap(one)(RootPoint(*fields[:4]), Faults(*fields[4:]))


class Sight(NamedTuple):
    """What one limb sees of roots, as `attempt_rows` takes it. Each of its two joints is seen in
    axes of its own, whose third runs along the line of sight to where it was detected.

    Attributes
    ----------
    axes : `(n, 2, 3, 3)` the upper bone's local frame in these axes
    target : `(n, 2, 2)` the detections minus the limb's start, across the line of sight
    reach, spread : `(n, 2)` of the joints' errors
    optics : `(n, 2)` `OPTICS`
    outlier : `(n, 2)` whether they are outliers
    """

    axes: np.ndarray
    target: np.ndarray
    reach: np.ndarray
    spread: np.ndarray
    optics: np.ndarray
    outlier: np.ndarray


def sights_of(views: Views, outlier: np.ndarray) -> list[Sight]:
    """That of every limb; a joint that was not seen, or is not there, may fall anywhere."""
    starts = [TORSO_INDEX.index(limb.bones[0].start) for limb in LIMBS]
    # One layout in memory and one precision, or numba would compile for each of them.
    plain = functools.partial(np.array, dtype=float, order="C")
    nearness, sights = plain(views.nearness), []
    for limb, ends, row, chained in zip(LIMBS, ENDS, starts, CHAINED, strict=True):
        reach, spread = plain(views.reach[:, ends]), plain(views.spread[:, ends])
        reach[:, 1] = reach[:, 1] if chained else np.inf
        axes, start = plain(views.axes[:, limb.upper]), plain(views.start[:, row])
        target, ray = plain(views.target[:, ends]), plain(views.ray[:, ends])
        own, across = np.empty((*reach.shape, 3, 3)), np.empty((*reach.shape, 2))
        optics, counts = np.empty(reach.shape, OPTICS), np.isfinite(reach)
        see_rows(axes, start, target, ray, nearness, counts, own, across, optics)
        wrong = np.ascontiguousarray(outlier[:, ends])
        sights.append(Sight(own, across, reach, spread, optics, wrong))
    return sights


def attempt_limbs(
    tables: dict[str, GroupTables],
    free: dict[str, GroupDraws],
    words: list[int],
    law: ErrorLaw,
    effort: Effort,
    views: Views,
    outlier: np.ndarray,
    first: int,
) -> list[dict[str, LimbDraws]]:
    """All groups under some roots, of which the first has this number; those that are `free` from
    draws of the prior."""
    ahead.wait()
    number, sights = len(outlier), sights_of(views, outlier)
    results: list[dict[str, LimbDraws]] = [{} for _ in range(number)]
    for index, name in enumerate(GROUPS):
        own = [sight for sight, limb in zip(sights, LIMBS, strict=True) if limb in GROUPS[name]]
        paths = np.column_stack([first + np.arange(number), np.full(number, index)])
        if name in free:
            found = [_free(free[name], words, *path) for path in paths.tolist()]
        else:
            states = seeded_rows(words, paths)
            found = weigh_group(tables[name], own, law, states, *effort[len(own)])
        for result, one in zip(results, found, strict=True):
            result[name] = one
    return results


def weigh_group(
    tables: GroupTables,
    sights: list[Sight],
    law: ErrorLaw,
    states: np.ndarray,
    trials: int,
    each: int,
) -> list[LimbDraws]:
    """One group under roots `(n, ...)` whose random numbers have these `states` `(n, 4)`: `each`
    attempts at each limb under each of so many lengths."""
    number, bones = len(states), len(tables.lengths)
    lengths = np.ones((2, number, trials))
    for column, parameters in enumerate(tables.lengths.tolist()):
        draw_trials(states, length_bins(*parameters, 1), lengths[column])
    limbs = []
    for sight, build in zip(sights, tables.builds, strict=True):
        found, ends = np.empty(number * trials * each, FOUND), np.zeros(number, np.int64)
        own = WithOutliers(law, sight.outlier)
        precision = np.where(np.isfinite(sight.reach), own.precision, 0.0)
        deviation = np.zeros_like(sight.reach)
        np.divide(sight.spread, np.sqrt(precision), out=deviation, where=precision > 0)
        attempt_rows(
            states, *sight[:3], deviation, sight.optics, build, *lengths, each, found, ends
        )
        found = found[: ends[-1]]
        if not law.follows(law.precision):
            found["weight"] *= _corrections(own, sight, found, ends)
        limbs.append((found, ends))
    first, second = limbs if len(limbs) == 2 else (*limbs, _certain(number, trials, each))
    evidence, bodies = np.zeros(number), blank_bodies(number * KEPT, len(limbs))
    combine_rows(states, *first, *second, lengths, each, evidence, bodies)
    draws = bodies.length[:, :bones], bodies.upper, bodies.lower
    return [
        LimbDraws(math.log(found), GroupDraws(*(part[row * KEPT :][:KEPT] for part in draws)))
        if found
        else LimbDraws(-math.inf, GroupDraws(*(part[:0] for part in draws)))
        for row, found in enumerate(evidence.tolist())
    ]


def _certain(number: int, trials: int, each: int) -> tuple[np.ndarray, np.ndarray]:
    """As `attempt_rows` leaves them, attempts at a limb that is not there, and explains all."""
    found = np.zeros(number * trials, FOUND)
    found["trial"], found["weight"] = np.tile(np.arange(trials), number), each
    return found, np.arange(1, number + 1) * trials


def _corrections(
    law: WithOutliers, sight: Sight, found: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """`(m,)`: of each attempt found, the likelihood over that of the envelopes by which its joints
    were proposed."""
    rows = np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
    counts = np.isfinite(sight.reach)
    square = found["square"] / np.where(counts, sight.spread, 1.0)[rows] ** 2
    law = WithOutliers(law.inlier, law.outlier[rows])
    return np.exp(np.where(counts[rows], law.log_over(square, law.precision), 0.0).sum(axis=1))


def _free(draws: GroupDraws, words: list[int], *path: int) -> LimbDraws:
    """Some draws of the prior, for a group of which nothing was seen."""
    rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(*path, 0)))
    some = rng.choice(POOL, KEPT, replace=False)
    return LimbDraws(0.0, GroupDraws(*(part[some] for part in draws)))


def free_groups(posterior: Posterior, words: list[int]) -> dict[str, GroupDraws]:
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
    return Pose(*map(np.asarray, _prior(model, np.array(words, np.uint32))))


@kept
def _prior(model: PoseModel, words: ArrayLike) -> tuple[jax.Array, ...]:
    """As a tuple, whose program can be kept: tracing it takes longer than all that it draws."""
    return tuple(model.draw(jax.random.wrap_key_data(jnp.asarray(words)), POOL))


def log_evidence(found: dict[str, LimbDraws]) -> float:
    """Log of the unbiased estimate of the limbs' evidence under one root."""
    return math.fsum(one.log_evidence for one in found.values())


def picks(rng: np.random.Generator, held: int, number: int) -> np.ndarray:
    """`(number,)`: which of so many draws held are taken, each as often as the others, in random
    order."""
    rounds = -(-number // held)
    orders = itertools.repeat(None, rounds)
    return np.concatenate([rng.permutation(held) for _ in orders])[:number]
