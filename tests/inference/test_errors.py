"""Errors of poses: what they must not depend on, what they must see, and a second route to the
alignment."""

import numpy as np
import pytest
from scipy.linalg import orthogonal_procrustes
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from poseterior.inference.studies.errors import (
    aligned_errors,
    best_of,
    joint_errors,
    limb_scaled,
    mean_joint_error,
    similarity_aligned,
)
from poseterior.probmodel import BadInput
from poseterior.probmodel.body import bone_vectors
from poseterior.probmodel.learning.dictionaries import PoseDictionary

TRUTH = PoseDictionary.default().mean
RNG = np.random.default_rng(3)
NOISY = TRUTH + RNG.normal(size=TRUTH.shape) * 0.2


def moved(joints: np.ndarray) -> np.ndarray:
    """The pose somewhere else, turned and larger."""
    return 3.0 * joints @ Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix().T + np.array(
        [1.0, 2.0, -3.0]
    )


def test_place_turn_scale_and_limb_lengths_do_not_count():
    longer = limb_scaled(TRUTH, TRUTH * np.array([1.0, 1.3, 0.8]))
    across = np.cross(bone_vectors(longer), bone_vectors(TRUTH))
    assert np.abs(across).max() < 1e-12
    assert mean_joint_error(moved(longer), TRUTH) == pytest.approx(0.0, abs=1e-12)
    assert mean_joint_error(moved(NOISY), TRUTH) == pytest.approx(
        float(mean_joint_error(NOISY, TRUTH)), rel=1e-9
    )


def test_a_mirror_image_does_count():
    """A similarity has no reflection: the mirrored pose of an asymmetric one is another pose."""
    assert mean_joint_error(NOISY * np.array([-1.0, 1.0, 1.0]), NOISY) > 0.05


def test_alignment_is_the_least_squares_one():
    """Against a minimiser over rotation vector, log scale and translation, from several starts
    (second route)."""

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


def proper_procrustes(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The alignment by SciPy's rotation fit (Wahba's problem, never a reflection), and the
    least-squares scale."""
    moved, wanted = joints - joints.mean(axis=0), truth - truth.mean(axis=0)
    turned = Rotation.align_vectors(wanted, moved)[0].apply(moved)
    return np.sum(turned * wanted) / np.sum(moved**2) * turned + truth.mean(axis=0)


@pytest.mark.parametrize("seed", range(20))
def test_alignment_is_scipys(seed):
    rng = np.random.default_rng(seed)
    joints, truth = moved(TRUTH + rng.normal(size=TRUTH.shape) * 0.5), rng.normal(size=TRUTH.shape)
    assert similarity_aligned(joints, truth) == pytest.approx(
        proper_procrustes(joints, truth), abs=1e-9
    )
    centred = [part - part.mean(axis=0) for part in (joints, truth)]
    rotation, _ = orthogonal_procrustes(*centred)
    if np.linalg.det(rotation) > 0:  # a third route, which may reflect
        ours = similarity_aligned(joints, truth) - truth.mean(axis=0)
        theirs = centred[0] @ rotation
        assert ours == pytest.approx(
            theirs * np.sum(theirs * centred[1]) / np.sum(centred[0] ** 2), abs=1e-9
        )


def test_a_reflection_is_not_undone_where_scipys_orthogonal_fit_would():
    """Half of random pairs are best aligned by a reflection; a body is not its mirror image."""
    flipped = NOISY * np.array([1.0, 1.0, -1.0])
    middle = [pose - pose.mean(axis=0) for pose in (flipped, NOISY)]
    assert np.linalg.det(orthogonal_procrustes(*middle)[0]) < 0
    assert aligned_errors(flipped, NOISY).max() > 0.1
    assert similarity_aligned(flipped, NOISY) == pytest.approx(
        proper_procrustes(flipped, NOISY), abs=1e-9
    )


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_degenerate_poses_are_aligned(rank):
    """All joints in a point, on a line, in a plane: finite, and as good as a minimiser's."""
    flat = NOISY * (np.arange(3) < rank)
    found = similarity_aligned(moved(flat), TRUTH)
    assert np.isfinite(found).all()
    if rank == 0:
        assert found == pytest.approx(np.broadcast_to(TRUTH.mean(axis=0), TRUTH.shape))
    ours = np.sum((found - TRUTH) ** 2)

    def cost(parameters: np.ndarray) -> float:
        turned = flat @ Rotation.from_rotvec(parameters[:3]).as_matrix().T
        return float(np.sum((np.exp(parameters[3]) * turned + parameters[4:] - TRUTH) ** 2))

    starts = [np.concatenate([Rotation.random(rng=RNG).as_rotvec(), np.zeros(4)]) for _ in range(4)]
    assert ours <= min(minimize(cost, start).fun for start in starts) * (1 + 1e-6)


def test_a_missing_joint_does_not_count():
    """The others are aligned as if it did not exist; the pose with it in place has the same errors
    there."""
    wrist = 4
    holed = moved(NOISY)
    holed[wrist] = np.nan
    rest = np.arange(15) != wrist
    found = aligned_errors(holed, TRUTH)
    assert np.isnan(found[wrist])
    assert found[rest] == pytest.approx(aligned_errors(moved(NOISY)[rest], TRUTH[rest]))
    scaled = joint_errors(holed, TRUTH)
    assert np.isnan(scaled[wrist])
    assert mean_joint_error(holed, TRUTH) == pytest.approx(scaled[rest].mean())
    unknown = TRUTH.copy()
    unknown[wrist] = np.nan  # the other way round
    assert aligned_errors(moved(NOISY), unknown)[rest] == pytest.approx(found[rest])


def test_beyond_a_missing_elbow_there_is_no_wrist():
    holed = NOISY.copy()
    holed[3] = np.nan
    assert np.flatnonzero(np.isnan(limb_scaled(holed, TRUTH)).any(axis=1)).tolist() == [3, 4]
    rest = [joint for joint in range(15) if joint not in (3, 4)]
    assert limb_scaled(holed, TRUTH)[rest] == pytest.approx(limb_scaled(NOISY, TRUTH)[rest])
    both = np.stack([NOISY, holed])
    assert joint_errors(both, TRUTH)[0] == pytest.approx(joint_errors(NOISY, TRUTH))


def test_without_limb_scaling_lengths_count():
    longer = limb_scaled(TRUTH, TRUTH * np.array([1.0, 1.3, 0.8]))
    assert joint_errors(longer, TRUTH).max() < 1e-12
    assert aligned_errors(longer, TRUTH).mean() > 0.02
