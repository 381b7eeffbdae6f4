"""Proposals of a root: a torso, a rotation, a scale and a translation that bring the
torso's seen joints within reach of their detections. Compiled.

Every joint is projected along the line of sight to its own detection (`ray`), where
perspective is known: what it misses its detection by, as large as at its own depth, is
then as linear in the scale and the translation as under weak perspective (docs/model.md
§ 9).

Rotations are cut into cells of three angles, R = Rz(roll) Ry(tilt) Rz(yaw): uniform on
SO(3) is uniform in roll, cos tilt and yaw. Under every torso and cell, each pair of
joints bounds the scale: their images are farther apart than detected by no more than
both reaches, and by what a turn inside the cell can add. A cell that no scale is left
in is dropped. Nothing is estimated.

A proposal draws a cell by its prior mass times that of its scales, a rotation in it, a
scale, and puts the first joint uniformly into its disc. So every proposal has the same
weight (docs/model.md § 9), and what passes the other discs is an exact draw."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.rectangles import SLACK
from poseterior.inference.exact.loops.series import circle
from poseterior.inference.exact.loops.tables import ROOT_CELLS, Record
from poseterior.inference.exact.loops.vectors import Axes, Plane, Vector, dot

TILTS = 12
"""Cells of the tilt, from 0 to π; twice as many of roll and of yaw."""
WIDTH = math.pi / TILTS
EDGES = np.cos(np.arange(TILTS + 1) * WIDTH)
"""Cosines of the tilts between cells."""
MOST_CELLS = 1 << 18
"""Cells that there is room for at first: enough for most torsos."""


class TorsoJoints(NamedTuple):
    """The torso's seen joints in front of a camera.

    Attributes
    ----------
    torsos : `(J, n, 3)` the joints in body axes, body units
    keypoints : `(n, 2)` where they were detected, in units of the lowest scale: then
        the inverse scale lies between 0 and 1
    bias : `(n, 2)` of the keypoints, body units: how far beside their joints they lie
        in the mean
    reach : `(n,)` how far from there they may fall, body units
    precision : `(n,)` one over the variance of joints whose errors are Gaussian within
        the reach, of which `loops.gaussian` makes use; 0 for others
    ray : `(n, 2)` of the joints' lines of sight, how far they run to the side for one
        in depth; 0 where all are parallel
    power : of the scales' density: that of the inverse scale v is v^(power - 1)
    """

    torsos: np.ndarray
    keypoints: np.ndarray
    bias: np.ndarray
    reach: np.ndarray
    precision: np.ndarray
    ray: np.ndarray
    power: float


class ProposedRoot(NamedTuple):
    """A root in registers: the `torso`'s number, the rotation, whose rows are `turn`,
    the `inverse` of the scale, and the translation over the scale, `plane`."""

    torso: int
    turn: Axes
    inverse: float
    plane: Plane


def disc_cells(joints: TorsoJoints) -> tuple[np.ndarray, float]:
    """The `ROOT_CELLS` in which a root may explain the torso, and the mass of all,
    which has the area of the first disc in it."""
    code, low, high = _cells_left(joints, MOST_CELLS)
    tilt = code // (2 * TILTS) % TILTS
    cells = np.zeros(len(code), ROOT_CELLS)
    cells["code"] = code
    cells["low"] = low**joints.power
    cells["span"] = high**joints.power - cells["low"]
    share = (EDGES[tilt] - EDGES[tilt + 1]) / 2 / (2 * TILTS) ** 2 / len(joints.torsos)
    weight = share * cells["span"] / joints.power
    area = math.pi * float(joints.reach[0]) ** 2
    return cells, area * float(alias_table(weight, cells)) if len(code) else 0.0


def _cells_left(joints: TorsoJoints, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Codes, and least and greatest inverse scales, of the cells that are left;
    searched again where there are more of them than there is room for."""
    code = np.empty(most, np.int64)
    low = np.empty(most)
    high = np.empty(most)
    number = _find_cells(joints, code, low, high)
    if number > most:
        return _cells_left(joints, number)
    return code[:number], low[:number], high[:number]


@compiled
def _find_cells(joints: TorsoJoints, code: np.ndarray, low: np.ndarray, high: np.ndarray) -> int:
    """Writes the cells that are left, as far as there is room; returns how many they
    are."""
    count = 0
    number = joints.reach.size
    pairs = np.empty((number * (number - 1) // 2, 2))
    seen = np.empty((number, 3))
    for torso in range(len(joints.torsos)):
        _measure_pairs(joints, torso, pairs)
        for yaw in range(2 * TILTS):
            for tilt in range(TILTS):
                _turn_but_roll(joints.torsos, torso, yaw, tilt, seen)
                for roll in range(2 * TILTS):
                    least, most = _inverse_scales(joints, pairs, seen, roll)
                    if least < most:
                        if count < code.size:
                            cell = (yaw * TILTS + tilt) * 2 * TILTS + roll
                            code[count] = torso * TILTS * (2 * TILTS) ** 2 + cell
                            low[count] = least
                            high[count] = most
                        count += 1
    return count


@inlined
def _turn_but_roll(torsos: np.ndarray, torso: int, yaw: int, tilt: int, seen: np.ndarray) -> None:
    """Writes where the joints of a torso lie before the roll, `(n, 3)`."""
    cos_yaw = math.cos((yaw + 0.5) * WIDTH)
    sin_yaw = math.sin((yaw + 0.5) * WIDTH)
    cosine = math.cos((tilt + 0.5) * WIDTH)
    sine = math.sin((tilt + 0.5) * WIDTH)
    for joint in range(len(seen)):
        x, y, z = point_of(torsos, torso, joint)
        ahead = cos_yaw * x - sin_yaw * y
        seen[joint, 0] = cosine * ahead + sine * z
        seen[joint, 1] = sin_yaw * x + cos_yaw * y
        seen[joint, 2] = cosine * z - sine * ahead


@inlined
def _measure_pairs(joints: TorsoJoints, torso: int, pairs: np.ndarray) -> None:
    """Writes of all pairs of joints, `(n (n - 1) / 2, 2)`, how far they lie apart; and how
    far, at most, their images move against each other because their lines of sight run
    to the side, if their depths change by their distance from the pelvis and from each
    other."""
    ray = joints.ray
    pair = 0
    for one in range(joints.reach.size):
        side = math.sqrt(ray[one, 0] ** 2 + ray[one, 1] ** 2)
        first = point_of(joints.torsos, torso, one)
        for two in range(one):
            point = point_of(joints.torsos, torso, two)
            apart = 0.0
            for axis in range(3):
                apart += (first[axis] - point[axis]) ** 2
            apart = math.sqrt(apart)
            x = ray[one, 0] - ray[two, 0]
            y = ray[one, 1] - ray[two, 1]
            pairs[pair, 0] = apart
            pairs[pair, 1] = side * apart + math.sqrt((x * x + y * y) * dot(point, point))
            pair += 1


@inlined
def _inverse_scales(
    joints: TorsoJoints, pairs: np.ndarray, seen: np.ndarray, roll: int
) -> tuple[float, float]:
    """The range of the inverse scale that all `pairs` of joints leave, for a torso whose
    joints lie at `seen` `(n, 3)` before the roll; empty where the first is not below
    the second."""
    cosine = math.cos((roll + 0.5) * WIDTH)
    sine = math.sin((roll + 0.5) * WIDTH)
    chord = 2 * math.sin(WIDTH / 4)  # of half a cell
    least = 0.0
    most = 1.0
    keypoints = joints.keypoints
    bias = joints.bias
    ray = joints.ray
    pair = -1
    for one in range(len(seen)):
        for two in range(one):
            pair += 1
            x = seen[one, 0] - seen[two, 0]
            y = seen[one, 1] - seen[two, 1]
            u = keypoints[one, 0] - keypoints[two, 0]
            v = keypoints[one, 1] - keypoints[two, 1]
            slack = chord * (math.sqrt(x * x + y * y) + 2 * pairs[pair, 0]) + SLACK
            slack += 2 * chord * pairs[pair, 1]
            far = joints.reach[one] + joints.reach[two] + slack
            across = cosine * x - sine * y + bias[one, 0] - bias[two, 0]
            down = sine * x + cosine * y + bias[one, 1] - bias[two, 1]
            across -= ray[one, 0] * seen[one, 2] - ray[two, 0] * seen[two, 2]
            down -= ray[one, 1] * seen[one, 2] - ray[two, 1] * seen[two, 2]
            # |image - (u, v) · inverse| ≤ far: a quadratic inequality in the inverse
            # scale.
            product = u * across + v * down
            square = u * u + v * v
            rest = across * across + down * down - far * far
            discriminant = product * product - square * rest
            if discriminant < 0 or (square == 0 and rest > 0):
                return 1.0, 0.0
            if square > 0:
                root = math.sqrt(discriminant)
                least = max(least, (product - root) / square)
                most = min(most, (product + root) / square)
                if least >= most:
                    return 1.0, 0.0
    return least, most


@inlined
def turned(
    cos_a: float, sin_a: float, cos_b: float, sin_b: float, cos_c: float, sin_c: float
) -> Axes:
    """The rows of Rz(a) Ry(b) Rz(c)."""
    return (
        (
            cos_a * cos_b * cos_c - sin_a * sin_c,
            -cos_a * cos_b * sin_c - sin_a * cos_c,
            cos_a * sin_b,
        ),
        (
            sin_a * cos_b * cos_c + cos_a * sin_c,
            -sin_a * cos_b * sin_c + cos_a * cos_c,
            sin_a * sin_b,
        ),
        (-sin_b * cos_c, sin_b * sin_c, cos_b),
    )


@inlined
def rotation_of(angles: Vector) -> Axes:
    """The rows of the rotation by roll, tilt and yaw, radians."""
    # Unpacked one by one: arguments that are tuples come out different in the last bit.
    sin_a, cos_a = circle(angles[0] / (2 * math.pi))
    sin_b, cos_b = circle(angles[1] / (2 * math.pi))
    sin_c, cos_c = circle(angles[2] / (2 * math.pi))
    return turned(cos_a, sin_a, cos_b, sin_b, cos_c, sin_c)


@compiled
def turn_rows(roots: np.ndarray, rotations: np.ndarray) -> None:
    """Writes the rotations `(n, 3, 3)` of `roots` `(n,)` `ROOTS`."""
    for row in range(len(roots)):
        angles = roots[row].angles
        turn = rotation_of((angles[0], angles[1], angles[2]))
        for axis in range(3):
            for column in range(3):
                rotations[row, axis, column] = turn[axis][column]


@inlined
def point_of(points: np.ndarray, torso: int, joint: int) -> Vector:
    """One of `points` `(J, n, 3)`, read once."""
    return points[torso, joint, 0], points[torso, joint, 1], points[torso, joint, 2]


@inlined
def image(turn: Axes, point: Vector, ray0: float, ray1: float) -> Plane:
    """Where a point falls along a ray, before any translation."""
    depth = dot(turn[2], point)
    return dot(turn[0], point) - ray0 * depth, dot(turn[1], point) - ray1 * depth


@inlined
def explains(joints: TorsoJoints, root: ProposedRoot, first: int) -> bool:
    """Whether the joints from the `first` on lie within reach."""
    keypoints = joints.keypoints
    bias = joints.bias
    reach = joints.reach
    ray = joints.ray
    for joint in range(first, reach.size):
        point = point_of(joints.torsos, root.torso, joint)
        x, y = image(root.turn, point, ray[joint, 0], ray[joint, 1])
        off0 = x + root.plane[0] + bias[joint, 0] - keypoints[joint, 0] * root.inverse
        off1 = y + root.plane[1] + bias[joint, 1] - keypoints[joint, 1] * root.inverse
        if off0 * off0 + off1 * off1 > reach[joint] * reach[joint]:
            return False
    return True


@inlined
def write_root(row: Record, root: ProposedRoot, angles: Vector, number: int) -> None:
    """Fills a row of `ROOTS`."""
    row.torso = root.torso
    row.angles[0], row.angles[1], row.angles[2] = angles
    row.inverse = root.inverse
    row.plane[0], row.plane[1] = root.plane
    row.number = number


@compiled
def propose_by_discs(
    state: np.ndarray, number: int, joints: TorsoJoints, cells: np.ndarray, roots: np.ndarray
) -> tuple[int, int]:
    """Makes proposals in `ROOT_CELLS`, up to a `number` of them or until there is no
    room for `roots`, `ROOTS`. Returns how many roots were accepted, and how many
    proposals were made."""
    keypoints = joints.keypoints
    reach = joints.reach
    bias = joints.bias
    ray = joints.ray
    stream = load(state)
    accepted = 0
    exponent = 1 / joints.power
    for proposal in range(number):
        at, stream = uniform(stream)
        at *= cells.size
        column = int(at)
        own = cells[column]
        cell = cells[own.partner + (column - own.partner) * int(at - column < own.share)]
        code = cell.code
        roll = code % (2 * TILTS)
        code = code // (2 * TILTS)
        tilt = code % TILTS
        code = code // TILTS
        yaw = code % (2 * TILTS)
        torso = code // (2 * TILTS)
        part, stream = uniform(stream)
        alpha = (roll + part) / (2 * TILTS)
        part, stream = uniform(stream)
        cos_b = (1 - part) * EDGES[tilt] + part * EDGES[tilt + 1]
        part, stream = uniform(stream)
        gamma = (yaw + part) / (2 * TILTS)
        sin_b = math.sqrt(max(0.0, 1 - cos_b * cos_b))
        sin_a, cos_a = circle(alpha)
        sin_c, cos_c = circle(gamma)
        turn = turned(cos_a, sin_a, cos_b, sin_b, cos_c, sin_c)
        part, stream = uniform(stream)
        inverse = (cell.low + cell.span * (1 - part)) ** exponent
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        radius = reach[0] * math.sqrt(radius)
        down, across = circle(angle)
        x, y = image(turn, point_of(joints.torsos, torso, 0), ray[0, 0], ray[0, 1])
        plane = (
            keypoints[0, 0] * inverse - bias[0, 0] + radius * across - x,
            keypoints[0, 1] * inverse - bias[0, 1] + radius * down - y,
        )
        root = ProposedRoot(torso, turn, inverse, plane)
        if inverse > 0 and explains(joints, root, 1):
            angles = 2 * math.pi * alpha, math.acos(cos_b), 2 * math.pi * gamma
            write_root(roots[accepted], root, angles, proposal)
            accepted += 1
            if accepted == roots.size:
                store(state, stream)
                return accepted, proposal + 1
    store(state, stream)
    return accepted, number
