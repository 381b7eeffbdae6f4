"""Attempts at a root: a torso, a rotation, a scale and a translation that bring the torso's seen
joints within reach of their detections. Compiled; scales in pixels a body unit.

The torso is uniform over the dictionary, the rotation on SO(3) (quaternions, Shoemake 1992), the
scale has density ∝ scale^-power above a proven lower bound, and the translation puts the first
joint uniformly into its disc. So every attempt has the same weight (`docs/model.md`, § 9), and what
passes the other discs is an exact draw."""

import math
from typing import NamedTuple

import numpy as np

from inference.exact.loops.numbers import compiled, load, store, uniform


class TorsoProblem(NamedTuple):
    """The torso's seen joints in front of a camera.

    Attributes
    ----------
    torsos : `(J, n, 3)` the joints in body axes, body units
    keypoints : `(n, 2)` where they were detected, pixels
    reach : `(n,)` how far from there they may fall, body units
    lowest : a scale below which no torso explains the detections, pixels a body unit
    power : of the scales' density, positive
    """

    torsos: np.ndarray
    keypoints: np.ndarray
    reach: np.ndarray
    lowest: float
    power: float


class RootTable(NamedTuple):
    """Where roots are written to: `torso` `(most,)`, `quaternion` `(most, 4)` scalar first, `scale`
    `(most,)`, `plane` `(most, 2)` the translation over the scale, `attempt` `(most,)` the number of
    the attempt."""

    torso: np.ndarray
    quaternion: np.ndarray
    scale: np.ndarray
    plane: np.ndarray
    attempt: np.ndarray


def root_table(most: int) -> RootTable:
    """A table with room for so many roots."""
    return RootTable(
        np.zeros(most, np.int64),
        np.zeros((most, 4)),
        np.zeros(most),
        np.zeros((most, 2)),
        np.zeros(most, np.int64),
    )


@compiled
def attempt_roots(
    state: np.ndarray, attempts: int, problem: TorsoProblem, table: RootTable
) -> tuple[int, int]:
    """Makes attempts, up to a number of them or until the table is full. Returns how many roots
    were found, and how many attempts were made."""
    torsos, keypoints, reach = problem.torsos, problem.keypoints, problem.reach
    stream, found, joints = load(state), 0, reach.size
    for attempt in range(attempts):
        at, stream = uniform(stream)
        torso = int(at * len(torsos))
        share, stream = uniform(stream)
        first, stream = uniform(stream)
        second, stream = uniform(stream)
        short, long = math.sqrt(1 - share), math.sqrt(share)
        w, x = long * math.cos(2 * np.pi * second), short * math.sin(2 * np.pi * first)
        y, z = short * math.cos(2 * np.pi * first), long * math.sin(2 * np.pi * second)
        m00, m01, m02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        m10, m11, m12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        level, stream = uniform(stream)
        inverse = (1 - level) ** (1 / problem.power) / problem.lowest
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        radius, angle = reach[0] * math.sqrt(radius), 2 * np.pi * angle
        p0, p1, p2 = torsos[torso, 0, 0], torsos[torso, 0, 1], torsos[torso, 0, 2]
        t0 = keypoints[0, 0] * inverse + radius * math.cos(angle)
        t1 = keypoints[0, 1] * inverse + radius * math.sin(angle)
        t0 -= m00 * p0 + m01 * p1 + m02 * p2
        t1 -= m10 * p0 + m11 * p1 + m12 * p2
        inside = True
        for joint in range(1, joints):
            p0, p1, p2 = torsos[torso, joint, 0], torsos[torso, joint, 1], torsos[torso, joint, 2]
            off0 = m00 * p0 + m01 * p1 + m02 * p2 + t0 - keypoints[joint, 0] * inverse
            off1 = m10 * p0 + m11 * p1 + m12 * p2 + t1 - keypoints[joint, 1] * inverse
            if off0 * off0 + off1 * off1 > reach[joint] * reach[joint]:
                inside = False
                break
        if inside:
            table.torso[found] = torso
            table.quaternion[found, 0], table.quaternion[found, 1] = w, x
            table.quaternion[found, 2], table.quaternion[found, 3] = y, z
            table.scale[found] = 1 / inverse
            table.plane[found, 0], table.plane[found, 1] = t0, t1
            table.attempt[found] = attempt
            found += 1
            if found == table.torso.size:
                store(state, stream)
                return found, attempt + 1
    store(state, stream)
    return found, attempts
