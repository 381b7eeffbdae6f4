"""Nested sampling: BlackJAX's nested slice sampling and nautilus, on a graded likelihood.

An indicator gives a nested sampler nothing to climb, so both climb the misfit (the largest distance
of a seen joint from its detection, in radii τ) down to 1. Nested slice sampling treats -misfit as
the likelihood, stops when all live points explain the detection, and counts the prior volume
inside. nautilus samples exp(-GRADE · max(misfit - 1, 0)), whose draws inside are draws of the
posterior; its evidence times their share is the evidence. Its neural networks are left out: they
were trained for minutes before there was a draw, in six dimensions."""

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.baselines.run import Baseline, Drawn
from poseterior.inference.baselines.target import Target
from poseterior.inference.resampling import systematic
from poseterior.probmodel.chunks import in_chunks

LIVE = 500
DELETED = 50
"""Live points, and how many of them are replaced at a time."""
SIMULATIONS = 200
"""Simulated prior volumes, from which the error of the evidence comes."""
NAUTILUS_BATCH, NAUTILUS_BATCHES = 512, 4
NAUTILUS_EFFECTIVE = 10_000
GRADE = 100.0
"""Slope of nautilus's likelihood in the misfit: most of its mass lies within 1 % of the discs."""
PLATEAU = 0.5
"""nautilus is through with exploring once its live points hold no more of the evidence than this.
At its default, 1 %, it goes on until the plateau inside the discs has a hundred times as many
points as are alive."""


class NestedSlice:
    """BlackJAX's nested slice sampling; `2 · d` slice steps a new point, as its documentation
    asks."""

    def __init__(self, target: Target, key: jax.Array) -> None:
        import blackjax

        def log_likelihood(point: jax.Array) -> jax.Array:
            return -target.misfit(point)

        self._target, self._key = target, key
        self._sampler = blackjax.nss(
            target.log_base, log_likelihood, 2 * target.dim, num_delete=DELETED
        )
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
        for name, leaf in (
            ("death", particles.loglikelihood),
            ("birth", particles.loglikelihood_birth),
        ):
            self._dead[name] = np.concatenate([self._dead[name], np.asarray(leaf)])

    @property
    def _inside(self) -> np.ndarray:
        return np.asarray(self._live.particles.loglikelihood) >= -1

    @property
    def held(self) -> int:
        return LIVE if self._inside.all() else 0

    def drawn(self, key: jax.Array) -> Drawn:
        points = np.asarray(self._live.particles.position)
        info = {
            "walkers": LIVE,
            "rounds": self._rounds,
            "misfit": float(-self._live.particles.loglikelihood.min()),
            "moved": 1.0,
            "kept": 1 / max(self._rounds, 1),
            "steps": 1,
        }
        if not self.held:
            return Drawn(np.empty((1, 0, self._target.dim)), np.nan, np.nan, info)
        return Drawn(points[None], *self._evidence(key), info)

    def _evidence(self, key: jax.Array) -> tuple[float, float]:
        """Log prior volume inside, from simulated shrinkage (Skilling 2006): mean and standard
        deviation."""
        live = self._live.particles
        death = np.concatenate([self._dead["death"], np.asarray(live.loglikelihood)])
        birth = np.concatenate([self._dead["birth"], np.asarray(live.loglikelihood_birth)])
        order = np.argsort(death, kind="stable")
        # How many were alive when each died (Fowlie, Handley & Su 2021): born before, not yet dead;
        # NaN: born first.
        born = np.sort(np.where(np.isnan(birth), -np.inf, birth))
        alive = np.searchsorted(born, death[order], side="left") - np.arange(len(order))
        outside = death[order] < -1
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        shrinkage = (
            np.log(rng.uniform(size=(int(outside.sum()), SIMULATIONS))) / alive[outside, None]
        )
        volumes = shrinkage.sum(axis=0)
        return float(volumes.mean()), float(volumes.std())

    def state(self) -> dict[str, np.ndarray]:
        leaves = {
            f"leaf{number}": np.asarray(leaf)
            for number, leaf in enumerate(jax.tree.leaves(self._live))
        }
        return {**leaves, **self._dead, "counts": np.array([self._rounds, self.evaluations])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        leaves, tree = jax.tree.flatten(self._live)
        found = [jnp.asarray(state[f"leaf{number}"]) for number in range(len(leaves))]
        self._live = jax.tree.unflatten(tree, found)
        self._dead = {name: state[name] for name in self._dead}
        self._rounds, self.evaluations = (int(count) for count in state["counts"])


class Nautilus:
    """nautilus without its neural networks; it has a file format of its own, whose bytes are its
    state."""

    def __init__(self, target: Target, key: jax.Array) -> None:
        self._target = target
        self._seed = int(np.asarray(jax.random.key_data(key))[-1])
        self._open(None)

    def _open(self, path: Path | None) -> None:
        import nautilus

        self._sampler = nautilus.Sampler(
            lambda cube: cube,
            self._likelihood,
            self._target.dim,
            n_live=LIVE,
            n_networks=0,
            n_batch=NAUTILUS_BATCH,
            vectorized=True,
            pass_dict=False,
            seed=self._seed,
            filepath=path,
        )
        self._sampler.filepath = None  # it would write after every batch

    def _likelihood(self, cube: np.ndarray) -> np.ndarray:
        misfit = in_chunks(self._target.misfit_in_cube, cube, size=NAUTILUS_BATCH)
        return -GRADE * np.maximum(misfit - 1, 0)

    @property
    def evaluations(self) -> int:
        return int(self._sampler.n_like)

    def more(self) -> bool:
        return not self._sampler.run(
            n_like_max=self.evaluations + NAUTILUS_BATCHES * NAUTILUS_BATCH,
            f_live=PLATEAU,
            n_eff=NAUTILUS_EFFECTIVE,
            discard_exploration=True,
        )

    @property
    def held(self) -> int:
        return int(self._inside.number)

    @property
    def _inside(self) -> "Weighted":
        """The points of the cube that explain the detection; none before the sampler has found its
        way there."""
        if not self._sampler.explored or not np.sum(self._sampler.shell_n):
            return Weighted(np.empty((0, self._target.dim)), np.empty(0), 0.0)
        points, log_weight, log_likelihood = self._sampler.posterior()
        weight, inside = np.exp(log_weight - log_weight.max()), log_likelihood >= 0
        return Weighted(points[inside], weight[inside], float(weight[inside].sum() / weight.sum()))

    def drawn(self, key: jax.Array) -> Drawn:
        """Every point at most once, with the probability that its weight says."""
        found = self._inside
        info = {
            "walkers": 1,
            "moved": 1.0,
            "kept": 1.0,
            "steps": 1,
            "explored": float(self._sampler.explored),
        }
        if not found.number:
            return Drawn(np.empty((1, 0, self._target.dim)), np.nan, np.nan, info)
        rows = systematic(found.weight, found.number, float(jax.random.uniform(key)))
        points = self._target.points_of(self._target.poses_in_cube(key, found.points[rows]))
        error = float(np.sqrt((1 + (1 - found.share) / found.share) / self._sampler.n_eff))
        return Drawn(points[None], float(self._sampler.log_z + np.log(found.share)), error, info)

    def state(self) -> dict[str, np.ndarray]:
        if not self.evaluations:
            return {"saved": np.empty(0, np.uint8)}
        with tempfile.TemporaryDirectory(prefix="poseterior-") as folder:
            path = Path(folder) / "nautilus.h5"
            self._sampler.write(path)
            return {"saved": np.frombuffer(path.read_bytes(), np.uint8)}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        if not len(state["saved"]):
            return self._open(None)
        with tempfile.TemporaryDirectory(prefix="poseterior-") as folder:
            path = Path(folder) / "nautilus.h5"
            path.write_bytes(state["saved"].tobytes())
            self._open(path)


class Weighted(NamedTuple):
    """Points of the cube `(n, d)` inside all discs, their weights `(n,)`, and the share of all
    weight they have."""

    points: np.ndarray
    weight: np.ndarray
    share: float

    @property
    def number(self) -> int:
        """How many of equal weight they are worth, none being taken twice."""
        return int(self.weight.sum() / self.weight.max()) if len(self.weight) else 0


NESTED = {
    "nss": Baseline(
        lambda target, key, starts: NestedSlice(target, key),
        0,
        "BlackJAX nested slice sampling of -misfit, 500 live points, 50 replaced at a time, 2d"
        " slice steps each",
        extra=("blackjax",),
        discs=True,
    ),
    "nautilus": Baseline(
        lambda target, key, starts: Nautilus(target, key),
        0,
        "nautilus on a likelihood graded by the misfit, 500 live points, ellipsoids without"
        " networks, exploration left out",
        extra=("nautilus",),
        discs=True,
    ),
}
