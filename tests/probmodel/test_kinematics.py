"""Local axes and forward kinematics: inverse, handedness, and what a rotation of the whole
does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.kinematics import (
    articulation,
    azimuth_elevation,
    direction,
    lower_axes,
    pose,
    unit,
    upper_axes,
)
from poseterior.probmodel.skeleton import (
    BONES,
    JOINT_INDEX,
    MIRROR,
    NUM_JOINTS,
    TORSO_INDEX,
    UPPER_BONES,
)
from tests.instances import random_triple

RNG = np.random.default_rng(0)
REFERENCE = np.array([0.1, 0.9, -0.3]) / np.linalg.norm([0.1, 0.9, -0.3])
FALLBACK = np.eye(3)[[0, 2, 0, 2]]
POSES = RNG.normal(size=(50, NUM_JOINTS, 3))


def test_pose_undoes_articulation() -> None:
    np.testing.assert_allclose(
        pose(*articulation(POSES, REFERENCE, FALLBACK), REFERENCE, FALLBACK), POSES, atol=1e-12
    )


def test_articulation_undoes_pose() -> None:
    torso, length = POSES[:, np.array(TORSO_INDEX)], RNG.uniform(0.2, 2, (50, 9))
    upper, lower = (
        np.asarray(unit(RNG.normal(size=(50, 5, 3)))),
        np.asarray(unit(RNG.normal(size=(50, 4, 3)))),
    )
    found = articulation(
        pose(torso, upper, lower, length, REFERENCE, FALLBACK), REFERENCE, FALLBACK
    )
    for a, b in zip(found, (torso, upper, lower, length), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-11)


def test_upper_axes_are_orthonormal_and_left_handed() -> None:
    axes = np.asarray(upper_axes(POSES[:, np.array(TORSO_INDEX)]))
    np.testing.assert_allclose(
        np.swapaxes(axes, -1, -2) @ axes, np.broadcast_to(np.eye(3), axes.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(axes), -1.0, rtol=1e-12)


def test_lower_axes_are_proper_in_their_parents_axes() -> None:
    axes = np.asarray(lower_axes(jnp.array([0.6, 0.0, 0.8]), REFERENCE, FALLBACK[0]))
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[:, 0], [0.6, 0.0, 0.8])


@pytest.mark.parametrize("sign", [1, -1])
def test_a_parent_along_the_reference_uses_the_fallback(sign: int) -> None:
    axes = np.asarray(lower_axes(sign * REFERENCE, REFERENCE, FALLBACK[0]))
    v = np.cross(sign * REFERENCE, FALLBACK[0])
    np.testing.assert_allclose(axes[:, 1], v / np.linalg.norm(v), atol=1e-14)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
    gradient = jax.jacrev(lambda parent: lower_axes(parent, REFERENCE, FALLBACK[0]))(
        sign * REFERENCE
    )
    assert np.isfinite(gradient).all()


def test_rotation_and_translation_change_no_local_direction() -> None:
    """The whole body turned, moved and scaled: directions are the same; lengths scale."""
    turn = random_triple(RNG)
    before = articulation(POSES, REFERENCE, FALLBACK)
    after = articulation(2.5 * (POSES + 3.0) @ turn.T, REFERENCE, FALLBACK)
    np.testing.assert_allclose(after.upper, before.upper, atol=1e-11)
    np.testing.assert_allclose(after.lower, before.lower, atol=1e-11)
    np.testing.assert_allclose(after.length, 2.5 * before.length, rtol=1e-11)


def test_a_reflection_does_change_them() -> None:
    """Negative control: a mirrored body, its sides not exchanged, has other angles."""
    after = articulation(POSES * np.array([-1.0, 1.0, 1.0]), REFERENCE, FALLBACK)
    assert np.abs(after.upper - articulation(POSES, REFERENCE, FALLBACK).upper).max() > 0.1


def test_pose_turns_with_its_torso() -> None:
    turn, parts = random_triple(RNG), articulation(POSES, REFERENCE, FALLBACK)
    turned = pose(parts.torso @ turn.T, *parts[1:], REFERENCE, FALLBACK)
    np.testing.assert_allclose(turned, POSES @ turn.T, atol=1e-11)


def test_turning_the_body_and_the_camera_together_changes_no_keypoint() -> None:
    camera = WeakPerspective(
        scale=80.0, rotation=random_triple(RNG), translation=np.array([320.0, 240.0])
    )
    turn = random_triple(RNG)
    other = camera._replace(rotation=camera.rotation @ turn.T)
    np.testing.assert_allclose(other.project(POSES @ turn.T), camera.project(POSES), atol=1e-9)
    np.testing.assert_allclose(camera.image(camera.view(POSES)), camera.project(POSES), atol=1e-12)


def test_an_upright_person_has_the_published_axes() -> None:
    """Standing, facing +z, left to +x, y up: raised forward, an arm (bone: parent minus child, so
    backwards) lies along the third axis; w = -u × v makes forward limbs point to +w's pole
    or its opposite, never to the side."""
    joints = np.zeros((NUM_JOINTS, 3))
    for name, place in {
        "thorax": (0, 1, 0),
        "right_shoulder": (-0.4, 1, 0),
        "left_shoulder": (0.4, 1, 0),
        "right_hip": (-0.2, 0, 0),
        "left_hip": (0.2, 0, 0),
    }.items():
        joints[JOINT_INDEX[name]] = place
    for bone in BONES:
        joints[bone.end] = joints[bone.start] + np.array([0.0, 0.1, 1.0])
    upper = np.asarray(articulation(joints, REFERENCE, FALLBACK).upper)
    assert (np.abs(upper[:, 2]) > 0.99).all()
    np.testing.assert_allclose(upper, np.broadcast_to(upper[0], upper.shape), atol=1e-12)


def test_legs_turn_with_the_hips_and_arms_with_the_shoulders() -> None:
    """Hips turned by 40° against the shoulders: a leg that points along the hips, and an arm along
    the shoulders, have the same local direction."""
    turn = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    joints = np.zeros((NUM_JOINTS, 3))
    for name, place in {
        "thorax": (0.0, 1.5, 0.0),
        "right_shoulder": (-0.5, 1.5, 0.0),
        "left_shoulder": (0.5, 1.5, 0.0),
        "right_hip": turn @ (-0.3, 0.0, 0.0),
        "left_hip": turn @ (0.3, 0.0, 0.0),
    }.items():
        joints[JOINT_INDEX[name]] = place
    axes = dict(zip(UPPER_BONES, upper_axes(joints[list(TORSO_INDEX)]), strict=True))
    for bone, frame in axes.items():
        along = turn[:, 0] if "leg" in bone.name else np.eye(3)[0]
        np.testing.assert_allclose(frame[:, 0], -along, atol=1e-12)


def test_mirror_is_an_involution_that_keeps_the_parents() -> None:
    assert [MIRROR[MIRROR[joint]] for joint in range(NUM_JOINTS)] == list(range(NUM_JOINTS))
    for bone in BONES:
        assert MIRROR[bone.start] in {
            other.start for other in BONES if other.end == MIRROR[bone.end]
        }


def test_azimuth_and_elevation_round_trip() -> None:
    u = np.asarray(unit(RNG.normal(size=(500, 3))))
    np.testing.assert_allclose(direction(*azimuth_elevation(u)), u, atol=1e-14)


def test_the_zero_vector_has_no_direction_and_a_finite_gradient() -> None:
    np.testing.assert_array_equal(unit(jnp.zeros(3)), 0.0)
    assert np.isfinite(jax.jacrev(unit)(jnp.zeros(3))).all()
