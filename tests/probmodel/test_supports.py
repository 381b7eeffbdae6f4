"""Constraints and their bijections: domain, codomain, inverse, and log-determinants against
autodiff."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpyro.distributions import biject_to, constraints

from tests.instances import distributions
from tests.sweeps import sweep

TABLE = distributions()
DIRECTIONS = [name for name in TABLE if name.startswith(("hinged", "occupied"))]
ROTATIONS = [name for name in TABLE if name.startswith("rotation")]
DISCS = [name for name in TABLE if name.startswith("disc")]
QUICK = ["hinged area", "occupied angle", "disc", "rotation"]
NAMES = sweep(DIRECTIONS + DISCS + ROTATIONS, QUICK)


def unconstrained(name: str, scale: float = 1.0) -> np.ndarray:
    size = (6, *TABLE[name].batch_shape, 3 if name in ROTATIONS else 2)
    return scale * np.random.default_rng(4).normal(size=size)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_bijection(name: str) -> None:
    """Shapes, codomain and inverse at sample shapes (6,) and (2, 3), and at far points of the
    plane."""
    support = TABLE[name].support
    transform = biject_to(support)
    assert transform.domain == constraints.real_vector
    assert transform.codomain == support
    x = unconstrained(name)
    y = transform(x)
    assert y.shape == transform.forward_shape(x.shape)
    assert transform.inverse_shape(y.shape) == x.shape
    assert support(y).all()
    np.testing.assert_allclose(transform.inv(y), x, rtol=1e-6, atol=1e-6)
    many = transform(x.reshape(2, 3, *x.shape[1:]))
    np.testing.assert_allclose(many.reshape(y.shape), y, rtol=1e-12, atol=1e-12)
    assert support(transform(unconstrained(name, 5.0))).all()
    assert np.isfinite(transform.inv(transform(unconstrained(name, 100.0)))).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", DIRECTIONS + DISCS)
def test_log_determinant_equals_autodiff(name: str) -> None:
    """Of directions: log of the area that a unit square of the plane sweeps on the sphere, |∂u/∂x₁
    × ∂u/∂x₂|."""
    transform = biject_to(TABLE[name].support)
    x = unconstrained(name)
    flat = x.reshape(len(x), -1)
    jacobian = (
        np.asarray(jax.vmap(jax.jacfwd(lambda x: transform(x.reshape(x_shape))))(flat))
        if (x_shape := x.shape[1:])
        else None
    )
    batch = TABLE[name].batch_shape
    jacobian = jacobian.reshape(len(x), int(np.prod(batch)), -1, int(np.prod(batch)), 2)
    # Members of a batch do not mix: the blocks on the diagonal are each member's own.
    own = np.einsum("nbibj->nbij", jacobian)
    element = (
        np.abs(np.linalg.det(own))
        if own.shape[2] == 2
        else np.linalg.norm(np.cross(own[..., 0], own[..., 1]), axis=-1)
    )
    found = transform.log_abs_det_jacobian(x, transform(x))
    np.testing.assert_allclose(found, np.log(element).reshape(len(x), *batch), atol=1e-6)


def test_log_determinant_of_rotations_equals_autodiff() -> None:
    """Haar's measure by another chart: an infinitesimal turn ω of a rotation has mass |ω|³ per
    8π², the volume of SO(3) in turns, so the determinant is that of x ↦ Rᵀ ∂R as turns."""
    transform = biject_to(TABLE["rotation"].support)
    for x in unconstrained("rotation"):
        rotation, slope = transform(x), jax.jacfwd(transform)(x)
        spin = np.einsum("ji,jkx->ikx", rotation, slope)
        turns = np.stack([spin[2, 1], spin[0, 2], spin[1, 0]])
        expected = np.log(np.abs(np.linalg.det(turns)) / (8 * np.pi**2))
        found = transform.log_abs_det_jacobian(x, rotation)
        np.testing.assert_allclose(found, expected, atol=1e-10)


def test_half_turns_come_back_finite() -> None:
    """The bijection leaves half turns out; at one its inverse is far, finite, and leads back."""
    transform = biject_to(TABLE["rotation"].support)
    for axis in np.eye(3):
        turn = 2 * np.outer(axis, axis) - np.eye(3)
        assert np.isfinite(transform.inv(turn)).all()
        np.testing.assert_allclose(transform(transform.inv(turn)), turn, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_supports_and_transforms_are_pytrees(name: str) -> None:
    support = TABLE[name].support
    for thing in (support, biject_to(support)):
        leaves, structure = jax.tree.flatten(thing)
        assert jax.tree.unflatten(structure, leaves) == thing
    x = unconstrained(name)
    inside = jax.jit(lambda transform, x: transform(x))(biject_to(support), x)
    np.testing.assert_allclose(inside, biject_to(support)(x), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_a_feasible_point_is_inside(name: str) -> None:
    law = TABLE[name]
    prototype = jnp.zeros((4, *law.batch_shape, *law.event_shape))
    assert law.support(law.support.feasible_like(prototype)).all()


def test_unequal_supports_differ() -> None:
    assert TABLE["hinged area"].support != TABLE["occupied angle"].support
    assert TABLE["hinged area"].support != TABLE["hinged box three"].support
    assert TABLE["disc"].support != TABLE["disc three"].support
    assert TABLE["disc"].support != TABLE["hinged area"].support


@settings(max_examples=50, deadline=None)
@given(x=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)))
def test_any_point_of_the_plane_lands_in_the_disc(x: tuple[float, float]) -> None:
    transform = biject_to(TABLE["disc"].support)
    y = transform(jnp.array(x))
    assert np.hypot(*(np.asarray(y) - TABLE["disc"].centre)) <= 0.5 * (1 + 1e-12)
    back = np.asarray(transform.inv(y))
    # Near the rim the inverse divides by a difference of the order of 1/|x|².
    np.testing.assert_allclose(back, x, rtol=1e-6, atol=1e-9 * max(1.0, np.hypot(*x) ** 3))
