"""Nested sampling: BlackJAX's nested slice sampling and nautilus, on a graded likelihood.

An indicator gives a nested sampler nothing to climb, so both climb the misfit (the largest distance of a seen joint
from its detection, in radii τ) down to 1. Nested slice sampling treats -misfit as the likelihood, stops when all live
points explain the detection, and counts the prior volume inside. nautilus samples exp(-GRADE · max(misfit - 1, 0)),
whose draws inside are draws of the posterior; its evidence times their share is the evidence.
"""

import functools
import tempfile
import warnings
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from inference.samplers.baseline import Baseline, Drawn, Method
from inference.target import Target
from probmodel.chunks import in_chunks

LIVE = 500
DELETED = 50
"""Live points, and how many of them are replaced at a time."""
SIMULATIONS = 200
"""Simulated prior volumes, from which the error of the evidence comes."""
NAUTILUS_LIVE = 1000
NAUTILUS_BATCH = 512
GRADE = 100.0
"""Slope of nautilus's likelihood in the misfit: most of its mass lies within 1 % of the discs."""
GLANCE = 2.0
"""Seconds that nautilus is let run at a time."""


class NestedSlice:
    """BlackJAX's nested slice sampling; `2 · d` slice steps a new point, as its documentation asks."""

    def __init__(self, target: Target, key: jax.Array) -> None:
        import blackjax

        def log_likelihood(point: jax.Array) -> jax.Array:
            return -target.misfit(point)

        self._target, self._key = target, key
        self._sampler = blackjax.nss(target.log_base, log_likelihood, 2 * target.dim, num_delete=DELETED)
        self._step = jax.jit(self._sampler.step)
        with jax.numpy_rank_promotion("allow"):
            live = self._sampler.init(target.prior_points(jax.random.fold_in(key, 0), LIVE))
        self._live = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), live)
        self._dead: dict[str, np.ndarray] = {name: np.empty((0,)) for name in ("death", "birth")}
        self._rounds, self.evaluations = 0, LIVE

    def more(self) -> bool:
        if self.held:
            return False
        key = jax.random.fold_in(self._key, 1 + self._rounds)
        with jax.numpy_rank_promotion("allow"):
            self._live, info = self._step(key, self._live)
        slices = info.update_info
        self.evaluations += int(np.sum(slices.num_expansions) + np.sum(slices.num_shrink))
        self._bury(info.particles)
        self._rounds += 1
        return not self._inside.all()

    def _bury(self, particles: Any) -> None:
        for name, leaf in (("death", particles.loglikelihood), ("birth", particles.loglikelihood_birth)):
            self._dead[name] = np.concatenate([self._dead[name], np.asarray(leaf)])

    @property
    def _inside(self) -> np.ndarray:
        return np.asarray(self._live.particles.loglikelihood) >= -1

    @property
    def held(self) -> int:
        return LIVE if self._inside.all() else 0

    def drawn(self, key: jax.Array) -> Drawn:
        points = np.asarray(self._live.particles.position)
        info = {"walkers": LIVE, "rounds": self._rounds, "misfit": float(-self._live.particles.loglikelihood.min()),
                "moved": 1.0, "kept": 1 / max(self._rounds, 1)}  # fmt: skip
        if not self.held:
            return Drawn(np.empty((1, 0, self._target.dim)), np.nan, np.nan, info)
        return Drawn(points[None], *self._evidence(key), info)

    def _evidence(self, key: jax.Array) -> tuple[float, float]:
        """Log prior volume inside, from simulated shrinkage (Skilling 2006): mean and standard deviation."""
        live = self._live.particles
        death = np.concatenate([self._dead["death"], np.asarray(live.loglikelihood)])
        birth = np.concatenate([self._dead["birth"], np.asarray(live.loglikelihood_birth)])
        order = np.argsort(death, kind="stable")
        # How many were alive when each died (Fowlie, Handley & Su 2021): born before, not yet dead; NaN: born first.
        born = np.sort(np.where(np.isnan(birth), -np.inf, birth))
        alive = np.searchsorted(born, death[order], side="left") - np.arange(len(order))
        outside = death[order] < -1
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        shrinkage = np.log(rng.uniform(size=(int(outside.sum()), SIMULATIONS))) / alive[outside, None]
        volumes = shrinkage.sum(axis=0)
        return float(volumes.mean()), float(volumes.std())

    def state(self) -> dict[str, np.ndarray]:
        leaves = {f"leaf{number}": np.asarray(leaf) for number, leaf in enumerate(jax.tree.leaves(self._live))}
        return {**leaves, **self._dead, "counts": np.array([self._rounds, self.evaluations])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        leaves, tree = jax.tree.flatten(self._live)
        found = [jnp.asarray(state[f"leaf{number}"]) for number in range(len(leaves))]
        self._live = jax.tree.unflatten(tree, found)
        self._dead = {name: state[name] for name in self._dead}
        self._rounds, self.evaluations = (int(count) for count in state["counts"])


class Nautilus:
    """nautilus with its defaults but for the live points; it keeps its own file, whose bytes are its state."""

    def __init__(self, target: Target, key: jax.Array) -> None:
        self._target = target
        self._seed = int(np.asarray(jax.random.key_data(key))[-1])
        self._folder = tempfile.TemporaryDirectory(prefix="poseterior-")
        self._open()

    @property
    def _path(self) -> Path:
        return Path(self._folder.name) / "nautilus.h5"

    def _open(self) -> None:
        import nautilus

        def likelihood(cube: np.ndarray) -> np.ndarray:
            misfit = in_chunks(self._target.misfit_in_cube, cube, size=NAUTILUS_BATCH)
            return -GRADE * np.maximum(misfit - 1, 0)

        self._sampler = nautilus.Sampler(
            lambda cube: cube, likelihood, self._target.dim, n_live=NAUTILUS_LIVE, n_batch=NAUTILUS_BATCH,
            vectorized=True, pass_dict=False, seed=self._seed, filepath=self._path,
        )  # fmt: skip

    @property
    def evaluations(self) -> int:
        return int(self._sampler.n_like)

    def more(self) -> bool:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its networks say that they could be trained longer
            return not self._sampler.run(timeout=GLANCE, n_eff=10_000)

    @property
    def held(self) -> int:
        return len(self._inside()) if self._sampler.explored else 0

    def _inside(self) -> np.ndarray:
        """Equally weighted points of the cube that explain the detection."""
        points, _, log_likelihood = self._sampler.posterior(equal_weight=True)
        return points[log_likelihood >= 0]

    def drawn(self, key: jax.Array) -> Drawn:
        info = {"walkers": 1, "moved": 1.0, "kept": 1.0, "explored": float(self._sampler.explored)}
        cube = self._inside() if self._sampler.explored else np.empty((0, self._target.dim))
        if not len(cube):
            return Drawn(np.empty((1, 0, self._target.dim)), np.nan, np.nan, info)
        points = self._target.points_of(self._target.poses_in_cube(key, cube))
        _, log_weight, log_likelihood = self._sampler.posterior()
        share = float(np.exp(log_weight)[log_likelihood >= 0].sum() / np.exp(log_weight).sum())
        error = float(np.sqrt(1 / self._sampler.n_eff + (1 - share) / (share * self._sampler.n_eff)))
        return Drawn(points[None], float(self._sampler.log_z + np.log(share)), error, info)

    def state(self) -> dict[str, np.ndarray]:
        if self.evaluations:
            self._sampler.write(self._path, overwrite=True)
        there = self._path.exists()
        return {"file": np.frombuffer(self._path.read_bytes() if there else b"", np.uint8)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self._path.unlink(missing_ok=True)
        if len(state["file"]):
            self._path.write_bytes(state["file"].tobytes())
        self._open()


def _nested(target: Target, key: jax.Array, starts: np.ndarray, method: Any) -> Method:
    return method(target, key)


NESTED = {
    "nss": Baseline(
        functools.partial(_nested, method=NestedSlice), 0,
        "BlackJAX nested slice sampling of -misfit, 500 live points, 50 replaced at a time, 2d slice steps each",
        extra=("blackjax",),
    ),
    "nautilus": Baseline(
        functools.partial(_nested, method=Nautilus), 0,
        "nautilus on a likelihood graded by the misfit, 1000 live points, its defaults otherwise", extra=("nautilus",),
    ),
}  # fmt: skip
