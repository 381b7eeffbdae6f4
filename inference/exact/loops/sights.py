"""How the joints of a limb are seen under many roots. Compiled; in body units."""

import math

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled


@compiled
def see_rows(
    axes: np.ndarray,
    start: np.ndarray,
    target: np.ndarray,
    ray: np.ndarray,
    nearness: np.ndarray,
    counts: np.ndarray,
    own: np.ndarray,
    across: np.ndarray,
    optics: np.ndarray,
) -> None:
    """How a limb's two joints are seen under every root: each in axes of its own, those of the
    camera after the smallest turn that brings the line of sight to where the joint was detected
    onto the third. Joints that do not count are seen as if they were as far away as the pelvis.

    Parameters
    ----------
    axes : `(n, 3, 3)` the upper bone's local frame in camera axes
    start : `(n, 3)` where the limb starts
    target, ray : `(n, 2, 2)` the detections, and the lines of sight to them
    nearness : `(n,)` one over the pelvis' distance
    counts : `(n, 2)` whether the joints were seen
    own : `(n, 2, 3, 3)` written on: the local frame in the joints' axes
    across : `(n, 2, 2)` written on: the detections minus the limb's start, in the same axes; 0
        where a joint does not count
    optics : `(n, 2)` `OPTICS`, written on
    """
    for row in range(len(axes)):
        for joint in range(2):
            counted = 1.0 if counts[row, joint] else 0.0
            ray0, ray1 = ray[row, joint, 0] * counted, ray[row, joint, 1] * counted
            near, optic = nearness[row] * counted, optics[row, joint]
            cosine = 1 / math.sqrt(1 + ray0 * ray0 + ray1 * ray1)
            side0, side1, bend = ray0 * cosine, ray1 * cosine, 1 / (1 + cosine)
            t00, t01 = 1 - side0 * side0 * bend, -side0 * side1 * bend
            t11 = 1 - side1 * side1 * bend
            for column in range(3):
                a0, a1, a2 = axes[row, 0, column], axes[row, 1, column], axes[row, 2, column]
                own[row, joint, 0, column] = t00 * a0 + t01 * a1 - side0 * a2
                own[row, joint, 1, column] = t01 * a0 + t11 * a1 - side1 * a2
                own[row, joint, 2, column] = side0 * a0 + side1 * a1 + cosine * a2
                optic.slope[column] = -near * a2
            gap0, gap1 = (
                target[row, joint, 0] - start[row, 0],
                target[row, joint, 1] - start[row, 1],
            )
            gap2 = -start[row, 2]
            across[row, joint, 0] = (t00 * gap0 + t01 * gap1 - side0 * gap2) * counted
            across[row, joint, 1] = (t01 * gap0 + t11 * gap1 - side1 * gap2) * counted
            optic.start = 1 + near * start[row, 2]
            bend /= cosine
            optic.stretch[0], optic.stretch[1] = 1 + side0 * side0 * bend, side0 * side1 * bend
            optic.stretch[2] = 1 + side1 * side1 * bend
