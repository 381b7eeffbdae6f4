"""This project's own JSON of 2D joints: joints by name, so that no order can be mistaken.

    {"format": "poseterior-detections", "version": 1,
     "people": [{"keypoints": {"right_knee": [x, y, score], …}, "image_id": "785",
                 "image_size": [640, 425], "face": {"nose": [x, y, score], …}, "track": "1"}]}

A joint that is not there was not seen; without a "face", the detector has no points of it. Other
keys (a `truth`, say) are left alone."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from poseterior.probmodel.detections import FACE, Detection, FloatArray
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.common import (
    Content,
    image_name,
    image_side,
    mapping,
    scored_point,
    sequence,
    skeleton_arrays,
    track_of,
)
from poseterior.probmodel.skeleton import JOINTS

FORMAT, VERSION, LAYOUT = "poseterior-detections", 1, "poseterior"


def recognises(content: Content) -> bool:
    """An object whose `format` is this one."""
    return isinstance(content.first, dict) and content.first.get("format") == FORMAT


def read(content: Content, threshold: float) -> Iterator[Detection]:
    """One detection for each of `people`, in order."""
    source = content.source
    document = mapping(content.json, source)
    if document.get("format") != FORMAT:
        raise BadInput(
            f"'format' of {source} is {shown(document.get('format'))}, not '{FORMAT}'; choose"
            " the format auto."
        )
    version = document.get("version")
    if isinstance(version, bool) or version != VERSION:
        raise BadInput(
            f"'version' of {source} is {shown(version)}, but version {VERSION} is what can be read."
        )
    people = sequence(document.get("people"), f"'people' of {source}")
    for person, value in enumerate(people):
        yield _person(value, person, source, threshold)


def write(detections: Sequence[Detection]) -> str:
    """The document that `read` turns into the same keypoints, scores, image ids and sizes.

    Raises `BadInput` where nothing is seen in any of `detections`: no reader would accept the file.
    """
    if not any(detection.seen.any() for detection in detections):
        raise BadInput("there is no joint in these detections, so there is nothing to write.")
    people = ",\n".join(json.dumps(_record(detection), allow_nan=False) for detection in detections)
    return f'{{"format": "{FORMAT}", "version": {VERSION}, "people": [\n{people}\n]}}\n'


def _record(detection: Detection) -> dict[str, Any]:
    size, face = detection.image_size, detection.face
    return {
        "keypoints": _rows_by_name(JOINTS, detection.keypoints, detection.score),
        **({} if detection.image_id is None else {"image_id": detection.image_id}),
        **({} if size is None else {"image_size": list(size)}),
        **({} if detection.track is None else {"track": detection.track}),
        **({} if face is None else {"face": _rows_by_name(FACE, face[:, :2], face[:, 2])}),
    }


def _rows_by_name(
    names: Sequence[str], xy: FloatArray, score: FloatArray
) -> dict[str, list[float]]:
    rows = zip(names, xy.tolist(), score.tolist(), strict=True)
    return {name: [*place, value] for name, place, value in rows if value > 0}


def _person(value: object, person: int, source: str, threshold: float) -> Detection:
    where = f"person {person} of {source}"
    record = mapping(value, where)
    rows = _points(record.get("keypoints"), "keypoints", JOINTS, where)
    keypoints, score = skeleton_arrays(
        {name: row for name, row in rows.items() if row[2] > threshold}
    )
    image = image_name(record.get("image_id"), f"'image_id' of {where}")
    size, face = _size(record.get("image_size"), where), _face(record.get("face"), where, threshold)
    return Detection(
        keypoints,
        score,
        LAYOUT,
        source,
        person,
        image,
        size,
        face,
        track=track_of(record),
    )


def _face(value: object, where: str, threshold: float) -> FloatArray | None:
    if value is None:
        return None
    face = np.full((len(FACE), 3), [np.nan, np.nan, 0.0])
    for name, row in _points(value, "face", FACE, where).items():
        if row[2] > threshold:
            face[FACE.index(name)] = row
    return face


def _points(value: object, key: str, names: Sequence[str], where: str) -> dict[str, FloatArray]:
    rows = {}
    for name, values in mapping(value, f"'{key}' of {where}").items():
        if name not in names:
            kind = "joint" if key == "keypoints" else "point of the face"
            raise BadInput(
                f"{where} has a {kind} {shown(name)}, which is none of {', '.join(names)}."
            )
        if len(sequence(values, f"{name} of {where}")) != 3:
            raise BadInput(f"{name} of {where} is {shown(values)} where [x, y, score] is needed.")
        rows[name] = scored_point(values, f"{name} in {where}")
    return rows


def _size(value: object, where: str) -> tuple[int, int] | None:
    if value is None:
        return None
    sides = sequence(value, f"'image_size' of {where}")
    if len(sides) != 2:
        raise BadInput(
            f"'image_size' of {where} is {shown(value)} where [width, height] is needed."
        )
    width, height = (image_side(side, f"'image_size' of {where}") for side in sides)
    return width, height
