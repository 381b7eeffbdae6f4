"""Results: draws → a DataTree with names, units and provenance, saved as netCDF; see `Result`.

Groups posterior, sample_stats, observed_data, constant_data; opened by `xarray.open_datatree` and
by ArviZ."""

import functools
import importlib.metadata
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from inference.candidates import Candidate, Frame
from inference.exact.loops.numbers import words_of
from probmodel.chunks import in_chunks
from probmodel.files import replacing
from probmodel.model import PoseModel, log_joint
from probmodel.observation import Observation
from probmodel.skeleton import JOINTS, LENGTH_GROUPS

_PACKAGES = ("poseterior", "numpyro", "jax", "numpy", "scipy", "arviz", "xarray")
BASE_MEASURE = (
    "counting (torso) x length (5, body units) x surface of the unit sphere (9 directions) x image"
    " area (px2)"
)
COMPLETE, OUT_OF_BUDGET, IMPOSSIBLE = "complete", "out of budget", "impossible"


class CandidateDraws(NamedTuple):
    """Draws under one candidate: `length` `(n, 5)`, `upper` `(n, 5, 3)`, `lower` `(n, 4, 3)`; log
    evidence (log prior probability of the indicator) and its standard error; `weight` the
    candidate's share of the posterior."""

    length: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    log_evidence: float
    log_evidence_se: float
    weight: float


class Cost(NamedTuple):
    """What the draws cost: proposals made, of which accepted in the sampler's own count, and
    seconds."""

    num_proposals: int
    acceptance_rate: float
    wall_time: float


@dataclass(frozen=True)
class Result:
    """What a sampler returns: the `tree`, the `status` (complete, out of budget, impossible) and,
    where it is not complete, a `sentence` that says why and what to do. Draws in the tree are exact
    whatever the status."""

    tree: xr.DataTree
    status: str
    sentence: str = ""

    @property
    def num_draws(self) -> int:
        """How many draws there are, of all chains."""
        return int(self.tree["posterior"].sizes["chain"] * self.tree["posterior"].sizes["draw"])

    def save(self, path: str | os.PathLike) -> None:
        """Writes netCDF, atomically. Raises `BadInput` where the path cannot be written."""
        save_tree(self.tree, path)


def save_tree(tree: xr.DataTree, path: str | os.PathLike) -> None:
    """Writes a tree as netCDF4, whole or not at all. Raises `BadInput` where it cannot."""
    with replacing(path) as partial:
        tree.to_netcdf(partial, engine="netcdf4")


def key_words(key: jax.Array) -> str:
    """A key as the attribute `seed` has it."""
    return " ".join(map(str, words_of(key)))


@functools.cache
def versions() -> str:
    """Versions of Python and of the packages that draws depend on."""
    found = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
    return ", ".join([f"python {platform.python_version()}", *found])


def build_tree(
    model: PoseModel,
    frame: Frame,
    parts: list[CandidateDraws],
    attributes: dict[str, Any],
    rng: np.random.Generator | None,
) -> xr.DataTree:
    """The DataTree of the mixture over a frame's candidates. Draws are put in random order, so that
    any stretch of them is a sample of the mixture; without `rng` they stay in theirs."""
    observations = [frame.observation(candidate) for candidate in frame.candidates]
    chain = {key: value[None] for key, value in pose_columns(model, frame, parts, rng).items()}
    number = chain["joints"].shape[1]
    lp = chain.pop("lp")
    dims = {
        "joints": ("chain", "draw", "joint", "axis"),
        "bone_length": ("chain", "draw", "length_group"),
        "torso": ("chain", "draw"),
        "candidate": ("chain", "draw"),
        "keypoints": ("chain", "draw", "joint", "uv"),
    }
    units = {"joints": "body units", "bone_length": "body units", "keypoints": "pixels"}
    posterior = xr.Dataset(
        {
            key: (dims[key], chain[key], {"units": units[key]} if key in units else {})
            for key in dims
        },
        coords={
            "chain": [0],
            "draw": np.arange(number),
            "joint": list(JOINTS),
            "axis": list("xyz"),
            "length_group": list(LENGTH_GROUPS),
            "uv": list("uv"),
        },
    )
    stats = xr.Dataset(
        {"lp": (("chain", "draw"), lp, {"base_measure": BASE_MEASURE})},
        coords={"chain": [0], "draw": posterior.draw},
    )
    tree = xr.DataTree.from_dict(
        {
            "posterior": posterior,
            "sample_stats": stats,
            "observed_data": observed_data(frame),
            "constant_data": _constant_data(frame.candidates, observations, parts),
        }
    )
    tree.attrs.update(
        attributes,
        limits=f"{model.limits.name} {model.limits.sha256}",
        measures=f"upper {model.upper}, lower {model.lower}",
        versions=versions(),
        source=frame.detection.source,
        person=frame.detection.person,
        estimator=frame.estimator,
        converged=int(frame.converged),
        body_unit="mean limb length",
    )
    return tree


Columns = dict[str, np.ndarray]


def pose_columns(
    model: PoseModel, frame: Frame, parts: list[CandidateDraws], rng: np.random.Generator | None
) -> Columns:
    """Draws of all candidates as columns: those of `joint_columns`, and torso, candidate, keypoints
    `(n, 15, 2)`, lp; in random order, or without `rng` one candidate after the other."""
    columns: list[Columns] = []
    for index, (candidate, part) in enumerate(zip(frame.candidates, parts, strict=True)):
        observation, camera, number = (
            frame.observation(candidate),
            candidate.camera,
            len(part.length),
        )
        joints = _each(functools.partial(_joints, model, observation), part, (len(JOINTS), 3))
        columns.append(
            {
                "joints": joints,
                "bone_length": part.length,
                "torso": np.full(number, candidate.torso_index),
                "candidate": np.full(number, index),
                "keypoints": float(camera.scale) * joints[..., :2] + np.asarray(camera.translation),
                "lp": _each(functools.partial(_density, model, observation), part, ()),
            }
        )
    return _shuffled(columns, rng)


def joint_columns(
    model: PoseModel, frame: Frame, parts: list[CandidateDraws], rng: np.random.Generator
) -> Columns:
    """Draws of all candidates in the same random order: joints `(n, 15, 3)` and bone_length `(n,
    5)` only."""
    columns = []
    for candidate, part in zip(frame.candidates, parts, strict=True):
        joints = functools.partial(_joints, model, frame.observation(candidate))
        columns.append(
            {"joints": _each(joints, part, (len(JOINTS), 3)), "bone_length": part.length}
        )
    return _shuffled(columns, rng)


def _each(
    function: Callable[..., np.ndarray], part: CandidateDraws, shape: tuple[int, ...]
) -> np.ndarray:
    """A compiled function of every draw, each a row of this shape."""
    return (
        in_chunks(function, part.length, part.upper, part.lower)
        if len(part.length)
        else np.empty((0, *shape))
    )


@jax.jit
def _joints(
    model: PoseModel,
    observation: Observation,
    length: jax.Array,
    upper: jax.Array,
    lower: jax.Array,
) -> jax.Array:
    """Joints of a chunk of draws in camera axes."""
    return model.joints(observation.view, length, upper, lower)


@jax.jit
def _density(
    model: PoseModel,
    observation: Observation,
    length: jax.Array,
    upper: jax.Array,
    lower: jax.Array,
) -> jax.Array:
    """Log joint density of a chunk of draws."""
    return log_joint(model, observation, length, upper, lower)


def _shuffled(columns: list[Columns], rng: np.random.Generator | None) -> Columns:
    joined = {key: np.concatenate([column[key] for column in columns]) for key in columns[0]}
    if rng is None:
        return joined
    order = rng.permutation(len(joined["joints"]))
    return {key: value[order] for key, value in joined.items()}


def observed_data(frame: Frame) -> xr.Dataset:
    """The detection with names; NaN and score 0 where a joint is missing."""
    return xr.Dataset(
        {
            "keypoints": (("joint", "uv"), frame.detection.keypoints, {"units": "pixels"}),
            "score": (("joint",), frame.detection.score),
        },
        coords={"joint": list(JOINTS), "uv": list("uv")},
    )


def _constant_data(
    candidates: tuple[Candidate, ...], observations: list[Observation], parts: list[CandidateDraws]
) -> xr.Dataset:
    cameras = [candidate.camera for candidate in candidates]
    return xr.Dataset(
        {
            "radius": (
                ("candidate", "joint"),
                np.stack([np.asarray(o.radius) for o in observations]),
            ),
            "scale": (("candidate",), np.array([float(camera.scale) for camera in cameras])),
            "rotation": (
                ("candidate", "axis", "body_axis"),
                np.stack([np.asarray(c.rotation) for c in cameras]),
            ),
            "translation": (
                ("candidate", "uv"),
                np.stack([np.asarray(c.translation) for c in cameras]),
            ),
            "torso_index": (
                ("candidate",),
                np.array([candidate.torso_index for candidate in candidates]),
            ),
            "reprojection_error": (
                ("candidate",),
                np.array([c.reprojection_error for c in candidates]),
            ),
            "log_evidence": (("candidate",), np.array([part.log_evidence for part in parts])),
            "log_evidence_se": (("candidate",), np.array([part.log_evidence_se for part in parts])),
            "weight": (("candidate",), np.array([part.weight for part in parts])),
        },
        coords={
            "candidate": np.arange(len(candidates)),
            "joint": list(JOINTS),
            "axis": list("xyz"),
            "body_axis": ["left", "up", "forward"],
            "uv": list("uv"),
        },
    )
