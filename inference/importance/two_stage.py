"""Two-stage importance sampling of the root: roots given the torso, each with faults of
the detector, before anything is asked of the limbs.

More roots are drawn than are weighted in the end, since a root that explains the torso
costs a sixth of what its limbs' evidence costs. How well draws of the prior fit the
limbs gives each root a first-stage weight; roots are taken by probabilities that this
decides, and weighted by their inverse, so that a wrong first-stage weight costs
effective roots and nothing else.

A pilot run estimates how much oversampling is needed. Where the detector has faults,
every pattern of the torso's faults gets a share of the roots: the pilot run estimates
what it has of the posterior. Where there may be several focal lengths, so does each of
these; but faults that are rare under the best of them are looked at under one that is
taken at random, and stands for all.
"""

import itertools
import math
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.exact.groups import workers
from poseterior.inference.exact.loops.first_stage import LANES
from poseterior.inference.exact.loops.gaussian import FEWER_LEVELS
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance.fault_patterns import (
    FaultPattern,
    FitScore,
    fault_patterns,
    fit_score,
    lenses_of,
    log_priors,
    pool_of,
    propose_faults,
)
from poseterior.inference.importance.limbs import LIMB_PROPOSALS, POOL_SIZE
from poseterior.inference.importance.torso_proposals import (
    TORSO_PROPOSALS,
    Batches,
    TorsoDraws,
    TorsoProposal,
    draw_torso,
    weighted_proposal,
)
from poseterior.inference.importance.torsos import TorsoProblem, log_nearness, torso_problem
from poseterior.inference.resampling import effective, inclusion, shares, systematic, times
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX

PILOT = 48
"""Roots of a pattern in the pilot run."""
ROUGH_LEVELS = 1
"""Levels of the cells of a pattern, where there are several."""
FINE_SHARE = 0.05
"""The share of the roots above which a pattern gets cells as fine as one alone. Those of several
focal lengths share the roots out, and rough cells do: fine ones cost three times as much as all the
rest, and made no more effective roots."""
COARSE_LEVELS = 0
"""Levels of the cells of faults, of which most are never seen."""
RARE_ODDS = 0.002
"""Odds of faults against none, under the best focal length, below which one focal length
stands for all."""
PILOT_PROPOSALS = 1 << 20
"""Proposals for a pattern in the pilot run."""
FEW_PROPOSALS = 1 << 21
"""Proposals for a pattern of which the pilot run brought no root."""
EVEN_SHARE = 0.1
"""What is shared out evenly among the patterns, whatever the pilot run says."""
OVERSAMPLING = 8, 32
"""How many roots get a first-stage weight, where they come easily, for one that is
weighted in the end: at least, and at most."""
EQUALS = 1.7
"""So many roots of about equal first-stage weight shall be among them, if that is not
too much oversampling: where limbs say much of the torso, one root in twenty has such a
weight."""
MOST_FIRST_STAGE = 1 << 17
"""So many roots get a first-stage weight altogether, if not more are to be weighted in
the end: it bounds the memory."""
FIRST_STAGE_POWER = 0.85
"""The power of the first-stage weight by which a root is taken."""
FIRST_STAGE_FLOOR = 0.05
"""What is shared out evenly among roots, whatever their first-stage weights."""


class ProposedRoots(NamedTuple):
    """Roots before their limbs.

    Attributes
    ----------
    points : the roots `(n, ...)`.
    faults : of the detector under each `(n, ...)`.
    log_weight : `(n,)`: prior × density of the torso's detection over what each was
        proposed with, × the peak of the limbs' likelihood and without the factors of
        the scale that they bring.
    pattern : `(n,)`: which of the patterns of the torso's faults each has.
    made : `(patterns,)`: how many proposals for roots of each there were.
    chance : `(n,)`: the probability with which each was taken from those that were
        proposed.
    wanted : how many roots there would be, had the budget been large enough.
    proposals : how many were made.
    stands_for : `(patterns,)`: as `FaultPattern` has it.
    """

    points: RootPoint
    faults: Faults
    log_weight: np.ndarray
    pattern: np.ndarray
    made: np.ndarray
    chance: np.ndarray
    wanted: int
    proposals: int
    stands_for: np.ndarray | int = 1

    def at(self, rows: Any) -> "ProposedRoots":
        """Some of them, whichever these are: they are taken more seldom."""
        chance = self.chance[rows]
        return self._replace(
            points=self.points.take(rows),
            faults=self.faults.take(rows),
            log_weight=self.log_weight[rows],
            pattern=self.pattern[rows],
            chance=chance * (len(chance) / max(len(self.chance), 1)),
        )

    def relative_variance(self, share: np.ndarray) -> float:
        """Of the evidence of roots that have these shares `(n,)` of it.

        Two parts: of those that were proposed, without number, Σ chance · share²; and
        of taking some of them, by so even a count that about their mean 1/n only what
        might have been left out counts, Σ (1 - chance) · (share - 1/n)² (Hájek 1964).
        From the sum goes what the number of proposals is known by. A pattern whose focal
        length stands for others has a variance that is, in the mean, at most the square
        of the share that was found: so much is added."""
        of_patterns = np.bincount(self.pattern, share, minlength=len(self.made))
        held = of_patterns > 0
        proposed = float(np.sum(of_patterns[held] ** 2 / self.made[held]))
        taking = (1 - self.chance) * (share - 1 / len(share)) ** 2
        variance = float(np.sum(self.chance * share**2 + taking)) - proposed
        alone = np.broadcast_to(self.stands_for, len(self.made)) > 1
        return max(variance, 0.0) + float(np.sum(of_patterns[alone] ** 2))


class PatternPlan(NamedTuple):
    """How roots of one fault pattern are going to be drawn.

    Attributes
    ----------
    pattern
        Of the torso's faults.
    problem, proposal
        Of the torso under it.
    share
        Of all roots.
    oversampling
        How many roots get a first-stage weight for one that is weighted in the end.
    likely
        Whether the pilot run brought any root.
    """

    pattern: FaultPattern
    problem: TorsoProblem
    proposal: TorsoProposal
    share: float = 1.0
    oversampling: int = 1
    likely: bool = True


class Pilot(NamedTuple):
    """What a pilot run says of a pattern.

    Attributes
    ----------
    plan
        Without a share.
    estimate
        `(n,)` log of about what each root has of the pattern.
    score
        Log of about what the pattern has of the posterior, -inf where there was no root.
    proposals
        How many were made.
    """

    plan: PatternPlan
    estimate: np.ndarray
    score: float
    proposals: int

    @property
    def likely(self) -> bool:
        """Whether it brought any root, and was of this very pattern."""
        return len(self.estimate) > 0 and self.plan.pattern.stands_for == 1


class PatternRoots(NamedTuple):
    """The roots of one pattern, as `ProposedRoots` has them, and the probability `(n,)`
    with which each was taken from those that were proposed."""

    points: RootPoint
    faults: Faults
    log_weight: np.ndarray
    pattern: np.ndarray
    chance: np.ndarray


def propose_roots(
    posterior: Posterior, key: jax.Array, number: int, budget: Budget
) -> ProposedRoots:
    """`number` roots, in random order, or as many as the budget allows."""
    pilot_key, torso_key, order_key = jax.random.split(key, 3)
    rng = np.random.default_rng(words_of(order_key))
    # Proposals for roots that may not be weighted are not taken away from limbs.
    ample = budget.proposals >= 2 * number * (TORSO_PROPOSALS + LIMB_PROPOSALS)
    plans, pilot_proposals = _plan(posterior, pilot_key, budget, ample, rng)
    counts = times(np.array([plan.share for plan in plans]), number, rng.uniform()).tolist()
    limits = [budget.proposals if plan.likely else FEW_PROPOSALS for plan in plans]
    torsos = _draw(plans, torso_key, counts, limits, budget)
    parts = []
    wanted = 0
    for index, (plan, torso, asked) in enumerate(zip(plans, torsos, counts, strict=True)):
        accepted = len(torso.points.torso)
        wanted += asked if plan.likely and not torso.enough else min(accepted, asked)
        if accepted:
            parts.append(_roots_of(posterior, plan, index, torso, asked, rng))
    made = np.array([torso.proposals for torso in torsos])
    proposals = pilot_proposals + int(made.sum())
    if not parts:
        nothing = np.zeros(0)
        none = PatternRoots(torsos[0].points, Faults.none(0), nothing, nothing.astype(int), nothing)
        return ProposedRoots(**none._asdict(), made=made, wanted=number, proposals=proposals)
    roots = jax.tree.map(lambda *rows: np.concatenate(rows), parts[0], *parts[1:])
    held = len(roots.log_weight)
    stands_for = np.array([plan.pattern.stands_for for plan in plans])
    # The mean over the roots there are, not over those asked for, is to be the evidence.
    roots = roots._replace(log_weight=roots.log_weight + np.log(held / number))
    whole = ProposedRoots(
        **roots._asdict(), made=made, wanted=wanted, proposals=proposals, stands_for=stands_for
    )
    return whole.at(rng.permutation(held))


def _plan(
    posterior: Posterior, key: jax.Array, budget: Budget, ample: bool, rng: np.random.Generator
) -> tuple[list[PatternPlan], int]:
    """A plan for each pattern, by a pilot run, and how many proposals that took; where
    there is but one pattern, and the budget is not `ample`, none is needed."""
    patterns, lenses = fault_patterns(posterior), lenses_of(posterior)
    if len(patterns) == 1:
        plans = _prepared(posterior, patterns, FEWER_LEVELS)
        if not ample:
            return plans, 0
        pilots = _pilots(posterior, plans, key, budget)
        made = pilots[0].proposals
    else:
        pilots, made = _of_faults(posterior, patterns, lenses, key, budget, rng)
    share = _shares(np.array([pilot.score for pilot in pilots]))
    plans = []
    for pilot, own in zip(pilots, share.tolist(), strict=True):
        plan = pilot.plan._replace(
            share=own,
            oversampling=_oversampling(pilot.estimate) if ample else 1,
            likely=pilot.likely or len(pilots) == 1,
        )
        if len(pilots) > 1 and lenses == 1 and own > FINE_SHARE:
            plan = plan._replace(proposal=weighted_proposal(plan.problem))
        plans.append(plan)
    return plans, made


def _of_faults(
    posterior: Posterior,
    patterns: list[FaultPattern],
    lenses: int,
    key: jax.Array,
    budget: Budget,
    rng: np.random.Generator,
) -> tuple[list[Pilot], int]:
    """Pilot runs of no faults under every lens, and of faults under the best of them; where they
    are not rare under it, under every lens, otherwise one that is taken at random stands
    for all. And how many proposals that took."""
    keys = jax.random.split(key, 3)
    plans = _prepared(posterior, patterns[:lenses], ROUGH_LEVELS)
    sound = _pilots(posterior, plans, keys[0], budget)
    score = np.array([pilot.score for pilot in sound])
    best, faulty = int(np.argmax(score)), list(itertools.batched(patterns[lenses:], lenses))
    plans = _prepared(posterior, [same[best] for same in faulty], COARSE_LEVELS)
    asked = _pilots(posterior, plans, keys[1], budget)
    made = sum(pilot.proposals for pilot in (*sound, *asked))
    if lenses == 1:
        return sound + asked, made
    usual = score[best] + math.log(RARE_ODDS)
    rare = [math.isfinite(usual) and pilot.score <= usual for pilot in asked]
    chance, stand_ins = _shares(score), []
    for same in itertools.compress(faulty, rare):
        lens = int(rng.choice(lenses, p=chance))
        stand_ins.append(same[lens]._replace(stands_for=1 / float(chance[lens])))
    known = itertools.compress(asked, rare)
    plans = _prepared(posterior, stand_ins, COARSE_LEVELS)
    found = sound + [
        pilot._replace(plan=plan, score=pilot.score + float(logsumexp(score - score[best])))
        for pilot, plan in zip(known, plans, strict=True)
    ]
    often = itertools.chain(*itertools.compress(faulty, np.logical_not(rare)))
    more = _pilots(posterior, _prepared(posterior, list(often), ROUGH_LEVELS), keys[2], budget)
    return found + more, made + sum(pilot.proposals for pilot in more)


def _prepared(posterior: Posterior, patterns: list[FaultPattern], levels: int) -> list[PatternPlan]:
    """What proposes roots of each, by cells of so many levels."""
    problems = [torso_problem(posterior, pattern.faults, pattern.lens) for pattern in patterns]
    proposals = workers().map(weighted_proposal, problems, [levels] * len(patterns))
    return list(map(PatternPlan, patterns, problems, proposals))


def _pilots(
    posterior: Posterior, plans: list[PatternPlan], key: jax.Array, budget: Budget
) -> list[Pilot]:
    number = len(plans)
    draws = _draw(plans, key, [PILOT] * number, [PILOT_PROPOSALS] * number, budget)
    found = []
    for plan, drawn in zip(plans, draws, strict=True):
        estimate, score = _pilot_estimate(posterior, plan.pattern, drawn), -math.inf
        if len(estimate):
            score = float(logsumexp(estimate)) + drawn.log_evidence
            score += _log_prior(posterior, plan.pattern)
        found.append(Pilot(plan, estimate, score, drawn.proposals))
    return found


def _pilot_estimate(posterior: Posterior, pattern: FaultPattern, pilot: TorsoDraws) -> np.ndarray:
    """`(n,)`: log of about what each root of a pilot run has of its pattern."""
    if not len(pilot.points.torso):
        return np.zeros(0)
    score = fit_score(posterior, pool_of(posterior.model), pattern, pilot.points)
    return log_first_stage(posterior, score, pattern, pilot.points) + pilot.log_share


def _oversampling(estimate: np.ndarray) -> int:
    """How many roots get a first-stage weight for one that is weighted in the end, by
    the pilot estimates `(n,)`."""
    least, most = OVERSAMPLING
    if not len(estimate):
        return least
    equal = effective(shares(FIRST_STAGE_POWER * estimate))
    return min(max(math.ceil(EQUALS * len(estimate) / equal), least), most)


def _roots_of(
    posterior: Posterior,
    plan: PatternPlan,
    index: int,
    torso: TorsoDraws,
    asked: int,
    rng: np.random.Generator,
) -> PatternRoots:
    """So many roots of the pattern of that `index` as were `asked` for, or all that
    there are, those of larger first-stage weight the rather, each with faults."""
    pattern = plan.pattern
    pool = _part_of_pool(posterior.model, plan.oversampling)
    score = fit_score(posterior, pool, pattern, torso.points)
    first_stage = log_first_stage(posterior, score, pattern, torso.points) + torso.log_share
    rows, chance = _take(first_stage, min(len(first_stage), asked), rng)
    faults, log_proposal = propose_faults(score.take(rows), pattern, rng)
    weight = torso.log_evidence + log_priors(posterior, faults) - log_proposal
    weight += np.log(pattern.stands_for * asked / plan.share) + torso.log_share[rows]
    weight -= np.log(chance)
    chance = chance * torso.inclusion[rows]
    number = np.full(len(rows), index)
    return PatternRoots(torso.points.take(rows), faults, weight, number, chance)


def _part_of_pool(model: PoseModel, oversampling: int) -> np.ndarray:
    """The pool's first draws: the more roots are compared with them, the fewer they
    are."""
    least = OVERSAMPLING[0]
    number = POOL_SIZE * least // max(oversampling, least) // LANES * LANES
    return pool_of(model)[..., :number]


def log_first_stage(
    posterior: Posterior, score: FitScore, pattern: FaultPattern, points: RootPoint
) -> np.ndarray:
    """`(n,)`: log first-stage weights, about what the limbs say of roots given the
    torso, but for a constant."""
    counted = np.asarray(posterior.detected.counts)
    of_limbs = int(counted.sum()) - sum(counted[list(TORSO_INDEX)])
    # The exchanges of one pattern move the same joints of the torso.
    nearness = log_nearness(posterior, points, pattern.exchanges[0])
    return score.total - 2 * of_limbs * np.asarray(points.log_scale) + nearness


def _take(
    first_stage: np.ndarray, number: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`number` rows by log first-stage weights `(n,)`, and the probability that each
    had of being taken. None is taken twice, so that the effective number of what is
    taken is never more than that of the whole."""
    share = (1 - FIRST_STAGE_FLOOR) * _normal(FIRST_STAGE_POWER * first_stage)
    probability = inclusion(share + FIRST_STAGE_FLOOR / len(first_stage), number)
    rows = systematic(probability, number, rng.uniform())
    return rows, probability[rows]


def _normal(score: np.ndarray) -> np.ndarray:
    return np.exp(score - logsumexp(score))


def _draw(
    plans: list[PatternPlan],
    key: jax.Array,
    counts: list[int],
    limits: list[int],
    budget: Budget,
) -> list[TorsoDraws]:
    """So many roots of each pattern, times its oversampling, by no more proposals than
    its limit."""
    draws = []
    for index, (plan, count, limit) in enumerate(zip(plans, counts, limits, strict=True)):
        words = words_of(jax.random.fold_in(key, index))
        batches = Batches(plan.problem, plan.proposal, words)
        most = max(count, min(plan.oversampling * count, MOST_FIRST_STAGE))
        draws.append(draw_torso(batches, count, Budget(limit, whole=budget), most=most))
    return draws


def _shares(score: np.ndarray) -> np.ndarray:
    """`(patterns,)`: what each gets of the roots: about what it has of the posterior, by
    the scores of pilot runs."""
    if not np.isfinite(score).any():
        return np.full(len(score), 1 / len(score))
    share = np.exp(score - logsumexp(score))
    return (1 - EVEN_SHARE) * share + EVEN_SHARE / len(score)


def _log_prior(posterior: Posterior, pattern: FaultPattern) -> float:
    """Log prior of the torso's outlier with the peak of the torso's likelihood, but for
    a constant; that of the exchange is in the fit score."""
    exchange = np.full(2, pattern.exchanges[0])
    outlier = np.stack([pattern.faults.outlier, np.zeros(NUM_JOINTS, bool)])
    own, none = log_priors(posterior, Faults(exchange, outlier))
    return float(own - none)
