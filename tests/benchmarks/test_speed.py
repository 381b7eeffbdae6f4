"""What the main job costs, piece by piece: `make bench`. Times are for comparison within one run
only."""

import jax
import pytest

from poseterior import inference
from poseterior.probmodel import PoseModel
from poseterior.probmodel.example import example
from tests.witnesses.limbs import build_groups
from tests.witnesses.patches import limbs_of, plan_limb, propose_limb
from tests.witnesses.pruned import BATCH, group_prior


@pytest.fixture(scope="module")
def problem():
    model = PoseModel()
    frame = inference.estimate_torso(example().detection)
    return model, frame, build_groups(model, frame.observation)["arms"]


def test_the_floor_random_numbers_alone(benchmark):
    """Six uniform numbers a proposal."""
    draw = jax.jit(lambda key: jax.random.uniform(key, (6, BATCH)))
    benchmark(lambda: jax.block_until_ready(draw(jax.random.key(0))))


def test_set_up_of_a_limb(benchmark, problem):
    limb = limbs_of(problem[2])[0]
    benchmark(lambda: jax.block_until_ready(plan_limb(limb)))


def test_a_batch_of_pruned_proposals(benchmark, problem):
    limb = limbs_of(problem[2])[0]
    plan = plan_limb(limb)
    benchmark(lambda: jax.block_until_ready(propose_limb(jax.random.key(0), limb, plan, BATCH)))


def test_a_batch_of_arms_from_the_prior(benchmark, problem):
    benchmark(lambda: jax.block_until_ready(group_prior(jax.random.key(0), problem[2], BATCH)))


def test_estimating_torso_and_camera(benchmark):
    detection = example().detection
    benchmark(lambda: inference.estimate_torso(detection))


def test_ten_thousand_exact_draws(benchmark, problem):
    model, frame, _ = problem

    def run():
        return inference.sample(
            model, frame, key=jax.random.key(0), num_samples=10_000, root="candidates"
        )

    result = benchmark.pedantic(run, warmup_rounds=1, rounds=3)
    assert result.num_draws == 10_000


@pytest.mark.parametrize("sampler", ["weighted-roots", "rejection"])
def test_draws_of_an_uncertain_root(benchmark, problem, sampler):
    """4,000 weighted roots, a draw each; or ten exact draws."""
    model, frame, _ = problem
    number = 4000 if sampler == "weighted-roots" else 10
    run = lambda: inference.sample(  # noqa: E731
        model,
        frame,
        key=jax.random.key(0),
        sampler=sampler,
        num_samples=number,
        root="uncertain",
        num_roots=1000 if sampler == "rejection" else number,
    )
    result = benchmark.pedantic(run, warmup_rounds=1, rounds=3)
    assert result.num_draws == number
    effective = result.tree.attrs["effective_roots"]
    benchmark.extra_info["effective a second"] = effective / benchmark.stats.stats.median
