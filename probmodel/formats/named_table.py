"""A table (CSV) with named columns: a row a frame, NAME_x, NAME_y and, where there is one,
NAME_score (or confidence, likelihood, visibility, …: `_SCORES`) for every point, in any order.

This is nobody's own format, but what people make of tables of their own. Names are matched as
people write them (`layouts.spoken_name`); others need a map of names. Cells are separated by
commas, semicolons or tabs. A cell that is empty, or "nan", is a missing point; a point without a
column for its score has one. A NAME_z beside a score is a depth, and not used; without one, or
beside the NAME_error of a triangulation (anipose's), the table is of positions in space."""

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import (
    FRAME_NAMES,
    TRACKS,
    Content,
    named_layout,
    scored_points,
    table_header,
    table_number,
    table_rows,
    track_of,
)
from poseterior.probmodel.layouts import spoken_name
from poseterior.probmodel.skeleton import JOINTS

FEWEST = 3
"""Joints that a header must name to be recognised; a camera needs as many."""
_SCORES = (
    *("score", "confidence", "conf", "likelihood", "visibility", "vis", "probability", "prob"),
    *("p", "c", "v", "s"),
)
_ENDINGS = ("x", "y", "z", "error", *_SCORES)
_COLUMN = re.compile(rf"(?P<name>.+?)[ _.](?P<part>{'|'.join(_ENDINGS)})", re.IGNORECASE)
_ROWS = (*FRAME_NAMES, "")
"""Columns that name the rows; an index of pandas has no name."""
_PEOPLE = (*TRACKS, "person", "individual", "id")
"""Columns that say whose row it is."""
Columns = dict[str, dict[str, int]]


def recognises(content: Content) -> bool:
    """A first line that names x and y of some joints."""
    columns = _columns(table_header(content))
    if isinstance(content.names, Mapping):
        names = [content.names.get(name, spoken_name(name)) for name in columns]
    else:
        names = list(content.names) or [spoken_name(name) for name in columns]
    joints = len(set(names) & set(JOINTS))
    return bool(columns) and (joints >= FEWEST or content.layout is not None)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each row, frame after frame."""
    rows = table_rows(content)
    header = next(rows, [])
    columns = _columns(header)
    if not columns:
        raise BadInput(
            f"the first line of {content.source} names no column NAME_x with its NAME_y; write a"
            " header."
        )
    deep = [places for places in columns.values() if "z" in places]
    if any("score" not in places or "error" in places for places in deep):
        known = "errors of a triangulation" if "error" in deep[0] else "no scores"
        raise BadInput(
            f"{content.source} has columns NAME_z and {known}, as a table of 3D positions has,"
            " which are for check, learn and evaluate; leave z out where x and y are of an image."
        )
    layout = named_layout(list(columns), content)
    frame, who = (_column(header, known) for known in (_ROWS, _PEOPLE))
    for person, row in enumerate(rows):
        where = f"row {person + 2} of {content.source}"
        if len(row) != len(header):
            raise BadInput(
                f"{where} has {len(row)} cells, but the header {len(header)}; check that it is"
                " complete."
            )
        flat = [value for places in columns.values() for value in _point(row, places, where)]
        name = str(person) if frame is None else row[frame].strip() or None
        track = None if who is None else track_of({"track": row[who]})
        points = scored_points(flat, layout.points, where)
        yield layout.detection(points, threshold, content.source, person, name, track=track)


def _column(header: list[str], known: Sequence[str]) -> int | None:
    """The place of the first column of a known name."""
    return next((at for at, cell in enumerate(header) if cell.strip().lower() in known), None)


def _columns(header: list[str]) -> Columns:
    """By point, in the order of the file, where its x, y and score stand; points without both x and
    y are left out."""
    found: Columns = {}
    for place, cell in enumerate(header):
        if match := _COLUMN.fullmatch(cell.strip()):
            part = match["part"].lower()
            found.setdefault(match["name"], {})["score" if part in _SCORES else part] = place
    return {name: places for name, places in found.items() if {"x", "y"} <= set(places)}


def _point(row: list[str], places: dict[str, int], where: str) -> tuple[float, float, float]:
    """x, y and score; all 0 where any is missing."""
    x, y = (table_number(row[places[part]], where) for part in "xy")
    score = table_number(row[places["score"]], where) if "score" in places else 1.0
    return (0.0, 0.0, 0.0) if np.isnan([x, y, score]).any() else (x, y, score)
