"""Frozen targets as tasks of sbibm: what is simulated has the target's error law, and the task is
what sbibm's own tests of its tasks ask for."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import stats

from poseterior.inference import benchmark
from poseterior.inference.benchmark.root import GivenRoot
from poseterior.inference.benchmark.target import FROZEN_LAWS
from poseterior.probmodel import BadInput

ODDS = 1e-4
"""How seldom sound simulations fail a test."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", "arm-soft", "scene"])
def test_detections_have_the_law_of_the_errors(name: str) -> None:
    """Seen from the detections that came of it, every pose explains them, and distances have the
    law that the density says, by its integral."""
    target, rng = benchmark.load(name), np.random.default_rng(1)
    points = target.prior_points(rng, 300)
    found = target.detections(points, rng)
    squares = []
    for point, seen_at in zip(points, found, strict=True):
        whole = target.seen_at.copy()
        whole[target.seen] = seen_at
        squares.append(dataclasses.replace(target, seen_at=whole).squares(point))
    sizes = np.sqrt(np.ravel(squares))
    reach, curvature = FROZEN_LAWS[target.law]
    assert sizes.max() <= reach * (1 + 1e-9)
    grid = np.linspace(0, reach, 2001)
    mass = np.cumsum(grid * np.exp(-curvature * grid**2))
    assert stats.kstest(sizes, lambda z: np.interp(z, grid, mass / mass[-1])).pvalue > ODDS
    other = np.cumsum(grid * np.exp(-(2.0 - curvature) * grid**2))
    wrong = stats.kstest(sizes, lambda z: np.interp(z, grid, other / other[-1])).pvalue
    assert wrong < ODDS**3, "the test would see the other law"


@pytest.fixture(params=["arm", "legs-soft", "scene"])
def task(request: pytest.FixtureRequest) -> tuple[str, Any]:
    pytest.importorskip("sbibm", reason="sbibm and PyTorch are not installed")
    return request.param, benchmark.sbibm_task(request.param)


@pytest.mark.slow
def test_the_task_is_what_sbibm_asks_for(task: tuple[str, Any]) -> None:
    """As its tests/tasks/test_task_interface.py."""
    import torch

    name, task = task
    target = benchmark.load(name)
    observation, truth = task.get_observation(num_observation=1), task.get_true_parameters(1)
    assert observation.shape == (1, 2 * len(target.seen))
    assert len(task.get_labels_data()) == observation.shape[-1] == task.dim_data
    assert len(task.get_labels_parameters()) == truth.shape[-1] == task.dim_parameters
    parameters = task.get_prior()(num_samples=10)
    assert parameters.shape == (10, target.dim)
    simulator = task.get_simulator(max_calls=15)
    assert simulator(parameters).shape == (10, task.dim_data)
    with pytest.raises(Exception, match=r"^$"):  # its own, without a word
        simulator(parameters)
    reference = task.get_reference_posterior_samples(num_observation=1)
    assert reference.shape == (task.num_reference_posterior_samples, target.dim)
    transform = task._get_transforms(True)["parameters"]
    jacobian = transform.log_abs_det_jacobian(transform(parameters), parameters)
    assert jacobian.shape == torch.Size([10])
    with pytest.raises(BadInput, match="has one observation, number 1, not 2"):
        task.get_observation(2)


@pytest.mark.slow
def test_the_task_s_density_is_prior_times_likelihood(task: tuple[str, Any]) -> None:
    """By its own prior in PyTorch, and the same simulations from the same seed."""
    import torch

    name, task = task
    target = benchmark.load(name)
    density = task._get_log_prob_fn(num_observation=1)
    parameters = task.get_reference_posterior_samples(1)[:200]
    found = density({"parameters": parameters}).numpy()
    points = target.points_of_box(parameters.numpy().astype(float))
    inside = np.isfinite(found)  # single precision leaves some outside
    assert inside.sum() > 150
    prior = task.get_prior_dist().log_prob(parameters).numpy()
    likelihood = target.log_likelihood(points)
    np.testing.assert_allclose(found[inside], (prior + likelihood)[inside], rtol=1e-4, atol=1e-3)
    draws = []
    for _ in range(2):
        torch.manual_seed(5)
        draws.append(task.get_simulator()(parameters))
    assert torch.equal(*draws)
    fixed = isinstance(target.root, GivenRoot)
    spread = draws[0].std(dim=0).max()
    assert (spread < 1) == fixed, "body units, or pixels"
