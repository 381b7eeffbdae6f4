"""Draws of the prior as a DataTree: what is possible before anything was seen."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from inference.results import key_words, versions
from probmodel.anatomy.lengths import BoneLength
from probmodel.anatomy.torsos import TorsoDictionary
from probmodel.chunks import CHUNK
from probmodel.directions.distributions import HingedDirection, OccupiedDirection
from probmodel.failures import BadInput
from probmodel.model import PoseModel
from probmodel.skeleton import JOINTS, LENGTH_GROUPS


def sample_prior(
    model: PoseModel,
    *,
    key: jax.Array,
    num_samples: int,
    progress: Callable[[int, int], None] | None = None,
) -> xr.DataTree:
    """`num_samples` independent poses in body axes, body units, as group `prior` (chain, draw,
    joint, axis).

    Raises `BadInput` on a number of samples below one.
    """
    if num_samples < 1:
        raise BadInput(f"the number of samples must be at least 1, not {num_samples}")
    parts = []
    for chunk in range(-(-num_samples // CHUNK)):
        parts.append(jax.tree.map(np.asarray, _draw(jax.random.fold_in(key, chunk), model)))
        if progress:
            progress(min((chunk + 1) * CHUNK, num_samples), num_samples)
    columns = (np.concatenate(column)[None, :num_samples] for column in zip(*parts, strict=True))
    torso, length, joints, lp = columns
    coords = {"chain": [0], "draw": np.arange(num_samples)}
    prior = xr.Dataset(
        {
            "joints": (("chain", "draw", "joint", "axis"), joints, {"units": "body units"}),
            "bone_length": (("chain", "draw", "length_group"), length, {"units": "body units"}),
            "torso": (("chain", "draw"), torso),
        },
        coords=coords
        | {
            "joint": list(JOINTS),
            "axis": list("xyz"),
            "length_group": list(LENGTH_GROUPS),
        },
    )
    stats = xr.Dataset({"lp": (("chain", "draw"), lp)}, coords=coords)
    tree = xr.DataTree.from_dict({"prior": prior, "sample_stats_prior": stats})
    tree.attrs.update(
        sampler="prior",
        seed=key_words(key),
        limits=f"{model.limits.name} {model.limits.sha256}",
        measures=f"upper {model.upper}, lower {model.lower}",
        axes="body: x to the person's left, y up, z forward",
        versions=versions(),
    )
    return tree


@jax.jit
def _draw(key: jax.Array, model: PoseModel) -> tuple[jax.Array, ...]:
    for_torso, for_length, for_upper, for_lower = jax.random.split(key, 4)
    torso = TorsoDictionary(model.torsos).sample(for_torso, (CHUNK,))
    length = BoneLength(model.lengths).sample(for_length, (CHUNK,))
    upper = OccupiedDirection(model.cells).sample(for_upper, (CHUNK,))
    lower = HingedDirection(model.hinges_at(upper)).sample(for_lower)
    joints = model.joints(jnp.asarray(model.torsos)[torso], length, upper, lower)
    return (
        torso,
        length,
        joints,
        model.log_prior(length, upper, lower) - jnp.log(model.torsos.shape[0]),
    )
