"""The paper's evaluation on motion capture of CMU: writes reports/evaluation.md and its pictures.

    python -m tests.benchmarks.evaluation_report ../shared/data work

`work` keeps what frames brought; a run that was stopped goes on there. Some forty minutes of
processor time."""

import json
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from inference.machines import Machines
from inference.studies.evaluation.bias import bias_study
from inference.studies.evaluation.conditions import Condition, conditions
from inference.studies.evaluation.outcome import Protocol
from inference.studies.evaluation.relations import relations
from inference.studies.evaluation.run import Results, evaluate
from inference.studies.evaluation.scores import Values, clustered, common, pose_errors, usable
from probmodel.datasets import EXACT, DataSet, Noise, read_data_set
from probmodel.learning.dictionaries import learn_dictionary
from probmodel.learning.learning import learn, read_all
from reports import evaluation_figures, evaluation_tables
from reports.commands.evaluate import PAPERS_FRAMES, duration
from reports.evaluation_tables import Labels, Sheet
from reports.figures import save_figure

OTHERS = ("cmu/asfamc/01", "cmu/asfamc/03", "bvh/cmu_131_03.bvh")
"""Recordings of people who are not in the eight classes of action."""
CLASSES = "cmu/actions_train.npz"
NOISE = Noise("gaussian", 0.02)
NOISY_FRAMES, TRUE_FRAMES, TRIED_FRAMES, SPEED_FRAMES = 2000, 400, 96, 320
ESTIMATORS = ("akhter-black", "zhou", "dictionary")
WORKERS = 2
PAGE = Path("reports")


class Runs(NamedTuple):
    """The data sets and what came out of their frames: with noisy 2D, and with true 2D."""

    noisy: DataSet
    noisy_results: Results
    true: DataSet
    true_results: Results


def protocol_of(data: Path) -> Protocol:
    """What the others' recordings teach, and the paper's way with it."""
    motions = read_all([data / name for name in OTHERS])
    return Protocol(learn(motions), learn_dictionary(motions))


def run(data: Path, protocol: Protocol, work: Path) -> Runs:
    """Everything, or what is left of it."""

    def judged(name: str, cases: DataSet, wanted: list[Condition]) -> Results:
        (work / name).mkdir(parents=True, exist_ok=True)
        return evaluate(
            cases,
            wanted,
            protocol,
            work / name,
            machines=Machines(WORKERS),
            progress=lambda done, all_: print(name, done, "of", all_, flush=True),
        )

    noisy = read_data_set(data / CLASSES, frames=NOISY_FRAMES, noise=NOISE)
    true = read_data_set(data / CLASSES, frames=TRUE_FRAMES, noise=EXACT)
    return Runs(
        noisy,
        judged("noisy", noisy, conditions(ESTIMATORS, (0,), (0.0,))),
        true,
        judged("true", true, conditions(ESTIMATORS[:2], (0, 1, 2), (0.0, 30.0, 60.0))),
    )


# --- why
# -------------------------------------------------------------------------------------------------------------


def by_difficulty(runs: Runs) -> Sheet:
    """A&B and its best of five by fifths of Zhou's error, which neither of the two has had a hand
    in."""
    values = [runs.noisy_results[Condition(name)] for name in ESTIMATORS[:2]]
    own = common(values)
    hard = pose_errors(values[1], "single")
    edges = np.quantile(hard[own], np.linspace(0, 1, 6))
    fifth = np.clip(np.searchsorted(edges, hard, side="right") - 1, 0, 4)
    rows: list[list[evaluation_tables.Cell]] = []
    for number in range(5):
        there = own & (fifth == number)
        single, best = (pose_errors(values[0], row)[there] for row in ("single", 5))
        recording = runs.noisy.recording[there]
        gain = clustered(
            np.stack([single, best], axis=1), recording, lambda m: 100 * (1 - m[..., 1] / m[..., 0])
        )
        words = f"{edges[number]:.0f} to {edges[number + 1]:.0f} mm"
        rows.append(
            [
                words,
                clustered(single, recording),
                clustered(best, recording),
                gain,
                int(there.sum()),
            ]
        )
    head = ["Zhou's error", "Akhter & Black, single", "its best of 5", "gain, %", "frames"]
    return Sheet(
        "difficulty",
        "The gain by difficulty",
        head,
        rows,
        "Noisy 2D, fifths of the frames. Negative: the best of five is farther off.",
    )


def by_noise_and_discs(data: Path, protocol: Protocol, work: Path) -> Sheet:
    """A&B and its best of five by noise, and with discs of less than half the radius."""
    rows: list[list[evaluation_tables.Cell]] = []
    for name, noise, factor in (
        ("true 2D", EXACT, 0.25),
        ("true 2D", EXACT, 0.1),
        ("noise 2 %", NOISE, 0.25),
        ("noise 4 %", Noise("gaussian", 0.04), 0.25),
    ):
        cases = read_data_set(data / CLASSES, frames=TRIED_FRAMES, noise=noise)
        tried = Protocol(
            protocol.anatomy, protocol.dictionary, factor=factor, max_proposals=4_000_000
        )
        out = work / f"tried-{noise.size:g}-{factor:g}"
        out.mkdir(parents=True, exist_ok=True)
        one = Condition("akhter-black")
        values = evaluate(cases, [one], tried, out, machines=Machines())[one]
        own = usable(values)
        table = np.stack([pose_errors(values, row) for row in ("single", 5, 20, "all")], axis=1)[
            own
        ]
        gain = clustered(table, cases.recording[own], lambda m: 100 * (1 - m[..., 1] / m[..., 0]))
        errors = [clustered(column, cases.recording[own]) for column in table.T]
        rows.append([f"{name}, τ factor {factor:g}", *errors, gain, int(own.sum())])
    head = ["", "single", "best of 5", "best of 20", "all samples", "gain of 5, %", "frames"]
    return Sheet(
        "discs",
        "Akhter & Black: noise, and the size of the discs",
        head,
        rows,
        f"{TRIED_FRAMES} frames, some lost where no pose explains the detections.",
    )


def measured(data: Path, protocol: Protocol, work: Path) -> dict[int, float]:
    """Frames a second with one and with two workers, measured once: the slope of blocks of 32
    frames as they come in, but for each worker's first, in which it compiles."""
    kept = work / "speed.json"
    if kept.exists():
        return {int(workers): rate for workers, rate in json.loads(kept.read_text()).items()}
    cases, rates = read_data_set(data / CLASSES, frames=SPEED_FRAMES, noise=NOISE), {}
    for workers in (1, 2):
        came: list[tuple[float, int]] = []
        with tempfile.TemporaryDirectory(dir=work) as out:
            evaluate(
                cases,
                [Condition("zhou")],
                protocol,
                Path(out),
                machines=Machines(workers),
                progress=lambda done, _, came=came: came.append((time.perf_counter(), done)),
            )
        seconds, frames = np.array(came[1 + workers :]).T
        rates[workers] = float(np.polyfit(seconds - seconds[0], frames, 1)[0])
    kept.write_text(json.dumps(rates))
    return rates


def speed(rates: dict[int, float]) -> Sheet:
    """Measured, and projected to more workers."""
    rows: list[list[evaluation_tables.Cell]] = []
    for workers in (1, 2, 16, 64):
        rate = rates.get(workers, workers * rates[1] * min(1.0, rates[2] / rates[1] / 2))
        words = f"{workers} worker{'s' if workers > 1 else ''}" + (
            "" if workers in rates else " (projected)"
        )
        rows.append([words, rate, duration(PAPERS_FRAMES / rate), duration(1e6 / rate)])
    head = ["", "frames a second", f"{PAPERS_FRAMES:,} frames", "1,000,000 frames"]
    return Sheet("speed", "Throughput", head, rows, SPEED_CAPTION)


SPEED_CAPTION = (
    "Zhou, 1,000 draws, 5 and 20 hypotheses, all errors, every frame written; slope of the line"
    " through the blocks as they came. Two cores, busy with other work, whence the little that a"
    " second worker adds. Projected: as many times the rate of one worker, each with a core of its"
    " own, as efficiently as the second one was."
)


# --- the page
# --------------------------------------------------------------------------------------------------------


def sheets(runs: Runs, protocol: Protocol) -> dict[str, Sheet]:
    """Tables of both runs."""
    noisy, true = (
        Labels(runs.noisy.action, runs.noisy.recording),
        Labels(runs.true.action, runs.true.recording),
    )
    base, ks = Condition(ESTIMATORS[0]), protocol.ks
    found = [
        evaluation_tables.table_1(runs.noisy_results, base, noisy, ks, {}, TABLE_1),
        evaluation_tables.table_2(runs.true_results, base, true, 5, TABLE_2),
        evaluation_tables.metrics_table(
            runs.noisy_results, base, ks, evaluation_tables.METRICS_CAPTION
        ),
        evaluation_tables.frames_table({**runs.noisy_results, **_named(runs.true_results)}),
    ]
    both = [*relations(runs.noisy_results, runs.noisy.recording, ks, base)]
    rest = relations(runs.true_results, runs.true.recording, ks, base)
    found.append(
        evaluation_tables.relations_table(both, "Noisy 2D. " + evaluation_tables.RELATIONS_CAPTION)
    )
    found.append(
        evaluation_tables.relations_table(rest, "True 2D. The same rules.")._replace(
            name="relations-true", title="The paper's relations, true 2D"
        )
    )
    return {sheet.name: sheet for sheet in found}


def _named(results: Results) -> Mapping[Condition, Values]:
    return {
        condition._replace(estimator=f"true-2D-{condition.estimator}"): v
        for condition, v in results.items()
    }


TABLE_1 = (
    f"CMU motion capture, {NOISY_FRAMES:,} frames, Gaussian noise of 2 % of the body height on"
    " every 2D joint, 1,000 draws a frame, one torso-and-camera candidate, as in the paper. ±:"
    " half a 95 % interval over recordings. The paper's column is of another data set: Human3.6M"
    " with 2D joints by Stacked Hourglass, other dictionaries, 15 actions (Chen et al. there:"
    " 153.5)."
)
TABLE_2 = (
    f"CMU motion capture, {TRUE_FRAMES} frames, true 2D joints; the paper's rows: Human3.6M, true"
    " 2D joints, A&B. Frames are those with enough draws in every column."
)


def main(data: Path, work: Path) -> None:
    """Runs all of it and writes the page and its pictures."""
    jax.config.update("jax_enable_x64", True)
    protocol = protocol_of(data)
    runs = run(data, protocol, work)
    tables = sheets(runs, protocol)
    bias = bias_study(read_data_set(data / CLASSES), protocol.anatomy)
    tables |= {sheet.name: sheet for sheet in evaluation_tables.bias_tables(bias)}
    tables["difficulty"] = by_difficulty(runs)
    tables["discs"] = by_noise_and_discs(data, protocol, work)
    tables["speed"] = speed(measured(data, protocol, work))
    base = Condition(ESTIMATORS[0])
    labels = Labels(runs.noisy.action, runs.noisy.recording)
    pictures = {
        "evaluation": evaluation_figures.errors_figure(
            runs.noisy_results, base, labels, protocol.ks
        ),
        "evaluation-pck": evaluation_figures.pck_figure(
            evaluation_figures.pck_curves(runs.true_results, base, 5)
        ),
        "evaluation-bias": evaluation_figures.bias_figure(bias),
    }
    for name, picture in pictures.items():
        save_figure(picture, PAGE / f"{name}.png")
    page = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    body = {name.replace("-", "_"): _table(sheet) for name, sheet in tables.items()}
    (PAGE / "evaluation.md").write_text(
        page.format(**body, valid=_valid(runs, protocol)), encoding="utf-8"
    )


def _table(sheet: Sheet) -> str:
    """Without its title, which the page has."""
    return sheet.markdown().split("\n\n", 1)[1].strip()


def _valid(runs: Runs, protocol: Protocol) -> str:
    return f"{100 * protocol.anatomy.limits.check(runs.noisy.poses).pose_valid.mean():.0f} %"


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
