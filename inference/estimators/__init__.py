"""Estimators: detections → torso and camera candidates, and a single 3D pose. One file each;
`ESTIMATORS` names them.

The usual way in: `estimate_torso(detection)`, or `estimate_torsos(detections)` for many at once.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from poseterior.inference.estimators.akhter_black import fit_akhter_black
from poseterior.inference.estimators.dictionary import fit_dictionary
from poseterior.inference.estimators.external import POSE_SUFFIXES, fit_poses, read_poses
from poseterior.inference.estimators.points import require_camera, require_pose
from poseterior.inference.estimators.zhou import fit_zhou
from poseterior.probmodel.anatomy.limits import AnatomicalLimits
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput, require_some
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.roots import Candidate


class KnownBodies(NamedTuple):
    """What estimators know of bodies: torsos `(J, 6, 3)`, dictionaries of whole poses, joint
    limits."""

    torsos: np.ndarray
    poses: PoseDictionary
    limits: AnatomicalLimits


Estimator = Callable[[Sequence[Detection], KnownBodies], list[tuple[Candidate, ...]]]
ESTIMATORS: dict[str, Estimator] = {
    "dictionary": lambda detections, learned: [
        fit_dictionary(detection, learned.torsos, learned.poses) for detection in detections
    ],
    "akhter-black": lambda detections, learned: fit_akhter_black(
        detections, learned.poses, learned.limits
    ),
    "zhou": lambda detections, learned: fit_zhou(detections, learned.poses),
}
FITTED_AT_ONCE = 64
"""Detections that are fitted at once; more do not get faster, and need more memory."""


def estimate_torsos(
    detections: Sequence[Detection],
    method: str = "dictionary",
    *,
    torsos: np.ndarray | None = None,
    limits: AnatomicalLimits | None = None,
    poses: PoseDictionary | None = None,
    num_candidates: int = 2,
    likelihood: Likelihood = PAPER,
) -> list[Estimate]:
    """Estimates torso, camera and a single 3D pose for each of many people.

    Parameters
    ----------
    detections
        The people.
    method
        One of `ESTIMATORS`, or a file of poses of another estimator (`roots.external`).
    torsos, limits, poses
        What is known of bodies: torsos `(J, 6, 3)`, joint limits, a pose dictionary; default: what
        is embedded.
    num_candidates
        The most that are kept for each, best reprojection (dictionary) or objective first; 1 is the
        paper's method.
    likelihood
        How detections err; no estimator looks at it, it is handed on.

    Returns
    -------
    list of Estimate
        One a person; one that did not converge says so (`Estimate.converged`).

    Raises
    ------
    BadInput
        On an unknown method, and where too little was detected for a camera or a pose.
    """
    require_some(num_candidates, "candidates")
    estimator = _estimator(str(method))
    learned = _learned(torsos, limits, poses)
    found: list[tuple[Candidate, ...]] = []
    for start in range(0, len(detections), FITTED_AT_ONCE):
        found += estimator(detections[start : start + FITTED_AT_ONCE], learned)
    return [
        Estimate(detection, candidates[:num_candidates], likelihood, str(method))
        for detection, candidates in zip(detections, found, strict=True)
    ]


def estimate_torso(
    detection: Detection, method: str = "dictionary", **settings: object
) -> Estimate:
    """Estimates torso, camera and a single 3D pose of one person.

    Parameters
    ----------
    detection
        The person.
    method
        One of `ESTIMATORS`, or a file of poses of another estimator.
    **settings
        Those of `estimate_torsos`.

    Returns
    -------
    Estimate
        With its candidates; `Estimate.converged` says whether the estimator came to an end.

    Raises
    ------
    BadInput
        On an unknown method, and where too little was detected for a camera or a pose.
    """
    return estimate_torsos([detection], method, **settings)[0]  # type: ignore[arg-type]


@dataclass(frozen=True)
class Estimating:
    """An estimator with all its settings, as one value: how people are estimated, one after the
    other, wherever that is done.

    Attributes
    ----------
    method, torsos, limits, poses, num_candidates, likelihood
        As `estimate_torsos` takes them.
    """

    method: str = "dictionary"
    torsos: np.ndarray | None = None
    limits: AnatomicalLimits | None = None
    poses: PoseDictionary | None = None
    num_candidates: int = 2
    likelihood: Likelihood = PAPER

    def __call__(self, detections: Sequence[Detection]) -> list[Estimate]:
        """What `estimate_torsos` finds.

        Parameters
        ----------
        detections
            The people.

        Returns
        -------
        list of Estimate
            One a person.

        Raises
        ------
        BadInput
            As `estimate_torsos` does.
        """
        return estimate_torsos(detections, **vars(self))

    def require(self, detection: Detection) -> None:
        """Refuses people whom no estimate is tried for.

        Parameters
        ----------
        detection
            A person.

        Raises
        ------
        BadInput
            Where too little is seen of the person.
        """
        (require_camera if self.method == "dictionary" else require_pose)(detection)

    @property
    def settings(self) -> dict[str, Any]:
        """What estimates depend on beside the detection: plain JSON values."""
        learned = _learned(self.torsos, self.limits, self.poses)
        digest = hashlib.sha256(np.ascontiguousarray(learned.torsos, "<f8").tobytes())
        digest.update((learned.poses.sha256 + learned.limits.sha256).encode())
        if self.method not in ESTIMATORS:
            digest.update(Path(self.method).read_bytes())
        return {
            "estimator": self.method,
            "candidates": self.num_candidates,
            "bodies": digest.hexdigest(),
            "likelihood": f"{self.likelihood.words} {self.likelihood.sha256}",
        }


def _estimator(method: str) -> Estimator:
    if method in ESTIMATORS:
        return ESTIMATORS[method]
    if Path(method).suffix.lower() not in POSE_SUFFIXES:
        raise BadInput(
            f"there is no estimator {method!r}; choose one of {', '.join(ESTIMATORS)}, or give an"
            " .npz or .npy with the poses of another"
        )
    read = read_poses(method)
    return lambda detections, learned: fit_poses(detections, read, learned.poses.torso, method)


def _learned(
    torsos: np.ndarray | None, limits: AnatomicalLimits | None, poses: PoseDictionary | None
) -> KnownBodies:
    if torsos is None or limits is None:
        embedded = Anatomy.default()
        torsos = embedded.torsos if torsos is None else torsos
        limits = embedded.limits if limits is None else limits
    return KnownBodies(np.asarray(torsos, float), poses or PoseDictionary.default(), limits)
