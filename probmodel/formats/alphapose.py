"""AlphaPose's files of all images in one object, by name.

    its "open" form: {"1.jpg": {"version": …, "people": [{"pose_keypoints_2d": [x, y, score, …]}]}}
    its "cmu" form:  {"1.jpg": {"version": …, "bodies": [{"joints": [x, y, score, …]}]}}
    PoseFlow's:      {"1.jpg": [{"keypoints": [x, y, score, …], "scores": …, "idx": …}, …]}

The first two are in OpenPose's COCO-18 order; how many points there are tells that of the last.
AlphaPose's usual form is a list of COCO results (`coco`).
"""

from collections.abc import Iterator
from typing import Any

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import Content, flat_points, mapping, sequence, track_of

KEYS = {"people": "pose_keypoints_2d", "bodies": "joints"}
"""Where an image's people stand, and where a person's points."""


def recognises(content: Content) -> bool:
    """An object whose first value has `people` or `bodies`, or lists objects with keypoints."""
    document = content.first
    value = next(filter(None, document.values()), None) if isinstance(document, dict) else None
    if isinstance(value, list):
        return isinstance(value[0], dict) and "keypoints" in value[0]
    return isinstance(value, dict) and any(key in value for key in KEYS)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """The people of all images, in the order of the file."""
    number = 0
    for image, value in mapping(content.json, content.source).items():
        people, key = _people(value, f"image {shown(image)} of {content.source}")
        for record in people:
            person = f"person {number} of {content.source}"
            fields = mapping(record, person)
            points, layout = flat_points(fields.get(key), key, person, content)
            track = track_of(fields)
            yield layout.detection(points, threshold, content.source, number, image, track=track)
            number += 1


def _people(value: object, where: str) -> tuple[list[Any], str]:
    if isinstance(value, list):
        return value, "keypoints"
    image = mapping(value, where)
    for key, points in KEYS.items():
        if key in image:
            return sequence(image[key], f"'{key}' of {where}"), points
    raise BadInput(
        f"{where} has neither 'people' nor 'bodies'; give AlphaPose's file of all images."
    )
