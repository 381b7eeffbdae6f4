"""Points that bring their names, as JSON: TensorFlow.js (MoveNet, PoseNet, BlazePose) and Apple's
Vision.

    [{"keypoints": [{"x": …, "y": …, "score": …, "name": "left_eye"}, …]}, …]     TensorFlow.js
    {"left_forearm_joint": {"x": …, "y": …, "confidence": …}, …}                  Vision

TensorFlow.js has pixels, or fractions where it was asked to normalise. Vision has no file of its
own; what people write is an object of its names of joints (their raw values, or leftElbow) for each
person, alone, in a list, or under "joints". Its coordinates are fractions of the image, and its
origin is the lower left corner: y counts upwards."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import (
    Content,
    are_fractions,
    mapping,
    named_layout,
    pixels,
    scored_point,
    sequence,
    track_of,
)

_PARTS = {
    "shoulder_1": "shoulder",
    "forearm": "elbow",
    "hand": "wrist",
    "upLeg": "hip",
    "leg": "knee",
    "foot": "ankle",
    "eye": "eye",
    "ear": "ear",
}
VISION = {"head_joint": "nose", "root": "pelvis"} | {
    f"{side}_{theirs}_joint": f"{side}_{ours}"
    for side in ("left", "right")
    for theirs, ours in _PARTS.items()
}
"""Vision's raw names of joints → ours."""
_CAMEL = {
    f"{side}{part.title()}" for side in ("left", "right") for part in ("shoulder", "hip", "knee")
}
"""Names in Swift that no other detector's points have in an object of objects."""


def recognises_listed(content: Content) -> bool:
    """A list of objects whose keypoints are objects with names."""
    records = content.first
    head = records[0] if isinstance(records, list) and records else None
    points = head.get("keypoints") if isinstance(head, dict) else None
    return (
        isinstance(points, list)
        and bool(points)
        and isinstance(points[0], dict)
        and {"x", "y", "name"} <= set(points[0])
    )


def recognises_vision(content: Content) -> bool:
    """An object of objects with names of Vision's, or a list of such."""
    document = content.first
    head = document[0] if isinstance(document, list) and document else document
    return isinstance(head, dict) and bool((set(VISION) | _CAMEL) & set(_joints(head)))


def read_listed(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each pose, numbered in the order of the file."""
    for person, value in enumerate(content.records()):
        where = f"record {person} of {content.source}"
        listed = sequence(mapping(value, where).get("keypoints"), f"'keypoints' of {where}")
        points = [mapping(point, f"point {i} of {where}") for i, point in enumerate(listed)]
        names = [point.get("name") for point in points]
        if not all(isinstance(name, str) for name in names):
            raise BadInput(f"a point of {where} has no name; keep the names of all points.")
        found = _detection([str(name) for name in names], points, content, threshold, person)
        yield replace(found, track=track_of(value))


def read_vision(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each person, numbered in the order of the file."""
    document = content.json
    people = document if isinstance(document, list) else [document]
    for person, value in enumerate(people):
        where = f"person {person} of {content.source}"
        joints = _joints(mapping(value, where))
        points = [mapping(point, f"{name} of {where}") for name, point in joints.items()]
        known = {name: ours for name, ours in VISION.items() if name in joints}
        if isinstance(content.names, dict):
            known |= content.names
        spoken = replace(content, names=content.names if isinstance(content.names, list) else known)
        yield _detection([*joints], points, spoken, threshold, person, upwards=True)


def _joints(record: dict[str, Any]) -> dict[str, Any]:
    inner = record.get("joints")
    return inner if isinstance(inner, dict) else record


def _detection(
    names: list[str],
    points: list[dict[str, Any]],
    content: Content,
    threshold: float,
    person: int,
    *,
    upwards: bool = False,
) -> Detection:
    where = f"person {person} of {content.source}"
    rows = np.array(
        [_row(point, f"{name} of {where}") for name, point in zip(names, points, strict=True)]
    ).reshape(-1, 3)
    if upwards and not are_fractions(rows[:, :2]):
        raise BadInput(
            f"{where} has coordinates beyond 1; Vision's are fractions of the image, so leave them"
            " as they are."
        )
    if upwards:
        rows[:, 1] = 1 - rows[:, 1]
    size = None
    if upwards or are_fractions(rows[:, :2]):
        rows[:, :2] *= pixels(content)
        size = content.image_size
    layout = named_layout(names, content)
    return layout.detection(rows, threshold, content.source, person, image_size=size)


def _row(point: dict[str, Any], where: str) -> FloatArray:
    score = point.get("score", point.get("confidence", 1.0))
    return scored_point([point.get("x"), point.get("y"), score], where)
