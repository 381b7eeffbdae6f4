"""The priors of the root: what is believed of torso and camera before anything was seen.

`Candidates` are the paper's method: atoms that an estimator found, weighed by what the torso's
keypoints say. Under a `TorsoCameraPrior` they are as uncertain as the pose (docs/model.md § 9).
Under a `WorldPrior` cameras are calibrated, and the body has a size and a place in their world
(§ 11). A `Posterior` takes any of them, and all that differs between them stands here.
"""

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.probmodel.camera import Lens, WeakPerspective
from poseterior.probmodel.rig import CameraRig, PlacedBody
from poseterior.probmodel.roots import Candidate, Root, RootPoint, WorldPoint, WorldRoot
from poseterior.probmodel.skeleton import TORSO_INDEX

if TYPE_CHECKING:
    from poseterior.probmodel.model import PoseModel

CANDIDATES, UNCERTAIN, WORLD = "candidates", "uncertain", "world"
ROOT_PRIORS = (UNCERTAIN, CANDIDATES)
"""By their names; the first is the one that is meant where none is named."""
NEAREST = 1.5
"""Body units, half a metre: in perspective a pelvis is no nearer to the camera, measured along its
optical axis."""
MEDIAN_SIZE, SIZE_SD = 345.0, 0.1
"""What is believed of a person's mean limb bone: its median in mm, and the standard deviation of
its log. That of 1.7 m tall people is about 345 mm; nine of ten are taken to be within 16 %."""
NEAREST_PLACE = 4.0
"""The same of several calibrated cameras, 1.5 m. No joint of a person is as far from the pelvis, so
that none is behind a camera."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Candidates:
    """The paper's method: torso and camera are one of a few that an estimator found. A root is the
    number of its candidate. The usual way in is `of`.

    Attributes
    ----------
    roots
        Leaves start with n.
    torso : `(n,)`
        Their torsos' indices in the dictionary; -1 where they are not from there.
    log_weight : `(n,)`
        Log of their probabilities.
    """

    roots: Root
    torso: np.ndarray | jax.Array
    log_weight: np.ndarray | jax.Array
    name: ClassVar[str] = CANDIDATES
    base_measure: ClassVar[str] = "counting (candidate)"

    @classmethod
    def of(cls, candidates: Sequence[Candidate], log_weight: np.ndarray) -> "Candidates":
        """What an estimator found.

        Parameters
        ----------
        candidates
            Its roots.
        log_weight : `(n,)`
            Log of their probabilities, which need not be normalised.

        Returns
        -------
        Candidates
            The prior.
        """
        roots = [jax.tree.map(np.asarray, one.root) for one in candidates]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *roots)
        torso = np.array([one.torso_index for one in candidates])
        return cls(stacked, torso, log_weight - np.logaddexp.reduce(log_weight))

    def compose(self, step: Callable[[str, Any], Any]) -> Any:
        """The prior, written once: `step(site, law)` says what becomes of its only law."""
        from numpyro.distributions import CategoricalLogits

        # Not validated: a candidate may be impossible.
        return step("root", CategoricalLogits(jnp.asarray(self.log_weight), validate_args=False))

    def log_density(self, point: Any) -> jax.Array:
        """`()`: log probability of one candidate."""
        return jnp.asarray(self.log_weight)[point]

    def root(self, point: Any) -> Root:
        """The torso and camera of one candidate: a formula of JAX where its number is one."""
        xp = jnp if isinstance(point, jax.Array) else np
        return jax.tree.map(lambda leaf: xp.asarray(leaf)[point], self.roots)

    @property
    def people(self) -> int:
        """How many people it tells apart: none of an estimator's torsos is known to be of one."""
        return 1

    def points(self, point: Any) -> RootPoint:
        """Candidates `(n,)` as a point each."""
        camera = self.roots.camera
        log_scale = np.log(np.asarray(camera.scale))
        whole = RootPoint(self.torso, camera.rotation, log_scale, camera.translation)
        return whole.take(point)

    def sides(self, point: Any, candidates: Sequence[Candidate]) -> np.ndarray:
        """The candidate that each root is.

        Parameters
        ----------
        point : `(n,)`
            Roots.
        candidates
            The candidates themselves.

        Returns
        -------
        ndarray
            `(n,)`.
        """
        return np.asarray(point)

    def columns(self, point: Any) -> dict[str, np.ndarray]:
        """What results say of roots `(n,)`, by name."""
        return {"torso": np.asarray(self.torso)[point]}

    def point_of(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Roots from what results say of them."""
        return np.asarray(columns["candidate"])

    def error_of(self, candidate: Candidate) -> float:
        """What results say of the reprojection error of a side's camera: it is the candidate's."""
        return candidate.reprojection_error

    def counted(self, joints: Sequence[int]) -> list[int]:
        """The joints whose keypoints are detections under a root: the torso's have been heard where
        candidates were weighed."""
        return list(joints)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TorsoCameraPrior:
    """What is believed of torso and camera: the torso uniform over a dictionary, the rotation
    uniform on SO(3), or upright bodies more probable, log scale and translation flat.

    The last two have no total mass, but every seen joint contributes scale⁻² to the posterior,
    which is proper as soon as two seen joints lie apart. Base measure: counting (torso) × Haar's ×
    log scale × area of the image. With a `lens` the scale ends where the person is `NEAREST`; one
    whose focal length is not known is one of a few, equally probable (counting).

    Attributes
    ----------
    torsos : `(J, 6, 3)`
        Body axes, body units, pelvis at the origin.
    upright
        Concentration of `UprightRotation`.
    lens
        Of the camera, where something is known of it: roots then see in perspective.
    """

    torsos: np.ndarray | jax.Array
    upright: float | jax.Array = 0.0
    lens: Lens | None = None
    name: ClassVar[str] = UNCERTAIN
    base_measure: ClassVar[str] = (
        "counting (torso) x Haar's on SO(3) (1 in all) x log scale x image area (px2, translation)"
    )

    @classmethod
    def of(cls, model: "PoseModel") -> "TorsoCameraPrior":
        """What a model believes of torso and camera."""
        return cls(model.torsos, model.upright, model.lens)

    def compose(self, step: Callable[[str, Any], Any]) -> RootPoint:
        """The prior, written once: `step(site, law)` says what becomes of each law."""
        from numpyro.distributions import Categorical, ImproperUniform, constraints

        from poseterior.probmodel.anatomy.torsos import TorsoDictionary
        from poseterior.probmodel.rotations import UprightRotation
        from poseterior.probmodel.scales import FlatUpTo

        torso = step("torso", TorsoDictionary(self.torsos))
        rotation = step("rotation", UprightRotation(self.upright))
        lens = step("lens", Categorical(logits=jnp.zeros(self.lenses))) if self.lenses > 1 else None
        flat = ImproperUniform(constraints.real, (), ())
        scale = flat if self.lens is None else FlatUpTo(self.highest_log_scale(lens))
        return RootPoint(
            torso,
            rotation,
            step("log_scale", scale),
            step("translation", ImproperUniform(constraints.real_vector, (), (2,))),
            lens,
        )

    @property
    def people(self) -> int:
        """How many people the dictionary has."""
        return len(self.torsos)

    @property
    def lenses(self) -> int:
        """How many lenses there may be: one, unless the focal length is unknown."""
        return 1 if self.lens is None else self.lens.number

    def lens_of(self, index: Any) -> Lens | None:
        """The lens of that index (`RootPoint.lens`), if anything is known of it."""
        return None if self.lens is None else self.lens.at(index)

    def highest_log_scale(self, index: Any = None) -> jax.Array:
        """`()`: that of a person at `NEAREST` before such a lens; infinite where nothing is known
        of it."""
        lens = self.lens_of(index)
        return jnp.log(jnp.asarray(jnp.inf if lens is None else lens.focal) / NEAREST)

    def log_density(self, point: RootPoint) -> jax.Array:
        """`()`: log density of one root; -inf outside."""
        return _log_density(self, point)

    def root(self, point: RootPoint) -> Root:
        """The torso and camera of one root."""
        torso = jnp.asarray(self.torsos)[point.torso]
        scale = jnp.exp(jnp.asarray(point.log_scale))
        weak = WeakPerspective(scale, point.rotation, point.translation)
        return Root(torso, weak.through(self.lens_of(point.lens)))

    def points(self, point: RootPoint) -> RootPoint:
        """Roots of the prior as points: what they are."""
        return jax.tree.map(np.asarray, point)

    def sides(self, point: RootPoint, candidates: Sequence[Candidate]) -> np.ndarray:
        """For each root, the candidate whose camera is turned least against its own.

        Parameters
        ----------
        point
            Roots, leaves start with n.
        candidates
            An estimator's, which name the sides.

        Returns
        -------
        ndarray
            `(n,)`; 0 where there is no candidate.
        """
        cameras = [np.asarray(one.camera.rotation) for one in candidates] or [np.eye(3)]
        # The trace of a rotation falls with its angle.
        trace = np.einsum("nij,cij->nc", np.asarray(point.rotation), np.stack(cameras))
        return np.argmax(trace, axis=1)

    def columns(self, point: RootPoint) -> dict[str, np.ndarray]:
        """What results say of roots `(n, ...)`, by name."""
        return {
            "torso": np.asarray(point.torso),
            "rotation": np.asarray(point.rotation),
            "scale": np.exp(point.log_scale),
            "translation": np.asarray(point.translation),
            **({} if point.lens is None else {"lens": np.asarray(point.lens)}),
        }

    def point_of(self, columns: Mapping[str, np.ndarray]) -> RootPoint:
        """Roots from what results say of them."""
        torso, rotation, scale, translation = (
            np.asarray(columns[name]) for name in ("torso", "rotation", "scale", "translation")
        )
        lens = np.asarray(columns["lens"]) if self.lenses > 1 else None
        return RootPoint(torso, rotation, np.log(scale), translation, lens)

    def error_of(self, candidate: Candidate) -> float:
        """Of a side's mean camera there is no reprojection error."""
        return np.nan

    @staticmethod
    def counted(joints: Sequence[int]) -> list[int]:
        """The joints whose keypoints are detections under a root: the torso's with all others."""
        return sorted({*TORSO_INDEX, *joints})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WorldPrior:
    """What is believed of a body in the world of calibrated cameras: the torso uniform over a
    dictionary, the rotation uniform on SO(3), the size log-normal about the population's, the place
    flat in the images and in the log of the distance (`SeenPlace`).

    Where calibrations are not exact, every camera's image is shifted by a Gaussian. With one camera
    and none of that it is the `TorsoCameraPrior` of its lens, and an independent size.

    Attributes
    ----------
    torsos : `(J, 6, 3)`
        Body axes, body units, pelvis at the origin.
    rig
        The cameras.
    pointing : `(C, 2)`
        Standard deviations of the shifts, pixels; `(0, 2)` where calibrations are exact.
    """

    torsos: np.ndarray | jax.Array
    rig: CameraRig
    pointing: np.ndarray | jax.Array
    name: ClassVar[str] = WORLD
    base_measure: ClassVar[str] = (
        "counting (torso) x Haar's on SO(3) (1 in all) x log size x volume (mm3, place)"
        " x image area (px2, pointing of each camera, if uncertain)"
    )

    @classmethod
    def of(cls, model: "PoseModel", rig: CameraRig, pointing: float = 0.0) -> "WorldPrior":
        """What a model believes of a body before these cameras, which point by so many degrees
        beside where they should (standard deviation each way)."""
        shift = np.tan(np.radians(pointing)) * np.asarray(rig.focal)
        return cls(model.torsos, rig, np.tile(shift[:, None], 2) if pointing else np.zeros((0, 2)))

    def compose(self, step: Callable[[str, Any], Any]) -> WorldPoint:
        """The prior, written once: `step(site, law)` says what becomes of each law."""
        from numpyro.distributions import Normal

        from poseterior.probmodel.anatomy.torsos import TorsoDictionary
        from poseterior.probmodel.places import SeenPlace
        from poseterior.probmodel.rotations import UprightRotation

        torso = step("torso", TorsoDictionary(self.torsos))
        rotation = step("rotation", UprightRotation(0.0))
        log_size = step("log_size", Normal(jnp.log(MEDIAN_SIZE), SIZE_SD))
        place = step("place", SeenPlace(self.rig, NEAREST_PLACE * jnp.exp(jnp.asarray(log_size))))
        pointing = jnp.zeros((0, 2))
        if len(self.pointing):
            pointing = step("pointing", Normal(0.0, self.pointing).to_event(2))
        return WorldPoint(torso, rotation, log_size, place, pointing)

    @property
    def people(self) -> int:
        """How many people the dictionary has."""
        return len(self.torsos)

    def log_density(self, point: WorldPoint) -> jax.Array:
        """`()`: log density of one root; -inf outside."""
        return _log_density(self, point)

    def root(self, point: WorldPoint) -> WorldRoot:
        """The torso of one root, and the body before its cameras."""
        torso = jnp.asarray(self.torsos)[point.torso]
        size = jnp.exp(jnp.asarray(point.log_size))
        rig = self.rig.shifted(point.pointing)
        return WorldRoot(torso, PlacedBody(rig, point.rotation, size, point.place))

    def columns(self, point: WorldPoint) -> dict[str, np.ndarray]:
        """What results say of roots `(n, ...)`, by name."""
        return {
            "torso": np.asarray(point.torso),
            "rotation": np.asarray(point.rotation),
            "size": np.exp(point.log_size),
            "place": np.asarray(point.place),
        } | ({"pointing": np.asarray(point.pointing)} if len(self.pointing) else {})

    @staticmethod
    def counted(joints: Sequence[int]) -> list[int]:
        """The joints whose keypoints are detections under a root: the torso's with all others."""
        return sorted({*TORSO_INDEX, *joints})


RootPrior = Candidates | TorsoCameraPrior


def _log_density(prior: TorsoCameraPrior | WorldPrior, point: RootPoint | WorldPoint) -> jax.Array:
    """`()`: the sum over the sites of a prior, as `compose` has them."""
    terms: list[jax.Array] = []

    def step(site: str, law: Any) -> jax.Array:
        value = jnp.asarray(getattr(point, site))
        terms.append(law.log_prob(value))
        return value

    prior.compose(step)
    return functools.reduce(operator.add, terms)
