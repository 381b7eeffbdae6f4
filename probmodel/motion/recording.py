"""A recording of motion, whatever file it comes from, and the forward kinematics that its readers
share."""

import dataclasses
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import read_bytes
from poseterior.probmodel.skeleton import PARENTS

INCH = 25.4
CMU_UNIT = INCH / 0.45
"""Millimetres in one unit of the CMU files (`length 0.45` in the ASF; the BVH conversions kept
it)."""
CMU_RATE = 120.0
NPZ_RATE = 30.0
MAX_TURN = 1500.0
"""Degrees a second. A football kick turns the lower leg by some 1,100 in the CMU recordings, a
somersault or a throw a limb by up to 2,500; swapped or lost markers jump at 1,700 to 12,000."""
GUARD = 0.05
"""Seconds before and after a jump that are not trusted."""
MOST_JOINTS, MOST_FRAMES = 2000, 500_000
"""Of a skeleton, and of a recording in a text format: more than an hour at 120 Hz."""
MOST_PLACES = 20_000_000
"""Joints of a skeleton times frames of its recording. Joints that turn need more room than
`LARGEST_TEXT` long before; those that never do need none in the file, but as much time."""
LARGEST_TEXT, MOST_LINES = 200_000_000, 5_000_000
"""Bytes and lines of a text file of motion capture; the longest of the CMU originals has 25 million
and 700,000."""
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
"""A number in the text formats, as a regular expression."""
FROM_SEVENTEEN = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15)
"""Where the fifteen joints are among Akhter & Black's seventeen, which have feet (12 and 16)."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """A recording.

    Attributes
    ----------
    joints : `(T, 15, 3)`
        Millimetres, right-handed axes, float64.
    frame_rate
        Hz.
    name
        Of the recording.
    subject
        Equal for recordings of the same skeleton.
    """

    joints: np.ndarray
    frame_rate: float
    name: str
    subject: str

    def at_rate(self, rate: float) -> "Motion":
        """Every k-th frame, k being the nearest to `frame_rate / rate` and at least 1; frames are
        never made up."""
        step = max(1, round(self.frame_rate / rate))
        return dataclasses.replace(
            self, joints=self.joints[::step], frame_rate=self.frame_rate / step
        )

    def without_jumps(self, max_turn: float = MAX_TURN) -> "Motion":
        """Without the frames at a jump, where a bone (from joint to parent) turns faster than
        `max_turn` degrees a second all of a sudden (`_sudden`), or more than twice as fast. The
        frames within `GUARD` seconds of it go: a T-pose before the first frame, a marker lost for a
        moment."""
        bones = self.joints[:, 1:] - self.joints[:, list(PARENTS[1:])]
        bones = bones / np.maximum(
            np.linalg.norm(bones, axis=-1, keepdims=True), np.finfo(float).tiny
        )
        steps = np.diff(bones, axis=0)
        turn = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(steps, axis=-1) / 2, 0, 1)))
        speed = turn * self.frame_rate
        jumping = (speed > max_turn) & (_sudden(steps) | (speed > 2 * max_turn))
        jumps = np.flatnonzero(jumping.any(axis=-1)) + 1
        guard = max(1, round(GUARD * self.frame_rate))
        keep = np.ones(len(self.joints), bool)
        for jump in jumps:
            keep[max(0, jump - guard) : jump + guard] = False
        return dataclasses.replace(self, joints=self.joints[keep])


def _sudden(steps: np.ndarray) -> np.ndarray:
    """Which steps `(T − 1, B, 3)` of bones' directions are jumps, `(T − 1, B)`: a step before or
    after it is less than half as long, or goes another way. Somebody who turns a somersault is as
    fast for some frames on end, in one sense; a marker that is lost for a moment jumps and comes
    back, and a T-pose before the first frame is followed by a person who moves as usual."""
    steps = np.concatenate([steps[1:2], steps, steps[-2:-1]])  # at the ends there is one neighbour
    if len(steps) < 3:
        return np.ones(steps.shape[:-1], bool)
    along = np.sum(steps[1:] * steps[:-1], axis=-1)
    square = np.sum(steps[1:-1] ** 2, axis=-1)
    return np.minimum(along[1:], along[:-1]) < 0.5 * square


def read_text(path: Path) -> str:
    """A text file, whatever its bytes. Raises `BadInput` where it cannot be read, or is too
    long."""
    data = read_bytes(path, "motion capture", "check the path", largest=LARGEST_TEXT)
    if data.count(b"\n") > MOST_LINES:
        raise BadInput(f"{path} has more than {MOST_LINES:,} lines; split it into smaller files")
    return data.decode("utf-8-sig", errors="replace")


def require_frames(count: int, joints: int, path: Path) -> None:
    """Raises `BadInput` where a recording has more frames than can be, for so many joints."""
    if count > MOST_FRAMES:
        raise BadInput(f"{path} has more than {MOST_FRAMES:,} frames; split it into smaller files")
    if count * joints > MOST_PLACES:
        raise BadInput(
            f"{path} has {count:,} frames of {joints:,} joints, more than {MOST_PLACES:,} places;"
            " split it into smaller files"
        )


class Rig(NamedTuple):
    """Segments, parents first. A segment starts where its parent ends, turned by its own
    rotation."""

    names: list[str]
    parents: list[int]
    offsets: Sequence[np.ndarray] | np.ndarray
    """`(S, 3)`: from a segment's start to its end, in the segment's own axes; or one by one, `(3,)`
    or, where it changes in time, `(T, 3)`."""


def forward(
    rig: Rig, wanted: Iterable[int], root: np.ndarray, rotations: Sequence[Rotation | None]
) -> np.ndarray:
    """Ends `(T, len(wanted), 3)` of segments, given root positions `(T, 3)` and each segment's
    local rotation (None: not turned). Segments that `wanted` does not need are skipped."""
    wanted = list(wanted)
    needed = set(wanted)
    for segment in reversed(range(len(rig.names))):
        if segment in needed and rig.parents[segment] >= 0:
            needed.add(rig.parents[segment])
    last_child = {rig.parents[segment]: segment for segment in sorted(needed)}
    ends: dict[int, np.ndarray] = {}
    turns: dict[int, Rotation] = {}
    for segment in sorted(needed):
        parent, local = rig.parents[segment], rotations[segment]
        if parent < 0:
            turns[segment] = local if local is not None else Rotation.identity(len(root))
        else:
            turns[segment] = turns[parent] if local is None else turns[parent] * local
        ends[segment] = (root if parent < 0 else ends[parent]) + turns[segment].apply(
            rig.offsets[segment]
        )
        if parent >= 0 and last_child[parent] == segment:  # a chain's ends would fill the memory
            del turns[parent]
            if parent not in wanted:
                del ends[parent]
    return np.stack([ends[segment] for segment in wanted], axis=1)


def floats(text: str) -> np.ndarray | None:
    """All numbers of a text, or None where a token is not one."""
    blocks = re.findall(r"[\s\S]{1,1000000}\S*", text)  # the texts of all numbers fill the memory
    try:
        return np.concatenate([[], *(np.array(block.split(), np.float64) for block in blocks)])
    except ValueError:
        return None


def require_depth(joints: np.ndarray, path: Path) -> None:
    """Raises `BadInput` where all joints of poses `(..., 15, 3)` have one coordinate in common, but
    not all of them: what a single camera saw. (A rig's pose of rest may lie in a plane.)"""
    flat = (joints == joints[..., :1, :]).reshape(-1, 3).all(axis=0)
    if flat.any() and not flat.all():
        raise BadInput(
            f"{path}: all joints lie in one plane (one coordinate is the same for all), as those of"
            " a single camera do; give poses in space"
        )


def positions(joints: np.ndarray, path: Path) -> np.ndarray:
    """Joints of a recording as they are. Raises `BadInput` where one is not finite, or so far away
    that its square loses its meaning."""
    if not (np.abs(joints) <= LARGEST_NUMBER).all():  # false for NaN too
        raise BadInput(
            f"{path}: a joint lies at no place that can be (its coordinates are not finite, or"
            f" beyond ±{LARGEST_NUMBER:g} mm); check offsets, lengths and channels"
        )
    return joints
