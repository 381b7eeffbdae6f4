"""Draws of the prior as a DataTree: what is possible before anything was seen."""

from collections.abc import Callable

import jax
import numpy as np
import xarray as xr
from numpyro.infer import Predictive
from numpyro.infer.util import log_density

from poseterior.inference.draws import key_words
from poseterior.inference.results import NAMES, VARIABLES, provenance
from poseterior.probmodel.chunks import CHUNK
from poseterior.probmodel.failures import require_some
from poseterior.probmodel.model import PoseModel


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
    require_some(num_samples, "samples")
    parts = []
    for chunk in range(-(-num_samples // CHUNK)):
        parts.append(jax.tree.map(np.asarray, _draw(jax.random.fold_in(key, chunk), model)))
        if progress:
            progress(min((chunk + 1) * CHUNK, num_samples), num_samples)
    drawn = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    drawn = {name: column[None, :num_samples] for name, column in drawn.items()}
    coords = {"chain": [0], "draw": np.arange(num_samples)}
    prior = xr.Dataset(
        {
            name: (("chain", "draw", *dims), drawn[name], {"units": unit} if unit else {})
            for name, (dims, unit) in VARIABLES.items()
            if name in ("joints", "bone_length", "torso")
        },
        coords=coords | {dim: NAMES[dim] for dim in ("joint", "axis", "length_group")},
    )
    stats = xr.Dataset({"lp": (("chain", "draw"), drawn["lp"])}, coords=coords)
    tree = xr.DataTree.from_dict({"prior": prior, "sample_stats_prior": stats})
    tree.attrs.update(
        sampler="prior",
        seed=key_words(key),
        axes="body: x to the person's left, y up, z forward",
        **provenance(model),
    )
    return tree


@jax.jit
def _draw(key: jax.Array, model: PoseModel) -> dict[str, jax.Array]:
    drawn = Predictive(model.prior, num_samples=CHUNK, parallel=True)(key)
    sites = {name: drawn[name] for name in ("torso", "bone_length", "upper", "lower")}
    lp = jax.vmap(lambda one: log_density(model.prior, (), {}, one)[0])(sites)
    return {**drawn, "lp": lp}
