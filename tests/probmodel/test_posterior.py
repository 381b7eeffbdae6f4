"""The posterior as one value: its program, its weights and its densities are the same thing."""

import dataclasses

import jax
import numpy as np
import pytest
from numpyro.infer import Predictive
from numpyro.infer.util import log_density

from poseterior.probmodel import BadInput, Candidate, Estimate, Likelihood, PoseModel
from poseterior.probmodel.model import log_joint
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX
from tests.scenes import prior_scene

SITES = ("bone_length", "upper", "lower")


@pytest.fixture(scope="module")
def posterior() -> Posterior:
    """A scene under three roots: the truth, the truth shrunk a little, and one that is far off."""
    model = PoseModel()
    frame = prior_scene(model, 3, factor=1.0)
    (truth,) = frame.candidates
    camera = truth.camera
    smaller = dataclasses.replace(truth, camera=camera._replace(scale=camera.scale * 0.97))
    away = dataclasses.replace(
        truth, camera=camera._replace(translation=camera.translation + np.array([500.0, 0.0]))
    )
    return dataclasses.replace(frame, candidates=(truth, smaller, away)).posterior(
        model, CANDIDATES
    )


def test_root_weights_by_hand(posterior) -> None:
    """Uniform discs of the torso's joints, their scores normalised among themselves."""
    torso = list(TORSO_INDEX)
    score, keypoints = posterior.detection.score[torso], posterior.detection.keypoints[torso]
    log_weight = []
    for root in posterior.candidates:
        radius = root.camera.scale * score.mean() / score
        far = np.linalg.norm(np.asarray(root.camera.project(root.torso)) - keypoints, axis=1)
        inside = (far <= radius).all()
        log_weight.append(-np.log(np.pi * radius**2).sum() if inside else -np.inf)
    assert np.isinf(log_weight[2])
    assert np.isfinite(log_weight[:2]).all()
    expected = log_weight - np.logaddexp.reduce(log_weight)
    np.testing.assert_allclose(posterior.root_prior.log_weight, expected, rtol=1e-12)


def test_where_no_root_fits_the_torso_says_nothing(posterior) -> None:
    far = Estimate(posterior.detection, posterior.candidates[2:] * 2)
    weight = far.posterior(posterior.model, CANDIDATES).root_prior.log_weight
    np.testing.assert_allclose(weight, np.log([0.5, 0.5]))


def test_weights_are_root_weights_times_the_discs(posterior) -> None:
    """A root whose scale is 3 % smaller has smaller discs, in pixels, for every joint seen."""
    ratio = posterior.log_weights[1] - posterior.log_weights[0]
    seen = int(np.sum(posterior.observations[0].seen))
    torso = posterior.root_prior.log_weight[1] - posterior.root_prior.log_weight[0]
    assert ratio == pytest.approx(torso - 2 * seen * np.log(0.97))


def test_the_program_is_the_mixture(posterior) -> None:
    """Density of the program at each root = weight of the root × joint density under it, and
    NumPyro draws roots by their weights."""
    drawn = Predictive(posterior.model.prior, num_samples=1)(jax.random.key(0))
    pose = {name: drawn[name][0] for name in SITES}
    estimate = Estimate(posterior.detection, posterior.candidates, Likelihood(factor=30.0))
    wide = estimate.posterior(posterior.model, CANDIDATES)
    for index in range(2):
        found, _ = log_density(wide.program, (), {}, pose | {"root": index})
        under = log_joint(wide.model, wide.observations[index], *pose.values())
        assert np.isfinite(found)
        np.testing.assert_allclose(found, wide.root_prior.log_weight[index] + under, rtol=1e-12)
    roots = Predictive(posterior.program, num_samples=2000)(jax.random.key(1))["root"]
    share = np.bincount(np.asarray(roots), minlength=3) / 2000
    weight = np.exp(posterior.root_prior.log_weight)
    error = np.sqrt(weight * (1 - weight) / 2000)
    assert (np.abs(share - weight) <= 4 * error).all()  # false alarm 6e-5 a root
    assert share[2] == 0


def test_a_program_that_nobody_asked_before_can_be_traced(posterior) -> None:
    """A sampler's trace may be what asks for weights and observations first: they are numbers then
    too, and stay so."""
    fresh = dataclasses.replace(posterior)
    roots = Predictive(fresh.program, num_samples=10)(jax.random.key(1))["root"]
    assert np.array_equal(
        roots, Predictive(posterior.program, num_samples=10)(jax.random.key(1))["root"]
    )
    np.testing.assert_array_equal(fresh.log_weights, posterior.log_weights)
    for leaf in jax.tree.leaves((fresh.observations, fresh.root_prior.log_weight)):
        assert not isinstance(leaf, jax.core.Tracer)


def test_an_observation_is_in_body_units_on_the_plane(posterior) -> None:
    observation, root = posterior.observations[0], posterior.candidates[0]
    pixels = np.asarray(root.camera.to_pixels(observation.target))
    seen = np.asarray(observation.seen)
    np.testing.assert_allclose(pixels[seen], posterior.detection.keypoints[seen], rtol=1e-12)
    spread = posterior.likelihood.spread(posterior.detection, root.camera.scale)
    np.testing.assert_allclose(observation.spread * root.camera.scale, spread)
    np.testing.assert_array_equal(np.isinf(observation.reach), ~seen)
    joints = np.random.default_rng(0).normal(size=(4, NUM_JOINTS, 3))
    far = np.linalg.norm(joints[..., :2] - observation.target, axis=-1)
    np.testing.assert_allclose(observation.distances(joints), far, rtol=1e-12)
    squares = np.where(seen, (far / observation.spread) ** 2, 0.0)
    np.testing.assert_allclose(observation.squares(joints), squares, rtol=1e-12)
    np.testing.assert_allclose(observation.misfit(joints), np.sqrt(squares.max(axis=1)))


def test_a_likelihood_without_sense_is_refused(posterior) -> None:
    with pytest.raises(BadInput, match="factor of the radii"):
        dataclasses.replace(posterior, likelihood=Likelihood(factor=-1.0)).observations  # noqa: B018


def test_an_estimate_is_its_posterior_but_for_the_model(posterior) -> None:
    (one, *_) = posterior.candidates
    estimate = Estimate(posterior.detection, (one,), Likelihood(), "somebody")
    again = estimate.posterior(posterior.model, CANDIDATES)
    assert isinstance(one, Candidate)
    assert (again.candidates, again.estimator) == ((one,), "somebody")
    np.testing.assert_array_equal(again.observations[0].spread, estimate.observation.spread)
