"""Sequential Monte Carlo that tempers τ: discs that shrink from wider than the image to their own
size (BlackJAX).

A population begins with the prior. Each stage keeps the particles whose worst joint lies within the
next, smaller multiple of τ (the median of all, never below 1), fills up with copies, and moves
every particle by random-walk Metropolis inside that wider posterior. The product of the kept shares
is the evidence. At multiple 1 the particles walk on. Source: Del Moral, Doucet & Jasra (2006,
2012); the schedule is that of multilevel splitting (Cérou et al. 2012)."""

import functools
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
from poseterior.inference.baselines.run import Baseline, Drawn
from poseterior.inference.baselines.target import Target

POPULATIONS = 4
PARTICLES = 256
MOVES = 60
"""Metropolis steps of every particle in a stage."""
SHARE = 0.5
"""Share of the particles that a stage keeps."""


class Population(NamedTuple):
    """Particles `(n, d)`, the multiple of τ that they live in, the log of the proposal's scale, the
    log evidence and its variance so far, stages done, and the key."""

    points: jax.Array
    multiple: jax.Array
    log_scale: jax.Array
    log_evidence: jax.Array
    variance: jax.Array
    key: jax.Array


class Tempering:
    """Populations apart from each other, each one chain: particle after particle, stage after stage
    at multiple 1."""

    def __init__(self, target: Target, key: jax.Array) -> None:
        self._target = target
        self.evaluations = 0
        self._populations = [
            _begin(target, jax.random.fold_in(key, run)) for run in range(POPULATIONS)
        ]
        self._kept = np.empty((POPULATIONS, 0, PARTICLES, target.dim))
        self._stages = 0
        self.restore(
            self.state()
        )  # of the types that a restored state has, so that nothing is compiled twice

    def more(self) -> bool:
        for run, population in enumerate(self._populations):
            self._populations[run] = _stage(self._target, population)
            self.evaluations += PARTICLES * (MOVES + 1)
        self._stages += 1
        if self._there:
            points = np.stack([np.asarray(population.points) for population in self._populations])
            self._kept = np.concatenate([self._kept, points[:, None]], axis=1)
        return True

    @property
    def _there(self) -> bool:
        return all(float(population.multiple) <= 1 for population in self._populations)

    @property
    def held(self) -> int:
        return int(np.prod(self._kept.shape[:-1]))

    def drawn(self, key: jax.Array) -> Drawn:
        runs, stages, particles, dim = self._kept.shape
        points = np.moveaxis(self._kept, 2, 1).reshape(runs, particles * stages, dim)
        moved = (
            float(np.mean(np.any(np.diff(self._kept, axis=1) != 0, axis=-1))) if stages > 1 else 1.0
        )
        multiple = max(float(population.multiple) for population in self._populations)
        info = {
            "runs": runs,
            "walkers": particles,
            "steps": stages,
            "moved": moved,
            "multiple": multiple,
            "kept": stages / max(self._stages, 1),
        }
        return Drawn(points, *self._evidence(), info)

    def _evidence(self) -> tuple[float, float]:
        """Log of the mean over populations, and the larger of two standard errors: their spread's,
        and the binomial."""
        if not self._there:
            return np.nan, np.nan
        logs = np.array([float(population.log_evidence) for population in self._populations])
        spread = logs.std(ddof=1) / np.sqrt(POPULATIONS)
        binomial = np.sqrt(
            np.mean([float(population.variance) for population in self._populations]) / POPULATIONS
        )
        return float(np.logaddexp.reduce(logs) - np.log(POPULATIONS)), float(max(spread, binomial))

    def state(self) -> dict[str, np.ndarray]:
        names = Population._fields[:-1]
        found = {
            name: np.stack([np.asarray(getattr(one, name)) for one in self._populations])
            for name in names
        }
        keys = np.stack([np.asarray(jax.random.key_data(one.key)) for one in self._populations])
        return {
            **found,
            "keys": keys,
            "kept": self._kept,
            "counts": np.array([self.evaluations, self._stages]),
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self._populations = [
            Population(
                **{name: jnp.asarray(state[name][run]) for name in Population._fields[:-1]},
                key=jax.random.wrap_key_data(jnp.asarray(state["keys"][run])),
            )
            for run in range(POPULATIONS)
        ]
        self._kept = state["kept"]
        self.evaluations, self._stages = (int(count) for count in state["counts"])


def _begin(target: Target, key: jax.Array) -> Population:
    points = target.prior_points(jax.random.fold_in(key, 0), PARTICLES)
    zero = jnp.zeros(())
    scale = jnp.log(2.38 / jnp.sqrt(jnp.asarray(float(target.dim))))
    return Population(points, jnp.asarray(jnp.inf), scale, zero, zero, jax.random.fold_in(key, 1))


def next_multiple(misfit: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The multiple of τ that comes after particles' misfits `(n,)`, and which of them it keeps. The
    particle that sets it is not among those: counted, it would make every share too large (Cérou et
    al. 2012)."""
    multiple = jnp.maximum(jnp.sort(misfit)[int(SHARE * len(misfit))], 1.0)
    return multiple, misfit < multiple


@jax.jit
def _stage(target: Target, population: Population) -> Population:
    """Resample by the next multiple, then move; at multiple 1 nothing is lost, and the particles
    only move."""
    from blackjax.smc import base
    from blackjax.smc.resampling import systematic

    key, for_step = jax.random.split(population.key)
    multiple, inside = next_multiple(target.misfit(population.points))
    kept = jnp.mean(inside)

    def density(point: jax.Array) -> jax.Array:
        return target.log_base(point) + jnp.where(target.misfit(point) <= multiple, 0.0, -jnp.inf)

    state = base.SMCState(population.points, inside / jnp.sum(inside), {})
    root = root_of_covariance(population.points)

    def move(keys: jax.Array, points: jax.Array, _: Any) -> tuple[jax.Array, jax.Array]:
        return _moves(density, keys, points, root, population.log_scale)

    state, info = base.step(for_step, state, move, lambda points: jnp.zeros(PARTICLES), systematic)
    log_scale = population.log_scale + 2 * (jnp.mean(info.update_info) - ACCEPTANCE)
    return Population(
        state.particles,
        multiple,
        jnp.clip(log_scale, -6.0, 1.0),
        population.log_evidence + jnp.log(kept),
        population.variance + (1 - kept) / (kept * PARTICLES),
        key,
    )


def _moves(
    density: Any, keys: jax.Array, points: jax.Array, root: jax.Array, log_scale: jax.Array
) -> tuple[jax.Array, jax.Array]:
    walkers = Stride(points, jax.vmap(density)(points), jnp.full(len(points), log_scale), keys)
    step = jax.vmap(functools.partial(metropolis, density), in_axes=(0, None, None))

    def one(walkers: Stride, _: None) -> tuple[Stride, jax.Array]:
        return step(walkers, root, jnp.zeros(()))

    after, accepted = jax.lax.scan(one, walkers, None, length=MOVES)
    return after.point, jnp.mean(accepted, axis=0)


TEMPERINGS = {
    "smc": Baseline(
        lambda target, key, starts: Tempering(target, key),
        0,
        "SMC that tempers τ (BlackJAX's step and systematic resampling), 4 × 256 particles, 60"
        " moves a stage",
        extra=("blackjax",),
        discs=True,
    ),
}
