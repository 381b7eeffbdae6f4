"""The evidence: how probable the prior thinks what was seen, with its standard error, whole and
limb by limb.

It ranks torsos and cameras: of two candidates that fit a torso alike, the limbs are better
explained under one of them."""

from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.draws import key_of
from poseterior.inference.exact.groups import StratifiedGroup, group_tables
from poseterior.inference.exact.problem import limb_problems, log_ratio_of
from poseterior.inference.exact.rates import Budget, GroupSampler
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import GROUPS, Limb

WHOLE_BODY = "body"
STEP = 4000
"""Draws after which the error is looked at again."""


class Evidence(NamedTuple):
    """How well a detection is explained.

    Attributes
    ----------
    log_evidence
        Log of the prior's mean of the likelihood over its peak: for discs, the log prior
        probability that every seen joint lies in its own. −inf where no pose was found that
        explains what was seen.
    standard_error
        Of `log_evidence`; inf with −inf.
    """

    log_evidence: float
    standard_error: float


def evidence(
    model: PoseModel,
    frame: Estimate,
    *,
    key: jax.Array | int,
    candidate: int = 0,
    relative_error: float = 0.01,
    max_proposals: int = 1_000_000_000,
) -> dict[str, Evidence]:
    """Evidence under one candidate: of the whole body, and limb by limb.

    The body is the product of its groups; limbs of a group share lengths, so that a group is not
    the product of its limbs.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates.
    key
        Of all draws.
    candidate
        Which candidate.
    relative_error
        Draws go on until the relative standard error of every entry is below it.
    max_proposals
        Where this budget ends first, the standard errors say how far it got.

    Returns
    -------
    dict of Evidence
        Of the "body", of each group ("head", "arms", "legs") and of each limb alone.
    """
    observation = frame.posterior(model, CANDIDATES).observations[candidate]
    tables, problems = group_tables(model), limb_problems(observation)
    budget = Budget(max_proposals)
    found, goal = {}, relative_error / np.sqrt(len(GROUPS))

    def sampler(key: jax.Array, name: str, limbs: tuple[Limb, ...], rows: slice) -> StratifiedGroup:
        group = tables[name]._replace(builds=tables[name].builds[rows])
        thin = log_ratio_of(model, observation, limbs)
        return StratifiedGroup(key, name, group, problems[name][rows], thin)

    for index, (name, members) in enumerate(GROUPS.items()):
        words = jax.random.fold_in(key_of(key), index)
        found[name] = _estimate(sampler(words, name, members, slice(None)), goal, budget)
        for row, limb in enumerate(members):
            if len(members) == 1:
                found[limb.name] = found[name]
                continue
            alone = sampler(jax.random.fold_in(words, row), name, (limb,), slice(row, row + 1))
            found[limb.name] = _estimate(alone, relative_error, budget)
    groups = [found[name] for name in GROUPS]
    body = Evidence(
        sum(e.log_evidence for e in groups),
        float(np.sqrt(sum(e.standard_error**2 for e in groups))),
    )
    return {WHOLE_BODY: body, **found}


def _estimate(sampler: GroupSampler, goal: float, budget: Budget) -> Evidence:
    number = 0
    while True:
        number += STEP
        enough = sampler.more(number, budget)
        (rate,) = sampler.rates
        if not enough or rate.variance <= goal**2:
            return Evidence(rate.log_probability, float(np.sqrt(rate.variance)))
        # Binomial errors fall with the square root of the successes.
        number = max(number, int(sampler.held * min(rate.variance / goal**2, 4.0)) - STEP)
