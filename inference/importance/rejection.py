"""The slow route, by which the fast one is judged: root, faults and limbs by rejection.

    draws = TorsoRejection().draw(posterior, key, 1000)

    roots = reject_roots(posterior, key=key, num_samples=1000)
    roots.cut_off                        # what share of the posterior lies above the bound

Faults of the torso come from their prior, roots from attempts at the torso, and each root has the
weight that the fast route gives it: but it is taken or left, with probability weight over bound,
and brings one draw. Such draws are independent and have equal weights; nothing is adapted to them,
and nothing drawn twice. Roots that promise little are left before their limbs are asked, with a
probability that is known, and those that stay count for them.

A bound that could be proven would be of no use, as weights scatter by some nats and bounds by many.
So a pilot run finds one, with room above the largest weight that it saw. What later weights have
above it is cut off; that share of the posterior, by which the law of the draws differs from it at
most (in total variation), is estimated without bias.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.draws import (
    COMPLETE,
    MAX_PROPOSALS,
    OUT_OF_BUDGET,
    Draws,
    Progress,
    Sampler,
)
from poseterior.inference.estimators.points import require_camera
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.importance.fault_patterns import (
    FaultPattern,
    fault_patterns,
    fit_score,
    lenses_of,
    log_priors,
    pool_of,
    prior_share,
    propose_faults,
)
from poseterior.inference.importance.limbs import (
    Effort,
    LimbDraws,
    free_groups,
    limb_draws,
    proposals_of,
)
from poseterior.inference.importance.torso_proposals import (
    TORSO_ZERO_ACCEPTANCE_LIMIT,
    TorsoProposal,
    exact_proposal,
    proposed_roots,
)
from poseterior.inference.importance.torsos import (
    TorsoProblem,
    log_mass,
    require_distance,
    torso_problem,
)
from poseterior.inference.importance.two_stage import (
    FIRST_STAGE_POWER,
    ProposedRoots,
    log_first_stage,
)
from poseterior.inference.importance.weighted import (
    NUM_ROOTS,
    WeightedRoots,
    blocks_of,
    log_limbs,
    require_number,
)
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.failures import require_some
from poseterior.probmodel.pose import GroupDraws, Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint

EFFORT: Effort = {1: (16, 16), 2: (16, 16)}
"""A root brings one draw, however well its evidence is known. The benchmark's frozen draws were
made with these."""
ATTEMPTS = proposals_of(EFFORT)
ROOM = 3.0
"""The bound over the largest weight of the pilot run."""
TOLERATED = 0.01
"""The share cut off above which draws are no answer."""
ABOUT = 512
"""Roots that a round of attempts shall bring, about."""
FIRST = 1 << 14
"""Attempts of the first round."""
MOST = 1 << 24
"""Attempts of any round."""
PATIENCE = 16
"""So many times the roots of the pilot run are weighed, while none has any weight."""
LIKELY = 0.95
"""The share of the first round's roots that promise too little to be asked for certain."""
CHANCE = 0.02
"""The least probability that a root's limbs are asked."""


@dataclass(frozen=True, eq=False)
class RejectedRoots(WeightedRoots):
    """Independent draws of the posterior, as roots of equal weight with one draw of their limbs.

    Attributes
    ----------
    cut_off
        An estimate of the share of the posterior that lies above the bound; draws lack it.
    tried
        How many roots were weighed for these, without those of the pilot run.
    """

    cut_off: float
    tried: int

    def draw(self, rng: np.random.Generator, number: int) -> tuple[RootPoint, Pose, np.ndarray]:
        """As `WeightedRoots.draw`, but none twice: at most as many as there are."""
        return super().draw(rng, min(number, len(self.limbs)))


def no_roots(posterior: Posterior) -> RootPoint:
    """No roots of a posterior."""
    lens = np.zeros(0, int) if lenses_of(posterior) > 1 else None
    return RootPoint(np.zeros(0, int), np.zeros((0, 3, 3)), np.zeros(0), np.zeros((0, 2)), lens)


class Taken(NamedTuple):
    """Roots that were taken, in random order, with patterns and one draw each of their limbs."""

    points: RootPoint
    faults: Faults
    limbs: list[dict[str, LimbDraws]]

    def first(self, number: int) -> "Taken":
        """The first so many."""
        rows = slice(0, number)
        return Taken(self.points.take(rows), self.faults.take(rows), self.limbs[rows])


class Round(NamedTuple):
    """Some attempts: the roots that they found, with patterns, limbs and the log of their weights
    `(n,)`, whose sum over the number of `attempts` is the evidence; and the limbs' `free` groups,
    by draws of the prior."""

    points: RootPoint
    faults: Faults
    limbs: list[dict[str, LimbDraws]]
    log_weight: np.ndarray
    attempts: int
    free: dict[str, GroupDraws]

    def taken(self, rng: np.random.Generator, log_bound: float) -> Taken:
        """The roots that are taken, each with probability weight over bound."""
        chance = np.log1p(-rng.uniform(size=len(self.log_weight)))
        rows = rng.permutation(np.flatnonzero(chance < self.log_weight - log_bound))
        limbs = [_one_draw(rng, self.limbs[row]) for row in rows.tolist()]
        for name, draws in self.free.items():  # no two from the same draw of the prior
            own = rng.permutation(len(draws.length))
            for place, found in enumerate(limbs):
                found[name] = _single(draws, int(own[place]))
        return Taken(self.points.take(rows), self.faults.take(rows), limbs)


def _one_draw(rng: np.random.Generator, limbs: dict[str, LimbDraws]) -> dict[str, LimbDraws]:
    """One of the draws that attempts at each group brought."""
    return {
        name: _single(found.draws, int(rng.integers(len(found.draws.length))))
        for name, found in limbs.items()
    }


def _single(draws: GroupDraws, row: int) -> LimbDraws:
    return LimbDraws(0.0, GroupDraws(*(part[row : row + 1].copy() for part in draws)))


class _Stratum(NamedTuple):
    """A pattern of the torso's faults, its `share` of the prior, and how its roots are
    attempted."""

    stratum: FaultPattern
    share: float
    posed: TorsoProblem
    proposal: TorsoProposal


def _strata(posterior: Posterior) -> list[_Stratum]:
    found = []
    for stratum in fault_patterns(posterior):
        posed = torso_problem(posterior, stratum.faults, stratum.lens)
        share = prior_share(posterior, stratum)
        found.append(_Stratum(stratum, share, posed, exact_proposal(posed)))
    return found


class _Rounds:
    """One round after the other, each with as many attempts as about `ABOUT` roots take, until the
    budget ends."""

    def __init__(self, posterior: Posterior, key: jax.Array, max_proposals: int) -> None:
        self.posterior, self.key = posterior, key
        self.strata = _strata(posterior)
        self.left, self.number, self.attempts = max_proposals, 0, FIRST
        self.made, self.promising = 0, -math.inf

    @property
    def spent(self) -> bool:
        """Whether nothing is left of the budget for another round."""
        return self.left < self.attempts + ABOUT * ATTEMPTS

    def __iter__(self) -> Iterator[Round]:
        while not self.spent:
            key = jax.random.fold_in(self.key, self.number)
            found = self._round(key)
            number = len(found.limbs)
            cost = self.attempts + number * ATTEMPTS
            self.left, self.made = self.left - cost, self.made + cost
            self.number += 1
            wanted = self.attempts * ABOUT / max(number, 1)
            self.attempts = int(min(max(wanted, FIRST), 8 * self.attempts, MOST))
            yield found

    def _round(self, key: jax.Array) -> Round:
        """So many attempts, each at the faults of the torso that the prior draws."""
        posterior = self.posterior
        torso_key, limb_key, pattern_key = jax.random.split(key, 3)
        rng = np.random.default_rng(words_of(pattern_key))
        share = np.array([one.share for one in self.strata])
        counts = rng.multinomial(self.attempts, share / share.sum()).tolist()
        parts = []
        for index, (one, number) in enumerate(zip(self.strata, counts, strict=True)):
            if number and one.proposal.mass:
                words = words_of(jax.random.fold_in(torso_key, index))
                points = proposed_roots(one.posed, one.proposal, words, number)
                parts.append(self._asked(rng, one, points))
        parts = [part for part in parts if len(part[2])]
        if not parts:
            return Round(no_roots(posterior), Faults.none(0), [], np.zeros(0), self.attempts, {})
        points, faults, weight = (
            jax.tree.map(lambda *rows: np.concatenate(rows), *column)
            for column in zip(*parts, strict=True)
        )
        words = words_of(limb_key)
        limbs = list(limb_draws(posterior, points, faults, words, EFFORT))
        weight = weight + log_limbs(posterior, points, faults, limbs)
        free = free_groups(posterior, words)
        return Round(points, faults, limbs, weight, self.attempts, free)

    def _asked(
        self, rng: np.random.Generator, one: _Stratum, points: RootPoint
    ) -> tuple[RootPoint, Faults, np.ndarray]:
        """The roots whose limbs are asked, with patterns, and the log of what each counts."""
        if not len(points.torso):
            return no_roots(self.posterior), Faults.none(0), np.zeros(0)
        fit = fit_score(self.posterior, pool_of(self.posterior.model), one.stratum, points)
        promise = log_first_stage(self.posterior, fit, one.stratum, points)
        if math.isinf(self.promising):
            self.promising = float(np.quantile(promise, LIKELY))
        chance = np.clip(np.exp(FIRST_STAGE_POWER * (promise - self.promising)), CHANCE, 1.0)
        rows = np.flatnonzero(rng.uniform(size=len(chance)) < chance)
        if not len(rows):
            return no_roots(self.posterior), Faults.none(0), np.zeros(0)
        faults, log_proposal = propose_faults(fit.take(rows), one.stratum, rng)
        weight = log_priors(self.posterior, faults) - log_proposal - np.log(chance[rows])
        mass = log_mass(one.posed, one.proposal.mass) - math.log(one.share)
        return points.take(rows), faults, weight + mass


@dataclass(frozen=True)
class TorsoRejection(Sampler):
    """Independent draws of torso, camera and pose, a few dozen a second.

    Attributes
    ----------
    name, max_proposals
        As of a `Sampler`.
    num_roots
        Of the pilot run, which finds the bound.
    """

    name: str = "rejection"
    num_roots: int = NUM_ROOTS

    def __post_init__(self) -> None:
        require_number(self.num_roots)

    def _blocks(
        self,
        posterior: Posterior,
        key: jax.Array,
        number: int,
        block: int,
        progress: Progress | None,
    ) -> Iterator[Draws]:
        roots = reject_roots(
            posterior,
            key=jax.random.fold_in(key, 0),
            num_samples=number,
            num_roots=self.num_roots,
            max_proposals=self.max_proposals,
            progress=progress,
        )
        about = {"num_roots": roots.tried, "cut_off": roots.cut_off}
        yield from blocks_of(roots, verdict(roots), about, key, number, block=number)


def reject_roots(
    posterior: Posterior,
    *,
    key: jax.Array,
    num_samples: int,
    num_roots: int = NUM_ROOTS,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> RejectedRoots:
    """Independent draws of root, faults and limbs together.

    Parameters
    ----------
    posterior
        What is to be drawn from.
    key
        Of all random numbers: the same key, the same draws.
    num_samples
        How many draws.
    num_roots
        Of the pilot run, which finds the bound.
    max_proposals
        Most attempts, at roots and limbs together; fewer draws where they end first.
    progress
        Called now and then with the draws made and wanted.

    Returns
    -------
    RejectedRoots
        The draws, or as many as the budget allowed.

    Raises
    ------
    BadInput
        Where the seen joints of the torso do not determine a camera, and where a number is out of
        range.
    """
    require_number(num_roots)
    require_some(num_samples, "samples")
    require_camera(posterior.detection)
    require_distance(posterior)
    round_key, choice_key = jax.random.split(key)
    rounds = _Rounds(posterior, round_key, max_proposals)
    rng = np.random.default_rng(words_of(choice_key))
    log_bound = _bound(rounds, num_roots)
    weights, parts, attempts, held = [np.zeros(0)], [], 0, 0
    if math.isfinite(log_bound):
        for found in rounds:
            parts.append(found.taken(rng, log_bound).first(num_samples - held))
            weights.append(found.log_weight)
            attempts, held = attempts + found.attempts, held + len(parts[-1].limbs)
            if progress:
                progress(held, num_samples)
            if held == num_samples:
                break
    return _result(
        posterior=posterior,
        parts=parts,
        log_weight=np.concatenate(weights),
        log_bound=log_bound,
        attempts=attempts,
        wanted=num_samples,
        made=rounds.made,
    )


def _bound(rounds: _Rounds, num_roots: int) -> float:
    """Log of a bound of the weights, from a pilot run of so many roots at least; -inf where none
    has any weight."""
    largest, weighed, attempts = -math.inf, 0, 0
    for found in rounds:
        weighed, attempts = weighed + len(found.limbs), attempts + found.attempts
        largest = max(largest, float(found.log_weight.max(initial=-math.inf)))
        if weighed >= num_roots and math.isfinite(largest):
            break
        if not weighed and attempts >= TORSO_ZERO_ACCEPTANCE_LIMIT:
            break
        if weighed >= PATIENCE * num_roots:
            break
    return largest + math.log(ROOM)


def _result(
    posterior: Posterior,
    parts: list[Taken],
    log_weight: np.ndarray,
    log_bound: float,
    attempts: int,
    wanted: int,
    made: int,
) -> RejectedRoots:
    held = np.isfinite(log_weight)
    weight = np.exp(log_weight[held] - log_bound)
    total = float(weight.sum())
    parts = [part for part in parts if part.limbs]
    if not parts:
        points, faults = no_roots(posterior), Faults.none(0)
        evidence, scatter, cut_off = -math.inf, 0.0, 0.0
    else:
        points, faults = (
            jax.tree.map(lambda *rows: np.concatenate(rows), *column)
            for column in zip(*((part.points, part.faults) for part in parts), strict=True)
        )
        evidence = math.log(total / attempts) + log_bound
        scatter = float(np.sum(weight**2)) / total**2
        cut_off = float(np.maximum(weight - 1, 0).sum()) / total
    limbs = [found for part in parts for found in part.limbs]
    number = len(limbs)
    equal, stratum, tried = np.full(number, evidence), np.zeros(number, int), np.array([attempts])
    # By such a chance equal ones say as much of the evidence as all that were tried.
    chance = np.full(number, number * scatter)
    proposed = ProposedRoots(
        points=points,
        faults=faults,
        log_weight=equal,
        pattern=stratum,
        made=tried,
        chance=chance,
        wanted=wanted,
        proposals=attempts,
    )
    return RejectedRoots(posterior, proposed, limbs, equal, made, cut_off, len(log_weight))


def verdict(roots: RejectedRoots) -> tuple[str, str]:
    """The status of these draws, and, where it is not complete, a sentence that says why and what
    to do."""
    where, number, wanted = roots.posterior.detection.where, len(roots.limbs), roots.proposed.wanted
    if number < wanted:
        return OUT_OF_BUDGET, (
            f"{number:,} of {wanted:,} draws by rejection after {roots.proposals:,} proposals for"
            f" {where}; ask for fewer, allow more proposals, or take weighted roots"
        )
    if roots.cut_off > TOLERATED:
        return OUT_OF_BUDGET, (
            f"{roots.cut_off:.1%} of the posterior of {where} lies above the bound that a pilot run"
            f" of too few roots found, and is cut off (at most {TOLERATED:.0%} may be); ask for"
            " more roots"
        )
    return COMPLETE, ""
