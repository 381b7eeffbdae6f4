"""Estimators: detections → torso and camera candidates, and a single 3D pose. One file each;
`ESTIMATORS` names them.

The usual way in: `estimate_torso(detection)`, or `estimate_torsos(detections)` for many at once.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inference.roots.akhter_black import fit_akhter_black
from inference.roots.dictionary import fit_dictionary
from inference.roots.external import SUFFIXES, fit_poses, read_poses
from inference.roots.zhou import fit_zhou
from probmodel.anatomy.limits import AnatomicalLimits
from probmodel.anatomy.population import Anatomy
from probmodel.detections import Detection
from probmodel.failures import BadInput
from probmodel.learning.dictionaries import PoseDictionary
from probmodel.likelihood import PAPER, Likelihood
from probmodel.posterior import Estimate
from probmodel.roots import Candidate


class Learned(NamedTuple):
    """What estimators know of bodies: torsos `(J, 6, 3)`, dictionaries of whole poses, joint
    limits."""

    torsos: np.ndarray
    poses: PoseDictionary
    limits: AnatomicalLimits


Estimator = Callable[[Sequence[Detection], Learned], list[tuple[Candidate, ...]]]
ESTIMATORS: dict[str, Estimator] = {
    "dictionary": lambda detections, learned: [
        fit_dictionary(detection, learned.torsos, learned.poses) for detection in detections
    ],
    "akhter-black": lambda detections, learned: fit_akhter_black(
        detections, learned.poses, learned.limits
    ),
    "zhou": lambda detections, learned: fit_zhou(detections, learned.poses),
}
BATCH = 64
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
    if num_candidates < 1:
        raise BadInput(f"the number of candidates must be at least 1, not {num_candidates}")
    estimator = _estimator(str(method))
    learned = _learned(torsos, limits, poses)
    found: list[tuple[Candidate, ...]] = []
    for start in range(0, len(detections), BATCH):
        found += estimator(detections[start : start + BATCH], learned)
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


def _estimator(method: str) -> Estimator:
    if method in ESTIMATORS:
        return ESTIMATORS[method]
    if Path(method).suffix.lower() not in SUFFIXES:
        raise BadInput(
            f"there is no estimator {method!r}; choose one of {', '.join(ESTIMATORS)}, or give an"
            " .npz or .npy with the poses of another"
        )
    read = read_poses(method)
    return lambda detections, learned: fit_poses(detections, read, learned.poses.torso, method)


def _learned(
    torsos: np.ndarray | None, limits: AnatomicalLimits | None, poses: PoseDictionary | None
) -> Learned:
    if torsos is None or limits is None:
        embedded = Anatomy.default()
        torsos = embedded.torsos if torsos is None else torsos
        limits = embedded.limits if limits is None else limits
    return Learned(np.asarray(torsos, float), poses or PoseDictionary.default(), limits)
