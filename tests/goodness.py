"""Goodness of fit with a written false-alarm rate, and integrals on the sphere that share no
formula with `probmodel`.

Every statistical test may fail by chance with probability `FALSE_ALARM` in all, over a fresh seed;
a test that makes n comparisons divides it by n (`floor`). Seeds are fixed, so a failure is a defect
until shown otherwise."""

import numpy as np
from scipy import stats

FALSE_ALARM = 1e-4
"""Chance that one test function fails although all is well, over the choice of its seed."""


def floor(comparisons: int) -> float:
    """The p-value below which one of `comparisons` comparisons fails (Bonferroni)."""
    return FALSE_ALARM / comparisons


def chi_square(counts: np.ndarray, probabilities: np.ndarray, least: float = 10.0) -> float:
    """p-value of Pearson's test of `counts` `(k,)` against `probabilities` `(k,)`, bins merged up
    to `least` expected.

    A count where the probability is zero gives p = 0.
    """
    counts, probabilities = np.asarray(counts, float), np.asarray(probabilities, float)
    if counts[probabilities <= 0].sum() > 0:
        return 0.0
    order = np.argsort(probabilities)
    order = order[probabilities[order] > 0]
    expected, seen = counts.sum() * probabilities[order], counts[order]
    # Smallest first, so that merged bins are alike in size; the last, incomplete one joins its
    # neighbour.
    start = np.unique(np.floor(np.cumsum(expected) / least + 1e-9), return_index=True)[1]
    start = start[:-1] if len(start) > 2 else start
    start[0] = 0
    expected, seen = np.add.reduceat(expected, start), np.add.reduceat(seen, start)
    if len(seen) < 2:
        return 1.0
    statistic = np.sum((seen - expected) ** 2 / expected)
    return float(stats.chi2.sf(statistic, len(seen) - 1))


def uniform_square(square: np.ndarray, cells: int = 8) -> float:
    """p-value of points `(n, 2)` being uniform in the unit square: chi-square on cells × cells
    equal parts."""
    counts, _, _ = np.histogram2d(*np.asarray(square).T, bins=cells, range=[[0, 1], [0, 1]])
    return chi_square(counts.ravel(), np.full(cells**2, cells**-2.0))


def uniform_each(cube: np.ndarray) -> np.ndarray:
    """p-values `(d,)` of each coordinate of points `(n, d)` being uniform on [0, 1]:
    Kolmogorov–Smirnov."""
    return np.array([stats.kstest(column, "uniform").pvalue for column in np.asarray(cube).T])


def energy_p_value(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, permutations: int = 999
) -> float:
    """p-value that samples `(n, d)` and `(m, d)` have one law: permutation test of the energy
    distance."""
    pooled = np.concatenate([a, b])
    distance = np.sqrt(np.maximum(np.sum((pooled[:, None] - pooled[None]) ** 2, axis=-1), 0.0))

    def energy(is_a: np.ndarray) -> np.ndarray:
        weight = np.where(is_a, 1 / len(a), -1 / len(b))
        return -np.einsum("pi,pi->p", weight @ distance, weight)

    labels = np.arange(len(pooled)) < len(a)
    shuffled = np.stack([rng.permutation(labels) for _ in range(permutations)])
    observed = energy(labels[None])[0]
    return float((1 + np.sum(energy(shuffled) >= observed)) / (1 + permutations))


def sphere_grid(rings: int) -> tuple[np.ndarray, float]:
    """Points `(n, 3)`, nearly even on the sphere (a Fibonacci spiral), and the steradians each
    stands for."""
    n = rings**2
    z = 1 - (2 * np.arange(n) + 1) / n
    azimuth = np.pi * (1 + 5**0.5) * np.arange(n)
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], axis=-1), 4 * np.pi / n


def hinge_masses(
    offset: float,
    bounds: np.ndarray,
    measure: str,
    strips: np.ndarray,
    sectors: np.ndarray,
    order: int = 48,
) -> np.ndarray:
    """Measure `(len(strips) - 1, len(sectors) - 1)` of the possible directions in strips of u3 ×
    sectors of γ.

    Another chart than the package's: the axis is e3, not e2, with u2 = ρ sin γ, u1 = -ρ cos γ, ρ =
    √(1 - u3²), γ all around from -π to π, so surface is du3 dγ. For each u3 the circle is cut
    wherever a condition can change and each arc is kept or dropped by the conditions at its middle;
    Gauss–Legendre over u3, pieces between kinks, in an angle that takes the square roots out of the
    ends."""
    low2, high2, low3, high3 = bounds
    squares = np.array(
        [0.0, low2**2, high2**2, offset**2, low2**2 + offset**2, high2**2 + offset**2]
    )
    # A sector's border meets the plane or the box on these circles of latitude too.
    sine, cosine = np.sin(sectors), np.abs(np.cos(sectors))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.concatenate([low2 / sine, high2 / sine, offset / cosine])
    squares = np.concatenate([squares, ratios[np.isfinite(ratios)] ** 2])
    kinks = np.sqrt(np.clip(1 - squares, 0, 1))
    first, last = max(low3, -1.0), min(high3, 1.0)
    if first >= last:
        return np.zeros((len(strips) - 1, len(sectors) - 1))
    near_the_ends = [
        sign * (1 - 0.1**k) for k in range(1, 6) for sign in (-1, 1)
    ]  # the circles shrink fast there
    nodes = np.unique(
        np.clip(np.concatenate([kinks, -kinks, strips, [first, last], near_the_ends]), first, last)
    )
    nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-15])]
    x, w = np.polynomial.legendre.leggauss(order)
    theta = np.pi * (x + 1) / 2
    middle, half = (nodes[1:] + nodes[:-1])[:, None] / 2, np.diff(nodes)[:, None] / 2
    u3 = (middle - half * np.cos(theta)).ravel()
    weight = (half * np.sin(theta) * w * np.pi / 2).ravel()
    arcs = _arc_masses(
        offset, (low2, high2), np.sqrt(np.maximum((1 - u3) * (1 + u3), 1e-30)), sectors, measure
    )
    strip = np.repeat(np.searchsorted(strips, middle[:, 0], side="right") - 1, order)
    masses = np.zeros((len(strips) - 1, len(sectors) - 1))
    np.add.at(masses, np.clip(strip, 0, len(strips) - 2), weight[:, None] * arcs)
    return masses


def _arc_masses(
    offset: float, box: tuple[float, float], rho: np.ndarray, sectors: np.ndarray, measure: str
) -> np.ndarray:
    """`(len(rho), len(sectors) - 1)`: measure of the possible arcs in each sector of each circle of
    latitude."""
    cuts = [np.broadcast_to(sectors, (len(rho), len(sectors)))]
    for level in box:
        angle = np.arcsin(np.clip(level / rho, -1, 1))[:, None]
        cuts += [angle, np.pi - angle, -np.pi - angle]
    angle = np.arccos(np.clip(offset / rho, -1, 1))[:, None]
    cuts += [angle, -angle, np.full_like(angle, np.pi / 2), np.full_like(angle, -np.pi / 2)]
    cut = np.sort(np.clip(np.concatenate(cuts, axis=1), sectors[0], sectors[-1]), axis=1)
    centre = (cut[:, 1:] + cut[:, :-1]) / 2
    u1, u2 = -rho[:, None] * np.cos(centre), rho[:, None] * np.sin(centre)
    kept = (u1 + offset < 0) & (box[0] <= u2) & (u2 <= box[1])
    length = np.diff(cut, axis=1)
    if measure == "box":
        length = rho[:, None] * np.abs(np.diff(np.sin(cut), axis=1))
    mass = np.zeros((len(rho), len(sectors) - 1))
    sector = np.clip(
        np.searchsorted(sectors, centre.ravel(), side="right") - 1, 0, len(sectors) - 2
    )
    np.add.at(
        mass,
        (np.repeat(np.arange(len(rho)), centre.shape[1]), sector),
        np.where(kept, length, 0.0).ravel(),
    )
    return mass
