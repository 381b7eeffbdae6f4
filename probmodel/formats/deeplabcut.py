"""DeepLabCut: a table with a row for each frame and x, y, likelihood of freely named body parts;
CSV or HDF5.

Three header rows name scorer, body part and coordinate, four also the individual. Names are matched
as people write them (`layouts.spoken_name`); others need a map of names. The HDF5 file is a table
of pandas, read with h5py alone: nothing is unpickled. The labels of its "table" form are pickled
text of a kind that is plain to read; any other is refused."""

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from poseterior.probmodel import arrays
from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    named_layout,
    table_header,
    table_number,
    table_rows,
)

HEADERS = ("scorer", "individuals", "bodyparts", "coords")
COORDS = ("x", "y", "likelihood")
_OPCODE = re.compile(
    r"V(?P<text>[^\n]*)\n|p(?P<put>\d+)\n|g(?P<get>\d+)\n|(?P<mark>\()|(?P<tuple>t)|[la.]"
)


class Table(NamedTuple):
    """`individuals` and `parts` name the columns of `values` `(frames, columns, 3)`; `frames` names
    the rows."""

    individuals: list[str]
    parts: list[str]
    frames: list[str]
    values: FloatArray


def recognises_csv(content: Content) -> bool:
    """A first row that begins with "scorer"."""
    header = table_header(content)
    return len(header) > 1 and header[0] == HEADERS[0]


def recognises_hdf5(content: Content) -> bool:
    """An HDF5 file with a table of pandas."""
    if content.arrays.magic != arrays.HDF5:
        return False
    return any("pandas_type" in attributes for attributes in content.arrays.attributes().values())


def read_csv(content: Content, threshold: float) -> Iterator[Detection]:
    """Every individual of every frame, frame after frame."""
    source = content.source
    rows = table_rows(content)
    header: dict[str, list[str]] = {}
    body: list[tuple[str, FloatArray]] = []
    width = skip = 0
    for number, row in enumerate(rows, start=1):
        if not body and row[0] in HEADERS and row[0] not in header:
            header[row[0]] = row
            width = len(header.get("bodyparts", row))
        elif not body:
            skip = _checked_header(header, source)
        if len(row) != width:
            raise BadInput(
                f"row {number} of {source} has {len(row)} cells, but the header {width}; check"
                " that it is complete."
            )
        if row is not header.get(row[0]):
            name = next((cell for cell in reversed(row[:skip]) if cell), str(len(body)))
            where = f"row {number} of {source}"
            body.append((name, np.array([table_number(cell, where) for cell in row[skip:]])))
    skip = _checked_header(header, source)
    labels = {name: row[skip:] for name, row in header.items()}
    values = np.array([numbers for _, numbers in body]).reshape(len(body), width - skip)
    table = _table(labels, [name for name, _ in body], values, source)
    return _people(table, content, threshold)


def _checked_header(header: Mapping[str, list[str]], source: str) -> int:
    """The first column of numbers. Raises `BadInput` where the header does not say what stands in
    the columns."""
    if not {"bodyparts", "coords"} <= set(header):
        raise BadInput(
            f"{source} has no rows 'bodyparts' and 'coords' under its first; give DeepLabCut's own"
            " CSV."
        )
    widths = {name: len(row) for name, row in header.items()}
    if len(set(widths.values())) > 1:
        raise BadInput(f"the header rows of {source} differ in length; check that it is complete.")
    return _first_value_column(header["coords"], source)


def _first_value_column(coords: list[str], source: str) -> int:
    for column, name in enumerate(coords):
        if name in COORDS:
            return column
    raise BadInput(f"the row 'coords' of {source} has no x; give DeepLabCut's own CSV.")


def read_hdf5(content: Content, threshold: float) -> Iterator[Detection]:
    """Every individual of every frame, frame after frame."""
    source = content.source
    attributes = content.arrays.attributes()
    group = next((name for name, values in attributes.items() if "pandas_type" in values), None)
    if group is None:
        raise BadInput(
            f"{source} holds no table of pandas; give the HDF5 file that DeepLabCut wrote."
        )
    table = f"{group}/table"
    kind = "values_block_0_kind"
    if kind in attributes.get(table, {}):
        rows = content.arrays.read([table])[table]
        if not {"index", "values_block_0"} <= set(rows.dtype.names or ()):
            raise BadInput(f"{table} of {source} has no columns of numbers; write the CSV instead.")
        labels = _by_level(text_labels(attributes[table][kind], source), source)
        return _people(
            _table(labels, _texts(rows["index"]), rows["values_block_0"], source),
            content,
            threshold,
        )
    found = content.arrays.read()
    levels = [
        name for name in (f"{group}/block0_items_level{i}" for i in range(4)) if name in found
    ]
    if not levels or f"{group}/block0_values" not in found or f"{group}/axis1" not in found:
        raise BadInput(
            f"{source} is a table of pandas of a form that cannot be read without unpickling; write"
            " the CSV instead (deeplabcut.analyze_videos_converth5_to_csv)."
        )
    tuples = zip(*(_level(found, name, source) for name in levels), strict=True)
    values = found[f"{group}/block0_values"]
    labels = _by_level(list(tuples), source)
    return _people(
        _table(labels, _texts(found[f"{group}/axis1"]), values, source), content, threshold
    )


def _level(found: Mapping[str, np.ndarray], name: str, source: str) -> list[str]:
    texts, codes = _texts(found[name]), found.get(name.replace("level", "label"))
    if codes is None or codes.dtype.kind not in "iu" or codes.ndim != 1:
        raise BadInput(f"{name} of {source} has no labels; write the CSV instead.")
    if len(codes) and not (codes.min() >= 0 and codes.max() < len(texts)):
        raise BadInput(
            f"the labels of {name} of {source} point beyond its names; the file is damaged."
        )
    return [texts[code] for code in codes]


def _texts(values: np.ndarray) -> list[str]:
    return [
        value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)
        for value in values.ravel().tolist()
    ]


def text_labels(text: str, source: str) -> list[tuple[str, ...]]:
    """The tuples of a list of tuples of texts, which pandas writes as a pickle in text form.

    Only the marks of texts, tuples and repetition are known here, and they are looked at, not run:
    whatever else there is, is refused."""
    place, memo = 0, dict[str, str]()
    tuples: list[tuple[str, ...]] = []
    stack: list[str] = []
    last: str | None = None
    while place < len(text):
        match = _OPCODE.match(text, place)
        if match is None:
            raise BadInput(
                f"the labels of {source} are pickled objects, which are not read; write the CSV"
                " instead."
            )
        place = match.end()
        if match["text"] is not None:
            last = match["text"]
            stack.append(last)
        elif match["get"] is not None:
            stack.append(memo.get(match["get"], ""))
        elif match["put"] is not None and last is not None:
            memo[match["put"]], last = last, None
        elif match["mark"]:
            stack, last = [], None
        elif match["tuple"]:
            tuples.append(tuple(stack))
            stack, last = [], None
    return tuples


def _by_level(tuples: list[tuple[str, ...]], source: str) -> dict[str, list[str]]:
    lengths = {len(labels) for labels in tuples}
    names = {3: ("scorer", "bodyparts", "coords"), 4: HEADERS}.get(max(lengths, default=0))
    if names is None or len(lengths) != 1:
        raise BadInput(
            f"the columns of {source} are not named by scorer, body part and coordinate; write the"
            " CSV."
        )
    return dict(zip(names, map(list, zip(*tuples, strict=True)), strict=True))


def _table(
    labels: dict[str, list[str]], frames: list[str], values: np.ndarray, source: str
) -> Table:
    values = arrays.plain(values, f"the table of {source}")
    parts, coords = labels["bodyparts"], labels["coords"]
    if values.shape != (len(frames), len(parts)) or not frames:
        raise BadInput(
            f"{source} has {len(frames)} frames and {len(parts)} columns but values {values.shape}."
        )
    step = 3 if "likelihood" in coords else 2
    if len(coords) % step or any(
        coords[i : i + step] != list(COORDS[:step]) for i in range(0, len(coords), step)
    ):
        raise BadInput(
            f"the columns of {source} do not come as {', '.join(COORDS[:step])}; give DeepLabCut's"
            " own file."
        )
    values = values.reshape(len(frames), -1, step)
    if step == 2:  # labelled by hand
        values = np.concatenate([values, np.ones_like(values[..., :1])], axis=-1)
    individuals = labels.get("individuals", [""] * len(parts))
    return Table(individuals[::step], parts[::step], frames, values)


def _people(table: Table, content: Content, threshold: float) -> Iterator[Detection]:
    wanted = list(dict.fromkeys(table.individuals))
    columns = {
        name: [i for i, individual in enumerate(table.individuals) if individual == name]
        for name in wanted
    }
    layouts = {
        name: named_layout([table.parts[i] for i in columns[name]], content) for name in wanted
    }
    person = 0
    for frame, rows in zip(table.frames, table.values, strict=True):
        for name in wanted:
            points = np.array(rows[columns[name]])
            points[~np.isfinite(points).all(axis=1)] = 0.0
            if (points[:, 2] < 0).any():
                raise BadInput(
                    f"a likelihood in frame {shown(frame)} of {content.source} is negative; give 0"
                    " or more."
                )
            yield layouts[name].detection(
                points, threshold, content.source, person, frame, track=name or None
            )
            person += 1
