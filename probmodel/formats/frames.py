"""Frames: a folder with a file for each, or one long file, read one frame after another.

    for frame in probmodel.read_frames("keypoints/"):
        frame.name, frame.people

Nothing is read before it is asked for, and nothing kept after: a frame is (its name, its people),
and may have nobody."""

import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats import content_of, format_of, openpose, people_of
from poseterior.probmodel.formats.common import Content
from poseterior.probmodel.formats.units import Unit, unit_of

PROBES = 25
"""Files of a folder, evenly spread, that say in which format it is."""
_SUFFIX = "_keypoints"
"""What OpenPose adds to the name of a frame."""


class DetectedFrame(NamedTuple):
    """A frame of a film.

    Attributes
    ----------
    name
        The image's name, a number in the file, or the name of its file.
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

    A folder has one format, told from a few of its files, since one frame may show too little.

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
        Where there is no file; and, once it is reached, at the first that cannot be read.
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
    frames = (_frames_of_file(replace(one, unit=unit), chosen, threshold) for one in contents)
    return itertools.chain.from_iterable(frames)


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
    return re.split(r"\d+", name), [int(digits) for digits in re.findall(r"\d{1,18}", name)], name


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


def _frames_of_file(
    content: Content, format: str, threshold: float | None
) -> Iterator[DetectedFrame]:
    people = people_of(content, format_of(content, format), threshold)
    stem = Path(content.source).stem.removesuffix(_SUFFIX)
    nobody = True
    for image, group in groupby(people, key=lambda person: person.image_id):
        nobody = False
        seen = [person for person in group if person.seen.any()]
        yield DetectedFrame(stem if image is None else image, seen)
    if nobody:
        yield DetectedFrame(stem, [])
