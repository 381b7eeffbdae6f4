"""Poses on their way to other software: in metres, y up, each with a name; see `Clip`."""

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.measures import Measure

UNITS = {"m": 1.0, "mm": 1000.0}
"""How many of each unit make a metre."""
RATE = 30.0
"""Frames a second where nobody says: to be said whenever it is used."""
PELVIS, CAMERA, WORLD_ORIGIN = "pelvis", "camera", "origin of the calibration"
"""What is at the origin of poses."""
LEAST_RATE, MOST_RATE = 1e-3, 1e5
"""Frames a second; no film has fewer, no camera takes more."""


class MeasureColumn(NamedTuple):
    """A measure of every pose of a clip: values `(n,)`, NaN where there is no pose, and the
    standard deviations of the draws, None where there are none; degrees or metres."""

    measure: Measure
    values: np.ndarray
    spread: np.ndarray | None

    def in_unit(self, unit: str) -> "MeasureColumn":
        """With lengths in another unit than metres."""
        if self.measure.kind != "length":
            return self
        scale = UNITS[unit]
        spread = None if self.spread is None else scale * self.spread
        return MeasureColumn(self.measure, scale * self.values, spread)

    def heads(self, unit: str) -> list[str]:
        """Of its columns in a table whose lengths are in `unit`."""
        sign = unit if self.measure.kind == "length" else "deg"
        own = [f"{self.measure.name}_{sign}"]
        return own if self.spread is None else [*own, f"{self.measure.name}_sd_{sign}"]


@dataclass(frozen=True)
class Clip:
    """Poses one after the other: hypotheses, draws, or the frames of a film.

    Attributes
    ----------
    joints : `(n, 15, 3)` metres; x right, y up, z towards the camera; of calibrated cameras x and z
        on the level. NaN where a frame of a film has no pose.
    names : what each is called.
    weights : `(n,)` share of the draws that each stands for; None where that means nothing.
    spread : `(n, 15, 3)` metres, standard deviations of the draws; None where there are none.
    film : whether they follow each other in time.
    numbers : when each is taken, in frames; they grow. None where nobody says: one follows the
        other.
    rate : frames a second.
    timed : whether that is known, and not assumed.
    origin : what is at the origin: the pelvis of each pose, or what stands still.
    measures : joint angles, lengths and steps that are asked for.
    """

    joints: np.ndarray
    names: list[str]
    weights: np.ndarray | None = None
    spread: np.ndarray | None = None
    film: bool = False
    numbers: list[int] | None = None
    rate: float = RATE
    timed: bool = False
    origin: str = PELVIS
    measures: tuple[MeasureColumn, ...] = ()

    @property
    def there(self) -> np.ndarray:
        """`(n,)`: which have a pose."""
        return np.isfinite(self.joints).all(axis=(1, 2))

    @property
    def frames(self) -> list[int]:
        """The numbers, from 1 where nobody says them."""
        return self.numbers or list(range(1, len(self.joints) + 1))

    @property
    def times(self) -> np.ndarray:
        """`(n,)` seconds from the first."""
        return np.array([after / self.rate for after in self._after])

    @property
    def step(self) -> int:
        """The largest number of frames of which all poses are whole multiples apart."""
        return math.gcd(*self._after) or 1

    @property
    def places(self) -> np.ndarray:
        """`(n,)`: how many steps each is from the first."""
        return np.array([after // self.step for after in self._after])

    @property
    def _after(self) -> list[int]:
        """How many frames each is after the first."""
        frames = self.frames
        return [number - frames[0] for number in frames]

    @property
    def radius(self) -> np.ndarray | None:
        """`(n, 15)` metres: root mean square distance of the draws from their mean."""
        return None if self.spread is None else np.sqrt(np.sum(self.spread**2, axis=-1))

    def at_rate(self, rate: float) -> "Clip":
        """The same at so many poses a second. Raises `BadInput` where there is no such rate."""
        if not LEAST_RATE <= rate <= MOST_RATE:
            raise BadInput(
                f"{rate:g} frames a second is no rate, from {LEAST_RATE:g} to {MOST_RATE:g}; give"
                " --rate as in the film, 25"
            )
        return dataclasses.replace(self, rate=rate)

    def regular(self) -> "Clip":
        """A pose every `step` frames, NaN where there is none: for formats that know a rate, and no
        times; these have no measures."""
        places = self.places
        count = int(places[-1]) + 1
        if count == len(places):
            return self
        names = dict(zip(places.tolist(), self.names, strict=True))
        return dataclasses.replace(
            self,
            joints=_spread_out(self.joints, places, count),
            names=[names.get(place, "") for place in range(count)],
            spread=None if self.spread is None else _spread_out(self.spread, places, count),
            numbers=[self.frames[0] + self.step * place for place in range(count)],
            measures=(),
        )

    @property
    def pace(self) -> float:
        """Poses a second of a clip that is `regular`."""
        return self.rate / self.step

    def held(self) -> "Clip":
        """With the pose before it, or else the first, where a frame has none: for formats in which
        a skeleton cannot be absent."""
        there = np.flatnonzero(self.there)
        before = np.searchsorted(there, np.arange(len(self.joints)), side="right") - 1
        return dataclasses.replace(self, joints=self.joints[there[np.maximum(before, 0)]])


def _spread_out(values: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
    """`(count, ...)`: values in their places, NaN elsewhere."""
    blank = np.full((count, *values.shape[1:]), np.nan)
    blank[places] = values
    return blank


def viewed(joints: np.ndarray) -> np.ndarray:
    """Joints `(..., 3)` in camera axes, or level ones (y down, z away), turned about x: y up, z
    towards the camera."""
    return joints * np.array([1.0, -1.0, -1.0]) + 0.0  # no zero below zero
