"""A frame's posterior under one candidate, in NumPy: what an external sampler is given where it is
compared on a detection, and not on a frozen target."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jax import Array
from jax.typing import ArrayLike

from poseterior.inference.baselines.target import COORDINATES, Target
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import JOINTS


@dataclass(frozen=True)
class PosteriorTarget:
    """A `SamplerTarget`, on the coordinates of `density`.

    Attributes
    ----------
    name : whose detection it is of.
    density : the same densities in JAX, with gradients.
    """

    name: str
    density: Target

    @classmethod
    def of(cls, posterior: Posterior) -> "PosteriorTarget":
        """That of a posterior with one candidate. Raises as `Target.of`."""
        return cls(posterior.detection.where, Target.of(posterior))

    @property
    def dim(self) -> int:
        """How many coordinates there are."""
        return self.density.dim

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(COORDINATES[index] for index in self.density.active)

    @property
    def seen_joints(self) -> list[str]:
        """The joints that were detected and count."""
        return [JOINTS[joint] for joint in self._seen]

    def log_density(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: log density at points `(..., d)` of R^d, but for the evidence."""
        return self._over(self.density.log_density, points)

    def log_graded(self, points: np.ndarray, hardness: float) -> np.ndarray:
        """`(...)`: log of a likelihood with slopes for walls (`FrozenTarget.log_graded`)."""
        return self._over(functools.partial(self.density.log_graded, hardness=hardness), points)

    def misfits(self, points: np.ndarray) -> np.ndarray:
        """`(..., k)`: distances of the seen joints from their detections, in reaches."""

        def squares(points: ArrayLike) -> Array:
            joints = self.density.joints(points)
            return self.density.observation.squares_in_reaches(joints)[..., self._seen]

        return np.sqrt(self._over(squares, points))

    def misfit(self, points: np.ndarray) -> np.ndarray:
        """`(...)`: the largest of them: a point is inside the support iff it is at most 1."""
        return self._over(self.density.misfit, points)

    def prior_points(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, d)` draws of the prior as points of R^d."""
        alpha, beta = map(np.asarray, self.density.shape)
        return self.points_of_box(rng.beta(alpha, beta, (number, self.dim)))

    def prior_transform(self, cube: np.ndarray) -> np.ndarray:
        """Points `(..., d)` of R^d from the unit cube: uniform ones become draws of the prior."""
        from scipy.special import betaincinv

        return self.points_of_box(betaincinv(*map(np.asarray, self.density.shape), cube))

    def points_of_box(self, box: np.ndarray) -> np.ndarray:
        """Points `(..., d)` of R^d from fractions of ranges, and of the directions' squares."""
        edge = np.finfo(float).eps
        inside = np.clip(np.asarray(box, float), edge, 1 - edge)
        return np.log(inside) - np.log1p(-inside)

    def joints_of(self, poses: Pose) -> np.ndarray:
        """`(..., 15, 3)`: joints of poses, camera axes, body units."""
        target = self.density
        return np.asarray(target.model.joints(target.observation.view, *poses))

    @property
    def _seen(self) -> np.ndarray:
        return np.flatnonzero(self.density.observation.seen)

    def _over(self, function: Callable[[np.ndarray], ArrayLike], points: np.ndarray) -> np.ndarray:
        """A function of rows, at points `(..., d)`; compiled for so many rows at a time."""
        points = np.asarray(points, float)
        found = in_chunks(function, points.reshape(-1, self.dim))
        return np.asarray(found).reshape(*points.shape[:-1], *found.shape[1:])
