"""How far off single 3D estimates are, and the best of five hypotheses beside them: writes
reports/estimators.md, .png.

    python -m tests.benchmarks.estimators_report ../shared/data

Real poses of three people, each judged with dictionaries, limits, lengths and torsos learned
without that person. Errors are mean joint errors in mm after limb scaling and similarity alignment;
the page says what is held out and how."""

import dataclasses
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import inference
from inference.roots.akhter_black import fit_akhter_black
from inference.roots.zhou import fit_zhou
from inference.studies.errors import best_of, mean_joint_error
from inference.studies.evaluation.scores import clustered
from probmodel import Anatomy, Detection, PoseModel
from probmodel.camera import WeakPerspective
from probmodel.datasets import body_height
from probmodel.learning.dictionaries import PoseDictionary, learn_dictionary
from probmodel.learning.learner import learn
from probmodel.learning.poses import read_all
from probmodel.motion import Motion
from probmodel.skeleton import LIMB_JOINTS, NUM_JOINTS
from tests.scenes import camera

SUBJECTS = ("01", "02", "03")
PER_TRIAL = 3
VIEWS = [(yaw, tilt) for yaw in (0, 60, 135, 250) for tilt in (-10, 20)]
NOISE = (0.0, 0.02, 0.05)
"""Standard deviation of the 2D noise, each way, as a share of the body height."""
MISSING = (0, 1, 2)
DRAWS, HYPOTHESES, BUDGET = 2000, 5, 20_000_000
METHODS = ("dictionary", "akhter-black", "zhou")
DRAWN_METHODS, DRAWN_PER_TRIAL = METHODS[1:], 2
NAMES = {
    "mean": "mean pose",
    "dictionary": "dictionary fit",
    "akhter-black": "Akhter & Black",
    "zhou": "Zhou et al.",
}
COLOURS = {"mean": "#777777", "dictionary": "#CC79A7", "akhter-black": "#D55E00", "zhou": "#0072B2"}
PIXELS = 0.2
"""Pixels a millimetre."""


class Held(NamedTuple):
    """One person's poses `(n, 15, 3)` (mm, Y up), the trial of each, and what was learned from
    everybody else."""

    poses: np.ndarray
    trial: np.ndarray
    dictionary: PoseDictionary
    anatomy: Anatomy


def hold_out(motions: Sequence[Motion], subject: str) -> Held:
    """Leaves a person out, and `walking_1`, which is a recording of subject 02 under another
    name."""
    own = [motion for motion in motions if motion.subject == subject]
    others = [
        motion
        for motion in motions
        if motion.subject != subject and motion.name != "walking/walking_1"
    ]
    poses, trial = [], []
    for motion in own:
        joints = motion.without_jumps().joints
        chosen = np.linspace(0, len(joints) - 1, PER_TRIAL + 2).astype(int)[1:-1]
        poses.append(joints[chosen])
        trial += [motion.name] * PER_TRIAL
    return Held(np.concatenate(poses), np.array(trial), learn_dictionary(others), learn(others))


class Case(NamedTuple):
    """A pose in camera axes `truth` `(15, 3)` mm, a detection of it, and the number of its pose."""

    truth: np.ndarray
    detection: Detection
    pose: int


def four_views(number: int) -> list[int]:
    """All yaws, the tilts by turns."""
    return [2 * yaw + (number + yaw) % 2 for yaw in range(4)]


def one_view(number: int) -> list[int]:
    """The views by turns."""
    return [number % len(VIEWS)]


def one_view_of_some(number: int) -> list[int]:
    """As `one_view`, of the first poses of each trial."""
    return one_view(number) if number % PER_TRIAL < DRAWN_PER_TRIAL else []


def cases(
    held: Held, noise: float, missing: int, views: Callable[[int], Iterable[int]], seed: int = 0
) -> list[Case]:
    """Every pose from some of the `VIEWS`. With more joints missing the same ones are, and others
    besides; the noise of a pose and view is the same at every level, only larger."""
    found = []
    for number, pose in enumerate(held.poses):
        for view in views(number):
            rng = np.random.default_rng([seed, number, view])
            truth = np.asarray(camera(*VIEWS[view]).view(pose - pose[0]))
            offset = rng.normal(size=(NUM_JOINTS, 2)) * noise * body_height(pose)
            score = np.full(NUM_JOINTS, 0.8)
            score[rng.permutation(LIMB_JOINTS)[:missing]] = 0
            keypoints = np.where(score[:, None] > 0, PIXELS * (truth[:, :2] + offset) + 320, np.nan)
            found.append(Case(truth, Detection(keypoints, score, "synthetic", "a pose", 0), number))
    return found


def estimates(held: Held, some: Sequence[Case], method: str) -> list[inference.Frame]:
    return inference.estimate_torsos(
        [case.detection for case in some],
        method,
        torsos=held.anatomy.torsos,
        limits=held.anatomy.limits,
        poses=held.dictionary,
    )


def single_errors(held: Held, some: Sequence[Case], method: str) -> np.ndarray:
    """Errors `(n,)` of the single estimates."""
    truth = np.stack([case.truth for case in some])
    if method == "mean":
        return mean_joint_error(np.broadcast_to(held.dictionary.mean, truth.shape), truth)
    return mean_joint_error(
        np.stack([frame.pose for frame in estimates(held, some, method)]), truth
    )


class Sampled(NamedTuple):
    """Errors of one case: the single estimate, the best of five hypotheses, the best of all
    draws."""

    single: float
    best: float
    any_draw: float


def sampled_errors(held: Held, some: Sequence[Case], method: str) -> list[Sampled | None]:
    """None where no pose was possible, or too few within the budget."""
    model = PoseModel.from_anatomy(held.anatomy)
    found: list[Sampled | None] = []
    for number, (case, frame) in enumerate(zip(some, estimates(held, some, method), strict=True)):
        result = inference.sample(
            model, frame, key=jax.random.key(number), num_samples=DRAWS, max_proposals=BUDGET
        )
        if result.num_draws < HYPOTHESES:
            found.append(None)
            continue
        five = np.stack(
            [hypothesis.joints for hypothesis in inference.hypotheses(result, HYPOTHESES)]
        )
        every = np.asarray(result.tree["posterior"].joints)[0]
        errors = (
            mean_joint_error(frame.pose, case.truth),
            best_of(five, case.truth),
            best_of(every, case.truth),
        )
        found.append(Sampled(*map(float, errors)))
    return found


# --- tables
# ----------------------------------------------------------------------------------------------------------


def interval(values: np.ndarray, cluster: np.ndarray) -> tuple[float, float]:
    """Mean and the half-width of its 95 % interval, whole trials being drawn anew."""
    found = clustered(values, cluster)
    return found.value, found.half


def said(values: np.ndarray, cluster: np.ndarray) -> str:
    mean, half = interval(values, cluster)
    return f"{mean:.1f} ± {half:.1f}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


class Singles(NamedTuple):
    """Errors by (method, noise, missing), and trial and subject of each case."""

    errors: dict[tuple[str, float, int], np.ndarray]
    trial: np.ndarray
    subject: np.ndarray


def study_singles(people: dict[str, Held]) -> Singles:
    errors: dict[tuple[str, float, int], np.ndarray] = {}
    for noise in NOISE:
        for missing in MISSING:
            parts = {name: cases(held, noise, missing, four_views) for name, held in people.items()}
            for method in ("mean", *METHODS):
                if missing and method in ("mean", "dictionary"):  # these do not look at limbs
                    errors[method, noise, missing] = errors[method, noise, 0]
                    continue
                found = [single_errors(people[name], part, method) for name, part in parts.items()]
                errors[method, noise, missing] = np.concatenate(found)
                print(method, noise, missing, errors[method, noise, missing].mean(), flush=True)
    trial = np.concatenate(
        [[people[name].trial[case.pose] for case in part] for name, part in parts.items()]
    )
    return Singles(errors, trial, np.array([name[:2] for name in trial]))


def singles_table(singles: Singles) -> str:
    rows = [
        (
            f"{noise:.0%}",
            str(missing),
            *(said(singles.errors[method, noise, missing], singles.trial) for method in NAMES),
        )
        for noise in NOISE
        for missing in MISSING
    ]
    return table(("noise", "missing", *NAMES.values()), rows)


def subjects_table(singles: Singles) -> str:
    rows = []
    for subject in SUBJECTS:
        mine = singles.subject == subject
        rows.append(
            (
                subject,
                str(mine.sum()),
                *(f"{singles.errors[method, 0.0, 0][mine].mean():.1f}" for method in NAMES),
            )
        )
    return table(("subject", "views of poses", *NAMES.values()), rows)


def differences_table(singles: Singles) -> str:
    """Paired differences between neighbours in the order that the paper has."""
    pairs = [("mean", "akhter-black"), ("akhter-black", "zhou"), ("dictionary", "zhou")]
    rows = [
        (
            f"{noise:.0%}",
            str(missing),
            *(
                said(
                    singles.errors[worse, noise, missing] - singles.errors[better, noise, missing],
                    singles.trial,
                )
                for worse, better in pairs
            ),
        )
        for noise in NOISE
        for missing in MISSING
    ]
    return table(("noise", "missing", *(f"{NAMES[a]} − {NAMES[b]}" for a, b in pairs)), rows)


class Drawn(NamedTuple):
    """By (method, missing): `(n, 3)` errors of `Sampled` and the trial of each; counts of cases
    without draws."""

    errors: dict[tuple[str, int], np.ndarray]
    trial: dict[tuple[str, int], np.ndarray]
    lost: dict[tuple[str, int], int]


def study_draws(people: dict[str, Held]) -> Drawn:
    """One view of some poses, the views taking turns; true 2D."""
    drawn = Drawn({}, {}, {})
    for method in DRAWN_METHODS:
        for missing in MISSING:
            errors, trial, lost = [], [], 0
            for held in people.values():
                some = cases(held, 0.0, missing, one_view_of_some)
                for case, found in zip(some, sampled_errors(held, some, method), strict=True):
                    lost += found is None
                    if found is not None:
                        errors.append(found)
                        trial.append(held.trial[case.pose])
            at = method, missing
            drawn.errors[at], drawn.trial[at], drawn.lost[at] = (
                np.array(errors),
                np.array(trial),
                lost,
            )
            print(at, drawn.errors[at].mean(axis=0), lost, flush=True)
    return drawn


def draws_table(drawn: Drawn) -> str:
    rows = []
    for (method, missing), errors in drawn.errors.items():
        trial = drawn.trial[method, missing]
        columns = (
            said(errors[:, 0], trial),
            said(errors[:, 1], trial),
            said(errors[:, 0] - errors[:, 1], trial),
            said(errors[:, 2], trial),
        )
        rows.append((NAMES[method], str(missing), *columns, str(drawn.lost[method, missing])))
    return table(
        ("estimator", "missing", "single", "best of five", "gap", "best of all draws", "no draws"),
        rows,
    )


def ablation_table(people: dict[str, Held]) -> str:
    """What the parts of the two estimators are worth: every joint seen, by noise."""
    variants: dict[str, Callable[[Held, list[Detection]], list]] = {
        "Akhter & Black": lambda held, seen: fit_akhter_black(
            seen, held.dictionary, held.anatomy.limits
        ),
        "… without limits (C_p)": lambda held, seen: fit_akhter_black(
            seen, held.dictionary, held.anatomy.limits, limit_weight=0.0
        ),
        "… without bone lengths (C_l)": lambda held, seen: fit_akhter_black(
            seen, held.dictionary, held.anatomy.limits, bones_weight=0.0
        ),
        "Zhou et al.": lambda held, seen: fit_zhou(seen, held.dictionary),
        "… robust, κ = 0.1": lambda held, seen: fit_zhou(seen, held.dictionary, threshold=0.1),
    }
    rows = []
    for name, fit in variants.items():
        columns = []
        for noise in NOISE:
            errors, trial = [], []
            for held in people.values():
                some = cases(held, noise, 0, four_views)
                truth = np.stack([case.truth for case in some])
                poses = np.stack(
                    [found[0].pose for found in fit(held, [case.detection for case in some])]
                )
                errors.append(mean_joint_error(poses, truth))
                trial.append(held.trial[[case.pose for case in some]])
            columns.append(said(np.concatenate(errors), np.concatenate(trial)))
        rows.append((name, *columns))
    return table(("estimator", *(f"{noise:.0%} noise" for noise in NOISE)), rows)


def turned(detection: Detection, angle: float) -> Detection:
    """The detection after a rotation of the image about (320, 320)."""
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()[:2, :2]
    return dataclasses.replace(detection, keypoints=(detection.keypoints - 320) @ turn.T + 320)


def rotation_table(people: dict[str, Held]) -> str:
    """Mean error with the image turned, 2 % noise, one joint missing; and the largest change of any
    pose's error."""
    rows = []
    for method in METHODS:
        by_angle = []
        for angle in (0, 30, 60):
            found = []
            for held in people.values():
                some = cases(held, 0.02, 1, one_view)
                some = [case._replace(detection=turned(case.detection, angle)) for case in some]
                found.append(single_errors(held, some, method))
            by_angle.append(np.concatenate(found))
        mean = [errors.mean() for errors in by_angle]
        change = [f"{abs(mean[i] / mean[0] - 1):.2%}" for i in (1, 2)]
        most = [f"{np.max(np.abs(by_angle[i] / by_angle[0] - 1)):.1%}" for i in (1, 2)]
        rows.append((NAMES[method], *(f"{value:.2f}" for value in mean), *change, *most))
    head = (
        "estimator",
        "0°",
        "30°",
        "60°",
        "mean by 30°",
        "mean by 60°",
        "any pose by 30°",
        "any pose by 60°",
    )
    return table(head, rows)


def speed_table(held: Held) -> str:
    """Milliseconds a frame, the best of five runs of 64 frames together, and of one frame alone."""
    rows = []
    some = cases(held, 0.02, 1, lambda number: range(len(VIEWS)))[:64]
    for method in METHODS[1:]:
        columns = []
        for count in (64, 1):
            estimates(held, some[:count], method)  # what is compiled or loaded once is not counted
            runs = []
            for _ in range(5):
                started = time.perf_counter(), time.process_time()
                estimates(held, some[:count], method)
                runs.append((time.perf_counter() - started[0], time.process_time() - started[1]))
            columns += [f"{1000 * best / count:.1f}" for best in np.min(runs, axis=0)]
        rows.append((NAMES[method], *columns))
    head = (
        "estimator",
        "64 together: ms a frame",
        "of processor time",
        "one alone: ms",
        "of processor time",
    )
    return table(head, rows)


def recovery_table() -> str:
    """Share of 64 noise-free poses in the span of the embedded dictionary that are recovered to
    1e-3."""
    whole, rng, rows = PoseDictionary.default(), np.random.default_rng(0), []
    limits = Anatomy.default().limits
    for terms in (1, 2, 3):
        shares = []
        for method in ("akhter-black", "zhou"):
            truths = []
            for number in range(64):
                source = whole.bases if method == "akhter-black" else whole.atoms
                chosen = source[rng.choice(len(source), terms, replace=False)]
                weights = (
                    rng.normal(size=terms) * 0.5
                    if method == "akhter-black"
                    else rng.uniform(1, 3, terms)
                )
                pose = np.einsum("k,kja->ja", weights, chosen) + (
                    whole.mean if method == "akhter-black" else 0
                )
                truths.append(np.asarray(camera(*VIEWS[number % len(VIEWS)]).view(pose)))
            view = WeakPerspective(100.0, np.eye(3), np.array([320.0, 320.0]))
            seen = [
                Detection(
                    np.asarray(view.project(truth)),
                    np.full(NUM_JOINTS, 0.8),
                    "synthetic",
                    "a pose",
                    0,
                )
                for truth in truths
            ]
            if method == "akhter-black":
                fits = fit_akhter_black(seen, whole, limits, bones_weight=0.0, limit_weight=0.0)
            else:
                fits = fit_zhou(seen, whole, penalty=1e-4, tolerance=1e-5, max_iterations=5000)
            right = [recovered(fit[0], truth) for fit, truth in zip(fits, truths, strict=True)]
            shares.append(f"{np.mean(right):.0%}")
        rows.append((str(terms), *shares))
    return table(("terms", NAMES["akhter-black"], NAMES["zhou"]), rows)


def recovered(candidate: inference.Candidate, truth: np.ndarray) -> bool:
    found, true = candidate.pose * float(candidate.camera.scale), 100 * (truth - truth[0])
    return bool(np.linalg.norm(found - true) <= 1e-3 * np.linalg.norm(true))


# --- the figure and the page
# -----------------------------------------------------------------------------------------


def figure(singles: Singles, drawn: Drawn, path: Path) -> None:
    """Left: single estimates under noise. Right: single estimates beside the best of five, with
    joints missing."""
    page = Figure(figsize=(9.6, 3.9), dpi=150, facecolor="white", layout="constrained")
    FigureCanvasAgg(page)
    left, right = page.subplots(1, 2, sharey=True)
    for index, (method, name) in enumerate(NAMES.items()):
        means, halves = np.array(
            [interval(singles.errors[method, noise, 0], singles.trial) for noise in NOISE]
        ).T
        at = 100 * np.array(NOISE) + 0.07 * (index - 1.5)
        left.errorbar(
            at, means, halves, color=COLOURS[method], marker="o", ms=4, capsize=2, elinewidth=0.8
        )
        place = (10, {"mean": -4, "dictionary": 5}.get(method, 0))
        left.annotate(
            name,
            (5, means[-1]),
            place,
            textcoords="offset points",
            va="center",
            fontsize=8,
            color=COLOURS[method],
            annotation_clip=False,
        )
    left.set_xlabel("2D noise, % of the body height (no joint missing)")
    left.set_ylabel("mean joint error, mm")
    left.set_xlim(-0.3, 7.2)
    left.set_xticks([100 * noise for noise in NOISE])
    for index, method in enumerate(DRAWN_METHODS):
        for column, style in ((0, "-"), (1, "--")):
            points = [
                interval(drawn.errors[method, m][:, column], drawn.trial[method, m])
                for m in MISSING
            ]
            means, halves = np.array(points).T
            at = np.array(MISSING) + 0.04 * (2 * index + column - 1.5)
            right.errorbar(
                at,
                means,
                halves,
                color=COLOURS[method],
                linestyle=style,
                marker="o",
                ms=4,
                capsize=2,
                elinewidth=0.8,
                mfc=COLOURS[method] if column == 0 else "white",
            )
        right.plot([], [], "-", color=COLOURS[method], label=NAMES[method])
    right.plot([], [], "-o", color="#222222", ms=4, label="single estimate")
    right.plot([], [], "--o", color="#222222", ms=4, mfc="white", label="best of five hypotheses")
    right.legend(frameon=False, fontsize=8, loc="upper left", ncols=2)
    right.set_xlabel("limb joints missing (true 2D)")
    right.set_xticks(MISSING)
    for axis in (left, right):
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_ylim(0, None)
        axis.grid(axis="y", color="#DDDDDD", linewidth=0.6)
    page.savefig(path)


def main(data: Path) -> None:
    """Runs all studies and writes the page and its picture."""
    jax.config.update("jax_enable_x64", True)
    motions = read_all([data / "cmu" / "asfamc", data / "cmu" / "actions_train.npz", data / "bvh"])
    people = {subject: hold_out(motions, subject) for subject in SUBJECTS}
    speed = speed_table(people["01"])
    print(speed, flush=True)
    write(people, study_singles(people), study_draws(people), speed)


def write(people: dict[str, Held], singles: Singles, drawn: Drawn, speed: str) -> None:
    """The page and its picture."""
    reports = Path(__file__).parents[2] / "reports"
    figure(singles, drawn, reports / "estimators.png")
    tables = {
        "POSES": str(sum(len(held.poses) for held in people.values())),
        "SINGLES": singles_table(singles),
        "DIFFERENCES": differences_table(singles),
        "SUBJECTS": subjects_table(singles),
        "DRAWS": draws_table(drawn),
        "ABLATION": ablation_table(people),
        "ROTATION": rotation_table(people),
        "SPEED": speed,
        "RECOVERY": recovery_table(),
    }
    body = Path(__file__).with_name("estimators_report.md").read_text(encoding="utf-8")
    for name, text in tables.items():
        body = body.replace("{{" + name + "}}", text)
    (reports / "estimators.md").write_text(body, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
