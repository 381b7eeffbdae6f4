"""Poses on their way to other software: in metres, y up, each with a name; see `Clip`."""

import dataclasses
from dataclasses import dataclass

import numpy as np

from poseterior.probmodel.failures import BadInput

UNITS = {"m": 1.0, "mm": 1000.0}
"""How many of each unit make a metre."""
MOST_RATE = 1e5
"""Frames a second; no camera takes more."""


@dataclass(frozen=True)
class Clip:
    """Poses one after the other: hypotheses, draws, or the frames of a film.

    Attributes
    ----------
    joints : `(n, 15, 3)` metres; x right, y up, z towards the camera, the pelvis at the origin. NaN
        where a frame of a film has no pose.
    names : what each is called.
    weights : `(n,)` share of the draws that each stands for; None where that means nothing.
    spread : `(n, 15, 3)` metres, standard deviations of the draws; None where there are none.
    film : whether they follow each other in time.
    rate : poses a second.
    """

    joints: np.ndarray
    names: list[str]
    weights: np.ndarray | None = None
    spread: np.ndarray | None = None
    film: bool = False
    rate: float = 30.0

    @property
    def there(self) -> np.ndarray:
        """`(n,)`: which have a pose."""
        return np.isfinite(self.joints).all(axis=(1, 2))

    @property
    def times(self) -> np.ndarray:
        """`(n,)` seconds from the first."""
        return np.arange(len(self.joints)) / self.rate

    @property
    def radius(self) -> np.ndarray | None:
        """`(n, 15)` metres: root mean square distance of the draws from their mean."""
        return None if self.spread is None else np.sqrt(np.sum(self.spread**2, axis=-1))

    def at_rate(self, rate: float) -> "Clip":
        """The same at so many poses a second. Raises `BadInput` where there is no such rate."""
        if not 0 < rate <= MOST_RATE:
            raise BadInput(f"{rate:g} frames a second is no rate; give --rate as in the film, 30")
        return dataclasses.replace(self, rate=rate)

    def held(self) -> "Clip":
        """With the pose before it, or else the first, where a frame has none: for formats in which
        a skeleton cannot be absent."""
        there = np.flatnonzero(self.there)
        before = np.searchsorted(there, np.arange(len(self.joints)), side="right") - 1
        return dataclasses.replace(self, joints=self.joints[there[np.maximum(before, 0)]])


def viewed(joints: np.ndarray) -> np.ndarray:
    """Joints `(..., 3)` in camera axes (y down, z away) turned about x: y up, z towards the
    camera."""
    return joints * np.array([1.0, -1.0, -1.0]) + 0.0  # no zero below zero
