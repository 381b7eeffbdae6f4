"""What a sampler may ask of a target, frozen or not."""

from typing import Protocol

import numpy as np


class SamplerTarget(Protocol):
    """What an external sampler may ask of a target, in NumPy: `target.FrozenTarget` is one, and a
    frame's posterior under one candidate another (`posterior.PosteriorTarget`). In JAX, and with
    gradients, `programs.in_jax(target)` has the same densities."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def dim(self) -> int:
        """How many coordinates there are."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Their names."""

    @property
    def seen_joints(self) -> list[str]:
        """The joints that were detected and count."""

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: log density at points `(..., d)` of R^d, but for the evidence."""

    def log_graded(self, points: np.ndarray, hardness: float) -> np.ndarray:
        """`(...)`: log of a likelihood with slopes for walls (`FrozenTarget.log_graded`)."""

    def misfits(self, points: np.ndarray) -> np.ndarray:
        """`(..., k)`: distances of the seen joints from their detections, in reaches."""

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: the largest of them: a point is inside the support iff it is at most 1."""

    def prior_points(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, d)` draws of the prior as points of R^d."""

    def prior_transform(self, cube: np.ndarray) -> np.ndarray:
        """Points `(..., d)` of R^d from the unit cube: uniform ones become draws of the prior."""

    def points_of_box(self, box: np.ndarray) -> np.ndarray:
        """Points `(..., d)` of R^d from fractions of ranges, and of the directions' squares."""
