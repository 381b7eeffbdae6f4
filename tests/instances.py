"""The one table of regions and distributions that goes through every generic test, nasty ones
included."""

import jax
import jax.numpy as jnp
import numpy as np
import numpyro.distributions as dist

from poseterior.probmodel.anatomy.lengths import BoneLength, LengthPrior
from poseterior.probmodel.anatomy.limits import GRID, AnatomicalLimits
from poseterior.probmodel.anatomy.torsos import TorsoDictionary
from poseterior.probmodel.directions.cells import Cells
from poseterior.probmodel.directions.distributions import HingedDirection, OccupiedDirection
from poseterior.probmodel.directions.hinges import Hinge
from poseterior.probmodel.errors.keypoints import DetectedKeypoint
from poseterior.probmodel.errors.laws import LAWS, Disc
from poseterior.probmodel.rotations import UprightRotation

NASTY_HINGES = {
    "published rounding": (1e-6, (-0.5, 0.6, -0.3, 0.4)),
    "published rounding, wide": (1.5e-6, (-1.0, 0.9, -0.99, 1.0)),
    "plane through the centre": (0.0, (-0.5, 0.6, -0.3, 0.4)),
    "negative zero": (-0.0, (-0.2, 0.9, -0.9, 0.4)),
    "hardly a plane": (-0.97, (-1.0, 1.0, -1.0, 1.0)),
    "hardly a plane, small box": (-0.97, (-0.1, 0.3, -0.2, 0.15)),
    "both sides": (-0.5, (-0.3, 0.8, -0.2, 0.9)),
    "sticks out": (0.0, (0.3, 1.0, 0.2, 0.99)),
    "corner at the rim": (-0.1, (0.70, 0.95, 0.70, 0.95)),
    "whole disc": (0.0, (-1.0, 1.0, -1.0, 1.0)),
    "more than the disc": (-0.2, (-1.5, 1.5, -2.0, 2.0)),
    "plane in front": (0.5, (-0.9, 0.7, -0.3, 0.8)),
    "plane far in front": (0.95, (-0.2, 0.3, -0.9, 0.1)),
    "cap at the end of e2": (0.0, (0.999, 1.0, -1.0, 1.0)),
    "cap at the end of e3": (0.0, (-1.0, 1.0, 0.999, 1.0)),
    "sliver along e2": (-0.3, (0.1, 0.1005, -0.5, 0.5)),
    "sliver along e3": (-0.3, (-0.5, 0.5, -0.2, -0.1995)),
    "needle": (0.0, (0.30, 0.301, -0.401, -0.40)),
    "behind only at the rim": (-0.3, (-1.0, -0.4, -0.97, 0.6)),
}


def random_triple(rng: np.random.Generator) -> np.ndarray:
    """An orthonormal triple with determinant one, Haar-distributed."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.array([[np.linalg.det(q)], [1], [1]])


def hinge_table(
    seed: int = 0, random: int = 21
) -> tuple[list[str], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Names and stacked parameters (triple, offset, bounds) of the nasty hinges and of `random`
    random ones."""
    rng = np.random.default_rng(seed)
    rows = list(NASTY_HINGES.items())
    while len(rows) < len(NASTY_HINGES) + random:
        offset = rng.choice([0.0, -abs(rng.normal() * 0.4), rng.uniform(-1, 1)])
        low, high = np.sort(rng.uniform(-1.05, 1.05, (2, 2)), axis=0)
        bounds = np.array([low[0], high[0], low[1], high[1]])
        u = rng.normal(size=(20_000, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        inside = (u[:, 0] + offset < 0) & (low <= u[:, 1:]).all(1) & (u[:, 1:] <= high).all(1)
        if inside.sum() > 10:  # some random boxes miss the disc
            rows.append((f"random {len(rows)}", (offset, tuple(bounds))))
    triples = np.stack([random_triple(rng) for _ in rows])
    offsets = np.array([row[1][0] for row in rows])
    return [row[0] for row in rows], (triples, offsets, np.array([row[1][1] for row in rows]))


def hinges_of(
    limits: AnatomicalLimits, count: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameters of `count` hinges of real tables: half at random, half those with the extreme
    offsets and areas."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(limits.has_plane)
    offset = np.asarray(limits.offset)[limits.has_plane]
    bounds = np.asarray(limits.bounds)[limits.has_plane]
    size = (bounds[:, 1] - bounds[:, 0]) * (bounds[:, 3] - bounds[:, 2])
    quarter = count // 8
    extreme = [
        np.argsort(key)[part]
        for key in (offset, size)
        for part in (slice(quarter), slice(-quarter, None))
    ]
    chosen = np.concatenate([*extreme, rng.choice(len(cells), count - 4 * quarter, replace=False)])
    where = tuple(cells[chosen].T)
    return (
        np.asarray(limits.triples())[where],
        np.asarray(limits.offset)[where],
        np.asarray(limits.bounds)[where],
    )


def cell_tables(seed: int = 0) -> dict[str, np.ndarray]:
    """Occupancy tables: random, single, at the poles, across the seam at ±180°, full."""
    rng = np.random.default_rng(seed)
    tables = {
        name: np.zeros(GRID, bool)
        for name in ("single", "north pole", "south pole", "one at a pole", "seam", "corner")
    }
    tables["single"][37, 22] = True
    tables["north pole"][:, 59] = True
    tables["south pole"][:, :2] = True
    tables["one at a pole"][80, 59] = True
    tables["seam"][[0, 1, 118, 119], 20:40] = True
    tables["corner"][[0, 119], [0, 59]] = True
    tables["full"] = np.ones(GRID, bool)
    tables["random"] = rng.random(GRID) < 0.3
    tables["sparse"] = rng.random(GRID) < 0.002
    return tables


LENGTHS = LengthPrior(
    low=np.array([0.5, 0.7, 0.4, 0.9, 1.0]),
    high=np.array([1.2, 1.0, 0.7, 1.5, 1.6]),
    alpha=np.array([7.0, 5.3, 0.6, 1.0, 40.0]),
    beta=np.array([6.5, 1.2, 0.8, 1.0, 25.0]),
)


def distributions() -> dict[str, dist.Distribution]:
    """The custom distributions, with batch shapes (), (3,) and (2, 2)."""
    _, (triples, offsets, bounds) = hinge_table()
    tables = np.stack(list(cell_tables().values()))
    rng = np.random.default_rng(3)
    found: dict[str, dist.Distribution] = {}
    for measure, label, index in (
        ("area", "", 6),
        ("area", "two by two", [[0, 5], [14, 17]]),
        ("box", "three", [0, 5, 7]),
    ):
        hinge = Hinge.build(triples[index], offsets[index], bounds[index], measure)
        found[f"hinged {measure} {label}".strip()] = HingedDirection(hinge)
    for measure, label, index in (
        ("angle", "", 4),
        ("angle", "two by two", [[2, 3], [5, 6]]),
        ("area", "three", [0, 1, 7]),
    ):
        found[f"occupied {measure} {label}".strip()] = OccupiedDirection(
            Cells.build(tables[index], measure)
        )
    found["disc"] = DetectedKeypoint(Disc(), jnp.array([3.0, -2.0]), jnp.array(0.5))
    found["disc three"] = DetectedKeypoint(
        Disc(), rng.normal(size=(3, 2)), np.array([1e-3, 1.0, 300.0])
    )
    found["disc two by two"] = DetectedKeypoint(
        Disc(), jnp.zeros(2), np.array([[1.0, 2.0], [3.0, 4.0]])
    )
    for name, law in LAWS.items():
        found[f"keypoint, {name}"] = DetectedKeypoint(law(), rng.normal(size=(3, 2)), 0.7)
    found["length"] = BoneLength(LENGTHS)
    wide = [jnp.broadcast_to(field, (3, 5)) for field in LENGTHS]
    found["length three"] = BoneLength(LengthPrior(*wide))
    found["torso"] = TorsoDictionary(rng.normal(size=(7, 6, 3)))
    found["rotation"] = UprightRotation()
    found["rotation three"] = UprightRotation(np.array([0.0, 2.0, 50.0]))
    return found


def index_region(region: Hinge | Cells, index: object) -> Hinge | Cells:
    """One region, or some, of a stacked region."""
    return jax.tree.map(lambda leaf: leaf[index], region)
