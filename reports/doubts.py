"""Doubts about what was given with a detection: whether it is the right image, whether the image
has the size that the user says, and whether its camera was far enough for weak perspective."""

from collections.abc import Sequence

import numpy as np

from poseterior.probmodel import Detection, PoseModel
from poseterior.probmodel.distance import nearest
from poseterior.probmodel.layouts import MEDIAPIPE_33
from poseterior.reports.options import FAR_ENOUGH, Detected, Person, Viewing

MOST_PEOPLE = 8
"""People of a file by whom its reading is judged, evenly spread, the one that is shown among
them."""

ODD_FOCAL = 1.25
"""So many times as long, or as short, as the photo says, a focal length is doubted: EXIF is in
whole millimetres, and calibrations differ from it by some per cent."""


def about_the_image(person: Detection, image: np.ndarray | None) -> list[str]:
    """What the image itself says: whether its size is the detection's, and whether the joints lie
    in it."""
    if image is None:
        return []
    size = (image.shape[1], image.shape[0])
    if person.image_size not in (None, size):
        was = "x".join(map(str, person.image_size or ()))
        return [
            f"the detection was made on an image of {was} pixels, but this one has"
            f" {size[0]}x{size[1]}"
        ]
    points = person.keypoints[person.seen]
    outside = ((points < 0) | (points > size)).any(axis=1)
    if outside.sum() > len(points) / 2:
        said = f"{outside.sum()} of {len(points)} joints lie outside the image"
        return [f"{said}: is it the right one, in its full size?"]
    return []


def size_is_open(person: Detection, detected: Detected) -> bool:
    """Whether the image's size is what the user says, and the joints lie where they do because of
    it: MediaPipe's are fractions in any file, others' where they need a size."""
    given = detected.image_size is not None and person.image_size is not None
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
    people: Sequence[Detection],
    size: tuple[int, int] | None,
    model: PoseModel,
    viewing: Viewing,
    exif: float | None = None,
) -> list[str]:
    """Whether the focal length that was given is another than the photo's EXIF says, pixels; where
    torso and camera are uncertain, too, whether people stand near the camera, and what is therefore
    drawn, or ought to be."""
    if viewing.focal is not None and model.lens is not None:
        return _about_the_focal_length(float(np.median(model.lens.focal)), model.lens.number, exif)
    if not viewing.rooted:
        return []
    if size is None and viewing.focal is None:
        return [
            "nobody knows how large the image is, and so whether the camera was near: within some"
            " three metres intervals are too narrow; give --image, --image-size 1920x1080 or"
            " --focal"
        ]
    metres = nearest(people, size, model.lengths)
    if metres >= FAR_ENOUGH:
        return []
    near = (
        f"a usual camera took this image, if it is a whole one, within {metres:.1f} m of somebody,"
        " where perspective is strong"
    )
    known = "in pixels" if exif is None else f"in pixels or exif ({exif:.0f} pixels)"
    if model.lens is None:
        return [f"{near} and intervals without it are too narrow: give --focal, {known} or unknown"]
    return [
        f"{near}: the focal length is drawn with the rest; give --focal where you know it, {known},"
        " or weak, to leave perspective out"
    ]


def _about_the_focal_length(focal: float, number: int, exif: float | None) -> list[str]:
    if number > 1 or exif is None or 1 / ODD_FOCAL < focal / exif < ODD_FOCAL:
        return []
    return [
        f"the photo's EXIF says a focal length of {exif:.0f} pixels, not {focal:.0f}: is it whole,"
        " or was it cut out of a larger one?"
    ]


def about(given: Person, model: PoseModel, viewing: Viewing) -> list[str]:
    """All doubts about the image of one person of a file, by a camera of which this is
    believed. Raises `BadInput` on a bad file."""
    person, detected = given.detection, given.detected
    people = [person, *others(given.people, person)]
    return [
        *about_the_image(person, detected.photo),
        *about_the_size(people, detected, model),
        *about_the_camera([person], given.size, model, viewing, detected.photo_focal),
    ]
