"""The plainest proposal, in NumPy: limbs drawn from the prior, without a look at the detections.

It is there to be timed beside exact rejection; JAX's is `inference.exact.naive.group_prior`.
"""

import numpy as np

from inference.exact.problem import Draws, Group
from probmodel.anatomy.limits import CELL


def propose(group: Group, number: int, rng: np.random.Generator) -> Draws:
    """Draws of a group of limbs from the prior (upper bones uniform in angle, lower bones per
    steradian)."""
    low, high, alpha, beta = (np.asarray(field) for field in group.lengths)
    length = low + (high - low) * rng.beta(alpha, beta, (number, group.num_bones))
    limbs = [_limb(group, limb, number, rng) for limb in range(group.num_limbs)]
    upper, lower = (np.stack(parts, axis=1) for parts in zip(*limbs, strict=True))
    return Draws(length, upper, lower)


def _limb(
    group: Group, limb: int, number: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower directions `(number, 3)`, in their local frames."""
    cells = np.argwhere(np.asarray(group.cells.occupied)[limb])
    column, row = cells[rng.integers(len(cells), size=number)].T
    azimuth = CELL * (column + rng.uniform(size=number)) - np.pi
    elevation = CELL * (row + rng.uniform(size=number)) - np.pi / 2
    around = np.cos(elevation)
    upper = np.stack(
        [around * np.cos(azimuth), around * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    if group.num_bones == 1:
        return upper, upper
    hinges = (group.hinges.triple, group.hinges.offset, group.hinges.bounds)
    triple, offset, bounds = (np.asarray(table)[limb, column, row] for table in hinges)
    return upper, _hinged(triple, offset, bounds, rng)


def _hinged(
    triple: np.ndarray, offset: np.ndarray, bounds: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Directions `(n, 3)` uniform on what plane and box of each draw's own cell leave: on the whole
    sphere, until all are possible."""
    found, left = np.empty((len(triple), 3)), np.arange(len(triple))
    while len(left):
        lower = rng.normal(size=(len(left), 3))
        lower /= np.linalg.norm(lower, axis=-1, keepdims=True)
        u1, u2, u3 = np.einsum("nij,nj->in", triple[left], lower)
        low2, high2, low3, high3 = bounds[left].T
        possible = (u1 + offset[left] < 0) & (low2 <= u2) & (u2 <= high2)
        possible &= (low3 <= u3) & (u3 <= high3)
        found[left[possible]] = lower[possible]
        left = left[~possible]
    return found
