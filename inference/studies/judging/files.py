"""Draws beside truths from files: .npz, netCDF4 (an xarray DataTree), Zarr where that package is.

An .npz has `draws` `(instances, draws, quantities)` and `truth`, or what sbi calls them
(`posterior_samples` `(draws, instances, quantities)` and `thetas`), or bayesflow's dictionaries
flattened (`estimates.NAME`, `targets.NAME`). A tree has groups `posterior` and `truth` (ArviZ: the
instances are a dimension of both, `chain` and `draw` of the first), and may have `sample_stats`
(`lp`, `log_weights`) and `covariates`. Draws of a tree are read in blocks of instances."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.resampling import WEIGHTS
from poseterior.inference.studies.judging.brought import Brought
from poseterior.probmodel.arrays import HDF5, ArrayFile, read_tables
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import opened

_WHAT = "file of draws and truths"
_ADVICE = (
    "write one with numpy.savez(path, draws=draws, truth=truth), draws of (instances, draws,"
    " quantities)"
)
DRAWS, TRUTH = ("draws", "posterior_samples"), ("truth", "thetas")
"""Ours, then sbi's, whose draws come first."""
COVARIATES_GROUP = "covariates"
WHICH_FILE = "file"
"""The covariate that says from which of several files an instance is."""
CHAINS = ("chain", "draw")
IN_BLOCK = 64
"""Instances that are read from a tree at a time."""


@dataclass
class InBlocks:
    """The draws of a tree `(instances, draws, q)`, of which a block is held at a time."""

    variables: list[xr.DataArray]
    first: int = -1
    held: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Instances, draws, quantities."""
        sizes = [int(np.prod(one.shape[2:], dtype=int)) for one in self.variables]
        instances, draws = self.variables[0].shape[:2]
        return instances, draws, sum(sizes)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self.fetch(0, self.shape[0])

    def fetch(self, first: int, end: int) -> np.ndarray:
        """The draws of some instances."""
        parts = [one[first:end].values.astype(float) for one in self.variables]
        return np.concatenate([part.reshape(*part.shape[:2], -1) for part in parts], axis=2)

    def __getitem__(self, index: int) -> np.ndarray:
        first = index - index % IN_BLOCK
        if first != self.first:
            self.held = self.fetch(first, first + IN_BLOCK)
            self.first = first
        return self.held[index - first]


def read_brought(path: Path, circular: tuple[str, ...] = ()) -> Brought:
    """What a file holds. Raises `BadInput` where it is none of the kinds above, is damaged, or what
    it holds cannot be judged."""
    if path.is_dir():
        return _of_tree(_zarr(path), path, circular)
    if _is_tree(path):
        return _of_tree(xr.open_datatree(path, engine="netcdf4"), path, circular)
    return _of_tables(read_tables(path, _WHAT, _ADVICE), path, circular)


Levels = tuple[xr.DataArray, dict[str, np.ndarray]]
"""Levels (simulation, quantity), and covariates by name."""


def read_judged(path: Path, circular: tuple[str, ...] = ()) -> Brought | Levels:
    """As `read_brought`; of a coverage.nc, whose draws are gone, levels and covariates, NaN for
    instances that failed. Raises `BadInput` as it."""
    if not path.is_dir() and _is_tree(path):
        with xr.open_datatree(path, engine="netcdf4") as tree:
            table = _group(tree, "simulation").load()
            if "posterior" not in tree.children and "level" in table:
                if circular:
                    raise BadInput(
                        f"{path} has no draws any more, and so nothing that could be circular;"
                        " leave `circular` out (on the command line --circular)"
                    )
                columns = _group(tree, COVARIATES_GROUP).load()
                return table["level"], {str(name): one.values for name, one in columns.items()}
    return read_brought(path, circular)


def joined(files: Mapping[str, Brought | Levels]) -> Levels:
    """What some coverage.nc have in common, one after the other, and as a covariate more which file
    it is. Raises `BadInput` where one of them is something else, or they have nothing in common."""
    parts: dict[str, Levels] = {}
    for name, one in files.items():
        if isinstance(one, Brought):
            raise BadInput(
                f"{name} has draws; only what `coverage` wrote (coverage.nc) is judged together,"
                " so judge it by itself, or put the draws into one file"
            )
        parts[name] = one
    levels = xr.concat([level for level, _ in parts.values()], "simulation", join="inner")
    if not levels.sizes["quantity"]:
        raise BadInput(f"{' and '.join(parts)} have no quantity in common; judge them one by one")
    each = [known for _, known in parts.values()]
    columns = {
        name: np.concatenate([known[name] for known in each])
        for name in each[0]
        if all(name in known for known in each)
    }
    for name in columns:
        if len({known[name].dtype.kind in "US" for known in each}) > 1 or name == WHICH_FILE:
            raise BadInput(
                f"the covariate {name} of {' and '.join(parts)} is not one: in some files numbers,"
                " in others words, or a file's own number; give it another name"
            )
    owner = np.repeat(list(parts), [level.sizes["simulation"] for level, _ in parts.values()])
    levels = levels.assign_coords(simulation=np.arange(levels.sizes["simulation"]))
    return levels, columns | {WHICH_FILE: owner}


def of_some_alone(files: Mapping[str, Brought | Levels]) -> list[str]:
    """Quantities and covariates that `joined` leaves out, since not all of the files have them."""
    levels = [one for one in files.values() if not isinstance(one, Brought)]
    each = [[*map(str, level["quantity"].values), *known] for level, known in levels]
    every = dict.fromkeys(itertools.chain(*each))
    return [name for name in every if not all(name in one for one in each)]


def _is_tree(path: Path) -> bool:
    """Whether it is HDF5, then one that another library may read. Raises `BadInput` where it is
    not such a one, or cannot be read."""
    with opened(path, _WHAT, _ADVICE) as file:
        found = ArrayFile(file, str(path), _WHAT, _ADVICE)
        if found.magic != HDF5:
            return False
        found.require_credible()
    return True


def _zarr(path: Path) -> xr.DataTree:
    try:
        import zarr  # noqa: F401
    except ImportError:
        raise BadInput(
            f"{path} is a folder, and Zarr's package is not installed; install zarr, or write"
            " netCDF4 (tree.to_netcdf)"
        ) from None
    try:
        return xr.open_datatree(path, engine="zarr")
    except Exception as error:  # a folder of anything
        raise BadInput(f"{path} is no Zarr tree ({type(error).__name__}); {_ADVICE}") from None


def _of_tables(arrays: Mapping[str, np.ndarray], path: Path, circular: tuple[str, ...]) -> Brought:
    draws: Any = {name[10:]: arrays[name] for name in arrays if name.startswith("estimates.")}
    truth: Any = {name[8:]: arrays[name] for name in arrays if name.startswith("targets.")}
    if not draws and not truth:
        draws, truth = (_first(arrays, names, path) for names in (DRAWS, TRUTH))
        if DRAWS[0] not in arrays:
            draws = np.swapaxes(draws, 0, 1)
        draws, truth = (
            part[..., None] if part.ndim == at else part for part, at in ((draws, 2), (truth, 1))
        )
    density = [arrays.get(name) for name in ("log_density_truth", "log_density")]
    covariates = arrays.get(COVARIATES_GROUP)
    columns = {name[11:]: arrays[name] for name in arrays if name.startswith("covariates.")}
    if covariates is not None and "covariate_names" in arrays:
        table = covariates.reshape(len(covariates), -1)
        columns |= dict(zip(_texts(arrays["covariate_names"]), table.T, strict=False))
    names = _texts(arrays["names"]) if "names" in arrays else None
    return Brought.of(
        draws,
        truth,
        **{name: arrays[name] for name in WEIGHTS if name in arrays},
        log_density=None if any(part is None for part in density) else density,
        covariates=columns or covariates,
        names=names,
        circular=circular,
    )


def _texts(values: np.ndarray) -> list[str]:
    return [str(text) for text in np.ravel(values)]


def _first(arrays: Mapping[str, np.ndarray], names: tuple[str, ...], path: Path) -> np.ndarray:
    for name in names:
        if name in arrays:
            return arrays[name]
    raise BadInput(
        f"{path} has no {' or '.join(names)}, only {', '.join(sorted(arrays)) or 'nothing'};"
        f" {_ADVICE}"
    )


def _of_tree(tree: xr.DataTree, path: Path, circular: tuple[str, ...]) -> Brought:
    if missing := {"posterior", TRUTH[0]} - set(tree.children):
        raise BadInput(
            f"{path} has no group {' and no group '.join(sorted(missing))}; a tree of draws has"
            " posterior and truth"
        )
    truth = tree[TRUTH[0]].to_dataset()
    names = [str(name) for name in truth.data_vars]
    posterior = tree["posterior"].to_dataset()
    if unknown := set(names) - set(map(str, posterior.data_vars)):
        raise BadInput(
            f"the group posterior of {path} has no {', '.join(sorted(unknown))}, which the group"
            " truth has"
        )
    along = _instances(truth, posterior, path)
    draws = InBlocks([_stacked(posterior[name], along) for name in names])
    known = {name: truth[name].transpose(along, ...).values for name in names}
    stats = tree["sample_stats"].to_dataset() if "sample_stats" in tree.children else xr.Dataset()
    density = None
    if "lp" in stats and "lp" in (extra := _group(tree, "truth_stats")):
        density = (extra["lp"].values, _stacked(stats["lp"], along).values)
    brought = Brought.of(
        draws,
        np.concatenate([one.reshape(len(one), -1) for one in known.values()], axis=1),
        **{name: _stacked(stats[name], along).values for name in WEIGHTS if name in stats},
        log_density=density,
        covariates=_group(tree, COVARIATES_GROUP).drop_vars(along, errors="ignore"),
        names=[label for name in names for label in _labels(name, truth[name], along)],
        circular=circular,
    )
    return brought


def _group(tree: xr.DataTree, name: str) -> xr.Dataset:
    return tree[name].to_dataset() if name in tree.children else xr.Dataset()


def _instances(truth: xr.Dataset, posterior: xr.Dataset, path: Path) -> str:
    """The dimension of the instances: the first of the truths."""
    firsts = {str(one.dims[0]) for one in truth.data_vars.values() if one.dims}
    if len(firsts) != 1 or (along := firsts.pop()) not in posterior.dims:
        raise BadInput(
            f"groups truth and posterior of {path} share no dimension of instances; it has to be"
            " the first of every truth"
        )
    return along


def _stacked(values: xr.DataArray, along: str) -> xr.DataArray:
    """`(instances, draws, ...)`, chains one after the other."""
    dims = [dim for dim in CHAINS if dim in values.dims]
    if len(dims) == 1:
        return values.transpose(along, dims[0], ...)
    return values.stack(sample=dims).transpose(along, "sample", ...)


def _labels(name: str, values: xr.DataArray, along: str) -> list[str]:
    rest = values.isel({along: 0})
    if not rest.ndim:
        return [name]
    labels = [
        [str(label) for label in rest[dim].values]
        if dim in rest.coords
        else [str(at) for at in range(rest.sizes[dim])]
        for dim in rest.dims
    ]
    places = np.ndindex(*rest.shape)
    return [
        f"{name} {' '.join(words[at] for words, at in zip(labels, place, strict=True))}"
        for place in places
    ]
