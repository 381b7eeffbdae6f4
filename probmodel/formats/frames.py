"""Frames: a folder with a file for each, or one long file, read one frame after another.

    for frame in probmodel.read_frames("keypoints/"):
        frame.name, frame.people

Nothing is read before it is asked for, and nothing kept after: a frame is (its name, its people),
and may have nobody."""

import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats import content_of, format_of, openpose, people_of
from poseterior.probmodel.formats.common import Content
from poseterior.probmodel.formats.units import Unit, unit_of
from poseterior.probmodel.people import distances

PROBES = 25
"""Files of a folder, evenly spread, that say in which format it is."""
_SUFFIX = "_keypoints"
"""What OpenPose adds to the name of a frame."""
_EXTENSION = re.compile(r"\.[A-Za-z]+$")
_FRACTION = re.compile(r"\d+\.\d+")
MOST_NUMBERED = 1_000_000
"""Frames of a film, seen or not: nine hours at thirty a second. Numbers farther apart are those of
images or clocks."""
OF_ONE_IMAGE = ("openpose", "opencv", "ultralytics-text")
"""How the formats begin that write a file an image, and so the people of one."""
LARGEST_FRAME = 10**30
"""Times in nanoseconds have nineteen digits."""
FEWEST_RECORDS, NEAR = 3, 0.3
"""Records of a file that names no frames are frames, and not people of one, where there are so many
and each lies within this, in sizes of a body, of where the one before does."""


class DetectedFrame(NamedTuple):
    """A frame of a film.

    Attributes
    ----------
    name
        The image's name, its number in the file, or in a folder with a file for each frame the
        file's name. Unlike any other's; what number it says: `frame_numbers`.
    people
        Who was found in it; there may be nobody.
    """

    name: str
    people: list[Detection]


def read_frames(
    path: str | os.PathLike[str],
    format: str = "auto",
    threshold: float | None = None,
    *,
    image_size: tuple[int, int] | None = None,
    names: Mapping[str, str] | Sequence[str] | None = None,
    layout: str | None = None,
) -> Iterator[DetectedFrame]:
    """The frames of a folder (sorted by name, numbers by value) or of a file, one after another.

    A folder has one format, told from a few of its files, since one frame may show too little. A
    file may have its people in any order, that of tracks for one: it is looked through first.

    Parameters
    ----------
    path
        The folder, with one file for each frame, or the file.
    format, threshold, image_size, names, layout
        As in `read_detections`.

    Yields
    ------
    DetectedFrame
        A frame, in which there may be nobody.

    Raises
    ------
    BadInput
        Where there is no file; and, once it is reached, at the first of a folder that cannot be
        read.
    """
    path = Path(path)
    if not path.is_dir():
        return _frames_of_file(content_of(path, image_size, names, layout), format, threshold)
    files = sorted_files(path)
    if not files:
        raise BadInput(
            f"{path} holds no files; give a folder with one file of 2D joints for each frame."
        )
    chosen, unit = _probed(files, format, threshold, image_size, names, layout)
    contents = (content_of(file, image_size, names, layout) for file in files)
    known = (replace(content, unit=unit) for content in contents)
    return _frames_of_folder(known, len(files), chosen, threshold)


def sorted_files(folder: Path) -> list[Path]:
    """The files of a folder, hidden ones aside, `frame_2` before `frame_10`. Raises `BadInput`
    where it is closed."""
    try:
        with os.scandir(folder) as entries:
            found = [
                entry.path
                for entry in entries
                if not entry.name.startswith(".") and entry.is_file()
            ]
    except OSError as error:
        raise BadInput(
            f"{folder} cannot be read ({error.strerror}); check its permissions."
        ) from None
    return [Path(name) for name in sorted(found, key=natural_order)]


def natural_order(name: str) -> tuple[list[str], list[int], str]:
    """By which names are sorted so that `frame_2` comes before `frame_10`."""
    return re.split(r"\d+", name), [int(digits) for digits in re.findall(r"\d+", name)], name


def frame_numbers(names: Sequence[str]) -> list[int] | None:
    """The numbers of a film's frames, from their names: by them times are told, and gaps.

    It is the one run of digits that differs from name to name; of several that do, the last, where
    it counts in the same order as all of them.

    Parameters
    ----------
    names
        Of all frames, each once: images, files, or indices of a table, in any order.

    Returns
    -------
    list of int or None
        None where the names do not count frames: no digits, two frames of one number (as of several
        cameras), times of a clock, or more than `MOST_NUMBERED` of their steps between the first
        and the last.
    """
    stems = [_EXTENSION.sub("", name) for name in names]
    if any(_FRACTION.fullmatch(stem) for stem in stems):  # an index of pandas, or seconds
        found = _whole(stems)
    else:
        parts = [natural_order(stem)[:2] for stem in stems]
        columns = list(zip(*(digits for _, digits in parts), strict=False))
        if not columns or any(words != parts[0][0] for words, _ in parts):
            return None
        varying = [column for column in columns if len(set(column)) > 1]
        found = list((varying or columns)[-1])
        by_all = sorted(range(len(names)), key=lambda one: parts[one][1])
        if by_all != sorted(range(len(names)), key=lambda one: found[one]):
            return None
    if found is None or len(set(found)) < len(found) or max(found) > LARGEST_FRAME:
        return None
    step = math.gcd(*(number - found[0] for number in found)) or 1
    return found if (max(found) - min(found)) // step < MOST_NUMBERED else None


def named_by(number: int, names: Sequence[str], numbers: Sequence[int]) -> str:
    """What a frame of another number would be called.

    Parameters
    ----------
    number
        That frame's.
    names, numbers
        Of frames in the order of time, two at least, as `frame_numbers` counts them.

    Returns
    -------
    str
        The first one's name with the number in place of its own.
    """
    first, last = (list(re.finditer(r"\d+", name)) for name in (names[0], names[-1]))
    ends = (numbers[0], numbers[-1])
    counts = [
        one for one, other in zip(first, last, strict=False) if (int(one[0]), int(other[0])) == ends
    ]
    start, end = counts[-1].span()
    return f"{names[0][:start]}{number:0{end - start}}{names[0][end:]}"


def _whole(texts: Sequence[str]) -> list[int] | None:
    """Numbers that are written as decimals; None where one is not whole, or no number."""
    if not all(re.fullmatch(r"\d+(\.0*)?", text) for text in texts):
        return None
    return [int(text.partition(".")[0]) for text in texts]


def _probed(
    files: Sequence[Path],
    format: str,
    threshold: float | None,
    image_size: tuple[int, int] | None,
    names: Mapping[str, str] | Sequence[str] | None,
    layout: str | None,
) -> tuple[str, Unit | None]:
    """The format of a folder's files, by name, and what their coordinates are counted in, from
    `PROBES` of them, since one frame may show too little.

    Raises `BadInput` where the files are not of one format.
    """
    probes = files[:: max(1, len(files) // PROBES)][:PROBES]
    contents = [content_of(file, image_size, names, layout) for file in probes]
    if format in ("auto", "openpose"):
        format = _format_of_all(contents)
    row = format_of(contents[0], format)
    people: list[Detection] = []
    for content in contents:
        with suppress(BadInput):  # a file that is refused once it is reached
            people += row.read(content, row.threshold if threshold is None else threshold)
    seen = [person for person in people if person.seen.any()]
    return format, unit_of(seen, centred=row.centred) if seen and row.unit is None else None


def _format_of_all(contents: Sequence[Content]) -> str:
    """The format of a few of a folder's files; OpenPose's with the order of its 25 points."""
    found = {format_of(content).name: content.source for content in contents}
    if len(found) > 1:
        said = ", ".join(f"{source} is {name}" for name, source in found.items())
        raise BadInput(
            f"the files of this folder differ in format ({said}); keep one format in a folder."
        )
    people = (
        [points for content in contents for points in openpose.bodies(content)]
        if set(found) == {"openpose"} and contents[0].layout is None
        else []
    )
    if not people:
        return next(iter(found))
    body = openpose.body_order(people, str(Path(contents[0].source).parent))
    return {openpose.BODY_25: "openpose-body25", openpose.BODY_25B: "openpose-body25b"}[body]


def _frames_of_folder(
    contents: Iterable[Content], count: int, format: str, threshold: float | None
) -> Iterator[DetectedFrame]:
    """The frames of `count` files."""
    for content in contents:
        frames = list(_frames_of_file(content, format, threshold))
        stem = _stem(content)
        for frame in frames:
            several = frame.name if count == 1 else f"{stem}/{frame.name}"
            yield frame._replace(name=stem if len(frames) == 1 else several)


def _stem(content: Content) -> str:
    return Path(content.source).stem.removesuffix(_SUFFIX)


def _frames_of_file(
    content: Content, format: str, threshold: float | None
) -> Iterator[DetectedFrame]:
    """The frames of a file, with those of whom something is seen."""
    for frame in _all_frames(content, format, threshold):
        yield frame._replace(people=[person for person in frame.people if person.seen.any()])


def _all_frames(content: Content, format: str, threshold: float | None) -> Iterator[DetectedFrame]:
    """In the order of their numbers or, where they have none, in which they come. Only a file whose
    frames are scattered is kept as a whole."""

    row = format_of(content, format)

    def people() -> Iterator[Detection]:
        return people_of(content, row, threshold)

    names = [image for image, _ in groupby(people(), key=lambda person: person.image_id)]
    if set(names) <= {None}:
        everyone, stem = list(people()), _stem(content)
        if row.name.startswith(OF_ONE_IMAGE) or not _one_after_another(everyone):
            yield DetectedFrame(stem, everyone)
        else:
            yield from (DetectedFrame(str(at), [one]) for at, one in enumerate(everyone))
        return
    ordered = _in_order([image for image in dict.fromkeys(names) if image is not None])
    ordered += [None] if None in names else []
    if ordered == names:
        for image, group in groupby(people(), key=lambda person: person.image_id):
            yield DetectedFrame(_stem(content) if image is None else image, list(group))
        return
    found: dict[str | None, list[Detection]] = {image: [] for image in ordered}
    for person in people():
        found[person.image_id].append(person)
    for image, everyone in found.items():
        yield DetectedFrame(_stem(content) if image is None else image, everyone)


def _in_order(names: list[str]) -> list[str | None]:
    numbers = frame_numbers(names)
    if numbers is None:
        return [*names]
    return [name for _, name in sorted(zip(numbers, names, strict=True))]


def _one_after_another(people: list[Detection]) -> bool:
    """Whether the records of a file that names no frames are of one person, frame by frame: each
    lies where the one before does, as nobody can who stands beside another."""
    places = [one.keypoints for one in people if one.seen.any()]
    steps = [distances([one], [other])[0, 0] for one, other in pairwise(places)]
    return len(places) >= FEWEST_RECORDS and max(steps) <= NEAR
