"""Do intervals hold for people, detectors and cameras that were never seen? Writes
reports/strangers.md.

    python -m poseterior.reports.pages.strangers ../shared/data work

`work` keeps what each row of views says, and a run that was stopped goes on there.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from poseterior.inference.studies import person_views
from poseterior.inference.studies.errorlaws.definitions import GIRDLES, best_torso
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
from poseterior.probmodel.datasets.person_views import (
    PersonView,
    read_person_views,
    views_of_session,
)
from poseterior.probmodel.layouts import LAYOUTS
from poseterior.probmodel.motion import read_motion
from poseterior.probmodel.sessions import Session, read_session
from poseterior.probmodel.skeleton import JOINT_INDEX, NUM_JOINTS, TORSO_INDEX
from poseterior.reports.pages.page import Data, Page, Work, kept_json, run
from poseterior.reports.tables import Sheet, sheet_of

FILM_VIEWS, ROOM_VIEWS, CAPTURED_VIEWS = 16, 30, 6
"""Of the film by each detector, of the operating room, and of motion capture at each distance."""
STRANGER_DRAWS, STRANGER_ROOTS = 1000, 300
JUDGED_LAWS = ("embedded", "with definitions")
DISTANCES = {1.0: JUDGED_LAWS, 2.5: JUDGED_LAWS[:1]}
"""Metres to the pelvis, and the laws under which views from there are judged."""
IMAGE, FOCAL_OF_IMAGE = 1920.0, 0.8
"""Longer side, pixels, and focal length in longer sides, of the simulated camera."""
TURNED, TILTED = 180.0, 20.0
"""Degrees, at most either way, by which it is turned about the person and looks up or down."""
TWO = np.sqrt(3) / 2
"""By which the difference of two detectors says how far a third one's points lie from their mean:
its standard deviation is that of two, |difference| / √2, and the mean errs too, √(1 + 1/2)."""
OFF = (0.0, 60.0, 120.0, np.inf)
"""Millimetres by which joints are detected off, about the shoulders."""


class Row(NamedTuple):
    """Some views: what they are of, their number, the laws under which they are judged, and how
    they are made."""

    name: str
    number: int
    laws: tuple[str, ...]
    views: Callable[[], list[PersonView]]


def mediapipe(session: Session, data: Path) -> Session:
    """What MediaPipe saw of the person of the film."""
    landmarks = np.load(data / "multicamera" / "mediapipe.npz")["landmarks"]
    layout = LAYOUTS["mediapipe_33"]
    people = tuple(
        tuple(layout.detection(np.asarray(points, float), 0.5, "the film", 0) for points in camera)
        for camera in landmarks
    )
    return dataclasses.replace(session, people=people)


def with_definitions(one: Session, other: Session) -> DetectorErrors:
    """The embedded law with definitions of shoulders and hips: the mean of two detectors on one
    film, and how far a third may lie from it."""
    points = np.concatenate([each.world.points[:, GIRDLES] / one.unit for each in (one, other)], 1)
    whole = np.isfinite(points).all(axis=(1, 2))
    torsos = Anatomy.embedded("wide").torsos[:, [TORSO_INDEX.index(row) for row in GIRDLES]]
    both = best_torso(points[whole], np.tile(np.asarray(torsos), (1, 2, 1))).mean(axis=0)
    # Detector × shoulder or hip × right or left; the sides mirror each other.
    sides = both.reshape(2, 2, 2, 3) * [[-1, 1, 1], [1, 1, 1]]
    mean, apart = sides.mean(axis=(0, 2)), np.abs(np.diff(sides.mean(axis=2), axis=0)[0])
    definition, sd = np.zeros((2, NUM_JOINTS, 3))
    definition[GIRDLES] = (mean[:, None] * [[-1, 1, 1], [1, 1, 1]]).reshape(-1, 3)
    sd[GIRDLES] = np.repeat(TWO * apart, 2, axis=0)
    return dataclasses.replace(DetectorErrors.default(), definition=definition, definition_sd=sd)


def captured(data: Path, law: DetectorErrors, metres: float) -> list[PersonView]:
    """One pose of each of the first subjects that limits were not learned from, before a camera at
    a distance, seen by a detector that errs as the law says."""
    motions = read_motion(data / "cmu" / "extremes")
    subjects = list(dict.fromkeys(motion.subject for motion in motions))[:CAPTURED_VIEWS]
    people = law.definitions(len(subjects))
    assert people is not None
    found = []
    for number, (subject, definition) in enumerate(zip(subjects, people, strict=True)):
        rng = np.random.default_rng([number, round(10 * metres)])
        joints = np.concatenate([one.joints for one in motions if one.subject == subject])
        pose = joints[rng.integers(len(joints))]
        found.append(_seen(pose - pose[0], definition, law, metres, subject, rng))
    return found


def _seen(
    pose: np.ndarray,
    definition: np.ndarray,
    law: DetectorErrors,
    metres: float,
    subject: str,
    rng: np.random.Generator,
) -> PersonView:
    angles = rng.uniform(-TURNED, TURNED), rng.uniform(-TILTED, TILTED)
    down = Rotation.from_euler("x", 180, degrees=True)
    turn = (Rotation.from_euler("x", angles[1], degrees=True) * down).as_matrix()
    turn = turn @ Rotation.from_euler("y", angles[0], degrees=True).as_matrix()
    unit, place = float(body_unit(pose[None])), np.array([0.0, 0.0, 1000 * metres])
    truth = pose @ turn.T + place
    torso = (truth - truth[0])[None, list(TORSO_INDEX)] / unit
    axes = align_torsos(torso, mean_torso(Anatomy.embedded("wide").torsos))[0]
    points = truth + unit * definition @ axes
    focal, middle = FOCAL_OF_IMAGE * IMAGE, np.full(2, IMAGE / 2)
    pixels = focal * points[:, :2] / points[:, 2:] + middle
    size = focal * unit / points[:, 2:]
    stretch = np.sqrt(
        law.law.parameters["df"] / rng.chisquare(law.law.parameters["df"], NUM_JOINTS)
    )
    error = law.sigma[:, None] * stretch[:, None] * rng.normal(size=(NUM_JOINTS, 2))
    far = law.outlier_radius * np.sqrt(rng.random(NUM_JOINTS))
    angle = rng.uniform(0, 2 * np.pi, NUM_JOINTS)
    stray = far[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    error = np.where((rng.random(NUM_JOINTS) < law.inlier)[:, None], error, stray)
    score = np.where(points[:, 2] > 0, 1.0, 0.0)
    keypoints = np.where(score[:, None] > 0, pixels + size * error, np.nan)
    person = Detection(keypoints, score, "skeleton_15", "motion capture", 0)
    return PersonView(person, truth, np.zeros(NUM_JOINTS), Lens(focal, middle), IMAGE, subject)


def judged(row: Row, law: DetectorErrors, views: list[PersonView]) -> list[dict[str, Any]]:
    """What draws say of the views of a row, as plain values."""
    model, likelihood = PoseModel(), Likelihood.of(law)
    units = units_of(views, model)
    found = []
    for seed, view in enumerate(views):
        seen_by = model.seen_by(view.believed("unknown"))
        given = view, units[view.person], seen_by, likelihood, seed
        levels = person_views.judge(*given, STRANGER_DRAWS, STRANGER_ROOTS)
        found.append({name: [part.tolist() for part in one] for name, one in levels.items()})
        print(row.name, seed, flush=True)
    return found


def rows_of(data: Path, film: Session, other: Session, law: DetectorErrors) -> list[Row]:
    """All, in the table's order."""

    def filmed(session: Session) -> list[PersonView]:
        return even(list(filter(of_the_person, views_of_session(film, session.people))), FILM_VIEWS)

    def room() -> list[PersonView]:
        every = read_person_views(data / "mvor" / "mvor.npz")
        return even(list(filter(of_the_person, every)), ROOM_VIEWS)

    return [
        Row("film, OpenPose", 1, JUDGED_LAWS, functools.partial(filmed, film)),
        Row("film, MediaPipe", 2, JUDGED_LAWS, functools.partial(filmed, other)),
        Row("operating room, OpenPose", 3, JUDGED_LAWS[:1], room),
        *(
            Row(
                f"motion capture, {far:g} m",
                4 + row,
                names,
                functools.partial(captured, data, law, far),
            )
            for row, (far, names) in enumerate(DISTANCES.items())
        ),
    ]


def read(kept: list[dict[str, Any]], middle: str) -> list[ViewLevels]:
    """What was kept of some views, about a midpoint."""
    return [ViewLevels(*(np.array(part, float) for part in one[middle])) for one in kept]


def cells(found: Honesty) -> list[str]:
    """Coverage at both levels by axis, with intervals over people; ECE, width and error."""
    wide = [
        f"{100 * value:.0f} ({100 * low:.0f}–{100 * high:.0f})"
        for value, low, high in zip(found.covered[1], found.low[1], found.high[1], strict=True)
    ]
    return [
        *wide,
        " / ".join(f"{100 * value:.0f}" for value in found.covered[0]),
        " / ".join(f"{value:.3f}" for value in found.ece),
        " / ".join(f"{value:.0f}" for value in found.width),
        " / ".join(f"{value:.0f}" for value in found.error),
    ]


def table(outcomes: dict[tuple[str, str], list[Any]], seen: dict[str, list[PersonView]]) -> Sheet:
    """A line for each row of views, law and midpoint."""
    lines = [
        (name, f"{one.people} / {one.views - one.silent}", law, middle, *cells(one))
        for (name, law), found in outcomes.items()
        for middle in MIDDLES
        for one in [honesty(seen[name], read(found, middle))]
    ]
    head = (
        *("views of", "people / views", "law", "about the", "x 95 %", "y 95 %", "depth 95 %"),
        *("50 %, x / y / depth", "ECE", "95 % wide, mm", "error of the mean, mm"),
    )
    return sheet_of(head, lines)


def gaps(seen: dict[str, list[PersonView]]) -> Sheet:
    """A line for each row of real views: how far detections lie beside the truth in the image."""
    lines = []
    for name, views in seen.items():
        own = {middle: person_views.beside_truth(views, pair) for middle, pair in MIDDLES.items()}
        lines.append((name, *(f"{gap[0]:.0f} / {gap[1]:.0f}" for gap in own.values())))
    head = ("views of", *(f"{middle}, right / down, mm" for middle in MIDDLES))
    return sheet_of(head, lines)


def by_detection(
    outcomes: dict[tuple[str, str], list[Any]], seen: dict[str, list[PersonView]], middle: str
) -> Sheet:
    """Real views together under the embedded law: coverage of joints by how far off they were
    detected, beside the midpoint."""
    level, off = [], []
    for name, views in seen.items():
        for view, one in zip(views, read(outcomes[name, JUDGED_LAWS[0]], middle), strict=True):
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


def parts(
    outcomes: dict[tuple[str, str], list[Any]], seen: dict[str, list[PersonView]], middle: str
) -> Sheet:
    """Of the error of the mean: what is the same in all views of a joint, what a person's views
    have in common beyond that, and the rest; root mean squares by axis."""
    lines = []
    for name, views in seen.items():
        error = np.stack([one.error for one in read(outcomes[name, JUDGED_LAWS[0]], middle)])
        error = error[:, list(JUDGED)]
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
    film = read_session(data / "multicamera")
    other = mediapipe(film, data)
    laws = {JUDGED_LAWS[0]: DetectorErrors.default(), JUDGED_LAWS[1]: with_definitions(film, other)}
    rows = rows_of(data, film, other, laws[JUDGED_LAWS[1]])
    seen = {row.name: row.views() for row in rows}
    outcomes = {
        (row.name, name): kept_json(
            work / f"{row.number}-{name.split()[0]}.json", judged, row, laws[name], seen[row.name]
        )
        for row in rows
        for name in row.laws
    }
    real = {row.name: seen[row.name] for row in rows[:3]}
    others = [not of_the_person(view) for view in views_of_session(film, other.people)]
    hip = laws[JUDGED_LAWS[1]].definition_sd[JOINT_INDEX["left_hip"]]
    values: dict[str, str | int | Sheet] = {
        "draws": f"{STRANGER_DRAWS:,}",
        "roots": STRANGER_ROOTS,
        "table": table(outcomes, seen),
        "gaps": gaps(real),
        "others": f"{sum(others)} of {len(others)}",
        "another": f"{person_views.ANOTHER:.0f}",
        "off": by_detection(outcomes, real, "shoulders"),
        "parts": parts(outcomes, real, "shoulders"),
        "parts_hips": parts(outcomes, real, "hips"),
        "hip": " / ".join(f"{338 * axis:.0f}" for axis in hip),
    }
    return Page("strangers", values)


if __name__ == "__main__":
    run(main)
