"""Wrong readings of a file: how often they are noticed, and right ones doubted.

Poses of motion capture are seen from random sides with a detector's noise, their faces where they
are in view; `study` judges each as it is, and misread in every way.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.inference.face import POINTS
from poseterior.inference.readings import (
    ASPECTS,
    BODY,
    READINGS,
    Judge,
    Reading,
    ReadingEvidence,
    Verdict,
    exchanged,
    stretched,
    weigh,
)
from poseterior.inference.studies.scenes import camera
from poseterior.probmodel.body import body_unit
from poseterior.probmodel.detections import FACE, Detection, mapped
from poseterior.probmodel.layouts import COCO_17, H36M_17, Layout
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS

MISREAD_NOISE = 0.08
"""Body units (2.6 cm): MMPose's joints lie so far from COCO's annotation on the one image that both
are of."""
FACE_NOISE = 0.03
CHIN = 0.37
"""Body units from the end of the head down to the middle between the ears."""
MISTAKES = 0.03
"""How often a point of the face is found though hidden, or missed though in view."""
SCALE, SCORE = 100, 0.8
"""Pixels a body unit, and the score of every point that is found."""
NODS = (25, 15, 10)
"""Degrees, standard deviations of the head's turn against the chest."""
READ_RIGHT = "right"
"""The reading that is no mistake."""


@dataclasses.dataclass(frozen=True)
class FileView:
    """A projected pose: the `detection`, its points `(17, 3)` in COCO's order, and degrees from a
    frontal view."""

    detection: Detection
    points: np.ndarray
    angle: float


def views(motions: Path, count: int, seed: int, noise: float = MISREAD_NOISE) -> Iterator[FileView]:
    """Poses of all kinds of action, from random sides."""
    joints = np.concatenate([motion.joints[::7] for motion in read_motion(motions)])
    rng = np.random.default_rng(seed)
    for pose in joints[rng.choice(len(joints), count, replace=False)]:
        body = (pose - pose[0]) / body_unit(pose[None])
        yield view_of(body, rng, noise)


def view_of(body: np.ndarray, rng: np.random.Generator, noise: float = MISREAD_NOISE) -> FileView:
    """`body` `(15, 3)` (body units) from a random side, tilted by up to 20°."""
    lens = camera(rng.uniform(0, 360), rng.uniform(-20, 20), SCALE)
    axes = _chest(body)
    turn = Rotation.from_euler("YXZ", rng.normal(size=3) * np.radians(NODS)).as_matrix()
    head = axes @ turn
    centre = body[JOINT_INDEX["head"]] - CHIN * head[:, 1]
    face = centre + POINTS @ head.T
    outward = (face - centre) / np.linalg.norm(face - centre, axis=1, keepdims=True)
    towards = -(np.asarray(lens.rotation)[2] @ outward.T)
    found = (towards > -0.2) ^ (rng.random(len(FACE)) < MISTAKES)
    exact = dict(zip(JOINTS, np.asarray(lens.project(body)), strict=True))
    exact |= dict(zip(FACE, np.asarray(lens.project(face)), strict=True))
    points = np.array([[*exact[name], SCORE] for name in COCO_17.points])
    spread = np.where(np.isin(COCO_17.points, FACE), FACE_NOISE, noise)
    points[:, :2] += rng.normal(size=(17, 2)) * SCALE * spread[:, None]
    for name, seen in zip(FACE, found, strict=True):
        points[COCO_17.points.index(name), 2] *= seen
    detection = COCO_17.detection(points, 0.0, "a scene", 0)
    # The skeleton's own thorax and pelvis, as a detector of them would see them.
    keypoints = np.array(detection.keypoints)
    for name in ("thorax", "pelvis"):
        keypoints[JOINT_INDEX[name]] = exact[name] + rng.normal(size=2) * SCALE * noise
    aside = min(1.0, abs((np.asarray(lens.rotation) @ axes[:, 2])[0]))
    detection = dataclasses.replace(detection, keypoints=keypoints)
    return FileView(detection, points, float(np.degrees(np.arcsin(aside))))


def _chest(body: np.ndarray) -> np.ndarray:
    """`(3, 3)`: columns left, up and forward of a pose."""
    at = {name: body[index] for name, index in JOINT_INDEX.items()}
    left = at["left_hip"] - at["right_hip"]
    up = _unit(at["thorax"] - at["pelvis"])
    return np.stack([_unit(left - left @ up * up), up, _unit(np.cross(left, up))], axis=1)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def mirrored(detection: Detection, axis: int, size: float = 640.0) -> Detection:
    """x counted from the other side (axis 0), or y (axis 1)."""
    turned = np.arange(2) == axis
    return mapped(detection, lambda places: np.where(turned, size - places, places))


def _read_as(points: np.ndarray, layout: Layout) -> Detection:
    points = np.array(points)
    points[:, 2] = SCORE
    return layout.detection(points, 0.0, "a scene", 0)


def seen_as(
    kind: str,
    person: Detection,
    usual: ReadingEvidence,
    opposed: ReadingEvidence,
    whole: ReadingEvidence,
) -> Verdict:
    """The verdict on `person` read with the exchange `kind`, from the evidences of the right
    reading: whatever is exchanged, a body and its mirror image fit equally well (a test shows it),
    so that nothing needs to be computed anew."""
    if kind == "whole":
        return weigh(person, whole, opposed, usual)
    reading = next(reading for reading in READINGS if reading.name == kind)
    here, there = (opposed, usual) if reading.opposed else (usual, opposed)
    return weigh(person, _turned(here, reading), _turned(there, reading), _turned(here, reading))


def _turned(evidence: ReadingEvidence, reading: Reading) -> ReadingEvidence:
    arms = evidence.arms[:, :: 1 - 2 * reading.arms]
    legs = evidence.legs[:, :: 1 - 2 * reading.legs]
    return evidence._replace(arms=arms, legs=legs)


class Evidences(NamedTuple):
    """Of a person as read, with shoulders exchanged, and with everything exchanged."""

    usual: ReadingEvidence
    opposed: ReadingEvidence
    whole: ReadingEvidence


def evidences(judge: Judge, person: Detection) -> Evidences:
    """Raises `BadInput` where too little of the torso is seen."""
    parts = ((), ("shoulder",), BODY)
    return Evidences(*(judge.evidence(exchanged(person, *names)) for names in parts))


def exchanges(person: Detection, found: Evidences) -> dict[str, Verdict]:
    """Verdicts on the right reading and on every exchange within the body."""
    kinds = (*(reading.name for reading in READINGS), "whole")
    right = {READ_RIGHT: weigh(person, *found)}
    return right | {kind: seen_as(kind, person, *found) for kind in kinds}


def others(judge: Judge, view: FileView, found: Evidences) -> dict[str, Verdict]:
    """Verdicts on mistakes that are no exchange: mirrored images, other orders, other sizes."""
    mirror = mirrored(view.detection, 0)
    upside = mirrored(view.detection, 1)
    opposite = judge.evidence(exchanged(mirror, *BODY))
    verdicts = {
        "mirrored": weigh(mirror, judge.evidence(mirror), found.opposed, opposite),
        "upside down": weigh(upside, judge.evidence(upside), found.opposed, found.usual),
        "order": judge.verdict(_read_as(view.points, H36M_17)),
        "reversed": judge.verdict(_read_as(view.points[::-1], COCO_17)),
    }
    wide = {factor: judge.evidence(stretched(view.detection, factor)) for factor in ASPECTS}
    verdicts["right, size open"] = weigh(view.detection, *found, list(wide.values()))
    for factor, evidence in wide.items():
        three = (evidence, evidence, evidence)
        verdicts[f"x{factor:.2f}"] = weigh(view.detection, *three, [found.usual])
    return verdicts


@dataclasses.dataclass
class Study:
    """Verdicts by kind of mistake, and in the same order the views' angles and by how much the
    evidence of a body differs from that of its mirror image."""

    verdicts: dict[str, list[Verdict]]
    angles: list[float]
    asymmetry: list[float]


def study(judge: Judge, scenes: Iterator[FileView], first: int) -> Study:
    """Judges every view; of the `first` ones also the mistakes that are no exchange."""
    result = Study({}, [], [])
    for number, view in enumerate(scenes):
        found = evidences(judge, view.detection)
        result.angles.append(view.angle)
        result.asymmetry.append(found.whole.body(0, 0) - found.usual.body(0, 0))
        verdicts = exchanges(view.detection, found)
        if number < first:
            verdicts |= others(judge, view, found)
        for kind, verdict in verdicts.items():
            result.verdicts.setdefault(kind, []).append(verdict)
        if number % 50 == 49:
            print(number + 1, flush=True)
    return result
