"""What streams are made of: frames with names, and what calibrated cameras filmed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from poseterior.probmodel.detections import Detection
from poseterior.probmodel.errors.likelihood import Likelihood
from poseterior.probmodel.instant import Instant
from poseterior.probmodel.level import CalibratedWorld
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.sessions import Session

SIDES_TOLD_AT = "sides_told_at"
"""What a stream calls the rate by which left and right were told before it was drawn."""


class Item(NamedTuple):
    """A frame of a stream.

    Attributes
    ----------
    name
        Unlike any other's.
    frame
        The estimate; or the detection, which is estimated where its block is made, and not again;
        or what calibrated cameras saw; or, where there is no pose to be told, the sentence that
        says why.
    exchange
        Of a detection in a film: how probable each of the exchanges but "none" is in this frame, as
        far as the others say it (`films.sides`); None where nothing is known but the law.
    """

    name: str
    frame: Estimate | Detection | Instant | str
    exchange: tuple[float, ...] | None = None


@dataclass(frozen=True)
class FramesInMotion:
    """The frames of a film that know what the others say of left and right: items of a stream.

    Attributes
    ----------
    items
        With an `exchange`.
    rate
        Frames a second by which it was told.
    """

    items: list[Item]
    rate: float

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self.items)

    @property
    def settings(self) -> dict[str, Any]:
        """What draws depend on beside the detections: plain JSON values."""
        return {SIDES_TOLD_AT: self.rate}


@dataclass(frozen=True, eq=False)
class Footage:
    """The frames that calibrated cameras filmed of one person: items of a stream, named by their
    numbers.

        pt.sample_film(pt.PoseModel(), pt.Footage(session, [0, 2]), rate=60, key=0, out="walk")

    Attributes
    ----------
    session
        What all cameras saw.
    cameras
        Which of them count, from 0; by default all.
    likelihood
        How detections err; by default as `Session.instant` has it.

    Raises
    ------
    BadInput
        Where there is no such camera.
    """

    session: Session
    cameras: Sequence[int] | None = None
    likelihood: Likelihood | None = None

    def __post_init__(self) -> None:
        self.first  # noqa: B018

    def __len__(self) -> int:
        return len(self.session)

    def __iter__(self) -> Iterator[Item]:
        for name, number in zip(self.names, self.session.numbers, strict=True):
            yield Item(name, self._instant(number))

    @property
    def names(self) -> list[str]:
        """Of the frames."""
        return [str(number) for number in self.session.numbers]

    @cached_property
    def first(self) -> Instant:
        """The first frame."""
        return self._instant(self.session.numbers[0])

    @cached_property
    def world(self) -> CalibratedWorld:
        """By what it is told: the axis that the cameras have for up, and the person's body unit."""
        views = tuple(view.label for view in self.first.views)
        return CalibratedWorld(self.first.up[0], self.session.unit, views)

    @property
    def settings(self) -> dict[str, Any]:
        """What draws depend on beside the detections: plain JSON values."""
        laws = dict.fromkeys(view.likelihood for view in self.first.views)
        return self.world._asdict() | {
            "views": list(self.world.views),
            "likelihood": "; ".join(f"{one.words} {one.sha256}" for one in laws),
        }

    def _instant(self, number: int) -> Instant:
        instant = self.session.instant(number, self.cameras)
        return instant.judged_by(self.likelihood) if self.likelihood else instant
