"""The likelihood: how far, and in what way, a detected joint may lie from where the pose projects.

An `ErrorLaw` is the isotropic law of one joint's error in units of its spread; the paper's is
`Disc`. A `Likelihood` gives every joint its spread (τ, from the detector's scores) and says which
joints count. `Observation` is what a detection then says under one root; see docs/model.md § 3.

To add a law, write one subclass of `ErrorLaw`. Samplers propose by its envelope, or uniformly
within its reach, and correct what they found by `log_over`: nothing else asks which law it is.
"""

import abc
import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.detections import LARGEST_NUMBER, LIKELIHOOD_JOINTS, Detection
from poseterior.probmodel.errorlaws import DetectorErrors
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.faults import EXCHANGES, NO_FAULTS, FaultPrior
from poseterior.probmodel.layouts import STRAY
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.programs import kept
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX

if TYPE_CHECKING:
    from poseterior.probmodel.roots import Root


class ErrorLaw(abc.ABC):
    """The isotropic law of an error e in the plane, in units of a joint's spread.

    Its density falls with the length of e and ends at `reach`. Formulas take arrays of NumPy or of
    JAX, and return the like.

    Attributes
    ----------
    reach
        The largest length of e that has any density.
    log_peak
        Log density at e = 0, per squared spread.
    precision
        Of the envelope, a Gaussian that has the law's peak and is nowhere below it within the
        reach: exp(-precision · `|e|²`/2). At 0 it is a disc, which bounds every law.
    exact
        Whether within the reach the law is its envelope.
    """

    reach: float
    log_peak: float
    precision: float = 0.0
    exact: bool = False

    @abc.abstractmethod
    def log_ratio(self, square: ArrayLike) -> Any:
        """`(...)`: log f(e)/f(0) at squared lengths of e `(...)`; -inf beyond the reach."""

    @abc.abstractmethod
    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(...)`: the quantiles of the length of e at numbers `(...)` in [0, 1)."""

    def follows(self, precision: ArrayLike) -> bool:
        """Whether errors proposed within the reach by Gaussians of this precision (0: uniformly)
        follow the law as they are."""
        return self.exact and bool(np.all(np.asarray(precision) == self.precision))

    def log_over(self, square: ArrayLike, precision: ArrayLike) -> Any:
        """What corrects errors that were proposed by an envelope, for limbs and torsos alike.

        Parameters
        ----------
        square : `(...)`
            Squared lengths of proposed errors, all within the reach but for rounding.
        precision
            Of the Gaussians by which they were proposed: the law's, or 0 where uniformly.

        Returns
        -------
        Array
            `(...)`: the log of the law over the envelope, both over their peak; at most 0.
        """
        xp = _namespace(square)
        within = xp.minimum(xp.asarray(square), xp.asarray(self.reach**2))
        return self.log_ratio(within) + precision * within / 2

    def sample(self, key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        """Errors.

        Parameters
        ----------
        key
            Of the draws.
        shape
            How many.

        Returns
        -------
        Array
            `(*shape, 2)`, in spreads.
        """
        for_distance, for_angle = jax.random.split(key)
        distance = self.distance(jax.random.uniform(for_distance, shape))
        angle = jax.random.uniform(for_angle, shape, maxval=2 * jnp.pi)
        return distance[..., None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Disc(ErrorLaw):
    """Uniform in the disc of radius one: the paper's law, an indicator."""

    reach = 1.0
    log_peak = float(-np.log(np.pi))
    exact = True

    def log_ratio(self, square: ArrayLike) -> Any:
        """0 in the disc, -inf outside."""
        xp = _namespace(square)
        return xp.where(xp.asarray(square) <= 1.0, 0.0, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """The square root."""
        return jnp.sqrt(jnp.asarray(uniform))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Gaussian(ErrorLaw):
    """A Gaussian whose standard deviation each way is half a spread, that of the disc, cut at three
    of them: 1.1 % of its mass lies beyond, and is left out."""

    precision = 4.0
    exact = True
    reach = 1.5
    log_peak = float(-np.log(2 * np.pi * 0.5**2 * (1 - np.exp(-(1.5**2) / (2 * 0.5**2)))))

    def log_ratio(self, square: ArrayLike) -> Any:
        """`-|e|²/2σ²` within the reach."""
        xp = _namespace(square)
        square = xp.asarray(square)
        return xp.where(square <= self.reach**2, -square * self.precision / 2, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`|e|²/2σ²` is exponential, cut at 4.5."""
        most = -jnp.expm1(-(self.reach**2) * self.precision / 2)
        return jnp.sqrt(-2 / self.precision * jnp.log1p(-most * jnp.asarray(uniform)))


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True)
class Student(ErrorLaw):
    """A bivariate Student's t of scale σ, half a spread, cut where as much of its mass lies beyond
    as beyond three σ of a Gaussian, which is its limit.

    With r = `|e|/σ` the mass beyond is (1 + r²/df)^(-df/2): it ends at r² = df (e^(9/df) - 1).

    Attributes
    ----------
    df
        Degrees of freedom, 2 at least.

    Raises
    ------
    BadInput
        On fewer, whose tails reach farther than a person.
    """

    df: float = 5.0
    log_peak = Gaussian.log_peak

    def __post_init__(self) -> None:
        if not self.df >= FEWEST_DF:  # true for NaN too
            raise BadInput(
                f"samplers take a student law of {FEWEST_DF:g} degrees of freedom or more, not"
                f" {self.df:g}; learn a gaussian one, whose outliers take the place of long tails"
            )

    @property
    def reach(self) -> float:  # type: ignore[override]
        """In spreads."""
        return 0.5 * math.sqrt(self.df * math.expm1(9 / self.df))

    @property
    def precision(self) -> float:  # type: ignore[override]
        """Log t is convex in `|e|²`, so it lies below its chord from the peak to the reach, where
        it is -(df + 2)/2 · 9/df: a Gaussian."""
        return 9 * (1 + 2 / self.df) / self.reach**2

    def log_ratio(self, square: ArrayLike) -> Any:
        """`-(df + 2)/2 · log(1 + |e|²/(σ² df))` within the reach."""
        xp = _namespace(square)
        square = xp.asarray(square)
        inside = -(self.df + 2) / 2 * xp.log1p(4 * square / self.df)
        return xp.where(square <= self.reach**2, inside, -xp.inf)

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(1 + |e|²/(σ² df))^(-df/2)` is uniform, cut at e^-4.5."""
        beyond = 1 + math.expm1(-4.5) * jnp.asarray(uniform)
        return 0.5 * jnp.sqrt(self.df * jnp.expm1(-2 / self.df * jnp.log(beyond)))


FEWEST_DF = 2.0
LAWS: dict[str, type[ErrorLaw]] = {"disc": Disc, "gaussian": Gaussian, "student": Student}
"""Error laws by name; the disc is the paper's."""


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=("outlier",), meta_fields=("inlier",)
)
@dataclasses.dataclass(frozen=True, eq=False)
class WithOutliers(ErrorLaw):
    """Of several joints each its own law: outliers are uniform in a disc of one spread, and all
    others have the `inlier` law. Numbers of this law are arrays, one for each joint.

    Attributes
    ----------
    inlier
        The law of the others.
    outlier : `(..., joints)` bool
        Which are outliers.
    """

    inlier: ErrorLaw
    outlier: np.ndarray | jax.Array

    @property
    def reach(self) -> Any:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.reach, self.inlier.reach)

    @property
    def log_peak(self) -> jax.Array:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.log_peak, self.inlier.log_peak)

    @property
    def precision(self) -> Any:  # type: ignore[override]
        """`(..., joints)`."""
        return self._each(Disc.precision, self.inlier.precision)

    @property
    def exact(self) -> bool:  # type: ignore[override]
        """Whether the inliers' law is."""
        return self.inlier.exact

    def log_ratio(self, square: ArrayLike) -> Any:
        """`(..., joints)`."""
        return self._each(Disc().log_ratio(square), self.inlier.log_ratio(square))

    def distance(self, uniform: ArrayLike) -> jax.Array:
        """`(..., joints)`."""
        return self._each(Disc().distance(uniform), self.inlier.distance(uniform))

    def _each(self, outliers: Any, others: Any) -> Any:
        xp = _namespace(self.outlier, outliers, others)
        return xp.where(xp.asarray(self.outlier), outliers, others)


def _namespace(*arrays: Any) -> Any:
    """NumPy, or `jax.numpy` where one of the arrays is of JAX."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np


@dataclasses.dataclass(frozen=True)
class Likelihood:
    """What a detection says: an error law, and every joint's spread.

    Attributes
    ----------
    law
        The law of the errors.
    factor
        The paper's 0.25: the spread of a joint of average score, in mean limb lengths.
    joints
        The joints that count where they are seen.
    faults
        How often keypoints are outliers or exchanged, where the root is uncertain; under fixed
        roots there are none.
    learned : how one detector errs, joint by joint, in place of the factor and of relative scores;
        see `Likelihood.of`.
    """

    law: ErrorLaw = dataclasses.field(default_factory=Disc)
    factor: float = 0.25
    joints: tuple[int, ...] = LIKELIHOOD_JOINTS
    faults: FaultPrior = NO_FAULTS
    learned: DetectorErrors | None = None

    @classmethod
    def of(
        cls, errors: DetectorErrors, joints: tuple[int, ...] = LIKELIHOOD_JOINTS
    ) -> "Likelihood":
        """The likelihood that a detector's errors say, its outliers and exchanges included.

        Parameters
        ----------
        errors
            Learned, or read from a file.
        joints
            The joints that count where they are seen.

        Returns
        -------
        Likelihood
            One that needs an uncertain root where there are outliers or exchanges.

        Raises
        ------
        BadInput
            On a law that samplers have not, such as a student one with too long tails.
        """
        law = Student(errors.df) if errors.law == "student" else LAWS[errors.law]()
        outlier = np.where(errors.known, 1 - errors.inlier, 0.0)
        exchange = [getattr(errors.exchange, name, 0.0) for name in EXCHANGES if name != "none"]
        faults = FaultPrior(tuple(outlier.tolist()), tuple(exchange), errors.outlier_radius)
        return cls(law, joints=joints, faults=faults, learned=errors)

    @property
    def bias(self) -> np.ndarray:
        """`(15, 2)`: the mean error of each joint's keypoint, body units, right and down."""
        if self.learned is None:
            return np.zeros((NUM_JOINTS, 2))
        return np.where(self.learned.known[:, None], self.learned.bias, 0.0)

    @property
    def words(self) -> str:
        """What a result says of it, such as "disc, factor 0.25"."""
        width = f"factor {self.factor:g}" if self.learned is None else "learned"
        found = f"{type(self.law).__name__.lower()}, {width}"
        return f"{found}, with faults" if self.faults.any else found

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of all that it says, to the last digit; `words` leave most of it out."""
        said = {
            "law": type(self.law).__name__,
            "factor": float(self.factor),
            "joints": [int(joint) for joint in self.joints],
            "faults": [self.faults.outlier, self.faults.exchange, self.faults.reach],
            "learned": None if self.learned is None else self.learned.document(),
            **vars(self.law),
        }
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()

    def spread(
        self, detection: Detection, scale: float, joints: Sequence[int] | None = None
    ) -> np.ndarray:
        """How far joints may lie from their projections: the paper's τ = `factor` · `scale` · (mean
        limb length) / α, where the mean limb length is one body unit and α is the joint's score
        over the mean score. Twice the learned σ, where there is one; where a midpoint was moved,
        how far it may lie from there adds to it (`probmodel.layouts.STRAY`).

        Parameters
        ----------
        detection
            Whose scores.
        scale
            Pixels per body unit.
        joints
            Which of the seen joints count, and average to α = 1; default: `self.joints`.

        Returns
        -------
        ndarray
            `(15,)` pixels, infinite where a joint does not count.

        Raises
        ------
        BadInput
            Where `scale` or `factor` is not positive, a score is so far below the others that its
            spread is not a finite number, or the learned errors know nothing of a seen joint.
        """
        for name, value in (("scale", scale), ("factor", self.factor)):
            if not 0 < value <= LARGEST_NUMBER:  # false for NaN too
                raise BadInput(
                    f"the {name} of the radii must lie between 0 and {LARGEST_NUMBER:g}, not"
                    f" {value}."
                )
        alpha = detection.alpha(self.joints if joints is None else joints)
        if self.learned is not None:
            counts = ~np.isnan(alpha)
            self.learned.require(counts, detection.where)
            own, stray = self.learned.spread(detection.score), np.zeros(NUM_JOINTS)
            stray[[JOINT_INDEX[name] for name in detection.moved]] = [
                STRAY[name] for name in detection.moved
            ]
            # The σ of every law is half a spread.
            return np.where(counts, 2 * scale * np.hypot(own, stray), np.inf)
        with np.errstate(over="ignore", divide="ignore"):  # reported below, by name
            spread = self.factor * scale / alpha
        for joint in np.flatnonzero(np.isinf(spread)):
            raise BadInput(
                f"the score of {JOINTS[joint]} in {detection.where} is {detection.score[joint]},"
                " too far below the others for a radius; read the file with a higher threshold."
            )
        return np.where(np.isnan(spread), np.inf, spread)

    def observe(
        self, detection: Detection, root: "Root", joints: Sequence[int] | None = None
    ) -> Observation:
        """The detection as it looks under a root, on the camera's plane and in body units.

        Parameters
        ----------
        detection
            What was detected.
        root
            Torso and camera.
        joints
            As in `spread`.

        Returns
        -------
        Observation
            Targets and spreads.

        Raises
        ------
        BadInput
            As `spread`.
        """
        scale = float(root.camera.scale)
        spread = self.spread(detection, scale, joints) / scale
        target = root.camera.to_plane(detection.keypoints) - self.bias
        target = np.where(np.isfinite(spread)[:, None], target, 0.0)
        return Observation(root, target, spread, self.law)

    def log_torso(self, detection: Detection, root: "Root") -> float:
        """Log density of the seen torso joints, whose scores are normalised among themselves.

        Parameters
        ----------
        detection
            What was detected.
        root
            Torso and camera.

        Returns
        -------
        float
            −inf where one lies beyond its reach.
        """
        joints = np.zeros((NUM_JOINTS, 3))
        joints[list(TORSO_INDEX)] = np.asarray(root.view)
        return float(_log_density(self.observe(detection, root, TORSO_INDEX), joints))


@kept
def _log_density(observation: Observation, joints: ArrayLike) -> jax.Array:
    """Compiled as one, since every operation by itself takes longer to compile than to be done."""
    return observation.log_density(joints)


PAPER = Likelihood()
"""Uniform discs of a quarter of a limb: the paper's."""
