"""One body from two or three calibrated cameras, judged by those that are left out, and faults
planted in one view of four: writes reports/cameras.md.

    python -m poseterior.reports.pages.cameras ../shared/data work

The law and how far cameras point beside their calibration are learned from the other half of the
film. `work` keeps what is judged, and a run that was stopped goes on there.
"""

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.draws import Draws
from poseterior.inference.importance.views.weighted import WeightedViews
from poseterior.inference.importance.weighted import FEWEST_EFFECTIVE
from poseterior.inference.studies.intervals import TAIL, Interval, of_share
from poseterior.probmodel import DetectorErrors, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, ORDERS
from poseterior.probmodel.instant import CameraView, Instant
from poseterior.probmodel.layouts import without_midpoints
from poseterior.probmodel.rows import evenly
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.sessions.session import ASSUMED_POINTING, HIPS, joints_seen
from poseterior.probmodel.sessions.timing import lags_of
from poseterior.probmodel.sessions.turning import turns_of
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, SMALL, TEXT, page, tidy
from poseterior.reports.pages.filmed import PARTS, Film, film, learn_as
from poseterior.reports.pages.honest import STRETCH
from poseterior.reports.pages.measures import within
from poseterior.reports.pages.page import Data, Page, Work, kept_json, run
from poseterior.reports.pages.posed import camera_turned, posed_table
from poseterior.reports.pages.viewed_measures import measured_beside, scores_of_pairs
from poseterior.reports.tables import Column, Sheet, sheet_of
from poseterior.reports.tables.frames import BELIEVED
from poseterior.reports.tables.measured import measure_scores_table

JUDGED_FRAMES = 20
"""Instants of the film at which every pair and every three of the cameras are judged."""
FAULTY_FRAMES = 100
"""Instants that get each fault, in one camera after the other."""
JUDGED_DRAWS, JUDGED_ROOTS = 1000, 800
FROM_POSTERIOR, BY_TRIANGULATION = WAYS = "posterior", "triangulation"
JUDGED_AXES = {
    2: {"depth": slice(0, 1), "side": slice(1, None)},
    3: {"image": slice(None)},
}
"""By the number of cameras: that axis of which a pair says least, and those across it; the image of
the camera that three leave out."""
SETS = {number: list(itertools.combinations(range(4), number)) for number in JUDGED_AXES}
"""By number, the cameras that are judged by the others."""
WRIST = JOINT_INDEX["right_wrist"]
UNTOUCHED, EXCHANGED_LEGS = "nothing", "legs exchanged"
MOVED = {"a wrist moved": 0.5, "a wrist moved far": 1.0}
"""Body units by which a wrist's keypoint is moved."""
PLANTED_LAGS = 5, -5
"""Frames by which one camera is behind the others."""
PLANTED_TURNS = list(itertools.product(range(2), (2.0, -2.0)))
"""About which of a camera's axes, and by how many degrees, it is turned."""
PLANTED = UNTOUCHED, *MOVED, EXCHANGED_LEGS


class Beliefs(NamedTuple):
    """What is learned from the other half of the film: how detections err, in which the outliers
    and exchanges are those of the embedded law; how far cameras point beside their calibration,
    degrees; and mm by which a joint's detection strays, `(15,)`."""

    likelihood: Likelihood
    pointing: float
    stray: np.ndarray


class CameraStanding(NamedTuple):
    """Of the limbs' joints, by axis `(8, A)`: the share of draws below the truth, whose errors they
    are given, the error of the mean, and the width of the draws' 95 % intervals, mm."""

    level: np.ndarray
    error: np.ndarray
    width: np.ndarray


def beliefs(seen: Film) -> list[Beliefs]:
    """By part of the film, from the rest of it."""
    default = Likelihood.of(DetectorErrors.default())
    found = []
    for part in range(PARTS):
        rest = seen.unseen(part)
        learned = Likelihood.of(learn_as(rest, perspective=True).errors)
        law = dataclasses.replace(learned, faults=default.faults)
        found.append(Beliefs(law, rest.pointing, rest.stray))
    return found


def frames_of(session: Session, number: int) -> list[int]:
    """So many rows, evenly over the film."""
    return evenly(len(session), number).tolist()


def draws_of(
    model: PoseModel, session: Session, row: int, cameras: Sequence[int], given: Beliefs
) -> np.ndarray:
    """`(n, 15, 3)`: joints in the world, mm."""
    instant = session.instant(session.numbers[row], cameras).judged_by(given.likelihood)
    return in_world(drawn_of(model, dataclasses.replace(instant, pointing=given.pointing), row))


def drawn_of(model: PoseModel, instant: Instant, seed: int) -> Draws:
    """Draws of an instant."""
    sampler = WeightedViews(num_roots=JUDGED_ROOTS)
    return sampler.draw(instant.posterior(model), jax.random.key(seed), JUDGED_DRAWS)


def in_world(draws: Draws) -> np.ndarray:
    """`(n, 15, 3)`: joints of draws in the world, mm."""
    size = np.exp(draws.points.log_size)[:, None, None]
    return np.asarray(draws.points.place)[:, None] + size * np.asarray(draws.joints)


def triangulated(
    session: Session, row: int, cameras: Sequence[int], given: Beliefs
) -> tuple[np.ndarray, np.ndarray]:
    """Joints `(15, 3)` by some cameras, mm, and the covariances `(15, 3, 3)` that go with them."""
    views = [session.straight[one] for one in cameras]
    rows = list(cameras)
    seen = joints_seen(views, session.keypoints[rows][:, [row]], session.score[rows][:, [row]])
    return seen.points[0], seen.covariance[0] * given.stray[:, None, None] ** 2


def scattered(mean: np.ndarray, doubt: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """`(n, 15, 3)`: draws of joints whose means and covariances are known."""
    normal = rng.standard_normal((JUDGED_DRAWS, 15, 3))
    return mean + np.einsum("jab,njb->nja", np.linalg.cholesky(doubt), normal)


def true_errors(
    session: Session, row: int, others: Sequence[int], given: Beliefs, rng: np.random.Generator
) -> np.ndarray:
    """`(n, 15, 3)` mm: errors of what other cameras triangulate, whose detections stray, and which
    point beside, as is believed."""
    rows = list(others)
    views = [session.straight[one] for one in others]
    scale = session.scale[rows, row][:, None, None, None]
    size = len(rows), JUDGED_DRAWS
    strays = given.stray[:, None] * rng.standard_normal((*size, 15, 2)) * scale
    focal = np.array([view.focal[0] for view in views])[:, None, None, None]
    point = np.tan(np.radians(given.pointing)) * focal * rng.standard_normal((*size, 1, 2))
    xy, score = session.keypoints[rows][:, [row]], session.score[rows][:, [row]]
    many = np.repeat(score, JUDGED_DRAWS, axis=1)
    moved = joints_seen(views, xy + strays + point, many).points
    return moved - joints_seen(views, xy, score).points


@dataclasses.dataclass(frozen=True)
class TruthOfOthers:
    """What cameras that a posterior has not seen say of the limbs' joints, `joints` `(8, A)` mm
    about the middle of all; the `errors` `(n, 8, A)` that this may have; and what makes of joints
    of the world `(n, 15, 3)` such coordinates."""

    joints: np.ndarray
    errors: np.ndarray
    of: Callable[[np.ndarray], np.ndarray]


def truth_beside(
    session: Session, row: int, cameras: Sequence[int], doubt: np.ndarray, given: Beliefs
) -> TruthOfOthers:
    """What the others say beside some cameras, whose joints have the covariances `doubt`
    `(15, 3, 3)`: of two others in axes of which the judged cameras say least first; of one in its
    image."""
    others = [one for one in range(len(session.cameras)) if one not in cameras]
    rng = np.random.default_rng([row, *cameras])
    if len(others) == 1:
        return truth_in_image(session, row, others[0], given, rng)
    errors = true_errors(session, row, others, given, rng)
    _, axes = np.linalg.eigh(doubt[HIPS].mean(axis=0))
    axes = axes[:, ::-1]
    joints = triangulated(session, row, others, given)[0]
    return TruthOfOthers(
        _limbs(joints @ axes), _limbs(errors @ axes), lambda draws: _limbs(draws @ axes)
    )


def truth_in_image(
    session: Session, row: int, other: int, given: Beliefs, rng: np.random.Generator
) -> TruthOfOthers:
    """What one camera saw, mm at the person's distance. Where it points beside, it does so for all
    joints, which are taken about their middle."""
    camera, scale = session.straight[other], session.scale[other, row]
    errors = given.stray[:, None] * rng.standard_normal((JUDGED_DRAWS, 15, 2))

    def of(draws: np.ndarray) -> np.ndarray:
        return _limbs(camera.project(draws) / scale)

    return TruthOfOthers(_limbs(session.keypoints[other, row] / scale), _limbs(errors), of)


def _limbs(joints: np.ndarray) -> np.ndarray:
    """`(..., 8, A)`: the limbs' joints about the middle of all."""
    return (joints - joints.mean(axis=-2, keepdims=True))[..., LIMB_JOINTS, :]


def judged(draws: np.ndarray, truth: TruthOfOthers) -> CameraStanding:
    """Draws of joints `(n, 15, 3)` of the world beside what the other cameras say."""
    points = truth.of(draws)
    low, high = np.quantile(points, [TAIL, 1 - TAIL], axis=0)
    level = (points + truth.errors < truth.joints).mean(axis=0)
    level = np.where(np.isfinite(truth.joints), level, np.nan)
    return CameraStanding(level, np.abs(points.mean(axis=0) - truth.joints), high - low)


def measure_pair(seen: Film, given: list[Beliefs], cameras: Sequence[int]) -> dict[str, Any]:
    """By way, the standings of measures of a pair of cameras, beside what the others say."""
    model, session = PoseModel(), seen.session
    rows = frames_of(session, JUDGED_FRAMES)
    others = [one for one in range(len(session.cameras)) if one not in cameras]
    found: dict[str, list[Any]] = {way: [] for way in WAYS} | {"rows": rows}
    for row in rows:
        own = given[seen.part_of(row)]
        rng = np.random.default_rng([row, *cameras, 46])
        truth = triangulated(session, row, others, own)[0]
        errors = true_errors(session, row, others, own, rng)
        strewn = scattered(*triangulated(session, row, cameras, own), rng)
        draws = {
            FROM_POSTERIOR: draws_of(model, session, row, cameras, own),
            BY_TRIANGULATION: without_midpoints(strewn, session.midpoints),
        }
        for way, joints in draws.items():
            found[way].append(measured_beside(session, joints, truth, errors, rng))
    return found


def judge_cameras(seen: Film, given: list[Beliefs], cameras: Sequence[int]) -> dict[str, Any]:
    """By way, the standings of some cameras, lists of rows."""
    model, session = PoseModel(), seen.session
    rows = frames_of(session, JUDGED_FRAMES)
    found: dict[str, list[Any]] = {way: [] for way in WAYS} | {"rows": rows}
    for row in rows:
        own = given[seen.part_of(row)]
        rng = np.random.default_rng([row, len(cameras)])
        mean, doubt = triangulated(session, row, cameras, own)
        truth = truth_beside(session, row, cameras, doubt, own)
        draws = {
            FROM_POSTERIOR: draws_of(model, session, row, cameras, own),
            BY_TRIANGULATION: scattered(mean, doubt, rng),
        }
        for way, joints in draws.items():
            found[way].append([part.tolist() for part in judged(joints, truth)])
    return found


def planted(view: CameraView, kind: str, unit: float) -> CameraView:
    """A view with a fault; `unit` pixels are a body unit there."""
    person = view.detection
    keypoints = person.keypoints.copy()
    if kind in MOVED:
        keypoints[WRIST, 0] += MOVED[kind] * unit
    if kind == EXCHANGED_LEGS:
        keypoints = keypoints[ORDERS[EXCHANGE_INDEX["legs"]]]
    return dataclasses.replace(view, detection=dataclasses.replace(person, keypoints=keypoints))


class FaultyInstants(NamedTuple):
    """For instants with a fault each: probabilities of outliers `(n, 4, 15)`, of exchanged legs
    `(n, 4)`, the `view` `(n,)` that has the fault, and of the limbs' joints the `mean` `(n, 8, 3)`
    and the `width` of the 95 % intervals, mm."""

    outlier: np.ndarray
    legs: np.ndarray
    view: np.ndarray
    mean: np.ndarray
    width: np.ndarray


def find_faults(seen: Film, given: list[Beliefs], kind: str) -> list[Any]:
    """For each instant what `FaultyInstants` have, as lists."""
    model, session, found = PoseModel(), seen.session, []
    for number, row in enumerate(frames_of(session, FAULTY_FRAMES)):
        own, view = given[seen.part_of(row)], number % len(session.cameras)
        instant = session.instant(session.numbers[row]).judged_by(own.likelihood)
        views = list(instant.views)
        views[view] = planted(views[view], kind, session.unit * session.scale[view, row])
        draws = drawn_of(model, Instant(instant.source, tuple(views), own.pointing), row)
        legs = np.asarray(draws.faults.exchange) == EXCHANGE_INDEX["legs"]
        outlier = np.asarray(draws.faults.outlier).mean(axis=0)
        limbs = in_world(draws)[:, LIMB_JOINTS]
        low, high = np.quantile(limbs, [TAIL, 1 - TAIL], axis=0)
        parts = outlier, legs.mean(axis=0), np.array(view), limbs.mean(axis=0), high - low
        found.append([part.tolist() for part in parts])
    return found


def fault_table(found: dict[str, list[Any]]) -> Sheet:
    """How often faults are found, and where there are none, and how far they move the joints that
    have none."""
    rows, every = [], {kind: _faulty(cases) for kind, cases in found.items()}
    other = [row for row, joint in enumerate(LIMB_JOINTS) if joint != WRIST]
    for kind, one in every.items():
        outlier, legs = alarms = one.outlier > BELIEVED, one.legs > BELIEVED
        hit, moved = "", ""
        if kind != UNTOUCHED:
            alarm = outlier if kind in MOVED else legs
            place = (np.arange(len(one.view)), one.view, WRIST)[: alarm.ndim]
            hit = f"{alarm[place].sum()} of {len(one.view)}"
            alarm[place] = False
            usual = every[UNTOUCHED]
            step = np.abs(one.mean - usual.mean)[:, other] / usual.width[:, other]
            moved = f"{np.median(step):.2f}"
        false = [f"{100 * alarm.mean():.1f} %" for alarm in alarms]
        rows.append([kind, hit, *false, moved])
    head = ["planted in one view of four", "found", "other keypoints called outliers"]
    head += ["other views' legs called exchanged", "other joints move, of their width"]
    return sheet_of([Column(head[0], left=True), *map(Column, head[1:])], rows)


def out_of_step(session: Session, camera: int, frames: int) -> Session:
    """A session whose one camera shows what the others showed so many frames before."""
    ends = abs(frames)
    kept = range(ends, len(session) - ends)
    people = tuple(
        tuple(view[row - (frames if number == camera else 0)] for row in kept)
        for number, view in enumerate(session.people)
    )
    numbers = tuple(session.numbers[row] for row in kept)
    return dataclasses.replace(session, numbers=numbers, people=people)


def lag_table(session: Session) -> Sheet:
    """What is found of cameras that are out of step, and where none is."""
    cases = {"none": session}
    for camera, label in enumerate(session.labels):
        for frames in PLANTED_LAGS:
            name = f"{label}, {abs(frames)} {'behind' if frames > 0 else 'ahead'}"
            cases[name] = out_of_step(session, camera, frames)
    rows = []
    for name, case in cases.items():
        lags = lags_of(case)
        assert lags is not None
        cells = []
        for found, error, sure in zip(lags.frames, lags.error, lags.sure, strict=True):
            cell = f"{found:+.1f} ± {2 * error:.1f}".replace("-", "−")
            cells.append(f"**{cell}**" if sure else cell)
        rows.append([name, *cells])
    head = [Column("planted", left=True), *map(Column, session.labels)]
    return sheet_of(head, rows)


def turned_aside(session: Session, camera: int, axis: int, degrees: float) -> Session:
    """A session whose calibration has one camera turned."""
    views = list(session.cameras)
    views[camera] = camera_turned(views[camera], "xyz"[axis], degrees)
    return dataclasses.replace(session, cameras=tuple(views))


def turn_table(session: Session) -> Sheet:
    """How probable it is of each camera that it is turned, where one is and where none is."""
    cases = {"none": session}
    for camera, label in enumerate(session.labels):
        for axis, degrees in PLANTED_TURNS:
            name = f"{label}, {degrees:+g}° about {'xyz'[axis]}".replace("-", "−")
            cases[name] = turned_aside(session, camera, axis, degrees)
    rows = []
    for name, case in cases.items():
        turns = turns_of(case)
        assert turns is not None
        cells = []
        for found in zip(turns.probability, turns.degrees, turns.error, turns.sure, strict=True):
            probability, degrees, error, sure = found
            size = f" ({degrees:.1f} ± {2 * error:.1f}°)" if sure else ""
            cells.append(f"**{probability:.2f}**{size}" if sure else f"{probability:.2f}")
        rows.append([name, *cells])
    head = [Column("planted", left=True), *map(Column, session.labels)]
    return sheet_of(head, rows)


def price_of_an_outlier(given: list[Beliefs]) -> dict[str, str]:
    """How many nats it costs to call a right wrist's keypoint an outlier, and how many standard
    deviations a body unit is there."""
    found = []
    for one in given:
        law = one.likelihood.learned
        assert law is not None
        wrong, sd = one.likelihood.faults.outlier[WRIST], float(law.sigma[WRIST])
        area = np.pi * one.likelihood.faults.reach**2
        found.append((np.log((1 - wrong) / (2 * np.pi * sd**2)) - np.log(wrong / area), 1 / sd))
    nats, deviations = np.mean(found, axis=0)
    return {"nats": f"{nats:.0f}", "deviations": f"{deviations:.0f}"}


def _faulty(cases: list[Any]) -> FaultyInstants:
    return FaultyInstants(*(np.array(list(part)) for part in zip(*cases, strict=True)))


def standings(found: dict[str, Any], way: str) -> CameraStanding:
    """Of one way, with an axis for frames first."""
    parts = zip(*found[way], strict=True)
    return CameraStanding(*(np.array(list(part)) for part in parts))


def covered(level: np.ndarray, rows: Sequence[int], within: float) -> Interval:
    """How often central intervals hold the truth, by the levels `(n, ...)` of frames."""
    held = np.abs(level - 0.5) < within / 2
    return of_share(held.reshape(len(held), -1), np.array(rows) // STRETCH)


def _share(one: Interval) -> str:
    return f"{100 * one.value:.0f} ({100 * one.low:.0f}–{100 * one.high:.0f})"


def _median(values: np.ndarray) -> str:
    return f"{np.median(values):.0f}"


def standing_table(found: dict[str, dict[str, Any]], axes: dict[str, slice]) -> Sheet:
    """Coverage, errors and widths by axis of sets of cameras, by way."""
    columns = [Column("cameras", left=True), Column("way", left=True)]
    for name in axes:
        columns += [Column(f"{name}: 50 %"), Column(f"{name}: 95 %")]
        columns += [Column(f"{name}: error"), Column(f"{name}: width")]
    rows = []
    for cameras, ways in found.items():
        for way in WAYS:
            one, cells = standings(ways, way), []
            for axis in axes.values():
                given = one.level[..., axis], ways["rows"]
                cells += [_share(covered(*given, within)) for within in (0.5, 0.95)]
                cells += [_median(part[..., axis]) for part in (one.error, one.width)]
            rows.append([cameras, way, *cells])
    return sheet_of(columns, rows)


def pooled(found: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """All sets together, frame by frame."""
    sets = list(found.values())
    whole = {way: np.concatenate([one[way] for one in sets], axis=2) for way in WAYS}
    return {"rows": sets[0]["rows"], **whole}


def coverage_figure(found: dict[str, dict[str, Any]]) -> Figure:
    """Coverage and errors of every set of cameras, by way."""
    figure = page(10.5, 5.6)
    left, right = figure.subplots(1, 2, sharey=True)
    left.axvspan(92, 98, color=FAINT, alpha=0.2, lw=0)
    left.axvline(95, color=INK, lw=0.6)
    for number, way in enumerate(WAYS):
        for row, one in enumerate(found.values()):
            standing = standings(one, way)
            share = covered(standing.level, one["rows"], 1 - 2 * TAIL)
            place, colour = row + 0.25 * (number - 0.5), PALETTE[number]
            label = way if not row else None
            left.plot([100 * share.low, 100 * share.high], [place] * 2, color=colour, lw=1.4)
            left.plot(100 * share.value, place, "o", ms=4, color=colour, label=label)
            right.plot(np.median(standing.error), place, "o", ms=4, color=colour)
    left.set_yticks(range(len(found)), [f"cameras {name}" for name in found])
    left.set_ylim(len(found) - 0.5, -0.5)
    left.set_xlabel("95 % intervals that hold the truth, %", fontsize=TEXT)
    right.set_xlabel("error of the mean, each axis, mm (median)", fontsize=TEXT)
    for axis in (left, right):
        axis.tick_params(labelsize=SMALL)
        tidy(axis)
    left.legend(frameon=False, fontsize=SMALL)
    return figure


def named(cameras: Sequence[int]) -> str:
    """As a user counts them."""
    return ", ".join(str(one + 1) for one in cameras)


def judge_all(
    seen: Film,
    given: list[Beliefs],
    work: Path,
    number: int,
    judge: Callable[..., dict[str, Any]] = judge_cameras,
    what: str = "cameras",
) -> dict[str, dict[str, Any]]:
    """What every set of so many cameras is worth, as a function judges it; `what` the files that
    keep it are called."""
    files = {one: work / f"{what}-{''.join(map(str, one))}.json" for one in SETS[number]}
    return {named(one): kept_json(file, judge, seen, given, one) for one, file in files.items()}


def main(data: Data, work: Work) -> Page:
    """Draws what is not there yet, then writes the page."""
    seen = film(data)
    given = beliefs(seen)
    sets = {number: judge_all(seen, given, work, number) for number in SETS}
    pairs, triples = (
        [standing_table(one, JUDGED_AXES[number]) for one in ({label: pooled(found)}, found)]
        for (number, found), label in zip(sets.items(), ("all pairs", "all threes"), strict=True)
    )
    faults = {
        kind: kept_json(
            work / f"faults-{kind.replace(' ', '-')}.json", find_faults, seen, given, kind
        )
        for kind in PLANTED
    }
    measured = judge_all(seen, given, work, 2, measure_pair, "measures")
    scores = {way: scores_of_pairs(measured, way) for way in WAYS}
    values: dict[str, str | int | Sheet] = {
        "measures": measure_scores_table(scores, caption=""),
        "measures_within": within(scores[FROM_POSTERIOR]),
        "triangulated_within": within(scores[BY_TRIANGULATION]),
        "frames": JUDGED_FRAMES,
        "draws": f"{JUDGED_DRAWS:,}",
        "roots": JUDGED_ROOTS,
        "pointing": " and ".join(f"{one.pointing:.2f}" for one in given),
        "together": pairs[0],
        "pairs": pairs[1],
        "threes": triples[0],
        "triples": triples[1],
        "faults": fault_table(faults),
        "faulty": FAULTY_FRAMES,
        "moved": " and ".join(f"{far:g}" for far in MOVED.values()),
        "lags": lag_table(seen.session),
        "turns": turn_table(seen.session),
        "posed": posed_table(work),
        "assumed": f"{ASSUMED_POINTING:g}",
        "fewest": FEWEST_EFFECTIVE,
        **price_of_an_outlier(given),
    }
    return Page("cameras", values, {"cameras": coverage_figure(sets[2] | sets[3])})


if __name__ == "__main__":
    run(main)
