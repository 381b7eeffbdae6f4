"""Which patterns of a detector's faults are tried (docs/model.md § 9), and which focal lengths.

The faults of the torso's keypoints are few, and so are the focal lengths that there may
be: each of them, with each of these, is a pattern, with roots of
its own. The others are drawn under each root from a proposal: how well draws of the
prior, the same for all roots, fit the limbs with and without each fault. A proposal
need not be right, for every root is weighted by the prior of its faults over the
proposal's; it decides how many roots are effective. Which roots are weighted at all is
proposed in the same way.
"""

import functools
import math
from typing import NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.exact.groups import group_tables, memoised_by_model, workers
from poseterior.inference.exact.loops.first_stage import limb_ends, mean_nearness
from poseterior.inference.importance.limbs import (
    CHAINED,
    DRAWS_PER_ROOT,
    ENDS,
    LIMBS,
    POOL_SIZE,
    Effort,
    LimbSampling,
    blind,
    frames_of,
    views_of,
    weigh_limbs,
)
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.faults import (
    LIMB_INDEX,
    MOVES_TORSO,
    ORDERS,
    FaultPrior,
    Faults,
    faults_of,
)
from poseterior.probmodel.errors.likelihood import PAPER
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.root_priors import TorsoCameraPrior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import TORSO_INDEX

BLUR = 0.06
"""Body units by which errors are widened, so that so few draws come near every
detection."""
DEFENSIVE = 0.1
"""The share of a proposal that is flatter than what the pool says: the square root of
it."""
ROOTS_AT_A_TIME = 512
"""Roots that a thread works on at a time."""
LEAST_DENSITY = 1e-30
"""The least density of a joint, per square body unit: in single precision it would be
zero."""
POOL_WORDS = [0, 0]
"""Of the key of the pool's draws."""
POOL_EFFORT: Effort = {1: (128, 4), 2: (64, 16)}
"""Proposals that bring them: several for one draw."""
OUTLIERS = np.array([[False, False], [True, False], [False, True], [True, True]])
"""`(4, 2)`: which joints of a limb are outliers."""


class FaultPattern(NamedTuple):
    """The faults of the torso's keypoints, `faults`; the `exchanges`, indices into
    `faults.EXCHANGES`, that come with them; the `lens`, where there may be several; and for how
    many lenses it stands, if it was taken from them at random: one over the chance that it had."""

    faults: Faults
    exchanges: tuple[int, ...]
    lens: int | None = None
    stands_for: float = 1.0


def fault_patterns(posterior: Posterior) -> list[FaultPattern]:
    """All that may be wrong with the torso's keypoints, nothing first; each of it under every lens,
    one after the other."""
    prior = posterior.faults
    counts = np.asarray(posterior.detected.counts)
    exchanges = prior.exchanges
    possible = tuple(exchanges[~MOVES_TORSO[exchanges]].tolist())
    patterns = [FaultPattern(Faults.none(), possible)]
    for place, joint in enumerate(TORSO_INDEX, 1):
        if prior.outlier[joint] and counts[joint]:
            patterns.append(FaultPattern(_torso_faults(0, place), possible))
    for index in exchanges[MOVES_TORSO[exchanges]].tolist():
        patterns.append(FaultPattern(_torso_faults(index, 0), (index,)))
    lenses = lenses_of(posterior)
    if lenses == 1:
        return patterns
    return [pattern._replace(lens=lens) for pattern in patterns for lens in range(lenses)]


def lenses_of(posterior: Posterior) -> int:
    """How many focal lengths there may be, each as probable as the others."""
    return TorsoCameraPrior.of(posterior.model).lenses


def prior_share(posterior: Posterior, pattern: FaultPattern) -> float:
    """The prior probability of the pattern: of its lens, and its faults of the torso with any of
    its exchanges, whatever is wrong with the limbs."""
    prior = posterior.faults
    counts = np.asarray(posterior.detected.counts)
    limbs = list(LIMB_INDEX)
    sound = np.log1p(-np.array(prior.outlier)[limbs] * counts[limbs]).sum()
    each = [pattern.faults._replace(exchange=np.asarray(one)) for one in pattern.exchanges]
    total = sum(np.exp(float(prior.log_prob(counts, one)) - sound) for one in each)
    return float(total) / lenses_of(posterior)


def _torso_faults(exchange: int, torso: int) -> Faults:
    """An exchange, and an outlier of the torso, numbered from 1; 0 is none."""
    return Faults(*map(np.asarray, faults_of(exchange, torso, np.zeros(len(LIMB_INDEX)))))


class FitScore(NamedTuple):
    """How well the prior's draws fit the limbs of roots: `limbs` `(n, e, 5, 4)`, log
    likelihoods with log priors, by exchange, limb and outliers; and the `exchanges`,
    with their log `prior` `(e,)`."""

    limbs: np.ndarray
    exchanges: tuple[int, ...]
    prior: np.ndarray

    def take(self, rows: np.ndarray) -> "FitScore":
        """That of some of the roots."""
        return self._replace(limbs=self.limbs[rows])

    @property
    def by_exchange(self) -> np.ndarray:
        """`(n, e)`: log probabilities of the exchanges, not normalised."""
        return self.prior + logsumexp(self.limbs, axis=-1).sum(axis=-1)

    @property
    def total(self) -> np.ndarray:
        """`(n,)`: log likelihood of all limbs together."""
        return logsumexp(self.by_exchange, axis=1)


def fit_score(
    posterior: Posterior, pool: np.ndarray, pattern: FaultPattern, points: RootPoint
) -> FitScore:
    """How well the `pool` of `pool_of` fits with each exchange and outlier at roots
    `(n, ...)`."""
    number = len(points.torso)
    limbs = np.empty((number, len(pattern.exchanges), len(LIMBS), len(OUTLIERS)))
    before = ORDERS[pattern.exchanges[0]][ENDS]
    for place, exchange in enumerate(pattern.exchanges):
        order = ORDERS[exchange][ENDS]
        # Limbs that read the same keypoints as under the first exchange fit as they did
        # there.
        anew = [limb for limb in range(len(LIMBS)) if not place or (order != before)[limb].any()]
        limbs[:, place] = limbs[:, 0]
        faults = Faults.none(number)._replace(exchange=np.full(number, exchange))
        frames = frames_of(views_of(posterior, points, faults), faults.outlier)
        for limb in anew:
            errors = _errors(posterior, order[limb], bool(CHAINED[limb]))
            limbs[:, place, limb] = _limb_score(pool[:, limb], errors, frames[limb])
    probability = posterior.faults.exchange_probabilities[list(pattern.exchanges)]
    return FitScore(limbs, pattern.exchanges, np.log(probability))


class Errors(NamedTuple):
    """Of the keypoints of a limb's two joints, `(2,)`: one over twice the `rate` of
    their errors' variance, 0 where none counts; the `peak` of their density × the
    probability that they are no outliers; and the density of an `outlier` × its
    probability. Body units."""

    rate: np.ndarray
    peak: np.ndarray
    outlier: np.ndarray


def _errors(posterior: Posterior, keypoints: np.ndarray, chained: bool) -> Errors:
    """Those of two keypoints, or of the first alone."""
    spread = np.asarray(posterior.detected.spread)[keypoints]
    outlier = np.array(posterior.faults.outlier)[keypoints]
    counts = np.isfinite(spread) & [True, chained]
    # The laws' variance either way is a quarter of the squared spread.
    variance = np.where(counts, spread**2 / 4 + BLUR**2, 1.0)
    return Errors(
        np.where(counts, 1 / (2 * variance), 0.0),
        np.where(counts, (1 - outlier) / (2 * np.pi * variance), 1.0),
        np.where(counts, outlier / (np.pi * posterior.faults.reach**2), 0.0),
    )


def _limb_score(pool: np.ndarray, errors: Errors, frames: np.ndarray) -> np.ndarray:
    """`(n, 4)`: log likelihood and log prior of a limb's outliers under roots."""
    pool = np.ascontiguousarray(pool)
    rate = errors.rate.astype(np.float32)
    # The first joint's axes serve both: a pilot estimate may be rough.
    axes = frames["axes"][:, 0, :2].astype(np.float32)
    gap = -frames["target"].astype(np.float32)
    near = np.empty((len(axes), 3))
    tasks = []
    for first in range(0, len(axes), ROOTS_AT_A_TIME):
        part = slice(first, first + ROOTS_AT_A_TIME)
        task = workers().submit(mean_nearness, pool, axes[part], gap[part], rate, near[part])
        tasks.append(task)
    for task in tasks:
        task.result()
    peak = errors.peak
    sound = np.column_stack([near * [peak.prod(), peak[1], peak[0]], np.ones(len(near))])
    outlier = np.array([1.0, *errors.outlier, errors.outlier.prod()])
    with np.errstate(divide="ignore"):
        return np.log(np.maximum(sound, LEAST_DENSITY)) + np.log(outlier)


@memoised_by_model
def pool_of(model: PoseModel) -> np.ndarray:
    """`(3, 5, 2, POOL_SIZE)`: where the joints of each limb lie from its start, in the
    local axes of its upper bone, in draws of the prior; single precision. The same ones
    for every key, since no pilot estimate makes a draw wrong.

    They are what proposals bring that have nothing to explain, so that nothing else has
    to be compiled; where limits are narrow, some come more than once."""
    tables = group_tables(model)
    views = blind(POOL_SIZE // DRAWS_PER_ROOT)
    sampling = LimbSampling(tables, {}, POOL_WORDS, PAPER.law, POOL_EFFORT)
    roots = weigh_limbs(sampling, views, np.zeros(views.reach.shape, bool), 0)
    pool = np.empty((3, len(LIMBS), 2, POOL_SIZE), np.float32)
    limb = 0
    for name, group in tables.items():
        draws = [one[name].draws for one in roots]
        length, upper, lower = (np.concatenate(parts) for parts in zip(*draws, strict=True))
        length = np.resize(length[:, [0, -1]], (POOL_SIZE, 2))
        for place, build in enumerate(group.builds):
            directions = (np.resize(part[:, place], (POOL_SIZE, 3)) for part in (upper, lower))
            limb_ends(build.reference, length, *directions, pool[:, limb])
            if build.bones == 1:
                pool[:, limb, 1] = pool[:, limb, 0]
            limb += 1
    return pool


def propose_faults(
    score: FitScore, pattern: FaultPattern, rng: np.random.Generator
) -> tuple[Faults, np.ndarray]:
    """Faults `(n, ...)` for each root, and the log probability `(n,)` with which they
    were proposed in their pattern."""
    number = len(score.limbs)
    which, log_proposal = _pick(score.by_exchange, rng)
    rows = np.arange(number)
    limbs = score.limbs[rows, which]
    outlier = np.tile(pattern.faults.outlier, (number, 1))
    exchange = np.array(score.exchanges)[which]
    for limb, ends in enumerate(ENDS):
        picked, log_part = _pick(limbs[:, limb], rng)
        log_proposal = log_proposal + log_part
        for place, end in enumerate(ends):
            if place == 0 or CHAINED[limb]:
                # Outliers are keypoints: under an exchange, another joint's.
                keypoint = ORDERS[exchange, end]
                outlier[rows, keypoint] = OUTLIERS[picked, place]
    return Faults(exchange, outlier), log_proposal


def _pick(score: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One of the columns in each row of `score` `(n, m)`, by its exponential, and the
    log probability that it had."""
    share = (1 - DEFENSIVE) * _normal(score) + DEFENSIVE * _normal(score / 2)
    ends = np.cumsum(share, axis=1)
    ends /= ends[:, -1:]
    picked = (rng.uniform(size=(len(score), 1)) >= ends).sum(axis=1)
    taken = share[np.arange(len(score)), picked] / share.sum(axis=1)
    return picked, np.log(taken)


def _normal(score: np.ndarray) -> np.ndarray:
    return np.exp(score - logsumexp(score, axis=1, keepdims=True))


def log_priors(posterior: Posterior, faults: Faults) -> np.ndarray:
    """`(n,)`: for the faults of each root the log of their prior probability, and its lens', × the
    peak of the likelihood under them at scale one."""
    measure = functools.partial(_log_priors, posterior.faults, posterior.detected)
    return in_chunks(measure, *faults) - math.log(lenses_of(posterior))


@jax.jit
def _log_priors(prior: FaultPrior, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    def one(faults: Faults) -> jax.Array:
        return prior.log_prob(detected.counts, faults) + detected.read(faults).log_peak()

    return jax.vmap(one)(Faults(*fields))
