"""Do intervals hold for people, detectors and cameras that were never seen? Writes
reports/strangers.md.

    python -m poseterior.reports.pages.strangers ../shared/data work

`work` keeps what each line of the table is made of, and a run that was stopped goes on there.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from poseterior.inference.studies import person_views
from poseterior.inference.studies.errorlaws.definitions import definitions_of_session
from poseterior.inference.studies.errorlaws.learn import learn
from poseterior.inference.studies.errorlaws.pairs import pairs_of_session
from poseterior.inference.studies.person_views import (
    JUDGED,
    LEVELS,
    MIDDLES,
    Honesty,
    ViewLevels,
    beside,
    even,
    honesty,
    of_the_person,
    units_of,
)
from poseterior.probmodel import Detection, DetectorErrors, Likelihood, PoseModel
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.body import align_torsos, body_unit, mean_torso
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.datasets.person_views import PersonView, read_person_views
from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.layouts import LAYOUTS, corrected
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.sessions import Session, read_session
from poseterior.probmodel.skeleton import NUM_JOINTS, TORSO_INDEX
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import page as blank_page
from poseterior.reports.figures.style import tidy
from poseterior.reports.pages.filmed import PARTS, Film
from poseterior.reports.pages.page import Data, Page, Work, kept_json, run
from poseterior.reports.pages.people import strangers, together
from poseterior.reports.tables import Sheet, sheet_of
from poseterior.reports.tables.sheet import percents

HALF_VIEWS, ROOM_VIEWS = 12, 30
"""Of each half of the film by each detector, and of the operating room."""
STRANGER_DRAWS, STRANGER_ROOTS = 1000, 300
DISTANCES = (1.0, 1.5, 2.5, 4.0, 8.0)
"""Metres from the simulated camera to the pelvis."""
IMAGE, FOCAL_OF_IMAGE = 1920.0, 0.8
"""Longer side, pixels, and focal length in longer sides, of the simulated camera."""
TURNED, TILTED = 180.0, 20.0
"""Degrees, at most either way, by which it is turned about the person and looks up or down."""
OFF = (0.0, 60.0, 120.0, np.inf)
"""Millimetres by which joints are detected off, about the shoulders."""
EMBEDDED_LAW, OTHER_HALF, OTHER_DETECTOR = "embedded", "other half", "other detector"
UNKNOWN, WEAK, CUT_OUT = "unknown", "weak", "unknown, cut out"
MARGIN = 1.3
"""Of a person's keypoints, the longer side of the image that was cut out around them."""


class Line(NamedTuple):
    """A line of the table: what views are of, the law's name and what is believed of the camera."""

    views: str
    law: str
    camera: str

    @property
    def file(self) -> str:
        """Where what it is made of is kept."""
        return "-".join(self).replace(", ", "-").replace(" ", "-") + ".json"


def mediapipe(session: Session, data: Path) -> Session:
    """What MediaPipe saw of the person of the film."""
    landmarks = np.load(data / "multicamera" / "mediapipe.npz")["landmarks"]
    layout = LAYOUTS["mediapipe_33"]
    people = tuple(
        tuple(layout.detection(np.asarray(points, float), 0.5, "the film", 0) for points in camera)
        for camera in landmarks
    )
    return dataclasses.replace(session, people=people)


def calibrated(session: Session, path: Path) -> DetectorErrors:
    """A detector's errors and definitions as `poseterior calibrate --perspective` learns them, kept
    in a file."""
    if not path.exists():
        pairs = pairs_of_session(session, perspective=True)
        definitions = definitions_of_session(session)
        learn(pairs, law="student", definitions=definitions).errors.write(path)
    return DetectorErrors.read(path)


def views_of_session(
    session: Session, people: Sequence[Sequence[Detection]], number: int
) -> list[PersonView]:
    """So many of what a detector saw in the cameras of a session, evenly, beside what its other
    cameras triangulate. Each camera counts as a person, since its views err together.

    Parameters
    ----------
    session
        Says the truth, of three cameras at least.
    people
        By camera and frame, detections of the person in the session's pixels: the session's own,
        or those of another detector.
    number
        How many.
    """
    found = []
    for row, (camera, straight, own) in enumerate(
        zip(session.cameras, session.straight, people, strict=True)
    ):
        world, turn = session.without(row), straight.rotation
        truth = straight.view(world.points)
        square = np.diagonal(turn @ world.covariance @ turn.T, axis1=-2, axis2=-1).mean(axis=-1)
        sigma = session.stray * np.sqrt(np.nan_to_num(square))
        lens = Lens(float(straight.focal.mean()), straight.principal)
        longer = 2 * float(np.max(straight.principal))
        for frame, person in enumerate(own):
            keypoints = camera.straighten(person.keypoints[None])[0]
            seen = corrected(dataclasses.replace(person, keypoints=keypoints))
            view = seen, truth[frame], sigma[frame], lens, longer, session.labels[row]
            found.append(PersonView(*view))
    return even(list(filter(of_the_person, found)), number)


def captured(motions: list[Motion], law: DetectorErrors, metres: float) -> list[PersonView]:
    """One pose of each subject, before a camera at a distance, seen by a detector that errs as the
    law says."""
    subjects = list(dict.fromkeys(motion.subject for motion in motions))
    people = law.definitions(len(subjects))
    assert people is not None
    found = []
    for number, (subject, definition) in enumerate(zip(subjects, people, strict=True)):
        rng = np.random.default_rng([number, round(10 * metres)])
        joints = np.concatenate([one.joints for one in motions if one.subject == subject])
        pose = joints[rng.integers(len(joints))]
        turn, errors = camera_turn(rng), strays_of(law, rng)
        found.append(seen_from(turn, pose - pose[0], definition, errors, metres, subject))
    return found


def camera_turn(rng: np.random.Generator) -> np.ndarray:
    """`(3, 3)`: from the axes of motion capture to those of a camera somewhere about the person."""
    angles = rng.uniform(-TURNED, TURNED), rng.uniform(-TILTED, TILTED)
    down = Rotation.from_euler("x", 180, degrees=True)
    turn = (Rotation.from_euler("x", angles[1], degrees=True) * down).as_matrix()
    return turn @ Rotation.from_euler("y", angles[0], degrees=True).as_matrix()


def seen_from(
    turn: np.ndarray,
    pose: np.ndarray,
    definition: np.ndarray,
    errors: np.ndarray,
    metres: float,
    subject: str,
) -> PersonView:
    """A pose `(15, 3)` in mm before a camera that is turned so, and so far from the origin;
    detected with a person's `definition`, and with `errors` `(15, 2)` in body units."""
    unit, place = float(body_unit(pose[None])), np.array([0.0, 0.0, 1000 * metres])
    truth = pose @ turn.T + place
    torso = (truth - truth[0])[None, list(TORSO_INDEX)] / unit
    axes = align_torsos(torso, mean_torso(Anatomy.default().torsos))[0]
    points = truth + unit * definition @ axes
    focal, middle = FOCAL_OF_IMAGE * IMAGE, np.full(2, IMAGE / 2)
    pixels = focal * points[:, :2] / points[:, 2:] + middle
    size = focal * unit / points[:, 2:]
    keypoints = np.where(points[:, 2:] > 0, pixels + size * errors, np.nan)
    score = (points[:, 2] > 0).astype(float)
    person = Detection(keypoints, score, "skeleton_15", "motion capture", 0)
    return PersonView(person, truth, np.zeros(NUM_JOINTS), Lens(focal, middle), IMAGE, subject)


def strays_of(law: DetectorErrors, rng: np.random.Generator) -> np.ndarray:
    """`(15, 2)` body units: a detection's errors, outliers among them."""
    assert isinstance(law.law, Student)
    freedom = law.law.df
    stretch = np.sqrt(freedom / rng.chisquare(freedom, NUM_JOINTS))
    error = law.bias + (law.sigma * stretch)[:, None] * rng.normal(size=(NUM_JOINTS, 2))
    far = law.outlier_radius * np.sqrt(rng.random(NUM_JOINTS))
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    stray = far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.where((rng.random(NUM_JOINTS) < law.inlier)[:, None], error, stray)


def judged(
    views: Sequence[PersonView],
    models: Mapping[str, PoseModel],
    laws: Sequence[DetectorErrors],
    camera: str,
    name: str,
) -> list[dict[str, Any]]:
    """What draws say of views, each under its law and the model of its person (the embedded one
    where there is none), as plain values."""
    embedded = PoseModel()
    units = units_of(views, embedded)
    found = []
    for seed, (view, law) in enumerate(zip(views, laws, strict=True)):
        model = models.get(view.person, embedded)
        view = view._replace(detection=_known(view.detection, law))
        seen_by, likelihood = model.seen_by(believed(view, camera)), Likelihood.of(law)
        given = view, units[view.person], seen_by, likelihood, seed
        levels = person_views.judge(*given, STRANGER_DRAWS, STRANGER_ROOTS)
        found.append({middle: [part.tolist() for part in one] for middle, one in levels.items()})
        print(name, seed, flush=True)
    return found


def believed(view: PersonView, camera: str) -> Lens | None:
    """What is believed of the camera; of an image that was cut out, that it is a whole one."""
    if camera != CUT_OUT:
        return view.believed(camera)
    points = view.detection.keypoints
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    return Lens.unknown(MARGIN * float(np.max(high - low)), (low + high) / 2)


def _known(seen: Detection, law: DetectorErrors) -> Detection:
    """Of a detection the joints that a law speaks of: MediaPipe's has no head."""
    return dataclasses.replace(
        seen,
        keypoints=np.where(law.known[:, None], seen.keypoints, np.nan),
        score=np.where(law.known, seen.score, 0.0),
    )


class Judging(NamedTuple):
    """All views, by what they are of, the laws of each of them by line, and the models of people
    from whom the embedded one was learned: without them."""

    views: Mapping[str, list[PersonView]]
    laws: Mapping[Line, list[DetectorErrors]]
    models: Mapping[str, PoseModel]


def real(data: Path, work: Path) -> Judging:
    """Views of the film by both detectors, and of the operating room."""
    film = read_session(data / "multicamera")
    detectors = {"OpenPose": film, "MediaPipe": mediapipe(film, data)}
    other = dict(zip(detectors, reversed(detectors), strict=True))
    embedded = DetectorErrors.default()
    views: dict[str, list[PersonView]] = {}
    laws: dict[Line, list[DetectorErrors]] = {}
    for detector, session in detectors.items():
        name = f"film, {detector}"
        truth, seen = Film(film), Film(session)
        parts = [
            views_of_session(truth.part(part), seen.part(part).people, HALF_VIEWS)
            for part in range(PARTS)
        ]
        learned = [
            calibrated(seen.unseen(part), work / f"law-{detector}-{part}.json")
            for part in range(PARTS)
        ]
        views[name] = [*itertools.chain(*parts)]
        own_laws = [law for law, part in zip(learned, parts, strict=True) for _ in part]
        laws[Line(name, OTHER_HALF, UNKNOWN)] = own_laws
        theirs = calibrated(detectors[other[detector]], work / f"law-{other[detector]}.json")
        laws[Line(name, OTHER_DETECTOR, UNKNOWN)] = [theirs] * len(views[name])
    every = read_person_views(data / "mvor" / "mvor.npz")
    room = "operating room, OpenPose"
    views[room] = even(list(filter(of_the_person, every)), ROOM_VIEWS)
    for name, own in views.items():
        for camera in (UNKNOWN, WEAK):
            laws[Line(name, EMBEDDED_LAW, camera)] = [embedded] * len(own)
    return Judging(views, laws, {})


def simulated(data: Path, work: Path, law: DetectorErrors) -> Judging:
    """Views of captured subjects by a detector that errs as a law says."""
    embedded = DetectorErrors.default()
    everybody, models = together(strangers(work, data))
    views = {f"{far:g} m": captured(everybody, law, far) for far in DISTANCES}
    lines = {
        (EMBEDDED_LAW, UNKNOWN): embedded,
        (EMBEDDED_LAW, WEAK): embedded,
        (EMBEDDED_LAW, CUT_OUT): embedded,
        ("its own", UNKNOWN): law,
    }
    return Judging(
        views,
        {
            Line(name, *said): [own] * len(views[name])
            for name in views
            for said, own in lines.items()
        },
        models,
    )


Kept = Mapping[Line, list[dict[str, Any]]]


def outcomes_of(judging: Judging, work: Path) -> Kept:
    """What was kept of each line, in the order of views, laws and cameras."""
    lines = sorted(judging.laws, key=lambda line: [*judging.views].index(line.views))
    return {
        line: kept_json(
            work / line.file,
            judged,
            judging.views[line.views],
            judging.models,
            judging.laws[line],
            line.camera,
            str(line),
        )
        for line in lines
    }


def read(kept: list[dict[str, Any]], middle: str) -> list[ViewLevels]:
    """What was kept of some views, about a midpoint."""
    return [ViewLevels(*(np.array(part, float) for part in one[middle])) for one in kept]


def cells(found: Honesty) -> list[str]:
    """Coverage at both levels by axis, with intervals over people; ECE, width and error."""
    return [
        *map(percents, zip(found.covered[1], found.low[1], found.high[1], strict=True)),
        " / ".join(f"{100 * value:.0f}" for value in found.covered[0]),
        " / ".join(f"{value:.3f}" for value in found.ece),
        " / ".join(f"{value:.0f}" for value in found.width),
        " / ".join(f"{value:.0f}" for value in found.error),
    ]


def table(judging: Judging, outcomes: Kept, middles: Sequence[str]) -> Sheet:
    """A line for each of views, laws, cameras and midpoints."""
    lines = [
        (line.views, f"{one.people} / {one.views - one.silent}", *line[1:], middle, *cells(one))
        for line, found in outcomes.items()
        for middle in middles
        for one in [honesty(judging.views[line.views], read(found, middle))]
    ]
    head = (
        *("views of", "people / views", "law", "camera", "about the"),
        *("x 95 %", "y 95 %", "depth 95 %", "50 %, x / y / depth", "ECE"),
        *("95 % wide, mm", "error of the mean, mm"),
    )
    return sheet_of(head, lines)


def picture(judging: Judging, outcomes: Kept, middle: str) -> Figure:
    """How often intervals of 95 % hold the truth, line by line, with intervals over people; those
    of weak perspective in another colour."""
    figure = blank_page(11.0, 0.3 * len(outcomes) + 1.0)
    panels = figure.subplots(1, 3)
    rows = np.arange(len(outcomes))[::-1]
    colours = [PALETTE[line.camera == WEAK] for line in outcomes]
    every = [
        honesty(judging.views[line.views], read(found, middle)) for line, found in outcomes.items()
    ]
    for axis, (panel, title) in enumerate(
        zip(panels, ("to the right", "down", "depth"), strict=True)
    ):
        held, low, high = (
            100 * np.array([part[1, axis] for part in column])
            for column in zip(*((one.covered, one.low, one.high) for one in every), strict=True)
        )
        panel.axvspan(92, 98, color="0.9", zorder=0)
        panel.hlines(rows, low, high, color=colours, lw=1.5)
        panel.scatter(held, rows, color=colours, s=16)
        panel.set(title=title, xlim=(50, 101), xlabel="95 % intervals hold, %")
        panel.set_yticks(rows, [""] * len(rows) if axis else [", ".join(line) for line in outcomes])
        tidy(panel)
    return figure


def gaps(views: Mapping[str, list[PersonView]]) -> Sheet:
    """A line for each of real views: how far detections lie beside the truth in the image."""
    lines = []
    for name, some in views.items():
        own = {middle: person_views.beside_truth(some, pair) for middle, pair in MIDDLES.items()}
        lines.append((name, *(f"{gap[0]:.0f} / {gap[1]:.0f}" for gap in own.values())))
    head = ("views of", *(f"{middle}, right / down, mm" for middle in MIDDLES))
    return sheet_of(head, lines)


def by_detection(judging: Judging, outcomes: Kept, middle: str) -> Sheet:
    """Real views together under the embedded law: coverage of joints by how far off they were
    detected, beside the midpoint."""
    level, off = [], []
    for name, views in judging.views.items():
        for view, one in zip(
            views, read(outcomes[Line(name, EMBEDDED_LAW, UNKNOWN)], middle), strict=True
        ):
            gap = beside(view)
            gap -= gap[MIDDLES[middle]].mean(axis=0)
            level.append(one.level[list(JUDGED)])
            off.append(np.linalg.norm(gap[list(JUDGED)], axis=1))
    every, apart = np.stack(level), np.stack(off)
    known = np.isfinite(every).all(axis=2)
    lines = []
    for low, high in itertools.pairwise(OFF):
        some = every[known & (apart >= low) & (apart < high)]
        held = [person_views.inside(some, nominal).mean(axis=0) for nominal in LEVELS]
        shown = [" / ".join(f"{100 * axis:.0f}" for axis in share) for share in held]
        name = f"{low:.0f} to {high:.0f}" if np.isfinite(high) else f"{low:.0f} and more"
        lines.append((name, f"{100 * len(some) / known.sum():.0f} %", shown[1], shown[0]))
    head = ("detected off, mm", "of the joints", "95 %, x / y / depth", "50 %")
    return sheet_of(head, lines)


def parts_of_errors(judging: Judging, outcomes: Kept, middle: str) -> Sheet:
    """Of the error of the mean: what is the same in all views of a joint, what a person's views
    have in common beyond that, and the rest; root mean squares by axis."""
    lines = []
    for name, views in judging.views.items():
        kept = read(outcomes[Line(name, EMBEDDED_LAW, UNKNOWN)], middle)
        error = np.stack([one.error for one in kept])[:, list(JUDGED)]
        constant = np.nanmean(error, axis=0)
        rest = error - constant
        owner = np.array([view.person for view in views])
        own = np.full_like(rest, np.nan)
        for person in np.unique(owner):
            rows = owner == person
            if rows.sum() > 1:
                own[rows] = np.nanmean(rest[rows], axis=0)
        split = np.broadcast_to(constant, error.shape), own, rest - own
        size = [np.sqrt(np.nanmean(part**2, axis=(0, 1))) for part in split]
        lines.append((name, *(" / ".join(f"{axis:.0f}" for axis in part) for part in size)))
    head = ("views of", "of a joint in all views, mm", "of a person, mm", "the rest, mm")
    return sheet_of(head, lines)


def main(data: Data, work: Work) -> Page:
    """Judges what is left to be judged, then writes the page."""
    people = real(data, work)
    bodies = simulated(data, work, DetectorErrors.read(work / "law-OpenPose.json"))
    seen, made = outcomes_of(people, work), outcomes_of(bodies, work)
    apart = functools.partial(table, people, seen)
    values: dict[str, str | int | Sheet] = {
        "draws": f"{STRANGER_DRAWS:,}",
        "roots": STRANGER_ROOTS,
        "table": apart(["shoulders"]),
        "hips": apart(["hips"]),
        "captured": table(bodies, made, ["hips"]),
        "subjects": len(bodies.models),
        "gaps": gaps(people.views),
        "another": f"{person_views.ANOTHER:.0f}",
        "off": by_detection(people, seen, "shoulders"),
        "parts": parts_of_errors(people, seen, "shoulders"),
        "parts_hips": parts_of_errors(people, seen, "hips"),
    }
    pictures = {
        "strangers": picture(people, seen, "shoulders"),
        "strangers-captured": picture(bodies, made, "hips"),
    }
    return Page("strangers", values, pictures)


if __name__ == "__main__":
    run(main)
