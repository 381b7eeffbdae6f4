"""A session: what several calibrated, synchronised cameras detected of one person.

Pose2Sim's layout, and EasyMocap's: a calibration in the folder or in `calibration/`, and a folder
of detections for each camera in it, in `pose/` or in `openpose/`, which sorted by name are the
calibration's cameras in its order. Frames are matched by the last number in their names.

    session = read_session("S01/")
    session.world.points         joints (frames, 15, 3), mm
    session.without(0).points    the same from the other cameras, to judge the first
"""

import dataclasses
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from poseterior.probmodel.body import bone_lengths
from poseterior.probmodel.detections import Detection
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.formats.frames import (
    DetectedFrame,
    natural_order,
    read_frames,
    sorted_files,
)
from poseterior.probmodel.layouts import MIDPOINTS, midpoints_of
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.sessions.calibrations import is_calibration, read_cameras
from poseterior.probmodel.sessions.pinhole import Pinhole
from poseterior.probmodel.sessions.triangulation import Triangulated, residuals, triangulate
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, NUM_JOINTS

if TYPE_CHECKING:
    from poseterior.probmodel.instant import Instant

HIPS = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
FIRST_SCALE = 0.4
"""Pixels a mm, until it is known where the person is."""
BEYOND = 0.25
"""Body units: views whose median residual is larger are not of one person, or not calibrated."""
ASSUMED_POINTING, ASSUMED_FREEDOM = 0.3, 2.0
"""Degrees by which a camera points beside its calibration, and as how many numbers that counts."""
SHORTEST_UNIT, LONGEST_UNIT = 100.0, 800.0
"""Millimetres between which a person's mean limb bone is long: those of grown people have 345."""
MOST_COMBINATIONS = 256
"""Of the people in a frame's views that are tried."""
VIEW_PLACES = ("pose", "openpose")
"""Where Pose2Sim and EasyMocap have folders of detections."""
_LIMBS = [row for row, bone in enumerate(BONES) if bone.name != "head"]
_ADVICE = (
    "give a folder with a calibration (.qca.txt, .toml, or intri.yml and extri.yml) and a folder of"
    " detections for each camera"
)


@dataclass(frozen=True, eq=False)
class Session:
    """One person in the views of several cameras.

    Attributes
    ----------
    name
        What it is called.
    cameras, labels
        The cameras, and the names of their folders.
    numbers
        `(F,)` of the frames.
    people
        By camera and frame, the person's detections.
    left_out
        How many frames lack the person in a view, or have views that do not agree.
    """

    name: str
    cameras: tuple[Pinhole, ...]
    labels: tuple[str, ...]
    numbers: tuple[int, ...]
    people: tuple[tuple[Detection, ...], ...]
    left_out: int = 0

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def straight(self) -> tuple[Pinhole, ...]:
        """The cameras without their lenses' distortion, with square pixels, as `keypoints` have
        them."""
        return tuple(camera.straight for camera in self.cameras)

    @cached_property
    def keypoints(self) -> np.ndarray:
        """`(C, F, 15, 2)` straightened, square pixels, NaN where missing."""
        views = zip(self.cameras, self.people, strict=True)
        return np.stack([_straightened(camera, people) for camera, people in views])

    @cached_property
    def score(self) -> np.ndarray:
        """`(C, F, 15)`, 0 where missing."""
        return np.array([[person.score for person in people] for people in self.people])

    @cached_property
    def midpoints(self) -> tuple[str, ...]:
        """Which of thorax and pelvis are midpoints in all detections (`layouts.corrected`), and
        so in what they triangulate."""
        people = (person for view in self.people for person in view)
        found = [() if person.moved else midpoints_of(person) for person in people]
        return tuple(name for name in MIDPOINTS if all(name in own for own in found))

    @cached_property
    def unit(self) -> float:
        """Millimetres of the person's body unit: the median over the frames."""
        return float(np.median(_units(self.world.points)))

    @cached_property
    def scale(self) -> np.ndarray:
        """`(C, F)` pixels a mm where the person's hips are."""
        return _scale(self.straight, self.world.points)

    @cached_property
    def world(self) -> Triangulated:
        """The joints by all cameras; arrays as `Triangulated` has them, with axes for frames and
        joints in the place of its `n`."""
        return joints_seen(self.straight, self.keypoints, self.score)

    def by(self, cameras: Sequence[int]) -> Triangulated:
        """`world` by some cameras alone."""
        return seen_by(cameras, self.straight, self.keypoints, self.score)

    def without(self, camera: int) -> Triangulated:
        """`world` by all cameras but one."""
        return seen_without(camera, self.straight, self.keypoints, self.score)

    @cached_property
    def apart(self) -> np.ndarray:
        """`(C, F, 15)` mm: how far detections are from the projected joints of all cameras."""
        return np.linalg.norm(_residuals(self.straight, self.world.points, self.keypoints), axis=-1)

    @cached_property
    def stray(self) -> np.ndarray:
        """`(15,)` mm, each way: how far detections of each joint stray, by the residuals of what
        all cameras triangulate and the freedom that this leaves them. What all joints of a person
        have in common, where a camera points, is left out. With `Triangulated.covariance` it says
        how far off a triangulated joint is."""
        weight, own, common = self._strays
        square = (weight * (own - common) ** 2).sum(axis=(0, 1, 3))
        views = (weight[..., 0] > 0).sum(axis=0)
        freedom = np.maximum(2 * views - 3, 0).sum(axis=0) * (1 - 1 / NUM_JOINTS)
        return np.sqrt(square / np.where(freedom > 0, freedom, np.nan))

    @cached_property
    def pointing(self) -> float:
        """Degrees by which a camera points beside its calibration, standard deviation each way: by
        what all joints of a person have in common in each view, for which three of its numbers are
        free, and by what is assumed where few cameras say little. What a camera lags behind the
        others counts as well."""
        _, _, common = self._strays
        focal = np.array([camera.focal[0] for camera in self.straight])
        angle = np.degrees(np.arctan(common[:, :, 0] * (self.scale / focal[:, None])[..., None]))
        square = float(np.mean(np.sum(angle**2, axis=(0, 2))))
        freedom = max(2 * len(self.cameras) - 3, 0)
        assumed = ASSUMED_FREEDOM * ASSUMED_POINTING**2
        return float(np.sqrt((square + assumed) / (freedom + ASSUMED_FREEDOM)))

    @cached_property
    def _strays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of detections from the projected joints of all cameras: weights `(C, F, 15, 1)`,
        residuals `(C, F, 15, 2)`, mm, and what they have in common in a view, `(C, F, 1, 2)`."""
        weight = self.world.weight[..., None]
        own = _residuals(self.straight, self.world.points, self.keypoints)
        own = np.where(weight > 0, own, 0.0)
        total = weight.sum(axis=2, keepdims=True)
        common = (weight * own).sum(axis=2, keepdims=True) / np.where(total > 0, total, 1.0)
        return weight, own, common

    def along_sight(self, camera: int, world: np.ndarray) -> np.ndarray:
        """Joints of the world in axes whose z is the camera's line of sight to the hips' midpoint,
        the origin.

        Parameters
        ----------
        camera
            Which camera.
        world : `(F, 15, 3)`
            Millimetres, the world's axes.

        Returns
        -------
        ndarray
            `(F, 15, 3)`, millimetres.
        """
        axes = self.sight_axes(camera, world)
        return (world - world[:, HIPS].mean(axis=1, keepdims=True)) @ np.swapaxes(axes, 1, 2)

    def sight_axes(self, camera: int, world: np.ndarray) -> np.ndarray:
        """What turns the world's axes into those of `along_sight`.

        Parameters
        ----------
        camera
            Which camera.
        world : `(F, 15, 3)`
            Millimetres, the world's axes.

        Returns
        -------
        ndarray
            `(F, 3, 3)`, one for each frame.
        """
        seen_by = self.cameras[camera]
        middle = seen_by.view(world)[:, HIPS].mean(axis=1)
        return np.stack([turn_to_sight(centre) @ seen_by.rotation for centre in middle])

    def instant(self, frame: int, cameras: Sequence[int] | None = None) -> "Instant":
        """One frame in its views, whose joint posterior is that of the person.

        Parameters
        ----------
        frame
            Its number, as the files have it.
        cameras
            Which cameras, counted from 0; by default all.

        Returns
        -------
        Instant
            Of straightened images, without the midpoints that a detector makes of other joints:
            they lie beside the skeleton's, and by as much in every view. Its cameras point beside
            their calibration as the session's do, and detections err by the embedded law
            (`Instant.judged_by` takes another): discs, of which no one is an outlier, seldom have
            a point in common.

        Raises
        ------
        BadInput
            Where there is no such frame or camera.
        """
        from poseterior.probmodel.errors.detector import DetectorErrors
        from poseterior.probmodel.errors.likelihood import Likelihood
        from poseterior.probmodel.instant import CameraView, Instant  # JAX comes with it

        if frame not in self.numbers:
            raise BadInput(
                f"{self.name} has no frame {frame} in which all cameras of the session see the"
                f" person; choose one from {min(self.numbers)} to {max(self.numbers)}"
            )
        row = self.numbers.index(frame)
        views = zip(self.labels, self.straight, self.people, self.keypoints[:, row], strict=True)
        every = Instant(
            f"{self.name} frame {frame}",
            tuple(
                CameraView(label, camera, _seen_itself(people[row], keypoints))
                for label, camera, people, keypoints in views
            ),
            self.pointing,
        ).judged_by(Likelihood.of(DetectorErrors.default()))
        return every if cameras is None else every.seen_by(cameras)

    def take(self, rows: Sequence[int]) -> "Session":
        """Some of the frames."""
        return dataclasses.replace(
            self,
            numbers=tuple(self.numbers[row] for row in rows),
            people=tuple(tuple(people[row] for row in rows) for people in self.people),
        )


def turn_to_sight(middle: np.ndarray) -> np.ndarray:
    """`(3, 3)`: the smallest turn that brings the line of sight to `middle` `(3,)`, in camera axes,
    onto z."""
    sight = middle / np.linalg.norm(middle)
    axis = np.cross(sight, [0.0, 0.0, 1.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + sight[2])


def _straightened(camera: Pinhole, people: Sequence[Detection]) -> np.ndarray:
    return camera.straighten(np.array([person.keypoints for person in people]))


def _seen_itself(person: Detection, straight: np.ndarray) -> Detection:
    """A detection in straightened pixels `(15, 2)`, without midpoints of others of its points."""
    score = person.score.copy()
    score[[JOINT_INDEX[name] for name in midpoints_of(person)]] = 0.0
    keypoints = np.where(score[:, None] > 0, straight, np.nan)
    return dataclasses.replace(
        person, keypoints=keypoints, score=score, face=None, moved=(), midpoints=()
    )


def joints_seen(cameras: Sequence[Pinhole], xy: np.ndarray, score: np.ndarray) -> Triangulated:
    """Joints from views `(C, F, 15, 2)`, their scores over the mean of a person's seen joints."""
    shape = score.shape
    seen = score > 0
    mean = score.sum(axis=-1, keepdims=True) / np.maximum(seen.sum(axis=-1, keepdims=True), 1)
    trust = (score / np.where(mean > 0, mean, 1.0)) ** 2
    views = xy.reshape(shape[0], -1, 2)
    scale = np.full(shape, FIRST_SCALE)
    for _ in range(2):
        flat = scale.reshape(shape[0], -1)
        found = triangulate(cameras, views, trust.reshape(shape[0], -1), flat)
        points = found.points.reshape(*shape[1:], 3)
        known = _scale(cameras, points)[..., None]
        scale = np.broadcast_to(np.where(known > 0, known, FIRST_SCALE), shape)
    return Triangulated(
        points,
        found.covariance.reshape(*shape[1:], 3, 3),
        found.weight.reshape(shape),
    )


def seen_without(
    camera: int, cameras: Sequence[Pinhole], xy: np.ndarray, score: np.ndarray
) -> Triangulated:
    """`joints_seen` by all cameras but one."""
    return seen_by([one for one in range(len(cameras)) if one != camera], cameras, xy, score)


def seen_by(
    chosen: Sequence[int], cameras: Sequence[Pinhole], xy: np.ndarray, score: np.ndarray
) -> Triangulated:
    """`joints_seen` by some cameras."""
    rows = list(chosen)
    return joints_seen([cameras[row] for row in rows], xy[rows], score[rows])


def _scale(cameras: Sequence[Pinhole], points: np.ndarray) -> np.ndarray:
    """`(C, F)` pixels a mm of straight cameras at the hips' midpoint of joints `(F, 15, 3)`; NaN
    where they are not known, negative behind a camera."""
    middle = points[:, HIPS].mean(axis=1)
    return np.stack([camera.focal[0] / camera.view(middle)[:, 2] for camera in cameras])


def _residuals(cameras: Sequence[Pinhole], points: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """`(C, F, 15, 2)` mm: `xy` minus projections of `points` `(F, 15, 3)`."""
    scale = np.broadcast_to(_scale(cameras, points)[..., None], xy.shape[:3])
    return residuals(cameras, points, xy, scale)


def _units(points: np.ndarray) -> np.ndarray:
    """`(F,)` mm: mean limb bones of joints `(F, 15, 3)`, of the bones that are known."""
    with np.errstate(invalid="ignore"):
        lengths = bone_lengths(points)[:, _LIMBS]
    known = np.isfinite(lengths)
    return np.where(known, lengths, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)


def is_session(path: Path) -> bool:
    """Whether it is a folder with a calibration in it, or in its folder `calibration`."""
    return path.is_dir() and bool(_calibrations(path))


def read_session(
    path: Path | str, frames: int | None = None, *, layout: str | None = None
) -> Session:
    """The session in a folder.

    Parameters
    ----------
    path
        The folder.
    frames
        How many, evenly over the film; by default all.
    layout
        The order of the joints in the detections, as `read_frames` takes it.

    Returns
    -------
    Session
        The person in the views of all cameras.

    Raises
    ------
    BadInput
        Where a file is missing or damaged, folders and cameras, or the frames of two cameras, are
        not the same number, or the calibration does not fit the detections.
    """
    path = Path(path)
    calibration = _only(_calibrations(path), path)
    cameras = read_cameras(calibration)
    folders = _view_folders(path)
    if len(folders) != len(cameras):
        raise BadInput(
            f"{path} has {len(folders)} folders of detections, but {calibration.name} calibrates"
            f" {len(cameras)} cameras; one folder must belong to each"
        )
    views = [_by_number(folder, layout) for folder in folders]
    _require_same_frames(views, folders)
    numbers = sorted(views[0])
    if frames is not None:
        numbers = [numbers[row] for row in evenly(len(numbers), frames)]
    labels = tuple(folder.name for folder in folders)
    session = _matched(path, tuple(cameras), labels, numbers, views)
    _require_fit(session, calibration)
    return session


def _calibrations(path: Path) -> list[Path]:
    places = [place for place in (path, path / "calibration") if place.is_dir()]
    return [file for place in places for file in sorted_files(place) if is_calibration(file)]


def _only(found: list[Path], path: Path) -> Path:
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise BadInput(f"{path} must hold one calibration, but has {names}; {_ADVICE}")
    return found[0]


def _view_folders(path: Path) -> list[Path]:
    """The folders that hold detections, sorted by name."""
    inside = [path / name for name in VIEW_PLACES if (path / name).is_dir()]
    place = inside[0] if inside else path
    folders = [one for one in place.iterdir() if one.is_dir() and not one.name.startswith(".")]
    found = [one for one in folders if any(file.suffix == ".json" for file in sorted_files(one))]
    return sorted(found, key=lambda folder: natural_order(folder.name))


def _by_number(folder: Path, layout: str | None) -> dict[int, DetectedFrame]:
    found: dict[int, DetectedFrame] = {}
    for frame in read_frames(folder, layout=layout):
        digits = re.findall(r"\d+", frame.name)
        if not digits:
            raise BadInput(f"{folder}: the frame {shown(frame.name)} has no number in its name")
        if int(digits[-1]) in found:
            raise BadInput(f"{folder}: two frames have the number {digits[-1]}; keep one of them")
        found[int(digits[-1])] = frame
    return found


def _require_same_frames(views: Sequence[dict[int, DetectedFrame]], folders: list[Path]) -> None:
    first = views[0]
    for folder, view in zip(folders, views, strict=True):
        if set(view) != set(first):
            odd = min(set(view) ^ set(first))
            raise BadInput(
                f"{folder.name} has {len(view)} frames and {folders[0].name} has {len(first)}, and"
                f" frame {odd} is only in one of them; synchronised cameras have the same frames"
            )


def _matched(
    path: Path,
    cameras: tuple[Pinhole, ...],
    labels: tuple[str, ...],
    numbers: list[int],
    views: Sequence[dict[int, DetectedFrame]],
) -> Session:
    """One person through all frames: the first people in the files, or the first others, whose
    views agree."""
    _require_people(path, labels, numbers, views)
    complete = [number for number in numbers if all(view[number].people for view in views)]
    first = [[view[number].people[0] for number in complete] for view in views]
    agreed = dict(zip(complete, _agree(cameras, first), strict=True)) if complete else {}
    kept, people = [], []
    for number in complete:
        there = [view[number].people for view in views]
        chosen = tuple(one[0] for one in there) if agreed[number] else _others(cameras, there)
        if chosen is not None:
            kept.append(number)
            people.append(chosen)
    if 2 * len(kept) < len(numbers) or not kept:
        from poseterior.probmodel.sessions.turning import said_of  # which needs sessions itself

        whole = Session(path.name, cameras, labels, tuple(complete), tuple(map(tuple, first)))
        advice = (
            "check that the calibration is of these cameras, in the order of the folders' names,"
            " and that they are synchronised"
        )
        raise BadInput(
            f"in {len(numbers) - len(kept)} of {len(numbers)} frames of {path} no person is where"
            f" the cameras' views meet; {'; if not, '.join([*said_of(whole), advice])}"
        )
    by_camera = tuple(zip(*people, strict=True))
    return Session(
        path.resolve().name,
        cameras,
        labels,
        tuple(kept),
        by_camera,
        left_out=len(numbers) - len(kept),
    )


def _require_people(
    path: Path,
    labels: Sequence[str],
    numbers: list[int],
    views: Sequence[dict[int, DetectedFrame]],
) -> None:
    """Raises `BadInput` where a camera saw nobody in most frames."""
    for label, view in zip(labels, views, strict=True):
        if 2 * (seen := sum(bool(view[number].people) for number in numbers)) < len(numbers):
            raise BadInput(
                f"{label} of {path} saw nobody in {len(numbers) - seen} of {len(numbers)} frames;"
                " look at its detections, or leave out its folder and its part of the calibration"
            )


def _others(
    cameras: Sequence[Pinhole], there: list[list[Detection]]
) -> tuple[Detection, ...] | None:
    """The people, one a view, of the first combination that agrees; None where there is none."""
    chosen = list(itertools.islice(_choices([len(view) for view in there]), MOST_COMBINATIONS))
    people = [[view[one[place]] for one in chosen] for place, view in enumerate(there)]
    agreed = np.flatnonzero(_agree(cameras, people))
    return tuple(view[agreed[0]] for view in people) if len(agreed) else None


def _choices(numbers: list[int]) -> Iterator[tuple[int, ...]]:
    """Which of so many people each view takes, those first that stand near the top of their files:
    one by one, so that many cameras cost no more than their views."""
    several = [view for view, number in enumerate(numbers) if number > 1]
    for places in range(sum(numbers) - len(numbers) + 1):
        for views in itertools.combinations_with_replacement(several, places):
            chosen = np.bincount(np.array(views, int), minlength=len(numbers))
            if (chosen < numbers).all():
                yield tuple(chosen.tolist())


def _agree(cameras: Sequence[Pinhole], people: Sequence[Sequence[Detection]]) -> np.ndarray:
    """`(F,)`: whether people, by camera and frame, can be one: in front of every camera, and near
    to where the views meet."""
    straight = [camera.straight for camera in cameras]
    views = zip(cameras, people, strict=True)
    xy = np.stack([_straightened(camera, seen) for camera, seen in views])
    score = np.array([[person.score for person in seen] for seen in people])
    points = joints_seen(straight, xy, score).points
    in_front = (_scale(straight, points) > 0).all(axis=0)  # false for NaN too
    apart = np.linalg.norm(_residuals(straight, points, xy), axis=-1)
    apart = np.where(score > 0, apart, np.nan)
    known = np.isfinite(apart).any(axis=2)
    middle = np.nanmedian(np.where(known[..., None], apart, np.inf), axis=2)
    return in_front & (middle <= BEYOND * _units(points)).all(axis=0)


def _require_fit(session: Session, calibration: Path) -> None:
    """Raises `BadInput` where one camera stands apart from the others, or nobody is so large."""
    if not SHORTEST_UNIT <= session.unit <= LONGEST_UNIT:
        raise BadInput(
            f"by {calibration.name} limbs of the person are {session.unit:,.3g} mm long (their"
            " mean), which nobody's are; lengths of a .qca.txt are millimetres, those of .toml and"
            " .yml metres: scale its positions"
        )
    for label, apart in zip(session.labels, session.apart, strict=True):
        middle = np.nanmedian(apart)
        if not middle <= BEYOND * session.unit:  # true for NaN too
            raise BadInput(
                f"the detections of {label} are {middle:.0f} mm (median) from where the other"
                f" cameras see the joints: {calibration.name} does not fit them; check the order of"
                " the folders, and that the cameras are synchronised"
            )
