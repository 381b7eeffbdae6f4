"""Draws of the root given the torso's detected joints alone, and how probable those
are.

Exact ones: every proposal has the same weight, so what passes is an exact, independent
draw from the whole support of the torso's posterior. Proposals end with the last root
wanted, so the rate m/n would be too large; (m - 1)/(n - 1) is unbiased (Haldane 1945).

Weighted ones, where Gaussian errors let cells of rotations be drawn by approximations
of their shares: where joints are known well, one proposal in 10^5 passes, but every
other one has a weight.
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
from poseterior.inference.exact.loops.gaussian import (
    FEWER_LEVELS,
    GaussianTorso,
    RotationCells,
    approximate_cells,
    bounded_cells,
    centre_joints,
    propose_by_gaussian,
)
from poseterior.inference.exact.loops.roots import TorsoJoints, disc_cells, propose_by_discs
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.tables import ROOTS
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance.torsos import (
    TorsoProblem,
    log_mass,
    points_of,
    rotations_of,
    torso_problem,
)
from poseterior.inference.resampling import effective, inclusion, shares, systematic
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.errors.laws import WithOutliers
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint

MOST_AT_A_TIME = 1 << 17
"""Most proposals made at a time by one thread: some 10 ms."""
FIRST_BATCH = 1 << 13
"""Proposals of the first batch; every other one is twice as large, since a few roots,
which are all that most fault patterns are asked for, often come with few proposals."""
TORSO_PROPOSALS = 8192
"""Proposals for each root that is wanted, in search of more: where they are all made,
they take three times as long as a root's limbs."""
TORSO_ZERO_ACCEPTANCE_LIMIT = 1 << 26
"""Proposals without one acceptance after which a torso is given up."""
PROBE = 1 << 12
"""Weighted proposals by which is found how many are needed."""
AMPLE = 2
"""Weighted proposals are as many as are worth so many times the roots wanted: then
those taken are nearly all of one weight."""
MOST_WEIGHTED = 1 << 19
"""Weighted proposals, at most, which bounds the memory."""
THINNING = 101
PROBING = 102
TAKING = 103
"""Where random numbers come from that thin by an error law, find how many proposals are
needed, and take some of the roots: paths that no batch has."""


class TorsoDraws(NamedTuple):
    """Draws of the root given the torso.

    Attributes
    ----------
    points
        The roots `(n, ...)`.
    log_share
        `(n,)` log of what each has of the evidence.
    inclusion
        `(n,)` the probability with which each was taken from those that were accepted.
    proposals
        How many were made.
    log_evidence
        Log of the integral over roots of prior mass × scale⁻² for every seen joint of the torso ×
        the likelihood of these joints over its peak; -inf where no root was accepted.
    variance
        Of that log, by the delta method; infinite where no root was accepted.
    enough
        Whether the budget allowed for all that was wanted.
    """

    points: RootPoint
    log_share: np.ndarray
    inclusion: np.ndarray
    proposals: int
    log_evidence: float
    variance: float
    enough: bool


class TorsoProposal(NamedTuple):
    """How roots of a torso are proposed.

    Attributes
    ----------
    mass
        Which times the acceptance rate, or the mean weight, is the evidence.
    propose
        Makes a batch, given the state of its random numbers, how many, and `ROOTS` to be written
        on; returns how many roots were accepted, and how many proposals were made.
    thinned
        Whether what is accepted still has to be thinned by the error law.
    precision
        `(n,)` of the Gaussians that the proposals have in them already.
    exact
        Or else proposals have weights.
    """

    mass: float
    propose: Callable[[np.ndarray, int, np.ndarray], tuple[int, int]]
    thinned: bool
    precision: np.ndarray
    exact: bool = True


def exact_proposal(problem: TorsoProblem) -> TorsoProposal:
    """By the Gaussian of least squares where joints whose errors a Gaussian bounds
    determine a scale, by discs otherwise."""
    if not _determined(problem):
        return _by_discs(problem)
    torso = GaussianTorso(problem.joints, centre_joints(problem.joints))
    return _by_gaussian(problem, torso, bounded_cells(torso), exact=True)


def weighted_proposal(problem: TorsoProblem, levels: int = FEWER_LEVELS) -> TorsoProposal:
    """As `exact_proposal`, but those by the Gaussian have weights, which scatter the
    less the more `levels` their cells have."""
    if not _determined(problem):
        return _by_discs(problem)
    torso = GaussianTorso(problem.joints, centre_joints(problem.joints))
    return _by_gaussian(problem, torso, approximate_cells(torso, levels), exact=False)


def _determined(problem: TorsoProblem) -> bool:
    joints = problem.joints
    return len(np.unique(joints.keypoints[joints.precision > 0], axis=0)) > 1


def _by_gaussian(
    problem: TorsoProblem, torso: GaussianTorso, cells: RotationCells, *, exact: bool
) -> TorsoProposal:
    return TorsoProposal(
        cells.mass,
        lambda state, number, roots: propose_by_gaussian(
            state, number, torso, cells.table, exact, roots
        ),
        thinned=not problem.law.follows(problem.law.precision),
        precision=problem.joints.precision,
        exact=exact,
    )


def _by_discs(problem: TorsoProblem) -> TorsoProposal:
    joints = problem.joints
    cells, mass = disc_cells(joints)
    return TorsoProposal(
        mass,
        lambda state, number, roots: propose_by_discs(state, number, joints, cells, roots),
        thinned=not problem.law.follows(0.0),
        precision=np.zeros_like(joints.precision),
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
    """Exact draws: `number` roots given the torso's joints, or as many as the budget
    allows; up to `most` where they come easily.

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
        Of proposals; "as many as it allows" has an unbiased evidence too.
    most
        So many are drawn, if `number * TORSO_PROPOSALS` proposals are enough for them; else as
        many as these brought, or `number`, whichever is more (default: `number`).
    """
    problem = torso_problem(posterior, faults)
    batches = Batches(problem, exact_proposal(problem), words)
    return draw_torso(batches, number, budget, most=most or number)


class Batches(NamedTuple):
    """Batches of proposals for a torso, each with random numbers of its own: the
    `problem`, how roots are proposed, and the `words` of the key."""

    problem: TorsoProblem
    proposal: TorsoProposal
    words: list[int]

    def make(self, proposals: int, most: int, batch: int) -> tuple[np.ndarray, int]:
        """The `ROOTS` that one batch of proposals brings, `most` at most, and how many
        proposals were made."""
        problem = self.problem
        roots = np.zeros(min(most, proposals), ROOTS)
        accepted, proposals = self.proposal.propose(seeded(self.words, batch), proposals, roots)
        # Copied, or every few roots would keep the memory of a whole batch.
        roots = roots[:accepted].copy()
        roots = roots[problem.lowest <= problem.highest * roots["inverse"]]
        if len(roots) and (self.proposal.thinned or problem.upright):
            roots["log_weight"] += _log_ratios(problem, self.proposal, roots)
            if self.proposal.exact:
                path = np.random.SeedSequence(self.words, spawn_key=(batch, THINNING))
                test = np.log1p(-np.random.default_rng(path).uniform(size=len(roots)))
                roots = roots[test <= roots["log_weight"]]
        return roots, proposals

    def make_all(self, sizes: list[int]) -> np.ndarray:
        """The `ROOTS` that batches of these sizes bring, side by side."""
        parts = workers().map(self.make, sizes, sizes, range(len(sizes)))
        return np.concatenate([np.zeros(0, ROOTS), *(roots for roots, _ in parts)])


def draw_torso(batches: Batches, number: int, budget: Budget, *, most: int) -> TorsoDraws:
    """As `draw_roots`, for a torso whose proposals are prepared already. Where these
    have weights, `most` roots, or as many as there are."""
    if not batches.proposal.exact:
        return _weighted(batches, most, budget)
    limit = number * TORSO_PROPOSALS
    parts = [np.zeros(0, ROOTS)]
    accepted = made = batch = 0
    while batches.proposal.mass and accepted < (most if made < limit else number):
        if not accepted and made >= TORSO_ZERO_ACCEPTANCE_LIMIT:
            break
        numbers = range(batch, batch + (os.cpu_count() or 1))
        sizes = [min(FIRST_BATCH << min(one // 2, 10), MOST_AT_A_TIME) for one in numbers]
        sizes = [size for size in sizes if budget.spend(size)]
        if not sizes:
            break
        for roots, proposals in workers().map(batches.make, sizes, [most] * len(sizes), numbers):
            roots["number"] += made
            parts.append(roots)
            accepted += len(roots)
            made += proposals
        batch += len(sizes)
    whole = np.concatenate(parts)
    early = int(np.searchsorted(whole["number"], limit))
    if not number or accepted < number or (number <= early < most and made < limit):
        return _exact(batches, whole, made, number, counted=False)
    if number <= early < most:  # the limit came first: a fixed number of proposals
        return _exact(batches, whole[:early], limit, number, counted=False)
    whole = whole[: min(max(early, number), most)]
    return _exact(batches, whole, int(whole["number"][-1]) + 1, number, counted=True)


def _exact(
    batches: Batches, roots: np.ndarray, made: int, wanted: int, *, counted: bool
) -> TorsoDraws:
    """Draws from proposals that were made until the last of them was accepted, if so
    `counted`, or else to the end of the budget."""
    accepted = len(roots)
    points = points_of(batches.problem, roots)
    rate = (accepted - 1) / max(made - 1, 1) if counted else accepted / max(made, 1)
    if not rate:
        return _none(points, made, enough=accepted >= wanted)
    return TorsoDraws(
        points,
        log_share=np.full(accepted, -math.log(accepted)),
        inclusion=np.ones(accepted),
        proposals=made,
        log_evidence=log_mass(batches.problem, batches.proposal.mass) + math.log(rate),
        variance=(1 - rate) / accepted,
        enough=accepted >= wanted,
    )


def _none(points: RootPoint, made: int, *, enough: bool) -> TorsoDraws:
    """No root, and no evidence."""
    nothing = np.zeros(0)
    points = points.take(slice(0, 0))
    return TorsoDraws(
        points,
        log_share=nothing,
        inclusion=nothing,
        proposals=made,
        log_evidence=-math.inf,
        variance=math.inf,
        enough=enough,
    )


def _weighted(batches: Batches, number: int, budget: Budget) -> TorsoDraws:
    """`number` roots, taken by their weights from those of as many proposals as a few
    others said that are needed: so the number of proposals knows nothing of the
    evidence."""
    problem, proposal, words = batches
    nowhere = points_of(problem, np.zeros(0, ROOTS))
    if not (number and proposal.mass):
        return _none(nowhere, 0, enough=True)
    if not budget.spend(PROBE):
        return _none(nowhere, 0, enough=False)
    probe, _ = batches.make(PROBE, PROBE, PROBING)
    worth = effective(shares(probe["log_weight"].copy()))
    wanted = math.ceil(AMPLE * number * PROBE / max(worth, 1.0))
    sizes = _sizes(min(max(wanted, PROBE), MOST_WEIGHTED))
    allowed = [size for size in sizes if budget.spend(size)]
    made = sum(allowed)
    enough = allowed == sizes
    whole = batches.make_all(allowed)
    log_weight = whole["log_weight"].copy()  # contiguous: sums and exponentials to the last bit
    if not np.isfinite(log_weight).any():
        return _none(nowhere, PROBE + made, enough=enough)
    total = float(logsumexp(log_weight))
    share = np.exp(log_weight - total)
    chance = inclusion(share, number)
    rng = np.random.default_rng(np.random.SeedSequence(words, spawn_key=(TAKING,)))
    rows = systematic(chance, min(number, int(np.count_nonzero(chance))), rng.uniform())
    return TorsoDraws(
        points_of(problem, whole[rows]),
        log_share=log_weight[rows] - total - np.log(chance[rows]),
        inclusion=chance[rows],
        proposals=PROBE + made,
        log_evidence=log_mass(problem, proposal.mass) + total - math.log(made),
        variance=1 / effective(share) - 1 / made,
        enough=enough,
    )


def _sizes(proposals: int) -> list[int]:
    """Of batches that make so many proposals."""
    return [min(MOST_AT_A_TIME, proposals - start) for start in range(0, proposals, MOST_AT_A_TIME)]


def _log_ratios(problem: TorsoProblem, proposal: TorsoProposal, roots: np.ndarray) -> np.ndarray:
    """`(n,)`: log of what roots count by the error law, beside how they were proposed,
    and by how upright they are, over the peak."""
    rotation = rotations_of(roots)
    ratio = problem.upright * (-rotation[:, 1, 1] - 1)
    if not proposal.thinned:
        return ratio
    measure = functools.partial(_log_ratio, problem.law, problem.joints, proposal.precision)
    return ratio + in_chunks(measure, roots["torso"], rotation, roots["inverse"], roots["plane"])


@jax.jit
def _log_ratio(
    law: WithOutliers, joints: TorsoJoints, precision: np.ndarray, *roots: jax.Array
) -> jax.Array:
    """`(n,)`: log likelihood of the torso's joints over its peak, and over that of the
    Gaussians by which they were proposed, given torso, rotation, inverse scale and
    translation over the scale of `roots`."""

    def one(
        torso: jax.Array, rotation: jax.Array, inverse: jax.Array, plane: jax.Array
    ) -> jax.Array:
        view = jnp.asarray(joints.torsos)[torso] @ rotation.T
        image = view[:, :2] - view[:, 2:] * jnp.asarray(joints.ray)
        offset = image + plane[None] + jnp.asarray(joints.bias)
        offset -= jnp.asarray(joints.keypoints) * inverse
        spread = jnp.asarray(joints.reach) / law.reach
        square = jnp.sum(offset**2, axis=1) / spread**2
        return jnp.sum(law.log_over(square, precision * spread**2))

    return jax.vmap(one)(*roots)


def proposed_roots(
    problem: TorsoProblem, proposal: TorsoProposal, words: list[int], proposals: int
) -> RootPoint:
    """The roots `(n, ...)` that a fixed number of exact proposals brings."""
    roots = Batches(problem, proposal, words).make_all(_sizes(proposals))
    return points_of(problem, roots)
