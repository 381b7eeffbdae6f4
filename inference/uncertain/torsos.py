"""Exact draws of the root given the torso's detected joints alone, and how probable those are.

Every attempt has the same weight, so what passes is an exact, independent draw from the whole
support of the torso's posterior. Attempts end with the last root wanted, so the rate m/n would be
too large; (m - 1)/(n - 1) is unbiased (Haldane 1945).
"""

import functools
import math
import os
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from scipy.spatial.transform import Rotation

from inference.exact.groups import workers
from inference.exact.loops.fits import attempt_fits, balance, cut_fits
from inference.exact.loops.numbers import seeded
from inference.exact.loops.roots import (
    RootTable,
    TorsoProblem,
    attempt_roots,
    cut_roots,
    root_table,
)
from inference.exact.rates import Budget
from probmodel.chunks import in_chunks
from probmodel.failures import BadInput
from probmodel.faults import ORDERS, Faults
from probmodel.likelihood import WithOutliers
from probmodel.model import PoseModel
from probmodel.roots import NEAREST, RootPoint, RootPrior
from probmodel.skeleton import TORSO_INDEX
from probmodel.uncertain import DetectedJoints, UncertainPosterior

BATCH = 1 << 17
"""Most attempts made at a time by one thread: some 20 ms."""
FIRST = 1 << 13
"""Attempts of the first batch; every other one is twice as large, since a few roots, which are all
that most patterns of faults are asked for, are often found by few attempts."""
PATIENCE = 8192
"""Attempts at the torso for each root that is wanted, in search of more: they take a third of the
time that a root's limbs take."""
HOPELESS = 1 << 26
"""Attempts without one success after which a torso is given up."""
THINNING = 101
"""Where the random numbers come from that thin by an error law: a path that no batch has."""


class Posed(NamedTuple):
    """A torso's `problem`, the `law` of its joints' errors, the concentration `upright` of its back
    about the vertical, what leads back to pixels: the `origin` `(2,)` of its keypoints, and the
    scale `lowest`, pixels a body unit, that is their unit; and the prior's `highest` scale."""

    problem: TorsoProblem
    law: WithOutliers
    upright: float
    origin: np.ndarray
    lowest: float
    highest: float


class TorsoDraws(NamedTuple):
    """Draws of the root given the torso.

    Attributes
    ----------
    points
        The roots `(n, ...)`.
    attempts
        How many were made.
    log_evidence
        Log of the integral over roots of prior mass × scale⁻² for every seen joint of the torso ×
        the likelihood of these joints over its peak; -inf where no root was found.
    variance
        Of that log, by the delta method; infinite where no root was found.
    """

    points: RootPoint
    attempts: int
    log_evidence: float
    variance: float


def torso_problem(posterior: UncertainPosterior, faults: Faults) -> Posed:
    """What the torso's joints ask of a root under a pattern of faults.

    The joint with the smallest disc comes first, then the others from far to near: most attempts
    fail early.
    """
    detected = jax.tree.map(np.asarray, _read(posterior.detected, faults))
    torsos = np.asarray(posterior.model.torsos, float)
    rows = [row for row, joint in enumerate(TORSO_INDEX) if np.isfinite(detected.spread[joint])]
    joints = [TORSO_INDEX[row] for row in rows]
    reach = (np.asarray(detected.law.reach) * detected.spread)[joints]
    keypoints = detected.keypoints[joints]
    first = int(np.argmin(reach))
    distance = np.linalg.norm(keypoints - keypoints[first], axis=1)
    distance[first] = np.inf
    order = np.argsort(-distance, kind="stable")
    points = np.ascontiguousarray(torsos[:, rows][:, order])
    origin = keypoints[first]
    law = WithOutliers(posterior.detected.law, detected.law.outlier[joints][order])
    keypoints, reach = keypoints[order] - origin, np.ascontiguousarray(reach[order])
    bias = np.ascontiguousarray(detected.bias[joints][order])
    ray = np.asarray(detected.rays(posterior.model.lens))[joints][order]
    lowest = lowest_scale(points, keypoints, bias, reach, ray)
    # Every seen joint contributes scale⁻², and the translation takes one of them.
    precision = np.zeros(len(rows))
    if law.inlier.deviation is not None:
        precision[~law.outlier] = (
            law.inlier.reach / law.inlier.deviation / reach[~law.outlier]
        ) ** 2
    problem = TorsoProblem(
        points,
        np.ascontiguousarray(keypoints / lowest),
        bias,
        reach,
        precision,
        np.ascontiguousarray(ray, float),
        2.0 * len(rows) - 2,
    )
    highest = math.exp(float(posterior.prior.highest_log_scale))
    return Posed(problem, law, float(posterior.model.upright), origin, lowest, highest)


@jax.jit
def _read(detected: DetectedJoints, faults: Faults) -> DetectedJoints:
    """Compiled, or every operation of it would be by itself."""
    return detected.read(faults)


def lowest_scale(
    torsos: np.ndarray,
    keypoints: np.ndarray,
    bias: np.ndarray,
    reach: np.ndarray,
    ray: np.ndarray,
) -> float:
    """A scale, pixels a body unit, that no root can go below: two joints project to within their
    distance in space of each other, or a little more where their lines of sight run to the side,
    and each is detected within its reach, but for its bias.

    Parameters
    ----------
    torsos
        `(J, n, 3)` body units
    keypoints
        `(n, 2)` pixels
    bias
        `(n, 2)` body units
    reach
        `(n,)` body units
    ray
        `(n, 2)` of the lines of sight, as `TorsoProblem` has them
    """
    apart = np.linalg.norm(keypoints[:, None] - keypoints[None], axis=-1)
    widest = np.linalg.norm(torsos[:, :, None] - torsos[:, None], axis=-1).max(axis=0)
    widest *= np.sqrt(1 + np.sum(ray**2, axis=1))[:, None]
    far = np.linalg.norm(torsos, axis=-1).max(axis=0)
    widest += far * np.linalg.norm(ray[:, None] - ray[None], axis=-1)
    most = widest + np.linalg.norm(bias[:, None] - bias[None], axis=-1)
    most += reach[:, None] + reach[None]
    # A little lower, for rounding; two joints at least lie apart, or no camera is determined.
    return float((apart / most).max() * (1 - 1e-9))


def draw_roots(
    posterior: UncertainPosterior,
    faults: Faults,
    words: list[int],
    number: int,
    budget: Budget,
    *,
    most: int | None = None,
) -> TorsoDraws:
    """`number` roots given the torso's joints, or as many as the budget allows; up to `most` where
    they come easily.

    Parameters
    ----------
    posterior
        Whose detection shows enough of the torso to determine a camera.
    faults
        One pattern, of which those of the torso count.
    words
        Of the key.
    number
        How many roots.
    budget
        Of attempts; "as many as it allows" has an unbiased evidence too.
    most
        So many are drawn, if `number * PATIENCE` attempts are enough for them; else as many as
        these brought, or `number`, whichever is more (default: `number`).
    """
    posed = torso_problem(posterior, faults)
    return draw_posed(posed, proposal_of(posed), words, number, budget, most=most or number)


def draw_posed(
    posed: Posed, proposal: "Proposal", words: list[int], number: int, budget: Budget, *, most: int
) -> TorsoDraws:
    """As `draw_roots`, for a torso whose attempts are prepared already."""
    patience = number * PATIENCE
    parts = [root_table(0)]
    found, made, batch = 0, 0, 0
    while proposal.mass and found < (most if made < patience else number):
        if not found and made >= HOPELESS:
            break
        numbers = list(range(batch, batch + (os.cpu_count() or 1)))
        sizes = [min(FIRST << min(one // 2, 10), BATCH) for one in numbers]
        sizes = [size for size in sizes if budget.spend(size)]
        if not sizes:
            break
        numbers = numbers[: len(sizes)]
        attempt = functools.partial(_batch, posed, proposal, words)
        tables = workers().map(attempt, sizes, [most] * len(sizes), numbers)
        for table, attempts in tables:
            parts.append(table._replace(attempt=table.attempt + made))
            found, made = found + len(table.torso), made + attempts
        batch += len(numbers)
    whole = RootTable(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    early = int(np.searchsorted(whole.attempt, patience))
    if not number or found < number or (number <= early < most and made < patience):
        return _named(posed, proposal.mass, whole, made, enough=False)
    if number <= early < most:  # patience ended first: a fixed number of attempts
        whole = RootTable(*(column[:early] for column in whole))
        return _named(posed, proposal.mass, whole, patience, enough=False)
    whole = RootTable(*(column[: min(max(early, number), most)] for column in whole))
    return _named(posed, proposal.mass, whole, int(whole.attempt[-1]) + 1, enough=True)


class Proposal(NamedTuple):
    """How attempts at a torso's roots are made: their `mass`, which times the rate of success is
    the evidence; a batch of them, by a stream of random numbers into a table: roots found, attempts
    made; whether what they find still has to be thinned by the error law; and the `precision`
    `(n,)` of the Gaussians that they have in them already."""

    mass: float
    attempt: Callable[[np.ndarray, int, RootTable], tuple[int, int]]
    thinned: bool
    precision: np.ndarray


def proposal_of(posed: Posed) -> Proposal:
    """By least squares where joints whose errors a Gaussian bounds determine a scale, by discs
    otherwise."""
    problem = posed.problem
    if len(np.unique(problem.keypoints[problem.precision > 0], axis=0)) > 1:
        known = balance(problem)
        fits = cut_fits(problem, known)
        return Proposal(
            fits.mass,
            lambda state, number, table: attempt_fits(state, number, problem, known, fits, table),
            thinned=not posed.law.inlier.gaussian,
            precision=problem.precision,
        )
    cells = cut_roots(problem)
    return Proposal(
        cells.mass,
        lambda state, number, table: attempt_roots(state, number, problem, cells, table),
        thinned=not posed.law.flat,
        precision=np.zeros_like(problem.precision),
    )


def _batch(
    posed: Posed,
    proposal: Proposal,
    words: list[int],
    attempts: int,
    number: int,
    batch: int,
) -> tuple[RootTable, int]:
    """The roots that one batch of attempts finds, `number` at most, and how many it made."""
    problem, law = posed.problem, posed.law
    table = root_table(min(number, attempts))
    found, attempts = proposal.attempt(seeded(words, batch), attempts, table)
    # Copied, or every few roots would keep the memory of a whole table.
    table = RootTable(*(column[:found].copy() for column in table))
    near = posed.lowest > posed.highest * table.inverse
    if near.any():
        table = RootTable(*(column[~near] for column in table))
        found = len(table.torso)
    if found and (proposal.thinned or posed.upright):
        rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(batch, THINNING)))
        test, rotation = np.log1p(-rng.uniform(size=found)), rotations_of(table)
        test -= posed.upright * (-rotation[:, 1, 1] - 1)
        ratio = 0.0
        if proposal.thinned:
            ratio = in_chunks(
                functools.partial(_log_ratio, law, problem, proposal.precision),
                table.torso,
                rotation,
                table.inverse,
                table.plane,
            )
        table = RootTable(*(column[test <= ratio] for column in table))
    return table, attempts


@jax.jit
def _log_ratio(
    law: WithOutliers,
    problem: TorsoProblem,
    precision: np.ndarray,
    torso: jax.Array,
    rotation: jax.Array,
    inverse: jax.Array,
    plane: jax.Array,
) -> jax.Array:
    """`(n,)`: log likelihood of the torso's joints over its peak, and over that of the Gaussians by
    which they were proposed."""

    def one(
        torso: jax.Array, rotation: jax.Array, inverse: jax.Array, plane: jax.Array
    ) -> jax.Array:
        view = jnp.asarray(problem.torsos)[torso] @ rotation.T
        image = view[:, :2] - view[:, 2:] * jnp.asarray(problem.ray)
        offset = image + plane[None] + jnp.asarray(problem.bias)
        offset -= jnp.asarray(problem.keypoints) * inverse
        square = jnp.sum(offset**2, axis=1)
        proposed = -precision * square / 2
        spread = jnp.asarray(problem.reach) / law.reach
        return jnp.sum(law.log_ratio(square / spread**2) - proposed)

    return jax.vmap(one)(torso, rotation, inverse, plane)


def rotations_of(table: RootTable) -> np.ndarray:
    """`(n, 3, 3)`: the rotations of roots in a table."""
    if not len(table.torso):
        return np.zeros((0, 3, 3))
    return Rotation.from_euler("ZYZ", table.angles).as_matrix()


def _named(posed: Posed, mass: float, table: RootTable, made: int, enough: bool) -> TorsoDraws:
    found, points = len(table.torso), _points(posed, table)
    # Counted to the last root wanted, or to the end of the budget.
    rate = (found - 1) / max(made - 1, 1) if enough else found / max(made, 1)
    if not rate:
        return TorsoDraws(points, made, -math.inf, math.inf)
    log_evidence = log_mass(posed, mass) + math.log(rate)
    return TorsoDraws(points, made, log_evidence, (1 - rate) / found)


def log_mass(posed: Posed, mass: float) -> float:
    """Log of the evidence if every attempt succeeded: a proposal's mass in pixels."""
    if not mass:
        return -math.inf
    peak = 0.0
    if posed.upright:
        from probmodel.rotations import log_upright_peak  # imports NumPyro, which few roots need

        peak = float(log_upright_peak(posed.upright))
    return math.log(mass) - posed.problem.power * math.log(posed.lowest) + peak


def _points(posed: Posed, table: RootTable) -> RootPoint:
    """The roots of a table, in pixels."""
    scale = posed.lowest / table.inverse
    translation = posed.origin + scale[:, None] * table.plane
    return RootPoint(table.torso, rotations_of(table), np.log(scale), translation)


def attempted_roots(posed: Posed, proposal: Proposal, words: list[int], attempts: int) -> RootPoint:
    """The roots `(n, ...)` that a fixed number of attempts finds."""
    sizes = [min(BATCH, attempts - start) for start in range(0, attempts, BATCH)]
    attempt = functools.partial(_batch, posed, proposal, words)
    tables = [
        root_table(0),
        *(table for table, _ in workers().map(attempt, sizes, sizes, range(len(sizes)))),
    ]
    return _points(posed, RootTable(*(np.concatenate(part) for part in zip(*tables, strict=True))))


def log_nearness(
    posterior: UncertainPosterior, points: RootPoint, exchange: ArrayLike
) -> np.ndarray:
    """`(n,)`: what perspective adds to the log density of the torso's joints under roots `(n, ...)`
    and exchanges `(n,)`: errors are as large as things appear where the joint is, and roots are
    drawn as if they were as large as at the pelvis."""
    number = len(np.asarray(points.torso))
    if posterior.model.lens is None or not number:
        return np.zeros(number)
    measure = functools.partial(_log_nearness, posterior.model, posterior.detected)
    return in_chunks(measure, *map(np.asarray, points), np.broadcast_to(exchange, number))


@jax.jit
def _log_nearness(model: PoseModel, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    prior, torso = RootPrior.of(model), jnp.asarray(TORSO_INDEX)

    def one(point: RootPoint, exchange: jax.Array) -> jax.Array:
        root = prior.root(point)
        counts = detected.counts[jnp.asarray(ORDERS)[exchange]][torso]
        larger = jnp.log(root.camera.magnification(root.view))
        return -2 * jnp.sum(jnp.where(counts, larger, 0.0))

    return jax.vmap(one)(RootPoint(*fields[:4]), fields[4])


def require_distance(posterior: UncertainPosterior) -> None:
    """Raises `BadInput` where a known focal length puts the person too near to the camera."""
    lens = posterior.model.lens
    if lens is None:
        return
    lowest = torso_problem(posterior, Faults.none()).lowest
    distance = float(lens.focal) / lowest
    if distance < NEAREST:
        raise BadInput(
            f"a focal length of {float(lens.focal):g} pixels puts {posterior.detection.where} at"
            f" most {distance:.2g} body units (of about 0.35 m) from the camera, where {NEAREST:g}"
            " are the least; give it in pixels of the image that the keypoints are of"
        )
