"""What all readers share: the content of a file, and checked access to JSON values.

A reader takes a `Content` and a threshold and yields `Detection`s one by one; whatever it does not
like it refuses with `BadInput`, one sentence that names the file, the place and the remedy."""

import json
import math
import re
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from probmodel.detections import LARGEST_NUMBER, Detection, FloatArray
from probmodel.failures import BadInput
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS

ARRAY_MAGIC = (b"\x93NUMPY", b"PK\x03\x04", b"\x89HDF\r\n\x1a\n")
"""How .npy, .npz and HDF5 begin."""
_SPACE = re.compile(r"[ \t\n\r]*")


@dataclass(frozen=True)
class Content:
    """The bytes of one file; `source` names it in messages.

    What the file does not say, the user may: `image_size` (width, height) in pixels, for
    coordinates that are fractions of it, and `names`, their names of joints → ours (or, in the
    order of the file, a list)."""

    data: bytes
    source: str
    image_size: tuple[int, int] | None = None
    names: Mapping[str, str] | Sequence[str] = field(default_factory=dict)

    @cached_property
    def text(self) -> str:
        """The text. Raises `BadInput` where it is not UTF-8."""
        try:
            return self.data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise BadInput(
                f"{self.source} is not UTF-8 text (byte {error.start} is not), nor HDF5 or NumPy's;"
                " give a file of 2D joints."
            ) from None

    @cached_property
    def json(self) -> Any:
        """The document, parsed once. Raises `BadInput` where it is not UTF-8, not JSON, or nested
        too deeply."""
        text = self.text
        with self._json_failures():
            return json.loads(text)

    @cached_property
    def first(self) -> Any:
        """The document or, where it is an array, its first element alone in a list: enough to
        recognise a format.

        None for a file of arrays, which is no text.
        """
        if self.data.startswith(ARRAY_MAGIC):
            return None
        text = self.text
        start = _skip(text, 0)
        if text[start : start + 1] != "[":
            return self.json
        with self._json_failures():
            start = _skip(text, start + 1)
            return (
                []
                if text[start : start + 1] == "]"
                else [json.JSONDecoder().raw_decode(text, start)[0]]
            )

    def records(self) -> Iterator[Any]:
        """The elements of a document that is an array, parsed one by one, so that a long file need
        not be in memory as objects. Raises `BadInput` as `json` does, at the element where that is
        found out."""
        if not isinstance(self.first, list):
            raise BadInput(f"{self.source} is {shown(self.first)} where a JSON array is needed.")
        text, decoder = self.text, json.JSONDecoder()
        place = _skip(text, _skip(text, 0) + 1)
        if text[place : place + 1] == "]":
            self._require_end(text, place + 1)
            return
        while True:
            with self._json_failures():
                value, place = decoder.raw_decode(text, place)
            yield value
            place = _skip(text, place)
            if text[place : place + 1] == "]":
                return self._require_end(text, place + 1)
            with self._json_failures():
                if text[place : place + 1] != ",":
                    raise json.JSONDecodeError("Expecting ',' delimiter", text, place)
            place = _skip(text, place + 1)

    def _require_end(self, text: str, place: int) -> None:
        with self._json_failures():
            if _skip(text, place) != len(text):
                raise json.JSONDecodeError("Extra data", text, place)

    @contextmanager
    def _json_failures(self) -> Iterator[None]:
        try:
            yield
        except json.JSONDecodeError as error:
            raise BadInput(
                f"{self.source} is not valid JSON: {error.msg} at line {error.lineno}, column"
                f" {error.colno}; check that the file is complete."
            ) from None
        except RecursionError:
            raise BadInput(
                f"{self.source} is nested too deeply for a file of 2D joints; check what wrote it."
            ) from None
        except ValueError:  # an integer of more digits than Python converts
            raise BadInput(
                f"{self.source} holds a whole number of thousands of digits; check what wrote it."
            ) from None


def _skip(text: str, place: int) -> int:
    """The place of the next character that is no white space."""
    space = _SPACE.match(text, place)
    return space.end() if space else place


def skeleton_arrays(rows: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """`(15, 2)` keypoints and `(15,)` scores from (x, y, score) of the joints that are seen, by
    name."""
    keypoints, score = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    for name, row in rows.items():
        keypoints[JOINT_INDEX[name]], score[JOINT_INDEX[name]] = row[:2], row[2]
    return keypoints, score


def at_least_one_joint(
    detections: list[Detection], source: str, threshold: float
) -> list[Detection]:
    """`detections`, unless there is none or nothing is seen in any of them: then `BadInput`."""
    if not detections:
        raise BadInput(
            f"{source} has no person in it; choose a frame in which the detector found one."
        )
    if not any(detection.seen.any() for detection in detections):
        raise BadInput(
            f"no joint of any person in {source} has a score above the threshold {threshold:g};"
            " lower the threshold or choose another frame."
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
        said = (
            "not finite"
            if isinstance(value, float) and not math.isfinite(value)
            else f"beyond ±{LARGEST_NUMBER:g}"
        )
        raise BadInput(
            f"{where} is {shown(value)}, which is {said}; give a finite number of pixels or score."
        )
    return float(value)


def scored_point(values: Sequence[object], where: str) -> FloatArray:
    """`(3,)`: x, y (pixels) and a score that is not negative."""
    x, y, score = (
        number(value, f"{part} of {where}")
        for part, value in zip(("x", "y", "score"), values, strict=True)
    )
    if score < 0:
        raise BadInput(
            f"score of {where} is {score:g}, which is negative; give 0 for a joint that was not"
            " detected."
        )
    return np.array([x, y, score])


def scored_points(values: object, names: Sequence[str], where: str) -> FloatArray:
    """`(len(names), 3)` from a flat list of x, y, score whose length is known to fit."""
    flat = sequence(values, where)
    if set(map(type, flat)) <= {int, float}:
        with suppress(OverflowError):  # a whole number too large for a float
            points = np.array(flat, dtype=float).reshape(-1, 3)
            if (np.abs(points) <= LARGEST_NUMBER).all() and (points[:, 2] >= 0).all():
                return points
    # Something is wrong: one by one, to name it.
    return np.array(
        [
            scored_point(flat[3 * i : 3 * i + 3], f"{name} in {where}")
            for i, name in enumerate(names)
        ]
    )


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
        raise BadInput(
            f"{where} is {shown(value)} where a positive whole number of pixels is needed."
        )
    return int(side)
