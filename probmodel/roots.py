"""Roots: a torso in front of a camera, and the candidates among which an estimator cannot choose.

Weak perspective leaves every torso a mirror twin (reflected in depth and turned) that projects to
nearly the same points; the limbs tell the two apart (docs/model.md § 6). Where the root is
uncertain, `RootPrior` says what is believed of it before anything was seen (§ 9).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.camera import Lens, Perspective, WeakPerspective

if TYPE_CHECKING:
    from poseterior.probmodel.model import PoseModel

NEAREST = 4.0
"""Body units, 1.5 m: where the focal length is known, a pelvis is no nearer to the camera, measured
along its optical axis. No joint of a person is as far from the pelvis, so that none is behind the
camera."""


class Root(NamedTuple):
    """A torso in front of a camera, a pytree.

    Attributes
    ----------
    torso : `(6, 3)`
        Body units, body axes, pelvis at the origin.
    camera
        The camera that sees it.
    """

    torso: np.ndarray | jax.Array
    camera: WeakPerspective | Perspective

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in camera axes."""
        return self.camera.view(self.torso)


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
    """

    torso: Any
    rotation: Any
    log_scale: Any
    translation: Any

    def take(self, rows: Any) -> "RootPoint":
        """Some of a batch."""
        return RootPoint(*(np.asarray(part)[rows] for part in self))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RootPrior:
    """What is believed of torso and camera: the torso uniform over a dictionary, the rotation
    uniform on SO(3), or upright bodies more probable, log scale and translation flat.

    The last two have no total mass, but every seen joint contributes scale⁻² to the posterior,
    which is proper as soon as two seen joints lie apart. Base measure: counting (torso) × Haar's ×
    log scale × area of the image. With a known `lens` the scale ends where the person is `NEAREST`.

    Attributes
    ----------
    torsos : `(J, 6, 3)`
        Body axes, body units, pelvis at the origin.
    upright
        Concentration of `UprightRotation`.
    lens
        Of the camera, where it is known: roots then see in perspective.
    """

    torsos: np.ndarray | jax.Array
    upright: float | jax.Array = 0.0
    lens: Lens | None = None

    @classmethod
    def of(cls, model: "PoseModel") -> "RootPrior":
        """What a model believes of torso and camera."""
        return cls(model.torsos, model.upright, model.lens)

    def compose(self, step: Callable[[str, Any], Any]) -> RootPoint:
        """The prior, written once: `step(site, law)` says what becomes of each law."""
        from numpyro.distributions import ImproperUniform, constraints

        from poseterior.probmodel.anatomy.torsos import TorsoDictionary
        from poseterior.probmodel.rotations import UprightRotation
        from poseterior.probmodel.scales import FlatUpTo

        flat = ImproperUniform(constraints.real, (), ())
        return RootPoint(
            step("torso", TorsoDictionary(self.torsos)),
            step("rotation", UprightRotation(self.upright)),
            step("log_scale", flat if self.lens is None else FlatUpTo(self.highest_log_scale)),
            step("translation", ImproperUniform(constraints.real_vector, (), (2,))),
        )

    @property
    def highest_log_scale(self) -> jax.Array:
        """`()`: that of a person at `NEAREST`; infinite where no focal length is known."""
        focal = jnp.inf if self.lens is None else self.lens.focal
        return jnp.log(jnp.asarray(focal) / NEAREST)

    def log_density(self, point: RootPoint) -> jax.Array:
        """`()`: log density of one root; -inf outside."""
        terms: list[jax.Array] = []

        def step(site: str, law: Any) -> None:
            terms.append(law.log_prob(jnp.asarray(getattr(point, site))))

        self.compose(step)
        return terms[0] + terms[1] + terms[2] + terms[3]

    def root(self, point: RootPoint) -> Root:
        """The torso and camera of one root."""
        torso = jnp.asarray(self.torsos)[point.torso]
        scale = jnp.exp(jnp.asarray(point.log_scale))
        weak = WeakPerspective(scale, point.rotation, point.translation)
        return Root(torso, weak.through(self.lens))
