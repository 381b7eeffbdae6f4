"""`poseterior evaluate`: the paper's tables, curves and relations on any data set, on one machine
or many."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from poseterior.inference.estimators.external import read_poses
from poseterior.inference.studies.errors import mean_joint_error
from poseterior.inference.studies.evaluation.bias import LEAST_POSES, Bias, bias_study
from poseterior.inference.studies.evaluation.conditions import Condition, conditions
from poseterior.inference.studies.evaluation.outcome import Protocol
from poseterior.inference.studies.evaluation.relations import Relation, relations
from poseterior.inference.studies.evaluation.run import Results, evaluate
from poseterior.inference.studies.evaluation.samples import of_predictions
from poseterior.inference.studies.evaluation.scores import Values, lost
from poseterior.probmodel.datasets import DataSet, brings_detections, read_data_set
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.learning.dictionaries import PoseDictionary
from poseterior.probmodel.root_priors import UNCERTAIN
from poseterior.reports import console
from poseterior.reports.figures import save_figure
from poseterior.reports.figures.bias import bias_figure
from poseterior.reports.figures.evaluation import errors_figure, pck_curves, pck_figure
from poseterior.reports.options import JudgedBy, RootKind, Screen, concentration
from poseterior.reports.settings import EvaluateSettings
from poseterior.reports.tables import Sheet
from poseterior.reports.tables.bias import actions_table, visits_table
from poseterior.reports.tables.evaluation import (
    PAPERS_FRAMES,
    Labels,
    best_table,
    calibration_table,
    frames_table,
    metrics_table,
    narrow,
    pck_table,
    relations_table,
    scores_of,
    sharpness_table,
    table_1,
    table_2,
)
from poseterior.reports.tables.measured import measure_scores_table
from poseterior.reports.tables.words import duration

MANY_FRAMES = 1_000_000
PRINTED = {
    JudgedBy.coordinates: ("table1", "table2", "relations", "best", "calibration", "sharpness"),
    JudgedBy.measures: ("measures",),
}
"""Tables that a terminal shows, by what is judged; the others are written."""
BY_ACTION = ("table1", "table2")
"""Tables with a column for every action or number of joints, of which a terminal shows few."""


class Predictions(NamedTuple):
    """Another method's poses for the frames of a data set.

    Attributes
    ----------
    errors : `(N,)` mm, mean joint errors after limb scaling and similarity alignment; the best
        where there are several for a frame.
    samples : what `samples.of_samples` says of them.
    """

    errors: np.ndarray
    samples: Values

    @classmethod
    def read(cls, path: Path, data: DataSet) -> "Predictions":
        """Of a file, with the joints that the data set's source has. Raises `BadInput` where its
        poses are not those of the data set's frames."""
        poses = read_poses(path)
        if len(poses) != len(data):
            raise BadInput(
                f"{path} holds predictions for {len(poses)} frames, but {data.name} has {len(data)}"
                " of them"
            )
        poses, truth = data.corrected(poses), data.corrected(data.poses)
        try:
            errors = np.asarray(mean_joint_error(poses, truth[:, None])).min(axis=1)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
        return cls(errors, of_predictions(poses, data))


class Findings(NamedTuple):
    """All that an evaluation says: tables and pictures, and the relations among them."""

    sheets: list[Sheet]
    figures: dict[str, Figure]
    relations: list[Relation]


def run(settings: EvaluateSettings, screen: Screen) -> None:
    """Evaluates, and writes tables (.md, .csv), pictures (.png) and the folder `frames`. What is
    there of the same run is kept; raises `BadInput` on bad input, and where the folder holds
    another run."""
    wanted, protocol, seed = _conditions(settings), _protocol(settings), settings.sampling.seed
    with console.progress("reading", screen.quiet):
        data = settings.data
        external = {path.stem: Predictions.read(path, data) for path in settings.predictions or ()}
    out = console.output_folder(settings.out)
    started, begun = time.monotonic(), -1
    with console.progress("frames", screen.quiet) as step:

        def report(done: int, all_of_them: int) -> None:
            nonlocal begun
            begun = done if begun < 0 else begun
            step(done, all_of_them)

        results = evaluate(
            data,
            wanted,
            protocol,
            out,
            machines=settings.workforce.machines(),
            progress=report,
        )
    fresh, seconds = len(wanted) * len(data) - begun, time.monotonic() - started
    bias = None
    with console.progress("bias of motion capture, tables, pictures", screen.quiet):
        if settings.bias and len(data) >= LEAST_POSES:
            # All its frames, in the proportions in which they were recorded.
            whole = read_data_set(settings.dataset, seed=seed, detections=settings.detections)
            bias = bias_study(whole, protocol.anatomy, seed=seed)
        found = findings(
            results,
            data,
            base=wanted[0],
            protocol=protocol,
            external=external,
            bias=bias,
            caption=described(settings, data, protocol),
        )
        write(found, out)
    for condition, values in results.items():
        gone = lost(values)
        if gone.number:
            everyone = len(values["num_draws"])
            what = f"{gone.number} of {everyone} frames under {condition.name} are lost"
            console.warn(f"{what}; the first: {gone.reasons[0]}")
    if screen.json:
        console.show_json(_json(found, out))
        return
    for sheet in found.sheets:
        if sheet.name in PRINTED[settings.of]:
            console.OUT.print(narrow(sheet) if sheet.name in BY_ACTION else sheet)
    if fresh:
        crew = settings.workforce
        console.say(throughput(fresh, seconds, None if crew.scheduler else crew.workers))
    console.say(f"Written to {out}: evaluation.md, tables as .csv, pictures, frames")


def _conditions(settings: EvaluateSettings) -> list[Condition]:
    """Raises `BadInput` where a list holds what it must not."""
    names = [name.strip() for name in settings.estimation.estimator.split(",") if name.strip()]
    missing = _listed(settings.missing, int, "--missing")
    roots = _roots(settings)
    if settings.upright is not None and UNCERTAIN not in roots:
        raise BadInput(
            "--upright is a belief about torso and camera that are drawn with the pose; add"
            " `uncertain` to --root, or leave it out"
        )
    if settings.perspective and set(roots) != {UNCERTAIN}:
        raise BadInput(
            "--perspective needs torso and camera to be uncertain; choose --root uncertain, or"
            " leave it out"
        )
    return conditions(names, missing, _listed(settings.rotate, float, "--rotate"), roots)


def _roots(settings: EvaluateSettings) -> list[str]:
    names = [name.strip() for name in settings.root.split(",") if name.strip()]
    return [RootKind(name).prior if name in [*RootKind] else name for name in names]


def _protocol(settings: EvaluateSettings) -> Protocol:
    """Raises `BadInput` on bad limits, pose dictionaries, error laws or numbers."""
    prior, estimation, poses = settings.prior, settings.estimation, settings.estimation.poses
    likelihood, roots = estimation.likelihood(), _roots(settings)
    if likelihood.faults.any and set(roots) != {UNCERTAIN}:
        raise BadInput(
            "--errors has outliers or exchanges, which need torso and camera to be uncertain;"
            " choose --root uncertain alone, or an error law without them"
        )
    return Protocol(
        anatomy=prior.anatomy(),
        dictionary=PoseDictionary.default() if poses == "default" else PoseDictionary.load(poses),
        upper=str(prior.upper),
        lower=str(prior.lower),
        candidates=estimation.candidates,
        likelihood=likelihood,
        num_samples=settings.sampling.num_samples,
        ks=tuple(_listed(settings.k, int, "--k")),
        max_proposals=settings.sampling.max_proposals,
        seed=settings.sampling.seed,
        num_roots=settings.roots,
        upright=concentration(settings.upright),
        composed=settings.composed,
    )


def findings(
    results: Results,
    data: DataSet,
    base: Condition,
    protocol: Protocol,
    external: Mapping[str, Predictions],
    bias: Bias | None,
    caption: str,
) -> Findings:
    """Tables and pictures from what came out of every frame."""
    labels, ks, few = Labels(data.action, data.recording), protocol.ks, min(protocol.ks)
    related = relations(results, data.recording, ks, base)
    scored = scores_of(
        results, base, data.recording, {name: one.samples for name, one in external.items()}
    )
    errors = {name: one.errors for name, one in external.items()}
    sheets = [
        table_1(results, base, labels, ks, errors, caption),
        table_2(results, base, labels, few, caption),
        relations_table(related),
        best_table(scored),
        calibration_table(scored),
        sharpness_table(scored),
        measure_scores_table({name: one.measures for name, one in scored.items()}),
        metrics_table(results, base, ks),
        frames_table(results),
    ]
    curves = pck_curves(results, base, few)
    sheets.append(pck_table(curves))
    figures = {
        "errors": errors_figure(results, base, labels, ks),
        "pck": pck_figure(curves),
    }
    if bias is not None:
        sheets += [actions_table(bias), visits_table(bias)]
        figures["bias"] = bias_figure(bias)
    return Findings(sheets, figures, related)


def write(found: Findings, out: Path) -> None:
    """Writes evaluation.md, a .csv for every table, a .png for every picture. Raises `BadInput`
    where it cannot."""
    for sheet in found.sheets:
        console.write_text(out / f"{sheet.name}.csv", sheet.csv())
    for name, figure in found.figures.items():
        save_figure(figure, out / f"{name}.png")
    pictures = "\n".join(f"![{name}]({name}.png)\n" for name in found.figures)
    shown = [sheet.markdown(titled=True) + "\n" for sheet in found.sheets if sheet.name != "pck"]
    console.write_text(out / "evaluation.md", "\n".join(["# Evaluation\n", pictures, *shown]))


def described(settings: EvaluateSettings, data: DataSet, protocol: Protocol) -> str:
    """What the numbers are of, in words for a caption."""
    if brings_detections(settings.dataset):
        given = "the 2D joints that it brings"
    else:
        given = (
            "true 2D joints"
            if settings.noise == "none"
            else f"2D joints with noise {settings.noise} of body height"
        )
    seen = ", focal lengths known" if settings.perspective else ""
    belief = f", backs tilted by some {settings.upright:g}°" if settings.upright else ""
    chosen = ", hypotheses composed of limbs" if protocol.composed else ""
    return (
        f"{data.name}: {len(data):,} frames of {len(data.actions)} actions, {given}{seen};"
        f" {protocol.num_samples:,} draws a frame, {protocol.candidates} torso-and-camera"
        f" candidate(s){belief}{chosen}. Errors after limb scaling and similarity alignment, ± half"
        " a 95 % interval over recordings. The paper's are of another data set, Human3.6M."
    )


def throughput(frames: int, seconds: float, workers: int | None) -> str:
    """How fast it went, and what more would take at that rate."""
    rate = frames / max(seconds, 1e-9)
    who = "the cluster" if workers is None else f"{workers} worker{'s' if workers > 1 else ''}"
    costs = ", ".join(
        f"{number:,} in {duration(number / rate)}" for number in (PAPERS_FRAMES, MANY_FRAMES)
    )
    return (
        f"{frames:,} frames under their conditions in {duration(seconds)}: {rate:.1f} a second with"
        f" {who}; {costs}"
    )


def _listed[T](text: str, kind: Callable[[str], T], option: str) -> list[T]:
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(
            f"{option} must be numbers with commas between them, such as 0,1,2, not {text!r}"
        ) from None


def _json(found: Findings, out: Path) -> dict:
    tables = {sheet.name: sheet.json() for sheet in found.sheets if sheet.name != "pck"}
    return {"out": str(out), "tables": tables}
