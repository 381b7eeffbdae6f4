"""Every custom distribution through the same tests, then those that are not directions."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from poseterior.probmodel.anatomy.lengths import BoneLength
from poseterior.probmodel.anatomy.torsos import TorsoDictionary
from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.errors.keypoints import DetectedKeypoint
from poseterior.probmodel.rotations import UprightRotation
from tests.goodness import chi_square, floor, uniform_each
from tests.instances import LENGTHS, distributions

TABLE = distributions()
DIRECTIONS = [name for name in TABLE if name.startswith(("hinged", "occupied"))]
KEY = jax.random.key(0)
HEAVY = (
    "length three",
    "hinged box three",
    "rotation three",
    "disc three",
    "hinged area two by two",
    "occupied angle two by two",
    "disc two by two",
)
"""Further batch shapes, which cost compilations: left to the slow run."""
EVERY = [pytest.param(name, marks=pytest.mark.slow) if name in HEAVY else name for name in TABLE]


@functools.cache
def draws(name: str, count: int = 5) -> jax.Array:
    return TABLE[name].sample(KEY, (count,))


def in_support(law: dist.Distribution, value: object) -> np.ndarray:
    """NumPyro's own interval, of the lengths, promotes ranks in silence; supports have no hash."""
    with jax.numpy_rank_promotion("allow"):
        return np.asarray(jax.jit(lambda value: law.support(value))(value))


def unchecked(law: dist.Distribution) -> dist.Distribution:
    """The same law, rebuilt with validate_args=False."""
    names = [
        name
        for name in inspect.signature(type(law).__init__).parameters
        if name not in ("self", "validate_args")
    ]
    fields = {name: getattr(law, name) for name in names if name != "batch_shape"}
    return type(law)(**fields, validate_args=False)


@pytest.mark.parametrize("name", EVERY)
def test_shapes(name: str) -> None:
    """As they are traced: numbers are looked at below, and operations one by one would each be
    compiled."""
    law = TABLE[name]
    shape = law.batch_shape + law.event_shape
    one = jax.eval_shape(law.sample, KEY)
    several = jax.eval_shape(lambda key: law.sample(key, (4, 2)), KEY)
    assert one.shape == shape
    assert several.shape == (4, 2, *shape)
    assert jax.eval_shape(law.log_prob, several).shape == (4, 2, *law.batch_shape)
    assert jax.eval_shape(law.log_prob, one).shape == law.batch_shape
    with jax.numpy_rank_promotion("allow"):
        held = jax.eval_shape(lambda value: law.support(value), several)
    assert held.shape == (4, 2, *law.batch_shape)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_same_key_same_draws_and_another_key_others(name: str) -> None:
    law = TABLE[name]
    first = law.sample(KEY, (50,))
    np.testing.assert_array_equal(first, law.sample(KEY, (50,)))
    assert not np.array_equal(first, law.sample(jax.random.key(1), (50,)))


@pytest.mark.parametrize("name", EVERY)
def test_draws_are_in_the_support(name: str) -> None:
    law = TABLE[name]
    value = jax.jit(lambda key: law.sample(key, (500,)))(KEY)
    assert in_support(law, value).all()
    assert np.isfinite(jax.jit(law.log_prob)(value)).all()


@pytest.mark.sweep
@pytest.mark.parametrize("name", EVERY)
def test_expand(name: str) -> None:
    law = TABLE[name]
    wide = law.expand((3, *law.batch_shape))
    value = wide.sample(KEY, (2,))
    assert value.shape == (2, 3, *law.batch_shape, *law.event_shape)
    np.testing.assert_allclose(wide.log_prob(value), law.log_prob(value), rtol=1e-12)
    assert not np.array_equal(value[:, 0], value[:, 1])
    assert in_support(wide, value).all()


@pytest.mark.sweep
@pytest.mark.parametrize("name", EVERY)
def test_to_event_sums_the_log_density(name: str) -> None:
    law, value = TABLE[name], draws(name)
    joint = law.to_event(len(law.batch_shape))
    expected = law.log_prob(value).sum(axis=tuple(range(1, 1 + len(law.batch_shape))))
    np.testing.assert_allclose(joint.log_prob(value), expected, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_jit_with_the_law_as_an_argument(name: str) -> None:
    """A distribution is a pytree: it passes through jit, in and out, and draws the same."""
    law, value = TABLE[name], draws(name)
    np.testing.assert_allclose(
        jax.jit(lambda law, x: law.log_prob(x))(law, value), law.log_prob(value), rtol=1e-12
    )
    np.testing.assert_allclose(
        jax.jit(lambda law: law.sample(KEY, (5,)))(law), value, rtol=1e-9, atol=1e-12
    )
    back = jax.jit(lambda law: law)(law)
    assert type(back) is type(law)
    np.testing.assert_array_equal(back.log_prob(value), law.log_prob(value))


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_pytree_round_trip(name: str) -> None:
    law = TABLE[name]
    leaves, structure = jax.tree.flatten(law)
    back = jax.tree.unflatten(structure, leaves)
    assert (back.batch_shape, back.event_shape) == (law.batch_shape, law.event_shape)
    np.testing.assert_array_equal(back.sample(KEY, (5,)), draws(name))
    doubled = jax.tree.map(lambda leaf: leaf, law)
    assert jax.tree.structure(doubled) == structure


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_vmap_over_values_and_keys(name: str) -> None:
    law, value = TABLE[name], draws(name)
    np.testing.assert_allclose(jax.vmap(law.log_prob)(value), law.log_prob(value), rtol=1e-12)
    several = jax.vmap(law.sample)(jax.random.split(KEY, 6))
    assert several.shape == (6, *law.batch_shape, *law.event_shape)


@pytest.mark.parametrize("name", [name for name in DIRECTIONS if "three" in name])
def test_vmap_over_parameters_equals_a_batch(name: str) -> None:
    law, value = TABLE[name], draws(name)
    mapped = jax.vmap(lambda region, x: type(law)(region).log_prob(x), (0, 1), 1)(law.region, value)
    np.testing.assert_allclose(mapped, law.log_prob(value), rtol=1e-12)


@pytest.mark.parametrize("name", [name for name in EVERY if name != "torso"])
def test_gradients_are_finite(name: str) -> None:
    """Of the log density at draws, at their antipodes (mostly outside) and at a wild point."""
    law, value = unchecked(TABLE[name]), np.asarray(draws(name))

    @jax.jit
    @jax.grad
    def gradient(x: jax.Array) -> jax.Array:
        log_prob = law.log_prob(x)
        return jnp.where(jnp.isfinite(log_prob), log_prob, 0.0).sum()

    for x in (value, -value, np.full_like(value, 1e3)):
        assert np.isfinite(gradient(x)).all()


def outside(name: str) -> list[np.ndarray]:
    """Points that are in no law of the family: off the sphere, out of the box or disc or range, no
    integers."""
    value = np.asarray(draws(name))
    if name in DIRECTIONS:
        return [
            1.001 * value,
            0.0 * value,
            0.5 * value,
            np.full_like(value, np.nan),
            np.full_like(value, np.inf),
        ]
    if name.startswith(("disc", "keypoint")):
        law = TABLE[name]
        reach = law.law.reach * np.asarray(law.spread)[..., None]
        away = np.asarray(law.centre) + reach * np.array([0.8, 0.6]) * (1 + 1e-9)
        return [
            np.broadcast_to(away, value.shape),
            np.full_like(value, np.nan),
            np.full_like(value, np.inf),
        ]
    if name.startswith("rotation"):
        return [
            value * (1 + 1e-6),
            -value,
            value @ np.diag([1.0, 1.0, -1.0]),
            0.0 * value,
            np.full_like(value, np.nan),
        ]
    if name.startswith("length"):
        out = np.array(value)
        out[..., 2] = np.asarray(LENGTHS.high)[2] + 1e-9
        return [-value, value + 100, out, np.full_like(value, np.nan)]
    return [np.array([-1, 7, 100]), np.array([0.5, 6.5])]


@pytest.mark.parametrize("name", EVERY)
def test_no_density_outside(name: str) -> None:
    """-inf, not NaN and not a number, whether or not arguments are checked."""
    law = unchecked(TABLE[name])
    assert law._validate_args is False
    log_prob = jax.jit(law.log_prob)
    for x in outside(name):
        assert (np.asarray(log_prob(x)) == -np.inf).all(), x
        assert not np.asarray(in_support(law, x)).any()


@pytest.mark.parametrize("name", DIRECTIONS)
def test_support_and_density_agree_everywhere(name: str) -> None:
    """On 2,000 directions all around: a finite density exactly where the support says so."""
    law = unchecked(TABLE[name])
    u = np.random.default_rng(0).normal(size=(2000, *[1] * len(law.batch_shape), 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    u = np.broadcast_to(u, (2000, *law.batch_shape, 3))
    np.testing.assert_array_equal(np.isfinite(jax.jit(law.log_prob)(u)), in_support(law, u))


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_single_precision(name: str) -> None:
    """Without 64 bits all is float32 and still finite; rounding may push at most 1 % of draws over
    an edge."""
    with jax.enable_x64(False):
        law = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), unchecked(TABLE[name]))
        if hasattr(law, "region") and isinstance(law.region, Hinge):
            # Built anew, so that the integrals are those of single precision too.
            law = type(law)(
                Hinge.build(
                    law.region.triple, law.region.offset, law.region.bounds, law.region.measure
                ),
                validate_args=False,
            )
        value = law.sample(KEY, (1000,))
        log_prob = law.log_prob(value)
        assert value.dtype == (jnp.int32 if name == "torso" else jnp.float32)
        assert log_prob.dtype == jnp.float32
        assert np.isfinite(value).all()
        assert not np.isnan(log_prob).any()
        reference = unchecked(TABLE[name])
    assert (np.asarray(log_prob) == -np.inf).mean() < 0.01
    if not name.startswith(("torso", "disc", "keypoint")):
        return
    np.testing.assert_allclose(log_prob, reference.log_prob(np.asarray(value)), 1e-5, 1e-6)


# Laws that are not directions


def test_torsos_are_drawn_evenly() -> None:
    """7,000 draws of 7 torsos, chi-square; false alarm 1e-4."""
    law = TABLE["torso"]
    counts = np.bincount(law.sample(KEY, (7000,)), minlength=7)
    assert chi_square(counts, np.full(7, 1 / 7)) > floor(1)
    np.testing.assert_allclose(np.exp(law.log_prob(jnp.arange(7))).sum(), 1.0, rtol=1e-12)
    np.testing.assert_array_equal(law.enumerate_support(), np.arange(7))


@pytest.mark.slow
def test_lengths_are_stretched_beta() -> None:
    """10,000 draws of five groups: Kolmogorov–Smirnov against scipy's Beta, false alarm 1e-4 over
    ten tests (sample and transport); the density against scipy's to 1e-10, and it integrates to
    one."""
    law = TABLE["length"]
    reference = stats.beta(LENGTHS.alpha, LENGTHS.beta, LENGTHS.low, LENGTHS.high - LENGTHS.low)
    value = np.asarray(law.sample(KEY, (10_000,)))
    cube = np.random.default_rng(3).random((10_000, 5))
    for x in (value, np.asarray(law.transport(cube))):
        assert uniform_each(reference.cdf(x)).min() > floor(10)
    np.testing.assert_allclose(
        law.log_prob(value), reference.logpdf(value).sum(axis=-1), rtol=1e-10
    )
    np.testing.assert_allclose(law.inverse(law.transport(cube)), cube, atol=1e-11)


def test_lengths_with_too_little_spread_are_found_out() -> None:
    """Negative control: 10,000 draws with their spread shrunk by 5 %."""
    reference = stats.beta(LENGTHS.alpha, LENGTHS.beta, LENGTHS.low, LENGTHS.high - LENGTHS.low)
    value = np.asarray(TABLE["length"].sample(KEY, (10_000,)))
    shrunk = value.mean(axis=0) + 0.95 * (value - value.mean(axis=0))
    assert uniform_each(reference.cdf(shrunk)).min() < floor(10)


def test_discs_are_filled_evenly() -> None:
    """10,000 draws of three discs: (distance/τ)² and the angle uniform (Kolmogorov–Smirnov, false
    alarm 1e-4 over 6); the density is one over the area; and the square root left out is found
    out."""
    law = TABLE["disc three"]
    offset = (np.asarray(law.sample(KEY, (10_000,))) - np.asarray(law.centre)) / np.asarray(
        law.spread
    )[:, None]
    distance = np.linalg.norm(offset, axis=-1)
    angle = np.arctan2(offset[..., 1], offset[..., 0]) / (2 * np.pi) + 0.5
    assert uniform_each(np.concatenate([distance**2, angle], axis=1)).min() > floor(6)
    assert uniform_each(distance).max() < floor(6)
    np.testing.assert_allclose(
        np.exp(law.log_prob(law.centre)) * np.pi * law.spread**2, 1.0, rtol=1e-12
    )


@pytest.mark.slow
def test_sample_and_transport_of_directions_are_one_law() -> None:
    """`sample` is `transport` of a uniform square: its inverse is uniform. 4,000 draws of each,
    false alarm 1e-4."""
    p_values = []
    for name in (name for name in DIRECTIONS if "two" in name):
        square = TABLE[name].inverse(TABLE[name].sample(KEY, (4000,)))
        p_values += [uniform_each(np.asarray(square).reshape(4000, -1))]
    assert np.min(p_values) > floor(np.size(p_values))


def turns_p_value(rotations: np.ndarray) -> float:
    """The smallest p-value, times their number, of what is known of uniform rotations: each column
    uniform on the sphere (its coordinates uniform on [-1, 1]), and the angle ω with density
    (1 - cos ω)/π, also after a fixed turn from either side."""
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix()
    p_values = []
    for turned in (rotations, turn @ rotations, rotations @ turn):
        p_values += list(uniform_each((turned.reshape(-1, 9) + 1) / 2))
        angle = Rotation.from_matrix(turned).magnitude()
        p_values += list(uniform_each(((angle - np.sin(angle)) / np.pi)[:, None]))
    return min(p_values) * len(p_values)


def test_rotations_are_uniform() -> None:
    """10,000 draws, Kolmogorov–Smirnov, false alarm 1e-4 over 30; and Euler angles drawn evenly,
    which are not uniform, are found out."""
    drawn = np.asarray(TABLE["rotation"].sample(KEY, (10_000,)))
    np.testing.assert_allclose(np.linalg.det(drawn), 1.0, rtol=1e-12)
    assert turns_p_value(drawn) > floor(1)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (10_000, 3))
    assert turns_p_value(Rotation.from_euler("xyz", angles).as_matrix()) < floor(1) / 1e6


@pytest.mark.parametrize("concentration", [0.0, 0.5, 8.0])
def test_backs_are_upright_as_they_should_be(concentration: float) -> None:
    """The cosine of the tilt follows exp(κ cos) on [-1, 1], by SciPy's von Mises and Fisher, and
    what is turned about the back is uniform: false alarm 1e-4 over four. The density has mass one
    by Haar's measure (4 standard errors). Another concentration is found out."""
    law = UprightRotation(concentration)
    drawn = np.asarray(law.sample(KEY, (10_000,)))
    assert np.abs(drawn @ np.swapaxes(drawn, 1, 2) - np.eye(3)).max() < 1e-12
    up = np.array([0.0, -1.0, 0.0])
    known = (
        stats.vonmises_fisher(up, concentration) if concentration else stats.uniform_direction(3)
    )
    other = np.asarray(known.rvs(10_000, random_state=np.random.default_rng(1)))
    p_values = [stats.ks_2samp(drawn[:, axis, 1], other[:, axis]).pvalue for axis in range(3)]
    across = np.cross(up, drawn[:, :, 1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    side = np.arctan2(
        np.sum(np.cross(drawn[:, :, 1], across) * drawn[:, :, 0], axis=1),
        np.sum(across * drawn[:, :, 0], axis=1),
    )
    p_values.append(stats.kstest(side, "uniform", args=(-np.pi, 2 * np.pi)).pvalue)
    assert min(p_values) > 1e-4 / 4
    anyhow = Rotation.random(20_000, rng=np.random.default_rng(2)).as_matrix()
    density = np.exp(np.asarray(law.log_prob(anyhow)))
    error = density.std() / np.sqrt(len(density))
    assert abs(density.mean() - 1) <= 4 * error + 1e-12
    if concentration:
        wrong = np.asarray(UprightRotation(0.7 * concentration).sample(KEY, (10_000,)))
        assert stats.ks_2samp(wrong[:, 1, 1], other[:, 1]).pvalue < 1e-7


@pytest.mark.parametrize(
    "law",
    [
        OccupiedDirection,
        HingedDirection,
        BoneLength,
        DetectedKeypoint,
        TorsoDictionary,
        UprightRotation,
    ],
)
def test_custom_laws_say_what_they_are(law: type) -> None:
    assert issubclass(law, dist.Distribution)
    assert law.__doc__
