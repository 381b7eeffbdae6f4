"""What every baseline sampler shares: how it is asked, how long it may run, how it is saved, and
what it hands over.

A baseline draws from a `Density`, not knowing that exact draws exist;
`inference.studies.comparison` says how well it does. `run` is the one loop: it lets a `Method` go
on until it has enough or the budget ends, shows progress, and saves, so that an interrupted run
goes on to the same bits. `chains.Walk` makes a method of any kernel of Markov chains."""

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from poseterior.inference.baselines.target import Density, Target
from poseterior.inference.draws import COMPLETE, OUT_OF_BUDGET, Progress
from poseterior.probmodel.arrays import read_tables
from poseterior.probmodel.chunks import in_chunks
from poseterior.probmodel.errors.laws import ErrorLaw
from poseterior.probmodel.failures import BadInput, installing
from poseterior.probmodel.files import replacing
from poseterior.probmodel.pose import Pose

Clock = Callable[[], float]
SAVE_EVERY = 20.0
"""Seconds between two saves."""


class Cost(NamedTuple):
    """What draws cost: proposals made, of which accepted in the sampler's own count, and
    seconds."""

    num_proposals: int
    acceptance_rate: float
    wall_time: float


class Drawn(NamedTuple):
    """What a method has drawn: `points` `(chain, draw, d)` of R^d (a chain is an ensemble folded,
    walker after walker, or one independent walker); log evidence and its standard error where the
    method knows them, else NaN; `info`: counts, among them `moved`, the share of steps that changed
    the point, `kept`, the share of the work that brought draws, and `steps`, how many draws in a
    row are one walker's path (1: they are no path)."""

    points: np.ndarray
    log_evidence: float
    log_evidence_se: float
    info: dict[str, float]

    def thinned(self, most: int) -> "Drawn":
        """At most so many draws, taken evenly along every path; all where they are no paths."""
        chains, draws, dim = self.points.shape
        steps = int(self.info["steps"])
        every = -(-chains * draws // most)
        if every <= 1 or steps == 1:
            return self
        points = self.points.reshape(chains, -1, steps, dim)[:, :, ::every]
        info = {**self.info, "steps": points.shape[2]}
        return self._replace(points=points.reshape(chains, -1, dim), info=info)


class Method(Protocol):
    """A sampler at work on one target. `more` goes on for about a second; `state` and `restore` are
    its whole memory."""

    @property
    def evaluations(self) -> int:
        """How often the density was evaluated."""

    def more(self) -> bool:
        """Goes on; False once it is finished by itself."""

    def drawn(self, key: jax.Array) -> Drawn:
        """What there is so far; no draws (`(chain, 0, d)`) where there is nothing that may be
        used."""

    def state(self) -> dict[str, np.ndarray]:
        """Everything that `restore` needs to go on."""

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Takes up where `state` was taken."""

    @property
    def held(self) -> int:
        """How many draws `drawn` would give."""


@dataclass(frozen=True)
class Baseline:
    """One row of the table of baselines: `build(target, key, starts)` gives the method, where the
    target is a `Density` or, of those that ask for more, a `Target`; `starts` is
    how many starting points inside the support it needs (0: it begins with the prior); `note` how
    it is set up, and by whose advice; `extra` the packages beyond the core; `discs` whether its
    draws are of discs, whatever the law of errors, so that it takes no other."""

    build: Callable[[Any, jax.Array, np.ndarray], Method]
    starts: int
    note: str
    extra: tuple[str, ...] = ()
    discs: bool = False


@dataclass(frozen=True)
class Allowance:
    """What a run may cost: `evaluations` of the density (a gradient counts as one), `seconds`;
    None: no limit."""

    evaluations: int | None = None
    seconds: float | None = None

    def allows(self, evaluations: int, seconds: float) -> bool:
        """Whether more may be spent."""
        return (self.evaluations is None or evaluations < self.evaluations) and (
            self.seconds is None or seconds < self.seconds
        )


class Checkpoint(NamedTuple):
    """How far a run was at some moment: seconds and evaluations spent, draws held after burn-in."""

    seconds: float
    evaluations: int
    held: int


@dataclass(frozen=True)
class Run:
    """What a baseline returns: `points` `(chain, draw, d)` of the target and the `poses` there,
    with leaves `(chain, draw, …)`, evidence or NaN, info, cost, history, status and sentence as in
    `inference.results.Result`. `cost.wall_time` is without compilation, which `info` has."""

    sampler: str
    points: np.ndarray
    poses: Pose
    log_evidence: float
    log_evidence_se: float
    info: dict[str, float]
    cost: Cost
    history: tuple[Checkpoint, ...]
    status: str
    sentence: str = ""

    @property
    def num_draws(self) -> int:
        """How many draws there are, of all chains."""
        return int(np.prod(self.poses.length.shape[:2]))


def run(
    baseline: Baseline,
    name: str,
    target: Density,
    *,
    key: jax.Array,
    starts: np.ndarray | None = None,
    num_samples: int = 10_000,
    most: int | None = None,
    allowance: Allowance = Allowance(),
    progress: Progress | None = None,
    save_to: Path | None = None,
    clock: Clock = time.perf_counter,
) -> Run:
    """Draws until `num_samples` draws are held (after burn-in, not independent of each other) or
    the allowance ends; hands over at most `most` of them, or all.

    `starts` `(n, d)`: points inside the support; the method takes its walkers' places from them.
    With `save_to`, an `.npz` is written now and then, atomically, and read again by the next run of
    the same baseline, key, starts and target. `clock` tells the seconds. Raises `BadInput` where a
    package is missing, the law of errors is not the baseline's, no start lies inside the support,
    or the file is another's."""
    check_packages(name, baseline)
    if isinstance(target, Target):
        check_law(name, baseline, target.observation.law)
    places = _places(baseline, name, target, key, starts)
    method = baseline.build(target, jax.random.fold_in(key, 1), places)
    saved = None if save_to is None else _Save(save_to, _fingerprint(name, target, key, places))
    history: list[Checkpoint] = []
    seconds = compiling = 0.0
    if saved:
        seconds, compiling, history = saved.load(method)
    if not history:
        compiling = first_step(method, clock)
    finished = False
    while (
        not finished and method.held < num_samples and allowance.allows(method.evaluations, seconds)
    ):
        started = clock()
        finished = not method.more()
        seconds += clock() - started
        history.append(Checkpoint(seconds, method.evaluations, method.held))
        if saved:
            saved.store(method, seconds, compiling, history)
        if progress:
            progress(min(method.held, num_samples), num_samples)
    if saved:
        saved.store(method, seconds, compiling, history, now=True)
    drawn = method.drawn(jax.random.fold_in(key, 3))
    if most:
        drawn = drawn.thinned(most)
    return _result(
        name=name,
        target=target,
        method=method,
        drawn=drawn,
        key=key,
        num_samples=num_samples,
        seconds=seconds,
        compiling=compiling,
        history=history,
    )


def first_step(method: Method, clock: Clock) -> float:
    """Takes the first step twice, so that the clock runs without compilation; returns the seconds
    of the first one."""
    started = clock()
    before = method.state()
    method.more()
    method.restore(before)
    return clock() - started


def _result(
    name: str,
    target: Density,
    method: Method,
    drawn: Drawn,
    key: jax.Array,
    num_samples: int,
    seconds: float,
    compiling: float,
    history: list[Checkpoint],
) -> Run:
    if not np.isfinite(drawn.points).all():
        raise BadInput(
            f"{name} returned draws that are not finite; use other starts or another sampler"
        )
    poses = _poses(target, jax.random.fold_in(key, 4), drawn.points)
    number = int(np.prod(drawn.points.shape[:2]))
    status, sentence = COMPLETE, ""
    spent = f"{method.evaluations:,} evaluations, {seconds:.1f} s"
    if not number:
        status, sentence = (
            OUT_OF_BUDGET,
            f"{name} has not one draw after {spent}: the budget is too small; allow more",
        )
    elif method.held < num_samples:
        status = OUT_OF_BUDGET
        sentence = (
            f"{name} holds {method.held} of {num_samples} draws after {spent}; allow more, or ask"
            " for fewer"
        )
    cost = Cost(method.evaluations, drawn.info.get("moved", np.nan), seconds)
    info = {**drawn.info, "compiling": compiling}
    return Run(
        sampler=name,
        points=drawn.points,
        poses=poses,
        log_evidence=drawn.log_evidence,
        log_evidence_se=drawn.log_evidence_se,
        info=info,
        cost=cost,
        history=tuple(history),
        status=status,
        sentence=sentence,
    )


def _poses(target: Density, key: jax.Array, points: np.ndarray) -> Pose:
    chains, draws = points.shape[:2]
    if not chains * draws:
        length, upper, lower = (
            np.empty((chains, draws, *shape)) for shape in ((5,), (5, 3), (4, 3))
        )
        return Pose(length, upper, lower)
    return target.poses(key, points)


def _places(
    baseline: Baseline, name: str, target: Density, key: jax.Array, starts: np.ndarray | None
) -> np.ndarray:
    """`(baseline.starts, d)`: rows of `starts` inside the support, without repetition while there
    are enough."""
    if not baseline.starts:
        return np.empty((0, target.dim))
    points = np.empty((0, target.dim)) if starts is None else np.asarray(starts, float)
    inside = np.isfinite(points).all(axis=-1)
    if len(points):
        inside &= np.asarray(in_chunks(target.misfit, np.where(inside[:, None], points, 0.0))) <= 1
    found = points[inside]
    if not len(found):
        raise BadInput(
            f"none of the {len(points)} starting points of {name} lies inside the support; give"
            " exact draws"
        )
    order = np.random.default_rng(np.asarray(jax.random.key_data(key))).permutation(len(found))
    return found[order[np.arange(baseline.starts) % len(found)]]


def check_packages(name: str, baseline: Baseline) -> None:
    """Raises `BadInput` where a package that the baseline needs is not installed."""
    import importlib.util

    missing = [package for package in baseline.extra if importlib.util.find_spec(package) is None]
    if missing:
        raise BadInput(
            f"the sampler {name} needs {' and '.join(missing)}, which is not installed;"
            f" {installing('samplers')}; or choose another"
        )


def check_law(name: str, baseline: Baseline, law: ErrorLaw) -> None:
    """Raises `BadInput` where the baseline does not draw under a law of errors."""
    if baseline.discs and not law.follows(0.0):
        raise BadInput(
            f"the sampler {name} shrinks discs, and knows of no other law of errors; take the law"
            " disc (on the command line --errors disc), or another sampler"
        )


def _fingerprint(name: str, target: Density, key: jax.Array, places: np.ndarray) -> str:
    digest = hashlib.sha256(name.encode())
    for leaf in [*jax.tree.leaves(target), jax.random.key_data(key), places]:
        digest.update(np.ascontiguousarray(leaf).tobytes())
    return digest.hexdigest()


def _checksum(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 of arrays with their names, types and shapes, in whatever order."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        digest.update(repr((name, array.dtype.str, array.shape)).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@dataclass
class _Save:
    """A file with a method's whole state, its cost and its history."""

    path: Path
    fingerprint: str
    last: float = field(default_factory=time.monotonic)

    def load(self, method: Method) -> tuple[float, float, list[Checkpoint]]:
        if not self.path.exists():
            return 0.0, 0.0, []
        advice = "delete it to begin this sampler anew"
        found = read_tables(self.path, "saved run", advice)
        lacking = {"_fingerprint", "_clock", "_history", "_sha256"} - found.keys()
        if lacking:
            raise BadInput(f"{self.path} is no saved run (it lacks {min(lacking)}); {advice}")
        if str(found.pop("_sha256")) != _checksum(found):
            raise BadInput(f"{self.path} is damaged (it is not what its checksum says); {advice}")
        fingerprint, clock = str(found.pop("_fingerprint")), found.pop("_clock")
        history = [
            Checkpoint(float(row[0]), int(row[1]), int(row[2])) for row in found.pop("_history")
        ]
        if fingerprint != self.fingerprint:
            raise BadInput(
                f"{self.path} belongs to another run (sampler, seed, starts or detection); choose"
                " another"
            )
        method.restore(found)
        return float(clock[0]), float(clock[1]), history

    def store(
        self,
        method: Method,
        seconds: float,
        compiling: float,
        history: list[Checkpoint],
        *,
        now: bool = False,
    ) -> None:
        if not now and time.monotonic() - self.last < SAVE_EVERY:
            return
        content = {
            "_fingerprint": np.array(self.fingerprint),
            "_clock": np.array([seconds, compiling]),
            "_history": np.array(history, float).reshape(-1, 3),
            **method.state(),
        }
        checksum = np.array(_checksum(content))
        with replacing(self.path) as partial, partial.open("wb") as file:
            np.savez(file, allow_pickle=False, _sha256=checksum, **content)
        self.last = time.monotonic()
