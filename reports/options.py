"""The options that several commands share, and how they become a model and a frame."""

import enum
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from reports import console

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inference import Frame
    from probmodel import Anatomy, DetectedFrame, Detection, PoseModel

File = Annotated[
    Path,
    typer.Argument(help="Detections, of any detector (reports/detectors.md).", show_default=False),
]
Limits = Annotated[
    str, typer.Option(help="'default', a .npz from `poseterior learn`, or the published .mat.")
]
Estimator = Annotated[
    str,
    typer.Option(
        help=(
            "How torso and camera are estimated: dictionary, akhter-black, zhou, or FILE.npz with"
            " `joints` (people, 15, 3), the poses of another estimator in camera axes."
        )
    ),
]
Poses = Annotated[
    str,
    typer.Option(help="Pose dictionaries: 'default', or a .npz from `poseterior learn --poses`."),
]
Format = Annotated[str, typer.Option(help="The file's format; 'auto' looks at its content.")]
Person = Annotated[int, typer.Option(help="Which person in the file, counted from 0.")]
Seed = Annotated[
    int, typer.Option(min=0, max=2**32 - 1, help="The same seed gives the same draws.")
]
NumSamples = Annotated[int, typer.Option(min=1, max=10_000_000, help="How many poses to draw.")]
Candidates = Annotated[
    int, typer.Option(min=1, help="Most torso-and-camera candidates kept; 1 is the paper's method.")
]
Factor = Annotated[
    float, typer.Option(help="The factor in the radius τ of a detection's disc (the paper: 0.25).")
]
Threshold = Annotated[
    float | None, typer.Option(help="Joints with a score up to this are missing.", show_default="0")
]
Head = Annotated[
    bool, typer.Option(help="Whether a detected head counts in the likelihood (the paper: no).")
]
Image = Annotated[Path | None, typer.Option(help="The image, drawn behind the detections.")]
ImageSize = Annotated[
    str | None,
    typer.Option(
        metavar="WIDTHxHEIGHT", help="For coordinates that are fractions; --image says it too."
    ),
]
Names = Annotated[
    Path | None,
    typer.Option(
        help="JSON object of a detector's own joint names → ours, or list in the file's order."
    ),
]
Correct = Annotated[
    bool,
    typer.Option("--correct", help="Move midpoints to where the skeleton's thorax and pelvis are."),
]
MaxProposals = Annotated[
    int, typer.Option(min=1, help="Most proposals of rejection before it gives up (exit code 3).")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress.")]
Json = Annotated[bool, typer.Option("--json", help="Results on stdout as JSON instead of a table.")]


class UpperMeasure(enum.StrEnum):
    """What "uniform" means for upper bones."""

    angle = "angle"
    area = "area"


class LowerMeasure(enum.StrEnum):
    """What "uniform" means for lower bones."""

    area = "area"
    box = "box"


Upper = Annotated[
    UpperMeasure, typer.Option(help="Measure in which upper bones are uniform; angle is eq. 7.")
]
Lower = Annotated[
    LowerMeasure, typer.Option(help="Measure in which lower bones are uniform; area is eq. 8.")
]


@dataclass(frozen=True)
class Belief:
    """What is believed, as the command line says it: limits and measures."""

    limits: str = "default"
    upper: str = "angle"
    lower: str = "area"

    def anatomy(self) -> "Anatomy":
        """The tables. Raises `BadInput` on a limits file that is not one."""
        from probmodel import Anatomy

        return Anatomy.default() if self.limits == "default" else Anatomy.load(Path(self.limits))

    def model(self) -> "PoseModel":
        """The model. Raises `BadInput` on a limits file that is not one."""
        from probmodel import PoseModel

        return PoseModel.from_anatomy(self.anatomy(), upper=self.upper, lower=self.lower)


SMALLEST_FACTOR = 1e-6
"""Areas of discs smaller than this, or larger than its inverse, would in the end overflow."""


@dataclass(frozen=True)
class Known:
    """What the user knows of a file of detections that it does not say itself."""

    image_size: str | None = None
    names: Path | None = None
    correct: bool = False
    image: Path | None = None

    def frames(self, path: Path, format: str, threshold: float | None) -> "Iterator[DetectedFrame]":
        """The frames of a folder or file, lazily. Raises `BadInput` as `read` does."""
        from probmodel import read_frames
        from probmodel.layouts import corrected

        for frame in read_frames(
            path, format, threshold, image_size=self._size(), names=self._names()
        ):
            yield (
                frame._replace(people=[corrected(person) for person in frame.people])
                if self.correct
                else frame
            )

    def read(self, file: Path, format: str, threshold: float | None) -> "list[Detection]":
        """The people of a file. Raises `BadInput` on a bad file, size, image or map of names."""
        from probmodel import read_detections
        from probmodel.layouts import corrected

        size, names = self._size(), self._names()
        people = read_detections(file, format, threshold, image_size=size, names=names)
        return [corrected(person) for person in people] if self.correct else people

    def _size(self) -> tuple[int, int] | None:
        from probmodel import BadInput

        if self.image_size is not None:
            width, _, height = self.image_size.partition("x")
            if not (
                width.isdecimal()
                and height.isdecimal()
                and 0 < int(width) < 10**6
                and 0 < int(height) < 10**6
            ):
                raise BadInput(f"--image-size must look like 640x480, not {self.image_size!r}")
            return int(width), int(height)
        if self.image is None:
            return None
        from reports.figures import read_image

        height_width = read_image(self.image).shape
        return height_width[1], height_width[0]

    def _names(self) -> dict[str, str] | list[str] | None:
        from probmodel import BadInput
        from probmodel.documents import read_json

        if self.names is None:
            return None
        names = read_json(self.names, "map of names", "give a JSON object of names")
        texts = (
            [*names, *names.values()]
            if isinstance(names, dict)
            else names
            if isinstance(names, list)
            else [None]
        )
        if not all(isinstance(text, str) for text in texts):
            raise BadInput(
                f"{self.names} must hold an object of names, or a list of them; write texts only"
            )
        return names


@dataclass(frozen=True)
class Sight:
    """Which person of which file, and how torso, camera and discs come out of it."""

    file: Path
    format: str = "auto"
    person: int = 0
    estimator: str = "dictionary"
    candidates: int = 2
    factor: float = 0.25
    threshold: float | None = None
    head: bool = True
    poses: str = "default"
    known: Known = Known()

    def people(self) -> "list[Detection]":
        """Everyone in the file. Raises `BadInput` on a bad file."""
        return self.known.read(self.file, self.format, self.threshold)

    def detection(self) -> "Detection":
        """The person. Raises `BadInput` on a bad file, or where there is no such person."""
        from probmodel.detections import pick_person

        return pick_person(self.people(), self.person)

    def settings(self, model: "PoseModel") -> dict[str, Any]:
        """How `inference.estimate_torso` is to be called. Raises `BadInput` on a bad factor or a
        bad file of poses."""
        import numpy as np

        from probmodel.detections import LIKELIHOOD_JOINTS, LIMB_JOINTS
        from probmodel.failures import BadInput
        from probmodel.learning.dictionaries import PoseDictionary

        if not SMALLEST_FACTOR <= self.factor <= 1 / SMALLEST_FACTOR:  # false for NaN too
            limits = f"{SMALLEST_FACTOR:g} and {1 / SMALLEST_FACTOR:g}"
            raise BadInput(
                f"--factor must lie between {limits}, not {self.factor:g}; the paper has 0.25"
            )
        return {
            "torsos": np.asarray(model.torsos),
            "limits": model.limits,
            "poses": None if self.poses == "default" else PoseDictionary.load(self.poses),
            "num_candidates": self.candidates,
            "factor": self.factor,
            "joints": LIKELIHOOD_JOINTS if self.head else LIMB_JOINTS,
        }

    def frame(self, model: "PoseModel") -> "Frame":
        """The person with torso and camera candidates; says so where the estimator did not
        converge. Raises `BadInput` where the torso is not seen well enough."""
        from inference import estimate_torso

        settings = self.settings(model)
        frame = estimate_torso(self.detection(), self.estimator, **settings)
        if not frame.converged:
            where = frame.detection.where
            console.warn(
                f"the estimator {self.estimator} did not converge for {where}; its best fit is used"
            )
        return frame


def prepare_jax() -> None:
    """64-bit floats, before anything is compiled: limits are decided to the last bits. Compiled
    code is kept in the user's cache folder, so that only the first run on a machine waits for the
    compiler."""
    import jax

    jax.config.update("jax_enable_x64", True)
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "poseterior"
        cache.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: a user without a home
        return  # without a cache everything works, only slower
    if os.access(cache, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
