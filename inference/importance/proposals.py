"""Roots given the torso, each with a pattern of faults, before anything is asked of the limbs.

More roots are drawn than are weighed, since a root that explains the torso costs a sixth of what
its limbs' evidence costs. How well draws of the prior fit the limbs says
which roots are promising; each is taken by a probability that this decides, and weighed by its
inverse, so that a wrong guess costs effective roots and nothing else.

A pilot run guesses how many have to be looked at for one that is promising. Where the detector has
faults, every stratum of the torso's faults gets a share of the roots: the pilot run guesses what it
has of the posterior.
"""

import math
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.exact.groups import workers
from poseterior.inference.exact.loops.fits import FEWER
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.loops.promise import LANES
from poseterior.inference.exact.rates import Budget
from poseterior.inference.importance.attempts import (
    PATIENCE,
    Proposal,
    TorsoDraws,
    draw_posed,
    quick_proposal_of,
)
from poseterior.inference.importance.limbs import ATTEMPTS, POOL
from poseterior.inference.importance.patterns import (
    Fit,
    Stratum,
    fit_of,
    log_priors,
    pool_of,
    propose,
    strata_of,
)
from poseterior.inference.importance.torsos import Posed, log_nearness, torso_problem
from poseterior.inference.resampling import effective, inclusion, shares, systematic, times
from poseterior.probmodel.faults import Faults
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX

PILOT = 48
"""Roots of a stratum in the pilot run."""
ROUGH, WORTH = 1, 0.05
"""Levels of the cells of a stratum; and the share of the roots above which it gets cells as fine as
where there are no strata: most have next to none."""
PILOT_ATTEMPTS = 1 << 20
"""Attempts of a stratum in the pilot run."""
FEW_ATTEMPTS = 1 << 21
"""Attempts of a stratum of which the pilot run brought no root."""
EVEN = 0.1
"""What is shared out evenly among the strata, whatever the pilot run says."""
LOOKS = 8, 32
"""How many roots of the torso are looked at, where they come easily, for one that is weighed."""
PROMISING = 1.7
"""So many equally promising ones shall be among them, if the looks allow for that: where limbs say
much of the torso, one root in twenty is."""
FURTHER = 1 << 17
"""So many roots are looked at altogether, if not more are to be weighed: it bounds the memory."""
TRUST = 0.85
"""The power of what the prior's draws say of a root by which it is taken."""
CHANCE = 0.05
"""What is shared out evenly among roots, whatever they say."""


class ProposedRoots(NamedTuple):
    """Roots before their limbs.

    Attributes
    ----------
    points : the roots `(n, ...)`.
    faults : their patterns of faults `(n, ...)`.
    log_weight : `(n,)`: prior × density of the torso's detection over what each was proposed with,
        × the peak of the limbs' likelihood and without the factors of the scale that they bring.
    stratum : `(n,)`: which of the strata each is of.
    made : `(strata,)`: how many attempts at roots of each there were.
    scatter : what the relative variance of the evidence has of the roots that these were taken
        from, were their promises kept, and attempts without number.
    wanted : how many roots there would be, had the budget been large enough.
    attempts : how many were made.
    """

    points: RootPoint
    faults: Faults
    log_weight: np.ndarray
    stratum: np.ndarray
    made: np.ndarray
    scatter: float
    wanted: int
    attempts: int

    def at(self, rows: Any) -> "ProposedRoots":
        """Some of them."""
        return self._replace(
            points=self.points.take(rows),
            faults=self.faults.take(rows),
            log_weight=self.log_weight[rows],
            stratum=self.stratum[rows],
        )

    def relative_variance(self, share: np.ndarray) -> float:
        """Of the evidence of roots that have these shares `(n,)` of it, by how their weights
        scatter and what they were taken from."""
        of_strata = np.bincount(self.stratum, share, minlength=len(self.made))
        held = of_strata > 0
        attempted = float(np.sum(of_strata[held] ** 2 / self.made[held]))
        variance = float(np.sum(share**2)) - 1 / len(share) + self.scatter - attempted
        return max(variance, 0.0)


class RootPlan(NamedTuple):
    """How roots are going to be drawn: of which `strata`, by what attempts at each, `attempted`;
    the `share` `(strata,)` of the roots that each gets, how many are looked at for one of them,
    `looks`, and whether there is hope of any, `hopeful`; how many `attempts` it took to know."""

    strata: list[Stratum]
    attempted: list[tuple[Posed, Proposal]]
    share: np.ndarray
    looks: list[int]
    hopeful: list[bool]
    attempts: int


class StratumRoots(NamedTuple):
    """The roots of one stratum, as `ProposedRoots` has them, and the probability `(n,)` with which
    each was taken from those that were attempted."""

    points: RootPoint
    faults: Faults
    log_weight: np.ndarray
    stratum: np.ndarray
    chance: np.ndarray


def propose_roots(
    posterior: Posterior, key: jax.Array, number: int, budget: Budget
) -> ProposedRoots:
    """`number` roots, in random order, or as many as the budget allows."""
    pilot_key, torso_key, order_key = jax.random.split(key, 3)
    rng = np.random.default_rng(words_of(order_key))
    # Attempts at roots that may not be weighed are not taken away from limbs.
    ample = budget.proposals >= 2 * number * (PATIENCE + ATTEMPTS)
    plan = _plan(posterior, pilot_key, budget, ample)
    counts = times(plan.share, number, rng.uniform())
    most = [budget.proposals if hope else FEW_ATTEMPTS for hope in plan.hopeful]
    torsos = _draw(plan.attempted, torso_key, counts.tolist(), most, budget, plan.looks)
    parts, wanted = [], 0
    for index, torso in enumerate(torsos):
        found, asked = len(torso.points.torso), int(counts[index])
        wanted += asked if plan.hopeful[index] and not torso.enough else min(found, asked)
        if found:
            parts.append(_roots_of(posterior, plan, index, torso, asked, rng))
    made = np.array([torso.attempts for torso in torsos])
    attempts = plan.attempts + int(made.sum())
    if not parts:
        none, points = np.zeros(0, int), torsos[0].points
        empty = points, Faults.none(0), np.zeros(0), none
        return ProposedRoots(*empty, made, 0.0, number, attempts)
    points, faults, weight, stratum, chance = jax.tree.map(
        lambda *rows: np.concatenate(rows), parts[0], *parts[1:]
    )
    # The mean over the roots there are, not over those asked for, is to be the evidence.
    weight += np.log(len(weight) / number)
    # If promises were kept, weights would have the relative variance of the chances.
    scatter = float(chance.mean()) / len(weight)
    whole = ProposedRoots(points, faults, weight, stratum, made, scatter, wanted, attempts)
    return whole.at(rng.permutation(len(weight)))


def _plan(posterior: Posterior, key: jax.Array, budget: Budget, ample: bool) -> RootPlan:
    """By a pilot run of each stratum; where there is but one, and the budget is not `ample`, none
    is needed."""
    strata = strata_of(posterior)
    posed = [torso_problem(posterior, stratum.faults) for stratum in strata]
    levels = [ROUGH] * len(posed) if len(posed) > 1 else [FEWER]
    attempted = list(zip(posed, workers().map(quick_proposal_of, posed, levels), strict=True))
    if len(strata) == 1 and not ample:
        return RootPlan(strata, attempted, np.ones(1), [1], [True], 0)
    once, most = [1] * len(strata), [PILOT_ATTEMPTS] * len(strata)
    pilots = _draw(attempted, key, [PILOT] * len(strata), most, budget, once)
    guesses = [_guess(posterior, *of) for of in zip(strata, pilots, strict=True)]
    share = _shares(posterior, strata, pilots, guesses)
    if len(strata) > 1:
        for index in np.flatnonzero(share > WORTH).tolist():
            attempted[index] = posed[index], quick_proposal_of(posed[index])
    return RootPlan(
        strata,
        attempted,
        share,
        [_looks(guess) for guess in guesses] if ample else once,
        [len(guess) > 0 or len(strata) == 1 for guess in guesses],
        sum(pilot.attempts for pilot in pilots),
    )


def _guess(posterior: Posterior, stratum: Stratum, pilot: TorsoDraws) -> np.ndarray:
    """`(n,)`: log of about what each root of a pilot run has of its stratum."""
    if not len(pilot.points.torso):
        return np.zeros(0)
    fit = fit_of(posterior, pool_of(posterior.model), stratum, pilot.points)
    return log_promise(posterior, fit, stratum, pilot.points) + pilot.log_share


def _looks(guess: np.ndarray) -> int:
    """How many roots to look at for one that is weighed, by what a pilot run guesses `(n,)`."""
    if not len(guess):
        return LOOKS[0]
    wanted = math.ceil(PROMISING * len(guess) / effective(shares(TRUST * guess)))
    return min(max(wanted, LOOKS[0]), LOOKS[1])


def _roots_of(
    posterior: Posterior,
    plan: RootPlan,
    index: int,
    torso: TorsoDraws,
    asked: int,
    rng: np.random.Generator,
) -> StratumRoots:
    """So many roots of a stratum as were `asked` for, or all that were found, the more promising
    the rather, each with a pattern of faults."""
    stratum, taken = plan.strata[index], min(len(torso.points.torso), asked)
    fit = fit_of(posterior, _some(posterior.model, plan.looks[index]), stratum, torso.points)
    promise = log_promise(posterior, fit, stratum, torso.points)
    rows, chance = _promising(promise + torso.log_share, taken, rng)
    faults, log_proposal = propose(fit.take(rows), stratum, rng)
    weight = torso.log_evidence + log_priors(posterior, faults) - log_proposal
    weight += np.log(asked / plan.share[index]) + torso.log_share[rows]
    weight -= np.log(chance)
    which = np.full(taken, index)
    return StratumRoots(
        torso.points.take(rows), faults, weight, which, chance * torso.inclusion[rows]
    )


def _some(model: PoseModel, looks: int) -> np.ndarray:
    """The pool's first draws: the more roots are looked at, the fewer each is held against."""
    number = POOL * LOOKS[0] // max(looks, LOOKS[0]) // LANES * LANES
    return pool_of(model)[..., :number]


def log_promise(posterior: Posterior, fit: Fit, stratum: Stratum, points: RootPoint) -> np.ndarray:
    """`(n,)`: about what the limbs say of roots given the torso, but for a constant."""
    counted = np.asarray(posterior.detected.counts)
    of_limbs = int(counted.sum()) - sum(counted[list(TORSO_INDEX)])
    # The exchanges of one stratum move the same joints of the torso.
    nearness = log_nearness(posterior, points, stratum.exchanges[0])
    return fit.total - 2 * of_limbs * np.asarray(points.log_scale) + nearness


def _promising(
    score: np.ndarray, number: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`number` rows of log evidences `(n,)`, and the probability that each had of being taken.
    None is taken twice, so that the effective number of what is taken is never more than that of
    the whole."""
    share = (1 - CHANCE) * _normal(TRUST * score) + CHANCE / len(score)
    probability = inclusion(share, number)
    rows = systematic(probability, number, rng.uniform())
    return rows, probability[rows]


def _normal(score: np.ndarray) -> np.ndarray:
    return np.exp(score - logsumexp(score))


def _draw(
    attempted: list[tuple[Posed, Proposal]],
    key: jax.Array,
    counts: list[int],
    most: list[int],
    budget: Budget,
    looks: list[int],
) -> list[TorsoDraws]:
    """So many roots of each stratum, or `looks` times as many, by so many attempts at most."""
    return [
        draw_posed(
            *torso,
            words_of(jax.random.fold_in(key, index)),
            counts[index],
            Budget(most[index], whole=budget),
            most=max(counts[index], min(looks[index] * counts[index], FURTHER)),
        )
        for index, torso in enumerate(attempted)
    ]


def _shares(
    posterior: Posterior,
    strata: list[Stratum],
    pilots: list[TorsoDraws],
    guesses: list[np.ndarray],
) -> np.ndarray:
    """`(strata,)`: what each gets of the roots: about what it has of the posterior."""
    score = np.full(len(strata), -np.inf)
    for index, (stratum, pilot, guess) in enumerate(zip(strata, pilots, guesses, strict=True)):
        if len(guess):
            score[index] = logsumexp(guess) + pilot.log_evidence + _log_prior(posterior, stratum)
    if not np.isfinite(score).any():
        return np.full(len(strata), 1 / len(strata))
    share = np.exp(score - logsumexp(score))
    return (1 - EVEN) * share + EVEN / len(strata)


def _log_prior(posterior: Posterior, stratum: Stratum) -> float:
    """Log prior of the torso's outlier with the peak of the torso's likelihood, but for a constant;
    that of the exchange is in the fit."""
    exchange = np.full(2, stratum.exchanges[0])
    outlier = np.stack([stratum.faults.outlier, np.zeros(NUM_JOINTS, bool)])
    own, none = log_priors(posterior, Faults(exchange, outlier))
    return float(own - none)
