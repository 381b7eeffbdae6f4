"""Who draws, where many detections are drawn from one after the other: a stream, an evaluation, a
study of coverage.

A drawer is made once, for one kind of root, and takes a detection's estimate and a key. What it
returns is the same for every kind, so that nobody who draws needs to know which one it is.

    draw = drawer(model, root="uncertain", num_samples=1000, num_roots=200)
    draw(frame, key).joints
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from poseterior.inference.composition import Drawn
from poseterior.inference.exact.mixture import MAX_PROPOSALS, PROPOSALS, draw_mixture
from poseterior.inference.importance.routes import ROUTES, draw_uncertain
from poseterior.inference.importance.tree import placed
from poseterior.inference.importance.weighted import require_number
from poseterior.inference.results import FIXED, UNCERTAIN, joint_columns
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.uncertain import UncertainPosterior

ROOTS = (FIXED, UNCERTAIN)
"""What torso and camera may be: given by an estimator, or drawn with the pose."""
NUM_ROOTS = 200
"""Roots of each detection where there are many of them: about a second of one core."""
SAMPLER = next(iter(PROPOSALS))
"""Exact rejection by strata."""


class Draws(NamedTuple):
    """Draws of one detection, in random order.

    Attributes
    ----------
    posterior : what they were drawn from.
    joints : `(n, 15, 3)` camera axes, the pelvis at the origin, body units of each draw's root.
    bone_length : `(n, 5)` body units.
    keypoints : `(n, 15, 2)` pixels, where the draws' joints fall in the image.
    scale : `(n,)` pixels a body unit, of each draw's root.
    candidate : `(n,)` each draw's root among the estimator's; None where the root is uncertain.
    points : the roots `(n, ...)` of the draws; None where the root is fixed.
    faults : which detections are faults in each draw, `(n, ...)`; None where the root is fixed.
    log_evidence, log_evidence_se : as the attributes of a result with such a root.
    effective_roots : of how many equally good roots the draws are; NaN where the root is fixed.
    status, sentence : as in `inference.results.Result`.
    """

    posterior: Posterior | UncertainPosterior
    joints: np.ndarray
    bone_length: np.ndarray
    keypoints: np.ndarray
    scale: np.ndarray
    candidate: np.ndarray | None
    points: RootPoint | None
    faults: Faults | None
    log_evidence: float
    log_evidence_se: float
    effective_roots: float
    status: str
    sentence: str

    @property
    def drawn(self) -> Drawn:
        """Those of which hypotheses can be composed."""
        return Drawn(
            self.posterior,
            self.joints,
            self.bone_length,
            self.candidate,
            self.points,
            self.faults,
        )


class Drawer(Protocol):
    """What draws from the posterior of a detection."""

    @property
    def settings(self) -> dict[str, Any]:
        """What the draws depend on beside model, detection and key: plain JSON values."""

    def __call__(self, frame: Estimate, key: jax.Array) -> Draws:
        """Draws of one detection, those of `inference.sample` for this key, in the same order."""


@dataclass(frozen=True)
class FixedRoot:
    """Exact draws from the mixture over an estimator's candidates."""

    model: PoseModel
    sampler: str
    num_samples: int
    max_proposals: int

    @property
    def settings(self) -> dict[str, Any]:
        """As of a `Drawer`."""
        names = ("sampler", "num_samples", "max_proposals")
        return {"root": FIXED} | {name: getattr(self, name) for name in names}

    def __call__(self, frame: Estimate, key: jax.Array) -> Draws:
        """As of a `Drawer`. Raises `BadInput` where its likelihood has faults."""
        posterior = frame.posterior(self.model)
        mixture = draw_mixture(
            posterior,
            key=key,
            sampler=self.sampler,
            num_samples=self.num_samples,
            max_proposals=self.max_proposals,
        )
        return Draws(
            posterior,
            **joint_columns(posterior, mixture.parts, mixture.rng),
            points=None,
            faults=None,
            log_evidence=mixture.attributes["log_evidence"],
            log_evidence_se=mixture.attributes["log_evidence_se"],
            effective_roots=math.nan,
            status=mixture.status,
            sentence=mixture.sentence,
        )


@dataclass(frozen=True)
class UncertainRoot:
    """Draws of torso, camera and pose together."""

    model: PoseModel
    sampler: str
    num_samples: int
    num_roots: int
    most_roots: int | None
    max_proposals: int

    @property
    def settings(self) -> dict[str, Any]:
        """As of a `Drawer`."""
        names = ("sampler", "num_samples", "num_roots", "most_roots", "max_proposals")
        given = {name: getattr(self, name) for name in names}
        return {"root": UNCERTAIN} | {name: value for name, value in given.items() if value}

    def __call__(self, frame: Estimate, key: jax.Array) -> Draws:
        """As of a `Drawer`. Raises `BadInput` where the seen joints of the torso do not determine
        a camera."""
        posterior = frame.uncertain(self.model)
        roots, status, sentence, _ = draw_uncertain(
            posterior,
            self.sampler,
            key=jax.random.fold_in(key, 0),
            num_samples=self.num_samples,
            num_roots=self.num_roots,
            most_roots=self.most_roots,
            max_proposals=self.max_proposals,
        )
        rng = np.random.default_rng(np.asarray(jax.random.key_data(jax.random.fold_in(key, 1))))
        points, poses, chosen = roots.draw(rng, self.num_samples)
        return Draws(
            posterior,
            **placed(posterior.model, points, poses),
            bone_length=poses.length,
            scale=np.exp(points.log_scale),
            candidate=None,
            points=points,
            faults=roots.proposed.faults.take(chosen),
            log_evidence=roots.log_evidence,
            log_evidence_se=roots.log_evidence_se,
            effective_roots=roots.effective,
            status=status,
            sentence=sentence,
        )


def drawer(
    model: PoseModel,
    *,
    root: str = FIXED,
    sampler: str | None = None,
    num_samples: int = 10_000,
    num_roots: int = NUM_ROOTS,
    most_roots: int | None = None,
    max_proposals: int = MAX_PROPOSALS,
) -> Drawer:
    """The drawer for one kind of root.

    Parameters
    ----------
    model : the prior of poses.
    root : one of `ROOTS`.
    sampler : how exact rejection proposes where the root is fixed: one of `PROPOSALS`; one of
        `ROUTES` where it is uncertain. By default the first of them.
    num_samples : draws of each detection.
    num_roots, most_roots : from how many roots they are made where the root is uncertain, and from
        how many at most where these are too few, as `inference.sample` takes them.
    max_proposals : most proposals for each detection.

    Raises
    ------
    BadInput
        On an unknown root or sampler, a sampler that holds the root fixed where it shall be
        uncertain, and numbers that cannot be.
    """
    sampler = sampler_under(root, sampler)
    if num_samples < 1:
        raise BadInput(f"the number of samples must be at least 1, not {num_samples}")
    if root == UNCERTAIN:
        require_number(num_roots)
        return UncertainRoot(model, sampler, num_samples, num_roots, most_roots, max_proposals)
    if sampler not in PROPOSALS:
        raise BadInput(f"there is no exact sampler {sampler!r}; choose from {', '.join(PROPOSALS)}")
    return FixedRoot(model, sampler, num_samples, max_proposals)


def sampler_under(root: str, sampler: str | None, rooted: Sequence[str] = ROUTES) -> str:
    """The sampler's name, or that which is meant under such a root where none is named; `rooted`
    are those that draw torso and camera, too. Raises `BadInput` on an unknown root, and on a
    sampler that holds the root fixed where it shall be uncertain or the other way round."""
    if root not in ROOTS:
        raise BadInput(f"there is no root {root!r}; choose one of {', '.join(ROOTS)}")
    if sampler is None:
        return ROUTES[0] if root == UNCERTAIN else SAMPLER
    if root == UNCERTAIN and sampler not in rooted:
        choice = f"{', '.join(rooted[:-1])} or {rooted[-1]}"
        raise BadInput(
            f"no sampler {sampler!r} draws torso and camera; choose {choice}, or the root {FIXED!r}"
        )
    if root == FIXED and sampler == ROUTES[0]:
        raise BadInput(
            f"the sampler {sampler} needs torso and camera uncertain; choose another, or the root"
            f" {UNCERTAIN!r}"
        )
    return sampler
