"""A result of ours as a `Clip` for a person of given height: hypotheses.json, posterior.nc, the
folder of both, or the folder of a stream."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.films.film import film_draws
from poseterior.inference.hypothesis import diverse
from poseterior.inference.measured import known_unit, level, require_height
from poseterior.inference.store import SETTINGS
from poseterior.inference.stream import all_draws, in_time, open_stream, rows_of_person
from poseterior.probmodel.arrays import netcdf_attributes, possible, read_netcdf
from poseterior.probmodel.datasets import body_height
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.measures import Measure
from poseterior.probmodel.root_priors import WORLD
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, PARENTS
from poseterior.reports.exports.bodies import Body
from poseterior.reports.exports.clip import (
    CAMERA,
    PELVIS,
    RATE,
    WORLD_ORIGIN,
    Clip,
    MeasureColumn,
    viewed,
)
from poseterior.reports.exports.measures import of_frames, of_poses
from poseterior.reports.exports.smoothing import Smoother

MEAN, HYPOTHESIS = "mean", "hypothesis"
"""What a film is made of: the mean of each frame's draws, made a body again, or the heaviest
hypothesis."""
USUAL_HEIGHT = 1.75
"""Metres, of a person of whom nobody says it."""
K = 5
"""Hypotheses of a posterior.nc, where nothing else is said."""
_JOINTS = "posterior/joints"
_ADVICE = (
    "give a hypotheses.json, a posterior.nc, their folder, or that of a stream of `poseterior"
    " frames`"
)


class Wanted(NamedTuple):
    """What is wanted of a result: a `height` in metres, unless calibrated cameras know it; `k`
    hypotheses, or so many `draws`; of a stream, which `person`, `what` of each frame (`MEAN`,
    `HYPOTHESIS`), and how it is smoothed; of a film, which of its paths (`path`). At so many frames
    a second (`rate`). None: whatever is usual."""

    height: float | None = None
    k: int | None = None
    draws: int | None = None
    person: int | None = None
    what: str | None = None
    path: int | None = None
    smoother: Smoother | None = None
    rate: float | None = None
    measures: tuple[Measure, ...] = ()


class _Poses(NamedTuple):
    """As in `Clip`, but in camera axes, or level ones with y down, and body units; `unit_mm` is how
    many millimetres these are where cameras know it, `measured` the poses from which it is told
    where not, `body` what a film's poses are to be made of, `draws` all draws of one person,
    `items` a film's in the stream, `rate` frames a second where the result says it."""

    joints: np.ndarray
    names: list[str]
    measured: np.ndarray
    weights: np.ndarray | None = None
    spread: np.ndarray | None = None
    film: bool = False
    numbers: list[int] | None = None
    origin: str = PELVIS
    unit_mm: float | None = None
    body: Body | None = None
    draws: np.ndarray | None = None
    items: list[str | None] | None = None
    rate: float | None = None


def read_clip(path: Path, wanted: Wanted) -> Clip:
    """The poses of a result: of calibrated cameras as large as they are, others scaled so that
    their median pose has the wanted height (of `body_height`: head, back, upper and lower leg, and
    a tenth for feet and hips).

    Raises
    ------
    BadInput
        Where it is no result, has not what is wanted, or no person is so tall, or a height is
        wanted of calibrated cameras.
    """
    require_height(wanted.height, None)
    found = _read(path, wanted)
    require_height(wanted.height, found.unit_mm)
    rate = found.rate if wanted.rate is None else wanted.rate
    _require_bodies(found.measured, path)
    metres = _metres(found, USUAL_HEIGHT if wanted.height is None else wanted.height)
    clip = Clip(
        metres * found.joints,
        found.names,
        found.weights,
        None if found.spread is None else metres * found.spread,
        found.film,
        found.numbers,
        timed=rate is not None,
        origin=found.origin,
    ).at_rate(RATE if rate is None else rate)
    if wanted.measures:
        columns = _measures(path, wanted.measures, found, metres)
        clip = dataclasses.replace(clip, measures=columns)
    joints = clip.joints
    if wanted.smoother is not None:
        joints = _smoothed(clip, wanted.smoother)
    if found.body is not None:
        joints = found.body.grown(metres).posed(joints)
    return dataclasses.replace(clip, joints=viewed(joints))


def _metres(found: _Poses, height: float) -> float:
    """Of a body unit."""
    if found.unit_mm is not None:
        return found.unit_mm / 1000
    return height / float(np.median(body_height(found.measured)))


def _measures(
    path: Path, chosen: Sequence[Measure], found: _Poses, metres: float
) -> tuple[MeasureColumn, ...]:
    """Of hypotheses and draws as they are, beside the deviations of all draws; of a film's frames
    the mean of the draws that were kept."""
    if found.items is None:
        return of_poses(found.joints, found.draws, chosen, metres)
    return of_frames(found.items, dict(all_draws(path)), chosen, metres)


def _smoothed(clip: Clip, smoother: Smoother) -> np.ndarray:
    """The joints of a film, filtered. Raises `BadInput` where the filter cannot be."""
    if not clip.film:
        raise BadInput("--smooth is for films, and these poses do not follow each other; leave it")
    if not clip.timed:
        raise BadInput(
            f"--smooth {smoother} needs to know how many frames a second there are; give --rate as"
            " in the film"
        )
    smoother.check(clip.pace)
    return smoother(clip.joints, clip.places, clip.pace)


def _read(path: Path, wanted: Wanted) -> _Poses:
    if path.is_dir() and (path / SETTINGS).exists():
        return _film(path, wanted)
    if wanted.person is not None:
        raise BadInput(f"{path} is of one person; leave --person out")
    if wanted.what is not None:
        raise BadInput(f"{path} is no film of frames; leave --what out")
    if wanted.path is not None:
        raise BadInput(f"{path} is no film, which alone has paths; leave --path-number out")
    if path.is_dir():
        return _of_folder(path, wanted)
    if not path.exists():
        raise BadInput(f"there is no result at {path}; {_ADVICE}")
    return _chosen(path, wanted) if path.suffix.lower() == ".json" else _drawn(path, wanted)


def _of_folder(folder: Path, wanted: Wanted) -> _Poses:
    """What `poseterior hypotheses` left there: the hypotheses that were chosen, with the spread of
    the draws; or single draws."""
    chosen, drawn = folder / "hypotheses.json", folder / "posterior.nc"
    if not (chosen.exists() or drawn.exists()):
        raise BadInput(f"{folder} is a folder without a result; {_ADVICE}")
    if not drawn.exists():
        return _chosen(chosen, wanted)
    if wanted.draws is not None or not chosen.exists():
        return _drawn(drawn, wanted)
    found, (joints, about) = _chosen(chosen, wanted), _draws(drawn)
    spread = _spread(joints, len(found.joints))
    return found._replace(measured=joints, spread=spread, draws=joints, **_placed(about))


# --- hypotheses.json


def _chosen(path: Path, wanted: Wanted) -> _Poses:
    """The hypotheses as they were chosen."""
    if wanted.draws is not None:
        raise BadInput(
            f"{path} holds hypotheses, not draws; leave --draws out, or give its posterior.nc"
        )
    content = read_json(path, "hypotheses.json of poseterior", _ADVICE)
    try:
        entries = content["hypotheses"]
        joints = np.array([[one["joints"][name] for name in JOINTS] for one in entries], float)
        weights = np.array([one["weight"] for one in entries], float)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise BadInput(
            f"{path} is not a hypotheses.json of poseterior ({type(error).__name__}); {_ADVICE}"
        ) from None
    if joints.ndim != 3 or joints.shape[1:] != (NUM_JOINTS, 3) or weights.shape != joints.shape[:1]:
        raise BadInput(f"{path} has hypotheses that are not of fifteen joints; {_ADVICE}")
    k = len(joints) if wanted.k is None else wanted.k
    if not 1 <= k <= len(joints):
        raise BadInput(f"{path} holds {len(joints)} hypotheses, not {k}; give another --k")
    about = {"root": WORLD, **content} if "up" in content else {}
    joints = level(joints, about)
    names = _numbered("hypothesis", k, 1)
    return _Poses(joints[:k], names, joints, weights[:k], **_placed(about))


def _placed(about: Mapping[Any, Any]) -> dict[str, Any]:
    """Where poses stand, and their unit, by the attributes of their result."""
    unit_mm = known_unit(about)
    return {} if unit_mm is None else {"origin": WORLD_ORIGIN, "unit_mm": unit_mm}


# --- posterior.nc


def _drawn(path: Path, wanted: Wanted) -> _Poses:
    """Single draws if asked for, else hypotheses with the spread of all draws."""
    joints, about = _draws(path)
    if wanted.draws is not None:
        if wanted.k is not None:
            raise BadInput("--k hypotheses or --draws single draws, not both; leave one out")
        if not 1 <= wanted.draws <= len(joints):
            raise BadInput(
                f"{path} holds {len(joints):,} draws, not {wanted.draws:,}; give another --draws"
            )
        names = _numbered("draw", wanted.draws, 0)
        return _Poses(joints[: wanted.draws], names, joints, **_placed(about))
    chosen = diverse(joints, K if wanted.k is None else wanted.k)
    picked = np.stack([one.joints for one in chosen])
    return _Poses(
        picked,
        _numbered("hypothesis", len(chosen), 1),
        joints,
        np.array([one.weight for one in chosen]),
        _spread(joints, len(picked)),
        draws=joints,
        **_placed(about),
    )


def _spread(joints: np.ndarray, times: int) -> np.ndarray:
    """`(times, 15, 3)`: the standard deviations of all draws, for each of so many poses."""
    return np.tile(joints.std(axis=0), (times, 1, 1))


def _draws(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """All draws `(n, 15, 3)` of a posterior.nc, chain by chain, level, and its attributes."""
    found = read_netcdf(path, (_JOINTS,), "posterior.nc of poseterior", _ADVICE)
    if _JOINTS not in found:
        raise BadInput(f"{path} holds no draws of poseterior; {_ADVICE}")
    joints = found[_JOINTS]
    if joints.ndim != 4 or joints.shape[2:] != (NUM_JOINTS, 3) or joints.dtype.kind != "f":
        raise BadInput(
            f"{path} has draws of shape {joints.shape}, not (chain, draw, 15, 3); {_ADVICE}"
        )
    joints = joints.reshape(-1, NUM_JOINTS, 3).astype(float)
    if not len(joints):
        raise BadInput(f"{path} holds no draw; sample again, with more --max-proposals")
    _require_places(joints, path)  # before any of them is chosen
    about = netcdf_attributes(path, "posterior.nc of poseterior", _ADVICE)
    return level(joints, about), about


# --- streams


def _film(path: Path, wanted: Wanted) -> _Poses:
    """A pose of a person for every frame, with the spread of that frame's draws."""
    if wanted.draws is not None or wanted.k is not None:
        raise BadInput(
            f"{path} is a stream: a film of one pose for each frame, whose draws do not follow each"
            " other in time; leave --draws and --k out"
        )
    tree = open_stream(path)
    names = [str(name) for name in tree["summary"].frame.values]
    frames, rows = rows_of_person(names, wanted.person, path)
    of_draws, of_hypotheses = tree["summary"].to_dataset(), tree["hypotheses"].to_dataset()
    heaviest = _spread_out(of_hypotheses.joints.values[:, 0], rows)
    there = heaviest[np.isfinite(heaviest).all(axis=(1, 2))]
    if not len(there):
        raise BadInput(f"{path} has no frame with a pose of that person; look at its summary")
    _require_bodies(there, path)
    body, single = Body.of(there), wanted.path is not None or wanted.what == HYPOTHESIS
    source = _poses_of(path, wanted, tree)
    joints = _spread_out(source.joints.values.astype(float), rows)
    spread = _spread_out(of_draws.sd.values, rows)
    origin = PELVIS
    if "place" in of_draws and np.isfinite(of_draws.place.values).any():
        origin = CAMERA
        joints = joints + _spread_out(source.place.values, rows)[:, None]
        spread[:, JOINT_INDEX["pelvis"]] = _spread_out(of_draws.place_sd.values, rows)
    exact = single and wanted.smoother is None
    order, numbers = in_time(frames)
    return _Poses(
        joints[order],
        [frames[at] for at in order],
        there,
        spread=spread[order],
        film=True,
        numbers=numbers,
        body=None if exact else body,
        items=[None if row is None else names[row] for row in (rows[at] for at in order)],
        rate=tree.attrs.get("rate"),
        **{"origin": origin} | _placed(tree.attrs),
    )


def _poses_of(path: Path, wanted: Wanted, tree: xr.DataTree) -> xr.Dataset:
    """What is wanted of each frame of a stream: `joints`, and the pelvis' `place`, NaN where it is
    not known. Raises `BadInput` where it has no such path, or no paths."""
    if wanted.path is None:
        if wanted.what == HYPOTHESIS:
            return tree["hypotheses"].to_dataset().isel(hypothesis=0)
        return tree["summary"].to_dataset().rename(mean="joints")
    if wanted.what is not None:
        raise BadInput("a path is whole; leave --what or --path-number out")
    paths = film_draws(path)
    number = paths.sizes["draw"]
    if not 0 <= wanted.path < number:
        raise BadInput(f"{path} has no path {wanted.path}; choose one from 0 to {number - 1}")
    return paths.isel(chain=0, draw=wanted.path)


def _spread_out(values: np.ndarray, rows: list[int | None]) -> np.ndarray:
    """The values of these rows, NaN where there is none."""
    blank = np.full(values.shape[1:], np.nan)
    return np.stack([blank if row is None else values[row] for row in rows])


# --- what all have in common


def _numbered(kind: str, number: int, first: int) -> list[str]:
    return [f"{kind} {first + one}" for one in range(number)]


def _require_places(joints: np.ndarray, path: Path) -> None:
    if not possible(joints):
        raise BadInput(f"{path} has a joint that is not at a finite place; {_ADVICE}")


def _require_bodies(kept: np.ndarray, path: Path) -> None:
    """Raises `BadInput` where a pose is not one of a body: a joint nowhere, a bone of no length, or
    a torso without a plane."""
    _require_places(kept, path)
    bones = np.linalg.norm(kept[:, 1:] - kept[:, list(PARENTS[1:])], axis=-1)
    up, side = _torso_axes(kept)
    area = np.linalg.norm(np.cross(up, side), axis=-1)
    if not ((bones > 0).all() and (area > 0).all()):
        raise BadInput(f"{path} has a pose with a bone of length zero, or a flat torso; {_ADVICE}")


def _torso_axes(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    up = joints[:, JOINT_INDEX["thorax"]] - joints[:, JOINT_INDEX["pelvis"]]
    return up, joints[:, JOINT_INDEX["left_hip"]] - joints[:, JOINT_INDEX["right_hip"]]
