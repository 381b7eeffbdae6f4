"""Scenes whose truth is known: a pose of the prior or of motion capture, seen by a camera, its
joints detected somewhere in their discs.

    prior_scene(model, seed)            one pose of the prior, from a random side
    prior_frames(model)                 the 64 of the benchmark of speed
    motion_frames(path)                 64 of motion capture
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.body import body_unit
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.datasets import View
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from poseterior.probmodel.transport import CUBE_DIM, from_cube

SCENE_CENTRE = (320.0, 240.0)
"""Pixels: where the pelvis is seen."""
SCORE = 0.8
HARDLY = 0.25
"""A low score."""
FORESHORTENED = range(100, 140)
"""Seeds of the scenes among which `foreshortened` chooses."""
ALL_BUT_AN_ARM = (
    "head",
    "left_elbow",
    "left_wrist",
    "right_knee",
    "left_knee",
    "right_ankle",
    "left_ankle",
)
"""Joints to leave out so that the right arm alone is seen."""
SCENES = 64
_MISSING = (
    (),
    (),
    ("right_wrist",),
    ("left_ankle",),
    (),
    (),
    ("left_elbow", "left_wrist"),
    ("right_knee", "left_wrist"),
)


def camera(yaw: float, tilt: float = 0.0, scale: float = 100.0) -> WeakPerspective:
    """A camera that sees a body turned by `yaw` and tilted by `tilt` degrees, facing it at 0, at
    `scale` pixels a body unit."""
    return WeakPerspective(scale, View(yaw, tilt).camera.rotation, np.array(SCENE_CENTRE))


def scene(
    torso: np.ndarray,
    view: WeakPerspective,
    joints: np.ndarray,
    *,
    rng: np.random.Generator,
    factor: float = 0.25,
    missing: tuple[str, ...] = ("head",),
    scores: np.ndarray | None = None,
) -> Estimate:
    """A frame whose one candidate is the truth, its keypoints uniform in the discs around the
    projected joints.

    Parameters
    ----------
    torso
        `(6, 3)`, as a candidate has it.
    view
        The camera.
    joints
        `(15, 3)`: body axes, body units, pelvis at the origin.
    rng
        Where keypoints come from.
    factor
        Of the radius τ.
    missing
        Names of joints that are not detected.
    scores
        `(15,)`; by default 0.8 each.
    """
    score = np.full(NUM_JOINTS, SCORE) if scores is None else scores.copy()
    score[[JOINT_INDEX[name] for name in missing]] = 0.0
    exact = np.asarray(view.project(joints))
    likelihood = Likelihood(factor=factor)
    radius = likelihood.spread(_detected(exact, score), float(view.scale))
    radius = np.where(np.isfinite(radius), radius, 0.0)
    distance = radius * np.asarray(likelihood.law.distance(rng.uniform(size=NUM_JOINTS)))
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    shift = distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    detection = _detected(exact + shift, score)
    return Estimate(detection, (Candidate(0, torso, view, 0.0),), likelihood)


def _detected(points: np.ndarray, score: np.ndarray) -> Detection:
    keypoints = np.where(score[:, None] > 0, points, np.nan)
    return Detection(keypoints, score, "synthetic", "a scene", 0)


def prior_scene(model: PoseModel, seed: int, **options: Any) -> Estimate:
    """A scene with a pose of the model's prior, seen from a random side; `options` are those of
    `scene`."""
    rng = np.random.default_rng(seed)
    pose = from_cube(model, jnp.asarray(rng.uniform(size=CUBE_DIM)))
    torso = np.asarray(model.torsos)[rng.integers(len(model.torsos))]
    joints = np.asarray(model.joints(torso, *pose))
    view = camera(rng.uniform(0, 360), rng.uniform(-30, 30))
    return scene(torso, view, joints, rng=rng, **options)


def low_scores() -> np.ndarray:
    """`(15,)`: wrists and ankles hardly seen, so that their discs are the widest."""
    score = np.full(NUM_JOINTS, SCORE)
    ends = (f"{side}_{end}" for side in ("left", "right") for end in ("wrist", "ankle"))
    score[[JOINT_INDEX[end] for end in ends]] = HARDLY
    return score


def foreshortened(model: PoseModel) -> Estimate:
    """Of forty scenes, the one whose seen limbs point most along the camera's axis."""
    pairs = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]
    starts, ends = (
        [JOINT_INDEX[f"{side}_{pair[end]}"] for side in ("left", "right") for pair in pairs]
        for end in (0, 1)
    )

    def apparent(frame: Estimate) -> float:
        keypoints = frame.detection.keypoints
        return float(np.linalg.norm(keypoints[ends] - keypoints[starts], axis=1).sum())

    return min((prior_scene(model, seed) for seed in FORESHORTENED), key=apparent)


def motion_scene(
    joints: np.ndarray, yaw: float, tilt: float, seed: int, **options: Any
) -> Estimate:
    """A scene with a pose of motion capture `(15, 3)` (y up), its own torso and the true camera;
    `options` are those of `scene`."""
    body = (joints - joints[0]) / body_unit(joints[None])
    rng = np.random.default_rng(seed)
    return scene(body[list(TORSO_INDEX)], camera(yaw, tilt), body, rng=rng, **options)


def hidden(index: int) -> tuple[str, ...]:
    """The joints that are not seen in frame `index` of the 64: none of the limbs' in every second
    frame, one or two in the others; the head is seen in every second pair."""
    return (*_MISSING[index % 8], *(("head",) if index % 4 < 2 else ()))


def prior_frames(model: PoseModel) -> list[Estimate]:
    """Poses of the prior, seeds 0 to 63, each from its own side."""
    return [prior_scene(model, seed, missing=hidden(seed)) for seed in range(SCENES)]


def motion_frames(path: Path) -> list[Estimate]:
    """Poses of motion capture, evenly over the archive at `path`, from all sides in turn."""
    joints = np.concatenate([motion.joints for motion in read_motion(path)])
    rows = np.linspace(0, len(joints) - 1, SCENES).astype(int)
    return [
        motion_scene(
            joints[row],
            yaw=360 * index * 0.618 % 360,
            tilt=(-20, 0, 20)[index % 3],
            seed=index,
            missing=hidden(index),
        )
        for index, row in enumerate(rows)
    ]
