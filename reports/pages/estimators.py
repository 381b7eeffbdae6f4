"""How far off single 3D estimates are, and the best of five hypotheses beside them: writes
reports/estimators.md and its picture.

    python -m poseterior.reports.pages.estimators ../shared/data

Real poses of three people, each judged with dictionaries, limits, lengths and torsos learned
without that person; the page says what is held out and how. Half an hour.
"""

import functools
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.estimators.akhter_black import fit_akhter_black
from poseterior.inference.estimators.zhou import fit_zhou
from poseterior.inference.studies.errors import mean_joint_error
from poseterior.inference.studies.evaluation.scores import Interval, clustered
from poseterior.probmodel import Anatomy, Candidate, Detection
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.datasets import VIEWS
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.learning.poses import read_all
from poseterior.probmodel.skeleton import NUM_JOINTS
from poseterior.reports.figures.estimators import estimators_figure
from poseterior.reports.pages.estimates import (
    METHODS,
    MISSING,
    RECOVERY_NOISE,
    SCORE,
    HeldOut,
    Scores,
    Singles,
    cases,
    estimates,
    four_views,
    hold_out,
    one_view,
    single_errors,
    study_draws,
    study_singles,
    turned,
)
from poseterior.reports.pages.page import Data, Page, Values, run
from poseterior.reports.tables import Column, Sheet, sheet_of

HELD_OUT = ("01", "02", "03")
ESTIMATE_NAMES = {
    "mean": "mean pose",
    "dictionary": "dictionary fit",
    "akhter-black": "Akhter & Black",
    "zhou": "Zhou et al.",
}
SEVERAL, RUNS = 64, 5
"""Frames that are estimated together, and how often that is timed."""
ESTIMATE_LEVELS = [(noise, missing) for noise in RECOVERY_NOISE for missing in MISSING]


def singles_table(singles: Singles) -> Sheet:
    """Errors by noise and missing joints."""
    rows = [
        (
            f"{noise:.0%}",
            str(missing),
            *(
                clustered(singles.errors[method, noise, missing], singles.trial)
                for method in ESTIMATE_NAMES
            ),
        )
        for noise, missing in ESTIMATE_LEVELS
    ]
    return sheet_of(("noise", "missing", *ESTIMATE_NAMES.values()), rows)


def subjects_table(singles: Singles) -> Sheet:
    """Errors by person, true 2D, every joint seen."""
    rows = []
    for subject in HELD_OUT:
        mine = singles.subject == subject
        means = (float(singles.errors[method, 0.0, 0][mine].mean()) for method in ESTIMATE_NAMES)
        rows.append((subject, int(mine.sum()), *means))
    return sheet_of(("subject", "views of poses", *ESTIMATE_NAMES.values()), rows)


def differences_table(singles: Singles) -> Sheet:
    """Paired differences between neighbours in the order that the paper has."""
    pairs = [("mean", "akhter-black"), ("akhter-black", "zhou"), ("dictionary", "zhou")]
    rows = []
    for noise, missing in ESTIMATE_LEVELS:
        error = {method: singles.errors[method, noise, missing] for method in ESTIMATE_NAMES}
        apart = (clustered(error[worse] - error[better], singles.trial) for worse, better in pairs)
        rows.append((f"{noise:.0%}", str(missing), *apart))
    return sheet_of(
        ("noise", "missing", *(f"{ESTIMATE_NAMES[a]} − {ESTIMATE_NAMES[b]}" for a, b in pairs)),
        rows,
    )


def draws_table(drawn: Scores) -> Sheet:
    """Single estimates, the best of five, the best of all draws."""
    rows = []
    for (method, missing), errors in drawn.errors.items():
        single, best, any_draw = errors.T
        columns = (single, best, single - best, any_draw)
        found = (clustered(column, drawn.trial[method, missing]) for column in columns)
        rows.append((ESTIMATE_NAMES[method], str(missing), *found, drawn.lost[method, missing]))
    heads = ("single", "best of five", "gap", "best of all draws")
    return sheet_of(("estimator", "missing", *heads, "no draws"), rows)


Fits = list[tuple[Candidate, ...]]


def _akhter_black(held: HeldOut, seen: list[Detection], **options: Any) -> Fits:
    return fit_akhter_black(seen, held.dictionary, held.anatomy.limits, **options)


def _zhou(held: HeldOut, seen: list[Detection], **options: Any) -> Fits:
    return fit_zhou(seen, held.dictionary, **options)


ABLATIONS: dict[str, Callable[[HeldOut, list[Detection]], Fits]] = {
    "Akhter & Black": _akhter_black,
    "… without limits (C_p)": functools.partial(_akhter_black, limit_weight=0.0),
    "… without bone lengths (C_l)": functools.partial(_akhter_black, bones_weight=0.0),
    "Zhou et al.": _zhou,
    "… robust, κ = 0.1": functools.partial(_zhou, threshold=0.1),
}


def ablation_table(people: Mapping[str, HeldOut]) -> Sheet:
    """What the parts of the two estimators are worth: every joint seen, by noise."""
    rows = [
        (name, *(_ablated(people, fit, noise) for noise in RECOVERY_NOISE))
        for name, fit in ABLATIONS.items()
    ]
    return sheet_of(("estimator", *(f"{noise:.0%} noise" for noise in RECOVERY_NOISE)), rows)


def _ablated(
    people: Mapping[str, HeldOut], fit: Callable[[HeldOut, list[Detection]], Fits], noise: float
) -> Interval:
    errors = []
    trial = []
    for held in people.values():
        some = cases(held, noise, 0, four_views)
        fits = fit(held, [case.detection for case in some])
        truth = np.stack([case.truth for case in some])
        errors.append(
            mean_joint_error(np.stack([np.asarray(found[0].pose, float) for found in fits]), truth)
        )
        trial.append(held.trial[[case.pose for case in some]])
    return clustered(np.concatenate(errors), np.concatenate(trial))


def rotation_table(people: Mapping[str, HeldOut]) -> Sheet:
    """Mean error with the image turned, 2 % noise, one joint missing; and the largest change of any
    pose's error."""
    rows: list[tuple[Any, ...]] = []
    for method in METHODS:
        by_angle = []
        for angle in (0, 30, 60):
            found = []
            for held in people.values():
                some = [turned(case, angle) for case in cases(held, 0.02, 1, one_view)]
                found.append(single_errors(held, some, method))
            by_angle.append(np.concatenate(found))
        mean = [float(errors.mean()) for errors in by_angle]
        change = [abs(mean[i] / mean[0] - 1) for i in (1, 2)]
        most = [float(np.max(np.abs(by_angle[i] / by_angle[0] - 1))) for i in (1, 2)]
        rows.append((ESTIMATE_NAMES[method], *mean, *change, *most))
    head: tuple[str | Column, ...] = (
        "estimator",
        *(Column(f"{angle}°", form="{:.2f}".format) for angle in (0, 30, 60)),
        *(Column(f"mean by {angle}°", form="{:.2%}".format) for angle in (30, 60)),
        *(Column(f"any pose by {angle}°", form="{:.1%}".format) for angle in (30, 60)),
    )
    return sheet_of(head, rows)


def speed_table(held: HeldOut) -> Sheet:
    """Milliseconds a frame, the best of some runs of 64 frames together, and of one frame alone."""
    some = cases(held, 0.02, 1, lambda number: range(len(VIEWS)))[:SEVERAL]
    rows: list[tuple[Any, ...]] = []
    for method in METHODS[1:]:
        columns: list[float] = []
        for count in (SEVERAL, 1):
            estimates(held, some[:count], method)  # what is compiled or loaded once is not counted
            runs = []
            for _ in range(RUNS):
                started = time.perf_counter(), time.process_time()
                estimates(held, some[:count], method)
                runs.append((time.perf_counter() - started[0], time.process_time() - started[1]))
            columns += [1000 * float(best) / count for best in np.min(runs, axis=0)]
        rows.append((ESTIMATE_NAMES[method], *columns))
    head = (
        "estimator",
        f"{SEVERAL} together: ms a frame",
        Column("of processor time", "processor, together"),
        "one alone: ms",
        Column("of processor time", "processor, alone"),
    )
    return sheet_of(head, rows)


def recovery_table() -> Sheet:
    """Share of noise-free poses in the span of the embedded dictionary that are recovered to
    1e-3."""
    whole = PoseDictionary.default()
    rng = np.random.default_rng(0)
    limits = Anatomy.default().limits
    rows = []
    for terms in (1, 2, 3):
        shares = []
        for method in METHODS[1:]:
            truths = [_in_the_span(whole, method, terms, number, rng) for number in range(SEVERAL)]
            seen = [_seen(truth) for truth in truths]
            if method == "akhter-black":
                fits = fit_akhter_black(seen, whole, limits, bones_weight=0.0, limit_weight=0.0)
            else:
                fits = fit_zhou(seen, whole, penalty=1e-4, tolerance=1e-5, max_iterations=5000)
            right = [recovered(fit[0], truth) for fit, truth in zip(fits, truths, strict=True)]
            shares.append(float(np.mean(right)))
        rows.append((str(terms), *shares))
    heads = (Column(ESTIMATE_NAMES[method], form="{:.0%}".format) for method in METHODS[1:])
    return sheet_of(("terms", *heads), rows)


def _in_the_span(
    whole: PoseDictionary, method: str, terms: int, number: int, rng: np.random.Generator
) -> np.ndarray:
    """A sum of some terms of the dictionary as the method has them, from one of the views."""
    of_bases = method == "akhter-black"
    source = whole.bases if of_bases else whole.atoms
    chosen = source[rng.choice(len(source), terms, replace=False)]
    weights = rng.normal(size=terms) * 0.5 if of_bases else rng.uniform(1, 3, terms)
    pose = np.einsum("k,kja->ja", weights, chosen) + (whole.mean if of_bases else 0)
    return np.asarray(VIEWS[number % len(VIEWS)].camera.view(pose))


def _seen(truth: np.ndarray) -> Detection:
    view = WeakPerspective(100.0, np.eye(3), np.array([320.0, 320.0]))
    points = np.asarray(view.project(truth))
    score = np.full(NUM_JOINTS, SCORE)
    return Detection(points, score, "synthetic", "a pose", 0)


def recovered(candidate: Candidate, truth: np.ndarray) -> bool:
    """Whether pose and scale are found to 1e-3."""
    found = np.asarray(candidate.pose, float) * float(candidate.camera.scale)
    true = 100 * (truth - truth[0])
    return bool(np.linalg.norm(found - true) <= 1e-3 * np.linalg.norm(true))


def picture(singles: Singles, drawn: Scores) -> Figure:
    """Single estimates under noise; beside the best of five, with joints missing."""
    errors = singles.errors
    trial = singles.trial
    by_noise = {
        name: [clustered(errors[method, noise, 0], trial) for noise in RECOVERY_NOISE]
        for method, name in ESTIMATE_NAMES.items()
    }
    by_missing = {
        (ESTIMATE_NAMES[method], words): [
            clustered(drawn.errors[method, missing][:, column], drawn.trial[method, missing])
            for missing in MISSING
        ]
        for method in METHODS[1:]
        for column, words in enumerate(("single estimate", "best of five hypotheses"))
    }
    return estimators_figure(RECOVERY_NOISE, by_noise, MISSING, by_missing)


def main(data: Data) -> Page:
    """Runs all studies and writes the page and its picture."""
    motions = read_all([data / "cmu" / "asfamc", data / "cmu" / "actions_train.npz", data / "bvh"])
    people = {subject: hold_out(motions, subject) for subject in HELD_OUT}
    speed = speed_table(people[HELD_OUT[0]])
    singles = study_singles(people)
    drawn = study_draws(people)
    values: Values = {
        "poses": sum(len(held.poses) for held in people.values()),
        "singles": singles_table(singles),
        "differences": differences_table(singles),
        "subjects": subjects_table(singles),
        "draws": draws_table(drawn),
        "ablation": ablation_table(people),
        "rotation": rotation_table(people),
        "speed": speed,
        "recovery": recovery_table(),
    }
    return Page("estimators", values, {"estimators": picture(singles, drawn)})


if __name__ == "__main__":
    run(main)
