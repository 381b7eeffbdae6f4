"""The runs of reports/coverage.md on real poses: where the truth stands, what k hypotheses cover,
and what the choices of the model are worth.

Every stage leaves its result in a folder and is not done twice.
"""

import dataclasses
import functools
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from poseterior.inference.estimators import ESTIMATORS
from poseterior.inference.hypothesis import grid_poses
from poseterior.inference.studies.calibration.choices import (
    CHOICES,
    CHOOSE,
    POSE_GRID,
    best_error,
    modes_represented,
)
from poseterior.inference.studies.calibration.exclusions import exclusions
from poseterior.inference.studies.calibration.posteriors import sampler_of
from poseterior.inference.studies.calibration.real import TRUE, by_the_likelihood, instances
from poseterior.inference.studies.calibration.record import case_columns, standings_tree
from poseterior.inference.studies.calibration.run import stand
from poseterior.probmodel import Likelihood, PoseModel
from poseterior.probmodel.anatomy.population import Anatomy
from poseterior.probmodel.anatomy.published import read_published
from poseterior.probmodel.datasets import Case, Noise, from_motions
from poseterior.probmodel.learning.dictionaries import PoseDictionary, learn_dictionary
from poseterior.probmodel.learning.learner import learn
from poseterior.probmodel.learning.poses import read_all
from poseterior.probmodel.motion import Motion
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.pages.page import kept
from poseterior.reports.pages.people import CAPTURED_FILES, without

DETECTOR = 0.08 / 4.85
"""As far as MMPose lies from the annotation on the one image that both are of, 0.08 limb lengths,
of the height."""
LIKELIHOOD = "likelihood"
ERRORS = {
    LIKELIHOOD: Noise(),
    "detector": Noise("gaussian", DETECTOR),
    "Gaussian 3 %": Noise("gaussian", 0.03),
    "heavy-tailed": Noise("heavy-tailed", DETECTOR),
}
REAL_ROOTS = (TRUE, *ESTIMATORS)
REAL_CELLS = [
    *((estimator, error, 0) for error in ERRORS for estimator in REAL_ROOTS),
    *((estimator, "detector", missing) for missing in (1, 2) for estimator in (TRUE, "zhou")),
]
"""Torso and camera, 2D error, and how many joints are missing: every error with none, and more with
a detector's and one estimator."""
REAL_POSES, REAL_DRAWS, REAL_BUDGET = 24, 200, 300_000
KS = (1, 2, 5, 10, 20, 50)
CHOSEN_DRAWS, CHOICE_STAND_INS = 500, 50


class Held(NamedTuple):
    """A model and pose dictionary learned from others, and the recordings of three people of whom
    it knows nothing."""

    model: PoseModel
    dictionary: PoseDictionary
    motions: list[Motion]


def others(data: Path, subjects: Collection[str]) -> list[Motion]:
    """The recordings of everybody but these people."""
    return without(read_all([data / source for source in CAPTURED_FILES]), subjects)


@functools.cache
def hold_out(work: Path, data: Path) -> Held:
    """Learns from everybody but the three people; what was learned is kept in `work`."""
    own = read_all([data / "cmu" / "asfamc"])
    limits = work / "limits.npz"
    poses = work / "poses.npz"
    if not (limits.exists() and poses.exists()):
        rest = others(data, {motion.subject for motion in own})
        learn_dictionary(rest).save(poses)
        learn(rest).save(limits)
    return Held(PoseModel.from_anatomy(Anatomy.load(limits)), PoseDictionary.load(poses), own)


def cases(held: Held, error: str, missing: int = 0, factor: float = 0.25) -> list[Case]:
    """Poses evenly over people and recordings, by one kind of 2D error."""
    poses = from_motions(held.motions, "CMU", frames=REAL_POSES, noise=ERRORS[error])
    some = [case.hiding(missing) for case in poses]
    return (
        [by_the_likelihood(case, Likelihood(factor=factor)) for case in some]
        if error == LIKELIHOOD
        else some
    )


def real(work: Path, data: Path) -> None:
    """Estimator × 2D error × missing joints: where the truth stands, and why it is excluded where
    it is."""
    for cell in REAL_CELLS:
        kept(cell_path(work, *cell), _cell, hold_out(work, data), *cell)


def _cell(held: Held, estimator: str, error: str, missing: int) -> xr.DataTree:
    tree = _stand(held.model, held.dictionary, estimator, cases(held, error, missing))
    tree.attrs.update(estimator=estimator, error=error, missing=missing)
    return tree


def cell_path(work: Path, estimator: str, error: str, missing: int) -> Path:
    """Where a cell is kept."""
    return work / f"real-{estimator}-{error}-{missing}.nc".replace(" ", "").replace("%", "")


def _stand(
    model: PoseModel,
    dictionary: PoseDictionary,
    estimator: str,
    some: list[Case],
    factor: float = 0.25,
) -> xr.DataTree:
    settings = {} if estimator == TRUE else {"poses": dictionary}
    likelihood = Likelihood(factor=factor)
    known = instances(some, model, estimator, likelihood=likelihood, **settings)
    draw = sampler_of("rejection", model, REAL_DRAWS, root=CANDIDATES, max_proposals=REAL_BUDGET)
    columns = case_columns(some, exclusions(model, some, known))
    return standings_tree(stand(draw, known, seed=0), {}, columns)


def choices(work: Path, data: Path) -> None:
    """Best-of-k error (mm) by way and k, of the truth and of held-out draws in its place, and modes
    represented."""
    kept(work / "choices.nc", _choices, hold_out(work, data))


def _choices(held: Held) -> xr.DataTree:
    rows: dict[str, list] = {"error": [], "floor": [], "modes": [], "recording": []}
    some = cases(held, "detector")
    draw = sampler_of(
        "rejection",
        held.model,
        CHOSEN_DRAWS + CHOICE_STAND_INS,
        root=CANDIDATES,
        max_proposals=REAL_BUDGET,
    )
    for number, instance in enumerate(instances(some, held.model)):
        drawn = draw(number, instance, jax.random.key(number)).joints
        if len(drawn) < CHOSEN_DRAWS + CHOICE_STAND_INS:
            print("no draws for", some[number].recording, flush=True)
            continue
        observation = instance.frame.observation
        chosen = _chosen(
            drawn[CHOICE_STAND_INS:], grid_poses(held.model, observation, most=CHOSEN_DRAWS)
        )
        mm = some[number].unit
        truth = instance.joints
        held_out = drawn[:CHOICE_STAND_INS]
        rows["error"].append([[mm * _best(picked, truth) for picked in way] for way in chosen])
        rows["floor"].append([[mm * _best(picked, held_out) for picked in way] for way in chosen])
        rows["modes"].append(
            [[modes_represented(picked, drawn) for picked in way] for way in chosen]
        )
        rows["recording"].append(some[number].recording)
    variables = {
        name: (("pose", "way", "k"), np.array(rows[name], float))
        for name in ("error", "floor", "modes")
    }
    found = xr.Dataset(variables, coords={"way": list(CHOICES), "k": list(KS)})
    found["recording"] = (("pose",), np.array(rows["recording"]))
    return xr.DataTree.from_dict({"choices": found})


def _chosen(draws: np.ndarray, grid: np.ndarray) -> list[list[np.ndarray]]:
    """By way and k; empty where the grid has no pose."""
    chosen = []
    for way in CHOICES:
        source = grid if way == POSE_GRID else draws
        chosen.append([CHOOSE[way](source, k, 0) if len(source) else source for k in KS])
    return chosen


def _best(picked: np.ndarray, truths: np.ndarray) -> float:
    """The mean over truths of the best error; NaN where nothing was picked."""
    return float(np.mean(best_error(picked, truths))) if len(picked) else np.nan


class Variant(NamedTuple):
    """One thing that is believed differently: limits and measures, the factor in τ, and whether
    scores count."""

    name: str
    upper: str = "angle"
    lower: str = "area"
    published: bool = False
    factor: float = 0.25
    scores: bool = True

    def model(self, learned: PoseModel, data: Path) -> PoseModel:
        """The model with what is believed instead."""
        limits = learned.limits
        if self.published:
            limits = read_published(data / "akhter_black" / "jointAngleModel_v2.mat")
        believed = limits, learned.lengths, learned.torsos
        return PoseModel(*believed, upper=self.upper, lower=self.lower)


BELIEFS = (
    Variant("as it is"),
    Variant("upper bones by area", upper="area"),
    Variant("lower bones by the box", lower="box"),
    Variant("published limits", published=True),
    Variant("factor in τ 0.125", factor=0.125),
    Variant("factor in τ 0.5", factor=0.5),
    Variant("scores ignored (α = 1)", scores=False),
)


def sensitivity(work: Path, data: Path) -> None:
    """Each variant on the same poses and the same detections: errors of a detector, larger where
    scores are lower."""
    held = hold_out(work, data)
    for number, variant in enumerate(BELIEFS):
        kept(work / f"variant-{number}.nc", _varied, held, variant, variant.model(held.model, data))


def _varied(held: Held, variant: Variant, model: PoseModel) -> xr.DataTree:
    some = [_scored(case, variant.scores) for case in cases(held, "detector")]
    tree = _stand(model, held.dictionary, TRUE, some, variant.factor)
    tree.attrs["variant"] = variant.name
    return tree


def _scored(case: Case, told: bool) -> Case:
    """Scores from 0.4 to 1, errors in inverse proportion to them; `told`: whether the detection
    says its scores."""
    rng = np.random.default_rng([4, case.number])
    score = rng.uniform(0.4, 1.0, case.detection.score.shape)
    error = (case.detection.keypoints - case.pixels[:, :2]) * (score.mean() / score)[:, None]
    detection = dataclasses.replace(
        case.detection,
        keypoints=case.pixels[:, :2] + error,
        score=score if told else np.ones_like(score),
    )
    return dataclasses.replace(case, detection=detection)
