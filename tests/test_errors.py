"""Errors of poses: what they must not depend on, what they must see, and a second route to the alignment."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from inference.errors import best_of, joint_errors, limb_scaled, mean_joint_error, similarity_aligned
from probmodel import BadInput
from probmodel.dictionaries import PoseDictionary, bone_vectors

TRUTH = PoseDictionary.default().mean
RNG = np.random.default_rng(3)
NOISY = TRUTH + RNG.normal(size=TRUTH.shape) * 0.2


def moved(joints: np.ndarray) -> np.ndarray:
    """The pose somewhere else, turned and larger."""
    return 3.0 * joints @ Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix().T + np.array([1.0, 2.0, -3.0])


def test_place_turn_scale_and_limb_lengths_do_not_count():
    longer = limb_scaled(TRUTH, TRUTH * np.array([1.0, 1.3, 0.8]))
    across = np.cross(bone_vectors(longer), bone_vectors(TRUTH))
    assert np.abs(across).max() < 1e-12
    assert mean_joint_error(moved(longer), TRUTH) == pytest.approx(0.0, abs=1e-12)
    assert mean_joint_error(moved(NOISY), TRUTH) == pytest.approx(float(mean_joint_error(NOISY, TRUTH)), rel=1e-9)


def test_a_mirror_image_does_count():
    """A similarity has no reflection: the mirrored pose of an asymmetric one is another pose."""
    assert mean_joint_error(NOISY * np.array([-1.0, 1.0, 1.0]), NOISY) > 0.05


def test_alignment_is_the_least_squares_one():
    """Against a minimiser over rotation vector, log scale and translation, from several starts (second route)."""

    def cost(parameters: np.ndarray) -> float:
        turned = NOISY @ Rotation.from_rotvec(parameters[:3]).as_matrix().T
        return float(np.sum((np.exp(parameters[3]) * turned + parameters[4:] - TRUTH) ** 2))

    ours = np.sum((similarity_aligned(moved(NOISY), TRUTH) - TRUTH) ** 2)
    starts = [np.concatenate([Rotation.random(rng=RNG).as_rotvec(), np.zeros(4)]) for _ in range(8)]
    assert ours == pytest.approx(min(minimize(cost, start).fun for start in starts), rel=1e-6)


def test_lengths_are_the_true_ones_afterwards():
    scaled = limb_scaled(NOISY, TRUTH)
    wanted = np.linalg.norm(bone_vectors(TRUTH), axis=-1)
    assert np.linalg.norm(bone_vectors(scaled), axis=-1) == pytest.approx(wanted)


def test_batches_are_what_single_poses_are():
    many, truths = np.stack([NOISY, TRUTH, NOISY + 1]), np.stack([TRUTH, NOISY, TRUTH])
    assert joint_errors(many, truths).shape == (3, 15)
    alone = [float(mean_joint_error(one, truth)) for one, truth in zip(many, truths, strict=True)]
    assert mean_joint_error(many, truths) == pytest.approx(alone)
    assert best_of(many, TRUTH) == pytest.approx(0.0, abs=1e-12)
    assert best_of(many[None], truths[:1]).shape == (1,)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="cannot be compared"):
        similarity_aligned(TRUTH, TRUTH[:7])
    collapsed = TRUTH.copy()
    collapsed[4] = collapsed[3]
    with pytest.raises(BadInput, match="right_wrist on the joint before it"):
        limb_scaled(collapsed, TRUTH)
