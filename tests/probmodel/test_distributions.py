"""Every custom distribution through the same tests, then the paper's literal recipe against eq.
8."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist
import pytest
from scipy import stats

from probmodel.anatomy.lengths import BoneLength
from probmodel.anatomy.limits import AnatomicalLimits
from probmodel.anatomy.published import read_published
from probmodel.anatomy.torsos import TorsoDictionary
from probmodel.directions.distributions import HingedDirection, OccupiedDirection, RecipeDirection
from probmodel.directions.hinges import Hinge
from probmodel.likelihood import Detected
from tests.goodness import FALSE_ALARM, chi_square, floor, hinge_masses, uniform_each
from tests.instances import LENGTHS, distributions, hinge_table, hinges_of

TABLE = distributions()
DIRECTIONS = [name for name in TABLE if name.startswith(("hinged", "occupied"))]
KEY = jax.random.key(0)
HEAVY = ("length three", "hinged area two by two", "occupied angle two by two", "disc two by two")
"""Further batch shapes, which cost compilations: left to the slow run, but for `test_shapes`."""
EVERY = [pytest.param(name, marks=pytest.mark.slow) if name in HEAVY else name for name in TABLE]


@functools.cache
def draws(name: str, count: int = 5) -> jax.Array:
    return TABLE[name].sample(KEY, (count,))


def in_support(law: dist.Distribution, value: object) -> np.ndarray:
    """NumPyro's own interval, of the lengths, promotes ranks in silence."""
    with jax.numpy_rank_promotion("allow"):
        return np.asarray(law.support(value))


def unchecked(law: dist.Distribution) -> dist.Distribution:
    """The same law, rebuilt with validate_args=False."""
    names = [
        name
        for name in inspect.signature(type(law).__init__).parameters
        if name not in ("self", "validate_args")
    ]
    fields = {name: getattr(law, name) for name in names if name != "batch_shape"}
    return type(law)(**fields, validate_args=False)


@pytest.mark.parametrize("name", TABLE)
def test_shapes(name: str) -> None:
    law = TABLE[name]
    shape = law.batch_shape + law.event_shape
    assert law.sample(KEY).shape == shape
    value = law.sample(KEY, (4, 2))
    assert value.shape == (4, 2, *shape)
    assert law.log_prob(value).shape == (4, 2, *law.batch_shape)
    assert law.log_prob(value[0, 0]).shape == law.batch_shape
    assert in_support(law, value).shape == (4, 2, *law.batch_shape)


@pytest.mark.parametrize("name", EVERY)
def test_same_key_same_draws_and_another_key_others(name: str) -> None:
    law = TABLE[name]
    first = law.sample(KEY, (50,))
    np.testing.assert_array_equal(first, law.sample(KEY, (50,)))
    assert not np.array_equal(first, law.sample(jax.random.key(1), (50,)))


@pytest.mark.parametrize("name", EVERY)
def test_draws_are_in_the_support(name: str) -> None:
    law, value = TABLE[name], TABLE[name].sample(KEY, (500,))
    assert in_support(law, value).all()
    assert np.isfinite(law.log_prob(value)).all()


@pytest.mark.parametrize("name", EVERY)
def test_expand(name: str) -> None:
    law = TABLE[name]
    wide = law.expand((3, *law.batch_shape))
    value = wide.sample(KEY, (2,))
    assert value.shape == (2, 3, *law.batch_shape, *law.event_shape)
    np.testing.assert_allclose(wide.log_prob(value), law.log_prob(value), rtol=1e-12)
    assert not np.array_equal(value[:, 0], value[:, 1])
    assert in_support(wide, value).all()


@pytest.mark.parametrize("name", EVERY)
def test_to_event_sums_the_log_density(name: str) -> None:
    law, value = TABLE[name], draws(name)
    joint = law.to_event(len(law.batch_shape))
    expected = law.log_prob(value).sum(axis=tuple(range(1, 1 + len(law.batch_shape))))
    np.testing.assert_allclose(joint.log_prob(value), expected, rtol=1e-12)


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


@pytest.mark.parametrize("name", EVERY)
def test_pytree_round_trip(name: str) -> None:
    law = TABLE[name]
    leaves, structure = jax.tree.flatten(law)
    back = jax.tree.unflatten(structure, leaves)
    assert (back.batch_shape, back.event_shape) == (law.batch_shape, law.event_shape)
    np.testing.assert_array_equal(back.sample(KEY, (5,)), draws(name))
    doubled = jax.tree.map(lambda leaf: leaf, law)
    assert jax.tree.structure(doubled) == structure


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
    law, value = unchecked(TABLE[name]), draws(name)
    for x in (value, -value, jnp.full_like(value, 1e3)):
        gradient = jax.grad(
            lambda x: jnp.where(jnp.isfinite(law.log_prob(x)), law.log_prob(x), 0.0).sum()
        )(x)
        assert np.isfinite(gradient).all()


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
    if name.startswith("disc"):
        law = TABLE[name]
        away = np.asarray(law.centre) + np.asarray(law.spread)[..., None] * np.array([0.8, 0.6]) * (
            1 + 1e-9
        )
        return [
            np.broadcast_to(away, value.shape),
            np.full_like(value, np.nan),
            np.full_like(value, np.inf),
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
    for x in outside(name):
        assert (np.asarray(law.log_prob(x)) == -np.inf).all(), x
        assert not np.asarray(in_support(law, x)).any()


@pytest.mark.parametrize("name", DIRECTIONS)
def test_support_and_density_agree_everywhere(name: str) -> None:
    """On 2,000 directions all around: a finite density exactly where the support says so."""
    law = unchecked(TABLE[name])
    u = np.random.default_rng(0).normal(size=(2000, *[1] * len(law.batch_shape), 3))
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    u = np.broadcast_to(u, (2000, *law.batch_shape, 3))
    np.testing.assert_array_equal(np.isfinite(law.log_prob(u)), in_support(law, u))


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
    if not name.startswith(("torso", "disc")):
        return
    np.testing.assert_allclose(log_prob, reference.log_prob(np.asarray(value)), rtol=1e-5)


# Laws that are not directions


def test_torsos_are_drawn_evenly() -> None:
    """7,000 draws of 7 torsos, chi-square; false alarm 1e-4."""
    law = TABLE["torso"]
    counts = np.bincount(law.sample(KEY, (7000,)), minlength=7)
    assert chi_square(counts, np.full(7, 1 / 7)) > floor(1)
    np.testing.assert_allclose(np.exp(law.log_prob(jnp.arange(7))).sum(), 1.0, rtol=1e-12)
    np.testing.assert_array_equal(law.enumerate_support(), np.arange(7))


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


def test_sample_and_transport_of_directions_are_one_law() -> None:
    """`sample` is `transport` of a uniform square: its inverse is uniform. 4,000 draws of each,
    false alarm 1e-4."""
    p_values = []
    for name in (name for name in DIRECTIONS if "two" in name):
        square = TABLE[name].inverse(TABLE[name].sample(KEY, (4000,)))
        p_values += [uniform_each(np.asarray(square).reshape(4000, -1))]
    assert np.min(p_values) > floor(np.size(p_values))


@pytest.mark.parametrize(
    "law", [OccupiedDirection, HingedDirection, BoneLength, Detected, TorsoDictionary]
)
def test_custom_laws_say_what_they_are(law: type) -> None:
    assert issubclass(law, dist.Distribution)
    assert law.__doc__


# The recipe to the letter


@pytest.fixture(scope="module")
def published(shared_data) -> AnatomicalLimits:
    return read_published(shared_data / "akhter_black" / "jointAngleModel_v2.mat")


def valid(u: np.ndarray, offset: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    box = (bounds[..., 0::2] <= u[..., 1:]) & (u[..., 1:] <= bounds[..., 1::2])
    return (u[..., 0] + offset < 0) & box.all(axis=-1)


@pytest.fixture(scope="module")
def recipe_figures(published) -> dict[str, np.ndarray]:
    """The recipe written out in numpy, 400,000 box draws per bone, every cell of an occupied parent
    alike."""
    rng = np.random.default_rng(11)
    figures: dict[str, list[float]] = {
        key: [] for key in ("sticks", "outside", "clamped", "recipe_near", "area_near")
    }
    for bone in range(4):
        plane = published.has_plane[bone] & np.asarray(published.occupied)[bone + 1]
        bounds, offset = (
            np.asarray(published.bounds)[bone][plane],
            np.asarray(published.offset)[bone][plane],
        )
        corner = np.maximum(np.abs(bounds[:, 0::2]), np.abs(bounds[:, 1::2]))
        figures["sticks"].append(np.mean((corner**2).sum(axis=1) > 1))
        chosen = rng.integers(len(bounds), size=400_000)
        b, d = bounds[chosen], offset[chosen]
        u23 = rng.uniform(b[:, 0::2], b[:, 1::2])
        square = 1 - (u23**2).sum(axis=1)
        figures["outside"].append(np.mean(square < 0))
        u1 = np.sqrt(np.maximum(square, 0))
        both = np.stack([np.column_stack([sign * u1, u23]) for sign in (-1, 1)])
        both /= np.linalg.norm(both, axis=-1, keepdims=True)
        ok = valid(both, d, b)
        accepted = ok.any(axis=0)
        figures["clamped"].append(np.mean((square < 0) & accepted))
        front = np.where(ok[0], both[0, :, 0], both[1, :, 0])
        figures["recipe_near"].append(np.mean(np.abs(front[accepted & (square >= 0)]) < 0.2))
        u = rng.normal(size=(400_000, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        uniform = valid(u, d, b)
        figures["area_near"].append(np.mean(np.abs(u[uniform, 0]) < 0.2))
    return {key: np.array(value) for key, value in figures.items()}


def test_how_far_the_recipe_is_from_eq_8(recipe_figures) -> None:
    """The figures of the published tables: of the boxes 92–96 % stick out of the unit disc, 9–11 %
    of box draws fall outside it, 5–6 % are clamped and accepted. Monte-Carlo error of each below
    0.0005."""
    print({key: value.round(4) for key, value in recipe_figures.items()})
    assert (np.abs(recipe_figures["sticks"] - 0.94) < 0.03).all()
    assert (np.abs(recipe_figures["outside"] - 0.10) < 0.015).all()
    assert (np.abs(recipe_figures["clamped"] - 0.055) < 0.01).all()


def recipe_and_reference(
    hinge: Hinge, measure: str, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """u1, u2, u3 of `count` recipe draws and of `count` draws of a measure, of each hinge of a
    stack."""
    region = Hinge.build(hinge.triple, hinge.offset, hinge.bounds, measure)
    laws = RecipeDirection(hinge), HingedDirection(region)
    keys = jax.random.split(jax.random.key(seed))
    samples = [law.sample(key, (count,)) for law, key in zip(laws, keys, strict=True)]
    return tuple(np.einsum("kij,nkj->nki", hinge.triple, u) for u in samples)


@pytest.fixture(scope="module")
def published_hinges(published) -> Hinge:
    return Hinge.build(*hinges_of(published, 200, seed=5))


def test_recipe_draws_keep_the_limits(published_hinges) -> None:
    u = RecipeDirection(published_hinges).sample(KEY, (100,))
    np.testing.assert_allclose(np.linalg.norm(u, axis=-1), 1.0, atol=1e-13)
    assert (RecipeDirection(published_hinges).support(u)).mean() > 0.9999


@pytest.fixture(scope="module")
def recipe_against_area(published_hinges) -> tuple[np.ndarray, np.ndarray]:
    return recipe_and_reference(published_hinges, "area", 500, 6)


def test_recipe_avoids_the_plane(recipe_against_area) -> None:
    """Within 0.2 of the plane lie about 13 % of directions under eq. 8; under the recipe far fewer
    off the rim, and a point mass on it that eq. 8 does not have. 500 draws of each of 200 published
    hinges."""
    recipe, area = recipe_against_area
    rim = np.abs(recipe[..., 0]) < 1e-12
    near_recipe = (np.abs(recipe[..., 0]) < 0.2) & ~rim
    near_area = np.abs(area[..., 0]) < 0.2
    print(
        "on the rim",
        rim.mean(),
        "near, recipe",
        near_recipe.mean(),
        "near, eq. 8",
        near_area.mean(),
    )
    assert 0.02 < rim.mean() < 0.12
    assert (np.abs(area[..., 0]) < 1e-12).mean() == 0
    assert near_recipe.mean() < 0.5 * near_area.mean()


@pytest.mark.slow
@pytest.mark.parametrize(("measure", "least"), [("area", 0.15), ("box", 0.02)])
def test_total_variation_of_the_recipe(published_hinges, measure: str, least: float) -> None:
    """Total variation between the recipe and a measure, on 6 × 6 × 2 parts of each hinge and the
    rim apart. From 20,000 draws of each of 24 hinges two equal laws would read about 0.025. A lower
    bound of the true distance."""
    some = jax.tree.map(lambda leaf: leaf[-24:], published_hinges)
    pair = recipe_and_reference(some, measure, 20_000, 7)
    distances = []
    for k in range(24):
        low2, high2, low3, high3 = np.asarray(some.bounds)[k]
        edges = [
            np.linspace(low - 1e-9, high + 1e-9, 7) for low, high in ((low2, high2), (low3, high3))
        ]
        shares = []
        for u in (part[:, k] for part in pair):
            rim = np.abs(u[:, 0]) < 1e-12
            counts = [
                np.histogram2d(*u[keep][:, 1:].T, bins=edges)[0].ravel()
                for keep in (~rim & (u[:, 0] < 0), ~rim & (u[:, 0] > 0))
            ]
            shares.append(np.concatenate([*counts, [rim.sum()]]) / len(u))
        distances.append(np.abs(shares[0] - shares[1]).sum() / 2)
    print(
        "total variation to",
        measure,
        np.round([np.mean(distances), np.min(distances), np.max(distances)], 3),
    )
    assert np.mean(distances) > least


def test_recipe_inside_the_disc_is_the_box_measure() -> None:
    """Where the box lies inside the disc and only the front is valid, the recipe *is* the measure
    "box": 40,000 draws, chi-square on 72 parts, false alarm 1e-4. Against "area" the same draws
    fail."""
    names, (triples, offsets, bounds) = hinge_table()
    k = names.index("plane through the centre")
    hinge = Hinge.build(triples[k], offsets[k], bounds[k], "box")
    u = np.asarray(RecipeDirection(hinge).sample(KEY, (40_000,))) @ triples[k].T
    strips = np.linspace(bounds[k][2], bounds[k][3], 7)
    sectors = np.linspace(-np.pi / 2, np.pi / 2, 13)
    counts = np.histogram2d(u[:, 2], np.arctan2(u[:, 1], -u[:, 0]), bins=[strips, sectors])[0]
    p_values = {}
    for measure in ("box", "area"):
        masses = hinge_masses(offsets[k], bounds[k], measure, strips, sectors)
        p_values[measure] = chi_square(counts.ravel(), (masses / masses.sum()).ravel())
    assert p_values["box"] > FALSE_ALARM
    assert p_values["area"] < FALSE_ALARM


def test_recipe_has_no_density_and_says_why(published_hinges) -> None:
    law = RecipeDirection(published_hinges)
    with pytest.raises(TypeError, match=r"no density.*clamp.*great circle.*HingedDirection"):
        law.log_prob(law.sample(KEY))


def test_recipe_is_a_distribution_otherwise(published_hinges) -> None:
    law = RecipeDirection(published_hinges)
    leaves, structure = jax.tree.flatten(law)
    back = jax.tree.unflatten(structure, leaves)
    np.testing.assert_array_equal(back.sample(KEY, (2,)), law.sample(KEY, (2,)))
    assert law.sample(KEY, (2, 3)).shape == (2, 3, 200, 3)
    assert jax.jit(lambda law, key: law.sample(key))(law, KEY).shape == (200, 3)
