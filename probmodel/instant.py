"""One instant in several views: what calibrated cameras detected of one person at one time.

An `Instant` stands where a detection does, with a likelihood for each view; its posterior is an
`InstantPosterior`, a `Posterior` whose root is in the cameras' world (docs/model.md § 11).

    instant = read_session("S01/").instant(20)
    instant.posterior(PoseModel())
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.faults import FaultPrior, Faults
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.level import up_of
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints, Observation
from poseterior.probmodel.posterior import Estimate, Posterior
from poseterior.probmodel.rig import CameraRig
from poseterior.probmodel.root_priors import WORLD, WorldPrior
from poseterior.probmodel.roots import Root, WorldPoint, WorldRoot

if TYPE_CHECKING:
    from poseterior.probmodel.sessions.pinhole import Pinhole

LARGEST_POINTING = 5.0
"""Degrees: cameras that may be off by more are not calibrated."""


@dataclass(frozen=True, eq=False)
class CameraView:
    """What one camera saw.

    Attributes
    ----------
    label
        What the camera is called.
    camera
        Without distortion, and with square pixels (`Pinhole.straight`).
    detection
        The person, in that camera's pixels.
    likelihood
        How its detector errs.
    """

    label: str
    camera: "Pinhole"
    detection: Detection
    likelihood: Likelihood = PAPER


@dataclass(frozen=True, eq=False)
class Instant:
    """One person in the views of calibrated cameras, at one time.

    Attributes
    ----------
    source
        The session, and the frame.
    views
        What each camera saw.
    pointing
        Degrees by which a camera may point beside its calibration: the standard deviation each way,
        independent from camera to camera. One view alone cannot tell it from where the body is,
        whose place is then as if the camera pointed as it should.

    Raises
    ------
    BadInput
        Where there is no view, or cameras may point anywhere.
    """

    source: str
    views: tuple[CameraView, ...]
    pointing: float = 0.0

    def __post_init__(self) -> None:
        if not self.views:
            raise BadInput(f"{self.source} has no view; give one camera at least")
        if not 0 <= self.pointing <= LARGEST_POINTING:  # false for NaN too
            raise BadInput(
                f"cameras of {self.source} point by {self.pointing:g} degrees beside their"
                f" calibration; give a number from 0 to {LARGEST_POINTING:g}"
            )

    @property
    def where(self) -> str:
        """The person, in words for a message."""
        return f"the person of {self.source}"

    @property
    def rig(self) -> CameraRig:
        """The cameras."""
        return CameraRig.of([view.camera for view in self.views])

    @property
    def up(self) -> tuple[str, float]:
        """The world's axis that points up, and how many degrees it lies from the cameras' own up
        (`level.up_of`)."""
        return up_of(np.stack([view.camera.rotation for view in self.views]))

    @property
    def keypoints(self) -> np.ndarray:
        """`(C, 15, 2)` pixels, NaN where missing."""
        return np.stack([view.detection.keypoints for view in self.views])

    @property
    def score(self) -> np.ndarray:
        """`(C, 15)`, 0 where missing."""
        return np.stack([view.detection.score for view in self.views])

    def seen_by(self, cameras: Sequence[int]) -> "Instant":
        """The same instant in some of its views.

        Parameters
        ----------
        cameras
            Which, counted from 0.

        Returns
        -------
        Instant
            In the order that is given.

        Raises
        ------
        BadInput
            Where there is no such camera, or one is named twice.
        """
        known = range(len(self.views))
        if len(set(cameras)) < len(cameras) or not set(cameras) <= set(known):
            raise BadInput(
                f"cameras {', '.join(str(one + 1) for one in cameras)} of {self.source} cannot be"
                f" chosen; it has those from 1 to {len(known)}, each of which counts once"
            )
        return dataclasses.replace(self, views=tuple(self.views[one] for one in cameras))

    def judged_by(self, *likelihoods: Likelihood) -> "Instant":
        """The same instant with other beliefs of how its detectors err.

        Parameters
        ----------
        likelihoods
            One for all views, or one for each.

        Returns
        -------
        Instant
            The same detections.

        Raises
        ------
        BadInput
            Where they are neither.
        """
        each = likelihoods * len(self.views) if len(likelihoods) == 1 else likelihoods
        if len(each) != len(self.views):
            raise BadInput(
                f"{len(likelihoods)} error laws were given for {len(self.views)} views of"
                f" {self.source}; give one for all, or one for each"
            )
        views = zip(self.views, each, strict=True)
        judged = [dataclasses.replace(view, likelihood=likelihood) for view, likelihood in views]
        return dataclasses.replace(self, views=tuple(judged))

    def posterior(self, model: PoseModel, root: str = WORLD) -> "InstantPosterior":
        """The posterior under a model of poses.

        Parameters
        ----------
        model
            The prior of poses.
        root
            There is one alone: the body in the world.

        Returns
        -------
        InstantPosterior
            Of poses, the body in the world, and faults in every view.

        Raises
        ------
        BadInput
            On a model that believes people to be upright, or has a lens of its own, or another
            prior of the root.
        """
        if root != WORLD:
            raise BadInput(
                f"several views have no root {root!r}; calibrated cameras see a body in the world"
            )
        if model.upright:
            raise BadInput(
                "a calibration does not say which way is up, so that several cameras leave no room"
                " for a belief that people are upright; leave it out"
            )
        if model.lens is not None:
            raise BadInput("calibrated cameras have focal lengths of their own; give none")
        errors = ViewErrors(tuple(view.likelihood for view in self.views))
        pointing = self.pointing if len(self.views) > 1 else 0.0
        return InstantPosterior(model, errors, self, WorldPrior.of(model, self.rig, pointing))


@dataclass(frozen=True)
class ViewErrors:
    """How the detections of several views err: a likelihood each.

    Attributes
    ----------
    views
        Those of the views.
    """

    views: tuple[Likelihood, ...]

    @property
    def faults(self) -> "ViewFaults":
        """The priors of faults."""
        return ViewFaults(tuple(view.faults for view in self.views))

    @property
    def words(self) -> str:
        """What a result says of them."""
        return "; ".join(dict.fromkeys(view.words for view in self.views))

    def detected(self, instant: Instant) -> "DetectedInstant":
        """The detections before any root: the joints of each likelihood and the torso's count, and
        are the skeleton's, wherever a detector sees them. Raises `BadInput` as
        `Likelihood.spread`."""
        counted = [WorldPrior.counted(view.joints) for view in self.views]
        seen = zip(self.views, instant.views, counted, strict=True)
        return DetectedInstant(
            tuple(
                own.detected(view.detection, count)._replace(definition=None)
                for own, view, count in seen
            )
        )


@jax.tree_util.register_static
@dataclass(frozen=True)
class ViewFaults:
    """The prior of faults in several views, which are independent.

    Attributes
    ----------
    views
        Those of the views.
    """

    views: tuple[FaultPrior, ...]

    @property
    def any(self) -> bool:
        """Whether there may be faults in any view."""
        return any(view.any for view in self.views)

    def none(self, *batch: int) -> Faults:
        """No fault at all, in patterns `(*batch, C, ...)`."""
        return Faults.none(*batch, len(self.views))

    def compose(self, counts: ArrayLike, step: Callable[[str, Any], Any]) -> Faults:
        """The prior, written once: as `FaultPrior.compose`, view by view, whose sites are called
        view1/exchange and so on; `counts` `(C, 15)`."""

        def named(number: int) -> Callable[[str, Any], Any]:
            return lambda site, law: step(f"view{number}/{site}", law)

        each = zip(self.views, jnp.asarray(counts), strict=True)
        found = [view.compose(own, named(row)) for row, (view, own) in enumerate(each, start=1)]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *found)

    def log_prob(self, counts: ArrayLike, faults: Faults) -> jax.Array:
        """`()`: log prior probability of one pattern in all views."""
        each = zip(self.views, jnp.asarray(counts), *map(jnp.asarray, faults), strict=True)
        found = [view.log_prob(own, Faults(*pattern)) for view, own, *pattern in each]
        return jnp.sum(jnp.stack(found))


class DetectedInstant(NamedTuple):
    """An instant before any root; a pytree.

    Attributes
    ----------
    views
        What each view says.
    """

    views: tuple[DetectedJoints, ...]

    @property
    def counts(self) -> jax.Array:
        """`(C, 15)` bool: the keypoints that count."""
        return jnp.stack([view.counts for view in self.views])

    def under(
        self, prior: WorldPrior, point: WorldPoint, faults: Faults | None = None
    ) -> "ObservedInstant":
        """The instant under one root and a pattern of faults `(C, ...)`, or none."""
        root = prior.root(point)
        seen = zip(self.views, root.camera.cameras, strict=True)
        observed = []
        for number, (view, camera) in enumerate(seen):
            own = None if faults is None else Faults(*(part[number] for part in faults))
            observed.append(view.at(Root(root.torso, camera), own))
        return ObservedInstant(root, tuple(observed))


class ObservedInstant(NamedTuple):
    """An instant under one root, a pytree; poses are in the world's axes.

    Attributes
    ----------
    root
        The torso in the world.
    views
        What each view says.
    """

    root: WorldRoot
    views: tuple[Observation, ...]

    @property
    def view(self) -> jax.Array:
        """`(6, 3)`: the torso in the world's axes, body units."""
        return self.root.view

    def condition(self, joints: jax.Array) -> None:
        """The sites of a NumPyro model for joints `(15, 3)` in the world's axes: those of
        `Observation.condition`, called view1/detection and so on."""
        from numpyro.handlers import scope

        turns = jnp.asarray(self.root.camera.rig.rotation)
        for number, view in enumerate(self.views):
            with scope(prefix=f"view{number + 1}"):
                view.condition(joints @ turns[number].T)


@dataclass(frozen=True, eq=False)
class InstantPosterior(Posterior):
    """The posterior of an instant over the body in the world, its pose, and faults in every view:
    `Posterior`, whose fields are those of several views."""

    likelihood: ViewErrors  # type: ignore[assignment]
    detection: Instant  # type: ignore[assignment]
    root_prior: WorldPrior  # type: ignore[assignment]

    @functools.cached_property
    def detected(self) -> DetectedInstant:  # type: ignore[override]
        """The joints that count in each view."""
        return self.likelihood.detected(self.detection)

    @property
    def faults(self) -> ViewFaults:  # type: ignore[override]
        """The priors of faults, of every view."""
        return self.likelihood.faults

    @property
    def alone(self) -> Posterior:
        """That of the first view by itself, whose focal length is known: the same law of a pose,
        where there is no other."""
        view = self.detection.views[0]
        lens = Lens(float(view.camera.focal[0]), view.camera.principal)
        return Estimate(view.detection, (), view.likelihood, lens=lens).posterior(self.model)
