"""What a detector says about one person in one frame: fifteen joints in pixels, each with a score
or missing.

The usual way in is `read_detections` of `probmodel.formats`; `Detection` is what every reader
returns. What the scores mean for the likelihood: `probmodel.errors.likelihood`."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.skeleton import BONES, JOINTS, LIMB_JOINTS, NUM_JOINTS

__all__ = ["FACE", "LARGEST_NUMBER", "LIKELIHOOD_JOINTS", "LIMB_JOINTS", "Detection", "pick_person"]

FloatArray = npt.NDArray[np.float64]

LIKELIHOOD_JOINTS = tuple(bone.end for bone in BONES)
"""The joints that may carry a factor of the likelihood: the head's end and the limb joints.

The paper's product runs over `LIMB_JOINTS` alone; pass those as `joints` to leave the head out.
"""

FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
"""Points of the face. No joints of the skeleton: they only tell which side of the person the camera
sees."""

LARGEST_NUMBER = 1e9
"""No coordinate (pixels), score or scale may be larger: squares of larger numbers lose their
meaning, or overflow."""


LONGEST_LABEL = 400
"""Characters of the name of an image, a subject, an action."""
_NOT_IN_LABELS = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
"""Control characters, with which a terminal can be told things, and surrogates, which no file can
hold."""
_LABEL = f"a text of at most {LONGEST_LABEL} characters without control characters, or None"


def is_label(value: object) -> bool:
    """Whether it is a text that can be shown and written anywhere."""
    return (
        isinstance(value, str)
        and len(value) <= LONGEST_LABEL
        and _NOT_IN_LABELS.search(value) is None
    )


@dataclass(frozen=True, eq=False)
class Detection:
    """One person in one frame.

    Attributes
    ----------
    keypoints : `(15, 2)`
        Pixels, x right, y down, NaN where missing; in the order of `probmodel.skeleton.JOINTS`,
        copied and read-only.
    score : `(15,)`
        Positive, 0 where missing; in the same manner.
    layout
        The joint order of the source.
    source, person
        The file, and the person's number in it.
    image_id, image_size
        The image's name, and its (width, height) in pixels, where they are known.
    face : `(5, 3)`
        x, y, score of the points of `FACE` in the same manner, None where the detector has none;
        the likelihood has no use for it.
    moved
        Which of thorax and pelvis `probmodel.layouts.corrected` has moved from a midpoint to where
        the skeleton has them.
    midpoints
        Which of the two the detector lacks, or defines as midpoints of shoulders and hips.
    track
        Whom the source says that this is: the same in all frames in which it found the same person,
        None where it says nothing. Who is who without it: `probmodel.people`.

    Raises
    ------
    BadInput
        Where shapes differ, a number is not finite or a score negative, or the NaN keypoints are
        not exactly those whose score is 0.
    """

    keypoints: FloatArray
    score: FloatArray
    layout: str
    source: str
    person: int
    image_id: str | None = None
    image_size: tuple[int, int] | None = None
    face: FloatArray | None = None
    moved: tuple[str, ...] = ()
    midpoints: tuple[str, ...] = ()
    track: str | None = None

    def __post_init__(self) -> None:
        keypoints = _owned(self.keypoints, (NUM_JOINTS, 2), f"the keypoints of {self.where}")
        score = _owned(self.score, (NUM_JOINTS,), f"the scores of {self.where}")
        object.__setattr__(self, "keypoints", keypoints)
        object.__setattr__(self, "score", score)
        _check_numbers(keypoints, score, JOINTS, self.where)
        if self.face is not None:
            face = _owned(self.face, (len(FACE), 3), f"the face of {self.where}")
            object.__setattr__(self, "face", face)
            _check_numbers(face[:, :2], face[:, 2], FACE, self.where)
        _check_labels(self.person, self.image_id, self.image_size, self.where)
        if self.track is not None and not is_label(self.track):
            raise BadInput(f"the track of {self.where} must be {_LABEL}, not {shown(self.track)}.")

    def _repr_html_(self) -> str:
        """A table of what was seen, for notebooks."""
        rows = "".join(
            f"<tr><td>{name}</td><td>{x:.1f}</td><td>{y:.1f}</td><td>{score:.2f}</td></tr>"
            for name, (x, y), score in zip(JOINTS, self.keypoints, self.score, strict=True)
            if score > 0
        )
        head = "<tr><th>joint</th><th>x</th><th>y</th><th>score</th></tr>"
        return f"<table><caption>{escape(self.where)}</caption>{head}{rows}</table>"

    @property
    def where(self) -> str:
        """The person and the file, in words for a message."""
        return f"person {self.person} of {self.source}"

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """`(15,)`: which joints were detected."""
        return self.score > 0

    def alpha(self, joints: Sequence[int] = LIKELIHOOD_JOINTS) -> FloatArray:
        """`(15,)`: the scores of the seen ones among `joints`, normalised to mean 1; NaN elsewhere.

        The paper's alpha, over its set S_o of observed joints. All NaN where none of `joints` is
        seen."""
        alpha = np.full(NUM_JOINTS, np.nan)
        chosen = [joint for joint in sorted(set(joints)) if self.seen[joint]]
        if chosen:
            alpha[chosen] = self.score[chosen] / self.score[chosen].mean()
        return alpha


def people_said(detections: Sequence[Detection]) -> str:
    """How many people there are, in words: of a film, a person is detected once a frame."""
    count = len(detections)
    images = len({detection.image_id for detection in detections})
    if images > 1:
        return f"{count} detections of people in {images} frames"
    return "1 person" if count == 1 else f"{count} people"


def mapped(
    detection: Detection, elsewhere: Callable[[FloatArray], FloatArray], **changes: Any
) -> Detection:
    """`detection` with keypoints and face where `elsewhere` takes places `(n, 2)` of the image, and
    other `changes` of fields."""
    face = detection.face
    if face is not None:
        face = np.column_stack([elsewhere(face[:, :2]), face[:, 2]])
    return replace(detection, keypoints=elsewhere(detection.keypoints), face=face, **changes)


def pick_person(detections: Sequence[Detection], person: int) -> Detection:
    """The detection numbered `person` in its file; raises `BadInput` that names the numbers there
    are."""
    if not detections:
        raise BadInput("there is no person to pick: the list of detections is empty.")
    for detection in detections:
        if detection.person == person:
            return detection
    numbers = [detection.person for detection in detections]
    last = f"{max(numbers)}" if len(numbers) == 1 else f"{min(numbers)} to {max(numbers)}"
    raise BadInput(
        f"{detections[0].source} has {people_said(detections)}, numbered {last}; person {person} is"
        " not among them, choose one that is."
    )


def _owned(values: npt.ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(f"{name} must be numbers in an array of shape {shape}.") from None
    if array.shape != shape:
        raise BadInput(f"{name} must have the shape {shape}, not {array.shape}.")
    array.setflags(write=False)
    return array


def _check_numbers(
    keypoints: FloatArray, score: FloatArray, names: Sequence[str], where: str
) -> None:
    finite = (np.abs(keypoints) <= LARGEST_NUMBER).all(axis=1)  # false for NaN too
    hidden = np.isnan(keypoints).all(axis=1)
    if ((score >= 0) & (score <= LARGEST_NUMBER) & np.where(score == 0, hidden, finite)).all():
        return
    for name, xy, value in zip(names, keypoints, score, strict=True):
        if not 0 <= value <= LARGEST_NUMBER:  # false for NaN too
            raise BadInput(
                f"the score of {name} in {where} is {value}; it must lie between 0 and"
                f" {LARGEST_NUMBER:g}."
            )
        if value == 0:
            if not np.isnan(xy).all():
                raise BadInput(
                    f"{name} in {where} has score 0, so that its keypoint must be NaN, not"
                    f" {xy.tolist()}."
                )
        elif not (np.abs(xy) <= LARGEST_NUMBER).all():
            raise BadInput(
                f"the keypoint of {name} in {where} is {xy.tolist()} with score {value}; a joint"
                f" that is seen needs finite coordinates within ±{LARGEST_NUMBER:g} pixels."
            )


def _check_labels(
    person: int, image_id: str | None, image_size: tuple[int, int] | None, where: str
) -> None:
    if not _is_whole(person) or person < 0:
        raise BadInput(
            f"the number of a person must be 0 or a positive whole number, not {person!r}."
        )
    if image_id is not None and not is_label(image_id):
        raise BadInput(f"the image_id of {where} must be {_LABEL}, not {shown(image_id)}.")
    if image_size is not None and not (
        isinstance(image_size, tuple)
        and len(image_size) == 2
        and all(_is_whole(n) and n > 0 for n in image_size)
    ):
        raise BadInput(
            f"the image_size of {where} must be two positive whole numbers of pixels, not"
            f" {image_size!r}."
        )


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
