"""Makes reports/samplers.md: baseline samplers on eight frames, each from two starts, judged by exact draws.

    python -m tests.benchmarks.samplers_report --seconds 60 --work build/samplers

Every frame's comparison is kept in the folder `--work`, with the runs; called again with more seconds, the runs go on.
With `--render` nothing is run: the page is made of what is there.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from inference.candidates import Frame
from inference.comparison import comparison_tree, contest
from inference.results import save_tree
from inference.samplers.baseline import Allowance
from inference.samplers.baselines import BASELINES
from inference.target import Target
from probmodel import PoseModel
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from reports import comparison_figures, comparison_tables
from tests.scenes import key, prior_scene

ROOT = Path(__file__).parents[2]
PICTURED = "all seen"
EXACT_DRAWS = 20_000
UNSEEN = ("head", "left_elbow", "left_wrist", "right_knee", "left_knee", "right_ankle", "left_ankle")


def low_scores() -> np.ndarray:
    """Wrists and ankles hardly seen: their discs are the widest."""
    score = np.full(NUM_JOINTS, 0.8)
    score[[JOINT_INDEX[f"{side}_{end}"] for side in ("left", "right") for end in ("wrist", "ankle")]] = 0.25
    return score


def foreshortened(model: PoseModel) -> Frame:
    """Of forty scenes, the one whose seen limbs point most along the camera's axis."""

    def flatness(frame: Frame) -> float:
        keypoints = frame.detection.keypoints
        upper = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]
        bones = [(f"{side}_{start}", f"{side}_{end}") for side in ("left", "right") for start, end in upper]
        return float(
            sum(np.linalg.norm(keypoints[JOINT_INDEX[end]] - keypoints[JOINT_INDEX[start]]) for start, end in bones)
        )

    return min((prior_scene(model, seed) for seed in range(100, 140)), key=flatness)


SUITE: dict[str, Callable[[PoseModel], Frame]] = {
    "one arm seen": lambda model: prior_scene(model, 1, missing=UNSEEN),
    "4 joints missing": lambda model: prior_scene(
        model, 2, missing=("head", "left_wrist", "right_elbow", "left_knee", "right_ankle")
    ),
    "2 joints missing": lambda model: prior_scene(model, 3, missing=("head", "left_wrist", "right_ankle")),
    "1 joint missing": lambda model: prior_scene(model, 4, missing=("head", "right_wrist")),
    "low scores": lambda model: prior_scene(model, 5, scores=low_scores()),
    "all seen": lambda model: prior_scene(model, 1),
    "all seen, head too": lambda model: prior_scene(model, 6, missing=()),
    "foreshortened limbs": foreshortened,
}
"""Frames of rising difficulty; the head is missing where nothing is said of it."""


def compare(model: PoseModel, number: int, frame: Frame, names: list[str], seconds: float, folder: Path) -> None:
    """Runs the contest on one frame and writes its comparison.nc."""
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    known = contest.truth(model, frame, key=key(1000 + number), number=EXACT_DRAWS)
    attributes = {"dim": Target.of(model, known.frame).dim, "exact_log_evidence": known.evidence[0],
                  "exact_log_evidence_se": known.evidence[1], "seconds": seconds}  # fmt: skip
    entries = [contest.enter_exact(model, known, "rejection", key=key(2000 + number), num_samples=10_000)]
    for index, name in enumerate(names):
        for start in contest.starts_of(name):
            save_to = folder / "runs" / f"{name}-{start.replace(' ', '-')}.npz"
            entry, _ = contest.enter_baseline(
                model, known, name, start, key=key(3000 + 100 * number + index), allowance=Allowance(seconds=seconds),
                num_samples=contest.ENDLESS, save_to=save_to,
            )  # fmt: skip
            entries.append(entry)
            print(f"  {entry.label}: {entry.verdict}, {entry.sentence}", flush=True)
            save_tree(comparison_tree(entries, known.sample, attributes), folder / "comparison.nc")


def summary(trees: dict[str, xr.DataTree]) -> str:
    """One line a frame: exact rejection against the best baseline, whichever start."""
    names = ("frame", "d", "log evidence", "exact: ESS/s", "best baseline: ESS/s", "ratio", "exact: to 0.1 sd",
             "first baseline: to 0.1 sd", "baselines that differ")  # fmt: skip
    lines = ["| " + " | ".join(names) + " |", "| --- " * len(names) + "|"]
    for name, tree in trees.items():
        found = tree["summary"].to_dataset()
        rest = found.isel(sampler=slice(1, None))
        exact = found.isel(sampler=0)
        best = rest.isel(sampler=int(np.argmax(rest.ess_per_second.values)))
        ratio = float(exact.ess_per_second) / float(best.ess_per_second) if best.ess_per_second > 0 else np.inf
        quickest = float(np.min(rest.seconds_to_distance.values))
        judged = rest.verdict.values != "no draws"
        lines.append(
            f"| {name} | {tree.attrs['dim']} | {tree.attrs['exact_log_evidence']:.1f} "
            f"| {float(exact.ess_per_second):,.0f} | {float(best.ess_per_second):.2g} ({best.sampler.item()}) "
            f"| {ratio:,.0f} | {float(exact.seconds_to_distance):.2g} s "
            f"| {'never' if np.isinf(quickest) else f'{quickest:.2g} s'} "
            f"| {int(np.sum(rest.verdict.values == 'differs'))} of {int(judged.sum())} |"
        )
    return "\n".join(lines)


def render(work: Path) -> None:
    """Writes the page and its picture from what is in the folder."""
    found = {name: work / f"{number}" / "comparison.nc" for number, name in enumerate(SUITE)}
    trees = {name: xr.open_datatree(path).load() for name, path in found.items() if path.exists()}
    ran = {str(label).split(" (")[0] for tree in trees.values() for label in tree["summary"].sampler.values}
    setup = "\n".join(f"- **{name}**: {row.note}" for name, row in BASELINES.items() if name in ran)
    tables = "\n\n".join(f"### {name}\n\n{comparison_tables.markdown(tree)}" for name, tree in trees.items())
    seconds = max(tree.attrs["seconds"] for tree in trees.values())
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    for word, value in (("SECONDS", f"{seconds:g}"), ("SETUP", setup), ("SUMMARY", summary(trees)), ("TABLES", tables)):
        text = text.replace(word, value)
    (ROOT / "reports" / "samplers.md").write_text(text, encoding="utf-8")
    comparison_figures.save(trees[PICTURED], ROOT / "reports" / "samplers.png")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="for each baseline, from each start")
    parser.add_argument("--samplers", default=",".join(BASELINES))
    parser.add_argument("--frames", default=",".join(str(number) for number in range(len(SUITE))))
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "samplers")
    parser.add_argument("--render", action="store_true", help="only make the page")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if not options.render:
        model = PoseModel()
        for number, (name, frame) in enumerate(SUITE.items()):
            if str(number) in options.frames.split(","):
                print(name, flush=True)
                names = options.samplers.split(",")
                compare(model, number, frame(model), names, options.seconds, options.work / str(number))
    render(options.work)


if __name__ == "__main__":
    main()
