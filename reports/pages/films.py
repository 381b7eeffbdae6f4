"""Do the paths of films hold, and what are they beside what people use? Writes reports/films.md.

    python -m poseterior.reports.pages.films ../shared/data work

The person on the beam, judged by the cameras that are left out, and captured people of whom no
limits were learned. `work` keeps the draws, and a run that was stopped goes on there.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.stats import chi2, norm

from poseterior.inference.estimators import Estimating
from poseterior.inference.films.film import (
    CUTOFF,
    FRAMES_FOLDER,
    NUM_PATHS,
    film_draws,
    sample_film,
)
from poseterior.inference.footage import Footage, Item
from poseterior.inference.stream import all_draws, open_stream
from poseterior.inference.studies.intervals import TAIL
from poseterior.inference.studies.measured import MeasureStandings, standings_of
from poseterior.probmodel import Detection, DetectorErrors, Likelihood, PoseModel
from poseterior.probmodel.body import body_unit
from poseterior.probmodel.camera import Lens
from poseterior.probmodel.datasets.sessions import judged_views
from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.layouts import MIDPOINTS, corrected, without_midpoints
from poseterior.probmodel.level import level_axes
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.motion.lowpass import butterworth
from poseterior.probmodel.sessions import Session, read_session
from poseterior.probmodel.skeleton import BONES, JOINT_INDEX, NUM_JOINTS
from poseterior.reports.figures.style import FAINT, INK, SMALL, TEXT, page, tidy
from poseterior.reports.pages.honest import STRETCH
from poseterior.reports.pages.measures import Measured, overview, within
from poseterior.reports.pages.page import Data, Page, Work, run
from poseterior.reports.pages.people import Strangers, strangers, together
from poseterior.reports.pages.strangers import camera_turn, seen_from
from poseterior.reports.tables import Sheet, sheet_of
from poseterior.reports.tables.sheet import NOTHING
from poseterior.reports.tables.words import spoken

CAPTURED_RATE, CAPTURED_SECONDS = 30.0, 2.0
CAPTURED_PEOPLE = 12
OTHER_RATES = (15.0, 60.0)
"""Frames a second at which some of the captured people are filmed, too."""
RATED_PEOPLE = 3
METRES = 4.0
"""From the simulated camera to the pelvis."""
AS_DEFINED = np.zeros((NUM_JOINTS, 3))
"""The simulated detector means the joints that the model has."""
ERROR_SHARES, ERRORS_LAST = (0.4, 0.5, 0.1), 0.15
"""Of the variance of simulated errors: what stays the same, what lasts (seconds), and what is new
in every frame; about as on the film."""
LAGS = (0.1, 0.5)
"""Seconds over which changes are judged."""
SHOWN_PATHS = 6
JUDGED_ENDS = [bone.end for bone in BONES]
HIPS = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
HEAVIEST = "frame by frame, the heaviest hypothesis"
ALONE = "frame by frame, all draws"
SMOOTHED = "frame by frame, each draw smoothed"
FILM_WAY = "film"
BEAM_WEAK, BEAM_UNKNOWN = "beam, weak perspective", "beam, unknown camera"
BEAM_KNOWN = "beam, `--focal`"
BEAM_CAMERAS = {BEAM_WEAK: "", BEAM_UNKNOWN: "-unknown", BEAM_KNOWN: "-focal"}
"""What films of one camera on the beam take it for, and what is put to their names."""
PAIRS = "beam, two cameras"
LIMB_TIPS = [
    JOINT_INDEX[name] for name in ("right_wrist", "left_wrist", "right_ankle", "left_ankle")
]


class TrueFilm(NamedTuple):
    """A film and its truth.

    Attributes
    ----------
    name : what it is of.
    people : what was detected in each frame.
    truth : `(frames, 15, 3)` mm, the camera's axes, or a world's level ones; NaN where it is not
        known.
    doubt : `(frames, 15, 3, 3)` mm, what makes its own errors of standard normals.
    lens : the camera's; None where nothing is to be known of it.
    rate : frames a second.
    axes : `(3, 3)` columns, along which coordinates are judged: last that of which cameras say
        least.
    model : learned from others, of people from whom the embedded one was learned.
    """

    name: str
    people: list[Detection] | Footage
    truth: np.ndarray
    doubt: np.ndarray
    lens: Lens | None
    rate: float
    axes: np.ndarray = np.eye(3)
    model: PoseModel | None = None

    @property
    def alone(self) -> list[Detection]:
        """The person in each frame of one camera."""
        assert not isinstance(self.people, Footage)
        return self.people

    @property
    def unit(self) -> float:
        """Millimetres of a body unit."""
        if isinstance(self.people, Footage):
            return self.people.world.unit_mm
        return body_unit(self.truth[np.isfinite(self.truth).all(axis=(1, 2))])

    def errors(self, number: int, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """`(number, rows, 15, 3)` mm: of the truth, those of a joint lasting as a detector's do."""
        each = [_lasting((NUM_JOINTS, 3), len(rows), self.rate, rng) for _ in range(number)]
        return np.einsum("fjab,nfjb->nfja", self.doubt[rows], np.stack(each))


def beam(data: Path, believed: str) -> list[TrueFilm]:
    """The film of every camera, of which this is believed (`BEAM_CAMERAS`), and what the three
    others say."""
    session = read_session(data / "multicamera")
    found = []
    for view in judged_views(session):
        camera = session.straight[view.camera]
        focal, principal = float(camera.focal[0]), camera.principal
        lenses = {
            BEAM_WEAK: None,
            BEAM_KNOWN: Lens(focal, principal),
            BEAM_UNKNOWN: Lens.unknown(2 * float(np.max(principal)), principal),
        }
        people = [
            corrected(
                dataclasses.replace(
                    session.people[view.camera][row],
                    keypoints=session.keypoints[view.camera][row],
                )
            )
            for row in view.rows
        ]
        found.append(
            TrueFilm(
                f"beam-{session.labels[view.camera]}{BEAM_CAMERAS[believed]}",
                people,
                without_midpoints(camera.view(view.world.points), MIDPOINTS),
                camera.rotation @ doubt_of(session, view.world.covariance),
                lenses[believed],
                60.0,
            )
        )
    return found


def beam_of_pairs(data: Path) -> list[TrueFilm]:
    """The film of every two cameras, and what the two others say."""
    session = read_session(data / "multicamera")
    every = range(len(session.cameras))
    found = []
    for pair in itertools.combinations(every, 2):
        footage = Footage(session, pair)
        world = footage.world
        own, others = session.by(pair), session.by([*set(every) - set(pair)])
        level = level_axes(world.up)
        known = np.nanmean(level @ own.covariance[:, HIPS] @ level.T, axis=(0, 1))
        found.append(
            TrueFilm(
                f"beam-{'-'.join(world.views)}",
                footage,
                world.unit_mm * world.told(without_midpoints(others.points, MIDPOINTS)),
                level @ doubt_of(session, others.covariance),
                None,
                60.0,
                np.linalg.eigh(known)[1],
            )
        )
    return found


def doubt_of(session: Session, covariance: np.ndarray) -> np.ndarray:
    """`(frames, 15, 3, 3)` mm: what makes errors of triangulated joints, whose covariances are in
    squared strays, of standard normals; nothing where a joint is not known."""
    known = np.isfinite(covariance).all(axis=(-2, -1))[..., None, None]
    root = np.linalg.cholesky(np.where(known, covariance, np.eye(3)))
    return np.where(known, root, 0.0) * session.stray[:, None, None]


def captured_films(
    parts: Sequence[Strangers], law: DetectorErrors, rate: float, people: int
) -> list[TrueFilm]:
    """The first subjects, each in the middle of a recording, before a camera that stands still, by
    a detector whose errors last; their models were learned from others."""
    motions, models = together(parts)
    longest = {one.subject: one for one in sorted(motions, key=lambda one: len(one.joints))}
    seconds = {name: len(one.joints) / one.frame_rate for name, one in longest.items()}
    some = [longest[name] for name in sorted(longest) if seconds[name] >= CAPTURED_SECONDS]
    some = some[:people]
    return [
        captured(motion, law, rate, number)._replace(model=models[motion.subject])
        for number, motion in enumerate(some)
    ]


def captured(
    motion: Motion,
    law: DetectorErrors,
    rate: float,
    number: int,
    seconds: float = CAPTURED_SECONDS,
) -> TrueFilm:
    """The first seconds of a recording, before a camera that stands still, by a detector whose
    errors last; the number is that of a seed."""
    rng = np.random.default_rng([number, round(rate)])
    # Captured at 30 frames a second; what is between them, splines say.
    times = np.arange(0, seconds - 1 / motion.frame_rate, 1 / rate)
    known = np.arange(len(motion.joints)) / motion.frame_rate
    joints = CubicSpline(known, motion.joints - motion.joints[0, 0])(times)
    errors = lasting_errors(law, len(joints), rate, rng)
    turn = camera_turn(rng)
    views = [
        seen_from(turn, pose, AS_DEFINED, error, METRES, motion.subject)
        for pose, error in zip(joints, errors, strict=True)
    ]
    return TrueFilm(
        f"captured-{motion.subject}-{rate:g}",
        [one.detection for one in views],
        np.stack([one.truth for one in views]),
        np.zeros((len(views), NUM_JOINTS, 3, 3)),
        None,
        rate,
    )


def lasting_errors(
    law: DetectorErrors, frames: int, rate: float, rng: np.random.Generator
) -> np.ndarray:
    """`(frames, 15, 2)` body units: errors whose every frame is as the law says, outliers among
    them, in three parts as `ERROR_SHARES` has them."""
    assert isinstance(law.law, Student)
    z = _lasting((NUM_JOINTS, 3), frames, rate, rng)
    freedom = law.law.df
    stretch = np.sqrt(freedom / chi2.ppf(norm.cdf(z[..., 2]), freedom))
    error = law.bias + (law.sigma * stretch)[..., None] * z[..., :2]
    far = law.outlier_radius * np.sqrt(rng.random((frames, NUM_JOINTS)))
    angle = rng.uniform(0, 2 * np.pi, far.shape)
    stray = far[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.where((rng.random(far.shape) < law.inlier)[..., None], error, stray)


def _lasting(
    shape: tuple[int, ...], frames: int, rate: float, rng: np.random.Generator
) -> np.ndarray:
    """`(frames, *shape)`: standard normals in every frame, in three parts."""
    kept = np.exp(-1 / (rate * ERRORS_LAST))
    slow = rng.standard_normal((frames, *shape))
    for row in range(1, frames):
        slow[row] = kept * slow[row - 1] + np.sqrt(1 - kept**2) * slow[row]
    parts = rng.standard_normal(shape), slow, rng.standard_normal((frames, *shape))
    return sum(np.sqrt(share) * part for share, part in zip(ERROR_SHARES, parts, strict=True))


def drawn(film: TrueFilm, work: Path) -> Path:
    """The folder of a film's paths, drawn where there is none."""
    out = work / film.name
    if not (out / "run.json").exists():
        model, law = film.model or PoseModel(), Likelihood.of(DetectorErrors.default())
        model = model if film.lens is None else model.seen_by(film.lens)
        people = film.people
        items = people if isinstance(people, Footage) else named(people)
        sample_film(
            model,
            items,
            rate=film.rate,
            key=0,
            out=out,
            estimating=Estimating(likelihood=law),
        )
        print(film.name, flush=True)
    return out


def named(people: list[Detection]) -> list[Item]:
    """Frames of a film, by their numbers."""
    return [Item(f"{row:04d}", person) for row, person in enumerate(people)]


Ways = Mapping[str, np.ndarray]
"""By the name of a way, paths `(n, frames, 15, 3)`, mm about the hips."""


def ways_of(film: TrueFilm, out: Path) -> tuple[Ways, np.ndarray]:
    """Ways to a motion, and the rows of the truth that their frames are."""
    paths = film_draws(out)
    rows = np.array([int(str(name)) for name in paths.frame.values])
    alone = {int(name): one.joints.values[0] for name, one in all_draws(out / FRAMES_FOLDER)}
    there = np.array([len(alone[row]) > 0 for row in rows])
    each = np.full(paths.joints.shape[1:], np.nan)
    for at, row in enumerate(rows):
        if there[at]:
            each[:, at] = alone[row]
    smooth = each.copy()
    smooth[:, there] = butterworth(each[:, there].swapaxes(0, 1), film.rate, CUTOFF).swapaxes(0, 1)
    heaviest = open_stream(out / FRAMES_FOLDER)["hypotheses"].joints.values[:, 0]
    found = {
        HEAVIEST: heaviest[rows][None],
        ALONE: each,
        SMOOTHED: smooth,
        FILM_WAY: paths.joints.values[0].astype(float),
    }
    return {name: film.unit * about_hips(one) for name, one in found.items()}, rows


def about_hips(joints: np.ndarray) -> np.ndarray:
    """Joints about the midpoint of the hips."""
    return joints - joints[..., HIPS, :].mean(axis=-2, keepdims=True)


class PathsJudged(NamedTuple):
    """What a way is worth on one film.

    Attributes
    ----------
    covered : `(1 + lags, 3)` how often 95 % intervals hold coordinates, and changes over `LAGS`.
    width : `(1 + lags, 3)` mm, their median widths.
    error : mm, of the mean path, mean over joints and frames.
    jitter : mm, median length of third differences of the mean path's wrists and ankles, at 60
        frames a second or the film's rate if it is less.
    """

    covered: np.ndarray
    width: np.ndarray
    error: float
    jitter: float


def judge(
    paths: np.ndarray, film: TrueFilm, rows: np.ndarray, rng: np.random.Generator
) -> PathsJudged:
    """A way's paths `(n, frames, 15, 3)` against the truth, whose own errors they are given."""
    truth = about_hips(film.truth[rows])
    own = film.errors(len(paths), rows, rng)
    noisy = about_hips(paths + own)[:, :, JUDGED_ENDS] @ film.axes
    true = truth[:, JUDGED_ENDS] @ film.axes
    kinds = [(noisy, true)]
    for lag in LAGS:
        step = round(lag * film.rate)
        kinds.append((noisy[:, step:] - noisy[:, :-step], true[step:] - true[:-step]))
    ends = [intervals(one) for one, _ in kinds]
    covered = np.array([_held(end, true) for end, (_, true) in zip(ends, kinds, strict=True)])
    width = np.array([np.nanmedian(high - low, axis=(0, 1)) for low, high in ends])
    mean = paths.mean(axis=0)
    gone = np.linalg.norm((mean - truth)[:, JUDGED_ENDS], axis=-1)
    return PathsJudged(covered, width, float(np.nanmean(gone)), jitter(mean))


def intervals(paths: np.ndarray) -> np.ndarray:
    """`(2, ...)`: both ends of central 95 % intervals of paths `(n, ...)`."""
    return np.quantile(paths, (TAIL, 1 - TAIL), axis=0)


def _held(ends: np.ndarray, truth: np.ndarray) -> list[float]:
    """By axis, how often intervals hold what is known of the truth."""
    low, high = ends
    known = np.isfinite(truth) & np.isfinite(low)
    inside = (low <= truth) & (truth <= high)
    return [float(inside[..., axis][known[..., axis]].mean()) for axis in range(3)]


def jitter(path: np.ndarray) -> float:
    """mm: median third difference of the ends of limbs of a path `(frames, 15, 3)`."""
    third = np.diff(path[:, LIMB_TIPS], 3, axis=0)
    return float(np.nanmedian(np.linalg.norm(third, axis=-1)))


def rows_of(films: list[TrueFilm], work: Path) -> dict[str, list[PathsJudged]]:
    """By way, what it is worth on each film."""
    found: dict[str, list[PathsJudged]] = {}
    for number, film in enumerate(films):
        ways, rows = ways_of(film, drawn(film, work))
        for name, paths in ways.items():
            rng = np.random.default_rng(number)
            found.setdefault(name, []).append(judge(paths, film, rows, rng))
    return found


def table(groups: Mapping[str, list[TrueFilm]], work: Path) -> Sheet:
    """A line for each group of films and way; coverage is a mean over films."""
    lines = [
        (f"{name}, {way}", *_cells(way, films, judged))
        for name, films in groups.items()
        for way, judged in rows_of(films, work).items()
    ]
    return sheet_of(HEAD, lines)


HEAD = (
    "films, and the way",
    "coordinates",
    *(f"changes in {lag:g} s" for lag in LAGS),
    "95 % wide, mm: coordinates",
    *(f"changes, {lag:g} s" for lag in LAGS),
    "error of the mean, mm",
    "jitter, mm",
    "the truth's",
)


def _cells(way: str, films: list[TrueFilm], judged: list[PathsJudged]) -> list[str]:
    shares = [held_of(judged, slice(kind, kind + 1)) for kind in range(1 + len(LAGS))]
    width = np.mean([one.width for one in judged], axis=0)
    if way == HEAVIEST:
        shares = wide = [NOTHING] * len(shares)
    else:
        wide = [" / ".join(f"{axis:.0f}" for axis in row) for row in width]
    means = [float(np.mean([getattr(one, name) for one in judged])) for name in ("error", "jitter")]
    true = float(np.mean([jitter(about_hips(film.truth)) for film in films]))
    return [*shares, *wide, f"{means[0]:.0f}", f"{means[1]:.1f}", f"{true:.1f}"]


def held_of(judged: list[PathsJudged], kinds: slice) -> str:
    """How often intervals hold, %, by axis, of coordinates or of changes."""
    covered = 100 * np.mean([one.covered for one in judged], axis=0)[kinds]
    return ", and ".join(" / ".join(f"{axis:.0f}" for axis in row) for row in covered)


def depth_of(judged: list[PathsJudged]) -> str:
    """mm: the median width of coordinates along the last axis."""
    return f"{np.mean([one.width[0, 2] for one in judged]):.0f}"


def measured(films: list[TrueFilm], work: Path) -> Measured:
    """Where the truth's angles and lengths stand among those of paths, frame by frame."""
    found, cluster = [], []
    for number, film in enumerate(films):
        ways, rows = ways_of(film, drawn(film, work))
        paths, rng = ways[FILM_WAY], np.random.default_rng([number, 48])
        truth = about_hips(film.truth[rows])
        noisy = about_hips(paths + film.errors(len(paths), rows, rng))
        for at, row in enumerate(rows):
            found.append(standings_of(truth[at], noisy[:, at], paths[:, at], rng))
            # Of one person, stretches of the film; of several, people.
            cluster.append(row // STRETCH if film.doubt.any() else number)
    parts = map(np.stack, zip(*found, strict=True))
    return Measured(MeasureStandings(*parts), np.array(cluster))


def inside_limits(groups: list[list[TrueFilm]], work: Path) -> float:
    """The share of poses of paths that the limits allow."""
    embedded, found = PoseModel(), []
    for film in (film for films in groups for film in films):
        limits = (film.model or embedded).limits
        some = film_draws(drawn(film, work)).joints.values[0, ::20].astype(float)
        found.append(limits.check(some.reshape(-1, NUM_JOINTS, 3)).pose_valid.mean())
    return float(np.mean(found))


def picture(film: TrueFilm, out: Path) -> Figure:
    """Depth of a wrist and an ankle: what frames say one by one, and paths, beside the truth."""
    ways, rows = ways_of(film, out)
    truth = about_hips(film.truth[rows])
    figure = page(11.0, 5.0)
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    seconds = rows / film.rate
    for row, joint in zip(panels, ("right_wrist", "left_ankle"), strict=True):
        at = JOINT_INDEX[joint]
        for axis, way in zip(row, (ALONE, FILM_WAY), strict=True):
            depth = ways[way][:, :, at, 2]
            low, high = intervals(depth)
            axis.fill_between(seconds, low, high, color=FAINT, alpha=0.35, lw=0)
            axis.plot(seconds, depth[:SHOWN_PATHS].T, lw=0.8, alpha=0.8)
            axis.plot(seconds, truth[:, at, 2], color=INK, lw=2.0)
            axis.set_title(f"{spoken(joint)}: {way}", fontsize=TEXT, loc="left")
            tidy(axis)
        row[0].set_ylabel("depth behind the hips, mm", fontsize=SMALL)
    for axis in panels[-1]:
        axis.set_xlabel("seconds", fontsize=SMALL)
    return figure


def main(data: Data, work: Work) -> Page:
    """Draws what is left to be drawn, then writes the page."""
    law = DetectorErrors.default()
    real = {
        **{name: beam(data, name) for name in BEAM_CAMERAS},
        PAIRS: beam_of_pairs(data),
    }
    parts = strangers(work, data)
    held = captured_films(parts, law, CAPTURED_RATE, CAPTURED_PEOPLE)
    made = {f"captured, {CAPTURED_RATE:g} a second": held}
    made |= {
        f"captured, {rate:g} a second": captured_films(parts, law, rate, RATED_PEOPLE)
        for rate in OTHER_RATES
    }
    of_measures = {
        BEAM_UNKNOWN: measured(real[BEAM_UNKNOWN], work),
        BEAM_KNOWN: measured(real[BEAM_KNOWN], work),
        PAIRS: measured(real[PAIRS], work),
        "captured": measured(held, work),
    }
    unknown_within, focal_within, pairs_within, captured_within = (
        within(one.scores) for one in of_measures.values()
    )
    judged_unknown, judged_focal, judged_pairs = (
        rows_of(real[name], work)[FILM_WAY] for name in (BEAM_UNKNOWN, BEAM_KNOWN, PAIRS)
    )
    constant, slow, quick = (f"{100 * share:.0f}" for share in ERROR_SHARES)
    values: dict[str, str | int | Sheet] = {
        "constant": constant,
        "slow": slow,
        "quick": quick,
        "lasting": f"{ERRORS_LAST:g}",
        "cutoff": f"{CUTOFF:g}",
        "paths": NUM_PATHS,
        "inside": f"{100 * inside_limits([*real.values(), *made.values()], work):.0f}",
        "real": table(real, work),
        "captured": table(made, work),
        "measures": overview(of_measures),
        "unknown_within": unknown_within,
        "focal_within": focal_within,
        "pairs_within": pairs_within,
        "unknown_held": held_of(judged_unknown, slice(1)),
        "unknown_depth": depth_of(judged_unknown),
        "focal_depth": depth_of(judged_focal),
        "pairs_depth": depth_of(judged_pairs),
        "pairs_held": held_of(judged_pairs, slice(1)),
        "pairs_changes": held_of(judged_pairs, slice(1, None)),
        "captured_within": captured_within,
        "people": len(held),
        "rated": RATED_PEOPLE,
        "metres": f"{METRES:g}",
        "seconds": f"{CAPTURED_SECONDS:g}",
    }
    first = real[BEAM_KNOWN][0]
    return Page("films", values, {"films": picture(first, drawn(first, work))})


if __name__ == "__main__":
    run(main)
