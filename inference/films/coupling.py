"""Which draw of a frame goes on which draw of the frames before.

Frames are drawn one by one, and each keeps its draws: torsos, and by themselves the limbs, are put
into such an order that the rows of all frames are paths which move as little as can be from where
they were of late. Every order is an assignment that is best for its frame (Crouse 2016, as SciPy
solves it). A limb that goes to another torso goes to one like its own, and where it is seen in the
image as well as before.

Nothing is said of how errors of neighbouring frames hang together, which nobody knows well: errors
that last are the safe side, and under them a second frame says nothing that the first did not. But
where in its posterior the truth lies changes as the person moves, and paths change with it: they
forget where among the draws they were, within `LASTING` seconds.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from poseterior.inference.exact.groups import workers
from poseterior.inference.films.parts import LIMB_BONES, Parts, PathBodies
from poseterior.probmodel.skeleton import BONES, TORSO_INDEX

RECENT = 0.1
"""Seconds over which it is told where paths were of late. The means of many frames do not stray by
themselves, as single draws would, the more the fewer there are."""
LASTING = 0.5
"""Seconds in which paths forget. Chosen by captured people: intervals of changes over half a second
hold what they should (reports/films.md)."""
OWN_PLACE = 1.0
"""What weighs, beside half the squared chord of a torso's turn, where its pelvis was (square, body
units), as far as calibrated cameras know it."""
OWN_TORSO, OWN_IMAGE = 0.25, 1.0
"""What weighs, beside a limb's own motion (squares of chords), that its torso is turned otherwise
(square of the angle), and that it falls elsewhere in the image, or in the world (square, body
units)."""


class Frame(NamedTuple):
    """The draws of a frame: their parts, where their joints are `(n, 15, 3)`, and how many seconds
    after the frame before."""

    parts: Parts
    joints: np.ndarray
    after: float


def coupled(
    frames: Iterable[Frame],
    body: PathBodies,
    random: np.random.Generator,
    lasting: float = LASTING,
    in_world: bool = False,
) -> list[Parts]:
    """Paths of bodies, whose frames are the draws of each in another order.

    Parameters
    ----------
    frames
        In the order of time.
    body
        Of each path.
    random
        By which paths forget where among the draws they were.
    lasting
        Seconds within which they do.
    in_world
        Whether the frames are of calibrated cameras, which see in all three axes where people are.

    Returns
    -------
    list of Parts
        Of every frame, row by row of the `body`.
    """
    found: list[Parts] = []
    recent: Parts | None = None
    for frame in frames:
        if recent is not None:
            share = math.sqrt(2 * frame.after / lasting)
            recent = _astray(recent, found[-1], share, random, in_world)
        now = _following(recent, frame, body, in_world)
        found.append(now)
        old = 0.0 if recent is None else math.exp(-frame.after / RECENT)
        recent = Parts(
            *(old * was + (1 - old) * part for was, part in zip(recent or now, now, strict=True))
        )
    return found


def _astray(
    recent: Parts, now: Parts, share: float, random: np.random.Generator, in_world: bool
) -> Parts:
    """Where paths were, moved by a share of the differences between draws: of torsos, of each limb
    by itself, and of places if these are told paths by."""
    number = len(now.turn)

    def differences(part: np.ndarray) -> np.ndarray:
        one, other = random.permutation(number), random.permutation(number)
        return share / math.sqrt(2) * (part[one] - part[other])

    turn, direction = recent.turn + differences(now.turn), recent.direction.copy()
    for bones in LIMB_BONES:
        direction[:, bones] += differences(now.direction[:, bones])
    place = recent.place + differences(now.place) if in_world else recent.place
    return Parts(turn, direction, place)


def _following(recent: Parts | None, frame: Frame, body: PathBodies, in_world: bool) -> Parts:
    drawn = frame.parts
    torso = np.arange(len(drawn.turn))
    if recent is not None:
        apart = _squares(recent.turn, drawn.turn) / 2
        if in_world:
            apart += OWN_PLACE * _squares(recent.place, drawn.place)
        torso = _assigned(apart)
    turn, direction = drawn.turn[torso], np.empty_like(drawn.direction)
    own = OWN_TORSO / 2 * _squares(turn, drawn.turn)

    def hang(bones: tuple[int, ...]) -> None:
        cost = own + OWN_IMAGE * _beside(turn, body, frame, bones, 3 if in_world else 2)
        if recent is not None:
            cost += _squares(recent.direction[:, bones], drawn.direction[:, bones])
        direction[:, bones] = drawn.direction[_assigned(cost)][:, bones]

    for _ in workers().map(hang, LIMB_BONES):
        pass
    return Parts(turn, direction, drawn.place[torso])


def _assigned(cost: np.ndarray) -> np.ndarray:
    """The column of each row, at the least cost in all."""
    return linear_sum_assignment(cost)[1]


def _squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`(n, n)`: squared distances between rows."""
    a, b = a.reshape(len(a), -1), b.reshape(len(b), -1)
    return (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None] - 2 * a @ b.T


def _beside(
    turn: np.ndarray, body: PathBodies, frame: Frame, bones: tuple[int, ...], known: int
) -> np.ndarray:
    """`(n, n)`: how far, squared, the ends of each draw's limb (columns) would lie beside where
    they are along the `known` axes (two in an image), if it hung from each torso (rows)."""
    axes = np.einsum("nij,njk->nik", turn, body.axes[:, bones[0]])[:, :known]
    start = body.torso[:, TORSO_INDEX.index(BONES[bones[0]].start)]
    place = np.einsum("nij,nj->ni", turn[:, :known], start)[:, :, None]
    found = np.zeros((len(turn), len(turn)))
    for bone in bones:
        along = np.tensordot(axes, frame.parts.direction[:, bone], (2, 1))
        place = place - body.bone_length[:, bone, None, None] * along
        ends = frame.joints[:, BONES[bone].end, :known].T
        found += np.square(place - ends).sum(axis=1)
    return found
