"""Who is left out of what is learned."""

from collections.abc import Collection, Sequence

from poseterior.probmodel.motion import Motion

AGAIN = "walking/walking_1"
"""A recording of subject 02 under another name: whoever is left out, it is too."""


def without(motions: Sequence[Motion], subjects: Collection[str]) -> list[Motion]:
    """The recordings of everybody else."""
    return [one for one in motions if one.subject not in subjects and one.name != AGAIN]
