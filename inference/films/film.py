"""Films: whole paths of one person, whose every frame keeps its own posterior.

    sample_film(model, items, rate=60, key=0, out="walk", estimating=estimating)
    film_draws("walk").joints         # (chain, draw, frame, joint, axis): a draw is a path

A film is a stream (`inference.stream`) in which draw i of all frames is one path of one body, so
that whatever reads streams reads films. Frames are drawn one by one, their draws are put in order
(`coupling`), gaps are filled (`gaps`), and what moves quicker than people do is taken away."""

import hashlib
import itertools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior.inference.estimators import Estimating
from poseterior.inference.films.coupling import LASTING, Frame, coupled
from poseterior.inference.films.gaps import filled
from poseterior.inference.films.lenses import film_lenses, rows_of_lens
from poseterior.inference.films.parts import Parts, PathBodies, put_together, taken_apart
from poseterior.inference.films.sides import with_sides
from poseterior.inference.footage import SIDES_TOLD_AT, Footage, Item
from poseterior.inference.hypothesis import Hypothesis, diverse
from poseterior.inference.machines import HERE, Machines
from poseterior.inference.resampling import times
from poseterior.inference.store import Block, Groups, Store, fill, locked
from poseterior.inference.stream import (
    STREAM_FORMAT,
    FrameDraws,
    PoseDraws,
    all_draws,
    frame_and_person,
    frames_of_block,
    groups_of,
    in_time,
    nothing_drawn,
    open_stream,
    require_draws,
    rows_of_person,
    sample_frames,
)
from poseterior.probmodel.body import mean_torso
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.frames import named_by
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.motion.lowpass import butterworth
from poseterior.probmodel.root_priors import WORLD
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.skeleton import TORSO_INDEX

CUTOFF = 4.0
"""Hz. In CMU motion capture at 30 frames a second, what is quicker moves wrists and ankles by 3 mm
(root mean square; 95 % of frames by less than 7)."""
FASTEST = 10_000.0
"""Frames a second at most."""
MOST_FILLED = 10
"""Times as many frames as there are poses: more would be no film."""
NUM_PATHS = 400
FRAMES_FOLDER = "frames"
"""The folder, in that of a film, of what is drawn for it frame by frame."""
FILM, FILLED = "film", "filled"
"""What such a stream calls itself, and the status of its frames without a pose of their own."""
_CHOSEN_BY = 50
"""Frames by which hypotheses, which are whole paths, are told apart."""
Progress = Callable[[int, int], None]
"""Called with the frames done, and how many there are."""


def sample_film(
    model: PoseModel,
    frames: Iterable[Item],
    *,
    rate: float,
    key: jax.Array | int,
    out: str | os.PathLike,
    estimating: Estimating | None = None,
    num_paths: int = NUM_PATHS,
    num_roots: int | None = None,
    most_roots: int | None = None,
    cutoff: float = CUTOFF,
    k: int = 5,
    machines: Machines = HERE,
    progress: Progress | None = None,
) -> Path:
    """Draws every frame, and puts the draws together to paths of one person.

    Parameters
    ----------
    model, frames
        As `sample_frames` takes them, of one person; torso and camera are uncertain. Detections are
        all read first: how keypoints move says where left and right are exchanged (`sides`), in the
        place of what the law says of any frame.
    rate
        As `film_of` takes it.
    key
        Of all draws.
    out
        Folder for the film; what is drawn of the frames goes to `frames` in it.
    estimating
        As `sample_frames` takes it.
    num_paths
        How many paths.
    num_roots, most_roots
        As `sample_frames` takes them; by default from `NUM_PATHS` roots, if it is no `Footage`.
    cutoff, k
        As `film_of` takes them.
    machines
        Who draws.
    progress
        Called now and then while the paths are made.

    Returns
    -------
    Path
        `out`, as `film_of` writes it.

    Raises
    ------
    BadInput
        As both do.
    """
    require_film(rate, cutoff, k, num_paths)
    if estimating is not None and not isinstance(frames, Footage):
        frames = with_sides(frames, rate, estimating.likelihood)
    drawn = sample_frames(
        model,
        frames,
        key=key,
        out=Path(out) / FRAMES_FOLDER,
        estimating=estimating,
        num_roots=NUM_PATHS if num_roots is None and not isinstance(frames, Footage) else num_roots,
        most_roots=most_roots,
        num_samples=num_paths,
        keep=num_paths,
        k=1,
        machines=machines,
    )
    return film_of(drawn, rate=rate, out=out, cutoff=cutoff, k=k, progress=progress)


def film_of(
    stream: str | os.PathLike,
    *,
    rate: float,
    out: str | os.PathLike,
    person: int | None = None,
    frames: Sequence[str] | None = None,
    cutoff: float = CUTOFF,
    k: int = 5,
    progress: Progress | None = None,
) -> Path:
    """Puts the draws of frames together to paths of one person.

    Every path is of one body, which is that of one draw. Frames keep their posteriors: until quick
    motion is taken away, the torsos of all paths are turned as those of the frame's draws, and the
    limbs of each kind are those of the draws. Where focal lengths were drawn, every path has one,
    the film's (`lenses`), and so stands somewhere; then frames keep their posteriors given it.

    Parameters
    ----------
    stream
        A folder of `sample_frames`, of which draws were kept: as many as there will be paths.
    rate
        Frames a second, as their names number them: of 60, frames 0, 2, 4 and so on are 30.
    out
        Another folder, for the film.
    person
        Whose film, if the stream is of several people.
    frames
        The names of all frames; those in which the person is not are gaps. By default those of the
        stream. Numbers that their names skip are gaps too.
    cutoff
        Hz: quicker motion is taken away; nothing is, where a film is too slow to hold any.
    k
        How many diverse paths are chosen as hypotheses.
    progress
        Called now and then.

    Returns
    -------
    Path
        `out`, a stream in which every frame has all paths, in one order, from the first frame with
        a pose to the last. Frames between them without one have the status "filled".

    Raises
    ------
    BadInput
        On a rate, a cutoff or a k that cannot be, and a rate other than that by which left and
        right were told; where no draws were kept, there is no such person or nobody with a pose;
        where frames are numbered with many more gaps than frames; and as
        `open_stream` and `sample_frames`.
    """
    source, folder = Path(stream), Path(out)
    tree = _frames_of(source, rate)
    paths = int(tree.attrs["keep"])
    require_film(rate, cutoff, k, paths)
    drawn, step = _drawn(source, tree, person, frames)
    with locked(folder):
        store = Store.begin(
            folder,
            {str(name): value for name, value in tree.attrs.items()}
            | {"study": FILM, "format": STREAM_FORMAT, "rate": rate, "step": step}
            | {"cutoff": cutoff, "lasting": LASTING, "k": k, "person": str(person)},
        )
        seed = [int(word) for word in str(tree.attrs["seed"]).split()]
        pace, random = rate / step, np.random.default_rng(seed)
        in_world = tree.attrs.get("root") == WORLD
        film = _paths(drawn, paths, pace, random, progress, in_world)
        parts = filled(film.parts, film.seen, pace, random)
        film = film._replace(parts=_without_quick(parts, pace, cutoff))
        task = _Writing(drawn, film, film.chosen(k), k, in_world)
        made_of = {"frames": _fingerprint(drawn)}
        blocks = [
            Block(number, f"frames {some[0]} to {some[-1]}", made_of, len(some), some)
            for number, some in enumerate(
                itertools.batched(range(len(drawn)), frames_of_block(paths))
            )
        ]
        fill(store, HERE, task, blocks, lambda block, groups: None)
        store.finish(len(blocks))
    return folder


def film_draws(folder: str | os.PathLike) -> xr.Dataset:
    """The paths of a film.

    Parameters
    ----------
    folder
        Of `film_of`.

    Returns
    -------
    Dataset
        `joints` `(chain, draw, frame, joint, axis)`, `place` `(chain, draw, frame, axis)` and
        `bone_length` `(chain, draw, length_group)`, body units; the `focal` length of each path
        `(chain, draw)`, pixels, NaN in weak perspective; `time` of the frames in seconds; the
        settings as attributes.

    Raises
    ------
    BadInput
        Where there is no film.
    """
    about = open_stream(folder).attrs
    if about["study"] != FILM:
        raise BadInput(
            f"{folder} is a stream whose draws do not follow each other in time; make a film of it"
            " with `film_of` (on the command line `poseterior film`)"
        )
    held = [one for _, one in all_draws(folder)]
    moving = ["joints", "place"]
    found = xr.concat([one[moving] for one in held], dim="frame")
    found = found.assign(held[0].drop_vars(["frame", *moving]).data_vars)
    found = found.transpose("chain", "draw", "frame", ...)
    seconds = np.arange(found.sizes["frame"]) * about["step"] / about["rate"]
    return found.assign_coords(time=("frame", seconds)).assign_attrs(about)


def require_film(rate: float, cutoff: float, k: int, paths: int) -> None:
    """Raises `BadInput` on numbers of which no film is made, whatever its frames are: see
    `film_of`."""
    if not 0 < rate <= FASTEST:  # false for NaN too
        raise BadInput(
            f"{rate:g} frames a second are no film; give a rate above 0, and at most {FASTEST:g}"
        )
    if not 0 < cutoff < math.inf:
        raise BadInput(f"motion cannot be cut off at {cutoff:g} Hz; give a cutoff above 0")
    if not 1 <= k <= paths:
        raise BadInput(
            f"{k} hypotheses cannot be chosen among {paths} paths; choose at least one, and at most"
            " as many as there are paths"
        )


def _frames_of(folder: Path, rate: float) -> xr.DataTree:
    """A stream of which a film of that rate can be made: its draws were kept, and are no paths
    yet."""
    tree = open_stream(folder)
    if tree.attrs["study"] == FILM:
        raise BadInput(
            f"{folder} is a film already; give what it was made of, the folder of its frames"
        )
    told = tree.attrs.get(SIDES_TOLD_AT)
    if told is not None and told != rate:
        raise BadInput(
            f"in the frames of {folder} left and right were told from how they follow each other at"
            f" {told:g} a second, and not at {rate:g}; give that rate, or draw them anew into"
            " another folder"
        )
    require_draws(folder, tree.attrs)
    return tree


class _Moment(NamedTuple):
    """A frame of the film: its name, what its stream says of it, and its draws; None for both where
    the person is not there."""

    name: str
    summary: xr.Dataset | None = None
    drawn: PoseDraws | None = None


def _drawn(
    folder: Path, tree: xr.DataTree, person: int | None, frames: Sequence[str] | None
) -> tuple[list[_Moment], int]:
    """All frames in the order of time, from the first with a pose to the last, and by how much
    their numbers grow from one to the next."""
    summary = tree["summary"].to_dataset()
    items = [str(name) for name in summary.frame.values]
    names, rows = rows_of_person(items, person, folder)
    held = {name: row for name, row in zip(names, rows, strict=True) if row is not None}
    who = frame_and_person(items[next(iter(held.values()))])[1]
    names = list(frames or names)
    order, numbers = in_time(names)
    number_of = numbers or range(len(order))
    counted = [names[at] for at in order]
    draws = dict(all_draws(folder))
    moments = {}
    for number, at in zip(number_of, order, strict=True):
        row = held.get(names[at])
        moments[number] = _moment(_item(names[at], who), row, summary, draws)
    there = [number for number, one in moments.items() if one.drawn is not None]
    if not there:
        row = next(iter(held.values()))
        raise BadInput(
            f"{folder} has no frame with a pose of that person, of whom {items[row]} says:"
            f" {summary.sentence.values[row]}"
        )
    first, last = there[0], there[-1]
    step = math.gcd(*(number - first for number in moments)) or 1
    if (last - first) // step >= MOST_FILLED * len(there):
        raise BadInput(
            f"the frames of {folder} are numbered from {first} to {last}, and only {len(there)} of"
            " them have a pose of that person; number them one by one, or give a part of them"
        )
    film = [
        moments.get(number) or _Moment(_item(named_by(number, counted, number_of), who))
        for number in range(first, last + 1, step)
    ]
    return film, step


def _item(frame: str, who: str) -> str:
    """What a person in a frame is called in a stream."""
    return f"{frame}/{who}" if who else frame


def _moment(
    name: str, row: int | None, summary: xr.Dataset, draws: dict[str, xr.Dataset]
) -> _Moment:
    if row is None:
        return _Moment(name)
    own = summary.isel(frame=row)
    held = draws[str(own.frame.values)]
    if not held.sizes["draw"]:
        return _Moment(name, own)
    return _Moment(name, own, PoseDraws.read(held))


class _Paths(NamedTuple):
    """Paths: parts `(frames, n)` on so many bodies; which frames are `seen`; and the `focal` length
    of each `(n,)`."""

    parts: Parts
    body: PathBodies
    seen: np.ndarray
    focal: np.ndarray

    def joints(self, frames: Sequence[int]) -> np.ndarray:
        """`(frames, n, 15, 3)`."""
        some = list(frames)
        return put_together(Parts(*(part[some] for part in self.parts)), self.body)

    def chosen(self, k: int) -> list[Hypothesis]:
        """Diverse paths."""
        some = evenly(len(self.seen), _CHOSEN_BY).tolist()
        paths = self.joints(some).swapaxes(0, 1)
        return diverse(paths.reshape(len(paths), -1, 3).astype(np.float32), k)


def _paths(
    moments: list[_Moment],
    paths: int,
    rate: float,
    random: np.random.Generator,
    progress: Progress | None,
    in_world: bool,
) -> _Paths:
    """Paths through the frames that have draws; blanks in the others."""
    seen = np.array([one.drawn is not None for one in moments])
    draws = [one.drawn for one in moments if one.drawn is not None]
    torsos = np.stack([one.joints[0, list(TORSO_INDEX)] for one in draws]).astype(float)
    like, after = mean_torso(torsos), np.diff(np.flatnonzero(seen), prepend=0) / rate
    focal, share = film_lenses([one.focal for one in draws])
    counts = times(share, paths, 0.5)
    focal, counts = focal[counts > 0], counts[counts > 0]
    steps, of_all = itertools.count(1), len(focal)

    def step() -> None:
        if progress is not None:
            progress(next(steps) // of_all, len(draws))

    groups = [
        _through([_rows(one, own, count) for one in draws], like, after, random, step, in_world)
        for own, count in zip(focal.tolist(), counts.tolist(), strict=True)
    ]
    # The first of the paths shall be no other than the last.
    order = random.permutation(paths) if of_all > 1 else np.arange(paths)
    found, bodies = zip(*groups, strict=True)
    body = PathBodies(*(np.concatenate(part)[order] for part in zip(*bodies, strict=True)))
    blank = Parts(*(np.empty((len(seen), paths, *part.shape[2:])) for part in found[0]))
    for part, values in zip(blank, zip(*found, strict=True), strict=True):
        part[seen] = np.concatenate(values, axis=1)[:, order]
    return _Paths(blank, body, seen, np.repeat(focal, counts)[order])


def _through(
    draws: list[PoseDraws],
    like: np.ndarray,
    after: np.ndarray,
    random: np.random.Generator,
    step: Callable[[], None],
    in_world: bool,
) -> tuple[Parts, PathBodies]:
    """Paths through all frames, as many as each has draws."""
    paths = len(draws[0].joints)
    owner = np.arange(paths) * len(draws) // paths
    joints = np.stack([draws[at].joints[row] for row, at in enumerate(owner)])
    length = np.stack([draws[at].bone_length[row] for row, at in enumerate(owner)])
    body = taken_apart(joints, length, like)[1]

    def frames() -> Iterator[Frame]:
        for one, seconds in zip(draws, after.tolist(), strict=True):
            parts = taken_apart(one.joints, one.bone_length, like)[0]
            yield Frame(parts._replace(place=one.place), one.joints, seconds)
            step()

    ordered = coupled(frames(), body, random, in_world=in_world)
    return Parts(*map(np.stack, zip(*ordered, strict=True))), body


def _rows(drawn: PoseDraws, focal: float, number: int) -> PoseDraws:
    """So many of the draws, those of a focal length if it is known, some of them twice where there
    are fewer."""
    rows = rows_of_lens(drawn.focal, focal, number)
    return PoseDraws(*(np.asarray(part, float)[rows] for part in drawn))


def _without_quick(parts: Parts, rate: float, cutoff: float) -> Parts:
    """Paths without what moves quicker; as they are where the film is too slow to hold any."""
    if cutoff >= rate / 2 or len(parts.turn) < 3:
        return parts
    return parts.over_time(lambda part: butterworth(part, rate, cutoff))


@dataclass(frozen=True)
class _Writing:
    """The task of a block, which is told the numbers of its frames."""

    moments: list[_Moment]
    film: _Paths
    chosen: list[Hypothesis]
    k: int
    in_world: bool

    def __call__(self, frames: Sequence[int]) -> Groups:
        joints = self.film.joints(frames)
        rows = [self._frame(at, own) for at, own in zip(frames, joints, strict=True)]
        return groups_of(rows, self.k)

    def _frame(self, at: int, joints: np.ndarray) -> FrameDraws:
        moment = self.moments[at]
        found = nothing_drawn(
            moment.name, FILLED, _without_pose(moment, self.in_world), self.k, len(joints)
        )
        if moment.drawn is not None and moment.summary is not None:
            own = moment.summary
            found = found._replace(
                status=str(own.status.values),
                sentence=str(own.sentence.values),
                log_evidence=float(own.log_evidence),
                log_evidence_se=float(own.log_evidence_se),
                effective_roots=float(own.effective_roots),
                outlier=own.outlier.values,
                exchange=own.exchange.values,
            )
        film = self.film
        here = PoseDraws(joints, film.body.length, film.parts.place[at], film.focal)
        chosen = [one._replace(joints=joints[one.draw]) for one in self.chosen]
        return found.drawn(here, chosen)


def _without_pose(moment: _Moment, in_world: bool) -> str:
    """Why a frame has no pose of its own."""
    own = moment.summary
    missing = "not all cameras of the session see the person" if in_world else "nobody was detected"
    why = f"{missing} there" if own is None else str(own.sentence.values)
    return f"filled from the frames before and after: {why}"


def _fingerprint(moments: list[_Moment]) -> str:
    """What a film is made of, in short: names and draws."""
    digest = hashlib.sha256()
    for one in moments:
        digest.update(one.name.encode("utf-8", "backslashreplace"))
        for part in one.drawn or ():
            digest.update(np.ascontiguousarray(part, "<f4").tobytes())
    return digest.hexdigest()
