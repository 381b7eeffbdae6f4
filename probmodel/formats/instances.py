"""People as records of points, each point a row [x, y] or [x, y, score]: what several libraries
return, written as JSON.

    [{"keypoints": [[x, y, score], …], "bbox": …}, …]                   MMPose 0.x
    [[{"keypoints": [[x, y], …], "scores": […], "labels": […]}, …], …]  Hugging Face ViTPose
    {"keypoints": [[[x, y], …], …], "scores": [[…], …]}                 RTMLib
    {"pred_keypoints": [[[x, y, score], …], …]}                         Detectron2's Instances
    {"preds": …} or {"bodyparts": …} likewise                           MMPose 0.x, DeepLabCut 3
    {"image": …, "keypoints": [[x, y], …]}                              one person, as people write
    {"filename": …, "annots": [{"keypoints": [[x, y, score], …]}, …]}   EasyMocap, BODY_25

Those of all people may stand in a list, one an image. ViTPose has a list an image. Its labels
number the points that it kept, where it was asked to leave out those of a low score. EasyMocap says
the size of its image. How many points there are tells whose they are, unless the user says it."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    BY_COUNT,
    Content,
    chosen_layout,
    flat_points,
    image_name,
    image_size,
    mapping,
    number,
    said_layout,
    scored_point,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import BODY_25, COCO_17, Layout

_KEYS = ("pred_keypoints", "keypoints", "preds", "bodyparts")
_IMAGES = ("image_id", "image", "filename", "file_name", "img_name")


def recognises(content: Content) -> bool:
    """Records, or one record of all people, whose keypoints are rows."""
    document = content.first
    for _ in range(2):  # a list of people, or a list of images of lists of people
        if isinstance(document, list) and document:
            document = document[0]
    if not isinstance(document, dict):
        return False
    if isinstance(document.get("annots"), list):
        return True
    return _depth(_rows(document)) >= (1 if document is content.first else 2)


def _rows(record: dict[str, Any]) -> Any:
    return next((record[key] for key in _KEYS if key in record), None)


def _depth(rows: Any) -> int:
    """How many lists stand in one another: 2 of one person's points, 3 of several people's."""
    return 1 + _depth(rows[0]) if isinstance(rows, list) and rows else 0


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Every person of every image, in the order of the file."""
    for person, one in enumerate(_people(content)):
        points, layout = _points(one, content)
        yield layout.detection(
            points, threshold, content.source, person, one.image, one.size, track=one.track
        )


class ListedPerson(NamedTuple):
    """Image, the person in words, points, scores, labels and track, unchecked; and what the file
    says of the image's size, and which layouts it may have."""

    image: str | None
    where: str
    rows: Any
    scores: Any
    labels: Any = None
    track: str | None = None
    size: tuple[int, int] | None = None
    known: tuple[Layout, ...] = BY_COUNT


def _people(content: Content) -> Iterator[ListedPerson]:
    source = content.source
    if isinstance(content.first, dict):
        yield from _document(mapping(content.json, source), source)
        return
    for index, value in enumerate(content.records()):
        where = f"record {index} of {source}"
        if isinstance(value, list):
            for place, record in enumerate(value):
                yield _record(record, str(index), f"person {place} of {where}")
        elif isinstance(value, dict) and "annots" in value:
            yield from _document(value, where)
        elif isinstance(value, dict) and _depth(_rows(value)) == 3:
            people = _columns(value, where)
            yield from (person._replace(image=person.image or str(index)) for person in people)
        else:
            yield _record(value, None, where)


def _document(document: dict[str, Any], source: str) -> Iterator[ListedPerson]:
    """The people of one object: EasyMocap's, of all people, or of one alone."""
    if "annots" in document:
        image, size = _image(document, source), image_size(document, source)
        people = sequence(document["annots"], f"'annots' of {source}")
        for index, value in enumerate(people):
            person = _record(value, image, f"person {index} of {source}")
            yield person._replace(size=size, known=(BODY_25, *BY_COUNT))
    elif "keypoints" in document and _depth(_rows(document)) in (1, 2):
        yield _record(document, None, f"the person of {source}")
    else:
        yield from _columns(document, source)


def _image(record: dict[str, Any], where: str) -> str | None:
    key = next((key for key in _IMAGES if record.get(key) is not None), None)
    return None if key is None else image_name(record[key], f"'{key}' of {where}")


def _columns(document: dict[str, Any], source: str) -> Iterator[ListedPerson]:
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
        image = _image(document, source)
        yield ListedPerson(image, f"person {index} of {source}", rows, row)


def _record(value: object, image: str | None, where: str) -> ListedPerson:
    record = mapping(value, where)
    image = image if image is not None else _image(record, where)
    rows, scores, labels = (record.get(key) for key in ("keypoints", "scores", "labels"))
    return ListedPerson(image, where, rows, scores, labels, track_of(record))


def _points(person: ListedPerson, content: Content) -> tuple[FloatArray, Layout]:
    """`(count, 3)` points in the layout's order."""
    where, scores, labels = person.where, person.scores, person.labels
    listed = sequence(person.rows, f"'keypoints' of {where}")
    if _depth(listed) == 1:
        return flat_points(listed, "keypoints", where, content, person.known)
    if isinstance(scores, list) and len(scores) != len(listed):
        raise BadInput(
            f"{where} has {len(listed)} keypoints but {len(scores)} scores; check what wrote it."
        )
    found = np.array(
        [
            _row(
                row,
                scores[index] if isinstance(scores, list) else None,
                f"point {index} of {where}",
            )
            for index, row in enumerate(listed)
        ]
    ).reshape(-1, 3)
    if labels is None:
        layout = chosen_layout(len(found), content, f"'keypoints' of {where}", person.known)
        return found, layout
    places = [_place(label, where) for label in sequence(labels, f"'labels' of {where}")]
    whole = (one for one in person.known if places == [*range(one.count)])
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
