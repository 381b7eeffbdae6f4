"""COCO keypoints: annotation files, and the lists of results that most detectors can write
(AlphaPose among them).

Annotations say how visible each point is (0, 1, 2), which becomes a score of 0, 1/2 or 1. They have
COCO's seventeen points, or those that their category names (as MMPose's files of other data sets
do), where the user's own names come first. Results carry a score for each point (AlphaPose's run to
6 in some models; only their proportions matter), and how many numbers a record has tells which
layout it is, as it does in annotations whose category names no points (Halpe's). OpenPifPaf's lists
leave out the image, and of a film are lines {"frame": 7, "predictions": […]}."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    BY_COUNT,
    Content,
    flat_points,
    image_name,
    image_size,
    mapping,
    named_layout,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import COCO_17, Layout

PERSON = 1
"""COCO's category of persons."""


def recognises_annotations(content: Content) -> bool:
    """An object with `annotations`."""
    return isinstance(content.first, dict) and "annotations" in content.first


def recognises_results(content: Content) -> bool:
    """A list, empty or of objects that name an image or have a flat list of keypoints."""
    records = content.first
    if not isinstance(records, list) or not records:
        return records == []
    head = records[0] if isinstance(records[0], dict) else {}
    head = next(iter(_predicted(head)), head)
    flat = head.get("keypoints")
    return "image_id" in head or (
        isinstance(flat, list) and bool(flat) and isinstance(flat[0], int | float)
    )


def read_annotations(content: Content, threshold: float) -> Iterator[Detection]:
    """The annotated people that have at least one labelled keypoint, numbered in the order of the
    file."""
    source = content.source
    document = mapping(content.json, source)
    annotations = sequence(document.get("annotations"), f"'annotations' of {source}")
    layouts = _person_categories(document, content)
    sizes = _image_sizes(document, source)
    people = 0
    for where, record in _records(annotations, "annotation", source):
        _check_category(record, set(layouts), where)
        if record.get("keypoints") is None:  # a person who was boxed only
            continue
        known = layouts[record.get("category_id", PERSON)]
        points, layout = _points(record, content, where, known)
        points[:, 2] = _scores_of_visibility(points[:, 2], layout, where)
        if points[:, 2].any():
            image = image_name(record.get("image_id"), f"image_id of {where}")
            yield layout.detection(
                points,
                threshold,
                source,
                people,
                image,
                sizes.get(image),
                track=track_of(record),
            )
            people += 1
    if annotations and not people:
        raise BadInput(
            f"no annotation in {source} has keypoints; give a file of person keypoints, not one of"
            " boxes."
        )


def read_results(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each record of the list, numbered in the order of the file."""
    records = (one for value in content.records() for one in _predicted(value))
    for person, (where, record) in enumerate(_records(records, "record", content.source)):
        _check_category(record, {PERSON}, where)
        image = image_name(record.get("image_id"), f"image_id of {where}")
        points, layout = _points(record, content, where)
        yield layout.detection(
            points, threshold, content.source, person, image, track=track_of(record)
        )


def _predicted(value: Any) -> list[Any]:
    """The records of a frame of OpenPifPaf's film; or the one that it is."""
    people = value.get("predictions") if isinstance(value, dict) else None
    if not isinstance(people, list):
        return [value]
    frame = {"image_id": value.get("frame")}
    return [frame | one if isinstance(one, dict) else one for one in people]


def _records(values: Iterable[Any], kind: str, source: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for index, value in enumerate(values):
        where = f"{kind} {index} of {source}"
        yield where, mapping(value, where)


def _points(
    record: dict[str, Any], content: Content, where: str, known: Sequence[Layout] = BY_COUNT
) -> tuple[FloatArray, Layout]:
    if "keypoints" not in record:
        raise BadInput(
            f"{where} has no 'keypoints', but {shown(list(record))}; give a file of keypoints, not"
            " one of boxes."
        )
    return flat_points(record["keypoints"], "keypoints", where, content, known)


def _scores_of_visibility(visibility: FloatArray, layout: Layout, where: str) -> FloatArray:
    for name, value in zip(layout.points, visibility, strict=True):
        if value not in (0, 1, 2):
            raise BadInput(
                f"the visibility of {name} in {where} is {value:g}, but annotations have 0, 1 or 2;"
                " write detections with scores as a list of COCO results."
            )
    return visibility / 2


def _person_categories(
    document: dict[str, Any], content: Content
) -> dict[object, Sequence[Layout]]:
    """The ids of the categories that are persons, and the layouts that each may have."""
    source = content.source
    if document.get("categories") is None:
        return {PERSON: _unnamed(content)}
    layouts: dict[object, Sequence[Layout]] = {}
    for where, category in _records(
        sequence(document["categories"], f"'categories' of {source}"), "category", source
    ):
        if category.get("name") == "person" and isinstance(category.get("id"), int):
            layouts[category["id"]] = _named(category.get("keypoints"), content, where)
    return layouts


def _unnamed(content: Content) -> Sequence[Layout]:
    """The list of names in the file's order that the user gives, or what the count tells."""
    if isinstance(content.names, Mapping) or not content.names:
        return BY_COUNT
    return [named_layout(list(content.names), content)]


def _named(names: object, content: Content, where: str) -> Sequence[Layout]:
    """The points of a category by its names of them."""
    if not names:
        return _unnamed(content)
    if names == list(COCO_17.points) and not content.names and content.layout is None:
        return [COCO_17]
    listed = sequence(names, f"'keypoints' of {where}")
    if not all(isinstance(name, str) for name in listed):
        raise BadInput(f"'keypoints' of {where} are {shown(names)} where names are needed.")
    return [named_layout(listed, content)]


def _check_category(record: dict[str, Any], persons: set[object], where: str) -> None:
    category = record.get("category_id", PERSON)
    if isinstance(category, bool) or not isinstance(category, int) or category not in persons:
        raise BadInput(
            f"{where} is of the category {shown(category)}, which is not a person; keep the persons"
            " only."
        )


def _image_sizes(document: dict[str, Any], source: str) -> dict[str | None, tuple[int, int]]:
    sizes: dict[str | None, tuple[int, int]] = {}
    for where, image in _records(
        sequence(document.get("images", []), f"'images' of {source}"), "image", source
    ):
        if size := image_size(image, where):
            sizes[image_name(image.get("id"), f"'id' of {where}")] = size
    sizes.pop(None, None)  # an image without an id is nobody's image
    return sizes
