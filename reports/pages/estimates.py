"""Single 3D estimates and the draws around them, of people whom nothing was learned from: what
reports/estimators.md shows.

Errors are mean joint errors in mm after limb scaling and similarity alignment.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from poseterior import inference
from poseterior.inference.studies.errors import best_of, mean_joint_error
from poseterior.probmodel import Anatomy, Detection, Estimate, PoseModel
from poseterior.probmodel.datasets import VIEWS, body_height
from poseterior.probmodel.learning.dictionaries import PoseDictionary, learn_dictionary
from poseterior.probmodel.learning.learner import learn
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import LIMB_JOINTS, NUM_JOINTS
from poseterior.reports.pages.people import without

PER_TRIAL, DRAWN_PER_TRIAL = 3, 2
RECOVERY_NOISE = (0.0, 0.02, 0.05)
"""Standard deviation of the 2D noise, each way, as a share of the body height."""
MISSING = (0, 1, 2)
ESTIMATE_DRAWS, HYPOTHESES, ESTIMATE_BUDGET = 2000, 5, 20_000_000
MEAN = "mean"
"""The mean pose, as if it were an estimate."""
METHODS = ("dictionary", "akhter-black", "zhou")
DRAWN_METHODS = METHODS[1:]
SCORE, RECOVERY_CENTRE = 0.8, 320
PIXELS = 0.2
"""Pixels a millimetre."""


class HeldOut(NamedTuple):
    """One person's poses `(n, 15, 3)` (mm, Y up), the trial of each, and what was learned from
    everybody else."""

    poses: np.ndarray
    trial: np.ndarray
    dictionary: PoseDictionary
    anatomy: Anatomy


def hold_out(motions: Sequence[Motion], subject: str) -> HeldOut:
    """Some poses of a person, and what is learned without that person."""
    own = [motion for motion in motions if motion.subject == subject]
    others = without(motions, [subject])
    poses = []
    trial = []
    for motion in own:
        joints = motion.without_jumps().joints
        chosen = np.linspace(0, len(joints) - 1, PER_TRIAL + 2).astype(int)[1:-1]
        poses.append(joints[chosen])
        trial += [motion.name] * PER_TRIAL
    return HeldOut(np.concatenate(poses), np.array(trial), learn_dictionary(others), learn(others))


class NoisyPose(NamedTuple):
    """A pose in camera axes `truth` `(15, 3)` mm, a detection of it, and the number of its pose."""

    truth: np.ndarray
    detection: Detection
    pose: int


def four_views(number: int) -> list[int]:
    """All yaws, the tilts by turns."""
    return [2 * yaw + (number + yaw) % 2 for yaw in range(4)]


def one_view(number: int) -> list[int]:
    """The views by turns."""
    return [number % len(VIEWS)]


def one_view_of_some(number: int) -> list[int]:
    """As `one_view`, of the first poses of each trial."""
    return one_view(number) if number % PER_TRIAL < DRAWN_PER_TRIAL else []


def cases(
    held: HeldOut, noise: float, missing: int, views: Callable[[int], Iterable[int]], seed: int = 0
) -> list[NoisyPose]:
    """Every pose from some of the `VIEWS`. With more joints missing the same ones are, and others
    besides; the noise of a pose and view is the same at every level, only larger."""
    found = []
    for number, pose in enumerate(held.poses):
        for view in views(number):
            rng = np.random.default_rng([seed, number, view])
            truth = VIEWS[view].see(pose)
            offset = rng.normal(size=(NUM_JOINTS, 2)) * noise * body_height(pose)
            score = np.full(NUM_JOINTS, SCORE)
            score[rng.permutation(LIMB_JOINTS)[:missing]] = 0
            points = PIXELS * (truth[:, :2] + offset) + RECOVERY_CENTRE
            keypoints = np.where(score[:, None] > 0, points, np.nan)
            found.append(
                NoisyPose(truth, Detection(keypoints, score, "synthetic", "a pose", 0), number)
            )
    return found


def estimates(held: HeldOut, some: Sequence[NoisyPose], method: str) -> list[Estimate]:
    """With what was learned from others."""
    return inference.estimate_torsos(
        [case.detection for case in some],
        method,
        torsos=held.anatomy.torsos,
        limits=held.anatomy.limits,
        poses=held.dictionary,
    )


def single_errors(held: HeldOut, some: Sequence[NoisyPose], method: str) -> np.ndarray:
    """Errors `(n,)` of the single estimates."""
    truth = np.stack([case.truth for case in some])
    if method == MEAN:
        return mean_joint_error(np.broadcast_to(held.dictionary.mean, truth.shape), truth)
    poses = np.stack([np.asarray(one.pose, float) for one in estimates(held, some, method)])
    return mean_joint_error(poses, truth)


class Sampled(NamedTuple):
    """Errors of one case: the single estimate, the best of five hypotheses, the best of all
    draws."""

    single: float
    best: float
    any_draw: float


def sampled_errors(held: HeldOut, some: Sequence[NoisyPose], method: str) -> list[Sampled | None]:
    """None where no pose was possible, or too few within the budget."""
    model = PoseModel.from_anatomy(held.anatomy)
    found: list[Sampled | None] = []
    for number, (case, frame) in enumerate(zip(some, estimates(held, some, method), strict=True)):
        result = inference.sample(
            model,
            frame,
            root=CANDIDATES,
            key=jax.random.key(number),
            num_samples=ESTIMATE_DRAWS,
            max_proposals=ESTIMATE_BUDGET,
        )
        if result.num_draws < HYPOTHESES:
            found.append(None)
            continue
        five = np.stack([one.joints for one in inference.hypotheses(result, HYPOTHESES)])
        every = np.asarray(result.tree["posterior"].joints)[0]
        single = mean_joint_error(np.asarray(frame.pose, float), case.truth)
        bests = (best_of(five, case.truth), best_of(every, case.truth))
        found.append(Sampled(*map(float, (single, *bests))))
    return found


class Singles(NamedTuple):
    """Errors by (method, noise, missing), and trial and subject of each case."""

    errors: dict[tuple[str, float, int], np.ndarray]
    trial: np.ndarray
    subject: np.ndarray


def study_singles(people: Mapping[str, HeldOut]) -> Singles:
    """Four views of every pose, with all noise and missing joints."""
    errors: dict[tuple[str, float, int], np.ndarray] = {}
    for noise in RECOVERY_NOISE:
        for missing in MISSING:
            parts = {name: cases(held, noise, missing, four_views) for name, held in people.items()}
            for method in (MEAN, *METHODS):
                if missing and method in (MEAN, "dictionary"):  # these do not look at limbs
                    errors[method, noise, missing] = errors[method, noise, 0]
                    continue
                found = [single_errors(people[name], part, method) for name, part in parts.items()]
                errors[method, noise, missing] = np.concatenate(found)
                print(method, noise, missing, errors[method, noise, missing].mean(), flush=True)
    trials = [people[name].trial[[case.pose for case in part]] for name, part in parts.items()]
    trial = np.concatenate(trials)
    return Singles(errors, trial, np.array([name[:2] for name in trial]))


class Scores(NamedTuple):
    """By (method, missing): `(n, 3)` errors of `Sampled` and the trial of each; counts of cases
    without draws."""

    errors: dict[tuple[str, int], np.ndarray]
    trial: dict[tuple[str, int], np.ndarray]
    lost: dict[tuple[str, int], int]


def study_draws(people: Mapping[str, HeldOut]) -> Scores:
    """One view of some poses, the views taking turns; true 2D."""
    drawn = Scores({}, {}, {})
    for at in [(method, missing) for method in DRAWN_METHODS for missing in MISSING]:
        method, missing = at
        errors = []
        trial = []
        lost = 0
        for held in people.values():
            some = cases(held, 0.0, missing, one_view_of_some)
            for case, found in zip(some, sampled_errors(held, some, method), strict=True):
                if found is None:
                    lost += 1
                else:
                    errors.append(found)
                    trial.append(held.trial[case.pose])
        drawn.errors[at] = np.array(errors)
        drawn.trial[at] = np.array(trial)
        drawn.lost[at] = lost
        print(at, drawn.errors[at].mean(axis=0), lost, flush=True)
    return drawn


def turned(case: NoisyPose, angle: float) -> NoisyPose:
    """The detection after a rotation of the image about its middle, degrees."""
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()[:2, :2]
    keypoints = (case.detection.keypoints - RECOVERY_CENTRE) @ turn.T + RECOVERY_CENTRE
    return case._replace(detection=dataclasses.replace(case.detection, keypoints=keypoints))
