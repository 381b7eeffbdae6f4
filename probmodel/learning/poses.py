"""Poses to learn from: recordings read, freed of glitches, thinned, and scaled to body units.

The usual way in: `read_all(paths)`, then `gather(motions)`."""

import os
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.body import body_unit, bone_vectors
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion import Motion, read_motion

LEARNING_RATE = 30.0
"""Frames a second that are learned from; neighbouring frames of 120 Hz capture say the same."""
Progress = Callable[[str, int, int], None]
"""Called with what is being done, steps done, and steps in all."""


class Poses(NamedTuple):
    """Poses of all subjects: `joints` `(N, 15, 3)` in body units, pelvis at the origin; `subject`
    `(N,)`, the index of each pose's subject."""

    joints: np.ndarray
    subject: np.ndarray


def read_all(
    paths: Sequence[str | os.PathLike],
    progress: Progress | None = None,
    *,
    names: Mapping[str, str] | None = None,
) -> list[Motion]:
    """All recordings of several files and folders of motion capture, and names of their joints, as
    `motion.read_motion` takes them."""
    motions: list[Motion] = []
    for done, path in enumerate(paths):
        if progress is not None:
            progress(f"reading {path}", done, len(paths))
        motions += read_motion(path, names=names)
    return motions


def usable(motions: Sequence[Motion]) -> list[Motion]:
    """The recordings without glitches and at `LEARNING_RATE`; those without a frame left are
    dropped.

    Raises
    ------
    BadInput
        Where no frame is left at all, or a bone has length zero.
    """
    cleaned = [motion.without_jumps().at_rate(LEARNING_RATE) for motion in motions]
    cleaned = [motion for motion in cleaned if len(motion.joints)]
    if not cleaned:
        raise BadInput(
            "the motion capture holds no usable frame; give recordings of at least a tenth of a"
            " second"
        )
    for motion in cleaned:
        if not (np.linalg.norm(bone_vectors(motion.joints), axis=-1) > 0).all():
            raise BadInput(
                f"the recording {motion.name} of subject {motion.subject} has a bone of length zero"
                " in a frame; leave that recording out"
            )
    return cleaned


def in_body_units(joints: np.ndarray) -> np.ndarray:
    """Poses `(N, 15, 3)` of one person, pelvis at the origin, limb bones of mean length one."""
    return (joints - joints[:, :1]) / body_unit(joints)


def gather(motions: Sequence[Motion]) -> Poses:
    """All usable poses; each subject is scaled by the mean limb length over its recordings."""
    by_subject: dict[str, list[np.ndarray]] = {}
    for motion in usable(motions):
        by_subject.setdefault(motion.subject, []).append(motion.joints)
    blocks = [in_body_units(np.concatenate(parts)) for parts in by_subject.values()]
    subject = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    return Poses(np.concatenate(blocks), subject)
