"""How far away people stand at most, by how large they appear before a usual camera."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.camera import FOCAL_MEDIAN
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.skeleton import BONES

if TYPE_CHECKING:
    from poseterior.probmodel.anatomy.lengths import LengthPrior

STRAY_BONES = 2
"""Bones, the longest in the image, that say nothing of the distance: keypoints may be wrong."""


def farthest(person: Detection, size: tuple[int, int], lengths: "LengthPrior") -> float:
    """Metres at which a person of 1.7 m stands at most before a usual camera, in an image of this
    width and height: where a bone would be as long as any and lie across the image. NaN where too
    few are seen."""
    _, longest, *_ = lengths
    seen = np.array([person.keypoints[bone.end] - person.keypoints[bone.start] for bone in BONES])
    own = np.array([longest[bone.length_group] for bone in BONES])
    scales = np.sort(np.linalg.norm(seen, axis=1) / own)  # pixels; NaN comes last
    known = scales[np.isfinite(scales)]
    if len(known) <= STRAY_BONES:
        return np.nan
    return MILLIMETRES / 1000 * FOCAL_MEDIAN * max(size) / float(known[-1 - STRAY_BONES])


def nearest(
    people: Iterable[Detection], size: tuple[int, int] | None, lengths: "LengthPrior"
) -> float:
    """Metres within which somebody stands: the least of `farthest`; infinite where nobody knows."""
    if size is None:
        return np.inf
    metres = (farthest(person, size, lengths) for person in people)
    return min((one for one in metres if np.isfinite(one)), default=np.inf)
