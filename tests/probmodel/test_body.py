"""Body units, lengths of bones, mirror images: by hand, on bodies whose numbers are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from poseterior.probmodel.body import (
    align_torsos,
    body_unit,
    bone_lengths,
    mean_torso,
    mirror_pose,
    mirror_torso,
    with_lengths,
)
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, NUM_JOINTS, TORSO_INDEX

LENGTHS = {"upper_arm": 0.75, "forearm": 0.5, "upper_leg": 1.25, "lower_leg": 1.5}
"""Of the limbs: their mean is one."""
RNG = np.random.default_rng(0)


def body(head: float, count: int = 4) -> np.ndarray:
    """Poses `(count, 15, 3)` at random, all with `LENGTHS`; the torso's bones have length 3."""
    lengths = np.full(NUM_JOINTS - 1, 3.0)
    for bone in BONES:
        group = bone.name.removeprefix("right_").removeprefix("left_")
        lengths[bone.end - 1] = head if group == "head" else LENGTHS[group]
    return with_lengths(np.random.default_rng(0).normal(size=(count, NUM_JOINTS, 3)), lengths)


@pytest.mark.parametrize("head", [0.2, 1.0, 7.0])
def test_the_body_unit_is_the_mean_limb_whatever_the_head_and_the_torso(head: float) -> None:
    assert body_unit(350 * body(head)) == pytest.approx(350)
    assert body_unit(body(head)[0]) == pytest.approx(1)
    wanted = [head, *np.repeat([0.75, 1.25], 2), *np.repeat([0.5, 1.5], 2)]
    np.testing.assert_allclose(bone_lengths(body(head)), np.tile(wanted, (4, 1)))


def test_a_bone_without_length_has_no_direction() -> None:
    joints = body(1.0)
    joints[2, JOINT_INDEX["left_wrist"]] = joints[2, JOINT_INDEX["left_elbow"]]
    with pytest.raises(BadInput, match="left_wrist"):
        with_lengths(joints, np.ones(NUM_JOINTS - 1))


def test_a_torso_mirrors_as_its_body_does() -> None:
    joints, torso = body(1.0), list(TORSO_INDEX)
    np.testing.assert_array_equal(mirror_torso(joints[:, torso]), mirror_pose(joints)[:, torso])


def test_alignment_undoes_a_turn() -> None:
    torso = body(1.0)[0, list(TORSO_INDEX)]
    turns = Rotation.random(5, rng=RNG).as_matrix()
    found = align_torsos(np.einsum("nab,jb->nja", turns, torso), torso)
    np.testing.assert_allclose(found, turns.swapaxes(1, 2), atol=1e-12)


def test_torsos_are_not_reflected() -> None:
    """Onto its own mirror image a torso is turned as well as that goes, by a proper rotation."""
    torso = body(1.0)[:, list(TORSO_INDEX)] - body(1.0)[:, :1]
    found = align_torsos(torso * np.array([-1.0, 1.0, 1.0]), torso[0])
    np.testing.assert_allclose(np.linalg.det(found), 1.0)


def test_the_mean_torso_stands_in_body_axes() -> None:
    """y along the back, x towards the left, whatever way the torsos that are averaged look."""
    torso = np.array(
        [[0, 0, 0], [0, 1.5, 0], [-0.5, 1.5, 0], [0.5, 1.5, 0], [-0.3, 0, 0], [0.3, 0, 0]]
    )
    turned = np.einsum("nab,jb->nja", Rotation.random(9, rng=RNG).as_matrix(), torso) + 4.0
    np.testing.assert_allclose(mean_torso(turned), torso, atol=1e-12)
