"""Mirror twins of a whole pose's torso: every estimate comes both ways round, so that the limbs'
evidence can choose.

An estimator looks for a pose on both sides of the depth ambiguity. Where both searches end on one
side, the twin is the same pose under the mirrored camera, as well as the torso joints allow."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from poseterior.inference.estimators.adjustment import adjust, angle_between, mirror_twin
from poseterior.inference.estimators.points import Points
from poseterior.inference.estimators.whole_pose import candidate_from_pose
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.roots import Candidate

SAME_ANGLE = np.radians(3)
"""Two cameras closer than this are one candidate: a torso seen head-on is its own mirror twin."""


class Outcome(NamedTuple):
    """How fits ended, `(m,)` each: `objective`, `iterations`, `converged`."""

    objective: np.ndarray
    iterations: np.ndarray
    converged: np.ndarray

    def of(self, row: int) -> dict[str, Any]:
        """Of one of the fits, by the names of a `Candidate`."""
        return {name: part[row].item() for name, part in self._asdict().items()}


def candidates_both_ways(
    detections: Sequence[Detection], joints: np.ndarray, outcome: Outcome, torso: np.ndarray
) -> list[tuple[Candidate, ...]]:
    """Candidates from two poses for each of n detections, one after the other: `joints` `(2n, 15,
    3)` in camera axes and pixels. The better one first; the other one, or its own twin where both
    face the same way, second."""
    found = []
    for number, detection in enumerate(detections):
        rows = sorted((2 * number, 2 * number + 1), key=lambda row: outcome.objective[row])
        pair = [
            candidate_from_pose(detection, joints[row], torso, **outcome.of(row)) for row in rows
        ]
        if _apart(*pair) <= SAME_ANGLE:
            twin = mirrored(detection, pair[0], joints[rows[0]])
            pair[1] = candidate_from_pose(detection, twin, torso, **outcome.of(rows[0]))
        found.append(tuple(pair) if _apart(*pair) > SAME_ANGLE else (pair[0],))
    return found


def _apart(one: Candidate, other: Candidate) -> float:
    return float(
        angle_between(
            np.asarray(one.camera.rotation)[None], np.asarray(other.camera.rotation)[None]
        )[0]
    )


def mirrored(detection: Detection, candidate: Candidate, joints: np.ndarray) -> np.ndarray:
    """The pose of `candidate`, `joints` `(15, 3)` in camera axes and pixels, under the mirrored
    camera, adjusted to the seen torso joints."""
    points = Points.gather([detection])
    rotation = np.asarray(candidate.camera.rotation)
    body = (joints - joints[0]) @ rotation
    term = body / points.size[0]
    fit = adjust(
        points.xy,
        points.torso_weight,
        term[None, None],
        mirror_twin(rotation)[None],
        np.ones((1, 1)),
    )
    turned = fit.coefficient[0, 0] * body @ fit.rotation[0].T
    seen = points.torso_weight[0]
    offset = points.centre[0] + points.size[0] * points.xy[0] - turned[:, :2]
    return turned + np.append(seen @ offset / seen.sum(), 0.0)
