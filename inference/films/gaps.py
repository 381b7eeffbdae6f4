"""What becomes of a path where nobody was seen: it goes straight from one end of the gap to the
other, and strays from there as far as people do."""

import itertools
import math

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.inference.films.parts import Parts
from poseterior.probmodel.skeleton import BONES

GAP_SECONDS = (1 / 15, 2 / 15, 4 / 15, 8 / 15, 1.0, 2.0)
"""Lengths of gaps."""
STRAYING = {
    "head": (0.009, 0.017, 0.044, 0.11, 0.24, 0.40),
    "upper_arm": (0.015, 0.036, 0.105, 0.30, 0.53, 0.72),
    "forearm": (0.019, 0.053, 0.175, 0.45, 0.70, 0.85),
    "upper_leg": (0.018, 0.038, 0.100, 0.25, 0.43, 0.53),
    "lower_leg": (0.021, 0.052, 0.147, 0.31, 0.45, 0.52),
    "turn": (0.009, 0.016, 0.040, 0.10, 0.21, 0.44),
    "place": (0.009, 0.022, 0.069, 0.19, 0.37, 0.79),
}
"""How far people are in the middle of gaps from where a straight way would lead: root mean squares
of chords of directions, radians of the torso's turn, and body units of the pelvis's place; CMU
motion capture, 26,000 frames of three subjects and of eight classes of action. Of longer gaps no
more is known than of the longest."""
_BENDS = ((1, 1.0), (2, 0.5))
"""Half waves over a gap, and their sizes."""


def straying(what: str, seconds: float) -> float:
    """`STRAYING` of a gap of any length."""
    return math.exp(np.interp(math.log(seconds), np.log(GAP_SECONDS), np.log(STRAYING[what])))


def filled(parts: Parts, seen: np.ndarray, rate: float, random: np.random.Generator) -> Parts:
    """Paths `(frames, n)` with their gaps filled: what is not `seen` `(frames,)` is overwritten.
    The first and the last frame are seen."""
    for before, after in itertools.pairwise(np.flatnonzero(seen).tolist()):
        if after - before > 1:
            _fill(parts, before, after, rate, random)
    return parts


def _fill(parts: Parts, before: int, after: int, rate: float, random: np.random.Generator) -> None:
    way = (np.arange(before + 1, after) - before) / (after - before)
    ends = Parts(*(part[[before, after]] for part in parts))
    straight = ends.over_time(lambda part: _between(part, way))
    inside, seconds = slice(before + 1, after), (after - before) / rate

    def astray(what: str, size: int, like: tuple[int, ...]) -> np.ndarray:
        waves = np.stack([share * np.sin(math.pi * half * way) for half, share in _BENDS])
        bends = random.standard_normal((len(_BENDS), *like))
        return straying(what, seconds) / math.sqrt(size) * np.tensordot(waves, bends, (0, 0))

    n = parts.place.shape[1]
    turned = Rotation.from_rotvec(astray("turn", 3, (n, 3)).reshape(-1, 3)).as_matrix()
    parts.turn[inside] = turned.reshape(len(way), n, 3, 3) @ straight.turn
    parts.place[inside] = straight.place + astray("place", 3, (n, 3))
    names = [bone.name.removeprefix("right_").removeprefix("left_") for bone in BONES]
    bent = np.stack([astray(name, 2, (n, 3)) for name in names], axis=2)
    direction = straight.direction + bent
    parts.direction[inside] = direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def _between(ends: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Straight ways from the first to the second of two."""
    return ends[0] + np.multiply.outer(way, ends[1] - ends[0])
