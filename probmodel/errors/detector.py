"""A detector's errors as a file says them: by joint their spread, their bias, the share of inliers.

The usual way in is `DetectorErrors.read(path)`; `poseterior calibrate` learns and writes such
files, and `DetectorErrors.default()` is the embedded one. Lengths are in the person's body units
(the mean limb bone is 1) in the plane of the image, x right and y down; docs/model.md § 10.

With probability `inlier` a joint's error is `bias` plus one of the law, otherwise the detection is
an outlier: uniform in the disc of `outlier_radius` around the joint's projection.
"""

import dataclasses
import json
import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import resources
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from poseterior.probmodel.detections import LARGEST_NUMBER
from poseterior.probmodel.documents import read_json
from poseterior.probmodel.errors.laws import LAWS, ErrorLaw, law_of
from poseterior.probmodel.errors.times import WITH_SE, ErrorTimes
from poseterior.probmodel.failures import BadInput, shown
from poseterior.probmodel.files import replacing
from poseterior.probmodel.layouts import MIDPOINTS, weights_of
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS, NUM_JOINTS, TORSO_INDEX

FORMAT = "poseterior error law 1"
UNITS = "body units: the person's mean limb bone is 1"
AXES = "image: right, down"
OUTLIER_RADIUS = 5.0
"""Body units: a person's height, so that an outlier may be anywhere on the person."""
LARGEST_LENGTH = 100.0
"""Body units; no spread, bias or radius is larger."""
SHARPEST = 0.002
"""Body units, less than a millimetre of a person: no detector is so exact that its sigma is
smaller, and samplers would seek for ever for poses that agree with it."""
_WHAT = "error law"
_ADVICE = "give a file that `poseterior calibrate` wrote, or one like it"
_PARAMETERS = {field.name for law in LAWS.values() for field in dataclasses.fields(law)}  # type: ignore[arg-type]
_KEYS = {
    *("format", "units", "axes", "law", *_PARAMETERS),
    *("joints", "exchange", "score", "outlier_radius", "times", "learned"),
}
_JOINT_KEYS = {"sigma", "inlier", "bias", "se", "pairs", "definition", "definition_sd"}
FARTHEST_DEFINITION = 1.0
"""Body units: a point that lies farther from a joint is no definition of it."""
DEFINITION_SEED = 0
"""Of the order in which people have the quantiles of definitions."""
_ALIKE = [
    [JOINT_INDEX[name] for name in names]
    for names in (*MIDPOINTS.values(), *((middle,) for middle in MIDPOINTS))
]
"""Joints of the torso that deviate together, but for the mirror."""
_LEFT_SIDE = [JOINT_INDEX[name] for name in JOINTS if name.startswith("left_")]


class Exchange(NamedTuple):
    """Probabilities that a detector takes right for left: of the legs alone (knees and ankles), of
    the arms alone (elbows and wrists), of the whole body; see `faults.EXCHANGES`."""

    legs: float = 0.0
    arms: float = 0.0
    body: float = 0.0


class ScoreFactor(NamedTuple):
    """How the spread depends on a detection's score: times `sigma_factor[i]` for scores from
    `edges[i - 1]` up to, but without, `edges[i]`; one factor more than there are edges."""

    edges: tuple[float, ...] = ()
    sigma_factor: tuple[float, ...] = (1.0,)

    def at(self, score: npt.ArrayLike) -> np.ndarray:
        """The factors at scores `(...)`."""
        rows = np.searchsorted(np.asarray(self.edges), np.asarray(score), side="right")
        return np.asarray(self.sigma_factor)[rows]


NO_EXCHANGE = Exchange()
ANY_SCORE = ScoreFactor()


@dataclass(frozen=True, eq=False)
class DetectorErrors:
    """How a detector errs.

    Attributes
    ----------
    law
        Of an inlier's error.
    sigma
        `(15,)` body units, NaN for joints it does not know: half a spread of the law. The error's
        standard deviation each way for `Gaussian`, and for `Disc`, whose radius is twice that; for
        `Student` the scale each way: error / σ has the bivariate t distribution.
    inlier
        `(15,)` probability that a detection is no outlier, NaN like `sigma`.
    bias
        `(15, 2)` body units, the inliers' mean error to the right and down, NaN like `sigma`.
    exchange
        Probabilities of exchanged sides.
    score
        How `sigma` depends on the score.
    outlier_radius
        Body units.
    pairs
        `(15,)` how many pairs of detection and truth each joint was learned from; 0 where the file
        does not say.
    se
        `(15, 4)` standard errors of sigma, inlier and the two of bias; NaN where there are none.
    learned
        Where it comes from, in words and numbers.
    definition
        `(15, 3)` body units, to the person's left, up and forward: how far from the skeleton's
        joint lies what the detector calls by its name; 0 where it is the same, and for limbs'
        joints, which have axes of their own.
    definition_sd
        `(15, 3)` body units: how much that differs between people, and between detectors where it
        is not known which one it is; see `definitions`.
    times
        How long errors last. None where nobody knows: then they are taken to last, so that a film
        is worth no more than a frame (`worth`).

    Raises
    ------
    BadInput
        On numbers that are none of an error law, by the joint's name.
    """

    law: ErrorLaw
    sigma: np.ndarray
    inlier: np.ndarray
    bias: np.ndarray
    exchange: Exchange = NO_EXCHANGE
    score: ScoreFactor = ANY_SCORE
    outlier_radius: float = OUTLIER_RADIUS
    pairs: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(NUM_JOINTS, int))
    se: np.ndarray = dataclasses.field(default_factory=lambda: np.full((NUM_JOINTS, 4), np.nan))
    learned: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    definition: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((NUM_JOINTS, 3)))
    definition_sd: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((NUM_JOINTS, 3)))
    times: ErrorTimes | None = None

    def __post_init__(self) -> None:
        self._check_radius()
        shapes = {"sigma": (), "inlier": (), "bias": (2,), "pairs": (), "se": (4,)}
        shapes |= {"definition": (3,), "definition_sd": (3,)}
        for name, row in shapes.items():
            array = np.array(getattr(self, name))
            if array.shape != (NUM_JOINTS, *row):
                raise BadInput(
                    f"{name} of an error law must have the shape {(NUM_JOINTS, *row)}, not"
                    f" {array.shape}"
                )
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not self.known.any():
            raise BadInput(f"an error law must know at least one joint; {_ADVICE}")
        for joint in range(NUM_JOINTS):
            if self.known[joint]:
                self._check_joint(joint)
        self._check_exchange()
        self._check_score()
        self._check_sizes()
        self._check_definition()
        if self.times is not None:
            self.times.check()

    def worth(self, frames: int, rate: float) -> float:
        """How many frames with errors of their own so many in succession are worth.

        Parameters
        ----------
        frames
            How many.
        rate
            Of them in a second.

        Returns
        -------
        float
            As of `ErrorTimes.worth`; 1 where nobody knows how long errors last.
        """
        return 1.0 if self.times is None else self.times.worth(frames, rate)

    @property
    def known(self) -> npt.NDArray[np.bool_]:
        """`(15,)`: the joints that it knows."""
        return ~np.isnan(self.sigma)

    def require(self, seen: np.ndarray, where: str) -> None:
        """Makes sure that it knows every joint that is seen.

        Parameters
        ----------
        seen : `(15,)` bool
            The joints that are seen.
        where
            The detection, in words.

        Raises
        ------
        BadInput
            Where it knows nothing of one of them.
        """
        for joint in np.flatnonzero(np.asarray(seen) & ~self.known):
            raise BadInput(
                f"the error law knows no {JOINTS[joint]}, which is seen in {where}; add it to the"
                " law's joints, or leave it out of the detection"
            )

    def spread(self, score: np.ndarray) -> np.ndarray:
        """`(..., 15)` body units: each joint's sigma at scores `(..., 15)`."""
        return self.sigma * self.score.at(score)

    def definitions(self, number: int, moved: Collection[str] = ()) -> np.ndarray | None:
        """Where detectors like this one see the torso's joints of so many people.

        Each has `definition` plus normal deviations of `definition_sd`, those of the left side the
        mirror image of those of the right: quantiles of the normal law in a random order, the same
        whoever asks (a Latin hypercube; McKay, Beckman & Conover 1979). One person has the mean.

        Parameters
        ----------
        number
            How many people.
        moved
            Which of thorax and pelvis were put where they are by shoulders and hips
            (`layouts.corrected`), and so lie as these do.

        Returns
        -------
        ndarray
            `(number, 15, 3)`, `(1, 15, 3)` where all are alike, and None where every point is the
            skeleton's joint.
        """
        if not self.definition_sd.any():
            every = weights_of(moved) @ self.definition
            return every[None] if every.any() else None
        quantile = ndtri((np.arange(number) + 0.5) / number)
        quantile /= max(float(quantile.std()), np.finfo(float).tiny)
        rng = np.random.default_rng(DEFINITION_SEED)
        normal = rng.permuted(np.tile(quantile, (len(_ALIKE), 3, 1)), axis=2)
        deviation = np.zeros((number, NUM_JOINTS, 3))
        for joints, own in zip(_ALIKE, normal, strict=True):
            deviation[:, joints] = own.T[:, None]
        deviation[:, _LEFT_SIDE, 0] *= -1
        return weights_of(moved) @ (self.definition + deviation * self.definition_sd)

    def _check_radius(self) -> None:
        if not 0 < self.outlier_radius <= LARGEST_LENGTH:  # false for NaN too
            raise BadInput(
                f"the outlier_radius must lie between 0 and {LARGEST_LENGTH:g} body units, not"
                f" {self.outlier_radius:g}"
            )

    def _check_joint(self, joint: int) -> None:
        name, sigma, inlier = JOINTS[joint], self.sigma[joint], self.inlier[joint]
        if not 0 < sigma <= LARGEST_LENGTH:
            raise BadInput(
                f"sigma of {name} must be positive and at most {LARGEST_LENGTH:g} body units, not"
                f" {sigma:g}"
            )
        if not 0 <= inlier <= 1:  # false for NaN too
            raise BadInput(f"inlier of {name} must lie between 0 and 1, not {inlier:g}")
        if not (np.abs(self.bias[joint]) <= LARGEST_LENGTH).all():  # false for NaN too
            raise BadInput(
                f"bias of {name} must be two numbers within ±{LARGEST_LENGTH:g} body units, not"
                f" {self.bias[joint].tolist()}"
            )

    def require_attainable(self) -> None:
        """Refuse a detector that would be exact beyond belief: samplers would seek for ever.

        Raises
        ------
        BadInput
            If the smallest sigma of a joint is under a millimetre of a person.
        """
        least = self.sigma * min(self.score.sigma_factor)
        joint = int(np.nanargmin(least))
        if least[joint] < SHARPEST:
            raise BadInput(
                f"sigma of {JOINTS[joint]} is {least[joint]:g} body units where its score is best,"
                f" less than {SHARPEST:g}, which is under a millimetre of a person; no detector is"
                " so exact: give its true error, in body units"
            )

    def _check_sizes(self) -> None:
        widest = int(np.nanargmax(self.sigma))
        if self.outlier_radius < self.sigma[widest]:
            raise BadInput(
                f"the outlier_radius is {self.outlier_radius:g} body units, less than the sigma of"
                f" {JOINTS[widest]} ({self.sigma[widest]:g}); outliers lie farther off than others"
            )

    def _check_definition(self) -> None:
        size = np.linalg.norm(self.definition, axis=-1)
        for joint in np.flatnonzero(~(size <= FARTHEST_DEFINITION)):  # true for NaN too
            raise BadInput(
                f"the definition of {JOINTS[joint]} must lie within {FARTHEST_DEFINITION:g} body"
                f" unit of the joint, not at {self.definition[joint].tolist()}"
            )
        sd = self.definition_sd
        for joint in np.flatnonzero(~((sd >= 0) & (sd <= FARTHEST_DEFINITION)).all(axis=-1)):
            raise BadInput(
                f"the definition_sd of {JOINTS[joint]} must lie between 0 and"
                f" {FARTHEST_DEFINITION:g} body unit each way, not {sd[joint].tolist()}"
            )
        for joint in np.flatnonzero((size > 0) | sd.any(axis=-1)):
            if joint not in TORSO_INDEX:
                raise BadInput(
                    f"{JOINTS[joint]} has a definition in the torso's axes, in which it has no"
                    " place; only pelvis, thorax, shoulders and hips may have one"
                )

    def _check_exchange(self) -> None:
        possible = all(0 <= one < 1 for one in self.exchange)  # false for NaN too
        if not possible or not sum(self.exchange) < 1:
            raise BadInput(
                "the probabilities of exchange must each lie between 0 and 1 and together stay"
                f" below 1, not {', '.join(f'{one:g}' for one in self.exchange)}"
            )

    def _check_score(self) -> None:
        edges, factors = np.asarray(self.score.edges), np.asarray(self.score.sigma_factor)
        if len(factors) != len(edges) + 1:
            raise BadInput(
                f"the score of an error law has {len(edges)} edges and {len(factors)} factors; give"
                " one factor more than edges"
            )
        if not ((np.diff(edges) > 0).all() and (np.abs(edges) <= LARGEST_NUMBER).all()):
            raise BadInput("the edges of the score of an error law must be rising numbers")
        if not ((factors > 0) & (factors <= LARGEST_LENGTH)).all():
            raise BadInput(
                "the factors of the score of an error law must be positive and at most"
                f" {LARGEST_LENGTH:g}"
            )

    @classmethod
    def default(cls) -> Self:
        """The embedded law (probmodel/data/PROVENANCE.md)."""
        with resources.as_file(
            resources.files("poseterior.probmodel.data") / "errors.json"
        ) as path:
            return cls.read(path)

    @classmethod
    def read(cls, path: str | os.PathLike) -> Self:
        """The law in a file.

        Raises
        ------
        BadInput
            Where the file is missing, is no JSON, or is no error law.
        """
        return cls.from_document(read_json(path, _WHAT, _ADVICE), str(path))

    @classmethod
    def from_document(cls, document: Any, source: str) -> Self:
        """The law in a JSON document.

        Parameters
        ----------
        document
            Parsed.
        source
            What messages call it.

        Returns
        -------
        DetectorErrors
            The law.

        Raises
        ------
        BadInput
            As `read`.
        """
        _require_format(document, source)
        joints = _Joints()
        for name, entry in _object(document["joints"], "joints", source).items():
            joints.take(name, entry, source)
        radius = document.get("outlier_radius", OUTLIER_RADIUS)
        parameters = {
            name: _finite(document[name], name, source) for name in _PARAMETERS & set(document)
        }
        read = partial(
            cls,
            exchange=_exchange(document.get("exchange", {}), source),
            score=_score(document.get("score"), source),
            outlier_radius=_finite(radius, "outlier_radius", source),
            pairs=joints.pairs,
            se=joints.se,
            learned=_object(document.get("learned", {}), "learned", source),
            definition=joints.definition,
            definition_sd=joints.definition_sd,
            times=_times(document.get("times"), source),
        )
        try:
            law = law_of(document["law"], parameters)
            found = read(law, joints.sigma, joints.inlier, joints.bias)
            found.require_attainable()
            return found
        except BadInput as error:
            raise BadInput(f"{source}: {error}") from None

    def document(self) -> dict[str, Any]:
        """What `write` writes."""
        found: dict[str, Any] = {"format": FORMAT, "units": UNITS, "axes": AXES}
        found |= {"law": self.law.name, **self.law.parameters}
        found["joints"] = {JOINTS[j]: self._entry(j) for j in range(NUM_JOINTS) if self.known[j]}
        found["exchange"] = self.exchange._asdict()
        if self.score != ANY_SCORE:
            found["score"] = {name: list(part) for name, part in self.score._asdict().items()}
        if self.times is not None:
            found["times"] = self.times.document()
        return found | {"outlier_radius": self.outlier_radius, "learned": dict(self.learned)}

    def _entry(self, joint: int) -> dict[str, Any]:
        entry: dict[str, Any] = {
            "sigma": float(self.sigma[joint]),
            "inlier": float(self.inlier[joint]),
            "bias": self.bias[joint].tolist(),
        }
        if self.pairs[joint]:
            entry["pairs"] = int(self.pairs[joint])
        if not np.isnan(self.se[joint]).any():
            entry["se"] = self.se[joint].tolist()
        if self.definition[joint].any():
            entry["definition"] = self.definition[joint].tolist()
        if self.definition_sd[joint].any():
            entry["definition_sd"] = self.definition_sd[joint].tolist()
        return entry

    def write(self, path: str | os.PathLike) -> None:
        """Writes what `read` reads, whole or not at all.

        Parameters
        ----------
        path
            The file.

        Raises
        ------
        BadInput
            Where it cannot be written.
        """
        with replacing(path) as place:
            text = json.dumps(self.document(), indent=1, ensure_ascii=False, allow_nan=False)
            place.write_text(text + "\n", encoding="utf-8")


def _require_format(document: Any, source: str) -> None:
    """Raises `BadInput` unless the document says that it is an error law, and has its keys only."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BadInput(f'{source} does not begin with "format": "{FORMAT}"; {_ADVICE}')
    for name in ("law", "joints"):
        if name not in document:
            raise BadInput(f"{source} lacks {name!r}; {_ADVICE}")
    _require_keys(document, _KEYS, "an error law", source)
    for name, wanted in (("units", UNITS), ("axes", AXES)):
        if document.get(name, wanted) != wanted:
            raise BadInput(
                f"{source}: {name} must be {wanted!r}, not {shown(document[name])}; bring the law"
                " to these, or leave the line out where it is in them"
            )


def _require_keys(entry: Mapping[str, Any], known: set[str], what: str, source: str) -> None:
    for name in entry:
        if name not in known:
            raise BadInput(
                f"{source}: {what} has no {shown(name)}; it may have {', '.join(sorted(known))}"
            )


class _Joints:
    """The joints' arrays, as they are read."""

    def __init__(self) -> None:
        self.sigma = np.full(NUM_JOINTS, np.nan)
        self.inlier = np.full(NUM_JOINTS, np.nan)
        self.bias = np.full((NUM_JOINTS, 2), np.nan)
        self.se = np.full((NUM_JOINTS, 4), np.nan)
        self.pairs = np.zeros(NUM_JOINTS, int)
        self.definition = np.zeros((NUM_JOINTS, 3))
        self.definition_sd = np.zeros((NUM_JOINTS, 3))

    def take(self, name: str, entry: Any, source: str) -> None:
        """A joint's entry. Raises `BadInput` on an unknown joint, and on what is no entry."""
        if name not in JOINT_INDEX:
            raise BadInput(
                f"{source} has a joint {shown(name)}, which the skeleton has not; choose among"
                f" {', '.join(JOINTS)}"
            )
        joint, entry = JOINT_INDEX[name], _object(entry, name, source)
        _require_keys(entry, _JOINT_KEYS, name, source)
        if "sigma" not in entry:
            raise BadInput(f"{source}: {name} lacks 'sigma'; {_ADVICE}")
        self.sigma[joint] = _finite(entry["sigma"], f"sigma of {name}", source)
        self.inlier[joint] = _finite(entry.get("inlier", 1.0), f"inlier of {name}", source)
        self.bias[joint] = 0.0
        for key, count in (("bias", 2), ("definition", 3), ("definition_sd", 3), ("se", 4)):
            if key in entry:
                row = _numbers(entry[key], count, f"{key} of {name}", source)
                getattr(self, key)[joint] = row
        self.pairs[joint] = _count(entry.get("pairs", 0), f"pairs of {name}", source)


def _exchange(entry: Any, source: str) -> Exchange:
    entry = _object(entry, "exchange", source)
    _require_keys(entry, set(Exchange._fields), "exchange", source)
    return Exchange(
        **{name: _finite(p, f"exchange of {name}", source) for name, p in entry.items()}
    )


def _score(entry: Any, source: str) -> ScoreFactor:
    if entry is None:
        return ANY_SCORE
    entry = _object(entry, "score", source)
    _require_keys(entry, set(ScoreFactor._fields), "score", source)
    parts = (entry.get(name) for name in ScoreFactor._fields)
    edges, factors = (
        tuple(_numbers(part, None, f"score {name}", source).tolist())
        for part, name in zip(parts, ScoreFactor._fields, strict=True)
    )
    return ScoreFactor(edges, factors)


def _times(entry: Any, source: str) -> ErrorTimes | None:
    if entry is None:
        return None
    entry = _object(entry, "times", source)
    _require_keys(entry, set(ErrorTimes._fields), "times", source)
    numbers = {
        name: _finite(entry.get(name), f"times {name}", source)
        for name in ErrorTimes._fields
        if name != "se"
    }
    errors = _object(entry.get("se", {}), "times se", source)
    known = {name: one for name, one in errors.items() if one is not None}
    _require_keys(known, set(WITH_SE), "times se", source)
    given = {name: _finite(one, f"times se {name}", source) for name, one in known.items()}
    return ErrorTimes(**numbers, se=np.array([given.get(name, np.nan) for name in WITH_SE]))


def _object(value: Any, name: str, source: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise BadInput(f"{source}: {name} must be an object, not {shown(value)}")
    return value


def _finite(value: Any, name: str, source: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise BadInput(f"{source}: {name} must be a number, not {shown(value)}")
    if not abs(value) < 1e300:  # false for NaN too
        raise BadInput(f"{source}: {name} must be a finite number, not {shown(value)}")
    return float(value)


def _count(value: Any, name: str, source: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**53:
        raise BadInput(f"{source}: {name} must be a whole number, not {shown(value)}")
    return value


def _numbers(value: Any, count: int | None, name: str, source: str) -> np.ndarray:
    """The numbers of a list, `count` of them or any."""
    if not isinstance(value, list) or count not in (None, len(value)):
        wanted = "a list of numbers" if count is None else f"{count} numbers"
        raise BadInput(f"{source}: {name} must be {wanted}, not {shown(value)}")
    return np.array([_finite(one, name, source) for one in value], dtype=np.float64)
