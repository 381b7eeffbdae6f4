"""The model: prior uniform on anatomically possible poses, likelihood uniform in discs, as NumPyro
programs.

`PoseModel.prior` and `PoseModel.posterior` are plain model functions: handlers, `Predictive`,
`log_density` and NumPyro's samplers work on them. Sites: torso, bone_length, upper, lower,
detection; deterministic: joints, keypoints. Base measure of every log density: counting (torso) ×
length (5) × surface of the sphere (9) × area of the image.

NumPyro, and the distributions that need it, are imported where a program is run or traced: kept
programs do without."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.anatomy.limits import AnatomicalLimits, cell_of
from poseterior.probmodel.anatomy.population import Anatomy, LengthPrior
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.kinematics import articulation, pose
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.programs import kept
from poseterior.probmodel.skeleton import BONES, NUM_LOWER

CELL_ARRAYS = 3
"""Arrays of `Cells`."""
LEAVES = ("limits", "lengths", "torsos", "cells", "hinges", "upright", "lens")
"""Fields of a `PoseModel` that hold arrays: its children as a pytree."""
LENGTH_OF_BONE = tuple(bone.length_group for bone in BONES)


@jax.tree_util.register_pytree_node_class
@dataclasses.dataclass(frozen=True, init=False)
class PoseModel:
    """The model of a pose, a pytree. Without arguments: the embedded limits, lengths and torsos,
    eqs. 7 and 8.

    Derived once: `cells`, the regions of the five upper bones (leaves start with 5), and `hinges`,
    those of the four lower bones in every cell of their parents (leaves start with 4 × 120 × 60; a
    cell without a plane has a hinge that nothing satisfies).

    Parameters
    ----------
    limits
        Which directions are possible.
    lengths
        The prior of bone lengths.
    torsos : `(J, 6, 3)`
        The dictionary of torsos, body axes, body units.
    upper
        The measure in which upper bones are uniform: "angle", eq. 7, or "area".
    lower
        That of lower bones: "area", eq. 8, or "box", the recipe inside the disc.
    upright
        Where torso and camera are uncertain: the concentration of the back about the vertical
        (`UprightRotation`); 0 for any rotation as probable as any other.
    lens
        Where torso and camera are uncertain: focal length and principal point, if they are known.

    Raises
    ------
    ValueError
        On another name of a measure.
    BadInput
        On a focal length that is not positive, or a principal point that is not one.
    """

    limits: AnatomicalLimits
    lengths: LengthPrior
    torsos: jax.Array
    cells: Cells
    hinges: Hinge
    upper: str
    lower: str
    upright: jax.Array
    lens: Lens | None

    def __init__(
        self,
        limits: AnatomicalLimits | None = None,
        lengths: LengthPrior | None = None,
        torsos: ArrayLike | None = None,
        *,
        upper: str = "angle",
        lower: str = "area",
        upright: float = 0.0,
        lens: Lens | None = None,
    ) -> None:
        if limits is None or lengths is None or torsos is None:
            embedded = Anatomy.default()
            limits = embedded.limits if limits is None else limits
            lengths = embedded.lengths if lengths is None else lengths
            torsos = embedded.torsos if torsos is None else torsos
        measures = _Measures(str(upper), str(lower))
        regions = _regions(limits, measures)
        # On the device as they are: `jnp.asarray` would compile a program for every shape.
        limits, lengths, torsos, tilt, lens = jax.device_put(
            (limits, lengths, torsos, float(upright), _checked(lens))
        )
        self._set(
            limits=limits,
            lengths=lengths,
            torsos=torsos,
            cells=Cells(*(*regions[:CELL_ARRAYS], measures.upper)),
            hinges=Hinge(*(*regions[CELL_ARRAYS:], measures.lower)),
            upper=measures.upper,
            lower=measures.lower,
            upright=tilt,
            lens=lens,
        )

    def _set(self, **fields: Any) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)  # the way to fill a frozen dataclass

    def tree_flatten(self) -> tuple[tuple, tuple[str, str]]:
        return tuple(getattr(self, name) for name in LEAVES), (self.upper, self.lower)

    @classmethod
    def tree_unflatten(cls, measures: tuple[str, str], children: tuple) -> "PoseModel":
        model = object.__new__(cls)
        upper, lower = measures
        model._set(**dict(zip(LEAVES, children, strict=True)), upper=upper, lower=lower)
        return model

    @classmethod
    def from_anatomy(cls, anatomy: Anatomy, **fields: Any) -> "PoseModel":
        """The model with the limits, lengths and torsos of one learned file.

        Parameters
        ----------
        anatomy
            What is learned.
        fields
            Others of `PoseModel`, by name.

        Returns
        -------
        PoseModel
            The model.
        """
        return cls(anatomy.limits, anatomy.lengths, anatomy.torsos, **fields)

    def seen_by(self, lens: Lens | None) -> "PoseModel":
        """The same model of people in front of another camera.

        Parameters
        ----------
        lens
            What is known of it; None for weak perspective.

        Returns
        -------
        PoseModel
            A copy that shares all tables.

        Raises
        ------
        BadInput
            On a focal length that is not positive, or a principal point that is not one.
        """
        children, measures = self.tree_flatten()
        return self.tree_unflatten(measures, (*children[:-1], jax.device_put(_checked(lens))))

    def hinges_at(self, upper: ArrayLike) -> Hinge:
        """Regions of the four lower bones, given upper directions `(..., 5, 3)` (leaves start with
        `... × 4`)."""
        column, row = cell_of(jnp.asarray(upper)[..., 1:, :])
        return jax.tree.map(lambda leaf: leaf[jnp.arange(NUM_LOWER), column, row], self.hinges)

    def joints(
        self, torso: ArrayLike, length: ArrayLike, upper: ArrayLike, lower: ArrayLike
    ) -> jax.Array:
        """The joints of poses, in the axes of the torso.

        Parameters
        ----------
        torso : `(..., 6, 3)`
            In any axes; camera axes give joints in camera axes.
        length, upper, lower
            The pose, as in `Pose`.

        Returns
        -------
        Array
            `(..., 15, 3)`.
        """
        length = jnp.asarray(length)[..., jnp.array(LENGTH_OF_BONE)]
        reference, fallback = jnp.asarray(self.limits.reference), jnp.asarray(self.limits.fallback)
        return pose(torso, upper, lower, length, reference, fallback)

    def pose_of(self, joints: ArrayLike, length: ArrayLike) -> Pose:
        """The pose with given joints; the inverse of `joints`.

        Parameters
        ----------
        joints : `(..., 15, 3)`
            In any axes.
        length : `(..., 5)`
            Bone lengths.

        Returns
        -------
        Pose
            Lengths and directions.
        """
        reference, fallback = jnp.asarray(self.limits.reference), jnp.asarray(self.limits.fallback)
        parts = articulation(joints, reference, fallback)
        return Pose(jnp.asarray(length), parts.upper, parts.lower)

    def compose(self, step: Callable[[str, Any], jax.Array]) -> Pose:
        """The chain of the prior, lengths → upper → hinge → lower, written once.

        `step(site, law)` says what becomes of each law in turn (a draw, a quantile, a given value);
        the law of the lower bones is that below the upper directions which `step` returned.
        """
        from poseterior.probmodel.anatomy.lengths import BoneLength
        from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection

        length = step("bone_length", BoneLength(self.lengths))
        upper = step("upper", OccupiedDirection(self.cells))
        return Pose(length, upper, step("lower", HingedDirection(self.hinges_at(upper))))

    def draw(self, key: jax.Array, number: int) -> Pose:
        """Poses of the prior.

        Parameters
        ----------
        key
            Of the draws.
        number
            How many.

        Returns
        -------
        Pose
            Leaves start with `number`.
        """
        keys = iter(jax.random.split(key, 3))

        def step(site: str, law: Any) -> jax.Array:
            return law.sample(next(keys), () if site == "lower" else (number,))

        return self.compose(step)

    def prior(self) -> jax.Array:
        """NumPyro model: a pose in body axes, body units; returns the joints `(15, 3)`."""
        import numpyro

        from poseterior.probmodel.anatomy.torsos import TorsoDictionary

        index = numpyro.sample("torso", TorsoDictionary(self.torsos))
        return self._pose(jnp.asarray(self.torsos)[index])

    def posterior(self, observation: Observation) -> jax.Array:
        """NumPyro model: a pose in camera axes that explains the detection, given its root.

        Draw new keypoints from it by `numpyro.handlers.uncondition`.
        """
        joints = self._pose(observation.view)
        observation.condition(joints)
        return joints

    def _pose(self, torso: jax.Array) -> jax.Array:
        import numpyro

        drawn = self.compose(lambda site, law: numpyro.sample(site, _whole(law)))
        return numpyro.deterministic("joints", self.joints(torso, *drawn))

    def log_prior(self, length: ArrayLike, upper: ArrayLike, lower: ArrayLike) -> jax.Array:
        """Log density of poses, given the torso.

        Parameters
        ----------
        length, upper, lower
            The poses, as in `Pose`.

        Returns
        -------
        Array
            `(...)`.
        """
        given = {"bone_length": length, "upper": upper, "lower": lower}
        terms = []

        def step(site: str, law: Any) -> jax.Array:
            terms.append(_whole(law).log_prob(given[site]))
            return jnp.asarray(given[site])

        self.compose(step)
        return terms[0] + terms[1] + terms[2]

    @property
    def measures(self) -> dict[str, str]:
        """The named choices of measure, for the attributes of results."""
        return {"upper": self.upper, "lower": self.lower}


SHORTEST_FOCAL = 1.0
"""Pixels; before a shorter one, all that a person may do is seen within a few of them."""


def _checked(lens: Lens | None) -> Lens | None:
    """A lens as numbers. Raises `BadInput` where they cannot be those of one."""
    if lens is None:
        return None
    focal, principal = np.asarray(lens.focal, float), np.asarray(lens.principal, float)
    for one in focal.ravel().tolist():
        if not SHORTEST_FOCAL <= one <= LARGEST_NUMBER:  # false for NaN too
            raise BadInput(
                f"a focal length must be positive, from {SHORTEST_FOCAL:g} to"
                f" {LARGEST_NUMBER:g} pixels, not {one:g}"
            )
    if principal.shape != (2,) or not (np.abs(principal) <= LARGEST_NUMBER).all():
        raise BadInput(
            f"a principal point must be two finite numbers of pixels, not {principal.tolist()}"
        )
    return Lens(focal if focal.ndim else float(focal), principal)


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class _Measures:
    """The measures of upper and lower bones."""

    upper: str
    lower: str


@kept
def _regions(limits: AnatomicalLimits, measures: _Measures) -> tuple[jax.Array, ...]:
    """The arrays of `Cells`, then those of `Hinge`."""
    missing = jnp.isnan(jnp.asarray(limits.offset))
    triple = jnp.where(missing[..., None, None], jnp.eye(3), limits.triples())
    offset = jnp.where(missing, 2.0, jnp.asarray(limits.offset))
    bounds = jnp.where(missing[..., None], 0.0, jnp.asarray(limits.bounds))
    cells = Cells.build(limits.occupied, measures.upper)
    hinges = Hinge.build(triple, offset, bounds, measures.lower)
    return tuple(jax.tree.leaves((cells, hinges)))


def _whole(law: Any) -> Any:
    """The law of all bones together: their product."""
    return law.to_event(1) if law.batch_shape else law


@kept
def log_joint(
    model: PoseModel,
    observation: Observation,
    length: ArrayLike,
    upper: ArrayLike,
    lower: ArrayLike,
) -> jax.Array:
    """`(...)`: log joint density of poses `(length, upper, lower)` and the detection, given the
    root: that of the program `PoseModel.posterior`; -inf outside."""
    from numpyro.infer.util import log_density

    def one(length: jax.Array, upper: jax.Array, lower: jax.Array) -> jax.Array:
        sites = {"bone_length": length, "upper": upper, "lower": lower}
        return log_density(model.posterior, (observation,), {}, sites)[0]

    return jnp.vectorize(one, signature="(g),(u,x),(l,x)->()")(length, upper, lower)
