"""Roots given the torso, each with a pattern of faults, before anything is asked of the limbs.

Where the detector has no faults these are exact draws of `torsos`. Where it has, every stratum of
the torso's faults gets a share of the roots: a pilot run guesses what it has of the posterior.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from inference.exact.loops.numbers import words_of
from inference.exact.rates import Budget
from inference.resampling import times
from inference.uncertain.patterns import (
    Stratum,
    fit_of,
    log_priors,
    pool_of,
    propose,
    strata_of,
)
from inference.uncertain.torsos import TorsoDraws, draw_roots
from probmodel.faults import Faults
from probmodel.roots import RootPoint
from probmodel.skeleton import NUM_JOINTS, TORSO_INDEX
from probmodel.uncertain import UncertainPosterior

PILOT = 48
"""Roots of a stratum in the pilot run."""
PILOT_ATTEMPTS = 1 << 20
"""Attempts of a stratum in the pilot run."""
FEW_ATTEMPTS = 1 << 21
"""Attempts of a stratum of which the pilot run brought no root."""
EVEN = 0.1
"""What is shared out evenly among the strata, whatever the pilot run says."""


class ProposedRoots(NamedTuple):
    """Roots before their limbs.

    Attributes
    ----------
    points : the roots `(n, ...)`.
    faults : their patterns of faults `(n, ...)`.
    log_weight : `(n,)`: prior × density of the torso's detection over what each was proposed with,
        × the peak of the limbs' likelihood and without the factors of the scale that they bring.
    stratum : `(n,)`: which of the strata each is of.
    variance : `(strata,)`, of the log of each stratum's evidence of the torso.
    wanted : how many roots there would be, had the budget been large enough.
    attempts : how many were made.
    """

    points: RootPoint
    faults: Faults
    log_weight: np.ndarray
    stratum: np.ndarray
    variance: np.ndarray
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
        """Of the evidence of roots that have these shares `(n,)` of it: by what the evidences of
        the torsos err."""
        of_strata = np.bincount(self.stratum, share, minlength=len(self.variance))
        held = of_strata > 0
        return float(np.sum(of_strata[held] ** 2 * self.variance[held]))


def propose_roots(
    posterior: UncertainPosterior, key: jax.Array, number: int, budget: Budget
) -> ProposedRoots:
    """`number` roots, in random order, or as many as the budget allows."""
    if not posterior.faults.any:
        torso = draw_roots(posterior, Faults.none(), words_of(key), number, budget)
        faults = Faults.none(len(torso.points.torso))
        found = len(faults.exchange)
        return ProposedRoots(
            torso.points,
            faults,
            log_weight=np.full(found, torso.log_evidence + posterior.log_peak),
            stratum=np.zeros(found, int),
            variance=np.array([torso.variance]),
            wanted=number,
            attempts=torso.attempts,
        )
    return _with_faults(posterior, key, number, budget)


def _with_faults(
    posterior: UncertainPosterior, key: jax.Array, number: int, budget: Budget
) -> ProposedRoots:
    pool_key, pilot_key, torso_key, order_key = jax.random.split(key, 4)
    strata, pool = strata_of(posterior), pool_of(posterior.model, words_of(pool_key))
    most = [PILOT_ATTEMPTS] * len(strata)
    pilots = _draw(posterior, strata, pilot_key, [PILOT] * len(strata), most, budget)
    share = _shares(posterior, pool, strata, pilots)
    rng = np.random.default_rng(words_of(order_key))
    counts = times(share, number, rng.uniform())
    hopeful = [len(pilot.points.torso) > 0 for pilot in pilots]
    most = [budget.proposals if hope else FEW_ATTEMPTS for hope in hopeful]
    torsos = _draw(posterior, strata, torso_key, counts.tolist(), most, budget)
    parts, wanted = [], 0
    for index, (stratum, torso) in enumerate(zip(strata, torsos, strict=True)):
        found = len(torso.points.torso)
        wanted += int(counts[index]) if hopeful[index] else found
        if found:
            fit = fit_of(posterior, pool, stratum, torso.points)
            faults, log_proposal = propose(fit, stratum, rng)
            weight = torso.log_evidence + log_priors(posterior, faults)
            weight += np.log(counts[index] / found / share[index]) - log_proposal
            parts.append((torso.points, faults, weight, np.full(found, index)))
    attempts = sum(torso.attempts for torso in (*pilots, *torsos))
    variance = np.array([torso.variance for torso in torsos])
    if not parts:
        none = np.zeros(0, int)
        return ProposedRoots(
            torsos[0].points, Faults.none(0), np.zeros(0), none, variance, number, attempts
        )
    points, faults, weight, stratum_of = (
        jax.tree.map(lambda *rows: np.concatenate(rows), *column)
        for column in zip(*parts, strict=True)
    )
    # The mean over the roots there are, not over those asked for, is to be the evidence.
    weight += np.log(len(weight) / number)
    whole = ProposedRoots(points, faults, weight, stratum_of, variance, wanted, attempts)
    return whole.at(rng.permutation(len(weight)))


def _draw(
    posterior: UncertainPosterior,
    strata: list[Stratum],
    key: jax.Array,
    counts: list[int],
    most: list[int],
    budget: Budget,
) -> list[TorsoDraws]:
    """So many roots of each stratum, by so many attempts at most."""
    return [
        draw_roots(
            posterior,
            stratum.faults,
            words_of(jax.random.fold_in(key, index)),
            counts[index],
            Budget(most[index], whole=budget),
        )
        for index, stratum in enumerate(strata)
    ]


def _shares(
    posterior: UncertainPosterior,
    pool: np.ndarray,
    strata: list[Stratum],
    pilots: list[TorsoDraws],
) -> np.ndarray:
    """`(strata,)`: what each gets of the roots: about what it has of the posterior."""
    counted = np.asarray(posterior.detected.counts)
    of_limbs = int(counted.sum()) - sum(counted[list(TORSO_INDEX)])
    score = np.full(len(strata), -np.inf)
    for index, (stratum, pilot) in enumerate(zip(strata, pilots, strict=True)):
        if len(pilot.points.torso):
            fit = fit_of(posterior, pool, stratum, pilot.points)
            evidence = fit.total - 2 * of_limbs * pilot.points.log_scale
            score[index] = (
                logsumexp(evidence)
                - np.log(len(evidence))
                + pilot.log_evidence
                + _log_prior(posterior, stratum)
            )
    if not np.isfinite(score).any():
        return np.full(len(strata), 1 / len(strata))
    share = np.exp(score - logsumexp(score))
    return (1 - EVEN) * share + EVEN / len(strata)


def _log_prior(posterior: UncertainPosterior, stratum: Stratum) -> float:
    """Log prior of the torso's outlier with the peak of the torso's likelihood, but for a constant;
    that of the exchange is in the fit."""
    exchange = np.full(2, stratum.exchanges[0])
    outlier = np.stack([stratum.faults.outlier, np.zeros(NUM_JOINTS, bool)])
    own, none = log_priors(posterior, Faults(exchange, outlier))
    return float(own - none)
