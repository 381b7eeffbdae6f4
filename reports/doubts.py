"""Doubts about what was given with a detection: whether it is the right image, whether the image
has the size that the user says, and whether its camera was far enough for weak perspective."""

from collections.abc import Iterable, Sequence

import numpy as np

from poseterior.probmodel import Detection, PoseModel
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.layouts import MEDIAPIPE_33
from poseterior.reports.options import (
    FAR_ENOUGH,
    ROUTES,
    Detected,
    Person,
    Viewing,
    draw_lenses,
)

MOST_PEOPLE = 8
"""People of a file by whom its reading is judged, evenly spread, the one that is shown among
them."""

BEYOND = 0.05
"""Of an image's longer side: a joint that lies so far outside it is not seen in it."""
ODD_FOCAL = 1.25
"""So many times as long, or as short, as the photo says, a focal length is doubted: EXIF is in
whole millimetres, and calibrations differ from it by some per cent."""


def about_the_image(person: Detection, size: tuple[int, int] | None) -> list[str]:
    """Whether an image of this width and height is the detection's: whether it has its size, and
    the joints lie in it. MediaPipe puts joints beyond the image, too."""
    if size is None:
        return []
    if person.image_size not in (None, size):
        was = "x".join(map(str, person.image_size or ()))
        return [
            f"the detection was made on an image of {was} pixels, but this one has"
            f" {size[0]}x{size[1]}"
        ]
    points, beyond = person.keypoints[person.seen], BEYOND * max(size)
    outside = ((points < -beyond) | (points > np.array(size) + beyond)).any(axis=1).sum()
    usual = len(points) / 2 if person.layout == MEDIAPIPE_33.name else 1
    if outside > usual:
        return [
            f"{outside} of {len(points)} joints lie outside the image of {size[0]}x{size[1]}:"
            " is it the right one, in its full size, and upright?"
        ]
    return []


def size_is_open(person: Detection, detected: Detected) -> bool:
    """Whether the image's size is what the user says, and the joints lie where they do because of
    it: MediaPipe's are fractions in any file, others' where they need a size; a file that says
    another size itself has pixels."""
    given = detected.image_size is not None and person.image_size == detected.size
    return given or person.layout == MEDIAPIPE_33.name


def others(people: list[Detection], person: Detection) -> list[Detection]:
    """The people by whom, beside this one, a file's reading is judged."""
    rest = [other for other in people if other.person != person.person and other.seen.any()]
    step = max(1, -(-len(rest) // (MOST_PEOPLE - 1)))
    return rest[::step]


def about_the_size(people: Sequence[Detection], detected: Detected, model: PoseModel) -> list[str]:
    """Whether bodies say that the size in `--image-size` is another image's. It takes seconds, so
    they are asked only where somebody gave a size by hand, and the joints hang on it."""
    if detected.image_size is None or not any(size_is_open(one, detected) for one in people):
        return []
    from poseterior.inference.readings import SENTENCES, Judge

    noticed = Judge(model).file(people, sizes=True).noticed
    return [SENTENCES["size"]] if "size" in noticed else []


def about_the_camera(
    metres: float,
    size: tuple[int, int] | None,
    model: PoseModel,
    viewing: Viewing,
    exif: float | None = None,
    samplers: Iterable[str] = ROUTES,
) -> list[str]:
    """Whether the focal length that was given is another than the photo's EXIF says, pixels; where
    none was given, and torso and camera are uncertain, also whether people stand within so few
    `metres` that it is drawn, or ought to be by other `samplers`."""
    if viewing.focal is not None:
        lens = model.lens
        return [] if lens is None else _about_the_focal_length(lens, exif)
    if not viewing.asks_how_near:
        return []
    if size is None:
        return [
            "it is not known how large the image is, or images differ in size, so that nobody can"
            " tell whether the camera was near: within some three metres intervals are too narrow;"
            " give --image, its size, such as --image-size 1920x1080, or --focal"
        ]
    if metres >= FAR_ENOUGH:
        return []
    near = (
        f"a usual camera took this image, if it is a whole one, within {metres:.1f} m of somebody,"
        " where perspective is strong"
    )
    known = "in pixels" if exif is None else f"in pixels or exif ({exif:.0f} pixels)"
    if draw_lenses(samplers):
        return [
            f"{near}: the focal length is drawn with the rest; give --focal where you know it,"
            f" {known}, or weak, to leave perspective out"
        ]
    return [
        f"{near} and intervals without it are too narrow: give --focal, {known}, or take"
        f" {ROUTES[0]}"
    ]


def _about_the_focal_length(lens: Lens, exif: float | None) -> list[str]:
    focal = float(np.median(lens.focal))
    if lens.number > 1 or exif is None or 1 / ODD_FOCAL < focal / exif < ODD_FOCAL:
        return []
    return [
        f"the photo's EXIF says a focal length of {exif:.0f} pixels, not {focal:.0f}: is it whole,"
        " or was it cut out of a larger one?"
    ]


def about(
    given: Person, model: PoseModel, viewing: Viewing, samplers: Iterable[str] = ROUTES
) -> list[str]:
    """All doubts about the image of one person of a file, of whose camera this is believed. Raises
    `BadInput` on a bad file."""
    person, detected = given.detection, given.detected
    people = [person, *others(given.people, person)]
    return [
        *about_the_image(person, detected.size),
        *about_the_size(people, detected, model),
        *about_the_camera(
            given.within(model), given.size, model, viewing, detected.photo_focal, samplers
        ),
    ]
