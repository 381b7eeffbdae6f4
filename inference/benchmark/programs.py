"""Frozen targets as the product's own values: as an `Estimate`, a `Posterior`, a NumPyro program,
and in JAX, where they have gradients.

    in_jax(load("arm"))                            # log_density, with jax.grad
    model, frame = frozen_model(), estimate(load("arm"))
    model.posterior                                # NumPyro program of frame.observation
"""

import functools
from importlib import resources

import numpy as np

from inference.baselines.target import Target
from inference.benchmark.anatomy import FILE
from inference.benchmark.target import FrozenTarget
from probmodel.anatomy.population import Anatomy
from probmodel.camera import WeakPerspective
from probmodel.detections import Detection
from probmodel.likelihood import LAWS, Likelihood
from probmodel.model import PoseModel
from probmodel.posterior import Estimate
from probmodel.roots import Candidate


@functools.cache
def frozen_model() -> PoseModel:
    """The model of the frozen anatomy."""
    with resources.as_file(resources.files("inference.benchmark.data") / FILE) as path:
        return PoseModel.from_anatomy(Anatomy.load(path))


def estimate(target: FrozenTarget) -> Estimate:
    """The target's detection and its root: body axes are those of the camera, and a pixel is a body
    unit."""
    keypoints = np.where(target.score[:, None] > 0, target.seen_at, np.nan)
    detection = Detection(keypoints, target.score, "benchmark", target.name, 0)
    camera = WeakPerspective(1.0, np.eye(3), np.zeros(2))
    likelihood = Likelihood(LAWS[target.law](), factor=target.factor)
    return Estimate(detection, (Candidate(-1, target.view, camera, 0.0),), likelihood)


def in_jax(target: FrozenTarget) -> Target:
    """The target in JAX, on R^d."""
    return Target.of(estimate(target).posterior(frozen_model()))
