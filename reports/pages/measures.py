"""What posteriors from one camera say of joint angles, lengths and steps, against the truth: writes
reports/measures.md.

    python -m poseterior.reports.pages.measures ../shared/data work

The person on the beam, judged by three other cameras, and motion capture of people of whom nothing
was learned. `work` keeps the draws, and shares those of the film with `honest`.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from poseterior.inference.studies.calibration import cover
from poseterior.inference.studies.calibration.coverage import measure_standings
from poseterior.inference.studies.intervals import TAIL
from poseterior.inference.studies.measured import (
    ALL_MEASURES,
    MeasureScore,
    MeasureStandings,
    no_standings,
    score,
    scores_of_measures,
    standings_of,
)
from poseterior.probmodel import Likelihood, PoseModel
from poseterior.probmodel.datasets import Case, from_motions
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.measures import MEASURES
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, SMALL, TEXT, page, tidy
from poseterior.reports.pages.filmed import (
    FILM_ROOTS,
    LEARNED,
    Film,
    FilmedCase,
    FilmedDraws,
    Way,
    drawn,
    film,
)
from poseterior.reports.pages.honest import STRETCH
from poseterior.reports.pages.page import Data, Page, Work, kept, run
from poseterior.reports.pages.people import HALVES, Strangers, strangers
from poseterior.reports.pages.real import ERRORS
from poseterior.reports.tables import Column, Sheet, sheet_of
from poseterior.reports.tables.measured import measure_scores_table
from poseterior.reports.tables.words import spoken

MEASURED_FRAMES, MEASURED_DRAWS = 25, 1000
"""Of the film, of four cameras each; and how many draws of each are measured."""
MEASURED_WAYS = {
    "one camera": Way(UNCERTAIN, LEARNED, frames=MEASURED_FRAMES),
    "one camera, `--focal`": Way(
        UNCERTAIN, LEARNED, focal=True, frames=MEASURED_FRAMES, roots=4 * FILM_ROOTS
    ),
}
MOCAP = "motion capture"
STRANGERS_POSES, STRANGERS_DRAWS, STRANGERS_ROOTS = 108, 500, 1000
COMPARED = (
    "elbow_flexion",
    "shoulder_elevation",
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_flexion",
)
LITERATURE = (
    (
        "OpenCap Monocular (arXiv 2603.24733)",
        "4.8°, mean, lower limbs",
        "a film; a network trained on images, a body model scaled to the person, physics",
    ),
    (
        "Portable Biomechanics Laboratory (2507.08268)",
        "< 3°, mean; single trials 11–16°",
        "a film by a phone; networks trained on images, a body model fitted to the whole film",
    ),
    (
        "several cameras, variational (2601.22412, 2502.06486)",
        "1.5–3.8°, mean",
        "films by calibrated cameras; intervals of positions, ECE < 0.1",
    ),
)
"""Whose, what error, and what each took as given; none has coverage of an angle's interval."""


SHOWN_CAMERA, BEAM_RATE = 0, 60
"""Of the picture: which camera; frames a second."""
SHOWN_ANGLES = (
    "right_knee_flexion",
    "left_knee_flexion",
    "right_elbow_flexion",
    "left_elbow_flexion",
)


class Measured(NamedTuple):
    """Many cases: their standings, lengths in millimetres, `(n, q)` each, and the cluster `(n,)` of
    each case."""

    standings: MeasureStandings
    cluster: np.ndarray

    @property
    def scores(self) -> list[MeasureScore]:
        """By measure."""
        return scores_of_measures(*self.standings, self.cluster)

    def pooled(self, names: Iterable[str], words: str) -> MeasureScore:
        """Of some measures of one unit, together."""
        wanted = {*names}
        rows = np.array([one.name in wanted for one in ALL_MEASURES])
        level, error, width = (part[:, rows] for part in self.standings)
        known = np.isfinite(level) & np.isfinite(error) & np.isfinite(width)
        cluster = np.broadcast_to(self.cluster[:, None], known.shape)[known]
        return score(words, "degrees", level[known], error[known], width[known], cluster)


def filmed(seen: Film, cases: Iterable[tuple[FilmedCase, FilmedDraws]]) -> Measured:
    """The standings of the film's cases; stretches of it are alike."""
    found = [(_standings(seen, *one), one[0].frame // STRETCH) for one in cases]
    parts = zip(*(standings for standings, _ in found), strict=True)
    return Measured(
        MeasureStandings(*map(np.stack, parts)), np.array([stretch for _, stretch in found])
    )


def _standings(seen: Film, case: FilmedCase, found: FilmedDraws) -> MeasureStandings:
    """Of one camera's detection; lengths in millimetres."""
    if not len(found.joints):
        return no_standings()
    rng = np.random.default_rng([case.camera, case.frame, 46])
    unit = seen.session.unit
    truth = unit * (case.skeletal_truth - case.skeletal_truth[0])
    joints = found.joints[:MEASURED_DRAWS]
    draws = unit * (joints - joints[:, :1])
    errors = unit * case.skeletal_errors(rng, len(draws))
    return standings_of(truth, draws + errors, draws, rng)


class Captured(NamedTuple):
    """Poses of people, as many of each as of any other, with a detector's errors, and a model that
    was learned from others."""

    model: PoseModel
    cases: list[Case]

    @classmethod
    def of(cls, some: Strangers) -> "Captured":
        """So many poses that all parts together are `STRANGERS_POSES`."""
        number, noise = STRANGERS_POSES // HALVES, ERRORS["detector"]
        return cls(some.model, list(from_motions(some.motions, "CMU", frames=number, noise=noise)))

    @property
    def possible(self) -> float:
        """The share of poses that the limits allow."""
        poses = np.stack([case.pose / case.unit for case in self.cases])
        return float(np.mean(self.model.limits.check(poses).pose_valid))


def captured(some: Captured) -> xr.DataTree:
    """Where the truths stand among draws."""
    return cover(
        some.model,
        some.cases,
        num_samples=STRANGERS_DRAWS,
        likelihood=Likelihood(Gaussian()),
        num_roots=STRANGERS_ROOTS,
    )


def overview(found: dict[str, Measured]) -> Sheet:
    """All angles together, and those of which others report errors."""
    every = [one.name for one in ALL_MEASURES if one.unit == "degrees"]
    groups = {"all angles": every} | {
        spoken(name): [f"right_{name}", f"left_{name}"] for name in COMPARED
    }
    by_way = {
        way: [one.pooled(names, words) for words, names in groups.items()]
        for way, one in found.items()
    }
    return measure_scores_table(by_way, caption="")


def literature() -> Sheet:
    """What others report."""
    columns = [Column(head, left=True) for head in ("whose", "error of angles", "given")]
    return sheet_of(columns, LITERATURE)


def outside(found: Measured) -> str:
    """Measures whose 95 % interval of coverage lies outside 92–98 %, in words, and how many of
    their misses are of truths below the interval."""
    names = []
    for one, level in zip(found.scores, found.standings.level.T, strict=True):
        if one.covered.high < 0.92 or one.covered.low > 0.98:
            below, above = (level < TAIL).sum(), (level > 1 - TAIL).sum()
            held = f"{100 * one.covered.value:.0f} %, {below} of {below + above} misses below"
            names.append(f"{spoken(one.name)} ({held})")
    return ", ".join(names) if names else "none"


def within(scores: Sequence[MeasureScore]) -> str:
    """How many measures are covered as they should, in words."""
    good = sum(0.92 <= one.covered.value <= 0.98 for one in scores)
    return f"{good} of {len(scores)}"


def coverage_of_measures(found: dict[str, Measured]) -> Figure:
    """The coverage of every measure, with its interval, a column a way."""
    figure = page(10.5, 5.6)
    axes = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    names = [one.name for one in ALL_MEASURES]
    for number, (axis, (way, one)) in enumerate(zip(axes, found.items(), strict=True)):
        axis.axvspan(0.92, 0.98, color=FAINT, alpha=0.2, lw=0)
        axis.axvline(0.95, color=INK, lw=0.6)
        for each in one.scores:
            row = names.index(each.name)
            axis.plot(each.covered[1:], [row, row], color=PALETTE[number], lw=1.4)
            axis.plot(each.covered.value, row, "o", ms=3, color=PALETTE[number])
        axis.set_title(way.replace("`", ""), fontsize=TEXT, color=INK)
        axis.set_xlim(0.5, 1.01)
        axis.tick_params(labelsize=SMALL)
        tidy(axis)
    axes[0].set_yticks(range(len(names)), [spoken(name) for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    figure.supxlabel("how often intervals of 95 % hold the truth", fontsize=TEXT)
    return figure


def film_of_angles(found: Iterable[tuple[FilmedCase, FilmedDraws]]) -> Figure:
    """Mean and 95 % band of knees and elbows over the film, by one camera, and the truth by the
    others."""
    here = [one for one in found if one[0].camera == SHOWN_CAMERA and len(one[1].joints)]
    cases = sorted(here, key=lambda one: one[0].frame)
    frames = [case.frame for case, _ in cases]
    figure = page(10.5, 4.2)
    axes = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for axis, name in zip(axes, SHOWN_ANGLES, strict=True):
        one = MEASURES[name]
        draws = [one.of(drawn_here.joints) for _, drawn_here in cases]
        low, high = np.transpose([np.quantile(each, [TAIL, 1 - TAIL]) for each in draws])
        colour = PALETTE[0] if name.startswith("right") else PALETTE[2]
        axis.fill_between(frames, low, high, color=colour, alpha=0.25, lw=0, label="95 % interval")
        axis.plot(frames, list(map(np.mean, draws)), color=colour, lw=1.4, label="mean")
        truth = [float(one.of(case.skeletal_truth)) for case, _ in cases]
        axis.plot(frames, truth, "--", color=INK, lw=1.0, label="by the other three cameras")
        axis.set_title(f"{spoken(name)}, degrees", loc="left", fontsize=TEXT, color=INK)
        axis.tick_params(labelsize=SMALL)
        tidy(axis)
    axes[0].legend(frameon=False, fontsize=SMALL)
    figure.supxlabel(f"frame, {BEAM_RATE} a second", fontsize=TEXT)
    return figure


def main(data: Data, work: Work) -> Page:
    """Draws what is not there yet, then writes the page."""
    seen = film(data)
    film_draws = {name: list(drawn(seen, way, work)) for name, way in MEASURED_WAYS.items()}
    found = {name: filmed(seen, cases) for name, cases in film_draws.items()}
    parts = [Captured.of(some) for some in strangers(work, data)]
    stood = [
        measure_standings(kept(work / f"measures-strangers-{number}.nc", captured, part))
        for number, part in enumerate(parts)
    ]
    person = np.array([case.subject for part in parts for case in part.cases])
    found[MOCAP] = Measured(
        MeasureStandings(*map(np.concatenate, zip(*stood, strict=True))), person
    )
    everything = {way: one.scores for way, one in found.items()}
    values: dict[str, str | int | Sheet] = {
        "overview": overview(found),
        "literature": literature(),
        "cases": MEASURED_FRAMES * len(seen.session.cameras),
        "draws": f"{MEASURED_DRAWS:,}",
        "roots": f"{FILM_ROOTS:,}",
        "more_roots": f"{4 * FILM_ROOTS:,}",
        "poses": len(person),
        "people": len({*person.tolist()}),
        "possible": f"{100 * np.mean([part.possible for part in parts]):.0f} %",
        "motion_roots": f"{STRANGERS_ROOTS:,}",
        "film_within": within(everything["one camera"]),
        "mocap_within": within(everything[MOCAP]),
        "film_outside": outside(found["one camera"]),
        "focal_outside": outside(found["one camera, `--focal`"]),
        "mocap_outside": outside(found[MOCAP]),
        "film": measure_scores_table({"": everything["one camera"]}, caption=""),
        "focal": measure_scores_table({"": everything["one camera, `--focal`"]}, caption=""),
        "mocap": measure_scores_table({"": everything[MOCAP]}, caption=""),
    }
    pictures = {
        "measures": coverage_of_measures(found),
        "measures-film": film_of_angles(film_draws["one camera, `--focal`"]),
    }
    return Page("measures", values, pictures)


if __name__ == "__main__":
    run(main)
