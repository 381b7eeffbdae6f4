"""Real poses: what is seen of them, with torso and camera true or estimated, and how their
posteriors stand.

A pose of a data set (`probmodel.datasets`) becomes an `Instance` whose truth is in the body units
of the estimate: what the image shows is the same, so pixels are what both have in common."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from inference.roots import estimate_torsos
from inference.studies.calibration.assess import Standing, assess
from inference.studies.calibration.posteriors import sampler_of
from inference.studies.calibration.simulations import Instance, detected
from probmodel.body import align_torsos
from probmodel.camera import WeakPerspective
from probmodel.datasets import Case
from probmodel.likelihood import Likelihood
from probmodel.model import PoseModel
from probmodel.posterior import Estimate
from probmodel.roots import Candidate
from probmodel.skeleton import TORSO_INDEX

TRUE = "true"
"""In place of an estimator's name: the true torso in front of the true camera."""
NUM_SAMPLES = 500
MAX_PROPOSALS = 3_000_000
"""Where no draw comes in so many proposals, none is waited for: some truths are far outside what is
possible."""
Progress = Callable[[int, int], None]


def by_the_likelihood(case: Case, factor: float = 0.25, seed: int = 0) -> Case:
    """The case with its detection drawn from the likelihood instead, scores and missing joints as
    they are."""
    rng = np.random.default_rng([seed, 2, case.number])
    exact, score = case.pixels[:, :2], case.detection.score
    found = detected(exact, score, case.scale * case.unit, factor, rng, source="likelihood")
    return dataclasses.replace(
        case, detection=dataclasses.replace(case.detection, keypoints=found.keypoints)
    )


def true_candidate(case: Case, model: PoseModel) -> Candidate:
    """The torso and camera that took the pose, in body axes as the model's torsos have them."""
    scale = case.scale * case.unit
    view = (case.pose / case.unit)[list(TORSO_INDEX)]
    rotation = align_torsos(view[None], np.asarray(model.torsos).mean(axis=0))[0].T
    return Candidate(-1, view @ rotation, WeakPerspective(scale, rotation, case.pixels[0, :2]), 0.0)


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
                settings.get("likelihood", Likelihood()),
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
    return [
        Instance(frame, (case.pixels - case.pixels[0]) / float(frame.candidates[0].camera.scale))
        for case, frame in zip(cases, frames, strict=True)
    ]


def stand_real(
    model: PoseModel,
    known: Sequence[Instance],
    *,
    sampler: str = "rejection",
    seed: int = 0,
    num_samples: int = NUM_SAMPLES,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> list[Standing]:
    """The standings of real instances. Without log density and misfit, which a torso that is not
    the true one does not have. Of several candidates each has a body unit of its own; all draws are
    brought to the first one's."""
    draw = sampler_of(sampler, model, num_samples, max_proposals=max_proposals)
    found = []
    for index, instance in enumerate(known):
        key = jax.random.fold_in(jax.random.key(seed), index)
        posterior = draw(index, instance, key)
        found.append(assess(instance, posterior, np.random.default_rng([seed, index, 1])))
        if progress:
            progress(index + 1, len(known))
    return found
