"""First-stage weights: how near draws of the prior come to where a limb's joints were
detected, under many roots. Compiled, in single precision and by lanes, so that it
becomes vector instructions: many more roots get a first-stage weight than are weighted
in the end, and it decides no more than which those are."""

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.vectors import Reference, dot, lower_axes, out_of

LANES = 16
"""Sums that are kept side by side; the number of draws is a multiple of it."""
_ONE = np.float32(1)
_EIGHTH = np.float32(1 / 8)


@compiled
def limb_ends(
    reference: Reference, length: np.ndarray, upper: np.ndarray, lower: np.ndarray, ends: np.ndarray
) -> None:
    """Where the joints of a limb lie from its start, in its upper bone's local frame.

    Parameters
    ----------
    reference : of the lower bone's frame
    length : `(n, 2)` of both bones
    upper, lower : `(n, 3)` their local directions, parent minus child
    ends : `(3, 2, n)` single precision, written on
    """
    for n in range(len(length)):
        u = upper[n, 0], upper[n, 1], upper[n, 2]
        v, w, _ = lower_axes(u, reference)
        bone = out_of((u, v, w), (lower[n, 0], lower[n, 1], lower[n, 2]))
        for axis in range(3):
            ends[axis, 0, n] = -length[n, 0] * u[axis]
            ends[axis, 1, n] = -length[n, 0] * u[axis] - length[n, 1] * bone[axis]


@inlined
def _kernel(rate: np.float32, x: np.float32, y: np.float32) -> np.float32:
    """About exp(-rate (x² + y²)), without a call: (1 + ·/8)⁻⁸."""
    once = _ONE / (_ONE + _EIGHTH * (rate * (x * x + y * y)))
    square = once * once
    fourth = square * square
    return fourth * fourth


@compiled
def mean_nearness(
    pool: np.ndarray, axes: np.ndarray, gap: np.ndarray, rate: np.ndarray, near: np.ndarray
) -> None:
    """Mean nearness of a limb's joints under every root.

    Parameters
    ----------
    pool : `(3, 2, m)` single precision: where both joints lie from the limb's start, in
        its frame
    axes : `(n, 2, 3)` single precision: the frame in the axes of the image
    gap : `(n, 2, 2)` single precision: the limb's start minus where its joints were
        detected
    rate : `(2,)` single precision: one over twice the variance of both errors; 0 where
        nothing was seen
    near : `(n, 3)` written on: means of both joints' nearness together, of the second's
        and of the first's, each 1 at most
    """
    sums = np.zeros((3, LANES), np.float32)
    both = sums[0]
    second = sums[1]
    first = sums[2]
    # In rows of lanes: with indices that might be negative, loads would become gathers.
    rows = pool.reshape((3, 2, -1, LANES))
    x1 = rows[0, 0]
    y1 = rows[1, 0]
    z1 = rows[2, 0]
    x2 = rows[0, 1]
    y2 = rows[1, 1]
    z2 = rows[2, 1]
    rate1 = rate[0]
    rate2 = rate[1]
    for row in range(len(axes)):
        a = axes[row, 0, 0], axes[row, 0, 1], axes[row, 0, 2]
        b = axes[row, 1, 0], axes[row, 1, 1], axes[row, 1, 2]
        gap1 = gap[row, 0, 0], gap[row, 0, 1]
        gap2 = gap[row, 1, 0], gap[row, 1, 1]
        sums[:] = 0
        for block in range(len(x1)):
            for lane in range(LANES):
                joint1 = x1[block, lane], y1[block, lane], z1[block, lane]
                joint2 = x2[block, lane], y2[block, lane], z2[block, lane]
                near1 = _kernel(rate1, dot(a, joint1) + gap1[0], dot(b, joint1) + gap1[1])
                near2 = _kernel(rate2, dot(a, joint2) + gap2[0], dot(b, joint2) + gap2[1])
                both[lane] += near1 * near2
                second[lane] += near2
                first[lane] += near1
        for column in range(3):
            near[row, column] = sums[column].sum() / x1.size
