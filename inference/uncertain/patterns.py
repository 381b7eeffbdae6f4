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
import jax.numpy as jnp
import numpy as np
from scipy.special import logsumexp

from inference.uncertain.limbs import Views, prior_poses, views_of
from probmodel.chunks import in_chunks
from probmodel.faults import (
    LIMB_INDEX,
    MOVES_TORSO,
    NUM_EXCHANGES,
    ORDERS,
    FaultPrior,
    Faults,
    faults_of,
)
from probmodel.kinematics import upper_axes
from probmodel.model import PoseModel
from probmodel.pose import Pose
from probmodel.roots import RootPoint
from probmodel.skeleton import GROUPS, TORSO_INDEX
from probmodel.uncertain import DetectedJoints, UncertainPosterior

BLUR = 0.06
"""Body units by which errors are widened, so that so few draws come near every detection."""
DEFENSIVE = 0.1
"""The share of a proposal that is flatter than what the pool says: the square root of it."""
SHARE = 32
"""Roots that are worked on at a time, which bounds the memory."""
LEAST = 1e-30
"""The least density of a joint, per square body unit: in single precision it would be zero."""
LIMBS = tuple(limb for members in GROUPS.values() for limb in members)
ENDS = np.array([[bone.end for bone in (*limb.bones, *limb.bones)[:2]] for limb in LIMBS])
"""`(5, 2)`: the joints of each limb, from the torso outwards; the head's twice."""
CHAINED = np.array([limb.lower is not None for limb in LIMBS])
PATTERNS = np.array([[False, False], [True, False], [False, True], [True, True]])
"""`(4, 2)`: which joints of a limb are outliers."""


class Stratum(NamedTuple):
    """The faults of the torso's keypoints, `faults`; and the `exchanges`, indices into
    `faults.EXCHANGES`, that come with them."""

    faults: Faults
    exchanges: tuple[int, ...]


def strata_of(posterior: UncertainPosterior) -> list[Stratum]:
    """All that may be wrong with the torso's keypoints, nothing first."""
    prior, counts = posterior.faults, np.asarray(posterior.detected.counts)
    probability = (1.0, *prior.exchange)
    still = [index for index in range(NUM_EXCHANGES) if not MOVES_TORSO[index]]
    possible = tuple(index for index in still if probability[index])
    found = [Stratum(Faults.none(), possible)]
    for place, joint in enumerate(TORSO_INDEX, 1):
        if prior.outlier[joint] and counts[joint]:
            found.append(Stratum(_pattern(0, place, np.zeros(len(LIMB_INDEX))), possible))
    for index in np.flatnonzero(MOVES_TORSO).tolist():
        if probability[index]:
            found.append(Stratum(_pattern(index, 0, np.zeros(len(LIMB_INDEX))), (index,)))
    return found


def prior_share(posterior: UncertainPosterior, stratum: Stratum) -> float:
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


def fit_of(
    posterior: UncertainPosterior, pool: np.ndarray, stratum: Stratum, points: RootPoint
) -> Fit:
    """How well the `pool` of `pool_of` fits under each exchange and pattern at roots `(n, ...)`."""
    prior, number = posterior.faults, len(points.torso)
    rows = []
    for exchange in stratum.exchanges:
        faults = Faults.none(number)._replace(exchange=np.full(number, exchange))
        views = views_of(posterior, points, faults)
        spread = np.asarray(posterior.detected.spread)[ORDERS[exchange]][ENDS]
        outlier = np.array(prior.outlier)[ORDERS[exchange]][ENDS]
        fit = functools.partial(_fit, pool, spread, outlier, prior.reach)
        rows.append(in_chunks(fit, *views, size=SHARE))
    probability = np.array([1 - sum(prior.exchange), *prior.exchange])
    return Fit(
        np.stack(rows, axis=1), stratum.exchanges, np.log(probability[list(stratum.exchanges)])
    )


def pool_of(model: PoseModel, words: list[int]) -> np.ndarray:
    """`(3, 5, 2, n)`: where the joints of each limb lie from its start, in the local axes of its
    upper bone, in the `n` draws of `prior_poses`; single precision."""
    return np.asarray(_pool(model, prior_poses(model, words)), np.float32)


@jax.jit
def _pool(model: PoseModel, poses: Pose) -> jax.Array:
    torso = jnp.asarray(model.torsos)[0]
    joints = model.joints(torso, *poses)
    starts = np.array([limb.bones[0].start for limb in LIMBS])
    axes = upper_axes(torso)[np.array([limb.upper for limb in LIMBS])]
    return jnp.einsum("lij,plei->jlep", axes, joints[:, ENDS] - joints[:, starts, None])


@jax.jit
def _fit(
    pool: jax.Array, spread: jax.Array, outlier: jax.Array, far: float, *fields: jax.Array
) -> jax.Array:
    """`(n, 5, 4)`: log likelihood and log prior of each limb's patterns.

    In single precision, and written out coordinate by coordinate: this is done for many more roots
    than are weighed, and so it is ten times as fast."""
    upper = np.array([limb.upper for limb in LIMBS])
    starts = np.array([TORSO_INDEX.index(limb.bones[0].start) for limb in LIMBS])
    counts = jnp.isfinite(spread) & jnp.stack([jnp.ones(5, bool), jnp.asarray(CHAINED)], axis=1)
    # The laws' variance either way is a quarter of the squared spread, Student's a little more.
    variance = jnp.where(counts, spread**2 / 4 + BLUR**2, 1.0)
    peak = jnp.where(counts, (1 - outlier) / (2 * jnp.pi * variance), 1.0)
    rate = jnp.where(counts, 1 / (2 * variance), 0.0)
    peak, rate = (part.astype(jnp.float32)[..., None] for part in (peak, rate))
    stray = jnp.where(counts, outlier / (jnp.pi * far**2), 0.0)

    def one(views: Views) -> jax.Array:
        plane = views.axes[upper, :2].astype(jnp.float32)[..., None, None]
        gap = (views.start[starts][:, None] - views.target[ENDS]).astype(jnp.float32)
        square = jnp.zeros(())
        for i in range(2):
            fall = sum(plane[:, i, j] * pool[j] for j in range(3))
            square = square + (fall + gap[:, :, i, None]) ** 2
        inner, outer = jnp.moveaxis(peak * jnp.exp(-rate * square), 1, 0)
        near = [part.mean(axis=-1) for part in (inner * outer, outer, inner)]
        whole = [*(jnp.maximum(part.astype(float), LEAST) for part in near), jnp.ones(5)]
        astray = [jnp.ones(5), stray[:, 0], stray[:, 1], stray[:, 0] * stray[:, 1]]
        return jnp.log(jnp.stack(whole, axis=-1)) + jnp.log(jnp.stack(astray, axis=-1))

    return jax.vmap(one)(Views(*fields))


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


def log_priors(posterior: UncertainPosterior, faults: Faults) -> np.ndarray:
    """`(n,)`: for each pattern the log of its prior probability × the peak of the likelihood under
    it at scale one."""
    return in_chunks(functools.partial(_log_priors, posterior.faults, posterior.detected), *faults)


@jax.jit
def _log_priors(prior: FaultPrior, detected: DetectedJoints, *fields: jax.Array) -> jax.Array:
    def one(faults: Faults) -> jax.Array:
        return prior.log_prob(detected.counts, faults) + detected.read(faults).log_peak()

    return jax.vmap(one)(Faults(*fields))
