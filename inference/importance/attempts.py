"""Draws of the root given the torso's detected joints alone, and how probable those are.

Exact ones: every attempt has the same weight, so what passes is an exact, independent draw from the
whole support of the torso's posterior. Attempts end with the last root wanted, so the rate m/n
would be too large; (m - 1)/(n - 1) is unbiased (Haldane 1945).

Weighed ones, where Gaussian errors let cells of rotations be drawn by guesses at what they have:
where joints are known well, one attempt in 10^5 passes, but every other one counts for something.
"""

import functools
import math
import os
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.exact.groups import workers
from poseterior.inference.exact.loops.fits import (
    FEWER,
    Balance,
    FitCells,
    attempt_fits,
    balance,
    cut_fits,
    guess_fits,
)
from poseterior.inference.exact.loops.roots import (
    RootTable,
    TorsoProblem,
    attempt_roots,
    cut_roots,
    root_table,
)
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance.torsos import (
    Posed,
    log_mass,
    points_of,
    rotations_of,
    torso_problem,
)
from poseterior.inference.resampling import effective, inclusion, shares, systematic
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.faults import Faults
from poseterior.probmodel.likelihood import WithOutliers
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint

BATCH = 1 << 17
"""Most attempts made at a time by one thread: some 10 ms."""
FIRST = 1 << 13
"""Attempts of the first batch; every other one is twice as large, since a few roots, which are all
that most patterns of faults are asked for, are often found by few attempts."""
PATIENCE = 8192
"""Attempts at the torso for each root that is wanted, in search of more: where they are all made,
they take three times as long as a root's limbs."""
HOPELESS = 1 << 26
"""Attempts without one success after which a torso is given up."""
PROBE = 1 << 12
"""Weighed attempts by which is found how many are needed."""
AMPLE = 2
"""Weighed attempts are as many as are worth so many times the roots wanted: then those taken are
nearly all of one weight."""
MOST_WEIGHED = 1 << 19
"""Weighed attempts, at most, which bounds the memory."""
THINNING, PROBING, TAKING = 101, 102, 103
"""Where random numbers come from that thin by an error law, find how many attempts are needed, and
take some of the roots: paths that no batch has."""


class TorsoDraws(NamedTuple):
    """Draws of the root given the torso.

    Attributes
    ----------
    points
        The roots `(n, ...)`.
    log_share
        `(n,)` log of what each has of the evidence.
    inclusion
        `(n,)` the probability with which each was taken from those that were found.
    attempts
        How many were made.
    log_evidence
        Log of the integral over roots of prior mass × scale⁻² for every seen joint of the torso ×
        the likelihood of these joints over its peak; -inf where no root was found.
    variance
        Of that log, by the delta method; infinite where no root was found.
    enough
        Whether the budget allowed for all that was wanted.
    """

    points: RootPoint
    log_share: np.ndarray
    inclusion: np.ndarray
    attempts: int
    log_evidence: float
    variance: float
    enough: bool


class Proposal(NamedTuple):
    """How attempts at a torso's roots are made: their `mass`, which times the rate of success, or
    the mean weight, is the evidence; a batch of them, by a stream of random numbers into a table:
    roots found, attempts made; whether what they find still has to be `thinned` by the error law;
    the `precision` `(n,)` of the Gaussians that they have in them already; and whether they are
    `exact`, or have weights."""

    mass: float
    attempt: Callable[[np.ndarray, int, RootTable], tuple[int, int]]
    thinned: bool
    precision: np.ndarray
    exact: bool = True


def proposal_of(posed: Posed) -> Proposal:
    """Exact attempts: by least squares where joints whose errors a Gaussian bounds determine a
    scale, by discs otherwise."""
    if not _determined(posed):
        return _by_discs(posed)
    known = balance(posed.problem)
    return _by_fits(posed, known, cut_fits(posed.problem, known), exact=True)


def quick_proposal_of(posed: Posed, levels: int = FEWER) -> Proposal:
    """As `proposal_of`, but those by least squares have weights, which scatter the less the more
    `levels` their cells have."""
    if not _determined(posed):
        return _by_discs(posed)
    known = balance(posed.problem)
    return _by_fits(posed, known, guess_fits(posed.problem, known, levels), exact=False)


def _determined(posed: Posed) -> bool:
    problem = posed.problem
    return len(np.unique(problem.keypoints[problem.precision > 0], axis=0)) > 1


def _by_fits(posed: Posed, known: Balance, fits: FitCells, *, exact: bool) -> Proposal:
    problem = posed.problem
    return Proposal(
        fits.mass,
        lambda state, number, table: attempt_fits(
            state, number, problem, known, fits, exact, table
        ),
        thinned=not posed.law.follows(posed.law.precision),
        precision=problem.precision,
        exact=exact,
    )


def _by_discs(posed: Posed) -> Proposal:
    problem = posed.problem
    cells, mass = cut_roots(problem)
    return Proposal(
        mass,
        lambda state, number, table: attempt_roots(state, number, problem, cells, table),
        thinned=not posed.law.follows(0.0),
        precision=np.zeros_like(problem.precision),
    )


def draw_roots(
    posterior: Posterior,
    faults: Faults,
    words: list[int],
    number: int,
    budget: Budget,
    *,
    most: int | None = None,
) -> TorsoDraws:
    """Exact draws: `number` roots given the torso's joints, or as many as the budget allows; up to
    `most` where they come easily.

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
    posed: Posed, proposal: Proposal, words: list[int], number: int, budget: Budget, *, most: int
) -> TorsoDraws:
    """As `draw_roots`, for a torso whose attempts are prepared already. Where these have weights,
    `most` roots, or as many as there are."""
    if not proposal.exact:
        return _weighed(posed, proposal, words, most, budget)
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
    whole = _joined(parts)
    early = int(np.searchsorted(whole.attempt, patience))
    if not number or found < number or (number <= early < most and made < patience):
        return _exact(posed, proposal.mass, whole, made, number, counted=False)
    if number <= early < most:  # patience ended first: a fixed number of attempts
        whole = RootTable(*(column[:early] for column in whole))
        return _exact(posed, proposal.mass, whole, patience, number, counted=False)
    whole = RootTable(*(column[: min(max(early, number), most)] for column in whole))
    made = int(whole.attempt[-1]) + 1
    return _exact(posed, proposal.mass, whole, made, number, counted=True)


def _exact(
    posed: Posed, mass: float, table: RootTable, made: int, wanted: int, *, counted: bool
) -> TorsoDraws:
    """Draws from attempts that were made until the last of them was found, if so `counted`, or else
    to the end of the budget."""
    found, points = len(table.torso), points_of(posed, table)
    rate = (found - 1) / max(made - 1, 1) if counted else found / max(made, 1)
    if not rate:
        return _none(points, made, enough=found >= wanted)
    share, taken = np.full(found, -math.log(found)), np.ones(found)
    evidence = log_mass(posed, mass) + math.log(rate)
    variance = (1 - rate) / found
    return TorsoDraws(points, share, taken, made, evidence, variance, found >= wanted)


def _none(points: RootPoint, made: int, *, enough: bool) -> TorsoDraws:
    """No root, and no evidence."""
    nothing = np.zeros(0)
    return TorsoDraws(points.take(slice(0, 0)), nothing, nothing, made, -math.inf, math.inf, enough)


def _weighed(
    posed: Posed, proposal: Proposal, words: list[int], number: int, budget: Budget
) -> TorsoDraws:
    """`number` roots, taken by their weights from those of as many attempts as a few others said
    that are needed: so the number of attempts knows nothing of the evidence."""
    nowhere = points_of(posed, root_table(0))
    if not (number and proposal.mass):
        return _none(nowhere, 0, enough=True)
    if not budget.spend(PROBE):
        return _none(nowhere, 0, enough=False)
    probe, _ = _batch(posed, proposal, words, PROBE, PROBE, PROBING)
    worth = effective(shares(probe.log_weight))
    wanted = math.ceil(AMPLE * number * PROBE / max(worth, 1.0))
    sizes = _sizes(min(max(wanted, PROBE), MOST_WEIGHED))
    allowed = [size for size in sizes if budget.spend(size)]
    whole, made, enough = _all_of(posed, proposal, words, allowed), sum(allowed), allowed == sizes
    weight = whole.log_weight
    if not np.isfinite(weight).any():
        return _none(nowhere, PROBE + made, enough=enough)
    total = float(logsumexp(weight))
    share = np.exp(weight - total)
    chance = inclusion(share, number)
    rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(TAKING,)))
    rows = systematic(chance, min(number, int(np.count_nonzero(chance))), rng.uniform())
    return TorsoDraws(
        points_of(posed, RootTable(*(column[rows] for column in whole))),
        weight[rows] - total - np.log(chance[rows]),
        chance[rows],
        PROBE + made,
        log_mass(posed, proposal.mass) + total - math.log(made),
        1 / effective(share) - 1 / made,
        enough,
    )


def _sizes(attempts: int) -> list[int]:
    """Of batches that make so many attempts."""
    return [min(BATCH, attempts - start) for start in range(0, attempts, BATCH)]


def _all_of(posed: Posed, proposal: Proposal, words: list[int], sizes: list[int]) -> RootTable:
    """The roots that batches of these sizes find, side by side."""
    attempt = functools.partial(_batch, posed, proposal, words)
    tables = workers().map(attempt, sizes, sizes, range(len(sizes)))
    return _joined([root_table(0), *(table for table, _ in tables)])


def _joined(tables: list[RootTable]) -> RootTable:
    return RootTable(*(np.concatenate(column) for column in zip(*tables, strict=True)))


def _batch(
    posed: Posed,
    proposal: Proposal,
    words: list[int],
    attempts: int,
    number: int,
    batch: int,
) -> tuple[RootTable, int]:
    """The roots that one batch of attempts finds, `number` at most, and how many it made."""
    table = root_table(min(number, attempts))
    found, attempts = proposal.attempt(seeded(words, batch), attempts, table)
    # Copied, or every few roots would keep the memory of a whole table.
    table = RootTable(*(column[:found].copy() for column in table))
    near = posed.lowest > posed.highest * table.inverse
    if near.any():
        table = RootTable(*(column[~near] for column in table))
    if len(table.torso) and (proposal.thinned or posed.upright):
        table = table._replace(log_weight=table.log_weight + _ratio(posed, proposal, table))
        if proposal.exact:
            rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(batch, THINNING)))
            test = np.log1p(-rng.uniform(size=len(table.torso)))
            table = RootTable(*(column[test <= table.log_weight] for column in table))
    return table, attempts


def _ratio(posed: Posed, proposal: Proposal, table: RootTable) -> np.ndarray:
    """`(n,)`: log of what roots count by the error law, beside how they were proposed, and by how
    upright they are, over the peak."""
    rotation = rotations_of(table)
    ratio = posed.upright * (-rotation[:, 1, 1] - 1)
    if not proposal.thinned:
        return ratio
    measure = functools.partial(_log_ratio, posed.law, posed.problem, proposal.precision)
    return ratio + in_chunks(measure, table.torso, rotation, table.inverse, table.plane)


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
        spread = jnp.asarray(problem.reach) / law.reach
        square = jnp.sum(offset**2, axis=1) / spread**2
        return jnp.sum(law.log_over(square, precision * spread**2))

    return jax.vmap(one)(torso, rotation, inverse, plane)


def attempted_roots(posed: Posed, proposal: Proposal, words: list[int], attempts: int) -> RootPoint:
    """The roots `(n, ...)` that a fixed number of exact attempts finds."""
    return points_of(posed, _all_of(posed, proposal, words, _sizes(attempts)))
