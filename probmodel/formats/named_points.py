"""Points that bring their names, as JSON: TensorFlow.js (MoveNet, PoseNet, BlazePose), ML Kit,
Apple's Vision, and objects of names.

    [{"keypoints": [{"x": …, "y": …, "score": …, "name": "left_eye"}, …]}, …]     TensorFlow.js
    {"score": …, "keypoints": [{"part": "leftEye", "position": {"x": …, "y": …}, "score": …}, …]}
    [{"landmarks": [{"type": "NOSE", "position": {…}, "inFrameLikelihood": …}, …]}, …]     ML Kit
    {"left_forearm_joint": {"x": …, "y": …, "confidence": …}, …}                  Vision
    {"left_wrist": [x, y], "nose": [x, y, score], …}                              anybody's

A list may be of people, or of frames that are lists of people or objects with `poses`.
TensorFlow.js has pixels, or fractions where it was asked to normalise. Vision has no file of its
own; what people write is an object of its names of joints (their raw values, or leftElbow) for each
person, alone, in a list, or under "joints". Its coordinates are fractions of the image, and its
origin is the lower left corner: y counts upwards."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from poseterior.probmodel.detections import FACE, Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    mapping,
    named_layout,
    scored_point,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import is_nowhere, spoken_name
from poseterior.probmodel.skeleton import JOINTS

FEWEST = 3
"""Joints that an object must name to be taken for a person; a camera needs as many."""
_PEOPLE = ("poses", "people", "predictions", "pose", "frames")
"""Where the people of a frame stand, or one person."""
_LISTS = ("keypoints", "landmarks", "points", "joints")
"""Where a person's points stand."""
_NAMES = ("name", "part", "type", "class", "label")
_PLACES = ("position", "point")
_SCORES = ("score", "confidence", "inFrameLikelihood", "likelihood", "visibility")
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


class NamedPose(NamedTuple):
    """A person's points, unchecked, and image and track, if the file says them."""

    points: Any
    image: str | None
    track: str | None = None


def recognises_listed(content: Content) -> bool:
    """Points with a place and a name, in a list of one person, in a list of people, or alone."""
    pose = next(_poses(content.first, None), None)
    points = [] if pose is None else pose.points
    head = points[0] if isinstance(points, list) and points else None
    return (
        isinstance(head, dict)
        and "visibility" not in head  # MediaPipe's, who orders them
        and _name(head) is not None
        and {"x", "y"} <= set(_place(head))
    )


def read_listed(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each pose, numbered in the order of the file."""
    document = content.records() if isinstance(content.first, list) else content.json
    for person, pose in enumerate(_poses(document, None)):
        where = f"record {person} of {content.source}"
        listed = sequence(pose.points, f"the points of {where}")
        points = [mapping(point, f"point {i} of {where}") for i, point in enumerate(listed)]
        names = [_name(point) for point in points]
        if None in names:
            raise BadInput(f"a point of {where} has no name; keep the names of all points.")
        yield _detection([str(name) for name in names], points, content, threshold, person, pose)


def _poses(value: object, image: str | None, depth: int = 0) -> Iterator[NamedPose]:
    """The poses in a document, in its order."""
    if isinstance(value, dict):
        key = next((key for key in _LISTS if key in value), None)
        inner = next((key for key in _PEOPLE if isinstance(value.get(key), list | dict)), None)
        if key is not None or inner is None:
            yield NamedPose(None if key is None else value[key], image, track_of(value))
        elif depth < 4:
            yield from _poses(value[inner], image, depth + 1)
    elif isinstance(value, list | Iterator) and depth < 4:
        for index, inner in enumerate(value):
            frame = isinstance(inner, list) or (
                isinstance(inner, dict) and set(_PEOPLE) & set(inner)
            )
            yield from _poses(inner, str(index) if frame else image, depth + 1)
    else:
        yield NamedPose(value, image)


def _name(point: dict[str, Any]) -> str | None:
    return next((point[key] for key in _NAMES if isinstance(point.get(key), str)), None)


def _place(point: dict[str, Any]) -> dict[str, Any]:
    return next((point[key] for key in _PLACES if isinstance(point.get(key), dict)), point)


def recognises_vision(content: Content) -> bool:
    """An object of objects with names of Vision's, or a list of such."""
    document = content.first
    head = document[0] if isinstance(document, list) and document else document
    joints = _joints(head) if isinstance(head, dict) else {}
    named = (set(VISION) | _CAMEL) & set(joints)
    return bool(named) and all(isinstance(joints[name], dict) for name in named)


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


def recognises_named(content: Content) -> bool:
    """An object of joints' names, a list of such, or an object of them by image."""
    head = content.first
    for _ in range(2):
        if isinstance(head, list) and head:
            head = head[0]
        elif isinstance(head, dict) and not _is_named(head, content):
            head = next(iter(head.values()), None)
    return isinstance(head, dict) and _is_named(head, content)


def read_named(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each object of names, numbered in the order of the file."""
    for person, (image, record) in enumerate(_named(content)):
        where = f"person {person} of {content.source}"
        points = [_named_point(value, f"{name} of {where}") for name, value in record.items()]
        yield _detection([*record], points, content, threshold, person, NamedPose(None, image))


def _is_named(record: dict[str, Any], content: Content) -> bool:
    names = content.names if isinstance(content.names, dict) else {}
    known = {names.get(name, spoken_name(name)) for name in record} & {*JOINTS, *FACE}
    return len(known) >= FEWEST and all(isinstance(one, list | dict) for one in record.values())


def _named(content: Content) -> Iterator[tuple[str | None, dict[str, Any]]]:
    """The objects of names, and their images."""
    listed = isinstance(content.first, list)
    document = enumerate(content.records()) if listed else [(None, content.json)]
    for index, value in document:
        record = mapping(value, content.source if index is None else f"record {index}")
        if _is_named(record, content):
            yield None if index is None else str(index), record
            continue
        for image, inner in record.items():
            people = inner if isinstance(inner, list) else [inner]
            for person in people:
                yield image, mapping(person, f"{shown(image)} of {content.source}")


def _named_point(value: object, where: str) -> dict[str, Any]:
    if isinstance(value, dict):
        return value
    row = sequence(value, where)
    if len(row) not in (2, 3):
        raise BadInput(f"{where} is {shown(value)} where [x, y] or [x, y, score] is needed.")
    return dict(zip(("x", "y", "score"), row, strict=False))


def _joints(record: dict[str, Any]) -> dict[str, Any]:
    inner = record.get("joints")
    return inner if isinstance(inner, dict) else record


def _detection(
    names: list[str],
    points: list[dict[str, Any]],
    content: Content,
    threshold: float,
    person: int,
    pose: NamedPose | None = None,
    *,
    upwards: bool = False,
) -> Detection:
    where = f"person {person} of {content.source}"
    rows = np.array(
        [_row(point, f"{name} of {where}") for name, point in zip(names, points, strict=True)]
    ).reshape(-1, 3)
    if upwards:
        found = ~is_nowhere(rows[:, :2])
        rows[found, 1] = 1 - rows[found, 1]
    image, track = (None, None) if pose is None else (pose.image, pose.track)
    layout = named_layout(names, content)
    return layout.detection(rows, threshold, content.source, person, image, track=track)


def _row(point: dict[str, Any], where: str) -> FloatArray:
    place = _place(point)
    score = next((point[key] for key in _SCORES if key in point), 1.0)
    return scored_point([place.get("x"), place.get("y"), score], where)
