"""The fast route: roots drawn given the torso, weighed by unbiased estimates of their limbs'
evidence, and drawn anew by their weights.

    draws = WeightedSampler(num_roots=1000).draw(posterior, key, 10_000)

    roots = weigh_roots(posterior, key=key, num_roots=1000)
    roots.effective                      # of how many equally good roots they are worth
    roots.draw(rng, 10_000)              # roots and poses

Weights that are random but unbiased leave the limit what it is: with more and more roots the draws
are draws of the posterior. How far a number of roots is from there, the effective number says.
"""

import abc
import dataclasses
import functools
import math
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from poseterior.inference.draws import (
    COMPLETE,
    MAX_PROPOSALS,
    OUT_OF_BUDGET,
    Draws,
    KnownRoots,
    Progress,
    Sampler,
)
from poseterior.inference.estimators.points import require_camera
from poseterior.inference.exact.loops.numbers import words_of
from poseterior.inference.exact.problem import limbs_of
from poseterior.inference.exact.rates import Budget
from poseterior.inference.exact.reach import out_of_reach
from poseterior.inference.importance.limbs import (
    LIMB_PROPOSALS,
    LimbDraws,
    limb_draws,
    log_evidence,
    outliers_of,
    picks,
    views_of,
)
from poseterior.inference.importance.torsos import log_nearness, require_distance
from poseterior.inference.importance.two_stage import ProposedRoots, propose_roots
from poseterior.inference.resampling import effective, shares, times
from poseterior.probmodel.errors.faults import LIMB_INDEX, Faults
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import GROUPS

NUM_ROOTS = 1000
"""Roots, where nothing else is said."""
MOST_ROOTS = 100_000
"""More would not fit the memory of a small machine."""
FEWEST_EFFECTIVE = 20
"""Effective roots below which draws are no answer: an interval would rest on one or two of them."""
EXAMINED = 32
"""Roots under which it is asked, where none explains a group of limbs, what is out of reach."""
APART = 2
"""Effective roots for every draw that counts as independent of the others."""


class RootWeights(abc.ABC):
    """Roots with weights, whose mean is the evidence: what they are worth, and draws of them.

    Attributes
    ----------
    posterior
        What they are drawn from.
    log_weight
        `(n,)` log of each root's weight; -inf where it has none.
    proposals
        How many attempts all that took.
    """

    posterior: Posterior
    log_weight: np.ndarray
    proposals: int

    @functools.cached_property
    def share(self) -> np.ndarray:
        """`(n,)`: the weights, with sum one; zeros where no root has any."""
        return shares(self.log_weight)

    @property
    def effective(self) -> float:
        """How many equally weighted roots these are worth: 1 / Σ share² (Kish 1965)."""
        return effective(self.share)

    @property
    def log_evidence(self) -> float:
        """Log of an unbiased estimate of the density of the detection, per square pixel of every
        joint (but one where a flat translation has no mass); -inf where no root has any weight."""
        return log_mean(self.log_weight)

    @property
    def log_evidence_se(self) -> float:
        """Standard error of `log_evidence`, by the delta method."""
        if not self.effective:
            return math.inf
        return math.sqrt(self.relative_variance(self.share))

    def evidence_of(self, rows: np.ndarray) -> tuple[float, float]:
        """Log evidence of the roots in some rows alone, and its standard error."""
        own = np.isin(np.arange(len(self.log_weight)), rows)
        evidence = log_mean(np.where(own, self.log_weight, -np.inf))
        whole = np.where(own, self.share, 0.0)
        if not whole.any():
            return evidence, math.inf
        return evidence, math.sqrt(self.relative_variance(whole / whole.sum()))

    @property
    @abc.abstractmethod
    def known(self) -> KnownRoots:
        """What is known of them."""

    @abc.abstractmethod
    def relative_variance(self, share: np.ndarray) -> float:
        """Of the evidence of roots that have these shares `(n,)` of it."""

    @abc.abstractmethod
    def draw_whole(
        self, rng: np.random.Generator, number: int
    ) -> tuple[Any, Pose, Faults, np.ndarray]:
        """`number` roots, poses and faults in random order, and which `(number,)` of the roots each
        has; none where no root has any weight."""


@dataclass(frozen=True, eq=False)
class WeightedRoots(RootWeights):
    """Roots given the torso with weights that make them roots of the posterior.

    Attributes
    ----------
    posterior
        What they are drawn from.
    proposed
        The roots, with their patterns of faults.
    limbs
        For each root, what attempts at its limbs brought.
    log_weight
        `(n,)` log of each root's weight, whose mean is the evidence; -inf where no draw was
        accepted.
    proposals
        How many attempts all that took.
    """

    posterior: Posterior
    proposed: ProposedRoots
    limbs: Sequence[dict[str, LimbDraws]]
    log_weight: np.ndarray
    proposals: int

    @property
    def points(self) -> RootPoint:
        """The roots `(n, ...)`."""
        return self.proposed.points

    @property
    def known(self) -> KnownRoots:
        """What is known of them."""
        limbs = np.array([log_evidence(found) for found in self.limbs])
        columns = {"log_evidence_of_limbs": limbs, "log_weight": self.log_weight}
        return KnownRoots(self.points, self.share, self.evidence_of, columns)

    def relative_variance(self, share: np.ndarray) -> float:
        """As of the roots that were proposed."""
        return self.proposed.relative_variance(share)

    def draw_whole(
        self, rng: np.random.Generator, number: int
    ) -> tuple[RootPoint, Pose, Faults, np.ndarray]:
        """As `draw`, with the faults of each root's pattern."""
        points, poses, chosen = self.draw(rng, number)
        return points, poses, self.proposed.faults.take(chosen), chosen

    def draw(self, rng: np.random.Generator, number: int) -> tuple[RootPoint, Pose, np.ndarray]:
        """`number` roots and poses, in random order, and which `(number,)` of the roots each has;
        none where no root has any weight.

        Roots come as often as their weights say (systematic resampling), limbs from those that were
        accepted under them, groups freely combined, since they are independent given the root.
        """
        if not self.effective:
            number = 0
        counts = times(self.share, number, rng.uniform())
        chosen = np.repeat(np.arange(len(counts)), counts)
        poses, start = Pose.blank(number), 0
        for root in np.flatnonzero(counts).tolist():
            rows = slice(start, start + int(counts[root]))
            part = Pose(*(column[rows] for column in poses))
            for name, found in self.limbs[root].items():
                order = picks(rng, len(found.draws.length), len(part.length))
                type(found.draws)(*(column[order] for column in found.draws)).fill(
                    part, GROUPS[name]
                )
            start = rows.stop
        order = rng.permutation(number)
        chosen, poses = chosen[order], Pose(*(column[order] for column in poses))
        return self.points.take(chosen), poses, chosen


@dataclass(frozen=True)
class WeightedSampler(Sampler):
    """Draws of torso, camera and pose from weighted roots.

    Attributes
    ----------
    name, max_proposals
        As of a `Sampler`.
    num_roots, most_roots
        From how many roots draws are made, and from how many at most where these are too few, as
        `weigh_enough_roots` takes them.
    """

    name: str = "weighted-roots"
    num_roots: int = NUM_ROOTS
    most_roots: int | None = None

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
        roots = weigh_enough_roots(
            posterior,
            key=jax.random.fold_in(key, 0),
            num_roots=self.num_roots,
            most_roots=self.most_roots,
            max_proposals=self.max_proposals,
            progress=progress,
        )
        about = {"num_roots": len(roots.log_weight)}
        yield from blocks_of(roots, verdict(roots), about, key, number, block)


def blocks_of(
    roots: RootWeights,
    verdict: tuple[str, str],
    about: dict[str, Any],
    key: jax.Array,
    number: int,
    block: int,
) -> Iterator[Draws]:
    """Draws from roots, block by block, with their status and sentence, and attributes of their
    own. There is one block at least, and no other where that one has no draw."""
    rng = np.random.default_rng(np.asarray(jax.random.key_data(jax.random.fold_in(key, 1))))
    worth = {
        "effective_roots": roots.effective,
        "num_proposals": roots.proposals,
        "log_evidence": roots.log_evidence,
        "log_evidence_se": roots.log_evidence_se,
    }
    status, sentence = verdict
    done = 0
    for start in range(0, number, block):
        points, poses, faults, chosen = roots.draw_whole(rng, min(block, number - start))
        done += len(chosen)
        rate = {"acceptance_rate": done / max(roots.proposals, 1)}
        yield Draws(
            roots.posterior,
            points,
            poses,
            faults=faults,
            known=roots.known,
            attributes=about | worth | rate,
            status=status,
            sentence=sentence,
            root_index=chosen,
        )
        if not done:
            return


def log_mean(log_weight: np.ndarray) -> float:
    """Log of the mean of weights `(n,)`; -inf where none has any."""
    if not np.isfinite(log_weight).any():
        return -math.inf
    return float(np.logaddexp.reduce(log_weight)) - math.log(len(log_weight))


def weigh_roots(
    posterior: Posterior,
    *,
    key: jax.Array,
    num_roots: int = NUM_ROOTS,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> WeightedRoots:
    """Roots given the torso, each with an estimate of its limbs' evidence.

    Parameters
    ----------
    posterior
        What is to be drawn from.
    key
        Of all random numbers: the same key, the same roots and weights.
    num_roots
        How many roots.
    max_proposals
        Most attempts, at roots and limbs together; fewer roots where they end first.
    progress
        Called now and then with the roots weighed and wanted.

    Raises
    ------
    BadInput
        Where the seen joints of the torso do not determine a camera, a known focal length puts the
        person too near to it, and where the number of roots is not from 1 to 100,000.
    """
    require_number(num_roots)
    require_camera(posterior.detection)
    require_distance(posterior)
    torso_key, limb_key = jax.random.split(key)
    budget = Budget(max_proposals)
    proposed = propose_roots(posterior, torso_key, num_roots, budget)
    afforded = max(max_proposals - proposed.proposals, 0) // LIMB_PROPOSALS
    proposed = proposed.at(slice(0, afforded))
    limbs: list[dict[str, LimbDraws]] = []
    for found in limb_draws(posterior, proposed.points, proposed.faults, words_of(limb_key)):
        limbs.append(found)
        if progress:
            progress(len(limbs), num_roots)
    return WeightedRoots(
        posterior,
        proposed,
        limbs,
        proposed.log_weight + log_limbs(posterior, proposed.points, proposed.faults, limbs),
        proposed.proposals + LIMB_PROPOSALS * len(limbs),
    )


def weigh_enough_roots(
    posterior: Posterior,
    *,
    key: jax.Array,
    num_roots: int = NUM_ROOTS,
    most_roots: int | None = None,
    max_proposals: int = MAX_PROPOSALS,
    progress: Progress | None = None,
) -> WeightedRoots:
    """As `weigh_roots`; but where fewer than `FEWEST_EFFECTIVE` of the roots are effective, all are
    drawn anew, as many as would do.

    Roots are not added to those of which too few were effective. Still, roots that stay were judged
    by their own weights, so that the evidence is no longer quite without bias.

    Parameters
    ----------
    posterior, key, progress
        As of `weigh_roots`.
    num_roots
        How many roots, at first.
    most_roots
        How many at most; by default no more than at first.
    max_proposals
        Most attempts, of all rounds together; a round that they may not suffice for is not begun.

    Raises
    ------
    BadInput
        As `weigh_roots`.
    """
    most, spent = num_roots if most_roots is None else most_roots, 0
    require_number(most)
    number: int | None = num_roots
    while number is not None:
        roots = weigh_roots(
            posterior,
            key=key,
            num_roots=number,
            max_proposals=max_proposals - spent,
            progress=progress,
        )
        spent += roots.proposals
        key, number = jax.random.fold_in(key, 0), _next(roots, most, max_proposals - spent)
    return dataclasses.replace(roots, proposals=spent)


def _next(roots: WeightedRoots, most: int, proposals: int) -> int | None:
    """How many roots would do in the place of these, within so many proposals; None where these
    do, no root explains the limbs, or the most that there may be would not do either."""
    number = len(roots.log_weight)
    if not 0 < roots.effective < FEWEST_EFFECTIVE or number < roots.proposed.wanted:
        return None
    more = min(most, max(2 * number, _enough(roots)))
    hopeless = roots.effective * more < FEWEST_EFFECTIVE * number
    dear = roots.proposals * more > proposals * number
    return None if more <= number or hopeless or dear else more


def require_number(num_roots: int) -> None:
    """Raises `BadInput` on a number of roots that cannot be."""
    if not 1 <= num_roots <= MOST_ROOTS:
        raise BadInput(
            f"the number of roots must lie between 1 and {MOST_ROOTS:,}, not {num_roots}"
        )


def log_limbs(
    posterior: Posterior,
    points: RootPoint,
    faults: Faults,
    limbs: Sequence[dict[str, LimbDraws]],
) -> np.ndarray:
    """`(n,)`: log of scale⁻² for every seen joint that is not the torso's × the estimated evidence
    of the limbs. Roots given the torso have scale⁻² for the torso's joints already, but not what
    perspective makes of it."""
    counted = np.asarray(posterior.detected.counts)
    evidence = np.array([log_evidence(found) for found in limbs])
    scale = counted[list(LIMB_INDEX)].sum() * np.asarray(points.log_scale)
    return evidence - 2 * scale + log_nearness(posterior, points, faults.exchange)


def verdict(roots: WeightedRoots) -> tuple[str, str]:
    """The status of draws from these roots, and, where it is not complete, a sentence that says why
    and what to do."""
    where, weighed = roots.posterior.detection.where, len(roots.log_weight)
    wanted = roots.proposed.wanted
    if not roots.proposals:
        return OUT_OF_BUDGET, f"no root was attempted for {where}; allow more proposals"
    if not len(roots.points.torso):
        return OUT_OF_BUDGET, (
            f"no torso brings all its seen joints within reach of their detections in"
            f" {roots.proposed.proposals:,} attempts for {where}; mend or drop one of"
            " shoulders, hips, thorax and pelvis, or raise the factor of the radii"
        )
    if not roots.effective:
        found = (
            f"none of {weighed:,} roots that explain the torso of {where} was found to have a pose"
            f" whose {_rarest(roots)} explain their detections"
        )
        far = _out_of_reach(roots)
        if far is not None:
            return OUT_OF_BUDGET, f"{found}: {far}"
        return OUT_OF_BUDGET, (
            f"{found}; mend or drop one, ask for more roots, or raise the factor of the radii"
        )
    few = roots.effective < FEWEST_EFFECTIVE
    if weighed < wanted:
        return OUT_OF_BUDGET, (
            f"{weighed:,} of {wanted:,} roots after {roots.proposals:,} proposals for {where};"
            f" {'' if few else 'ask for fewer roots, or '}allow more proposals"
        )
    if few:
        return OUT_OF_BUDGET, (
            f"the draws for {where} rest on {roots.effective:.1f} effective roots of {weighed:,},"
            f" too few for an answer (at least {FEWEST_EFFECTIVE}); ask for some"
            f" {_enough(roots):,} roots, or mend the detection that hardly any root explains"
        )
    return COMPLETE, ""


def _out_of_reach(roots: WeightedRoots) -> str | None:
    """A sentence on the joint that is farthest out of reach under every one of some roots; None
    where there is no such joint, or where a focal length is known, for which there are no
    bounds."""
    model, proposed = roots.posterior.model, roots.proposed.at(slice(0, EXAMINED))
    if model.lens is not None:
        return None
    views = views_of(roots.posterior, proposed.points, proposed.faults)
    reach = np.where(outliers_of(roots.posterior, proposed.faults), np.inf, views.reach)
    columns = views.axes, views.start[..., :2], views.target, reach
    each = [
        {one.joint: one for one in out_of_reach(model, limbs_of(*map(np.array, row)))}
        for row in zip(*columns, strict=True)
    ]
    always = set.intersection(*map(set, each))
    if not always:
        return None
    excess = operator.attrgetter("excess")
    nearest = [min((found[name] for found in each), key=excess) for name in always]
    scale = float(np.median(np.exp(proposed.points.log_scale)))
    return max(nearest, key=excess).sentence(scale)


def _rarest(roots: WeightedRoots) -> str:
    """The group of limbs that fewest roots explain."""
    held = {name: sum(one[name].log_evidence > -math.inf for one in roots.limbs) for name in GROUPS}
    return min(held, key=held.__getitem__)


def _enough(roots: WeightedRoots) -> int:
    """About how many roots would be enough, twice as many for safety; two digits."""
    wanted = 2 * len(roots.log_weight) * FEWEST_EFFECTIVE / roots.effective
    unit = 10 ** max(0, math.floor(math.log10(wanted)) - 1)
    return min(MOST_ROOTS, math.ceil(wanted / unit) * unit)
