"""Doubts about what was given with a detection: whether it is the right image, whether the image
has the size that the user says, and whether its camera was far enough for weak perspective."""

from collections.abc import Sequence

import numpy as np

from poseterior.probmodel import Detection, PoseModel
from poseterior.probmodel.camera import FOCAL_MEDIAN
from poseterior.probmodel.layouts import MEDIAPIPE_33
from poseterior.probmodel.skeleton import BONES
from poseterior.reports.options import Detected, Person
from poseterior.reports.tables.posterior import MILLIMETRES

MOST_PEOPLE = 8
"""People of a file by whom its reading is judged, evenly spread, the one that is shown among
them."""

FAR_ENOUGH = 4.0
"""Metres to the camera: nearer, intervals under weak perspective are too narrow
(reports/strangers.md)."""
ODD_FOCAL = 1.25
"""So many times as long, or as short, as the photo says, a focal length is doubted: EXIF is in
whole millimetres, and calibrations differ from it by some per cent."""
STRAY_BONES = 2
"""Bones, the longest in the image, that say nothing of the distance: keypoints may be wrong."""


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


def farthest(person: Detection, size: tuple[int, int], model: PoseModel) -> float:
    """Metres at which a person of 1.7 m stands at most before a usual camera: where a bone would
    be as long as any and turned its whole length to the camera. NaN where too few are seen."""
    _, longest, *_ = model.lengths
    seen = np.array([person.keypoints[bone.end] - person.keypoints[bone.start] for bone in BONES])
    own = np.array([longest[bone.length_group] for bone in BONES])
    scales = np.sort(np.linalg.norm(seen, axis=1) / own)  # pixels; NaN comes last
    known = scales[np.isfinite(scales)]
    if len(known) <= STRAY_BONES:
        return np.nan
    return MILLIMETRES / 1000 * FOCAL_MEDIAN * max(size) / float(known[-1 - STRAY_BONES])


def about_the_camera(
    people: Sequence[Detection],
    size: tuple[int, int] | None,
    model: PoseModel,
    exif: float | None = None,
) -> list[str]:
    """Whether the focal length is another than the photo's EXIF says, pixels; or whether people
    stand too near for the weak perspective that the model believes in, if the image's size is
    known: by the user, since files may be of people who were cut out."""
    if model.lens is not None:
        return _about_the_focal_length(float(np.median(model.lens.focal)), model.lens.number, exif)
    if size is None:
        return []
    metres = [farthest(person, size, model) for person in people]
    known = [one for one in metres if np.isfinite(one)]
    if not known or np.median(known) >= FAR_ENOUGH:
        return []
    return [
        f"if this image is a whole one, a usual camera took it within {np.median(known):.1f} m of a"
        " person, where perspective is strong and intervals without it are too narrow: give"
        f" --focal, {_known(exif)}"
    ]


def _known(exif: float | None) -> str:
    return "in pixels or unknown" if exif is None else f"in pixels or exif ({exif:.0f} pixels)"


def _about_the_focal_length(focal: float, number: int, exif: float | None) -> list[str]:
    if number > 1 or exif is None or 1 / ODD_FOCAL < focal / exif < ODD_FOCAL:
        return []
    return [
        f"the photo's EXIF says a focal length of {exif:.0f} pixels, not {focal:.0f}: is it whole,"
        " or was it cut out of a larger one?"
    ]


def about(given: Person, model: PoseModel) -> list[str]:
    """All doubts about the image of one person of a file. Raises `BadInput` on a bad file."""
    person, detected = given.detection, given.detected
    people = [person, *others(given.people, person)]
    return [
        *about_the_image(person, detected.photo),
        *about_the_size(people, detected, model),
        *about_the_camera([person], detected.size, model, detected.photo_focal),
    ]
