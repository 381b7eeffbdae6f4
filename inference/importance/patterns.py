"""Which patterns of a detector's faults are tried (docs/model.md § 9).

The faults of the torso's keypoints are few: each of them is a stratum, with roots of its own. The
others are drawn under each root from a proposal: how well draws of the prior, kept for all roots,
fit the limbs with and without each fault. A proposal need not be right, for every root is weighed
by the prior of its pattern over the proposal's; it decides how many roots count. Which roots are
weighed at all is proposed in the same way.
"""

import functools
from typing import NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp

from poseterior.inference.exact.groups import group_tables, once_a_model, workers
from poseterior.inference.exact.loops.promise import limb_ends, near_rows
from poseterior.inference.importance.limbs import (
    CHAINED,
    ENDS,
    KEPT,
    LIMBS,
    POOL,
    Effort,
    Sight,
    attempt_limbs,
    blind,
    sights_of,
    views_of,
)
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.faults import (
    LIMB_INDEX,
    MOVES_TORSO,
    ORDERS,
    FaultPrior,
    Faults,
    faults_of,
)
from poseterior.probmodel.likelihood import PAPER
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.observation import DetectedJoints
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.roots import RootPoint
from poseterior.probmodel.skeleton import TORSO_INDEX

BLUR = 0.06
"""Body units by which errors are widened, so that so few draws come near every detection."""
DEFENSIVE = 0.1
"""The share of a proposal that is flatter than what the pool says: the square root of it."""
SHARE = 512
"""Roots that a thread works on at a time."""
LEAST = 1e-30
"""The least density of a joint, per square body unit: in single precision it would be zero."""
WORDS = [0, 0]
"""Of the key of the draws by which is guessed."""
BLIND_EFFORT: Effort = {1: (128, 4), 2: (64, 16)}
"""Attempts that bring them: several for one that is kept."""
PATTERNS = np.array([[False, False], [True, False], [False, True], [True, True]])
"""`(4, 2)`: which joints of a limb are outliers."""


class Stratum(NamedTuple):
    """The faults of the torso's keypoints, `faults`; and the `exchanges`, indices into
    `faults.EXCHANGES`, that come with them."""

    faults: Faults
    exchanges: tuple[int, ...]


def strata_of(posterior: Posterior) -> list[Stratum]:
    """All that may be wrong with the torso's keypoints, nothing first."""
    prior, counts = posterior.faults, np.asarray(posterior.detected.counts)
    exchanges = prior.exchanges
    possible = tuple(exchanges[~MOVES_TORSO[exchanges]].tolist())
    found = [Stratum(Faults.none(), possible)]
    for place, joint in enumerate(TORSO_INDEX, 1):
        if prior.outlier[joint] and counts[joint]:
            found.append(Stratum(_pattern(0, place, np.zeros(len(LIMB_INDEX))), possible))
    for index in exchanges[MOVES_TORSO[exchanges]].tolist():
        found.append(Stratum(_pattern(index, 0, np.zeros(len(LIMB_INDEX))), (index,)))
    return found


def prior_share(posterior: Posterior, stratum: Stratum) -> float:
    """The prior probability of the stratum: of its faults of the torso with any of its exchanges,
    whatever is wrong with the limbs."""
    prior, counts = posterior.faults, np.asarray(posterior.detected.counts)
    patterns = [stratum.faults._replace(exchange=np.asarray(one)) for one in stratum.exchanges]
    sound = np.log1p(-np.array(prior.outlier)[list(LIMB_INDEX)] * counts[list(LIMB_INDEX)]).sum()
    return float(sum(np.exp(float(prior.log_prob(counts, one)) - sound) for one in patterns))


def _pattern(exchange: int, torso: int, limbs: np.ndarray) -> Faults:
    return Faults(*map(np.asarray, faults_of(exchange, torso, limbs)))


class Fit(NamedTuple):
    """How well the prior's draws fit the limbs of roots: `limbs` `(n, e, 5, 4)`, log likelihoods
    with log priors, by exchange, limb and pattern of its outliers."""

    limbs: np.ndarray
    exchanges: tuple[int, ...]
    prior: np.ndarray

    def take(self, rows: np.ndarray) -> "Fit":
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


def fit_of(posterior: Posterior, pool: np.ndarray, stratum: Stratum, points: RootPoint) -> Fit:
    """How well the `pool` of `pool_of` fits under each exchange and pattern at roots `(n, ...)`."""
    prior, number = posterior.faults, len(points.torso)
    limbs = np.empty((number, len(stratum.exchanges), len(LIMBS), len(PATTERNS)))
    for place, exchange in enumerate(stratum.exchanges):
        order, before = ORDERS[exchange][ENDS], ORDERS[stratum.exchanges[0]][ENDS]
        # Limbs that read the same keypoints as under the first exchange fit as they did there.
        anew = [limb for limb in range(len(LIMBS)) if not place or (order != before)[limb].any()]
        limbs[:, place] = limbs[:, 0]
        faults = Faults.none(number)._replace(exchange=np.full(number, exchange))
        sights = sights_of(views_of(posterior, points, faults), faults.outlier)
        for limb in anew:
            errors = _errors(posterior, order[limb], bool(CHAINED[limb]))
            limbs[:, place, limb] = _fit(pool[:, limb], errors, sights[limb])
    probability = prior.exchange_probabilities[list(stratum.exchanges)]
    return Fit(limbs, stratum.exchanges, np.log(probability))


class Errors(NamedTuple):
    """Of the keypoints of a limb's two joints, `(2,)`: one over twice the `rate` of their errors'
    variance, 0 where none counts; the `peak` of their density × the probability that they are no
    outliers; and the density of an outlier × its probability, `stray`. Body units."""

    rate: np.ndarray
    peak: np.ndarray
    stray: np.ndarray


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


def _fit(pool: np.ndarray, errors: Errors, sight: Sight) -> np.ndarray:
    """`(n, 4)`: log likelihood and log prior of a limb's patterns under roots."""
    pool, rate = np.ascontiguousarray(pool), errors.rate.astype(np.float32)
    axes = sight.axes[:, 0, :2].astype(np.float32)  # of both joints: guesses may be rough
    gap = -sight.target.astype(np.float32)
    near = np.empty((len(axes), 3))
    parts = [slice(first, first + SHARE) for first in range(0, len(axes), SHARE)]
    tasks = (
        workers().submit(near_rows, pool, axes[part], gap[part], rate, near[part]) for part in parts
    )
    for task in list(tasks):
        task.result()
    peak, stray = errors.peak, errors.stray
    whole = np.column_stack([near * [peak.prod(), peak[1], peak[0]], np.ones(len(near))])
    astray = np.array([1.0, stray[0], stray[1], stray.prod()])
    with np.errstate(divide="ignore"):
        return np.log(np.maximum(whole, LEAST)) + np.log(astray)


@once_a_model
def pool_of(model: PoseModel) -> np.ndarray:
    """`(3, 5, 2, POOL)`: where the joints of each limb lie from its start, in the local axes of its
    upper bone, in draws of the prior; single precision. The same ones for every key, since no guess
    makes a draw wrong.

    They are what attempts bring that have nothing to explain, so that nothing else has to be
    compiled; where limits are narrow, some come more than once."""
    tables, views = group_tables(model), blind(POOL // KEPT)
    outlier = np.zeros(views.reach.shape, bool)
    found = attempt_limbs(tables, {}, WORDS, PAPER.law, BLIND_EFFORT, views, outlier, 0)
    pool, limb = np.empty((3, len(LIMBS), 2, POOL), np.float32), 0
    for name, group in tables.items():
        draws = [one[name].draws for one in found]
        length, upper, lower = (np.concatenate(parts) for parts in zip(*draws, strict=True))
        length = np.resize(length[:, [0, -1]], (POOL, 2))
        for place, build in enumerate(group.builds):
            directions = (np.resize(part[:, place], (POOL, 3)) for part in (upper, lower))
            limb_ends(build.reference, length, *directions, pool[:, limb])
            if build.bones == 1:
                pool[:, limb, 1] = pool[:, limb, 0]
            limb += 1
    return pool


def propose(fit: Fit, stratum: Stratum, rng: np.random.Generator) -> tuple[Faults, np.ndarray]:
    """A pattern `(n, ...)` for each root, and the log probability `(n,)` with which it was proposed
    in its stratum."""
    number = len(fit.limbs)
    which, log_proposal = _pick(fit.by_exchange, rng)
    rows = np.arange(number)
    limbs = fit.limbs[rows, which]
    outlier = np.tile(stratum.faults.outlier, (number, 1))
    exchange = np.array(fit.exchanges)[which]
    for limb, ends in enumerate(ENDS):
        pattern, log_part = _pick(limbs[:, limb], rng)
        log_proposal = log_proposal + log_part
        for place, end in enumerate(ends):
            if place == 0 or CHAINED[limb]:
                # Outliers are keypoints: under an exchange, another joint's.
                keypoint = ORDERS[exchange, end]
                outlier[rows, keypoint] = PATTERNS[pattern, place]
    return Faults(exchange, outlier), log_proposal


def _pick(score: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """One of the columns in each row of `score` `(n, m)`, by its exponential, and the log
    probability that it had."""
    share = (1 - DEFENSIVE) * _normal(score) + DEFENSIVE * _normal(score / 2)
    ends = np.cumsum(share, axis=1)
    ends /= ends[:, -1:]
    picked = (rng.uniform(size=(len(score), 1)) >= ends).sum(axis=1)
    taken = share[np.arange(len(score)), picked] / share.sum(axis=1)
    return picked, np.log(taken)


def _normal(score: np.ndarray) -> np.ndarray:
    return np.exp(score - logsumexp(score, axis=1, keepdims=True))


def log_priors(posterior: Posterior, faults: Faults) -> np.ndarray:
    """`(n,)`: for each pattern the log of its prior probability × the peak of the likelihood under
    it at scale one."""
    return in_chunks(functools.partial(_log_priors, posterior.faults, posterior.detected), *faults)


@jax.jit
def _log_priors(prior: FaultPrior, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    def one(faults: Faults) -> jax.Array:
        return prior.log_prob(detected.counts, faults) + detected.read(faults).log_peak()

    return jax.vmap(one)(Faults(*fields))
