"""What exact draws cost: writes reports/speed.md and its picture (`make bench`).

    python -m poseterior.reports.pages.speed [../shared/data]

Times are of one run on one machine; what carries over are the ratios. Naive rejection per group is
never run to its end: its cost a draw is the measured cost of a proposal over the measured evidence.
"""

import functools
import multiprocessing
import os
import platform
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.drawsfile import sample_to_file
from poseterior.inference.estimators import estimate_torso
from poseterior.inference.exact.groups import RESOLUTIONS, StratifiedGroup, group_tables, plan_group
from poseterior.inference.exact.loops.numbers import compiled, load, store, uniform
from poseterior.inference.exact.loops.proposals import add_bodies, propose_lengths, propose_limb
from poseterior.inference.exact.loops.seeds import seeded
from poseterior.inference.exact.loops.tables import CutLimb, blank_bodies, workspace_pair
from poseterior.inference.exact.mixture import ExactRejection, root_samplers
from poseterior.inference.exact.naive import BATCH, propose
from poseterior.inference.exact.problem import limb_problems
from poseterior.inference.exact.rates import Budget
from poseterior.inference.footage import Item
from poseterior.inference.results import Result
from poseterior.inference.sampler import sample
from poseterior.inference.stream import sample_frames
from poseterior.inference.studies.scenes import prior_scene
from poseterior.probmodel import Anatomy, Estimate, PoseModel, read_detections
from poseterior.probmodel.example import example
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.skeleton import GROUPS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import page as blank_page
from poseterior.reports.pages.clocks import digits, finish, frames_of, quartiles, timed, titled
from poseterior.reports.pages.page import SHARED, Data, Page, Values, in_doubles, run
from poseterior.reports.pages.waits import waits
from poseterior.reports.tables import Column, Sheet, sheet_of
from poseterior.reports.tables.evaluation import PAPERS_FRAMES

SPEED_DRAWS = 100_000
MANY = 2_000_000
"""Draws of a photo's person."""
SERVED = 300_000
"""Draws of what a user gets."""
FEW = 2000
"""After which a process has what it holds however many draws it makes."""
UNIFORMS = 23
"""Uniform numbers of a pose: the floor."""
STREAM_FRAMES, STREAM_ROOTS = 32, 200
STAGE_LEVEL, STAGE_ATTEMPTS = 2, 1 << 16
"""The resolution, and the attempts, by which the stages of an attempt are timed."""
STAGE_FRAMES = slice(None, None, 8)


class FrameCost(NamedTuple):
    """Of one frame.

    Attributes
    ----------
    set_up
        Seconds to set up as finely as `SPEED_DRAWS` draws deserve.
    seconds
        In all.
    arms, legs
        Acceptance.
    proposals
        For a whole body.
    naive
        Seconds that naive rejection per group would need for a draw.
    """

    set_up: float
    seconds: float
    arms: float
    legs: float
    proposals: float
    naive: float

    @property
    def rate(self) -> float:
        """Whole bodies a second."""
        return SPEED_DRAWS / self.seconds


class Curve(NamedTuple):
    """Measurements `y` at `x`."""

    x: Sequence[float]
    y: Sequence[float]


@compiled
def _numbers(state, count):  # type: ignore[no-untyped-def]
    stream = load(state)
    total = 0.0
    for _ in range(count):
        value, stream = uniform(stream)
        total += value
    store(state, stream)
    return total


def floors() -> dict[str, float]:
    """Seconds a pose for its random numbers alone."""
    state = seeded([0], 0)
    rng = np.random.default_rng(0)
    draw = jax.jit(lambda key: jax.random.uniform(key, (UNIFORMS * BATCH,)))
    _numbers(state, 10)
    jax.block_until_ready(draw(jax.random.key(0)))
    return {
        "compiled SFC64": timed(lambda: _numbers(state, UNIFORMS * BATCH)) / BATCH,
        "NumPy PCG64": timed(lambda: rng.random(UNIFORMS * BATCH)) / BATCH,
        "JAX threefry": timed(lambda: jax.block_until_ready(draw(jax.random.key(1)))) / BATCH,
    }


def naive_proposal(model: PoseModel, frame: Estimate) -> float:
    """Seconds of one body proposed from the prior and tested group by group."""
    groups = tuple((name,) for name in GROUPS)

    def run(seed: int) -> None:
        jax.block_until_ready(propose(jax.random.key(seed), model, frame.observation, groups))

    run(0)
    return timed(lambda: run(1)) / BATCH


def cost(model: PoseModel, frame: Estimate, naive: float) -> FrameCost:
    """Times one frame, its one candidate known."""
    started = time.perf_counter()
    budget = Budget(10**12)
    (candidate,) = root_samplers(frame.posterior(model, CANDIDATES), jax.random.key(0), "rejection")
    assert candidate.more(SPEED_DRAWS, budget)
    seconds = time.perf_counter() - started
    groups = {
        sampler.name: sampler
        for sampler in candidate.samplers
        if isinstance(sampler, StratifiedGroup)
    }
    last = {name: sampler.rates[0].rates[-1] for name, sampler in groups.items()}
    evidence = {name: np.exp(sampler.rates[0].log_probability) for name, sampler in groups.items()}
    return FrameCost(
        set_up=timed(lambda: [group.plan_at(group.level) for group in groups.values()], 1),
        seconds=seconds,
        arms=last["arms"].accepted / last["arms"].proposed,
        legs=last["legs"].accepted / last["legs"].proposed,
        proposals=budget.spent / candidate.held,
        naive=naive / min(evidence.values()),
    )


def published(data: Path) -> str:
    """What a photo's person costs under the published limits, in words; empty where the data are
    not at hand."""
    limits = data / "akhter_black" / "jointAngleModel_v2.mat"
    photo = data / "detections" / "openpose" / "body25_spin_im1010_keypoints.json"
    if not (limits.exists() and photo.exists()):
        return ""
    model = PoseModel.from_anatomy(Anatomy.load(limits))
    posterior = estimate_torso(read_detections(photo)[0]).posterior(model, CANDIDATES)

    def draw() -> None:
        candidate, *_ = root_samplers(posterior, jax.random.key(0), "rejection")
        assert candidate.more(MANY, Budget(10**12))

    return (
        f"A photo's person (OpenPose's keypoints of `{photo.name}`) under the limits that Akhter"
        f" and Black published: {MANY / timed(draw):,.0f} bodies a second, {MANY:,} of them."
    )


def served(data: Path) -> Sheet:
    """What a user gets of the engine's draws, with a photo's person if at hand: draws as the engine
    hands them over; a result's joints and keypoints; and with densities and predictions read."""
    photo = data / "detections" / "openpose" / "body25_spin_im1010_keypoints.json"
    detection = read_detections(photo)[0] if photo.exists() else example().detection
    model, frame = PoseModel(), estimate_torso(detection)
    posterior = frame.posterior(model, CANDIDATES)
    key = jax.random.key(0)

    def result() -> Result:
        return sample(model, frame, key=key, num_samples=SERVED, root=CANDIDATES)

    ways: dict[str, Callable[[], object]] = {
        "the engine: lengths and directions": lambda: ExactRejection().draw(posterior, key, SERVED),
        "`pt.sample`: joints and keypoints": result,
        "all of it read, densities and predictions too": lambda: result().tree.load(),
    }
    rows = []
    for what, action in ways.items():
        action()
        used = min(_processor(action) for _ in range(3))
        rows.append((what, SERVED / timed(action), 1e6 * used / SERVED))
    heads = "draws a second", "µs of a processor a draw"
    return sheet_of([f"{SERVED:,} draws", *(Column(head, form=digits) for head in heads)], rows)


def _processor(action: Callable[[], object]) -> float:
    """Seconds of all processors."""
    started = time.process_time()
    action()
    return time.process_time() - started


class StageCost(NamedTuple):
    """Where an attempt at a pair of limbs goes, on one core.

    Attributes
    ----------
    stratum
        Nanoseconds to set up one stratum.
    lengths, limb
        Nanoseconds an attempt for its two lengths, and for each limb that is tried.
    draw
        Nanoseconds to hand over a draw.
    whole
        Nanoseconds an attempt in all.
    first, both
        Of the attempts, the shares that pass the first limb, and both.
    """

    stratum: float
    lengths: float
    limb: float
    draw: float
    whole: float
    first: float
    both: float


def stages(model: PoseModel, frame: Estimate, name: str) -> StageCost:
    """Times a group's loops one after the other, by the processor's time of this thread."""
    tables = group_tables(model)[name]
    limbs = limb_problems(frame.observation)[name]
    clock = time.thread_time
    number = STAGE_ATTEMPTS
    plan_group(tables, limbs, RESOLUTIONS[STAGE_LEVEL], alone=True)
    started = clock()
    plan = plan_group(tables, limbs, RESOLUTIONS[STAGE_LEVEL], alone=True)
    set_up = clock() - started
    workspaces = workspace_pair(number)
    cut = [CutLimb(*parts) for parts in zip(limbs, tables.builds, plan.strata, strict=True)]
    counts = np.random.default_rng(0).multinomial(number, plan.share)
    state = seeded([0], 0)
    room = blank_bodies(number, len(limbs))
    times = []

    def stage(action: Callable[..., int], *given: object) -> int:
        start = clock()
        found = action(*given)
        times.append(1e9 * (clock() - start))
        return found

    for _ in range(2):  # the first time memory is new
        times.clear()
        stage(propose_lengths, state, np.cumsum(counts), 0, plan.bins, True, workspaces[0])
        first = stage(propose_limb, state, cut[0], plan.sub, number, workspaces[0])
        both = stage(propose_limb, state, cut[1], plan.sub, first, workspaces[1])
        stage(add_bodies, state, both, workspaces, np.arange(2), room, 0)
    length, one, two, draw = times
    return StageCost(
        stratum=1e9 * set_up / plan.size,
        lengths=length / number,
        limb=(one + two) / (number + first),
        draw=draw / max(both, 1),
        whole=sum(times) / number,
        first=first / number,
        both=both / number,
    )


def where_it_goes(model: PoseModel, frames: Sequence[Estimate]) -> dict[str, list[StageCost]]:
    """The stages of both pairs of limbs, frame by frame."""
    return {name: [stages(model, frame, name) for frame in frames] for name in ("arms", "legs")}


def stages_table(costs: dict[str, list[StageCost]]) -> Sheet:
    """Medians over the frames, by group."""
    words = {
        "stratum": "ns to set up a stratum",
        "lengths": "ns an attempt for two lengths",
        "limb": "ns for each limb that is tried",
        "draw": "ns to hand over a draw",
        "whole": "ns an attempt in all",
        "first": "% of attempts that pass the first limb",
        "both": "% that pass both",
    }
    rows = []
    for field, what in words.items():
        scale = 100.0 if what.startswith("%") else 1.0
        each = ([scale * getattr(cost, field) for cost in own] for own in costs.values())
        rows.append((what, *map(np.median, each)))
    return sheet_of(["medians", *(Column(name, form=digits) for name in costs)], rows)


def costs_table(costs: Sequence[FrameCost], floor: float) -> Sheet:
    """Costs over the frames: smallest, quartiles, largest."""
    columns = {
        name: np.array([getattr(item, name) for item in costs]) for name in FrameCost._fields
    }
    rate = np.array([item.rate for item in costs])
    lines = {
        "whole bodies a second": rate,
        "set-up, ms": 1e3 * columns["set_up"],
        "acceptance of arms, %": 100 * columns["arms"],
        "acceptance of legs, %": 100 * columns["legs"],
        "attempts a body, all groups": columns["proposals"],
        "times faster than naive groups": columns["naive"] * rate,
        "times the floor (23 random numbers)": 1 / rate / floor,
    }
    return quartiles("over 64 frames", lines)


def _nanoseconds(head: str) -> Column:
    return Column(head, form=lambda seconds: f"{1e9 * seconds:,.0f}")


def floors_table(floor: dict[str, float]) -> Sheet:
    """What random numbers cost."""
    head = (f"random numbers of a pose ({UNIFORMS})", _nanoseconds("ns"))
    return sheet_of(head, list(floor.items()))


def naive_table(naive: float) -> Sheet:
    """What a naive proposal costs."""
    return sheet_of(("one naive proposal", _nanoseconds("JAX, ns")), [("whole body", naive)])


def curves(model: PoseModel, frame: Estimate) -> dict[str, Curve]:
    """Microseconds a draw, set-up included, against the number of draws and, for 10,000 of a pose
    of the prior, the radius of the discs."""

    def each(frame: Estimate, number: int) -> float:
        posterior = frame.posterior(model, CANDIDATES)
        draw = functools.partial(ExactRejection().draw, posterior, jax.random.key(1), number)
        return timed(draw, 2) / number * 1e6

    numbers = [100, 1000, 10_000, 100_000, 1_000_000]
    factors = [0.02, 0.05, 0.1, 0.25, 0.5, 1.0]
    scaled = [prior_scene(model, 0, factor=factor) for factor in factors]
    return {
        "draws of one frame": Curve(numbers, [each(frame, number) for number in numbers]),
        "factor in τ": Curve(factors, [each(item, 10_000) for item in scaled]),
    }


def streams(model: PoseModel, frames: Sequence[Estimate], root: str = CANDIDATES) -> Curve:
    """Seconds of streams of 1 to `STREAM_FRAMES` frames × 10,000 draws with five hypotheses."""
    items = [Item(str(number), frame) for number, frame in enumerate(frames)]

    def run(count: int) -> float:
        with tempfile.TemporaryDirectory() as folder:
            started = time.perf_counter()
            sample_frames(
                model,
                items[:count],
                key=jax.random.key(0),
                out=folder,
                root=root,
                num_roots=STREAM_ROOTS,
            )
            return time.perf_counter() - started

    run(1)  # compiles
    counts = [1, 4, 16, STREAM_FRAMES]
    return Curve(counts, [run(count) for count in counts])


class Million(NamedTuple):
    """A million draws of the embedded example, in a process of its own."""

    how: str
    seconds: float
    peak: float
    start: float
    size: float


def million(to_file: bool, double: bool) -> Million:
    """Draws and saves them, in memory first or straight to the file, once a few have been drawn."""
    in_doubles()
    model = PoseModel()
    frame = estimate_torso(example().detection)
    number = 1_000_000
    draw = functools.partial(sample, model, frame, key=jax.random.key(0))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "posterior.nc"
        draw(num_samples=FEW).save(path)
        start = _peak()
        started = time.perf_counter()
        if to_file:
            key = jax.random.key(0)
            sample_to_file(path, model, frame, key=key, num_samples=number, double=double)
        else:
            draw(num_samples=number).save(path, double=double)
        seconds = time.perf_counter() - started
        size = path.stat().st_size
    words = f"{'straight to disk' if to_file else 'in memory'}, {'double' if double else 'single'}"
    return Million(words, seconds, _peak(), start, size / 1e6)


def _peak() -> float:
    """Megabytes that this process has held at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def millions() -> Sheet:
    """A million draws each way, one after the other."""
    ways = [(False, True), (True, True), (True, False)]
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, max_tasks_per_child=1) as pool:
        rows = [pool.submit(million, *way).result() for way in ways]
    heads = ("seconds", "MB at most", f"MB, {FEW:,} draws", "MB on disk")
    return sheet_of(["a million draws", *(Column(head, form=digits) for head in heads)], rows)


def picture(found: dict[str, Curve], stream: Curve) -> Figure:
    """Three panels: cost against draws, frames and τ."""
    figure = blank_page(11, 3.4, dpi=110)
    axes = figure.subplots(1, 3)
    for axis, (name, curve) in zip(axes[[0, 2]], found.items(), strict=True):
        axis.loglog(*curve, "o-", color=PALETTE[0])
        axis.set(xlabel=name, ylabel="µs a draw, set-up included")
    axes[1].plot(*stream, "o-", color=PALETTE[0])
    axes[1].set(xlabel="frames × 10,000 draws, five hypotheses each", ylabel="seconds", ylim=0)
    finish(axes)
    return figure


def main(data: Data = SHARED) -> Page:
    """Measures, writes, and prints the page."""
    large = millions()  # first: a process starts with the peak of the one that it comes from
    model = PoseModel()
    sets = frames_of(model, data)
    frames = list(sets.values())[-1]
    # Compiles.
    ExactRejection().draw(frames[0].posterior(model, CANDIDATES), jax.random.key(0), 2000)
    floor = floors()
    naive = naive_proposal(model, frames[0])
    tables = {
        title: costs_table([cost(model, frame, naive) for frame in own], floor["compiled SFC64"])
        for title, own in sets.items()
    }
    found = curves(model, frames[0])
    stream = streams(model, frames)
    memory = _peak() / 1e3
    slope = float(np.polyfit(*stream, 1)[0])
    uncertain = float(np.polyfit(*streams(model, frames, UNCERTAIN), 1)[0])
    values: Values = {
        "tables": titled(tables),
        "draws": f"{SPEED_DRAWS:,}",
        "published": published(data),
        "served": served(data),
        "waits": waits(),
        "cores": str(os.cpu_count()),
        "machine": platform.machine(),
        "stages": stages_table(where_it_goes(model, frames[STAGE_FRAMES])),
        "level": " × ".join(map(str, RESOLUTIONS[STAGE_LEVEL])),
        "floors": floors_table(floor),
        "naive": naive_table(naive),
        "per_frame": f"{slope * 1e3:.0f}",
        "per_uncertain": f"{uncertain * 1e3:.0f}",
        "roots": str(STREAM_ROOTS),
        "thousand": f"{slope * 1000:,.0f}",
        "paper": f"{slope * PAPERS_FRAMES / 60:,.0f}",
        "memory": f"{memory:.2f}",
        "millions": large,
    }
    return Page("speed", values, {"speed": picture(found, stream)})


if __name__ == "__main__":
    run(main)
