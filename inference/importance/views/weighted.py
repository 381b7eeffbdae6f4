"""One body from all views: roots proposed by a fit, weighed by unbiased estimates of their limbs'
evidence, and drawn anew by their weights.

    draws = WeightedViews().draw(instant.posterior(model), jax.random.key(0), 10_000)

With one view it draws from that view's posterior, whose focal length is known, and the size from
its prior: they are the same law (docs/model.md § 11).
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.draws import (
    COMPLETE,
    OF_ONE_RUN,
    OUT_OF_BUDGET,
    Draws,
    KnownRoots,
    Progress,
    Sampler,
)
from poseterior.inference.exact.groups import workers
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.importance.views.faults import drawn_faults
from poseterior.inference.importance.views.limbs import (
    PER_LIMB,
    Proposals,
    weigh_bodies,
)
from poseterior.inference.importance.views.roots import (
    BodyProposal,
    BodySteps,
    WorldBodies,
    fitted,
)
from poseterior.inference.importance.weighted import (
    FEWEST_EFFECTIVE,
    RootWeights,
    WeightedSampler,
    blocks_of,
    require_number,
)
from poseterior.inference.resampling import effective, shares, tempered, times
from poseterior.probmodel.errors.faults import Faults
from poseterior.probmodel.instant import InstantPosterior
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import MEDIAN_SIZE, SIZE_SD
from poseterior.probmodel.roots import RootPoint, WorldPoint
from poseterior.probmodel.sessions import Pinhole
from poseterior.probmodel.skeleton import UPPER_BONES

NUM_BODIES = 800
"""Roots, where nothing else is said."""
PILOT_RUNS, PILOT_BODIES = 12, 100
"""Pilot runs at most, by which proposals are refined, and the roots of each."""
PILOT_EFFECTIVE, PILOT_SHARE = 40, 1 / 6
"""Effective roots by which they are, and of all roots the share: weights of fewer are tempered
until they are as many."""
PILOT_ENOUGH = 100
"""Effective roots after which there is no further run."""
TIMES_AS_MANY = 4
"""Roots of a further run, where one with too few effective ones shows where more are needed."""
BODIES_AT_ONCE = 50
"""Roots that a program takes at a time, which bounds the memory."""
LIMBS_OF_BODY = PER_LIMB * len(UPPER_BONES)
"""Proposals for the limbs of one root."""


@dataclass(frozen=True, eq=False)
class WeighedRoots(RootWeights):
    """Roots with their weights and what was proposed for their limbs.

    Attributes
    ----------
    posterior, log_weight, proposals
        As of `RootWeights`.
    bodies, steps
        Roots with lengths; and the proposal's steps to them, with the views' exchanges.
    limbs
        Proposals `(n, 5, P)` for the limbs, the head first.
    """

    posterior: InstantPosterior
    bodies: WorldBodies
    steps: BodySteps
    log_weight: np.ndarray
    limbs: Proposals
    proposals: int

    @property
    def known(self) -> KnownRoots:
        """What is known of them."""
        return KnownRoots(self.bodies.point, self.share, self.evidence_of)

    def relative_variance(self, share: np.ndarray) -> float:
        """By how these shares scatter."""
        return max(float(np.sum(share**2)) - 1 / len(share), 0.0)

    def draw_whole(
        self, rng: np.random.Generator, number: int
    ) -> tuple[WorldPoint, Pose, Faults, np.ndarray]:
        """As of `RootWeights`; limbs come as often as their weights say, faults last."""
        counts = times(self.share, number if self.effective else 0, rng.uniform())
        chosen = rng.permutation(np.repeat(np.arange(len(counts)), counts))
        bodies, exchange = self.bodies.take(chosen), self.steps.exchange[chosen]
        log_weight = self.limbs.log_weight[chosen]
        taken = np.argmax(log_weight + rng.gumbel(size=log_weight.shape), axis=-1)
        place = chosen[:, None], np.arange(log_weight.shape[1]), taken
        pose = Pose(bodies.length, self.limbs.upper[place], self.limbs.lower[place][:, 1:])
        faults = drawn_faults(self.posterior, bodies.point, pose, exchange, rng)
        return bodies.point, pose, faults, chosen


def weigh(
    posterior: InstantPosterior,
    proposal: BodyProposal,
    key: jax.Array,
    number: int,
    progress: Progress | None = None,
) -> WeighedRoots:
    """So many bodies of a proposal with their weights."""
    draw_key, limb_key = jax.random.split(key)
    steps = proposal.draw(np.random.default_rng(words_of(draw_key)), number)
    bodies = proposal.bodies(steps)
    words = np.asarray(jax.random.key_data(limb_key))
    given = posterior.model, posterior.detected, posterior.faults, posterior.root_prior, words

    def some(start: int) -> Any:
        rows = np.minimum(np.arange(start, start + BODIES_AT_ONCE), number - 1)
        own = bodies.take(rows)
        exchange = steps.exchange[rows]
        found = weigh_bodies(*given, np.int64(start), *own.point, own.length, exchange)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: number - start], found)

    parts = []
    for found in workers().map(some, range(0, number, BODIES_AT_ONCE)):
        parts.append(found)
        if progress:
            progress(min(BODIES_AT_ONCE * len(parts), number), number)
    log_torso, columns = jax.tree.map(lambda *rows: np.concatenate(rows), *parts)
    limbs = Proposals(*columns)
    of_limbs = logsumexp(limbs.log_weight, axis=-1) - math.log(PER_LIMB)
    log_weight = log_torso + of_limbs.sum(axis=1) - proposal.log_density(steps)
    # Beyond the ends of lengths, and of half turns, there is nothing.
    log_weight = np.where(np.isnan(log_weight), -np.inf, log_weight)
    return WeighedRoots(posterior, bodies, steps, log_weight, limbs, number * LIMBS_OF_BODY)


def pooled(pilots: Sequence[tuple[BodyProposal, WeighedRoots]]) -> tuple[BodySteps, np.ndarray]:
    """The bodies of pilot runs of one size, and the logs of their weights as draws of all their
    proposals together (Cornuet et al. 2012)."""
    steps = BodySteps(*map(np.concatenate, zip(*(run.steps for _, run in pilots), strict=True)))
    target = [one.log_steps(run.steps) + run.log_weight for one, run in pilots]
    mixed = logsumexp([one.log_steps(steps) for one, _ in pilots], axis=0)
    return steps, np.concatenate(target) - mixed + math.log(len(pilots))


def weigh_refined(
    posterior: InstantPosterior,
    key: jax.Array,
    number: int,
    progress: Progress | None = None,
    most: int | None = None,
) -> WeighedRoots:
    """So many bodies of a proposal that pilot runs have refined. Where fewer than
    `FEWEST_EFFECTIVE` of them are effective, they are one more pilot run, for `TIMES_AS_MANY`
    bodies, or for the `most` that are left. Raises `BadInput` as `fitted`."""
    proposal, pilots = fitted(posterior), []
    for run in range(PILOT_RUNS):
        pilot = weigh(posterior, proposal, jax.random.fold_in(key, run), PILOT_BODIES)
        pilots.append((proposal, pilot))
        steps, log_weight = pooled(pilots)
        share = tempered(log_weight, max(PILOT_EFFECTIVE, PILOT_SHARE * len(log_weight)))
        if share.any():
            proposal = proposal.refined(steps, share)
        if effective(shares(log_weight)) > PILOT_ENOUGH:
            break
    found = weigh(posterior, proposal, jax.random.fold_in(key, PILOT_RUNS), number, progress)
    spent = sum(pilot.proposals for _, pilot in pilots)
    more = TIMES_AS_MANY * number if most is None else min(TIMES_AS_MANY * number, most - number)
    if 0 < found.effective < FEWEST_EFFECTIVE and more > number:
        spent += found.proposals
        proposal = proposal.refined(found.steps, tempered(found.log_weight, PILOT_EFFECTIVE))
        further = jax.random.fold_in(key, PILOT_RUNS + 1)
        found = weigh(posterior, proposal, further, more, progress)
    return dataclasses.replace(found, proposals=found.proposals + spent)


@dataclass(frozen=True)
class WeightedViews(Sampler):
    """Draws of a body in the world, its pose and faults in every view from weighted roots.

    Attributes
    ----------
    name, max_proposals
        As of a `Sampler`.
    num_roots
        From how many roots draws are made.
    """

    name: str = "weighted-roots"
    num_roots: int = NUM_BODIES

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
        assert isinstance(posterior, InstantPosterior)
        if len(posterior.detection.views) == 1:
            yield from _of_one_view(posterior, self, key, number, block, progress)
            return
        afforded = self.max_proposals // LIMBS_OF_BODY - PILOT_RUNS * PILOT_BODIES
        roots = weigh_refined(
            posterior,
            jax.random.fold_in(key, 0),
            max(1, min(self.num_roots, afforded)),
            progress,
            afforded,
        )
        about = {"num_roots": len(roots.log_weight)}
        yield from blocks_of(roots, verdict(roots, self.num_roots), about, key, number, block)


def _of_one_view(
    posterior: InstantPosterior,
    asked: WeightedViews,
    key: jax.Array,
    number: int,
    block: int,
    progress: Progress | None,
) -> Iterator[Draws]:
    """Draws from one view's posterior, whose focal length is known, with sizes of the prior."""
    camera = posterior.detection.views[0].camera
    one = WeightedSampler(max_proposals=asked.max_proposals, num_roots=asked.num_roots)
    own_key, size_key = jax.random.split(key)
    rng = np.random.default_rng(words_of(size_key))
    for draws in one.blocks(posterior.alone, own_key, number, block=block, progress=progress):
        about = dict(draws.attributes)
        # A density per square pixel and log scale is one per mm³ and log size, but for this.
        about["log_evidence"] -= 2 * math.log(camera.focal[0])
        for name in OF_ONE_RUN:
            del about[name]
        yield dataclasses.replace(
            draws,
            posterior=posterior,
            points=_in_the_world(camera, draws.points, rng),
            faults=Faults(*(part[:, None] for part in draws.faults)),
            known=KnownRoots(draws.known.points, draws.known.share, draws.known.evidence),
            attributes=about,
        )


def _in_the_world(camera: Pinhole, points: RootPoint, rng: np.random.Generator) -> WorldPoint:
    """Roots `(n, ...)` of one camera as bodies in its world, with sizes of their prior."""
    log_size = rng.normal(math.log(MEDIAN_SIZE), SIZE_SD, len(points.log_scale))
    depth = camera.focal[0] * np.exp(log_size - points.log_scale)
    aside = (points.translation - camera.principal) / camera.focal[0]
    placed = depth[:, None] * np.column_stack([aside, np.ones(len(depth))])
    return WorldPoint(
        points.torso,
        camera.rotation.T @ points.rotation,
        log_size,
        placed @ camera.rotation + camera.centre,
        np.zeros((len(depth), 0, 2)),
    )


def verdict(roots: WeighedRoots, wanted: int) -> tuple[str, str]:
    """The status of draws from these roots, and, where it is not complete, a sentence that says why
    and what to do."""
    where, number = roots.posterior.detection.where, len(roots.log_weight)
    if not roots.effective:
        return OUT_OF_BUDGET, (
            f"none of {number:,} bodies explains what all cameras saw of {where}; take an error law"
            " with outliers, leave out a camera, or check the calibration"
        )
    if number < wanted:
        return OUT_OF_BUDGET, (
            f"{number:,} of {wanted:,} roots for {where}; ask for fewer roots, or allow more"
            " proposals"
        )
    if roots.effective < FEWEST_EFFECTIVE:
        return OUT_OF_BUDGET, (
            f"the draws for {where} rest on {roots.effective:.1f} effective roots of {number:,},"
            f" too few for an answer (at least {FEWEST_EFFECTIVE}); ask for more roots, or take an"
            " error law with outliers"
        )
    return COMPLETE, ""
