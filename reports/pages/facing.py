"""How often the limbs' evidence says which way a person faces: writes reports/facing.md.

    python -m poseterior.reports.pages.facing ../shared/data

200 poses of motion capture, cameras all around them, keypoints drawn from the likelihood's discs;
torso and camera are estimated, both candidates kept. Right means that the candidate nearer to the
true facing has the larger share.
"""

import dataclasses
import itertools
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior import inference
from poseterior.inference.draws import COMPLETE
from poseterior.inference.studies.scenes import motion_scene
from poseterior.probmodel import Anatomy, Detection, PoseModel
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import TORSO_INDEX
from poseterior.reports.pages.page import Data, Page, run
from poseterior.reports.tables import Column, Sheet, sheet_of

FACING_POSES = 200
FACING_DRAWS, FACING_BUDGET = 200, 30_000_000
FACING_NOISE = 5.0
"""Pixels at 100 pixels a body unit: 0.05 limb lengths, about 17 mm on a person of 1.7 m."""
ANGLE_BINS = (0, 15, 30, 45, 60, 75, 90)


class FacingRow(NamedTuple):
    """One pose.

    Attributes
    ----------
    angle
        Of the view, degrees: 0 from the front or from behind, 90 from the side.
    candidates
        How many there are.
    share
        Of the posterior, that of the candidate nearest to the truth.
    complete
        Whether there are enough draws.
    apart
        Degrees between the facings of the first and the last candidate.
    first
        Whether the candidate nearest to the truth has the least reprojection error.
    """

    angle: float
    candidates: int
    share: float
    complete: bool
    apart: float
    first: bool


def facing_of(joints: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The way the chest points, in camera axes: across the hips × up the back."""
    forward = np.cross(joints[12] - joints[9], joints[1] - joints[0])
    return rotation @ (forward / np.linalg.norm(forward))


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Degrees between two unit vectors."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def disturbed(detection: Detection, rng: np.random.Generator) -> Detection:
    """The detection with Gaussian noise on the torso joints; the limbs have theirs from the discs
    already."""
    keypoints = np.array(detection.keypoints)
    keypoints[list(TORSO_INDEX)] += rng.normal(size=(len(TORSO_INDEX), 2)) * FACING_NOISE
    return dataclasses.replace(detection, keypoints=keypoints)


def study(model: PoseModel, poses: np.ndarray, seed: int) -> list[FacingRow]:
    """Estimates torso and camera of every pose, and weighs the candidates."""
    rng = np.random.default_rng(seed)
    rows = []
    for number, joints in enumerate(poses):
        truth = motion_scene(joints, rng.uniform(0, 360), rng.uniform(-20, 20), seed + number)
        true = facing_of(joints, np.asarray(truth.best.camera.rotation))
        detection = disturbed(truth.detection, rng)
        frame = inference.estimate_torso(detection, torsos=np.asarray(model.torsos))
        result = inference.sample(
            model,
            frame,
            root=CANDIDATES,
            key=jax.random.key(number),
            num_samples=FACING_DRAWS,
            max_proposals=FACING_BUDGET,
        )
        nearest = int(np.argmax([candidate.facing @ true for candidate in frame.candidates]))
        rows.append(
            FacingRow(
                angle=float(np.degrees(np.arcsin(min(1.0, abs(true[0]))))),
                candidates=len(frame.candidates),
                share=float(result.tree["constant_data"].weight.values[nearest]),
                complete=result.status == COMPLETE,
                apart=angle(frame.best.facing, frame.candidates[-1].facing),
                first=nearest == 0,
            )
        )
    return rows


def table(rows: list[FacingRow]) -> Sheet:
    """The rows by view angle."""
    lines: list[tuple[Any, ...]] = []
    for low, high in [*itertools.pairwise(ANGLE_BINS), (0, 90)]:
        inside = [row for row in rows if low <= row.angle <= high and row.complete]
        two = [row for row in inside if row.candidates == 2]
        if two:
            name = "all" if (low, high) == (0, 90) else f"{low}–{high}"
            right = sum(row.share > 0.5 for row in two)
            first = sum(row.first for row in two)
            apart = float(np.median([row.apart for row in two]))
            lines.append((name, len(inside), len(two), apart, (right, len(two)), (first, len(two))))
    head = (
        "view, degrees from frontal",
        "poses",
        "two candidates",
        Column("apart (median)", form="{:.0f}°".format),
        Column("evidence right", form=_share),
        Column("error right", form=_share),
    )
    return sheet_of(head, lines)


def _share(counts: tuple[int, int]) -> str:
    count, whole = counts
    return f"{count} of {whole} ({count / whole:.0%})"


def section(anatomy: Anatomy, poses: np.ndarray) -> str:
    """What came out under some limits."""
    rows = study(PoseModel.from_anatomy(anatomy), poses, seed=7)
    lost = sum(not row.complete for row in rows)
    return "\n\n".join(
        [
            f"## {anatomy.limits.name} limits",
            table(rows).markdown(),
            f"No pose was possible within the budget in {lost} of {FACING_POSES}.",
        ]
    )


def main(data: Data) -> Page:
    """Runs the study under the published and the embedded limits, and writes the page."""
    motions = read_motion(data / "cmu" / "actions_train.npz")
    joints = np.concatenate([motion.joints[::7] for motion in motions])
    poses = joints[np.random.default_rng(1).choice(len(joints), FACING_POSES, replace=False)]
    published = Anatomy.load(data / "akhter_black" / "jointAngleModel_v2.mat")
    sections = [section(anatomy, poses) for anatomy in (published, Anatomy.default())]
    return Page("facing", {"sections": "\n\n".join(sections)})


if __name__ == "__main__":
    run(main)
