"""Why a posterior excludes a true pose outright: a limit, a length, a detection beyond τ, the
torso, the camera.

The true bones, as vectors in camera axes, are hung on the estimated torso in front of the estimated
camera; what is broken there and not on the true torso in front of the true camera is the estimate's
fault, and putting one of the two right shows which. (Left and right lengths differ a little in real
people; the model shares one, here their mean.)"""

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from poseterior.inference.studies.calibration.quantities import lengths
from poseterior.inference.studies.calibration.real import true_candidate
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.probmodel.anatomy.limits import LIMITS
from poseterior.probmodel.datasets import Case
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.roots import Candidate, RootPoint
from poseterior.probmodel.skeleton import (
    BONE_NAMES,
    BONES,
    JOINTS,
    LENGTH_GROUPS,
    NUM_JOINTS,
    TORSO_INDEX,
)

LIMIT, LENGTH, TAU, TORSO, CAMERA, BOTH = REASON_SOURCES = (
    "limit",
    "length",
    "τ",
    "torso",
    "camera",
    "torso and camera together",
)


class Break(NamedTuple):
    """What a pose breaks: `kind` (limit, length, τ) of which `part` (bone, length group, joint),
    and by how `much`: degrees (NaN: below an impossible parent), shares of the range's end, radii τ
    beyond the disc."""

    kind: str
    part: str
    much: float


class Reason(NamedTuple):
    """Why a truth is excluded: the `source` (`REASON_SOURCES`), and what it breaks."""

    source: str
    broken: Break

    @property
    def label(self) -> str:
        """The source, and for the model's own limits and lengths the bone."""
        part = (
            f" of the {self.broken.part.replace('_', ' ')}"
            if self.source in (LIMIT, LENGTH)
            else ""
        )
        return f"{self.source}{part}"

    @property
    def sentence(self) -> str:
        """In words, with the amount."""
        kind, part, much = self.broken
        words = {
            LIMIT: f"{much:.1f}° beyond its limit",
            LENGTH: f"{much:.1%} beyond its range",
            TAU: f"{much:.2f} τ",
        }
        said = "below an impossible parent" if np.isnan(much) else words[kind]
        return f"{self.source}: {part.replace('_', ' ')} {said}"


def exclusions(
    model: PoseModel, cases: Sequence[Case], known: Sequence[Instance], root: str = CANDIDATES
) -> list[list[Reason]]:
    """The reasons why each case's posterior excludes its truth, none where it does not. Where there
    are several candidates each has to exclude it, and the one with the fewest reasons gives
    them. Where the `root` is uncertain the torso's detections count too."""
    places = []
    rows = []
    for number, (case, instance) in enumerate(zip(cases, known, strict=True)):
        right = true_candidate(case, model)
        for mine in instance.frame.candidates:
            places += [(case, instance.frame, one) for one in _combinations(mine, right)]
            rows.append(number)
    broken = _broken(model, places, root)
    found: list[list[Reason] | None] = [None] * len(cases)
    for start, number in zip(range(0, len(places), 4), rows, strict=True):
        reasons = _reasons(*(broken[start + step] for step in range(4)))
        best = found[number]
        if best is None or len(reasons) < len(best):
            found[number] = reasons
    return [reasons or [] for reasons in found]


def _combinations(mine: Candidate, right: Candidate) -> list[Candidate]:
    """The estimate, the truth, the true camera with the estimated torso, the estimated camera with
    the true torso. A torso keeps the size that it has in the image: the unit belongs to the
    camera."""
    unit = float(mine.camera.scale) / float(right.camera.scale)
    return [
        mine,
        right,
        Candidate(-1, mine.torso * unit, right.camera, 0.0),
        Candidate(-1, right.torso / unit, mine.camera, 0.0),
    ]


def _broken(
    model: PoseModel, places: list[tuple[Case, Estimate, Candidate]], root: str
) -> list[dict[tuple[str, str], Break]]:
    joints = np.stack([hung(case, candidate) for case, _, candidate in places])
    check = model.limits.check(joints)
    length = lengths(joints)
    low = np.asarray(model.lengths.low)
    high = np.asarray(model.lengths.high)
    beyond = np.maximum(low / length, length / high) - 1
    found = []
    for row, (_, frame, candidate) in enumerate(places):
        breaks = [
            Break(LIMIT, BONE_NAMES[bone], float(check.excess[row, bone]))
            for bone in np.flatnonzero(~check.valid[row])
            if LIMITS[check.limit[row, bone]] != "parent"  # the parent is a break itself
        ]
        breaks += [
            Break(LENGTH, LENGTH_GROUPS[group], float(beyond[row, group]))
            for group in np.flatnonzero(beyond[row] > 0)
        ]
        far = _misfits(OBSERVED[root](model, frame, candidate), joints[row])
        breaks += [
            Break(TAU, JOINTS[joint], float(far[joint])) for joint in np.flatnonzero(far > 1)
        ]
        found.append({(one.kind, one.part): one for one in breaks})
    return found


def hung(case: Case, candidate: Candidate) -> np.ndarray:
    """`(15, 3)`: the case's true bones on a candidate's torso, camera axes, the candidate's body
    units."""
    joints = np.zeros((NUM_JOINTS, 3))
    joints[list(TORSO_INDEX)] = np.asarray(candidate.camera.view(candidate.torso))
    for bone in BONES:  # upper bones come before those that hang from them
        vector = case.scale * (case.pose[bone.end] - case.pose[bone.start])
        joints[bone.end] = joints[bone.start] + vector / float(candidate.camera.scale)
    return joints


def _misfits(observation: Observation, joints: np.ndarray) -> np.ndarray:
    """`(15,)`: distances from the detections in radii τ, 0 where a joint has no factor."""
    return np.sqrt(np.asarray(observation.squares(joints))) / observation.law.reach


def _of_limbs(model: PoseModel, frame: Estimate, candidate: Candidate) -> Observation:
    return frame.likelihood.observe(frame.detection, candidate.root)


def _of_all(model: PoseModel, frame: Estimate, candidate: Candidate) -> Observation:
    camera = candidate.camera
    point = RootPoint(0, camera.rotation, np.log(float(camera.scale)), camera.translation)
    posterior = frame.posterior(model)
    # Where joints are seen depends on the camera alone; the true torso is in no dictionary.
    seen = posterior.detected.under(posterior.root_prior, point, Faults.none())
    return seen._replace(root=candidate.root)


OBSERVED = {CANDIDATES: _of_limbs, UNCERTAIN: _of_all}
"""What a candidate's camera sees of a detection, by what the posterior holds of the root."""


def _reasons(mine: dict, right: dict, with_camera: dict, with_torso: dict) -> list[Reason]:
    """What is broken under the estimate: already under the truth it is the model's own; otherwise
    it is the camera's if the true camera alone mends it, the torso's if the true torso alone
    does."""
    found = []
    for key, broken in mine.items():
        if key in right:
            found.append(Reason(broken.kind, broken))
        else:
            mended = key not in with_camera, key not in with_torso
            source = {(True, False): CAMERA, (False, True): TORSO}.get(mended, BOTH)
            found.append(Reason(source, broken))
    return found


class Rank(NamedTuple):
    """A reason over many instances: how many it excludes, how many it alone excludes, and the
    middle amount by kind of what is broken (limit: degrees; length: share of the range's end; τ:
    radii)."""

    label: str
    excluded: int
    alone: int
    amounts: dict[str, float]


def ranking(found: Sequence[Sequence[Reason]]) -> list[Rank]:
    """The reasons of many instances, commonest first."""
    labels = [{reason.label for reason in reasons} for reasons in found]
    ranks = []
    for label in sorted(set().union(*labels)):
        broken = [reason.broken for reasons in found for reason in reasons if reason.label == label]
        amounts = {
            kind: float(np.nanmedian([one.much for one in broken if one.kind == kind] or [np.nan]))
            for kind in (LIMIT, LENGTH, TAU)
            if any(one.kind == kind and np.isfinite(one.much) for one in broken)
        }
        ranks.append(
            Rank(
                label,
                sum(label in one for one in labels),
                sum(one == {label} for one in labels),
                amounts,
            )
        )
    return sorted(ranks, key=lambda rank: -rank.excluded)


def as_text(reasons: Sequence[Reason]) -> str:
    """Reasons as one line of JSON, for a file."""
    return json.dumps([(reason.source, *reason.broken) for reason in reasons])


def from_text(text: str) -> list[Reason]:
    """What `as_text` wrote."""
    return [
        Reason(source, Break(kind, part, float(much)))
        for source, kind, part, much in json.loads(text)
    ]
