"""What a detector calls a shoulder, a hip, a thorax: how far in the torso's axes its points lie
from the skeleton's joints.

Several calibrated cameras triangulate the detector's own points; the torso of the population that
is laid over them, turned and moved as a whole, has the skeleton's joints. What is left in the mean
is the definition. A person's own proportions are in it: of few people it says no more than their
torsos differ from one another, which is what its spread has.
"""

from typing import NamedTuple

import numpy as np

from poseterior.probmodel.body import mean_torso
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.skeleton import MIRROR, NUM_JOINTS, TORSO_INDEX

_MIRRORED = [TORSO_INDEX.index(MIRROR[joint]) for joint in TORSO_INDEX]
_SIDEWAYS = np.array([-1.0, 1.0, 1.0])


class Definitions(NamedTuple):
    """Of a detector's points, body units and body axes (left, up, forward).

    Attributes
    ----------
    offset : `(15, 3)` from the skeleton's joints; 0 for those that are no torso's.
    scatter : `(15, 3)` standard deviation over the frames.
    frames : of how many.
    """

    offset: np.ndarray
    scatter: np.ndarray
    frames: int


def learn_definitions(session: Session, torsos: np.ndarray) -> Definitions:
    """The definitions of the detector of a session, the same left and right.

    Parameters
    ----------
    session
        Of calibrated cameras; its detections as the posterior will have them.
    torsos : `(J, 6, 3)`
        The population's, body units.

    Raises
    ------
    BadInput
        Where no frame shows the whole torso to two cameras.
    """
    points = session.world.points[:, list(TORSO_INDEX)] / session.unit
    points = points[np.isfinite(points).all(axis=(1, 2))]
    if not len(points):
        raise BadInput(
            f"no frame of {session.name} shows the whole torso to two cameras; definitions need one"
        )
    usual = mean_torso(torsos)
    left = np.stack([residual(usual, one) for one in points])
    offset, scatter = np.zeros((2, NUM_JOINTS, 3))
    mean = left.mean(axis=0)
    offset[list(TORSO_INDEX)] = (mean + (mean * _SIDEWAYS)[_MIRRORED]) / 2
    scatter[list(TORSO_INDEX)] = left.std(axis=0)
    return Definitions(offset, scatter, len(points))


def residual(torso: np.ndarray, points: np.ndarray) -> np.ndarray:
    """`(6, 3)`: what is left of points `(6, 3)` beside a torso `(6, 3)` that is turned and moved
    onto them, in the torso's axes."""
    centre, middle = torso.mean(axis=0), points.mean(axis=0)
    u, _, vt = np.linalg.svd((torso - centre).T @ (points - middle))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return (points - middle) @ turn.T - (torso - centre)
