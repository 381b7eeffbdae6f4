"""Files of 2D joints: `read_detections` reads them all, `write_detections` writes this project's own.

`FORMATS` is the table of readers; adding a format is one module and one row. A format is recognised by its content,
never by the name of the file.
"""

import math
import os
import secrets
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from probmodel.detections import Detection
from probmodel.failures import BadInput
from probmodel.formats import coco, native, openpose
from probmodel.formats.common import Content

__all__ = ["FORMATS", "Content", "Format", "read_content", "read_detections", "write_detections"]

LARGEST_FILE = 1_000_000_000
"""Bytes; larger files would fill the memory before anything could be said about them."""

DEFAULT_THRESHOLD = 0.0
"""A joint with a score up to this is missing, where no threshold is given."""


class Format(NamedTuple):
    """A row of `FORMATS`: `recognises` is None for a format that is read only where it is asked for by name."""

    name: str
    about: str
    recognises: Callable[[Content], bool] | None
    read: Callable[[Content, float], list[Detection]]


_ROWS = (
    Format("poseterior", "this project's JSON, joints by name", native.recognises, native.read),
    Format("openpose", "OpenPose JSON, BODY_25, BODY_25B or COCO-18", openpose.recognises, openpose.read),
    Format("openpose-body25", "OpenPose JSON, BODY_25 for certain", None, openpose.reader(openpose.BODY_25)),
    Format("openpose-body25b", "OpenPose JSON, BODY_25B for certain", None, openpose.reader(openpose.BODY_25B)),
    Format("openpose-coco18", "OpenPose JSON, COCO-18 for certain", None, openpose.reader(openpose.COCO_18)),
    Format("coco-annotations", "COCO keypoint annotations", coco.recognises_annotations, coco.read_annotations),
    Format("coco-results", "COCO keypoint results, a list of records", coco.recognises_results, coco.read_results),
)
FORMATS = {row.name: row for row in _ROWS}
"""By name; the first whose `recognises` says yes is the one that `auto` takes."""


def read_detections(
    path: str | os.PathLike[str], format: str = "auto", threshold: float | None = None
) -> list[Detection]:
    """Every person in a file of 2D joints, in the order of the file.

    `format` is "auto" or a name of `FORMATS`. Joints with score <= `threshold` (0 where it is None) are missing; a
    person of whom nothing is seen stays in the list, so that the numbers of the others do not change. Raises
    `BadInput`, one sentence, for whatever is wrong with the file.
    """
    return read_content(_content(Path(path)), format, threshold)


def read_content(content: Content, format: str = "auto", threshold: float | None = None) -> list[Detection]:
    """`read_detections` of bytes that are in memory already."""
    threshold = DEFAULT_THRESHOLD if threshold is None else threshold
    if not (math.isfinite(threshold) and threshold >= 0):
        raise BadInput(f"the threshold of the scores must be 0 or a positive number, not {threshold}.")
    return _format(content, format).read(content, threshold)


def write_detections(path: str | os.PathLike[str], detections: Sequence[Detection]) -> None:
    """Write this project's JSON; a file that was there is replaced as a whole or, on any failure, not at all.

    Raises `BadInput` where there is nothing to write or the place cannot be written to.
    """
    text = native.write(detections)
    try:
        target = Path(os.path.realpath(path))  # through a link, which would be replaced otherwise
        _replace(target, text)
    except (OSError, ValueError) as error:  # ValueError: a path that no file can have
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{path} cannot be written ({reason}); choose another place.") from None


def _replace(target: Path, text: str) -> None:
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _content(path: Path) -> Content:
    try:
        if not path.exists():
            raise BadInput(f"{path} does not exist; give the path of a file of 2D joints.")
        if not path.is_file():
            raise BadInput(f"{path} is not a file; give the path of a file of 2D joints.")
        if (size := path.stat().st_size) > LARGEST_FILE:
            raise BadInput(f"{path} has {size} bytes, more than {LARGEST_FILE}; split it into smaller files.")
        return Content(path.read_bytes(), str(path))
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}); give the path of a file of 2D joints.") from None


def _format(content: Content, name: str) -> Format:
    if name in FORMATS:
        return FORMATS[name]
    if name != "auto":
        raise BadInput(f"there is no format {name!r}; choose auto or one of {', '.join(FORMATS)}.")
    for row in FORMATS.values():
        if row.recognises is not None and row.recognises(content):
            return row
    known = "; ".join(row.about for row in FORMATS.values() if row.recognises is not None)
    raise BadInput(f"{content.source} is JSON of a shape that is not known here; the known ones are: {known}.")
