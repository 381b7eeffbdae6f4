"""Attempts at a root where the torso's joints err by Gaussians: a torso and a rotation, and then
the scale and the translation that fit them. Compiled.

Where joints fall is linear in the inverse scale v and in the translation over the scale p. So under
a torso and a rotation the likelihood is a Gaussian in (v, p) times exp(-χ²/2), where χ² is what
least squares leave unexplained, and its widths are the same under all of them. An attempt draws a
torso and a cell of rotations by a bound on its share, a rotation in it, v and p from the Gaussian,
and passes with what the bound was too large by, if the joints lie within their reach. What passes
is an exact draw (docs/model.md § 9).

Where joints are known well, bounds are far too large, and one attempt in 10^5 passes. So cells may
also be drawn by a guess at their share, which is near the truth; then every attempt counts as much
as the guess was too small by.

Bounds: χ is a distance from a subspace, so it changes by no more than the joints move; that is d at
most in a cell. The density of v has a factor v^m, which lies below its tangent at a `star`, an
exponential, which moves the Gaussian of v and leaves its width."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.roots import (
    RootTable,
    TorsoProblem,
    cosines_sines,
    explains,
    image,
    turned,
    write_root,
)
from poseterior.inference.exact.loops.series import circle, sine
from poseterior.inference.exact.loops.tables import ALIAS

TILTS = 6
"""Cells of the tilt that are looked at first, from 0 to π; twice as many of roll and of yaw."""
LEVELS = 4
"""How often cells are cut into eight."""
FEWER = 3
"""The same where shares are guessed: a third less to set up."""
GUESS = 0.25
"""The part of what a cell's bounds allow for that guesses do: what a cell has of exp(-χ²/2) is a
little more than it has in its middle. With this part attempts' weights scatter least, or nearly,
whether joints are known well or not."""
WORTH = 0.999
"""Share of the mass whose cells are cut again."""
MOST_CUT = 15_000
"""Most cells that are cut again, those with the greatest mass, which bounds memory."""
SLACK = 1e-9
"""For rounding, of the bounds."""


class FitCells(NamedTuple):
    """Cells of rotations in which a torso may fit.

    Attributes
    ----------
    torso : `(m,)` the torso's number
    corner : `(m, 3)` the least roll, tilt and yaw
    width : `(m, 3)` of the cell
    least : `(m,)` bound on χ², from below, or a guess at it
    top : `(m,)` bound on the inverse scale that fits best, from above, or a guess
    star : `(m,)` where the tangent of v^m touches
    alias : `(m,)` table of the masses
    mass : of all of them
    """

    torso: np.ndarray
    corner: np.ndarray
    width: np.ndarray
    least: np.ndarray
    top: np.ndarray
    star: np.ndarray
    alias: np.ndarray
    mass: float


class Balance(NamedTuple):
    """What a problem's keypoints and precisions say before any rotation: the `total` precision,
    the keypoints `(n, 2)` around their `middle` `(2,)`, the `lever`, by which an inverse scale is
    known, the `torsos` `(J, n, 3)` around their middles, the middles `(J, 1, 3)` themselves, the
    mean `bias` `(2,)` with the biases `(n, 2)` around it, and the mean `ray` `(2,)` with what the
    rays have beside it, `rays` `(n, 2)`. Middles are weighed by the precisions."""

    total: float
    middle: np.ndarray
    keypoints: np.ndarray
    lever: float
    torsos: np.ndarray
    middles: np.ndarray
    bias: np.ndarray
    biases: np.ndarray
    ray: np.ndarray
    rays: np.ndarray


def balance(problem: TorsoProblem) -> Balance:
    """The balance of a problem in which two joints at least have a precision."""
    weight = problem.precision / problem.precision.sum()
    middle, bias = weight @ problem.keypoints, weight @ problem.bias
    keypoints, ray = problem.keypoints - middle, weight @ problem.ray
    middles = np.einsum("n,jnx->jx", weight, problem.torsos)
    return Balance(
        float(problem.precision.sum()),
        middle,
        keypoints,
        float(problem.precision @ np.sum(keypoints**2, axis=1)),
        np.ascontiguousarray(problem.torsos - middles[:, None]),
        np.ascontiguousarray(middles[:, None]),
        bias,
        np.ascontiguousarray(problem.bias - bias),
        ray,
        np.ascontiguousarray(problem.ray - ray),
    )


def cut_fits(problem: TorsoProblem, known: Balance) -> FitCells:
    """The cells in which a root may explain the torso, with bounds, finest where most of the mass
    is."""
    return _cut(problem, known, LEVELS, 1.0)


def guess_fits(problem: TorsoProblem, known: Balance, levels: int = FEWER) -> FitCells:
    """As `cut_fits`, with guesses in the place of the bounds; no cell is left out by a guess."""
    return _cut(problem, known, levels, GUESS)


def _cut(problem: TorsoProblem, known: Balance, levels: int, part: float) -> FitCells:
    """Cells with guesses by this `part` of what bounds allow for; which are cut, and which are left
    out, bounds say."""
    torso, corner, width = _first_cells(len(problem.torsos))
    kept: list[tuple[np.ndarray, ...]] = []
    for level in range(levels + 1):
        guesses = np.empty((len(torso), 3))
        log_bound, log_mass = np.empty(len(torso)), np.empty(len(torso))
        _bound(problem, known, part, torso, corner, width, guesses, log_bound, log_mass)
        rows = np.isfinite(log_bound)
        torso, corner, width = torso[rows], corner[rows], width[rows]
        guesses, log_bound, log_mass = guesses[rows], log_bound[rows], log_mass[rows]
        cut = _worth_cutting(log_bound) if level < levels else np.zeros(len(torso), bool)
        kept.append(tuple(column[~cut] for column in (torso, corner, width, guesses, log_mass)))
        torso, corner, width = _eighths(torso[cut], corner[cut], width[cut])
    torso, corner, width, guesses, log_mass = (
        np.ascontiguousarray(np.concatenate(column)) for column in zip(*kept, strict=True)
    )
    alias, mass = np.zeros(len(torso), ALIAS), 0.0
    if len(torso):
        highest = log_mass.max()
        mass = float(alias_table(np.exp(log_mass - highest), alias)) * math.exp(highest)
    least, top, star = (np.ascontiguousarray(column) for column in guesses.T)
    return FitCells(torso, corner, width, least, top, star, alias, mass)


def _first_cells(torsos: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    side = math.pi / TILTS
    lattice = np.indices((torsos, 2 * TILTS, TILTS, 2 * TILTS)).reshape(4, -1).T
    corner = np.ascontiguousarray(lattice[:, 1:] * side)
    return np.ascontiguousarray(lattice[:, 0]), corner, np.full(corner.shape, side)


def _worth_cutting(log_mass: np.ndarray) -> np.ndarray:
    """`(m,)`: the cells that hold nearly all of the mass, but not too many."""
    order = np.argsort(-log_mass, kind="stable")
    mass = np.exp(log_mass[order] - log_mass.max(initial=-math.inf))
    held = np.cumsum(mass) - mass
    wanted = order[held < WORTH * mass.sum()][:MOST_CUT]
    chosen = np.zeros(len(log_mass), bool)
    chosen[wanted] = True
    return chosen


def _eighths(
    torso: np.ndarray, corner: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    half = np.repeat(width / 2, 8, axis=0)
    step = np.tile(np.indices((2, 2, 2)).reshape(3, 8).T, (len(torso), 1))
    return np.repeat(torso, 8), np.repeat(corner, 8, axis=0) + step * half, half


@compiled
def _bound(
    problem: TorsoProblem,
    known: Balance,
    part: float,
    torso: np.ndarray,
    corner: np.ndarray,
    width: np.ndarray,
    guesses: np.ndarray,
    log_bound: np.ndarray,
    log_mass: np.ndarray,
) -> None:
    """Writes the log of each cell's mass by bounds, -inf where no root of the cell can explain the
    torso; and guesses at least χ², highest best inverse scale and the tangent's point, as if joints
    moved by a `part` of what they may, all of it for bounds, with the log of the mass by these."""
    joints, power, precision = problem.reach.size, problem.power, problem.precision
    farthest = 0.0
    for joint in range(joints):
        farthest += precision[joint] * problem.reach[joint] ** 2
    lever, exponent = known.lever, power - 1
    constant = math.log(2 * math.pi / known.total) + math.log(2 * math.pi / lever) / 2
    constant -= math.log(len(problem.torsos))
    for cell in range(torso.size):
        roll, tilt, yaw = corner[cell, 0], corner[cell, 1], corner[cell, 2]
        share = width[cell, 0] * width[cell, 2] / (2 * math.pi) ** 2
        share *= (math.cos(tilt) - math.cos(tilt + width[cell, 1])) / 2
        chi, best, moves, _, _ = _fit(
            known,
            precision,
            torso[cell],
            roll + width[cell, 0] / 2,
            tilt + width[cell, 1] / 2,
            yaw + width[cell, 2] / 2,
            width[cell],
        )
        least, top = _moved(chi, best, moves, lever)
        # No joint beyond its reach, so v is no farther from the best than this.
        reached = top + math.sqrt(max(0.0, farthest - least) / lever)
        if least > farthest * (1 + SLACK) or reached <= 0:
            log_bound[cell] = -math.inf
            continue
        whole = math.log(share) + constant
        log_share, _ = _log_share(least, top, exponent, lever)
        log_bound[cell] = whole + log_share
        least, top = _moved(chi, best, part * moves, lever)
        log_share, star = _log_share(least, top, exponent, lever)
        guesses[cell, 0], guesses[cell, 1], guesses[cell, 2] = least, top, star
        log_mass[cell] = whole + log_share


@inlined
def _moved(chi: float, best: float, moves: float, lever: float) -> tuple[float, float]:
    """χ² at least, and the inverse scale that fits best at most, where joints move by so much."""
    least = max(0.0, math.sqrt(chi) - moves - SLACK) ** 2
    return least, best + moves / math.sqrt(lever) + SLACK


@inlined
def _log_share(least: float, top: float, exponent: float, lever: float) -> tuple[float, float]:
    """Log of exp(-χ²/2) × what the tangent of v^exponent has in the mean; and where it touches: v
    at which v^exponent × the Gaussian around `top` is highest."""
    star = (top + math.sqrt(top * top + 4 * exponent / lever)) / 2
    tangent = exponent * (math.log(star) - 1 + top / star)
    return tangent + exponent * exponent / (2 * lever * star * star) - least / 2, star


@compiled
def _fit(
    known: Balance,
    precision: np.ndarray,
    torso: int,
    roll: float,
    tilt: float,
    yaw: float,
    width: np.ndarray,
) -> tuple[float, float, float, float, float]:
    """χ² and the inverse scale that fits best, under one rotation, how far the joints may move,
    weighed, when the rotation moves by half of `width` either way, and where their middle falls
    beside that of parallel lines of sight."""
    cos_a, sin_a, cos_b, sin_b, cos_c, sin_c = cosines_sines(roll, tilt, yaw)
    by_roll, by_tilt = 2 * sine(width[0] / 4), 2 * sine(width[1] / 4)
    by_yaw = 2 * sine(width[2] / 4)
    m0, m1, m2 = known.middles[torso, 0, 0], known.middles[torso, 0, 1], known.middles[torso, 0, 2]
    middle = cos_b * m2 - sin_b * (cos_c * m0 - sin_c * m1)
    side = math.sqrt(known.ray[0] ** 2 + known.ray[1] ** 2)
    square, product, moves, mean0, mean1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for joint in range(precision.size):
        weight = precision[joint]
        if weight > 0:
            x, y = known.torsos[torso, joint, 0], known.torsos[torso, joint, 1]
            z = known.torsos[torso, joint, 2]
            turned, along = cos_c * x - sin_c * y, sin_c * x + cos_c * y
            across, depth = cos_b * turned + sin_b * z, cos_b * z - sin_b * turned
            # Of the rays' mean, the middle's depth moves all joints alike.
            ray0, ray1 = known.rays[joint, 0], known.rays[joint, 1]
            aside0 = known.ray[0] * depth + ray0 * (depth + middle)
            aside1 = known.ray[1] * depth + ray1 * (depth + middle)
            image0 = cos_a * across - sin_a * along + known.biases[joint, 0] - aside0
            image1 = sin_a * across + cos_a * along + known.biases[joint, 1] - aside1
            square += weight * (image0 * image0 + image1 * image1)
            product += weight * (
                known.keypoints[joint, 0] * image0 + known.keypoints[joint, 1] * image1
            )
            mean0, mean1 = mean0 + weight * aside0, mean1 + weight * aside1
            flat, sheer = math.sqrt(x * x + y * y), math.sqrt(turned * turned + z * z)
            step = by_roll * math.sqrt(across * across + along * along)
            step += (1 + side) * (by_tilt * sheer + by_yaw * flat)
            far = math.sqrt((x + m0) ** 2 + (y + m1) ** 2 + (z + m2) ** 2)
            step += math.sqrt(ray0 * ray0 + ray1 * ray1) * (by_tilt + by_yaw) * far
            moves += weight * step * step
    best, total = product / known.lever, known.total
    square -= (mean0 * mean0 + mean1 * mean1) / total
    return (
        max(0.0, square - product * best),
        best,
        math.sqrt(moves),
        mean0 / total + known.ray[0] * middle,
        mean1 / total + known.ray[1] * middle,
    )


@compiled
def attempt_fits(
    state: np.ndarray,
    attempts: int,
    problem: TorsoProblem,
    known: Balance,
    cells: FitCells,
    bounded: bool,
    table: RootTable,
) -> tuple[int, int]:
    """Makes attempts, up to a number of them or until the table is full. Returns how many roots
    were found, and how many attempts were made. In cells that are not `bounded` but guessed at,
    roots have weights."""
    stream, found, still = load(state), 0, np.zeros(3)
    exponent, lever, total = problem.power - 1, known.lever, known.total
    precision = problem.precision
    for attempt in range(attempts):
        at, stream = uniform(stream)
        at *= cells.torso.size
        column = int(at)
        own = cells.alias[column]
        entry = own.partner + (column - own.partner) * int(at - column < own.share)
        torso, star = cells.torso[entry], cells.star[entry]
        part, stream = uniform(stream)
        roll = cells.corner[entry, 0] + part * cells.width[entry, 0]
        part, stream = uniform(stream)
        low = cells.corner[entry, 1]
        cos_b = (1 - part) * math.cos(low) + part * math.cos(low + cells.width[entry, 1])
        tilt = math.acos(min(1.0, max(-1.0, cos_b)))
        part, stream = uniform(stream)
        yaw = cells.corner[entry, 2] + part * cells.width[entry, 2]
        chi, best, _, aside0, aside1 = _fit(known, precision, torso, roll, tilt, yaw, still)
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        _, cosine = circle(angle)
        normal = math.sqrt(-2 * math.log(1 - radius)) * cosine
        inverse = best + exponent / (lever * star) + normal / math.sqrt(lever)
        part, stream = uniform(stream)
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        if inverse <= 0 or inverse > 1:
            continue
        log_ratio = (cells.least[entry] - chi) / 2
        log_ratio += exponent * (best - cells.top[entry]) / star
        log_ratio += exponent * (math.log(inverse / star) - (inverse - star) / star)
        if bounded:
            if math.log(1 - part) > log_ratio:
                continue
            log_ratio = 0.0
        radius = math.sqrt(-2 * math.log(1 - radius) / total)
        down, across = circle(angle)
        turn = turned(*cosines_sines(roll, tilt, yaw))
        x, y = image(turn, known.middles, 0.0, 0.0, torso, 0)
        x, y = x - aside0 + known.bias[0], y - aside1 + known.bias[1]
        t0 = known.middle[0] * inverse - x + radius * across
        t1 = known.middle[1] * inverse - y + radius * down
        if explains(problem, torso, turn, inverse, t0, t1, 0):
            write_root(table, found, torso, roll, tilt, yaw, inverse, t0, t1, attempt)
            table.log_weight[found] = log_ratio
            found += 1
            if found == table.torso.size:
                store(state, stream)
                return found, attempt + 1
    store(state, stream)
    return found, attempts
