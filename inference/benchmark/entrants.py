"""Everybody who is held to a frozen target, each by one name, run for so many evaluations or
seconds of the processor: exact draws, the product's baselines, external samplers.

    outcome = entrant("emcee").run(load("arm"), PRIOR, Allowance(seconds=10))

Markov chains start twice: in exact draws, which is a gift that nobody has, and from the prior:
draws of it, led downhill at the sampler's expense until they are inside the walls."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import jax
import numpy as np

from poseterior.inference.baselines.catalogue import BASELINES
from poseterior.inference.baselines.run import Allowance, Baseline, check_packages, first_step
from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark.draws import DrawBlock, draw_roots, exact_points
from poseterior.inference.benchmark.external.entries import (
    CLOCK,
    ExternalSampler,
    SamplerRun,
    external_sampler,
    external_samplers,
)
from poseterior.inference.benchmark.programs import estimate, frozen_model, in_jax
from poseterior.inference.benchmark.root import BoxedRoot, GivenRoot
from poseterior.inference.benchmark.submission import Submission
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.root_priors import CANDIDATES

EXACT_ENGINE, GIFT, PRIOR = "exact", "exact draws", "prior"
"""The engine, and the two starts of Markov chains."""
TIMED_DRAWS, ROOTED_DRAWS = 10_000, 200
"""Exact draws that are timed: under one root, and with an uncertain one."""
MOST_DRAWS = 8_000
"""Draws of a baseline that are handed over at most, taken evenly along its paths."""
DOWNHILL_STEP = 0.3
"""Of the walk downhill, in R^d."""
DOWNHILL_STEPS = 4000
"""Of the walk downhill."""
ANY_DENSITY = ("emcee", "emcee-de", "aies", "ess", "random-walk", "sa")
"""Baselines that ask for a density on R^d and nothing else. The others shrink discs (smc, nss,
nautilus) or soften their rims (nuts, hmc), and know of one root only."""
ENTRANT_SEED = 3


class Entrant(ABC):
    """One who is held to a target."""

    @property
    def note(self) -> str:
        """How it is set up."""
        return ""

    @property
    def starts(self) -> tuple[str, ...]:
        """Those that it may be run from; one without a name where it needs none."""
        return ("",)

    def require(self) -> None:  # noqa: B027 — most need nothing
        """Raises `BadInput` where a package that it needs is not installed."""

    def cannot(self, target: FrozenTarget) -> str:
        """Why it is not run on a target; empty where it is."""
        return ""

    @abstractmethod
    def run(
        self, target: FrozenTarget, start: str, allowance: Allowance, seed: int = ENTRANT_SEED
    ) -> SamplerRun | None:
        """What it brings for so much, from one of its `starts`; compilation is not counted. None
        where it brought no draws: it found no start, or was not through."""


def entrants() -> tuple[str, ...]:
    """Everybody's name. Raises as `external_samplers`."""
    return (EXACT_ENGINE, *BASELINES, *external_samplers())


def entrant(name: str) -> Entrant:
    """The one of that name. Raises `BadInput` where there is none, and as `external_sampler`."""
    if name == EXACT_ENGINE:
        return ExactEngine()
    if name in BASELINES:
        return BaselineEntrant(name, BASELINES[name])
    if name in external_samplers():
        return ExternalEntrant(name, external_sampler(name))
    raise BadInput(f"there is no sampler {name!r}; choose from {', '.join(entrants())}")


@dataclass(frozen=True)
class ExternalEntrant(Entrant):
    """An external sampler; from where it starts is its own affair."""

    name: str
    sampler: ExternalSampler

    @property
    def note(self) -> str:
        """As its own."""
        return self.sampler.note

    def require(self) -> None:
        """As of an `Entrant`."""
        self.sampler.require(self.name)

    def run(
        self, target: FrozenTarget, start: str, allowance: Allowance, seed: int = ENTRANT_SEED
    ) -> SamplerRun | None:
        """As of an `Entrant`."""
        return self.sampler.run(self.name, target, seed, allowance)


@dataclass(frozen=True)
class ExactEngine(Entrant):
    """The engine's own draws, always as many as `TIMED_DRAWS`, whatever is allowed."""

    def run(
        self, target: FrozenTarget, start: str, allowance: Allowance, seed: int = ENTRANT_SEED
    ) -> SamplerRun | None:
        """As of an `Entrant`. How long it takes to set up is what one draw alone takes."""
        number = TIMED_DRAWS if isinstance(target.root, GivenRoot) else ROOTED_DRAWS
        for several in (number, 1):  # compiled before the clock runs
            _drawn(target, several)
        started = CLOCK()
        _drawn(target, 1)
        alone = CLOCK() - started
        started = CLOCK()
        block, evaluations = _drawn(target, number)
        seconds = CLOCK() - started
        submission = Submission(
            block.points[None],
            len(block.points),
            block.log_evidence,
            block.log_evidence_se,
            evaluations,
            seconds,
        )
        return SamplerRun(submission, kept=max(0.0, 1 - alone / seconds))


@dataclass(frozen=True)
class BaselineEntrant(Entrant):
    """A baseline of the product. What it is told is a density, not which pose a point is."""

    name: str
    baseline: Baseline

    @property
    def note(self) -> str:
        """As of the baseline."""
        return self.baseline.note

    def require(self) -> None:
        """As of an `Entrant`."""
        check_packages(self.name, self.baseline)

    @property
    def starts(self) -> tuple[str, ...]:
        """Both where it is started at all."""
        return (PRIOR, GIFT) if self.baseline.starts else ("",)

    def cannot(self, target: FrozenTarget) -> str:
        """Why it is not run on a target; empty where it is."""
        if self.name in ANY_DENSITY:
            return ""
        if not isinstance(target.root, GivenRoot):
            return "it knows of one torso and camera only"
        if self.baseline.discs and target.law != "disc":
            return "it shrinks discs, and soft walls are none"
        return ""

    def run(
        self, target: FrozenTarget, start: str, allowance: Allowance, seed: int = ENTRANT_SEED
    ) -> SamplerRun | None:
        """As of an `Entrant`."""
        begun = CLOCK()
        found = self._starts(target, start, allowance, seed)
        if found is None:
            return None
        starts, spent = found
        before = CLOCK() - begun if start == PRIOR else 0.0
        key = jax.random.key(seed)
        method = self.baseline.build(in_jax(target), jax.random.fold_in(key, 1), starts)
        first_step(method, CLOCK)
        seconds = before
        finished = False
        while not finished and allowance.allows(method.evaluations + spent, seconds):
            begun = CLOCK()
            finished = not method.more()
            seconds += CLOCK() - begun
        drawn = method.drawn(jax.random.fold_in(key, 3)).thinned(MOST_DRAWS)
        if not drawn.points.shape[1]:
            return None
        submission = Submission(
            drawn.points,
            drawn.points.shape[0] * drawn.points.shape[1],
            drawn.log_evidence,
            drawn.log_evidence_se,
            float(method.evaluations + spent),
            seconds,
        )
        steps = int(drawn.info["steps"])
        # Nested samplers have their draws at the end, however much of the work these took.
        kept = drawn.info.get("kept", 1.0) * (1 - before / seconds) if steps > 1 else 0.0
        return SamplerRun(submission, self.baseline.starts if start == GIFT else 0, kept, steps)

    def _starts(
        self, target: FrozenTarget, start: str, allowance: Allowance, seed: int
    ) -> tuple[np.ndarray, int] | None:
        """Starts `(n, d)`, and the evaluations that they cost; None where none were found."""
        wanted = self.baseline.starts
        if not wanted:
            return np.empty((0, target.dim)), 0
        if start == GIFT:
            return exact_points(target, wanted), 0
        rng = np.random.default_rng(seed)
        starts, spent = downhill(target, rng, wanted, allowance)
        if not len(starts):
            return None
        starts, more = filled(target, rng, starts, wanted)
        return starts, spent + more


def downhill(
    target: FrozenTarget, rng: np.random.Generator, wanted: int, allowance: Allowance
) -> tuple[np.ndarray, int]:
    """Starts inside the support from draws of the prior.

    Parameters
    ----------
    target
        Whose support.
    rng
        Of all it does.
    wanted
        How many starts.
    allowance
        What they may cost.

    Returns
    -------
    tuple
        Starts `(n, d)`, from twice as many draws by steps that are taken where the misfit does not
        rise, until as many as are `wanted` are inside, or those that are when its time is up; and
        the evaluations that this cost.
    """
    begun = CLOCK()
    points = target.prior_points(rng, 2 * wanted)
    misfit = target.misfit(points)
    spent = len(points)
    for _ in range(DOWNHILL_STEPS):
        outside = np.flatnonzero(misfit > 1)
        if len(points) - len(outside) >= wanted or not allowance.allows(spent, CLOCK() - begun):
            break
        scale = DOWNHILL_STEP * 10 ** rng.uniform(-2, 0.5, (len(outside), 1))
        proposal = points[outside] + scale * rng.normal(size=(len(outside), target.dim))
        found = target.misfit(proposal)
        better = found <= misfit[outside]
        points[outside[better]] = proposal[better]
        misfit[outside[better]] = found[better]
        spent += len(outside)
    return points[misfit <= 1][:wanted], spent


def filled(
    target: FrozenTarget, rng: np.random.Generator, starts: np.ndarray, wanted: int
) -> tuple[np.ndarray, int]:
    """`(wanted, d)` starts from `(n, d)`, and the evaluations that this cost. Where they are fewer,
    others lie beside them, as near as it takes to be inside: no ensemble can do anything with
    walkers in one place."""
    points = starts[np.arange(wanted) % len(starts)]
    outside = np.arange(len(starts), wanted)
    scale = DOWNHILL_STEP
    spent = 0
    while len(outside):
        beside = points[outside] + scale * rng.normal(size=(len(outside), target.dim))
        inside = target.misfit(beside) <= 1
        points[outside[inside]] = beside[inside]
        spent += len(outside)
        outside = outside[~inside]
        scale /= 2
    return points, spent


def _drawn(target: FrozenTarget, number: int) -> tuple[DrawBlock, float]:
    """Exact draws, always with the same key, and how many proposals they took, where that is
    known."""
    if isinstance(target.root, BoxedRoot):
        return draw_roots(target, target.root, jax.random.key(2), number), math.nan
    posterior = estimate(target).posterior(frozen_model(), CANDIDATES)
    found = ExactRejection().draw(posterior, jax.random.key(2), number)
    points = Target.of(posterior).points_of(found.poses)
    block = DrawBlock(points, found.log_evidence, found.log_evidence_se)
    return block, float(found.attributes["num_proposals"])
