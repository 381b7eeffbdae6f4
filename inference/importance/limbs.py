"""What the limbs say of many roots: each root's evidence without bias from a fixed
number of proposals, and the draws that these bring.

Every group of limbs gets the same number of proposals under every root, each with a
weight (`loops.weighted_limbs`). "Until one is accepted" would not do: the mean of such
a rate is not the rate. Groups share nothing, so a product of their estimates is
unbiased too; the two limbs of a group are proposed under the same lengths.
"""

import functools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.exact import warm_up
from poseterior.inference.exact.groups import GroupTables, group_tables, workers
from poseterior.inference.exact.loops.bins import length_bins
from poseterior.inference.exact.loops.line_of_sight import line_of_sight_frames
from poseterior.inference.exact.loops.pairs import combine_rows
from poseterior.inference.exact.loops.seeds import seeded_rows
from poseterior.inference.exact.loops.tables import (
    ACCEPTED,
    SIGHT_FRAMES,
    AcceptedRows,
    LimbTables,
    blank_bodies,
)
from poseterior.inference.exact.loops.weighted_limbs import draw_length_rows, propose_rows
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import ORDERS, Faults
from poseterior.probmodel.errors.laws import ErrorLaw, WithOutliers
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import GROUPS, NUM_JOINTS, NUM_UPPER, TORSO_INDEX

Effort = dict[int, tuple[int, int]]
"""By the number of limbs in a group: draws of the bones' lengths under each root, and
proposals for each limb under each of them."""
EFFORT: Effort = {1: (128, 4), 2: (16, 16)}
"""Under roots that matter a group's evidence is then known to 10 to 30 %, which costs
few effective roots. Two limbs explain their detections in pairs, and of these there are
the more, the more proposals share a length; the head hangs on its length alone."""
LIMBS = tuple(limb for members in GROUPS.values() for limb in members)
ENDS = np.array([[bone.end for bone in (*limb.bones, *limb.bones)[:2]] for limb in LIMBS])
"""`(5, 2)`: the joints of each limb, from the torso outwards; the head's twice."""
CHAINED = np.array([limb.lower is not None for limb in LIMBS])
DRAWS_PER_ROOT = 64
"""Draws of a group under one root: any of them are as good as all."""
POOL_SIZE = 4096
"""Draws of the prior that stand for it: for groups of which nothing was seen, which are
the same under every root, and for first-stage weights."""
ROOTS_PER_BLOCK = 1024
"""Roots that are worked on at a time, which bounds the memory."""
ROOTS_PER_TASK = 64
"""Roots that a thread works on at a time."""


def proposals_of(effort: Effort) -> int:
    """Proposals for the limbs of one root."""
    return sum(math.prod(effort[len(limbs)]) * len(limbs) for limbs in GROUPS.values())


LIMB_PROPOSALS = proposals_of(EFFORT)


class LimbDraws(NamedTuple):
    """What the proposals for one group bring under one root: the log of its estimated
    evidence, -inf where nothing explained the detections, and `draws`, all of one
    weight."""

    log_evidence: float
    draws: GroupDraws


class LimbSampling(NamedTuple):
    """What limbs are sampled by, the same under every root: the model's `tables`, draws
    of the prior for the groups that are `free`, the `words` of the key, the `law` of
    errors, and the `effort`."""

    tables: dict[str, GroupTables]
    free: dict[str, GroupDraws]
    words: list[int]
    law: ErrorLaw
    effort: Effort


class Views(NamedTuple):
    """What limbs see of roots, body units: local `axes` `(n, 5, 3, 3)` of the upper
    bones in camera axes, the torso's joints, `start` `(n, 6, 3)`, the detections,
    `target` `(n, 15, 2)`, how far from there joints may fall, `reach` `(n, 15)`, the
    `spread` `(n, 15)` of their errors; the lines of sight, `ray` `(n, 15, 2)`, and one
    over the pelvis' distance, `nearness` `(n,)`, which are 0 where no focal length is
    known."""

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
    """For each of the roots and fault patterns `(n, ...)`, what the proposals for its
    limbs bring, by group; root `i` has random numbers of its own, whatever comes before
    it."""
    tables = group_tables(posterior.model)
    free = free_groups(posterior, words)
    sampling = LimbSampling(tables, free, words, posterior.detected.law, effort)
    for start in range(0, len(points.torso), ROOTS_PER_BLOCK):
        part = slice(start, start + ROOTS_PER_BLOCK)
        views = views_of(posterior, points.take(part), faults.take(part))
        outlier = outliers_of(posterior, faults.take(part))
        rows = [
            slice(first, first + ROOTS_PER_TASK) for first in range(0, len(outlier), ROOTS_PER_TASK)
        ]
        tasks = [
            (Views(*(column[row] for column in views)), outlier[row], start + row.start)
            for row in rows
        ]
        weigh = functools.partial(weigh_limbs, sampling)
        for block in workers().map(weigh, *zip(*tasks, strict=True)):
            yield from block


def views_of(posterior: Posterior, points: RootPoint, faults: Faults) -> Views:
    """The views of roots and fault patterns `(n, ...)`, compiled once."""
    view = functools.partial(_views, posterior.model, posterior.detected)
    return Views(*in_chunks(view, *jax.tree.leaves(points), *faults, size=ROOTS_PER_BLOCK))


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
    """`(n, 15)`: the joints whose keypoints are outliers in patterns of faults `(n,
    ...)`."""
    counts = np.isfinite(np.asarray(posterior.detected.spread))
    order = ORDERS[faults.exchange]
    return np.take_along_axis(faults.outlier, order, axis=1) & counts[order]


@kept
def _views(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> tuple[jax.Array, ...]:
    """The columns of `Views`."""
    prior = TorsoCameraPrior.of(model)

    def one(point: RootPoint, faults: Faults) -> tuple[jax.Array, ...]:
        lens = prior.lens_of(point.lens)
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

    return jax.vmap(one)(RootPoint(*fields[:-2]), Faults(*fields[-2:]))


def frames_of(views: Views, outlier: np.ndarray) -> list[np.ndarray]:
    """Of every limb the line-of-sight frames `(n, 2)` `SIGHT_FRAMES` of its joints; a
    joint that was not seen, or is not there, may fall anywhere."""
    starts = [TORSO_INDEX.index(limb.bones[0].start) for limb in LIMBS]
    # One layout in memory and one precision, or numba would compile for each of them.
    plain = functools.partial(np.array, dtype=float, order="C")
    nearness = plain(views.nearness)
    limbs = []
    for limb, ends, row, chained in zip(LIMBS, ENDS, starts, CHAINED, strict=True):
        frames = np.zeros((len(nearness), 2), SIGHT_FRAMES)
        frames["reach"] = views.reach[:, ends]
        if not chained:
            frames["reach"][:, 1] = np.inf
        frames["spread"] = views.spread[:, ends]
        frames["outlier"] = outlier[:, ends]
        line_of_sight_frames(
            plain(views.axes[:, limb.upper]),
            plain(views.start[:, row]),
            plain(views.target[:, ends]),
            plain(views.ray[:, ends]),
            nearness,
            frames,
        )
        limbs.append(frames)
    return limbs


def weigh_limbs(
    sampling: LimbSampling, views: Views, outlier: np.ndarray, first: int
) -> list[dict[str, LimbDraws]]:
    """All groups under some roots, of which the first has this number; those that are
    free from draws of the prior."""
    warm_up.wait()
    number = len(outlier)
    limbs = frames_of(views, outlier)
    results: list[dict[str, LimbDraws]] = [{} for _ in range(number)]
    for index, name in enumerate(GROUPS):
        own = [frames for frames, limb in zip(limbs, LIMBS, strict=True) if limb in GROUPS[name]]
        paths = np.column_stack([first + np.arange(number), np.full(number, index)])
        if name in sampling.free:
            free = sampling.free[name]
            draws = [_free(free, sampling.words, *path) for path in paths.tolist()]
        else:
            states = seeded_rows(sampling.words, paths)
            effort = sampling.effort[len(own)]
            draws = weigh_group(sampling.tables[name], own, sampling.law, states, effort)
        for result, one in zip(results, draws, strict=True):
            result[name] = one
    return results


def weigh_group(
    tables: GroupTables,
    limbs: list[np.ndarray],
    law: ErrorLaw,
    states: np.ndarray,
    effort: tuple[int, int],
) -> list[LimbDraws]:
    """One group, given the `SIGHT_FRAMES` `(n, 2)` of its limbs under roots whose
    random numbers have these `states` `(n, 4)`; the `effort` as in `Effort`."""
    num_lengths, per_length = effort
    number = len(states)
    lengths = np.ones((2, number, num_lengths))
    for column, parameters in enumerate(tables.lengths.tolist()):
        draw_length_rows(states, length_bins(*parameters, 1), lengths[column])
    accepted = [
        _weigh_limb(states, frames, build, law, lengths, per_length)
        for frames, build in zip(limbs, tables.builds, strict=True)
    ]
    if len(limbs) == 1:
        accepted.append(_certain(number, num_lengths, per_length))
    bodies = blank_bodies(number * DRAWS_PER_ROOT, len(limbs))
    evidence = combine_rows(states, *accepted, lengths, per_length, bodies)
    columns = bodies.length[:, : len(tables.lengths)], bodies.upper, bodies.lower
    draws = []
    for row, own in enumerate(evidence.tolist()):
        first = row * DRAWS_PER_ROOT
        rows = slice(first, first + DRAWS_PER_ROOT) if own else slice(0)
        part = GroupDraws(*(column[rows] for column in columns))
        draws.append(LimbDraws(math.log(own) if own else -math.inf, part))
    return draws


def _weigh_limb(
    states: np.ndarray,
    frames: np.ndarray,
    build: LimbTables,
    law: ErrorLaw,
    lengths: np.ndarray,
    per_length: int,
) -> AcceptedRows:
    """The weighted proposals for one limb that explain its detections."""
    own = WithOutliers(law, np.ascontiguousarray(frames["outlier"]))
    precision = np.where(np.isfinite(frames["reach"]), own.precision, 0.0)
    deviation = np.zeros(frames.shape)
    np.divide(frames["spread"], np.sqrt(precision), out=deviation, where=precision > 0)
    frames["deviation"] = deviation
    rows = np.empty(len(states) * lengths.shape[2] * per_length, ACCEPTED)
    ends = propose_rows(states, frames, build, lengths, per_length, rows)
    accepted = AcceptedRows(rows[: ends[-1]], ends)
    if not law.follows(law.precision):
        accepted.rows["weight"] *= _corrections(own, frames, accepted)
    return accepted


def _certain(number: int, num_lengths: int, per_length: int) -> AcceptedRows:
    """The proposals for a limb that is not there, and so explains everything."""
    rows = np.zeros(number * num_lengths, ACCEPTED)
    rows["draw"] = np.tile(np.arange(num_lengths), number)
    rows["weight"] = per_length
    return AcceptedRows(rows, np.arange(1, number + 1) * num_lengths)


def _corrections(law: WithOutliers, frames: np.ndarray, accepted: AcceptedRows) -> np.ndarray:
    """`(m,)`: of each proposal, the likelihood over that of the envelopes by which its
    joints were proposed."""
    rows = np.repeat(np.arange(len(accepted.ends)), np.diff(accepted.ends, prepend=0))
    counts = np.isfinite(frames["reach"])
    square = accepted.rows["square"] / np.where(counts, frames["spread"], 1.0)[rows] ** 2
    law = WithOutliers(law.inlier, law.outlier[rows])
    return np.exp(np.where(counts[rows], law.log_over(square, law.precision), 0.0).sum(axis=1))


def _free(draws: GroupDraws, words: list[int], *path: int) -> LimbDraws:
    """Some draws of the prior, for a group of which nothing was seen."""
    rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(*path, 0)))
    some = rng.choice(POOL_SIZE, DRAWS_PER_ROOT, replace=False)
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
    chained = any(limb.lower is not None for name in free for limb in GROUPS[name])
    poses = prior_poses(posterior.model, words, lower=chained)
    return {name: GroupDraws.of(poses, GROUPS[name]) for name in free}


def prior_poses(model: PoseModel, words: list[int], *, lower: bool = True) -> Pose:
    """`POOL_SIZE` draws of the prior, those of the lower bones left blank where these
    are not asked for: of detectors that say nothing of the head."""
    # Directions first: JAX compiles them while the other process compiles the loops.
    directions = _directions if lower else _upper_directions
    upper, *rest = map(np.asarray, directions(model, np.array(words, np.uint32)))
    return Pose(_prior_lengths(model, words), upper, *rest or [Pose.blank(POOL_SIZE).lower])


def _prior_lengths(model: PoseModel, words: list[int]) -> np.ndarray:
    """`(POOL_SIZE, 5)`: bone lengths of the prior, by the loop that has those of every
    root; what JAX makes of Beta's draws compiles for three seconds."""
    warm_up.wait()
    states = seeded_rows(words, np.array([[0, len(GROUPS)]]))  # after those of the root's groups
    columns = np.stack([np.asarray(field, float) for field in model.lengths], axis=1)
    lengths = np.empty((len(columns), 1, POOL_SIZE))
    for parameters, column in zip(columns.tolist(), lengths, strict=True):
        draw_length_rows(states, length_bins(*parameters, 1), column)
    return np.ascontiguousarray(lengths[:, 0].T)


@kept
def _directions(model: PoseModel, words: ArrayLike) -> tuple[jax.Array, ...]:
    """Upper and lower ones; as a tuple, whose program can be kept: tracing it takes
    longer than all that it draws."""
    return tuple(model.draw(jax.random.wrap_key_data(jnp.asarray(words)), POOL_SIZE)[1:])


@kept
def _upper_directions(model: PoseModel, words: ArrayLike) -> tuple[jax.Array, ...]:
    """The same upper ones; compiled in a third of the time, which a first call waits
    for."""
    return tuple(model.draw(jax.random.wrap_key_data(jnp.asarray(words)), POOL_SIZE)[1:2])


def log_evidence(found: dict[str, LimbDraws]) -> float:
    """Log of the unbiased estimate of the limbs' evidence under one root."""
    return math.fsum(one.log_evidence for one in found.values())


def picks(rng: np.random.Generator, held: int, number: int) -> np.ndarray:
    """`(number,)`: which of so many draws held are taken, each as often as the others,
    in random order."""
    rounds = range(-(-number // held))
    return np.concatenate([rng.permutation(held) for _ in rounds])[:number]
