"""Joints and keypoints of many draws under few roots, by the compiled loop and by the model's own
formulas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from poseterior.inference.exact.placing import place_shared
from poseterior.probmodel import PoseModel
from poseterior.probmodel.camera import Lens, Perspective, WeakPerspective
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import Root

NUMBER = 60


def some_poses(model: PoseModel, random: np.random.Generator) -> Pose:
    """Directions anywhere on the sphere: the limits are no part of where joints are. Some upper
    bones are parallel to the reference direction of those below."""
    upper, lower = random.normal(size=(NUMBER, 5, 3)), random.normal(size=(NUMBER, 4, 3))
    upper[::7] = model.limits.reference
    upper[3::7] = -np.asarray(model.limits.reference)
    units = (part / np.linalg.norm(part, axis=-1, keepdims=True) for part in (upper, lower))
    return Pose(random.uniform(0.5, 1.5, (NUMBER, 5)), *units)


@pytest.mark.parametrize("lens", [None, 900.0, 40.0], ids=["weak", "far", "behind the camera"])
def test_the_loop_places_poses_as_the_model_does(lens: float | None) -> None:
    model, random = PoseModel(), np.random.default_rng(0)
    poses, points = some_poses(model, random), random.integers(3, size=NUMBER)
    turns = np.linalg.qr(random.normal(size=(3, 3, 3)))[0]
    weak = WeakPerspective(
        np.array([50.0, 60.0, 70.0]),
        turns * np.linalg.det(turns)[:, None, None],
        random.normal(size=(3, 2)) * 100,
    )
    given = None if lens is None else Lens(np.full(3, lens), np.tile([320.0, 240.0], (3, 1)))
    camera = weak if given is None else Perspective(weak, given)
    roots = Root(np.asarray(model.torsos)[[0, 5, 9]], camera)

    def one(point: jax.Array, pose: Pose) -> tuple[jax.Array, jax.Array]:
        root = jax.tree.map(lambda leaf: jnp.asarray(leaf)[point], roots)
        joints = model.joints(root.view, *pose)
        return joints, root.camera.image(joints)

    joints, keypoints = jax.vmap(one)(points, poses)
    found = place_shared(model, roots, points, poses)
    np.testing.assert_allclose(found[0], joints, atol=1e-12)
    np.testing.assert_allclose(found[1], keypoints, rtol=1e-9, atol=1e-9)
    if lens is not None:
        nearest = 1 + joints[..., 2] * (np.asarray(weak.scale)[points] / lens)[:, None]
        assert bool((nearest <= 0).any()) is (lens == 40.0)
