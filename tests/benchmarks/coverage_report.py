"""Does the posterior mean what it says? Writes reports/coverage.md and its pictures.

    python -m tests.benchmarks.coverage_report ../shared/data WORK [STAGE…]

Every stage leaves its result in the folder WORK and is not done twice; the page is written when all
are there. With names of stages, only those are done. About an hour on one core."""

import dataclasses
import functools
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from inference.baselines.catalogue import ONE_FLIP
from inference.hypothesis import grid_poses
from inference.results import save_tree
from inference.roots import ESTIMATORS
from inference.studies.calibration import Instance, calibrate, judge
from inference.studies.calibration.choices import CHOOSE, GRID, WAYS, best_error, modes_represented
from inference.studies.calibration.controls import (
    DISTORTIONS,
    IGNORING,
    RECIPE,
    distorted,
    following_the_recipe,
    ignoring,
)
from inference.studies.calibration.coverage import summary
from inference.studies.calibration.ece import ece
from inference.studies.calibration.exclusions import (
    Reason,
    as_text,
    exclusions,
    from_text,
    hung,
    ranking,
)
from inference.studies.calibration.posteriors import Sampler, sampler_of
from inference.studies.calibration.quantities import ENERGY_BALL, LOG_DENSITY, TARP
from inference.studies.calibration.real import TRUE, by_the_likelihood, instances
from inference.studies.calibration.record import standings_tree
from inference.studies.calibration.run import stand
from probmodel import PoseModel
from probmodel.anatomy.population import Anatomy
from probmodel.anatomy.published import read_published
from probmodel.datasets import Case, Noise, from_motions
from probmodel.learning.dictionaries import PoseDictionary, learn_dictionary
from probmodel.learning.learning import learn, read_all
from probmodel.motion import Motion
from reports.coverage_figures import (
    Miss,
    controls_figure,
    coverage_figure,
    misses_figure,
    ranks_figure,
)
from reports.coverage_tables import Rows, by_joint, families, grid, markdown, reasons
from reports.figures import save_figure
from tests.inference.test_calibration import sizes

SIMULATIONS, DRAWS = 1000, 1000
MEASURES = (("angle", "area"), ("area", "area"), ("angle", "box"))
CONTROLLED, RECIPES, RECIPE_DRAWS = 300, 400, 60
BASELINES = (("emcee", ONE_FLIP),)
JUDGED, EVALUATIONS = 100, 10_000


def exact(work: Path, data: Path) -> None:
    """1,000 simulations × 1,000 exact draws in every measure, and what they cost."""
    for upper, lower in MEASURES:
        path = work / f"exact-{upper}-{lower}.nc"
        cost = path.with_suffix(".json")
        if cost.exists():
            continue
        started, cpu = time.perf_counter(), time.process_time()
        calibrate(
            PoseModel(upper=upper, lower=lower),
            "rejection",
            num_simulations=SIMULATIONS,
            num_samples=DRAWS,
            out=path,
        )
        cost.write_text(json.dumps([time.process_time() - cpu, time.perf_counter() - started]))


def controls(work: Path, data: Path) -> None:
    """Wrong posteriors on the first simulations, by the same tests."""
    model = PoseModel()
    right = sampler_of("rejection", model, DRAWS)
    wrong: dict[str, tuple[Sampler, int]] = {
        name: (distorted(right, spoil), CONTROLLED) for name, spoil in DISTORTIONS.items()
    }
    wrong[IGNORING] = ignoring(model, DRAWS), CONTROLLED
    wrong[RECIPE] = following_the_recipe(model, RECIPE_DRAWS), RECIPES
    for number, (name, (sampler, count)) in enumerate(wrong.items()):
        path = work / f"control-{number}.nc"
        if not path.exists():
            tree = calibrate(
                model, sampler, num_simulations=count, out=work / f"partial-{number}.nc"
            )
            tree.attrs["sampler"] = name
            save_tree(tree, path)
            print(name, judge(tree["simulation"].to_dataset()).families, flush=True)


def baselines(work: Path, data: Path) -> None:
    """A sampler that is not exact, from both its starts, on the first of the same simulations."""
    model = PoseModel()
    for name, start in BASELINES:
        path = work / f"baseline-{name}-{start}.nc".replace(" ", "-")
        if not path.exists():
            draw = sampler_of(name, model, EVALUATIONS, max_proposals=EVALUATIONS, start=start)
            tree = calibrate(model, draw, num_simulations=JUDGED)
            tree.attrs["sampler"] = f"{name}, started {start}"
            save_tree(tree, path)


# --- real poses
# ------------------------------------------------------------------------------------------------------

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
ESTIMATED = (TRUE, *ESTIMATORS)
CELLS = [
    *((estimator, error, 0) for error in ERRORS for estimator in ESTIMATED),
    *((estimator, "detector", missing) for missing in (1, 2) for estimator in (TRUE, "zhou")),
]
"""Torso and camera, 2D error, and how many joints are missing: every error with none, and more with
a detector's and one estimator."""
POSES, REAL_DRAWS, BUDGET = 24, 200, 300_000


class Held(NamedTuple):
    """A model and pose dictionary learned from others, and the recordings of three people of whom
    it knows nothing."""

    model: PoseModel
    dictionary: PoseDictionary
    motions: list[Motion]


@functools.cache
def hold_out(work: Path, data: Path) -> Held:
    """Learns from everybody but the three people (and `walking_1`, which is one of them under
    another name); what was learned is kept in `work`."""
    own = read_all([data / "cmu" / "asfamc"])
    limits, poses = work / "limits.npz", work / "poses.npz"
    if not (limits.exists() and poses.exists()):
        subjects = {motion.subject for motion in own}
        others = [
            motion
            for motion in read_all([data / "cmu" / "actions_train.npz", data / "bvh"])
            if motion.subject not in subjects and motion.name != "walking/walking_1"
        ]
        learn_dictionary(others).save(poses)
        learn(others).save(limits)
    return Held(PoseModel.from_anatomy(Anatomy.load(limits)), PoseDictionary.load(poses), own)


def cases(held: Held, error: str, missing: int = 0, factor: float = 0.25) -> list[Case]:
    """Poses evenly over people and recordings, by one kind of 2D error."""
    poses = from_motions(held.motions, "CMU", frames=POSES, noise=ERRORS[error])
    some = [case.hiding(missing) for case in poses]
    return [by_the_likelihood(case, factor) for case in some] if error == LIKELIHOOD else some


def real(work: Path, data: Path) -> None:
    """Estimator × 2D error × missing joints: where the truth stands, and why it is excluded where
    it is."""
    left = [cell for cell in CELLS if not _cell(work, *cell).exists()]
    if not left:
        return
    held = hold_out(work, data)
    for estimator, error, missing in left:
        tree = _stand(held.model, held.dictionary, estimator, cases(held, error, missing))
        tree.attrs.update(estimator=estimator, error=error, missing=missing)
        save_tree(tree, _cell(work, estimator, error, missing))
        print(
            estimator,
            error,
            missing,
            Counter(tree["simulation"].status.values.tolist()),
            flush=True,
        )


def _cell(work: Path, estimator: str, error: str, missing: int) -> Path:
    return work / f"real-{estimator}-{error}-{missing}.nc".replace(" ", "").replace("%", "")


def _stand(
    model: PoseModel,
    dictionary: PoseDictionary,
    estimator: str,
    some: list[Case],
    factor: float = 0.25,
) -> xr.DataTree:
    known = instances(
        some,
        model,
        estimator,
        factor=factor,
        **({} if estimator == TRUE else {"poses": dictionary}),
    )
    columns = {
        "recording": np.array([case.recording for case in some]),
        "unit_mm": np.array([case.unit for case in some]),
        "reasons": np.array([as_text(one) for one in exclusions(model, some, known)]),
    }
    standings = stand(
        sampler_of("rejection", model, REAL_DRAWS, max_proposals=BUDGET), known, seed=0
    )
    return standings_tree(standings, {}, columns)


# --- k hypotheses
# ----------------------------------------------------------------------------------------------------

KS = (1, 2, 5, 10, 20, 50)
CHOSEN_DRAWS, STAND_INS = 500, 50


def choices(work: Path, data: Path) -> None:
    """Best-of-k error (mm) by way and k, of the truth and of held-out draws in its place, and modes
    represented."""
    path = work / "choices.nc"
    if path.exists():
        return
    rows: dict[str, list] = {"error": [], "floor": [], "modes": [], "recording": []}
    held = hold_out(work, data)
    some = cases(held, "detector")
    draw = sampler_of("rejection", held.model, CHOSEN_DRAWS + STAND_INS, max_proposals=BUDGET)
    for number, instance in enumerate(instances(some, held.model)):
        drawn = draw(number, instance, jax.random.key(number)).joints
        if len(drawn) < CHOSEN_DRAWS + STAND_INS:
            print("no draws for", some[number].recording, flush=True)
            continue
        observation = instance.frame.observation(instance.frame.candidates[0])
        chosen = _chosen(drawn[STAND_INS:], grid_poses(held.model, observation, most=CHOSEN_DRAWS))
        mm, truth, held_out = some[number].unit, instance.joints, drawn[:STAND_INS]
        rows["error"].append([[mm * _best(picked, truth) for picked in way] for way in chosen])
        rows["floor"].append([[mm * _best(picked, held_out) for picked in way] for way in chosen])
        rows["modes"].append(
            [[modes_represented(picked, drawn) for picked in way] for way in chosen]
        )
        rows["recording"].append(some[number].recording)
    recording = rows.pop("recording")
    tree = xr.DataTree.from_dict(
        {
            "choices": xr.Dataset(
                {
                    name: (("pose", "way", "k"), np.array(values, float))
                    for name, values in rows.items()
                }
                | {"recording": (("pose",), np.array(recording))},
                coords={"way": list(WAYS), "k": list(KS)},
            )
        }
    )
    save_tree(tree, path)


def _chosen(draws: np.ndarray, grid: np.ndarray) -> list[list[np.ndarray]]:
    """By way and k; empty where the grid has no pose."""
    return [
        [
            CHOOSE[way](grid if way == GRID else draws, k, 0) if len(grid) or way != GRID else grid
            for k in KS
        ]
        for way in WAYS
    ]


def _best(picked: np.ndarray, truths: np.ndarray) -> float:
    """The mean over truths of the best error; NaN where nothing was picked."""
    return float(np.mean(best_error(picked, truths))) if len(picked) else np.nan


# --- sensitivity
# -----------------------------------------------------------------------------------------------------


class Variant(NamedTuple):
    """One thing that is believed differently: limits and measures, the factor in τ, and whether
    scores count."""

    name: str
    upper: str = "angle"
    lower: str = "area"
    published: bool = False
    factor: float = 0.25
    scores: bool = True


VARIANTS = (
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
    left = [
        number for number in range(len(VARIANTS)) if not (work / f"variant-{number}.nc").exists()
    ]
    held = hold_out(work, data) if left else None
    for number in left:
        assert held is not None
        variant, model = VARIANTS[number], held.model
        published = data / "akhter_black" / "jointAngleModel_v2.mat"
        limits = read_published(published) if variant.published else model.limits
        model = PoseModel(
            limits, model.lengths, model.torsos, upper=variant.upper, lower=variant.lower
        )
        some = [_scored(case, variant.scores) for case in cases(held, "detector")]
        tree = _stand(model, held.dictionary, TRUE, some, variant.factor)
        tree.attrs["variant"] = variant.name
        save_tree(tree, work / f"variant-{number}.nc")
        print(variant.name, Counter(tree["simulation"].status.values.tolist()), flush=True)


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


# --- the tests themselves
# --------------------------------------------------------------------------------------------

REPETITIONS, TOYS, TOY_DRAWS = 200, 100, 50


def toy(work: Path, data: Path) -> None:
    """How often each test rejects a right posterior in closed form."""
    path = work / "toy.json"
    if not path.exists():
        found = sizes(REPETITIONS, TOYS, TOY_DRAWS)
        path.write_text(json.dumps({name: p_values.tolist() for name, p_values in found.items()}))


# --- the page
# --------------------------------------------------------------------------------------------------------

STAGES = {
    "exact": exact,
    "toy": toy,
    "real": real,
    "controls": controls,
    "choices": choices,
    "sensitivity": sensitivity,
    "baselines": baselines,
}
SHOWN = ("right_wrist z", "left_knee x", LOG_DENSITY, ENERGY_BALL, TARP)


def read(path: Path) -> xr.DataTree:
    with xr.open_datatree(path) as tree:
        return tree.load()


def toy_rows(work: Path) -> Rows:
    found = json.loads((work / "toy.json").read_text())
    rows = []
    for name, values in found.items():
        p_values = np.array(values)
        rows.append(
            (
                name,
                *(f"{np.mean(p_values <= level):.1%}" for level in (0.01, 0.05, 0.2)),
                str(len(values)),
            )
        )
    return Rows(("test", "rejects at 1 %", "at 5 %", "at 20 %", "repetitions"), rows)


def with_ece(table: Rows, simulations: Sequence[xr.Dataset]) -> Rows:
    """The field's ECE of the same simulations, and its floor, beside the tests."""
    columns = []
    for simulation in simulations:
        found = ece(
            simulation.whole.values,
            simulation.stand_in.values,
            np.arange(simulation.sizes["simulation"]),
        )
        columns.append(f"{found.whole.value:.3f} ({found.floor:.3f})")
    head = (*table.head[:-1], "field's ECE (floor)", table.head[-1])
    return Rows(
        head, [(*row[:-1], one, row[-1]) for row, one in zip(table.rows, columns, strict=True)]
    )


def judged(found: dict[str, xr.Dataset]) -> Rows:
    """The tests on several posteriors, and the field's ECE."""
    return with_ece(
        families({name: judge(simulation) for name, simulation in found.items()}),
        list(found.values()),
    )


def real_trees(work: Path) -> dict[tuple[str, str, str], xr.DataTree]:
    return {
        (estimator, error, str(missing)): read(_cell(work, estimator, error, missing))
        for estimator, error, missing in CELLS
    }


def reasons_of(
    trees: dict[tuple[str, str, str], xr.DataTree], wanted: Callable[[str], bool]
) -> tuple[list, int]:
    texts = [
        text
        for (estimator, _, _), tree in trees.items()
        if wanted(estimator)
        for text in tree["simulation"].reasons.values.tolist()
    ]
    return ranking([from_text(text) for text in texts]), len(texts)


def misses(work: Path, data: Path, labels: Sequence[str]) -> list[Miss]:
    """One picture for each reason: the instance in the middle of those that it excludes alone, or
    with few others."""
    held = hold_out(work, data)
    found: dict[str, list[tuple[int, Miss]]] = {label: [] for label in labels}
    some = cases(held, "detector")
    for estimator in ESTIMATORS:
        views = instances(some, held.model, estimator, poses=held.dictionary, num_candidates=1)
        for case, instance, why in zip(
            some, views, exclusions(held.model, some, views), strict=True
        ):
            for label in {reason.label for reason in why} & set(labels):
                title = f"{label}\n({estimator}, subject {case.subject})"
                found[label].append((len(why), _miss(title, case, instance, why, label)))
    chosen = [sorted(many, key=lambda one: one[0]) for many in found.values() if many]
    return [many[len(many) // 4][1] for many in chosen]


def _miss(title: str, case: Case, instance: Instance, why: list[Reason], label: str) -> Miss:
    candidate = instance.frame.candidates[0]
    joints = hung(case, candidate) * float(candidate.camera.scale)
    pixels = joints + np.append(np.asarray(candidate.camera.translation), 0.0)
    first = sorted(why, key=lambda reason: reason.label != label)
    radius = np.asarray(instance.frame.observation(candidate).radius)
    return Miss(title, case.detection.keypoints, radius, case.pixels, pixels, first)


def choices_rows(work: Path) -> Rows:
    found = read(work / "choices.nc")["choices"].to_dataset()
    rows = []
    for way in WAYS:
        for name, words in (
            ("error", "the truth"),
            ("floor", "one more draw"),
            ("modes", "modes represented"),
        ):
            values = found[name].sel(way=way).mean("pose")
            rows.append(
                (
                    way,
                    words,
                    *(f"{value:.0%}" if name == "modes" else f"{value:.0f} mm" for value in values),
                )
            )
    return Rows(("chosen by", "against", *(f"k = {k}" for k in KS)), rows)


def _some(work: Path, pattern: str) -> list[xr.DataTree]:
    return [read(path) for path in sorted(work.glob(pattern))]


def page(work: Path, data: Path) -> None:
    """Writes the page and its pictures."""
    reports = Path(__file__).parents[2] / "reports"
    exacts = {
        f"upper {upper}, lower {lower}": (
            read(work / f"exact-{upper}-{lower}.nc")["simulation"].to_dataset()
        )
        for upper, lower in MEASURES
    }
    first = next(iter(exacts.values()))
    right = {"exact rejection": first.isel(simulation=slice(CONTROLLED))}
    wrong = {
        tree.attrs["sampler"]: tree["simulation"].to_dataset()
        for tree in _some(work, "control-*.nc")
    }
    others = {
        tree.attrs["sampler"]: tree["simulation"].to_dataset()
        for tree in _some(work, "baseline-*.nc")
    }
    trees = real_trees(work)
    summaries = {key: summary(tree) for key, tree in trees.items()}
    estimated, size = reasons_of(trees, lambda name: name != TRUE)
    own, own_size = reasons_of(trees, lambda name: name == TRUE)
    variants = [read(work / f"variant-{number}.nc") for number in range(len(VARIANTS))]
    save_figure(ranks_figure(first), reports / "coverage.png")
    save_figure(
        controls_figure({"exact": first, **wrong}, SHOWN), reports / "coverage_controls.png"
    )
    curves = {
        f"{name}": trees[name, "detector", "0"]["simulation"].to_dataset() for name in ESTIMATED
    }
    save_figure(coverage_figure(curves), reports / "coverage_real.png")
    save_figure(
        misses_figure(misses(work, data, [one.label for one in estimated[:3]])),
        reports / "coverage_misses.png",
    )
    costs = [
        json.loads((work / f"exact-{upper}-{lower}.json").read_text()) for upper, lower in MEASURES
    ]
    tables = {
        "MEASURES": markdown(judged(exacts)),
        "COST": ", ".join(f"{cpu:.0f} s" for cpu, _ in costs),
        "TOY": markdown(toy_rows(work)),
        "CONTROLS": markdown(judged({**right, **wrong})),
        "BASELINES": markdown(
            judged({"exact rejection": first.isel(simulation=slice(JUDGED)), **others})
        ),
        "REAL": markdown(grid(summaries, ("torso and camera", "2D error", "missing"))),
        "JOINTS": markdown(by_joint(summaries["zhou", "detector", "0"])),
        "JOINTS_TRUE": markdown(by_joint(summaries[TRUE, "detector", "0"])),
        "REASONS": markdown(reasons(estimated, size)),
        "REASONS_TRUE": markdown(reasons(own, own_size)),
        "CHOICES": markdown(choices_rows(work)),
        "SENSITIVITY": markdown(
            grid({(tree.attrs["variant"],): summary(tree) for tree in variants}, ("variant",))
        ),
        "JUDGED": str(JUDGED),
        "EVALUATIONS": f"{EVALUATIONS:,}",
        "POSES": str(summaries[TRUE, "detector", "0"].size),
    }
    body = Path(__file__).with_name("coverage_report.md").read_text(encoding="utf-8")
    for name, text in tables.items():
        body = body.replace("{{" + name + "}}", text)
    (reports / "coverage.md").write_text(body, encoding="utf-8")


def main(data: Path, work: Path, stages: Sequence[str]) -> None:
    """Does what is left of the stages, then writes the page."""
    jax.config.update("jax_enable_x64", True)
    work.mkdir(parents=True, exist_ok=True)
    for name in stages or STAGES:
        STAGES[name](work, data)
    if not stages:
        page(work, data)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])
