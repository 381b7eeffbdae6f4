"""Sports2D's TRC in pixels: x and y of markers, z 0, a row a frame; y counts upwards.

One in metres is no file of 2D joints, whatever its z: `motion.markers`."""

from collections.abc import Iterator

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.formats.common import Content, named_layout, table_number
from poseterior.probmodel.formats.hourglass import scored

FIRST_ROW, FIRST_COLUMN = 5, 2
"""Where numbers begin, after the header and after the number and time of a frame."""


def recognises(content: Content) -> bool:
    """A TRC whose units are pixels."""
    if not content.data.startswith(b"PathFileType"):
        return False
    lines = content.data[:4096].decode("utf-8", "replace").splitlines()
    return len(lines) > 2 and "px" in lines[2].split("\t")


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each frame."""
    lines = content.text.splitlines()
    names = [name.strip() for name in lines[3].split("\t")[FIRST_COLUMN:]] if lines[3:] else []
    names = [name for name in names if name]
    layout = named_layout(names, content)
    frames, rows = [], []
    for number, line in enumerate(lines[FIRST_ROW:], FIRST_ROW + 1):
        cells = line.split("\t")
        if not line.strip():
            continue
        if len(cells) < FIRST_COLUMN + 3 * len(names):
            raise BadInput(
                f"line {number} of {content.source} has {len(cells)} cells, fewer than its markers"
                " need; check that it is complete."
            )
        where = f"line {number} of {content.source}"
        numbers = cells[FIRST_COLUMN : FIRST_COLUMN + 3 * len(names)]
        rows.append([table_number(cell, where) for cell in numbers])
        frames.append(cells[0].strip())
    points = np.array(rows, float).reshape(len(rows), len(names), 3)[..., :2]
    if np.nanmax(points[..., 1], initial=-np.inf) <= 0:
        points[..., 1] *= -1
    for person, (frame, xy) in enumerate(zip(frames, points, strict=True)):
        where = f"frame {person} of {content.source}"
        yield layout.detection(scored(xy, where), threshold, content.source, person, frame)
