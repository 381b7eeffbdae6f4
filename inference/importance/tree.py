"""Weighted roots → a DataTree: the draws with their roots, and all roots that were weighed.

Pictures and tables ask which way the person faces. So every root goes to that one of the
estimator's candidates whose camera is turned like its own, and `candidate` names these sides.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import xarray as xr

from poseterior.inference.importance.limbs import log_evidence
from poseterior.inference.importance.weighted import WeightedRoots, log_mean
from poseterior.inference.results import NAMES, UNCERTAIN, Columns, assemble
from poseterior.probmodel.chunks import CHUNK, in_chunks
from poseterior.probmodel.errors.faults import ORDERS, FaultPrior, Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import RootPoint, RootPrior
from poseterior.probmodel.uncertain import DetectedJoints, UncertainPosterior, log_joints

BASE_MEASURE = (
    "counting (torso) x Haar's on SO(3) (1 in all) x log scale x image area (px2, translation) x"
    " length (5, body units) x surface of the unit sphere (9 directions) x image area (px2)"
)

EVIDENCE = ("log_evidence", "log_evidence_se")


def uncertain_tree(
    roots: WeightedRoots,
    rng: np.random.Generator,
    number: int,
    attributes: dict[str, Any],
    block: int = 0,
) -> xr.DataTree:
    """The DataTree of `number` draws, none where no root has any weight. Beside the groups that
    every result has, `roots` holds all that were weighed, with their weights. The `block` counts as
    in `build_tree`."""
    posterior = roots.posterior
    points, poses, chosen = roots.draw(rng, number)
    faults = roots.proposed.faults.take(chosen)
    columns = draw_columns(posterior, points, poses, faults) | {"root_index": chosen}
    columns["candidate"] = sides(posterior, points)
    about = {
        "root": UNCERTAIN,
        "num_roots": len(roots.log_weight),
        "effective_roots": roots.effective,
        "num_proposals": roots.proposals,
        "log_evidence": roots.log_evidence,
        "log_evidence_se": roots.log_evidence_se,
        "converged": int(all(one.converged for one in posterior.candidates)),
    }
    constant = side_data(posterior, roots.points, roots.share, functools.partial(_evidence, roots))
    tree = assemble(posterior, columns, constant, BASE_MEASURE, about | attributes, block)
    tree["roots"] = xr.DataTree(_weighed(roots))
    return tree


def draw_columns(
    posterior: UncertainPosterior, points: RootPoint, poses: Pose, faults: Faults
) -> Columns:
    """Draws `(n, ...)` as columns: the root's, the detection as each reads it, joints, bone_length,
    keypoints, lp; and outlier and exchange, where there may be faults."""
    lp = np.empty(0)
    if len(poses.length):
        density = functools.partial(
            _log_joints, posterior.model, posterior.detected, posterior.faults
        )
        lp = in_chunks(density, *map(np.asarray, points), *poses, *faults)
    scale, where = np.exp(points.log_scale), placed(posterior.model, points, poses)
    named = {"outlier": faults.outlier, "exchange": faults.exchange}
    return {
        **(named if posterior.faults.any else {}),
        **_read(posterior, _units(posterior.model, scale, where["joints"]), faults),
        "torso": np.asarray(points.torso),
        "rotation": np.asarray(points.rotation),
        "scale": scale,
        "translation": np.asarray(points.translation),
        "bone_length": poses.length,
        "lp": lp,
        **where,
    }


def _units(model: PoseModel, scale: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """`(n, 15)`: pixels of a body unit at each joint of draws `(n, 15, 3)`."""
    nearness = 0.0 if model.lens is None else 1 / float(model.lens.focal)
    return scale[:, None] / (1 + nearness * scale[:, None] * joints[:, :, 2])


def _read(posterior: UncertainPosterior, unit: np.ndarray, faults: Faults) -> Columns:
    """The detection as each pattern of faults `(n, ...)` has it, as the fields of `KeypointsRead`,
    in pixels, of which a body unit has `unit` `(n, 15)` at each joint."""
    order = ORDERS[faults.exchange]
    spread = np.asarray(posterior.detected.spread)[order]
    outlier = np.take_along_axis(faults.outlier, order, axis=1) & np.isfinite(spread)
    bias = np.where(outlier[..., None], 0.0, posterior.likelihood.bias[order])
    return {
        "read_detected": posterior.detection.keypoints[order],
        "read_bias": unit[..., None] * bias,
        "read_spread": unit * np.where(outlier, posterior.faults.reach, spread),
        "read_outlier": outlier,
    }


def placed(model: PoseModel, points: RootPoint, poses: Pose, *, size: int = CHUNK) -> Columns:
    """Joints `(n, 15, 3)` in camera axes and keypoints `(n, 15, 2)` of draws `(n, ...)`, `size` of
    them at a time."""
    if not len(poses.length):
        return {"joints": np.empty((0, 15, 3)), "keypoints": np.empty((0, 15, 2))}
    place = functools.partial(_place, model)
    return in_chunks(place, *map(np.asarray, points), *poses, size=size)


def _log_joints(
    model: PoseModel, detected: DetectedJoints, faulty: FaultPrior, *fields: np.ndarray
) -> jax.Array:
    points, poses, faults = RootPoint(*fields[:4]), Pose(*fields[4:7]), Faults(*fields[7:])
    return log_joints(model, detected, faulty, points, poses, faults)


@jax.jit
def _place(model: PoseModel, *fields: jax.Array) -> dict[str, jax.Array]:
    prior = RootPrior.of(model)

    def one(point: RootPoint, pose: Pose) -> dict[str, jax.Array]:
        root = prior.root(point)
        joints = model.joints(root.view, *pose)
        return {"joints": joints, "keypoints": root.camera.image(joints)}

    return jax.vmap(one)(RootPoint(*fields[:4]), Pose(*fields[4:]))


def sides(posterior: UncertainPosterior, points: RootPoint) -> np.ndarray:
    """`(n,)`: for each root, the candidate whose camera is turned least against its own."""
    cameras = [np.asarray(one.camera.rotation) for one in posterior.candidates] or [np.eye(3)]
    # The trace of a rotation falls with its angle.
    trace = np.einsum("nij,cij->nc", np.asarray(points.rotation), np.stack(cameras))
    return np.argmax(trace, axis=1)


def _weighed(roots: WeightedRoots) -> xr.Dataset:
    points, one = roots.points, ("root",)
    limbs = np.array([log_evidence(found) for found in roots.limbs])
    return xr.Dataset(
        {
            "torso": (one, points.torso),
            "rotation": ((*one, "axis", "body_axis"), points.rotation),
            "scale": (one, np.exp(points.log_scale), {"units": "pixels per body unit"}),
            "translation": ((*one, "uv"), points.translation, {"units": "pixels"}),
            "log_evidence_of_limbs": (one, limbs),
            "log_weight": (one, roots.log_weight),
            "share": (one, roots.share),
            "candidate": (one, sides(roots.posterior, points)),
        },
        coords={"root": np.arange(len(limbs))}
        | {name: NAMES[name] for name in ("axis", "body_axis", "uv")},
    )


def side_data(
    posterior: UncertainPosterior,
    points: RootPoint,
    share: np.ndarray,
    evidence: Callable[[np.ndarray], tuple[float, float]],
) -> xr.Dataset:
    """What the posterior says of each side: its share and evidence, and the mean of its cameras.

    Parameters
    ----------
    posterior
        Whose roots these are.
    points
        Roots `(n, ...)`.
    share : `(n,)`
        Of the posterior, that each of them stands for.
    evidence
        Log evidence of the roots in some rows alone, with its standard error; NaN where there is
        none.

    Returns
    -------
    Dataset
        By candidate.
    """
    side, number = sides(posterior, points), max(1, len(posterior.candidates))
    means: list[dict[str, Any]] = []
    for index in range(number):
        rows = np.flatnonzero(side == index)
        found = _mean_camera(posterior, points.take(rows), share[rows], index)
        means.append(found | dict(zip(EVIDENCE, evidence(rows), strict=True)))
    columns = {name: np.array([mean[name] for mean in means]) for name in means[0]}
    spread = np.where(np.isfinite(posterior.detected.spread), posterior.detected.spread, np.nan)
    one = ("candidate",)
    dims = {"rotation": (*one, "axis", "body_axis"), "translation": (*one, "uv")}
    reach = posterior.detected.law.reach * spread
    return xr.Dataset(
        {name: (dims.get(name, one), column) for name, column in columns.items()}
        | {"radius": ((*one, "joint"), columns["scale"][:, None] * reach[None])},
        coords={"candidate": np.arange(number)}
        | {name: NAMES[name] for name in ("joint", "axis", "body_axis", "uv")},
    )


def _evidence(roots: WeightedRoots, rows: np.ndarray) -> tuple[float, float]:
    """Log evidence of the roots in some rows alone, and its standard error."""
    own = np.isin(np.arange(len(roots.log_weight)), rows)
    whole = np.where(own, roots.share, 0.0)
    weight = whole.sum()
    if not weight:
        return log_mean(np.where(own, roots.log_weight, -np.inf)), np.inf
    error = np.sqrt(roots.proposed.relative_variance(whole / weight))
    return log_mean(np.where(own, roots.log_weight, -np.inf)), float(error)


def _mean_camera(
    posterior: UncertainPosterior, points: RootPoint, share: np.ndarray, index: int
) -> dict[str, Any]:
    """Of a side's roots: their share, mean camera and its spread, and the torso that has most of
    it. The estimator's candidate where they have no weight."""
    weight = share.sum()
    found: dict[str, Any] = {
        "weight": float(weight),
        "reprojection_error": np.nan,
        "scale_sd": np.nan,
        "turn_sd": np.nan,
        "num_torsos": 0,
    }
    if not weight:
        return found | _of_candidate(posterior, index)
    share = share / weight
    scale = np.exp(points.log_scale)
    mean = float(share @ scale)
    rotation = nearest_rotation(np.einsum("n,nij->ij", share, points.rotation))
    cosine = (np.einsum("nij,ij->n", points.rotation, rotation) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    by_torso = np.bincount(points.torso, weights=share)
    return found | {
        "scale": mean,
        "scale_sd": float(np.sqrt(share @ (scale - mean) ** 2)),
        "rotation": rotation,
        "turn_sd": float(np.sqrt(share @ turn**2)),
        "translation": share @ points.translation,
        "torso_index": int(np.argmax(by_torso)),
        "num_torsos": int(np.count_nonzero(by_torso)),
    }


def _of_candidate(posterior: UncertainPosterior, index: int) -> dict[str, Any]:
    if not posterior.candidates:
        nowhere = {"scale": np.nan, "rotation": np.full((3, 3), np.nan), "torso_index": -1}
        return nowhere | {"translation": np.full(2, np.nan)}
    one = posterior.candidates[index]
    return {
        "scale": float(one.camera.scale),
        "rotation": np.asarray(one.camera.rotation),
        "translation": np.asarray(one.camera.translation),
        "torso_index": one.torso_index,
        "reprojection_error": one.reprojection_error,
    }


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation nearest to a mean of rotations, least squares."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
