"""The rectangle around the directions that put a bone's end into its disc, in the chart
(x, α) whose area is dx dα.

A bone of length 1 seen along the line of sight: x is what it moves across the line from
its start to the disc's centre, √(1-x²) sin α along that line. Compiled, without
branches; see `tests.witnesses.patches.patch_rectangle` for the same in JAX."""

import math

import numpy as np

from poseterior.inference.exact.loops.numbers import inlined
from poseterior.inference.exact.loops.series import arcsine

SLACK = 1e-9
"""Bounds are widened by this much (relative, or body units), so that rounding never
makes them less than bounds."""
ROWS = 4
"""Pieces of the α range in front, and as many behind."""
MASKS = 1 << (2 * ROWS)
PICK = np.array(
    [
        [
            ([i for i in range(2 * ROWS) if mask >> i & 1] or [0])[n % max(mask.bit_count(), 1)]
            for n in range(2 * ROWS)
        ]
        for mask in range(MASKS)
    ],
    dtype=np.int8,
)
"""`PICK[mask, n]`: the n-th piece that a mask keeps."""
COUNT = np.array([mask.bit_count() for mask in range(MASKS)], dtype=np.int8)
"""How many pieces a mask keeps."""


@inlined
def rectangle(distance: float, radius: float) -> tuple[float, float, float]:
    """|x| ≤ width, low ≤ α ≤ high around what a disc at `distance` sees; low = high
    where it sees nothing."""
    crossing = (1 + distance * distance - radius * radius) / (
        2 * (distance if distance > 1e-300 else 1e-300)
    )
    rest = 1 - crossing * crossing
    width = math.sqrt(rest if rest > 0 else 0.0)  # where the disc's rim meets the sphere's
    width = width if crossing < distance else (radius if radius < 1 else 1.0)
    return (width if crossing > 0 else 1.0), arcsine(distance - radius), arcsine(distance + radius)


@inlined
def largest_rectangle(nearest: float, farthest: float, radius: float) -> float:
    """The largest 2 · width · (high - low) for distances in [nearest, farthest] and
    radii up to `radius`: the rectangle grows with the radius, and with the distance
    until the disc touches the rim, from where on it shrinks."""
    touching = 1 - radius
    touching = touching if touching > nearest else nearest
    width, low, _ = rectangle(touching if touching < farthest else farthest, radius)
    # Where that is not at `farthest`, both reach the rim; and this arcsine is known
    # already.
    high = arcsine(farthest + radius)
    return 2 * width * (high - low) * (1 + SLACK)
