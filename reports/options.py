"""The options that several commands share, each declared once, and what they become.

A group is a frozen class whose fields are options; a command's settings (`settings`) hold groups
and options of its own, and `cli` makes one command line of them all. Nothing here imports JAX
before it is needed, so that `--help` is quick."""

import dataclasses
import enum
import functools
import math
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from typer import Argument, Option

from poseterior.probmodel.errors import LAW_NAMES
from poseterior.probmodel.failures import BadInput
from poseterior.reports import configuration, console
from poseterior.reports.fields import option

if TYPE_CHECKING:
    import numpy as np

    from poseterior.inference import Estimating
    from poseterior.inference.machines import Machines
    from poseterior.probmodel import (
        Anatomy,
        DetectedFrame,
        Detection,
        Estimate,
        Lens,
        Likelihood,
        PoseModel,
    )

SAMPLERS = (
    *("rejection", "rejection-group", "rejection-prior"),
    *("emcee", "emcee-de", "aies", "ess", "nuts", "hmc"),
    *("random-walk", "sa", "smc", "nss", "nautilus"),
    "rejection-device",
)
"""Those of `inference.SAMPLERS`, as a test makes sure: `--help` names them without importing
JAX."""
ROUTES = ("weighted-roots", "rejection")
"""Samplers of an uncertain root that are not baselines: the first two of `ROOTED`."""
ROOTED = (*ROUTES, "emcee", "emcee-de", "aies", "ess", "random-walk", "sa")
"""The samplers with an uncertain root, `inference.sampler.ROOTED_SAMPLERS`."""
PROGRAMS = "POSETERIOR_PROGRAMS"
"""The variable of `probmodel.programs`, which imports JAX."""
MOST_ROOTS, FURTHER = 100_000, 16
"""`inference.importance.weighted.MOST_ROOTS`; and how many times as many roots as were asked for
are drawn where these are too few."""
LARGEST_SIDE = 10**6
"""Pixels; no image is larger."""
SMALLEST_FACTOR = 1e-6
"""Areas of discs smaller than this, or larger than its inverse, would in the end overflow."""


class JudgedBy(enum.StrEnum):
    """What posteriors are judged by."""

    coordinates = "coordinates"
    measures = "measures"


Factor = Annotated[
    float, Option(help="The factor in the radius τ of a detection's disc (the paper: 0.25).")
]
LIMITS_HELP = (
    "'default'; 'wide', with twice the margins around what was seen; a .npz from `poseterior"
    " learn`; or the published .mat."
)
Limits = Annotated[str, Option(help=LIMITS_HELP)]
LimitsOfPoses = Annotated[
    str | None, Option(help=LIMITS_HELP, show_default="those that the poses were drawn under")
]
NumSamples = Annotated[int, Option(min=1, max=10_000_000, help="How many poses to draw.")]
Seed = Annotated[int, Option(min=0, max=2**32 - 1, help="The same seed gives the same draws.")]
Roots = Annotated[
    int, Option(min=1, max=MOST_ROOTS, help="From how many torsos and cameras, if uncertain.")
]
Upright = Annotated[
    float | None,
    Option(
        min=1,
        max=90,
        help="How far a back is tilted from the image's vertical, standard deviation each way in"
        " degrees (--root uncertain).",
        show_default="any way round is as probable as any other",
    ),
]
KnownLenses = Annotated[
    bool,
    Option(
        "--perspective",
        help="Focal lengths of calibrated cameras are known (as by --focal): what weak perspective"
        " cannot explain is no error.",
    ),
]
Hypotheses = Annotated[int, Option(help="How many diverse hypotheses of each person.")]
Composed = Annotated[
    bool,
    Option(
        "--composed",
        help="Put hypotheses together of limbs of draws: possible poses, more like the means of"
        " clusters than any draw.",
    ),
]

JointOrder = Annotated[
    str | None,
    Option(
        "--layout",
        help="Order of a detector's joints, where files do not say it: coco_17, halpe_26, ….",
    ),
]
CameraNoise = Annotated[
    str,
    Option(help="Of synthetic cameras: none, gaussian:SIZE, heavy-tailed:SIZE (of body height)."),
]
Keypoints2D = Annotated[str, Option(help="Human3.6M's 2D file, data_2d_h36m_NAME.npz.")]
WhoseFilm = Annotated[int | None, Option(help="Whose film, in a stream of several people.")]
RigNames = Annotated[
    Path | None,
    Option(
        "--names",
        help="JSON object of the names of joints or markers in motion capture (.bvh, .trc, .c3d)"
        " → ours.",
        show_default="those of most programs are known",
    ),
]
Judged = Annotated[
    JudgedBy,
    Option(
        "--of",
        help="What is judged: coordinates, or measures (joint angles, lengths and steps).",
    ),
]
Open = Annotated[bool, Option("--open", help="Open the page in a browser.")]
Double = Annotated[
    bool,
    Option(
        "--double",
        help="Write joints, keypoints and densities in double precision: files twice as large.",
    ),
]


class UpperMeasure(enum.StrEnum):
    """What "uniform" means for upper bones."""

    angle = "angle"
    area = "area"


class LowerMeasure(enum.StrEnum):
    """What "uniform" means for lower bones."""

    area = "area"
    box = "box"


class ExportFormat(enum.StrEnum):
    """What results are exported to."""

    bvh = "bvh"
    c3d = "c3d"
    trc = "trc"
    gltf = "gltf"
    csv = "csv"
    npz = "npz"
    mot = "mot"
    sto = "sto"


class FilmPose(enum.StrEnum):
    """What of each frame a film is made of."""

    mean = "mean"
    hypothesis = "hypothesis"


class LengthUnit(enum.StrEnum):
    """What exported lengths are in."""

    m = "m"
    mm = "mm"


class LearnedLaw(enum.StrEnum):
    """What laws of a detector's errors are learned."""

    gaussian = "gaussian"
    student = "student"


@dataclass(frozen=True, kw_only=True)
class Screen:
    """How a command speaks: with progress or without, in tables or JSON."""

    config: Path | None = option(
        None,
        "A TOML file of options by their names: num-samples = 1000. What is on the command"
        " line wins.",
        is_eager=True,
        callback=configuration.take,
    )
    quiet: bool = option(False, "No progress.", "--quiet")
    json: bool = option(False, "Results on stdout as JSON instead of a table.", "--json")


def anatomy_of(limits: str) -> "Anatomy":
    """Embedded tables by their name, or those of a file. Raises `BadInput` on one that is not of
    limits."""
    from poseterior.probmodel import Anatomy
    from poseterior.probmodel.anatomy.limits import EMBEDDED

    return Anatomy.embedded(limits) if limits in EMBEDDED else Anatomy.load(Path(limits))


@dataclass(frozen=True, kw_only=True)
class Prior:
    """What anatomy allows: limits, and the measures in which directions are uniform."""

    PANEL: ClassVar = "The prior"
    limits: Limits = "default"
    upper: UpperMeasure = option(
        UpperMeasure.angle, "Measure in which upper bones are uniform; angle is eq. 7."
    )
    lower: LowerMeasure = option(
        LowerMeasure.area, "Measure in which lower bones are uniform; area is eq. 8."
    )

    def anatomy(self) -> "Anatomy":
        """The tables. Raises `BadInput` on a limits file that is not one."""
        return anatomy_of(self.limits)

    def model(self, *, upright: float = 0.0) -> "PoseModel":
        """The model. Raises `BadInput` on a limits file that is not one."""
        from poseterior.probmodel import PoseModel

        return PoseModel.from_anatomy(
            self.anatomy(), upper=self.upper, lower=self.lower, upright=upright
        )


@dataclass(frozen=True, kw_only=True)
class Detected:
    """Detections in a file, and what the user knows of it that it does not say itself."""

    PANEL: ClassVar = "How detections are read"
    format: str = option("auto", "The file's format; 'auto' looks at its content.")
    threshold: float | None = option(
        None, "Joints with a score up to this are missing.", show_default="0"
    )
    image: Path | None = option(None, "The image: it says its size, and lies behind pictures.")
    image_size: str | None = option(
        None, "For coordinates that are fractions; --image says it too.", metavar="WIDTHxHEIGHT"
    )
    names: Path | None = option(
        None, "JSON object of a detector's own joint names → ours, or list in the file's order."
    )
    layout: JointOrder = None
    correct: bool = option(
        True,
        "Move midpoints to where the skeleton's thorax and pelvis are.",
        "--correct/--as-detected",
    )

    @functools.cached_property
    def photo(self) -> "np.ndarray | None":
        """`(H, W, 3)` bytes of the image, decoded once. Raises `BadInput` where it is none."""
        if self.image is None:
            return None
        from poseterior.reports.figures import read_image

        return read_image(self.image)

    @functools.cached_property
    def photo_focal(self) -> float | None:
        """The focal length that the image's EXIF says, pixels. Raises `BadInput` as `photo`."""
        if self.image is None:
            return None
        from poseterior.reports.figures.files import photo_focal

        return photo_focal(self.image)

    def frames(self, path: Path) -> "Iterator[DetectedFrame]":
        """The frames of a folder or file, lazily. Raises `BadInput` as `read_frames` does."""
        from poseterior.probmodel import read_frames

        for frame in read_frames(path, self.format, self.threshold, **self._known()):
            yield frame._replace(people=self._corrected(frame.people))

    def people(self, file: Path) -> "list[Detection]":
        """The people of a file. Raises `BadInput` on a bad file, size, image or map of names."""
        from poseterior.probmodel import read_detections

        return self._corrected(read_detections(file, self.format, self.threshold, **self._known()))

    def _known(self) -> dict[str, Any]:
        """What the user knows of a file that it does not say itself."""
        return {"image_size": self.size, "names": self._names(), "layout": self.layout}

    def _corrected(self, people: "list[Detection]") -> "list[Detection]":
        from poseterior.probmodel.layouts import corrected

        return [corrected(person) for person in people] if self.correct else people

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the image, as the user says them, or its own. Raises `BadInput` on a
        bad size or image."""
        if self.image_size is not None:
            return parse_size(self.image_size, "--image-size", "640x480")
        return None if self.photo is None else (self.photo.shape[1], self.photo.shape[0])

    def _names(self) -> dict[str, str] | list[str] | None:
        return None if self.names is None else read_names(self.names)


def read_names(path: Path) -> dict[str, str] | list[str]:
    """A map of names, or a list of them. Raises `BadInput` where the file holds neither."""
    from poseterior.probmodel.documents import read_json

    names = read_json(path, "map of names", "give a JSON object of names")
    texts = [*names, *names.values()] if isinstance(names, dict) else names
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise BadInput(f"{path} must hold an object of names, or a list of them; write texts only")
    return names


def map_of_names(path: Path | None) -> dict[str, str] | None:
    """A map of names, if there is a file of them. Raises `BadInput` where it holds something
    else."""
    names = None if path is None else read_names(path)
    if isinstance(names, list):
        raise BadInput(f"{path} must hold an object of a file's names of joints → ours, not a list")
    return names


@dataclass(frozen=True, kw_only=True)
class Person:
    """One person of a file of detections."""

    PANEL: ClassVar = Detected.PANEL
    file: Annotated[
        Path,
        Argument(help="Detections, of any detector (reports/detectors.md).", show_default=False),
    ]
    person: int = option(0, "Which person in the file, counted from 0.")
    detected: Detected = Detected()

    @functools.cached_property
    def people(self) -> "list[Detection]":
        """Everyone in the file. Raises `BadInput` on a bad file."""
        return self.detected.people(self.file)

    @functools.cached_property
    def detection(self) -> "Detection":
        """The person. Raises `BadInput` on a bad file, or where there is no such person."""
        from poseterior.probmodel.detections import pick_person

        return pick_person(self.people, self.person)

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the person's image, if anything says them."""
        return self.detected.size or self.detection.image_size

    def within(self, model: "PoseModel") -> float:
        """Metres within which the person stands, by how large the image is."""
        from poseterior.probmodel.distance import nearest

        return nearest([self.detection], self.size, model.lengths)

    def check(self) -> None:
        """Reads the file. Raises `BadInput` on a bad file, or where there is no such person."""
        self.detection  # noqa: B018


@dataclass(frozen=True, kw_only=True)
class PersonOrSession(Person):
    """One person of a file of detections, or of a folder of calibrated cameras."""

    @property
    def is_session(self) -> bool:
        """Whether it is a folder of calibrated cameras."""
        if not self.file.is_dir():
            return False
        from poseterior.probmodel.sessions import is_session

        return is_session(self.file)

    def check(self) -> None:
        """Reads the file if it is one of detections. Raises `BadInput` as `Person.check` does."""
        if not self.is_session:
            super().check()


@dataclass(frozen=True, kw_only=True)
class PersonOrResult(Person):
    """One person of a file of detections, or a result of ours in its place."""

    file: Annotated[
        Path, Argument(help="Detections, of any detector; or a result.", show_default=False)
    ]

    @property
    def is_result(self) -> bool:
        """Whether it is a posterior.nc, or a folder of ours."""
        return self.file.suffix.lower() == ".nc" or self.file.is_dir()

    def check(self) -> None:
        """Reads the file if it is one of detections. Raises `BadInput` as `Person.check` does."""
        if not self.is_result:
            super().check()


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """How torso, camera and discs come out of a detection."""

    PANEL: ClassVar = "Torso, camera and discs"
    estimator: str = option(
        "dictionary",
        "How torso and camera are estimated: dictionary, akhter-black, zhou, or FILE.npz"
        " with `joints` (people, 15, 3), the poses of another estimator in camera axes.",
    )
    poses: str = option(
        "default", "Pose dictionaries: 'default', or a .npz from `poseterior learn --poses`."
    )
    candidates: int = option(
        2, "Most torso-and-camera candidates kept; 1 is the paper's method.", min=1
    )
    factor: Factor = 0.25
    errors: str | None = option(
        None,
        f"Law of a detection's error: {', '.join(LAW_NAMES)} (the paper's is disc), learned"
        " (the embedded one of real detections), or FILE.json from `poseterior calibrate`."
        " The last two have outliers, and need --root uncertain. By default disc for one view, and"
        " learned for several cameras.",
    )
    outliers: float | None = option(
        None, "How probable it is that a keypoint is an outlier (--root uncertain)."
    )
    exchanges: float | None = option(
        None, "How probable it is that left and right are exchanged (--root uncertain)."
    )
    head: bool = option(True, "Whether a detected head counts in the likelihood (the paper: no).")

    def likelihood(self, usual: str = "disc") -> "Likelihood":
        """How detections err; by the `usual` law where none is named. Raises `BadInput` on a bad
        factor, law or probability."""
        from poseterior.probmodel.errors.faults import FaultPrior

        likelihood = self._law(self.errors or usual)
        if self.outliers is None and self.exchanges is None:
            return likelihood
        given = likelihood.faults
        said = FaultPrior.of(self.outliers or 0.0, self.exchanges or 0.0)
        outlier = given.outlier if self.outliers is None else said.outlier
        exchange = given.exchange if self.exchanges is None else said.exchange
        faults = FaultPrior(outlier, exchange, given.reach)
        return dataclasses.replace(likelihood, faults=faults)

    def _law(self, errors: str) -> "Likelihood":
        from poseterior.probmodel import Likelihood
        from poseterior.probmodel.detections import LIKELIHOOD_JOINTS, LIMB_JOINTS
        from poseterior.probmodel.errors.detector import DetectorErrors
        from poseterior.probmodel.errors.laws import LAWS

        if not SMALLEST_FACTOR <= self.factor <= 1 / SMALLEST_FACTOR:  # false for NaN too
            limits = f"{SMALLEST_FACTOR:g} and {1 / SMALLEST_FACTOR:g}"
            raise BadInput(
                f"--factor must lie between {limits}, not {self.factor:g}; the paper has 0.25"
            )
        joints = LIKELIHOOD_JOINTS if self.head else LIMB_JOINTS
        law = LAWS.get(errors)
        if law is not None:
            return Likelihood(law(), factor=self.factor, joints=joints)
        if errors == "learned":
            return Likelihood.of(DetectorErrors.default(), joints)
        if not Path(errors).exists():
            raise BadInput(
                f"there is no error law {errors}; --errors takes {', '.join(LAWS)}, learned,"
                " or a file that `poseterior calibrate` wrote"
            )
        return Likelihood.of(DetectorErrors.read(errors), joints)

    def estimating(self, model: "PoseModel") -> "Estimating":
        """How people are estimated. Raises `BadInput` on a bad factor or a bad file of poses."""
        import numpy as np

        from poseterior.inference import Estimating
        from poseterior.probmodel.learning.dictionaries import PoseDictionary

        return Estimating(
            self.estimator,
            np.asarray(model.torsos),
            model.limits,
            None if self.poses == "default" else PoseDictionary.load(self.poses),
            self.candidates,
            self.likelihood(),
        )

    def estimate(self, detection: "Detection", model: "PoseModel") -> "Estimate":
        """Torso and camera candidates of a person; warns where the estimator did not converge.
        Raises `BadInput` where the torso is not seen well enough."""
        (frame,) = self.estimating(model)([detection])
        if not frame.converged:
            console.warn(
                f"the estimator {self.estimator} did not converge for {detection.where}; its best"
                " fit is used"
            )
        return frame


def concentration(upright: float | None) -> float:
    """What the model believes where backs are tilted by so many degrees; 0 where nobody says."""
    return 0.0 if upright is None else math.radians(upright) ** -2


ESTIMATED = ("estimator", "poses", "candidates", "chains")
"""Options of torsos and cameras that are estimated and held fixed."""


OF_ONE_VIEW = (
    *("person", "composed", "recalibrated", "estimator", "poses", "candidates", "root", "roots"),
    *("most_roots", "upright", "focal", "principal", "format", "threshold", "image", "image_size"),
    *("names", "correct"),
)
"""Options that calibrated cameras, which see one body, do not have."""


def flag(name: str) -> str:
    """What an option is called on the command line."""
    return "--" + name.replace("_", "-")


def require_meaning_in_views(given: Set[str]) -> None:
    """Raises `BadInput` where an option was given that is not of calibrated cameras."""
    for name in OF_ONE_VIEW:
        if name in given:
            raise BadInput(
                f"{flag(name)} is not of calibrated cameras, which see one body in"
                " the world; leave it out"
            )


def parse_cameras(text: str | None) -> list[int] | None:
    """Cameras, counted from 0, from such as "1,3", in their own order; None, all. Raises `BadInput`
    otherwise."""
    try:
        return sorted(int(one) - 1 for one in text.split(",")) if text else None
    except ValueError:
        raise BadInput(f"--cameras {text} is no list of numbers; give one such as 1,3") from None


class RootKind(enum.StrEnum):
    """What torso and camera are."""

    fixed = "fixed"
    uncertain = "uncertain"

    @property
    def prior(self) -> str:
        """The prior of the root, as `probmodel.root_priors` names it."""
        return "candidates" if self is RootKind.fixed else "uncertain"


class CameraKind(enum.StrEnum):
    """What is believed of the camera that saw a person."""

    weak = "weak"
    known = "known"
    unknown = "unknown"


EXIF = "exif"
"""What `--focal` says where the photo says it."""
FAR_ENOUGH = 4.0
"""Metres to the camera: nearer, intervals under weak perspective are too narrow, and farther off
they are as good as any (reports/strangers.md)."""


def draw_lenses(samplers: Iterable[str]) -> bool:
    """Whether all of these samplers can draw a focal length that nobody knows."""
    return {*samplers} <= {*ROUTES}


@dataclass(frozen=True, kw_only=True)
class Rooting:
    """Whether torso and camera are a part of the posterior."""

    PANEL: ClassVar = Estimation.PANEL
    root: RootKind = option(
        RootKind.uncertain,
        "Torso and camera: fixed at an estimator's candidates (the paper), or uncertain and"
        " drawn with the pose.",
    )
    roots: Roots = 1000
    upright: Upright = None

    @property
    def rooted(self) -> bool:
        """Whether torso and camera are drawn with the pose."""
        return self.root == RootKind.uncertain

    def require_meaning(self, given: Set[str]) -> None:
        """Raises `BadInput` where an option was given that means nothing with this kind of root."""
        other = RootKind.fixed if self.rooted else RootKind.uncertain
        for name in ESTIMATED if self.rooted else ("roots", "most_roots"):
            if name in given:
                raise BadInput(
                    f"{flag(name)} means nothing where torso and camera are {self.root}; leave it"
                    f" out, or choose --root {other}"
                )

    def model(self, prior: Prior) -> "PoseModel":
        """The model of anatomy, with what is believed of the root. Raises `BadInput` on a limits
        file that is not one."""
        return prior.model(upright=concentration(self.upright))


@dataclass(frozen=True, kw_only=True)
class Viewing(Rooting):
    """As `Rooting`, of people whose camera may be known."""

    focal: str | None = option(
        None,
        "Focal length of the camera in pixels of the image; exif, where the photo says it"
        " (--image); unknown: one of a few that cameras have, drawn with the rest (--root"
        " uncertain); or weak, for weak perspective.",
        metavar="PIXELS|exif|unknown|weak",
        show_default="unknown where the image's size says that people are within"
        f" {FAR_ENOUGH:g} m, else weak",
    )
    principal: str | None = option(
        None,
        "Where the camera's optical axis meets the image, pixels (--focal).",
        metavar="X,Y",
        show_default="the image's centre",
    )

    @property
    def asks_how_near(self) -> bool:
        """Whether it is the people's distance that says what is believed of the camera."""
        return self.focal is None and self.rooted

    def seen_by(
        self,
        model: "PoseModel",
        metres: float,
        size: tuple[int, int] | None,
        exif: float | None = None,
        samplers: Iterable[str] = ROUTES,
    ) -> "PoseModel":
        """A model before the camera of images of this width and height and with this focal length
        in their EXIF, if they are known, within so many `metres` of somebody; for `samplers`, not
        all of which can draw a focal length. Raises `BadInput` on a camera that cannot be, or whose
        optical axis nobody knows."""
        near = metres < FAR_ENOUGH and self.asks_how_near and draw_lenses(samplers)
        camera = CameraKind.unknown if near else CameraKind.weak
        said = camera if self.focal is None else self.focal
        return model.seen_by(self._lens(said, size, exif))

    def model_of(
        self, prior: Prior, person: Person, samplers: Iterable[str] = ROUTES
    ) -> "PoseModel":
        """As `model`, before the camera of a person's image."""
        model, exif = self.model(prior), person.detected.photo_focal
        return self.seen_by(model, person.within(model), person.size, exif, samplers)

    def _lens(self, said: str, size: tuple[int, int] | None, exif: float | None) -> "Lens | None":
        import numpy as np

        from poseterior.probmodel.camera import Lens

        if said == CameraKind.weak:
            if self.principal is not None:
                raise BadInput(
                    "--principal says nothing under weak perspective; give --focal with it, in"
                    " pixels or unknown, or leave it out"
                )
            return None
        if said == CameraKind.unknown and not self.rooted:
            raise BadInput(
                "--focal unknown needs torso and camera to be uncertain; leave --root fixed out"
            )
        if said == EXIF and exif is None:
            raise BadInput(
                "--focal exif needs a photo (--image) whose EXIF says FocalLengthIn35mmFilm, which"
                " many programs leave out; give pixels, or --focal unknown"
            )
        unknown = said == CameraKind.unknown
        focal = None if unknown else exif if said == EXIF else parse_focal(said)
        if size is None and focal is None:
            raise BadInput(
                "--focal unknown needs the size of the image, by which cameras' focal lengths are"
                " believed, and the file does not say it; give --image, or --image-size 640x480"
            )
        if size is None and self.principal is None:
            raise BadInput(
                "--focal needs to know where the optical axis meets the image, whose size the file"
                " does not say; give --image, --image-size 640x480, or --principal 320,240"
            )
        principal = (
            np.array(size) / 2
            if self.principal is None
            else parse_point(self.principal, "--principal", "320,240")
        )
        if (
            size is not None
            and np.isfinite(principal).all()
            and ((principal < 0) | (principal > size)).any()
        ):
            raise BadInput(
                f"--principal {self.principal} lies outside the image of {size[0]}x{size[1]}"
                " pixels; it is where the camera's optical axis meets the image, usually near its"
                " centre"
            )
        if focal is not None:
            return Lens(focal, principal)
        assert size is not None  # or nothing would be known of the focal length
        return Lens.unknown(max(size), principal)


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How many draws, from which seed, within which budget."""

    PANEL: ClassVar = "Sampling"
    num_samples: NumSamples = 10_000
    seed: Seed = 0
    max_proposals: int = option(
        1_000_000_000, "Most proposals for a person before the sampler gives up.", min=1
    )


@dataclass(frozen=True, kw_only=True)
class Workforce:
    """Who does the work."""

    PANEL: ClassVar = "Many machines"
    workers: int = option(1, "Processes of this machine that share the work.", min=1)
    scheduler: str | None = option(None, "Address of a dask scheduler, whose workers do it.")

    def machines(self) -> "Machines":
        """The same, as `inference` takes it."""
        from poseterior.inference.machines import Machines

        return Machines(self.workers, self.scheduler)


@dataclass(frozen=True, kw_only=True)
class Drawing(Viewing):
    """As `Viewing`, where roots that are too few are drawn anew."""

    most_roots: int | None = option(
        None,
        "From how many at most: where fewer than 20 count, as many as would do are drawn.",
        min=1,
        max=MOST_ROOTS,
        show_default=f"{FURTHER} times --roots",
    )

    @property
    def most(self) -> int:
        """How many roots at most."""
        return min(FURTHER * self.roots, MOST_ROOTS) if self.most_roots is None else self.most_roots


def parse_focal(text: str) -> float:
    """Pixels from such as "1650". Raises `BadInput` otherwise."""
    try:
        return float(text)
    except ValueError:
        raise BadInput(
            f"--focal must be pixels of the image, such as 1650, exif, unknown or weak, not"
            f" {text!r}"
        ) from None


def parse_point(text: str, option: str, example: str) -> "np.ndarray":
    """`(2,)` from such as "320,240.5". Raises `BadInput` otherwise."""
    import numpy as np

    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} must look like {example}, not {text!r}") from None
    return np.array([x, y])


def parse_size(text: str, option: str, example: str) -> tuple[int, int]:
    """Width and height from such as "640x480". Raises `BadInput` otherwise."""
    width, _, height = text.partition("x")
    sides = [int(side) for side in (width, height) if side.isdecimal() and len(side) < 8]
    if len(sides) != 2 or not all(0 < side < LARGEST_SIDE for side in sides):
        raise BadInput(f"{option} must look like {example}, not {text!r}")
    return sides[0], sides[1]


def check(settings: object) -> None:
    """Reads the files that settings, or a group of theirs, can refuse by themselves: a refusal need
    not wait for what a command imports.

    Raises
    ------
    BadInput
        On a file that cannot be used.
    """
    for one in (*vars(settings).values(), settings):
        if hasattr(one, "check"):
            one.check()


OUTPUTS = ("out", "poses")
"""Options that name what is written; of `learn`, poses are too."""
_OF_A_RESULT = re.compile(r"(hypotheses|run)\.json|.*\.nc")
"""Files in a folder of results that are read."""


def require_other_files(values: Mapping[str, Any]) -> None:
    """Raises `BadInput` where what is to be written is something that is read, or, where that is a
    folder of results, a part of it."""
    outputs = {name: values.get(name) for name in OUTPUTS}
    given = [one for name, one in values.items() if name not in OUTPUTS]
    flat = [one for each in given for one in (each if isinstance(each, list) else [each])]
    read = [Path(one) for one in flat if isinstance(one, str | Path)]
    for name, out in outputs.items():
        if not isinstance(out, Path) or not out.exists():
            continue
        for path in read:
            inside = path.is_dir() and out.parent.samefile(path)
            part = inside and _OF_A_RESULT.fullmatch(out.name)
            if path.exists() and (part or out.samefile(path)):
                raise BadInput(
                    f"--{name} {out} would replace what is read from {path}; choose another name"
                )


def require_meaning(settings: object, given: Set[str]) -> None:
    """Raises `BadInput` where an option was given that settings, or a group of theirs, know to mean
    nothing beside the others."""
    for one in (settings, *vars(settings).values()):
        if hasattr(one, "require_meaning"):
            one.require_meaning(given)


def prepare_jax() -> None:
    """64-bit floats, before anything is compiled: limits are decided to the last bits. Compiled
    code is kept in the user's cache folder, so that only the first run on a machine waits for the
    compiler."""
    settings = {"jax_enable_x64": True} | _jax_cache()
    if "jax_compilation_cache_dir" in settings:
        os.environ.setdefault(PROGRAMS, settings["jax_compilation_cache_dir"])
    if "jax" not in sys.modules:  # it reads these when something needs it; a refusal does not
        os.environ.update({name.upper(): str(value) for name, value in settings.items()})
        return
    import jax

    for name, value in settings.items():
        jax.config.update(name, value)


def _cache() -> Path | None:
    """The folder of what is compiled: the user's, or, where nobody may write to that, the one among
    the temporary folders that has the compiled loops too."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "poseterior"
        cache.mkdir(parents=True, exist_ok=True)
        if os.access(cache, os.W_OK):
            return cache
    except (OSError, RuntimeError):  # RuntimeError: a user without a home
        pass
    from poseterior.inference.exact.loops.cache_folder import temporary

    own = temporary()
    if own is not None:  # matplotlib looks for fonts once, too
        os.environ.setdefault("MPLCONFIGDIR", str(own / "matplotlib"))
    return own


def _jax_cache() -> dict[str, Any]:
    """Where JAX keeps compiled code, and what of it; nothing where it cannot."""
    cache = _cache()
    if cache is None:
        return {}  # without a cache everything works, only slower
    return {
        "jax_compilation_cache_dir": str(cache),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
