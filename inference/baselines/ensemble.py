"""Ensembles of walkers that propose from each other's places: emcee's moves, NumPyro's AIES and
ensemble slice sampling.

Several ensembles run apart; walkers of one ensemble are not independent, so each ensemble is one
chain. All walk in R^d. emcee's own snooker move is not used: up to release 3.1.6 it samples another
law (on a normal distribution in ten dimensions its variance is 0.6 instead of 1;
`tests/inference/test_baselines.py`)."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.chains import Kernel, Trace, settled, walking
from poseterior.inference.baselines.run import Baseline
from poseterior.inference.baselines.target import Density

RUNS = 4
WALKERS = 64
"""Walkers of an ensemble: even, and more than twice 23, as both libraries ask."""
ENSEMBLE_STEPS = 32
"""Steps of all ensembles between two looks at the clock."""
SNOOKER_SCALE = 1.7
"""Ter Braak & Vrugt (2008), § 2."""


class EmceeKernel:
    """An ensemble of emcee with the moves of `moves()`."""

    walkers = WALKERS
    warm_up = 0

    def __init__(self, target: Density, moves: Any) -> None:
        import emcee

        self._state = emcee.State

        def log_density(points: np.ndarray) -> np.ndarray:
            return np.asarray(target.log_density(points))

        self._sampler = emcee.EnsembleSampler(
            WALKERS, target.dim, log_density, moves=moves, vectorize=True
        )

    def start(self, key: jax.Array, points: np.ndarray) -> dict[str, np.ndarray]:
        # emcee has no seed argument: its generator is set through the state.
        _, words, position, *_ = np.random.RandomState(
            np.asarray(jax.random.key_data(key))
        ).get_state()
        return {
            "points": points,
            "log_density": self._sampler.log_prob_fn(points),
            "words": np.asarray(words),
            "generator": np.array([position, 0, 0.0]),
        }

    def advance(
        self, state: dict[str, np.ndarray], steps: int
    ) -> tuple[dict[str, np.ndarray], Trace]:
        position, has_normal, normal = state["generator"]
        generator = ("MT19937", state["words"], int(position), int(has_normal), float(normal))
        now = self._state(state["points"], log_prob=state["log_density"], random_state=generator)
        trace = np.empty((steps, *state["points"].shape))
        walk = self._sampler.sample(
            now, iterations=steps, store=False, skip_initial_state_check=True
        )
        for step, now in enumerate(walk):
            trace[step] = now.coords
        _, words, *numbers = now.random_state
        after = {
            "points": np.array(now.coords),
            "log_density": np.array(now.log_prob),
            "words": np.array(words),
            "generator": np.array(numbers, float),
        }
        return after, Trace(trace, steps * WALKERS)


def _stretch() -> Any:
    import emcee

    return emcee.moves.StretchMove()


def _differential() -> Any:
    import emcee

    return [(emcee.moves.DEMove(), 0.8), (snooker(), 0.2)]


def snooker() -> Any:
    """The snooker move of ter Braak & Vrugt (2008) as an emcee move, with their acceptance
    ratio."""
    import emcee

    class Snooker(emcee.moves.RedBlueMove):
        """A step along the line through another walker z, by the difference of two more projected
        on it. Where z is in the same place there is no line, and no step."""

        def __init__(self) -> None:
            super().__init__(nsplits=4)

        def get_proposal(
            self, active: np.ndarray, others: list[np.ndarray], random: Any
        ) -> tuple[np.ndarray, np.ndarray]:
            order = random.permutation(3)
            z, one, two = (
                others[row][random.randint(len(others[row]), size=len(active))] for row in order
            )
            line = active - z
            distance = np.linalg.norm(line, axis=1)
            apart = distance > 0
            distance[~apart] = 1.0
            along = np.sum(line * (one - two), axis=1) / distance**2
            proposal = active + SNOOKER_SCALE * along[:, None] * line
            farther = np.where(apart, np.linalg.norm(proposal - z, axis=1), 1.0)
            ratio = np.log(farther) - np.log(distance)
            return proposal, (active.shape[1] - 1) * ratio

    return Snooker()


class NumPyroKernel:
    """A kernel of NumPyro with its walkers, or chains, side by side. `evaluations_of(before,
    after)` counts."""

    def __init__(self, kernel: Any, walkers: int, warm_up: int, evaluations_of: Any) -> None:
        self.walkers, self.warm_up = walkers, warm_up
        self._kernel, self._evaluations_of = kernel, evaluations_of
        self._advance = jax.jit(self._walk, static_argnums=1)

    def start(self, key: jax.Array, points: np.ndarray) -> Any:
        with jax.numpy_rank_promotion("allow"):  # NumPyro promotes ranks
            return self._kernel.init(
                jax.random.split(key, self.walkers), self.warm_up, jnp.asarray(points), (), {}
            )

    def advance(self, state: Any, steps: int) -> tuple[Any, Trace]:
        with jax.numpy_rank_promotion("allow"):
            after, points, count = self._advance(state, steps)
        return after, Trace(np.asarray(points), int(count))

    def _walk(self, state: Any, steps: int) -> tuple[Any, jax.Array, jax.Array]:
        def one(state: Any, _: None) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            after = self._kernel.sample(state, (), {})
            return after, (after.z, self._evaluations_of(state, after))

        after, (points, counts) = jax.lax.scan(one, state, None, length=steps)
        return after, points, jnp.sum(counts)


def _potential(target: Density) -> Any:
    return lambda point: -target.log_density(point)


class SliceKernel(NumPyroKernel):
    """NumPyro's ensemble slice sampler: μ is tuned in the warm-up and then fixed, for it would go
    on tuning itself."""

    def __init__(self, target: Density) -> None:
        from numpyro.infer import ESS

        # Without randomize_split walkers would change places, and look as if they mixed.
        options = {"potential_fn": _potential(target), "randomize_split": False}
        self._tuning = NumPyroKernel(
            ESS(**options), WALKERS, 4 * ENSEMBLE_STEPS, _slice_evaluations
        )
        super().__init__(
            ESS(**options, tune_mu=False), WALKERS, self._tuning.warm_up, _slice_evaluations
        )

        self._compiled = False

    def start(self, key: jax.Array, points: np.ndarray) -> Any:
        other = super().start(key, points)  # gives the kernel its density
        if not self._compiled:
            super().advance(settled(other), ENSEMBLE_STEPS)
            self._compiled = True
        return self._tuning.start(key, points), jnp.zeros((), int)

    def advance(self, state: Any, steps: int) -> tuple[Any, Trace]:
        inner, done = state
        kernel = self._tuning.advance if int(done) < self.warm_up else super().advance
        inner, trace = kernel(inner, steps)
        return (inner, done + steps), trace


def _slice_evaluations(before: Any, after: Any) -> jax.Array:
    """Expansions and contractions that did something, and one look past either end of every
    walker's slice."""
    now, then = after.inner_state, before.inner_state
    reset = (now.n_expansions == 0) & (now.n_contractions == 0)
    spent = now.n_expansions - then.n_expansions + now.n_contractions - then.n_contractions
    return 2 * WALKERS + jnp.where(reset, WALKERS, spent)


def _affine(target: Density) -> Kernel:
    from numpyro.infer import AIES

    # Half and half, as in the example of its documentation.
    kernel = AIES(
        potential_fn=_potential(target), moves={AIES.DEMove(): 0.5, AIES.StretchMove(): 0.5}
    )
    return NumPyroKernel(kernel, WALKERS, 0, lambda before, after: jnp.asarray(WALKERS))


def _emcee(target: Density, moves: Any) -> Kernel:
    return EmceeKernel(target, moves())


def _row(kernel: Any, note: str) -> Baseline:
    build = walking(kernel, steps=ENSEMBLE_STEPS, runs=RUNS, ensemble=True)
    return Baseline(build, RUNS * WALKERS, note)


ENSEMBLES = {
    "emcee": _row(functools.partial(_emcee, moves=_stretch), "stretch move (emcee's default)"),
    "emcee-de": _row(
        functools.partial(_emcee, moves=_differential),
        "0.8 differential evolution, 0.2 snooker (emcee's advice; the snooker with its proper"
        " acceptance ratio)",
    ),
    "aies": _row(
        _affine,
        "NumPyro AIES: half differential evolution, half stretch (its documentation's example)",
    ),
    "ess": _row(
        SliceKernel, "NumPyro ensemble slice sampling, differential move, μ fixed after warm-up"
    ),
}
