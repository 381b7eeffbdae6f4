"""A result as ArviZ's functions ask for it: without what never varies, and with detections of those
joints alone that count."""

from typing import Literal

import numpy as np
import xarray as xr

from poseterior.probmodel.failures import BadInput

_LABELS = ("torso", "candidate", "root_index", "exchange", "outlier")
"""Numbers of things: no kernel density and no rank is of them."""
_COMPARED = ("posterior", "sample_stats", "posterior_predictive", "observed_data")


def for_arviz(tree: xr.DataTree, axis: Literal["u", "v"] | None = None) -> xr.DataTree:
    """A result in the form in which ArviZ's functions take a posterior.

    Parameters
    ----------
    tree
        That of a `Result`, or `xarray.open_datatree("posterior.nc")`.
    axis
        Of the image: the groups of detections then hold one number a joint, as `loo_pit`,
        `plot_loo_pit`, `plot_ppc_pit` and `plot_loo_interval` need it; a joint that is left out is
        left out with both of its coordinates. None keeps both.

    Returns
    -------
    DataTree
        `posterior` without the pelvis (the origin), labels, and keypoints (which follow from the
        rest); `observed_data`, `posterior_predictive` and `log_likelihood` of the joints that
        count, under one dimension `joint`; `constant_data` with the scores; `log_prior`, the log
        density less the log likelihood, where there is one (under a flat law there is none, and
        what asks for it refuses).

    Raises
    ------
    BadInput
        Where it is no result of `poseterior`, or has no such axis.
    """
    lost = [name for name in _COMPARED if name not in tree.children]
    if lost:
        raise BadInput(f"ArviZ compares the groups of a result, and {lost[0]} is missing")
    if axis not in (None, "u", "v"):
        raise BadInput(f"the axes of an image are u and v, not {axis!r}")
    predicted = tree["posterior_predictive"].to_dataset()
    counts = np.isfinite(predicted.keypoints).all(["chain", "draw", "uv"]).values
    seen = predicted.joint.values[counts]
    at = {"joint": seen} if axis is None else {"joint": seen, "uv": axis}
    observed = tree["observed_data"].to_dataset()
    groups = {
        "posterior": _varying(tree["posterior"].to_dataset()),
        "sample_stats": tree["sample_stats"].to_dataset(),
        "posterior_predictive": predicted.sel(at),
        "observed_data": observed[["keypoints"]].sel(at),
        "constant_data": observed[["score"]],
    }
    if "log_likelihood" in tree.children:
        likelihood = tree["log_likelihood"].to_dataset().rename(detected="joint")
        groups["log_likelihood"] = likelihood
        log_prior = tree["sample_stats"].lp - likelihood.keypoints.sum("joint")
        groups["log_prior"] = xr.Dataset({"pose": log_prior})
    found = xr.DataTree.from_dict(groups)
    found.attrs.update(tree.attrs)
    return found


def _varying(posterior: xr.Dataset) -> xr.Dataset:
    """What differs between draws and is a continuous number."""
    joints = [name for name in posterior.joint.values if name != "pelvis"]
    return posterior.drop_vars([*_LABELS, "keypoints"], errors="ignore").sel(joint=joints)
