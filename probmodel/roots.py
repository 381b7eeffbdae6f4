"""Roots: a torso in front of a camera, and the candidates among which an estimator cannot choose.

Weak perspective leaves every torso a mirror twin (reflected in depth and turned) that projects to
nearly the same points; the limbs tell the two apart (`docs/model.md`, § 6).
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from probmodel.camera import WeakPerspective


class Root(NamedTuple):
    """A torso in front of a camera, a pytree.

    Attributes
    ----------
    torso : `(6, 3)`, body units, body axes, pelvis at the origin.
    camera : the camera that sees it.
    """

    torso: np.ndarray | jax.Array
    camera: WeakPerspective

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in camera axes."""
        return self.camera.view(self.torso)


@dataclass(frozen=True)
class Candidate:
    """One root that an estimator proposes, and how it came about.

    Attributes
    ----------
    torso_index : index of the torso in the dictionary; -1 where it is not from there.
    torso : `(6, 3)`, body axes, body units.
    camera : the camera.
    reprojection_error : root mean square distance in pixels, weighted by score, between the seen
        torso joints and their projections.
    pose : `(15, 3)`, the estimator's single 3D pose: camera axes, body units, pelvis at the
        origin.
    objective : what the estimator minimised, in its own units.
    iterations : how many steps that took.
    converged : whether it came to an end; if not, this is the best estimate found.
    """

    torso_index: int
    torso: np.ndarray
    camera: WeakPerspective
    reprojection_error: float
    pose: np.ndarray | None = None
    objective: float = np.nan
    iterations: int = 0
    converged: bool = True

    @property
    def root(self) -> Root:
        """Torso and camera alone."""
        return Root(self.torso, self.camera)

    @property
    def facing(self) -> np.ndarray:
        """`(3,)`: the way the chest points, in camera axes (x right, y down, z away)."""
        return np.asarray(self.camera.rotation)[:, 2]
