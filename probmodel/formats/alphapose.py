"""AlphaPose's other two files: all images in one object, by name, each with its people in
OpenPose's COCO-18 order.

    its "open" form: {"1.jpg": {"version": …, "people": [{"pose_keypoints_2d": [x, y, score, …]}]}}
    its "cmu" form:  {"1.jpg": {"version": …, "bodies": [{"joints": [x, y, score, …]}]}}

Its usual form is a list of COCO results (`coco`), in COCO-17, Halpe-26 or Halpe-136.
"""

from collections.abc import Iterator
from typing import Any

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import Content, mapping, scored_points, sequence, track_of
from poseterior.probmodel.layouts import COCO_18

KEYS = {"people": "pose_keypoints_2d", "bodies": "joints"}
"""Where an image's people stand, and where a person's points."""


def recognises(content: Content) -> bool:
    """An object whose first value has `people` or `bodies`."""
    document = content.first
    value = next(iter(document.values()), None) if isinstance(document, dict) else None
    return isinstance(value, dict) and any(key in value for key in KEYS)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """The people of all images, in the order of the file."""
    number = 0
    for image, value in mapping(content.json, content.source).items():
        where = f"image {shown(image)} of {content.source}"
        people, key = _people(mapping(value, where), where)
        for record in people:
            person = f"person {number} of {content.source}"
            flat = sequence(mapping(record, person).get(key), f"'{key}' of {person}")
            if len(flat) != 3 * COCO_18.count:
                raise BadInput(
                    f"'{key}' of {person} holds {len(flat)} numbers, but this form of AlphaPose has"
                    f" {3 * COCO_18.count}; have AlphaPose write its default form."
                )
            points = scored_points(flat, COCO_18.points, person)
            track = track_of(record)
            yield COCO_18.detection(points, threshold, content.source, number, image, track=track)
            number += 1


def _people(value: dict[str, Any], where: str) -> tuple[list[Any], str]:
    for key, points in KEYS.items():
        if key in value:
            return sequence(value[key], f"'{key}' of {where}"), points
    raise BadInput(
        f"{where} has neither 'people' nor 'bodies'; give AlphaPose's file of all images."
    )
