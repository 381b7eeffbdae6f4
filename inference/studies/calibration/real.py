"""Real poses: what is seen of them, with torso and camera true or estimated, and how their
posteriors stand.

A pose of a data set (`probmodel.datasets`) becomes an `Instance` whose truth is in the body units
of the estimate: what the image shows is the same, so pixels are what both have in common."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from poseterior.inference.estimators import estimate_torsos
from poseterior.inference.studies.calibration.simulations import SPREADS, Instance, detected
from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.datasets import Case, Noise, read_data_set
from poseterior.probmodel.errors.likelihood import PAPER, Likelihood
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import TORSO_INDEX

TRUE = "true"
"""In place of an estimator's name: the true torso in front of the true camera."""
NUM_SAMPLES = 500
INSTANCE_PROPOSALS = 3_000_000
"""Where no draw comes in so many proposals, none is waited for: some truths are far outside what is
possible."""
LIKELIHOOD = "likelihood"
"""In place of a kind of noise: detections drawn from the likelihood itself."""


def read_cases(
    path: Path,
    *,
    frames: int | None = None,
    noise: str = LIKELIHOOD,
    missing: int = 0,
    likelihood: Likelihood = PAPER,
    root: str = UNCERTAIN,
    seed: int = 0,
    perspective: bool = False,
) -> tuple[list[Case], dict[str, Any]]:
    """Poses of a data set as they are seen, and what `run.cover` records of where they come from.

    Parameters
    ----------
    path
        The data set, as `read_data_set` takes it.
    frames
        How many, as many of each action (default: all).
    noise
        Of the 2D joints: `LIKELIHOOD`, or as `Noise.parse` reads it.
    missing
        Limb joints of each that are not seen, at random.
    likelihood
        How detections err, where the noise is the likelihood's own.
    root
        What the posterior will hold of the root: whether the torso's joints have the likelihood's
        law too, where detections are drawn from it.
    seed
        Of noise and of what is hidden.
    perspective
        Whether the lenses of calibrated cameras are known; the root must then be uncertain.

    Returns
    -------
    list of Case, dict
        The cases, and where they come from.

    Raises
    ------
    BadInput
        On a bad data set, noise or number.
    """
    drawn = noise == LIKELIHOOD
    kind = Noise() if drawn else Noise.parse(noise)
    if perspective and root == CANDIDATES:
        raise BadInput(
            "a known focal length needs torso and camera to be uncertain; choose the root"
            " 'uncertain', or leave perspective out"
        )
    data = read_data_set(path, frames=frames, noise=kind, seed=seed, perspective=perspective)
    cases = [case.hiding(missing, seed) for case in data]
    if drawn:
        cases = [by_the_likelihood(case, likelihood, seed, root) for case in cases]
    return cases, {"data": f"{path.name} {data.sha256}", "noise": noise, "missing": missing}


def by_the_likelihood(
    case: Case, likelihood: Likelihood = PAPER, seed: int = 0, root: str = CANDIDATES
) -> Case:
    """The case with its detection drawn from the likelihood instead, scores and missing joints as
    they are."""
    rng = np.random.default_rng([seed, 2, case.number])
    exact = case.image(case.pose)
    score = case.detection.score
    unit = case.scale * case.unit * case.magnification(case.pose)
    spread = unit * SPREADS[root](score, likelihood)
    found = detected(exact, score, spread, likelihood, rng, source="likelihood")
    return dataclasses.replace(
        case, detection=dataclasses.replace(case.detection, keypoints=found.keypoints)
    )


def true_candidate(case: Case, model: PoseModel) -> Candidate:
    """The torso and camera that took the pose, in body axes as the model's torsos have them."""
    scale = case.scale * case.unit
    view = (case.pose / case.unit)[list(TORSO_INDEX)]
    rotation = align_torsos(view[None], np.asarray(model.torsos).mean(axis=0))[0].T
    weak = WeakPerspective(scale, rotation, case.translation)
    return Candidate(-1, view @ rotation, weak.through(case.lens), 0.0)


def instances(
    cases: Sequence[Case], model: PoseModel, estimator: str = TRUE, **settings: Any
) -> list[Instance]:
    """What is seen of each case with its candidates. `settings` are those of `estimate_torsos`
    (likelihood, poses, …); torsos and limits are the model's. Raises `BadInput` on an unknown
    estimator."""
    if estimator == TRUE:
        frames = [
            Estimate(
                case.detection,
                (true_candidate(case, model),),
                settings.get("likelihood", PAPER),
                estimator=TRUE,
            )
            for case in cases
        ]
    else:
        frames = estimate_torsos(
            [case.detection for case in cases],
            estimator,
            torsos=np.asarray(model.torsos),
            limits=model.limits,
            **settings,
        )
    return [_instance(case, frame) for case, frame in zip(cases, frames, strict=True)]


def _instance(case: Case, frame: Estimate) -> Instance:
    units = case.scale / float(frame.best.camera.scale)
    return Instance(
        dataclasses.replace(frame, lens=case.lens),
        case.pose * units,
        None if case.doubt is None else case.doubt * units**2,
    )
