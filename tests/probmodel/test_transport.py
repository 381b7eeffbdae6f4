"""The transport from the unit cube: the same law as ancestral sampling, its inverse, gradient and
Jacobian."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpyro.infer import Predictive

from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.transport import CUBE_DIM, Pose, from_cube, to_cube
from tests.goodness import energy_p_value, floor, uniform_each

RNG = np.random.default_rng(12)
CUBE = RNG.random((1000, CUBE_DIM))
MEASURES = [("angle", "area"), pytest.param(("area", "box"), marks=pytest.mark.slow)]


@pytest.fixture(scope="module", params=MEASURES, ids=["eqs. 7 and 8", "area and box"])
def model(request) -> PoseModel:
    upper, lower = request.param
    return PoseModel(upper=upper, lower=lower)


@pytest.fixture(scope="module")
def ancestral(model) -> dict[str, jax.Array]:
    return Predictive(model.prior, num_samples=1000)(jax.random.key(5))


def test_dimension() -> None:
    assert CUBE_DIM == 23


@pytest.mark.slow
def test_round_trip_and_support(model) -> None:
    """1,000 points: back to the cube to 1e-9, every one possible."""
    configuration = from_cube(model, CUBE)
    np.testing.assert_allclose(to_cube(model, configuration), CUBE, atol=1e-9)
    assert np.isfinite(model.log_prior(*configuration)).all()


@pytest.mark.slow
def test_shapes() -> None:
    model = PoseModel()
    one, many = (from_cube(model, cube) for cube in (CUBE[0], CUBE[:6].reshape(2, 3, CUBE_DIM)))
    assert [part.shape for part in one] == [(5,), (5, 3), (4, 3)]
    assert [part.shape for part in many] == [(2, 3, 5), (2, 3, 5, 3), (2, 3, 4, 3)]
    np.testing.assert_allclose(many.lower[0, 0], one.lower, atol=1e-12)
    assert to_cube(model, many).shape == (2, 3, CUBE_DIM)


@pytest.mark.slow
def test_ancestral_draws_become_uniform(model, ancestral) -> None:
    """1,000 draws of the NumPyro prior through the inverse: Kolmogorov–Smirnov on 23 coordinates,
    false alarm 1e-4."""
    configuration = Pose(ancestral["bone_length"], ancestral["upper"], ancestral["lower"])
    p_values = uniform_each(to_cube(model, configuration))
    assert p_values.min() > floor(CUBE_DIM), p_values


def test_a_wrong_measure_is_found_out(model, ancestral) -> None:
    """Negative control: 1,000 draws under one pair of measures are not uniform under the other
    pair."""
    other = PoseModel(upper="area", lower="box") if model.upper == "angle" else PoseModel()
    configuration = Pose(ancestral["bone_length"], ancestral["upper"], ancestral["lower"])
    assert uniform_each(jax.jit(to_cube)(other, configuration)).min() < floor(CUBE_DIM)


@pytest.mark.slow
def test_poses_from_the_cube_equal_ancestral_poses_in_law(model, ancestral) -> None:
    """Energy-distance permutation test on 1,000 + 1,000 poses of 45 numbers, 999 permutations:
    false alarm 0.001."""
    torso = jnp.asarray(model.torsos)[RNG.integers(len(model.torsos), size=len(CUBE))]
    poses = np.asarray(model.joints(torso, *from_cube(model, CUBE)))
    both = [np.asarray(x).reshape(1000, -1) for x in (poses, ancestral["joints"])]
    assert energy_p_value(*both, np.random.default_rng(0)) > 0.001


@pytest.mark.slow
def test_gradient_equals_finite_differences(model) -> None:
    """A smooth functional of the pose along random lines, at points away from the borders between
    cells."""

    def height(cube: jax.Array) -> jax.Array:
        return jnp.sum(jnp.sin(model.joints(jnp.asarray(model.torsos)[0], *from_cube(model, cube))))

    gradient = jax.jit(jax.vmap(jax.grad(height)))
    value = jax.jit(jax.vmap(height))
    line = RNG.normal(size=(200, CUBE_DIM))
    step = 1e-7
    points = 0.05 + 0.9 * CUBE[:200]
    numeric = (value(points + step * line) - value(points - step * line)) / (2 * step)
    exact = np.einsum("ni,ni->n", gradient(points), line)
    assert np.isfinite(exact).all()
    error = np.abs(numeric - exact) / (1 + np.abs(exact))
    # A few lines cross from one cell into the next, where lower bones jump.
    assert np.mean(error < 1e-4) > 0.95, np.sort(error)[-20:]


@pytest.mark.slow
def test_jacobian_is_one_over_the_prior(model) -> None:
    """Log of the volume element of (lengths, directions) per unit of the cube, by autodiff, is
    minus the log prior. The Jacobian is block triangular: within a cell a lower bone's law does not
    move with its parent."""
    points = 0.02 + 0.96 * CUBE[:40]
    jacobian = jax.jit(jax.vmap(jax.jacfwd(lambda cube: from_cube(model, cube))))(points)
    log_volume = np.log(np.einsum("nii->ni", jacobian.length[..., :5])).sum(axis=-1)
    for part, first in ((jacobian.upper, 5), (jacobian.lower, 15)):
        for bone in range(part.shape[1]):
            own = np.asarray(part[:, bone, :, first + 2 * bone : first + 2 * bone + 2])
            log_volume = log_volume + np.log(
                np.linalg.norm(np.cross(own[..., 0], own[..., 1]), axis=-1)
            )
    np.testing.assert_allclose(log_volume, -model.log_prior(*from_cube(model, points)), atol=1e-5)


def test_jit_with_the_model_as_an_argument(model) -> None:
    back = jax.tree.unflatten(*reversed(jax.tree.flatten(model)))
    assert (back.upper, back.lower) == (model.upper, model.lower)
    for a, b in zip(from_cube(back, CUBE), from_cube(model, CUBE), strict=True):
        np.testing.assert_array_equal(a, b)
