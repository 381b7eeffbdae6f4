"""This project's own JSON of 2D joints: joints by name, so that no order can be mistaken.

    {"format": "poseterior-detections", "version": 1,
     "people": [{"keypoints": {"right_knee": [x, y, score], …}, "image_id": "785",
                 "image_size": [640, 425], "face": {"nose": [x, y, score], …}, "track": "1"}]}

A joint that is not there was not seen; without a "face", the detector has no points of it.
"midpoints" says which of thorax and pelvis are those of shoulders and hips. Where there is no
"unit": "pixels", as files that were written here have it, coordinates are looked at. Other keys (a
`truth`, say) are left alone."""

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
from poseterior.probmodel.formats.units import Unit, in_pixels
from poseterior.probmodel.layouts import MIDPOINTS, midpoints_of
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
    if content.layout is not None:
        raise BadInput(
            f"{source} names its joints; leave out layout (on the command line --layout)."
        )
    listed = enumerate(sequence(document.get("people"), f"'people' of {source}"))
    people = (_person(value, person, source, threshold) for person, value in listed)
    written = document.get("unit") == Unit.PIXELS.value
    return people if written else in_pixels(people, None, content.image_size)


def write(detections: Sequence[Detection]) -> str:
    """The document that `read` turns into the same keypoints, scores, image ids and sizes.

    Raises `BadInput` where nothing is seen in any of `detections`: no reader would accept the file.
    """
    if not any(detection.seen.any() for detection in detections):
        raise BadInput("there is no joint in these detections, so there is nothing to write.")
    people = ",\n".join(json.dumps(_record(detection), allow_nan=False) for detection in detections)
    head = f'{{"format": "{FORMAT}", "version": {VERSION}, "unit": "{Unit.PIXELS.value}",'
    return f'{head} "people": [\n{people}\n]}}\n'


def _record(detection: Detection) -> dict[str, Any]:
    size, face = detection.image_size, detection.face
    midpoints = () if detection.moved else midpoints_of(detection)
    return {
        "keypoints": _rows_by_name(JOINTS, detection.keypoints, detection.score),
        **({} if detection.image_id is None else {"image_id": detection.image_id}),
        **({} if size is None else {"image_size": list(size)}),
        **({} if detection.track is None else {"track": detection.track}),
        **({"midpoints": list(midpoints)} if midpoints else {}),
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
    midpoints = _midpoints(record.get("midpoints", []), where)
    return Detection(
        keypoints=keypoints,
        score=score,
        layout=LAYOUT,
        source=source,
        person=person,
        image_id=image,
        image_size=size,
        face=face,
        midpoints=midpoints,
        track=track_of(record),
    )


def _midpoints(value: object, where: str) -> tuple[str, ...]:
    names = sequence(value, f"'midpoints' of {where}")
    if any(name not in MIDPOINTS for name in names):
        raise BadInput(
            f"'midpoints' of {where} are {shown(names)}, which may be {' and '.join(MIDPOINTS)}."
        )
    return tuple(name for name in MIDPOINTS if name in names)


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
