"""Many frames as one stream: draws and hypotheses of each, written as they come, resumed where they
stopped.

A stream is a folder: `stream.json` says what was asked for, `block-000000.nc` and so on hold some
frames each, written at once or not at all. Every frame has a key of its own, so that a run that was
stopped and goes on ends with the same bits, and so do blocks made elsewhere. Memory holds one
block, however many frames there are.

    sample_frames(model, frames, key=jax.random.key(0), out="walk", num_samples=10_000, k=5)
    tree = open_stream("walk")          # summaries and hypotheses of all frames
"""

import hashlib
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

from inference.exact.mixture import MAX_PROPOSALS, draw_mixture
from inference.hypothesis import diverse
from inference.results import joint_columns, key_words, save_tree, versions
from probmodel.detections import Detection
from probmodel.failures import BadInput
from probmodel.files import replacing
from probmodel.formats.frames import DetectedFrame
from probmodel.model import PoseModel
from probmodel.posterior import Estimate
from probmodel.skeleton import JOINTS, LENGTH_GROUPS, NUM_JOINTS, NUM_LENGTHS

BLOCK_BYTES = 64_000_000
"""About how much a block holds; more frames a block where fewer draws are kept."""
MOST_FRAMES = 64
"""Frames of a block at most: what is lost when a run is killed."""
BAD_INPUT = "bad input"
Progress = Callable[[int], None]


class Item(NamedTuple):
    """A frame of a stream: its `name`, and the `Estimate` or, where there is none, the sentence that
    says why."""

    name: str
    frame: Estimate | str


class Drawn(NamedTuple):
    """What is kept of a frame: see `open_stream`."""

    name: str
    status: str
    sentence: str
    num_draws: int
    log_evidence: float
    log_evidence_se: float
    mean: np.ndarray
    sd: np.ndarray
    hypotheses: np.ndarray
    weight: np.ndarray
    chosen: np.ndarray
    joints: np.ndarray
    bone_length: np.ndarray


def sample_frames(
    model: PoseModel,
    frames: Iterable[Item],
    *,
    key: jax.Array,
    out: str | os.PathLike,
    sampler: str = "rejection",
    num_samples: int = 10_000,
    k: int = 5,
    keep: int | None = None,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> Path:
    """Draws `num_samples` poses of every frame and chooses `k` hypotheses among them; writes them
    to the folder `out`.

    `keep` is how many draws of each frame are written (default: all). `frames` is read as it is
    needed; a frame that is a sentence, or whose budget of `max_proposals` ends, is recorded with
    its reason, and the others go on. Blocks that are there already are kept. `progress(done)` is
    called for each block. Raises `BadInput` where `out` holds another run, or where the frames
    differ from those that it began with."""
    keep = num_samples if keep is None else min(keep, num_samples)
    if num_samples < 1 or not 1 <= k <= num_samples or keep < 0:
        raise BadInput(
            f"{num_samples} samples, {k} hypotheses and {keep} kept do not go together; choose at"
            " least one sample, at most as many hypotheses, and no negative number to keep"
        )
    folder = Path(out)
    settings = {
        "seed": key_words(key),
        "sampler": sampler,
        "num_samples": num_samples,
        "k": k,
        "keep": keep,
        "max_proposals": max_proposals,
        "limits": f"{model.limits.name} {model.limits.sha256}",
        "measures": f"upper {model.upper}, lower {model.lower}",
        "versions": versions(),
    }
    _begin(folder, settings)
    size = max(
        1, min(MOST_FRAMES, BLOCK_BYTES // (4 * (3 * NUM_JOINTS + NUM_LENGTHS) * max(keep, 1)))
    )
    done = 0
    with ThreadPoolExecutor(os.cpu_count()) as workers:

        def draw(index: int, item: Item) -> Drawn:
            return _draw(
                model,
                item,
                jax.random.fold_in(key, index),
                sampler,
                num_samples,
                k,
                keep,
                max_proposals,
            )

        for number, items in enumerate(_blocks(frames, size)):
            path = folder / f"block-{number:06d}.nc"
            fingerprint = _fingerprint(items)
            if path.exists():
                _same_frames(path, fingerprint)
            else:
                indices = range(number * size, number * size + len(items))
                rows = list(workers.map(draw, indices, items))
                save_tree(
                    _block_tree(
                        rows, k, {**settings, "frames": fingerprint, "first": number * size}
                    ),
                    path,
                )
            done += len(items)
            if progress:
                progress(done)
    return folder


def open_stream(folder: str | os.PathLike) -> xr.DataTree:
    """Summaries and hypotheses of all frames of a stream, opened in parts only as needed.

    `/summary` by frame: status, sentence, num_draws, log_evidence with its standard error, `mean`
    and `sd` of the joints `(frame, joint, axis)`. `/hypotheses`: `joints` `(frame, hypothesis,
    joint, axis)`, `weight`, `draw`. The draws stay in their blocks: `draws_of(folder, name)`.
    Raises `BadInput` where there is no stream."""
    folder = Path(folder)
    settings = _settings(folder)
    parts: dict[str, list[xr.Dataset]] = {"summary": [], "hypotheses": []}
    for path in _paths(folder):
        with xr.open_datatree(path, engine="netcdf4") as tree:
            for name, rows in parts.items():
                rows.append(tree[name].to_dataset().load())
    found = xr.DataTree.from_dict(
        {name: xr.concat(rows, dim="frame") for name, rows in parts.items()}
    )
    found.attrs.update(settings)
    return found


def draws_of(folder: str | os.PathLike, name: str) -> xr.Dataset:
    """The draws kept of the frame `name`: `joints` `(chain, draw, joint, axis)` and `bone_length`,
    as ArviZ takes them. Raises `BadInput` where the stream has no such frame."""
    for path in _paths(Path(folder)):
        with xr.open_datatree(path, engine="netcdf4") as tree:
            names = tree["summary"].frame.values
            if name in names:
                index = int(np.flatnonzero(names == name)[0])
                rows = tree["posterior"].to_dataset().isel(frame=index).load()
                held = int(tree["summary"].num_draws[index])
                return rows.isel(draw=slice(min(held, rows.sizes["draw"]))).expand_dims("chain")
    raise BadInput(
        f"{folder} has no frame {name!r}; its names are in the summary that `open_stream` gives"
    )


def estimated(
    frames: Iterable[DetectedFrame], estimate: Callable[[Detection], Estimate]
) -> Iterator[Item]:
    """Everyone in frames of detections as items of a stream, named `frame/person`; who cannot be
    estimated becomes the sentence that says why."""
    for frame in frames:
        for detection in frame.people:
            name = f"{frame.name}/{detection.person}"
            try:
                yield Item(name, estimate(detection))
            except BadInput as error:
                yield Item(name, str(error))


def _draw(
    model: PoseModel,
    item: Item,
    key: jax.Array,
    sampler: str,
    num_samples: int,
    k: int,
    keep: int,
    max_proposals: int,
) -> Drawn:
    name, frame = item
    if isinstance(frame, str):
        return _nothing(name, BAD_INPUT, frame, k, keep)
    posterior = frame.posterior(model)
    mixture = draw_mixture(
        posterior,
        key=key,
        sampler=sampler,
        num_samples=num_samples,
        max_proposals=max_proposals,
    )
    columns = joint_columns(posterior, mixture.parts, mixture.rng)
    joints, number = columns["joints"], len(columns["joints"])
    drawn = _nothing(name, mixture.status, mixture.sentence, k, keep)
    if number == 0:
        return drawn
    for row, (pose, weight, chosen) in enumerate(
        diverse(joints.astype(np.float32), min(k, number))
    ):
        drawn.hypotheses[row], drawn.weight[row], drawn.chosen[row] = pose, weight, chosen
    kept = min(keep, number)
    drawn.joints[:kept], drawn.bone_length[:kept] = joints[:kept], columns["bone_length"][:kept]
    return drawn._replace(
        num_draws=number,
        log_evidence=mixture.attributes["log_evidence"],
        log_evidence_se=mixture.attributes["log_evidence_se"],
        mean=joints.mean(axis=0),
        sd=joints.std(axis=0),
    )


def _nothing(name: str, status: str, sentence: str, k: int, keep: int) -> Drawn:
    blank = np.full((NUM_JOINTS, 3), np.nan)
    poses, joints = (
        np.full((k, NUM_JOINTS, 3), np.nan),
        np.full((keep, NUM_JOINTS, 3), np.nan, np.float32),
    )
    lengths = np.full((keep, NUM_LENGTHS), np.nan, np.float32)
    return Drawn(
        name,
        status,
        sentence,
        0,
        -np.inf,
        np.inf,
        blank,
        blank,
        poses,
        np.zeros(k),
        np.full(k, -1),
        joints,
        lengths,
    )


def _block_tree(rows: list[Drawn], k: int, attributes: dict[str, Any]) -> xr.DataTree:
    fields = {name: [getattr(row, name) for row in rows] for name in Drawn._fields}
    names = {"frame": fields["name"], "joint": list(JOINTS), "axis": list("xyz")}
    by_frame = ("status", "sentence", "num_draws", "log_evidence", "log_evidence_se")
    summary: dict[str, Any] = {name: (("frame",), np.array(fields[name])) for name in by_frame}
    summary |= {
        name: (("frame", "joint", "axis"), np.stack(fields[name])) for name in ("mean", "sd")
    }
    hypotheses = {
        "joints": (("frame", "hypothesis", "joint", "axis"), np.stack(fields["hypotheses"])),
        "weight": (("frame", "hypothesis"), np.stack(fields["weight"])),
        "draw": (("frame", "hypothesis"), np.stack(fields["chosen"])),
    }
    posterior = {
        "joints": (
            ("frame", "draw", "joint", "axis"),
            np.stack(fields["joints"]),
            {"units": "body units"},
        ),
        "bone_length": (
            ("frame", "draw", "length_group"),
            np.stack(fields["bone_length"]),
            {"units": "body units"},
        ),
    }
    tree = xr.DataTree.from_dict(
        {
            "summary": xr.Dataset(summary, coords=names),
            "hypotheses": xr.Dataset(hypotheses, coords=names | {"hypothesis": np.arange(k)}),
            "posterior": xr.Dataset(
                posterior, coords=names | {"length_group": list(LENGTH_GROUPS)}
            ),
        }
    )
    tree.attrs.update(attributes)
    return tree


def _blocks(frames: Iterable[Item], size: int) -> Iterator[list[Item]]:
    iterator = iter(frames)
    while items := list(itertools.islice(iterator, size)):
        yield items


def _fingerprint(items: list[Item]) -> str:
    """What the frames of a block are, in short: names, detections, candidates."""
    digest = hashlib.sha256()
    for name, frame in items:
        digest.update(name.encode())
        if isinstance(frame, str):
            digest.update(frame.encode())
            continue
        digest.update(repr(frame.likelihood).encode())
        arrays: list[Any] = [frame.detection.keypoints, frame.detection.score]
        for candidate in frame.candidates:
            camera = candidate.camera
            arrays += [candidate.torso, camera.scale, camera.rotation, camera.translation]
        for array in arrays:
            digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()


def _begin(folder: Path, settings: dict[str, Any]) -> None:
    path = folder / "stream.json"
    if path.exists():
        old = _settings(folder)
        changed = [name for name in settings if old.get(name) != settings[name]]
        if changed:
            raise BadInput(
                f"{folder} holds another run (its {changed[0]} is {old.get(changed[0])!r}, not "
                f"{settings[changed[0]]!r}); choose another folder, or delete that one"
            )
        return
    with replacing(path) as partial:
        folder.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(settings, indent=1), encoding="utf-8")


def _settings(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads((folder / "stream.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict):
        raise BadInput(
            f"{folder} is not a stream of frames (it has no readable stream.json); give the folder"
            " of a run"
        )
    return found


def _same_frames(path: Path, fingerprint: str) -> None:
    try:
        with xr.open_datatree(path, engine="netcdf4") as tree:
            found = tree.attrs.get("frames")
    except (OSError, ValueError) as error:
        raise BadInput(
            f"{path} cannot be read ({error}); delete it, and run again to make it anew"
        ) from None
    if found != fingerprint:
        raise BadInput(
            f"{path} was made of other frames than those given now; choose another folder, or"
            " delete that block"
        )


def _paths(folder: Path) -> list[Path]:
    return sorted(folder.glob("block-*.nc"))
