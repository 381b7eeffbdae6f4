"""A CSV with named columns: a row a frame, NAME_x, NAME_y and, where there is one, NAME_score (or
confidence, conf, likelihood, visibility, p) for every point, in any order.

This is nobody's own format, but what people make of tables of their own. Names are matched as
people write them (`layouts.spoken_name`); others need a map of names. Coordinates are pixels. A
cell that is empty, or "nan", is a missing point; a point without a column for its score has one."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    TRACKS,
    Content,
    named_layout,
    scored_points,
    table_rows,
    track_of,
)
from poseterior.probmodel.layouts import spoken_name
from poseterior.probmodel.skeleton import JOINTS

FEWEST = 3
"""Joints that a header must name to be recognised; a camera needs as many."""
LONGEST_HEADER = 100_000
"""Bytes of a first line that are looked at to recognise it."""
_SCORES = ("score", "confidence", "conf", "likelihood", "visibility", "p")
_COLUMN = re.compile(rf"(?P<name>.+?)[ _.](?P<part>x|y|{'|'.join(_SCORES)})", re.IGNORECASE)
_FRAMES = ("frame", "frame_id", "frame_number", "image", "image_id", "file", "")
"""Columns that name the rows, as people call them; an index of pandas has no name."""
_PEOPLE = (*TRACKS, "person", "individual", "id")
"""Columns that say whose row it is."""
Columns = dict[str, dict[str, int]]


def recognises(content: Content) -> bool:
    """A first line that names x and y of some joints."""
    start = content.data[:LONGEST_HEADER].decode("utf-8-sig", "replace")
    if content.arrays.magic or start.lstrip().startswith(("{", "[")):
        return False
    header = start.splitlines()[0].split(",") if start else []
    columns = _columns([cell.strip('"') for cell in header])
    if isinstance(content.names, Mapping):
        names = [content.names.get(name, spoken_name(name)) for name in columns]
    else:
        names = list(content.names) or [spoken_name(name) for name in columns]
    return bool(columns) and len(set(names) & set(JOINTS)) >= FEWEST


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
    layout = named_layout(list(columns), content)
    frame, who = (_column(header, known) for known in (_FRAMES, _PEOPLE))
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
    x, y = (_cell(row[places[part]], where) for part in "xy")
    score = _cell(row[places["score"]], where) if "score" in places else 1.0
    return (0.0, 0.0, 0.0) if np.isnan([x, y, score]).any() else (x, y, score)


def _cell(text: str, where: str) -> float:
    if not text.strip():
        return np.nan
    with suppress(ValueError):
        return float(text)
    raise BadInput(f"{where} holds {shown(text)} where a number is needed.")
