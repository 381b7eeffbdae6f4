"""`poseterior evaluate`: the paper's tables, curves and relations on any data set, on one machine
or many."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from inference.machines import Machines
from inference.roots.external import read_poses
from inference.studies.errors import mean_joint_error
from inference.studies.evaluation.bias import LEAST_POSES, Bias, bias_study
from inference.studies.evaluation.conditions import Condition, conditions
from inference.studies.evaluation.outcome import Protocol
from inference.studies.evaluation.relations import Relation, relations
from inference.studies.evaluation.run import Results, evaluate
from probmodel.datasets import DataSet, Noise, brings_detections, read_data_set
from probmodel.detections import LIKELIHOOD_JOINTS, LIMB_JOINTS
from probmodel.failures import BadInput
from probmodel.learning.dictionaries import PoseDictionary
from reports import console, evaluation_figures, evaluation_tables
from reports.evaluation_tables import Labels, Sheet
from reports.figures import save_figure
from reports.options import Belief

PAPERS_FRAMES, MANY_FRAMES = 26_385, 1_000_000


class Source(NamedTuple):
    """Which frames of which data set, and what is done to their 2D joints."""

    path: Path
    frames: int | None
    noise: str
    detections: str

    def read(self, seed: int) -> DataSet:
        """The data set. Raises `BadInput` as `read_data_set` does."""
        return read_data_set(
            self.path,
            frames=self.frames,
            noise=Noise.parse(self.noise),
            seed=seed,
            detections=self.detections,
        )

    def whole(self, seed: int) -> DataSet:
        """All its frames, in the proportions in which they were recorded."""
        return read_data_set(self.path, seed=seed, detections=self.detections)


class Request(NamedTuple):
    """What is evaluated, how, by whom, and where it goes."""

    out: Path
    estimators: str
    missing: str
    rotate: str
    ks: str
    num_samples: int
    candidates: int
    factor: float
    head: bool
    poses: str
    max_proposals: int
    predictions: Sequence[Path]
    bias: bool
    workers: int
    scheduler: str | None
    seed: int

    def conditions(self) -> list[Condition]:
        """Raises `BadInput` where a list holds what it must not."""
        names = [name.strip() for name in self.estimators.split(",") if name.strip()]
        return conditions(
            names, _listed(self.missing, int, "--missing"), _listed(self.rotate, float, "--rotate")
        )

    def protocol(self, belief: Belief) -> Protocol:
        """Raises `BadInput` on bad limits, pose dictionaries or numbers."""
        dictionary = (
            PoseDictionary.default() if self.poses == "default" else PoseDictionary.load(self.poses)
        )
        joints = LIKELIHOOD_JOINTS if self.head else LIMB_JOINTS
        return Protocol(
            belief.anatomy(),
            dictionary,
            str(belief.upper),
            str(belief.lower),
            self.candidates,
            self.factor,
            joints,
            self.num_samples,
            tuple(_listed(self.ks, int, "--k")),
            self.max_proposals,
            self.seed,
        )


class Findings(NamedTuple):
    """All that an evaluation says: tables and pictures, and the relations among them."""

    sheets: list[Sheet]
    figures: dict[str, Figure]
    relations: list[Relation]


def run(source: Source, belief: Belief, request: Request, *, quiet: bool, as_json: bool) -> None:
    """Evaluates, and writes tables (.md, .csv), pictures (.png) and the folder `frames`. What is
    there of the same run is kept; raises `BadInput` on bad input, and where the folder holds
    another run."""
    wanted, protocol = request.conditions(), request.protocol(belief)
    with console.progress("reading", quiet):
        data = source.read(request.seed)
        external = {path.stem: external_errors(path, data) for path in request.predictions}
    out = console.output_folder(request.out)
    started, begun = time.monotonic(), -1
    with console.progress("frames", quiet) as step:

        def report(done: int, all_of_them: int) -> None:
            nonlocal begun
            begun = done if begun < 0 else begun
            step(done, all_of_them)

        results = evaluate(
            data,
            wanted,
            protocol,
            out,
            machines=Machines(request.workers, request.scheduler),
            progress=report,
        )
    fresh, seconds = len(wanted) * len(data) - begun, time.monotonic() - started
    bias = None
    with console.progress("bias of motion capture, tables, pictures", quiet):
        if request.bias and len(data) >= LEAST_POSES:
            bias = bias_study(source.whole(request.seed), protocol.anatomy, seed=request.seed)
        found = findings(
            results, data, wanted[0], protocol, external, bias, described(source, data, protocol)
        )
        write(found, out)
    if as_json:
        console.show_json(_json(found, out))
        return
    for sheet in found.sheets:
        if sheet.name in ("table1", "table2", "relations"):
            console.OUT.print(sheet.narrow().screen())
    if fresh:
        console.say(
            throughput(fresh, seconds, request.workers if request.scheduler is None else None)
        )
    console.say(f"Written to {out}: evaluation.md, tables as .csv, pictures, frames")


def findings(
    results: Results,
    data: DataSet,
    base: Condition,
    protocol: Protocol,
    external: Mapping[str, np.ndarray],
    bias: Bias | None,
    caption: str,
) -> Findings:
    """Tables and pictures from what came out of every frame."""
    labels, ks, few = Labels(data.action, data.recording), protocol.ks, min(protocol.ks)
    related = relations(results, data.recording, ks, base)
    sheets = [
        evaluation_tables.table_1(results, base, labels, ks, external, caption),
        evaluation_tables.table_2(results, base, labels, few, caption),
        evaluation_tables.relations_table(related, evaluation_tables.RELATIONS_CAPTION),
        evaluation_tables.metrics_table(results, base, ks, evaluation_tables.METRICS_CAPTION),
        evaluation_tables.frames_table(results),
    ]
    curves = evaluation_figures.pck_curves(results, base, few)
    sheets.append(evaluation_tables.pck_table(curves))
    figures = {
        "errors": evaluation_figures.errors_figure(results, base, labels, ks),
        "pck": evaluation_figures.pck_figure(curves),
    }
    if bias is not None:
        sheets += evaluation_tables.bias_tables(bias)
        figures["bias"] = evaluation_figures.bias_figure(bias)
    return Findings(sheets, figures, related)


def write(found: Findings, out: Path) -> None:
    """Writes evaluation.md, a .csv for every table, a .png for every picture. Raises `BadInput`
    where it cannot."""
    for sheet in found.sheets:
        console.write_text(out / f"{sheet.name}.csv", sheet.csv())
    for name, figure in found.figures.items():
        save_figure(figure, out / f"{name}.png")
    pictures = "\n".join(f"![{name}]({name}.png)\n" for name in found.figures)
    shown = [sheet.markdown() for sheet in found.sheets if sheet.name != "pck"]
    console.write_text(out / "evaluation.md", "\n".join(["# Evaluation\n", pictures, *shown]))


def described(source: Source, data: DataSet, protocol: Protocol) -> str:
    """What the numbers are of, in words for a caption."""
    if brings_detections(source.path):
        given = "the 2D joints that it brings"
    else:
        given = (
            "true 2D joints"
            if source.noise == "none"
            else f"2D joints with noise {source.noise} of body height"
        )
    return (
        f"{data.name}: {len(data):,} frames of {len(data.actions)} actions, {given};"
        f" {protocol.num_samples:,} draws a frame, {protocol.candidates} torso-and-camera"
        " candidate(s). Errors after limb scaling and similarity alignment, ± half a 95 % interval"
        " over recordings. The paper's are of another data set, Human3.6M."
    )


def external_errors(path: Path, data: DataSet) -> np.ndarray:
    """`(N,)`: mean joint errors of the poses of a file (the best, where it has several for a
    frame). Raises `BadInput` where they are not those of the data set's frames."""
    poses = read_poses(path)
    if len(poses) != len(data):
        raise BadInput(
            f"{path} holds predictions for {len(poses)} frames, but {data.name} has {len(data)} of"
            " them"
        )
    try:
        return np.asarray(mean_joint_error(poses, data.poses[:, None])).min(axis=1)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


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


def duration(seconds: float) -> str:
    """In words that suit it."""
    for size, name in ((86_400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.1f} s"


def _listed[T](text: str, kind: Callable[[str], T], option: str) -> list[T]:
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(
            f"{option} must be numbers with commas between them, such as 0,1,2, not {text!r}"
        ) from None


def _json(found: Findings, out: Path) -> dict:
    tables = {
        sheet.name: [
            dict(zip(["name", *sheet.head[1:]], map(evaluation_tables.plain, row), strict=True))
            for row in sheet.rows
        ]
        for sheet in found.sheets
        if sheet.name != "pck"
    }
    return {"out": str(out), "tables": tables}
