"""What the limbs of a placed body say: each root's evidence without bias from a fixed number of
proposals, weighed by the prior and by all views.

A proposal aims at where all views together have the joint, or at where one of them has it, or it is
one of the prior, which bounds its weight; the density of this mixture is known. Given root and
lengths the limbs are independent of each other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.importance.views.aims import (
    AimModes,
    Reach,
    SpatialAim,
    aim_of,
    aimed_density,
    draw_direction,
    modes_of,
    with_next,
)
from poseterior.inference.importance.views.sights import Sights, ViewJudge, log_exchange, sights_of
from poseterior.probmodel.anatomy.limits import cell_of
from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.instant import DetectedInstant, ViewFaults
from poseterior.probmodel.kinematics import lower_axes, upper_axes
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import WorldPrior
from poseterior.probmodel.roots import WorldPoint, WorldRoot
from poseterior.probmodel.skeleton import LOWER_BONES, NUM_LOWER, TORSO_INDEX, UPPER_BONES

PER_LIMB = 32
"""Proposals for each limb of each body."""
AIMED, ALONE, OF_PRIOR = 0.55, 0.25, 0.2
"""Shares of proposals: aimed by all views, by one alone, and from the prior."""
WRISTS = [bone.end for bone in LOWER_BONES]
CHAIN_LENGTHS = [
    [UPPER_BONES[row + 1].length_group, LOWER_BONES[row].length_group] for row in range(NUM_LOWER)
]
"""`(4, 2)`: the length groups of the limbs of two bones."""
HEAD_LENGTH = UPPER_BONES[0].length_group
BONE_STARTS = np.array([TORSO_INDEX.index(bone.start) for bone in UPPER_BONES])
"""`(5,)`: where the upper bones begin, among the torso's joints."""
LATTICE = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""By which the numbers of a bone's proposal step from one to the next: Roberts' (2018) sequence of
the cube, of which any run is spread out, so that wrists are for elbows of any weight."""
UNIFORMS = len(LATTICE)
"""Numbers that a bone's proposal takes."""


class Proposals(NamedTuple):
    """Weighted proposals for limbs.

    Attributes
    ----------
    log_weight : `(...)`
        Log of prior × density of the detections over proposal; -inf where it explains nothing.
    upper, lower : `(..., 3)`
        Local directions, as a `Pose` has them; of the head's `lower` nothing is said.
    """

    log_weight: jax.Array
    upper: jax.Array
    lower: jax.Array


class SeenJoint(NamedTuple):
    """A joint that a bone is to reach: what the views say of it, its `aims` by all of them and by
    one (leaves start with 2), and whether any sees it."""

    sights: Sights
    aims: SpatialAim
    seen: jax.Array


class TorsoInWorld(NamedTuple):
    """A placed torso: its joints, `torso` `(6, 3)` mm, its upper bones' `axes` `(5, 3, 3)`, mm a
    body unit, `size`, and the pelvis' `place`."""

    torso: jax.Array
    axes: jax.Array
    size: jax.Array
    place: jax.Array


def body_of(root: WorldRoot) -> TorsoInWorld:
    """That of one root."""
    view, camera = root.view, root.camera
    size, place = jnp.asarray(camera.size), jnp.asarray(camera.place)
    return TorsoInWorld(camera.world(view), upper_axes(view), size, place)


def _targets(judge: ViewJudge, sights: Sights, body: TorsoInWorld, alone: jax.Array) -> SeenJoint:
    """Those of all joints, leaves start with 15; `alone` `(15,)` decides the one view."""
    number = judge.rig.number

    def one(sights: Sights, alone: jax.Array) -> SeenJoint:
        order = jnp.cumsum(sights.counts)
        chosen = jnp.argmax(order > alone * order[-1])
        trusts = jnp.stack([jnp.ones(number), (jnp.arange(number) == chosen).astype(float)])
        aims = jax.vmap(aim_of, (None, None, 0, None, None))(
            judge.rig, sights, trusts, body.size, body.place
        )
        return SeenJoint(sights, aims, jnp.any(sights.counts))

    return jax.vmap(one, (1, 0))(sights, alone)


def _propose(
    uniforms: jax.Array, modes: AimModes, aims: SpatialAim, seen: jax.Array, of_prior: jax.Array
) -> jax.Array:
    """`(3,)`: a direction of the world by the mixture, from numbers `(3,)`; `of_prior` is the one
    that the prior proposes for the last two of them."""
    pick = jnp.where(seen, uniforms[0], 1.0)
    alone = (pick >= AIMED).astype(int)
    along = jnp.where(alone == 1, (pick - AIMED) / ALONE, pick / AIMED)
    own, axes = _at(modes, alone), aims.axes[alone]
    share = own.share[0]
    aimed = axes @ draw_direction(own, (along >= share).astype(int), uniforms[1:])
    return jnp.where(pick >= AIMED + ALONE, of_prior, aimed)


def _log_proposal(
    direction: jax.Array, modes: AimModes, aims: SpatialAim, seen: jax.Array, of_prior: jax.Array
) -> jax.Array:
    """`()`: log density per steradian of the mixture; `of_prior` is that of the prior's part."""
    every, alone = (aimed_density(_at(modes, row), aims.axes[row].T @ direction) for row in (0, 1))
    mixed = jnp.log(AIMED * every + ALONE * alone + OF_PRIOR * jnp.exp(of_prior))
    return jnp.where(seen, mixed, of_prior)


def _at(rows: AimModes, row: jax.Array | int) -> AimModes:
    return AimModes(*(part[row] for part in rows))


def _upper(
    uniforms: jax.Array, judge: ViewJudge, body: TorsoInWorld, bone: "UpperReach", length: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """An upper bone: its local direction, where it ends in the world, and the log of its weight."""
    modes = jax.vmap(modes_of, (0, None, None))(bone.target.aims, bone.start, length)
    prior = -bone.axes @ bone.cells.transport(uniforms[1:])
    direction = _propose(uniforms, modes, bone.target.aims, bone.target.seen, prior)
    local = -bone.axes.T @ direction
    inside = bone.cells.contains(local)
    log_prior = jnp.where(inside, bone.cells.log_density(local), -jnp.inf)
    log_proposal = _log_proposal(direction, modes, bone.target.aims, bone.target.seen, log_prior)
    end = bone.start + length * direction
    weight = log_prior - log_proposal + judge.log_limb(bone.target.sights, end, body.size)
    return local, end, jnp.where(inside, weight, -jnp.inf)


class UpperReach(NamedTuple):
    """What an upper bone is proposed by: the `cells` of its prior, its local `axes`, where it
    starts, mm, and the joint that it is to reach."""

    cells: Cells
    axes: jax.Array
    start: jax.Array
    target: SeenJoint


class LowerReach(NamedTuple):
    """The same of the bone below it: its hinges `(120, 60)`, the references of its axes, and the
    joint."""

    hinges: Hinge
    reference: jax.Array
    fallback: jax.Array
    target: SeenJoint


def _lower(
    uniforms: jax.Array,
    judge: ViewJudge,
    upper: UpperReach,
    below: LowerReach,
    elbow: tuple[jax.Array, jax.Array],
    lengths: tuple[jax.Array, jax.Array],
) -> tuple[jax.Array, jax.Array]:
    """The bone below an upper one, which has a local direction and ends somewhere (`elbow`): its
    local direction, and the log of its weight; `lengths` are the bone's in mm and a body unit."""
    local, begins = elbow
    length, size = lengths
    column, row = cell_of(local)
    hinge = jax.tree.map(lambda leaf: leaf[column, row], below.hinges)
    axes = -upper.axes @ lower_axes(local, below.reference, below.fallback)
    modes = jax.vmap(modes_of, (0, None, None))(below.target.aims, begins, length)
    low, high = jnp.maximum(hinge.box[0], -1.0), jnp.minimum(hinge.box[1], 1.0)
    first, last = hinge.box[2:]
    rise = low + (high - low) * uniforms[1]
    rho = jnp.sqrt(jnp.maximum(1 - rise**2, 0.0))
    turn = first + (last - first) * uniforms[2]
    boxed = jnp.array([-rho * jnp.cos(turn), rise, rho * jnp.sin(turn)]) @ hinge.triple
    direction = _propose(uniforms, modes, below.target.aims, below.target.seen, axes @ boxed)
    found = axes.T @ direction
    u1, u2, u3 = hinge.triple @ found
    angle = jnp.arctan2(u3, -u1)
    in_box = (low <= u2) & (u2 <= high) & (first <= angle) & (angle <= last)
    log_box = jnp.where(in_box, -jnp.log((high - low) * (last - first)), -jnp.inf)
    log_proposal = _log_proposal(direction, modes, below.target.aims, below.target.seen, log_box)
    inside = hinge.contains(found)
    weight = hinge.log_density(found) - log_proposal
    weight += judge.log_limb(below.target.sights, begins + length * direction, size)
    return found, jnp.where(inside & (hinge.total > 0), weight, -jnp.inf)


@kept
def weigh_bodies(
    model: PoseModel,
    detected: DetectedInstant,
    faulty: ViewFaults,
    prior: WorldPrior,
    words: ArrayLike,
    first: ArrayLike,
    *rows: ArrayLike,
) -> tuple:
    """What bodies and their exchanges say, `rows` of `WorldPoint`, lengths and exchanges
    `(n, ...)`, of which the first has the number `first`: each has random numbers of its own by the
    key's `words`.

    Returns
    -------
    `(n,)` log of the prior of root, lengths and exchanges × the density of the torso's keypoints;
    and the columns of `Proposals` `(n, 5, P)` for the limbs, the head first.
    """
    from poseterior.probmodel.anatomy.lengths import BoneLength

    every = ViewJudge.of(prior.rig, detected)
    key = jax.random.wrap_key_data(jnp.asarray(words))

    def one(
        number: jax.Array, point: WorldPoint, length: jax.Array, exchange: jax.Array
    ) -> tuple[jax.Array, tuple]:
        own = jax.random.fold_in(key, number)
        sights, root = sights_of(detected, faulty, exchange), prior.root(point)
        judge, body = every._replace(rig=root.camera.rig), body_of(root)
        options = judge.torso_options(sights, sights.sought(root), body.size, exchange)
        log_torso = prior.log_density(point) + log_exchange(faulty, exchange)
        log_torso += BoneLength(model.lengths, validate_args=False).log_prob(length)
        log_torso += jnp.sum(jax.nn.logsumexp(options, axis=1))
        return log_torso, tuple(_limbs(own, model, judge, body, length, sights))

    *root, length, exchange = map(jnp.asarray, rows)
    return jax.vmap(one)(
        jnp.asarray(first) + jnp.arange(len(exchange)), WorldPoint(*root), length, exchange
    )


def _limbs(
    key: jax.Array,
    model: PoseModel,
    judge: ViewJudge,
    body: TorsoInWorld,
    length: jax.Array,
    sights: Sights,
) -> Proposals:
    """Proposals `(5, P)` for the limbs of one body, the head first."""
    view_key, chain_key, head_key, order_key = jax.random.split(key, 4)
    every = _targets(judge, sights, body, jax.random.uniform(view_key, (sights.counts.shape[1],)))
    upper = [_upper_bone(model, body, every, row) for row in range(len(UPPER_BONES))]
    chained = jax.tree.map(lambda *rows: jnp.stack(rows), *upper[1:])
    target = jax.tree.map(lambda leaf: leaf[jnp.array(WRISTS)], every)
    reference = jnp.tile(jnp.asarray(model.limits.reference), (NUM_LOWER, 1))
    below = LowerReach(model.hinges, reference, jnp.asarray(model.limits.fallback), target)

    def chain(
        uniforms: jax.Array,
        offset: jax.Array,
        bone: UpperReach,
        below: LowerReach,
        lengths: jax.Array,
    ) -> Proposals:
        bone, reach = _looking_ahead(bone, below.target, lengths[1])
        local, end, of_upper = jax.vmap(_upper, (0, None, None, None, None))(
            uniforms[:, 0], judge, body, bone, lengths[0]
        )
        ahead = jax.vmap(reach.log_share)(end)
        level, rows = _resampled(of_upper, ahead, offset)
        elbows = local[rows], end[rows]
        lower, of_lower = jax.vmap(_lower, (0, None, None, None, 0, None))(
            uniforms[:, 1], judge, bone, below, elbows, (lengths[1], body.size)
        )
        return Proposals(level + of_lower, elbows[0], lower)

    def head(uniforms: jax.Array) -> Proposals:
        local, _, weight = _upper(uniforms, judge, body, upper[0], body.size * length[HEAD_LENGTH])
        return Proposals(weight, local, local)

    numbers = _spread(chain_key, NUM_LOWER, 2)
    offsets = jax.random.uniform(order_key, (NUM_LOWER,))
    lengths = body.size * length[jnp.array(CHAIN_LENGTHS)]
    chains = jax.vmap(chain)(numbers, offsets, chained, below, lengths)
    heads = jax.vmap(head)(_spread(head_key, 1, 1)[0, :, 0])
    return jax.tree.map(lambda one, many: jnp.concatenate([one[None], many]), heads, chains)


def _looking_ahead(
    bone: UpperReach, after: SeenJoint, length: jax.Array
) -> tuple[UpperReach, Reach]:
    """An upper bone that all views aim so that the one below it, some mm long, reaches its own
    joint, and what that says of where it ends."""
    every, next_of_all = (
        jax.tree.map(lambda leaf: leaf[0], joint.aims) for joint in (bone.target, after)
    )
    aim, reach = with_next(every, next_of_all, length)
    aims = jax.tree.map(lambda rows, one: rows.at[0].set(one), bone.target.aims, aim)
    return bone._replace(target=bone.target._replace(aims=aims)), reach


def _spread(key: jax.Array, limbs: int, bones: int) -> jax.Array:
    """`(limbs, P, bones, 3)`: numbers of the proposals for each bone, a lattice that is moved at
    random (Cranley & Patterson 1976): each by itself is uniform, so that means are without bias,
    and together they leave fewer gaps than independent ones."""
    moved = jax.random.uniform(key, (limbs, 1, bones, UNIFORMS))
    steps = np.outer(np.arange(PER_LIMB), LATTICE)
    return (jnp.asarray(steps)[None, :, None] + moved) % 1.0


def _resampled(
    log_weight: jax.Array, ahead: jax.Array, offset: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """As many rows as there are weights `(P,)`, each as often as its share of weights times what
    lies `ahead` of it says, rounded by one `offset` for all (systematic); and the logs of the
    weights that they have then: what comes of the rows, times these, is without bias."""
    wanted = log_weight + ahead
    level = jax.nn.logsumexp(wanted)
    nothing, number = jnp.isneginf(level), len(wanted)
    share = jnp.exp(wanted - jnp.where(nothing, 0.0, level))
    points = (jnp.arange(number) + offset) / number
    rows = jnp.sum(jnp.cumsum(share)[None, :-1] < points[:, None], axis=1)
    return jnp.where(nothing, -jnp.inf, level - jnp.log(number) - ahead[rows]), rows


def _upper_bone(model: PoseModel, body: TorsoInWorld, every: SeenJoint, row: int) -> UpperReach:
    cells, target = (
        jax.tree.map(lambda leaf, at=at: leaf[at], rows)
        for rows, at in ((model.cells, row), (every, UPPER_BONES[row].end))
    )
    return UpperReach(cells, body.axes[row], body.torso[BONE_STARTS[row]], target)
