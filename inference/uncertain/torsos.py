"""Exact draws of the root given the torso's detected joints alone, and how probable those are.

Every attempt has the same weight, so what passes is an exact, independent draw from the whole
support of the torso's posterior. Attempts end with the last root wanted, so the rate m/n would be
too large; (m - 1)/(n - 1) is unbiased (Haldane 1945).
"""

import functools
import math
import os
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from inference.exact.groups import workers
from inference.exact.loops.numbers import seeded
from inference.exact.loops.roots import RootTable, TorsoProblem, attempt_roots, root_table
from inference.exact.rates import Budget
from probmodel.chunks import in_chunks
from probmodel.likelihood import ErrorLaw
from probmodel.roots import RootPoint
from probmodel.rotations import rotation_of
from probmodel.skeleton import TORSO_INDEX
from probmodel.uncertain import UncertainPosterior

BATCH = 1 << 20
"""Attempts made at a time by one thread: some 0.1 s."""
HOPELESS = 1 << 28
"""Attempts without one success after which a torso is given up."""
THINNING = 101
"""Where the random numbers come from that thin by an error law: a path that no batch has."""


class TorsoDraws(NamedTuple):
    """Draws of the root given the torso.

    Attributes
    ----------
    points : the roots `(n, ...)`.
    attempts : how many were made.
    log_evidence : log of the integral over roots of prior mass × scale⁻² for every seen joint of
        the torso × the likelihood of these joints over its peak; -inf where no root was found.
    variance : of that log, by the delta method; infinite where no root was found.
    """

    points: RootPoint
    attempts: int
    log_evidence: float
    variance: float


def torso_problem(posterior: UncertainPosterior) -> tuple[TorsoProblem, np.ndarray]:
    """What the torso's joints ask of a root, and the point `(2,)` of the image, in pixels, that is
    the origin of the problem's keypoints.

    The joint with the smallest disc comes first, then the others from far to near: most attempts
    fail early.
    """
    detected, torsos = posterior.detected, np.asarray(posterior.model.torsos, float)
    rows = [row for row, joint in enumerate(TORSO_INDEX) if np.isfinite(detected.spread[joint])]
    joints = [TORSO_INDEX[row] for row in rows]
    reach = detected.law.reach * np.asarray(detected.spread)[joints]
    keypoints = np.asarray(detected.keypoints)[joints]
    first = int(np.argmin(reach))
    distance = np.linalg.norm(keypoints - keypoints[first], axis=1)
    distance[first] = np.inf
    order = np.argsort(-distance, kind="stable")
    points = np.ascontiguousarray(torsos[:, rows][:, order])
    origin = keypoints[first]
    problem = TorsoProblem(
        points,
        np.ascontiguousarray(keypoints[order] - origin),
        np.ascontiguousarray(reach[order]),
        lowest_scale(points, keypoints[order], reach[order]),
        2.0 * len(rows) - 2,
    )
    return problem, origin


def lowest_scale(torsos: np.ndarray, keypoints: np.ndarray, reach: np.ndarray) -> float:
    """A scale, pixels a body unit, that no root can go below: two joints project to within their
    distance in space of each other, and each is detected within its reach.

    Parameters
    ----------
    torsos : `(J, n, 3)` body units
    keypoints : `(n, 2)` pixels
    reach : `(n,)` body units
    """
    apart = np.linalg.norm(keypoints[:, None] - keypoints[None], axis=-1)
    widest = np.linalg.norm(torsos[:, :, None] - torsos[:, None], axis=-1).max(axis=0)
    most = widest + reach[:, None] + reach[None]
    # A little lower, for rounding; two joints at least lie apart, or no camera is determined.
    return float((apart / most).max() * (1 - 1e-9))


def draw_roots(
    posterior: UncertainPosterior, words: list[int], number: int, budget: Budget
) -> TorsoDraws:
    """`number` roots given the torso's joints, or as many as the budget allows.

    Parameters
    ----------
    posterior : whose detection shows enough of the torso to determine a camera.
    words : of the key.
    number : how many roots.
    budget : of attempts.
    """
    problem, origin = torso_problem(posterior)
    parts: list[RootTable] = []
    found, made, batch = 0, 0, 0
    while found < number and (found or made < HOPELESS):
        numbers = [
            one for one in range(batch, batch + (os.cpu_count() or 1)) if budget.spend(BATCH)
        ]
        if not numbers:
            break
        tables = workers().map(
            functools.partial(_batch, posterior.detected.law, problem, words, number), numbers
        )
        for table, attempts in tables:
            parts.append(table._replace(attempt=table.attempt + made))
            found, made = found + len(table.torso), made + attempts
        batch += len(numbers)
    whole = RootTable(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    if found >= number:
        whole = RootTable(*(column[:number] for column in whole))
        made = int(whole.attempt[-1]) + 1
    return _named(problem, origin, whole, made, found >= number)


def _batch(
    law: ErrorLaw, problem: TorsoProblem, words: list[int], number: int, batch: int
) -> tuple[RootTable, int]:
    """The roots that one batch of attempts finds, and how many attempts it made."""
    table = root_table(number)
    found, attempts = attempt_roots(seeded(words, batch), BATCH, problem, table)
    table = RootTable(*(column[:found] for column in table))
    if not law.flat and found:
        rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(batch, THINNING)))
        test = np.log1p(-rng.uniform(size=found))
        kept = test <= in_chunks(functools.partial(_log_ratio, law, problem), *table[:4])
        table = RootTable(*(column[kept] for column in table))
    return table, attempts


@functools.partial(jax.jit, static_argnums=0)
def _log_ratio(
    law: ErrorLaw,
    problem: TorsoProblem,
    torso: jax.Array,
    quaternion: jax.Array,
    scale: jax.Array,
    plane: jax.Array,
) -> jax.Array:
    """`(n,)`: log likelihood of the torso's joints over its peak."""

    def one(torso: jax.Array, rotation: jax.Array, scale: jax.Array, plane: jax.Array) -> jax.Array:
        image = jnp.asarray(problem.torsos)[torso] @ rotation[:2].T
        offset = image + plane[None] - jnp.asarray(problem.keypoints) / scale
        square = jnp.sum(offset**2, axis=1) / (jnp.asarray(problem.reach) / law.reach) ** 2
        return jnp.sum(law.log_ratio(square))

    return jax.vmap(one)(torso, rotation_of(quaternion), scale, plane)


_rotations = jax.jit(rotation_of)


def _named(
    problem: TorsoProblem, origin: np.ndarray, table: RootTable, made: int, enough: bool
) -> TorsoDraws:
    found = len(table.torso)
    rotation = in_chunks(_rotations, table.quaternion) if found else np.zeros((0, 3, 3))
    points = RootPoint(
        table.torso,
        rotation,
        np.log(table.scale),
        origin + table.scale[:, None] * table.plane,
    )
    # Counted to the last root wanted, or to the end of the budget.
    rate = (found - 1) / max(made - 1, 1) if enough else found / max(made, 1)
    if found < 2 or not rate:
        return TorsoDraws(points, made, -math.inf, math.inf)
    log_mass = math.log(np.pi * problem.reach[0] ** 2 / problem.power)
    log_mass -= problem.power * math.log(problem.lowest)
    return TorsoDraws(points, made, log_mass + math.log(rate), (1 - rate) / found)
