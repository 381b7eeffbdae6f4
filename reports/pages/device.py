"""What exact draws cost on a GPU: writes reports/device.md and its picture.

    python -m poseterior.reports.pages.device [../shared/data]

For a machine that has one: JAX's first device is measured. Every program is compiled before its
time is taken; what a user waits for that is a column of its own.
"""

import os
import time
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from poseterior.inference.exact.device.group import DeviceGroup, device_groups
from poseterior.inference.exact.device.tables import device_plan
from poseterior.inference.exact.groups import GroupTables, StratifiedGroup, group_tables
from poseterior.inference.exact.loops.tables import LimbProblem
from poseterior.inference.exact.mixture import RootSampler, root_samplers
from poseterior.inference.exact.problem import limb_problems
from poseterior.inference.exact.rates import Budget
from poseterior.probmodel import Estimate, PoseModel
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import page as blank_page
from poseterior.reports.pages.clocks import digits, finish, frames_of, quartiles, timed, titled
from poseterior.reports.pages.page import SHARED, Data, Page, Values, run
from poseterior.reports.tables import Column, Sheet, sheet_of

DEVICE_DRAWS = 10_000_000
COUNTS = (10_000, 100_000, 1_000_000, 10_000_000, 100_000_000)
"""Draws of the curve's frame."""
DEVICE_FRAMES = slice(None, None, 8)
"""Of the 64."""
COMPARED, CHECKED = 200_000, slice(None, None, 4)
"""Draws that are compared with the processor's, and in which of the frames."""


class DeviceCost(NamedTuple):
    """Of one frame.

    Attributes
    ----------
    first
        Seconds of the first call, with all that is compiled.
    seconds
        Of the same again, with another key.
    set_up
        Seconds to cut as finely as in that call, and to hand the strata over.
    attempt
        Seconds an attempt at a group.
    processor
        Seconds in which this machine's processor draws a tenth as many, times ten.
    """

    first: float
    seconds: float
    set_up: float
    attempt: float
    processor: float


def _body(model: PoseModel, frame: Estimate, seed: int) -> tuple[RootSampler, list[DeviceGroup]]:
    groups = device_groups(jax.random.key(seed), model, frame.observation)
    return RootSampler(model, frame.observation, groups), groups


def draw(model: PoseModel, frame: Estimate, seed: int, number: int) -> tuple[float, float]:
    """Seconds of so many whole bodies that stay on the device, and of those for each attempt."""
    budget = Budget(10**15)
    started = time.perf_counter()
    body, groups = _body(model, frame, seed)
    assert body.more(number, budget)
    jax.block_until_ready([group.room for group in groups])
    seconds = time.perf_counter() - started
    return seconds, seconds / budget.spent


def cost(model: PoseModel, frame: Estimate) -> DeviceCost:
    """Times one frame, its one candidate known."""
    first, _ = draw(model, frame, 0, DEVICE_DRAWS)
    seconds, attempt = draw(model, frame, 1, DEVICE_DRAWS)
    body, groups = _body(model, frame, 2)
    assert body.more(DEVICE_DRAWS, Budget(10**15))
    levels = {group.name: group.level for group in groups}
    del body, groups
    tables = group_tables(model)
    problems = limb_problems(frame.observation)

    def set_up() -> None:
        for name, level in levels.items():
            jax.block_until_ready(_handed(name, level, tables[name], problems[name]))

    def processor() -> None:
        (candidate,) = root_samplers(
            frame.posterior(model, CANDIDATES), jax.random.key(3), "rejection"
        )
        assert candidate.more(DEVICE_DRAWS // 10, Budget(10**15))

    return DeviceCost(first, seconds, timed(set_up, 1), attempt, 10 * timed(processor, 1))


def _handed(name: str, level: int, tables: GroupTables, limbs: tuple[LimbProblem, ...]) -> object:
    with jax.enable_x64(True):
        group = StratifiedGroup(jax.random.key(0), name, tables, limbs)
        return device_plan(group.plan_at(level), tables, limbs)


def compared(model: PoseModel, frame: Estimate) -> list[tuple[float, float]]:
    """Group by group, draws of the device beside those of the processor: the smallest p-value of
    two-sample Kolmogorov–Smirnov tests of all coordinates, times their number; and the difference
    of log evidences over its standard error."""
    found = []
    problems = limb_problems(frame.observation)
    for device in device_groups(jax.random.key(4), model, frame.observation):
        name = device.name
        tables = group_tables(model)[name]
        loops = StratifiedGroup(jax.random.key(5), name, tables, problems[name])
        for sampler in (device, loops):
            assert sampler.more(COMPARED, Budget(10**15))
        ours, theirs = (
            np.concatenate(
                [part[:COMPARED].reshape(COMPARED, -1) for part in sampler.draws()[name]], axis=1
            )
            for sampler in (device, loops)
        )
        values = [stats.ks_2samp(*pair).pvalue for pair in zip(ours.T, theirs.T, strict=True)]
        one = device.rates[0]
        other = loops.rates[0]
        error = np.sqrt(one.variance + other.variance)
        found.append(
            (
                min(1.0, min(values) * len(values)),
                (one.log_probability - other.log_probability) / error,
            )
        )
    return found


def costs_table(costs: Sequence[DeviceCost]) -> Sheet:
    """Costs over the frames: smallest, quartiles, largest."""
    seconds = np.array([item.seconds for item in costs])
    lines = {
        "whole bodies a second": DEVICE_DRAWS / seconds,
        "times this machine's processor": np.array([item.processor for item in costs]) / seconds,
        "set-up, ms": 1e3 * np.array([item.set_up for item in costs]),
        "ns an attempt, all included": 1e9 * np.array([item.attempt for item in costs]),
        "s of the first call": np.array([item.first for item in costs]),
    }
    return quartiles(f"over {len(costs)} frames", lines)


def picture(rates: Sequence[float]) -> Figure:
    """Bodies a second against the number of draws."""
    figure = blank_page(5, 3.4, dpi=110)
    axis = figure.subplots()
    axis.loglog(COUNTS, rates, "o-", color=PALETTE[0])
    axis.set(xlabel="draws of one frame", ylabel="whole bodies a second, set-up included")
    finish([axis])
    return figure


def main(data: Data = SHARED) -> Page:
    """Measures, writes, and prints the page."""
    model = PoseModel()
    sets = frames_of(model, data, DEVICE_FRAMES)
    costs = {title: [cost(model, frame) for frame in frames] for title, frames in sets.items()}
    frames = list(sets.values())[-1]
    checks = [check for frame in frames[CHECKED] for check in compared(model, frame)]
    smallest = min(value for value, _ in checks)
    rates = []
    for number in COUNTS:
        draw(model, frames[0], 6, number)
        rates.append(number / draw(model, frames[0], 7, number)[0])
    values: Values = {
        "device": jax.devices()[0].device_kind,
        "cores": os.cpu_count() or 1,
        "jax": jax.__version__,
        "draws": f"{DEVICE_DRAWS:,}",
        "tables": titled({title: costs_table(own) for title, own in costs.items()}),
        "curve": sheet_of(
            ["draws of one frame", Column("whole bodies a second", form=digits)],
            [(f"{count:,}", rate) for count, rate in zip(COUNTS, rates, strict=True)],
        ),
        "compared": f"{COMPARED:,}",
        "checks": str(len(checks)),
        "smallest": f"{smallest:.2g}",
        "chance": f"{1 - (1 - smallest) ** len(checks):.2g}",
        "largest": f"{max(abs(score) for _, score in checks):.2f}",
    }
    return Page("device", values, {"device": picture(rates)})


if __name__ == "__main__":
    run(main)
