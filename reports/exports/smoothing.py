"""Filters for films: `smoother_of("butterworth:6")` makes one, which takes every stretch of frames
without a gap by itself."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.motion.lowpass import butterworth

_ORDER = 2
"""Of the polynomials of Savitzky and Golay."""
_SPEEDS = 1.0
"""Hz: the cutoff of speeds in the one-euro filter."""
_GROWTH = 2.0
"""Hz for each metre a second: how its cutoff grows with speed."""


def savgol(values: np.ndarray, rate: float, window: float) -> np.ndarray:
    """Parabolas through `window` frames; through fewer where the stretch is shorter."""
    from scipy.signal import savgol_filter

    del rate
    longest = len(values) - (len(values) + 1) % 2
    frames = min(int(window), longest)
    return values if frames <= _ORDER else savgol_filter(values, frames, _ORDER, axis=0)


def one_euro(values: np.ndarray, rate: float, slowest: float) -> np.ndarray:
    """The filter of Casiez, Roussel and Vogel (CHI 2012), which looks back only, as films that are
    still being made need it: what rests is cut off at `slowest` Hz, what moves later."""
    found, speed = values.copy(), np.zeros_like(values[0])
    for at in range(1, len(values)):
        speed = speed + _share(_SPEEDS, rate) * ((values[at] - values[at - 1]) * rate - speed)
        share = _share(slowest + _GROWTH * np.abs(speed), rate)
        found[at] = found[at - 1] + share * (values[at] - found[at - 1])
    return found


def _share[T: (float, np.ndarray)](cutoff: T, rate: float) -> T:
    """How much of a new value a low-pass filter of first order takes."""
    return 1 / (1 + rate / (2 * math.pi * cutoff))


class _Kind(NamedTuple):
    """A kind of filter: its function of `(n, ...)` metres, rate and parameter; the parameter, in
    words, and its usual value."""

    run: Callable[[np.ndarray, float, float], np.ndarray]
    parameter: str
    usual: float


FILTERS = {
    "butterworth": _Kind(butterworth, "Hz", 6.0),
    "savgol": _Kind(savgol, "frames, odd", 15.0),
    "one-euro": _Kind(one_euro, "Hz", 1.0),
}
"""Filters by name."""


@dataclass(frozen=True)
class Smoother:
    """A filter with its parameter."""

    name: str
    parameter: float

    def __str__(self) -> str:
        return f"{self.name}:{self.parameter:g}"

    def check(self, rate: float) -> None:
        """Raises `BadInput` where it cannot run at so many frames a second."""
        if self.name == "butterworth" and self.parameter >= rate / 2:
            raise BadInput(
                f"--smooth {self} cuts off beyond what {rate:g} frames a second can hold; choose"
                f" less than {rate / 2:.3g} Hz"
            )

    def __call__(self, values: np.ndarray, places: np.ndarray, rate: float) -> np.ndarray:
        """Values `(n, ...)` of frames at `places` `(n,)`, whole numbers that grow, at `rate` places
        a second; rows that are NaN, and places that are not there, are gaps."""
        found = values.copy()
        there = np.flatnonzero(np.isfinite(values).reshape(len(values), -1).all(axis=1))
        for stretch in np.split(there, np.flatnonzero(np.diff(places[there]) > 1) + 1):
            if len(stretch) > 1:
                found[stretch] = FILTERS[self.name].run(values[stretch], rate, self.parameter)
        return found


def smoother_of(text: str) -> Smoother:
    """A filter from its name and, after a colon, its parameter. Raises `BadInput` on any other
    text."""
    name, colon, given = text.partition(":")
    kind = FILTERS.get(name)
    if kind is None:
        raise BadInput(f"there is no filter {name!r}; choose one of {', '.join(FILTERS)}")
    try:
        value = float(given) if colon else kind.usual
    except ValueError:
        value = math.nan
    odd = name != "savgol" or (value % 2 == 1 and value > _ORDER)
    if not (0 < value < math.inf and odd):
        raise BadInput(
            f"--smooth {text} is no filter; after the colon stands a number ({kind.parameter}), as"
            f" in {name}:{kind.usual:g}"
        )
    return Smoother(name, value)
