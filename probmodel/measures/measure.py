"""One measure: how it is computed, and what its number means; see `Measure`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

Computed = Callable[[np.ndarray], np.ndarray]
"""Joints `(..., 15, 3)` → numbers `(...)`."""
Kind = Literal["angle", "turn", "length"]
FULL_TURN = 360.0
"""Degrees."""


@dataclass(frozen=True)
class Measure:
    """A number that people measure of a pose.

    Attributes
    ----------
    name
        As it is asked for.
    of
        Joints `(..., 15, 3)` in camera axes → the measure `(...)`, NaN where the pose does not
        determine it.
    kind
        "angle": degrees on a line that does not close, such as 0 to 180; "turn": degrees of a
        circle, from -180 to 180, of which both ends are one; "length": in the unit of the joints.
    convention
        From where it is counted, and what is positive.
    source
        Whose convention it is.
    """

    name: str
    of: Computed
    kind: Kind
    convention: str
    source: str

    @property
    def circular(self) -> bool:
        """Whether -180 and 180 are one value."""
        return self.kind == "turn"

    @property
    def unit(self) -> str:
        """Of its numbers, where joints are in body units."""
        return "body units" if self.kind == "length" else "degrees"


def wrapped(degrees: np.ndarray) -> np.ndarray:
    """Angles as they are from -180 up to 180 degrees."""
    return (degrees + FULL_TURN / 2) % FULL_TURN - FULL_TURN / 2


def turned(degrees: np.ndarray, measure: Measure) -> np.ndarray:
    """Differences of a measure's values: the short way round where it is circular."""
    return wrapped(degrees) if measure.circular else degrees
