"""What an uncertain root changes on real detections with a real truth: writes reports/honest.md.

    python -m poseterior.reports.pages.honest ../shared/data work

One person filmed by four calibrated cameras. One camera's detection goes to the product, the truth
is triangulated from the other three. Nothing is aligned. `work` keeps the draws, and a run that was
stopped goes on there.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from poseterior.inference.hypothesis import diverse
from poseterior.inference.importance.weighted import FEWEST_EFFECTIVE
from poseterior.inference.studies.calibration.assess import ECE_STAND_INS
from poseterior.inference.studies.calibration.ece import ece
from poseterior.inference.studies.errorlaws.judge import LEVELS, shares_within, standings
from poseterior.inference.studies.errorlaws.pairs import pairs_of_session
from poseterior.inference.studies.evaluation.samples import ECE_SAMPLES, JUDGED_NAMES
from poseterior.inference.studies.intervals import Interval, of_share
from poseterior.inference.studies.levels import median_levels, stand_in_levels
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.probmodel.sessions import Session
from poseterior.probmodel.sessions.session import HIPS
from poseterior.probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, SMALL, Style, entitle, page
from poseterior.reports.pages.filmed import (
    FILM_DRAWS,
    FILM_ROOTS,
    FILM_WAYS,
    PARTS,
    Film,
    FilmedCase,
    FilmedDraws,
    Way,
    drawn,
    film,
    learn_as,
)
from poseterior.reports.pages.page import Data, Page, Work, run
from poseterior.reports.tables import Sheet, sheet_from, sheet_of
from poseterior.reports.tables.sheet import percents

BEST = 5
CURVE = 100
"""Cases of a way, at least, whose standings are drawn."""
STRETCH = 10
"""Frames that are drawn anew together: they are alike."""
ORDER = ("first half", "second half")
STANDING_AXES = ("x", "y", "depth")
LIMB = 338.0
"""Millimetres: the person's mean limb bone."""
HONEST_JOINTS = [
    *LIMB_JOINTS,
    *(JOINT_INDEX[name] for name in ("right_shoulder", "left_shoulder", "right_hip", "left_hip")),
]
"""The joints of the errors: those that detector and skeleton define alike."""
Found = dict[Way, list["HonestCase"]]
"""By way, what was found in each case."""


class HonestCase(NamedTuple):
    """One way on one case.

    Attributes
    ----------
    camera, frame : whose detection it is.
    standing : `(8, 3)` share of draws below the truth, limb joints × x, y, depth; draws have errors
        as the truth has them.
    bare : `(8, 3)` the same of draws without.
    spread : `(8, 3)` standard deviations of the draws, body units.
    levels, stand_ins : `(14,)`, `(10, 14)` the share of draws nearer to their median than the truth
        is, and the same of draws in its place, for all joints but the pelvis, rooted there; draws
        have the truth's errors.
    mean, best : mm, errors of the posterior's mean and of the best of five hypotheses.
    effective : roots; NaN where the root is fixed.
    seconds : of the drawing.
    drawn : whether there are any draws.
    """

    camera: int
    frame: int
    standing: np.ndarray
    bare: np.ndarray
    spread: np.ndarray
    levels: np.ndarray
    stand_ins: np.ndarray
    mean: float
    best: float
    effective: float
    seconds: float
    drawn: bool


NOWHERE = np.full((8, 3), np.nan)
NO_LEVELS = np.full(len(JUDGED_NAMES), np.nan), np.full((ECE_STAND_INS, len(JUDGED_NAMES)), np.nan)


def judge(case: FilmedCase, found: FilmedDraws) -> HonestCase:
    """Draws for one camera's detection, against the truth; NaN where there are none."""
    joints = found.joints
    about = (found.roots, found.seconds)
    if not len(joints):
        nothing = NOWHERE, NOWHERE, NOWHERE, *NO_LEVELS, np.nan, np.nan
        return HonestCase(case.camera, case.frame, *nothing, *about, False)
    limbs = joints[:, LIMB_JOINTS]
    truth = case.truth[list(LIMB_JOINTS)]
    rng = np.random.default_rng([case.camera, case.frame])
    noise = case.errors(rng, len(joints))[:, LIMB_JOINTS]
    hypotheses = np.array([one.joints for one in diverse(joints, min(BEST, len(joints)))])
    return HonestCase(
        case.camera,
        case.frame,
        np.mean(limbs + noise < truth, axis=0),
        np.mean(limbs < truth, axis=0),
        limbs.std(axis=0),
        *levels(case, joints, rng),
        float(error(joints.mean(axis=0)[None], case.truth)[0]),
        float(error(hypotheses, case.truth).min()),
        *about,
        True,
    )


def levels(
    case: FilmedCase, joints: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`HonestCase.levels` and `HonestCase.stand_ins`, as `poseterior evaluate` has them."""
    few = joints[:ECE_SAMPLES]
    few = (few - few[:, :1] + case.skeletal_errors(rng, len(few)))[:, 1:]
    truth = case.skeletal_truth
    rows = rng.integers(0, len(few), ECE_STAND_INS)
    return median_levels((truth - truth[0])[1:], few), stand_in_levels(few, rows)


def error(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """`(n,)` mm: mean distance of poses `(n, 15, 3)` from the truth over `HONEST_JOINTS`."""
    apart = np.linalg.norm(joints[:, HONEST_JOINTS] - truth[HONEST_JOINTS], axis=-1)
    return LIMB * np.nanmean(apart, axis=1)


def coverage(standing: np.ndarray, cluster: np.ndarray) -> Interval:
    """How often central intervals of 95 % hold the truth, `standing` `(n, ...)`, with an interval
    from drawing clusters `(n,)` anew."""
    known = ~np.isnan(standing).reshape(len(standing), -1).any(axis=1)
    held = (standing >= 0.025) & (standing <= 0.975)
    return of_share(held[known].reshape(known.sum(), -1), cluster[known])


def table(outcomes: Found) -> Sheet:
    """A line a way: coverage by axis, truths beyond all draws, widths, errors."""
    lines = []
    for way, found in outcomes.items():
        standing = np.stack([one.standing for one in found if one.drawn])
        beyond = (standing == 0) | (standing == 1)
        spread = LIMB * np.nanmean([one.spread for one in found], axis=(0, 1))
        across = np.hypot(*spread[:2]) / np.sqrt(2)
        line = {
            "torso and camera": str(way),
            "cases": len(found),
            **dict(zip(STANDING_AXES, by_axis(found, "standing"), strict=True)),
            "coordinates beyond all draws": f"{100 * beyond.mean():.0f} %",
            "cases with one": f"{100 * beyond.any(axis=(1, 2)).mean():.0f} %",
            "sd across / in depth, mm": f"{across:.0f} / {spread[2]:.0f}",
            "error of mean, mm": f"{np.nanmean([one.mean for one in found]):.0f}",
            f"best of {BEST}, mm": f"{np.nanmean([one.best for one in found]):.0f}",
        }
        lines.append(line)
    return sheet_from(lines)


def by_axis(found: Sequence[HonestCase], column: str) -> list[str]:
    """Coverage in x, y and depth, cameras drawn anew."""
    standing = np.stack([getattr(one, column) for one in found])
    camera = np.array([one.camera for one in found])
    return [percents(coverage(standing[:, :, axis], camera)) for axis in range(3)]


def ece_table(outcomes: Found) -> Sheet:
    """A line a way: the field's calibration error, cameras drawn anew, and its floor."""
    lines: list[tuple[Any, ...]] = []
    for way, found in outcomes.items():
        there = [one for one in found if np.isfinite(one.levels).all()]
        of = ece(
            np.stack([one.levels for one in there]),
            np.stack([one.stand_ins for one in there]),
            np.array([one.camera for one in there]),
        )
        value = f"{of.whole.value:.3f} ({of.whole.low:.3f}–{of.whole.high:.3f})"
        lines.append((str(way), len(there), value, f"{of.floor:.3f}"))
    return sheet_of(("torso and camera", "cases", "ECE", "its floor"), lines)


def bare_table(outcomes: Found) -> Sheet:
    """A line a way: coverage by axis if the truth had no error of its own."""
    lines = [(str(way), *by_axis(found, "bare")) for way, found in outcomes.items()]
    return sheet_of(("torso and camera", *STANDING_AXES), lines)


def paired(outcomes: Found) -> Found:
    """Of every way that knows the focal length, and the same way without it, the cases that both
    have."""
    found: Found = {}
    for way in outcomes:
        for other in outcomes:
            if way.focal and not other.focal and str(way).startswith(str(other)):
                common = min(len(outcomes[way]), len(outcomes[other]))
                found |= {one: outcomes[one][:common] for one in (other, way)}
    return found


def parts_of(outcomes: Found, seen: Film) -> Sheet:
    """A line for each way with an uncertain root and each half of the film, and each camera:
    coverage by axis, stretches of the film drawn anew, and how wide the draws are."""
    lines: list[tuple[Any, ...]] = []
    for way, found in outcomes.items():
        if way.root != UNCERTAIN:
            continue
        for part in range(PARTS):
            some = [one for one in found if seen.part_of(one.frame) == part]
            lines.append((str(way), ORDER[part], *part_line(some)))
        for camera in sorted({one.camera for one in found}):
            some = [one for one in found if one.camera == camera]
            lines.append((str(way), f"camera {camera + 1}", *part_line(some)))
    head = ("torso and camera", "judged in", "cases", *STANDING_AXES, "sd across, mm")
    return sheet_of(head, lines)


def part_line(some: Sequence[HonestCase]) -> tuple[Any, ...]:
    """How many cases, coverage by axis, and the draws' standard deviation to the side."""
    standing = np.stack([one.standing for one in some])
    stretch = np.array([one.frame // STRETCH for one in some])
    axes = (percents(coverage(standing[:, :, axis], stretch)) for axis in range(3))
    across = LIMB * np.sqrt(
        np.mean(np.nanmean([one.spread[:, :2] for one in some], axis=(0, 1)) ** 2)
    )
    return (len(some), *axes, f"{across:.0f}")


def law_table(seen: Film) -> Sheet:
    """How many residuals of the part of the film that was not learned from lie within a law's
    regions, cameras drawn anew: as it was fitted, and as `calibrate` writes it."""
    lines: list[tuple[Any, ...]] = []
    for part in range(PARTS):
        found = learn_as(seen.unseen(part))
        assert found.truth_fit is not None
        rest = pairs_of_session(seen.part(part))
        fitted = dataclasses.replace(
            found.errors,
            law=Gaussian(),
            sigma=np.where(found.errors.known, found.fit.mixture.sigma, np.nan),
        )
        for name, law in (("as fitted", fitted), ("as written", found.errors)):
            standing = standings(law, rest, found.truth_fit.mixture.sigma)
            row = map(percents, shares_within(standing, rest.recording))
            lines.append((f"{ORDER[1 - part]} → {ORDER[part]}, {name}", *row))
    heads = (f"{100 * level:.0f} %" for level in LEVELS)
    return sheet_of(("learned from → judged on", *heads), lines)


def parts_table(session: Session) -> Sheet:
    """What keypoints say of limb joints against the hips' midpoint, at the true scale, minus where
    they are: all of it, what is the same in all of a view's frames, and the rest; mm each way, 1.48
    times medians of absolute values, so that a wrong hand does not make the number."""
    lines: list[tuple[Any, ...]] = []
    for name, perspective in (("line of sight", False), ("calibrated camera", True)):
        pairs = pairs_of_session(session, perspective=perspective)
        error = pairs.detected - pairs.truth
        error = LIMB * (error - error[:, HIPS].mean(axis=1, keepdims=True))[:, LIMB_JOINTS]
        middle = np.zeros_like(error)
        for view in np.unique(pairs.recording):
            own = pairs.recording == view
            middle[own] = np.nanmedian(error[own], axis=0)
        lines.append((name, *(f"{typical(one):.0f}" for one in (error, middle, error - middle))))
    head = ("the truth as seen", "all, mm", "of the view", "around that")
    return sheet_of(head, lines)


def typical(values: np.ndarray) -> float:
    """A standard deviation about zero, by the median of absolute values."""
    return float(np.nanmedian(np.abs(values)) / stats.norm.ppf(0.75))


def doubts(cases: Sequence[FilmedCase]) -> tuple[float, float]:
    """Medians of the standard errors of the truth's limb joints, mm: across and in depth."""
    free = np.stack([case.errors(np.random.default_rng(0), 2000).std(axis=0) for case in cases])
    across, _, depth = LIMB * np.median(free[:, LIMB_JOINTS], axis=(0, 1))
    return float(across), float(depth)


def costs(outcomes: Found) -> Sheet:
    """A line a way: time a frame, effective roots, cases without draws."""
    lines = []
    for way, found in outcomes.items():
        there = [one for one in found if one.drawn]
        seconds = np.median([one.seconds for one in there])
        effective = [one.effective for one in there]
        few = "–" if way.root != UNCERTAIN else f"{np.median(effective):.0f} ({min(effective):.0f})"
        too_few = sum(one.effective < FEWEST_EFFECTIVE for one in there)
        line = {
            "torso and camera": str(way),
            "seconds": f"{seconds:.1f}",
            "effective roots (fewest)": few,
            f"cases below {FEWEST_EFFECTIVE}": too_few,
            "cases without a pose": len(found) - len(there),
        }
        lines.append(line)
    return sheet_from(lines)


def standings_figure(outcomes: Found) -> Figure:
    """By axis: how the truths' standings among the draws are distributed; uniform is right."""
    many = {way: found for way, found in outcomes.items() if len(found) >= CURVE}
    figure = page(8.4, 3.0, dpi=150)
    for axis, name in zip(figure.subplots(1, 3), STANDING_AXES, strict=True):
        axis.plot([0, 1], [0, 1], color=FAINT, lw=0.8, ls=":")
        for colour, (way, found) in zip(PALETTE, many.items(), strict=False):
            row = "xy".find(name) % 3
            standing = np.stack([one.standing[:, row] for one in found if one.drawn]).ravel()
            at = np.sort(standing)
            level = np.arange(1, len(at) + 1) / len(at)
            line: Style = {"color": colour, "lw": 1.3, "ls": "-" if way.moved else "--"}
            axis.step(at, level, where="post", label=str(way).replace("`", ""), **line)
        entitle(axis, name)
        axis.set_xlabel("share of draws below the truth", fontsize=SMALL)
        axis.tick_params(labelsize=SMALL)
        axis.set(xlim=(0, 1), ylim=(0, 1))
        axis.set_aspect("equal")
    figure.axes[0].set_ylabel("share of truths", fontsize=SMALL)
    figure.axes[0].legend(fontsize=SMALL - 1, frameon=False, loc="upper left")
    return figure


def main(data: Data, work: Work) -> Page:
    """Does what is left of the study, then writes the page."""
    seen = film(data)
    outcomes = {way: [judge(*one) for one in drawn(seen, way, work)] for way in FILM_WAYS}
    across, depth = doubts(seen.cases)
    whole = learn_as(seen.session, perspective=True)
    values: dict[str, str | int | Sheet] = {
        "draws": f"{FILM_DRAWS:,}",
        "roots": f"{FILM_ROOTS:,}",
        "more": f"{max(way.roots for way in FILM_WAYS):,}",
        "table": table(outcomes),
        "paired": table(paired(outcomes)),
        "cameras": parts_of(outcomes, seen),
        "laws": law_table(seen),
        "parts": parts_table(seen.session),
        "together": f"{whole.common[HIPS[0]]:.1f}",
        "ece": ece_table(outcomes),
        "bare": bare_table(outcomes),
        "across": f"{across:.0f}",
        "depth": f"{depth:.0f}",
        "costs": costs(outcomes),
    }
    return Page("honest", values, {"honest": standings_figure(outcomes)})


if __name__ == "__main__":
    run(main)
