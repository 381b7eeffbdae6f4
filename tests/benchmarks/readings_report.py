"""How often a wrong reading of a file is noticed, and a right one doubted: writes
reports/readings.md and its picture.

    python -m tests.benchmarks.readings_report ../shared/data

Poses of CMU motion capture (eight kinds of action), cameras all around them, detector's noise, a
face whose points are found where they are in view; each wrong reading of the same file; and real
detections, read rightly and wrongly."""

import dataclasses
import itertools
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from inference.face import POINTS
from inference.readings import (
    ASPECTS,
    BODY,
    FACE_THRESHOLD,
    READINGS,
    THRESHOLD,
    Evidence,
    Judge,
    Reading,
    Verdict,
    exchanged,
    stretched,
    together,
    weigh,
)
from probmodel import Anatomy, BadInput, Detection, PoseModel, read_detections
from probmodel.body import body_unit
from probmodel.detections import FACE
from probmodel.layouts import COCO_17, H36M_17, Layout
from probmodel.motion import read_motion
from probmodel.skeleton import JOINT_INDEX, JOINTS
from tests.scenes import camera

FRESH = 200
"""Poses of another seed, for the thresholds were chosen on the first."""
POSES, OTHERS = 500, 150
"""Poses in all, and those that are also misread in ways that are no exchange."""
NOISE = 0.08
"""Body units (2.6 cm): MMPose's joints lie so far from COCO's annotation on the one image that both
are of."""
FACE_NOISE = 0.03
CHIN = 0.37
"""Body units from the end of the head down to the middle between the ears."""
MISTAKES = 0.03
"""How often a point of the face is found though hidden, or missed though in view."""
BINS = (0, 30, 60, 90)
WORDS = {
    "arms": "arms exchanged",
    "legs": "legs exchanged",
    "limbs": "arms and legs exchanged",
    "halves": "upper body exchanged",
    "shoulders": "shoulders exchanged",
    "hips": "hips exchanged",
    "whole": "everything exchanged",
    "mirrored": "image mirrored",
    "upside down": "y counted upwards",
    "order": "COCO's 17 points read as Human3.6M's",
    "reversed": "COCO's 17 points read backwards",
    **{f"x{factor:.2f}": f"image {factor:.2f} times too wide" for factor in ASPECTS},
}


@dataclasses.dataclass(frozen=True)
class View:
    """A projected pose: the `detection`, its points `(17, 3)` in COCO's order, and degrees from a
    frontal view."""

    detection: Detection
    points: np.ndarray
    angle: float


def views(motions: Path, count: int, seed: int, noise: float = NOISE) -> Iterator[View]:
    """Poses of all kinds of action, from random sides."""
    joints = np.concatenate([motion.joints[::7] for motion in read_motion(motions)])
    rng = np.random.default_rng(seed)
    for pose in joints[rng.choice(len(joints), count, replace=False)]:
        body = (pose - pose[0]) / body_unit(pose[None])
        yield view_of(body, rng, noise)


def view_of(body: np.ndarray, rng: np.random.Generator, noise: float = NOISE) -> View:
    """`body` `(15, 3)` (body units) from a random side, tilted by up to 20°."""
    lens = camera(rng.uniform(0, 360), rng.uniform(-20, 20))
    left, up = body[12] - body[9], body[1] - body[0]
    axes = np.stack(
        [_unit(left - left @ _unit(up) * _unit(up)), _unit(up), _unit(np.cross(left, up))], axis=1
    )
    turn = Rotation.from_euler("YXZ", rng.normal(size=3) * np.radians([25, 15, 10])).as_matrix()
    head = axes @ turn
    centre = body[8] - CHIN * head[:, 1]
    face = centre + POINTS @ head.T
    outward = (face - centre) / np.linalg.norm(face - centre, axis=1, keepdims=True)
    towards = -(np.asarray(lens.rotation)[2] @ outward.T)
    found = (towards > -0.2) ^ (rng.random(len(FACE)) < MISTAKES)
    exact = dict(zip(JOINTS, np.asarray(lens.project(body)), strict=True))
    exact |= dict(zip(FACE, np.asarray(lens.project(face)), strict=True))
    points = np.array([[*exact[name], 0.8] for name in COCO_17.points])
    spread = np.where(np.isin(COCO_17.points, FACE), FACE_NOISE, noise)
    points[:, :2] += rng.normal(size=(17, 2)) * 100 * spread[:, None]
    for name, seen in zip(FACE, found, strict=True):
        points[COCO_17.points.index(name), 2] *= seen
    chest = np.asarray(lens.rotation) @ axes[:, 2]
    exact_detection = COCO_17.detection(points, 0.0, "a scene", 0)
    keypoints = np.array(
        exact_detection.keypoints
    )  # the skeleton's own thorax and pelvis, as a detector of them would
    for name in ("thorax", "pelvis"):
        keypoints[JOINT_INDEX[name]] = exact[name] + rng.normal(size=2) * 100 * noise
    detection = dataclasses.replace(exact_detection, keypoints=keypoints)
    return View(detection, points, float(np.degrees(np.arcsin(min(1.0, abs(chest[0]))))))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def mirrored(detection: Detection, axis: int, size: float = 640.0) -> Detection:
    """x counted from the other side (axis 0), or y (axis 1)."""
    sign, shift = (
        np.where(np.arange(2) == axis, -1.0, 1.0),
        np.where(np.arange(2) == axis, size, 0.0),
    )
    face = detection.face
    if face is not None:
        face = np.column_stack([face[:, :2] * sign + shift, face[:, 2]])
    return dataclasses.replace(detection, keypoints=detection.keypoints * sign + shift, face=face)


def _read_as(points: np.ndarray, layout: Layout) -> Detection:
    points = np.array(points)
    points[:, 2] = 0.8
    return layout.detection(points, 0.0, "a scene", 0)


def seen_as(
    kind: str, person: Detection, usual: Evidence, opposed: Evidence, whole: Evidence
) -> Verdict:
    """The verdict on `person` read with the exchange `kind`, from the evidences of the right
    reading: whatever is exchanged, a body and its mirror image fit equally well (a test shows it),
    so that nothing needs to be computed anew."""
    if kind == "whole":
        return weigh(person, whole, opposed, usual)
    reading = next(reading for reading in READINGS if reading.name == kind)
    here, there = (opposed, usual) if reading.opposed else (usual, opposed)
    return weigh(person, _turned(here, reading), _turned(there, reading), _turned(here, reading))


def _turned(evidence: Evidence, reading: Reading) -> Evidence:
    arms, legs = (
        evidence.arms[:, :: 1 - 2 * reading.arms],
        evidence.legs[:, :: 1 - 2 * reading.legs],
    )
    return evidence._replace(arms=arms, legs=legs)


@dataclasses.dataclass
class Study:
    """Verdicts by kind of mistake ("right" for none), and the views' angles and symmetry errors in
    the same order."""

    verdicts: dict[str, list[Verdict]]
    angles: list[float]
    asymmetry: list[float]


def study(judge: Judge, scenes: Iterator[View], others: int) -> Study:
    """Judges every view; of the first `others` also the mistakes that are no exchange."""
    found = Study({}, [], [])
    for number, view in enumerate(scenes):
        usual, opposed, whole = (
            judge.evidence(exchanged(view.detection, *parts)) for parts in ((), ("shoulder",), BODY)
        )
        found.angles.append(view.angle)
        found.asymmetry.append(whole.body(0, 0) - usual.body(0, 0))
        rows = {"right": weigh(view.detection, usual, opposed, whole)}
        rows |= {
            kind: seen_as(kind, view.detection, usual, opposed, whole)
            for kind in (*(r.name for r in READINGS), "whole")
        }
        if number < others:
            mirror, upside = mirrored(view.detection, 0), mirrored(view.detection, 1)
            rows["mirrored"] = weigh(
                mirror, judge.evidence(mirror), opposed, judge.evidence(exchanged(mirror, *BODY))
            )
            rows["upside down"] = weigh(upside, judge.evidence(upside), opposed, usual)
            for kind, layout, points in (
                ("order", H36M_17, view.points),
                ("reversed", COCO_17, view.points[::-1]),
            ):
                rows[kind] = judge.verdict(_read_as(points, layout))
            wide = {factor: judge.evidence(stretched(view.detection, factor)) for factor in ASPECTS}
            rows["right, size open"] = weigh(
                view.detection, usual, opposed, whole, list(wide.values())
            )
            for factor, evidence in wide.items():
                rows[f"x{factor:.2f}"] = weigh(
                    view.detection, evidence, evidence, evidence, [usual]
                )
        for kind, verdict in rows.items():
            found.verdicts.setdefault(kind, []).append(verdict)
        if number % 50 == 49:
            print(number + 1, flush=True)
    return found


def share(verdicts: list[Verdict], people: int = 1) -> tuple[int, int]:
    """How many files of `people` are doubted, of how many."""
    files = [
        together(verdicts[start : start + people])
        for start in range(0, len(verdicts) - people + 1, people)
    ]
    return sum(bool(file.noticed) for file in files), len(files)


def percent(count: int, of: int) -> str:
    return f"{count / of:.1%} ({count} of {of})" if of else "–"


def table(found: Study) -> str:
    """Shares of doubted files by mistake, for files of one person, by view, and of ten."""
    heading = [
        "read",
        "one person",
        *(f"view {low}–{high}°" for low, high in itertools.pairwise(BINS)),
        "ten people",
    ]
    lines = ["| " + " | ".join(heading) + " |", "| --- " * len(heading) + "|"]
    for kind, verdicts in found.verdicts.items():
        row = [WORDS.get(kind, kind), percent(*share(verdicts))]
        for low, high in itertools.pairwise(BINS):
            inside = [
                v for v, angle in zip(verdicts, found.angles, strict=False) if low <= angle < high
            ]
            row.append(f"{share(inside)[0] / max(len(inside), 1):.1%}")
        lines.append("| " + " | ".join([*row, percent(*share(verdicts, 10))]) + " |")
    return "\n".join(lines)


def real_people(data: Path) -> list[Detection]:
    """The people of the data pack of whom enough is seen; of AlphaPose's twenty frames of one
    person the first."""
    folder = data / "detections"
    files = sorted(
        [
            *folder.glob("openpose/*.json"),
            folder / "coco" / "test_coco.json",
            *folder.glob("mmpose/*.json"),
            folder / "mediapipe" / "pose_landmarks.pbtxt",
        ]
    )
    people = [person for file in files for person in read_detections(file, image_size=(1000, 667))]
    return [*people, read_detections(folder / "alphapose" / "alphapose-results_halpe26.json")[0]]


def real_table(judge: Judge, people: list[Detection]) -> str:
    """How many real people are doubted, read rightly and wrongly."""
    verdicts: dict[str, list[Verdict]] = {}
    for person in people:
        try:
            usual, opposed, whole = (
                judge.evidence(exchanged(person, *parts)) for parts in ((), ("shoulder",), BODY)
            )
        except BadInput:
            continue  # too little of the torso is seen
        verdicts.setdefault("right", []).append(weigh(person, usual, opposed, whole))
        for kind in (*(reading.name for reading in READINGS), "whole"):
            verdicts.setdefault(kind, []).append(seen_as(kind, person, usual, opposed, whole))
    lines = ["| read | doubted | as |", "| --- | --- | --- |"]
    for kind, several in verdicts.items():
        noticed = Counter(name for verdict in several for name in verdict.noticed)
        said = ", ".join(f"{name} {count}" for name, count in noticed.most_common())
        lines.append(f"| {WORDS.get(kind, kind)} | {percent(*share(several))} | {said} |")
    return "\n".join(lines)


def picture(found: Study) -> Figure:
    """Gains of the right readings and of the wrong ones, by kind: where they overlap, nothing can
    be told."""
    kinds = ["whole", *(reading.name for reading in READINGS)]
    figure = Figure(figsize=(8, 4.2), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.add_subplot()
    for row, kind in enumerate(kinds):
        column = found.verdicts["right"][0].names.index(kind)
        right = np.array([verdict.gains[0, column] for verdict in found.verdicts["right"]])
        for values, colour, shift in ((right, "#0072B2", 0.17), (-right, "#D55E00", -0.17)):
            jitter = np.random.default_rng(row).uniform(-0.12, 0.12, len(values))
            axis.plot(
                np.clip(values, -60, 60), row + shift + jitter, ".", ms=2, color=colour, alpha=0.5
            )
    axis.axvline(THRESHOLD, ymin=1 / len(kinds), color="#222222", lw=0.8)
    axis.axvline(FACE_THRESHOLD, ymax=1 / len(kinds), color="#222222", lw=0.8)
    axis.set_xscale("symlog", linthresh=5)
    axis.set_yticks(range(len(kinds)), [WORDS[kind] for kind in kinds], fontsize=8)
    axis.set_xlabel(
        "nats by which the exchange explains one person better; right of the line a file is"
        " doubted",
        fontsize=8,
    )
    axis.set_title("Blue: read rightly. Orange: read with this exchange", loc="left", fontsize=9)
    return figure


def main(data: Path) -> None:
    """Runs the study and writes page and picture."""
    jax.config.update("jax_enable_x64", True)
    judge = Judge(PoseModel.from_anatomy(Anatomy.default()))
    found = study(judge, views(data / "cmu" / "actions_train.npz", POSES, seed=5), others=OTHERS)
    out = Path(__file__).parents[2] / "reports"
    picture(found).savefig(out / "readings.png")
    body = Path(__file__).with_name("readings_report.md").read_text(encoding="utf-8")
    spread = np.abs(found.asymmetry)
    fresh = study(judge, views(data / "cmu" / "actions_train.npz", FRESH, seed=6), others=0)
    facts = {
        "TABLE": table(found),
        "FRESH_TABLE": table(fresh),
        "FRESH": str(FRESH),
        "OTHERS": str(OTHERS),
        "POSES": str(POSES),
        "REAL": real_table(judge, real_people(data)),
        "SYMMETRY": (
            f"{np.median(spread):.2f} nats in the median, {np.quantile(spread, 0.95):.1f} for 95 %"
        ),
    }
    for name, text in sorted(facts.items(), key=lambda fact: -len(fact[0])):
        body = body.replace(name, text)
        print(text, flush=True)
    (out / "readings.md").write_text(body, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
