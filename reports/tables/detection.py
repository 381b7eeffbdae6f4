"""What was read from a detector's file, and what a network found."""

from collections.abc import Sequence

import numpy as np

from poseterior.probmodel.detections import FACE, Detection
from poseterior.probmodel.skeleton import JOINTS
from poseterior.reports.tables.sheet import Column, Sheet, fixed, number, significant
from poseterior.reports.tables.words import spoken


def reading_table(person: Detection, radius: np.ndarray | None) -> Sheet:
    """Each joint and face point that was seen: place, score, and `radius` `(15,)` in pixels where
    it is known."""
    unknown = np.full(len(JOINTS), np.nan)
    reach = unknown if radius is None else radius
    points = zip(JOINTS, person.keypoints, person.score, reach, strict=True)
    face = [] if person.face is None else zip(FACE, person.face, strict=True)
    records = [
        {"joint": name, "x": x, "y": y, "score": score, "radius": number(disc)}
        for name, (x, y), score, disc in points
        if score > 0
    ]
    records += [
        {"joint": name, "x": x, "y": y, "score": score, "radius": None}
        for name, (x, y, score) in face
        if score > 0
    ]
    columns = [
        Column("joint", form=spoken, left=True),
        Column("x"),
        Column("y"),
        Column("score", form=significant(3)),
        Column("radius", form=fixed(1)),
    ]
    return Sheet(columns, records, f"Person {person.person}")


def people_table(people: Sequence[Detection]) -> Sheet:
    """Each person that a network found: image, number, joints seen, highest score."""
    records = [
        {
            "image": person.image_id,
            "person": person.person,
            "joints": int(person.seen.sum()),
            "highest score": float(person.score.max()),
        }
        for person in people
    ]
    columns = [
        Column("image", left=True),
        Column("person"),
        Column("joints"),
        Column("highest score", form=significant(3)),
    ]
    return Sheet(columns, records, "People")
