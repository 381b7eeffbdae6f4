"""Results: draws → a DataTree with names, units and provenance, saved as netCDF; see `Result`.

Groups posterior, sample_stats, posterior_predictive, log_likelihood, observed_data, constant_data;
opened by `xarray.open_datatree` and by ArviZ."""

import functools
import importlib.metadata
import os
import platform
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.predictions import KeypointsRead, prediction_groups
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.documents import shortest
from poseterior.probmodel.files import replacing
from poseterior.probmodel.model import PoseModel, log_joint
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.programs import kept
from poseterior.probmodel.skeleton import JOINTS, LENGTH_GROUPS, NUM_JOINTS
from poseterior.probmodel.uncertain import UncertainPosterior

_PACKAGES = ("poseterior", "numpyro", "jax", "numpy", "scipy", "arviz", "xarray")
BASE_MEASURE = (
    "counting (torso) x length (5, body units) x surface of the unit sphere (9 directions) x image"
    " area (px2)"
)
FIXED, UNCERTAIN = "fixed", "uncertain"
"""What a result says of its root: atoms that an estimator gave, or a part of the posterior."""
BLOCK = 1 << 16
"""Draws of a large result that are in memory at a time (some 200 MB), and that its pictures and
tables are of."""
COMPLETE, OUT_OF_BUDGET, IMPOSSIBLE = "complete", "out of budget", "impossible"


class RootDraws(NamedTuple):
    """Draws under one root.

    Attributes
    ----------
    poses : the draws `(n, ...)`.
    log_evidence : log of the prior's mean of the likelihood over its peak; for discs, the log prior
        probability of the indicator.
    log_evidence_se : its standard error.
    weight : the root's share of the posterior.
    """

    poses: Pose
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
    """What a sampler returns. Draws of exact rejection are exact whatever the status.

    Attributes
    ----------
    tree
        ArviZ's groups: posterior, sample_stats, and others.
    status
        complete, out of budget or impossible.
    sentence
        Why it is not complete, and what to do; empty where it is.
    """

    tree: xr.DataTree
    status: str
    sentence: str = ""

    @property
    def num_draws(self) -> int:
        """How many draws there are, of all chains."""
        return int(self.tree["posterior"].sizes["chain"] * self.tree["posterior"].sizes["draw"])

    def first(self, number: int) -> "Result":
        """The first draws of each chain, in memory: as good a sample as all of them, for what needs
        no more.

        Parameters
        ----------
        number
            How many; all where there are fewer.

        Returns
        -------
        Result
            With the same attributes.
        """
        if self.tree["posterior"].sizes["draw"] <= number:
            return self
        some = self.tree.isel(draw=slice(number), missing_dims="ignore").load()
        return replace(self, tree=some)

    @functools.cached_property
    def shown(self) -> "Result":
        """The first `BLOCK` draws: those that pictures and tables are of."""
        return self.first(BLOCK)

    def save(self, path: str | os.PathLike, *, double: bool = False) -> None:
        """Writes netCDF, whole or not at all.

        Parameters
        ----------
        path
            The file.
        double
            Writes all numbers as they are. Otherwise those of `SINGLE`, nearly all of a file, are
            rounded to single precision: half the size, and a ten-thousandth of a pixel, which puts
            about one draw of a million beyond a limit that it was just within.

        Raises
        ------
        BadInput
            Where it cannot be written.
        """
        save_tree(self.tree, path, {} if double else single(self.tree))


def save_tree(
    tree: xr.DataTree, path: str | os.PathLike, encoding: dict[str, Any] | None = None
) -> None:
    """Writes a tree as netCDF4, whole or not at all; `encoding` by group and variable. Raises
    `BadInput` where it cannot."""
    with replacing(path) as partial:
        tree.to_netcdf(partial, engine="netcdf4", encoding=encoding)


SINGLE = {
    "posterior": ("joints", "keypoints"),
    "posterior_predictive": ("keypoints",),
    "log_likelihood": ("keypoints",),
}
"""What files have in single precision, by group, unless somebody asks for more."""


def single(tree: xr.DataTree) -> dict[str, dict[str, dict[str, str]]]:
    """The encoding, by group and variable, of a result in single precision."""
    return {
        f"/{group}": {name: {"dtype": "float32"} for name in names}
        for group, names in SINGLE.items()
        if group in tree.children
    }


def key_words(key: jax.Array) -> str:
    """A key as the attribute `seed` has it."""
    return " ".join(map(str, words_of(key)))


@functools.cache
def versions() -> str:
    """Versions of Python and of the packages that draws depend on."""
    found = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
    return ", ".join([f"python {platform.python_version()}", *found])


def provenance(model: PoseModel) -> dict[str, str]:
    """What every result says of the model it was made with, and of the software."""
    return {
        "limits": f"{model.limits.name} {model.limits.sha256}",
        "measures": f"upper {model.upper}, lower {model.lower}",
        **({"upright": shortest(model.upright)} if model.upright else {}),
        **(_said(model.lens) if model.lens is not None else {}),
        "versions": versions(),
    }


def _said(lens: Lens) -> dict[str, str]:
    principal = " ".join(map(shortest, np.asarray(lens.principal).tolist()))
    return {"focal": shortest(lens.focal), "principal": principal}


Columns = dict[str, np.ndarray]
COLUMNS: dict[str, tuple[tuple[str, ...], str]] = {
    "joints": (("joint", "axis"), "body units"),
    "bone_length": (("length_group",), "body units"),
    "torso": ((), ""),
    "candidate": ((), ""),
    "root_index": ((), ""),
    "rotation": (("axis", "body_axis"), ""),
    "scale": ((), "pixels per body unit"),
    "translation": (("uv",), "pixels"),
    "keypoints": (("joint", "uv"), "pixels"),
    "outlier": (("joint",), ""),
    "exchange": ((), ""),
}
"""The variables of draws: what stands after chain and draw, and the unit."""
NAMES = {
    "joint": list(JOINTS),
    "axis": list("xyz"),
    "body_axis": ["left", "up", "forward"],
    "uv": list("uv"),
    "length_group": list(LENGTH_GROUPS),
}
"""The coordinates of what has names."""


def build_tree(
    posterior: Posterior,
    parts: list[RootDraws],
    attributes: dict[str, Any],
    rng: np.random.Generator | None,
    block: int = 0,
) -> xr.DataTree:
    """The DataTree of a posterior's draws, those of each root in `parts`.

    Draws are put in random order, so that any stretch of them is a sample of the mixture; without
    `rng` they stay in theirs. The attribute `seed` also decides the predictions, with the number of
    the `block` where a result is made in several.
    """
    columns = pose_columns(posterior, parts, rng)
    attributes = {"root": FIXED} | attributes | {"converged": int(posterior.converged)}
    constant = _constant_data(posterior, parts)
    return assemble(posterior, columns, constant, BASE_MEASURE, attributes, block)


def assemble(
    posterior: Posterior | UncertainPosterior,
    columns: Columns,
    constant: xr.Dataset,
    base_measure: str,
    attributes: dict[str, Any],
    block: int = 0,
) -> xr.DataTree:
    """The DataTree of draws in columns `(n, ...)`: some of `COLUMNS`, the fields of
    `KeypointsRead`, their names after "read_", and lp, log densities with respect to
    `base_measure`."""
    chain = ("chain", "draw")
    coords = {"chain": [0], "draw": np.arange(len(columns["joints"]))}
    draws: dict[str, Any] = {}
    used: set[str] = set()
    for name in [name for name in COLUMNS if name in columns]:
        dims, unit = COLUMNS[name]
        draws[name] = ((*chain, *dims), columns[name][None], {"units": unit} if unit else {})
        used.update(dims)
    names = {name: values for name, values in NAMES.items() if name in used}
    lp = (chain, columns["lp"][None], {"base_measure": base_measure})
    words = [int(word) for word in attributes["seed"].split()]
    tree = xr.DataTree.from_dict(
        {
            "posterior": xr.Dataset(draws, coords=coords | names),
            "sample_stats": xr.Dataset({"lp": lp}, coords=coords),
            **prediction_groups(
                posterior.likelihood.law,
                KeypointsRead(*(columns[f"read_{name}"] for name in KeypointsRead._fields)),
                columns["keypoints"],
                words,
                block,
            ),
            "observed_data": observed_data(posterior.detection),
            "constant_data": constant,
        }
    )
    tree.attrs.update(
        attributes,
        **provenance(posterior.model),
        source=posterior.detection.source,
        person=posterior.detection.person,
        estimator=posterior.estimator,
        errors=posterior.likelihood.words,
        moved=" ".join(posterior.detection.moved),
        body_unit="mean limb length",
    )
    return tree


def pose_columns(
    posterior: Posterior, parts: list[RootDraws], rng: np.random.Generator | None
) -> Columns:
    """Draws under all roots as columns: those of `joint_columns` but for scale, torso, the
    detection as it is read, lp; in random order, or without `rng` one root after the other."""
    columns: list[Columns] = []
    for index, (root, observation, part) in enumerate(
        zip(posterior.roots, posterior.observations, parts, strict=True)
    ):
        number = len(part.poses.length)
        density = functools.partial(log_joint, posterior.model, observation)
        seen = _seen(posterior.model, observation, part.poses)
        spread = seen.pop("scale")[:, None] * np.asarray(observation.spread)
        columns.append(
            {
                **seen,
                "torso": np.full(number, root.torso_index),
                "candidate": np.full(number, index),
                "read_detected": _tiled(posterior.detection.keypoints, number),
                "read_bias": _tiled(posterior.likelihood.bias * float(root.camera.scale), number),
                "read_spread": spread,
                "read_outlier": np.zeros((number, NUM_JOINTS), bool),
                "lp": in_chunks(density, *part.poses) if number else np.empty(0),
            }
        )
    return _shuffled(columns, rng)


def _tiled(row: np.ndarray, number: int) -> np.ndarray:
    """The same row for every draw."""
    return np.broadcast_to(row, (number, *row.shape))


def joint_columns(
    posterior: Posterior, parts: list[RootDraws], rng: np.random.Generator
) -> Columns:
    """Draws under all roots in the same random order: joints `(n, 15, 3)`, bone_length `(n, 5)`,
    keypoints `(n, 15, 2)`, candidate `(n,)` and the root's scale `(n,)` in pixels a body unit
    only."""
    columns = [
        _seen(posterior.model, observation, part.poses)
        | {"candidate": np.full(len(part.poses.length), index)}
        for index, (observation, part) in enumerate(zip(posterior.observations, parts, strict=True))
    ]
    return _shuffled(columns, rng)


def _seen(model: PoseModel, observation: Observation, poses: Pose) -> Columns:
    """Draws under one root, and where its camera sees them."""
    number = len(poses.length)
    joints, keypoints = np.empty((0, NUM_JOINTS, 3)), np.empty((0, NUM_JOINTS, 2))
    if number:
        joints, keypoints = in_chunks(functools.partial(_place, model, observation), *poses)
    return {
        "joints": joints,
        "bone_length": poses.length,
        "keypoints": keypoints,
        "scale": np.full(number, float(observation.root.camera.scale)),
    }


@kept
def _place(
    model: PoseModel,
    observation: Observation,
    length: jax.Array,
    upper: jax.Array,
    lower: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Joints of a chunk of draws in camera axes, and where they fall in the image."""
    joints = model.joints(observation.view, length, upper, lower)
    return joints, observation.root.camera.image(joints)


def _shuffled(columns: list[Columns], rng: np.random.Generator | None) -> Columns:
    joined = {key: _joined([column[key] for column in columns]) for key in columns[0]}
    if rng is None:
        return joined
    order = rng.permutation(len(joined["joints"]))
    return {key: value.take(order, axis=0) for key, value in joined.items()}


def _joined(parts: list[np.ndarray]) -> np.ndarray:
    """The rows of all parts; of one part itself, which need not be copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def observed_data(detection: Detection) -> xr.Dataset:
    """The detection with names; NaN and score 0 where a joint is missing."""
    return xr.Dataset(
        {
            "keypoints": (("joint", "uv"), detection.keypoints, {"units": "pixels"}),
            "score": (("joint",), detection.score),
        },
        coords={"joint": list(JOINTS), "uv": list("uv")},
    )


def _constant_data(posterior: Posterior, parts: list[RootDraws]) -> xr.Dataset:
    roots, one = posterior.roots, ("candidate",)
    cameras = [root.camera for root in roots]
    reach = np.stack([observation.reach for observation in posterior.observations])
    radius = np.where(np.isfinite(reach), reach, np.nan) * [[float(c.scale)] for c in cameras]
    return xr.Dataset(
        {
            "radius": ((*one, "joint"), radius),
            "scale": (one, [float(camera.scale) for camera in cameras]),
            "rotation": (
                (*one, "axis", "body_axis"),
                np.stack([np.asarray(camera.rotation) for camera in cameras]),
            ),
            "translation": (
                (*one, "uv"),
                np.stack([np.asarray(camera.translation) for camera in cameras]),
            ),
            "torso_index": (one, [root.torso_index for root in roots]),
            "reprojection_error": (one, [root.reprojection_error for root in roots]),
            "log_evidence": (one, [part.log_evidence for part in parts]),
            "log_evidence_se": (one, [part.log_evidence_se for part in parts]),
            "weight": (one, [part.weight for part in parts]),
        },
        coords={
            "candidate": np.arange(len(roots)),
            "joint": list(JOINTS),
            "axis": list("xyz"),
            "body_axis": ["left", "up", "forward"],
            "uv": list("uv"),
        },
    )
