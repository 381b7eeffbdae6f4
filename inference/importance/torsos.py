"""The torso problem: what the torso's detected joints ask of a root, in the units of
its proposals."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.exact.loops.roots import TorsoJoints, turn_rows
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import ORDERS, Faults
from poseterior.probmodel.errors.laws import WithOutliers
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import NEAREST, TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX


class TorsoProblem(NamedTuple):
    """What the torso's joints ask of a root.

    Attributes
    ----------
    joints
        The torso's seen joints.
    law
        Of their errors.
    upright
        Concentration of the back about the vertical.
    origin
        `(2,)` of the keypoints, pixels.
    lowest
        The scale, pixels a body unit, that is the keypoints' unit.
    highest
        The prior's highest scale, pixels a body unit.
    lens
        Which focal length the camera has, where it may have several.
    """

    joints: TorsoJoints
    law: WithOutliers
    upright: float
    origin: np.ndarray
    lowest: float
    highest: float
    lens: int | None


def torso_problem(posterior: Posterior, faults: Faults, lens: int | None = None) -> TorsoProblem:
    """What the torso's joints ask of a root under a pattern of faults, and one of the focal
    lengths that there may be.

    The joint with the smallest disc comes first, then the others from far to near: then
    most proposals fail early.
    """
    detected = jax.tree.map(np.asarray, _read(posterior.detected, faults))
    prior = TorsoCameraPrior.of(posterior.model)
    rows = [row for row, joint in enumerate(TORSO_INDEX) if np.isfinite(detected.spread[joint])]
    seen = [TORSO_INDEX[row] for row in rows]
    reach = (np.asarray(detected.law.reach) * detected.spread)[seen]
    keypoints = detected.keypoints[seen]
    first = int(np.argmin(reach))
    origin = keypoints[first]
    distance = np.linalg.norm(keypoints - origin, axis=1)
    distance[first] = np.inf
    order = np.argsort(-distance, kind="stable")
    law = WithOutliers(posterior.detected.law, detected.law.outlier[seen][order])
    torsos = np.asarray(posterior.model.torsos, float)
    if detected.definition is not None:
        torsos = torsos + detected.definition[:, TORSO_INDEX]
    joints = TorsoJoints(
        torsos=np.ascontiguousarray(torsos[:, rows][:, order]),
        keypoints=keypoints[order] - origin,
        bias=np.ascontiguousarray(detected.bias[seen][order]),
        reach=np.ascontiguousarray(reach[order]),
        precision=np.asarray(law.precision * (law.reach / reach[order]) ** 2),
        ray=np.asarray(detected.rays(prior.lens_of(lens)))[seen][order],
        # Every seen joint contributes scale⁻², and the translation takes one of them.
        power=2.0 * len(rows) - 2,
    )
    lowest = lowest_scale(joints)
    joints = joints._replace(
        keypoints=np.ascontiguousarray(joints.keypoints / lowest),
        ray=np.ascontiguousarray(joints.ray, float),
    )
    highest = math.exp(float(prior.highest_log_scale(lens)))
    return TorsoProblem(
        joints=joints,
        law=law,
        upright=float(posterior.model.upright),
        origin=origin,
        lowest=lowest,
        highest=highest,
        lens=lens,
    )


@jax.jit
def _read(detected: DetectedJoints, faults: Faults) -> DetectedJoints:
    """Compiled, or every operation of it would be by itself."""
    return detected.read(faults)


def lowest_scale(joints: TorsoJoints) -> float:
    """A scale, pixels a body unit, that no root can go below, given joints whose
    keypoints are in pixels: two joints project to within their distance in space of
    each other, or a little more where their lines of sight run to the side, and each is
    detected within its reach, but for its bias."""

    def apart(rows: np.ndarray) -> np.ndarray:
        return np.linalg.norm(rows[..., :, None, :] - rows[..., None, :, :], axis=-1)

    widest = apart(joints.torsos).max(axis=0)
    widest *= np.sqrt(1 + np.sum(joints.ray**2, axis=1))[:, None]
    far = np.linalg.norm(joints.torsos, axis=-1).max(axis=0)
    widest += far * apart(joints.ray)
    most = widest + apart(joints.bias)
    most += joints.reach[:, None] + joints.reach[None]
    # A little lower, for rounding; two joints at least lie apart, or no camera is
    # determined.
    return float((apart(joints.keypoints) / most).max() * (1 - 1e-9))


def log_mass(problem: TorsoProblem, mass: float) -> float:
    """Log of the evidence if every proposal were accepted: a proposal's mass in
    pixels."""
    if not mass:
        return -math.inf
    peak = 0.0
    if problem.upright:
        # Imports NumPyro, which few roots need.
        from poseterior.probmodel.rotations import log_upright_peak

        peak = float(log_upright_peak(problem.upright))
    return math.log(mass) - problem.joints.power * math.log(problem.lowest) + peak


def rotations_of(roots: np.ndarray) -> np.ndarray:
    """`(n, 3, 3)`: the rotations of `ROOTS` `(n,)`."""
    rotations = np.empty((len(roots), 3, 3))
    turn_rows(roots, rotations)
    return rotations


def points_of(problem: TorsoProblem, roots: np.ndarray) -> RootPoint:
    """`ROOTS` `(n,)` as roots in pixels."""
    scale = problem.lowest / roots["inverse"]
    translation = problem.origin + scale[:, None] * roots["plane"]
    lens = None if problem.lens is None else np.full(len(roots), problem.lens)
    return RootPoint(roots["torso"].copy(), rotations_of(roots), np.log(scale), translation, lens)


def log_nearness(posterior: Posterior, points: RootPoint, exchange: ArrayLike) -> np.ndarray:
    """`(n,)`: what perspective adds to the log density of the torso's joints under
    roots `(n, ...)` and exchanges `(n,)`: errors are as large as things appear where
    the joint is, and roots are drawn as if they were as large as at the pelvis."""
    number = len(np.asarray(points.torso))
    if posterior.model.lens is None or not number:
        return np.zeros(number)
    measure = functools.partial(_log_nearness, posterior.model, posterior.detected)
    return in_chunks(measure, *jax.tree.leaves(points), np.broadcast_to(exchange, number))


@jax.jit
def _log_nearness(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    prior = TorsoCameraPrior.of(model)
    torso = jnp.asarray(TORSO_INDEX)

    def one(point: RootPoint, exchange: jax.Array) -> jax.Array:
        root = prior.root(point)
        counts = detected.counts[jnp.asarray(ORDERS)[exchange]][torso]
        view = jnp.zeros((NUM_JOINTS, 3)).at[torso].set(root.view)
        view = detected.under(prior, point).defined(view)[torso]
        farther = jnp.log(jnp.maximum(root.camera.relative_depth(view), 0.0))
        return 2 * jnp.sum(jnp.where(counts, farther, 0.0))

    return jax.vmap(one)(RootPoint(*fields[:-1]), fields[-1])


def require_distance(posterior: Posterior) -> None:
    """Raises `BadInput` where a focal length, the longest that there may be, puts the person
    too near to the camera."""
    lens = posterior.model.lens
    if lens is None:
        return
    longest = int(np.argmax(lens.focal)) if lens.number > 1 else None
    focal = float(np.max(lens.focal))
    distance = focal / torso_problem(posterior, Faults.none(), longest).lowest
    if distance < NEAREST:
        raise BadInput(
            f"a focal length of {focal:g} pixels puts {posterior.detection.where} at"
            f" most {distance:.2g} body units (of about 0.35 m) from the camera, where {NEAREST:g}"
            " are the least; give it in pixels of the image that the keypoints are of"
        )
