"""Line-of-sight frames: how the joints of a limb are seen under many roots. Compiled;
in body units."""

import math

import numpy as np

from poseterior.inference.exact.loops.numbers import compiled
from poseterior.inference.exact.loops.vectors import into


@compiled
def line_of_sight_frames(
    axes: np.ndarray,
    start: np.ndarray,
    target: np.ndarray,
    ray: np.ndarray,
    nearness: np.ndarray,
    frames: np.ndarray,
) -> None:
    """Gives each of a limb's two joints, under every root, the camera's axes after the
    smallest turn that brings the line of sight to where the joint was detected onto the
    third. Joints that do not count are seen as if they were as far away as the pelvis.

    Parameters
    ----------
    axes : `(n, 3, 3)` the upper bone's local frame in camera axes
    start : `(n, 3)` where the limb starts
    target, ray : `(n, 2, 2)` the detections, and the lines of sight to them
    nearness : `(n,)` one over the pelvis' distance
    frames : `(n, 2)` `SIGHT_FRAMES`, whose `reach` is there, and whose geometry is
        written on
    """
    for row in range(len(axes)):
        for joint in range(2):
            frame = frames[row, joint]
            counted = 1.0 if frame.reach < math.inf else 0.0
            ray0 = ray[row, joint, 0] * counted
            ray1 = ray[row, joint, 1] * counted
            near = nearness[row] * counted
            cosine = 1 / math.sqrt(1 + ray0 * ray0 + ray1 * ray1)
            side0 = ray0 * cosine
            side1 = ray1 * cosine
            bend = 1 / (1 + cosine)
            turn = (
                (1 - side0 * side0 * bend, -side0 * side1 * bend, -side0),
                (-side0 * side1 * bend, 1 - side1 * side1 * bend, -side1),
                (side0, side1, cosine),
            )
            for column in range(3):
                axis = axes[row, 0, column], axes[row, 1, column], axes[row, 2, column]
                seen0, seen1, seen2 = into(turn, axis)
                frame.axes[0, column] = seen0
                frame.axes[1, column] = seen1
                frame.axes[2, column] = seen2
                frame.slope[column] = -near * axis[2]
            gap = (
                target[row, joint, 0] - start[row, 0],
                target[row, joint, 1] - start[row, 1],
                -start[row, 2],
            )
            across0, across1, _ = into(turn, gap)
            frame.target[0] = across0 * counted
            frame.target[1] = across1 * counted
            frame.start = 1 + near * start[row, 2]
            bend /= cosine
            frame.stretch[0] = 1 + side0 * side0 * bend
            frame.stretch[1] = side0 * side1 * bend
            frame.stretch[2] = 1 + side1 * side1 * bend
