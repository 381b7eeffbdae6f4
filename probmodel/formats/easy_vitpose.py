"""easy_ViTPose: frames of people by their numbers, rows of y, x, score, and the names of points.

{"keypoints": [{"0": [[y, x, score], …], "1": …}, …], "skeleton": {"0": "nose", …}}"""

from collections.abc import Iterator

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    chosen_layout,
    mapping,
    named_layout,
    scored_point,
    sequence,
)
from poseterior.probmodel.layouts import Layout


def recognises(content: Content) -> bool:
    """An object whose keypoints are a list of objects, with a skeleton of names beside it."""
    document = content.first
    if not isinstance(document, dict) or "skeleton" not in document:
        return False
    frames = document.get("keypoints")
    return isinstance(frames, list) and (not frames or isinstance(frames[0], dict))


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Everyone of every frame."""
    source = content.source
    document = mapping(content.json, source)
    person, names = 0, document.get("skeleton")
    for frame, people in enumerate(sequence(document.get("keypoints"), f"'keypoints' of {source}")):
        for track, rows in mapping(people, f"frame {frame} of {source}").items():
            where = f"person {person} of {source}"
            points = np.array(
                [
                    _point(row, f"point {i} of {where}")
                    for i, row in enumerate(sequence(rows, where))
                ]
            ).reshape(-1, 3)
            layout = _layout(names, len(points), content)
            yield layout.detection(points, threshold, source, person, str(frame), track=track)
            person += 1


def _layout(names: object, count: int, content: Content) -> Layout:
    """By the names of all points, or else by their number."""
    table = names if isinstance(names, dict) else {}
    listed = [table.get(str(index)) for index in range(count)]
    if all(isinstance(name, str) for name in listed):
        return named_layout([str(name) for name in listed], content)
    return chosen_layout(count, content, content.source)


def _point(row: object, where: str) -> np.ndarray:
    values = sequence(row, where)
    if len(values) != 3:
        raise BadInput(f"{where} is {shown(row)} where [y, x, score] is needed.")
    return scored_point([values[1], values[0], values[2]], where)
