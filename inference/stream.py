"""Many frames as one stream: draws and hypotheses of each, written as they come, resumed where they
stopped.

A stream is a folder, an `inference.store.Store` of blocks of frames. Every frame has a key of its
own, so that a run that was stopped and resumed ends with the same bits, whatever machines its
blocks are made on. Memory holds a few blocks, however many frames there are.

    sample_frames(model, frames, key=jax.random.key(0), out="walk", num_samples=10_000, k=5)
    tree = open_stream("walk")          # summaries and hypotheses of all frames

Draws are written only where they are asked for (`keep`): ten thousand of a frame are 2 MB.
"""

import copy
import dataclasses
import hashlib
import itertools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from poseterior.inference.composition import compose
from poseterior.inference.draws import MAX_PROPOSALS, Draws, key_of, key_words
from poseterior.inference.estimators import Estimating
from poseterior.inference.footage import Footage, FramesInMotion, Item
from poseterior.inference.hypothesis import Hypothesis, diverse
from poseterior.inference.machines import HERE, Machines, in_threads
from poseterior.inference.results import focal_of, provenance
from poseterior.inference.sampler import MANY_ROOTS, DetectionSampler, sampler_of
from poseterior.inference.store import Block, Groups, Store, fill, locked
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import EXCHANGES, NUM_EXCHANGES
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.frames import DetectedFrame, frame_numbers
from poseterior.probmodel.instant import Instant
from poseterior.probmodel.level import CalibratedWorld
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.people import cast_of
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import UNCERTAIN, WORLD
from poseterior.probmodel.skeleton import (
    JOINT_INDEX,
    JOINTS,
    LENGTH_GROUPS,
    NUM_JOINTS,
    NUM_LENGTHS,
)

STREAM_FORMAT = 2
"""What blocks hold of a frame: draws have had focal lengths since 2."""
DRAW_BYTES = 4 * (3 * NUM_JOINTS + NUM_LENGTHS + 3 + 1)
"""Of a draw that is kept, in single precision."""
BLOCK_BYTES = 64_000_000
"""About how much a block holds; more frames a block where fewer draws are kept."""
MOST_IN_BLOCK = 64
"""Frames of a block at most: what is lost when a run is killed."""
BAD_INPUT = "bad input"
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Of the quantiles of depth that are kept of every frame."""
MOST_TRACKS_NAMED = 12
"""People of a film that are described one by one."""
_STREAM = "a stream of frames"
Progress = Callable[[int], None]


class PoseDraws(NamedTuple):
    """Draws of a frame: joints `(n, 15, 3)`, `bone_length` `(n, 5)`, where the pelvis is before the
    camera, `(n, 3)`, body units, and the camera's `focal` length `(n,)`, pixels; both NaN in weak
    perspective. Of calibrated cameras: where it is in their world, and the body as large as it is
    (`CalibratedWorld`)."""

    joints: np.ndarray
    bone_length: np.ndarray
    place: np.ndarray
    focal: np.ndarray

    @classmethod
    def read(cls, held: xr.Dataset) -> "PoseDraws":
        """Those that were kept of a frame, as `draws_of` gives them; streams of earlier versions
        say nothing of focal lengths."""
        values = {name: held[name].values[0] for name in cls._fields if name in held}
        return cls(**{"focal": np.full(held.sizes["draw"], np.nan)} | values)


class FrameDraws(NamedTuple):
    """What is kept of a frame: see `open_stream`."""

    name: str
    status: str
    sentence: str
    num_draws: int
    log_evidence: float
    log_evidence_se: float
    effective_roots: float
    outlier: np.ndarray
    exchange: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    place: np.ndarray
    place_sd: np.ndarray
    depth: np.ndarray
    hypotheses: np.ndarray
    standing: np.ndarray
    weight: np.ndarray
    chosen: np.ndarray
    joints: np.ndarray
    bone_length: np.ndarray
    places: np.ndarray
    focal: np.ndarray

    def drawn(
        self, draws: PoseDraws, chosen: Sequence[Hypothesis], standing: bool = True
    ) -> "FrameDraws":
        """With what is said of some draws, and as many of them as are kept. Those of which every
        one has a focal length of its own, in every frame another, are not said to be `standing`
        anywhere."""
        number, k = len(draws.joints), len(chosen)
        kept = min(len(self.joints), number)
        place = draws.place if standing else np.full_like(draws.place, np.nan)
        found = self._replace(
            num_draws=number,
            mean=draws.joints.mean(axis=0),
            sd=draws.joints.std(axis=0),
            place=place.mean(axis=0),
            place_sd=place.std(axis=0),
            depth=np.quantile(draws.joints[:, :, 2], LEVELS, axis=0).T,
        )
        found.hypotheses[:k] = [one.joints for one in chosen]
        found.weight[:k] = [one.weight for one in chosen]
        found.chosen[:k] = [one.draw for one in chosen]
        found.standing[:k] = place[found.chosen[:k]]
        rooms = found.joints, found.bone_length, found.places, found.focal
        for room, part in zip(rooms, draws, strict=True):
            room[:kept] = part[:kept]
        return found


def nothing_drawn(name: str, status: str, sentence: str, k: int, keep: int) -> FrameDraws:
    """A frame without draws, with room for so many hypotheses and kept draws."""
    blank = np.full((NUM_JOINTS, 3), np.nan)
    return FrameDraws(
        name,
        status,
        sentence,
        num_draws=0,
        log_evidence=-np.inf,
        log_evidence_se=np.inf,
        effective_roots=np.nan,
        outlier=blank[:, 0],
        exchange=np.full(NUM_EXCHANGES, np.nan),
        mean=blank,
        sd=blank,
        place=blank[0],
        place_sd=blank[0],
        depth=np.full((NUM_JOINTS, len(LEVELS)), np.nan),
        hypotheses=np.full((k, NUM_JOINTS, 3), np.nan),
        standing=np.full((k, 3), np.nan),
        weight=np.zeros(k),
        chosen=np.full(k, -1),
        joints=np.full((keep, NUM_JOINTS, 3), np.nan, np.float32),
        bone_length=np.full((keep, NUM_LENGTHS), np.nan, np.float32),
        places=np.full((keep, 3), np.nan, np.float32),
        focal=np.full(keep, np.nan, np.float32),
    )


def sample_frames(
    model: PoseModel,
    frames: Iterable[Item],
    *,
    key: jax.Array | int,
    out: str | os.PathLike,
    estimating: Estimating | None = None,
    sampler: str | None = None,
    root: str = UNCERTAIN,
    num_roots: int | None = None,
    most_roots: int | None = None,
    num_samples: int = 10_000,
    k: int = 5,
    composed: bool = False,
    keep: int = 0,
    max_proposals: int = MAX_PROPOSALS,
    machines: Machines = HERE,
    progress: Progress | None = None,
) -> Path:
    """Draws poses of every frame, chooses hypotheses among them, and writes both to a folder, where
    a run that was stopped is resumed.

    A frame that is a sentence, whose budget of `max_proposals` ends, or whose draws rest on too few
    roots, is recorded with its reason. Damaged blocks are made anew.

    Parameters
    ----------
    model
        The prior of poses.
    frames
        Read as they are needed, in this process; of calibrated cameras `Footage`.
    key
        Of all draws: the same key, the same bits, whoever draws.
    out
        The folder.
    estimating
        How detections are estimated; not needed where all frames are estimates.
    sampler, root, num_roots, most_roots, num_samples
        As `inference.sample` takes them: what is drawn of every frame; by default from `MANY_ROOTS`
        roots. Of `Footage` as `sample_instant` takes them, and there is one prior of roots alone.
    k, composed
        How many hypotheses of each frame, and whether they are put together limb by limb
        (`inference.composition`), rather than draws.
    keep
        How many draws of each frame are written, of `DRAW_BYTES` each, for `draws_of`.
    max_proposals
        Most proposals for a frame.
    machines
        Who draws; blocks are written by this process.
    progress
        Called with the number of frames done, block by block.

    Returns
    -------
    Path
        `out`.

    Raises
    ------
    BadInput
        Where `out` holds another run, or another process is writing to it, where the numbers do not
        go together, where a detection comes without `estimating`, or views come without being
        `Footage`, and as these and `sampler_of` do.
    """
    keep = min(keep, num_samples)
    if num_samples < 1 or not 1 <= k <= num_samples or keep < 0:
        raise BadInput(
            f"{num_samples} samples, {k} hypotheses and {keep} kept do not go together; choose at"
            " least one sample, at most as many hypotheses, and no negative number to keep"
        )
    key = key_of(key)
    if estimating:
        estimating([])  # refuses what would fail for everybody
    folder = Path(out)
    size = frames_of_block(keep)
    words = np.asarray(jax.random.key_data(key))
    world = frames.world if isinstance(frames, Footage) else None
    if world is not None:
        root = WORLD
        _require_whole(composed)
    elif num_roots is None:
        num_roots = MANY_ROOTS
    chosen = sampler_of(
        root, sampler, num_roots=num_roots, most_roots=most_roots, max_proposals=max_proposals
    )
    draw = DetectionSampler(model, root, chosen, num_samples)
    task = _Drawing(
        draw=draw,
        estimating=estimating,
        words=words,
        k=k,
        composed=composed,
        keep=keep,
        lens=model.lens,
        world=world,
    )
    settings = {
        "study": "stream of frames",
        "format": STREAM_FORMAT,
        "seed": key_words(key),
        "block": size,
        **draw.settings,
        **(estimating.settings if estimating else {}),
        **(frames.settings if isinstance(frames, Footage | FramesInMotion) else {}),
        "k": k,
        **({"composed": True} if composed else {}),
        "keep": keep,
        **provenance(model),
    }
    taken: list[int] = []

    def take(block: Block, groups: Groups) -> None:
        taken.append(block.size)
        if progress:
            progress(sum(taken))

    with locked(folder):
        store = Store.begin(folder, settings)
        fill(
            store,
            machines,
            task,
            _blocks(_possible(frames, estimating, world is not None), size),
            take,
        )
        store.finish(len(taken))
    return folder


def open_stream(folder: str | os.PathLike) -> xr.DataTree:
    """Summaries and hypotheses of all frames of a stream; the draws stay in their blocks, see
    `draws_of`.

    Parameters
    ----------
    folder
        Where `sample_frames` wrote it.

    Returns
    -------
    DataTree
        `/summary` by frame: status, sentence, num_draws, log_evidence with its standard error,
        effective_roots (NaN where torso and camera are fixed), the probabilities that a keypoint is
        an `outlier` `(frame, joint)` and that left and right are exchanged by a `pattern`,
        `exchange` `(frame, pattern)` (NaN under a law without either; of calibrated cameras
        `(frame, view, ...)`), `mean` and `sd` of joints `(frame, joint, axis)` about the pelvis,
        quantiles of their `depth` `(frame, joint, level)`, and `place` and `place_sd`
        `(frame, axis)` of the pelvis before the camera, body units (NaN where no focal length is
        known, but in a film); `/hypotheses`: `joints` `(frame, hypothesis, joint, axis)`, `place`
        `(frame, hypothesis, axis)`, `weight`, `draw`. The settings of the run are attributes; of
        calibrated cameras `up`, `unit_mm` and `views` too, by which axes are level and body units
        known (`CalibratedWorld`).

    Raises
    ------
    BadInput
        Where there is no stream, or a block of it is missing, damaged or of another run.
    """
    store = Store.open(Path(folder), _STREAM)
    numbers = store.numbers()
    if not numbers:
        raise BadInput(f"{folder} is a stream without any frame yet; run again to fill it")
    found = xr.DataTree.from_dict(
        {
            group: xr.concat([store.read(number, group) for number in numbers], dim="frame")
            for group in ("summary", "hypotheses")
        }
    )
    found["summary"] = _with_faults(found["summary"].to_dataset())
    if "views" in store.settings:
        own = found["summary"].to_dataset().assign_coords(view=store.settings["views"])
        found["summary"] = own.assign_attrs(unit_mm=store.settings["unit_mm"])
    found.attrs.update(store.settings)
    return found


def _with_faults(summary: xr.Dataset) -> xr.Dataset:
    """A summary that says nothing of faults, as those of earlier versions do not, says so."""
    number, patterns = summary.sizes["frame"], list(EXCHANGES)
    blank = {
        "outlier": (("frame", "joint"), np.full((number, NUM_JOINTS), np.nan)),
        "exchange": (("frame", "pattern"), np.full((number, len(patterns)), np.nan)),
    }
    missing = {name: value for name, value in blank.items() if name not in summary}
    return summary.assign(missing).assign_coords(pattern=patterns)


def draws_of(folder: str | os.PathLike, name: str) -> xr.Dataset:
    """The draws that were kept of one frame.

    Parameters
    ----------
    folder
        The stream's.
    name
        The frame's.

    Returns
    -------
    Dataset
        `joints` `(chain, draw, joint, axis)`, `bone_length`, `place` `(chain, draw, axis)` of the
        pelvis and the `focal` length `(chain, draw)` with which it is there (both NaN in weak
        perspective), as ArviZ takes them.

    Raises
    ------
    BadInput
        As `open_stream`, and where there is no such frame, or no draw was kept of any.
    """
    store = _with_draws(folder)
    for number in store.numbers():
        summary = store.read(number, "summary")
        index = np.flatnonzero(summary.frame.values == name)
        if len(index):
            return _held(summary, store.read(number, "posterior"), int(index[0]))
    raise BadInput(
        f"{folder} has no frame {name!r}; its names are in the summary that `open_stream` gives"
    )


def all_draws(folder: str | os.PathLike) -> Iterator[tuple[str, xr.Dataset]]:
    """As `draws_of`, of every frame, by its name, block after block."""
    store = _with_draws(folder)
    for number in store.numbers():
        summary, drawn = store.read(number, "summary"), store.read(number, "posterior")
        for index, name in enumerate(summary.frame.values):
            yield str(name), _held(summary, drawn, index)


def _with_draws(folder: str | os.PathLike) -> Store:
    """A stream in which draws were kept. Raises `BadInput` where it is none."""
    store = Store.open(Path(folder), _STREAM)
    require_draws(folder, store.settings)
    return store


def require_draws(folder: str | os.PathLike, settings: Mapping[Any, Any]) -> None:
    """Raises `BadInput` where no draws were kept in a stream of such settings."""
    if not settings.get("keep"):
        raise BadInput(
            f"no draws were kept in {folder}; draw again into another folder with `keep`"
            " (on the command line --keep), how many draws of each frame are written"
        )


def _held(summary: xr.Dataset, drawn: xr.Dataset, index: int) -> xr.Dataset:
    """The draws of one frame of a block, without the blanks after them."""
    rows = drawn.isel(frame=index)
    held = min(int(summary.num_draws[index]), rows.sizes["draw"])
    return rows.isel(draw=slice(held)).expand_dims("chain")


class People:
    """Everyone in frames of detections as items of a stream, named `frame/person`, where a person
    has the same number in all frames (`probmodel.people`).

    A person of whom too little is seen is left out where enough is seen of somebody else in the
    frame: detectors find fragments of people at the edges and behind others. Where there is nobody
    else, the one of whom most is seen becomes the sentence that says why, and the others are left
    out.

    Parameters
    ----------
    frames
        Gives the frames from the first; called once to tell who is who, and whenever the items are
        read, one frame after another.
    require
        Raises `BadInput` where too little is seen of a person.
    person
        The number of the one whose items these are; None for everyone.

    Attributes
    ----------
    cast : who is who.
    fragments : how many people were left out, and the first of them in words.

    Raises
    ------
    BadInput
        Where there is no such person, and as `frames` does.
    """

    def __init__(
        self,
        frames: Callable[[], Iterable[DetectedFrame]],
        require: Callable[[Detection], None],
        person: int | None = None,
    ) -> None:
        self._frames, self._require, self._person = frames, require, person
        self.fragments: list[str] = []
        self.cast = cast_of((frame.name, self._kept(frame)) for frame in frames())
        if person is not None and not 0 <= person < self.cast.size:
            raise BadInput(
                f"there is no person {person} in these frames, but {self.described()}; choose one"
                " of them"
            )

    def of(self, person: int) -> "People":
        """One of these people alone; who is who is not told again."""
        found = copy.copy(self)
        found._person = person
        return found

    def __len__(self) -> int:
        """How many items there are."""
        counts = self.cast.frames
        return sum(counts) if self._person is None else counts[self._person]

    def __iter__(self) -> Iterator[Item]:
        for frame, numbers in zip(self._frames(), self.cast.numbers, strict=True):
            places = self._places(frame)
            for place, number in zip(places, numbers, strict=True):
                if self._person in (None, number):
                    detection = frame.people[place]
                    reason = self._reason(detection)
                    name = f"{frame.name}/{number}"
                    yield Item(name, detection if reason is None else reason)

    def described(self) -> str:
        """How many people there are, the first of them with their tracks and in how many frames
        each is."""
        people = zip(self.cast.tracks, self.cast.frames, strict=True)
        each = [
            f"{number} ({'' if track is None else f'track {track}, '}{count} frames)"
            for number, (track, count) in enumerate(people)
        ]
        more = f" and {len(each) - MOST_TRACKS_NAMED} more" if len(each) > MOST_TRACKS_NAMED else ""
        plural = "1 person" if len(each) == 1 else f"{len(each)} people"
        return f"{plural}: {', '.join(each[:MOST_TRACKS_NAMED])}{more}"

    def _kept(self, frame: DetectedFrame) -> list[Detection]:
        places = self._places(frame)
        self.fragments += [
            f"{frame.name}, number {place} there"
            for place in range(len(frame.people))
            if place not in places
        ]
        return [frame.people[place] for place in places]

    def _places(self, frame: DetectedFrame) -> list[int]:
        """Which of a frame's people are no fragments."""
        everyone = frame.people
        places = [at for at, one in enumerate(everyone) if self._reason(one) is None]
        if everyone and not places:
            places = [int(np.argmax([one.seen.sum() for one in everyone]))]
        return places

    def _reason(self, detection: Detection) -> str | None:
        """Why too little is seen; None where it is enough."""
        try:
            self._require(detection)
        except BadInput as error:
            return str(error)
        return None


def frame_and_person(name: str) -> tuple[str, str]:
    """The two parts of an item's name; the person is empty where somebody else named it."""
    frame, slash, person = name.rpartition("/")
    return (frame, person) if slash else (name, "")


def in_time(frames: list[str]) -> tuple[list[int], list[int] | None]:
    """The order of frames by their numbers, and these; their own order, and None, where their names
    have none."""
    numbers = frame_numbers(frames)
    if numbers is None:
        return list(range(len(frames))), None
    order = sorted(range(len(frames)), key=lambda at: numbers[at])
    return order, [numbers[at] for at in order]


def rows_of_person(
    names: list[str], person: int | None, path: Path
) -> tuple[list[str], list[int | None]]:
    """The names of all frames, and in which row of the stream the person stands in each (None: in
    none). Items are called `frame/person` where a detector's file was read."""
    parts = [frame_and_person(name) for name in names]
    people = sorted({who for _, who in parts}, key=lambda who: (len(who), who))
    if person is None and len(people) > 1:
        raise BadInput(
            f"{path} is a film of {len(people)} people; choose one with `person` (on the command"
            f" line --person), of {', '.join(people[:20])}"
        )
    who = people[0] if person is None else str(person)
    if who not in people:
        raise BadInput(f"{path} has no person {who}; choose one of {', '.join(people[:20])}")
    rows = {frame: row for row, (frame, one) in enumerate(parts) if one == who}
    frames = list(dict.fromkeys(frame for frame, _ in parts))
    return frames, [rows.get(frame) for frame in frames]


@dataclass(frozen=True)
class _Drawing:
    """The task of a block: draws and hypotheses of its frames, of which it is told the number of
    the first; `words` are those of the run's key."""

    draw: DetectionSampler
    estimating: Estimating | None
    words: np.ndarray
    k: int
    composed: bool
    keep: int
    lens: Lens | None
    world: CalibratedWorld | None

    def __call__(self, block: tuple[int, list[Item]]) -> Groups:
        first, items = block
        names, frames = [item.name for item in items], self._estimates(items)
        rows = in_threads(self._drawn, range(first, first + len(items)), names, frames)
        return groups_of(rows, self.k)

    def _estimates(self, items: list[Item]) -> list[Estimate | Instant | str]:
        """Detections are estimated together, or one by one where that fails for one of them."""
        estimating = self.estimating
        people = [item.frame for item in items if isinstance(item.frame, Detection)]
        found: Iterator[Estimate | str] = iter(())
        if estimating is not None and people:
            try:
                found = iter(estimating(people))
            except BadInput:
                found = (_alone(estimating, person) for person in people)
        return [
            _with_sides(next(found), item) if isinstance(item.frame, Detection) else item.frame
            for item in items
        ]

    def _drawn(self, index: int, name: str, frame: Estimate | Instant | str) -> FrameDraws:
        if isinstance(frame, str):
            return self._nothing(name, BAD_INPUT, frame)
        key = jax.random.fold_in(jax.random.wrap_key_data(jnp.asarray(self.words)), index)
        try:
            draws = self.draw(frame, key)
        except BadInput as error:  # a torso of which too little is seen for a root of its own
            return self._nothing(name, BAD_INPUT, str(error))
        drawn = self._nothing(name, draws.status, draws.sentence)._replace(
            log_evidence=draws.log_evidence,
            log_evidence_se=draws.log_evidence_se,
            effective_roots=draws.effective_roots,
        )
        if not len(draws):
            return drawn
        if self._knows_faults(draws):
            patterns = np.asarray(draws.faults.exchange)[..., None] == np.arange(NUM_EXCHANGES)
            outlier = np.mean(draws.faults.outlier, axis=0)
            drawn = drawn._replace(outlier=outlier, exchange=np.mean(patterns, axis=0))
        k, told = min(self.k, len(draws)), self._told(draws, frame)
        chosen = compose(draws, k) if self.composed else diverse(told.joints.astype(np.float32), k)
        return drawn.drawn(told, chosen, standing=not self._drawn_lens(frame))

    def _told(self, draws: Draws, frame: Estimate | Instant) -> PoseDraws:
        if self.world is not None:
            return _in_world(draws, self.world)
        return PoseDraws(draws.joints, draws.bone_length, *_standing(draws, self._lens_of(frame)))

    def _knows_faults(self, draws: Draws) -> bool:
        """Whether the law has faults, though none may be possible in this frame of a film."""
        law = None if self.estimating is None else self.estimating.likelihood
        return draws.posterior.faults.any or (law is not None and law.faults.any)

    def _lens_of(self, frame: Estimate | Instant) -> Lens | None:
        return self.lens if isinstance(frame, Instant) or frame.lens is None else frame.lens

    def _drawn_lens(self, frame: Estimate | Instant) -> bool:
        """Whether focal lengths are drawn with the rest."""
        lens = self._lens_of(frame)
        return lens is not None and lens.number > 1

    def _nothing(self, name: str, status: str, sentence: str) -> FrameDraws:
        return nothing_drawn(name, status, sentence, self.k, self.keep)


def _standing(draws: Draws, lens: Lens | None) -> tuple[np.ndarray, np.ndarray]:
    """`(n, 3)`: where the pelvis of every draw stands in the camera's axes, body units, and `(n,)`
    its focal length, pixels; NaN where there is no lens. A lens sees a body unit there as `scale`
    pixels."""
    if lens is None:
        return np.full((len(draws.joints), 3), np.nan), np.full(len(draws.joints), np.nan)
    scale, focal = np.asarray(draws.scale)[:, None], focal_of(draws)
    assert focal is not None  # the posterior has the lens
    aside = (draws.keypoints[:, JOINT_INDEX["pelvis"]] - np.asarray(lens.principal)) / scale
    return np.concatenate([aside, focal[:, None] / scale], axis=1), focal


def _in_world(draws: Draws, world: CalibratedWorld) -> PoseDraws:
    """The draws of what calibrated cameras saw: as large as they are."""
    size = np.exp(np.asarray(draws.points.log_size))
    return PoseDraws(
        world.told(size[:, None, None] * draws.joints),
        draws.bone_length * (size / world.unit_mm)[:, None],
        world.told(np.asarray(draws.points.place)),
        np.full(len(size), np.nan),
    )


def _require_whole(composed: bool) -> None:
    """Raises `BadInput` where hypotheses of several views are to be put together limb by limb."""
    if composed:
        raise BadInput(
            "hypotheses of several views are draws, and not put together limb by limb; leave"
            " `composed` out (on the command line --composed)"
        )


def _with_sides(estimate: Estimate | str, item: Item) -> Estimate | str:
    """An estimate whose sides are exchanged as probably as its item says."""
    if isinstance(estimate, str) or item.exchange is None:
        return estimate
    likelihood = estimate.likelihood
    faults = dataclasses.replace(likelihood.faults, exchange=item.exchange)
    return dataclasses.replace(estimate, likelihood=dataclasses.replace(likelihood, faults=faults))


def _alone(estimating: Estimating, person: Detection) -> Estimate | str:
    try:
        return estimating([person])[0]
    except BadInput as error:
        return str(error)


def frames_of_block(keep: int) -> int:
    """How many frames a block holds, of each of which so many draws are kept."""
    return max(1, min(MOST_IN_BLOCK, BLOCK_BYTES // (DRAW_BYTES * max(keep, 1))))


def groups_of(rows: list[FrameDraws], k: int) -> Groups:
    """What a block holds of its frames."""
    fields = {name: [getattr(row, name) for row in rows] for name in FrameDraws._fields}
    names = {"frame": fields["name"], "joint": list(JOINTS), "axis": list("xyz")}
    scalars = ("num_draws", "log_evidence", "log_evidence_se", "effective_roots")
    by_frame = ("status", "sentence", *scalars)
    units = {"units": "body units"}

    def column(field: str, *dims: str, **attributes: str) -> tuple[Any, ...]:
        return ("frame", *dims), np.stack(fields[field]), attributes

    summary = {name: column(name) for name in by_frame} | {
        name: column(name, "joint", "axis") for name in ("mean", "sd")
    }
    summary |= {name: column(name, "axis", **units) for name in ("place", "place_sd")}
    summary["depth"] = column("depth", "joint", "level", **units)
    for name, dim in (("outlier", "joint"), ("exchange", "pattern")):
        shares = np.stack(np.broadcast_arrays(*fields[name]))  # blanks are of no view
        summary[name] = (("frame", *(["view"] if shares.ndim == 3 else []), dim), shares)
    hypotheses = {
        "joints": column("hypotheses", "hypothesis", "joint", "axis"),
        "place": column("standing", "hypothesis", "axis", **units),
        "weight": column("weight", "hypothesis"),
        "draw": column("chosen", "hypothesis"),
    }
    posterior = {
        "joints": column("joints", "draw", "joint", "axis", **units),
        "bone_length": column("bone_length", "draw", "length_group", **units),
        "place": column("places", "draw", "axis", **units),
        "focal": column("focal", "draw", units="pixels"),
    }
    return {
        "summary": xr.Dataset(
            summary, coords=names | {"level": list(LEVELS), "pattern": list(EXCHANGES)}
        ),
        "hypotheses": xr.Dataset(hypotheses, coords=names | {"hypothesis": np.arange(k)}),
        "posterior": xr.Dataset(posterior, coords=names | {"length_group": list(LENGTH_GROUPS)}),
    }


def _possible(
    frames: Iterable[Item], estimating: Estimating | None, footage: bool
) -> Iterator[Item]:
    """Frames, as they are read. Raises `BadInput` on a detection that nobody can estimate, and on
    views that are of no footage."""
    for item in frames:
        if isinstance(item.frame, Instant) and not footage:
            raise BadInput(
                f"{item.name} is of calibrated cameras; give all of their frames together, as"
                " `Footage`"
            )
        if estimating is None and isinstance(item.frame, Detection):
            raise BadInput(
                f"{item.name} is a detection; say how it is estimated (`estimating`), or give its"
                " estimate"
            )
        yield item


def _blocks(frames: Iterable[Item], size: int) -> Iterator[Block]:
    for number, some in enumerate(itertools.batched(frames, size)):
        items, first = list(some), number * size
        words = f"frames {first} to {first + len(items) - 1}"
        yield Block(number, words, {"frames": _fingerprint(items)}, len(items), (first, items))


def _fingerprint(items: list[Item]) -> str:
    """What the frames of a block are, in short: names, detections, candidates."""
    digest = hashlib.sha256()
    for name, frame, exchange in items:
        digest.update(name.encode("utf-8", "backslashreplace"))
        if exchange is not None:
            digest.update(repr(exchange).encode())
        if isinstance(frame, str):
            digest.update(frame.encode("utf-8", "backslashreplace"))
            continue
        if isinstance(frame, Instant):
            digest.update(_views_in_short(frame))
            continue
        detection = frame if isinstance(frame, Detection) else frame.detection
        digest.update(repr(detection.moved).encode())
        arrays: list[Any] = [detection.keypoints, detection.score]
        if isinstance(frame, Estimate):
            digest.update(frame.likelihood.sha256.encode())
            for candidate in frame.candidates:
                camera = candidate.camera
                arrays += [candidate.torso, camera.scale, camera.rotation, camera.translation]
        for array in arrays:
            digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()


def _views_in_short(instant: Instant) -> bytes:
    """Of what each camera saw, and of the cameras."""
    digest = hashlib.sha256()
    for view in instant.views:
        digest.update(f"{view.label} {view.likelihood.sha256}".encode("utf-8", "backslashreplace"))
    rig = instant.rig
    arrays = [instant.keypoints, instant.score, rig.focal, rig.principal, rig.rotation, rig.centre]
    for array in [*arrays, instant.pointing]:
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.digest()
