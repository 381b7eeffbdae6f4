"""Ultralytics' YOLO-pose: text files of predictions or labels, and the JSON of `Results.to_json()`.

A line of text is `class x y width height`, then x, y and, in most models, a score (of labels: how
visible, 0, 1 or 2) for each of COCO's seventeen points, then perhaps the box's score and a number
of the track; all coordinates are fractions of the image. JSON has pixels, or fractions where it was
asked to normalise, of one image or in a list for each. Some versions put points with a score below
one half at (0, 0) but leave them their score: such points are missing."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import (
    Content,
    cell_number,
    chosen_layout,
    mapping,
    number,
    scored_points,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import COCO_17

_BOX = 5
"""The class and its box, before the points of a line."""
_WIDTHS = {_BOX + width * COCO_17.count + more: width for width in (2, 3) for more in range(3)}
"""How many numbers a line may have, and how many of them each point has."""
_LINE = re.compile(rf"\s*\d+( [-+.\deE]+){{{min(_WIDTHS) - 1},{max(_WIDTHS) - 1}}}\s*")


def recognises_text(content: Content) -> bool:
    """A first line of as many numbers as a person of COCO's points has."""
    if content.arrays.magic:
        return False
    first = content.text.lstrip("\n").split("\n", 1)[0].rstrip()
    return bool(_LINE.fullmatch(first)) and len(first.split()) in _WIDTHS


def recognises_json(content: Content) -> bool:
    """A list of objects whose keypoints are columns x and y."""
    head = content.first
    for _ in range(2):  # of people, or of images that are lists of people
        head = head[0] if isinstance(head, list) and head else head
    return (
        isinstance(content.first, list)
        and isinstance(head, dict)
        and isinstance(head.get("keypoints"), dict)
    )


def read_text(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each line, numbered in the order of the file."""
    lines = [line.split() for line in content.text.splitlines() if line.strip()]
    for person, words in enumerate(lines):
        where = f"line {person + 1} of {content.source}"
        width = _WIDTHS.get(len(words))
        if width is None:
            raise BadInput(
                f"{where} has {len(words)} numbers, but a person of {COCO_17.count} points has"
                f" {', '.join(map(str, sorted(_WIDTHS)))}; give the file of a YOLO-pose model."
            )
        values = [cell_number(word, where) for word in words[_BOX : _BOX + width * COCO_17.count]]
        rows = np.array(values).reshape(COCO_17.count, width)
        score = rows[:, 2] if width == 3 else np.ones(COCO_17.count)
        found = _detection(content, rows[:, :2], score, threshold, person, where)
        yield replace(found, track=_track(words[_BOX + width * COCO_17.count :]))


def read_json(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each object, numbered in the order of the file."""
    for person, (image, value) in enumerate(_records(content)):
        where = f"record {person} of {content.source}"
        columns = mapping(mapping(value, where).get("keypoints"), f"'keypoints' of {where}")
        x, y = (_column(columns.get(name), f"'{name}' of {where}") for name in "xy")
        seen = columns.get("visible")
        score = np.ones(COCO_17.count) if seen is None else _column(seen, f"'visible' of {where}")
        found = _detection(content, np.stack([x, y], axis=-1), score, threshold, person, where)
        yield replace(found, track=track_of(value), image_id=image)


def _records(content: Content) -> Iterator[tuple[str | None, Any]]:
    """Everybody, and the image where there is a list for each."""
    for index, value in enumerate(content.records()):
        several = isinstance(value, list)
        yield from (
            (str(index) if several else None, one) for one in (value if several else [value])
        )


def _track(words: list[str]) -> str | None:
    """What stands behind the points of a line: a box's score, a number of the track, or both."""
    track = words[-1] if len(words) == 2 or (words and words[-1].isdecimal()) else None
    return track_of({"track": track})


def _column(values: object, where: str) -> FloatArray:
    """One number for each point."""
    column = sequence(values, where)
    if len(column) != COCO_17.count:
        raise BadInput(
            f"{where} has {len(column)} numbers where COCO's {COCO_17.count} points are needed;"
            " give the results of a YOLO-pose model of persons."
        )
    return np.array([number(value, f"a number in {where}") for value in column])


def _detection(
    content: Content,
    xy: FloatArray,
    score: FloatArray,
    threshold: float,
    person: int,
    where: str,
) -> Detection:
    """A person from points `(17, 2)` and scores `(17,)`."""
    layout = chosen_layout(COCO_17.count, content, content.source)
    flat = np.column_stack([xy, score]).ravel().tolist()
    points = scored_points(flat, layout.points, where)
    return layout.detection(points, threshold, content.source, person)
