"""Measures of results: joint angles, lengths and steps, draw by draw, and what the draws say of
them.

    found = measures(result, "right_knee_flexion", "distance(right_wrist,head)", height=1.75)
    measure_intervals(found, 0.95)      # mean, deviation, interval, modes

The posterior of a number that depends on the pose is that number of every draw: nothing is
approximated, and nothing learned."""

import itertools
import os
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.results import Result
from poseterior.inference.saved import read_result
from poseterior.inference.store import SETTINGS
from poseterior.inference.summaries import Summary, summarised
from poseterior.probmodel.datasets import body_height
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.level import level_axes
from poseterior.probmodel.measures import ALONG_SIGHT, MEASURES, PLAIN, Measure, measure_of
from poseterior.probmodel.root_priors import WORLD

SHORTEST_PERSON, TALLEST_PERSON = 0.2, 3.0
"""Metres between which a person's height lies."""
PROBABILITY = 0.95
MOST_MODES = 2
"""Of a measure, at most, that are told apart."""
_SAMPLED = ("chain", "draw")
_SUMMARY = ("mean", "sd", "low", "high")
_ADVICE = "give a posterior.nc, its folder, or that of a stream of `poseterior frames`"


def measures(
    of: Result | xr.DataTree | xr.Dataset | str | os.PathLike,
    *wanted: str,
    height: float | None = None,
) -> xr.Dataset:
    """What people measure of a pose, of every draw.

    Parameters
    ----------
    of
        A result, its tree, a Dataset with `joints` (…, joint, axis) in camera axes, or a file or
        folder: a posterior.nc, or a stream whose draws were kept. Of calibrated cameras too: what
        is counted from the vertical is, there, from the world's axis that is `up`.
    *wanted
        Names of measures, or expressions such as `angle(right_hip,right_knee,right_ankle)`; all
        that have a name where there are none.
    height
        The person's, in metres, if it is known: lengths are then in millimetres, as those of
        calibrated cameras always are. Every draw is scaled to it, head, back, upper and lower leg
        and a tenth for feet and hips; as sizes are equally probable on a log scale before, that is
        the posterior given the height.

    Returns
    -------
    Dataset
        A variable for each measure with the dimensions of the draws, of a stream (frame, draw), NaN
        where the pose does not determine it; `units`, `convention`, `source` and `circular` are its
        attributes.

    Raises
    ------
    BadInput
        Where there is no such measure, no draw, no result, no person is so tall, a height is given
        where calibrated cameras know it, or depth is asked for where there is no one camera.
    """
    chosen = chosen_measures(wanted)
    if isinstance(of, str | os.PathLike):
        return _of_path(Path(of), chosen, height)
    group = of.tree if isinstance(of, Result) else of
    inside = group["posterior"].to_dataset() if isinstance(group, xr.DataTree) else group
    if "joints" not in inside:
        raise BadInput("there are no joints to measure; give a result, its tree or its posterior")
    return _measured(inside["joints"], chosen, height, group.attrs)


def chosen_measures(wanted: Sequence[str]) -> list[Measure]:
    """Those of these names or expressions, each once; all that have a name where there are none.
    Raises `BadInput` as `measure_of` does."""
    found = [measure_of(text) for text in wanted] or list(MEASURES.values())
    return list({one.name: one for one in found}.values())


def require_height(height: float | None, unit_mm: float | None) -> None:
    """Raises `BadInput` where no person is so many metres tall, or it is known how large a body
    unit is; None is no height."""
    if height is None:
        return
    if unit_mm is not None:
        raise BadInput(
            "calibrated cameras know how large the person is; leave the height out (on the command"
            " line --height)"
        )
    if not SHORTEST_PERSON <= height <= TALLEST_PERSON:  # false for NaN too
        raise BadInput(
            f"{height:g} is not the height of a person in metres, from {SHORTEST_PERSON:g} to"
            f" {TALLEST_PERSON:g}; give another"
        )


def known_unit(about: Mapping[Any, Any]) -> float | None:
    """Millimetres of the unit of a result's joints, by its attributes; None where nobody knows."""
    return float(about.get("unit_mm", 1.0)) if about.get("root") == WORLD else None


def level(joints: np.ndarray, about: Mapping[Any, Any]) -> np.ndarray:
    """Joints `(..., 15, 3)` of a result, by its attributes, in axes in which measures are told: a
    camera's, or those of a world with y down, which streams have already. Raises `BadInput` where
    it does not say which way is up."""
    if about.get("root") != WORLD or "unit_mm" in about:
        return joints
    return joints @ level_axes(str(about.get("up"))).T


def in_units(
    joints: np.ndarray, chosen: Sequence[Measure], unit_mm: float | np.ndarray | None
) -> Iterator[tuple[str, np.ndarray]]:
    """The unit, and the values `(...)`, of each measure of poses `(..., 15, 3)` in units of so many
    millimetres, or body units where nobody knows."""
    for one in chosen:
        scaled = one.kind == "length" and unit_mm is not None
        yield ("mm" if scaled else one.unit), one.of(joints) * (unit_mm if scaled else 1.0)


def _measured(
    joints: xr.DataArray,
    chosen: Sequence[Measure],
    height: float | None,
    about: Mapping[Any, Any],
) -> xr.Dataset:
    unit_mm = known_unit(about)
    require_height(height, unit_mm)
    if unit_mm is not None:
        _require_no_depth(chosen)
    elif joints.attrs.get("units") == "mm":
        raise BadInput(
            "these joints are of calibrated cameras, and without a word of which way is up; give"
            " the result, or its tree"
        )
    joints = joints.transpose(..., "joint", "axis")
    if not joints.size:
        raise BadInput("there is no draw to measure; sample again, with a larger budget")
    poses = level(joints.values.astype(float), about)
    known = unit_mm if height is None else 1000 * height / body_height(poses)
    dims = [name for name in joints.dims if name not in ("joint", "axis")]
    values = zip(chosen, in_units(poses, chosen, known), strict=True)
    return xr.Dataset(
        {
            one.name: (dims, found, _attributes(one, unit, about.get("up")))
            for one, (unit, found) in values
        },
        coords={name: joints.coords[name] for name in dims if name in joints.coords},
        attrs=dict(about) | ({} if height is None else {"height": height}),
    )


def _require_no_depth(chosen: Sequence[Measure]) -> None:
    for one in chosen:
        if one.name.startswith(f"{ALONG_SIGHT}("):
            raise BadInput(
                f"{one.name} is told along the sight of one camera, and this result is of several;"
                f" ask for {one.name.replace(ALONG_SIGHT, 'level', 1)}, the distance on the level"
            )


def _attributes(one: Measure, unit: str, up: str | None) -> dict[str, Any]:
    vertical = f"angle with the calibration's axis {up}, which is taken for vertical"
    return {
        "units": unit,
        "convention": one.convention,
        "source": vertical if up and one.source == PLAIN else one.source,
        "circular": int(one.circular),
    }


def _of_path(path: Path, chosen: Sequence[Measure], height: float | None) -> xr.Dataset:
    if path.is_dir() and (path / SETTINGS).exists():
        return _of_stream(path, chosen, height)
    drawn = path / "posterior.nc" if path.is_dir() else path
    if not drawn.exists():
        raise BadInput(f"there is no result at {path}; {_ADVICE}")
    tree = read_result(drawn).tree
    return _measured(tree["posterior"].joints, chosen, height, tree.attrs)


def _of_stream(folder: Path, chosen: Sequence[Measure], height: float | None) -> xr.Dataset:
    # Now: whoever measures one person need not wait for what draws many.
    from poseterior.inference.stream import all_draws, open_stream

    drawn = dict(all_draws(folder))
    if not any(one.sizes["draw"] for one in drawn.values()):
        raise BadInput(f"{folder} has no frame with a pose; its summary says why")
    alone = [one.joints.isel(chain=0).drop_vars("frame") for one in drawn.values()]
    together = xr.concat(
        [one.assign_coords(draw=np.arange(one.sizes["draw"])) for one in alone],
        dim=xr.Variable("frame", list(drawn)),
        join="outer",
    )
    return _measured(together, chosen, height, open_stream(folder).attrs)


def measure_intervals(found: xr.Dataset, probability: float = PROBABILITY) -> xr.Dataset:
    """What the draws say of measures.

    Parameters
    ----------
    found
        As `measures` gives them.
    probability
        Of the intervals, which are central; on a circle, cut opposite to the mean.

    Returns
    -------
    Dataset
        By `measure`, and by frame where there are frames: `mean`, `sd`, `low`, `high`, and `value`
        and `mass` of one or two modes, by `mode`, NaN where there is but one. Units by measure. The
        high end of a circular measure is above the low one, and may be above 180 degrees.

    Raises
    ------
    BadInput
        Where the probability is not between 0 and 1.
    """
    if not 0 < probability < 1:
        raise BadInput(
            f"an interval of {probability:g} is none; give a probability between 0 and 1, 0.95"
        )
    names = [str(name) for name in found.data_vars]
    rest = [name for name in found[names[0]].dims if name not in _SAMPLED]
    rows = np.stack([_rows(found[name], rest, probability) for name in names])
    dims = ("measure", *rest)
    columns: dict[str, Any] = {
        field: (dims, rows[..., column]) for column, field in enumerate(_SUMMARY)
    }
    columns["value"] = ((*dims, "mode"), rows[..., len(_SUMMARY) :: 2])
    columns["mass"] = ((*dims, "mode"), rows[..., len(_SUMMARY) + 1 :: 2])
    coords: dict[Any, Any] = {"measure": names, "mode": np.arange(1, MOST_MODES + 1)}
    coords |= {name: found.coords[name].values for name in rest if name in found.coords}
    coords["units"] = ("measure", [str(found[name].attrs["units"]) for name in names])
    return xr.Dataset(columns, coords, dict(found.attrs) | {"probability": probability})


def _rows(values: xr.DataArray, rest: Sequence[Hashable], probability: float) -> np.ndarray:
    """`(..., 8)`: mean, deviation, both ends, and value and mass of two modes, of one measure."""
    circular = bool(values.attrs["circular"])
    array = values.transpose(*rest, ...).values
    shape = array.shape[: len(rest)]
    found = [summarised(one, probability, circular) for one in array.reshape(*shape or (1,), -1)]
    return np.array([_row(one) for one in found]).reshape(*shape, -1)


def _row(one: Summary) -> list[float]:
    blank = [np.nan] * 2 * (MOST_MODES - len(one.modes))
    return [one.mean, one.sd, one.low, one.high, *itertools.chain(*one.modes), *blank]
