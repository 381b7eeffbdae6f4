"""Poses whose truth is known, and what is seen of them: drawn from the model itself, prior ×
likelihood.

Torso, camera, scores and missing joints are drawn anew for each simulation. Where the posterior
holds torso and camera fixed they say nothing of the limbs, so that any law of theirs will do.

Where the root is uncertain it has to come from its prior: torso uniform, rotation by Haar's
measure, or upright as the model believes. From flat priors of log scale and translation nothing can
be drawn; but the posterior moves and grows with the image (docs/model.md § 9), so any fixed
scale and place will do for questions whose answers do the same. Perspective does not: before a lens
both are drawn from a window (`LensWindow`), and the posterior is asked given that they lie in it.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.camera import Lens, Perspective, WeakPerspective
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import ORDERS, FaultPrior
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.roots import Candidate, RootPoint
from poseterior.probmodel.rotations import UprightRotation
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from poseterior.probmodel.transport import CUBE_DIM, from_cube

FACING_UPRIGHT = np.diag([1.0, -1.0, -1.0])
"""Turns axes (left, up, forward) into the camera's, the person facing the camera."""
SCALE, IMAGE_CENTRE = 100.0, np.array([320.0, 240.0])
NEAREST_SEEN, FARTHEST_SEEN, ASIDE = 3.0, 20.0, 0.2
"""Body units to people before a lens: at least, before the shortest of its focal lengths, and at
most, before the longest; and their places beside the optical axis at most, in focal lengths."""
TILT = 30.0
"""Degrees up and down from which the camera looks."""
LEAST_SCORE = 0.5
HIDDEN = (("head",), (), ("head", "right_wrist"), ("left_elbow", "left_wrist", "right_knee"))
"""Joints that are missing, in turn. Few patterns: some samplers are compiled for each."""
SIMULATIONS_PER_BLOCK = 50
"""Simulations made, and saved, at once."""


def _sideways(rng: np.random.Generator, model: PoseModel) -> np.ndarray:
    """A rotation under which an upright person is seen from some side."""
    turn = Rotation.from_euler("yx", [rng.uniform(0, 360), rng.uniform(-TILT, TILT)], degrees=True)
    return FACING_UPRIGHT @ turn.as_matrix()


def _believed(rng: np.random.Generator, model: PoseModel) -> np.ndarray:
    """A rotation of the model's prior."""
    if not model.upright:
        return Rotation.random(rng=rng).as_matrix()
    key = jax.random.key(int(rng.integers(2**32)))
    return np.asarray(UprightRotation(model.upright).sample(key))


ROTATIONS = {CANDIDATES: _sideways, UNCERTAIN: _believed}
"""How simulated people are turned, by what the posterior holds of the root."""


Spread = Callable[[np.ndarray, Likelihood], np.ndarray]
"""Scores `(15,)` and a likelihood → the spread `(15,)` of each joint's error, body units."""


class LensWindow(NamedTuple):
    """Where simulated people are seen by a lens: the prior, which is flat in the logarithm of the
    scale and in the place, is drawn within it.

    Attributes
    ----------
    low, high : `(3,)`
        Least and greatest log scale and translation.
    lens
        Before which.
    """

    low: np.ndarray
    high: np.ndarray
    lens: Lens

    @classmethod
    def of(cls, lens: Lens) -> "LensWindow":
        """That of a lens. Raises `BadInput` where its focal lengths lie too far apart for one."""
        focal, middle = np.atleast_1d(lens.focal), np.asarray(lens.principal)
        scale = np.log([np.max(focal) / FARTHEST_SEEN, np.min(focal) / NEAREST_SEEN])
        if scale[0] >= scale[1]:
            raise BadInput(
                f"focal lengths that differ by {np.max(focal) / np.min(focal):.3g} times cannot be"
                f" simulated together; {FARTHEST_SEEN / NEAREST_SEEN:.3g} times is the most"
            )
        aside = ASIDE * np.median(focal)
        low, high = np.append(scale[0], middle - aside), np.append(scale[1], middle + aside)
        return cls(low, high, lens)

    def draw(self, rng: np.random.Generator, rotation: np.ndarray) -> Perspective:
        """A camera of the prior."""
        several = self.lens.number > 1
        own = self.lens.at(int(rng.integers(self.lens.number)) if several else None)
        log_scale, *place = rng.uniform(self.low, self.high)
        weak = WeakPerspective(float(np.exp(log_scale)), rotation, np.array(place))
        return Perspective(weak, Lens(float(own.focal), np.asarray(own.principal)))

    def holds(self, points: RootPoint) -> np.ndarray:
        """`(n,)`: whether roots `(n, ...)` lie in it."""
        root = np.column_stack([points.log_scale, points.translation])
        return np.all((self.low <= root) & (root <= self.high), axis=1)


class Instance(NamedTuple):
    """What is seen of a person, and the truth behind it: the pose `joints` `(15, 3)`, pelvis at the
    origin, camera axes, in the body units of the frame's first candidate; `doubt` `(15, 15, 3, 3)`,
    the covariances of its own errors, where it has some (`probmodel.datasets.Case`)."""

    frame: Estimate
    joints: np.ndarray
    doubt: np.ndarray | None = None


def simulate(
    model: PoseModel,
    seed: int,
    first: int,
    number: int,
    *,
    likelihood: Likelihood = PAPER,
    root: str = CANDIDATES,
) -> list[Instance]:
    """Simulations `first`, …, `first + number - 1` of a seed, each the same whichever others are
    made with it, for posteriors with such a `root`. The frame's candidate is the true root.
    Where the likelihood has faults, so have detections."""
    rngs = [np.random.default_rng([seed, index]) for index in range(first, first + number)]
    cubes = np.stack([rng.uniform(size=CUBE_DIM) for rng in rngs])
    indices = [int(rng.integers(len(model.torsos))) for rng in rngs]
    torsos = np.asarray(model.torsos)[indices]
    joints = in_chunks(functools.partial(_poses, model), cubes, torsos, size=SIMULATIONS_PER_BLOCK)
    people = len(model.torsos) if root == UNCERTAIN else 1
    definitions = likelihood.definitions(people)
    window = None if model.lens is None else LensWindow.of(model.lens)
    some = []
    for row, (rng, index, torso) in enumerate(zip(rngs, indices, torsos, strict=True)):
        rotation = ROTATIONS[root](rng, model)
        camera: WeakPerspective | Perspective = WeakPerspective(SCALE, rotation, IMAGE_CENTRE)
        if window is not None:
            camera = window.draw(rng, rotation)
        missing = HIDDEN[(first + row) % len(HIDDEN)]
        candidate = Candidate(index, torso, camera, 0.0)
        pose = joints[row]
        points = pose if definitions is None else pose + definitions[index % len(definitions)]
        some.append(_instance(pose, points, candidate, missing, likelihood, SPREADS[root], rng))
    return some


@jax.jit
def _poses(model: PoseModel, cube: jax.Array, torso: jax.Array) -> jax.Array:
    return model.joints(torso, *from_cube(model, cube))


def _instance(
    pose: np.ndarray,
    points: np.ndarray,
    candidate: Candidate,
    missing: tuple[str, ...],
    likelihood: Likelihood,
    spread: Spread,
    rng: np.random.Generator,
) -> Instance:
    camera = candidate.camera
    score = rng.uniform(LEAST_SCORE, 1.0, NUM_JOINTS)
    score[[JOINT_INDEX[name] for name in missing]] = 0.0
    exact = np.asarray(camera.project(points))
    joints = np.asarray(camera.view(pose))
    unit = float(camera.scale) * np.asarray(camera.magnification(joints))
    biased = exact + unit[:, None] * likelihood.bias
    detection = detected(biased, score, unit * spread(score, likelihood), likelihood, rng)
    if likelihood.faults.any:
        detection = faulty(detection, exact, unit, likelihood.faults, rng)
    return Instance(Estimate(detection, (candidate,), likelihood, estimator="truth"), joints)


def _spread(score: np.ndarray, likelihood: Likelihood, joints: Sequence[int]) -> np.ndarray:
    keypoints = np.where(score[:, None] > 0, np.zeros((NUM_JOINTS, 2)), np.nan)
    blank = Detection(keypoints, score, "simulation", "a pose", 0)
    spread = likelihood.spread(blank, 1.0, joints)
    return np.where(np.isfinite(spread), spread, likelihood.factor / 2)


def limbs_spread(score: np.ndarray, likelihood: Likelihood) -> np.ndarray:
    """`(15,)` of each joint's error, body units, where the root is fixed. The joints that do not
    count, those of the torso, err by half the factor; estimators look at them."""
    return _spread(score, likelihood, likelihood.joints)


def joint_spread(score: np.ndarray, likelihood: Likelihood) -> np.ndarray:
    """`(15,)` of each joint's error, body units, where the root is uncertain: those of the torso
    have the same law as the limbs'."""
    return _spread(score, likelihood, sorted({*TORSO_INDEX, *likelihood.joints}))


SPREADS: dict[str, Spread] = {CANDIDATES: limbs_spread, UNCERTAIN: joint_spread}
"""How far detections stray, by what the posterior holds of the root."""


def detected(
    exact: np.ndarray,
    score: np.ndarray,
    spread: np.ndarray,
    likelihood: Likelihood,
    rng: np.random.Generator,
    *,
    source: str = "simulation",
) -> Detection:
    """A detection by the likelihood: keypoints around the projections `exact` `(15, 2)`, those of
    the torso too, with errors of the law at each joint's `spread` `(15,)`, in pixels; without
    faults."""
    far = spread * np.asarray(likelihood.law.distance(rng.uniform(size=NUM_JOINTS)))
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    shifted = exact + far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Detection(np.where(score[:, None] > 0, shifted, np.nan), score, source, "a pose", 0)


def faulty(
    detection: Detection,
    exact: np.ndarray,
    unit: np.ndarray,
    prior: FaultPrior,
    rng: np.random.Generator,
) -> Detection:
    """The detection with a pattern of faults of the prior: an exchanged keypoint strays from the
    other joint's projection as far as it strayed from its own, an outlier anywhere within reach;
    both as large as at the joint's depth, where a body unit has `unit` `(15,)` pixels."""
    seen = detection.score > 0
    key = jax.random.key(int(rng.integers(2**32)))
    faults = jax.tree.map(np.asarray, prior.draw(seen, key))
    order = ORDERS[faults.exchange]
    far = unit[order] * prior.reach * np.sqrt(rng.uniform(size=NUM_JOINTS))
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    astray = far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    near = (detection.keypoints - exact) * (unit[order] / unit)[:, None]
    off = np.where(faults.outlier[:, None], astray, near)
    keypoints = np.where(seen[:, None], exact[order] + off, np.nan)
    return dataclasses.replace(detection, keypoints=keypoints)
