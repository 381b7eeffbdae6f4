"""Composed hypotheses: possible poses like the centres of clusters, put together limb by limb.

A pose has some twenty dimensions, so that even the nearest of ten thousand draws is far from the
centre of its cluster, which itself is no pose: its bones are too short, and no limit holds it.
Given torso, camera and bone lengths, though, limbs are independent of each other: among so many
draws of one *limb* there is one whose bones point nearly as the centre's do, and limbs of different
draws make a pose that is possible and explains the detection.

    composed(result, frame.posterior(model), k=5)
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.clusters import Clusters, clusters
from poseterior.inference.draws import Draws
from poseterior.inference.hypothesis import Hypothesis, require_k
from poseterior.inference.machines import calm_blas
from poseterior.inference.results import Result
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.root_priors import CANDIDATES, RootPrior
from poseterior.probmodel.roots import RootPoint, nearest_rotation
from poseterior.probmodel.skeleton import GROUPS, NUM_JOINTS, PARENTS, TORSO_INDEX

TRIED_ROOTS = 8
"""Roots that are tried for each hypothesis, of each kind: draws' own, and the mean camera's."""
LIMBS_TRIED = 10_000
"""Draws whose limbs are tried: of more, the nearest is hardly nearer."""
SHORTEST = 1e-9
"""Body units: of a shorter mean bone nobody can say where it points."""
_TORSO = np.array(TORSO_INDEX)
_ENDS = tuple(
    np.array([bone.end for bone in limb.bones]) for limbs in GROUPS.values() for limb in limbs
)
"""Of each limb, the joints that it decides."""
_LIMB_OF = np.zeros(NUM_JOINTS, int)
for _limb, _joints in enumerate(_ENDS):
    _LIMB_OF[_joints] = _limb


class DrawnUnder(NamedTuple):
    """Draws with what they were made under.

    Attributes
    ----------
    posterior : what they were drawn from.
    joints : `(n, 15, 3)` camera axes, body units.
    bone_length : `(n, 5)` body units.
    points : the root of each draw, as the posterior's prior has it.
    faults : the pattern of faults of each draw `(n, ...)`.
    """

    posterior: Posterior
    joints: np.ndarray
    bone_length: np.ndarray
    points: Any
    faults: Faults

    @classmethod
    def of(cls, result: Result, posterior: Posterior) -> "DrawnUnder":
        """The draws of a result that `sample` returned for a posterior."""
        found = {
            str(name): np.asarray(values).reshape(-1, *values.shape[2:])
            for name, values in result.tree["posterior"].data_vars.items()
        }
        none = Faults.none(len(found["joints"]))
        faults = Faults(*(found.get(name, part) for name, part in none._asdict().items()))
        points = posterior.root_prior.point_of(found)
        return cls(posterior, found["joints"], found["bone_length"], points, faults)


class _Roots(NamedTuple):
    """Roots `(r, ...)` of which one becomes a hypothesis': what the detection says under each, bone
    lengths, and whose limbs are its own, so that they need no check: one of those tried, -1 for
    none."""

    seen: Observation
    length: np.ndarray
    own: np.ndarray


def composed(
    result: Result, posterior: Posterior, k: int = 5, *, seed: int = 0
) -> list[Hypothesis]:
    """Hypotheses that are more like the centres of a result's clusters than draws are: possible
    poses, each with the torso and camera of a draw, or the mean camera of a cluster, and with limbs
    of others.

    Parameters
    ----------
    result
        What `sample` returned.
    posterior
        What it was drawn from.
    k
        How many.
    seed
        Of k-means++.

    Returns
    -------
    list of Hypothesis
        Heaviest cluster first, each with its keypoints and the number of the draw nearest to it;
        fewer than `k` where there are fewer distinct draws.

    Raises
    ------
    BadInput
        Where k is not from 1 to the number of draws.
    """
    return compose(DrawnUnder.of(result, posterior), k, seed=seed)


def compose(drawn: DrawnUnder | Draws, k: int, *, seed: int = 0) -> list[Hypothesis]:
    """`composed` of draws that are at hand.

    Parameters
    ----------
    drawn
        The draws.
    k
        How many hypotheses.
    seed
        Of k-means++.

    Returns
    -------
    list of Hypothesis
        As of `composed`.

    Raises
    ------
    BadInput
        Where k is not from 1 to the number of draws.
    """
    require_k(k, len(drawn.joints))
    flat = np.asarray(drawn.joints, float).reshape(len(drawn.joints), -1)
    with calm_blas():
        fit = clusters(flat, k, seed)
    found = [_hypothesis(drawn, fit, cluster) for cluster in np.unique(fit.labels).tolist()]
    return sorted(found, key=lambda hypothesis: -hypothesis.weight)


def _hypothesis(drawn: DrawnUnder | Draws, fit: Clusters, cluster: int) -> Hypothesis:
    members = np.flatnonzero(fit.labels == cluster)
    centre = fit.centres[cluster].reshape(NUM_JOINTS, 3)
    way = _of_candidates if drawn.posterior.root_prior.name == CANDIDATES else _of_points
    bases, roots = way(drawn, members, centre)
    limbs = np.append(np.arange(min(len(drawn.joints), LIMBS_TRIED)), bases)
    directions = drawn.joints[limbs], drawn.bone_length[limbs]
    found = _assembled(drawn.posterior.model, roots, *directions, centre)
    poses, keypoints, squares = map(np.asarray, found)
    best = int(np.argmin(squares))
    away = np.sum((drawn.joints - poses[best]) ** 2, axis=(1, 2))
    weight = len(members) / len(drawn.joints)
    return Hypothesis(poses[best], weight, int(np.argmin(away)), keypoints[best])


def _of_candidates(
    drawn: DrawnUnder | Draws, members: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, _Roots]:
    """The draws nearest to the centre, and their candidates."""
    posterior = drawn.posterior
    bases = np.resize(_nearest(drawn.joints[members], centre, members)[:TRIED_ROOTS], TRIED_ROOTS)
    seen = _under(posterior.detected, posterior.root_prior, drawn.points[bases], None)
    return bases, _Roots(seen, drawn.bone_length[bases], _own(drawn))


def _of_points(
    drawn: DrawnUnder | Draws, members: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, _Roots]:
    """Draws of those roots whose torsos are nearest to the centre's, and these roots; behind them
    the members' mean camera, with the torsos that are nearest under it."""
    posterior, points, faults = drawn.posterior, drawn.points, drawn.faults
    order = _nearest(drawn.joints[members][:, _TORSO], centre[_TORSO], members)
    _, first = np.unique(points.log_scale[order], return_index=True)  # each root once
    bases = np.resize(order[np.sort(first)][:TRIED_ROOTS], TRIED_ROOTS)
    like = members[_same(faults.take(members), faults.take(bases[0]))]
    middle = _mean_camera(posterior, points.take(like), centre)
    roots = jax.tree.map(lambda *parts: np.concatenate(parts), points.take(bases), middle)
    patterns = faults.take(np.append(bases, np.full(TRIED_ROOTS, bases[0])))
    mean = np.tile(drawn.bone_length[like].mean(axis=0), (TRIED_ROOTS, 1))
    length = np.concatenate([drawn.bone_length[bases], mean])
    seen = _under(posterior.detected, posterior.root_prior, roots, patterns)
    return bases, _Roots(seen, length, np.append(_own(drawn), np.full(TRIED_ROOTS, -1)))


def _nearest(poses: np.ndarray, centre: np.ndarray, names: np.ndarray) -> np.ndarray:
    """The names of poses `(m, j, 3)`, nearest to the centre first."""
    return names[np.argsort(np.sum((poses - centre) ** 2, axis=(1, 2)), kind="stable")]


def _own(drawn: DrawnUnder | Draws) -> np.ndarray:
    """Where the limbs of the draws whose roots are tried stand: behind all others."""
    return min(len(drawn.joints), LIMBS_TRIED) + np.arange(TRIED_ROOTS)


def _same(patterns: Faults, one: Faults) -> np.ndarray:
    """`(n,)` bool: the patterns of faults `(n, ...)` that are that one."""
    return (patterns.exchange == one.exchange) & (patterns.outlier == one.outlier).all(axis=-1)


def _mean_camera(posterior: Posterior, points: RootPoint, centre: np.ndarray) -> RootPoint:
    """`(TRIED_ROOTS, ...)`: the mean of some roots' cameras, before it those of their torsos that
    are nearest to the centre's."""
    torsos = np.unique(points.torso)
    rotation = nearest_rotation(points.rotation.mean(axis=0))
    view = np.einsum("ab,njb->nja", rotation, np.asarray(posterior.model.torsos)[torsos])
    chosen = np.resize(_nearest(view, centre[_TORSO], torsos)[:TRIED_ROOTS], TRIED_ROOTS)
    return RootPoint(
        chosen,
        np.tile(rotation, (TRIED_ROOTS, 1, 1)),
        np.full(TRIED_ROOTS, np.log(np.exp(points.log_scale).mean())),
        np.tile(points.translation.mean(axis=0), (TRIED_ROOTS, 1)),
        None if points.lens is None else np.full(TRIED_ROOTS, _commonest(points.lens)),
    )


def _commonest(indices: np.ndarray) -> int:
    """The index that comes most often."""
    return int(np.bincount(indices).argmax())


def _bones(joints: jax.Array) -> jax.Array:
    """`(..., 15, 3)`: from each joint's parent to the joint; the pelvis has none."""
    return joints - joints[..., np.maximum(PARENTS, 0), :]


@jax.jit  # and not kept: what it returns is more than tuples
def _under(
    detected: DetectedJoints,
    prior: RootPrior,
    points: Any,
    faults: Faults | None,
) -> Observation:
    """What a detection says under roots and patterns of faults `(r, ...)`."""
    return jax.vmap(lambda *one: detected.under(prior, *one))(points, faults)


@kept
def _assembled(
    model: PoseModel,
    roots: _Roots,
    joints: jax.Array | np.ndarray,
    bone_length: jax.Array | np.ndarray,
    centre: jax.Array | np.ndarray,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Under each of r roots the pose of those limbs of draws `(n, ...)` that point most nearly as
    the centre's, among those that explain their detections: joints `(r, 15, 3)`, keypoints
    `(r, 15, 2)`, and `(r,)` squared distances, infinite where there is none.

    What a bone is off is the distance from where it would end if it pointed as the centre's does;
    the torso's joints are as far off as they are from the centre's."""
    limbs, rows = model.pose_of(joints, bone_length), jnp.arange(len(joints))
    wanted = _bones(jnp.asarray(centre))
    wanted = wanted / jnp.maximum(jnp.linalg.norm(wanted, axis=-1, keepdims=True), SHORTEST)

    def under(root: _Roots) -> tuple[jax.Array, ...]:
        seen, length, own = root

        def of_draw(
            row: jax.Array, upper: jax.Array, lower: jax.Array
        ) -> tuple[jax.Array, jax.Array]:
            placed = model.joints(seen.view, length, upper, lower)
            bones = _bones(placed)
            turned = jnp.linalg.norm(bones, axis=-1, keepdims=True) * wanted
            off = jnp.sum((bones - turned) ** 2, axis=-1)
            off = jnp.where(seen.within(placed) | (row == own), off, jnp.inf)
            return placed, jnp.stack([off[ends].sum() for ends in _ENDS])

        placed, off = jax.vmap(of_draw)(rows, limbs.upper, limbs.lower)
        pose = placed[off.argmin(axis=0)[_LIMB_OF], np.arange(NUM_JOINTS)]
        torso = jnp.sum((pose - centre)[_TORSO] ** 2)
        explained = (own >= 0) | seen.within(pose)[_TORSO].all()
        squares = jnp.where(explained, off.min(axis=0).sum() + torso, jnp.inf)
        return pose, seen.root.camera.image(pose), squares

    return jax.lax.map(under, roots)
