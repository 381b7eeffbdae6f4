"""A data set: true 3D poses, a 2D detection of each, and who does what in them; and one case of it.

Poses are in millimetres and camera axes (x right, y down, z away from the camera), the pelvis at
the origin; a weak-perspective camera of known scale and place took them: pixels = scale · (x, y) +
translation, but for the detector's errors; or one whose lens is known, with that scale where the
pelvis is. A data set has its source's thorax and pelvis, its cases have the skeleton's. Everything
random about a case comes out of the seed and the number of the case alone."""

import dataclasses
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from poseterior.probmodel.body import body_unit
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.detections import LARGEST_NUMBER, Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.layouts import MIDPOINTS, corrected, weights_of, without_midpoints
from poseterior.probmodel.rows import evenly, shares
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS, NUM_JOINTS, PARENTS

_TALL = (
    ("thorax", "head"),
    ("pelvis", "thorax"),
    ("right_hip", "right_knee"),
    ("right_knee", "right_ankle"),
)
SMALLEST, TALLEST = 500.0, 2500.0
"""Millimetres between which the height of a person lies: others are poses in metres, inches,
pixels."""


def body_height(poses: np.ndarray) -> np.ndarray:
    """`(...)`: heights of poses `(..., 15, 3)` however they bend: lengths of head, back-bone, upper
    and lower leg, and a tenth for feet and hips; in the units of the poses."""
    start, end = (np.array([JOINT_INDEX[bone[side]] for bone in _TALL]) for side in (0, 1))
    return 1.1 * np.linalg.norm(poses[..., end, :] - poses[..., start, :], axis=-1).sum(axis=-1)


@dataclass(frozen=True, eq=False)
class Case:
    """One pose `(15, 3)` (mm, camera axes, pelvis at the origin), its `detection`, the true
    camera's `scale` (pixels a mm, where the pelvis is) and `translation` `(2,)` (pixels, of the
    pelvis), its `lens` if it is known, and the `number` of the case, from which its randomness
    comes; `doubt` `(15, 15, 3, 3)`, the covariances of the truth's own errors (mm²) by two joints,
    where it has some."""

    number: int
    pose: np.ndarray
    detection: Detection
    scale: float
    translation: np.ndarray
    action: str
    subject: str
    recording: str
    lens: Lens | None = None
    doubt: np.ndarray | None = None

    def image(self, poses: np.ndarray) -> np.ndarray:
        """`(..., 15, 2)` pixels in which the true camera would see poses `(..., 15, 3)`, mm and
        camera axes, whose pelvis is where that of the truth is."""
        flat = self.translation + self.scale * poses[..., :2]
        if self.lens is None:
            return flat
        principal = np.asarray(self.lens.principal)
        return principal + (flat - principal) * self.magnification(poses)[..., None]

    def magnification(self, poses: np.ndarray) -> np.ndarray:
        """`(..., 15)`: how much larger than at the pelvis things appear where the joints of poses
        `(..., 15, 3)` are; 1 under weak perspective."""
        focal = np.inf if self.lens is None else float(self.lens.focal)
        return 1 / (1 + poses[..., 2] * (self.scale / focal))

    @property
    def pixels(self) -> np.ndarray:
        """`(15, 3)`: x and y are where the pose's joints truly are in the image; z is their depth
        in pixels, camera axes."""
        return np.column_stack([self.image(self.pose), self.scale * self.pose[:, 2]])

    @property
    def unit(self) -> float:
        """Millimetres of one body unit, this person's mean limb length."""
        return float(body_unit(self.pose[None]))

    def corrected(self, midpoints: tuple[str, ...]) -> "Case":
        """With those of thorax and pelvis that are `midpoints` where the skeleton has them, in pose
        and detection (`probmodel.layouts`)."""
        if not midpoints:
            return self
        pose = without_midpoints(self.pose, midpoints)
        return dataclasses.replace(
            self,
            pose=pose - pose[0],
            detection=corrected(self.detection, midpoints),
            scale=float(self.scale * self.magnification(pose)[0]),
            translation=self.image(pose)[0],
        )

    def strays(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, 15, 3)` mm: errors that the truth may have, the pelvis at the origin; 0 where
        it has none. Draws that are given such errors differ from the truth as it is known by no
        more than they should."""
        return strays(self.doubt, rng, number)

    def hiding(self, missing: int, seed: int = 0) -> "Case":
        """With `missing` of the eight limb joints gone from the detection, chosen at random; when
        more are asked for, the same ones are gone, and others besides. Raises `BadInput` where
        there are not so many."""
        if not 0 <= missing <= len(LIMB_JOINTS):
            raise BadInput(f"{missing} limb joints cannot be missing; there are {len(LIMB_JOINTS)}")
        gone = np.random.default_rng([seed, 1, self.number]).permutation(LIMB_JOINTS)[:missing]
        keypoints, score = self.detection.keypoints.copy(), self.detection.score.copy()
        keypoints[gone], score[gone] = np.nan, 0.0
        return dataclasses.replace(
            self, detection=dataclasses.replace(self.detection, keypoints=keypoints, score=score)
        )

    def turned(self, degrees: float) -> "Case":
        """With the camera rolled: pose and detection turned in the image plane, about the mean of
        the joints."""
        turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
        centre = self.pixels[:, :2].mean(axis=0)

        def about(places: ArrayLike) -> np.ndarray:
            return (np.asarray(places) - centre) @ turn[:2, :2].T + centre

        lens = self.lens and self.lens._replace(principal=about(self.lens.principal))
        keypoints = about(self.detection.keypoints)
        return dataclasses.replace(
            self,
            pose=self.pose @ turn.T,
            doubt=None if self.doubt is None else turn @ self.doubt @ turn.T,
            translation=about(self.translation),
            detection=dataclasses.replace(self.detection, keypoints=keypoints),
            lens=lens,
        )


COLUMNS = {
    "poses": (NUM_JOINTS, 3),
    "keypoints": (NUM_JOINTS, 2),
    "score": (NUM_JOINTS,),
    "scale": (),
    "translation": (2,),
    "action": (),
    "subject": (),
    "recording": (),
}
"""The fields of every `DataSet` that have a row for each case, and the shapes of their rows."""


def skeletal(doubt: np.ndarray, midpoints: tuple[str, ...]) -> np.ndarray:
    """`(15, 15, 3, 3)`: covariances of the errors of the skeleton's joints, by two of them, from
    those of a source's joints `(15, 3, 3)`, each independent of the others but for `midpoints`."""
    weights = weights_of(midpoints)
    return np.einsum("ja,ka,axy->jkxy", weights, weights, doubt)


def strays(doubt: np.ndarray | None, rng: np.random.Generator, number: int) -> np.ndarray:
    """`(number, 15, 3)`: normal errors of covariances `(15, 15, 3, 3)` by two joints, less that of
    the pelvis; 0, and nothing is drawn, where there are none."""
    if doubt is None:
        return np.zeros((number, NUM_JOINTS, 3))
    flat = np.swapaxes(doubt, 1, 2).reshape(3 * NUM_JOINTS, -1)
    size, axes = np.linalg.eigh(flat)
    normal = rng.normal(size=(number, len(flat))) * np.sqrt(np.maximum(size, 0.0))
    errors = (normal @ axes.T).reshape(number, NUM_JOINTS, 3)
    return errors - errors[:, :1]


@dataclass(frozen=True, eq=False)
class DataSet:
    """Cases whose truth is known, as arrays, with the joints that their source has.

    Frames of one recording are alike: intervals are to be drawn over recordings.

    Attributes
    ----------
    name
        What it is called in results.
    poses : `(N, 15, 3)`
        Millimetres, camera axes.
    keypoints : `(N, 15, 2)`
        Pixels, NaN where missing.
    score : `(N, 15)`
        0 where missing.
    scale : `(N,)`
        Pixels a millimetre, where the pelvis is.
    translation : `(N, 2)`
        Where the pelvis falls in the image, pixels.
    action, subject, recording : `(N,)` texts
        What was done, by whom, and in which recording.
    lens
        The lenses of the cameras, arrays `(N,)` and `(N, 2)`, where they are known.
    midpoints
        Which of thorax and pelvis are midpoints of shoulders and hips, in poses and keypoints; the
        cases have the skeleton's in their place, since a definition is no error.
    doubt : `(N, 15, 3, 3)`
        Covariances of the poses' own errors, mm², those of one joint independent of another's,
        where they have some: draws are given such errors before a truth is ranked among them.

    Raises
    ------
    BadInput
        On other shapes, on poses that are not finite or not in millimetres, on frames without
        action, on midpoints of other names, and on covariances that are none.
    """

    name: str
    poses: np.ndarray
    keypoints: np.ndarray
    score: np.ndarray
    scale: np.ndarray
    translation: np.ndarray
    action: np.ndarray
    subject: np.ndarray
    recording: np.ndarray
    lens: Lens | None = None
    midpoints: tuple[str, ...] = ()
    doubt: np.ndarray | None = None

    def __post_init__(self) -> None:
        number = len(self.poses)
        for field, shape in self._columns().items():
            found = np.shape(getattr(self, field))
            if found != (number, *shape):
                raise BadInput(
                    f"{self.name}: {field} has shape {found}, which must be {(number, *shape)}"
                )
        if not number:
            raise BadInput(f"{self.name} has no frames")
        if sorted(self.midpoints) != sorted(set(self.midpoints) & set(MIDPOINTS)):
            raise BadInput(
                f"{self.name}: the midpoints are {shown(' '.join(self.midpoints))}; name"
                f" {' and '.join(MIDPOINTS)}, or one of them, or none"
            )
        self._check_poses()
        self._check_doubt()
        for frame in np.flatnonzero(np.char.str_len(np.char.strip(self.action)) == 0):
            raise BadInput(
                f"{self.name}: frame {frame} has no action; name what is done in every frame"
            )

    def _check_poses(self) -> None:
        finite = (np.abs(self.poses) <= LARGEST_NUMBER).all(axis=(1, 2))  # false for NaN too
        for frame in np.flatnonzero(~finite):
            raise BadInput(
                f"{self.name}: frame {frame} has a coordinate that is not finite; leave that"
                " frame out"
            )
        for who in np.unique(self.subject):
            height = float(np.median(body_height(self.poses[self.subject == who])))
            if not SMALLEST <= height <= TALLEST:
                raise BadInput(
                    f"{self.name}: subject {shown(str(who))} would be {_metres(height)} m tall;"
                    " poses must be in millimetres, so multiply them by what makes them so"
                )
        bones = np.linalg.norm(self.poses[:, 1:] - self.poses[:, PARENTS[1:]], axis=-1)
        for frame in np.flatnonzero(~(bones > 0).all(axis=1)):
            raise BadInput(
                f"{self.name}: frame {frame} has a bone of length zero; leave that frame out"
            )

    def _check_doubt(self) -> None:
        if self.doubt is None:
            return
        own = np.where(np.abs(self.doubt) <= LARGEST_NUMBER, self.doubt, -1.0)
        even = np.isclose(own, np.swapaxes(own, -1, -2), rtol=1e-6).all(axis=(1, 2, 3))
        least = np.linalg.eigvalsh(own)[..., 0] >= -1e-6 * np.abs(own).max(axis=(2, 3))
        for frame in np.flatnonzero(~(even & least.all(axis=1))):
            raise BadInput(
                f"{self.name}: the doubt of frame {frame} is no covariance of errors; give"
                " symmetric matrices without negative eigenvalues, mm²"
            )

    def _columns(self) -> dict[str, tuple[int, ...]]:
        """Those that are there."""
        return COLUMNS if self.doubt is None else COLUMNS | {"doubt": (NUM_JOINTS, 3, 3)}

    def __len__(self) -> int:
        return len(self.poses)

    def case(self, row: int, number: int | None = None) -> Case:
        """One of the cases, in the skeleton's joints.

        Parameters
        ----------
        row
            Which.
        number
            Its number where these are some of a larger set's cases; by default the row.

        Returns
        -------
        Case
            With its detection.

        Raises
        ------
        BadInput
            Where its detection is not one (a score below zero, …).
        """
        number = row if number is None else number
        detection = Detection(
            self.keypoints[row], self.score[row], "skeleton_15", f"frame {number} of {self.name}", 0
        )
        case = Case(
            number=number,
            pose=self.poses[row],
            detection=detection,
            scale=float(self.scale[row]),
            translation=self.translation[row],
            action=str(self.action[row]),
            subject=str(self.subject[row]),
            recording=str(self.recording[row]),
            lens=self._lens(row),
            doubt=None if self.doubt is None else skeletal(self.doubt[row], self.midpoints),
        )
        return case.corrected(self.midpoints)

    def corrected(self, poses: np.ndarray) -> np.ndarray:
        """Poses `(..., 15, 3)` with this set's joints, of its truth or of a prediction for it, as
        the cases have them: the skeleton's thorax and pelvis, the pelvis at the origin."""
        placed = without_midpoints(poses, self.midpoints)
        return placed - placed[..., :1, :]

    def __iter__(self) -> Iterator[Case]:
        return (self.case(number) for number in range(len(self)))

    @property
    def actions(self) -> list[str]:
        """The classes of action, sorted."""
        return sorted(set(self.action.tolist()))

    def take(self, rows: np.ndarray) -> "DataSet":
        """Some of the cases, numbered anew."""
        columns = {name: getattr(self, name)[rows] for name in self._columns()}
        return dataclasses.replace(self, **columns, lens=self._lens(rows))

    def _lens(self, rows: int | np.ndarray) -> Lens | None:
        return self.lens and Lens(*(np.asarray(column)[rows] for column in self.lens))

    def spread(self, frames: int) -> "DataSet":
        """`frames` cases, as many of each action as of any other while there are that many, evenly
        over its frames."""
        chosen = []
        for action, share in zip(self.actions, shares(frames, len(self.actions)), strict=True):
            rows = np.flatnonzero(self.action == action)
            chosen.append(rows[evenly(len(rows), share)])
        return self.take(np.sort(np.concatenate(chosen)))

    @cached_property
    def sha256(self) -> str:
        """Hash of the contents: the same cases have the same, wherever they were read from."""
        digest = hashlib.sha256()
        columns = {name: getattr(self, name) for name in self._columns()}
        columns |= self.lens._asdict() if self.lens else {}
        columns |= {"midpoints": np.array(self.midpoints)} if self.midpoints else {}
        for name, column in columns.items():
            value = (
                column.astype("<f8")
                if column.dtype.kind == "f"
                else np.array("\n".join(column.tolist()).encode())
            )
            digest.update(
                name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes()
            )
        return digest.hexdigest()


def _metres(height: float) -> str:
    return f"{height / 1000:,.0f}" if height > 10_000 else f"{height / 1000:.2g}"
