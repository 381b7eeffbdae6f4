"""Results: draws → a DataTree with names, units and provenance, saved as netCDF; see `Result`.

Groups posterior, sample_stats, posterior_predictive, log_likelihood, observed_data, constant_data;
opened by `xarray.open_datatree` and by ArviZ."""

import functools
import importlib.metadata
import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import jax
import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from poseterior.inference.draws import Draws, KnownRoots, over_draws
from poseterior.inference.predictions import (
    FLAT_LAW,
    KeypointsRead,
    log_likelihood,
    new_detections,
)
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.documents import shortest
from poseterior.probmodel.errors.faults import ORDERS
from poseterior.probmodel.files import replacing
from poseterior.probmodel.instant import Instant
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.posterior import Posterior, log_joints
from poseterior.probmodel.root_priors import RootPrior
from poseterior.probmodel.roots import Candidate, RootPoint, nearest_rotation
from poseterior.probmodel.skeleton import JOINTS, LENGTH_GROUPS

_PACKAGES = ("poseterior", "numpyro", "jax", "numpy", "scipy", "arviz", "xarray")
BLOCK = 1 << 16
"""Draws of a large result that are in memory at a time (some 200 MB), and that its pictures and
tables are of."""


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

    def _repr_html_(self) -> str:
        said = f"{self.num_draws:,} draws by {self.tree.attrs.get('sampler', '?')}, {self.status}"
        about = f"{said}: {self.sentence}" if self.sentence else said
        return f"<p>{escape(about)}</p>{self.tree._repr_html_()}"

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
    focal = " ".join(map(shortest, np.ravel(lens.focal).tolist()))
    return {"focal": focal, "principal": principal}


BASE_MEASURE = (
    "length (5, body units) x surface of the unit sphere (9 directions) x image area (px2)"
)
"""Of log densities, after that of the root."""
VARIABLES: dict[str, tuple[tuple[str, ...], str]] = {
    "joints": (("joint", "axis"), "body units"),
    "bone_length": (("length_group",), "body units"),
    "torso": ((), ""),
    "lens": ((), ""),
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


def result_of(draws: Draws, block: int = 0) -> Result:
    """Draws with names. The attribute `seed` also decides the predictions, with the number of the
    `block` where a result is made in several."""
    return Result(tree_of(draws, block), draws.status, draws.sentence)


def tree_of(draws: Draws, block: int = 0) -> xr.DataTree:
    """The DataTree of draws, whatever sampler made them. Its log densities and predictions are
    computed when they are first read, since most readers want neither."""
    posterior, columns = draws.posterior, columns_of(draws)
    named = {name: (*VARIABLES[name], columns[name]) for name in VARIABLES if name in columns}
    groups = {
        "posterior": in_draws(draws, named),
        "sample_stats": densities(draws),
        **_predictions(draws, block),
        "observed_data": observed_data(posterior.detection),
        "constant_data": constant_data(posterior, draws.known),
    }
    if draws.root_index is not None:
        groups["roots"] = _known_roots(draws)
    tree = xr.DataTree.from_dict(groups)
    tree.attrs.update(
        {"root": draws.prior.name, "converged": int(posterior.converged)} | draws.attributes,
        **provenance(posterior.model),
        source=posterior.detection.source,
        person=posterior.detection.person,
        estimator=posterior.estimator,
        errors=posterior.likelihood.words,
        moved=" ".join(posterior.detection.moved),
        body_unit="mean limb length",
    )
    return tree


class WhenRead(BackendArray):
    """An array that is computed when it is first read, and then kept.

    Parameters
    ----------
    shape
        Of the array, of doubles.
    make
        Computes it.
    """

    dtype = np.dtype(float)

    def __init__(self, shape: tuple[int, ...], make: Callable[[], np.ndarray]) -> None:
        self.shape = shape
        self.make = make

    @functools.cached_property
    def values(self) -> np.ndarray:
        """The array."""
        return self.make().reshape(self.shape)

    def __getitem__(self, key: indexing.ExplicitIndexer) -> np.ndarray:
        kind = indexing.IndexingSupport.BASIC
        return indexing.explicit_indexing_adapter(key, self.shape, kind, self.values.__getitem__)

    def __getstate__(self) -> dict[str, Any]:
        return {"shape": self.shape, "values": self.values}


Column = tuple[tuple[str, ...], str, np.ndarray | WhenRead]
"""A variable of draws: dimensions after chain and draw, unit, values `(n, ...)`."""


def in_draws(draws: Draws, named: Mapping[str, Column]) -> xr.Dataset:
    """Variables of draws, by name."""
    shape = draws.chains, len(draws) // draws.chains
    variables = {}
    for name, (dims, unit, values) in named.items():
        whole = *shape, *values.shape[1:]
        given: Any
        if isinstance(values, WhenRead):
            given = indexing.LazilyIndexedArray(WhenRead(whole, values.make))
        else:
            given = np.reshape(values, whole)
        variables[name] = ("chain", "draw", *dims), given, {"units": unit} if unit else {}
    names = {dim: NAMES[dim] for dims, *_ in named.values() for dim in dims if dim in NAMES}
    coords = {"chain": np.arange(shape[0]), "draw": np.arange(shape[1])}
    return xr.Dataset(variables, coords=coords | names)


def columns_of(draws: Draws) -> dict[str, np.ndarray]:
    """Draws as columns `(n, ...)`, those of `VARIABLES` that there are."""
    return common_columns(draws) | {
        "joints": draws.joints,
        "candidate": draws.prior.sides(draws.points, draws.posterior.candidates),
    }


def common_columns(draws: Draws) -> dict[str, np.ndarray]:
    """The columns that draws have whatever was detected: of one view, or of several."""
    columns = draws.prior.columns(draws.points) | {
        "bone_length": draws.bone_length,
        "keypoints": draws.keypoints,
    }
    if draws.root_index is not None:
        columns["root_index"] = draws.root_index
    if draws.posterior.faults.any:
        columns |= {"outlier": draws.faults.outlier, "exchange": draws.faults.exchange}
    return columns


def densities(draws: Draws) -> xr.Dataset:
    """The log joint density of draws with names, computed when it is first read."""
    lp = WhenRead((len(draws),), lambda: log_density(draws))
    found = in_draws(draws, {"lp": ((), "", lp)})
    found["lp"].attrs["base_measure"] = f"{draws.prior.base_measure} x {BASE_MEASURE}"
    return found


def log_density(draws: Draws) -> np.ndarray:
    """`(n,)`: the log joint density of draws, that of the program."""
    posterior = draws.posterior
    if not len(draws):
        return np.empty(0)
    given = posterior.model, posterior.detected, posterior.root_prior, posterior.faults
    return over_draws(log_joints, given, draws.points, draws.poses, draws.faults)


def _predictions(draws: Draws, block: int) -> dict[str, xr.Dataset]:
    """`posterior_predictive`: `keypoints` (chain, draw, joint, uv), pixels, NaN where a joint does
    not count. `log_likelihood`: `keypoints` (chain, draw, detected), of the joints that count, per
    square pixel; left out under a law that is flat, see `FLAT_LAW`."""
    law, number = draws.posterior.likelihood.law, len(draws)
    words = [int(word) for word in draws.attributes["seed"].split()]
    defined = functools.cache(lambda: _defined(draws))
    read = functools.cache(lambda: _as_read(draws, defined()[0]))
    new = WhenRead(
        (number, len(JOINTS), 2),
        lambda: new_detections(law, read(), defined()[1], words, block),
    )
    predicted = in_draws(draws, {"keypoints": (("joint", "uv"), "pixels", new)})
    if law.follows(0.0):  # uniform within its reach
        return {"posterior_predictive": predicted.assign_attrs(log_likelihood=FLAT_LAW)}
    patterns = ORDERS[np.bincount(draws.faults.exchange, minlength=len(ORDERS)) > 0]
    counts = np.isfinite(np.asarray(draws.posterior.detected.spread))[patterns].any(axis=0)
    seen = np.flatnonzero(counts)
    likely = WhenRead(
        (number, len(seen)), lambda: log_likelihood(law, read(), defined()[1])[:, seen]
    )
    found = in_draws(draws, {"keypoints": (("detected",), "", likely)})
    found["keypoints"].attrs["base_measure"] = "image area (px2)"
    named = found.assign_coords(detected=[JOINTS[joint] for joint in seen])
    return {"posterior_predictive": predicted, "log_likelihood": named}


def _defined(draws: Draws) -> tuple[np.ndarray, np.ndarray]:
    """What the detector looks for in each draw, `(n, 15, 3)` in camera axes, and where that falls
    in the image, `(n, 15, 2)` pixels: the joints, but for its definitions."""
    posterior = draws.posterior
    if posterior.detected.definition is None or not len(draws):
        return draws.joints, draws.keypoints
    given = posterior.detected, posterior.root_prior
    return over_draws(_place_defined, given, draws.points, draws.joints)


@jax.jit
def _place_defined(
    detected: DetectedJoints, prior: RootPrior, points: Any, joints: jax.Array
) -> tuple[jax.Array, jax.Array]:
    def one(point: Any, joints: jax.Array) -> tuple[jax.Array, jax.Array]:
        seen = detected.under(prior, point)
        places = seen.defined(joints)
        return places, seen.root.camera.image(places)

    return jax.vmap(one)(points, joints)


def _as_read(draws: Draws, points: np.ndarray) -> KeypointsRead:
    """The detection of `points` `(n, 15, 3)` as the pattern of faults of each draw has it."""
    posterior = draws.posterior
    order = ORDERS[draws.faults.exchange]
    spread = np.asarray(posterior.detected.spread)[order]
    outlier = np.take_along_axis(draws.faults.outlier, order, axis=1) & np.isfinite(spread)
    bias = np.where(outlier[..., None], 0.0, posterior.likelihood.bias[order])
    unit = _units(draws, points)
    return KeypointsRead(
        posterior.detection.keypoints[order],
        unit[..., None] * bias,
        unit * np.where(outlier, posterior.faults.reach, spread),
        outlier,
    )


def _units(draws: Draws, points: np.ndarray) -> np.ndarray:
    """`(n, 15)`: pixels of a body unit at points `(n, 15, 3)` in camera axes."""
    scale, focal = draws.scale[:, None], focal_of(draws)
    nearness = 0.0 if focal is None else 1 / focal[:, None]
    return scale / (1 + nearness * scale * points[:, :, 2])


def focal_of(draws: Draws) -> np.ndarray | None:
    """`(n,)`: the focal length of each draw, pixels; None under weak perspective."""
    lens = draws.posterior.model.lens
    if lens is None:
        return None
    rows = draws.cameras.lens
    focal = np.asarray(lens.focal)
    return np.full(len(draws), focal) if rows is None else focal[rows]


def observed_data(detection: Detection | Instant, *views: str) -> xr.Dataset:
    """What was detected, with names, the dimension of `views` first where there is one; NaN and
    score 0 where a joint is missing."""
    return xr.Dataset(
        {
            "keypoints": ((*views, "joint", "uv"), detection.keypoints, {"units": "pixels"}),
            "score": ((*views, "joint"), detection.score),
        },
        coords={name: NAMES[name] for name in ("joint", "uv")},
    )


def constant_data(posterior: Posterior, known: KnownRoots) -> xr.Dataset:
    """What is known of each side, which is a candidate of the estimator: its share of the posterior
    and evidence, and the mean of its roots' cameras."""
    side = posterior.root_prior.sides(known.points, posterior.candidates)
    points, number = posterior.root_prior.points(known.points), max(1, len(posterior.candidates))
    found: list[dict[str, Any]] = []
    for index in range(number):
        rows = np.flatnonzero(side == index)
        evidence = dict(zip(("log_evidence", "log_evidence_se"), known.evidence(rows), strict=True))
        found.append(_side(posterior, points.take(rows), known.share[rows], index) | evidence)
    columns = {name: np.array([one[name] for one in found]) for name in found[0]}
    spread = np.asarray(posterior.detected.spread)
    reach = posterior.likelihood.law.reach * np.where(np.isfinite(spread), spread, np.nan)
    columns["radius"] = columns["scale"][:, None] * reach[None]
    dims = {"rotation": ("axis", "body_axis"), "translation": ("uv",), "radius": ("joint",)}
    return xr.Dataset(
        {name: (("candidate", *dims.get(name, ())), column) for name, column in columns.items()},
        coords={"candidate": np.arange(number)}
        | {name: NAMES[name] for name in ("joint", "axis", "body_axis", "uv")},
    )


def _side(posterior: Posterior, points: RootPoint, share: np.ndarray, index: int) -> dict[str, Any]:
    """Of a side's roots: their share, mean camera and its spread, and the torso that has most of
    it. The estimator's candidate where they have no weight."""
    weight = share.sum()
    found: dict[str, Any] = {"weight": float(weight), "num_torsos": 0}
    found |= dict.fromkeys(("reprojection_error", "scale_sd", "turn_sd"), np.nan)
    if posterior.candidates:
        found |= _of_candidate(posterior, posterior.candidates[index])
    elif not weight:
        nowhere = {"scale": np.nan, "rotation": np.full((3, 3), np.nan), "torso_index": -1}
        return found | nowhere | {"translation": np.full(2, np.nan)}
    if not weight:
        return found
    share = share / weight
    scale = np.exp(points.log_scale)
    mean = float(share @ scale)
    rotation = nearest_rotation(np.einsum("n,nij->ij", share, points.rotation))
    cosine = (np.einsum("nij,ij->n", points.rotation, rotation) - 1) / 2
    turn = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    torsos, torso = np.unique(points.torso, return_inverse=True)
    by_torso = np.bincount(torso, weights=share)
    return found | {
        "scale": mean,
        "scale_sd": float(np.sqrt(share @ (scale - mean) ** 2)),
        "rotation": rotation,
        "turn_sd": float(np.sqrt(share @ turn**2)),
        "translation": share @ points.translation,
        "torso_index": int(torsos[np.argmax(by_torso)]),
        "num_torsos": int(np.count_nonzero(by_torso)),
    }


def _of_candidate(posterior: Posterior, one: Candidate) -> dict[str, Any]:
    return {
        "scale": float(one.camera.scale),
        "rotation": np.asarray(one.camera.rotation),
        "translation": np.asarray(one.camera.translation),
        "torso_index": one.torso_index,
        "reprojection_error": posterior.root_prior.error_of(one),
    }


def _known_roots(draws: Draws) -> xr.Dataset:
    """All roots that were weighed."""
    posterior, known, one = draws.posterior, draws.known, ("root",)
    columns = draws.prior.columns(known.points) | {
        "candidate": draws.prior.sides(known.points, posterior.candidates),
        "share": known.share,
        **known.columns,
    }
    return xr.Dataset(
        {
            name: ((*one, *VARIABLES.get(name, ((), ""))[0]), column, _units_of(name))
            for name, column in columns.items()
        },
        coords={"root": np.arange(len(known.share))}
        | {name: NAMES[name] for name in ("axis", "body_axis", "uv")},
    )


def _units_of(name: str) -> dict[str, str]:
    unit = VARIABLES.get(name, ((), ""))[1]
    return {"units": unit} if unit else {}
