"""What all readers share: the content of a file, checked access to JSON values, and joint orders.

A reader takes a `Content` and a threshold and returns a list of `Detection`; whatever it does not like it refuses with
`BadInput`, one sentence that names the file, the place and the remedy. A `Layout` maps the points of a detector onto
the skeleton.
"""

import json
import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from probmodel.detections import LARGEST_NUMBER, Detection, FloatArray
from probmodel.failures import BadInput
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

MIDPOINTS = {"thorax": ("right_shoulder", "left_shoulder"), "pelvis": ("right_hip", "left_hip")}
"""Joints that lie midway between two others, for the detectors that do not have them or missed them."""


@dataclass(frozen=True)
class Content:
    """The bytes of one file; `source` names it in messages."""

    data: bytes
    source: str

    @cached_property
    def json(self) -> Any:
        """The document, parsed once. Raises `BadInput` where it is not UTF-8, not JSON, or nested too deeply."""
        try:
            return json.loads(self.data.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            raise BadInput(
                f"{self.source} is not UTF-8 text (byte {error.start} is not); give a JSON file of 2D joints."
            ) from None
        except json.JSONDecodeError as error:
            raise BadInput(
                f"{self.source} is not valid JSON: {error.msg} at line {error.lineno}, column {error.colno}; "
                "check that the file is complete."
            ) from None
        except RecursionError:
            raise BadInput(
                f"{self.source} is nested too deeply for a file of 2D joints; check what wrote it."
            ) from None
        except ValueError:  # an integer of more digits than Python converts
            raise BadInput(f"{self.source} holds a whole number of thousands of digits; check what wrote it.") from None


@dataclass(frozen=True)
class Layout:
    """A detector's joint order: the name of each point, in the order of the file.

    A point that is a joint of the skeleton bears the joint's name; the others are not used.
    """

    name: str
    points: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many points a person has."""
        return len(self.points)

    def to_skeleton(self, points: FloatArray, threshold: float) -> tuple[FloatArray, FloatArray]:
        """`(15, 2)` keypoints and `(15,)` scores from `(count, 3)` rows of x, y, score.

        Points with score <= `threshold` are missing. A thorax or pelvis that is missing, or not part of the layout, is
        the midpoint of shoulders or hips where both are seen, with the smaller of their scores.
        """
        seen = {name: row for name, row in zip(self.points, points, strict=True) if row[2] > threshold}
        for middle, (right, left) in MIDPOINTS.items():
            if middle not in seen and right in seen and left in seen:
                seen[middle] = np.append((seen[right][:2] + seen[left][:2]) / 2, min(seen[right][2], seen[left][2]))
        return skeleton_arrays({name: row for name, row in seen.items() if name in JOINT_INDEX})


def skeleton_arrays(rows: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """`(15, 2)` keypoints and `(15,)` scores from (x, y, score) of the joints that are seen, by name."""
    keypoints, score = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    for name, row in rows.items():
        keypoints[JOINT_INDEX[name]], score[JOINT_INDEX[name]] = row[:2], row[2]
    return keypoints, score


def at_least_one_joint(detections: list[Detection], source: str, threshold: float) -> list[Detection]:
    """`detections`, unless there is none or nothing is seen in any of them: then `BadInput`."""
    if not detections:
        raise BadInput(f"{source} has no person in it; choose a frame in which the detector found one.")
    if not any(detection.seen.any() for detection in detections):
        raise BadInput(
            f"no joint of any person in {source} has a score above the threshold {threshold:g}; lower the threshold or "
            "choose another frame."
        )
    return detections


def shown(value: object) -> str:
    """A short form of any JSON value for a message (never long, never recursing deeply)."""
    return reprlib.repr(value)


def number(value: object, where: str) -> float:
    """A finite number within ±`LARGEST_NUMBER`; true and false are not numbers."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise BadInput(f"{where} is {shown(value)} where a number is needed.")
    if not (abs(value) <= LARGEST_NUMBER):  # compares huge integers without overflow; false for NaN
        said = "not finite" if isinstance(value, float) and not math.isfinite(value) else f"beyond ±{LARGEST_NUMBER:g}"
        raise BadInput(f"{where} is {shown(value)}, which is {said}; give a finite number of pixels or score.")
    return float(value)


def scored_point(values: Sequence[object], where: str) -> FloatArray:
    """`(3,)`: x, y (pixels) and a score that is not negative."""
    x, y, score = (number(value, f"{part} of {where}") for part, value in zip(("x", "y", "score"), values, strict=True))
    if score < 0:
        raise BadInput(f"score of {where} is {score:g}, which is negative; give 0 for a joint that was not detected.")
    return np.array([x, y, score])


def scored_points(values: object, names: Sequence[str], where: str) -> FloatArray:
    """`(len(names), 3)` from a flat list of x, y, score whose length is known to fit."""
    flat = sequence(values, where)
    return np.array([scored_point(flat[3 * i : 3 * i + 3], f"{name} in {where}") for i, name in enumerate(names)])


def mapping(value: object, where: str) -> dict[str, Any]:
    """A JSON object."""
    if not isinstance(value, dict):
        raise BadInput(f"{where} is {shown(value)} where a JSON object is needed.")
    return value


def sequence(value: object, where: str) -> list[Any]:
    """A JSON array."""
    if not isinstance(value, list):
        raise BadInput(f"{where} is {shown(value)} where a JSON array is needed.")
    return value


def image_name(value: object, where: str) -> str | None:
    """An image's id as text; files number their images or name them."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**18:
        return str(value)
    raise BadInput(f"{where} is {shown(value)} where a whole number or a name is needed.")


def image_side(value: object, where: str) -> int:
    """The width or the height of an image in pixels."""
    side = number(value, where)
    if side <= 0 or side != int(side):
        raise BadInput(f"{where} is {shown(value)} where a positive whole number of pixels is needed.")
    return int(side)
