"""Motion capture as a data set: poses evenly from its recordings, seen by synthetic cameras in
turn."""

from collections.abc import Sequence

import numpy as np

from poseterior.probmodel.datasets.cases import DataSet, body_height
from poseterior.probmodel.datasets.noise import EXACT, Noise
from poseterior.probmodel.datasets.views import CENTRE, VIEWS, View
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.rows import shares

RATE = 30.0
"""Frames a second that are chosen from; neighbouring frames of faster capture say the same."""


def action_of(motion: Motion) -> str:
    """A recording's action: its name up to a slash (`walking/walking_1`); trials without one are
    their subject's."""
    return motion.name.split("/")[0] if "/" in motion.name else f"subject {motion.subject}"


def from_motions(
    motions: Sequence[Motion],
    name: str,
    *,
    frames: int | None = None,
    views: Sequence[View] = VIEWS,
    noise: Noise = EXACT,
    seed: int = 0,
) -> DataSet:
    """Poses of recordings without their glitches, each seen by one of `views`, in turn; scores
    are 1.

    Parameters
    ----------
    motions, name
        The recordings, and what the data set is called.
    frames
        How many in all, the same number of each action, evenly over its frames; an action with
        fewer gives some of them twice, seen from elsewhere. By default every frame once.
    views
        The synthetic cameras.
    noise, seed
        The error of the detections, and its seed.

    Raises
    ------
    BadInput
        Where no frame is left.
    """
    clean = [motion.without_jumps().at_rate(RATE) for motion in motions]
    by_action: dict[str, list[Motion]] = {}
    for motion in clean:
        if len(motion.joints):
            by_action.setdefault(action_of(motion), []).append(motion)
    if not by_action:
        raise BadInput(
            f"{name} holds no usable frame; give recordings of at least a tenth of a second"
        )
    wanted = [None] * len(by_action) if frames is None else shares(frames, len(by_action))
    parts = [
        _chosen(by_action[action], number)
        for action, number in zip(sorted(by_action), wanted, strict=True)
    ]
    world = np.concatenate([poses for poses, _ in parts])
    source = [motion for _, many in parts for motion in many]
    count = len(world)
    # A pose that comes again, next in the row, must not meet the camera it had; neighbours do not
    # share one anyway.
    own = [views[number % len(views)] for number in range(count)]
    poses = np.stack([view.see(pose) for view, pose in zip(own, world, strict=True)])
    scale = np.array([view.scale for view in own])
    height = body_height(poses)
    errors = np.stack(
        [noise.errors(float(height[number]), seed, number) for number in range(count)]
    )
    return DataSet(
        name=name,
        poses=poses,
        keypoints=scale[:, None, None] * (poses[..., :2] + errors) + np.array(CENTRE),
        score=np.ones(poses.shape[:2]),
        scale=scale,
        translation=np.tile(CENTRE, (count, 1)),
        action=np.array([action_of(motion) for motion in source]),
        subject=np.array([motion.subject for motion in source]),
        recording=np.array([motion.name for motion in source]),
    )


def _chosen(motions: Sequence[Motion], number: int | None) -> tuple[np.ndarray, list[Motion]]:
    """`number` poses of an action, and the recording each is from."""
    poses = np.concatenate([motion.joints for motion in motions])
    owner = [motion for motion in motions for _ in range(len(motion.joints))]
    rows = (
        np.linspace(0, len(poses) - 1, len(poses) if number is None else number).round().astype(int)
    )
    return poses[rows], [owner[row] for row in rows]
