"""Arrays of points in a .npy, or as lists in JSON: of any detector, where the user names the order
of the joints; and in a .npy of MoveNet; of FreeMoCap.

    (frames, joints, 2 or 3)           x, y and perhaps a score; one frame has two axes
    (…, 1, 17, 3) or (…, 6, 56)        MoveNet's output: y, x, score, fractions of the image; 56 are
                                       17 points, then a box and its score
    (cameras, frames, points, 2 or 3)  FreeMoCap's mediapipe_2dData…pixelXY.npy: pixels; MediaPipe's
                                       33 points of the body, then hands and face

RTMLib's `keypoints` (people, joints, 2) and `scores` (people, joints) may stand in a .npz. A point
with a number that is NaN is missing. FreeMoCap's third number is MediaPipe's depth, and is
not used."""

from collections.abc import Iterator

import numpy as np

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, chosen_layout
from poseterior.probmodel.formats.hourglass import scored
from poseterior.probmodel.formats.units import OUTSIDE
from poseterior.probmodel.layouts import COCO_17, MEDIAPIPE_33

PEOPLE, NUMBERS_A_PERSON = 6, 56
"""What MoveNet's model for several people returns for each image."""


def recognises(content: Content) -> bool:
    """Rows of two or three numbers."""
    shape = content.arrays.shape()
    return len(shape) in (2, 3) and shape[-1] in (2, 3)


def recognises_lists(content: Content) -> bool:
    """The same as lists in lists."""
    head = content.first
    for _ in range(2):
        head = head[0] if isinstance(head, list) and head and isinstance(head[0], list) else head
    return (
        isinstance(head, list)
        and head is not content.first
        and len(head) in (2, 3)
        and all(isinstance(value, int | float | None) for value in head)
    )


def recognises_movenet(content: Content) -> bool:
    """The shape of MoveNet's output."""
    shape = content.arrays.shape()
    single = len(shape) >= 4 and shape[-3:] == (1, COCO_17.count, 3)
    return single or (len(shape) >= 3 and shape[-2:] == (PEOPLE, NUMBERS_A_PERSON))


def recognises_freemocap(content: Content) -> bool:
    """Rows of two or three numbers of at least MediaPipe's points, for each frame and camera."""
    shape = content.arrays.shape()
    return len(shape) == 4 and shape[-1] in (2, 3) and shape[-2] >= MEDIAPIPE_33.count


def recognises_rtmlib(content: Content) -> bool:
    """A .npz with keypoints and their scores."""
    return content.arrays.magic == arrays.ZIP and {"keypoints", "scores"} <= set(
        content.arrays.names()
    )


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each frame."""
    return _read(_numbers(content), content, threshold)


def read_lists(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each frame; null is no number."""
    try:
        points = np.array(content.json, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(
            f"the lists of {content.source} are not all numbers of one shape, (frames, joints, 2 or"
            " 3); write as many points for each person."
        ) from None
    return _read(arrays.plain(points, content.source), content, threshold)


def _read(points: FloatArray, content: Content, threshold: float) -> Iterator[Detection]:
    points = points[None] if points.ndim == 2 else points
    if points.ndim != 3 or points.shape[2] not in (2, 3) or not points.size:
        raise BadInput(
            f"{content.source} has the shape {points.shape}, not (frames, joints, 2 or 3)."
        )
    layout = chosen_layout(points.shape[1], content, content.source, ())
    small = (np.abs(np.nan_to_num(points[..., :2])) <= 1 + OUTSIDE).all()
    if small and points.shape[1:] == (COCO_17.count, 3):
        raise BadInput(
            f"all coordinates of {content.source} lie between 0 and 1; give pixels or, where they"
            " are y, x and score of MoveNet, the format movenet."
        )
    for person, rows in enumerate(points):
        where = f"frame {person} of {content.source}"
        yield layout.detection(scored(rows, where), threshold, content.source, person, str(person))


def read_movenet(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each of the people, image after image; those of the model for several
    people whom it did not find are left out."""
    values = _numbers(content)
    layout = chosen_layout(COCO_17.count, content, content.source)
    if values.shape[-1:] == (NUMBERS_A_PERSON,):
        found = values.reshape(-1, NUMBERS_A_PERSON)
        frames = np.arange(len(found)) // PEOPLE
        frames, found = frames[found[:, -1] > 0], found[found[:, -1] > 0]
        people = found[:, : 3 * COCO_17.count].reshape(-1, COCO_17.count, 3)
    elif values.shape[-2:] == (COCO_17.count, 3):
        people = values.reshape(-1, COCO_17.count, 3)
        frames = np.arange(len(people))
    else:
        raise BadInput(
            f"{content.source} has the shape {values.shape}, not MoveNet's (…, 17, 3) or (…, 6,"
            " 56)."
        )
    for person, (frame, rows) in enumerate(zip(frames, people, strict=True)):
        points = scored(rows[:, [1, 0, 2]], f"person {person} of {content.source}")
        yield layout.detection(points, threshold, content.source, person, str(frame))


def read_freemocap(content: Content, threshold: float) -> Iterator[Detection]:
    """Every frame of every camera, camera after camera; frames are named `<camera>/<frame>`."""
    values = _numbers(content)
    if values.ndim != 4 or values.shape[2] < MEDIAPIPE_33.count or values.shape[3] not in (2, 3):
        raise BadInput(
            f"{content.source} has the shape {values.shape}, not FreeMoCap's (cameras, frames,"
            " points, 2 or 3)."
        )
    layout = chosen_layout(MEDIAPIPE_33.count, content, content.source)
    person = 0
    for camera, frames in enumerate(values):
        for frame, rows in enumerate(frames):
            name = f"{camera}/{frame}"
            points = scored(rows[: MEDIAPIPE_33.count, :2], f"frame {name} of {content.source}")
            yield layout.detection(points, threshold, content.source, person, name)
            person += 1


def read_rtmlib(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each of the people."""
    found = content.arrays.read(["keypoints", "scores"])
    if len(found) < 2:
        raise BadInput(f"{content.source} has no arrays 'keypoints' and 'scores'; save both.")
    places, scores = (
        arrays.plain(found[name], f"'{name}' of {content.source}")
        for name in ("keypoints", "scores")
    )
    if places.ndim != 3 or places.shape != (*scores.shape, 2):
        raise BadInput(
            f"{content.source} has keypoints {places.shape} and scores {scores.shape}, not (people,"
            " joints, 2) and (people, joints)."
        )
    layout = chosen_layout(places.shape[1], content, f"'keypoints' of {content.source}")
    points = np.concatenate([places, scores[..., None]], axis=-1)
    for person, rows in enumerate(points):
        where = f"person {person} of {content.source}"
        yield layout.detection(scored(rows, where), threshold, content.source, person)


def _numbers(content: Content) -> FloatArray:
    content.arrays.require(arrays.NPY)
    values = content.arrays.read()[""]
    return arrays.plain(values, content.source)
