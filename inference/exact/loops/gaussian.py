"""Proposals of a root where the torso's joints err by Gaussians: a torso and a
rotation, and then the scale and the translation from the Gaussian that is left of the
likelihood. Compiled.

Where joints fall is linear in the inverse scale v and in the translation over the scale
p. So under a torso and a rotation the likelihood is a Gaussian in (v, p) times
exp(-χ²/2), where χ² is what least squares leave unexplained, and its widths are the
same under all of them. A proposal draws a torso and a cell of rotations by a bound on
its share, a rotation in it, v and p from the Gaussian, and passes with the probability
that makes up for the bound, if the joints lie within their reach. What passes is an
exact draw (docs/model.md § 9).

Where joints are known well, bounds are far too large, and one proposal in 10^5 passes.
So cells may also be drawn by an approximation of their share; then every proposal has
the weight by which the approximation was too small.

Bounds: χ is a distance from a subspace, so it changes by no more than the joints move;
that is d at most in a cell. The density of v has a factor v^m, which lies below its
tangent at a `star`, an exponential, which moves the Gaussian of v and leaves its
width."""

import math
from typing import NamedTuple

import numpy as np

from poseterior.inference.exact.loops.bins import alias_table
from poseterior.inference.exact.loops.numbers import compiled, inlined, load, store, uniform
from poseterior.inference.exact.loops.rectangles import SLACK
from poseterior.inference.exact.loops.roots import (
    ProposedRoot,
    TorsoJoints,
    explains,
    image,
    point_of,
    rotation_of,
    write_root,
)
from poseterior.inference.exact.loops.series import circle, sine
from poseterior.inference.exact.loops.tables import ROTATION_CELLS
from poseterior.inference.exact.loops.vectors import Plane, Vector

FIRST_TILTS = 6
"""Cells of the tilt before any is cut, from 0 to π; twice as many of roll and of
yaw."""
LEVELS = 4
"""How often cells are cut into eight."""
FEWER_LEVELS = 3
"""The same where shares are approximate: a third less to set up."""
APPROXIMATE = 0.25
"""The part of what a cell's bounds allow for that approximations do: what a cell has of
exp(-χ²/2) is a little more than it has in its middle. With this part the weights of
proposals scatter least, or nearly, whether joints are known well or not."""
MASS_TO_CUT = 0.999
"""Share of the mass whose cells are cut again."""
MOST_CUT = 15_000
"""Most cells that are cut again, those with the greatest mass, which bounds memory."""


class CentredJoints(NamedTuple):
    """The torso's joints and keypoints around their means, which the precisions weight:
    what can be known before any rotation.

    Attributes
    ----------
    precision : `(n,)` of the joints
    total : of them
    middle, keypoints : `(2,)` and `(n, 2)` around it
    lever : the precision by which the keypoints tell an inverse scale
    torsos, middles : `(J, n, 3)` around `(J, 1, 3)`
    bias, biases : `(2,)` and `(n, 2)` around it
    ray, rays : `(2,)` and `(n, 2)` around it
    slant : `(n,)` lengths of `rays`
    flat, far : `(J, n)` how far joints lie from the yaw's axis, and from the pelvis
    """

    precision: np.ndarray
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
    slant: np.ndarray
    flat: np.ndarray
    far: np.ndarray


class GaussianTorso(NamedTuple):
    """The torso's joints as they are, and around their means."""

    joints: TorsoJoints
    centred: CentredJoints


class RotationCells(NamedTuple):
    """`ROTATION_CELLS` `(m,)` in which a torso may fit, and the mass of all of them."""

    table: np.ndarray
    mass: float


def centre_joints(joints: TorsoJoints) -> CentredJoints:
    """Centres joints of which two at least have a precision."""
    weight = joints.precision / joints.precision.sum()
    middle = weight @ joints.keypoints
    bias = weight @ joints.bias
    ray = weight @ joints.ray
    keypoints = joints.keypoints - middle
    middles = np.einsum("n,jnx->jx", weight, joints.torsos)
    torsos = np.ascontiguousarray(joints.torsos - middles[:, None])
    rays = np.ascontiguousarray(joints.ray - ray)
    return CentredJoints(
        precision=joints.precision,
        total=float(joints.precision.sum()),
        middle=middle,
        keypoints=keypoints,
        lever=float(joints.precision @ np.sum(keypoints**2, axis=1)),
        torsos=torsos,
        middles=np.ascontiguousarray(middles[:, None]),
        bias=bias,
        biases=np.ascontiguousarray(joints.bias - bias),
        ray=ray,
        rays=rays,
        slant=np.linalg.norm(rays, axis=1),
        flat=np.linalg.norm(torsos[..., :2], axis=2),
        far=np.linalg.norm(torsos + middles[:, None], axis=2),
    )


def bounded_cells(torso: GaussianTorso) -> RotationCells:
    """The cells in which a root may explain the torso, with bounds, finest where most
    of the mass is."""
    return _cut(torso, LEVELS, 1.0)


def approximate_cells(torso: GaussianTorso, levels: int = FEWER_LEVELS) -> RotationCells:
    """As `bounded_cells`, with approximations in the place of the bounds; these leave
    out no cell."""
    return _cut(torso, levels, APPROXIMATE)


def _cut(torso: GaussianTorso, levels: int, part: float) -> RotationCells:
    """Cells by this `part` of what bounds allow for; which are cut, and which are left
    out, bounds say."""
    cells = _first_cells(len(torso.joints.torsos))
    done = []
    log_masses = []
    for level in range(levels + 1):
        log_bound = np.empty(len(cells))
        log_mass = np.empty(len(cells))
        _bound(torso.joints, torso.centred, part, cells, log_bound, log_mass)
        rows = np.isfinite(log_bound)
        cells = cells[rows]
        cut = np.zeros(len(cells), bool)
        if level < levels:
            cut = _worth_cutting(log_bound[rows])
        done.append(cells[~cut])
        log_masses.append(log_mass[rows][~cut])
        cells = _eighths(cells[cut])
    table = np.concatenate(done)
    mass = 0.0
    if len(table):
        log_mass = np.concatenate(log_masses)
        highest = log_mass.max()
        mass = float(alias_table(np.exp(log_mass - highest), table)) * math.exp(highest)
    return RotationCells(table, mass)


def _first_cells(torsos: int) -> np.ndarray:
    side = math.pi / FIRST_TILTS
    lattice = np.indices((torsos, 2 * FIRST_TILTS, FIRST_TILTS, 2 * FIRST_TILTS)).reshape(4, -1).T
    cells = np.zeros(len(lattice), ROTATION_CELLS)
    cells["torso"] = lattice[:, 0]
    cells["corner"] = lattice[:, 1:] * side
    cells["width"] = side
    return cells


def _worth_cutting(log_mass: np.ndarray) -> np.ndarray:
    """`(m,)`: the cells that hold nearly all of the mass, but not too many."""
    order = np.argsort(-log_mass, kind="stable")
    mass = np.exp(log_mass[order] - log_mass.max(initial=-math.inf))
    held = np.cumsum(mass) - mass
    wanted = order[held < MASS_TO_CUT * mass.sum()][:MOST_CUT]
    chosen = np.zeros(len(log_mass), bool)
    chosen[wanted] = True
    return chosen


def _eighths(cells: np.ndarray) -> np.ndarray:
    """The cells, each cut into eight."""
    eighths = np.repeat(cells, 8)
    eighths["width"] /= 2
    step = np.tile(np.indices((2, 2, 2)).reshape(3, 8).T, (len(cells), 1))
    eighths["corner"] += step * eighths["width"]
    return eighths


@compiled
def _bound(
    joints: TorsoJoints,
    centred: CentredJoints,
    part: float,
    cells: np.ndarray,
    log_bound: np.ndarray,
    log_mass: np.ndarray,
) -> None:
    """Writes the log of each cell's mass by bounds, -inf where no root of the cell can
    explain the torso; and into `ROTATION_CELLS` least χ², highest best inverse scale
    and the tangent's point, as if joints moved by a `part` of what they may, all of it
    for bounds, with the log of the mass by these."""
    farthest = 0.0
    for joint in range(joints.reach.size):
        farthest += joints.precision[joint] * joints.reach[joint] ** 2
    lever = centred.lever
    exponent = joints.power - 1
    constant = math.log(2 * math.pi / centred.total) + math.log(2 * math.pi / lever) / 2
    constant -= math.log(len(joints.torsos))
    for row in range(cells.size):
        cell = cells[row]
        roll = cell.corner[0]
        tilt = cell.corner[1]
        yaw = cell.corner[2]
        width = cell.width[0], cell.width[1], cell.width[2]
        share = width[0] * width[2] / (2 * math.pi) ** 2
        share *= (math.cos(tilt) - math.cos(tilt + width[1])) / 2
        middle = roll + width[0] / 2, tilt + width[1] / 2, yaw + width[2] / 2
        fit = _fit(centred, cell.torso, middle, width)
        least, top = _moved(fit.chi, fit.best, fit.moves, lever)
        # No joint beyond its reach, so v is no farther from the best than this.
        reached = top + math.sqrt(max(0.0, farthest - least) / lever)
        if least > farthest * (1 + SLACK) or reached <= 0:
            log_bound[row] = -math.inf
            continue
        whole = math.log(share) + constant
        log_share, _ = _log_share(least, top, exponent, lever)
        log_bound[row] = whole + log_share
        least, top = _moved(fit.chi, fit.best, part * fit.moves, lever)
        log_share, star = _log_share(least, top, exponent, lever)
        log_mass[row] = whole + log_share
        cell.least = least
        cell.top = top
        cell.star = star


@inlined
def _moved(chi: float, best: float, moves: float, lever: float) -> tuple[float, float]:
    """χ² at least, and the inverse scale that fits best at most, where joints move by
    so much."""
    least = max(0.0, math.sqrt(chi) - moves - SLACK) ** 2
    return least, best + moves / math.sqrt(lever) + SLACK


@inlined
def _log_share(least: float, top: float, exponent: float, lever: float) -> tuple[float, float]:
    """Log of exp(-χ²/2) × what the tangent of v^exponent has in the mean; and where it
    touches: v at which v^exponent × the Gaussian around `top` is highest."""
    star = (top + math.sqrt(top * top + 4 * exponent / lever)) / 2
    tangent = exponent * (math.log(star) - 1 + top / star)
    return tangent + exponent * exponent / (2 * lever * star * star) - least / 2, star


class Fit(NamedTuple):
    """What least squares come to under one rotation: `chi`, χ², and the `best` inverse
    scale; how far the joints may move, weighted, `moves`; and where their middle falls
    beside that of parallel lines of sight, `aside`."""

    chi: float
    best: float
    moves: float
    aside: Plane


@compiled
def _fit(centred: CentredJoints, torso: int, angles: Vector, width: Vector) -> Fit:
    """The fit under one rotation, which may move by half of `width` either way."""
    sin_a, cos_a = circle(angles[0] / (2 * math.pi))
    sin_b, cos_b = circle(angles[1] / (2 * math.pi))
    sin_c, cos_c = circle(angles[2] / (2 * math.pi))
    by_roll = 2 * sine(width[0] / 4)
    by_tilt = 2 * sine(width[1] / 4)
    by_yaw = 2 * sine(width[2] / 4)
    moving = width[1] > 0
    m0, m1, m2 = point_of(centred.middles, torso, 0)
    middle = cos_b * m2 - sin_b * (cos_c * m0 - sin_c * m1)
    side = math.sqrt(centred.ray[0] ** 2 + centred.ray[1] ** 2)
    square = product = moves = mean0 = mean1 = 0.0
    for joint in range(centred.precision.size):
        weight = centred.precision[joint]
        if weight > 0:
            x, y, z = point_of(centred.torsos, torso, joint)
            turned = cos_c * x - sin_c * y
            along = sin_c * x + cos_c * y
            across = cos_b * turned + sin_b * z
            depth = cos_b * z - sin_b * turned
            # Of the rays' mean, the middle's depth moves all joints alike.
            ray0 = centred.rays[joint, 0]
            ray1 = centred.rays[joint, 1]
            aside0 = centred.ray[0] * depth + ray0 * (depth + middle)
            aside1 = centred.ray[1] * depth + ray1 * (depth + middle)
            image0 = cos_a * across - sin_a * along + centred.biases[joint, 0] - aside0
            image1 = sin_a * across + cos_a * along + centred.biases[joint, 1] - aside1
            square += weight * (image0 * image0 + image1 * image1)
            product += weight * (
                centred.keypoints[joint, 0] * image0 + centred.keypoints[joint, 1] * image1
            )
            mean0 += weight * aside0
            mean1 += weight * aside1
            if moving:
                sheer = math.sqrt(turned * turned + z * z)
                step = by_roll * math.sqrt(across * across + along * along)
                step += (1 + side) * (by_tilt * sheer + by_yaw * centred.flat[torso, joint])
                step += centred.slant[joint] * (by_tilt + by_yaw) * centred.far[torso, joint]
                moves += weight * step * step
    best = product / centred.lever
    total = centred.total
    square -= (mean0 * mean0 + mean1 * mean1) / total
    aside = mean0 / total + centred.ray[0] * middle, mean1 / total + centred.ray[1] * middle
    return Fit(max(0.0, square - product * best), best, math.sqrt(moves), aside)


@compiled
def propose_by_gaussian(
    state: np.ndarray,
    number: int,
    torso: GaussianTorso,
    cells: np.ndarray,
    bounded: bool,
    roots: np.ndarray,
) -> tuple[int, int]:
    """Makes proposals in `ROTATION_CELLS`, up to a `number` of them or until there is
    no room for `roots`, `ROOTS`. Returns how many roots were accepted, and how many
    proposals were made. Where cells are not `bounded` but approximate, roots have
    weights."""
    joints, centred = torso
    stream = load(state)
    accepted = 0
    exponent = joints.power - 1
    lever = centred.lever
    still = 0.0, 0.0, 0.0
    for proposal in range(number):
        at, stream = uniform(stream)
        at *= cells.size
        column = int(at)
        own = cells[column]
        cell = cells[own.partner + (column - own.partner) * int(at - column < own.share)]
        part, stream = uniform(stream)
        roll = cell.corner[0] + part * cell.width[0]
        part, stream = uniform(stream)
        low = cell.corner[1]
        cos_b = (1 - part) * math.cos(low) + part * math.cos(low + cell.width[1])
        tilt = math.acos(min(1.0, max(-1.0, cos_b)))
        part, stream = uniform(stream)
        yaw = cell.corner[2] + part * cell.width[2]
        angles = roll, tilt, yaw
        fit = _fit(centred, cell.torso, angles, still)
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        _, cosine = circle(angle)
        normal = math.sqrt(-2 * math.log(1 - radius)) * cosine
        inverse = fit.best + exponent / (lever * cell.star) + normal / math.sqrt(lever)
        # All random numbers of a proposal before it may end: then any two proposals
        # have the same.
        part, stream = uniform(stream)
        radius, stream = uniform(stream)
        angle, stream = uniform(stream)
        if inverse <= 0 or inverse > 1:
            continue
        log_ratio = (cell.least - fit.chi) / 2
        log_ratio += exponent * (fit.best - cell.top) / cell.star
        log_ratio += exponent * (math.log(inverse / cell.star) - (inverse - cell.star) / cell.star)
        if bounded:
            if math.log(1 - part) > log_ratio:
                continue
            log_ratio = 0.0
        radius = math.sqrt(-2 * math.log(1 - radius) / centred.total)
        down, across = circle(angle)
        turn = rotation_of(angles)
        x, y = image(turn, point_of(centred.middles, cell.torso, 0), 0.0, 0.0)
        x = x - fit.aside[0] + centred.bias[0]
        y = y - fit.aside[1] + centred.bias[1]
        plane = (
            centred.middle[0] * inverse - x + radius * across,
            centred.middle[1] * inverse - y + radius * down,
        )
        root = ProposedRoot(cell.torso, turn, inverse, plane)
        if explains(joints, root, 0):
            row = roots[accepted]
            write_root(row, root, angles, proposal)
            row.log_weight = log_ratio
            accepted += 1
            if accepted == roots.size:
                store(state, stream)
                return accepted, proposal + 1
    store(state, stream)
    return accepted, number
