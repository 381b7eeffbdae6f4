"""Bone lengths by bins: the prior's mass in each, and exact draws inside one for the compiled loop.

A range is cut into bins of equal width, each bin into slices. A slice is proposed in proportion to
an envelope of the Beta density x^(a-1) (1-x)^(b-1), a length uniformly inside it, and kept with
probability density / envelope; a lower bound on that decides nearly always. In the two outermost
slices, where a factor may be unbounded, that factor is drawn by its power law instead, exactly."""

import functools
from typing import NamedTuple

import numpy as np
from scipy.special import betainc

from inference.exact.loops.numbers import compiled, load, store, uniform

SLICES = 16
"""Slices a bin."""


class LengthBins(NamedTuple):
    """Bins of one length group. `mass` `(bins,)` prior probability; `edges` `(bins + 1,)` body
    units; `shape` low, width of the range, a, b; `slices` `(bins · SLICES, 6)`: alias probability
    and partner within the bin, start and width as fractions of the range, lower bound over
    envelope, envelope."""

    mass: np.ndarray
    edges: np.ndarray
    shape: np.ndarray
    slices: np.ndarray


@functools.lru_cache(maxsize=128)  # few priors, few resolutions, the same for every frame
def length_bins(low: float, high: float, alpha: float, beta: float, number: int) -> LengthBins:
    """Cuts [low, high] (body units) with the prior's low + (high - low)·Beta(alpha, beta) into
    `number` bins."""
    cuts = np.linspace(0, 1, number * SLICES + 1)
    start, end = cuts[:-1], cuts[1:]
    peak = (alpha - 1) / (alpha + beta - 2) if alpha + beta != 2 else 0.5
    # The density's extremes over a slice are at its ends, or at its one stationary point.
    extremes = _density(np.stack([start, end, np.clip(peak, start, end)])[:, 1:-1], alpha, beta)
    envelope, weight, floor = (np.zeros_like(start) for _ in range(3))
    envelope[1:-1], floor[1:-1] = extremes.max(axis=0), extremes.min(axis=0) / extremes.max(axis=0)
    weight[1:-1] = envelope[1:-1] * (end - start)[1:-1]
    # The outermost slices hold one factor by its power law, whose integral is known, and bound the
    # other.
    envelope[0] = max(1.0, (1 - end[0]) ** (beta - 1))
    envelope[-1] = max(1.0, start[-1] ** (alpha - 1))
    weight[0] = envelope[0] * end[0] ** alpha / alpha
    weight[-1] = envelope[-1] * (1 - start[-1]) ** beta / beta
    floor[[0, -1]] = -1.0  # never decided by the bound alone
    slices = np.stack(
        [np.empty_like(start), np.empty_like(start), start, end - start, floor, envelope], axis=1
    )
    for index in range(number):
        rows = slice(index * SLICES, (index + 1) * SLICES)
        alias_table(weight[rows], slices[rows])
    edges = low + (high - low) * cuts[::SLICES]
    mass = np.diff(betainc(alpha, beta, cuts[::SLICES]))
    return LengthBins(mass, edges, np.array([low, high - low, alpha, beta]), slices)


def _density(fraction: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    return fraction ** (alpha - 1) * (1 - fraction) ** (beta - 1)


@compiled
def alias_table(weight: np.ndarray, table: np.ndarray) -> None:
    """Walker's alias table of weights `(n,)`, not all zero: fills the first two columns of `table`
    `(n, …)` with each entry's own share and its partner."""
    size = weight.size
    waiting = np.empty(size, np.int64)  # poor entries from the front, rich ones from the back
    poor, rich = 0, size
    scale = size / weight.sum()
    for index in range(size):
        table[index, 0], table[index, 1] = weight[index] * scale, index
        if table[index, 0] < 1:
            waiting[poor] = index
            poor += 1
        else:
            rich -= 1
            waiting[rich] = index
    while poor > 0 and rich < size:
        taker, giver = waiting[poor - 1], waiting[rich]
        poor -= 1
        table[taker, 1] = giver
        table[giver, 0] -= 1 - table[taker, 0]
        if table[giver, 0] < 1:
            rich += 1
            waiting[poor] = giver
            poor += 1
    for index in range(poor):  # what is left is full but for rounding
        table[waiting[index], 0] = 1.0


@compiled
def _exactly(
    row: int, last: int, start: float, width: float, across: float, alpha: float, beta: float
) -> tuple[float, float]:
    """The proposed fraction of the range, and what the density leaves to be decided. Apart, so that
    its powers are computed only where they are needed."""
    if row == 0:
        fraction = width * across ** (1 / alpha)
        return fraction, (1 - fraction) ** (beta - 1)
    if row == last:
        fraction = 1 - width * across ** (1 / beta)
        return fraction, fraction ** (alpha - 1)
    fraction = start + width * across
    return fraction, fraction ** (alpha - 1) * (1 - fraction) ** (beta - 1)


@compiled
def draw_lengths(
    shape: np.ndarray, slices: np.ndarray, index: int, state: np.ndarray, lengths: np.ndarray
) -> None:
    """Fills `lengths` `(n,)` with draws from the prior inside bin `index`, body units."""
    stream = load(state)
    low, span, alpha, beta = shape[0], shape[1], shape[2], shape[3]
    last, first = slices.shape[0] - 1, index * SLICES
    for number in range(lengths.size):
        while True:
            place, stream = uniform(stream)
            across, stream = uniform(stream)
            test, stream = uniform(stream)
            place *= SLICES
            own = int(place)
            partner = int(slices[first + own, 1])
            # Without a branch, which would be guessed wrong half of the time.
            row = first + partner + (own - partner) * int(place - own < slices[first + own, 0])
            fraction = slices[row, 2] + slices[row, 3] * across
            if test < slices[row, 4]:
                break
            fraction, density = _exactly(
                row, last, slices[row, 2], slices[row, 3], across, alpha, beta
            )
            if test * slices[row, 5] < density:
                break
        lengths[number] = low + span * fraction
    store(state, stream)
