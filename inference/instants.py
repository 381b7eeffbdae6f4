"""Posteriors of one body in several views, with names: `sample_instant(model, instant, key=…)` →
`Result`.

    session = read_session("S01/")
    result = sample_instant(PoseModel(), session.instant(20), key=0)
    result.tree["posterior"]["joints"]         # mm, in the world's axes
"""

import jax
import numpy as np
import xarray as xr

from poseterior.inference.draws import MAX_PROPOSALS, Draws, Progress, key_of
from poseterior.inference.importance.views.weighted import NUM_BODIES
from poseterior.inference.results import (
    NAMES,
    Result,
    common_columns,
    densities,
    in_draws,
    observed_data,
    provenance,
)
from poseterior.inference.sampler import sampler_of
from poseterior.probmodel.instant import Instant, InstantPosterior
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.root_priors import WORLD

COLUMNS_OF_VIEWS: dict[str, tuple[tuple[str, ...], str]] = {
    "joints": (("joint", "axis"), "mm"),
    "bone_length": (("length_group",), "body units"),
    "torso": ((), ""),
    "root_index": ((), ""),
    "rotation": (("axis", "body_axis"), ""),
    "size": ((), "mm per body unit"),
    "place": (("axis",), "mm"),
    "pointing": (("view", "uv"), "pixels"),
    "keypoints": (("view", "joint", "uv"), "pixels"),
    "outlier": (("view", "joint"), ""),
    "exchange": (("view",), ""),
}
"""The variables of draws: what stands after chain and draw, and the unit."""


def sample_instant(
    model: PoseModel,
    instant: Instant,
    *,
    key: jax.Array | int,
    sampler: str | None = None,
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    num_roots: int = NUM_BODIES,
    progress: Progress | None = None,
) -> Result:
    """Draws from the posterior of one body, given what several calibrated cameras detected.

    Parameters
    ----------
    model
        The prior of poses.
    instant
        The detections, with an error law each, as `Session.instant` gives them.
    key
        Of all draws: the same key, the same draws. A number stands for `jax.random.key` of it.
    sampler
        One of those in a world: "weighted-roots" if none is named.
    num_samples
        How many draws.
    max_proposals
        Most proposals for limbs.
    num_roots
        From how many roots draws are made.
    progress
        Called now and then with the roots made and wanted.

    Returns
    -------
    Result
        Joints in the world's axes and mm, keypoints in the straightened images of all views.

    Raises
    ------
    BadInput
        On an unknown sampler or a number that cannot be, and where the cameras do not see enough of
        the torso together, or it is behind one of them.
    """
    chosen = sampler_of(WORLD, sampler, max_proposals=max_proposals, num_roots=num_roots)
    draws = chosen.draw(instant.posterior(model), key_of(key), num_samples, progress)
    return Result(tree_of_views(draws), draws.status, draws.sentence)


def tree_of_views(draws: Draws) -> xr.DataTree:
    """The DataTree of draws of an instant."""
    posterior = draws.posterior
    assert isinstance(posterior, InstantPosterior)
    columns = columns_of_views(draws)
    named = {
        name: (*COLUMNS_OF_VIEWS[name], columns[name])
        for name in COLUMNS_OF_VIEWS
        if name in columns
    }
    labels = {"view": [view.label for view in posterior.detection.views]}
    tree = xr.DataTree.from_dict(
        {
            "posterior": in_draws(draws, named).assign_coords(labels),
            "sample_stats": densities(draws),
            "observed_data": observed_data(posterior.detection, "view").assign_coords(labels),
            "constant_data": cameras_of(posterior.detection).assign_coords(labels),
        }
    )
    tree.attrs.update(
        {"root": draws.prior.name} | draws.attributes,
        **provenance(posterior.model),
        source=posterior.detection.source,
        errors=posterior.likelihood.words,
        up=posterior.detection.up[0],
        body_unit="mean limb length",
    )
    return tree


def columns_of_views(draws: Draws) -> dict[str, np.ndarray]:
    """Draws as columns `(n, ...)`, those of `COLUMNS_OF_VIEWS` that there are."""
    columns = common_columns(draws)
    size = columns["size"][:, None, None]
    return columns | {"joints": columns["place"][:, None] + size * draws.joints}


def cameras_of(instant: Instant) -> xr.Dataset:
    """The cameras with names: from the world's axes to theirs, and where they stand."""
    rig = instant.rig
    return xr.Dataset(
        {
            "focal": (("view",), np.asarray(rig.focal), {"units": "pixels"}),
            "principal": (("view", "uv"), np.asarray(rig.principal), {"units": "pixels"}),
            "camera_rotation": (("view", "camera_axis", "axis"), np.asarray(rig.rotation)),
            "camera_centre": (("view", "axis"), np.asarray(rig.centre), {"units": "mm"}),
        },
        coords={"axis": NAMES["axis"], "camera_axis": NAMES["axis"], "uv": NAMES["uv"]},
    )
