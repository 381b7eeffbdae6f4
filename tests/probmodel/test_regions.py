"""Regions of the sphere: constants, draws, inverses and gradients, against integrals and tests in
another chart."""

import functools
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, special, stats

from poseterior.probmodel.anatomy.lengths import BoneLength, LengthPrior
from poseterior.probmodel.anatomy.limits import CELL, GRID, AnatomicalLimits
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.directions.cells import UPPER_MEASURES, Cells, cell_centres, cell_measure
from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection
from poseterior.probmodel.directions.hinges import LOWER_MEASURES, Hinge
from tests.goodness import (
    chi_square,
    floor,
    hinge_masses,
    sphere_grid,
    uniform_each,
    uniform_square,
)
from tests.instances import cell_tables, hinge_table, hinges_of, index_region
from tests.sweeps import sweep

NUM_DRAWS = 10_000
NAMES, PARAMETERS = hinge_table()
TABLES = cell_tables()
ALL_ROUND = np.array([-np.pi, np.pi])

transport_hinge = jax.jit(lambda hinge, square: HingedDirection(hinge).transport(square))
inverse_hinge = jax.jit(lambda hinge, vector: HingedDirection(hinge).inverse(vector))
log_prob_hinge = jax.jit(
    lambda hinge, vector: HingedDirection(hinge, validate_args=False).log_prob(vector)
)
transport_cells = jax.jit(lambda cells, square: OccupiedDirection(cells).transport(square))
inverse_cells = jax.jit(lambda cells, vector: OccupiedDirection(cells).inverse(vector))
log_prob_cells = jax.jit(
    lambda cells, vector: OccupiedDirection(cells, validate_args=False).log_prob(vector)
)
BOX_LATER = sweep(LOWER_MEASURES, ["area"])


@functools.cache
def hinges(measure: str) -> Hinge:
    return Hinge.build(*PARAMETERS, measure)


@functools.cache
def cells(measure: str) -> Cells:
    return Cells.build(np.stack(list(TABLES.values())), measure)


@functools.cache
def squares(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).random((NUM_DRAWS, count, 2))


@pytest.fixture(scope="module")
def default_limits() -> AnatomicalLimits:
    return AnatomicalLimits.default()


@pytest.fixture(scope="module")
def published_limits(shared_data) -> AnatomicalLimits:
    return read_published(shared_data / "akhter_black" / "jointAngleModel_v2.mat")


# Normalising constants


def total(offset: float, bounds: np.ndarray, measure: str) -> float:
    return float(hinge_masses(offset, bounds, measure, np.array([-1.0, 1.0]), ALL_ROUND).sum())


def assert_totals(hinge: Hinge, measure: str) -> None:
    expected = [
        total(d, b, measure)
        for d, b in zip(np.asarray(hinge.offset), np.asarray(hinge.bounds), strict=True)
    ]
    # Both sides subtract numbers of the order of the whole sphere: the error is absolute.
    np.testing.assert_allclose(np.asarray(hinge.total), expected, rtol=1e-9, atol=2e-13)


def test_boxes_around_hinges_hold_all_that_is_allowed_and_hardly_more() -> None:
    """By a grid of u2 and the angle about it, 0.01 and 0.02 wide. Half of the hinges fill their
    boxes but for a step or two; where plane and box meet askew bounds may be generous: twelve are,
    by more than a tenth."""
    found = hinges("area")
    offset, bounds, boxes = (np.asarray(part) for part in (found.offset, found.bounds, found.box))
    u2, turn = np.linspace(-1, 1, 201)[:, None], np.linspace(-np.pi, np.pi, 315)[None]
    u1, u3 = -np.sqrt(1 - u2**2) * np.cos(turn), np.sqrt(1 - u2**2) * np.sin(turn)
    spare = []
    for plane, (low2, high2, low3, high3), box in zip(offset, bounds, boxes, strict=True):
        inside = (u1 + plane < 0) & (low2 <= u2) & (u2 <= high2) & (low3 <= u3) & (u3 <= high3)
        if inside.any():
            across, along = u2[inside.any(axis=1), 0], turn[0, inside.any(axis=0)]
            ends = across.min(), across.max(), along.min(), along.max()
            spare.append((box - ends) * [-1, 1, -1, 1])
    assert np.min(spare) >= 0
    assert np.median(np.max(spare, axis=1)) < 0.03
    assert np.sum(np.max(spare, axis=1) > 0.1) <= 12


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_constant_of_a_hinge_equals_quadrature_about_another_axis(measure: str) -> None:
    assert_totals(hinges(measure), measure)


@pytest.mark.parametrize("measure", BOX_LATER)
def test_constants_of_default_hinges(measure: str, default_limits) -> None:
    assert_totals(Hinge.build(*hinges_of(default_limits, 100), measure), measure)


@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_constants_of_published_hinges(measure: str, published_limits) -> None:
    assert_totals(Hinge.build(*hinges_of(published_limits, 100), measure), measure)


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_density_of_a_hinge_integrates_to_one_on_an_even_grid(measure: str) -> None:
    """The masked density itself, summed over 640,000 even points: exact but for the rim of the
    region, whose share of the grid bounds the error; slivers, which hold few points, are left to
    the quadrature above."""
    grid, steradians = sphere_grid(800)
    values = np.exp(np.asarray(log_prob_hinge(hinges(measure), grid[:, None])))
    points = (values > 0).sum(axis=0)
    large = points > 3000
    assert large.sum() > 20
    # A curve of length L crosses about L √n / √4π points of n; each counts half on average, by
    # chance in or out.
    tolerance = 30 * points[large] ** -0.75
    assert (np.abs(values.sum(axis=0)[large] * steradians - 1) < tolerance).all()


def quadrature_of_cells(cells: Cells) -> np.ndarray:
    """Integrals of the density over the sphere in equal-area coordinates (sine of the elevation,
    azimuth), cell by cell; the sine near a pole is 1 - t², which takes out the pole of the "angle"
    density."""
    x, w = np.polynomial.legendre.leggauss(16)
    edges = np.sin(np.linspace(-np.pi / 2, np.pi / 2, GRID[1] + 1))
    edges[30:] = -edges[30::-1]
    t = np.sqrt(np.maximum(1 - np.abs(edges), 0.0))
    nodes = (t[1:] + t[:-1])[:, None] / 2 + (t[1:] - t[:-1])[:, None] / 2 * x
    sine = np.sign(edges[1:] + edges[:-1])[:, None] * (1 - nodes**2)
    weight = np.abs(t[1:] - t[:-1])[:, None] / 2 * w * 2 * nodes
    planar = nodes * np.sqrt(2 - nodes**2)  # √(1 - sine²) without cancellation
    azimuth = ((np.arange(GRID[0]) + 0.4) * CELL - np.pi)[:, None, None]
    u = np.stack(
        np.broadcast_arrays(planar * np.cos(azimuth), planar * np.sin(azimuth), sine), axis=-1
    )
    density = np.exp(np.asarray(log_prob_cells(cells, u.reshape(-1, 1, 3)))).reshape(
        *u.shape[:-1], -1
    )
    return np.einsum("arqc,rq->carq", density, weight).sum(axis=-1) * CELL


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_constant_of_cells_equals_quadrature(measure: str) -> None:
    masses = quadrature_of_cells(cells(measure))
    np.testing.assert_allclose(masses.sum(axis=(1, 2)), 1.0, rtol=1e-9)
    assert (masses[~np.stack(list(TABLES.values()))] == 0).all()


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_constant_of_default_cells(measure: str, default_limits) -> None:
    masses = quadrature_of_cells(Cells.build(default_limits.occupied, measure))
    np.testing.assert_allclose(masses.sum(axis=(1, 2)), 1.0, rtol=1e-9)


def test_measure_of_all_cells_is_that_of_the_sphere() -> None:
    full = list(TABLES).index("full")
    assert cells("area").total[full] == pytest.approx(4 * np.pi, rel=1e-13)
    assert cells("angle").total[full] == pytest.approx(2 * np.pi**2, rel=1e-13)
    assert float(np.sum(cell_measure("area"))) * GRID[0] == pytest.approx(4 * np.pi, rel=1e-13)


def test_unknown_measures_are_refused() -> None:
    with pytest.raises(ValueError, match="upper bones is one of angle, area, not 'box'"):
        Cells.build(np.ones(GRID, bool), "box")
    with pytest.raises(ValueError, match="lower bones is one of area, box, not 'angle'"):
        Hinge.build(np.eye(3), 0.0, np.ones(4), "angle")


# Draws against the density


def hinge_p_values(hinge: Hinge, measure: str, draws: np.ndarray, split: int = 6) -> np.ndarray:
    """p-values `(count,)` of draws `(n, count, 3)` against the measure's masses on strips of u3 ×
    sectors of γ."""
    p_values = []
    for k in range(draws.shape[1]):
        triple, bounds = np.asarray(hinge.triple[k]), np.asarray(hinge.bounds[k])
        u1, u2, u3 = triple @ draws[:, k].T
        strips = np.linspace(max(bounds[2], -1) - 1e-12, min(bounds[3], 1) + 1e-12, split + 1)
        gamma = np.arctan2(u2, -u1)
        # Sectors adapt to where the draws are; their masses come from the quadrature all the same.
        sectors = np.concatenate(
            [[-np.pi], np.quantile(gamma, np.arange(1, split) / split), [np.pi]]
        )
        counts, _, _ = np.histogram2d(u3, gamma, bins=[strips, sectors])
        masses = hinge_masses(float(hinge.offset[k]), bounds, measure, strips, sectors, order=24)
        p_values.append(chi_square(counts.ravel(), (masses / masses.sum()).ravel()))
    return np.array(p_values)


def assert_hinges_fit(hinge: Hinge, measure: str) -> None:
    """Chi-square of draws on 36 parts each, every p-value over the floor for that many hinges."""
    draws = np.asarray(transport_hinge(hinge, squares(hinge.offset.size)))
    p_values = hinge_p_values(hinge, measure, draws)
    assert p_values.min() > floor(p_values.size), (p_values.argmin(), p_values.min())


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_draws_of_a_hinge_follow_its_density(measure: str) -> None:
    """10,000 draws of each of 40 hinges; false alarm 1e-4 over the 40."""
    assert_hinges_fit(hinges(measure), measure)


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_draws_of_default_hinges_follow_their_density(measure: str, default_limits) -> None:
    """10,000 draws of each of 80 hinges; false alarm 1e-4 over the 80."""
    assert_hinges_fit(Hinge.build(*hinges_of(default_limits, 80), measure), measure)


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_draws_of_published_hinges_follow_their_density(measure: str, published_limits) -> None:
    """10,000 draws of each of 80 hinges; false alarm 1e-4 over the 80."""
    assert_hinges_fit(Hinge.build(*hinges_of(published_limits, 80), measure), measure)


WIDE = [
    NAMES.index(name) for name in ("both sides", "sticks out", "whole disc", "more than the disc")
]


@pytest.mark.slow
def test_the_wrong_measure_is_found_out() -> None:
    """Negative control: draws of "box" against the masses of "area", in hinges wide enough to tell,
    10,000 draws."""
    wide = index_region(hinges("box"), np.array(WIDE))
    draws = np.asarray(transport_hinge(wide, squares(len(WIDE))))
    assert hinge_p_values(wide, "area", draws).max() < floor(len(WIDE))


@pytest.mark.parametrize("measure", LOWER_MEASURES)
@pytest.mark.parametrize("coordinate", [0, 1])
def test_five_per_cent_too_little_spread_is_found_out(measure: str, coordinate: int) -> None:
    """Negative control: one coordinate of the square shrunk by 5 % about its middle, then the usual
    test."""
    wide = index_region(hinges(measure), np.array(WIDE))
    square = np.array(squares(len(WIDE)))
    square[..., coordinate] = 0.5 + 0.95 * (square[..., coordinate] - 0.5)
    p_values = hinge_p_values(wide, measure, np.asarray(transport_hinge(wide, square)))
    assert p_values.max() < floor(len(WIDE))


def sub_blocks(draws: np.ndarray) -> np.ndarray:
    """Counts `(count, 240, 120)` of draws `(n, count, 3)` in quarters of cells, halves of azimuth ×
    halves in sine."""
    edges = np.sin(np.linspace(-np.pi / 2, np.pi / 2, GRID[1] + 1))
    sines = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    azimuth = np.linspace(-np.pi, np.pi, 2 * GRID[0] + 1)
    parts = [
        np.histogram2d(np.arctan2(u[:, 1], u[:, 0]), u[:, 2], bins=[azimuth, sines])[0]
        for u in np.moveaxis(draws, 1, 0)
    ]
    return np.stack(parts)


def block_probabilities(tables: np.ndarray, measure: str) -> np.ndarray:
    """Probabilities `(count, 240, 120)` of the same quarters by one-dimensional adaptive quadrature
    of the density 1/√(1 - z²) over the sine z ("angle"), or 1 ("area")."""
    edges = np.sin(np.linspace(-np.pi / 2, np.pi / 2, GRID[1] + 1))
    sines = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    if measure == "area":
        rows = np.diff(sines)
    else:
        rows = np.array(
            [integrate.quad(lambda z: 1 / np.sqrt(1 - z * z), *ends)[0] for ends in pairwise(sines)]
        )
    weight = np.repeat(np.repeat(tables, 2, axis=1), 2, axis=2) * rows
    return weight / weight.sum(axis=(1, 2), keepdims=True)


def cells_p_values(measure: str, against: str, square: np.ndarray) -> np.ndarray:
    """p-values `(2, 9)` of each table's draws on quarters of cells, and on 120 coarse blocks."""
    draws = np.asarray(transport_cells(cells(measure), square))
    pair = [sub_blocks(draws), block_probabilities(np.stack(list(TABLES.values())), against)]
    coarse = [blocks.reshape(len(TABLES), 12, 20, 10, 12).sum(axis=(2, 4)) for blocks in pair]
    return np.array(
        [
            [chi_square(n.ravel(), p.ravel()) for n, p in zip(*both, strict=True)]
            for both in (pair, coarse)
        ]
    )


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_draws_of_cells_follow_their_density(measure: str) -> None:
    """10,000 draws of each of 9 tables, chi-square on quarters of cells and coarser; false alarm
    1e-4 over all 18."""
    p_values = cells_p_values(measure, measure, squares(len(TABLES)))
    assert p_values.min() > floor(p_values.size), dict(zip(TABLES, p_values.T, strict=True))


def test_the_wrong_measure_of_cells_is_found_out() -> None:
    """Negative control: "angle" draws against "area" probabilities in the tables that span enough
    elevation."""
    p_values = dict(
        zip(TABLES, cells_p_values("angle", "area", squares(len(TABLES))).min(axis=0), strict=True)
    )
    assert max(
        p_values[name] for name in ("full", "random", "north pole", "south pole", "one at a pole")
    ) < floor(18)


@pytest.mark.parametrize(
    ("coordinate", "seen"), [(0, ("full", "random", "north pole")), (1, ("full", "random"))]
)
def test_five_per_cent_too_little_spread_of_cells_is_found_out(
    coordinate: int, seen: tuple[str, ...]
) -> None:
    """Negative control: one coordinate of the square shrunk by 5 % about its middle, then the usual
    test, in the tables where that coordinate spans many cells. With twice the draws of the test
    itself, it fails by a factor of more than a hundred: no count on the edge of a bin decides."""
    square = np.concatenate([squares(len(TABLES)), squares(len(TABLES), seed=2)])
    square[..., coordinate] = 0.5 + 0.95 * (square[..., coordinate] - 0.5)
    p_values = dict(zip(TABLES, cells_p_values("angle", "angle", square).min(axis=0), strict=True))
    assert max(p_values[name] for name in seen) < floor(18) / 100, p_values


# The inverse


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_inverse_of_a_hinge_returns_the_square(measure: str) -> None:
    hinge, square = hinges(measure), squares(len(NAMES))[:3000]
    draws = transport_hinge(hinge, square)
    back = np.asarray(inverse_hinge(hinge, draws))
    # The measure below a point is known to a few units of rounding of the sphere's, so of the
    # total's only relatively.
    tolerance = 1e-12 / np.minimum(np.asarray(hinge.total), 0.1)
    error = np.abs(back - square).max(axis=(0, 2))
    # In a thin sliver the place along it is rounded too.
    narrow = np.minimum(np.diff(PARAMETERS[2][:, :2]), np.diff(PARAMETERS[2][:, 2:]))[:, 0]
    assert (error < tolerance + 1e-14 / narrow).all(), dict(zip(NAMES, error, strict=True))


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_inverse_of_cells_returns_the_square(measure: str) -> None:
    square = squares(len(TABLES))[:3000]
    back = np.asarray(inverse_cells(cells(measure), transport_cells(cells(measure), square)))
    np.testing.assert_allclose(back, square, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_inverse_of_rejection_draws_is_uniform(measure: str) -> None:
    """Rosenblatt: draws made without the transport, by rejection from the sphere or the disc,
    become uniform in the square. About 4,000 draws of each hinge that rejection can serve;
    Kolmogorov–Smirnov per coordinate and chi-square on 64 parts, false alarm 1e-4 over all of
    them."""
    rng = np.random.default_rng(8)
    rows = [k for k, b in enumerate(PARAMETERS[2]) if min(b[1] - b[0], b[3] - b[2]) > 0.05]
    p_values = []
    u = rng.normal(size=(400_000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    if measure == "box":  # uniform in the disc, either side: density ∝ |u1| per steradian
        angle, radius = rng.uniform(-np.pi, np.pi, len(u)), np.sqrt(rng.random(len(u)))
        u = np.stack(
            [
                rng.choice([-1, 1], len(u)) * np.sqrt(1 - radius**2),
                radius * np.cos(angle),
                radius * np.sin(angle),
            ],
            1,
        )
    for k in rows:
        triple, offset, bounds = (part[k] for part in PARAMETERS)
        inside = (
            (u[:, 0] + offset < 0)
            & (bounds[[0, 2]] <= u[:, 1:]).all(1)
            & (u[:, 1:] <= bounds[[1, 3]]).all(1)
        )
        kept = u[inside][:4000]
        if len(kept) < 1000:
            continue
        padded = np.resize(kept, (4000, 3)) @ triple  # one shape, so one compilation
        square = np.asarray(inverse_hinge(index_region(hinges(measure), k), padded))[: len(kept)]
        p_values += [uniform_square(square), *uniform_each(square)]
    assert len(p_values) > 60
    assert min(p_values) > floor(len(p_values))


# Insides, corners, gradients


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_draws_of_hinges_lie_inside(measure: str) -> None:
    """Not one of 10,000 × 40 draws outside: rounding can push out only a share of about 1e-12."""
    hinge = hinges(measure)
    draws = transport_hinge(hinge, squares(len(NAMES)))
    log_prob = np.asarray(log_prob_hinge(hinge, draws))
    assert np.isfinite(log_prob).all(), {
        NAMES[k] for k in np.argwhere(~np.isfinite(log_prob))[:, 1]
    }


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_draws_of_cells_lie_inside(measure: str) -> None:
    assert np.isfinite(
        log_prob_cells(cells(measure), transport_cells(cells(measure), squares(len(TABLES))))
    ).all()


CORNERS = np.array(
    [[a, b] for a in (0.0, 1e-300, 1e-17, 0.5, 1 - 2**-53, 1.0) for b in (0.0, 1e-17, 0.5, 1.0)]
)


@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_corners_of_the_square_stay_within_rounding_of_a_hinge(measure: str) -> None:
    """At the very edge of the square the direction is on the edge of the region, to rounding, and
    no further."""
    draws = np.asarray(
        transport_hinge(
            hinges(measure), np.broadcast_to(CORNERS[:, None], (len(CORNERS), len(NAMES), 2))
        )
    )
    assert np.isfinite(draws).all()
    np.testing.assert_allclose(np.linalg.norm(draws, axis=-1), 1.0, atol=1e-14)
    triple, offset, bounds = PARAMETERS
    u = np.einsum("kij,nkj->nki", triple, draws)
    assert (
        u[..., 0] + offset <= 1e-7
    ).all()  # a square root of rounding, where the plane cuts the rim
    assert (u[..., 1:] >= bounds[:, [0, 2]] - 1e-14).all()
    assert (u[..., 1:] <= bounds[:, [1, 3]] + 1e-14).all()


@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_corners_of_the_square_stay_within_rounding_of_the_cells(measure: str) -> None:
    square = np.broadcast_to(CORNERS[:, None], (len(CORNERS), len(TABLES), 2))
    draws = np.asarray(transport_cells(cells(measure), square))
    assert np.isfinite(draws).all()
    for k, table in enumerate(TABLES.values()):
        centres = np.asarray(cell_centres())[table]
        nearest = np.arccos(np.clip((draws[:, k] @ centres.T).max(axis=1), -1, 1))
        assert nearest.max() < CELL * 0.75  # half the diagonal of a cell, rounded up


def area_times_density(
    regions: Any, square: np.ndarray, transport: Callable, log_prob: Callable
) -> np.ndarray:
    """|∂u/∂s × ∂u/∂t| · density: the transport differentiated at points of every region."""
    jacobian = jax.jit(jax.vmap(jax.vmap(jax.jacfwd(lambda s, r: r.transport(s))), (0, None)))(
        square, regions
    )
    element = np.linalg.norm(np.cross(jacobian[..., 0], jacobian[..., 1]), axis=-1)
    return element * np.exp(np.asarray(log_prob(regions, transport(regions, square))))


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_area_element_of_the_transport_is_one_over_the_density(measure: str) -> None:
    square = 0.01 + 0.98 * squares(len(NAMES))[:200]
    found = area_times_density(hinges(measure), square, transport_hinge, log_prob_hinge)
    np.testing.assert_allclose(found, 1.0, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("measure", UPPER_MEASURES)
def test_area_element_of_the_cells_transport(measure: str) -> None:
    square = squares(len(TABLES))[:200]
    found = area_times_density(cells(measure), square, transport_cells, log_prob_cells)
    np.testing.assert_allclose(found, 1.0, rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("measure", LOWER_MEASURES)
def test_gradients_of_hinges_are_finite(measure: str) -> None:
    """Forward and backward, of transport, inverse and log density, at draws and at the corners of
    the square."""
    edge = np.clip(CORNERS, 1e-12, 1 - 1e-12)
    square = np.concatenate(
        [squares(len(NAMES))[:100], np.broadcast_to(edge[:, None], (len(edge), len(NAMES), 2))]
    )
    hinge, draws = hinges(measure), transport_hinge(hinges(measure), square)

    def batch(function):
        return jax.jit(jax.vmap(jax.vmap(function), (0, None)))

    assert np.isfinite(batch(jax.jacrev(lambda s, h: h.transport(s)))(square, hinge)).all()
    assert np.isfinite(batch(jax.jacrev(lambda u, h: h.inverse(u)))(draws, hinge)).all()
    assert np.isfinite(batch(jax.grad(lambda u, h: h.log_density(u)))(draws, hinge)).all()


@settings(max_examples=60, deadline=None)
@given(
    offset=st.one_of(st.sampled_from([0.0, -0.0, 1e-6, -1e-9]), st.floats(-1.2, 0.9)),
    low=st.tuples(st.floats(-1.2, 0.9), st.floats(-1.2, 0.9)),
    width=st.tuples(st.floats(0.01, 2.2), st.floats(0.01, 2.2)),
    measure=st.sampled_from(LOWER_MEASURES),
)
def test_any_hinge_has_the_right_constant(offset, low, width, measure) -> None:
    """Hinges from the whole range of parameters, empty ones included."""
    bounds = np.array([low[0], low[0] + width[0], low[1], low[1] + width[1]])
    hinge = Hinge.build(np.eye(3), offset, bounds, measure)
    assert float(hinge.total) == pytest.approx(total(offset, bounds, measure), rel=1e-9, abs=1e-12)


def test_an_impossible_hinge_holds_nothing() -> None:
    for offset, bounds in (
        (2.0, np.zeros(4)),
        (0.0, np.array([0.8, 0.9, 0.8, 0.9])),
        (0.0, np.array([1.1, 1.2, 0, 1])),
    ):
        hinge = Hinge.build(np.eye(3), offset, bounds)
        assert float(hinge.total) == 0
        grid, _ = sphere_grid(60)
        assert (np.asarray(log_prob_hinge(hinge, grid)) == -np.inf).all()


@pytest.mark.slow
def test_quantiles_of_lengths_equal_another_library() -> None:
    """Beta quantiles, from J-shaped to narrow, against scipy (another algorithm) to 1e-12."""
    rng = np.random.default_rng(2)
    alpha, beta = np.exp(rng.uniform(np.log(0.3), np.log(200), (2, 200, 5)))
    prior = LengthPrior(np.zeros((200, 5)), np.ones((200, 5)), alpha, beta)
    probability = rng.random((200, 5))
    probability[:3] = np.array([0.0, 1.0, 1e-12])[:, None]
    found = np.asarray(BoneLength(prior).transport(probability))
    np.testing.assert_allclose(found, stats.beta(alpha, beta).ppf(probability), atol=1e-12)
    slope = jax.grad(lambda p: BoneLength(prior).transport(p).sum())(jnp.asarray(probability))[3:]
    np.testing.assert_allclose(slope * stats.beta(alpha, beta).pdf(found)[3:], 1.0, rtol=1e-8)
    np.testing.assert_allclose(
        BoneLength(prior).inverse(found)[3:], special.betainc(alpha, beta, found)[3:], rtol=1e-10
    )


# What "uniform" means


def pole_share(limits: AnatomicalLimits, measure: str, bone: int) -> float:
    """Share of an upper bone's draws within 15° of a pole of its frame, exactly (15° is five rows
    of cells)."""
    mass = np.asarray(limits.occupied)[bone] * np.asarray(cell_measure(measure))
    return float((mass[:, :5].sum() + mass[:, -5:].sum()) / mass.sum())


def test_angle_piles_up_at_the_poles(published_limits) -> None:
    """13 % of arms and 18 % of legs lie within 15° of a pole under "angle", 2.7 % and 3.9 % under
    "area"; and so say 10,000 draws, to 5 standard errors (false alarm 1e-6 each)."""
    shares = {
        m: [pole_share(published_limits, m, bone) for bone in range(5)] for m in UPPER_MEASURES
    }
    np.testing.assert_allclose(shares["angle"][1:], [0.13, 0.13, 0.18, 0.18], atol=0.01)
    np.testing.assert_allclose(shares["area"][1:], [0.027, 0.027, 0.039, 0.039], atol=0.002)
    for measure in UPPER_MEASURES:
        draws = transport_cells(Cells.build(published_limits.occupied, measure), squares(5, seed=4))
        near = np.abs(np.asarray(draws)[..., 2]) > np.cos(np.radians(15))
        error = np.sqrt(np.array(shares[measure]) / NUM_DRAWS)
        assert (
            np.abs(near.mean(axis=0) - shares[measure]) <= 5 * error
        ).all()  # the head never points there: 0 ≤ 0
