"""Poses whose truth is known, and what is seen of them: drawn from the model itself, prior ×
likelihood.

Torso, camera, scores and missing joints are drawn anew for each simulation and then held fixed, as
the posterior holds them; they say nothing of the limbs, so the limbs' posterior given them is the
model's own."""

import functools
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from probmodel.camera import WeakPerspective
from probmodel.chunks import in_chunks
from probmodel.detections import Detection
from probmodel.likelihood import PAPER, Likelihood
from probmodel.model import PoseModel
from probmodel.posterior import Estimate
from probmodel.roots import Candidate
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from probmodel.transport import CUBE_DIM, from_cube

UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""Turns axes (left, up, forward) into the camera's, the person facing the camera."""
SCALE, MIDDLE = 100.0, np.array([320.0, 240.0])
TILT = 30.0
"""Degrees up and down from which the camera looks."""
LEAST_SCORE = 0.5
HIDDEN = (("head",), (), ("head", "right_wrist"), ("left_elbow", "left_wrist", "right_knee"))
"""Joints that are missing, in turn. Few patterns: some samplers are compiled for each."""
BLOCK = 50
"""Simulations made, and saved, at once."""


class Instance(NamedTuple):
    """What is seen of a person, and the truth behind it: the pose `joints` `(15, 3)`, pelvis at the
    origin, camera axes, in the body units of the frame's first candidate."""

    frame: Estimate
    joints: np.ndarray


def simulate(
    model: PoseModel, seed: int, first: int, number: int, *, likelihood: Likelihood = PAPER
) -> list[Instance]:
    """Simulations `first`, …, `first + number - 1` of a seed, each the same whichever others are
    made with it; `factor` is that of the radius τ."""
    rngs = [np.random.default_rng([seed, index]) for index in range(first, first + number)]
    cubes = np.stack([rng.uniform(size=CUBE_DIM) for rng in rngs])
    torsos = np.asarray(model.torsos)[[rng.integers(len(model.torsos)) for rng in rngs]]
    joints = in_chunks(functools.partial(_poses, model), cubes, torsos, size=BLOCK)
    return [
        _instance(pose, torso, HIDDEN[index % len(HIDDEN)], likelihood, rng)
        for index, pose, torso, rng in zip(
            range(first, first + number), joints, torsos, rngs, strict=True
        )
    ]


@jax.jit
def _poses(model: PoseModel, cube: jax.Array, torso: jax.Array) -> jax.Array:
    return model.joints(torso, *from_cube(model, cube))


def _instance(
    pose: np.ndarray,
    torso: np.ndarray,
    missing: tuple[str, ...],
    likelihood: Likelihood,
    rng: np.random.Generator,
) -> Instance:
    turn = Rotation.from_euler("yx", [rng.uniform(0, 360), rng.uniform(-TILT, TILT)], degrees=True)
    camera = WeakPerspective(SCALE, UPRIGHT @ turn.as_matrix(), MIDDLE)
    score = rng.uniform(LEAST_SCORE, 1.0, NUM_JOINTS)
    score[[JOINT_INDEX[name] for name in missing]] = 0.0
    detection = detected(np.asarray(camera.project(pose)), score, SCALE, likelihood, rng)
    candidate = Candidate(0, torso, camera, 0.0)
    return Instance(
        Estimate(detection, (candidate,), likelihood, estimator="truth"),
        np.asarray(camera.view(pose)),
    )


def detected(
    exact: np.ndarray,
    score: np.ndarray,
    scale: float,
    likelihood: Likelihood,
    rng: np.random.Generator,
    *,
    source: str = "simulation",
) -> Detection:
    """A detection by the likelihood: keypoints uniform in their discs around the projections
    `exact` `(15, 2)`, those of the torso too (estimators look at them); `scale` in pixels a body
    unit."""
    seen = score > 0
    where = "a pose"
    blank = Detection(np.where(seen[:, None], exact, np.nan), score, source, where, 0)
    spread = likelihood.spread(blank, scale)
    spread = np.where(np.isfinite(spread), spread, likelihood.factor * scale / 2)
    far, angle = (
        spread * np.asarray(likelihood.law.distance(rng.uniform(size=NUM_JOINTS))),
        rng.uniform(0, 2 * np.pi, NUM_JOINTS),
    )
    shifted = exact + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Detection(np.where(seen[:, None], shifted, np.nan), score, source, where, 0)
