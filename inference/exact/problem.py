"""What one root leaves of each limb: where its joints have to fall, seen from where the
limb starts.

Given the root, head, arms and legs are independent of each other, and the limbs of a
group share nothing but bone lengths. Everything here is in body units and 64 bits,
whatever JAX computes in.
"""

from collections.abc import Callable

import jax
import numpy as np

from poseterior.inference.exact.loops.tables import LimbProblem
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.kinematics import upper_axes
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.programs import kept
from poseterior.probmodel.skeleton import GROUPS, TORSO_INDEX, Limb

LogRatio = Callable[[GroupDraws], np.ndarray]
"""`(n,)`: for draws of a group, the log of the likelihood of its joints over its
peak."""


def limb_problems(observation: Observation) -> dict[str, tuple[LimbProblem, ...]]:
    """The problem of every limb, by group."""
    axes, plane = (np.array(part, float) for part in _torso(observation))  # copies: one type
    return limbs_of(axes, plane, np.asarray(observation.target, float), observation.reach)


def limbs_of(
    axes: np.ndarray, plane: np.ndarray, target: np.ndarray, reach: np.ndarray
) -> dict[str, tuple[LimbProblem, ...]]:
    """The problem of every limb, by group; everything in body units.

    Parameters
    ----------
    axes : `(5, 3, 3)`, local axes of the upper bones in camera axes.
    plane : `(6, 2)`, where the torso's joints fall.
    target : `(15, 2)`, where joints were detected.
    reach : `(15,)`, how far from there they may fall; infinite where a joint does not
        count.
    """
    start = dict(zip(TORSO_INDEX, plane, strict=True))
    found = {}
    for name, limbs in GROUPS.items():
        rows = []
        for limb in limbs:
            offset = np.zeros((2, 2))
            radius = np.full(2, np.inf)
            for row, bone in enumerate(limb.bones):
                if np.isfinite(reach[bone.end]):
                    offset[row] = target[bone.end] - start[limb.bones[0].start]
                    radius[row] = reach[bone.end]
            rows.append(LimbProblem(np.ascontiguousarray(axes[limb.upper]), offset, radius))
        found[name] = tuple(rows)
    return found


@kept
def _torso(observation: Observation) -> tuple[jax.Array, jax.Array]:
    """Local axes of the upper bones in camera axes, and the torso's joints on the
    plane."""
    view = observation.view
    return upper_axes(view), observation.root.camera.flatten(view)


def log_ratio_of(
    model: PoseModel, observation: Observation, limbs: tuple[Limb, ...]
) -> LogRatio | None:
    """What draws within reach of all their targets are thinned by; None where they
    follow the law as they are, so that all of them are kept."""
    if observation.law.follows(0.0):
        return None
    ends = [bone.end for limb in limbs for bone in limb.bones]

    def log_ratio(draws: GroupDraws) -> np.ndarray:
        poses = Pose.blank(len(draws.length))
        draws.fill(poses, limbs)
        rows = in_chunks(lambda *pose: log_ratios(model, observation, Pose(*pose)), *poses)
        return rows[:, ends].sum(axis=1)

    return log_ratio


@kept
def log_ratios(model: PoseModel, observation: Observation, poses: Pose) -> jax.Array:
    """`(n, 15)`: log of each joint's likelihood over its peak, for poses `(n, ...)`."""
    return observation.log_ratios(model.joints(observation.view, *poses))
