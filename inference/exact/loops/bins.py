"""Bone lengths by bins: the prior's mass in each, and exact draws inside one for the
compiled loop.

A range is cut into bins of equal width, each bin into slices. A slice is proposed in
proportion to an envelope of the Beta density x^(a-1) (1-x)^(b-1), a length uniformly
inside it, and kept with probability density / envelope; a lower bound on that decides
nearly always. In the two outermost slices, where a factor may be unbounded, that factor
is drawn by its power law instead, exactly."""

import functools

import numpy as np
from scipy.special import beta as beta_function
from scipy.special import betainc

from poseterior.inference.exact.loops.numbers import compiled, load, store, uniform
from poseterior.inference.exact.loops.tables import (
    ALIAS,
    SLICES,
    LengthBins,
    LengthLaw,
    Record,
)

PER_BIN = 64
"""Slices a bin: the more there are, the fewer lengths need the density itself, two
powers."""


@functools.lru_cache(maxsize=128)  # few priors, few resolutions, the same for every frame
def length_bins(low: float, high: float, alpha: float, beta: float, number: int) -> LengthBins:
    """Cuts [low, high] (body units) with the prior's low + (high - low)·Beta(alpha,
    beta) into `number` bins."""
    cuts = np.linspace(0, 1, number * PER_BIN + 1)
    start = cuts[:-1]
    end = cuts[1:]
    peak = (alpha - 1) / (alpha + beta - 2) if alpha + beta != 2 else 0.5
    # The density's extremes over a slice are at its ends, or at its one stationary
    # point.
    extremes = _density(np.stack([start, end, np.clip(peak, start, end)])[:, 1:-1], alpha, beta)
    envelope, weight, floor = (np.zeros_like(start) for _ in range(3))
    envelope[1:-1] = extremes.max(axis=0)
    floor[1:-1] = extremes.min(axis=0) / extremes.max(axis=0)
    weight[1:-1] = envelope[1:-1] * (end - start)[1:-1]
    # The outermost slices hold one factor by its power law, whose integral is known,
    # and bound the other.
    envelope[0] = max(1.0, (1 - end[0]) ** (beta - 1))
    envelope[-1] = max(1.0, start[-1] ** (alpha - 1))
    weight[0] = envelope[0] * end[0] ** alpha / alpha
    weight[-1] = envelope[-1] * (1 - start[-1]) ** beta / beta
    floor[[0, -1]] = -1.0  # never decided by the bound alone
    slices = np.zeros(start.size, SLICES)
    alias = np.zeros(start.size, ALIAS)
    slices["start"] = start
    slices["width"] = end - start
    slices["floor"] = floor
    slices["envelope"] = envelope
    for first in range(0, start.size, PER_BIN):
        alias_table(weight[first : first + PER_BIN], alias[first : first + PER_BIN])
    edges = low + (high - low) * cuts[::PER_BIN]
    mass = np.diff(betainc(alpha, beta, cuts[::PER_BIN]))
    law = LengthLaw(float(low), float(high - low), float(alpha), float(beta))
    proposed = weight.reshape(-1, PER_BIN).sum(axis=1) / beta_function(alpha, beta)
    return LengthBins(law, mass, proposed, edges, alias, slices)


def _density(fraction: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    return fraction ** (alpha - 1) * (1 - fraction) ** (beta - 1)


@compiled
def alias_table(weight: np.ndarray, table: np.ndarray) -> float:
    """Fills an alias table.

    Parameters
    ----------
    weight : `(n,)`, not all zero
    table : `(n,)` `ALIAS`, or another with its columns

    Returns
    -------
    The sum of the weights.
    """
    size = weight.size
    total = 0.0
    waiting = np.empty(size, np.int64)  # poor entries from the front, rich ones from the back
    poor = 0
    rich = size
    for index in range(size):
        total += weight[index]
    scale = size / total
    for index in range(size):
        entry = table[index]
        entry.share = weight[index] * scale
        entry.partner = index
        if entry.share < 1:
            waiting[poor] = index
            poor += 1
        else:
            rich -= 1
            waiting[rich] = index
    while poor > 0 and rich < size:
        taker = table[waiting[poor - 1]]
        giver = table[waiting[rich]]
        poor -= 1
        taker.partner = waiting[rich]
        giver.share -= 1 - taker.share
        if giver.share < 1:
            waiting[poor] = waiting[rich]
            rich += 1
            poor += 1
    for index in range(poor):  # what is left is full but for rounding
        table[waiting[index]].share = 1.0
    return total


@compiled
def _exactly(
    row: int, last: int, piece: Record, across: float, law: LengthLaw
) -> tuple[float, float]:
    """The proposed fraction of the range, and what the density leaves to be decided.
    Apart, so that its powers are computed only where they are needed."""
    if row == 0:
        fraction = piece.width * across ** (1 / law.alpha)
        return fraction, (1 - fraction) ** (law.beta - 1)
    if row == last:
        fraction = 1 - piece.width * across ** (1 / law.beta)
        return fraction, fraction ** (law.alpha - 1)
    fraction = piece.start + piece.width * across
    return fraction, fraction ** (law.alpha - 1) * (1 - fraction) ** (law.beta - 1)


@compiled
def draw_lengths(bins: LengthBins, index: int, state: np.ndarray, lengths: np.ndarray) -> None:
    """Fills `lengths` `(n,)` with draws from the prior inside bin `index`, body
    units."""
    law = bins.law
    alias = bins.alias
    slices = bins.slices
    stream = load(state)
    last = slices.size - 1
    first = index * PER_BIN
    for number in range(lengths.size):
        while True:
            place, stream = uniform(stream)
            across, stream = uniform(stream)
            test, stream = uniform(stream)
            place *= PER_BIN
            own = int(place)
            entry = alias[first + own]
            # Without a branch, which would be guessed wrong half of the time.
            row = first + entry.partner + (own - entry.partner) * int(place - own < entry.share)
            piece = slices[row]
            fraction = piece.start + piece.width * across
            if test < piece.floor:
                break
            fraction, density = _exactly(row, last, piece, across, law)
            if test * piece.envelope < density:
                break
        lengths[number] = law.low + law.span * fraction
    store(state, stream)
