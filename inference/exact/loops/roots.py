"""Attempts at a root: a torso, a rotation, a scale and a translation that bring the torso's seen
joints within reach of their detections. Compiled.

Every joint is projected along the line of sight to its own detection (`ray`), where perspective is
known to be one: what it misses its detection by, as large as at its own depth, is then as linear in
the scale and the translation as under weak perspective (docs/model.md § 9).

Rotations are cut into cells of three angles, R = Rz(roll) Ry(tilt) Rz(yaw): uniform on SO(3) is
uniform in roll, cos tilt and yaw. Under every torso and cell, each pair of joints bounds the scale:
their images are farther apart than detected by no more than both reaches, and by what a turn inside
the cell can add. A cell that no scale is left in is dropped. Nothing is estimated.

An attempt draws a cell by its prior mass times that of its scales, a rotation in it, a scale, and
puts the first joint uniformly into its disc. So every attempt has the same weight (`docs/model.md`,
§ 9), and what passes the other discs is an exact draw."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.series import circle
from poseterior.inference.exact.loops.tables import ROOT_CELLS

TILTS = 12
"""Cells of the tilt, from 0 to π; twice as many of roll and of yaw."""
WIDTH = math.pi / TILTS
EDGES = np.cos(np.arange(TILTS + 1) * WIDTH)
"""Cosines of the tilts between cells."""
ROOM = 1 << 17
"""Cells that there is room for at first: enough for most torsos."""
SLACK = 1e-9
"""Body units, for rounding."""
Turn = tuple[float, float, float, float, float, float, float, float, float]
"""The rows of a rotation."""


class TorsoProblem(NamedTuple):
    """The torso's seen joints in front of a camera.

    Attributes
    ----------
    torsos : `(J, n, 3)` the joints in body axes, body units
    keypoints : `(n, 2)` where they were detected, in units of the lowest scale: then the inverse
        scale lies between 0 and 1
    bias : `(n, 2)` of the keypoints, body units: how far beside their joints they lie in the mean
    reach : `(n,)` how far from there they may fall, body units
    precision : `(n,)` one over the variance of joints whose errors are Gaussian within the
        reach, of which `loops.fits` makes use; 0 for others
    ray : `(n, 2)` of the joints' lines of sight, how far they run to the side for one in depth; 0
        where all are parallel
    power : of the scales' density: that of the inverse scale v is v^(power - 1)
    """

    torsos: np.ndarray
    keypoints: np.ndarray
    bias: np.ndarray
    reach: np.ndarray
    precision: np.ndarray
    ray: np.ndarray
    power: float


class RootTable(NamedTuple):
    """Where roots are written to: `torso` `(most,)`, `angles` `(most, 3)` roll, tilt and yaw,
    `inverse` `(most,)` of the scale, `plane` `(most, 2)` the translation over the scale, `attempt`
    `(most,)` the number of the attempt."""

    torso: np.ndarray
    angles: np.ndarray
    inverse: np.ndarray
    plane: np.ndarray
    attempt: np.ndarray
    log_weight: np.ndarray


def root_table(most: int) -> RootTable:
    """A table with room for so many roots."""
    return RootTable(
        np.zeros(most, np.int64),
        np.zeros((most, 3)),
        np.zeros(most),
        np.zeros((most, 2)),
        np.zeros(most, np.int64),
        np.zeros(most),
    )


def cut_roots(problem: TorsoProblem) -> tuple[np.ndarray, float]:
    """The `ROOT_CELLS` in which a root may explain the torso, and the mass of all, which has the
    area of the first disc in it."""
    code, low, high = _kept_cells(problem, ROOM)
    tilt, cells = code // (2 * TILTS) % TILTS, np.zeros(len(code), ROOT_CELLS)
    cells["code"], cells["low"] = code, low**problem.power
    cells["span"] = high**problem.power - cells["low"]
    share = (EDGES[tilt] - EDGES[tilt + 1]) / 2 / (2 * TILTS) ** 2 / len(problem.torsos)
    weight, area = share * cells["span"] / problem.power, math.pi * float(problem.reach[0]) ** 2
    return cells, area * float(alias_table(weight, cells)) if len(code) else 0.0


def _kept_cells(problem: TorsoProblem, room: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Codes, and least and greatest inverse scales, of the cells that are left; found anew where
    there are more of them than there is room for."""
    code, low, high = np.empty(room, np.int64), np.empty(room), np.empty(room)
    number = _find_cells(problem, code, low, high)
    if number > room:
        return _kept_cells(problem, number)
    return code[:number], low[:number], high[:number]


@compiled
def _find_cells(problem: TorsoProblem, code: np.ndarray, low: np.ndarray, high: np.ndarray) -> int:
    """Writes the cells that are left, as far as there is room; returns how many they are."""
    torsos, joints, found = problem.torsos, problem.reach.size, 0
    across, along, depth = np.empty(joints), np.empty(joints), np.empty(joints)
    turn = 2 * math.sin(WIDTH / 4)  # the chord of half a cell
    for torso in range(len(torsos)):
        for yaw in range(2 * TILTS):
            cos_yaw, sin_yaw = math.cos((yaw + 0.5) * WIDTH), math.sin((yaw + 0.5) * WIDTH)
            for tilt in range(TILTS):
                cosine, sine = math.cos((tilt + 0.5) * WIDTH), math.sin((tilt + 0.5) * WIDTH)
                for joint in range(joints):
                    x, y = torsos[torso, joint, 0], torsos[torso, joint, 1]
                    turned, z = cos_yaw * x - sin_yaw * y, torsos[torso, joint, 2]
                    across[joint] = cosine * turned + sine * z
                    along[joint] = sin_yaw * x + cos_yaw * y
                    depth[joint] = cosine * z - sine * turned
                for roll in range(2 * TILTS):
                    least, most = _inverse_scales(problem, torso, across, along, depth, roll, turn)
                    if least < most:
                        if found < code.size:
                            cell = (yaw * TILTS + tilt) * 2 * TILTS + roll
                            code[found] = torso * TILTS * (2 * TILTS) ** 2 + cell
                            low[found], high[found] = least, most
                        found += 1
    return found


@compiled
def _inverse_scales(
    problem: TorsoProblem,
    torso: int,
    across: np.ndarray,
    along: np.ndarray,
    depth: np.ndarray,
    roll: int,
    turn: float,
) -> tuple[float, float]:
    """The range of the inverse scale that all pairs of joints leave, for a torso whose joints lie
    at `across`, `along`, `depth` before the roll; empty where the first is not below the second."""
    cosine, sine = math.cos((roll + 0.5) * WIDTH), math.sin((roll + 0.5) * WIDTH)
    least, most, torsos, keypoints = 0.0, 1.0, problem.torsos, problem.keypoints
    bias, ray = problem.bias, problem.ray
    for one in range(across.size):
        for two in range(one):
            x, y = across[one] - across[two], along[one] - along[two]
            u, v = keypoints[one, 0] - keypoints[two, 0], keypoints[one, 1] - keypoints[two, 1]
            length = 0.0
            for axis in range(3):
                length += (torsos[torso, one, axis] - torsos[torso, two, axis]) ** 2
            slack = turn * (math.sqrt(x * x + y * y) + 2 * math.sqrt(length)) + SLACK
            slack += 2 * turn * _ray_slack(problem, torso, one, two, math.sqrt(length))
            far = problem.reach[one] + problem.reach[two] + slack
            across_image = cosine * x - sine * y + bias[one, 0] - bias[two, 0]
            down_image = sine * x + cosine * y + bias[one, 1] - bias[two, 1]
            across_image -= ray[one, 0] * depth[one] - ray[two, 0] * depth[two]
            down_image -= ray[one, 1] * depth[one] - ray[two, 1] * depth[two]
            image = across_image * across_image + down_image * down_image
            dot = u * across_image + v * down_image
            square = u * u + v * v
            rest = image - far * far
            root = dot * dot - square * rest
            if root < 0 or (square == 0 and rest > 0):
                return 1.0, 0.0
            if square > 0:
                root = math.sqrt(root)
                least, most = max(least, (dot - root) / square), min(most, (dot + root) / square)
                if least >= most:
                    return 1.0, 0.0
    return least, most


@inlined
def _ray_slack(problem: TorsoProblem, torso: int, one: int, two: int, apart: float) -> float:
    """How far, at most, the images of two joints that lie `apart` move against each other because
    their lines of sight run to the side, if their depths change by their distance from the pelvis
    and from each other."""
    ray, points = problem.ray, problem.torsos
    x, y = ray[one, 0] - ray[two, 0], ray[one, 1] - ray[two, 1]
    far = points[torso, two, 0] ** 2 + points[torso, two, 1] ** 2 + points[torso, two, 2] ** 2
    side = math.sqrt(ray[one, 0] ** 2 + ray[one, 1] ** 2)
    return side * apart + math.sqrt((x * x + y * y) * far)


@inlined
def turned(
    cos_a: float, sin_a: float, cos_b: float, sin_b: float, cos_c: float, sin_c: float
) -> Turn:
    """The rows of Rz(a) Ry(b) Rz(c)."""
    return (
        cos_a * cos_b * cos_c - sin_a * sin_c,
        -cos_a * cos_b * sin_c - sin_a * cos_c,
        cos_a * sin_b,
        sin_a * cos_b * cos_c + cos_a * sin_c,
        -sin_a * cos_b * sin_c + cos_a * cos_c,
        sin_a * sin_b,
        -sin_b * cos_c,
        sin_b * sin_c,
        cos_b,
    )


@inlined
def cosines_sines(
    roll: float, tilt: float, yaw: float
) -> tuple[float, float, float, float, float, float]:
    """Cosine and sine of each of the angles, as `turned` takes them."""
    sin_a, cos_a = circle(roll / (2 * math.pi))
    sin_b, cos_b = circle(tilt / (2 * math.pi))
    sin_c, cos_c = circle(yaw / (2 * math.pi))
    return cos_a, sin_a, cos_b, sin_b, cos_c, sin_c


@compiled
def turn_rows(angles: np.ndarray, rotations: np.ndarray) -> None:
    """Writes the rotations `(n, 3, 3)` of roots with `angles` `(n, 3)` roll, tilt and yaw."""
    for row in range(len(angles)):
        turn = turned(*cosines_sines(angles[row, 0], angles[row, 1], angles[row, 2]))
        for place in range(9):
            rotations[row, place // 3, place % 3] = turn[place]


@inlined
def image(
    turn: Turn, points: np.ndarray, ray0: float, ray1: float, torso: int, joint: int
) -> tuple[float, float]:
    """Where a point of `points` `(J, n, 3)` falls along a ray, before any translation."""
    p0, p1, p2 = points[torso, joint, 0], points[torso, joint, 1], points[torso, joint, 2]
    depth = turn[6] * p0 + turn[7] * p1 + turn[8] * p2
    return (
        turn[0] * p0 + turn[1] * p1 + turn[2] * p2 - ray0 * depth,
        turn[3] * p0 + turn[4] * p1 + turn[5] * p2 - ray1 * depth,
    )


@inlined
def explains(
    problem: TorsoProblem,
    torso: int,
    turn: Turn,
    inverse: float,
    t0: float,
    t1: float,
    first: int,
) -> bool:
    """Whether the joints from the `first` on lie within reach."""
    torsos, keypoints, bias, reach = (
        problem.torsos,
        problem.keypoints,
        problem.bias,
        problem.reach,
    )
    ray = problem.ray
    for joint in range(first, reach.size):
        x, y = image(turn, torsos, ray[joint, 0], ray[joint, 1], torso, joint)
        off0 = x + t0 + bias[joint, 0] - keypoints[joint, 0] * inverse
        off1 = y + t1 + bias[joint, 1] - keypoints[joint, 1] * inverse
        if off0 * off0 + off1 * off1 > reach[joint] * reach[joint]:
            return False
    return True


@inlined
def write_root(
    table: RootTable,
    row: int,
    torso: int,
    roll: float,
    tilt: float,
    yaw: float,
    inverse: float,
    t0: float,
    t1: float,
    attempt: int,
) -> None:
    """Writes a root into a row of the table."""
    table.torso[row], table.inverse[row], table.attempt[row] = torso, inverse, attempt
    table.angles[row, 0], table.angles[row, 1], table.angles[row, 2] = roll, tilt, yaw
    table.plane[row, 0], table.plane[row, 1] = t0, t1


@compiled
def attempt_roots(
    state: np.ndarray, attempts: int, problem: TorsoProblem, cells: np.ndarray, table: RootTable
) -> tuple[int, int]:
    """Makes attempts in `ROOT_CELLS`, up to a number of them or until the table is full. Returns
    how many roots were found, and how many attempts were made."""
    torsos, keypoints, reach = problem.torsos, problem.keypoints, problem.reach
    bias, ray = problem.bias, problem.ray
    stream, found, root = load(state), 0, 1 / problem.power
    for attempt in range(attempts):
        at, stream = uniform(stream)
        at *= cells.size
        column = int(at)
        own = cells[column]
        cell = cells[own.partner + (column - own.partner) * int(at - column < own.share)]
        code = cell.code
        roll, code = code % (2 * TILTS), code // (2 * TILTS)
        tilt, code = code % TILTS, code // TILTS
        yaw, torso = code % (2 * TILTS), code // (2 * TILTS)
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
        inverse = (cell.low + cell.span * (1 - part)) ** root
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        radius = reach[0] * math.sqrt(radius)
        down, across = circle(angle)
        x, y = image(turn, torsos, ray[0, 0], ray[0, 1], torso, 0)
        t0 = keypoints[0, 0] * inverse - bias[0, 0] + radius * across - x
        t1 = keypoints[0, 1] * inverse - bias[0, 1] + radius * down - y
        if inverse > 0 and explains(problem, torso, turn, inverse, t0, t1, 1):
            alpha, beta, gamma = 2 * math.pi * alpha, math.acos(cos_b), 2 * math.pi * gamma
            write_root(table, found, torso, alpha, beta, gamma, inverse, t0, t1, attempt)
            found += 1
            if found == table.torso.size:
                store(state, stream)
                return found, attempt + 1
    store(state, stream)
    return found, attempts
