"""Whether exchanged legs can be told at all, by evidences without faults: writes
reports/exchanges.md.

    python -m poseterior.reports.pages.exchanges [PEOPLE]

The people of `reports.pages.faults`, whose legs' keypoints are exchanged, read in every way that
sides may be exchanged. This shares neither patterns nor their proposals with the posterior that has
faults, so it says what that posterior would be, were its draws without end. And the ratio of two of
these evidences is the best test that there is of "exchanged" against "not" (Neyman & Pearson 1933),
so it says too what any other way to find out could reach.
"""

import dataclasses
import functools
import itertools
from typing import NamedTuple

import jax
import numpy as np
from scipy.special import logsumexp
from scipy.stats import bootstrap

from poseterior.inference.importance.weighted import weigh_roots
from poseterior.inference.studies.scenes import prior_scene
from poseterior.probmodel import Detection, Estimate, PoseModel
from poseterior.probmodel.errors.faults import (
    EXCHANGE_INDEX,
    EXCHANGES,
    MOVES_TORSO,
    ORDERS,
    FaultPrior,
)
from poseterior.probmodel.skeleton import JOINT_INDEX
from poseterior.reports.pages.faults import (
    EXCHANGED,
    LEGS_EXCHANGED,
    SURE,
    exchanged,
    with_detection,
)
from poseterior.reports.pages.page import Page, People, Values, run
from poseterior.reports.tables import Sheet, sheet_from, sheet_of
from poseterior.reports.tables.sheet import NOTHING

EXCHANGE_PEOPLE, EXCHANGE_ROOTS = 200, 250
EXCHANGE_BUDGET = 10_000_000
"""Proposals for a reading, which may have no torso at all."""
ALARMS = (0.02, 0.05, 0.1, 0.2)
"""How often legs that are not exchanged may be called so."""
RADIUS_ENDS = (2.0, 5.0)
"""Radii: where groups of people end, by how far apart their legs' joints were detected."""


class Told(NamedTuple):
    """One person: the log evidence `(6,)` of each reading of the exchanged detection, their
    standard errors `(6,)`, and how many radii the farther of knees and ankles lie apart."""

    log_evidence: np.ndarray
    error: np.ndarray
    apart: float

    @property
    def gain(self) -> float:
        """By how many nats exchanged legs explain the detection better than no exchange."""
        return float(self.log_evidence[LEGS_EXCHANGED] - self.log_evidence[0])

    @property
    def probability(self) -> np.ndarray:
        """`(6,)`: the posterior probability of each reading."""
        prior = FaultPrior.of(0.0, EXCHANGED).exchange
        score = self.log_evidence + np.log([1 - sum(prior), *prior])
        return np.exp(score - logsumexp(score))


def read_as(detection: Detection, name: str) -> Detection:
    """The detection with an exchange undone."""
    order = ORDERS[EXCHANGE_INDEX[name]]
    return dataclasses.replace(
        detection, keypoints=detection.keypoints[order], score=detection.score[order]
    )


def tell(model: PoseModel, frame: Estimate, seed: int) -> Told:
    """The evidences of a person whose legs are exchanged."""
    wrong = with_detection(frame, exchanged)
    found = []
    for name in EXCHANGES:
        reading = dataclasses.replace(wrong, detection=read_as(wrong.detection, name))
        roots = weigh_roots(
            reading.posterior(model),
            key=jax.random.key(seed),
            num_roots=EXCHANGE_ROOTS,
            max_proposals=EXCHANGE_BUDGET,
        )
        found.append((roots.log_evidence, roots.log_evidence_se))
    evidence, error = np.array(found).T
    scale = float(frame.candidates[0].camera.scale)
    radius = frame.likelihood.spread(frame.detection, scale)
    keypoints = frame.detection.keypoints
    gaps = []
    for name in ("knee", "ankle"):
        one = JOINT_INDEX[f"left_{name}"]
        other = JOINT_INDEX[f"right_{name}"]
        gaps.append(np.linalg.norm(keypoints[one] - keypoints[other]) / radius[one])
    return Told(evidence, error, float(max(gaps)))


def table(people: list[Told]) -> Sheet:
    """A line a group of people, by how far apart their legs are, and one for all."""
    edges = [0.0, *RADIUS_ENDS, np.inf]
    lines = [
        _line(
            f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}",
            [one for one in people if low <= one.apart < high],
        )
        for low, high in itertools.pairwise(edges)
    ]
    whole = _line("all", people)
    # Of a group of nobody nothing is known.
    blank = dict.fromkeys(whole, NOTHING) | {"people": 0}
    return sheet_from([*(blank | line for line in lines), whole])


def _line(name: str, people: list[Told]) -> dict[str, str | int]:
    if not people:
        return {"legs apart, radii": name}
    probability = np.stack([one.probability for one in people])
    legs = probability[:, LEGS_EXCHANGED]
    other = probability[:, MOVES_TORSO].sum(axis=1)
    return {
        "legs apart, radii": name,
        "people": len(people),
        f"legs told with probability ≥ {SURE}": f"{(legs >= SURE).sum()} of {len(people)}",
        "median probability": f"{np.median(legs):.3f}",
        "median nats in favour": f"{np.median([one.gain for one in people]):.1f}",
        "some exchange, median probability": f"{np.median(1 - probability[:, 0]):.3f}",
        "of hips too, median": f"{np.median(other):.3f}",
    }


def found(gain: np.ndarray, alarms: float, axis: int = -1) -> np.ndarray:
    """What share of exchanged legs the best test finds that calls legs exchanged in a share
    `alarms` of detections that are right.

    The nats `gain` `(…, n)` by which exchanged legs explain an exchanged detection better than no
    exchange are those by which no exchange explains the detection as it was."""
    threshold = np.quantile(-gain, 1 - alarms, axis=axis, method="higher", keepdims=True)
    return (gain > threshold).mean(axis=axis)


def best_tests(people: list[Told]) -> Sheet:
    """What the best test finds, with an interval of 95 % from drawing people anew."""
    gain = np.array([one.gain for one in people])
    lines = []
    for alarms in ALARMS:
        of = functools.partial(found, alarms=alarms)
        drawn = bootstrap((gain,), of, method="percentile", rng=0).confidence_interval
        share = f"{of(gain):.0%} ({100 * drawn.low:.0f}–{100 * drawn.high:.0f})"
        lines.append((f"{alarms:.0%}", share))
    return sheet_of(("called exchanged where they are not", "found where they are"), lines)


def main(people: People = EXCHANGE_PEOPLE) -> Page:
    """Runs the study and writes the page."""
    model = PoseModel()
    told = []
    for seed in range(people):
        told.append(tell(model, prior_scene(model, 500 + seed, missing=()), seed))
        print(seed, told[-1], flush=True)
    prior = FaultPrior.of(0.0, EXCHANGED).exchange
    needed = np.log(SURE / (1 - SURE) * (1 - sum(prior)) / prior[0])
    known = np.concatenate([one.error[[0, LEGS_EXCHANGED]] for one in told])
    sure = np.array([one.gain for one in told]) >= np.log(SURE / (1 - SURE))
    values: Values = {
        "tests": best_tests(told),
        "even": f"{sure.mean():.0%}",
        "people": people,
        "roots": EXCHANGE_ROOTS,
        "exchanges": f"{100 * EXCHANGED:.0f} %",
        "needed": f"{needed:.1f}",
        "sure": f"{SURE}",
        "error": f"{np.median(known[np.isfinite(known)]):.2f}",
        "table": table(told),
    }
    return Page("exchanges", values)


if __name__ == "__main__":
    run(main)
