"""Whether a detector's faults are found, and what they do to the rest: writes reports/faults.md.

    python -m poseterior.reports.pages.faults [PEOPLE]

People of the prior from random sides, all joints detected; then the same with the left wrist moved
by the person's height, and with the legs' keypoints exchanged.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.sampler import sample
from poseterior.inference.studies.intervals import of_share
from poseterior.inference.studies.scenes import prior_scene
from poseterior.probmodel import Detection, Estimate, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX, EXCHANGES, ORDERS, FaultPrior
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.probmodel.skeleton import JOINT_INDEX, JOINTS
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, SMALL, entitle, page
from poseterior.reports.pages.page import Page, People, run
from poseterior.reports.tables import Sheet, sheet_from
from poseterior.reports.tables.sheet import fixed, percents

FAULT_PEOPLE, FAULT_ROOTS, FAULT_DRAWS = 40, 400, 1000
OUTLIERS, EXCHANGED = 0.05, 0.05
"""Prior probabilities of a keypoint's being an outlier, and of an exchange."""
SURE = 0.95
WRIST, LEGS_EXCHANGED = JOINT_INDEX["left_wrist"], EXCHANGE_INDEX["legs"]
OTHER_JOINTS = [
    JOINT_INDEX[name] for name in ("right_elbow", "right_wrist", "right_knee", "right_ankle")
]
"""Joints that no fault of this page touches but the exchange of the legs."""


class JudgedFaults(NamedTuple):
    """One person under one fault: posterior probabilities of outliers `(15,)` and exchanges `(6,)`,
    the mean of the joints `(15, 3)`, rooted at the pelvis, how many effective roots there were."""

    outlier: np.ndarray
    exchange: np.ndarray
    mean: np.ndarray
    effective: float


def moved(detection: Detection) -> Detection:
    """The left wrist moved by the person's height, away from the middle of the body."""
    keypoints = np.array(detection.keypoints)
    away = keypoints[WRIST] - np.nanmean(keypoints, axis=0)
    height = np.ptp(keypoints, axis=0).max()
    keypoints[WRIST] += height * away / np.linalg.norm(away)
    return dataclasses.replace(detection, keypoints=keypoints)


def exchanged(detection: Detection) -> Detection:
    """Knees and ankles, left for right."""
    order = ORDERS[LEGS_EXCHANGED]
    return dataclasses.replace(
        detection, keypoints=detection.keypoints[order], score=detection.score[order]
    )


FAULTS: dict[str, Callable[[Detection], Detection]] = {
    "none": lambda detection: detection,
    "left wrist moved by a body length": moved,
    "legs exchanged": exchanged,
}


def judge(model: PoseModel, frame: Estimate, seed: int, faulty: bool = True) -> JudgedFaults:
    """Draws for one detection."""
    faults = FaultPrior.of(OUTLIERS, EXCHANGED) if faulty else FaultPrior()
    frame = dataclasses.replace(
        frame, likelihood=dataclasses.replace(frame.likelihood, faults=faults)
    )
    result = sample(
        model,
        frame,
        key=jax.random.key(seed),
        num_samples=FAULT_DRAWS,
        root=UNCERTAIN,
        num_roots=FAULT_ROOTS,
        max_proposals=200_000_000,
    )
    if not result.num_draws:
        nothing = np.full((len(JOINTS), 3), np.nan)
        return JudgedFaults(np.zeros(len(JOINTS)), np.zeros(len(EXCHANGES)), nothing, 0.0)
    draws = result.tree["posterior"]
    joints = draws.joints.values[0]
    outlier = np.zeros(joints.shape[:2])
    exchange = np.zeros(len(joints), int)
    if faulty:
        outlier = draws.outlier.values[0]
        exchange = draws.exchange.values[0]
    return JudgedFaults(
        np.mean(outlier, axis=0),
        np.bincount(exchange, minlength=len(EXCHANGES)) / len(exchange),
        np.mean(joints - joints[:, :1], axis=0),
        float(result.tree.attrs["effective_roots"]),
    )


def with_detection(frame: Estimate, change: Callable[[Detection], Detection]) -> Estimate:
    """The estimate with its detection changed."""
    return dataclasses.replace(frame, detection=change(frame.detection))


def found(name: str, one: JudgedFaults) -> float:
    """The posterior probability of what is wrong; of anything at all where nothing is."""
    if name == "none":
        return float(max(one.outlier.max(), one.exchange[1:].max()))
    return float(one.exchange[LEGS_EXCHANGED] if name == "legs exchanged" else one.outlier[WRIST])


def table(outcomes: dict[str, list[JudgedFaults]], without: dict[str, list[JudgedFaults]]) -> Sheet:
    """A line a fault: how often it was found, and how far it moved the means of the other limbs,
    with a likelihood that has faults and with one that has none."""
    lines = []
    calm = np.stack([one.mean for one in outcomes["none"]])
    for name, people in outcomes.items():
        sure = np.array([found(name, one) >= SURE for one in people])
        share = of_share(sure[:, None], np.arange(len(people)))
        shifts = [_shift(some, calm) for some in (people, without[name])]
        lost = sum(one.effective == 0 for one in without[name])
        line = {
            "what was done": name,
            f"found with probability ≥ {SURE}": percents(share),
            "median probability": f"{np.median([found(name, one) for one in people]):.3f}",
            "other joints moved by": fixed(2)(shifts[0]),
            "the same without faults in the model": fixed(2)(shifts[1]),
            "no pose without": lost,
            "effective roots": f"{np.median([one.effective for one in people]):.0f}",
        }
        lines.append(line)
    return sheet_from(lines)


def _shift(people: list[JudgedFaults], calm: np.ndarray) -> float:
    """Body units: the median distance of the other limbs' means from those of the detection as it
    was; NaN where nobody has draws."""
    apart = np.linalg.norm(
        np.stack([one.mean for one in people])[:, OTHER_JOINTS] - calm[:, OTHER_JOINTS], axis=-1
    )
    return float(np.nanmedian(apart)) if np.isfinite(apart).any() else np.nan


def probabilities_figure(outcomes: dict[str, list[JudgedFaults]]) -> Figure:
    """Everybody's posterior probability of the fault, in order."""
    figure = page(7.4, 3.0, dpi=150)
    axis = figure.subplots()
    for colour, (name, people) in zip(PALETTE, outcomes.items(), strict=False):
        level = np.sort([found(name, one) for one in people])
        label = "nothing done: the likeliest fault" if name == "none" else name
        axis.plot(
            np.linspace(0, 1, len(level)), level, "o-", ms=3, lw=1.2, color=colour, label=label
        )
    axis.axhline(SURE, color=FAINT, lw=0.8, ls=":")
    entitle(axis, "Faults of a detector, and their posterior probability")
    axis.set_xlabel("share of people", fontsize=SMALL)
    axis.set_ylabel("probability", fontsize=SMALL)
    axis.tick_params(labelsize=SMALL)
    axis.legend(fontsize=SMALL, frameon=False, loc="center right")
    return figure


def main(people: People = FAULT_PEOPLE) -> Page:
    """Runs the study and writes the page."""
    model = PoseModel()
    frames = [prior_scene(model, 500 + seed, missing=()) for seed in range(people)]
    outcomes, without = (
        {
            name: [
                judge(model, with_detection(frame, change), seed, faulty)
                for seed, frame in enumerate(frames)
            ]
            for name, change in FAULTS.items()
        }
        for faulty in (True, False)
    )
    values: dict[str, str | int | Sheet] = {
        "people": people,
        "roots": FAULT_ROOTS,
        "outliers": f"{100 * OUTLIERS:.0f} %",
        "exchanges": f"{100 * EXCHANGED:.0f} %",
        "table": table(outcomes, without),
    }
    return Page("faults", values, {"faults": probabilities_figure(outcomes)})


if __name__ == "__main__":
    run(main)
