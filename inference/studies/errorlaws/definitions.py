"""What a detector calls the torso's joints, as offsets from the skeleton's in the torso's own axes:
an image cannot say "a hip is farther out", since left and right change places when people turn.

    definitions_of_data(data)          from how errors turn with people, where the truth is known
    definitions_of_session(session)    from triangulated joints beside the torso that explains them
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.errorlaws.learn import jackknife_groups
from poseterior.inference.studies.errorlaws.pairs import size_of
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.body import align_torsos, mean_torso
from poseterior.probmodel.datasets import DataSet
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.layouts import MIDPOINTS
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX

GIRDLES = [JOINT_INDEX[name] for pair in MIDPOINTS.values() for name in pair]
"""Shoulders and hips."""
WIDEST_DEFINITION = 0.3
"""Body units, the standard deviation of what is believed of an offset before anything is seen: it
decides where people are seen from one side only."""
OFFSET_FREEDOM, OFFSET_ROUNDS = 4.0, 30
"""Degrees of freedom of the Student's t by which offsets are fitted, so that outliers count for
little; and rounds until its weights come to rest."""
FEWEST_FRAMES = 10
"""With a whole torso."""


class Definitions(NamedTuple):
    """Where a detector's points lie beside the skeleton's joints.

    Attributes
    ----------
    mean : `(15, 3)`
        Body units, to the person's left, up and forward; 0 for limbs' joints.
    se : `(15, 3)`
        Standard errors, from leaving recordings, or stretches of one, out in turn.
    """

    mean: np.ndarray
    se: np.ndarray


def body_axes(data: DataSet) -> np.ndarray:
    """`(N, 3, 3)`: what turns the camera's axes into those of each person's torso."""
    torso = data.corrected(data.poses)[:, list(TORSO_INDEX)]
    return align_torsos(torso, mean_torso(Anatomy.default().torsos))


def definitions_of_data(data: DataSet) -> Definitions:
    """From detections beside their truth: of each joint of the torso the offset in the torso's
    axes, apart from a bias in the image's.

    Parameters
    ----------
    data
        Whose truth is exact.

    Returns
    -------
    Definitions
        Offsets that are known the worse, the fewer sides people are seen from.
    """
    size = size_of(data)
    exact = data.scale[:, None, None] * data.poses[..., :2] + data.translation[:, None]
    error = (data.keypoints - exact) / size[:, None, None]
    # Rows of least squares: the offset, seen from the front, and the bias in the image.
    turned = np.swapaxes(body_axes(data), 1, 2)[:, :2]
    rows = np.concatenate([turned, np.broadcast_to(np.eye(2), (len(error), 2, 2))], axis=2)

    def fitted(kept: np.ndarray) -> np.ndarray:
        found = np.zeros((NUM_JOINTS, 3))
        for joint in TORSO_INDEX:
            there = kept & np.isfinite(error[:, joint]).all(axis=-1)
            if there.sum() >= FEWEST_FRAMES:
                found[joint] = _offset(rows[there], error[there, joint])
        return found

    return _left_out(fitted, data.recording)


def seen_offsets(definitions: Definitions, data: DataSet) -> np.ndarray:
    """`(N, 15, 2)`: how far beside the joints of a data set, body units in the image, such
    definitions lie."""
    return np.einsum("nba,jb->nja", body_axes(data), definitions.mean)[..., :2]


def _offset(rows: np.ndarray, error: np.ndarray) -> np.ndarray:
    """`(3,)`: the offset that explains errors `(n, 2)` best, by rows `(n, 2, 5)`."""
    weight = np.ones(len(error))
    believed = np.diag([WIDEST_DEFINITION**-2] * 3 + [0.0] * 2)
    found = np.zeros(rows.shape[-1])
    for _ in range(OFFSET_ROUNDS):
        left = np.sum((error - rows @ found) ** 2, axis=1)
        variance = max(float(np.sum(weight * left) / (2 * len(left))), 1e-12)
        weight = (OFFSET_FREEDOM + 2) / (OFFSET_FREEDOM + left / variance)
        normal = np.einsum("n,nia,nib->ab", weight, rows, rows) + variance * believed
        found = np.linalg.solve(normal, np.einsum("n,nia,ni->a", weight, rows, error))
    return found[:3]


def definitions_of_session(session: Session) -> Definitions:
    """From calibrated cameras: shoulders and hips as all of them see them, beside those of the
    embedded torso that explains them best. Of the midpoint of all four nothing is learned: no truth
    says where in the body they are.

    Parameters
    ----------
    session
        Of one person.

    Returns
    -------
    Definitions
        Offsets of shoulders and hips.

    Raises
    ------
    BadInput
        Where too few frames show both shoulders and both hips.
    """
    points = session.world.points[:, GIRDLES] / session.unit
    whole = np.isfinite(points).all(axis=(1, 2))
    if whole.sum() < FEWEST_FRAMES:
        raise BadInput(
            f"{session.name} has {whole.sum()} frames with both shoulders and both hips, and"
            f" definitions need {FEWEST_FRAMES}; give more frames"
        )
    torsos = np.asarray(Anatomy.default().torsos)
    own = torsos[:, [TORSO_INDEX.index(joint) for joint in GIRDLES]]
    offsets = best_torso(points[whole], own)

    def fitted(kept: np.ndarray) -> np.ndarray:
        found = np.zeros((NUM_JOINTS, 3))
        found[GIRDLES] = offsets[kept].mean(axis=0)
        return found

    return _left_out(fitted, np.full(len(offsets), session.name))


def best_torso(points: np.ndarray, torsos: np.ndarray) -> np.ndarray:
    """`(n, k, 3)`: how far points `(n, k, 3)`, turned and moved onto that of the torsos
    `(J, k, 3)` that they fit best over all, lie from its joints, in its axes."""
    centred = points - points.mean(axis=1, keepdims=True)
    offsets = []
    for torso in torsos - torsos.mean(axis=1, keepdims=True):
        turn = align_torsos(centred, torso)
        offsets.append(np.einsum("nab,nkb->nka", turn, centred) - torso)
    return min(offsets, key=lambda one: float(np.sum(one**2)))


def _left_out(fitted: Callable[[np.ndarray], np.ndarray], recording: np.ndarray) -> Definitions:
    """What is `fitted` to all, with standard errors of what is fitted to the rest of groups."""
    groups = jackknife_groups(recording)
    number = groups.max() + 1
    parts = np.stack([fitted(groups != group) for group in range(number)])
    se = np.sqrt((number - 1) * np.var(parts, axis=0))
    return Definitions(fitted(np.full(len(groups), True)), se)
