"""What an uncertain root changes on real detections with a real truth: writes reports/honest.md.

    python -m reports.pages.honest ../shared/data

One person filmed by four calibrated cameras. One camera's detection goes to the product, the truth
is triangulated from the other three. Everything is in the person's own body units and millimetres,
the hips' midpoint at the origin, z along the line of sight, without any alignment.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

import inference
from inference.hypothesis import diverse
from inference.results import FIXED, UNCERTAIN
from inference.studies.errorlaws.embedded import embedded
from inference.studies.errorlaws.learn import learn
from inference.studies.errorlaws.pairs import pairs_of_session
from inference.studies.intervals import Interval, of_share
from inference.uncertain.weighted import FEWEST_EFFECTIVE
from probmodel import Detection, Likelihood, PoseModel
from probmodel.faults import NO_FAULTS
from probmodel.layouts import corrected
from probmodel.likelihood import Gaussian
from probmodel.sessions import Session, read_session
from probmodel.skeleton import JOINT_INDEX, LIMB_JOINTS
from reports.figures.colours import PALETTE
from reports.figures.style import FAINT, INK, SMALL, TITLE, page
from reports.pages.page import in_doubles, write_page
from reports.tables import Sheet, sheet_of

UNSEEN = 50
"""The first frame that the learned law has not seen."""
FRAMES = range(UNSEEN, 100, 6)
DRAWS, ROOTS, BEST = 4000, 1000, 5
HIPS = [JOINT_INDEX["right_hip"], JOINT_INDEX["left_hip"]]
LIMB = 338.0
"""Millimetres: the person's mean limb bone."""
DISC, GAUSSIAN, LEARNED = "disc", "Gaussian", "learned"
JUDGED = [
    *LIMB_JOINTS,
    *(JOINT_INDEX[name] for name in ("right_shoulder", "left_shoulder", "right_hip", "left_hip")),
]
"""The joints of the errors: those that detector and skeleton define alike."""


class Way(NamedTuple):
    """One way to a posterior: its root, the error law's name, and whether midpoints are moved to
    the skeleton's thorax and pelvis."""

    root: str
    errors: str = DISC
    moved: bool = True

    def __str__(self) -> str:
        given = "" if self.moved else ", `--as-detected`"
        return f"{self.root}, {self.errors}{given}"


WAYS = (
    Way(FIXED, moved=False),
    Way(FIXED),
    Way(UNCERTAIN, moved=False),
    Way(UNCERTAIN),
    Way(UNCERTAIN, GAUSSIAN),
    Way(UNCERTAIN, LEARNED),
)
Found = dict[Way, list["Judged"]]
"""By way, what was found in each case."""


class FilmedCase(NamedTuple):
    """What one camera detected, and the truth `(15, 3)` from the others: body units of the person,
    the hips' midpoint at the origin, z along the line of sight to it; with the covariances
    `(15, 3, 3)` of the truth's own errors, those of one joint independent of another's."""

    camera: int
    detection: Detection
    truth: np.ndarray
    doubt: np.ndarray

    def errors(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """`(number, 15, 3)`: errors that the truth may have, rooted as it is."""
        spread = np.linalg.cholesky(np.nan_to_num(self.doubt) + 1e-12 * np.eye(3))
        free = np.einsum("jab,njb->nja", spread, rng.normal(size=(number, *self.truth.shape)))
        return free - free[:, HIPS].mean(axis=1, keepdims=True)


class Judged(NamedTuple):
    """One way on one case.

    Attributes
    ----------
    standing : `(8, 3)` share of draws below the truth, limb joints × x, y, depth; draws have errors
        as the truth has them.
    bare : `(8, 3)` the same of draws without.
    spread : `(8, 3)` standard deviations of the draws, body units.
    mean, best : mm, errors of the posterior's mean and of the best of five hypotheses.
    effective : roots; NaN where the root is fixed.
    seconds : of the drawing.
    drawn : whether there are any draws.
    """

    standing: np.ndarray
    bare: np.ndarray
    spread: np.ndarray
    mean: float
    best: float
    effective: float
    seconds: float
    drawn: bool


NOWHERE = np.full((8, 3), np.nan)
LOST = Judged(NOWHERE, NOWHERE, NOWHERE, np.nan, np.nan, np.nan, np.nan, False)
"""Where there is no draw."""


def cases_of(session: Session, frames: Sequence[int]) -> list[FilmedCase]:
    """Every camera in some frames of a session, judged by the others, whose detections err as in
    the frames before `UNSEEN`."""
    exact = pairs_of_session(session.take(range(UNSEEN)), perspective=True)
    sigma = learn(exact).errors.sigma
    found = []
    for number in range(len(session.cameras)):
        world = session.without(number)
        truth = session.along_sight(number, world.points) / session.unit
        axes = session.sight_axes(number, world.points)[:, None]
        doubt = axes @ world.covariance @ np.swapaxes(axes, -1, -2)
        doubt = doubt * sigma[:, None, None] ** 2
        found.append(
            [
                FilmedCase(number, session.people[number][frame], truth[frame], doubt[frame])
                for frame in frames
            ]
        )
    return [case for cases in zip(*found, strict=True) for case in cases]


def likelihoods(session: Session) -> dict[str, Likelihood]:
    """By name: the paper's, its Gaussian, and the one learned from the frames before `UNSEEN`, all
    without faults."""
    law = embedded(session.take(range(UNSEEN)))
    return {
        DISC: Likelihood(),
        GAUSSIAN: Likelihood(Gaussian()),
        LEARNED: dataclasses.replace(Likelihood.of(law), faults=NO_FAULTS),
    }


def judge(
    model: PoseModel, case: FilmedCase, root: str, likelihood: Likelihood, seed: int
) -> Judged:
    """Draws for one camera's detection, against the truth."""
    frame = inference.estimate_torso(
        case.detection, torsos=np.asarray(model.torsos), likelihood=likelihood
    )
    result = inference.sample(
        model,
        frame,
        key=jax.random.key(seed),
        num_samples=DRAWS,
        root=root,
        num_roots=ROOTS,
        max_proposals=300_000_000,
    )
    if not result.num_draws:
        return LOST
    joints = result.tree["posterior"].joints.values[0]
    joints = joints - joints[:, HIPS].mean(axis=1, keepdims=True)
    limbs, truth = joints[:, LIMB_JOINTS], case.truth[list(LIMB_JOINTS)]
    noise = case.errors(np.random.default_rng(seed), len(joints))[:, LIMB_JOINTS]
    hypotheses = np.array([one.joints for one in diverse(joints, min(BEST, len(joints)))])
    return Judged(
        standing=np.mean(limbs + noise < truth, axis=0),
        bare=np.mean(limbs < truth, axis=0),
        spread=limbs.std(axis=0),
        mean=float(error(joints.mean(axis=0)[None], case.truth)[0]),
        best=float(error(hypotheses, case.truth).min()),
        effective=float(result.tree.attrs.get("effective_roots", np.nan)),
        seconds=float(result.tree.attrs["wall_time_s"]),
        drawn=True,
    )


def error(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """`(n,)` mm: mean distance of poses `(n, 15, 3)` from the truth over `JUDGED`."""
    apart = np.linalg.norm(joints[:, JUDGED] - truth[JUDGED], axis=-1)
    return LIMB * np.nanmean(apart, axis=1)


def coverage(standing: np.ndarray, cluster: np.ndarray) -> Interval:
    """How often central intervals of 95 % hold the truth, `standing` `(n, ...)`, with an interval
    from drawing cameras anew."""
    known = ~np.isnan(standing).reshape(len(standing), -1).any(axis=1)
    held = (standing >= 0.025) & (standing <= 0.975)
    return of_share(held[known].reshape(known.sum(), -1), cluster[known])


def table(outcomes: Found, camera: np.ndarray) -> Sheet:
    """A line a way: coverage by axis, truths beyond all draws, widths, errors."""
    lines: list[tuple[Any, ...]] = []
    for way, found in outcomes.items():
        standing = np.stack([one.standing for one in found])
        drawn = np.array([one.drawn for one in found])
        beyond = ((standing == 0) | (standing == 1))[drawn]
        spread = LIMB * np.nanmean([one.spread for one in found], axis=(0, 1))
        lines.append(
            (
                str(way),
                *(share(coverage(standing[:, :, axis], camera)) for axis in range(3)),
                f"{100 * beyond.mean():.0f} %",
                f"{100 * beyond.any(axis=(1, 2)).mean():.0f} %",
                f"{np.hypot(*spread[:2]) / np.sqrt(2):.0f} / {spread[2]:.0f}",
                f"{np.nanmean([one.mean for one in found]):.0f}",
                f"{np.nanmean([one.best for one in found]):.0f}",
            )
        )
    head = (
        "torso and camera",
        "x",
        "y",
        "depth",
        "coordinates beyond all draws",
        "cases with one",
        "sd across / in depth, mm",
        "error of mean, mm",
        f"best of {BEST}, mm",
    )
    return sheet_of(head, lines)


def bare_table(outcomes: Found, camera: np.ndarray) -> Sheet:
    """A line a way: coverage by axis if the truth had no error of its own."""
    lines = []
    for way, found in outcomes.items():
        standing = np.stack([one.bare for one in found])
        lines.append(
            (str(way), *(share(coverage(standing[:, :, axis], camera)) for axis in range(3)))
        )
    return sheet_of(("torso and camera", "x", "y", "depth"), lines)


def doubts(cases: Sequence[FilmedCase]) -> tuple[float, float]:
    """Medians of the standard errors of the truth's limb joints, mm: across and in depth."""
    free = np.stack([case.errors(np.random.default_rng(0), 2000).std(axis=0) for case in cases])
    across, _, depth = LIMB * np.median(free[:, LIMB_JOINTS], axis=(0, 1))
    return float(across), float(depth)


def share(interval: Interval) -> str:
    """A share with its interval, in percent."""
    low, high = 100 * interval.low, 100 * interval.high
    return f"{100 * interval.value:.0f} % ({low:.0f}–{high:.0f})"


def costs(outcomes: Found) -> Sheet:
    """A line a way: time a frame, effective roots, cases without draws."""
    lines = []
    for way, found in outcomes.items():
        drawn = [one for one in found if one.drawn]
        seconds = np.median([one.seconds for one in drawn])
        effective = [one.effective for one in drawn]
        few = "–" if way.root == FIXED else f"{np.median(effective):.0f} ({min(effective):.0f})"
        too_few = sum(one.effective < FEWEST_EFFECTIVE for one in drawn)
        lines.append((str(way), f"{seconds:.1f}", few, too_few, len(found) - len(drawn)))
    head = (
        "torso and camera",
        "seconds",
        "effective roots (fewest)",
        f"cases below {FEWEST_EFFECTIVE}",
        "cases without a pose",
    )
    return sheet_of(head, lines)


def standings_figure(outcomes: Found) -> Figure:
    """By axis: how the truths' standings among the draws are distributed; uniform is right."""
    figure = page(8.4, 3.0, dpi=150)
    for axis, name in zip(figure.subplots(1, 3), ("x", "y", "depth"), strict=True):
        axis.plot([0, 1], [0, 1], color=FAINT, lw=0.8, ls=":")
        for colour, (way, found) in zip(PALETTE, outcomes.items(), strict=False):
            row = "xy".find(name) % 3
            standing = np.stack([one.standing[:, row] for one in found if one.drawn]).ravel()
            at = np.sort(standing)
            level = np.arange(1, len(at) + 1) / len(at)
            style = "-" if way.moved else "--"
            axis.step(
                at,
                level,
                color=colour,
                lw=1.3,
                ls=style,
                where="post",
                label=str(way).replace("`", ""),
            )
        axis.set_title(name, loc="left", fontsize=TITLE, fontweight="bold", color=INK)
        axis.set_xlabel("share of draws below the truth", fontsize=SMALL)
        axis.tick_params(labelsize=SMALL)
        axis.set(xlim=(0, 1), ylim=(0, 1))
        axis.set_aspect("equal")
    figure.axes[0].set_ylabel("share of truths", fontsize=SMALL)
    figure.axes[0].legend(fontsize=SMALL - 1, frameon=False, loc="upper left")
    return figure


def study(session: Session, cases: Sequence[FilmedCase]) -> Found:
    """All ways on all cases."""
    model, likelihood, found = PoseModel(), likelihoods(session), {}
    for way in WAYS:
        seen = [case._replace(detection=corrected(case.detection)) for case in cases]
        found[way] = [
            judge(model, case, way.root, likelihood[way.errors], seed)
            for seed, case in enumerate(seen if way.moved else cases)
        ]
    return found


def film(data: Path) -> Session:
    """The person on the beam, in doubles. Ends the program where the data pack is not there."""
    if not (data / "multicamera").is_dir():
        raise SystemExit(
            f"{data} has no folder `multicamera`: this page needs the shared data pack"
        )
    in_doubles()
    return read_session(data / "multicamera")


def main(data: Path) -> None:
    """Runs the study and writes the page."""
    session = film(data)
    cases = cases_of(session, FRAMES)
    outcomes = study(session, cases)
    camera = np.array([case.camera for case in cases])
    across, depth = doubts(cases)
    values: dict[str, str | int | Sheet] = {
        "cases": len(cases),
        "frames": len(FRAMES),
        "seen": UNSEEN,
        "draws": f"{DRAWS:,}",
        "roots": f"{ROOTS:,}",
        "table": table(outcomes, camera),
        "bare": bare_table(outcomes, camera),
        "across": f"{across:.0f}",
        "depth": f"{depth:.0f}",
        "costs": costs(outcomes),
    }
    print(write_page("honest", values, {"honest": standings_figure(outcomes)}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
