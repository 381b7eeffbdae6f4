"""Readings: was the file read as it was meant? A detection against its exchanged, mirrored and
upside-down selves.

`judge(detections, model)` weighs the people of a file under every reading and says, in sentences,
where another explains them much better. The evidence is the model's, in a cheap form: the mean,
over draws of the prior, of a smooth likelihood of each limb (standard error below 0.2 nats), × the
misfit of the torso, × the face (`face`). What can be told and what cannot, with shares:
reports/readings.md."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from poseterior.inference.estimators import estimate_torso
from poseterior.inference.face import log_face_likelihood
from poseterior.probmodel.detections import FACE, Detection, mapped
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.pose import Pose
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import GROUPS, JOINT_INDEX, LIMB_JOINTS, MIRROR, TORSO_INDEX
from poseterior.probmodel.transport import CUBE_DIM, from_cube

DRAWS = 2**15
"""Poses of the prior that stand for it."""
NOISE = 0.10
"""Standard deviation, body units, of a detected limb joint about the pose's, along either axis."""
TORSO_NOISE = 0.09
"""The same for torso joints; a dictionary of torsos fits a real torso only so well."""
FLOOR = -25.0
"""Log likelihood of a limb that no draw comes near: an outlier of the detector must not outweigh
everything else."""


class ReadingEvidence(NamedTuple):
    """Log evidence of one detection with the torso as it is: by candidate, `torso` `(c,)` and
    `face` `(c,)`; and `arms` and `legs` `(c, 2)`, as they are and exchanged."""

    torso: np.ndarray
    face: np.ndarray
    arms: np.ndarray
    legs: np.ndarray

    def body(self, arms: int, legs: int) -> float:
        """Log evidence of torso and limbs."""
        return float(np.logaddexp.reduce(self.torso + self.arms[:, arms] + self.legs[:, legs]))

    def facing(self) -> float:
        """Log evidence of the face, given torso and limbs."""
        weight = self.torso + self.arms[:, 0] + self.legs[:, 0]
        return float(np.logaddexp.reduce(weight + self.face) - np.logaddexp.reduce(weight))


@functools.lru_cache(maxsize=1)
def _points() -> np.ndarray:
    from scipy.stats import qmc  # Seconds to import, and few commands judge a reading.

    return np.asarray(qmc.Sobol(CUBE_DIM, seed=0).random(DRAWS))


@jax.jit
def _prior(model: PoseModel, points: jax.Array) -> Pose:
    return from_cube(model, points)


@jax.jit
def _joints(model: PoseModel, torso: jax.Array, draws: Pose) -> jax.Array:
    """`(n, 15, 3)`: the draws on one torso."""
    return jax.vmap(model.joints, (None, 0, 0, 0))(torso, *draws)


def _log_evidence(draws: np.ndarray, target: np.ndarray, group: str) -> float:
    """Log evidence of a group's two limbs under `draws` `(n, 8, 2)` of `LIMB_JOINTS`.

    The limbs are taken apart from each other: that they share lengths is left out.
    """
    total = 0.0
    for limb in GROUPS[group]:
        joints = [bone.end for bone in limb.bones if np.isfinite(target[bone.end]).all()]
        square = sum(
            (draws[:, LIMB_JOINTS.index(j), axis] - np.float32(target[j, axis])) ** 2
            for j in joints
            for axis in (0, 1)
        )
        square = np.zeros(len(draws)) + square / NOISE**2
        total += np.logaddexp(np.logaddexp.reduce(-square / 2) - np.log(len(draws)), FLOOR)
    return float(total)


def exchanged(detection: Detection, *parts: str) -> Detection:
    """`detection` with left and right exchanged in `parts`: names of joints without their side, and
    "face"."""
    order = np.arange(len(MIRROR))
    for part in parts:
        if part != "face":
            right, left = JOINT_INDEX[f"right_{part}"], JOINT_INDEX[f"left_{part}"]
            order[[right, left]] = left, right
    face = detection.face
    if face is not None and "face" in parts:
        face = face[[FACE.index(_other(name)) for name in FACE]]
    return dataclasses.replace(
        detection, keypoints=detection.keypoints[order], score=detection.score[order], face=face
    )


def _other(name: str) -> str:
    side, _, part = name.partition("_")
    return f"{ {'left': 'right', 'right': 'left'}[side] }_{part}" if part else name


ARMS, LEGS = ("elbow", "wrist"), ("knee", "ankle")
BODY = ("shoulder", "hip", *ARMS, *LEGS, "face")


class Reading(NamedTuple):
    """Another way to read a detection: left and right exchanged in `parts`; with shoulders and hips
    (not) `opposed`, and `arms` and `legs` (not) exchanged against them, it stands in two
    `ReadingEvidence`s."""

    name: str
    parts: tuple[str, ...]
    opposed: bool
    arms: int
    legs: int


READINGS = (
    Reading("arms", ARMS, False, 1, 0),
    Reading("legs", LEGS, False, 0, 1),
    Reading("limbs", ARMS + LEGS, False, 1, 1),
    Reading("halves", ("shoulder", *ARMS), True, 1, 0),
    Reading("shoulders", ("shoulder",), True, 0, 0),
    Reading("hips", ("hip",), True, 1, 1),
)
ASPECTS = (9 / 16, 3 / 4, 4 / 3, 16 / 9)
"""Factors between the width over height of usual images: what x is off by where the size of the
image is wrong."""
BETTER_BY = 4.0
"""Nats of evidence, summed over people, by which an exchange within the body must explain them
better before it is spoken of: less is the noise of the draws."""
FACE_THRESHOLD = 2.5
"""The same for the exchange of everything, which the face decides."""
SIZE_THRESHOLD = 10.0
"""Nats, times the root of the number of people, by which another size of the image must explain
them better. Bodies are wider and narrower too, so that one in seventy gains as much, read rightly;
what several gain so, each by itself, adds up as roots do, and what a wrong size brings, in full."""
WORST_FIT = -3.8
"""Log evidence a seen joint, below which the points are hardly a body's under any reading."""
UPSIDE_DOWN = -0.5
"""Cosine between the spine, head to pelvis, and the image's down: beyond it a person stands on the
head."""

SENTENCES = {
    "arms": "left and right arm seem to be exchanged",
    "legs": "left and right leg seem to be exchanged",
    "limbs": "the left limbs seem to hang on the right side of the torso",
    "halves": (
        "left and right seem to be exchanged in one half of the body, above or below the waist"
    ),
    "shoulders": "left and right shoulder seem to be exchanged",
    "hips": "left and right hip seem to be exchanged",
    "whole": (
        "left and right seem to be exchanged, or the image mirrored: faces and bodies look opposite"
        " ways"
    ),
    "upside down": "people stand on their heads: is y counted upwards, or the image turned?",
    "size": (
        "people are too wide or too narrow: is the size of the image the one that the detector was"
        " given?"
    ),
    "order": (
        "the points do not make a human body: is this their order (the format), and are these"
        " joints of one person?"
    ),
}
"""What is said of each thing that can be noticed."""


class Verdict(NamedTuple):
    """What readings say about a number of people: `gains` `(people, readings)`, by how many nats
    each of `names` explains them better than the file as it is; `fits` `(people,)`, log evidence as
    it is, and `joints` `(people,)`, of how many; `spines` `(people,)`, cosines between spine and
    the image's down. `skipped` says of whom too little is seen."""

    names: tuple[str, ...]
    gains: np.ndarray
    fits: np.ndarray
    joints: np.ndarray
    spines: np.ndarray
    skipped: tuple[str, ...]

    @property
    def noticed(self) -> tuple[str, ...]:
        """Names of what is wrong, the best explanation of each kind: none where nothing speaks
        against the file."""
        if not len(self.gains):
            return ()
        found = []
        total = dict(zip(self.names, self.gains.sum(axis=0).tolist(), strict=True))
        exchanges = {reading.name: total[reading.name] for reading in READINGS}
        best = max(exchanges, key=exchanges.__getitem__)
        wrong_size = total.get("size", -np.inf) > SIZE_THRESHOLD * np.sqrt(len(self.gains))
        if (self.fits.sum() + max(exchanges[best], 0.0)) / self.joints.sum() < WORST_FIT:
            found.append("size" if wrong_size else "order")
        elif exchanges[best] > BETTER_BY:
            found.append(best)
        elif wrong_size:
            found.append("size")
        if np.mean(self.spines < UPSIDE_DOWN) > 0.5:
            found.append("upside down")
        elif total["whole"] > FACE_THRESHOLD and "order" not in found:
            found.append("whole")
        return tuple(found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The same as sentences."""
        return tuple(SENTENCES[name] for name in self.noticed)


class Judge:
    """The model's prior as draws, to weigh any number of detections with."""

    def __init__(self, model: PoseModel) -> None:
        self._model = model
        self._torsos = np.asarray(model.torsos)
        self._draws = _prior(model, jnp.asarray(_points()))
        self._kept: dict[int, np.ndarray] = {}

    def evidence(self, detection: Detection) -> ReadingEvidence:
        """Of one person. Raises `BadInput` where too little of the torso is seen."""
        frame = estimate_torso(detection, torsos=self._torsos)
        parts = [self._under(detection, candidate) for candidate in frame.candidates]
        return ReadingEvidence(*(np.array(part) for part in zip(*parts, strict=True)))

    def file(self, detections: Sequence[Detection], *, sizes: bool = False) -> Verdict:
        """What the readings say of all these people together; those of whom too little is seen are
        skipped."""
        judged, skipped = [], []
        for detection in detections:
            try:
                judged.append(self.verdict(detection, sizes=sizes))
            except BadInput as error:
                skipped.append(str(error))
        return together(judged, tuple(skipped))

    def verdict(self, detection: Detection, *, sizes: bool = False) -> Verdict:
        """What the readings say of one person. Raises `BadInput` where too little of the torso is
        seen."""
        usual = self.evidence(detection)
        opposed = self.evidence(exchanged(detection, "shoulder"))
        whole = usual if detection.face is None else self.evidence(exchanged(detection, *BODY))
        others = (
            [self.evidence(stretched(detection, 1 / factor)) for factor in ASPECTS] if sizes else []
        )
        return weigh(detection, usual, opposed, whole, others)

    def _under(
        self, detection: Detection, candidate: Candidate
    ) -> tuple[float, float, list[float], list[float]]:
        scale, rows = float(candidate.camera.scale), np.asarray(candidate.camera.rotation)[:2]
        draws = self._limbs(candidate) @ rows.T.astype(np.float32)
        target = candidate.camera.to_plane(detection.keypoints)
        seen = int(detection.seen[list(TORSO_INDEX)].sum())
        torso = -0.5 * seen * (candidate.reprojection_error / scale / TORSO_NOISE) ** 2
        arms, legs = (
            [_log_evidence(draws, target[order], name) for order in (slice(None), list(MIRROR))]
            for name in ("arms", "legs")
        )
        return torso, log_face_likelihood(detection, candidate), arms, legs

    def _limbs(self, candidate: Candidate) -> np.ndarray:
        """`(n, 8, 3)`: limb joints of the draws on the candidate's torso, kept, since a file's
        people share few."""
        index = candidate.torso_index
        if index not in self._kept:
            joints = _joints(self._model, jnp.asarray(candidate.torso), self._draws)
            self._kept[index] = np.asarray(joints[:, jnp.array(LIMB_JOINTS)], np.float32)
        return self._kept[index]


def judge(detections: Sequence[Detection], model: PoseModel, *, sizes: bool = False) -> Verdict:
    """Weighs the readings of a file by its people, all together: a file has one order.

    `sizes`: also whether the image's size is right, which is open where coordinates are fractions
    of it. About 0.8 s a person, 2 s with `sizes`."""
    return Judge(model).file(detections, sizes=sizes)


def together(verdicts: Sequence[Verdict], skipped: tuple[str, ...] = ()) -> Verdict:
    """The people of several verdicts in one."""
    skipped = (*skipped, *(sentence for verdict in verdicts for sentence in verdict.skipped))
    verdicts = [verdict for verdict in verdicts if len(verdict.gains)]
    if not verdicts:
        return Verdict((), np.zeros((0, 0)), np.zeros(0), np.zeros(0), np.zeros(0), skipped)
    gains = np.concatenate([verdict.gains for verdict in verdicts])
    columns = zip(
        *((verdict.fits, verdict.joints, verdict.spines) for verdict in verdicts), strict=True
    )
    fits, joints, spines = (np.concatenate(column) for column in columns)
    return Verdict(verdicts[0].names, gains, fits, joints, spines, skipped)


def weigh(
    detection: Detection,
    usual: ReadingEvidence,
    opposed: ReadingEvidence,
    whole: ReadingEvidence,
    sizes: Sequence[ReadingEvidence] = (),
) -> Verdict:
    """The verdict on one person from the evidence `usual`, with the shoulders exchanged
    (`opposed`), with everything exchanged (`whole`), and with other aspects of the image
    (`sizes`)."""
    body = usual.body(0, 0)
    gains = [
        (opposed if reading.opposed else usual).body(reading.arms, reading.legs) - body
        for reading in READINGS
    ]
    gains.append(whole.facing() - usual.facing())
    if sizes:
        gains.append(max(evidence.body(0, 0) for evidence in sizes) - body)
    joints = detection.seen[[*TORSO_INDEX, *LIMB_JOINTS]].sum()
    spine = detection.keypoints[JOINT_INDEX["pelvis"]] - detection.keypoints[JOINT_INDEX["thorax"]]
    cosine = spine[1] / np.linalg.norm(spine) if np.isfinite(spine).all() and spine.any() else 1.0
    names = (*(reading.name for reading in READINGS), "whole", *(["size"] if sizes else []))
    return Verdict(
        names, np.array([gains]), np.array([body]), np.array([joints]), np.array([cosine]), ()
    )


def stretched(detection: Detection, factor: float) -> Detection:
    """`detection` with x multiplied, as it is where the width of the image is wrong."""
    return mapped(detection, lambda places: places * np.array([factor, 1.0]))
