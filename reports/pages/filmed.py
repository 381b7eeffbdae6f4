"""One person filmed by four calibrated cameras: what each camera's detection says by itself, kept
in a folder, beside what the other three say.

Poses are in the person's own body units, the hips' midpoint at the origin, z along the line of
sight to it. The film is cut in two: what is learned from one half judges the other.
"""

import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior import inference
from poseterior.inference.estimators.points import require_camera
from poseterior.inference.machines import HERE
from poseterior.inference.store import Block, Groups, Store, fill, locked
from poseterior.inference.studies.calibration.real import TRUE, true_candidate
from poseterior.inference.studies.errorlaws.learn import Learned, learn
from poseterior.inference.studies.errorlaws.pairs import pairs_of_session
from poseterior.probmodel import Detection, Estimate, Lens, Likelihood, PoseModel
from poseterior.probmodel.datasets import Case, from_session
from poseterior.probmodel.datasets.cases import skeletal, strays
from poseterior.probmodel.datasets.sessions import judged_views
from poseterior.probmodel.errors.faults import NO_FAULTS
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.layouts import MIDPOINTS, corrected, without_midpoints
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.sessions import Session, read_session
from poseterior.probmodel.sessions.session import HIPS
from poseterior.probmodel.skeleton import NUM_JOINTS
from poseterior.reports.pages.page import in_doubles

FILM_DRAWS, FILM_ROOTS = 4000, 1000
FILM_BUDGET = 300_000_000
"""Most proposals for a case."""
DISC, LEARNED = "disc", "learned"
GOLDEN = (5**0.5 - 1) / 2
PARTS = 2
"""Of the film, one after the other."""


class Way(NamedTuple):
    """One way to a posterior: its root, the error law's name, whether midpoints are moved to the
    skeleton's thorax and pelvis, whether the focal length is known, in how many frames it is
    judged, and how many roots are weighed where they are uncertain."""

    root: str
    errors: str = DISC
    moved: bool = True
    focal: bool = False
    frames: int = 100
    roots: int = FILM_ROOTS

    def __str__(self) -> str:
        given = "" if self.moved else ", `--as-detected`"
        return f"{self.root}, {self.errors}{given}{', `--focal`' if self.focal else ''}"

    @property
    def folder(self) -> str:
        """Where its draws are kept."""
        given = "" if self.moved else "-as-detected"
        return f"{self.root}-{self.errors}{given}{'-focal' if self.focal else ''}".lower()


FILM_WAYS = (
    Way(CANDIDATES, moved=False),
    Way(CANDIDATES),
    Way(UNCERTAIN),
    Way(UNCERTAIN, focal=True, frames=25),
    Way(UNCERTAIN, LEARNED),
    Way(UNCERTAIN, LEARNED, focal=True, roots=4 * FILM_ROOTS),
    Way(TRUE),
    Way(TRUE, LEARNED, frames=10),
)


class FilmedCase(NamedTuple):
    """What one `camera` detected in a `frame`, and the truth `(15, 3)` from the others: body units
    of the person, the hips' midpoint at the origin, z along the line of sight to it; with the
    covariances `(15, 3, 3)` of the truth's own errors, those of one joint independent of another's.
    Where the focal length is to be known: the `straight` detection, without the distortion of the
    `lens`, and what `turns` `(3, 3)` the camera's axes into those of the truth. Where torso and
    camera are: the `known` case with its weak-perspective camera and what turns its axes, None
    where not all joints are."""

    camera: int
    frame: int
    detection: Detection
    truth: np.ndarray
    doubt: np.ndarray
    straight: Detection
    lens: Lens
    turns: np.ndarray
    known: tuple[Case, np.ndarray] | None = None

    def errors(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, 15, 3)`: errors that the truth may have, rooted as it is."""
        spread = np.linalg.cholesky(np.nan_to_num(self.doubt) + 1e-12 * np.eye(3))
        free = np.einsum("jab,njb->nja", spread, rng.normal(size=(number, *self.truth.shape)))
        return free - free[:, HIPS].mean(axis=1, keepdims=True)

    def skeletal_errors(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, 15, 3)`: those of `skeletal_truth`, rooted at its pelvis."""
        return strays(skeletal(np.nan_to_num(self.doubt), (*MIDPOINTS,)), rng, number)

    @property
    def skeletal_truth(self) -> np.ndarray:
        """`(15, 3)`: with the skeleton's thorax and pelvis in the place of the midpoints."""
        return without_midpoints(self.truth, MIDPOINTS)


class FilmedDraws(NamedTuple):
    """What came out of a case: `joints` `(draws, 15, 3)` in body units, rooted and turned as the
    truth is, the effective number of `roots` behind them, NaN where the root is fixed, and the
    `seconds` it took."""

    joints: np.ndarray
    roots: float
    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class Film:
    """A session, cut in two."""

    session: Session

    def part_of(self, frame: int) -> int:
        """Which part of the film a frame is in."""
        return frame * PARTS // len(self.session)

    def part(self, part: int) -> Session:
        """One part of the film."""
        frames = range(len(self.session))
        return self.session.take([frame for frame in frames if self.part_of(frame) == part])

    def unseen(self, part: int) -> Session:
        """The rest of the film."""
        frames = range(len(self.session))
        return self.session.take([frame for frame in frames if self.part_of(frame) != part])

    @functools.cached_property
    def cases(self) -> list[FilmedCase]:
        """Every camera in every frame, judged by the others, whose detections err as in the rest of
        the film. So ordered that the first ones are evenly over the film, however many they are."""
        views = list(map(self._view, range(len(self.session.cameras))))
        frames = np.argsort(np.arange(len(self.session)) * GOLDEN % 1)
        return [view[frame] for frame in frames for view in views]

    def _view(self, camera: int) -> list[FilmedCase]:
        session = self.session
        world = session.without(camera)
        truth = session.along_sight(camera, world.points) / session.unit
        axes = session.sight_axes(camera, world.points)[:, None]
        doubt = axes @ world.covariance @ np.swapaxes(axes, -1, -2)
        sigma = np.stack([self._truth_sigma[self.part_of(row)] for row in range(len(session))])
        doubt = doubt * sigma[:, :, None, None] ** 2
        seen_by = session.straight[camera]
        people = session.people[camera]
        straight = [
            dataclasses.replace(person, keypoints=keypoints)
            for person, keypoints in zip(people, session.keypoints[camera], strict=True)
        ]
        turns = (axes[:, 0] @ seen_by.rotation.T).copy()
        lens = Lens(float(seen_by.focal.mean()), seen_by.principal)
        rows = zip(people, truth, doubt, straight, turns, strict=True)
        cases = [
            FilmedCase(
                camera=camera,
                frame=row,
                detection=person,
                truth=where,
                doubt=errs,
                straight=plain,
                lens=lens,
                turns=turned,
            )
            for row, (person, where, errs, plain, turned) in enumerate(rows)
        ]
        for row, (known, rotation) in self._known[camera].items():
            cases[row] = cases[row]._replace(known=(known, axes[row, 0] @ rotation.T))
        return cases

    @functools.cached_property
    def _known(self) -> list[dict[int, tuple[Case, np.ndarray]]]:
        """By camera and frame, the cases whose truth is whole, and what `(3, 3)` turns the world's
        axes into theirs."""
        cases = iter(from_session(self.session))
        return [
            {
                int(row): (next(cases), rotation)
                for row, rotation in zip(
                    view.rows[view.whole], view.rotation[view.whole], strict=True
                )
            }
            for view in judged_views(self.session)
        ]

    @functools.cached_property
    def _truth_sigma(self) -> list[np.ndarray]:
        """By part of the film, how far detections stray in the rest of it."""
        rests = [pairs_of_session(self.unseen(part), perspective=True) for part in range(PARTS)]
        return [learn(rest).fit.mixture.sigma for rest in rests]

    @functools.cached_property
    def learned(self) -> dict[bool, list[Likelihood]]:
        """By whether the focal length is known and by part of the film, what is learned from the
        rest of it, its bias in it, without faults."""
        return {focal: self._learned(focal) for focal in (False, True)}

    def _learned(self, focal: bool) -> list[Likelihood]:
        laws = [learn_as(self.unseen(part), perspective=focal).errors for part in range(PARTS)]
        return [dataclasses.replace(Likelihood.of(law), faults=NO_FAULTS) for law in laws]

    def likelihood(self, way: Way, frame: int) -> Likelihood:
        """How detections err in a way's eyes: as the paper says, or as is learned from the rest."""
        return (
            self.learned[way.focal][self.part_of(frame)] if way.errors == LEARNED else Likelihood()
        )


def learn_as(session: Session, *, perspective: bool = False) -> Learned:
    """As `poseterior calibrate` learns: a law that has what perspective adds along the line of
    sight, unless the focal length is to be known; the truth's own errors are those without it."""
    true = pairs_of_session(session, perspective=True)
    return learn(true if perspective else pairs_of_session(session), truth=true)


def film(data: Path) -> Film:
    """The person on the beam, in doubles. Ends the program where the data pack is not there."""
    if not (data / "multicamera").is_dir():
        raise SystemExit(
            f"{data} has no folder `multicamera`: this page needs the shared data pack"
        )
    in_doubles()
    return Film(read_session(data / "multicamera"))


def drawn(seen: Film, way: Way, work: Path) -> Iterator[tuple[FilmedCase, FilmedDraws]]:
    """The draws of a way in its cases; those that are not in the folder `work` are made."""
    cases = seen.cases[: way.frames * len(seen.session.cameras)]
    settings = {
        "way": str(way),
        "session": seen.session.name,
        "draws": FILM_DRAWS,
        "roots": way.roots,
    }
    with locked(work / way.folder):
        store = Store.begin(work / way.folder, settings)
        blocks = [_block(seen, way, number, case) for number, case in enumerate(cases)]
        fill(store, HERE, functools.partial(_draw, way), blocks, lambda block, groups: None)
        for block, case in zip(blocks, cases, strict=True):
            found = store.read(block.number, "draws")
            about = found.attrs["roots"], found.attrs["seconds"]
            yield case, FilmedDraws(found.joints.values.astype(float), *map(float, about))


class Asked(NamedTuple):
    """What the draws of one case are made of: the `frame` or, where torso and camera are known, the
    `case`; the focal length, if it is, and what turns the draws' axes into the truth's; the draws'
    body units in those of the truth; a seed."""

    detection: Detection
    likelihood: Likelihood
    lens: Lens | None
    turns: np.ndarray
    case: Case | None
    units: float
    seed: int


def _block(seen: Film, way: Way, number: int, case: FilmedCase) -> Block:
    likelihood = seen.likelihood(way, case.frame)
    person = case.straight if way.focal else case.detection
    person = corrected(person) if way.moved else person
    lens, turns = (case.lens, case.turns) if way.focal else (None, np.eye(3))
    known = None
    units = 1.0
    if way.root == TRUE and case.known is not None:
        known, turns = case.known
        units = known.unit / seen.session.unit
    seed = case.frame * len(seen.session.cameras) + case.camera
    made_of = {"camera": case.camera, "frame": case.frame, "law": likelihood.sha256}
    asked = Asked(
        detection=person,
        likelihood=likelihood,
        lens=lens,
        turns=turns,
        case=known,
        units=units,
        seed=seed,
    )
    return Block(number, f"{way}, case {number}", made_of, 1, asked)


def _draw(way: Way, asked: Asked) -> Groups:
    """Draws for one camera's detection; none where no root explains it, or where it shows too few
    of the torso's joints for one."""
    model = _model().seen_by(asked.lens)
    frame = _frame(way, asked, model)
    if frame is None:
        return _kept(np.zeros((0, NUM_JOINTS, 3)), np.nan, np.nan)
    result = inference.sample(
        model,
        frame,
        key=jax.random.key(asked.seed),
        num_samples=FILM_DRAWS,
        root=CANDIDATES if way.root == TRUE else way.root,
        num_roots=way.roots,
        max_proposals=FILM_BUDGET,
    )
    joints = result.tree["posterior"].joints.values[0]
    joints = (joints - joints[:, HIPS].mean(axis=1, keepdims=True)) @ asked.turns.T
    about = result.tree.attrs
    return _kept(asked.units * joints, about.get("effective_roots", np.nan), about["wall_time_s"])


def _frame(way: Way, asked: Asked, model: PoseModel) -> Estimate | None:
    """What is drawn from; None where it shows too little."""
    if way.root == TRUE:
        case = asked.case
        if case is None:
            return None
        root = true_candidate(case, model)
        return Estimate(case.detection, (root,), asked.likelihood, estimator=TRUE)
    try:
        require_camera(asked.detection)
    except BadInput:
        return None
    torsos = np.asarray(model.torsos)
    likelihood = asked.likelihood
    return inference.estimate_torso(asked.detection, torsos=torsos, likelihood=likelihood)


def _kept(joints: np.ndarray, roots: float, seconds: float) -> Groups:
    """What is kept of a case: see `FilmedDraws`."""
    columns = {"joints": (("draw", "joint", "axis"), joints.astype(np.float32))}
    about = {"roots": float(roots), "seconds": float(seconds)}
    return {"draws": xr.Dataset(columns, attrs=about)}


@functools.cache
def _model() -> PoseModel:
    return PoseModel()
