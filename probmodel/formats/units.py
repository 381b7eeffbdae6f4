"""What coordinates are counted in: pixels, fractions of the image, or −1 to 1 from its middle.

Readers yield people as the file has them, and `in_pixels`, which all of them go through, looks:
nobody is a pixel tall. Fractions become pixels by the size of the image, the file's own or else the
user's; what is neither, metres perhaps, is refused."""

import enum
import itertools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from poseterior.probmodel.detections import Detection, FloatArray, mapped
from poseterior.probmodel.failures import BadInput

OUTSIDE = 0.5
"""How far outside of the image, in images, a fraction may still lie."""
FARTHEST_FRACTION = 10.0
"""Fractions beyond this are pixels that someone converted already: joints do not lie ten images
away."""
SMALLEST_BODY = 3.0
"""Pixels; whoever is not larger is measured in something else."""
MOST_NEGATIVE = 0.25
"""The share of points left of the image or above it from which on they are counted from its middle,
or in space."""
LOOKED_AT, MOST_LOOKED_AT = 100, 10_000
"""People of a file that are looked at; and how many where nobody is larger than `SMALLEST_BODY`,
though coordinates are no fractions: a detector may put all points of nobody into one place."""


class Unit(enum.Enum):
    """What one is, in coordinates: a pixel, the image's side, or half of it, from the middle."""

    PIXELS = "pixels"
    FRACTIONS = "fractions"
    CENTRED = "centred"


def in_pixels(
    people: Iterable[Detection],
    unit: Unit | None,
    size: tuple[int, int] | None,
    *,
    centred: bool = False,
) -> Iterator[Detection]:
    """The people of a file in pixels, one by one.

    Parameters
    ----------
    people
        As the file has them.
    unit
        What it counts in; None where that has to be looked at.
    size
        (width, height) of the image in pixels, for people whose file does not say it.
    centred
        Whether its detector counts from the middle, if it was asked to.

    Yields
    ------
    Detection
        The same in pixels, with the size of its image where that was needed.

    Raises
    ------
    BadInput
        Where coordinates are neither pixels nor fractions, or fractions of an image whose size
        nobody says.
    """
    rest = iter(people)
    if unit is None:
        head: list[Detection] = []
        small = True
        for person in itertools.islice(rest, MOST_LOOKED_AT):
            head.append(person)
            small &= np.abs(_points(person)).max(initial=0.0) <= 1 + OUTSIDE
            if _extent(person) > SMALLEST_BODY or (small and len(head) == LOOKED_AT):
                break
        unit, rest = unit_of(head, centred=centred), itertools.chain(head, rest)
    elif unit is Unit.FRACTIONS:
        head = list(itertools.islice(rest, LOOKED_AT))
        _require_an_image(head)
        rest = itertools.chain(head, rest)
    for person in rest:
        yield person if unit is Unit.PIXELS else _scaled(person, unit, size)


def unit_of(people: Sequence[Detection], *, centred: bool = False) -> Unit:
    """What people as a file has them are counted in. Raises `BadInput` as `in_pixels` does."""
    points = [_points(person) for person in people]
    xy = np.concatenate(points) if points else np.empty((0, 2))
    if not len(xy) or any(_extent(person) > SMALLEST_BODY for person in people):
        return Unit.PIXELS
    source = people[0].source
    if (np.abs(xy) > 1 + OUTSIDE).any():
        if max(map(len, points)) < 3:
            return Unit.PIXELS  # too little is seen to tell a size
        raise BadInput(
            f"nobody in {source} is larger than {max(map(_extent, people)):.2g}, which can be"
            " neither pixels nor fractions of an image, but perhaps metres; give 2D joints in"
            " pixels (3D poses are for check, learn and evaluate)."
        )
    negative = (xy < 0).any(axis=1)
    if centred and negative.any() and all(person.image_size is None for person in people):
        return Unit.CENTRED
    if negative.mean() > MOST_NEGATIVE:
        raise BadInput(
            f"the coordinates of {source} lie between {xy.min():.2g} and {xy.max():.2g} on both"
            " sides of zero, which are neither pixels nor fractions of an image; give pixels, from"
            " the upper left corner (3D poses are for check, learn and evaluate)."
        )
    return Unit.FRACTIONS


def _require_an_image(people: Sequence[Detection]) -> None:
    """Raises `BadInput` where fractions lie about an origin, as MediaPipe's world landmarks do."""
    xy = np.concatenate([np.empty((0, 2)), *map(_points, people)])
    if len(xy) and (xy < 0).mean(axis=0).min() > MOST_NEGATIVE:
        raise BadInput(
            f"the coordinates of {people[0].source} lie on both sides of zero, as those in space"
            " do, MediaPipe's world landmarks among them, and not fractions of an image; give the"
            " landmarks of the image (3D poses are for check, learn and evaluate)."
        )


def _points(person: Detection) -> FloatArray:
    """`(n, 2)`: all that is seen, of body and face."""
    face = np.empty((0, 2)) if person.face is None else person.face[:, :2]
    xy = np.concatenate([person.keypoints, face])
    return xy[np.isfinite(xy).all(axis=1)]


def _extent(person: Detection) -> float:
    """The longer side of the box around all that is seen; 0 where nothing is."""
    xy = _points(person)
    return float(np.ptp(xy, axis=0).max()) if len(xy) else 0.0


def _scaled(person: Detection, unit: Unit, size: tuple[int, int] | None) -> Detection:
    size = person.image_size or size
    if size is None:
        raise BadInput(
            f"the coordinates of {person.source} are fractions of an image whose size the file"
            " does not say; give image_size=(640, 480), or on the command line the image (--image)"
            " or --image-size 640x480."
        )
    farthest = np.abs(_points(person)).max(initial=0.0)
    if farthest > FARTHEST_FRACTION:
        raise BadInput(
            f"{person.where} has a point {farthest:g} images from the corner, where fractions of"
            " the image are needed; leave them as the detector wrote them."
        )
    shift, scale = (1.0, np.array(size) / 2) if unit is Unit.CENTRED else (0.0, np.array(size))
    return mapped(person, lambda places: (places + shift) * scale, image_size=size)
