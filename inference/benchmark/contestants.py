"""Everybody who is held to a frozen target, run for so many evaluations or seconds of the
processor: exact draws, the product's baselines, guests.

    outcome = contestant(load("arm"), "emcee", PRIOR, Allowance(seconds=10))

Markov chains start twice: in exact draws, which is a gift that nobody has, and from the prior:
draws of it, led downhill at the sampler's expense until they are inside the walls."""

import importlib.util
import math

import jax
import numpy as np

from poseterior.inference.baselines.catalogue import BASELINES
from poseterior.inference.baselines.run import Allowance, check_packages, first_step
from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark.draws import DrawBlock, draw_roots, exact_points
from poseterior.inference.benchmark.guests import GUESTS
from poseterior.inference.benchmark.guests.graded import CLOCK, Outcome
from poseterior.inference.benchmark.programs import estimate, frozen_model, in_jax
from poseterior.inference.benchmark.root import BoxedRoot, GivenRoot
from poseterior.inference.benchmark.submission import Submission
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.probmodel.failures import BadInput, installing
from poseterior.probmodel.root_priors import CANDIDATES

EXACT, GIFT, PRIOR = "exact", "exact draws", "prior"
"""The engine, and the two starts of Markov chains."""
DRAWS, ROOTED = 10_000, 200
"""Exact draws that are timed: under one root, and with an uncertain one."""
MOST = 8_000
"""Draws of a baseline that are handed over at most, taken evenly along its paths."""
STEP = 0.3
"""Of the walk downhill, in R^d."""
PATIENCE = 4000
"""Most steps of the walk downhill."""
ANY_DENSITY = ("emcee", "emcee-de", "aies", "ess", "random-walk", "sa")
"""Baselines that ask for a density on R^d and nothing else. The others shrink discs (smc, nss,
nautilus) or soften their rims (nuts, hmc), and know of one root only."""


def cannot(target: FrozenTarget, name: str) -> str:
    """Why a sampler is not run on a target; empty where it is.

    Raises
    ------
    BadInput
        On a sampler that does not exist, or whose package is not installed.
    """
    check_name(name)
    if name not in BASELINES or name in ANY_DENSITY:
        return ""
    if not isinstance(target.root, GivenRoot):
        return "it knows of one torso and camera only"
    if BASELINES[name].discs and target.law != "disc":
        return "it shrinks discs, and soft walls are none"
    return ""


def check_name(name: str) -> None:
    """Raises `BadInput` on a sampler that does not exist, or whose package is not installed."""
    if name in BASELINES:
        check_packages(name, BASELINES[name])
    elif name in GUESTS:
        package, extra = GUESTS[name].package, GUESTS[name].extra
        if package and importlib.util.find_spec(package) is None:
            raise BadInput(
                f"the sampler {name} is not installed; {installing(extra)}; or leave it out"
            )
    elif name != EXACT:
        known = ", ".join((EXACT, *BASELINES, *GUESTS))
        raise BadInput(f"there is no sampler {name!r}; choose from {known}")


def starts_of(name: str) -> tuple[str, ...]:
    """The starts that a sampler may be run from."""
    return (PRIOR, GIFT) if name in BASELINES and BASELINES[name].starts else ("",)


def contestant(
    target: FrozenTarget, name: str, start: str, allowance: Allowance, seed: int = 3
) -> Outcome | None:
    """What a sampler brings for so much; compilation is not counted.

    Parameters
    ----------
    target
        What it is to draw from.
    name
        `EXACT`, or a key of `BASELINES` or `GUESTS`.
    start
        One of `starts_of(name)`.
    allowance
        Evaluations, or seconds of the processor. `EXACT` always draws as many as `DRAWS`.
    seed
        Of all it does.

    Returns
    -------
    Outcome or None
        None where it brought no draws: it found no start, or was not through.

    Raises
    ------
    BadInput
        As `check_name`.
    """
    check_name(name)
    if name == EXACT:
        return _exact(target)
    if name in GUESTS:
        return GUESTS[name].run(target, seed, allowance)
    return _baseline(target, name, start, allowance, seed)


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
    for _ in range(PATIENCE):
        outside = np.flatnonzero(misfit > 1)
        if len(points) - len(outside) >= wanted or not allowance.allows(spent, CLOCK() - begun):
            break
        scale = STEP * 10 ** rng.uniform(-2, 0.5, (len(outside), 1))
        proposal = points[outside] + scale * rng.normal(size=(len(outside), target.dim))
        found = target.misfit(proposal)
        better = found <= misfit[outside]
        points[outside[better]], misfit[outside[better]] = proposal[better], found[better]
        spent += len(outside)
    return points[misfit <= 1][:wanted], spent


def filled(
    target: FrozenTarget, rng: np.random.Generator, starts: np.ndarray, wanted: int
) -> tuple[np.ndarray, int]:
    """`(wanted, d)` starts from `(n, d)`, and the evaluations that this cost. Where they are fewer,
    others lie beside them, as near as it takes to be inside: no ensemble can do anything with
    walkers in one place."""
    points = starts[np.arange(wanted) % len(starts)]
    outside, scale, spent = np.arange(len(starts), wanted), STEP, 0
    while len(outside):
        beside = points[outside] + scale * rng.normal(size=(len(outside), target.dim))
        inside = target.misfit(beside) <= 1
        points[outside[inside]] = beside[inside]
        spent, outside, scale = spent + len(outside), outside[~inside], scale / 2
    return points, spent


def _exact(target: FrozenTarget) -> Outcome:
    """The engine's own draws, everything compiled before the clock runs. How long it takes to set
    up is what one draw alone takes."""
    number = DRAWS if isinstance(target.root, GivenRoot) else ROOTED
    for several in (number, 1):
        _drawn(target, several)
    started = CLOCK()
    _drawn(target, 1)
    alone = CLOCK() - started
    started = CLOCK()
    block, evaluations = _drawn(target, number)
    seconds = CLOCK() - started
    evidence = block.log_evidence, block.log_evidence_se
    points = block.points[None]
    submission = Submission(points, points.shape[1], *evidence, evaluations, seconds)
    return Outcome(submission, kept=max(0.0, 1 - alone / seconds))


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


def _baseline(
    target: FrozenTarget, name: str, start: str, allowance: Allowance, seed: int
) -> Outcome | None:
    """A baseline from one of its starts. What it is told is a density, not which pose a point
    is."""
    baseline, key = BASELINES[name], jax.random.key(seed)
    begun, spent = CLOCK(), 0
    starts = np.empty((0, target.dim))
    if baseline.starts and start == GIFT:
        starts = exact_points(target, baseline.starts)
    elif baseline.starts:
        rng = np.random.default_rng(seed)
        starts, spent = downhill(target, rng, baseline.starts, allowance)
        if not len(starts):
            return None
        starts, more = filled(target, rng, starts, baseline.starts)
        spent += more
    before = CLOCK() - begun if start == PRIOR else 0.0
    method = baseline.build(in_jax(target), jax.random.fold_in(key, 1), starts)
    first_step(method, CLOCK)
    seconds, finished = before, False
    while not finished and allowance.allows(method.evaluations + spent, seconds):
        begun = CLOCK()
        finished = not method.more()
        seconds += CLOCK() - begun
    drawn = method.drawn(jax.random.fold_in(key, 3)).thinned(MOST)
    if not drawn.points.shape[1]:
        return None
    evidence = drawn.log_evidence, drawn.log_evidence_se
    number = int(np.prod(drawn.points.shape[:2]))
    cost = float(method.evaluations + spent), seconds
    submission = Submission(drawn.points, number, *evidence, *cost)
    steps = int(drawn.info["steps"])
    # Nested samplers have their draws at the end, however much of the work these took.
    kept = drawn.info.get("kept", 1.0) * (1 - before / seconds) if steps > 1 else 0.0
    given = baseline.starts if start == GIFT else 0
    return Outcome(submission, given, kept, steps)
