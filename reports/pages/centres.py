"""What it costs that hypotheses are draws: how near to the truth the draws nearest to clusters'
centres come, beside poses composed of limbs, and the centres, which are no possible poses. Writes
reports/centres.md.

    python -m poseterior.reports.pages.centres ../shared/data

Some minutes. Frames and errors are like those of the relations in reports/motion.md, but fewer.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from poseterior.inference.clusters import clusters
from poseterior.inference.composition import compose
from poseterior.inference.draws import Draws
from poseterior.inference.estimators import estimate_torsos
from poseterior.inference.hypothesis import diverse
from poseterior.inference.sampler import MANY_ROOTS as NUM_ROOTS
from poseterior.inference.studies.calibration.real import TRUE, true_candidate
from poseterior.inference.studies.errors import best_of, mean_joint_error
from poseterior.inference.studies.evaluation.outcome import Protocol
from poseterior.inference.studies.evaluation.relations import RELATION_GAIN
from poseterior.inference.studies.evaluation.scores import Interval
from poseterior.probmodel import Likelihood
from poseterior.probmodel.datasets import Case, read_data_set
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.posterior import Estimate
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.skeleton import NUM_JOINTS
from poseterior.reports.figures.composition import gains_figure
from poseterior.reports.pages.evaluation import CLASSES, EVALUATION_NOISE, gain, protocol_of
from poseterior.reports.pages.motion import ESTIMATOR
from poseterior.reports.pages.page import Data, Page, Values, run
from poseterior.reports.tables import Sheet, sheet_from

K, CENTRE_FRAMES = 5, 160
CHOSEN = ("draws", "composed", "centres, which are no poses")
CENTRE_LAWS = {"disc": Likelihood(), "Gaussian": Likelihood(Gaussian())}
CENTRE_WAYS = ((CANDIDATES, "disc"), (UNCERTAIN, "disc"), (UNCERTAIN, "Gaussian"), (TRUE, "disc"))
ROOT_WORDS = {CANDIDATES: ESTIMATOR, UNCERTAIN: "uncertain", TRUE: "true"}


class CentreErrors(NamedTuple):
    """Mean joint errors in mm: of the single estimate, and the best of k draws, k composed poses
    and k centres; the last three once more where a draw that was kept apart stands in for the
    truth."""

    single: float
    draws: float
    composed: float
    centres: float
    own_draws: float
    own_composed: float
    own_centres: float


def judged(drawn: Draws, single: np.ndarray, case: Case) -> CentreErrors:
    """What draws in random order, and the single estimate `(15, 3)`, are worth."""
    stand_in = drawn.joints[0] * case.unit
    rest = drawn.take(slice(1, None))
    some = (
        np.stack([one.joints for one in diverse(rest.joints, K)]),
        np.stack([one.joints for one in compose(rest, K)]),
        clusters(rest.joints.reshape(len(rest.joints), -1), K, 0).centres.reshape(
            -1, NUM_JOINTS, 3
        ),
    )
    errors = [float(best_of(poses, truth)) for truth in (case.pose, stand_in) for poses in some]
    return CentreErrors(float(mean_joint_error(single, case.pose)), *errors)


def found_of(
    protocol: Protocol, cases: list[Case], frames: list[Estimate], root: str, law: str
) -> list[CentreErrors | None]:
    """By frame; None where there are too few draws."""
    draw = protocol.sampler(root)
    found = []
    for case, frame in zip(cases, frames, strict=True):
        given = dataclasses.replace(frame, likelihood=CENTRE_LAWS[law])
        if root == TRUE:
            given = dataclasses.replace(given, candidates=(true_candidate(case, protocol.model),))
        drawn = draw(given, jax.random.fold_in(jax.random.key(protocol.seed), case.number))
        assert frame.pose is not None  # Akhter & Black's has one
        enough = len(drawn.joints) == protocol.num_samples
        found.append(judged(drawn, frame.pose, case) if enough else None)
    return found


class CentreRow(NamedTuple):
    """A way to have a root: mean errors, gains on the single estimate of the three ways to choose,
    that of composed poses on draws where a draw stands in for the truth, and how many frames there
    are."""

    way: tuple[str, str]
    means: list[float]
    gains: list[Interval]
    own: Interval
    frames: int

    @classmethod
    def of(
        cls, way: tuple[str, str], found: list[CentreErrors | None], recording: np.ndarray
    ) -> "CentreRow":
        """The row of what was found by frame."""
        rows = [number for number, one in enumerate(found) if one is not None]
        values = np.array([one for one in found if one is not None])
        own = recording[rows]
        gains = [gain(values[:, [0, column]], own) for column in (1, 2, 3)]
        means = values.mean(axis=0)[:4].tolist()
        return cls(way, means, gains, gain(values[:, [4, 5]], own), len(rows))


def rows_of(data: Path, say: Callable[[str], None]) -> list[CentreRow]:
    """Every way to have a root, with the errors of one set of frames."""
    protocol = protocol_of(data)
    cases = list(read_data_set(data / CLASSES, frames=CENTRE_FRAMES, noise=EVALUATION_NOISE))
    frames = estimate_torsos(
        [case.detection for case in cases],
        ESTIMATOR,
        torsos=protocol.anatomy.torsos,
        limits=protocol.anatomy.limits,
        poses=protocol.dictionary,
        num_candidates=1,
    )
    recording = np.array([case.recording for case in cases])
    rows = []
    for root, law in CENTRE_WAYS:
        found = found_of(protocol, cases, frames, root, law)
        rows.append(CentreRow.of((ROOT_WORDS[root], law), found, recording))
        say(str(rows[-1]))
    return rows


def table(rows: list[CentreRow]) -> Sheet:
    """Errors and gains."""
    means = ("single", *(f"best of {K} {way}" for way in ("draws", "composed", "centres")))
    gains = ("gain of draws on the single estimate", "of composed", "of centres")
    return sheet_from(
        dict(zip(("torso and camera", "error law"), row.way, strict=True))
        | {head: f"{mean:.1f}" for head, mean in zip(means, row.means, strict=True)}
        | {head: _words(one) for head, one in zip(gains, row.gains, strict=True)}
        | {
            "of composed on draws, a draw in place of the truth": _words(row.own),
            "frames": row.frames,
        }
        for row in rows
    )


def _words(one: Interval) -> str:
    return f"{one.value:+.1f} % ({one.low:+.1f} to {one.high:+.1f})"


def main(data: Data) -> Page:
    """Runs the study and writes the page."""
    rows = rows_of(data, print)
    values: Values = {
        "table": table(rows),
        "frames": CENTRE_FRAMES,
        "k": K,
        "least": f"{100 * RELATION_GAIN:.0f} %",
        "roots": NUM_ROOTS,
    }
    gains = dict(zip(CHOSEN, zip(*(row.gains for row in rows), strict=True), strict=True))
    figure = gains_figure(gains, [", ".join(row.way) for row in rows], K)
    return Page("centres", values, {"centres": figure})


if __name__ == "__main__":
    run(main)
