"""The likelihood: how far, and in what way, a detected joint may lie from where the pose projects.

A `Likelihood` is an error law (`laws`), every joint's spread (τ, from the detector's scores), which
joints count, and the detector's faults. `Observation` is what a detection then says under one root;
see docs/model.md § 3.
"""

import dataclasses
import functools
import hashlib
import json
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.detections import LARGEST_NUMBER, LIKELIHOOD_JOINTS, Detection
from poseterior.probmodel.errors.detector import DetectorErrors
from poseterior.probmodel.errors.faults import EXCHANGES, NO_FAULTS, FaultPrior
from poseterior.probmodel.errors.laws import Disc, ErrorLaw
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.layouts import STRAY
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.programs import kept
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX

if TYPE_CHECKING:
    from poseterior.probmodel.roots import Root

LONGEST_REACH = 6.7
"""Spreads: a Student's law of two degrees of freedom ends there. Longer tails reach farther than a
person."""


def _of_a_frame(law: DetectorErrors) -> dict[str, Any]:
    """What a law says of single frames, whose posterior knows nothing of how long errors last."""
    return {name: part for name, part in law.document().items() if name != "times"}


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

    Raises
    ------
    BadInput
        On a law that reaches too far for samplers, such as a student one with too long tails.
    """

    law: ErrorLaw = dataclasses.field(default_factory=Disc)
    factor: float = 0.25
    joints: tuple[int, ...] = LIKELIHOOD_JOINTS
    faults: FaultPrior = NO_FAULTS
    learned: DetectorErrors | None = None

    def __post_init__(self) -> None:
        if not self.law.reach <= LONGEST_REACH:
            raise BadInput(
                f"samplers take error laws that end within {LONGEST_REACH:g} spreads, and"
                f" {self.law} ends at {self.law.reach:.3g}; learn a gaussian one, whose outliers"
                " take the place of long tails"
            )

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
            On a law that reaches too far for samplers, or is exact beyond belief.
        """
        errors.require_attainable()
        outlier = np.where(errors.known, 1 - errors.inlier, 0.0)
        exchange = [getattr(errors.exchange, name, 0.0) for name in EXCHANGES if name != "none"]
        faults = FaultPrior(tuple(outlier.tolist()), tuple(exchange), errors.outlier_radius)
        return cls(errors.law, joints=joints, faults=faults, learned=errors)

    @property
    def bias(self) -> np.ndarray:
        """`(15, 2)`: the mean error of each joint's keypoint, body units, right and down."""
        if self.learned is None:
            return np.zeros((NUM_JOINTS, 2))
        return np.where(self.learned.known[:, None], self.learned.bias, 0.0)

    def definitions(self, people: int, moved: Collection[str] = ()) -> np.ndarray | None:
        """How far from each joint lies what the detector calls so.

        Parameters
        ----------
        people
            How many people.
        moved
            As `DetectorErrors.definitions` has it.

        Returns
        -------
        ndarray
            `(people, 15, 3)` or `(1, 15, 3)`, body units and axes; None where all is where the
            skeleton has it.
        """
        return None if self.learned is None else self.learned.definitions(people, moved)

    @property
    def words(self) -> str:
        """What a result says of it, such as "disc, factor 0.25"."""
        width = f"factor {self.factor:g}" if self.learned is None else "learned"
        found = f"{self.law.name}, {width}"
        return f"{found}, with faults" if self.faults.any else found

    @functools.cached_property
    def sha256(self) -> str:
        """Hash of all that it says, to the last digit; `words` leave most of it out."""
        said = {
            "law": type(self.law).__name__,
            "factor": float(self.factor),
            "joints": [int(joint) for joint in self.joints],
            "faults": [self.faults.outlier, self.faults.exchange, self.faults.reach],
            "learned": None if self.learned is None else _of_a_frame(self.learned),
            **self.law.parameters,
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

    def detected(
        self, detection: Detection, joints: Sequence[int] | None = None, people: int = 1
    ) -> DetectedJoints:
        """The detection before any root.

        Parameters
        ----------
        detection
            What was detected.
        joints
            As in `spread`.
        people
            How many the root's prior has, each of whom has definitions of joints of its own.

        Returns
        -------
        DetectedJoints
            Keypoints with their spreads in body units.

        Raises
        ------
        BadInput
            As `spread`.
        """
        spread = self.spread(detection, 1.0, joints)
        keypoints = np.where(np.isfinite(spread)[:, None], detection.keypoints, 0.0)
        definition = self.definitions(people, detection.moved)
        given = self.bias, self.faults.reach, self.law, definition
        return DetectedJoints(keypoints, spread, *given)

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
        return self.detected(detection, joints).at(root)

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
