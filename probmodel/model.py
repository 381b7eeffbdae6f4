"""The model: prior uniform on anatomically possible poses, likelihood uniform in discs, as NumPyro
programs.

`PoseModel.prior` and `PoseModel.posterior` are plain model functions: handlers, `Predictive`,
`log_density` and NumPyro's samplers work on them. Sites: torso, bone_length, upper, lower,
detection; deterministic: joints, keypoints. Base measure of every log density: counting (torso) ×
length (5) × surface of the sphere (9) × area of the image."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpyro
from jax.typing import ArrayLike
from numpyro.handlers import mask

from probmodel.anatomy.lengths import BoneLength, LengthPrior
from probmodel.anatomy.limits import AnatomicalLimits, cell_of
from probmodel.anatomy.population import Anatomy
from probmodel.anatomy.torsos import TorsoDictionary
from probmodel.directions.cells import Cells
from probmodel.directions.distributions import HingedDirection, OccupiedDirection
from probmodel.directions.hinges import Hinge
from probmodel.disc import UniformDisc
from probmodel.kinematics import pose
from probmodel.observation import Observation
from probmodel.skeleton import BONES, NUM_LOWER

LENGTH_OF_BONE = tuple(bone.length_group for bone in BONES)


@jax.tree_util.register_pytree_node_class
@dataclasses.dataclass(frozen=True, init=False)
class PoseModel:
    """The model of a pose, a pytree. Without arguments: the embedded limits, lengths and torsos,
    eqs. 7 and 8.

    `upper` is the measure of upper bones ("angle", eq. 7, or "area"), `lower` that of lower bones
    ("area", eq. 8, or "box", the recipe inside the disc); another name raises `ValueError`. Derived
    once: `cells`, the regions of the five upper bones (leaves start with 5), and `hinges`, those of
    the four lower bones in every cell of their parents (leaves start with 4 × 120 × 60; a cell
    without a plane has a hinge that nothing satisfies)."""

    limits: AnatomicalLimits
    lengths: LengthPrior
    torsos: jax.Array
    cells: Cells
    hinges: Hinge
    upper: str
    lower: str

    def __init__(
        self,
        limits: AnatomicalLimits | None = None,
        lengths: LengthPrior | None = None,
        torsos: ArrayLike | None = None,
        *,
        upper: str = "angle",
        lower: str = "area",
    ) -> None:
        if limits is None or lengths is None or torsos is None:
            embedded = Anatomy.default()
            limits = embedded.limits if limits is None else limits
            lengths = embedded.lengths if lengths is None else lengths
            torsos = embedded.torsos if torsos is None else torsos
        self._set(
            limits=jax.tree.map(jnp.asarray, limits),
            lengths=jax.tree.map(jnp.asarray, lengths),
            torsos=jnp.asarray(torsos),
            **_regions(limits, upper, lower),
            upper=upper,
            lower=lower,
        )

    def _set(self, **fields: Any) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)  # the way to fill a frozen dataclass

    def tree_flatten(self) -> tuple[tuple, tuple[str, str]]:
        return (self.limits, self.lengths, self.torsos, self.cells, self.hinges), (
            self.upper,
            self.lower,
        )

    @classmethod
    def tree_unflatten(cls, measures: tuple[str, str], children: tuple) -> "PoseModel":
        model = object.__new__(cls)
        limits, lengths, torsos, cells, hinges = children
        upper, lower = measures
        model._set(
            limits=limits,
            lengths=lengths,
            torsos=torsos,
            cells=cells,
            hinges=hinges,
            upper=upper,
            lower=lower,
        )
        return model

    @classmethod
    def from_anatomy(
        cls, anatomy: Anatomy, *, upper: str = "angle", lower: str = "area"
    ) -> "PoseModel":
        """The model with the limits, lengths and torsos of one learned file."""
        return cls(anatomy.limits, anatomy.lengths, anatomy.torsos, upper=upper, lower=lower)

    def hinges_at(self, upper: ArrayLike) -> Hinge:
        """Regions of the four lower bones, given upper directions `(..., 5, 3)` (leaves start with
        `... × 4`)."""
        column, row = cell_of(jnp.asarray(upper)[..., 1:, :])
        return jax.tree.map(lambda leaf: leaf[jnp.arange(NUM_LOWER), column, row], self.hinges)

    def joints(
        self, torso: ArrayLike, length: ArrayLike, upper: ArrayLike, lower: ArrayLike
    ) -> jax.Array:
        """Joints `(..., 15, 3)` in the axes of the `torso` `(..., 6, 3)`, from the lengths `(...,
        5)` and the local directions `(..., 5, 3)`, `(..., 4, 3)`."""
        length = jnp.asarray(length)[..., jnp.array(LENGTH_OF_BONE)]
        return pose(
            torso,
            upper,
            lower,
            length,
            jnp.asarray(self.limits.reference),
            jnp.asarray(self.limits.fallback),
        )

    def prior(self) -> jax.Array:
        """NumPyro model: a pose in body axes, body units; returns the joints `(15, 3)`."""
        index = numpyro.sample("torso", TorsoDictionary(self.torsos))
        return self._pose(jnp.asarray(self.torsos)[index])

    def posterior(self, observation: Observation) -> jax.Array:
        """NumPyro model: a pose in camera axes that explains the observation's keypoints, given its
        torso and camera.

        Draw new keypoints from it by `numpyro.handlers.uncondition`.
        """
        joints = self._pose(observation.view)
        keypoints = numpyro.deterministic("keypoints", observation.camera.image(joints))
        seen = observation.has_factor
        detected = jnp.where(seen[:, None], jnp.asarray(observation.keypoints), keypoints)
        radius = jnp.where(seen, jnp.asarray(observation.radius), 1.0)
        with numpyro.plate("joint", len(seen)), mask(mask=seen):
            numpyro.sample(
                "detection", UniformDisc(keypoints, radius, validate_args=False), obs=detected
            )
        return joints

    def _pose(self, torso: jax.Array) -> jax.Array:
        length = numpyro.sample("bone_length", BoneLength(self.lengths))
        upper = numpyro.sample("upper", OccupiedDirection(self.cells).to_event(1))
        lower = numpyro.sample("lower", HingedDirection(self.hinges_at(upper)).to_event(1))
        return numpyro.deterministic("joints", self.joints(torso, length, upper, lower))

    def log_prior(self, length: ArrayLike, upper: ArrayLike, lower: ArrayLike) -> jax.Array:
        """`(...)`: log density of lengths `(..., 5)` and directions `(..., 5, 3)`, `(..., 4, 3)`,
        the torso given."""
        log_prob = BoneLength(self.lengths).log_prob(length)
        log_prob = log_prob + OccupiedDirection(self.cells).log_prob(upper).sum(axis=-1)
        return log_prob + HingedDirection(self.hinges_at(upper)).log_prob(lower).sum(axis=-1)

    @property
    def measures(self) -> dict[str, str]:
        """The named choices of measure, for the attributes of results."""
        return {"upper": self.upper, "lower": self.lower}


@functools.partial(jax.jit, static_argnames=("upper", "lower"))
def _regions(limits: AnatomicalLimits, upper: str, lower: str) -> dict[str, Any]:
    missing = jnp.isnan(jnp.asarray(limits.offset))
    triple = jnp.where(missing[..., None, None], jnp.eye(3), limits.triples())
    offset = jnp.where(missing, 2.0, jnp.asarray(limits.offset))
    bounds = jnp.where(missing[..., None], 0.0, jnp.asarray(limits.bounds))
    return {
        "cells": Cells.build(limits.occupied, upper),
        "hinges": Hinge.build(triple, offset, bounds, lower),
    }


@jax.jit
def log_joint(
    model: PoseModel,
    observation: Observation,
    length: ArrayLike,
    upper: ArrayLike,
    lower: ArrayLike,
) -> jax.Array:
    """`(...)`: log joint density of poses (lengths `(..., 5)`, directions `(..., 5, 3)`, `(..., 4,
    3)`) and keypoints: the prior without the torso, times the discs; -inf outside."""
    inside = observation.explains(model.joints(observation.view, length, upper, lower))
    return model.log_prior(length, upper, lower) + jnp.where(
        inside, observation.log_disc_density, -jnp.inf
    )
