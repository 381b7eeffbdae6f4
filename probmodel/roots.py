"""Roots: a torso in front of a camera, and the candidates among which an estimator cannot choose.

Weak perspective leaves every torso a mirror twin (reflected in depth and turned) that projects to
nearly the same points; the limbs tell the two apart (docs/model.md § 6). What is believed of roots
before anything was seen, `root_priors` say (§ 9).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from poseterior.probmodel.camera import Perspective, WeakPerspective
from poseterior.probmodel.rig import PlacedBody


class Root[Seen: (WeakPerspective | Perspective, PlacedBody)](NamedTuple):
    """A torso in front of a camera, or in the world of several; a pytree.

    Attributes
    ----------
    torso : `(6, 3)`
        Body units, body axes, pelvis at the origin.
    camera
        The camera that sees it, or the body before its cameras.
    """

    torso: np.ndarray | jax.Array
    camera: Seen

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in camera axes, or in the world's; body units."""
        return self.camera.view(self.torso)


WorldRoot = Root[PlacedBody]
"""That of a body in the world of several cameras."""


@dataclass(frozen=True)
class Candidate:
    """One root that an estimator proposes, and how it came about.

    Attributes
    ----------
    torso_index
        Index of the torso in the dictionary; -1 where it is not from there.
    torso : `(6, 3)`
        Body axes, body units.
    camera
        The camera.
    reprojection_error
        Root mean square distance in pixels, weighted by score, between the seen torso joints and
        their projections.
    pose : `(15, 3)`
        The estimator's single 3D pose: camera axes, body units, pelvis at the origin.
    objective
        What the estimator minimised, in its own units.
    iterations
        How many steps that took.
    converged
        Whether it came to an end; if not, this is the best estimate found.
    """

    torso_index: int
    torso: np.ndarray
    camera: WeakPerspective | Perspective
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


class RootPoint(NamedTuple):
    """A root as its prior has it, or a batch of them; a pytree.

    Attributes
    ----------
    torso : `(...)`
        Index into the dictionary.
    rotation : `(..., 3, 3)`
        From body axes to camera axes.
    log_scale : `(...)`
        Log of pixels per body unit.
    translation : `(..., 2)`
        Where the pelvis falls in the image, pixels.
    lens : `(...)`
        Index into the focal lengths that there may be; None where there are no two of them.
    """

    torso: Any
    rotation: Any
    log_scale: Any
    translation: Any
    lens: Any = None

    def take(self, rows: Any) -> "RootPoint":
        """Some of a batch."""
        return jax.tree.map(lambda part: np.asarray(part)[rows], self)


class WorldPoint(NamedTuple):
    """A body in the world as its prior has it, or a batch of them; a pytree.

    Attributes
    ----------
    torso : `(...)`
        Index into the dictionary.
    rotation : `(..., 3, 3)`
        From body axes to the world's axes.
    log_size : `(...)`
        Log of mm a body unit.
    place : `(..., 3)`
        Where the pelvis is, mm.
    pointing : `(..., C, 2)`
        Pixels by which every camera's image lies beside where its calibration has it; `(..., 0, 2)`
        where calibrations are exact.
    """

    torso: Any
    rotation: Any
    log_size: Any
    place: Any
    pointing: Any

    def take(self, rows: Any) -> "WorldPoint":
        """Some of a batch."""
        return WorldPoint(*(np.asarray(part)[rows] for part in self))


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotations nearest to matrices `(..., 3, 3)`, such as means of some, least squares."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., -1] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt
