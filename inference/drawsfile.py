"""Draws straight to disk: a result of any number of draws, in bounded memory.

    result = sample_to_file("posterior.nc", model, frame, key=jax.random.key(0),
                            num_samples=1_000_000)

Exact rejection and weighted roots make them block by block; each is a sample of the posterior, is
written, and is forgotten. The file is that of `Result.save`, and appears when it
is whole.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import netCDF4
import numpy as np
import xarray as xr

from poseterior.inference.draws import MAX_PROPOSALS, Draws, Progress, key_of
from poseterior.inference.exact import warm_up
from poseterior.inference.importance.weighted import NUM_ROOTS
from poseterior.inference.results import BLOCK, Result, result_of, single
from poseterior.inference.sampler import estimated, require_chains, sampler_of
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.files import replacing
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import UNCERTAIN

CHUNK = 1 << 12
"""Draws that a file which grows has side by side: those of one joint are read without the rest."""
_LAST = ("log_evidence", "log_evidence_se", "weight")
"""What is known of the candidates only when all is drawn."""


def sample_to_file(
    path: str | os.PathLike,
    model: PoseModel,
    frame: Estimate | Detection,
    *,
    key: jax.Array | int,
    sampler: str | None = None,
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    chains: int = 1,
    root: str = UNCERTAIN,
    num_roots: int = NUM_ROOTS,
    most_roots: int | None = None,
    double: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Draws as `inference.sample` makes them, saved in a file.

    More than `BLOCK` draws of exact rejection in one chain, or of weighted roots, never are in
    memory together: the result's tree then reads them from the file as they are asked for. They are
    other ones, as random, than `sample` makes for the same key. Other samplers draw first, and then
    save.

    Parameters
    ----------
    path
        The netCDF file. None is written where there is no draw.
    model, frame, key, sampler, num_samples, max_proposals, chains, root, num_roots, most_roots
        As of `inference.sample`.
    double
        As of `Result.save`.
    progress
        As of `inference.sample`.

    Returns
    -------
    Result
        As of `inference.sample`.

    Raises
    ------
    BadInput
        As `inference.sample` does, and where the file cannot be written.
    """
    chosen = sampler_of(
        root,
        sampler,
        max_proposals=max_proposals,
        num_roots=num_roots,
        most_roots=most_roots,
        chains=require_chains(root, sampler, chains),
    )
    posterior = estimated(frame).posterior(model, root)
    blocks = chosen.blocks(posterior, key_of(key), num_samples, block=BLOCK, progress=progress)
    if num_samples > BLOCK:
        return _written(path, blocks, double)
    (draws,) = blocks
    warm_up.finish()
    result = result_of(draws)
    if result.num_draws:
        result.save(path, double=double)
    return result


def _written(path: str | os.PathLike, blocks: Iterator[Draws], double: bool) -> Result:
    """Blocks in one file, and the result that reads them from there. Where the first one has no
    draw, that one itself."""
    last = result_of(next(blocks))
    if not last.num_draws:
        return last
    encoding = {} if double else single(last.tree)
    with (
        replacing(path) as partial,
        contextlib.closing(DrawsFile(partial, last.tree, encoding)) as file,
    ):
        _let_go(last.tree)
        for number, draws in enumerate(blocks, 1):
            last = result_of(draws, number)
            file.append(last.tree)
            _let_go(last.tree)
    return Result(xr.open_datatree(path, engine="netcdf4"), last.status, last.sentence)


def _let_go(tree: xr.DataTree) -> None:
    """Frees the memory of a tree that nobody looks at again: parents and children hold each other,
    and Python would wait with them until it has made many more objects."""
    for group in list(tree.children.values()):
        group.orphan()


class DrawsFile:
    """A netCDF file that trees of draws are appended to.

    Parameters
    ----------
    path
        Of the file, which is written at once.
    tree
        The first draws, with everything that is no draw.
    encoding
        By group and variable, as of `xarray`.
    """

    def __init__(self, path: Path, tree: xr.DataTree, encoding: dict[str, dict[str, Any]]) -> None:
        self._groups = [name for name, group in tree.children.items() if "draw" in group.dims]
        chunked = {
            f"/{name}": _chunked(tree[name].to_dataset(), encoding.get(f"/{name}", {}))
            for name in self._groups
        }
        unlimited = {f"/{name}": ["draw"] for name in self._groups}
        tree.to_netcdf(path, engine="netcdf4", encoding=chunked, unlimited_dims=unlimited)
        self._file = netCDF4.Dataset(path, "a")
        self._file.set_auto_maskandscale(False)
        for name in self._groups:
            for variable in self._file[name].variables.values():
                if "draw" in variable.dimensions:
                    variable.set_var_chunk_cache(0)  # whole chunks are written, and not read again
        self._size = tree["posterior"].sizes["draw"]

    def append(self, tree: xr.DataTree) -> None:
        """Adds draws; what their tree says of the whole run replaces what was said before."""
        rows = slice(self._size, self._size + tree["posterior"].sizes["draw"])
        for name in self._groups:
            for variable, values in tree[name].to_dataset().variables.items():
                if "draw" in values.dims:
                    where = tuple(rows if dim == "draw" else slice(None) for dim in values.dims)
                    added = (
                        np.arange(rows.start, rows.stop) if variable == "draw" else values.values
                    )
                    self._file[name][variable][where] = added
        for variable in _LAST:
            self._file["constant_data"][variable][:] = tree["constant_data"][variable].values
        self._file.setncatts({str(name): value for name, value in tree.attrs.items()})
        self._size = rows.stop

    def close(self) -> None:
        """Ends the file."""
        self._file.close()


def _chunked(group: xr.Dataset, encoding: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The encoding with chunks along the draws."""
    return {
        str(name): {
            **encoding.get(str(name), {}),
            "chunksizes": tuple(
                CHUNK if dim == "draw" else group.sizes[dim] for dim in variable.dims
            ),
        }
        for name, variable in group.variables.items()
        if "draw" in variable.dims
    }
