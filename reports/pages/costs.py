"""What the fast route costs against the number of roots, by error law: a part of reports/routes.md.

Each run is what a user has of `inference.sample`: roots, draws of joints, their results. Loops and
programs are compiled before times are taken.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from poseterior import inference
from poseterior.probmodel import Detection, Estimate, Likelihood, PoseModel
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, SMALL, TITLE, page
from poseterior.reports.tables import Sheet, sheet_from

ROOT_NUMBERS = (250, 1000, 4000, 16_000)
"""Of roots, and of draws."""
WANTED = 1000
"""Effective draws a second that a frame should have."""


class RootCost(NamedTuple):
    """Of many roots of several detections under one error law: `seconds` and `effective` draws,
    `(detections,)`."""

    law: str
    roots: int
    seconds: np.ndarray
    effective: np.ndarray

    @property
    def rates(self) -> np.ndarray:
        """`(detections,)`: effective draws a second."""
        return self.effective / self.seconds


def costs_of(
    model: PoseModel,
    detections: Sequence[Detection],
    laws: Mapping[str, Likelihood],
    said: Callable[[RootCost], None],
) -> list[RootCost]:
    """Every number of roots under every law; `said` is told of each at once."""
    found = []
    for law, likelihood in laws.items():
        frames = [Estimate(one, (), likelihood) for one in detections]
        for number in ROOT_NUMBERS:
            _drawn(model, frames[0], number, 0)
            pairs = [_drawn(model, frame, number, seed) for seed, frame in enumerate(frames, 1)]
            seconds, effective = np.array(pairs).T
            found.append(RootCost(law, number, seconds, effective))
            said(found[-1])
    return found


def _drawn(model: PoseModel, frame: Estimate, number: int, seed: int) -> tuple[float, float]:
    """The seconds that so many roots and draws take, and the effective ones among them."""
    started = time.perf_counter()
    result = inference.sample(
        model,
        frame,
        key=jax.random.key(seed),
        num_samples=number,
        root=UNCERTAIN,
        num_roots=number,
    )
    seconds = time.perf_counter() - started
    return seconds, float(result.tree.attrs["effective_roots"])


def table_of(costs: Sequence[RootCost]) -> Sheet:
    """A line for each number of roots under each law."""
    return sheet_from(
        {
            "errors": one.law,
            "roots": f"{one.roots:,}",
            "seconds": f"{np.median(one.seconds):.2g}",
            "effective draws": f"{np.median(one.effective):,.0f}",
            "effective a second": f"{np.median(one.rates):,.0f}",
            "range": f"{one.rates.min():,.0f} to {one.rates.max():,.0f}",
        }
        for one in costs
    )


def plot_costs(costs: Sequence[RootCost]) -> Figure:
    """Effective draws a second against the number of roots: medians, with ranges."""
    figure = page(6.4, 3.4, dpi=150)
    axes = figure.subplots()
    names = list(dict.fromkeys(one.law for one in costs))
    for colour, name in zip(PALETTE, names, strict=False):
        own = [one for one in costs if one.law == name]
        middle = np.array([np.median(one.rates) for one in own])
        ends = np.array([[one.rates.min(), one.rates.max()] for one in own]).T
        beyond = np.abs(ends - middle)
        at = np.array([one.roots for one in own]) * 1.04 ** names.index(name)
        axes.errorbar(at, middle, beyond, color=colour, marker="o", ms=4, lw=1, label=name)
    axes.axhline(WANTED, color=INK, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xticks(ROOT_NUMBERS, [f"{number:,}" for number in ROOT_NUMBERS], fontsize=SMALL)
    axes.minorticks_off()
    axes.set_ylim(0)
    axes.tick_params(axis="y", labelsize=SMALL)
    axes.set_xlabel("roots", fontsize=SMALL)
    axes.set_ylabel("effective draws a second", fontsize=SMALL)
    title = "Effective draws a second: medians and ranges"
    axes.set_title(title, loc="left", fontsize=TITLE, color=INK)
    axes.spines[:].set_color(FAINT)
    axes.legend(fontsize=SMALL, frameon=False, loc="upper left")
    return figure
