"""MPII's annotations as JSON, the list that HRNet, MMPose and the Stacked Hourglass train on: a
record a person with `joints` (sixteen [x, y] in pixels), `joints_vis` (1 or 0), `image`, `center`
and `scale`. A joint that was not labelled has joints_vis 0, or lies at (0, 0) or (−1, −1)."""

from collections.abc import Iterator

import numpy as np

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    chosen_layout,
    image_name,
    mapping,
    number,
    scored_point,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import MPII_16


def recognises(content: Content) -> bool:
    """A list of objects with joints and, beside them, what names their image."""
    records = content.first
    head = records[0] if isinstance(records, list) and records else None
    return isinstance(head, dict) and {"joints", "image"} <= set(head)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each record, numbered in the order of the file."""
    for person, value in enumerate(content.records()):
        where = f"record {person} of {content.source}"
        record = mapping(value, where)
        joints = sequence(record.get("joints"), f"'joints' of {where}")
        seen = record.get("joints_vis", [1] * len(joints))
        if len(joints) != MPII_16.count or len(sequence(seen, "'joints_vis'")) != len(joints):
            raise BadInput(
                f"{where} has {len(joints)} joints and joints_vis of {len(seen)} where MPII's"
                f" {MPII_16.count} are needed of both."
            )
        layout = chosen_layout(MPII_16.count, content, where)
        points = np.array(
            [
                _point(xy, visible, f"{name} in {where}")
                for name, xy, visible in zip(MPII_16.points, joints, seen, strict=True)
            ]
        )
        image = image_name(record.get("image"), f"'image' of {where}")
        yield layout.detection(
            points, threshold, content.source, person, image, track=track_of(record)
        )


def _point(xy: object, visible: object, where: str) -> np.ndarray:
    if len(sequence(xy, where)) != 2:
        raise BadInput(f"{where} is {shown(xy)} where [x, y] is needed.")
    if visible not in (0, 1):
        raise BadInput(
            f"joints_vis of {where} is {shown(visible)} where 0 or 1 is needed; write detections"
            " with scores as COCO results."
        )
    return scored_point([*xy, number(visible, where)], where)  # type: ignore[misc]
