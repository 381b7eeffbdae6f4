"""MMPose 1.x (RTMPose, ViTPose, …): instances with lists of [x, y] and of scores.

    instance: {"keypoints": [[x, y], …], "keypoint_scores": […], "bbox": [[x0, y0, x1, y1]]}
    [instance, …]                                                     an image (inferencer)
    {"meta_info": {"dataset_name": "coco", "keypoint_id2name": {"0": "nose", …}},
     "instance_info": [instance, …]                                   an image (demo scripts)
                   or [{"frame_id": 0, "instances": [instance, …]}, …]}     a video

The layout stands in `meta_info`: by the name of the data set or by the names of the points. A file
without it is told by its number of points, where only one layout has that many. Scores of SimCC
heads may exceed 1; only their proportions matter."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    BY_COUNT,
    Content,
    chosen_layout,
    image_name,
    mapping,
    number,
    scored_point,
    sequence,
    track_of,
)
from poseterior.probmodel.layouts import (
    AIC_14,
    COCO_17,
    CROWDPOSE_14,
    H36M_17,
    HALPE_26,
    HALPE_136,
    MPII_16,
    WHOLEBODY_133,
    Layout,
    layout_of_names,
)

DATASETS = {
    "coco": COCO_17,
    "h36m": H36M_17,
    "mpii": MPII_16,
    "halpe26": HALPE_26,
    "halpe": HALPE_136,
    "coco_wholebody": WHOLEBODY_133,
    "crowdpose": CROWDPOSE_14,
    "aic": AIC_14,
}
"""Layouts by the data set's name in `meta_info`; any other is read by the names of its points."""


def recognises(content: Content) -> bool:
    """An object with `instance_info`, or a list (empty lists are not ours) of objects with
    `keypoint_scores`."""
    document = content.first
    if isinstance(document, dict):
        return "instance_info" in document
    head = document[0] if isinstance(document, list) and document else None
    return isinstance(head, dict) and ("keypoint_scores" in head or "instances" in head)


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """The instances of all frames, in the order of the file."""
    layout, records = None, content.records()
    if isinstance(content.first, dict):
        document = content.first
        layout = _layout(document.get("meta_info"), content.source)
        records = iter(
            sequence(document.get("instance_info"), f"'instance_info' of {content.source}")
        )
    for person, (frame, instance) in enumerate(_instances(records, content.source)):
        where = f"person {person} of {content.source}"
        record = mapping(instance, where)
        points, fitting = _points(record, layout, content, where)
        track = track_of(record)
        yield fitting.detection(points, threshold, content.source, person, frame, track=track)


def _instances(records: Iterator[Any], source: str) -> Iterator[tuple[str | None, Any]]:
    """Frame and instance; a record is an instance, or a frame that has a list of them."""
    for index, record in enumerate(records):
        where = f"record {index} of {source}"
        if "instances" not in mapping(record, where):
            yield None, record
            continue
        frame = image_name(record.get("frame_id", index), f"'frame_id' of {where}")
        for instance in sequence(record["instances"], f"'instances' of {where}"):
            yield frame, instance


def _layout(meta: object, source: str) -> Layout | None:
    """None where `meta_info` says nothing."""
    if meta is None:
        return None
    info = mapping(meta, f"'meta_info' of {source}")
    name = info.get("dataset_name")
    if isinstance(name, str) and name in DATASETS:
        return DATASETS[name]
    names = info.get("keypoint_id2name")
    if names is None:
        return None
    table = mapping(names, f"'keypoint_id2name' of 'meta_info' of {source}")
    ordered = [table.get(str(index)) for index in range(len(table))]
    if not all(isinstance(value, str) for value in ordered):
        raise BadInput(
            f"'keypoint_id2name' of {source} does not name the points 0 to {len(table) - 1}; check"
            " what wrote it."
        )
    return layout_of_names([str(value) for value in ordered])


def _points(
    record: dict[str, Any], layout: Layout | None, content: Content, where: str
) -> tuple[FloatArray, Layout]:
    xy = sequence(record.get("keypoints"), f"'keypoints' of {where}")
    scores = sequence(record.get("keypoint_scores"), f"'keypoint_scores' of {where}")
    layout = chosen_layout(
        len(xy), content, f"'keypoints' of {where}", BY_COUNT if layout is None else [layout]
    )
    if len(scores) != len(xy):
        raise BadInput(
            f"{where} has {len(xy)} keypoints but {len(scores)} scores; check what wrote it."
        )
    points = zip(layout.points, xy, scores, strict=True)
    return (
        np.array([_row(place, score, f"{name} in {where}") for name, place, score in points]),
        layout,
    )


def _row(xy: object, score: object, where: str) -> FloatArray:
    if len(sequence(xy, where)) != 2:
        raise BadInput(f"{where} is {shown(xy)} where [x, y] is needed.")
    # A head that regresses its scores may fall below zero, where nothing was found.
    return scored_point([*xy, max(number(score, f"score of {where}"), 0.0)], where)  # type: ignore[misc]
