"""How often the limbs' evidence says which way a person faces: writes reports/facing.md.

    python -m tests.benchmarks.facing_report ../shared/data

200 poses of motion capture, cameras all around them, keypoints drawn from the likelihood's discs;
torso and camera are estimated, both candidates kept. Right means that the candidate nearer to the
true facing has the larger share."""

import dataclasses
import itertools
import sys
from pathlib import Path

import jax
import numpy as np

import inference
from inference.results import COMPLETE
from probmodel import Anatomy, Detection, PoseModel
from probmodel.motion import read_motion
from probmodel.skeleton import TORSO_INDEX
from tests.scenes import motion_scene

POSES = 200
DRAWS = 200
NOISE = 5.0
"""Pixels at 100 pixels a body unit: 0.05 limb lengths, about 17 mm on a person of 1.7 m."""
BINS = (0, 15, 30, 45, 60, 75, 90)


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
    keypoints[list(TORSO_INDEX)] += rng.normal(size=(len(TORSO_INDEX), 2)) * NOISE
    return dataclasses.replace(detection, keypoints=keypoints)


def study(model: PoseModel, poses: np.ndarray, seed: int) -> list[dict]:
    """One row a pose: angle of the view, whether there were two candidates, the share of the right
    one."""
    rng = np.random.default_rng(seed)
    rows = []
    for number, joints in enumerate(poses):
        truth = motion_scene(joints, rng.uniform(0, 360), rng.uniform(-20, 20), seed + number)
        true = facing_of(joints, np.asarray(truth.candidates[0].camera.rotation))
        frame = inference.estimate_torso(
            disturbed(truth.detection, rng), torsos=np.asarray(model.torsos)
        )
        result = inference.sample(
            model, frame, key=jax.random.key(number), num_samples=DRAWS, max_proposals=30_000_000
        )
        nearest = int(np.argmax([candidate.facing @ true for candidate in frame.candidates]))
        rows.append(
            {
                # 0° is a view from the front or from behind, 90° one from the side.
                "angle": float(np.degrees(np.arcsin(min(1.0, abs(true[0]))))),
                "candidates": len(frame.candidates),
                "share": float(result.tree["constant_data"].weight.values[nearest]),
                "complete": result.status == COMPLETE,
                "apart": angle(frame.candidates[0].facing, frame.candidates[-1].facing),
                "first": nearest == 0,
            }
        )
    return rows


def table(rows: list[dict]) -> str:
    """The rows by view angle, as Markdown."""
    names = (
        "view, degrees from frontal",
        "poses",
        "two candidates",
        "apart (median)",
        "evidence right",
        "error right",
    )
    lines = ["| " + " | ".join(names) + " |", "| --- " * len(names) + "|"]
    for low, high in [*itertools.pairwise(BINS), (0, 90)]:
        inside = [row for row in rows if low <= row["angle"] <= high and row["complete"]]
        two = [row for row in inside if row["candidates"] == 2]
        if not two:
            continue
        right = sum(row["share"] > 0.5 for row in two)
        first = sum(row["first"] for row in two)
        name = "all" if (low, high) == (0, 90) else f"{low}–{high}"
        apart = np.median([row["apart"] for row in two])
        shares = (f"{count} of {len(two)} ({count / len(two):.0%})" for count in (right, first))
        lines.append(
            " | ".join(["| " + name, str(len(inside)), str(len(two)), f"{apart:.0f}°", *shares])
            + " |"
        )
    return "\n".join(lines)


def main(data: Path) -> None:
    """Runs the study under the published and the embedded limits, and writes the page."""
    jax.config.update("jax_enable_x64", True)
    motions = read_motion(data / "cmu" / "actions_train.npz")
    joints = np.concatenate([motion.joints[::7] for motion in motions])
    published = Anatomy.load(data / "akhter_black" / "jointAngleModel_v2.mat")
    poses = joints[np.random.default_rng(1).choice(len(joints), POSES, replace=False)]
    parts = [(__doc__ or "").split("\n\n")[0].split(":")[0] + "."]
    for anatomy in (published, Anatomy.default()):
        rows = study(PoseModel.from_anatomy(anatomy), poses, seed=7)
        lost = sum(not row["complete"] for row in rows)
        parts += [
            f"## {anatomy.limits.name} limits",
            table(rows),
            f"No pose was possible within the budget in {lost} of {POSES}.",
        ]
        print("\n\n".join(parts[-3:]), flush=True)
    body = Path(__file__).with_name("facing_report.md").read_text(encoding="utf-8")
    out = Path(__file__).parents[2] / "reports" / "facing.md"
    out.write_text(body.replace("TABLES", "\n\n".join(parts[1:])), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
