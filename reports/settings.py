"""What each command can be asked for: one frozen class a command, its docstring the command's
help."""

import functools
from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

from typer import Argument, Option

from poseterior.probmodel.failures import BadInput
from poseterior.reports.fields import option
from poseterior.reports.options import (
    ROOTED,
    ROUTES,
    SAMPLERS,
    CameraKind,
    CameraNoise,
    Composed,
    Detected,
    Double,
    Drawing,
    Estimation,
    ExportFormat,
    Factor,
    FilmPose,
    Hypotheses,
    JointOrder,
    Judged,
    JudgedBy,
    Keypoints2D,
    KnownLenses,
    LearnedLaw,
    LengthUnit,
    LimitsOfPoses,
    NumSamples,
    Open,
    Person,
    PersonOrResult,
    PersonOrSession,
    Prior,
    RigNames,
    Rooting,
    RootKind,
    Roots,
    Sampling,
    Seed,
    Upright,
    Viewing,
    WhoseFilm,
    Workforce,
    flag,
    map_of_names,
    parse_cameras,
    require_meaning_in_views,
)

if TYPE_CHECKING:
    from poseterior.inference.benchmark import Submission
    from poseterior.inference.footage import Footage
    from poseterior.probmodel.datasets import DataSet
    from poseterior.probmodel.instant import Instant
    from poseterior.probmodel.measures import Measure
    from poseterior.probmodel.people import Cast
    from poseterior.probmodel.sessions import Session
    from poseterior.reports.exports.smoothing import Smoother

CONTESTANTS = "rejection,emcee,aies,random-walk"
"""Of `compare`, where nobody says whom."""
OPEN = Drawing(root=RootKind.uncertain)
"""Of commands for whoever asks about a person, and not about a sampler or the paper."""
MANY_ROOTED = Rooting(roots=200)
"""Where many people are drawn from, each has fewer roots: about a second of one core."""
OPEN_MANY = Drawing(root=RootKind.uncertain, roots=MANY_ROOTED.roots)
OPEN_FILM = Drawing(root=RootKind.uncertain, roots=400)
"""As many roots as paths."""
REAL = "Real poses (with --dataset)"
"""The part of the help for options of `coverage` that mean nothing without a data set."""


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """Run the embedded example, end to end: one pose, one wrist missing, the truth drawn beside the
    hypotheses."""

    drawn: ClassVar = RootKind.fixed
    EXAMPLES: ClassVar[tuple[str, ...]] = ("demo", "demo --open", "demo --out my-demo --seed 1")
    out: Path = option(Path("demo"), "Folder for the results.")
    open: Open = False
    seed: Seed = 0


@dataclass(frozen=True, kw_only=True)
class HypothesesSettings:
    """Posterior draws and diverse hypotheses for one detected person: a picture, a page that turns,
    a table, two files.

    Of a folder of calibrated cameras they are of one body in all views, in the world's axes and mm:
    --frame says when, and there is no page."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "hypotheses frame_keypoints.json --out result",
        "hypotheses people.json --person 3 --image photo.jpg --k 8",
        "hypotheses frame.json --upright 20 --composed",
        "hypotheses frame.json --focal 1650 --image photo.jpg --errors learned",
        "hypotheses frame.json --root fixed --limits limits.npz --candidates 1",
        "hypotheses frame.json --root fixed --estimator zhou",
        "hypotheses frame.json --recalibrated wider.json",
        "hypotheses session/ --frame 20 --cameras 1,3",
    )
    person: PersonOrSession
    frame: int | None = option(None, "Which frame of calibrated cameras; the first by default.")
    cameras: str | None = option(None, "Which calibrated cameras, such as 1,3; all by default.")
    out: Path = option(
        Path("out"), "Folder for posterior.nc, hypotheses.json, hypotheses.png, hypotheses.html."
    )
    open: Open = False
    k: Hypotheses = 5
    composed: Composed = False
    double: Double = False
    recalibrated: Path | None = option(
        None,
        "File of `coverage judge --recalibrate`: intervals with its guarantee, too.",
        show_default="none",
    )
    sampling: Sampling = Sampling()
    estimation: Estimation = Estimation()
    rooting: Drawing = OPEN
    prior: Prior = Prior()

    @property
    def drawn(self) -> RootKind | None:
        """Under what kind of root it draws: its loops are compiled where they never were; None of
        several views, which have no such loops."""
        return None if self.person.is_session else self.rooting.root

    @property
    def session(self) -> "Session":
        """What calibrated cameras saw. Raises `BadInput` where it cannot be read."""
        from poseterior.probmodel.sessions import read_session

        return read_session(self.person.file, layout=self.person.detected.layout)

    def instant(self, session: "Session") -> "Instant":
        """One frame of it. Raises `BadInput` where there is no such frame or camera."""
        chosen = parse_cameras(self.cameras)
        frame = session.numbers[0] if self.frame is None else self.frame
        return session.instant(frame, chosen).judged_by(self.estimation.likelihood("learned"))

    def require_meaning(self, given: Set[str]) -> None:
        """Raises `BadInput` where an option was given that calibrated cameras do not know."""
        if self.person.is_session:
            require_meaning_in_views(given)

    def check(self) -> None:
        """Raises `BadInput` where frames or cameras are chosen of a single view."""
        if not self.person.is_session and (self.frame is not None or self.cameras):
            raise BadInput(
                f"--frame and --cameras are of calibrated cameras, and {self.person.file} is no"
                " folder with a calibration; leave them out"
            )


@dataclass(frozen=True, kw_only=True)
class SampleSettings:
    """Posterior draws of one detected person, as netCDF, and beside it a page that turns."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "sample frame.json --out posterior.nc --num-samples 100000",
        "sample frame.json --sampler rejection --num-samples 20",
        "sample frame.json --sampler emcee --num-samples 1000",
        "sample frame.json --root fixed --chains 4 --num-samples 4000 --out chains.nc",
        "sample frame.json --root fixed --candidates 1 --sampler nuts --num-samples 1000",
    )
    person: Person
    out: Path = option(
        Path("posterior.nc"), "File to write; the page has its name, with .html at the end."
    )
    open: Open = False
    sampler: str | None = option(
        None,
        f"One of {', '.join(SAMPLERS)}; with --root uncertain {', '.join(ROOTED)}.",
        show_default=f"the first; with --root uncertain {ROUTES[0]}",
    )
    chains: int = option(
        1, "Independent runs of exact rejection, which share the samples (--root fixed)."
    )
    double: Double = False
    sampling: Sampling = Sampling()
    estimation: Estimation = Estimation()
    rooting: Drawing = OPEN
    prior: Prior = Prior()

    @property
    def drawn(self) -> RootKind | None:
        """As of `HypothesesSettings`; None where the sampler has no such loops."""
        strata = self.sampler in (None, SAMPLERS[0])
        return self.rooting.root if strata or self.rooting.root == RootKind.uncertain else None


class _Film(NamedTuple):
    """The names of all frames, the sizes of their people's images, and whether they are records of
    a file that names none."""

    names: list[str]
    sizes: set[tuple[int, int] | None]
    unnamed: bool


@dataclass(frozen=True, kw_only=True)
class _ManyFrames:
    """What `frames` and `film` have in common."""

    path: Annotated[
        Path,
        Argument(
            help="A folder of detections, one file of many frames, or a folder of calibrated"
            " cameras.",
            show_default=False,
        ),
    ]
    open: Open = False
    cameras: str | None = option(None, "Which calibrated cameras, such as 1,3; all by default.")
    person: int | None = option(
        None,
        "Whose film: one person alone, counted from 0 as they are first seen.",
        min=0,
        show_default="everyone",
    )
    k: Hypotheses = 5
    workforce: Workforce = Workforce()
    sampling: Sampling = Sampling()
    detected: Detected = Detected()
    estimation: Estimation = Estimation()
    rooting: Drawing = OPEN_MANY
    prior: Prior = Prior()

    @property
    def drawn(self) -> RootKind | None:
        """As of `HypothesesSettings`."""
        return None if self.is_session else self.rooting.root

    @functools.cached_property
    def is_session(self) -> bool:
        """Whether it is a folder of calibrated cameras."""
        from poseterior.probmodel.sessions import is_session

        return is_session(self.path)

    @functools.cached_property
    def footage(self) -> "Footage":
        """What calibrated cameras filmed. Raises `BadInput` where it cannot be read, or there is no
        such camera."""
        from poseterior.inference.footage import Footage
        from poseterior.probmodel.sessions import read_session

        session = read_session(self.path, layout=self.detected.layout)
        return Footage(session, parse_cameras(self.cameras), self.estimation.likelihood("learned"))

    def require_meaning(self, given: Set[str]) -> None:
        """As of `HypothesesSettings`."""
        if self.is_session:
            require_meaning_in_views(given)

    @functools.cached_property
    def _film(self) -> "_Film":
        """All frames, looked through: what cannot be read is better found now than after hours."""
        names, sizes, unnamed = [], set(), False
        for frame in self.detected.frames(self.path):
            names.append(frame.name)
            sizes |= {person.image_size for person in frame.people}
            unnamed |= any(person.image_id is None for person in frame.people)
        return _Film(names, sizes, unnamed and not self.path.is_dir())

    @property
    def names(self) -> list[str]:
        """Of all frames."""
        return self.footage.names if self.is_session else self._film.names

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the images, where anything says them and they are all the same."""
        sizes = self._film.sizes
        return self.detected.size or (next(iter(sizes)) if len(sizes) == 1 else None)

    def doubts(self, cast: "Cast") -> list[str]:
        """What is not certain of who is who, and of which frame is when."""
        from poseterior.probmodel.formats.frames import frame_numbers

        names, said = self._film.names, list(cast.doubts)
        if self._film.unnamed and len(names) > 1:
            said.append(
                f"the records of {self.path} name no frames; each lies where the one before does,"
                f" and they are read as {len(names)} frames of one person"
            )
        if len(names) > 1 and frame_numbers(names) is None:
            said.append(
                f"the names of the frames ({names[0]}, {names[1]}, …) do not count them: they are"
                " taken in this order, without gaps"
            )
        return said

    def check(self) -> None:
        """Reads all frames. Raises `BadInput` on a bad one, or where there is nobody."""
        if self.is_session:
            self.footage  # noqa: B018
            return
        self._require_no_cameras()
        if not self._film.sizes:
            raise BadInput(
                f"{self.path} has no person in it; choose one in which the detector found some"
            )

    def _require_no_cameras(self) -> None:
        if self.cameras:
            raise BadInput(
                f"--cameras is of calibrated cameras, and {self.path} is no folder with a"
                " calibration; leave it out"
            )


@dataclass(frozen=True, kw_only=True)
class FramesSettings(_ManyFrames):
    """Posterior draws and hypotheses of everyone in many frames, written as they come; goes on
    where it was stopped."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "frames walk/ --keep 200 --out walk-posterior",
        "frames video.json --out result --num-samples 1000 --keep 100",
        "frames street.json --person 1 --out one-of-them",
        "frames walk/ --out walk-uncertain --roots 400 --upright 20",
        "frames walk/ --focal 1650 --principal 240,320",
        "frames walk/ --root fixed --out walk-of-the-paper",
        "frames session/ --cameras 1,3 --out in-the-world",
    )
    out: Path = option(
        Path("out"),
        "Folder for the stream, depth.png and hypotheses.html; a run that was stopped"
        " goes on there.",
    )
    composed: Composed = False
    keep: int = option(0, "How many draws of each person are written, 200 bytes each.")


OF_PATHS = frozenset(
    ("path", "fps", "cutoff", "k", "person", "cameras", "out", "open", "config", "quiet", "json")
)
"""Options that say something of a film whose frames have been drawn."""


@dataclass(frozen=True, kw_only=True)
class FilmSettings(_ManyFrames):
    """Whole paths of one person in a film: one body, motion that goes on from frame to frame, gaps
    filled; every frame keeps its own posterior. Goes on where it was stopped."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "film walk/ --fps 60 --out walk-film",
        "film video.json --fps 30 --person 1 --focal 1650 --principal 540,960",
        "film walk-posterior --fps 60 --out walk-film",
        "film session/ --fps 60 --cameras 1,3 --out walk-film",
    )
    fps: Annotated[
        float,
        Option(help="Frames a second, as their names number them.", show_default=False),
    ]
    out: Path = option(
        Path("out"),
        "Folder for the film, depth.png and hypotheses.html, and in frames/ what is drawn frame by"
        " frame; a run that was stopped goes on there.",
    )
    cutoff: float = option(4.0, "Motion quicker than so many Hz is taken away.")
    sampling: Sampling = Sampling(num_samples=400)
    estimation: Estimation = Estimation(errors="learned")
    rooting: Drawing = OPEN_FILM

    @property
    def keep(self) -> int:
        """All draws of a frame, which are as many as there are paths."""
        return self.sampling.num_samples

    @property
    def drawn_before(self) -> bool:
        """Whether the path is a stream of `frames`, whose draws were kept."""
        return (self.path / "run.json").is_file()

    def require_meaning(self, given: Set[str]) -> None:
        """As of `FramesSettings`; of draws that are there nothing but paths is to be made."""
        super().require_meaning(given)
        for name in sorted(given - OF_PATHS) if self.drawn_before else ():
            raise BadInput(
                f"{flag(name)} is of what is drawn, and {self.path} has been drawn"
                " already; leave it out"
            )

    def check(self) -> None:
        """As of `FramesSettings`, where draws are still to be made. Raises `BadInput` on a film
        that cannot be made of them, too."""
        from poseterior.inference.films.film import require_film

        if self.drawn_before:
            self._require_no_cameras()
            return
        require_film(self.fps, self.cutoff, self.k, self.keep)
        super().check()


@dataclass(frozen=True, kw_only=True)
class ShowSettings:
    """Draw how a file was read, joint by joint, and warn where another reading explains its people
    better. Of a result (posterior.nc, its folder, or that of a stream): write its page anew."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "show frame_keypoints.json --out overlay.png",
        "show landmarks.json --image photo.jpg --person 1",
        "show video.csv --names names.json",
        "show result --image photo.jpg --open",
    )
    person: PersonOrResult
    out: Path | None = option(
        None,
        "The picture: .png, .pdf or .svg; of a result, the page.",
        show_default="overlay.png, or hypotheses.html in the result's folder",
    )
    open: Open = False
    estimation: Estimation = Estimation()
    prior: Prior = Prior()


@dataclass(frozen=True, kw_only=True)
class DetectSettings:
    """Find people's joints in images with a heatmap network of one's own, through onnxruntime."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "detect photo.jpg --model hourglass.onnx --layout mpii_16",
        "detect *.jpg --model rtmpose.onnx --layout coco_17 --boxes people.json --out found.json",
        "detect photo.jpg --model net.onnx --layout coco_17 --box 280,44,218,346",
    )
    images: Annotated[list[Path], Argument(help="Images: PNG, JPEG, ….", show_default=False)]
    model: Annotated[Path, Option(help="A top-down heatmap network, ONNX.", show_default=False)]
    layout: Annotated[
        str, Option(help="Its joints: mpii_16, coco_17, halpe_26, ….", show_default=False)
    ]
    out: Path = option(Path("detections.json"), "File to write.")
    box: str | None = option(None, "The person; else the image.", metavar="X,Y,WIDTH,HEIGHT")
    boxes: Path | None = option(None, "COCO detection results: the people of all images.")
    least_score: float = option(0.5, "Boxes with a lower score are left out.")
    input_size: str | None = option(None, "Where the network has none.", metavar="WIDTHxHEIGHT")
    pixels: str = option("imagenet", "How pixels are normalised: imagenet, unit or bytes.")
    method: str = option("soft", "Where a joint is in its heatmap: soft or quarter.")
    threshold: float = option(
        0.002, "Joints with a score, their heatmap's mean, up to this are missing."
    )


@dataclass(frozen=True, kw_only=True)
class PriorSettings:
    """Poses from the prior: what anatomy allows before anything was seen."""

    EXAMPLES: ClassVar[tuple[str, ...]] = ("prior --num-samples 1000 --out prior.nc",)
    out: Path = option(Path("prior.nc"), "File to write.")
    num_samples: NumSamples = 10_000
    seed: Seed = 0
    prior: Prior = Prior()


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Say which bones of 3D poses break which limit, and by how many degrees."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "check posterior.nc",
        "check 01_01.amc --limits limits.npz",
    )
    file: Annotated[
        Path,
        Argument(
            help="3D poses: .nc, .json, .amc, .bvh, .trc, .c3d, .npy, .npz.", show_default=False
        ),
    ]
    limits: LimitsOfPoses = None
    names: RigNames = None


@dataclass(frozen=True, kw_only=True)
class MeasureSettings:
    """Joint angles, lengths and steps of a result, with intervals: a table, a picture, a file.

    Measures have the ISB's conventions where fifteen joints determine them; others are written as
    angle(a,b,c), inclination(a,b), distance(a,b), level(a,b), height(a) or depth(a,b) of names of
    joints. Lengths are in body units, with --height, or from calibrated cameras, in millimetres. A
    stream needs draws that were kept (`frames --keep`)."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "measure result --out measures.csv",
        "measure result/posterior.nc --measure right_knee_flexion --interval 0.9",
        "measure result --measure 'angle(right_hip,right_knee,right_ankle)' --height 1.82",
        "measure walk-posterior --person 0 --measure right_knee_flexion --out knee.csv",
    )
    result: Annotated[
        Path, Argument(help="posterior.nc, its folder, or a stream's.", show_default=False)
    ]
    measure: list[str] | None = option(
        None, "A name, or an expression; may be given again.", show_default="all that have a name"
    )
    interval: float = option(0.95, "Probability of the intervals, which are central.")
    height: float | None = option(
        None, "The person's height in metres, if it is known.", show_default="in body units"
    )
    person: WhoseFilm = None
    out: Path = option(
        Path("measures.csv"), "The table: .csv, or .nc with every draw; the picture lies beside it."
    )


@dataclass(frozen=True, kw_only=True)
class ExportSettings:
    """Write a result as BVH, C3D, TRC, glTF, CSV, .npz, .mot or .sto: hypotheses, single draws, or
    the film of a stream.

    All have x to the right of the image, y up and z towards the camera, with the pelvis at the
    origin, or, of a stream with a known focal length, the camera. Of calibrated cameras all is
    where it stands in their world, turned so that y is up. Of a stream it takes the mean of
    each frame's draws, made a body with bones of one length. Frames that are not there are gaps.
    Standard deviations of the draws are columns in CSV, markers JOINT_sd in TRC, residuals
    in C3D (root mean square distance); hypotheses.json alone knows none. C3D and glTF need
    poseterior's extra `export`."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "export result/hypotheses.json --to bvh",
        "export result/posterior.nc --to c3d --draws 100 --height 1.82",
        "export walk-posterior --to trc --person 0 --rate 25 --out walk.trc",
        "export walk-posterior --to bvh --rate 25 --smooth butterworth:6",
        "export result --to gltf --out ghosts.glb",
        "export walk-posterior --to mot --person 0 --rate 25 --measure right_knee_flexion",
    )
    result: Annotated[
        Path,
        Argument(
            help="hypotheses.json, posterior.nc, their folder, or a stream's.", show_default=False
        ),
    ]
    to: Annotated[ExportFormat, Option(help="The format.", show_default=False)]
    out: Path | None = option(None, "File to write.", show_default="the result's name, here")
    height: float | None = option(
        None,
        "The person's height in metres: head, back, upper and lower leg, and a tenth for"
        " feet and hips.",
        show_default="1.75; calibrated cameras know it",
    )
    unit: LengthUnit | None = option(None, "Of lengths.", show_default="mm; m for BVH and glTF")
    k: int | None = option(None, "How many hypotheses.", show_default="all that were chosen, or 5")
    draws: int | None = option(None, "So many single draws of a posterior.nc instead.")
    person: WhoseFilm = None
    what: FilmPose | None = option(
        None,
        "Of each frame of a stream: the mean of the draws, made a body again, or the"
        " heaviest hypothesis.",
        show_default="mean",
    )
    path_number: int | None = option(
        None, "Of a film: this one of its paths, counted from 0, instead.", metavar="NUMBER"
    )
    smooth: str | None = option(
        None,
        "Of a stream (with --rate): butterworth:6 (Hz, no lag), savgol:15 (frames) or"
        " one-euro:1 (Hz, looks back only).",
        metavar="FILTER",
        show_default="no filter",
    )
    rate: float | None = option(
        None, "Frames a second of the film.", show_default="30, which is then said"
    )
    measure: list[str] | None = option(
        None,
        "A measure, as of `measure`, for a column of CSV, .mot or .sto; may be given again.",
        show_default="none in CSV; all that have a name",
    )

    def check(self) -> None:
        """Raises `BadInput` on a filter or a measure that is none, or has no room."""
        self.smoother  # noqa: B018
        self.measures  # noqa: B018

    @functools.cached_property
    def measures(self) -> "tuple[Measure, ...]":
        """Those that are exported. Raises `BadInput` where there is no such measure, or the format
        has no room for it."""
        from poseterior.inference.measured import chosen_measures
        from poseterior.reports.exports import OF_MEASURES, WITH_MEASURES

        if self.to in OF_MEASURES:
            return tuple(chosen_measures(self.measure or ()))
        if not self.measure:
            return ()
        if self.to not in WITH_MEASURES:
            raise BadInput(
                f"{self.to} has no room for measures; export to {', '.join(WITH_MEASURES)}, or"
                " leave --measure out"
            )
        return tuple(chosen_measures(self.measure))

    @functools.cached_property
    def smoother(self) -> "Smoother | None":
        """The filter. Raises `BadInput` where there is none of that name."""
        from poseterior.reports.exports.smoothing import smoother_of

        return None if self.smooth is None else smoother_of(self.smooth)


@dataclass(frozen=True, kw_only=True)
class CompareSettings:
    """Judge samplers by exact draws: which of them would have misled you on this detection?"""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "compare frame.json --samplers rejection,emcee,random-walk --out comparison",
        "compare frame.json --samplers smc,nss --seconds 120",
        "compare frame.json --root uncertain --samplers weighted-roots,emcee --exact-draws 500",
    )
    person: Person
    samplers: str | None = option(
        None,
        "Names with commas between them; a wrong one lists them all.",
        show_default=f"{CONTESTANTS}; with --root uncertain {ROUTES[0]}",
    )
    out: Path = option(Path("comparison"), "Folder for comparison.nc, comparison.png and the runs.")
    seconds: float = option(30.0, "Seconds for each baseline, from each of its starts.")
    max_evaluations: int | None = option(
        None, "Most evaluations of the density for each of them.", min=1, show_default="no limit"
    )
    num_samples: NumSamples = 10_000
    exact_draws: int | None = option(
        None,
        "By how many exact draws they are judged.",
        min=100,
        max=1_000_000,
        show_default="20,000; with --root uncertain 1,000, some minutes",
    )
    seed: Seed = 0
    estimation: Estimation = Estimation()
    rooting: Viewing = Viewing()
    prior: Prior = Prior()


@dataclass(frozen=True, kw_only=True)
class BenchmarkListSettings:
    """The frozen targets: dimensions, evidence, modes, and what is hard about each."""

    EXAMPLES: ClassVar[tuple[str, ...]] = ("benchmark list", "benchmark list --json")


TargetName = Annotated[
    str, Option(help="A target of `poseterior benchmark list`.", show_default=False)
]


@dataclass(frozen=True, kw_only=True)
class BenchmarkDrawsSettings:
    """Exact draws of a target as an .npz, the first of a million, which `benchmark judge` takes
    too; they are kept in the cache folder. Of `scene` there are 100,000, and ten thousand take one
    core eleven minutes."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "benchmark draws --target arm --num-samples 1000 --out arm.npz",
    )
    target: TargetName
    out: Path = option(Path("draws.npz"), "File to write.")
    num_samples: NumSamples = 10_000

    def check(self) -> None:
        """Raises `BadInput` where there is no such target."""
        from poseterior.inference.benchmark.catalogue import load

        load(self.target)


@dataclass(frozen=True, kw_only=True)
class BenchmarkJudgeSettings:
    """Judge draws of a target by exact ones.

    An .npz with `points` (n, d) or (chain, draw, d) of R^d, or `box`, or `cube`; where there are
    any, `weights` or `log_weights`, `log_evidence` and `log_evidence_se`, `evaluations`,
    `seconds`."""

    EXAMPLES: ClassVar[tuple[str, ...]] = ("benchmark judge draws.npz --target arm",)
    draws: Annotated[Path, Argument(help="The draws, .npz, .npy or .nc.", show_default=False)]
    target: TargetName

    @functools.cached_property
    def submission(self) -> "Submission":
        """The draws. Raises `BadInput` where they cannot be draws of the target."""
        from poseterior.inference.benchmark.catalogue import load
        from poseterior.inference.benchmark.submission import read_submission

        return read_submission(self.draws, load(self.target))

    def check(self) -> None:
        """Reads the file. Raises `BadInput` as `submission`."""
        self.submission  # noqa: B018


@dataclass(frozen=True, kw_only=True)
class EvaluateSettings:
    """The paper's evaluation on a data set whose truth is known: tables, curves, which of its
    relations hold.

    Of --estimator, --missing, --rotate and --root it takes several with commas between them."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "evaluate actions_train.npz --frames 500 --missing 0,1,2 --rotate 0,30,60 --workers 2",
        "evaluate h36m/ --detections gt --frames 26385 --scheduler tcp://host:8786",
        "evaluate mocap/ --noise gaussian:0.02 --limits limits.npz --poses poses.npz"
        " --predictions chen.npz",
        "evaluate actions_train.npz --frames 200 --noise gaussian:0.02 --estimator zhou"
        " --root fixed,uncertain,true --no-bias",
        "evaluate actions_train.npz --frames 200 --noise gaussian:0.02 --estimator akhter-black"
        " --root uncertain --upright 20 --composed --no-bias",
        "evaluate session/ --root uncertain --roots 1000 --perspective --errors law.json --no-bias",
    )
    dataset: Annotated[
        Path,
        Argument(
            help="Motion capture, VideoPose3D's Human3.6M, calibrated cameras in Pose2Sim's"
            " layout, or a plain .npz with truth.",
            show_default=False,
        ),
    ]
    of: Judged = JudgedBy.coordinates
    missing: str = option("0", "Numbers of limb joints made missing, at random.")
    rotate: str = option("0", "Degrees by which the image is turned.")
    root: str = option(
        "uncertain",
        "Torso and camera: fixed (the estimators'), uncertain, or true (the truth's own).",
    )
    roots: Roots = MANY_ROOTED.roots
    upright: Upright = None
    perspective: KnownLenses = False
    k: str = option("5,20", "Numbers of hypotheses of which the best counts.")
    composed: Composed = False
    out: Path = option(
        Path("evaluation"), "Folder for the results; a run that was stopped goes on there."
    )
    frames: int | None = option(
        None, "How many frames, as many of each action.", show_default="all"
    )
    noise: CameraNoise = "none"
    detections: Keypoints2D = "gt"
    names: RigNames = None
    layout: JointOrder = None
    predictions: list[Path] | None = option(
        None, "Poses of another method, a row of Table 1; may be given again."
    )
    bias: bool = option(True, "Whether the bias of its motion capture is studied too.")
    workforce: Workforce = Workforce()
    sampling: Sampling = Sampling(num_samples=1000, max_proposals=20_000_000)
    estimation: Estimation = Estimation(estimator="akhter-black,zhou,dictionary", candidates=1)
    prior: Prior = Prior()

    @functools.cached_property
    def data(self) -> "DataSet":
        """The data set. Raises `BadInput` as `read_data_set` does."""
        from poseterior.probmodel.datasets import Noise, read_data_set

        return read_data_set(
            self.dataset,
            frames=self.frames,
            noise=Noise.parse(self.noise),
            seed=self.sampling.seed,
            detections=self.detections,
            perspective=self.perspective,
            names=map_of_names(self.names),
            layout=self.layout,
        )

    def check(self) -> None:
        """Reads the data set. Raises `BadInput` where it is none."""
        self.data  # noqa: B018


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """Test whether a sampler's posterior means what it says, under the model or on real poses, and
    why it misses.

    Poses of the prior are simulated and seen, and the sampler's draws judged by them. With
    --simulate-only they are only written, for samplers that run elsewhere. With --dataset the
    poses are real."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "coverage --sampler rejection --num-simulations 1000 --out coverage",
        "coverage --simulate-only --num-simulations 200",
        "coverage --sampler draws.npz --num-simulations 200",
        "coverage --dataset recordings.npz --root fixed --estimator zhou --noise gaussian:0.02"
        " --missing 1 --out real",
        "coverage --root uncertain --num-simulations 1000 --out whole",
        "coverage --dataset session/ --root uncertain --perspective --noise none --out filmed",
        "coverage --dataset views.npz --camera unknown --errors learned --out seen",
        "coverage --dataset recordings.npz --of measures --out measured",
    )
    sampler: str | None = option(
        None,
        "A name, as of `sample`, or a file: `joints` (simulations, draws, 15, 3).",
        show_default=f"{SAMPLERS[0]}; with --root uncertain {ROUTES[0]}",
    )
    of: Judged = JudgedBy.coordinates
    out: Path = option(
        Path("coverage"), "Folder for coverage.nc and coverage.png; a run goes on there."
    )
    num_simulations: int = option(1000, "Poses of the prior, each seen once.")
    simulate_only: bool = option(
        False, "Write simulations.nc, for samplers that run elsewhere.", "--simulate-only"
    )
    dataset: Path | None = option(
        None,
        "Real poses: motion capture, Human3.6M, calibrated cameras, a plain .npz, or one"
        " of views of people.",
        "--dataset",
        "--poses",
        rich_help_panel=REAL,
    )
    frames: int = option(100, "How many of them.", rich_help_panel=REAL)
    estimator: str = option(
        "true",
        "Their torso and camera: true, dictionary, akhter-black or zhou.",
        rich_help_panel=REAL,
    )
    noise: str = option(
        "likelihood",
        "Their 2D errors: likelihood, none, gaussian:SIZE, heavy-tailed:SIZE (of body height).",
        rich_help_panel=REAL,
    )
    missing: int = option(0, "Limb joints that are not seen.", min=0, rich_help_panel=REAL)
    perspective: KnownLenses = False
    camera: CameraKind = option(
        CameraKind.unknown,
        "What is believed of the cameras of views of people (an .npz with detection and truth).",
        rich_help_panel=REAL,
    )
    errors: str = option(
        "disc", "Law of the errors of views of people, as of `hypotheses`.", rich_help_panel=REAL
    )
    rooting: Rooting = MANY_ROOTED
    factor: Factor = 0.25
    workforce: Workforce = Workforce()
    sampling: Sampling = Sampling(num_samples=1000, max_proposals=3_000_000)
    prior: Prior = Prior()

    @property
    def of_views(self) -> bool:
        """Whether the data set is one of views of people."""
        from poseterior.probmodel.datasets.person_views import is_person_views

        return self.dataset is not None and is_person_views(self.dataset)

    def require_meaning(self, given: Set[str]) -> None:
        """Raises `BadInput` where an option was given that the chosen way does not know."""
        views = ["camera", "errors"]
        real = ["frames", "estimator", "noise", "missing", "perspective", *views]
        draws = ["sampler", "num_samples", "max_proposals", "roots", "upright"]
        if self.of_views:
            way = "with views of people"
            unknown = ["simulate_only", "num_simulations", "sampler", "workers"]
            unknown += ["estimator", "noise", "missing", "perspective"]
        elif self.dataset is not None and self.dataset.exists() and {*views} & given:
            way, unknown = "but with views of people", views
        elif self.dataset is not None:
            way, unknown = "with --dataset", ["simulate_only", "num_simulations"]
        elif self.simulate_only:
            way, unknown = "with --simulate-only", ["of", *draws, *real]
        else:
            way, unknown = "without --dataset", real
        for name in unknown:
            if name in given:
                raise BadInput(
                    f"{flag(name)} means nothing {way}; leave it out, or choose another of the"
                    " three ways in `poseterior coverage --help`"
                )


@dataclass(frozen=True, kw_only=True)
class CoverageJudgeSettings:
    """Judge anybody's posterior of anything by draws beside truths: is it calibrated, and where
    does it fail?

    A file is an .npz with `draws` (instances, draws, quantities) and `truth` (instances,
    quantities), sbi's `posterior_samples` and `thetas`, bayesflow's dictionaries as
    `estimates.NAME` and `targets.NAME`, or a tree (netCDF4, Zarr) with the groups `posterior` and
    `truth`. `covariates` say where to look; `weights`, `log_weights` and log densities are taken as
    they are. A coverage.nc of `poseterior coverage` can be judged too, several of them together."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "coverage judge mine.npz --out judged",
        "coverage judge mine.nc --circular heading --recalibrate wider.json --by score",
        "coverage judge network.npz mcmc.npz --json",
        "coverage judge openpose/coverage.nc mediapipe/coverage.nc --together",
    )
    files: Annotated[list[Path], Argument(help="Draws and truths.", show_default=False)]
    out: Path | None = option(
        None, "Folder for NAME.nc and NAME.png of each file.", show_default="none"
    )
    together: bool = option(
        False, "The files, of `coverage`, are one, and which of them a covariate: detectors, say."
    )
    circular: list[str] | None = option(
        None, "A quantity that is an angle, in radians; may be repeated.", show_default="none"
    )
    false_alarm: float = option(
        0.01, "Chance that a right posterior is accused.", min=1e-4, max=0.5
    )
    recalibrate: Path | None = option(
        None, "File of recalibrated intervals to write, for `hypotheses --recalibrated`."
    )
    by: str | None = option(None, "A covariate whose groups are recalibrated one by one.")
    seed: Seed = 0

    def require_meaning(self, given: Set[str]) -> None:
        """Raises `BadInput` where --by comes without --recalibrate, or two files would be one."""
        if self.by and not self.recalibrate:
            raise BadInput("--by means nothing without --recalibrate; give that, or leave it out")
        if self.recalibrate and len(self.files) > 1:
            raise BadInput(f"--recalibrate is of one file, not of {len(self.files)}")
        if self.together and len(self.files) == 1:
            raise BadInput("--together means nothing for one file; give more, or leave it out")
        if len({path.resolve() for path in self.files}) < len(self.files):
            raise BadInput("a file is given twice; leave it out once")
        if len(self.named) < len(self.files):
            raise BadInput("two of the files differ in their endings alone; rename one of them")

    @property
    def named(self) -> dict[str, Path]:
        """The files by what results of them are called: their own names, or, where these are not
        different, with those of as many of their folders as tell them apart."""
        parts = [path.resolve().with_suffix("").parts[1:] for path in self.files]
        named: dict[str, Path] = {}
        for depth in range(1, 1 + max(map(len, parts))):
            named = {
                "-".join(part[-depth:]): path for part, path in zip(parts, self.files, strict=True)
            }
            if len(named) == len(self.files):
                break
        return named


@dataclass(frozen=True, kw_only=True)
class CalibrateSettings:
    """Learn how a detector errs, joint by joint: spread, bias, outliers, exchanged sides, and what
    its scores say of them.

    It learns from detections beside their truth, or from a person filmed by three calibrated
    cameras or more, without any truth: each is judged by what the others triangulate, whose own
    error is taken into account. It writes the law, and a picture of the residuals against it."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "calibrate session/ --out errors.json",
        "calibrate session/ --perspective --law student --out errors.json",
        "calibrate session/ --perspective --fps 60",
        "calibrate h36m/ --detections cpn_ft_h36m_dbb --frames 5000 --out cpn.json",
    )
    dataset: Annotated[
        Path,
        Argument(
            help="Calibrated cameras in Pose2Sim's layout, Human3.6M, or a plain .npz with truth.",
            show_default=False,
        ),
    ]
    out: Path = option(Path("errors.json"), "File to write; the picture lies beside it.")
    law: LearnedLaw = option(
        LearnedLaw.gaussian, "Of errors that are no outliers; --errors takes gaussian."
    )
    perspective: KnownLenses = False
    fps: float | None = option(
        None,
        "Frames a second of a session whose frames follow each other: then it is said how"
        " long errors last, too.",
        show_default="not said",
    )
    frames: int = option(2000, "Most detected people to learn from, evenly over all.", min=1)
    noise: CameraNoise = "none"
    detections: Keypoints2D = "gt"
    layout: JointOrder = None
    seed: Seed = 0

    @functools.cached_property
    def data(self) -> "DataSet | Session":
        """The session, or the data set. Raises `BadInput` where it is neither."""
        from poseterior.probmodel.datasets import Noise, read_data_set
        from poseterior.probmodel.sessions import is_session, read_session

        if is_session(self.dataset):
            return read_session(self.dataset, layout=self.layout)
        noise = Noise.parse(self.noise)
        return read_data_set(
            self.dataset,
            noise=noise,
            seed=self.seed,
            detections=self.detections,
            layout=self.layout,
        )

    def described(self) -> dict[str, str]:
        """What the law's file says of how it was learned."""
        from poseterior.probmodel.sessions import Session

        if not isinstance(self.data, Session):
            return {"truth": "given"}
        camera = "perspective" if self.perspective else "weak perspective"
        return {
            "truth": f"triangulated by the other cameras, seen in {camera}",
            "detector": self.data.people[0][0].layout,
        }

    def check(self) -> None:
        """Reads the data. Raises `BadInput` where they are none, or no film where a rate is
        given."""
        from poseterior.probmodel.sessions import Session

        if self.fps is not None and not isinstance(self.data, Session):
            raise BadInput(
                "--fps is of a session of calibrated cameras, whose frames follow each other, which"
                f" {self.dataset} is not; leave it out"
            )
        self.data  # noqa: B018


@dataclass(frozen=True, kw_only=True)
class LearnSettings:
    """Learn limits, bone lengths and torsos, and if asked for pose dictionaries, from motion
    capture."""

    EXAMPLES: ClassVar[tuple[str, ...]] = (
        "learn cmu/01 cmu/02 walk.bvh --out limits.npz",
        "learn cmu/01 cmu/02 --out limits.npz --poses poses.npz",
        "learn cmu/01 --wider 2 --out wide.npz",
    )
    mocap: Annotated[
        list[Path],
        Argument(
            help="Motion capture: ASF/AMC folder, .bvh, .trc, .c3d, .npz.", show_default=False
        ),
    ]
    out: Path = option(Path("limits.npz"), "File to write.")
    poses: Path | None = option(None, "File for pose dictionaries, of which estimators build.")
    mirror: bool = option(True, "Whether what one side did is possible for the other.")
    wider: float = option(
        1.0, "Factor by which the usual margins around what was seen are widened."
    )
    names: RigNames = None
