"""What draws of one number say, on a line or on a circle of 360 degrees: centre, deviation,
interval, density, and whether they have two modes.

On a circle the mean is the direction of the mean vector, the deviation the root of -2 ln of its
length (Mardia & Jupp 2000), and everything else is told from deviations from that mean, the short
way round. SciPy and ArviZ have the same mean and deviation; here they are plain NumPy, for which no
command waits."""

from typing import NamedTuple

import numpy as np

from poseterior.probmodel.measures.measure import FULL_TURN, wrapped

DENSITY_PLACES = 512
"""Places at which a density is known."""
VALLEY, LEAST_MASS = 0.6, 0.1
"""Two modes are two where the density between them falls below this share of the lower one, and
each has this share of the draws at least."""
STEADY = 200
"""Draws by which the density's bandwidth is chosen, at most: draws that share roots are worth
fewer than they are, and a mode shall be none of a few roots."""


_NOTHING = np.finfo(float).tiny


class Mode(NamedTuple):
    """Where a density is highest, and the share of the draws that belong there."""

    value: float
    mass: float


class Summary(NamedTuple):
    """Draws of one number: mean, standard deviation, the ends of a central interval (the high end
    above the low one, beyond 180 where it must be), and the `modes`, one or two, by their values.
    NaN, and no mode, where there is no draw."""

    mean: float
    sd: float
    low: float
    high: float
    modes: tuple[Mode, ...]


class DensityCurve(NamedTuple):
    """A density at places `at` `(DENSITY_PLACES,)`, evenly apart; on a circle from
    the emptiest place once round."""

    at: np.ndarray
    density: np.ndarray


def centre(draws: np.ndarray, circular: bool) -> np.ndarray:
    """`(...)`: the mean of draws `(n, ...)`."""
    if not circular:
        return draws.mean(axis=0)
    angles = np.radians(draws)
    return np.degrees(np.arctan2(np.sin(angles).mean(axis=0), np.cos(angles).mean(axis=0)))


def deviation(draws: np.ndarray, circular: bool) -> np.ndarray:
    """`(...)`: the standard deviation of draws `(n, ...)`."""
    if not circular:
        return draws.std(axis=0)
    length = np.abs(np.exp(1j * np.radians(draws)).mean(axis=0))
    return np.degrees(np.sqrt(-2 * np.log(np.clip(length, _NOTHING, 1.0))))


def unrolled(draws: np.ndarray, circular: bool) -> np.ndarray:
    """Draws `(n, ...)` on a line: those on a circle cut opposite to their mean."""
    if not circular:
        return draws
    middle = centre(draws, True)
    return middle + wrapped(draws - middle)


def interval(draws: np.ndarray, probability: float, circular: bool) -> np.ndarray:
    """`(2, ...)`: the ends of central intervals of draws `(n, ...)`."""
    tail = (1 - probability) / 2
    return np.quantile(unrolled(draws, circular), [tail, 1 - tail], axis=0)


def density_of(draws: np.ndarray, circular: bool) -> DensityCurve:
    """The density of draws `(n,)` by a Gaussian kernel, its width by Silverman's rule (1986)."""
    line = unrolled(draws, circular)
    width = _bandwidth(line)
    if circular:
        low, high = float(line.min()), float(line.min()) + FULL_TURN
    else:
        low, high = float(line.min()) - 4 * width, float(line.max()) + 4 * width
    step = (high - low) / DENSITY_PLACES
    counts = np.bincount(
        ((line - low) / step).astype(int) % DENSITY_PLACES, minlength=DENSITY_PLACES
    )
    away = np.minimum(np.arange(DENSITY_PLACES), DENSITY_PLACES - np.arange(DENSITY_PLACES)) * step
    kernel = np.exp(-0.5 * (away / width) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(counts) * np.fft.rfft(kernel / kernel.sum()), DENSITY_PLACES)
    found = DensityCurve(
        low + (np.arange(DENSITY_PLACES) + 0.5) * step, np.maximum(smooth, 0) / len(draws) / step
    )
    return _from_the_emptiest(found) if circular else found


def _bandwidth(line: np.ndarray) -> float:
    quarter, three = np.quantile(line, [0.25, 0.75])
    spread = min(float(line.std()), (three - quarter) / 1.349) or float(line.std())
    least = 1e-6 * (1 + float(np.abs(line).max()))
    return max(0.9 * spread * min(len(line), STEADY) ** -0.2, least)


def _from_the_emptiest(found: DensityCurve) -> DensityCurve:
    lowest = int(np.argmin(found.density))
    at = np.concatenate([found.at[lowest:] - FULL_TURN, found.at[:lowest]])
    turns = np.round(at.mean() / FULL_TURN)
    return DensityCurve(at - turns * FULL_TURN, np.roll(found.density, -lowest))


def modes(draws: np.ndarray, circular: bool) -> tuple[Mode, ...]:
    """The one or two modes of draws `(n,)`, with their masses, by their values."""
    at, density = density_of(draws, circular)
    rising = np.maximum.accumulate(density)
    falling = np.maximum.accumulate(density[::-1])[::-1]
    share = np.cumsum(density) / density.sum()
    inner = (share >= LEAST_MASS) & (share <= 1 - LEAST_MASS)
    depth = np.where(inner, density / np.maximum(np.minimum(rising, falling), _NOTHING), 1.0)
    valley = int(np.argmin(depth))
    if depth[valley] >= VALLEY:
        return (Mode(_named(at[np.argmax(density)], circular), 1.0),)
    line = at[0] + (draws - at[0]) % FULL_TURN if circular else draws
    before = float(np.mean(line < at[valley]))
    peaks = at[np.argmax(density[:valley])], at[valley + np.argmax(density[valley:])]
    found = zip(peaks, (before, 1 - before), strict=True)
    return tuple(sorted(Mode(_named(peak, circular), mass) for peak, mass in found))


def _named(place: float, circular: bool) -> float:
    return float(wrapped(np.asarray(place))) if circular else float(place)


def summarised(draws: np.ndarray, probability: float, circular: bool) -> Summary:
    """The summary of those draws `(n,)` that are numbers."""
    held = draws[np.isfinite(draws)]
    if not len(held):
        return Summary(np.nan, np.nan, np.nan, np.nan, ())
    low, high = interval(held, probability, circular)
    return Summary(
        float(centre(held, circular)),
        float(deviation(held, circular)),
        float(low),
        float(high),
        modes(held, circular),
    )
