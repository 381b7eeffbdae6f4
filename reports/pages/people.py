"""Who is left out of what is learned."""

import functools
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from poseterior.probmodel import PoseModel
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.learning.learner import learn
from poseterior.probmodel.learning.poses import read_all
from poseterior.probmodel.motion import Motion

AGAIN = "walking/walking_1"
"""A recording of subject 02 under another name: whoever is left out, it is too."""
EVERYDAY, UNUSUAL = ("cmu/asfamc", "cmu/actions_train.npz", "bvh"), "cmu/extremes"
CAPTURED_FILES = (*EVERYDAY, UNUSUAL)
"""Of the embedded tables, in the data pack."""
HALVES = 2
"""In how many parts its people are judged."""


class Strangers(NamedTuple):
    """Recordings of people, and a model that was learned from everybody else."""

    model: PoseModel
    motions: list[Motion]


def without(motions: Sequence[Motion], subjects: Collection[str]) -> list[Motion]:
    """The recordings of everybody else."""
    return [one for one in motions if one.subject not in subjects and one.name != AGAIN]


@functools.cache
def strangers(work: Path, data: Path) -> tuple[Strangers, ...]:
    """All people of `UNUSUAL`, each part of them beside what was learned from all others; it is
    kept in `work`."""
    everyday, unusual = read_all([data / source for source in EVERYDAY]), read_all([data / UNUSUAL])
    people = list(dict.fromkeys(motion.subject for motion in unusual))
    found = []
    for part in range(HALVES):
        own, path = people[part::HALVES], work / f"limits-{part}.npz"
        if not path.exists():
            learn(without([*everyday, *unusual], own)).save(path)
        model = PoseModel.from_anatomy(Anatomy.load(path))
        found.append(Strangers(model, [one for one in unusual if one.subject in own]))
    return tuple(found)


def together(parts: Sequence[Strangers]) -> tuple[list[Motion], dict[str, PoseModel]]:
    """All recordings, and by subject the model that was learned without it."""
    motions = [motion for part in parts for motion in part.motions]
    return motions, {motion.subject: part.model for part in parts for motion in part.motions}
