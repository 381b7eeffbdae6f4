"""How near draws of the prior come to what a limb's joints were detected as, under many roots.
Compiled, in single precision and by lanes, so that it becomes vector instructions: it is asked of
many more roots than are weighed, and decides no more than which those are."""

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled, inlined
from poseterior.inference.exact.loops.strata import lower_axes
from poseterior.inference.exact.loops.tables import Reference

LANES = 16
"""Sums that are kept side by side; the number of draws is a multiple of it."""
_ONE, _EIGHTH = np.float32(1), np.float32(1 / 8)


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
        u0, u1, u2 = upper[n, 0], upper[n, 1], upper[n, 2]
        v0, v1, v2, w0, w1, w2, _ = lower_axes(u0, u1, u2, reference)
        q0, q1, q2 = lower[n, 0], lower[n, 1], lower[n, 2]
        one, two = length[n, 0], length[n, 1]
        ends[0, 0, n], ends[1, 0, n], ends[2, 0, n] = -one * u0, -one * u1, -one * u2
        ends[0, 1, n] = -one * u0 - two * (u0 * q0 + v0 * q1 + w0 * q2)
        ends[1, 1, n] = -one * u1 - two * (u1 * q0 + v1 * q1 + w1 * q2)
        ends[2, 1, n] = -one * u2 - two * (u2 * q0 + v2 * q1 + w2 * q2)


@inlined
def _bell(rate: np.float32, x: np.float32, y: np.float32) -> np.float32:
    """About exp(-rate (x² + y²)), without a call: (1 + ·/8)⁻⁸."""
    once = _ONE / (_ONE + _EIGHTH * (rate * (x * x + y * y)))
    square = once * once
    fourth = square * square
    return fourth * fourth


@compiled
def near_rows(
    pool: np.ndarray, axes: np.ndarray, gap: np.ndarray, rate: np.ndarray, near: np.ndarray
) -> None:
    """Mean nearness of a limb's joints under every root.

    Parameters
    ----------
    pool : `(3, 2, m)` single precision: where both joints lie from the limb's start, in its frame
    axes : `(n, 2, 3)` single precision: the frame in the axes of the image
    gap : `(n, 2, 2)` single precision: the limb's start minus where its joints were detected
    rate : `(2,)` single precision: one over twice the variance of both errors; 0 where nothing was
        seen
    near : `(n, 3)` written on: means of both joints' nearness together, of the second's and of the
        first's, each 1 at most
    """
    lanes = np.zeros((3, LANES), np.float32)
    # In rows of lanes: with indices that might be negative, loads would become gathers.
    rows = pool.reshape((3, 2, -1, LANES))
    x1, y1, z1 = rows[0, 0], rows[1, 0], rows[2, 0]
    x2, y2, z2 = rows[0, 1], rows[1, 1], rows[2, 1]
    both, outer, inner = lanes[0], lanes[1], lanes[2]
    rate1, rate2 = rate[0], rate[1]
    for row in range(len(axes)):
        a0, a1, a2 = axes[row, 0, 0], axes[row, 0, 1], axes[row, 0, 2]
        b0, b1, b2 = axes[row, 1, 0], axes[row, 1, 1], axes[row, 1, 2]
        g10, g11, g20, g21 = gap[row, 0, 0], gap[row, 0, 1], gap[row, 1, 0], gap[row, 1, 1]
        lanes[:] = 0
        for block in range(len(x1)):
            for lane in range(LANES):
                first = _bell(
                    rate1,
                    a0 * x1[block, lane] + a1 * y1[block, lane] + a2 * z1[block, lane] + g10,
                    b0 * x1[block, lane] + b1 * y1[block, lane] + b2 * z1[block, lane] + g11,
                )
                second = _bell(
                    rate2,
                    a0 * x2[block, lane] + a1 * y2[block, lane] + a2 * z2[block, lane] + g20,
                    b0 * x2[block, lane] + b1 * y2[block, lane] + b2 * z2[block, lane] + g21,
                )
                both[lane] += first * second
                outer[lane] += second
                inner[lane] += first
        for column in range(3):
            near[row, column] = lanes[column].sum() / x1.size
