"""MediaPipe Pose: 33 landmarks whose x and y are fractions of the image, with a visibility.

MediaPipe has no file of its own; people write one of these, and all are read:

    [{"x": …, "y": …, "z": …, "visibility": …} × 33]      one person; or a list of such lists
    {"landmarks": …}, {"pose_landmarks": …}, {"poseLandmarks": …}      the same, one level down
    [{"frame": 7, "landmarks": …}, …], {"frames": […]}    a film, its frames numbered if they say so
    landmarks { landmark { x: … visibility: … } … }       its protobuf as text, a block a person
    x, y, z, visibility                                   a table (CSV): 33 rows a person, or a row
                                                          a frame, in the landmarks' order

Pixels are fractions × image size, so the size must be known. A visibility outside [0, 1] is a
logit; the file's are then all turned into probabilities. One up to 1/2 counts as not seen, unless
another threshold is given."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.documents import require_modest
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    FRAME_NAMES,
    Content,
    cell_number,
    chosen_layout,
    image_name,
    mapping,
    number,
    sequence,
    table_header,
    table_rows,
)
from poseterior.probmodel.layouts import MEDIAPIPE_33

MISSING_VISIBILITY = 0.5
"""The visibility up to which a landmark is missing."""
WRAPPINGS = ("landmarks", "pose_landmarks", "poseLandmarks")
_FIELDS = ("x", "y", "visibility")
_BLOCK = re.compile(r"\b(?P<name>\w+)\s*\{|(?P<close>\})|(?P<field>\w+)\s*:\s*(?P<value>[^\s{}]+)")


def recognises_json(content: Content) -> bool:
    """Landmarks with x, y and visibility, in a list, a list of lists, or one level down."""
    document = _first(_frames(content.first))
    if isinstance(document, dict):
        key = _wrapping(document)
        document = document if key is None else document[key]
        if key is not None and not document:
            return True  # nobody in the first frame
    for _ in range(2):
        document = _first(document)
    return isinstance(document, dict) and {"x", "y"} <= set(document) and "image_id" not in document


def _first(value: Any) -> Any:
    return value[0] if isinstance(value, list) and value else value


def _frames(document: Any) -> Any:
    return document.get("frames", document) if isinstance(document, dict) else document


def _wrapping(document: Any) -> str | None:
    return next((key for key in WRAPPINGS if key in document), None)


def recognises_text(content: Content) -> bool:
    """The text form of the protobuf: blocks of landmarks."""
    head = content.data[:4096]
    return b"landmark" in head and re.search(rb"landmark\s*\{", head) is not None


def recognises_table(content: Content) -> bool:
    """A header with x, y and visibility (or one of each for every landmark) in its first line."""
    header = _header(content)
    return ("x" in header and "y" in header and "visibility" in header) or len(
        _wide_columns(header)
    ) == 33


def read_json(content: Content, threshold: float) -> Iterator[Detection]:
    """Every person of the document."""
    rows = [
        (frame, _landmarks(value, f"person {person} of {content.source}"))
        for person, (frame, value) in enumerate(_people(content))
    ]
    return _detections(content, rows, threshold)


def _people(content: Content) -> Iterator[tuple[str | None, Any]]:
    """The landmarks of everybody, and their frame."""
    document = _frames(content.json)
    head = _first(document)
    if head is document or not isinstance(head, dict) or _wrapping(head) is None:
        yield from ((None, value) for value in _persons(document, content.source))
        return
    for index, value in enumerate(document):
        where = f"frame {index} of {content.source}"
        frame = mapping(value, where)
        said = next((frame[key] for key in FRAME_NAMES if key in frame), index)
        yield from ((image_name(said, where), person) for person in _persons(frame, where))


def _persons(document: Any, where: str) -> list[Any]:
    """The landmarks of each person of a frame; nobody's may be empty, or null."""
    if isinstance(document, dict):
        key = _wrapping(document)
        if key is None:
            raise BadInput(
                f"{where} has none of {', '.join(WRAPPINGS)}; give MediaPipe's landmarks."
            )
        document = document[key]
    people = [] if document is None else sequence(document, f"the landmarks of {where}")
    return [people] if people and isinstance(people[0], dict) else people


def read_text(content: Content, threshold: float) -> Iterator[Detection]:
    """Every `landmarks` block."""
    require_modest(content.text, content.source)
    people: list[list[dict[str, Any]]] = []
    path: list[str] = []
    for match in _BLOCK.finditer(re.sub(r"#[^\n]*", "", content.text)):
        if name := match["name"]:
            path.append(name)
            if name in ("landmarks", "landmark_list") or (
                name == "landmark" and len(path) == 1 and not people
            ):
                people.append([])
            if name == "landmark" and people:
                people[-1].append({"x": 0, "y": 0})  # what protobuf leaves out is zero
        elif match["close"]:
            if not path:
                raise BadInput(
                    f"{content.source} closes a block that was never opened; check that it is"
                    " complete."
                )
            path.pop()
        elif path and path[-1] == "landmark" and people:
            people[-1][-1][match["field"]] = cell_number(
                match["value"], f"{shown(match['field'])} of {content.source}"
            )
    if path:
        raise BadInput(
            f"{content.source} ends inside a block {shown(path[-1])}; check that the file is"
            " complete."
        )
    rows = [
        _landmarks(value, f"person {person} of {content.source}")
        for person, value in enumerate(people)
    ]
    return _detections(content, [(None, row) for row in rows], threshold)


def read_table(content: Content, threshold: float) -> Iterator[Detection]:
    """One person of 33 rows, or one person for each row."""
    header = _header(content)
    lines = list(table_rows(content))[1:]
    wide = _wide_columns(header)
    people: list[tuple[str | None, FloatArray]] = []
    if len(wide) == MEDIAPIPE_33.count:
        for index, line in enumerate(lines):
            people.append((str(index), _cells(line, wide, f"row {index + 2} of {content.source}")))
    else:
        if not set(_FIELDS) <= set(header):
            raise BadInput(
                f"the first line of {content.source} does not name x, y and visibility; write a"
                " header."
            )
        columns = [header.index(name) for name in _FIELDS]
        if not lines or len(lines) % MEDIAPIPE_33.count:
            raise BadInput(
                f"{content.source} has {len(lines)} rows of landmarks where a multiple of"
                f" {MEDIAPIPE_33.count} is needed; check that the file is complete."
            )
        for start in range(0, len(lines), MEDIAPIPE_33.count):
            part = lines[start : start + MEDIAPIPE_33.count]
            cells = [
                _cells(line, [columns], f"row {start + row + 2} of {content.source}")[0]
                for row, line in enumerate(part)
            ]
            people.append(
                (None if len(lines) == MEDIAPIPE_33.count else str(start // 33), np.array(cells))
            )
    return _detections(content, people, threshold)


def _header(content: Content) -> list[str]:
    return [cell.lower() for cell in table_header(content)]


def _wide_columns(header: list[str]) -> list[list[int]]:
    """The columns of x, y, visibility of each landmark, where the header has them in groups that
    look alike: x0, y0, z0, v0 or nose_x, nose_y, nose_z, nose_visibility."""
    columns: dict[str, list[int]] = {"x": [], "y": [], "v": []}
    for index, name in enumerate(header):
        kind = re.sub(r"[\d_.\s]", "", name)
        last = name.rsplit("_", 1)[-1].rsplit(".", 1)[-1]
        for key, words in (("x", ("x",)), ("y", ("y",)), ("v", ("v", "visibility", "vis"))):
            if kind in words or last in words:
                columns[key].append(index)
    if not len(columns["x"]) == len(columns["y"]) == len(columns["v"]) == MEDIAPIPE_33.count:
        return []
    return [list(group) for group in zip(*columns.values(), strict=True)]


def _cells(line: list[str], columns: list[list[int]], where: str) -> FloatArray:
    if len(line) <= max(map(max, columns)):
        raise BadInput(
            f"{where} has {len(line)} cells, fewer than its header; check that the file is"
            " complete."
        )
    return np.array([[cell_number(line[column], where) for column in group] for group in columns])


def _landmarks(value: object, where: str) -> FloatArray:
    """`(33, 3)` fractions and visibility."""
    landmarks = sequence(value, where)
    if len(landmarks) != MEDIAPIPE_33.count:
        raise BadInput(
            f"{where} has {len(landmarks)} landmarks where {MEDIAPIPE_33.count} are needed; give"
            " all of MediaPipe's pose landmarks."
        )
    rows = []
    for name, landmark in zip(MEDIAPIPE_33.points, landmarks, strict=True):
        fields = mapping(landmark, f"{name} in {where}")
        rows.append(
            [
                number(
                    fields.get(field, 1.0 if field == "visibility" else None),
                    f"{field} of {name} in {where}",
                )
                for field in _FIELDS
            ]
        )
    return np.array(rows)


def _detections(
    content: Content, people: list[tuple[str | None, FloatArray]], threshold: float
) -> Iterator[Detection]:
    if not people:
        return
    from scipy.special import expit  # takes a while, and few files need it

    layout = chosen_layout(MEDIAPIPE_33.count, content, content.source)
    visibility = np.stack([rows[:, 2] for _, rows in people])
    logits = bool(((visibility < 0) | (visibility > 1)).any())
    for person, (frame, rows) in enumerate(people):
        score = expit(rows[:, 2]) if logits else rows[:, 2]
        points = np.column_stack([rows[:, :2], score])
        yield layout.detection(points, threshold, content.source, person, frame)
