"""What an uncertain root changes on motion capture of people of whom nothing was learned: writes
reports/motion.md.

    python -m reports.pages.motion ../shared/data work

Some forty minutes on one core; `work` keeps what is done, and a run that was stopped goes on there.
"""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from inference.machines import HERE
from inference.results import FIXED, UNCERTAIN, save_tree
from inference.studies.calibration.coverage import CoverageSummary, summary
from inference.studies.calibration.exclusions import Reason, as_text, exclusions
from inference.studies.calibration.posteriors import sampler_of
from inference.studies.calibration.real import TRUE, instances
from inference.studies.calibration.record import standings_tree
from inference.studies.calibration.run import stand
from inference.studies.calibration.simulations import Instance
from inference.studies.evaluation.conditions import Condition, conditions
from inference.studies.evaluation.relations import relations
from inference.studies.evaluation.run import evaluate
from probmodel import Likelihood, PoseModel
from probmodel.anatomy.population import Anatomy
from probmodel.body import align_torsos
from probmodel.camera import WeakPerspective
from probmodel.datasets import Case, from_motions, read_data_set
from probmodel.learning.learner import learn
from probmodel.learning.poses import gather
from probmodel.learning.tolerance import DEFAULT
from probmodel.likelihood import Gaussian
from probmodel.roots import Candidate
from probmodel.skeleton import TORSO_INDEX
from reports.figures.coverage import coverage_figure
from reports.pages.coverage import read
from reports.pages.evaluation import CLASSES, NOISE, protocol_of
from reports.pages.page import Values, in_doubles, write_page
from reports.pages.real import ERRORS, Held, hold_out, others
from reports.tables import Sheet, sheet_of
from reports.tables.coverage import reasons_table, settings_table, share
from reports.tables.evaluation import RELATIONS_CAPTION, relations_table

POSES, DRAWS, ROOTS = 48, 1000, 1000
BUDGET = 100_000_000
NEAREST = 8
"""So many of the dictionary's torsos are laid on the true one."""
FRAMES = 160
"""Of the paper's relations."""
ESTIMATOR = "akhter-black"
MARGINS = (*((TRUE, margin) for margin in (1.0, 1.5, 2.0, 3.0)), (UNCERTAIN, 2.0))
"""Torso and camera, and how many times the usual margins limits have."""
MARGIN_DRAWS = 500
LAWS = {"disc": Likelihood(), "Gaussian": Likelihood(Gaussian())}


class Way(NamedTuple):
    """One way to a posterior: torso and camera (the true ones, an estimator's, or uncertain), and
    the name of the error law."""

    root: str
    errors: str

    @property
    def path(self) -> str:
        """Where it is kept."""
        return f"motion-{self.root}-{self.errors}.nc".lower()


WAYS = (
    Way("dictionary", "disc"),
    Way(UNCERTAIN, "disc"),
    Way(UNCERTAIN, "Gaussian"),
    Way(TRUE, "disc"),
    Way(TRUE, "Gaussian"),
)


def detections(held: Held) -> list[Case]:
    """Poses evenly over people and recordings, with a detector's errors."""
    return list(from_motions(held.motions, "CMU", frames=POSES, noise=ERRORS["detector"]))


def stood(work: Path, held: Held, way: Way) -> xr.DataTree:
    """Where the truths stand among the draws, and why they are excluded where they are."""
    path = work / way.path
    if not path.exists():
        some, likelihood = detections(held), LAWS[way.errors]
        root = UNCERTAIN if way.root == UNCERTAIN else FIXED
        known = instances(
            some, held.model, TRUE if root == UNCERTAIN else way.root, likelihood=likelihood
        )
        draw = sampler_of(None, held.model, DRAWS, max_proposals=BUDGET, root=root, num_roots=ROOTS)
        columns = columns_of(some, excluded(held.model, some, known, root))
        save_tree(standings_tree(stand(draw, known, seed=0), {}, columns), path)
        print(way, flush=True)
    return read(path)


def columns_of(cases: Sequence[Case], reasons: Sequence[list[Reason]]) -> dict[str, np.ndarray]:
    """What `summary` wants to know of each case."""
    return {
        "recording": np.array([case.recording for case in cases]),
        "unit_mm": np.array([case.unit for case in cases]),
        "reasons": np.array([as_text(one) for one in reasons]),
    }


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
    nearest = np.argsort(np.sum(left**2, axis=(1, 2)))[:NEAREST].tolist()
    return tuple(
        Candidate(k, torsos[k], WeakPerspective(scales[k], rotations[k], moves[k]), 0.0)
        for k in nearest
    )


def by_margins(work: Path, data: Path, held: Held, root: str, margin: float) -> xr.DataTree:
    """As `stood`, with Gaussian errors, by limits with wider margins; with the share of all the
    people's poses that these allow."""
    path = work / f"motion-{root}-margin-{margin:g}.nc"
    if not path.exists():
        model, some = with_margin(work, data, held, margin), detections(held)
        known = instances(some, model, TRUE, likelihood=LAWS["Gaussian"])
        kind = FIXED if root == TRUE else root
        draw = sampler_of(
            None, model, MARGIN_DRAWS, max_proposals=BUDGET, root=kind, num_roots=ROOTS
        )
        columns = columns_of(some, excluded(model, some, known, kind))
        tree = standings_tree(stand(draw, known, seed=0), {}, columns)
        check = model.limits.check(gather(held.motions).joints)
        tree.attrs["possible"] = float(check.pose_valid.mean())
        save_tree(tree, path)
        print(root, "margins", margin, flush=True)
    return read(path)


def with_margin(work: Path, data: Path, held: Held, margin: float) -> PoseModel:
    """The model learned from everybody else, with wider margins."""
    path = work / f"limits-{margin:g}.npz"
    if not path.exists():
        rest = others(data, {motion.subject for motion in held.motions})
        learn(rest, tolerance=DEFAULT.wider(margin)).save(path)
    return PoseModel.from_anatomy(Anatomy.load(path))


def margins_table(trees: dict[tuple[str, float], xr.DataTree]) -> Sheet:
    """What wider margins bring and cost."""
    rows = []
    for (root, margin), tree in trees.items():
        found = summary(tree)
        rows.append(
            (
                root,
                f"{margin:g}",
                f"{tree.attrs['possible']:.0%}",
                share(found.excluded),
                share(found.covered["lateral", 0.95]),
                share(found.covered["depth", 0.95]),
                f"{found.lateral:.0f}, {found.depth:.0f}",
                found.without_draws,
            )
        )
    head = (
        "torso and camera",
        "margins, times the usual",
        "possible, of all poses",
        "truth excluded",
        "lateral 95 %",
        "depth 95 %",
        "spread lateral, depth (mm)",
        "no draws",
    )
    return sheet_of(head, rows)


def compared(work: Path, data: Path) -> Values:
    """The paper's relations under every root."""
    protocol = protocol_of(data)
    cases = read_data_set(data / CLASSES, frames=FRAMES, noise=NOISE)
    wanted = conditions((ESTIMATOR, "zhou"), (0,), (0.0,), (FIXED, UNCERTAIN, TRUE))
    out = work / "relations"
    out.mkdir(parents=True, exist_ok=True)
    results = evaluate(cases, wanted, protocol, out, machines=HERE)
    found = relations(results, cases.recording, protocol.ks, Condition(ESTIMATOR))
    return {
        "relations": relations_table(found, RELATIONS_CAPTION),
        "frames": FRAMES,
    }


def widths(found: dict[Way, CoverageSummary]) -> Values:
    """How much wider depth is than where the root is known, and how much of what was excluded is
    possible now."""
    known, free = found[Way(TRUE, "disc")], found[Way(UNCERTAIN, "disc")]
    return {
        "wider": f"{100 * (free.depth / known.depth - 1):.0f} %",
        "wider_across": f"{100 * (free.lateral / known.lateral - 1):.0f} %",
    }


def main(data: Path, work: Path) -> None:
    """Does what is left, then writes the page."""
    in_doubles()
    work.mkdir(parents=True, exist_ok=True)
    held = hold_out(work, data)
    trees = {way: stood(work, held, way) for way in WAYS}
    found = {way: summary(tree) for way, tree in trees.items()}
    gaussian = found[Way(UNCERTAIN, "Gaussian")]
    values: Values = {
        "table": settings_table(found.items(), ("torso and camera", "error law")),
        "reasons": reasons_table(gaussian.reasons, gaussian.size),
        "poses": POSES,
        "roots": ROOTS,
        "nearest": NEAREST,
        "margins": margins_table({one: by_margins(work, data, held, *one) for one in MARGINS}),
        **widths(found),
        **compared(work, data),
    }
    curves = {
        ", ".join(way): tree["simulation"].to_dataset()
        for way, tree in trees.items()
        if way.errors == "disc" or way.root == UNCERTAIN
    }
    write_page("motion", values, {"motion": coverage_figure(curves)})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
