"""What all readers share: the content of a file, and checked access to JSON values.

A reader takes a `Content` and a threshold and yields `Detection`s one by one; whatever it does not
like it refuses with `BadInput`, one sentence that names the file, the place and the remedy."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from poseterior.probmodel.arrays import ArrayFile
from poseterior.probmodel.detections import FACE, LARGEST_NUMBER, Detection, FloatArray, is_label
from poseterior.probmodel.documents import decoded, json_failures, parsed, require_modest
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.units import Unit
from poseterior.probmodel.layouts import (
    COCO_17,
    COCO_18,
    HALPE_26,
    HALPE_136,
    LAYOUTS,
    MEDIAPIPE_33,
    MPII_16,
    WHOLEBODY_133,
    Layout,
    layout_of_names,
    spoken_name,
)
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS

LARGEST_LABEL = 10**100
"""Beyond every number of an image or a person: times in nanoseconds have nineteen digits."""
_SPACE = re.compile(r"[ \t\n\r]*")


@dataclass(frozen=True)
class Content:
    """The bytes of one file; `source` names it in messages.

    What the file does not say, the user may: `image_size` (width, height) in pixels, for
    coordinates that are fractions of it; `names`, their names of joints → ours (or, in the order of
    the file, a list); `layout`, the order of joints, a name of `layouts.LAYOUTS`; and what the
    folder says of its files, their `unit`."""

    data: bytes
    source: str
    image_size: tuple[int, int] | None = None
    names: Mapping[str, str] | Sequence[str] = field(default_factory=dict)
    layout: str | None = None
    unit: Unit | None = None

    @cached_property
    def arrays(self) -> ArrayFile:
        """The same bytes as a file of arrays, whether it is one or not."""
        return ArrayFile(io.BytesIO(self.data), self.source)

    @cached_property
    def text(self) -> str:
        """The text. Raises `BadInput` where it is not UTF-8."""
        return decoded(self.data, self.source, ", nor HDF5 or NumPy's; give a file of 2D joints.")

    @cached_property
    def _document(self) -> str:
        """The text of a document whose objects fit into memory."""
        require_modest(self.text, self.source)
        return self.text

    @cached_property
    def json(self) -> Any:
        """The document, parsed once; of JSON lines, a list of them. Raises `BadInput` where it is
        not UTF-8, not JSON, nested too deeply, or would fill the memory."""
        return [*self.records()] if self._of_lines else parsed(self.text, self.source)

    @cached_property
    def _of_lines(self) -> bool:
        """Whether it is JSON lines: an object a line, which stand for an array of them."""
        first, _, rest = self._document.lstrip().partition("\n")
        whole = first.startswith("{") and first.rstrip().endswith("}")
        return whole and rest.lstrip().startswith("{")

    @cached_property
    def first(self) -> Any:
        """The document or, where it is an array, its first element alone in a list: enough to
        recognise a format.

        None for a file of arrays, and for a text that begins neither an object nor an array.
        """
        if self.arrays.magic:
            return None
        text = self._document
        start = _skip(text, 0)
        if self._of_lines:
            return [next(self.records())]
        if text[start : start + 1] == "{":
            return self.json
        if text[start : start + 1] != "[":
            return None
        with json_failures(self.source):
            start = _skip(text, start + 1)
            return (
                []
                if text[start : start + 1] == "]"
                else [json.JSONDecoder().raw_decode(text, start)[0]]
            )

    def records(self) -> Iterator[Any]:
        """The elements of a document that is an array, parsed one by one, so that a long file need
        not be in memory as objects. Raises `BadInput` as `json` does, at the element where that is
        found out."""
        if self._of_lines:
            for number, line in enumerate(self._document.split("\n"), 1):
                if line.strip():
                    yield parsed(line, f"line {number} of {self.source}")
            return
        if not isinstance(self.first, list):
            raise BadInput(f"{self.source} is {shown(self.first)} where a JSON array is needed.")
        text, decoder = self._document, json.JSONDecoder()
        place = _skip(text, _skip(text, 0) + 1)
        if text[place : place + 1] == "]":
            self._require_end(text, place + 1)
            return
        while True:
            with json_failures(self.source):
                value, place = decoder.raw_decode(text, place)
            yield value
            place = _skip(text, place)
            if text[place : place + 1] == "]":
                return self._require_end(text, place + 1)
            with json_failures(self.source):
                if text[place : place + 1] != ",":
                    raise json.JSONDecodeError("Expecting ',' delimiter", text, place)
            place = _skip(text, place + 1)

    def _require_end(self, text: str, place: int) -> None:
        with json_failures(self.source):
            if _skip(text, place) != len(text):
                raise json.JSONDecodeError("Extra data", text, place)


def _skip(text: str, place: int) -> int:
    """The place of the next character that is no white space."""
    space = _SPACE.match(text, place)
    return space.end() if space else place


MOST_CELLS = 30_000_000
"""Cells of a table: five hours of video at 30 frames a second, of eighteen points each."""


SEPARATORS = (",", ";", "\t")
"""Of the cells of a table; where it is no comma, that may stand before decimals."""
LONGEST_HEADER = 100_000
"""Bytes of a first line that are looked at to recognise a table."""
_DECIMAL = re.compile(r"\s*[-+]?\d*,\d*(?:[eE][-+]?\d+)?\s*")


def table_header(content: Content) -> list[str]:
    """The cells of the first line of what may be a table; none of a file of arrays."""
    if content.arrays.magic:
        return []
    line = content.data[:LONGEST_HEADER].decode("utf-8-sig", "replace").lstrip().split("\n", 1)[0]
    return [cell.strip().strip('"') for cell in line.split(_separator(line))]


def _separator(line: str) -> str:
    return max(SEPARATORS, key=line.count)


def table_rows(content: Content) -> Iterator[list[str]]:
    """The rows of a table that are not empty, one by one, decimal commas as points. Raises
    `BadInput` where it is no table, or has more cells than can be."""
    separator = _separator(content.text.lstrip().split("\n", 1)[0])
    if content.text.count(separator) + content.text.count("\n") > MOST_CELLS:
        raise BadInput(
            f"{content.source} has more than {MOST_CELLS:,} cells; split it into smaller files."
        )
    rows = csv.reader(io.StringIO(content.text, newline=""), delimiter=separator)
    try:
        for row in filter(None, rows):
            yield row if separator == "," else [_with_point(cell) for cell in row]
    except csv.Error as error:
        raise BadInput(f"{content.source} is no table ({error}); check what wrote it.") from None


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL.fullmatch(cell) else cell


def table_number(cell: str, where: str) -> float:
    """The number in a cell, NaN where it is empty. Raises `BadInput` where it is something else."""
    if not cell.strip():
        return np.nan
    with suppress(ValueError):
        return float(cell)
    raise BadInput(f"{where} holds {shown(cell)} where a number is needed.")


def cell_number(cell: str, where: str) -> float:
    """The number in a cell, which must not be empty. Raises `BadInput` as `number` does."""
    return number(table_number(cell, where), f"a number in {where}")


def skeleton_arrays(rows: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """`(15, 2)` keypoints and `(15,)` scores from (x, y, score) of the joints that are seen, by
    name."""
    keypoints, score = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    for name, row in rows.items():
        keypoints[JOINT_INDEX[name]], score[JOINT_INDEX[name]] = row[:2], row[2]
    return keypoints, score


def at_least_one_joint(
    detections: list[Detection], source: str, threshold: float
) -> list[Detection]:
    """`detections`, unless there is none or nothing is seen in any of them: then `BadInput`."""
    if not detections:
        raise BadInput(
            f"{source} has no person in it; choose a frame in which the detector found one."
        )
    if not any(detection.seen.any() for detection in detections):
        raise BadInput(
            f"no joint of any person in {source} has a score above the threshold {threshold:g};"
            f" {'lower the threshold or ' if threshold else ''}choose another frame."
        )
    return detections


def number(value: object, where: str) -> float:
    """A finite number within ±`LARGEST_NUMBER`; true and false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadInput(f"{where} is {shown(value)} where a number is needed.")
    if not (abs(value) <= LARGEST_NUMBER):  # compares huge integers without overflow; false for NaN
        said = (
            "not finite"
            if isinstance(value, float) and not math.isfinite(value)
            else f"beyond ±{LARGEST_NUMBER:g}"
        )
        raise BadInput(
            f"{where} is {shown(value)}, which is {said}; give a finite number of pixels or score."
        )
    return float(value)


def scored_point(values: Sequence[object], where: str) -> FloatArray:
    """`(3,)`: x, y (pixels) and a score that is not negative."""
    x, y, score = (
        number(value, f"{part} of {where}")
        for part, value in zip(("x", "y", "score"), values, strict=True)
    )
    if score < 0:
        raise BadInput(
            f"score of {where} is {score:g}, which is negative; give 0 for a joint that was not"
            " detected."
        )
    return np.array([x, y, score])


def scored_points(values: object, names: Sequence[str], where: str) -> FloatArray:
    """`(len(names), 3)` from a flat list of x, y, score whose length is known to fit; a point of
    three NaN is missing."""
    flat = sequence(values, where)
    if set(map(type, flat)) <= {int, float}:
        with suppress(OverflowError):  # a whole number too large for a float
            points = np.array(flat, dtype=float).reshape(-1, 3)
            points[np.isnan(points).all(axis=1)] = 0.0  # how Pose2Sim says that it has none
            if (np.abs(points) <= LARGEST_NUMBER).all() and (points[:, 2] >= 0).all():
                return points
    # Something is wrong: one by one, to name it.
    return np.array(
        [
            scored_point(flat[3 * i : 3 * i + 3], f"{name} in {where}")
            for i, name in enumerate(names)
        ]
    )


def mapping(value: object, where: str) -> dict[str, Any]:
    """A JSON object."""
    if not isinstance(value, dict):
        raise BadInput(f"{where} is {shown(value)} where a JSON object is needed.")
    return value


def sequence(value: object, where: str) -> list[Any]:
    """A JSON array."""
    if not isinstance(value, list):
        raise BadInput(f"{where} is {shown(value)} where a JSON array is needed.")
    return value


def image_name(value: object, where: str) -> str | None:
    """An image's id as text; files number their images or name them."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < LARGEST_LABEL:
        return str(value)
    raise BadInput(f"{where} is {shown(value)} where a whole number or a name is needed.")


FRAME_NAMES = (
    *("frame", "frame_id", "frame_idx", "frame_index", "frame_number", "frame_num", "frameno"),
    *("fnum", "image", "image_id", "image_name", "img_name", "file", "filename", "file_name"),
)
"""What people and detectors call the number or the name of a frame, the likelier first."""
TRACKS = ("track", "track_id", "person_id", "personID", "instance_id", "idx", "pid")
"""What detectors and trackers call the number by which they follow a person through a film."""


def track_of(record: Mapping[str, Any]) -> str | None:
    """Whom a record says that it is of; None where it says nothing, or that nobody was followed
    (numbers below zero)."""
    return next(filter(None, (_track(record.get(key)) for key in TRACKS)), None)


def _track(value: object) -> str | None:
    """A number, also as a text, a float or in a list of its own, as AlphaPose and OpenPose write
    it; or a name."""
    while isinstance(value, list) and len(value) == 1:
        (value,) = value
    if isinstance(value, str):
        text = value.strip()
        with suppress(ValueError):
            return _track(int(text) if text.isdecimal() else float(text))
        return text if text and is_label(text) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    if isinstance(value, float) and not value.is_integer():
        return None
    return str(int(value)) if 0 <= value < LARGEST_LABEL else None


def image_side(value: object, where: str) -> int:
    """The width or the height of an image in pixels."""
    side = number(value, where)
    if side <= 0 or side != int(side):
        raise BadInput(
            f"{where} is {shown(value)} where a positive whole number of pixels is needed."
        )
    return int(side)


def image_size(
    record: Mapping[str, Any], where: str, sides: tuple[str, str] = ("width", "height")
) -> tuple[int, int] | None:
    """Width and height of the image of a record, where it has both of its `sides`."""
    if any(record.get(side) is None for side in sides):
        return None
    width, height = (image_side(record[side], f"'{side}' of {where}") for side in sides)
    return width, height


def said_layout(content: Content) -> Layout | None:
    """The layout that the user names. Raises `BadInput` where there is no such one."""
    if content.layout is None:
        return None
    if content.layout not in LAYOUTS:
        raise BadInput(
            f"there is no layout {shown(content.layout)}; choose one of {', '.join(LAYOUTS)}."
        )
    return LAYOUTS[content.layout]


BY_COUNT = (
    COCO_17,
    COCO_18,
    HALPE_26,
    HALPE_136,
    MPII_16,
    MEDIAPIPE_33,
    WHOLEBODY_133,
)
"""Layouts that are told by their number of points; 17 are COCO's, which the models of 2D joints
have."""


def chosen_layout(
    count: int, content: Content, where: str, known: Iterable[Layout] = BY_COUNT
) -> Layout:
    """The layout that the user names, or the one among `known` of so many points. Raises `BadInput`
    where there is none, or it has another number of them."""
    known = tuple(known)
    said = said_layout(content) or (known[0] if len(known) == 1 else None)
    layout = said or next((one for one in known if one.count == count), None)
    if layout is not None and layout.count == count:
        return layout
    other = f", but {said.name} has {said.count}" if said else ""
    fitting = ", ".join(one.name for one in LAYOUTS.values() if one.count == count)
    advice = f"name their order (layout; on the command line --layout), such as {fitting}"
    raise BadInput(
        f"{where} holds {count} points of a person{other};"
        f" {advice if fitting else 'no order known here has so many'}."
    )


def flat_points(
    values: object, key: str, where: str, content: Content, known: Iterable[Layout] = BY_COUNT
) -> tuple[FloatArray, Layout]:
    """`(count, 3)` points, and their layout, from a flat list of x, y, score that stands at `key`.
    Raises `BadInput` where it is none, or as `chosen_layout` does."""
    flat = sequence(values, f"'{key}' of {where}")
    if len(flat) % 3 or not flat:
        raise BadInput(
            f"'{key}' of {where} holds {len(flat)} numbers, where x, y and score of each point are"
            " needed; write all three."
        )
    layout = chosen_layout(len(flat) // 3, content, f"'{key}' of {where}", known)
    return scored_points(flat, layout.points, where), layout


def named_layout(parts: list[str], content: Content) -> Layout:
    """The layout of points that a file names freely: in the order that the user names, by the
    user's names for them, or by their own. Raises `BadInput` where two are the same joint, or none
    is any, or the user's order contradicts them."""
    names = content.names
    if content.layout is not None:
        return _ordered(parts, content)
    if isinstance(names, Mapping):
        layout = layout_of_names(parts, dict(names))
    elif len(names) == len(parts):
        layout = layout_of_names(list(names))
    else:
        raise BadInput(
            f"the list of names has {len(names)}, but {content.source} has {len(parts)} body parts."
        )
    doubled = sorted({name for name in layout.points if layout.points.count(name) > 1})
    if doubled:
        raise BadInput(
            f"{content.source} has several body parts that are {doubled[0]}; give a map of names"
            " (names; on the command line --names)."
        )
    if not set(layout.points) & set(JOINTS):
        known = ", ".join((*JOINTS, *FACE))
        raise BadInput(
            f"none of the body parts of {content.source} ({shown(parts)}) is a joint known here;"
            f" give a map of names (names; on the command line --names names.json) to {known}."
        )
    return layout


def _ordered(parts: list[str], content: Content) -> Layout:
    """The user's layout for points that have names too."""
    layout = chosen_layout(len(parts), content, content.source)
    for part, point in zip(parts, layout.points, strict=True):
        if spoken_name(part) in (*JOINTS, *FACE) and spoken_name(part) != point:
            raise BadInput(
                f"{content.source} names a point {shown(part)} where {layout.name} has {point};"
                " leave out layout (on the command line --layout)."
            )
    return layout
