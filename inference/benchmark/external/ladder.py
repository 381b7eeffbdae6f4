"""Non-reversible parallel tempering (Okabe et al. 2001; Syed, Bouchard-Côté, Deligiannidis & Doucet
2022), which no library has on the versions of this one: few lines on the random-walk Metropolis of
the baselines.

A ladder has a level for each inverse temperature of the graded likelihood, from 0, where every
sweep draws anew from the prior, to 1; its last rung is the target itself. Even and odd pairs of
neighbours are asked in turn to swap, which carries states up and down without the random walk that
swaps of random pairs make. While it is tuned, in rounds that double, levels are spaced so that all
swaps are turned down equally often, and every level's proposals take on its covariance; then
nothing changes any more, and only draws from then on count."""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.metropolis import (
    ACCEPTANCE,
    Stride,
    metropolis,
    root_of_covariance,
)
from poseterior.inference.baselines.run import Allowance
from poseterior.inference.baselines.target import Target
from poseterior.inference.benchmark.external.entries import CLOCK, ExternalSampler, SamplerRun
from poseterior.inference.benchmark.external.graded import HARDNESS
from poseterior.inference.benchmark.forms import SamplerTarget
from poseterior.inference.benchmark.programs import in_jax
from poseterior.inference.benchmark.submission import FEWEST_OF_CHAIN, Submission
from poseterior.inference.benchmark.uncertain import UncertainTarget

LADDERS, RUNGS = 4, 24
"""Ladders apart from each other, each one chain; and levels of a ladder."""
MOVES = 5
"""Metropolis steps of every level in a sweep."""
SWEEPS = 32
"""Of a batch, after which the clock is looked at; even, so that pairs keep their turns."""
TUNING, BURN_IN = 0.3, 0.25
"""The share of what is allowed that goes into tuning, and of what is drawn then that is thrown
away."""
COLDEST = 1e-6
"""The least inverse temperature above 0 to begin with: beyond a wall the graded likelihood falls by
thousands of nats."""
COVARIANCE = 4000
"""Points of a level whose covariance its proposals take on, at most, the latest ones."""
GAIN = 4.0
"""How fast a level's scale follows its acceptance, a round."""
Density = Target | UncertainTarget


class Settings(NamedTuple):
    """What is tuned: inverse temperatures `(levels,)`, the logs of the proposals' scales
    `(levels,)`, and roots of their covariances `(levels, d, d)`."""

    inverse: jax.Array
    log_scale: jax.Array
    root: jax.Array

    @classmethod
    def first(cls, dim: int) -> "Settings":
        """Geometric levels, and proposals as wide as the prior."""
        inverse = jnp.array([0.0, *np.geomspace(COLDEST, 1, RUNGS - 2), 1.0])
        root = jnp.tile(jnp.eye(dim), (RUNGS, 1, 1))
        return cls(inverse, jnp.full(RUNGS, np.log(2.38 / np.sqrt(dim))), root)

    def tuned(self, batches: "list[Batch]") -> "Settings":
        """The next ones, by what happened under these."""
        refused = np.mean([1 - batch.swapped for batch in batches], axis=0)[:-1] + 1e-3
        barrier = np.concatenate([[0.0], np.cumsum(refused)])
        height = np.log(np.asarray(self.inverse)[:-1] + COLDEST)
        spaced = np.exp(np.interp(np.linspace(0, barrier[-1], RUNGS - 1), barrier, height))
        inverse = np.concatenate([np.maximum(spaced - COLDEST, 0), [1.0]])
        inverse[0] = 0.0
        inverse[-2] = 1.0
        moved = np.mean([batch.moved for batch in batches], axis=0)
        points = np.concatenate([batch.points for batch in batches])
        points = np.moveaxis(points, 2, 0).reshape(RUNGS, -1, points.shape[-1])
        root = _roots(jnp.asarray(points[:, -COVARIANCE:]))
        return Settings(jnp.asarray(inverse), self.log_scale + GAIN * (moved - ACCEPTANCE), root)


class Batch(NamedTuple):
    """What some sweeps did: `points` `(sweeps, ladders, levels, d)`, the share of moves accepted
    `(levels,)`, and how likely swaps were to be `(levels - 1,)`."""

    points: np.ndarray
    moved: np.ndarray
    swapped: np.ndarray


class Ladders:
    """The ladders at work, and the evaluations that they have cost."""

    def __init__(self, target: SamplerTarget, seed: int) -> None:
        self._target = target
        self._rng = np.random.default_rng(seed)
        self._density = in_jax(target)
        self._key = jax.random.key(seed)
        self._points = self._prior(RUNGS)
        self._batches = self.evaluations = 0
        self.settings = Settings.first(target.dim)

    def _prior(self, number: int) -> np.ndarray:
        """`(ladders, number, d)` draws of the prior."""
        points = self._target.prior_points(self._rng, LADDERS * number)
        return points.reshape(LADDERS, number, self._target.dim)

    def sweep(self) -> Batch:
        """A batch of sweeps further."""
        fresh = np.moveaxis(self._prior(SWEEPS), 1, 0)
        key = jax.random.fold_in(self._key, self._batches)
        found = _sweeps(self._density, self.settings, self._points, fresh, key)
        batch = Batch(*map(np.asarray, found))
        self._points = batch.points[-1]
        self._batches += 1
        self.evaluations += SWEEPS * LADDERS * RUNGS * (MOVES + 2)
        return batch


def nrpt(target: SamplerTarget, seed: int, allowance: Allowance) -> SamplerRun | None:
    """Non-reversible parallel tempering. None where no ladder's last rung came inside for good, or
    the allowance ends with the tuning."""
    Ladders(target, seed).sweep()  # compiled before the clock runs
    ladders = Ladders(target, seed)
    started = CLOCK()
    tuning = Allowance(_part(allowance.evaluations), _part(allowance.seconds))
    for number in itertools.count():
        batches: list[Batch] = []
        while len(batches) < 2**number and tuning.allows(ladders.evaluations, CLOCK() - started):
            batches.append(ladders.sweep())
        if not batches:
            break
        ladders.settings = ladders.settings.tuned(batches)
    before = CLOCK() - started
    last = []
    while allowance.allows(ladders.evaluations, CLOCK() - started):
        last.append(ladders.sweep().points[:, :, -1])
    seconds = CLOCK() - started
    paths = np.concatenate(last) if last else np.empty((0, LADDERS, target.dim))
    outside = target.misfit(paths).max(axis=1) > 1  # of any ladder
    begun = max(int(BURN_IN * len(paths)), *(1 + np.flatnonzero(outside)[-1:]), 0)
    points = np.moveaxis(paths[begun:], 1, 0)
    if points.shape[1] < FEWEST_OF_CHAIN:
        return None
    costs = {"evaluations": float(ladders.evaluations), "seconds": seconds}
    kept = (1 - before / seconds) * points.shape[1] / len(paths)
    number = points.shape[0] * points.shape[1]
    return SamplerRun(Submission(points, number, **costs), kept=kept, steps=points.shape[1])


def _part(allowed: float | None) -> Any:
    return None if allowed is None else TUNING * allowed


@jax.jit
def _roots(points: jax.Array) -> jax.Array:
    return jax.vmap(root_of_covariance)(points)


@jax.jit
def _sweeps(
    density: Density, settings: Settings, points: jax.Array, fresh: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """As `Batch` has it: from points `(ladders, levels, d)`, with draws of the prior
    `(sweeps, ladders, d)` for the first levels."""

    def sweep(points: jax.Array, given: tuple[jax.Array, ...]) -> tuple[jax.Array, Any]:
        drawn, turn, key = given
        for_moves, for_swaps = jax.random.split(key)
        points, moved = _moved(density, settings, points.at[:, 0].set(drawn), for_moves)
        points, swapped = _swapped(density, settings.inverse, points, turn, for_swaps)
        return points, (points, moved, swapped)

    turns = jnp.arange(len(fresh)) % 2
    _, (paths, moved, swapped) = jax.lax.scan(
        sweep, jnp.asarray(points), (fresh, turns, jax.random.split(key, len(fresh)))
    )
    return paths, moved.mean(axis=0), swapped.mean(axis=0)


def _heights(density: Density, inverse: jax.Array, point: jax.Array) -> jax.Array:
    """`(levels,)`: every level's log likelihood of one point. Within reach the graded one is the
    target's."""
    graded = density.log_graded(point, HARDNESS)
    hard = jnp.where(density.misfit(point) <= 1, graded, -jnp.inf)
    return (inverse * graded).at[-1].set(hard)


def _moved(
    density: Density, settings: Settings, points: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Metropolis steps of every level, of scales scattered by a factor of e about the level's own:
    where walls are thin, one is too long, and across the valley too short."""

    def one(level: jax.Array, point: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        def log_density(at: jax.Array) -> jax.Array:
            return density.log_base(at) + _heights(density, settings.inverse, at)[level]

        for_scale, own = jax.random.split(key)
        scale = settings.log_scale[level] + jax.random.normal(for_scale)
        walker = Stride(point, log_density(point), scale, own)

        def step(walker: Stride, _: None) -> tuple[Stride, jax.Array]:
            return metropolis(log_density, walker, settings.root[level], jnp.zeros(()))

        walker, accepted = jax.lax.scan(step, walker, None, length=MOVES)
        return walker.point, accepted.mean()

    levels = jax.vmap(one)
    keys = jax.random.split(key, points.shape[:2])
    points, accepted = jax.vmap(levels, in_axes=(None, 0, 0))(jnp.arange(RUNGS), points, keys)
    return points, accepted.mean(axis=0)


def chance_of(gain: jax.Array) -> jax.Array:
    """How likely neighbours are to swap, by what the log density of both together gains. Where both
    have none, there is no number, and nothing to gain."""
    return jnp.where(jnp.isnan(gain), 0.0, jnp.exp(jnp.minimum(gain, 0.0)))


def _swapped(
    density: Density, inverse: jax.Array, points: jax.Array, turn: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Neighbours exchanged, of pairs whose turn it is, and how likely each pair was to be."""
    heights = jax.vmap(jax.vmap(lambda point: _heights(density, inverse, point)))(points)
    own = jnp.diagonal(heights, axis1=1, axis2=2)
    # A level's point one level up, and one level down.
    up = jnp.diagonal(heights, offset=1, axis1=1, axis2=2)
    down = jnp.diagonal(heights, offset=-1, axis1=1, axis2=2)
    gain = up + down - own[:, :-1] - own[:, 1:]
    chance = chance_of(gain)
    levels = jnp.arange(RUNGS)[None]
    chosen = (jax.random.uniform(key, chance.shape) < chance) & (levels[:, :-1] % 2 == turn)
    step = jnp.pad(chosen.astype(int), ((0, 0), (0, 1)))
    order = levels + step - jnp.roll(step, 1, axis=1)
    return jnp.take_along_axis(points, order[..., None], axis=1), chance.mean(axis=0)


NRPT = ExternalSampler(
    nrpt,
    "non-reversible parallel tempering, ours: 4 × 24 levels, random-walk Metropolis, swaps of even"
    " and odd pairs in turn, levels spaced by the rejections of swaps",
)
