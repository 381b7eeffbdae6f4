"""Frozen targets as the product's own values: as an `Estimate`, a `Posterior`, a NumPyro program,
and in JAX, where they have gradients.

    in_jax(load("arm"))                            # log_density, with jax.grad
    model, frame = frozen_model(), estimate(load("arm"))
    model.posterior                                # NumPyro program of frame.observation
    estimate(scene).posterior(model_of(scene)).program   # that of root and pose: load("scene")
"""

import functools
from importlib import resources

import numpy as np

from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark.anatomy import ANATOMY_FILE
from poseterior.inference.benchmark.external.posterior import PosteriorTarget
from poseterior.inference.benchmark.forms import SamplerTarget
from poseterior.inference.benchmark.root import GivenRoot
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.benchmark.uncertain import UncertainTarget
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.laws import LAWS
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.roots import Candidate


@functools.cache
def frozen_model() -> PoseModel:
    """The model of the frozen anatomy."""
    with resources.as_file(
        resources.files("poseterior.inference.benchmark.data") / ANATOMY_FILE
    ) as path:
        return PoseModel.from_anatomy(Anatomy.load(path))


def estimate(target: FrozenTarget) -> Estimate:
    """The target's detection and its root, if that is fixed: body axes are then those of the
    camera, and a pixel is a body unit."""
    keypoints = np.where(target.score[:, None] > 0, target.seen_at, np.nan)
    detection = Detection(keypoints, target.score, "benchmark", target.name, 0)
    likelihood = Likelihood(LAWS[target.law](), factor=target.factor)
    if not isinstance(target.root, GivenRoot):
        return Estimate(detection, (), likelihood)
    camera = WeakPerspective(1.0, np.eye(3), np.zeros(2))
    return Estimate(detection, (Candidate(-1, target.root.view, camera, 0.0),), likelihood)


def model_of(target: FrozenTarget) -> PoseModel:
    """The model of the frozen anatomy, with the torsos of the target in their order where its root
    is uncertain: `estimate(target).posterior(model_of(target))` is then the target but for its box,
    since that posterior's priors of scale and place have no bounds."""
    frozen = frozen_model()
    if isinstance(target.root, GivenRoot):
        return frozen
    return PoseModel(frozen.limits, frozen.lengths, target.root.torsos)


def in_jax(target: SamplerTarget) -> Target | UncertainTarget:
    """The target in JAX, on R^d."""
    if isinstance(target, PosteriorTarget):
        return target.density
    if not isinstance(target, FrozenTarget):
        raise TypeError(f"{target.name} is no target of ours, and has no form in JAX")
    root = target.root
    frame = estimate(target)
    model = model_of(target)
    if isinstance(root, GivenRoot):
        return Target.of(frame.posterior(model, CANDIDATES))
    return UncertainTarget.of(target, root, frame.posterior(model))
