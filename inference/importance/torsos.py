"""What the torso's detected joints ask of a root, in units in which attempts at it are made."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.inference.exact.loops.roots import RootTable, TorsoProblem, turn_rows
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.faults import ORDERS, Faults
from poseterior.probmodel.likelihood import WithOutliers
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import NEAREST, TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import TORSO_INDEX


class Posed(NamedTuple):
    """A torso's `problem`, the `law` of its joints' errors, the concentration `upright` of its back
    about the vertical, what leads back to pixels: the `origin` `(2,)` of its keypoints, and the
    scale `lowest`, pixels a body unit, that is their unit; and the prior's `highest` scale."""

    problem: TorsoProblem
    law: WithOutliers
    upright: float
    origin: np.ndarray
    lowest: float
    highest: float


def torso_problem(posterior: Posterior, faults: Faults) -> Posed:
    """What the torso's joints ask of a root under a pattern of faults.

    The joint with the smallest disc comes first, then the others from far to near: most attempts
    fail early.
    """
    detected = jax.tree.map(np.asarray, _read(posterior.detected, faults))
    torsos = np.asarray(posterior.model.torsos, float)
    rows = [row for row, joint in enumerate(TORSO_INDEX) if np.isfinite(detected.spread[joint])]
    joints = [TORSO_INDEX[row] for row in rows]
    reach = (np.asarray(detected.law.reach) * detected.spread)[joints]
    keypoints = detected.keypoints[joints]
    first = int(np.argmin(reach))
    distance = np.linalg.norm(keypoints - keypoints[first], axis=1)
    distance[first] = np.inf
    order = np.argsort(-distance, kind="stable")
    points = np.ascontiguousarray(torsos[:, rows][:, order])
    origin = keypoints[first]
    law = WithOutliers(posterior.detected.law, detected.law.outlier[joints][order])
    keypoints, reach = keypoints[order] - origin, np.ascontiguousarray(reach[order])
    bias = np.ascontiguousarray(detected.bias[joints][order])
    ray = np.asarray(detected.rays(posterior.model.lens))[joints][order]
    lowest = lowest_scale(points, keypoints, bias, reach, ray)
    # Every seen joint contributes scale⁻², and the translation takes one of them.
    precision = np.asarray(law.precision * (law.reach / reach) ** 2)
    problem = TorsoProblem(
        points,
        np.ascontiguousarray(keypoints / lowest),
        bias,
        reach,
        precision,
        np.ascontiguousarray(ray, float),
        2.0 * len(rows) - 2,
    )
    highest = math.exp(float(posterior.root_prior.highest_log_scale))
    return Posed(problem, law, float(posterior.model.upright), origin, lowest, highest)


@jax.jit
def _read(detected: DetectedJoints, faults: Faults) -> DetectedJoints:
    """Compiled, or every operation of it would be by itself."""
    return detected.read(faults)


def lowest_scale(
    torsos: np.ndarray,
    keypoints: np.ndarray,
    bias: np.ndarray,
    reach: np.ndarray,
    ray: np.ndarray,
) -> float:
    """A scale, pixels a body unit, that no root can go below: two joints project to within their
    distance in space of each other, or a little more where their lines of sight run to the side,
    and each is detected within its reach, but for its bias.

    Parameters
    ----------
    torsos
        `(J, n, 3)` body units
    keypoints
        `(n, 2)` pixels
    bias
        `(n, 2)` body units
    reach
        `(n,)` body units
    ray
        `(n, 2)` of the lines of sight, as `TorsoProblem` has them
    """
    apart = np.linalg.norm(keypoints[:, None] - keypoints[None], axis=-1)
    widest = np.linalg.norm(torsos[:, :, None] - torsos[:, None], axis=-1).max(axis=0)
    widest *= np.sqrt(1 + np.sum(ray**2, axis=1))[:, None]
    far = np.linalg.norm(torsos, axis=-1).max(axis=0)
    widest += far * np.linalg.norm(ray[:, None] - ray[None], axis=-1)
    most = widest + np.linalg.norm(bias[:, None] - bias[None], axis=-1)
    most += reach[:, None] + reach[None]
    # A little lower, for rounding; two joints at least lie apart, or no camera is determined.
    return float((apart / most).max() * (1 - 1e-9))


def log_mass(posed: Posed, mass: float) -> float:
    """Log of the evidence if every attempt succeeded: a proposal's mass in pixels."""
    if not mass:
        return -math.inf
    peak = 0.0
    if posed.upright:
        from poseterior.probmodel.rotations import (
            log_upright_peak,
        )  # imports NumPyro, which few roots need

        peak = float(log_upright_peak(posed.upright))
    return math.log(mass) - posed.problem.power * math.log(posed.lowest) + peak


def rotations_of(table: RootTable) -> np.ndarray:
    """`(n, 3, 3)`: the rotations of roots in a table."""
    rotations = np.empty((len(table.angles), 3, 3))
    turn_rows(table.angles, rotations)
    return rotations


def points_of(posed: Posed, table: RootTable) -> RootPoint:
    """The roots of a table, in pixels."""
    scale = posed.lowest / table.inverse
    translation = posed.origin + scale[:, None] * table.plane
    return RootPoint(table.torso, rotations_of(table), np.log(scale), translation)


def log_nearness(posterior: Posterior, points: RootPoint, exchange: ArrayLike) -> np.ndarray:
    """`(n,)`: what perspective adds to the log density of the torso's joints under roots `(n, ...)`
    and exchanges `(n,)`: errors are as large as things appear where the joint is, and roots are
    drawn as if they were as large as at the pelvis."""
    number = len(np.asarray(points.torso))
    if posterior.model.lens is None or not number:
        return np.zeros(number)
    measure = functools.partial(_log_nearness, posterior.model, posterior.detected)
    return in_chunks(measure, *map(np.asarray, points), np.broadcast_to(exchange, number))


@jax.jit
def _log_nearness(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    prior, torso = TorsoCameraPrior.of(model), jnp.asarray(TORSO_INDEX)

    def one(point: RootPoint, exchange: jax.Array) -> jax.Array:
        root = prior.root(point)
        counts = detected.counts[jnp.asarray(ORDERS)[exchange]][torso]
        larger = jnp.log(root.camera.magnification(root.view))
        return -2 * jnp.sum(jnp.where(counts, larger, 0.0))

    return jax.vmap(one)(RootPoint(*fields[:4]), fields[4])


def require_distance(posterior: Posterior) -> None:
    """Raises `BadInput` where a known focal length puts the person too near to the camera."""
    lens = posterior.model.lens
    if lens is None:
        return
    lowest = torso_problem(posterior, Faults.none()).lowest
    distance = float(lens.focal) / lowest
    if distance < NEAREST:
        raise BadInput(
            f"a focal length of {float(lens.focal):g} pixels puts {posterior.detection.where} at"
            f" most {distance:.2g} body units (of about 0.35 m) from the camera, where {NEAREST:g}"
            " are the least; give it in pixels of the image that the keypoints are of"
        )
