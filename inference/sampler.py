"""The one face of all samplers: `sample(model, frame, sampler=…, key=…, num_samples=…)` → `Result`.

Exact rejection draws from the mixture over the frame's candidates: each candidate's evidence comes
out of its own rejection, weighs it against the others, and decides how many of the draws are its
own."""

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np

from inference.baselines.catalogue import BASELINES, sample_baseline
from inference.candidates import Frame
from inference.exact.naive import PROPOSALS
from inference.exact.problem import Draws, Group, build_groups
from inference.exact.rates import Budget, GroupSampler, Pooled, Rate
from inference.exact.reach import OutOfReach, nearest_miss, out_of_reach
from inference.results import (
    COMPLETE,
    IMPOSSIBLE,
    OUT_OF_BUDGET,
    CandidateDraws,
    Result,
    build_tree,
    key_words,
)
from probmodel.failures import BadInput
from probmodel.model import PoseModel
from probmodel.observation import Observation
from probmodel.skeleton import GROUPS, NUM_LENGTHS, NUM_LOWER, NUM_UPPER

SAMPLERS = tuple(PROPOSALS)
"""Samplers by name: exact rejection, the fastest way on the device at hand; by strata; pruned; each
group, and the whole body, from the prior."""
PILOTS = (64, 2000)
"""Draws of each candidate from which the candidates are weighed, in two rounds, before the rest is
shared out."""
NEGLIGIBLE = 0.01
"""A candidate whose share is below this after the first round (known to an eighth) needs no
second."""
PILOT_PROPOSALS = 20_000_000
"""Proposals (some seconds) in which a candidate must make its first pilot draws."""
EVEN = 16
"""Every group gets so many-th part of its draws before any group gets the rest."""
MAX_PROPOSALS = 1_000_000_000
Progress = Callable[[int, int], None]


@dataclass
class CandidateSampler:
    """Exact rejection under one candidate, and what has been drawn of it."""

    model: PoseModel
    observation: Observation
    samplers: Sequence[GroupSampler]

    def more(self, number: int, budget: Budget) -> bool:
        """Goes on until every group holds `number` draws; False where it cannot."""
        # Every group goes on, also when another one cannot, and none to the end before all have
        # some: where the budget ends first, there shall be as many whole bodies as there can be.
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
        """How much of `number` draws there is, from 0 to 1, all groups taken together."""
        return sum(min(sampler.held, number) for sampler in self.samplers) / max(
            1, number * len(self.samplers)
        )

    @functools.cached_property
    def groups(self) -> dict[str, Group]:
        """The groups' problems, for explanations."""
        return build_groups(self.model, self.observation)

    @property
    def rates(self) -> list[Rate | Pooled]:
        return [rate for sampler in self.samplers for rate in sampler.rates]

    @property
    def log_evidence(self) -> float:
        """Log prior probability that every seen joint lies in its disc; -inf where no draw was
        accepted."""
        return -math.inf if not self.held else sum(rate.log_probability for rate in self.rates)

    @property
    def log_evidence_se(self) -> float:
        """Standard error of `log_evidence`."""
        return math.inf if not self.held else math.sqrt(sum(rate.variance for rate in self.rates))

    def bodies(self, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first `number` draws as lengths `(n, 5)`, upper `(n, 5, 3)` and lower `(n, 4, 3)`
        directions."""
        length = np.empty((number, NUM_LENGTHS))
        upper, lower = np.empty((number, NUM_UPPER, 3)), np.empty((number, NUM_LOWER, 3))
        if number:
            draws = {
                name: part for sampler in self.samplers for name, part in sampler.draws().items()
            }
            for name, limbs in GROUPS.items():
                _place(draws[name], limbs, number, length, upper, lower)
        return length, upper, lower


def _place(
    draws: Draws,
    limbs: tuple,
    number: int,
    length: np.ndarray,
    upper: np.ndarray,
    lower: np.ndarray,
) -> None:
    for column, bone in enumerate(limbs[0].bones):
        length[:, bone.length_group] = draws.length[:number, column]
    for row, limb in enumerate(limbs):
        upper[:, limb.upper] = draws.upper[:number, row]
        if limb.lower is not None:
            lower[:, limb.lower] = draws.lower[:number, row]


class Mixture(NamedTuple):
    """Draws from the mixture over a frame's candidates, one part each, before they are named and
    put in order; what they cost and are worth as `attributes`; `status` and `sentence` as in
    `Result`; `rng` for what remains random."""

    parts: list[CandidateDraws]
    attributes: dict[str, Any]
    status: str
    sentence: str
    rng: np.random.Generator


def sample(
    model: PoseModel,
    frame: Frame,
    *,
    key: jax.Array,
    sampler: str = "rejection",
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> Result:
    """Draws `num_samples` poses from the posterior over a frame's candidates.

    `max_proposals` bounds the work; where it ends first, or where no pose is possible, the result
    says so in `status` and `sentence` and holds the draws that were made. `progress(done, wanted)`
    is called now and then. A baseline of `inference.baselines.catalogue` draws chains under one
    candidate, started in exact draws. Raises `BadInput` on an unknown sampler or a number of
    samples below one."""
    if sampler in BASELINES and num_samples > 0:
        starts = functools.partial(sample, model, frame, key=jax.random.fold_in(key, 0))
        return sample_baseline(
            model,
            frame,
            starts,
            key=key,
            sampler=sampler,
            num_samples=num_samples,
            max_evaluations=max_proposals,
            progress=progress,
        )
    started = time.perf_counter()
    mixture = draw_mixture(model, frame, key, sampler, num_samples, max_proposals, progress)
    mixture.attributes["wall_time_s"] = time.perf_counter() - started
    attributes = {**mixture.attributes, "status": mixture.status}
    tree = build_tree(model, frame, mixture.parts, attributes, mixture.rng)
    return Result(tree, mixture.status, mixture.sentence)


def draw_mixture(
    model: PoseModel,
    frame: Frame,
    key: jax.Array,
    sampler: str = "rejection",
    num_samples: int = 10_000,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> Mixture:
    """What `sample` does, short of building its tree."""
    if sampler not in SAMPLERS:
        raise BadInput(
            f"there is no sampler {sampler!r}; choose one of {', '.join([*SAMPLERS, *BASELINES])}"
        )
    if num_samples < 1:
        raise BadInput(f"the number of samples must be at least 1, not {num_samples}")
    budget = Budget(max_proposals)
    samplers = candidate_samplers(model, frame, key, sampler)
    prior = log_prior_weights(frame)
    log_weight = _weigh(samplers, prior, num_samples, budget)
    rng = np.random.default_rng(
        np.asarray(jax.random.key_data(jax.random.fold_in(key, len(samplers))))
    )
    counts = rng.multinomial(num_samples, _shares(log_weight))
    enough = _fill(samplers, counts, budget, progress)
    held = [
        min(int(count), candidate.held) for count, candidate in zip(counts, samplers, strict=True)
    ]
    shares = _shares(_log_weights(samplers, prior))
    parts = [
        CandidateDraws(
            *candidate.bodies(number),
            candidate.log_evidence,
            candidate.log_evidence_se,
            float(share),
        )
        for candidate, number, share in zip(samplers, held, shares, strict=True)
    ]
    evidence, error = _mixture_evidence(prior, parts)
    attributes = {
        "sampler": sampler,
        "seed": key_words(key),
        "num_samples": num_samples,
        "num_proposals": budget.spent,
        "acceptance_rate": sum(held) / max(budget.spent, 1),
        "log_evidence": evidence,
        "log_evidence_se": error,
    }
    status, sentence = (
        (COMPLETE, "") if enough else _explain(samplers, frame, budget, sum(held), num_samples)
    )
    return Mixture(parts, attributes, status, sentence, rng)


def candidate_samplers(
    model: PoseModel, frame: Frame, key: jax.Array, sampler: str
) -> list[CandidateSampler]:
    """A sampler for each of the frame's candidates, with keys of their own."""
    observations = [frame.observation(candidate) for candidate in frame.candidates]
    return [
        CandidateSampler(
            model,
            observation,
            PROPOSALS[sampler](jax.random.fold_in(key, index), model, observation),
        )
        for index, observation in enumerate(observations)
    ]


def log_prior_weights(frame: Frame) -> np.ndarray:
    """`(candidates,)`: what weighs a candidate beside its evidence: equal prior mass, the
    likelihood of the seen torso joints, and the density of the limbs' discs, which depends on the
    candidate's scale (§ 6 of the model).

    Where no candidate has all seen torso joints inside their discs, the torso's likelihood says
    nothing and is left out. Normalised."""
    if len(frame.candidates) == 1:
        return np.zeros(1)
    torso = np.array([frame.log_torso_likelihood(candidate) for candidate in frame.candidates])
    discs = np.array(
        [float(frame.observation(candidate).log_disc_density) for candidate in frame.candidates]
    )
    log_weight = discs + (torso if np.isfinite(torso).any() else 0.0)
    return log_weight - np.logaddexp.reduce(log_weight)


def _weigh(
    samplers: list[CandidateSampler], prior: np.ndarray, number: int, budget: Budget
) -> np.ndarray:
    """Log weights of the candidates from pilot draws: few of each, more of those that turn out to
    matter.

    A candidate under which draws are very rare is not waited for: what its allowance brought is its
    evidence. Only where no candidate brings any draw do the allowances grow, to the end of the
    budget."""
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
            break  # every candidate has been given up
    for index in np.flatnonzero(_shares(log_weight) > NEGLIGIBLE):
        samplers[index].more(second, Budget(allowance, whole=budget))
    return _log_weights(samplers, prior)


def _log_weights(samplers: list[CandidateSampler], prior: np.ndarray) -> np.ndarray:
    return prior + np.array([candidate.log_evidence for candidate in samplers])


def _shares(log_weight: np.ndarray) -> np.ndarray:
    """Weights that sum to one; where nothing has any, the first candidate (best reprojection) has
    all."""
    if not np.isfinite(log_weight).any():
        return np.eye(len(log_weight))[0]
    share = np.exp(log_weight - log_weight.max())
    return share / share.sum()


def _fill(
    samplers: list[CandidateSampler], counts: np.ndarray, budget: Budget, progress: Progress | None
) -> bool:
    wanted = int(counts.sum())

    def report() -> None:
        done = sum(
            candidate.progress(int(count)) * count
            for candidate, count in zip(samplers, counts, strict=True)
        )
        if progress:
            progress(int(done), wanted)

    budget.watch = report
    done = [
        candidate.more(int(count), budget)
        for candidate, count in zip(samplers, counts, strict=True)
        if count
    ]
    report()
    return all(done)


def _mixture_evidence(prior: np.ndarray, parts: list[CandidateDraws]) -> tuple[float, float]:
    """Log evidence of the mixture and its standard error, the candidates' errors being
    independent."""
    log_terms = prior + np.array([part.log_evidence for part in parts])
    if not np.isfinite(log_terms).any():
        return -math.inf, math.inf
    errors = np.array(
        [
            part.log_evidence_se if share > 0 else 0.0
            for part, share in zip(parts, _shares(log_terms), strict=True)
        ]
    )
    return float(np.logaddexp.reduce(log_terms)), float(
        np.sqrt(np.sum((_shares(log_terms) * errors) ** 2))
    )


def _explain(
    samplers: list[CandidateSampler], frame: Frame, budget: Budget, held: int, wanted: int
) -> tuple[str, str]:
    """Why there are fewer draws than wanted, in a sentence that names the joint or the group."""
    unreachable = [_first_out_of_reach(candidate) for candidate in samplers]
    if all(unreachable):
        joint = unreachable[0]
        assert joint is not None
        return IMPOSSIBLE, f"no pose explains {frame.detection.where}: " + joint.sentence(
            float(frame.candidates[0].camera.scale)
        )
    index = unreachable.index(None)
    slowest = min(samplers[index].samplers, key=lambda sampler: sampler.held)
    name = slowest.slowest
    miss = nearest_miss(name, samplers[index].groups[name]).sentence(
        float(frame.candidates[index].camera.scale)
    )
    counts = (
        f"{held} of {wanted} draws after {budget.spent:,} proposals for {frame.detection.where}"
    )
    if slowest.hopeless:
        return (
            OUT_OF_BUDGET,
            f"{counts}: no possible {name} explain their detections ({miss}); mend or drop one",
        )
    advice = "ask for fewer samples, allow more proposals, or mend a detection"
    return OUT_OF_BUDGET, f"{counts}: the {name} stand in the way ({miss}); {advice}"


def _first_out_of_reach(candidate: CandidateSampler) -> OutOfReach | None:
    found = [
        joint for name, group in candidate.groups.items() for joint in out_of_reach(name, group)
    ]
    return found[0] if found else None
