"""Joint orders: what each detector calls its points, and how they become the skeleton's joints and
the face.

`LAYOUTS` is the table, by name. A point that is a joint of the skeleton, or of the face, bears that
name; the others are not used. Where a layout has no thorax or pelvis, or defines them as midpoints,
they are the midpoints of shoulders and hips; `corrected` moves them to where the skeleton has them,
as every command that reads detections does. Offsets and their sources: reports/detectors.md."""

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from poseterior.probmodel.detections import FACE, Detection, FloatArray
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS

MIDPOINTS = {"thorax": ("right_shoulder", "left_shoulder"), "pelvis": ("right_hip", "left_hip")}
"""Joints that lie midway between two others, for the detectors that do not have them or missed
them."""

TOWARDS_THE_OTHER = {"thorax": 0.124, "pelvis": 0.194}
"""How far along the line from one midpoint to the other the skeleton's own joint lies: the mean
over the embedded torsos, projected onto that line (a test derives them again). The thorax lies
below the shoulders' midpoint and the pelvis above the hips'; under weak perspective a share of a
line stays the same share in every view."""

BEHIND = {"thorax": -0.005, "pelvis": 0.077}
"""How far behind that line the joint lies, in the line's lengths: what an image does not tell, but
a pose in space does. The same mean."""

STRAY = {"thorax": 0.034, "pelvis": 0.079}
"""How far from there they lie, body units: the standard deviation along any one axis over the
embedded torsos, seen from all sides (the same test). The pelvis lies behind the line."""

_MIDDLE_ROWS = tuple(
    (JOINT_INDEX[middle], JOINT_INDEX[right], JOINT_INDEX[left])
    for middle, (right, left) in MIDPOINTS.items()
)


@dataclass(frozen=True)
class Layout:
    """A detector's joint order: the name of each point, in the order of the file.

    `midpoints` names those of thorax and pelvis that the layout lacks, or has but defines as
    midpoints of shoulders and hips."""

    name: str
    points: tuple[str, ...]
    midpoints: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """How many points a person has."""
        return len(self.points)

    @cached_property
    def _body(self) -> tuple[list[int], list[int]]:
        """Which points are joints, and which joints they are."""
        return self._places_of(JOINTS)

    @cached_property
    def _face(self) -> tuple[list[int], list[int]]:
        return self._places_of(FACE)

    def _places_of(self, known: Sequence[str]) -> tuple[list[int], list[int]]:
        places = [place for place, name in enumerate(self.points) if name in known]
        return places, [known.index(self.points[place]) for place in places]

    def to_skeleton(self, points: FloatArray, threshold: float) -> tuple[FloatArray, FloatArray]:
        """`(15, 2)` keypoints and `(15,)` scores from `(count, 3)` rows of x, y, score.

        Points with score <= `threshold` are missing. A thorax or pelvis that is missing, or not
        part of the layout, is the midpoint of shoulders or hips where both are seen, with the
        smaller of their scores."""
        indices, joints = self._body
        rows = np.zeros((NUM_JOINTS, 3))
        rows[joints] = points[indices]
        seen = rows[:, 2] > threshold
        for middle, right, left in _MIDDLE_ROWS:
            if not seen[middle] and seen[right] and seen[left]:
                rows[middle, :2] = (rows[right, :2] + rows[left, :2]) / 2
                rows[middle, 2] = min(rows[right, 2], rows[left, 2])
                seen[middle] = True
        rows[~seen] = np.nan, np.nan, 0.0
        return rows[:, :2], rows[:, 2]

    def face(self, points: FloatArray, threshold: float) -> FloatArray | None:
        """`(5, 3)` x, y, score of `FACE`, NaN, NaN, 0 where missing; None where the layout has no
        nose, or no eyes and ears, and so says nothing about which way the head is turned."""
        indices, rows = self._face
        if not self.has_face:
            return None
        face = np.full((len(FACE), 3), [np.nan, np.nan, 0.0])
        face[rows] = points[indices]
        face[~(face[:, 2] > threshold)] = np.nan, np.nan, 0.0
        return face

    @cached_property
    def has_face(self) -> bool:
        """Whether there is a nose, and an eye or an ear on either side."""
        names = set(self.points)
        return "nose" in names and any(
            {f"left_{part}", f"right_{part}"} <= names for part in ("eye", "ear")
        )

    def detection(
        self,
        points: FloatArray,
        threshold: float,
        source: str,
        person: int,
        image_id: str | None = None,
        image_size: tuple[int, int] | None = None,
        track: str | None = None,
    ) -> Detection:
        """One person from `(count, 3)` rows of x, y, score; points at one of `NOWHERE` are
        missing, whatever their score."""
        points = np.where(is_nowhere(points[:, :2])[:, None], 0.0, points)
        keypoints, score = self.to_skeleton(points, threshold)
        return Detection(
            keypoints=keypoints,
            score=score,
            layout=self.name,
            source=source,
            person=person,
            image_id=image_id,
            image_size=image_size,
            face=self.face(points, threshold),
            midpoints=self.midpoints,
            track=track,
        )


NOWHERE = (0.0, -1.0)
"""Where detectors and annotators put both coordinates of a point that they did not find."""


def is_nowhere(xy: FloatArray) -> npt.NDArray[np.bool_]:
    """`(...)`: which of points `(..., 2)` mean that there is none."""
    return np.any([(xy == place).all(axis=-1) for place in NOWHERE], axis=0)


def _in_pairs(*parts: str) -> tuple[str, ...]:
    """The points of both sides, part after part, the left one first."""
    return tuple(f"{side}_{part}" for part in parts for side in ("left", "right"))


_RIGHT_ARM = ("right_shoulder", "right_elbow", "right_wrist")
_LEFT_ARM = ("left_shoulder", "left_elbow", "left_wrist")
_RIGHT_LEG = ("right_hip", "right_knee", "right_ankle")
_LEFT_LEG = ("left_hip", "left_knee", "left_ankle")
_ARMS_AND_LEGS = (*_RIGHT_ARM, *_LEFT_ARM, *_RIGHT_LEG, *_LEFT_LEG)
_IN_PAIRS = _in_pairs("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_COCO = ("nose", *_in_pairs("eye", "ear"), *_IN_PAIRS)
_BOTH = ("thorax", "pelvis")
_FEET = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("big_toe", "small_toe", "heel")
)
_HALPE = (*_COCO, "head", "neck", "hip_centre", *_in_pairs("big_toe", "small_toe", "heel"))
_OPENPOSE_FACE = ("right_eye", "left_eye", "right_ear", "left_ear")
_MEDIAPIPE = (
    *("nose", "left_eye_inner", "left_eye", "left_eye_outer"),
    *("right_eye_inner", "right_eye", "right_eye_outer"),
    *("left_ear", "right_ear", "mouth_left", "mouth_right"),
    *_in_pairs("shoulder", "elbow", "wrist", "pinky", "index", "thumb"),
    *_in_pairs("hip", "knee", "ankle", "heel", "foot_index"),
)
_BODY_25 = ("nose", "thorax", *_RIGHT_ARM, *_LEFT_ARM, "pelvis", *_RIGHT_LEG, *_LEFT_LEG)
_MPII_TRUNK = ("pelvis", "thorax", "upper_neck", "head")
_H36M_TRUNK = ("spine", "thorax", "neck_or_nose", "head")

COCO_17 = Layout("coco_17", _COCO, _BOTH)
BODY_25 = Layout("body_25", (*_BODY_25, *_OPENPOSE_FACE, *_FEET), _BOTH)
BODY_25B = Layout("body_25b", (*_COCO, "upper_neck", "head", *_FEET), _BOTH)
COCO_18 = Layout("coco_18", ("nose", "thorax", *_ARMS_AND_LEGS, *_OPENPOSE_FACE), _BOTH)
HALPE_26 = Layout("halpe_26", _HALPE, _BOTH)
HALPE_136 = Layout("halpe_136", (*_HALPE, *(f"face_or_hand_{i}" for i in range(110))), _BOTH)
WHOLEBODY_133 = Layout(
    "coco_wholebody_133", (*_COCO, *(f"foot_face_or_hand_{i}" for i in range(116))), _BOTH
)
MPII_16 = Layout(
    "mpii_16",
    (*_RIGHT_LEG[::-1], *_LEFT_LEG, *_MPII_TRUNK, *_RIGHT_ARM[::-1], *_LEFT_ARM),
    _BOTH,
)
H36M_17 = Layout(
    "h36m_17",
    ("pelvis", *_RIGHT_LEG, *_LEFT_LEG, *_H36M_TRUNK, *_LEFT_ARM, *_RIGHT_ARM),
    ("pelvis",),
)
MEDIAPIPE_33 = Layout("mediapipe_33", _MEDIAPIPE, _BOTH)
CROWDPOSE_14 = Layout("crowdpose_14", (*_IN_PAIRS, "head", "neck"), _BOTH)
AIC_14 = Layout("aic_14", (*_ARMS_AND_LEGS, "head", "neck"), _BOTH)

_ALL = (
    *(COCO_17, COCO_18, BODY_25, BODY_25B, HALPE_26, HALPE_136),
    *(WHOLEBODY_133, MPII_16, H36M_17, MEDIAPIPE_33, CROWDPOSE_14, AIC_14),
)
LAYOUTS = MappingProxyType({layout.name: layout for layout in _ALL})
"""By name."""


def corrected(detection: Detection, midpoints: tuple[str, ...] | None = None) -> Detection:
    """`detection` with the thorax and pelvis where the skeleton has them, if they are midpoints.

    A midpoint whose counterpart is not seen cannot be moved and stays; what has been moved
    (`Detection.moved`) is not moved again. Shares: `TOWARDS_THE_OTHER`.

    Parameters
    ----------
    detection
        Of anyone.
    midpoints
        Which of the two are; by default those that `midpoints_of` finds.

    Returns
    -------
    Detection
        The same, or a new one whose `moved` names what was moved.
    """
    midpoints = midpoints_of(detection) if midpoints is None else midpoints
    if detection.moved or not np.isfinite(_line(detection.keypoints, midpoints)).all():
        return detection
    keypoints = without_midpoints(detection.keypoints, midpoints)
    return dataclasses.replace(detection, keypoints=keypoints, moved=midpoints)


def midpoints_of(detection: Detection) -> tuple[str, ...]:
    """Which of thorax and pelvis are midpoints: where the layout says so, and where they lie
    exactly midway because they were missed."""
    halfway = _halfway(detection.keypoints)
    return tuple(
        name
        for name in MIDPOINTS
        if name in detection.midpoints
        or _same(detection.keypoints[JOINT_INDEX[name]], halfway[name])
    )


def without_midpoints(joints: np.ndarray, midpoints: Collection[str]) -> np.ndarray:
    """Joints `(..., 15, 2)` of an image, or `(..., 15, 3)` in a right-handed space, with those of
    thorax and pelvis that are `midpoints` moved to where the skeleton has them: along the line
    between both (`TOWARDS_THE_OTHER`), and in space behind it (`BEHIND`)."""
    line, moved = _line(joints, midpoints), np.array(joints)
    back = _backwards(joints, line) if joints.shape[-1] == len("xyz") else np.zeros_like(line)
    for name in midpoints:
        way = line if name == "thorax" else -line
        moved[..., JOINT_INDEX[name], :] += TOWARDS_THE_OTHER[name] * way + BEHIND[name] * back
    return moved


def weights_of(midpoints: Collection[str]) -> np.ndarray:
    """`(15, 15)`: by how much each joint moves what `without_midpoints` makes of shoulders, hips
    and the other joints, along the line between the midpoints."""
    halfway, weights = np.eye(NUM_JOINTS), np.eye(NUM_JOINTS)
    for middle, *ends in _MIDDLE_ROWS:
        halfway[middle] = weights[ends].mean(axis=0)
    for name in midpoints:
        row, (other,) = JOINT_INDEX[name], (each for each in MIDPOINTS if each != name)
        share = TOWARDS_THE_OTHER[name]
        weights[row] = (1 - share) * halfway[row] + share * halfway[JOINT_INDEX[other]]
    return weights


def _halfway(joints: np.ndarray) -> dict[str, np.ndarray]:
    return {
        name: np.mean([joints[..., JOINT_INDEX[side], :] for side in sides], axis=0)
        for name, sides in MIDPOINTS.items()
    }


def _line(joints: np.ndarray, midpoints: Collection[str]) -> np.ndarray:
    """From the shoulders' midpoint to the hips', by thorax and pelvis where these are `midpoints`
    of their own."""
    middle = _halfway(joints) | {name: joints[..., JOINT_INDEX[name], :] for name in midpoints}
    return middle["pelvis"] - middle["thorax"]


def _backwards(joints: np.ndarray, line: np.ndarray) -> np.ndarray:
    """`(..., 3)`: to the person's back, as long as the line."""
    across = sum(
        joints[..., JOINT_INDEX[left], :] - joints[..., JOINT_INDEX[right], :]
        for right, left in MIDPOINTS.values()
    )
    back = np.cross(across, line)
    size, length = (np.linalg.norm(way, axis=-1, keepdims=True) for way in (line, back))
    return back * (size / np.where(length > 0, length, 1.0))  # a flat body has no back


def _same(point: FloatArray, other: FloatArray) -> bool:
    return bool(np.allclose(point, other, rtol=1e-9, atol=0.0))


_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_SIDED_PARTS = {"shoulder", "elbow", "wrist", "hip", "knee", "ankle", "eye", "ear"}
_WHOLE = {
    **dict.fromkeys(("pelvis", "hip_centre", "hip_center", "mid_hip", "root"), "pelvis"),
    **dict.fromkeys(("thorax", "chest"), "thorax"),
    **dict.fromkeys(("head", "head_top", "top_head"), "head"),
    "nose": "nose",
}


def spoken_name(name: str) -> str:
    """The skeleton's (or face's) name of a body part as people write it, or the name as it is where
    it is no such part.

    LeftShoulder, left-shoulder, shoulder_l and l_shoulder are all left_shoulder. Numbered names
    (hip1) are not guessed."""
    words = _words(name)
    if whole := _WHOLE.get("_".join(words)):
        return whole
    side, part = _sided(words)
    return f"{side}_{part}" if side and part in _SIDED_PARTS else name


def _sided(words: list[str]) -> tuple[str, str]:
    """The side and the part of a name of two words; empty where it has no side."""
    sides = [_SIDES[word] for word in words if word in _SIDES]
    parts = [word for word in words if word not in _SIDES]
    return (sides[0], parts[0]) if len(sides) == len(parts) == 1 else ("", "")


def _words(name: str) -> list[str]:
    """Lower-case words of a name in camel, snake or kebab case; MidHip, mid_hip and "mid hip" are
    the same."""
    spaced = "".join(
        f" {letter}" if letter.isupper() and not name.isupper() else letter for letter in name
    )
    return "".join(letter if letter.isalnum() else " " for letter in spaced).lower().split()


def layout_of_names(names: list[str], mapping: "dict[str, str] | None" = None) -> Layout:
    """A layout of freely named points: `mapping` (their name → ours) first, then `spoken_name`.

    Feet are ankles where no ankle, toe or heel has a name, as in Human3.6M's names. A pelvis that
    detectors name is the hips' midpoint, and a thorax is the shoulders' beside MPII's upper neck;
    names that are a known layout's are as in that."""
    mapping = mapping or {}
    points = tuple(mapping[name] if name in mapping else spoken_name(name) for name in names)
    if not any({"ankle", "toe", "heel"} & set(_words(point)) for point in points):
        points = tuple(_ankle_of(point) for point in points)
    known = [layout.midpoints for layout in LAYOUTS.values() if set(layout.points) == set(points)]
    if known:
        return Layout("named", points, known[0])
    own = "thorax" in points and not any("".join(_words(name)) == "upperneck" for name in names)
    return Layout("named", points, ("pelvis",) if own else _BOTH)


def _ankle_of(foot: str) -> str:
    side, part = _sided(_words(foot))
    return f"{side}_ankle" if part == "foot" else foot
