"""Which draw of a frame goes on which draw of the frame before.

Frames are drawn one by one, and each keeps its draws: torsos, and by themselves the limbs, are put
into such an order that the rows of all frames are paths which move as little as can be. Every order
is an assignment that is best for its frame and the one before (Crouse 2016, as SciPy solves it).
A limb that goes to another torso goes to one like its own, and where it is seen in the image as
well as before.

Nothing is said of how errors of neighbouring frames hang together, which nobody knows well: errors
that last are the safe side, and under them a second frame says nothing that the first did not.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from poseterior.inference.films.parts import LIMB_BONES, Parts, PathBodies
from poseterior.probmodel.skeleton import BONES, TORSO_INDEX

OWN_TORSO, OWN_IMAGE = 0.25, 1.0
"""What weighs, beside a limb's own motion (squares of chords), that its torso is turned otherwise
(square of the angle), and that it falls elsewhere in the image (square, body units)."""


class Frame(NamedTuple):
    """The draws of a frame: their parts, and where their joints are `(n, 15, 3)`."""

    parts: Parts
    joints: np.ndarray


def coupled(frames: Iterable[Frame], body: PathBodies) -> list[Parts]:
    """Paths of bodies, whose frames are the draws of each in another order.

    Parameters
    ----------
    frames
        In the order of time.
    body
        Of each path.

    Returns
    -------
    list of Parts
        Of every frame, row by row of the `body`.
    """
    found: list[Parts] = []
    for frame in frames:
        found.append(_following(found[-1] if found else None, frame, body))
    return found


def _following(before: Parts | None, frame: Frame, body: PathBodies) -> Parts:
    drawn = frame.parts
    torso = np.arange(len(drawn.turn))
    if before is not None:
        torso = _assigned(_squares(before.turn, drawn.turn) / 2)
    turn, direction = drawn.turn[torso], np.empty_like(drawn.direction)
    own = OWN_TORSO / 2 * _squares(turn, drawn.turn)
    for bones in LIMB_BONES:
        cost = own + OWN_IMAGE * _beside(turn, body, frame, bones)
        if before is not None:
            cost += _squares(before.direction[:, bones], drawn.direction[:, bones])
        direction[:, bones] = drawn.direction[_assigned(cost)][:, bones]
    return Parts(turn, direction, drawn.place[torso])


def _assigned(cost: np.ndarray) -> np.ndarray:
    """The column of each row, at the least cost in all."""
    return linear_sum_assignment(cost)[1]


def _squares(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """`(n, n)`: squared distances between rows."""
    a, b = a.reshape(len(a), -1), b.reshape(len(b), -1)
    return (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None] - 2 * a @ b.T


def _beside(turn: np.ndarray, body: PathBodies, frame: Frame, bones: tuple[int, ...]) -> np.ndarray:
    """`(n, n)`: how far, squared, the ends of each draw's limb (columns) would lie beside where
    they are in its image, if it hung from each torso (rows)."""
    axes = np.einsum("nij,njk->nik", turn, body.axes[:, bones[0]])[:, :2]
    start = body.torso[:, TORSO_INDEX.index(BONES[bones[0]].start)]
    place = np.einsum("nij,nj->ni", turn[:, :2], start)[:, :, None]
    found = np.zeros((len(turn), len(turn)))
    for bone in bones:
        along = np.tensordot(axes, frame.parts.direction[:, bone], (2, 1))
        place = place - body.bone_length[:, bone, None, None] * along
        ends = frame.joints[:, BONES[bone].end, :2].T
        found += np.square(place - ends).sum(axis=1)
    return found
