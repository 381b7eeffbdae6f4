"""Exact draws from the mixture over a posterior's candidates.

Each candidate's evidence comes out of its own rejection, weighs it against the others, and decides
how many of the draws are its own.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from poseterior.inference.draws import (
    COMPLETE,
    IMPOSSIBLE,
    OUT_OF_BUDGET,
    Draws,
    KnownRoots,
    Progress,
    Sampler,
    joined,
)
from poseterior.inference.exact.device.group import device_groups
from poseterior.inference.exact.groups import StratifiedGroup, group_tables
from poseterior.inference.exact.naive import PriorBodies
from poseterior.inference.exact.problem import limb_problems, log_ratio_of
from poseterior.inference.exact.rates import Budget, GroupSampler, Pooled, Rate
from poseterior.inference.exact.reach import nearest_miss, out_of_reach
from poseterior.inference.resampling import shares
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import Observation
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import GROUPS

PILOTS = (64, 2000)
"""Draws of each root from which the roots are weighed, in two rounds, before the rest
is shared out."""
NEGLIGIBLE = 0.01
"""A root whose share is below this after the first round (known to an eighth) needs no
second."""
PILOT_PROPOSALS = 20_000_000
"""Proposals (some seconds) in which a root must make its first pilot draws."""
EVEN = 16
"""Every group gets so many-th part of its draws before any group gets the rest."""


def _strata(key: jax.Array, model: PoseModel, observation: Observation) -> list[GroupSampler]:
    tables = group_tables(model)
    problems = limb_problems(observation)
    return [
        StratifiedGroup(
            jax.random.fold_in(key, index),
            name,
            tables[name],
            problems[name],
            log_ratio_of(model, observation, GROUPS[name]),
        )
        for index, name in enumerate(GROUPS)
    ]


def _per_group(key: jax.Array, model: PoseModel, observation: Observation) -> list[GroupSampler]:
    return [PriorBodies(key, model, observation, tuple((name,) for name in GROUPS))]


def _whole_body(key: jax.Array, model: PoseModel, observation: Observation) -> list[GroupSampler]:
    return [PriorBodies(key, model, observation, (tuple(GROUPS),))]


ON_DEVICE = "rejection-device"
Proposal = Callable[[jax.Array, PoseModel, Observation], Sequence[GroupSampler]]
PROPOSALS: dict[str, Proposal] = {
    "rejection": _strata,
    "rejection-group": _per_group,
    "rejection-prior": _whole_body,
    ON_DEVICE: device_groups,
}
"""How exact rejection proposes, by the sampler's name: by strata; each group, or the
whole body, from the prior; by strata on the device that JAX computes on."""


@dataclass
class RootSampler:
    """Exact rejection under one root, and what has been drawn of it."""

    model: PoseModel
    observation: Observation
    samplers: Sequence[GroupSampler]

    def more(self, number: int, budget: Budget) -> bool:
        """Goes on until every group holds `number` draws; False where it cannot."""
        # Every group goes on, also when another one cannot, and none to the end before
        # all have some: where the budget ends first, there shall be as many whole
        # bodies as there can be.
        done = [
            sampler.more(target, budget)
            for target in (-(-number // EVEN), number)
            for sampler in self.samplers
        ]
        return all(done)

    @property
    def held(self) -> int:
        """Whole bodies held."""
        return min(sampler.held for sampler in self.samplers)

    def progress(self, number: int) -> float:
        """How much of `number` draws there is, from 0 to 1, all groups taken
        together."""
        held = sum(min(sampler.held, number) for sampler in self.samplers)
        return held / max(1, number * len(self.samplers))

    @property
    def rates(self) -> list[Rate | Pooled]:
        return [rate for sampler in self.samplers for rate in sampler.rates]

    @property
    def log_evidence(self) -> float:
        """Log of the prior's mean of the likelihood over its peak; -inf where no draw
        was accepted."""
        return sum(rate.log_probability for rate in self.rates)

    @property
    def log_evidence_se(self) -> float:
        """Standard error of `log_evidence`; infinite where no draw was accepted."""
        return math.sqrt(sum(rate.variance for rate in self.rates))

    def forget(self, number: int) -> None:
        """Lets go of the first `number` draws, which have gone elsewhere."""
        for sampler in self.samplers:
            sampler.forget(number)

    def poses(self, number: int) -> Pose:
        """The first `number` draws that are held."""
        poses = Pose.blank(number)
        self.fill(poses)
        return poses

    def fill(self, poses: Pose) -> None:
        """Writes the first draws that are held into poses `(n, ...)`."""
        if len(poses.length):
            for sampler in self.samplers:
                for name, draws in sampler.draws().items():
                    draws.fill(poses, GROUPS[name])


@dataclass(frozen=True)
class ExactRejection(Sampler):
    """Exact, independent draws from the mixture over a posterior's candidates, by one of
    `PROPOSALS`.

    Attributes
    ----------
    name, max_proposals
        As of a `Sampler`.
    chains
        Independent runs, each with a key and its share of the proposals of its own, so that
        diagnostics which compare chains have some.
    """

    name: str = "rejection"
    chains: int = 1

    def __post_init__(self) -> None:
        if self.name not in PROPOSALS:
            raise BadInput(
                f"there is no exact sampler {self.name!r}; choose from {', '.join(PROPOSALS)}"
            )

    def _blocks(
        self,
        posterior: Posterior,
        key: jax.Array,
        number: int,
        block: int,
        progress: Progress | None,
    ) -> Iterator[Draws]:
        if self.chains != 1:
            yield self._several(posterior, key, number, progress)
            return
        budget = Budget(self.max_proposals)
        samplers = root_samplers(posterior, key, self.name)
        prior = posterior.log_weights
        log_weight = _weigh(samplers, prior, number, budget)
        seed = jax.random.key_data(jax.random.fold_in(key, len(samplers)))
        rng = np.random.default_rng(np.asarray(seed))
        counts = rng.multinomial(number, _shares(log_weight))
        given = 0
        for own in _shared_out(counts, block, rng):
            report = _reporter(samplers, own, given, number, progress)
            enough = _fill(samplers, own, budget, report)
            held = [min(int(count), one.held) for count, one in zip(own, samplers, strict=True)]
            given += sum(held)
            status, sentence = COMPLETE, ""
            if not enough:
                status, sentence = _explain(samplers, posterior, budget, given, number)
            cost = {
                "num_proposals": budget.spent,
                "acceptance_rate": given / max(budget.spent, 1),
            }
            draws = _drawn(posterior, samplers, held, prior, rng)
            yield replace(
                draws, attributes=cost | draws.attributes, status=status, sentence=sentence
            )
            if not enough:
                return
            for one, count in zip(samplers, held, strict=True):
                one.forget(count)

    def _several(
        self, posterior: Posterior, key: jax.Array, number: int, progress: Progress | None
    ) -> Draws:
        if not 1 <= self.chains <= number:
            raise BadInput(
                f"{number:,} samples cannot be in {self.chains} chains; choose from 1 to one a"
                " sample"
            )
        each = -(-number // self.chains)
        one = replace(self, chains=1, max_proposals=max(1, self.max_proposals // self.chains))
        runs = []
        for chain, own in enumerate(jax.random.split(key, self.chains)):

            def report(made: int, _wanted: int, done: int = chain * each) -> None:
                if progress:
                    progress(done + made, self.chains * each)

            runs.append(one.draw(posterior, own, each, report))
        return joined(runs)


def _drawn(
    posterior: Posterior,
    samplers: list[RootSampler],
    held: list[int],
    prior: np.ndarray,
    rng: np.random.Generator,
) -> Draws:
    """The first draws of each candidate, so many as are `held`, in random order, and what is known
    of the candidates by now."""
    poses, order = Pose.blank(sum(held)), rng.permutation(sum(held))
    ends = np.cumsum(held)
    for one, start, end in zip(samplers, ends - held, ends, strict=True):
        one.fill(Pose(*(column[start:end] for column in poses)))
    evidences = np.array([(one.log_evidence, one.log_evidence_se) for one in samplers])
    evidence, error = _mixture_evidence(prior, *evidences.T)
    return Draws(
        posterior,
        points=np.repeat(np.arange(len(samplers)), held)[order],
        poses=in_chunks(lambda rows: Pose(*(column.take(rows, axis=0) for column in poses)), order)
        if len(order)
        else poses,
        faults=Faults.none(len(order)),
        known=KnownRoots(
            np.arange(len(samplers)),
            _shares(_log_weights(samplers, prior)),
            functools.partial(_one_evidence, evidences),
        ),
        attributes={"log_evidence": evidence, "log_evidence_se": error},
    )


def _one_evidence(evidences: np.ndarray, rows: np.ndarray) -> tuple[float, float]:
    """That of the one candidate in `rows`."""
    (row,) = rows
    log_evidence, error = evidences[row].tolist()
    return log_evidence, error


def _shared_out(counts: np.ndarray, block: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """How many draws of each root are in each block: as if all draws stood in random
    order."""
    while counts.sum() > block:
        own = rng.multivariate_hypergeometric(counts, block)
        yield own
        counts = counts - own
    yield counts


def root_samplers(posterior: Posterior, key: jax.Array, sampler: str) -> list[RootSampler]:
    """A sampler for each of the posterior's roots, with keys of their own."""
    propose = PROPOSALS[sampler]
    model = posterior.model
    return [
        RootSampler(model, one, propose(jax.random.fold_in(key, index), model, one))
        for index, one in enumerate(posterior.observations)
    ]


def _weigh(
    samplers: list[RootSampler], prior: np.ndarray, number: int, budget: Budget
) -> np.ndarray:
    """Log weights of the roots from pilot draws: few of each, more of those that turn
    out to matter.

    A root under which draws are very rare is not waited for: what its allowance brought
    is its evidence. Only where no root brings any draw do the allowances grow, to the
    end of the budget.
    """
    if len(samplers) == 1:
        return prior
    first, second = (min(pilot, number) for pilot in PILOTS)
    allowance = PILOT_PROPOSALS
    log_weight = np.full(len(samplers), -np.inf)
    while not np.isfinite(log_weight).any() and budget.spent < budget.proposals:
        spent = budget.spent
        for index in np.flatnonzero(np.isfinite(prior)):
            samplers[index].more(first, Budget(allowance, whole=budget))
        log_weight = _log_weights(samplers, prior)
        allowance *= 2
        if budget.spent == spent:
            break  # every root has been given up
    for index in np.flatnonzero(_shares(log_weight) > NEGLIGIBLE):
        samplers[index].more(second, Budget(allowance, whole=budget))
    return _log_weights(samplers, prior)


def _log_weights(samplers: list[RootSampler], prior: np.ndarray) -> np.ndarray:
    return prior + np.array([one.log_evidence for one in samplers])


def _shares(log_weight: np.ndarray) -> np.ndarray:
    """Weights that sum to one; where nothing has any, the first root (best
    reprojection) has all."""
    if not np.isfinite(log_weight).any():
        return np.eye(len(log_weight))[0]
    return shares(log_weight)


def _fill(
    samplers: list[RootSampler], counts: np.ndarray, budget: Budget, report: Callable[[], None]
) -> bool:
    """Goes on until every root holds its count of draws; False where one cannot."""
    budget.watch = report
    done = [
        one.more(count, budget)
        for one, count in zip(samplers, counts.tolist(), strict=True)
        if count
    ]
    report()
    return all(done)


def _reporter(
    samplers: list[RootSampler],
    counts: np.ndarray,
    given: int,
    wanted: int,
    progress: Progress | None,
) -> Callable[[], None]:
    """What says how far a block is, after `given` draws of the `wanted`."""

    def report() -> None:
        if progress:
            pairs = zip(samplers, counts.tolist(), strict=True)
            progress(given + int(sum(one.progress(count) * count for one, count in pairs)), wanted)

    return report


def _mixture_evidence(
    prior: np.ndarray, log_evidence: np.ndarray, errors: np.ndarray
) -> tuple[float, float]:
    """Log evidence of the mixture and its standard error, the candidates' errors being
    independent."""
    log_terms = prior + log_evidence
    if not np.isfinite(log_terms).any():
        return -math.inf, math.inf
    shares = _shares(log_terms)
    errors = np.where(shares > 0, errors, 0.0)
    return float(np.logaddexp.reduce(log_terms)), float(np.sqrt(np.sum((shares * errors) ** 2)))


def _explain(
    samplers: list[RootSampler], posterior: Posterior, budget: Budget, held: int, wanted: int
) -> tuple[str, str]:
    """Why there are fewer draws than wanted, in a sentence that names the joint or the
    group."""
    model = posterior.model
    where = posterior.detection.where
    unreachable = [
        out_of_reach(model, limb_problems(observation)) for observation in posterior.observations
    ]
    if all(unreachable):
        scale = float(posterior.candidates[0].camera.scale)
        return IMPOSSIBLE, f"no pose explains {where}: {unreachable[0][0].sentence(scale)}"
    index = unreachable.index([])
    observation = posterior.observations[index]
    slowest = min(samplers[index].samplers, key=lambda sampler: sampler.held)
    name = slowest.slowest
    scale = float(observation.root.camera.scale)
    miss = nearest_miss(model, observation, name).sentence(scale)
    if all(any(group.impossible for group in one.samplers) for one in samplers):
        return IMPOSSIBLE, (
            f"no pose explains {where}: the bounds leave no possible {name} for their detections"
            f" ({miss}); mend or drop one"
        )
    counts = f"{held} of {wanted} draws after {budget.spent:,} proposals for {where}"
    if slowest.given_up:
        return OUT_OF_BUDGET, (
            f"{counts}: no possible {name} explain their detections ({miss}); mend or drop one"
        )
    advice = "ask for fewer samples, allow more proposals, or mend a detection"
    return OUT_OF_BUDGET, f"{counts}: the {name} stand in the way ({miss}); {advice}"
