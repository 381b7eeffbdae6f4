"""A result read back from its netCDF file: what tables and pages ask of it.

    read_result("result/posterior.nc").tree

The file is read as any other that may come from a stranger (docs/security.md): sizes are checked
before memory is taken, and nothing but plain arrays, texts and numbers is looked at.
"""

import os
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.results import NAMES, Result
from poseterior.probmodel.arrays import HDF5, ArrayFile, doubles
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import opened
from poseterior.probmodel.root_priors import UNCERTAIN, WORLD
from poseterior.probmodel.skeleton import NUM_JOINTS

WHAT, ADVICE = "posterior.nc of poseterior", "give one that `poseterior` wrote"
_CANDIDATE = {
    "radius": ("joint",),
    "rotation": ("axis", "body_axis"),
    "scale": (),
    "translation": ("uv",),
    "weight": (),
    "log_evidence": (),
    "log_evidence_se": (),
    "reprojection_error": (),
    "torso_index": (),
}
_SPREADS: dict[str, tuple[str, ...]] = {"scale_sd": (), "turn_sd": (), "num_torsos": ()}
"""What an uncertain root has besides."""
_SIZES = {"joint": NUM_JOINTS, "axis": 3, "uv": 2, "body_axis": 3}
_COUNTS = ("num_proposals", "wall_time_s")
_NUMBERS = (*_COUNTS, "acceptance_rate", "log_evidence", "log_evidence_se")
_TEXTS = ("source", "sampler", "seed", "limits", "measures", "status")
_MISSING = (
    "observed_data/keypoints",
    "constant_data/radius",
    "constant_data/reprojection_error",  # of a side's mean camera there is none
    *(f"constant_data/{name}" for name in _SPREADS),
)
"""What is not a number where there is none."""
_EVIDENCES = ("constant_data/log_evidence", "constant_data/log_evidence_se")
"""What may be no number at all."""
_TURNED = 1e-3
"""How far a rotation's columns may be from orthonormal: files may be in single precision."""
LONGEST_TEXT = 5000
"""Characters of an attribute; the longest name of a file has 4,096."""


def _variables(root: object) -> dict[str, tuple[str, ...]]:
    """What is read under such a prior of the root, and its dimensions."""
    found: dict[str, tuple[str, ...]] = {"posterior/joints": ("chain", "draw", "joint", "axis")}
    if root == WORLD:
        return found
    found |= {
        "posterior/keypoints": ("chain", "draw", "joint", "uv"),
        "posterior/candidate": ("chain", "draw"),
        "observed_data/keypoints": ("joint", "uv"),
        "observed_data/score": ("joint",),
    }
    by_candidate = _CANDIDATE | (_SPREADS if root == UNCERTAIN else {})
    return found | {
        f"constant_data/{name}": ("candidate", *dims) for name, dims in by_candidate.items()
    }


def read_result(path: str | os.PathLike) -> Result:
    """A saved result, without what nobody asks of it: lengths, densities, predictions, all roots;
    of several views, nothing but joints.

    Parameters
    ----------
    path
        A posterior.nc.

    Raises
    ------
    BadInput
        Where there is no such file, it is damaged, or not one of ours.
    """
    with opened(path, WHAT, ADVICE) as file:
        found = ArrayFile(file, str(path), WHAT, ADVICE)
        found.require(HDF5)
        attributes = found.own_attributes()
        variables = _variables(attributes.get("root"))
        arrays = found.read(list(variables))
    for name in variables:
        if name not in arrays:
            raise BadInput(f"{path} lacks {name}; {ADVICE}")
    tree = _tree(arrays, variables, path)
    tree.attrs.update(_checked(attributes, path))
    return Result(tree, str(tree.attrs["status"]))


def _tree(
    arrays: dict[str, np.ndarray], variables: dict[str, tuple[str, ...]], path: str | os.PathLike
) -> xr.DataTree:
    sizes = dict(_SIZES)
    groups: dict[str, dict[str, Any]] = {}
    for name, dims in variables.items():
        array = arrays[name]
        known = len(dims) == array.ndim and all(
            sizes.setdefault(dim, size) == size for dim, size in zip(dims, array.shape, strict=True)
        )
        if not known or array.dtype.kind not in "fiu":
            raise BadInput(f"{path} has {name} of shape {array.shape}; {ADVICE}")
        group, _, variable = name.partition("/")
        groups.setdefault(group, {})[variable] = (dims, _plain(array))
        _require_numbers(name, groups[group][variable][1], path)
    _require_possible(groups, path)
    return xr.DataTree.from_dict(
        {
            group: xr.Dataset(found).assign_coords(
                {dim: NAMES[dim] for dim in _SIZES if any(dim in one[0] for one in found.values())}
            )
            for group, found in groups.items()
        }
    )


def _plain(array: np.ndarray) -> np.ndarray:
    return array.astype(np.int64) if array.dtype.kind in "iu" else doubles(array)


def _require_possible(groups: dict[str, dict[str, Any]], path: str | os.PathLike) -> None:
    """Raises `BadInput` where there is no draw, or what there is cannot be of one view."""
    known = {name: values for group in groups.values() for name, (_, values) in group.items()}
    if not known["joints"].size or ("weight" in known and not len(known["weight"])):
        raise BadInput(
            f"{path} holds no draw; sample again, with more --max-proposals on the command line"
        )
    if "weight" in known:  # of several views there are no candidates
        _require_candidates(known, path)


def _require_candidates(known: dict[str, np.ndarray], path: str | os.PathLike) -> None:
    """Raises `BadInput` where a draw's candidate is none of those listed, or these have no
    camera."""
    if not ((known["candidate"] >= 0) & (known["candidate"] < len(known["weight"]))).all():
        raise BadInput(f"{path} has draws of candidates that it does not list; {ADVICE}")
    turned = np.swapaxes(known["rotation"], 1, 2) @ known["rotation"] - np.eye(3)
    if np.abs(turned).max() > _TURNED or (known["scale"] <= 0).any() or (known["weight"] < 0).any():
        raise BadInput(f"{path} has a candidate with a camera or a weight that none has; {ADVICE}")


def _require_numbers(name: str, values: np.ndarray, path: str | os.PathLike) -> None:
    """Raises `BadInput` where there is something that such a variable cannot hold."""
    possible = np.abs(values) <= LARGEST_NUMBER
    if name in _EVIDENCES:
        possible |= ~np.isfinite(values)
    elif name in _MISSING:
        possible |= np.isnan(values)
    if not possible.all():
        raise BadInput(f"{path} has {values[~possible][0]:g} in {name}; {ADVICE}")


def _checked(attributes: Any, path: str | os.PathLike) -> dict[str, Any]:
    """The attributes, with those that every result has. Raises `BadInput` where one is missing, or
    cannot be."""
    kinds: dict[str, Any] = dict.fromkeys(_TEXTS, str) | dict.fromkeys(_NUMBERS, (int, float))
    if attributes.get("root") == UNCERTAIN:
        kinds |= dict.fromkeys(("num_roots", "effective_roots"), (int, float))
    own: dict[str, Any] = {"up": str} if attributes.get("root") == WORLD else {"person": int}
    for name, kind in (kinds | own).items():
        if not isinstance(attributes.get(name), kind):
            raise BadInput(f"{path} does not say its {name}; {ADVICE}")
    for name, value in attributes.items():
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            raise BadInput(f"{path} has {len(value):,} characters in its {name}; {ADVICE}")
    for name in _COUNTS:
        if not 0 <= attributes[name] < 1e18:  # false for NaN too
            raise BadInput(f"{path} says {attributes[name]:g} of its {name}; {ADVICE}")
    return dict(attributes)
