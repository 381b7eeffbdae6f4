"""Diverse hypotheses: nearest actual poses of k-means++ clusters, and the paper's grid."""

import numpy as np
import pytest

from poseterior import inference
from poseterior.inference.hypothesis import NUM_ANGLES, diverse
from poseterior.probmodel import BadInput, PoseModel
from poseterior.probmodel.kinematics import articulation
from tests.scenes import key, prior_scene


@pytest.fixture(scope="module")
def result():
    model = PoseModel()
    return model, inference.sample(
        model, prior_scene(model, 1, factor=0.5), key=key(0), num_samples=1500, root="candidates"
    )


def test_hypotheses_are_draws_and_their_shares_add_up(result):
    _, drawn = result
    joints = drawn.tree["posterior"].joints.values[0]
    chosen = inference.hypotheses(drawn, 5)
    assert len(chosen) == 5
    assert sum(hypothesis.weight for hypothesis in chosen) == pytest.approx(1.0)
    assert [hypothesis.weight for hypothesis in chosen] == sorted(
        (h.weight for h in chosen), reverse=True
    )
    for hypothesis in chosen:
        assert np.array_equal(hypothesis.joints, joints[hypothesis.draw])


def test_separated_clusters_are_found_with_their_nearest_member():
    """Three tight groups of known shares: each gets the member nearest to its mean."""
    rng = np.random.default_rng(0)
    centres, sizes = rng.normal(size=(3, 15, 3)) * 10, (50, 30, 20)
    poses = np.concatenate(
        [
            centre + rng.normal(size=(n, 15, 3)) * 0.1
            for centre, n in zip(centres, sizes, strict=True)
        ]
    )
    chosen = diverse(poses, 3)
    assert [hypothesis.weight for hypothesis in chosen] == [0.5, 0.3, 0.2]
    for hypothesis, start, size in zip(chosen, (0, 50, 80), sizes, strict=True):
        group = poses[start : start + size]
        distance = np.linalg.norm((group - group.mean(axis=0)).reshape(size, -1), axis=1)
        assert hypothesis.draw == start + int(np.argmin(distance))


def test_diverse_hypotheses_stand_for_more_draws_than_random_ones(result):
    """Root mean square distance from all draws to the nearest hypothesis, against 200 random
    choices of five."""
    _, drawn = result
    joints = drawn.tree["posterior"].joints.values[0]

    def left_over(poses) -> float:
        offset = joints[:, None] - np.asarray(poses)[None]
        return np.sqrt(np.sum(offset**2, axis=(2, 3)).min(axis=1).mean())

    rng = np.random.default_rng(1)
    chance = [left_over(joints[rng.choice(len(joints), 5, replace=False)]) for _ in range(200)]
    chosen = [hypothesis.joints for hypothesis in inference.hypotheses(drawn, 5)]
    assert left_over(chosen) < np.quantile(chance, 0.01)


@pytest.mark.parametrize("k", [0, 1501])
def test_k_out_of_range_is_refused(result, k):
    with pytest.raises(BadInput, match="choose k from 1 to 1500"):
        inference.hypotheses(result[1], k)


@pytest.mark.sweep
def test_the_grid_is_possible_explains_the_detection_and_lies_on_the_grid():
    model = PoseModel()
    frame = prior_scene(model, 1, factor=0.7)
    observation = frame.observation
    poses = inference.grid_poses(model, observation, most=400)
    assert len(poses) == 400
    assert model.limits.check(poses).valid.all()
    assert np.asarray(observation.explains(poses)).all()
    local = articulation(
        poses, np.asarray(model.limits.reference), np.asarray(model.limits.fallback)
    )
    azimuth = np.arctan2(local.upper[..., 1], local.upper[..., 0])
    step = (azimuth + np.pi) / (2 * np.pi / NUM_ANGLES) - 0.5
    assert np.abs(step - np.round(step)).max() < 1e-6


@pytest.mark.slow
def test_a_limb_that_the_grid_cannot_explain_leaves_no_pose():
    model = PoseModel()
    frame = prior_scene(model, 1, factor=0.01)
    assert inference.grid_poses(model, frame.observation).shape == (0, 15, 3)
