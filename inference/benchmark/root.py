"""The root of a frozen target, a torso in front of a camera: fixed, or a part of the posterior with
seven coordinates of its own.

Plain NumPy that shares no code with `probmodel.roots` and `probmodel.rotations`; tests hold them to
each other. `BoxedRoot` cuts the flat priors of scale and place (docs/model.md § 9) off at a
box, since otherwise there would be neither an evidence nor a prior transform."""

import functools
import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from poseterior.probmodel.skeleton import TORSO_INDEX


class PlacedTorso(NamedTuple):
    """A root, or many: the `torso` `(..., 6, 3)` in camera axes, body units; the `scale` `(...)` of
    the image, its units a body unit; and the `place` `(..., 2)` of the pelvis in it."""

    torso: np.ndarray
    scale: np.ndarray
    place: np.ndarray


@dataclass(frozen=True, eq=False)
class GivenRoot:
    """One torso, seen by a camera that does nothing: the image is the camera's plane.

    Attributes
    ----------
    view : `(6, 3)`, the torso in camera axes (x right, y down, z away), body units.
    """

    view: np.ndarray
    coordinates: ClassVar[tuple[str, ...]] = ()
    joints: ClassVar[tuple[int, ...]] = ()
    """The joints that count because of it: none, since the torso lies where it lies."""

    def at(self, box: np.ndarray) -> PlacedTorso:
        """The one root there is."""
        return PlacedTorso(self.view, np.ones(()), np.zeros(2))

    def log_growth(self, box: np.ndarray) -> np.ndarray:
        """`(...)`: log of the scale over the least one, at points `(..., 0)`: 0."""
        return np.zeros(box.shape[:-1])


@dataclass(frozen=True, eq=False)
class BoxedRoot:
    """Any torso of a dictionary, turned in any way, of any size and at any place in a box; the
    prior is flat in all seven coordinates, which are fractions.

    - *torso*: which of them, the unit interval being cut into equal parts. Torsos that stand next
      to each other are alike, so that a small step is a small change.
    - *yaw*, *tilt*, *roll*: the body is turned about its back, which then leans towards the camera
      and is turned in the image. In the middle of all three somebody stands upright and faces the
      camera. Turns are flat in the angle and tilts in their sine, which is Haar's measure.
    - *log scale*, *place u*, *place v*: in the box.

    Attributes
    ----------
    torsos : `(J, 6, 3)`, body axes (x to the person's left, y up, z forward), body units.
    scale : `(2,)`, the least and the largest, units of the image a body unit.
    place : `(2, 2)`, the corners between which the pelvis falls, in the image.
    """

    torsos: np.ndarray
    scale: np.ndarray
    place: np.ndarray
    coordinates: ClassVar[tuple[str, ...]] = (
        *("torso", "yaw", "tilt", "roll"),
        *("log scale", "place u", "place v"),
    )
    joints: ClassVar[tuple[int, ...]] = TORSO_INDEX

    @functools.cached_property
    def log_range(self) -> float:
        """Log of the largest scale over the least."""
        return math.log(self.scale[1] / self.scale[0])

    @property
    def log_volume(self) -> float:
        """Log of the box's size: log scale × area of the image."""
        return math.log(self.log_range * float(np.prod(self.place[1] - self.place[0])))

    def torso_index(self, box: np.ndarray) -> np.ndarray:
        """`(...)`: which of the torsos, at points `(..., 7)`."""
        part = np.floor(box[..., 0] * len(self.torsos)).astype(int)
        return np.clip(part, 0, len(self.torsos) - 1)

    def at(self, box: np.ndarray) -> PlacedTorso:
        """The roots at points `(n, 7)`."""
        turned = rotations(box[..., 1:4]) @ np.swapaxes(self.torsos[self.torso_index(box)], -1, -2)
        scale = self.scale[0] * np.exp(self.log_growth(box))
        place = self.place[0] + (self.place[1] - self.place[0]) * box[..., 5:]
        return PlacedTorso(np.swapaxes(turned, -1, -2), scale, place)

    def log_growth(self, box: np.ndarray) -> np.ndarray:
        """`(...)`: log of the scale over the least one, at points `(..., 7)`."""
        return self.log_range * box[..., 4]

    def box_of(
        self,
        torso: np.ndarray,
        rotation: np.ndarray,
        log_scale: np.ndarray,
        place: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """The box at roots, outside of [0, 1] where they are not in it.

        Parameters
        ----------
        torso : `(n,)`
            Which of the torsos. The place in its part is drawn, since nothing depends on it.
        rotation : `(n, 3, 3)`
            From body axes to camera axes.
        log_scale : `(n,)`
        place : `(n, 2)`
        rng
            Where the places in the torsos' parts are from.

        Returns
        -------
        ndarray
            `(n, 7)`.
        """
        part = (torso + rng.uniform(size=len(torso))) / len(self.torsos)
        growth = (log_scale - math.log(self.scale[0])) / self.log_range
        inside = (place - self.place[0]) / (self.place[1] - self.place[0])
        turns = fractions_of(rotation)
        return np.concatenate([part[:, None], turns, growth[:, None], inside], axis=1)


FrozenRoot = GivenRoot | BoxedRoot


def rotations(turns: np.ndarray) -> np.ndarray:
    """`(..., 3, 3)`: rotations from body axes to camera axes at fractions `(..., 3)` of yaw, tilt
    and roll; uniform fractions have Haar's law."""
    yaw, roll = (np.pi * (2 * turns[..., one] - 1) for one in (0, 2))
    lean = 2 * turns[..., 1] - 1  # sine of the tilt
    upright = np.sqrt((1 - lean) * (1 + lean))
    c = np.cos(yaw)
    s = np.sin(yaw)
    # Rows of the body turned about its back, then leaning towards the camera.
    across = np.stack([c, np.zeros_like(c), s], axis=-1)
    down = np.stack([-lean * s, -upright, lean * c], axis=-1)
    off = np.stack([upright * s, -lean, -upright * c], axis=-1)
    c, s = (part[..., None] for part in (np.cos(roll), np.sin(roll)))
    return np.stack([c * across - s * down, s * across + c * down, off], axis=-2)


def fractions_of(rotation: np.ndarray) -> np.ndarray:
    """`(..., 3)`: the fractions at rotations `(..., 3, 3)`."""
    yaw = np.arctan2(rotation[..., 2, 0], -rotation[..., 2, 2])
    roll = np.arctan2(rotation[..., 0, 1], -rotation[..., 1, 1])
    lean = -rotation[..., 2, 1]
    return np.stack([(yaw / np.pi + 1) / 2, (lean + 1) / 2, (roll / np.pi + 1) / 2], axis=-1)
