"""OpenPose's JSON, and what others write in its envelope: each person a flat list of x, y, score; a
point that was not found is 0, 0, 0.

    {"people": [{"pose_keypoints_2d": [x, y, score, …]}, …]}      a frame, also a list of frames
    {"bodies": [{"joints": [x, y, score, …]}, …]}                 its predecessor, caffe_rtpose
    {"people": …, "canvas_width": …, "canvas_height": …}          ControlNet's and ComfyUI's
    {"people": [{"pose_keypoints_2d": [[y, x, y, x, …]]}]}        PoseNet's, y first, no scores

The file does not say which model wrote it. How many points there are tells it: eighteen are
COCO-18, seventeen and twenty-six (Pose2Sim's and Sports2D's) COCO-17 and Halpe-26. Twenty-five are
BODY_25, the usual model, or BODY_25B, whose order differs: `body_order` tells them apart by the
lengths of the bones, and refuses where it cannot. Coordinates are pixels, fractions of the image,
or, where OpenPose was told so, −1 to 1. Somebody of NaN alone, as Pose2Sim writes who was not
found, has no joints."""

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import (
    BY_COUNT,
    Content,
    flat_points,
    image_size,
    mapping,
    said_layout,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import BODY_25, BODY_25B, Layout, is_nowhere

LISTS = ("people", "bodies")
"""Where a frame's people stand."""
KEYS = ("pose_keypoints_2d", "pose_keypoints", "joints")
"""Where a person's points stand; the second is OpenPose 1.0's, the third that of `bodies`."""
CANVAS = ("canvas_width", "canvas_height")

_SIDED = (
    ("nose", "*_eye", 4.5),
    ("*_eye", "*_ear", 9),
    ("*_shoulder", "*_elbow", 28),
    ("*_elbow", "*_wrist", 25),
    ("*_hip", "*_knee", 42),
    ("*_knee", "*_ankle", 42),
    ("*_shoulder", "*_hip", 50),
    ("*_ankle", "*_heel", 8),
    ("*_ankle", "*_big_toe", 17),
    ("*_big_toe", "*_small_toe", 8),
    ("thorax", "*_shoulder", 17),
    ("pelvis", "*_hip", 11),
    ("upper_neck", "*_shoulder", 20),
)
_MIDDLE = (
    ("left_shoulder", "right_shoulder", 34.0),
    ("left_hip", "right_hip", 22.0),
    ("thorax", "nose", 25.0),
    ("upper_neck", "head", 26.0),
    ("upper_neck", "nose", 15.0),
    ("head", "nose", 18.0),
)
BONES_CM = _MIDDLE + tuple(
    (a.replace("*", side), b.replace("*", side), float(cm))
    for a, b, cm in _SIDED
    for side in ("left", "right")
)
"""Pairs of points and their usual distance on an adult; it only has to be right enough to tell two
orders apart."""

MIN_BONES, MIN_EVIDENCE = 8, 0.3
"""A person with fewer bones does not count; evidence below this is no evidence.

Chosen on 9600 motion-capture poses seen from random sides, half in either order, with points
dropped at random: none was read in the wrong order, and 3 of 100 with enough bones were left open.
The people of real files have 1.3 and more. """


class BodyPoints(NamedTuple):
    """A person's numbers, unchecked; their key; words that name the person; image, its size, and
    the person's track, if known."""

    flat: list[Any]
    key: str
    where: str
    image: str | None
    size: tuple[int, int] | None
    track: str | None


def recognises(content: Content) -> bool:
    """An object with `people` or `bodies` and no `format` of another's, or a list of such."""
    head = content.first
    head = head[0] if isinstance(head, list) and head else head
    return isinstance(head, dict) and "format" not in head and any(key in head for key in LISTS)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Every person; the layout follows from the number of points and, for 25, from `body_order`."""
    if said_layout(content) is not None:
        return _detections(content, threshold, ())
    people = bodies(content)
    body = body_order(people, content.source) if people else BODY_25
    return _detections(content, threshold, (body, *BY_COUNT))


def reader(layout: Layout) -> Callable[[Content, float], Iterator[Detection]]:
    """`read` for a file that is known to be in `layout`."""
    return lambda content, threshold: _detections(content, threshold, (layout,))


def body_order(people: list[FloatArray], source: str) -> Layout:
    """`BODY_25` or `BODY_25B`, whichever makes the people in `(25, 3)` points look more human.

    In the right order, all bones have about their usual length up to one scale; in the wrong one,
    some cross the whole body and others vanish. The evidence of a person is the logarithm of the
    ratio of the two coefficients of variation of length over usual length. Raises `BadInput` where
    it does not suffice."""
    evidence = order_evidence(people)
    if abs(evidence) < MIN_EVIDENCE:
        raise BadInput(
            f"{source} has 25 points a person, but too few are seen to tell BODY_25 from BODY_25B;"
            " choose the format openpose-body25 or openpose-body25b."
        )
    return BODY_25 if evidence > 0 else BODY_25B


def order_evidence(people: list[FloatArray]) -> float:
    """Positive for BODY_25, negative for BODY_25B: the sum over people in `(25, 3)` points."""
    return sum(_evidence(points) for points in people)


def bodies(content: Content) -> list[FloatArray]:
    """The people of 25 points of whom something is seen, `(25, 3)` each."""
    flat = [body for body in _bodies(content) if len(body.flat) == 3 * BODY_25.count]
    people = [flat_points(body.flat, body.key, body.where, content, (BODY_25,))[0] for body in flat]
    return [points for points in people if points[:, 2].any()]


def _evidence(points: FloatArray) -> float:
    """Positive for BODY_25, negative for BODY_25B, 0 where there is too little to go by."""
    ratios = [_relative_lengths(points, layout) for layout in (BODY_25, BODY_25B)]
    if any(len(ratio) < MIN_BONES or ratio.max() == 0 for ratio in ratios):
        return 0.0
    spreads = [max(ratio.std() / ratio.mean(), 1e-3) for ratio in ratios]
    return math.log(spreads[1] / spreads[0])


def _relative_lengths(points: FloatArray, layout: Layout) -> FloatArray:
    """Length in pixels over usual length, of every bone whose two ends are seen."""
    seen = (points[:, 2] > 0) & ~is_nowhere(points[:, :2])
    index = {name: i for i, name in enumerate(layout.points) if seen[i]}
    bones = [(index[a], index[b], cm) for a, b, cm in BONES_CM if a in index and b in index]
    return np.array([np.linalg.norm(points[a, :2] - points[b, :2]) / cm for a, b, cm in bones])


def _bodies(content: Content) -> Iterator[BodyPoints]:
    """Everyone in the file, frame after frame."""
    source, person = content.source, 0
    listed = isinstance(content.first, list)
    for frame, value in enumerate(content.records() if listed else [content.json]):
        document = mapping(value, f"frame {frame} of {source}" if listed else source)
        people = next((key for key in LISTS if key in document), LISTS[0])
        for record in sequence(document.get(people), f"'{people}' of {source}"):
            where = f"person {person} of {source}"
            fields = mapping(record, where)
            flat, key = _flat_list(fields, where)
            image, size = str(frame) if listed else None, image_size(document, source, CANVAS)
            yield BodyPoints(flat, key, where, image, size, track_of(fields))
            person += 1


def _flat_list(person: dict[str, Any], where: str) -> tuple[list[Any], str]:
    key = next((key for key in KEYS if key in person), None)
    if key is None:
        raise BadInput(
            f"{where} has neither '{KEYS[0]}' nor '{KEYS[1]}'; give OpenPose's JSON of the body."
        )
    flat = sequence(person[key], f"'{key}' of {where}")
    if len(flat) == 1 and isinstance(flat[0], list) and len(flat[0]) % 2 == 0:
        pairs = zip(flat[0][1::2], flat[0][::2], strict=True)
        return [number for x, y in pairs for number in (x, y, 1.0)], key
    return flat, key


def _detections(
    content: Content, threshold: float, known: tuple[Layout, ...]
) -> Iterator[Detection]:
    for person, body in enumerate(_bodies(content)):
        points, layout = flat_points(body.flat, body.key, body.where, content, known)
        yield layout.detection(
            points,
            threshold,
            content.source,
            person,
            body.image,
            body.size,
            track=body.track,
        )
