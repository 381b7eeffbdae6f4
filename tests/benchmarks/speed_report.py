"""What exact draws cost: writes reports/speed.md and speed.png (`make bench`).

    python -m tests.benchmarks.speed_report [../shared/data]

Times are of one run on one machine; what carries over are the ratios. Naive rejection per group is
never run to its end: its cost a draw is the measured cost of a proposal over the measured evidence.
"""

import functools
import os
import platform
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib
import numpy as np

import inference
from inference.exact.groups import StratifiedGroup
from inference.exact.loops.numbers import compiled, load, seeded, store, uniform
from inference.exact.mixture import draw_mixture
from inference.exact.rates import Budget
from inference.stream import Item, sample_frames
from probmodel import PoseModel
from probmodel.posterior import Estimate
from probmodel.skeleton import GROUPS
from tests.benchmarks.scenes64 import motion_frames, prior_frames
from tests.brute_force import propose_group
from tests.scenes import prior_scene
from tests.witnesses.limbs import build_groups
from tests.witnesses.pruned import BATCH, group_prior

matplotlib.use("Agg")
import matplotlib.pyplot as plt

DRAWS = 100_000
NUMBERS = 23
"""Uniform numbers of a pose: the floor."""
STREAM_FRAMES = 32


class Cost(NamedTuple):
    """Of one frame: seconds to set up as finely as `DRAWS` draws deserve, and in all; acceptance of
    arms and legs; proposals a whole body; seconds that naive rejection per group would need a draw,
    in JAX and in NumPy."""

    set_up: float
    seconds: float
    arms: float
    legs: float
    proposals: float
    naive: float
    numpy: float

    @property
    def rate(self) -> float:
        """Whole bodies a second."""
        return DRAWS / self.seconds


def timed(action: Callable[[], object], repeats: int = 3) -> float:
    """Seconds of the fastest of some runs."""
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        found.append(time.perf_counter() - start)
    return min(found)


@compiled
def _numbers(state: np.ndarray, count: int) -> float:
    stream, total = load(state), 0.0
    for _ in range(count):
        value, stream = uniform(stream)
        total += value
    store(state, stream)
    return total


def floors() -> dict[str, float]:
    """Seconds a pose for its random numbers alone."""
    state, rng = seeded([0], 0), np.random.default_rng(0)
    draw = jax.jit(lambda key: jax.random.uniform(key, (NUMBERS * BATCH,)))
    _numbers(state, 10)
    jax.block_until_ready(draw(jax.random.key(0)))
    return {
        "compiled SFC64": timed(lambda: _numbers(state, NUMBERS * BATCH)) / BATCH,
        "NumPy PCG64": timed(lambda: rng.random(NUMBERS * BATCH)) / BATCH,
        "JAX threefry": timed(lambda: jax.block_until_ready(draw(jax.random.key(1)))) / BATCH,
    }


def naive_proposals(model: PoseModel, frame: Estimate) -> dict[str, tuple[float, float]]:
    """Seconds of one proposal of each group from the prior: JAX, and the plain NumPy of the
    tests."""
    groups = build_groups(model, frame.observation)
    found = {}
    for name, group in groups.items():
        run = jax.jit(lambda key, group=group: group.explains(group_prior(key, group, BATCH)))
        jax.block_until_ready(run(jax.random.key(0)))
        in_jax = timed(lambda run=run: jax.block_until_ready(run(jax.random.key(1)))) / BATCH
        torso = np.asarray(frame.observation.view)
        rng = np.random.default_rng(0)
        propose = functools.partial(
            propose_group, model.limits, model.lengths, torso, name, 20_000, rng
        )
        in_numpy = timed(propose, 1) / 20_000
        found[name] = (in_jax, in_numpy)
    return found


def cost(model: PoseModel, frame: Estimate, naive: dict[str, tuple[float, float]]) -> Cost:
    """Times one frame, its one candidate known."""
    started, budget = time.perf_counter(), Budget(10**12)
    (candidate,) = root_samplers(frame.posterior(model), jax.random.key(0), "rejection")
    assert candidate.more(DRAWS, budget)
    seconds = time.perf_counter() - started
    groups = {
        sampler.name: sampler
        for sampler in candidate.samplers
        if isinstance(sampler, StratifiedGroup)
    }
    last = {name: sampler.rates[0].rates[-1] for name, sampler in groups.items()}
    set_up = timed(lambda: [sampler.plan_at(sampler.level) for sampler in groups.values()], 1)
    evidence = {name: np.exp(sampler.rates[0].log_probability) for name, sampler in groups.items()}
    return Cost(
        set_up,
        seconds,
        last["arms"].accepted / last["arms"].proposed,
        last["legs"].accepted / last["legs"].proposed,
        budget.spent / candidate.held,
        sum(naive[name][0] / evidence[name] for name in GROUPS),
        sum(naive[name][1] / evidence[name] for name in GROUPS),
    )


def line(what: str, values: np.ndarray, scale: float = 1.0, digits: int = 3) -> str:
    """A row of the table: smallest, lower quartile, median, upper quartile, largest."""
    parts = np.quantile(values * scale, [0, 0.25, 0.5, 0.75, 1])
    return (
        f"| {what} | "
        + " | ".join(f"{part:,.{digits}g}" if part < 1000 else f"{part:,.0f}" for part in parts)
        + " |"
    )


def table(costs: list[Cost], floor: float) -> list[str]:
    """Costs over the frames."""
    columns = {name: np.array([getattr(item, name) for item in costs]) for name in Cost._fields}
    rate = np.array([item.rate for item in costs])
    rows = [
        line("whole bodies a second", rate),
        line("set-up, ms", columns["set_up"], 1e3),
        line("acceptance of arms, %", columns["arms"], 100),
        line("acceptance of legs, %", columns["legs"], 100),
        line("attempts a body, all groups", columns["proposals"]),
        line("times faster than naive groups (JAX)", columns["naive"] * rate),
        line("times faster than naive groups (NumPy)", columns["numpy"] * rate),
        line("times the floor (23 random numbers)", 1 / rate / floor),
    ]
    return [
        "| over 64 frames | min | ¼ | median | ¾ | max |",
        "| --- | ---: | ---: | ---: | ---: | ---: |",
        *rows,
    ]


def curves(model: PoseModel, frame: Estimate) -> dict[str, tuple[list[float], list[float]]]:
    """Microseconds a draw, set-up included, against the number of draws and, for 10,000 of a pose
    of the prior, the radius of the discs."""

    def each(frame: Estimate, number: int) -> float:
        seconds = timed(
            lambda: draw_mixture(model, frame, jax.random.key(1), "rejection-strata", number), 2
        )
        return seconds / number * 1e6

    numbers = [100, 1000, 10_000, 100_000, 1_000_000]
    factors = [0.02, 0.05, 0.1, 0.25, 0.5, 1.0]
    found = {"draws": (numbers, [each(frame, number) for number in numbers])}
    scaled = [prior_scene(model, 0, factor=factor) for factor in factors]
    found["factor in τ"] = (factors, [each(item, 10_000) for item in scaled])
    return found


def streams(model: PoseModel, frames: list[Estimate]) -> tuple[list[int], list[float], float]:
    """Seconds of streams of 1 to `STREAM_FRAMES` frames × 10,000 draws with five hypotheses, and
    the memory it took."""
    counts, seconds = [1, 4, 16, STREAM_FRAMES], []
    items = [Item(str(number), frame) for number, frame in enumerate(frames)]
    with tempfile.TemporaryDirectory() as folder:
        sample_frames(model, items[:1], key=jax.random.key(0), out=folder)  # compiles
    for count in counts:
        with tempfile.TemporaryDirectory() as folder:
            started = time.perf_counter()
            sample_frames(model, items[:count], key=jax.random.key(0), out=folder)
            seconds.append(time.perf_counter() - started)
    return counts, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def draw_curves(
    path: Path, found: dict[str, tuple[list[float], list[float]]], stream: tuple
) -> None:
    """Three panels: cost against draws, frames and τ."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    for axis, (name, (x, y)) in zip(axes[[0, 2]], found.items(), strict=True):
        axis.loglog(x, y, "o-", color="#1f6fb2")
        axis.set(
            xlabel=name if name != "draws" else "draws of one frame",
            ylabel="µs a draw, set-up included",
        )
    axes[1].plot(stream[0], stream[1], "o-", color="#1f6fb2")
    axes[1].set(xlabel="frames × 10,000 draws, five hypotheses each", ylabel="seconds", ylim=0)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Measures, writes, and prints the page."""
    jax.config.update("jax_enable_x64", True)
    model = PoseModel()
    sets = {"Poses of the prior, by their seeds": prior_frames(model)}
    archive = (
        Path(sys.argv[1] if len(sys.argv) > 1 else "../shared/data") / "cmu" / "actions_train.npz"
    )
    if archive.exists():
        sets["Poses of CMU motion capture"] = motion_frames(archive)
    frames = list(sets.values())[-1]
    draw_mixture(model, frames[0], jax.random.key(0), "rejection-strata", 2000)  # compiles
    floor, naive = floors(), naive_proposals(model, frames[0])
    pages = []
    for title, chosen in sets.items():
        pages += [
            f"## {title}",
            "",
            *table([cost(model, frame, naive) for frame in chosen], floor["compiled SFC64"]),
            "",
        ]
    found, stream = curves(model, frames[0]), streams(model, frames)
    slope = float(np.polyfit(stream[0], stream[1], 1)[0])
    patches = (
        timed(
            lambda: inference.sample(
                model,
                frames[0],
                key=jax.random.key(1),
                sampler="rejection-patches",
                num_samples=5000,
            ),
            2,
        )
        / 5000
    )
    strata = (
        timed(
            lambda: inference.sample(model, frames[0], key=jax.random.key(1), num_samples=5000), 2
        )
        / 5000
    )
    report = Path("reports") / "speed.md"
    draw_curves(report.with_suffix(".png"), found, stream)
    template = (Path(__file__).parent / "speed_report.md").read_text(encoding="utf-8")
    text = template.format(
        tables="\n".join(pages).rstrip(),
        draws=DRAWS,
        cores=os.cpu_count(),
        machine=platform.machine(),
        floors="\n".join(f"| {name} | {seconds * 1e9:,.0f} |" for name, seconds in floor.items()),
        naive="\n".join(
            f"| {name} | {one * 1e9:,.0f} | {two * 1e9:,.0f} |"
            for name, (one, two) in naive.items()
        ),
        per_frame=slope * 1e3,
        thousand=slope * 1000,
        paper=slope * 26_385 / 60,
        memory=stream[2],
        patches=patches / strata,
    )
    report.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
