"""COCO keypoints: annotation files, and the lists of results that most detectors can write (AlphaPose among them).

Seventeen points, the left side first. Annotations say how visible a point is (0, 1, 2), which becomes a score of 0, 1/2
or 1; results carry a score for each point. Neither has an end of the head, a pelvis or a thorax.
"""

from collections.abc import Iterator
from typing import Any

from probmodel.detections import Detection, FloatArray
from probmodel.failures import BadInput
from probmodel.formats.common import (
    Content,
    Layout,
    at_least_one_joint,
    image_name,
    image_side,
    mapping,
    scored_points,
    sequence,
    shown,
)  # fmt: skip

COCO_17 = Layout(
    "coco_17",
    (
        "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
        "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
        "right_ankle",
    ),
)  # fmt: skip

PERSON = 1
"""COCO's category of persons."""


def recognises_annotations(content: Content) -> bool:
    """An object with `annotations`."""
    return isinstance(content.json, dict) and "annotations" in content.json


def recognises_results(content: Content) -> bool:
    """A list, empty or of objects that name an image."""
    records = content.json
    return isinstance(records, list) and (not records or (isinstance(records[0], dict) and "image_id" in records[0]))


def read_annotations(content: Content, threshold: float) -> list[Detection]:
    """The annotated people that have at least one labelled keypoint, numbered in the order of the file."""
    source = content.source
    document = mapping(content.json, source)
    annotations = sequence(document.get("annotations"), f"'annotations' of {source}")
    persons = _person_categories(document, source)
    sizes = _image_sizes(document, source)
    people: list[Detection] = []
    for where, record in _records(annotations, "annotation", source):
        _check_category(record, persons, where)
        if record.get("keypoints") is None:  # a person who was boxed only
            continue
        points = _points(record, where)
        points[:, 2] = _scores_of_visibility(points[:, 2], where)
        if points[:, 2].any():
            image = image_name(record.get("image_id"), f"image_id of {where}")
            people.append(_detection(points, len(people), image, sizes.get(image), source, threshold))
    if annotations and not people:
        raise BadInput(f"no annotation in {source} has keypoints; give a file of person keypoints, not one of boxes.")
    return at_least_one_joint(people, source, threshold)


def read_results(content: Content, threshold: float) -> list[Detection]:
    """One detection for each record of the list, numbered in the order of the file."""
    source = content.source
    people: list[Detection] = []
    for where, record in _records(sequence(content.json, source), "record", source):
        _check_category(record, {PERSON}, where)
        image = image_name(record.get("image_id"), f"image_id of {where}")
        people.append(_detection(_points(record, where), len(people), image, None, source, threshold))
    return at_least_one_joint(people, source, threshold)


def _records(values: list[Any], kind: str, source: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for index, value in enumerate(values):
        where = f"{kind} {index} of {source}"
        yield where, mapping(value, where)


def _points(record: dict[str, Any], where: str) -> FloatArray:
    if "keypoints" not in record:
        raise BadInput(f"{where} has no 'keypoints'; give a file of keypoints, not one of boxes.")
    flat = sequence(record["keypoints"], f"'keypoints' of {where}")
    if len(flat) != 3 * COCO_17.count:
        raise BadInput(
            f"'keypoints' of {where} holds {len(flat)} numbers, but x, y, score of COCO's {COCO_17.count} points are "
            f"{3 * COCO_17.count}; have the detector write COCO's 17 keypoints."
        )
    return scored_points(flat, COCO_17.points, where)


def _scores_of_visibility(visibility: FloatArray, where: str) -> FloatArray:
    for name, value in zip(COCO_17.points, visibility, strict=True):
        if value not in (0, 1, 2):
            raise BadInput(
                f"the visibility of {name} in {where} is {value:g}, but annotations have 0, 1 or 2; write detections "
                "with scores as a list of COCO results."
            )
    return visibility / 2


def _person_categories(document: dict[str, Any], source: str) -> set[object]:
    """The ids of the categories that are persons; their points must be named in COCO's order where they are named."""
    if document.get("categories") is None:
        return {PERSON}
    persons: set[object] = set()
    for where, category in _records(sequence(document["categories"], f"'categories' of {source}"), "category", source):
        if category.get("name") != "person" or not isinstance(category.get("id"), int):
            continue
        persons.add(category["id"])
        names = category.get("keypoints")
        if names is not None and names != list(COCO_17.points):
            raise BadInput(
                f"'keypoints' of {where} are {shown(names)}, not COCO's 17 points in COCO's order; reorder them "
                f"({COCO_17.points[0]}, {COCO_17.points[1]}, …, {COCO_17.points[-1]})."
            )
    return persons


def _check_category(record: dict[str, Any], persons: set[object], where: str) -> None:
    category = record.get("category_id", PERSON)
    if isinstance(category, bool) or not isinstance(category, int) or category not in persons:
        raise BadInput(f"{where} is of the category {shown(category)}, which is not a person; keep the persons only.")


def _image_sizes(document: dict[str, Any], source: str) -> dict[str | None, tuple[int, int]]:
    sizes: dict[str | None, tuple[int, int]] = {}
    for where, image in _records(sequence(document.get("images", []), f"'images' of {source}"), "image", source):
        if image.get("width") is not None and image.get("height") is not None:
            width, height = (image_side(image[side], f"'{side}' of {where}") for side in ("width", "height"))
            sizes[image_name(image.get("id"), f"'id' of {where}")] = (width, height)
    sizes.pop(None, None)  # an image without an id is nobody's image
    return sizes


def _detection(
    points: FloatArray, person: int, image: str | None, size: tuple[int, int] | None, source: str, threshold: float
) -> Detection:
    keypoints, score = COCO_17.to_skeleton(points, threshold)
    return Detection(keypoints, score, COCO_17.name, source, person, image, size)
