"""Which way is up in the world of calibrated cameras, and level axes for what is told there.

A calibration does not say it. But cameras stand upright, more or less, and a world has one of its
axes vertical: the one that lies nearest to the mean of the cameras' own."""

from typing import NamedTuple

import numpy as np

from poseterior.probmodel.failures import BadInput, shown

UPS = {f"{sign}{name}": axis for sign in ("", "-") for axis, name in enumerate("xyz")}
"""The axes that may point up by their names, with their numbers."""
MOST_TILT = 30.0
"""Degrees from the cameras' own up beyond which it is doubtful that an axis is vertical."""


def up_of(rotation: np.ndarray) -> tuple[str, float]:
    """The axis of the world that points up.

    Parameters
    ----------
    rotation : `(C, 3, 3)`
        From the world's axes to those of each camera, y down.

    Returns
    -------
    str
        One of `UPS`.
    float
        Degrees between it and the mean of the cameras' own up.
    """
    up = -np.asarray(rotation)[:, 1].mean(axis=0)
    axis = int(np.argmax(np.abs(up)))
    length = float(np.linalg.norm(up))
    tilt = np.degrees(np.arccos(np.clip(abs(up[axis]) / length, 0, 1))) if length else 90.0
    return ("-" if up[axis] < 0 else "") + "xyz"[axis], float(tilt)


def doubtful(up: str, tilt: float) -> list[str]:
    """A sentence where cameras do not tell which way is up."""
    if tilt <= MOST_TILT:
        return []
    return [
        f"of the calibration's axes {up} lies nearest to where cameras have up, and {tilt:.0f}"
        " degrees from there: what is counted from the vertical, such as heights and leans, is"
        " counted from that axis"
    ]


def level_axes(up: str) -> np.ndarray:
    """Axes as those of a camera that stands level.

    Parameters
    ----------
    up
        The world's axis that points up, one of `UPS`.

    Returns
    -------
    ndarray
        `(3, 3)`: what turns the world's axes into x and z on the level, and y down.

    Raises
    ------
    BadInput
        Where it is none of them.
    """
    if up not in UPS:
        raise BadInput(f"{shown(up)} is no axis that points up; give one of {', '.join(UPS)}")
    down = np.zeros(3)
    down[UPS[up]] = 1.0 if up.startswith("-") else -1.0
    right = np.eye(3)[0 if UPS[up] else 1]
    return np.stack([right, down, np.cross(right, down)])


class CalibratedWorld(NamedTuple):
    """What is known of the world that cameras are calibrated in, by which a film of them is told as
    films of one camera are: what reads the one reads the other.

    Attributes
    ----------
    up
        The axis that points up, one of `UPS`.
    unit_mm
        Millimetres of a body unit.
    views
        What the cameras are called.
    """

    up: str
    unit_mm: float
    views: tuple[str, ...]

    def told(self, points: np.ndarray) -> np.ndarray:
        """Points `(..., 3)` in the world's axes, mm, in body units of level ones (`level_axes`).
        Raises `BadInput` as that does."""
        return points @ level_axes(self.up).T / self.unit_mm
