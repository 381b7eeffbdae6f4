"""Markov chains as a method: any kernel that moves walkers, several runs apart, with a burn-in and
bounded memory."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.run import Drawn

BURN_IN = 0.25
"""Share of a chain's steps that is thrown away."""
KEPT = 1 << 16
"""Steps × walkers kept at least; beyond twice as many every second step is dropped and the stride
doubled."""
CAPACITY = int((1 - BURN_IN) * KEPT)
"""Draws that are left of what is kept at least."""


class Trace(NamedTuple):
    """What a kernel's walkers did: `points` `(steps, walkers, d)`, and how often the density was
    evaluated."""

    points: np.ndarray
    evaluations: int


class Kernel(Protocol):
    """One step of Markov chains, for `walkers` walkers at once. A state is a pytree of arrays."""

    walkers: int
    warm_up: int
    """Steps in which it tunes itself, thrown away."""

    def start(self, key: jax.Array, points: np.ndarray) -> Any:
        """The state of walkers that begin at `points` `(at least walkers, d)`."""

    def advance(self, state: Any, steps: int) -> tuple[Any, Trace]:
        """Some steps further."""


class Walk:
    """Markov chains as a method: `runs` times the same kernel, apart from each other, each with its
    own walkers.

    `ensemble`: the walkers of a run know of each other, and become one chain, walker after walker;
    otherwise each walker is a chain. The first `BURN_IN` of what is kept is left out."""

    def __init__(
        self,
        kernel: Kernel,
        key: jax.Array,
        starts: np.ndarray,
        *,
        runs: int,
        ensemble: bool,
        steps: int,
    ) -> None:
        self.kernel, self.ensemble, self.steps = kernel, ensemble, steps
        self.evaluations = 0
        places = starts.reshape(runs, -1, starts.shape[-1])
        self._states = [
            settled(kernel.start(jax.random.fold_in(key, run), places[run])) for run in range(runs)
        ]
        self._kept = np.empty((runs, 0, kernel.walkers, starts.shape[-1]))
        self._stride, self._done, self._warm = 1, 0, 0

    def more(self) -> bool:
        traces = []
        for run, state in enumerate(self._states):
            after, trace = self.kernel.advance(state, self.steps)
            self._states[run] = settled(after)
            self.evaluations += trace.evaluations
            traces.append(np.asarray(trace.points))
        if self._warm < self.kernel.warm_up:
            self._warm += self.steps
            return True
        first = -self._done % self._stride
        self._kept = np.concatenate(
            [self._kept, np.stack(traces)[:, first :: self._stride]], axis=1
        )
        self._done += self.steps
        if self._kept[..., 0].size > 2 * KEPT:
            self._kept = self._kept[:, ::2]
            self._stride *= 2
        return True

    @property
    def held(self) -> int:
        return int(np.prod(self._after_burn_in.shape[:-1]))

    @property
    def _after_burn_in(self) -> np.ndarray:
        return self._kept[:, int(np.ceil(BURN_IN * self._kept.shape[1])) :]

    @property
    def points(self) -> np.ndarray:
        """`(chain, draw, d)`: what is left after the burn-in."""
        kept = np.moveaxis(self._after_burn_in, 2, 1)  # runs, walkers, steps, d
        runs, walkers, steps, dim = kept.shape
        return kept.reshape(
            (runs, walkers * steps, dim) if self.ensemble else (runs * walkers, steps, dim)
        )

    def drawn(self, key: jax.Array) -> Drawn:
        kept = np.moveaxis(self._after_burn_in, 2, 1)
        runs, walkers, steps, _ = kept.shape
        moved = float(np.mean(np.any(np.diff(kept, axis=2) != 0, axis=-1))) if steps > 1 else np.nan
        kept_share = steps * self._stride / max(self._done + self._warm, 1)
        info = {
            "runs": runs,
            "walkers": walkers,
            "steps": steps,
            "stride": self._stride,
            "moved": moved,
            "kept": kept_share,
        }
        return Drawn(self.points, np.nan, np.nan, info)

    def state(self) -> dict[str, np.ndarray]:
        leaves = [_plain(leaf) for leaf in jax.tree.leaves(self._states)]
        return {f"leaf{number}": leaf for number, leaf in enumerate(leaves)} | {
            "kept": self._kept,
            "counts": np.array([self.evaluations, self._stride, self._done, self._warm]),
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        leaves, tree = jax.tree.flatten(self._states)
        found = [_like(leaf, state[f"leaf{number}"]) for number, leaf in enumerate(leaves)]
        self._states = jax.tree.unflatten(tree, found)
        self._kept = state["kept"]
        self.evaluations, self._stride, self._done, self._warm = (
            int(count) for count in state["counts"]
        )


def walking(
    kernel: Callable[[Any], Kernel], *, steps: int, runs: int = 1, ensemble: bool = False
) -> Callable[[Any, jax.Array, np.ndarray], Walk]:
    """How the walk of a kernel, which is made for a target, is built of target, key and starts."""
    return lambda target, key, starts: Walk(
        kernel(target), key, starts, runs=runs, ensemble=ensemble, steps=steps
    )


def settled(state: Any) -> Any:
    """A state whose leaves are of the very types that a restored state has, so that nothing is
    compiled twice."""
    return jax.tree.map(lambda leaf: _like(leaf, _plain(leaf)), state)


def _plain(leaf: Any) -> np.ndarray:
    is_key = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def _like(leaf: Any, saved: np.ndarray) -> Any:
    """A saved leaf as the kind of thing that `leaf` is: a NumPy array, a key, or else an array of
    JAX."""
    if isinstance(leaf, np.ndarray):
        return saved
    if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.asarray(saved))
    return jnp.asarray(saved)
