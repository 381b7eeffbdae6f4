"""Detections that are in memory: arrays of points, and the `Results` of Ultralytics' YOLO-pose.

    people = detections_of(array, layout="coco_17")
    people = detections_of(YOLO("yolo11n-pose.pt")("photo.jpg"))

What has the shape of these results is taken for them, whoever made it: their package is not asked
for."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, chosen_layout
from poseterior.probmodel.formats.hourglass import scored
from poseterior.probmodel.formats.units import in_pixels
from poseterior.probmodel.layouts import COCO_17

__all__ = ["detections_of"]

IN_MEMORY = "the array"
"""What has no file is called so in messages and results."""


def detections_of(
    points: Any, layout: str | None = None, *, image_size: tuple[int, int] | None = None
) -> list[Detection]:
    """Every person of an array of 2D joints, or of what a detector returned.

    Parameters
    ----------
    points
        `(joints, 2 or 3)` of a person or `(people, joints, 2 or 3)`: pixels x right, y down, and
        perhaps a score; NaN, or without a score (0, 0), is a joint that was not detected. Tensors
        are taken as arrays. Or the `Results` of Ultralytics' YOLO-pose, one or a list of them.
    layout
        The order of the joints, a name of `layouts.LAYOUTS`; by default that of so many points.
    image_size
        (width, height) in pixels, where it is known; results say it themselves.

    Returns
    -------
    list of Detection
        Numbered from 0, through all results. A person of whom nothing was seen stays in the list.

    Raises
    ------
    BadInput
        On what is neither, on fractions of an image, and on a layout that does not fit.
    """
    results = points if isinstance(points, list | tuple) else [points]
    if results and all(hasattr(one, "keypoints") for one in results):
        people = [person for one in results for person in _of_results(one)]
    else:
        people = [(rows, IN_MEMORY, image_size) for rows in _people(_plain(points), IN_MEMORY)]
    found = (
        _detection(rows, layout, source, person, size)
        for person, (rows, source, size) in enumerate(people)
    )
    return list(in_pixels(found, None, image_size))


def _detection(
    rows: FloatArray, layout: str | None, source: str, person: int, size: tuple[int, int] | None
) -> Detection:
    where = f"person {person} of {source}"
    chosen = chosen_layout(len(rows), Content(b"", source, layout=layout), where)
    return chosen.detection(scored(rows, where), 0.0, source, person, image_size=size)


Person = tuple[FloatArray, str, tuple[int, int] | None]
"""Rows of x, y and perhaps a score, where they are from, and the size of the image."""


def _of_results(results: Any) -> Iterator[Person]:
    """People of one image. Points that YOLO did not find are at (0, 0), whatever their score."""
    source = str(getattr(results, "path", None) or IN_MEMORY)
    if results.keypoints is None:
        raise BadInput(f"the results of {source} have no keypoints; give those of a pose model.")
    shape = getattr(results, "orig_shape", None)
    size = None if shape is None else (int(shape[1]), int(shape[0]))
    places, scores = _plain(results.keypoints.xy), getattr(results.keypoints, "conf", None)
    if places.size == 0:
        return
    if scores is not None:
        places = np.concatenate([places, _plain(scores)[..., None]], axis=-1)
    for rows in _people(places, source):
        if len(rows) != COCO_17.count:
            raise BadInput(
                f"the results of {source} have {len(rows)} points of a person, not COCO's"
                f" {COCO_17.count}; give them as an array, with a layout."
            )
        yield _without_zeros(rows), source, size


def _people(points: FloatArray, source: str) -> FloatArray:
    """`(people, joints, 2 or 3)`."""
    people = points[None] if points.ndim == 2 else points
    if people.ndim != 3 or people.shape[2] not in (2, 3):
        raise BadInput(
            f"{source} has the shape {points.shape}, not (joints, 2 or 3) or (people, joints, 2 or"
            " 3)."
        )
    if people.shape[2] == 2:
        return np.stack([_without_zeros(rows) for rows in people]) if len(people) else people
    return people


def _without_zeros(rows: FloatArray) -> FloatArray:
    """Points at (0, 0) are none: NaN."""
    rows = rows.copy()
    rows[(rows[:, :2] == 0).all(axis=1)] = np.nan
    return rows


def _plain(values: Any) -> FloatArray:
    """Numbers as an array; a tensor of an accelerator comes to the processor first. Raises
    `BadInput` on anything else."""
    values = values.detach() if hasattr(values, "detach") else values
    values = values.cpu() if hasattr(values, "cpu") else values
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        array = np.empty(0, object)
    if array.dtype.kind not in "iuf":
        raise BadInput(
            "detections are made of an array of numbers, (joints, 2 or 3) or (people, joints, 2 or"
            f" 3), or of the results of a YOLO-pose model, not of {type(values).__name__}."
        )
    return arrays.plain(array, IN_MEMORY)
