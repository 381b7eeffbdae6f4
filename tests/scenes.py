"""Scenes whose truth is known: poses of the prior or of motion capture, seen by a camera, with
their discs."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from probmodel.body import body_unit
from probmodel.camera import WeakPerspective
from probmodel.detections import Detection
from probmodel.likelihood import Likelihood
from probmodel.model import PoseModel
from probmodel.posterior import Estimate
from probmodel.roots import Candidate
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from probmodel.transport import CUBE_DIM, from_cube

UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""Turns axes (left, up, forward) into the camera's, the person facing the camera."""


def camera(yaw: float, tilt: float = 0.0, scale: float = 100.0) -> WeakPerspective:
    """A camera that sees the body turned by `yaw` and tilted by `tilt` degrees."""
    turn = Rotation.from_euler("yx", [yaw, tilt], degrees=True).as_matrix()
    return WeakPerspective(scale, UPRIGHT @ turn, np.array([320.0, 240.0]))


def scene(
    torso: np.ndarray,
    view: WeakPerspective,
    joints: np.ndarray,
    *,
    factor: float = 0.25,
    missing: tuple[str, ...] = ("head",),
    rng: np.random.Generator,
    scores: np.ndarray | None = None,
) -> Estimate:
    """A frame with one candidate, the truth: keypoints drawn from the discs around the projected
    `joints` `(15, 3)` (body axes, body units, pelvis at the origin)."""
    score = np.full(NUM_JOINTS, 0.8) if scores is None else scores.copy()
    score[[JOINT_INDEX[name] for name in missing]] = 0.0
    exact = np.asarray(view.project(joints))
    seen = score > 0
    blank = Detection(np.where(seen[:, None], exact, np.nan), score, "synthetic", "a scene", 0)
    likelihood = Likelihood(factor=factor)
    radius = likelihood.spread(blank, float(view.scale))
    radius = np.where(np.isfinite(radius), radius, 0.0)
    distance, angle = (
        radius * np.sqrt(rng.uniform(size=NUM_JOINTS)),
        rng.uniform(0, 2 * np.pi, NUM_JOINTS),
    )
    shifted = exact + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    detection = Detection(
        np.where(seen[:, None], shifted, np.nan), score, "synthetic", "a scene", 0
    )
    return Estimate(detection, (Candidate(0, torso, view, 0.0),), likelihood)


def prior_scene(model: PoseModel, seed: int, **options: object) -> Estimate:
    """A scene with a pose of the model's prior, seen from a random side."""
    rng = np.random.default_rng(seed)
    pose = from_cube(model, jnp.asarray(rng.uniform(size=CUBE_DIM)))
    torso = np.asarray(model.torsos)[rng.integers(len(model.torsos))]
    joints = np.asarray(model.joints(torso, *pose))
    return scene(
        torso, camera(rng.uniform(0, 360), rng.uniform(-30, 30)), joints, rng=rng, **options
    )


def motion_scene(
    joints: np.ndarray, yaw: float, tilt: float, seed: int, **options: object
) -> Estimate:
    """A scene with a pose of motion capture `(15, 3)` (Y up), its own torso and the true camera."""
    body = (joints - joints[0]) / body_unit(joints[None])
    return scene(
        body[list(TORSO_INDEX)], camera(yaw, tilt), body, rng=np.random.default_rng(seed), **options
    )


def key(seed: int) -> jax.Array:
    """A JAX key."""
    return jax.random.key(seed)
