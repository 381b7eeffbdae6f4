"""What an uncertain root changes on motion capture of people of whom nothing was learned: writes
reports/motion.md.

    python -m poseterior.reports.pages.motion ../shared/data work

An hour on two cores; `work` keeps what is done, and a run that was stopped goes on there.
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.machines import HERE
from poseterior.inference.studies.calibration.coverage import CoverageSummary, summary
from poseterior.inference.studies.calibration.exclusions import Reason, exclusions
from poseterior.inference.studies.calibration.posteriors import sampler_of
from poseterior.inference.studies.calibration.real import TRUE, instances
from poseterior.inference.studies.calibration.record import case_columns, standings_tree
from poseterior.inference.studies.calibration.run import stand
from poseterior.inference.studies.calibration.simulations import Instance
from poseterior.inference.studies.evaluation.conditions import Condition, conditions
from poseterior.inference.studies.evaluation.outcome import Protocol
from poseterior.inference.studies.evaluation.relations import Relation, relations
from poseterior.inference.studies.evaluation.run import evaluate
from poseterior.probmodel import Likelihood, PoseModel
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.body import align_torsos
from poseterior.probmodel.camera import WeakPerspective
from poseterior.probmodel.datasets import Case, from_motions, read_data_set
from poseterior.probmodel.errors.laws import Gaussian
from poseterior.probmodel.learning.learner import learn
from poseterior.probmodel.learning.poses import gather
from poseterior.probmodel.learning.tolerance import DEFAULT
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN
from poseterior.probmodel.roots import Candidate
from poseterior.probmodel.skeleton import TORSO_INDEX
from poseterior.reports.figures.coverage import coverage_figure
from poseterior.reports.pages.evaluation import CLASSES, EVALUATION_NOISE, protocol_of
from poseterior.reports.pages.page import Data, Page, Values, Work, kept, run
from poseterior.reports.pages.real import ERRORS, Held, hold_out, others
from poseterior.reports.tables import Sheet, sheet_from
from poseterior.reports.tables.coverage import reasons_table, settings_table, share
from poseterior.reports.tables.evaluation import RELATIONS_CAPTION, relations_table

MOTION_POSES, MOTION_ROOTS = 48, 1000
MOTION_BUDGET = 100_000_000
LAID_TORSOS = 8
"""So many of the dictionary's torsos are laid on the true one."""
RELATION_FRAMES = 640
"""Of the paper's relations."""
ESTIMATOR = "akhter-black"
RELATION_ROOTS = (CANDIDATES, UNCERTAIN, TRUE)
UPRIGHT_DEGREES = 20
"""Degrees by which backs are tilted, where that is believed."""
MOTION_LAWS = {"disc": Likelihood(), "Gaussian": Likelihood(Gaussian())}


class Given(NamedTuple):
    """What a posterior is given: torso and camera (the true ones, an estimator's, or uncertain),
    the name of the error law, and how many times the usual margins its limits have; and the number
    of draws that stand for it."""

    root: str
    errors: str = "Gaussian"
    margin: float = 1.0
    draws: int = 500

    @property
    def kind(self) -> str:
        """Whether the root is fixed or uncertain."""
        return UNCERTAIN if self.root == UNCERTAIN else CANDIDATES

    @property
    def path(self) -> str:
        """Where it is kept."""
        return f"motion-{self.root}-{self.errors}-{self.margin:g}-{self.draws}.nc".lower()


ROOT_KNOWN = Given(TRUE, "disc", draws=1000)
ROOT_FREE = ROOT_KNOWN._replace(root=UNCERTAIN)
ROOT_AND_LAW_FREE = ROOT_FREE._replace(errors="Gaussian")
"""Neither the root nor that a disc holds every error is taken for granted."""
BY_LAW = (
    ROOT_KNOWN._replace(root="dictionary"),
    ROOT_FREE,
    ROOT_AND_LAW_FREE,
    ROOT_KNOWN,
    ROOT_KNOWN._replace(errors="Gaussian"),
)
BY_MARGIN = (
    *(Given(TRUE, margin=margin) for margin in (1.0, 1.5, 2.0, 3.0)),
    Given(UNCERTAIN, margin=2.0),
)


def detections(held: Held) -> list[Case]:
    """Poses evenly over people and recordings, with a detector's errors."""
    return list(from_motions(held.motions, "CMU", frames=MOTION_POSES, noise=ERRORS["detector"]))


def stood(work: Path, data: Path, held: Held, given: Given) -> xr.DataTree:
    """Where the truths stand among the draws, why they are excluded where they are, and the share
    of all the people's poses that the limits allow."""
    return kept(work / given.path, _stood, work, data, held, given)


def _stood(work: Path, data: Path, held: Held, given: Given) -> xr.DataTree:
    model = with_margin(work, data, held, given.margin)
    some = detections(held)
    root = TRUE if given.root == UNCERTAIN else given.root
    known = instances(some, model, root, likelihood=MOTION_LAWS[given.errors])
    draw = sampler_of(
        None,
        model,
        given.draws,
        max_proposals=MOTION_BUDGET,
        root=given.kind,
        num_roots=MOTION_ROOTS,
    )
    columns = case_columns(some, excluded(model, some, known, given.kind))
    check = model.limits.check(gather(held.motions).joints)
    possible = {"possible": float(check.pose_valid.mean())}
    return standings_tree(stand(draw, known, seed=0), possible, columns)


def excluded(
    model: PoseModel, cases: Sequence[Case], known: Sequence[Instance], root: str
) -> list[list[Reason]]:
    """As `exclusions`; where the root is uncertain, under the best of the dictionary's torsos laid
    on the true one. There may be better roots, so that this says at least how many truths are
    possible."""
    if root == UNCERTAIN:
        known = [
            one._replace(frame=dataclasses.replace(one.frame, candidates=laid(case, model)))
            for case, one in zip(cases, known, strict=True)
        ]
    return exclusions(model, cases, known, root)


def laid(case: Case, model: PoseModel) -> tuple[Candidate, ...]:
    """The dictionary's torsos nearest to the true one, turned and scaled onto it about the pelvis
    (least squares) and then shifted, nearest first."""
    torsos = np.asarray(model.torsos)
    view = case.scale * case.pose[list(TORSO_INDEX)]
    rotations = align_torsos(torsos, view)
    turned = np.einsum("nab,njb->nja", rotations, torsos)
    scales = np.sum(turned * view, axis=(1, 2)) / np.sum(turned**2, axis=(1, 2))
    left = view - scales[:, None, None] * turned
    moves = case.pixels[0, :2] + left[..., :2].mean(axis=1)
    nearest = np.argsort(np.sum(left**2, axis=(1, 2)))[:LAID_TORSOS].tolist()
    return tuple(
        Candidate(k, torsos[k], WeakPerspective(scales[k], rotations[k], moves[k]), 0.0)
        for k in nearest
    )


def with_margin(work: Path, data: Path, held: Held, margin: float) -> PoseModel:
    """The model learned from everybody else, with wider margins where they are not the usual."""
    if margin == 1:
        return held.model
    path = work / f"limits-{margin:g}.npz"
    if not path.exists():
        rest = others(data, {motion.subject for motion in held.motions})
        learn(rest, tolerance=DEFAULT.wider(margin)).save(path)
    return PoseModel.from_anatomy(Anatomy.load(path))


def margins_table(trees: dict[Given, xr.DataTree]) -> Sheet:
    """What wider margins bring and cost."""
    rows = []
    for given, tree in trees.items():
        found = summary(tree)
        row = {
            "torso and camera": given.root,
            "margins, times the usual": f"{given.margin:g}",
            "possible, of all poses": f"{tree.attrs['possible']:.0%}",
            "truth excluded": share(found.excluded),
            "lateral 95 %": share(found.covered["lateral", 0.95]),
            "depth 95 %": share(found.covered["depth", 0.95]),
            "spread lateral, depth (mm)": f"{found.lateral:.0f}, {found.depth:.0f}",
            "no draws": found.without_draws,
        }
        rows.append(row)
    return sheet_from(rows)


def compared(work: Path, data: Path) -> Values:
    """The paper's relations under every root; those of the single estimate where hypotheses are
    composed, and where backs are believed to be upright besides."""
    protocol = protocol_of(data)
    cases = read_data_set(data / CLASSES, frames=RELATION_FRAMES, noise=EVALUATION_NOISE)

    def found(name: str, protocol: Protocol, roots: Sequence[str]) -> list[Relation]:
        estimators = (ESTIMATOR, "zhou") if CANDIDATES in roots else (ESTIMATOR,)
        wanted = conditions(estimators, (0,), (0.0,), roots)
        out = work / name
        out.mkdir(parents=True, exist_ok=True)
        results = evaluate(cases, wanted, protocol, out, machines=HERE)
        base = Condition(ESTIMATOR, root=roots[0])
        return relations(results, cases.recording, protocol.ks, base)

    composed = dataclasses.replace(protocol, composed=True)
    upright = dataclasses.replace(composed, upright=math.radians(UPRIGHT_DEGREES) ** -2)
    gaussian = dataclasses.replace(upright, likelihood=MOTION_LAWS["Gaussian"])
    ways = {
        "": (composed, RELATION_ROOTS),
        f", upright within {UPRIGHT_DEGREES}°": (upright, RELATION_ROOTS[1:2]),
        f", upright within {UPRIGHT_DEGREES}°, Gaussian errors": (gaussian, RELATION_ROOTS[1:2]),
    }
    against = [
        one._replace(words=one.words.replace(":", f"{words}:", 1))
        for number, (words, (way, roots)) in enumerate(ways.items())
        for one in found(f"composed-{number}", way, roots)
        if "single" in one.words
    ]
    return {
        "relations": relations_table(
            found("relations", protocol, RELATION_ROOTS), RELATIONS_CAPTION
        ),
        "composed": relations_table(against, RELATIONS_CAPTION),
        "frames": RELATION_FRAMES,
    }


def widths(found: dict[Given, CoverageSummary]) -> Values:
    """How much wider intervals are, in depth and across, than where the root is known."""
    known = found[ROOT_KNOWN]
    free = found[ROOT_FREE]
    return {
        "wider": f"{100 * (free.depth / known.depth - 1):.0f} %",
        "wider_across": f"{100 * (free.lateral / known.lateral - 1):.0f} %",
    }


def main(data: Data, work: Work) -> Page:
    """Does what is left, then writes the page."""
    held = hold_out(work, data)
    trees = {given: stood(work, data, held, given) for given in (*BY_LAW, *BY_MARGIN)}
    found = {given: summary(trees[given]) for given in BY_LAW}
    named = {given[:2]: one for given, one in found.items()}
    values: Values = {
        "table": settings_table(named.items(), ("torso and camera", "error law")),
        "reasons": reasons_table(found[ROOT_AND_LAW_FREE].reasons, found[ROOT_AND_LAW_FREE].size),
        "poses": MOTION_POSES,
        "roots": MOTION_ROOTS,
        "nearest": LAID_TORSOS,
        "margins": margins_table({given: trees[given] for given in BY_MARGIN}),
        **widths(found),
        **compared(work, data),
    }
    curves = {
        ", ".join(given[:2]): trees[given]["simulation"].to_dataset()
        for given in BY_LAW
        if given.errors == "disc" or given == ROOT_AND_LAW_FREE
    }
    return Page("motion", values, {"motion": coverage_figure(curves)})


if __name__ == "__main__":
    run(main)
