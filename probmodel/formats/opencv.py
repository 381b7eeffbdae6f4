"""OpenPose's keypoints as OpenCV stores arrays (`--write_keypoint_format yml`, json or xml).

    pose_0: {sizes: [people, points, 3], data: [x, y, score, …]}

Only sizes and numbers are looked for, by their names; nothing else of YAML or XML is read."""

import math
import re
from collections.abc import Iterator
from itertools import chain

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, cell_number, chosen_layout
from poseterior.probmodel.formats.openpose import body_order
from poseterior.probmodel.layouts import BODY_25, Layout

_OPENCV_NUMBERS = r"""["']?\s*[:>]\s*\[?(?P<{0}>[^\[\]<]*)"""
_ARRAY = re.compile(
    r"\bpose_\d+\b.{0,200}?\bsizes"
    + _OPENCV_NUMBERS.format("sizes")
    + r".{0,200}?\bdata"
    + _OPENCV_NUMBERS.format("data"),
    re.DOTALL,
)


def recognises(content: Content) -> bool:
    """A text with OpenCV's mark of an array of a pose near its beginning."""
    head = content.data[:1000]
    return b"opencv-nd-matrix" in head and b"pose_0" in head


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """Everyone in its arrays."""
    source = content.source
    people = [
        *chain.from_iterable(_people(match, source) for match in _ARRAY.finditer(content.text))
    ]
    layouts = {len(points): _layout(len(points), people, content) for points in people}
    for person, points in enumerate(people):
        yield layouts[len(points)].detection(points, threshold, source, person)


def _layout(count: int, people: list[np.ndarray], content: Content) -> Layout:
    if count == BODY_25.count and content.layout is None:
        return body_order([points for points in people if len(points) == count], content.source)
    return chosen_layout(count, content, content.source)


def _people(array: re.Match[str], source: str) -> np.ndarray:
    """`(people, points, 3)`."""
    where = f"an array of {source}"
    sizes, data = (
        [cell_number(word, where) for word in re.split(r"[\s,]+", array[name].strip()) if word]
        for name in ("sizes", "data")
    )
    whole = [int(size) for size in sizes if size == int(size) and size > 0]
    if len(whole) != 3 or whole[2] != 3 or math.prod(whole) != len(data) or len(sizes) != 3:
        raise BadInput(
            f"{where} has {len(data)} numbers and sizes {sizes}, which are not people, points and"
            " 3; check that it is complete."
        )
    points = np.array(data).reshape(whole)
    if (points[..., 2] < 0).any():
        raise BadInput(f"a score of {where} is negative; give 0 for what was not detected.")
    return points
