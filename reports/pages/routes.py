"""The fast route to draws with an uncertain root, judged by the exact one on real frames, and what
both cost: writes reports/routes.md.

    python -m poseterior.reports.pages.routes ../shared/data

Controls are the same weighted roots with weights that are wrong.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.draws import COMPLETE, place
from poseterior.inference.importance.rejection import RejectedRoots, reject_roots, verdict
from poseterior.inference.importance.weighted import APART, WeightedRoots, weigh_roots
from poseterior.inference.studies.comparison.judge import (
    AGREES,
    DIFFERS,
    JUDGE_LEVEL,
    Judgement,
    judge,
)
from poseterior.inference.studies.comparison.sample import Sample, sample_of
from poseterior.probmodel import Detection, Estimate, Likelihood, PoseModel
from poseterior.probmodel.detections import LIKELIHOOD_JOINTS
from poseterior.probmodel.errors.detector import DetectorErrors
from poseterior.probmodel.errors.faults import FaultPrior
from poseterior.probmodel.errors.laws import LAWS
from poseterior.probmodel.layouts import corrected
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import TORSO_INDEX
from poseterior.reports.figures.colours import PALETTE
from poseterior.reports.figures.style import FAINT, INK, SMALL, TITLE, page
from poseterior.reports.pages.costs import WANTED, costs_of, plot_costs, table_of
from poseterior.reports.pages.filmed import film
from poseterior.reports.pages.page import Data, Page, run
from poseterior.reports.tables import Sheet, sheet_from, sheet_of
from poseterior.reports.tables.sheet import NOTHING

ROUTE_FRAMES = (10, 30, 50, 70, 90)
"""Of every camera."""
REJECTED_DRAWS, ROUTE_ROOTS = 120, 1500
ROUTE_BUDGET = 100_000_000
"""Proposals for the exact draws of a case, which may be fewer then."""
ROUTE_LAWS = {name: Likelihood(law()) for name, law in LAWS.items()} | {
    "disc, faults": Likelihood(faults=FaultPrior.of(0.02, 0.02)),
}
TURNS = tuple(itertools.islice(itertools.cycle(ROUTE_LAWS), len(ROUTE_FRAMES)))
"""The error law of each of the frames."""
FAST = "weighted roots"
COSTED = (50, 90)
"""Those of the frames in which the number of roots is varied."""


class JudgedFrame(NamedTuple):
    """What one camera detected in one frame, and the error law that is taken for it."""

    name: str
    law: str
    detection: Detection


class Found(NamedTuple):
    """One case.

    Attributes
    ----------
    exact : the exact draws.
    seconds : that these took, and that the weighted roots took.
    effective : of how many equally good roots the weighted ones are.
    gap : difference of the log evidences in standard errors.
    judged : by way, the judgement of its draws.
    """

    exact: RejectedRoots
    seconds: tuple[float, float]
    effective: float
    gap: float
    judged: dict[str, Judgement]


def _without_scale(roots: WeightedRoots) -> np.ndarray:
    """Weights without scale⁻² for every seen joint of the limbs."""
    counted = np.asarray(roots.posterior.detected.counts)
    limbs = int(counted.sum()) - int(counted[list(TORSO_INDEX)].sum())
    return roots.log_weight + 2 * limbs * roots.points.log_scale


def _alike(roots: WeightedRoots) -> np.ndarray:
    """Every root alike that has a draw, as if one had been waited for."""
    return np.where(np.isfinite(roots.log_weight), 0.0, -np.inf)


WEIGHINGS: dict[str, Callable[[WeightedRoots], np.ndarray]] = {
    FAST: lambda roots: roots.log_weight,
    "control: without scale⁻²": _without_scale,
    "control: every root alike": _alike,
}


def whole(roots: WeightedRoots, number: int, seed: int) -> Sample:
    """`number` draws of pose and root."""
    points, poses, _ = roots.draw(np.random.default_rng(seed), number)
    joints, _ = place(roots.posterior, points, poses)
    found = sample_of(joints[None], poses.length[None])
    return found.with_roots(joints[None], np.exp(points.log_scale)[None], points.translation[None])


def _posterior(model: PoseModel, case: JudgedFrame) -> Posterior:
    return Estimate(case.detection, (), ROUTE_LAWS[case.law]).posterior(model)


def study(model: PoseModel, case: JudgedFrame, seed: int) -> Found:
    """Both routes on one case, and the controls."""
    posterior = _posterior(model, case)
    exact_key, fast_key = jax.random.split(jax.random.key(seed))
    started = time.perf_counter()
    exact = reject_roots(
        posterior, key=exact_key, num_samples=REJECTED_DRAWS, max_proposals=ROUTE_BUDGET
    )
    between = time.perf_counter()
    fast = weigh_roots(posterior, key=fast_key, num_roots=ROUTE_ROOTS)
    seconds = between - started, time.perf_counter() - between
    if verdict(exact)[0] != COMPLETE:
        print(verdict(exact)[1])
    known = whole(exact, REJECTED_DRAWS, seed)
    judged = {}
    for name, weigh in WEIGHINGS.items():
        roots = dataclasses.replace(fast, log_weight=weigh(fast))
        sample = whole(roots, int(roots.effective / APART), seed)
        # The evidence of a control is not what it is wrong about.
        evidence = (fast.log_evidence, fast.log_evidence_se) if name == FAST else (math.nan,) * 2
        judged[name] = judge(
            sample,
            known,
            evidence=evidence,
            exact_evidence=(exact.log_evidence, exact.log_evidence_se),
        )
    error = math.hypot(exact.log_evidence_se, fast.log_evidence_se)
    gap = (fast.log_evidence - exact.log_evidence) / error
    return Found(exact, seconds, fast.effective, gap, judged)


def smallest(judgement: Judgement) -> float:
    """The smallest p-value, corrected for the number of tests; NaN without any."""
    tests = judgement.tests
    return min(1.0, len(tests) * min(test.p_value for test in tests)) if tests else math.nan


def table(cases: list[JudgedFrame], found: list[Found]) -> Sheet:
    """A line a case."""
    lines = []
    for case, one in zip(cases, found, strict=True):
        fast = one.judged[FAST]
        line = {
            "frame": case.name,
            "errors": case.law,
            "exact draws": len(one.exact.limbs),
            "a second": f"{len(one.exact.limbs) / one.seconds[0]:.1f}",
            "cut off": f"{100 * one.exact.cut_off:.1f} %",
            "effective roots": f"{one.effective:.0f}",
            "log evidences apart, se": f"{one.gap:+.1f}",
            "smallest p, corrected": f"{smallest(fast):.2g}" if fast.tests else NOTHING,
            "verdict": fast.verdict,
        }
        lines.append(line)
    return sheet_from(lines)


def counts(found: list[Found]) -> Sheet:
    """A line a way: how often it was said to differ."""
    lines = []
    for name in WEIGHINGS:
        said = [one.judged[name].verdict for one in found]
        other = len(said) - said.count(DIFFERS) - said.count(AGREES)
        lines.append((name, said.count(AGREES), said.count(DIFFERS), other))
    return sheet_of(("weights", "agrees", "differs", "cannot tell"), lines)


def figure_of(cases: list[JudgedFrame], found: list[Found]) -> Figure:
    """The smallest p-value of every case, by way."""
    figure = page(8.4, 3.4, dpi=150)
    axes = figure.subplots()
    place = np.arange(len(cases))
    for colour, marker, name in zip(PALETTE, "osD", WEIGHINGS, strict=False):
        values = [max(smallest(one.judged[name]), 1e-12) for one in found]
        axes.semilogy(place, values, marker, color=colour, ms=5, label=name)
    axes.axhline(JUDGE_LEVEL, color=INK, lw=0.8, ls=":")
    axes.set_xticks(place, [case.name for case in cases], rotation=60, ha="right", fontsize=SMALL)
    axes.tick_params(axis="y", labelsize=SMALL)
    axes.set_ylabel("smallest p of all tests, corrected", fontsize=SMALL)
    axes.set_title("Below the line: said to differ", loc="left", fontsize=TITLE, color=INK)
    axes.spines[:].set_color(FAINT)
    axes.legend(fontsize=SMALL, frameon=False, loc="lower left", ncols=3, bbox_to_anchor=(0, 1.08))
    return figure


def main(data: Data) -> Page:
    """Runs the study and writes the page."""
    session = film(data).session
    seen = {
        frame: [corrected(people[frame]) for people in session.people] for frame in ROUTE_FRAMES
    }
    cases = [
        JudgedFrame(f"{frame}, camera {number}", law, detection)
        for frame, law in zip(ROUTE_FRAMES, TURNS, strict=True)
        for number, detection in enumerate(seen[frame], 1)
    ]
    model = PoseModel()
    found = []
    for law in ROUTE_LAWS:  # compiled before times are taken
        first = next(case for case in cases if case.law == law)
        reject_roots(_posterior(model, first), key=jax.random.key(0), num_samples=1)
    for seed, case in enumerate(cases):
        found.append(study(model, case, seed))
        said = {name: one.verdict for name, one in found[-1].judged.items()}
        print(case.name, found[-1].seconds, said, flush=True)
    detections = [detection for frame in COSTED for detection in seen[frame]]
    learned = Likelihood.of(DetectorErrors.default(), LIKELIHOOD_JOINTS)
    costs = costs_of(model, detections, ROUTE_LAWS | {"learned": learned}, print)
    rates = [len(one.exact.limbs) / one.seconds[0] for one in found]
    values: dict[str, str | int | Sheet] = {
        "cases": len(cases),
        "exact": REJECTED_DRAWS,
        "budget": f"{ROUTE_BUDGET:,}",
        "roots": f"{ROUTE_ROOTS:,}",
        "slowest": f"{min(rates):.1f}",
        "middle": f"{np.median(rates):.1f}",
        "fastest": f"{max(rates):.1f}",
        "counts": counts(found),
        "table": table(cases, found),
        "detections": len(detections),
        "costs": table_of(costs),
        "wanted": f"{WANTED:,}",
    }
    figures = {"routes": figure_of(cases, found), "routes-costs": plot_costs(costs)}
    return Page("routes", values, figures)


if __name__ == "__main__":
    run(main)
