"""People as records of points, each point a row [x, y] or [x, y, score]: what several libraries
return, written as JSON.

    [{"keypoints": [[x, y, score], …], "bbox": …}, …]                   MMPose 0.x
    [[{"keypoints": [[x, y], …], "scores": […], "labels": […]}, …], …]  Hugging Face ViTPose
    {"keypoints": [[[x, y], …], …], "scores": [[…], …]}                 RTMLib
    {"pred_keypoints": [[[x, y, score], …], …]}                         Detectron2's Instances

ViTPose has a list an image. Its labels number the points that it kept, where it was asked to leave
out those of a low score. Coordinates are pixels. How many points there are tells whose they are,
unless the user says it."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    chosen_layout,
    mapping,
    number,
    said_layout,
    scored_point,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import (
    COCO_17,
    HALPE_26,
    HALPE_136,
    MPII_16,
    WHOLEBODY_133,
    Layout,
)

KNOWN = (COCO_17, HALPE_26, HALPE_136, MPII_16, WHOLEBODY_133)
"""Layouts that are told by their number of points."""
_KEYS = ("pred_keypoints", "keypoints")


def recognises(content: Content) -> bool:
    """Records, or one record of all people, whose keypoints are rows."""
    document = content.first
    for _ in range(2):  # a list of people, or a list of images of lists of people
        if isinstance(document, list) and document:
            document = document[0]
    if not isinstance(document, dict):
        return False
    rows = next((document[key] for key in _KEYS if key in document), None)
    return isinstance(rows, list) and bool(rows) and isinstance(rows[0], list)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Every person of every image, in the order of the file."""
    for person, (image, where, rows, scores, labels, track) in enumerate(_people(content)):
        points, layout = _points(rows, scores, labels, content, where)
        yield layout.detection(points, threshold, content.source, person, image, track=track)


Person = tuple[str | None, str, Any, Any, Any, str | None]
"""Image, the person in words, points, scores, labels and track."""


def _people(content: Content) -> Iterator[Person]:
    source = content.source
    if isinstance(content.first, dict):
        yield from _columns(mapping(content.json, source), source)
        return
    for index, value in enumerate(content.records()):
        where = f"record {index} of {source}"
        if isinstance(value, list):
            for place, record in enumerate(value):
                yield _record(record, str(index), f"person {place} of {where}")
        else:
            yield _record(value, None, where)


def _columns(document: dict[str, Any], source: str) -> Iterator[Person]:
    """People of a record that has all of them."""
    key = next((key for key in _KEYS if key in document), _KEYS[0])
    people = sequence(document.get(key), f"'{key}' of {source}")
    # Detectron2's scores are those of boxes; its points bring their own.
    scores = document.get("scores") if key == "keypoints" else None
    if scores is not None and len(sequence(scores, f"'scores' of {source}")) != len(people):
        raise BadInput(
            f"{source} has {len(people)} people but scores of {len(scores)}; check what wrote it."
        )
    each = [None] * len(people) if scores is None else scores
    for index, (rows, row) in enumerate(zip(people, each, strict=True)):
        yield None, f"person {index} of {source}", rows, row, None, None


def _record(value: object, image: str | None, where: str) -> Person:
    record = mapping(value, where)
    points, scores, labels = (record.get(key) for key in ("keypoints", "scores", "labels"))
    return image, where, points, scores, labels, track_of(record)


def _points(
    rows: object, scores: object, labels: object, content: Content, where: str
) -> tuple[FloatArray, Layout]:
    """`(count, 3)` points in the layout's order."""
    listed = sequence(rows, f"'keypoints' of {where}")
    if scores is not None:
        scores = sequence(scores, f"'scores' of {where}")
        if len(scores) != len(listed):
            raise BadInput(
                f"{where} has {len(listed)} keypoints but {len(scores)} scores; check what wrote"
                " it."
            )
    found = np.array(
        [
            _row(row, None if scores is None else scores[index], f"point {index} of {where}")
            for index, row in enumerate(listed)
        ]
    ).reshape(-1, 3)
    if labels is None:
        return found, chosen_layout(len(found), KNOWN, content, f"'keypoints' of {where}")
    places = [_place(label, where) for label in sequence(labels, f"'labels' of {where}")]
    whole = (one for one in KNOWN if places == [*range(one.count)])
    layout = said_layout(content) or next(whole, COCO_17)
    if len(places) != len(found) or len(set(places)) < len(places):
        raise BadInput(
            f"{where} has {len(found)} keypoints, but the labels {shown(places)}; check what wrote"
            " it."
        )
    if max(places, default=0) >= layout.count:
        raise BadInput(
            f"{where} has the label {max(places)}, but {layout.name} {layout.count} points; name"
            " the order of joints (layout; on the command line --layout)."
        )
    points = np.zeros((layout.count, 3))
    points[places] = found
    return points, layout


def _place(label: object, where: str) -> int:
    value = number(label, f"a label of {where}")
    if value < 0 or value != int(value):
        raise BadInput(f"a label of {where} is {shown(label)} where a whole number is needed.")
    return int(value)


def _row(row: object, score: object, where: str) -> FloatArray:
    values = sequence(row, where)
    if len(values) not in (2, 3):
        raise BadInput(f"{where} is {shown(row)} where [x, y] or [x, y, score] is needed.")
    if score is None:
        score = values[2] if len(values) == 3 else 1.0
    # A head that regresses its scores may fall below zero, where nothing was found.
    return scored_point([*values[:2], max(number(score, f"score of {where}"), 0.0)], where)
