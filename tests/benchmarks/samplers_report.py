"""Makes reports/samplers.md: baseline samplers on eight frames, each from two starts, judged by
exact draws.

    python -m tests.benchmarks.samplers_report --seconds 60 --work build/samplers

Every line is kept in the folder `--work`, with its run; called again with more seconds, the runs go
on. With `--render` nothing is run: the page is made of what is there. Exact rejection is timed anew
beside every line. `--frames 1,2` and `--samplers` run some only, so that several processes can
share the work."""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import xarray as xr

from inference.baselines.catalogue import BASELINES
from inference.baselines.run import Allowance
from inference.baselines.target import Target
from inference.exact.mixture import draw_mixture
from inference.results import save_tree
from inference.studies.comparison import comparison_tree, contest
from inference.studies.comparison.record import Entry
from probmodel import PoseModel
from probmodel.posterior import Estimate
from probmodel.skeleton import JOINT_INDEX, NUM_JOINTS
from reports import comparison_figures, comparison_tables
from tests.scenes import key, prior_scene

ROOT = Path(__file__).parents[2]
PICTURED = "all seen"
CHECK = "one arm seen"
"""Six dimensions, for every sampler to show that it is right; not of the suite."""
EXACT_DRAWS = 20_000
CLOCKED = (10_000, 100_000)
"""Draws of exact rejection that are timed, set-up included."""
CLOCK = time.process_time
"""Other work on the machine does not count."""
EVIDENCES = ("smc", "nss", "nautilus")
PATHLESS = ("nss", "nautilus")
"""Whose draws are no path, so that there is no pace at which they go on once they have settled."""
PATIENCE = {"nuts": 15, "hmc": 15, "ess": 4, "smc": 8, "nss": 32, "nautilus": 12}
"""Times as long as the others these may take: they have nothing before a long warm-up, or before
they have come from the prior to the posterior."""
UNSEEN = (
    "head",
    "left_elbow",
    "left_wrist",
    "right_knee",
    "left_knee",
    "right_ankle",
    "left_ankle",
)


def low_scores() -> np.ndarray:
    """Wrists and ankles hardly seen: their discs are the widest."""
    score = np.full(NUM_JOINTS, 0.8)
    score[
        [JOINT_INDEX[f"{side}_{end}"] for side in ("left", "right") for end in ("wrist", "ankle")]
    ] = 0.25
    return score


def foreshortened(model: PoseModel) -> Estimate:
    """Of forty scenes, the one whose seen limbs point most along the camera's axis."""

    def flatness(frame: Estimate) -> float:
        keypoints = frame.detection.keypoints
        upper = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]
        bones = [
            (f"{side}_{start}", f"{side}_{end}")
            for side in ("left", "right")
            for start, end in upper
        ]
        return float(
            sum(
                np.linalg.norm(keypoints[JOINT_INDEX[end]] - keypoints[JOINT_INDEX[start]])
                for start, end in bones
            )
        )

    return min((prior_scene(model, seed) for seed in range(100, 140)), key=flatness)


SUITE: dict[str, Callable[[PoseModel], Estimate]] = {
    "4 joints missing": lambda model: prior_scene(
        model, 2, missing=("head", "left_wrist", "right_elbow", "left_knee", "right_ankle")
    ),
    "3 joints missing": lambda model: prior_scene(
        model, 7, missing=("head", "left_elbow", "right_wrist", "left_ankle")
    ),
    "2 joints missing": lambda model: prior_scene(
        model, 3, missing=("head", "left_wrist", "right_ankle")
    ),
    "1 joint missing": lambda model: prior_scene(model, 4, missing=("head", "right_wrist")),
    "low scores": lambda model: prior_scene(model, 5, scores=low_scores()),
    "all seen": lambda model: prior_scene(model, 1),
    "all seen, head too": lambda model: prior_scene(model, 6, missing=()),
    "foreshortened limbs": foreshortened,
    CHECK: lambda model: prior_scene(model, 1, missing=UNSEEN),
}
"""Frames of rising difficulty, and the check; the head is missing too but where it is said to be
seen."""


def clock(model: PoseModel, frame: Estimate, number: int) -> list[float]:
    """Processor seconds of exact rejection for each of `CLOCKED`, everything compiled, short of
    naming the draws."""
    found = []
    for draws in CLOCKED:
        started = CLOCK()
        draw_mixture(model, frame, key(number), num_samples=draws)
        found.append(CLOCK() - started)
    return found


def compare(
    model: PoseModel, number: int, frame: Estimate, names: list[str], seconds: float, folder: Path
) -> None:
    """Runs the contest on one frame and writes a comparison of every line, unless there is one of
    as many seconds."""
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    known = contest.truth(model, frame, key=key(1000 + number), number=EXACT_DRAWS)
    attributes = {
        "dim": Target.of(model, known.frame).dim,
        "exact_log_evidence": known.evidence[0],
        "exact_log_evidence_se": known.evidence[1],
    }

    def keep(entry: Entry, path: Path, allowed: float) -> None:
        seconds = dict(zip(CLOCKED, clock(model, known.frame, 4000 + number), strict=True))
        beside = {f"exact_seconds_{draws}": value for draws, value in seconds.items()}
        save_tree(
            comparison_tree([entry], known.sample, attributes | beside | {"allowed": allowed}), path
        )
        print(f"  {entry.label}: {entry.verdict}, {entry.sentence}", flush=True)

    if not (path := folder / "rejection.nc").exists():
        own = key(2000 + number)
        keep(
            contest.enter_exact(
                model, known, "rejection", key=own, num_samples=CLOCKED[0], clock=CLOCK
            ),
            path,
            0.0,
        )
    for name, start in [(one, start) for one in names for start in contest.starts_of(one)]:
        label = f"{name}-{start.replace(' ', '-')}".removesuffix("-")
        allowed = seconds * PATIENCE.get(name, 1)
        if (path := folder / f"{label}.nc").exists() and xr.open_datatree(path).attrs[
            "allowed"
        ] >= allowed:
            continue
        entry, _ = contest.enter_baseline(
            model,
            known,
            name,
            start,
            key=key(3000 + 100 * number + list(BASELINES).index(name)),
            allowance=Allowance(seconds=allowed),
            num_samples=contest.ENDLESS,
            save_to=folder / "runs" / f"{label}.npz",
            clock=CLOCK,
        )
        keep(entry, path, allowed)


def joined(folder: Path) -> xr.DataTree | None:
    """The lines of one frame as one comparison; `exact_seconds` `(line, draws)` is how long exact
    rejection took beside each."""
    order = [
        "rejection",
        *(f"{name}{start}" for name in BASELINES for start in ("", "-dispersed", "-one-flip")),
    ]
    trees = [
        xr.open_datatree(folder / f"{label}.nc").load()
        for label in order
        if (folder / f"{label}.nc").exists()
    ]
    if len(trees) < 2:
        return None
    labels = [str(tree["summary"].sampler.item()) for tree in trees]
    groups = {}
    for name in trees[0].children:
        parts = [tree[name].to_dataset() for tree in trees if name in tree.children]
        groups[name] = xr.concat(
            parts, "sampler", data_vars="minimal", coords="minimal", compat="override", join="outer"
        )
        if name != "modes":
            groups[name] = groups[name].reindex(sampler=labels)
    found = xr.DataTree.from_dict(groups)
    seconds = np.array(
        [[tree.attrs[f"exact_seconds_{draws}"] for draws in CLOCKED] for tree in trees]
    )
    least = min(tree.attrs["allowed"] for tree in trees[1:])
    found.attrs.update(trees[0].attrs, exact_seconds=seconds, allowed_least=least)
    return found


def table(names: tuple[str, ...], lines: list[list[str]]) -> str:
    """Markdown."""
    rows = [list(names), ["---"] * len(names), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def exact_rates(tree: xr.DataTree) -> np.ndarray:
    """`(2,)`: exact draws a second for each of `CLOCKED`, median over the times beside the
    lines."""
    return np.array(CLOCKED) / np.median(tree.attrs["exact_seconds"], axis=0)


def summary(trees: dict[str, xr.DataTree]) -> str:
    """One line a frame: exact rejection against the best baseline, whichever start, by either
    measure."""
    names = (
        "frame",
        "d",
        "log evidence",
        "exact draws/s, of 10,000",
        "of 100,000",
        "best earned/s",
        "ratio",
        "best settled/s",
        "ratio",
        "exact: to 0.1 sd",
        "first baseline",
        "lines that differ",
    )
    return table(names, [_summary_line(name, tree) for name, tree in trees.items()])


def _summary_line(name: str, tree: xr.DataTree) -> list[str]:
    found = tree["summary"].to_dataset()
    exact, rest = found.isel(sampler=0), found.isel(sampler=slice(1, None))
    few, many = exact_rates(tree)
    quickest = float(np.min(rest.seconds_to_distance.values))
    judged = rest.verdict.values != "no draws"
    walks = rest.sel(sampler=~rest.sampler.isin(PATHLESS))
    return [
        name,
        str(tree.attrs["dim"]),
        f"{tree.attrs['exact_log_evidence']:.1f}",
        f"{few:,.0f}",
        f"{many:,.0f}",
        *_best(rest, "ess_per_second", many),
        *_best(walks, "settled_per_second", many),
        f"{float(exact.seconds_to_distance):.2g} s",
        "never" if np.isinf(quickest) else f"{quickest:.2g} s",
        f"{int(np.sum(rest.verdict.values == 'differs'))} of {int(judged.sum())}",
    ]


def _best(lines: xr.Dataset, measure: str, exact: float) -> tuple[str, str]:
    """The largest of a measure with the name of its line, and how many times as many exact draws
    there are a second."""
    best = lines.isel(sampler=int(np.argmax(lines[measure].values)))
    value = float(best[measure])
    if not value:
        return "none", "–"
    bound = measure == "settled_per_second" and not float(best.time_known)
    return (
        f"{'≤ ' * bound}{value:.3g} ({best.sampler.item()})",
        f"{'≥ ' * bound}{exact / value:,.0f}",
    )


def evidences(trees: dict[str, xr.DataTree]) -> str:
    """Evidence of those that know it, against the exact one; flagged beyond three standard errors
    of the difference."""
    lines = []
    for name, tree in trees.items():
        known, error = tree.attrs["exact_log_evidence"], tree.attrs["exact_log_evidence_se"]
        line = [name, f"{known:.2f} ± {error:.2f}"]
        summary = tree["summary"].to_dataset()
        for sampler in EVIDENCES:
            one = summary.sel(sampler=sampler) if sampler in summary.sampler.values else None
            value = np.nan if one is None else float(one.log_evidence)
            if np.isnan(value):
                line.append("–" if one is None else f"none in {float(one.seconds):.0f} s")
                continue
            own = float(one.log_evidence_se)
            off = (value - known) / np.hypot(own, error)
            line.append(
                f"{value:.2f} ± {own:.2f}"
                + (f", **off by {off:+.1f} errors**" if abs(off) > 3 else "")
            )
        lines.append(line)
    return table(("frame", "exact", *EVIDENCES), lines)


def absent(trees: dict[str, xr.DataTree]) -> str:
    """A sentence that says which samplers have not been run on which frames; empty where all
    have."""
    parts = []
    for name, tree in trees.items():
        ran = {str(label).split(" (")[0] for label in tree["summary"].sampler.values}
        if left := [sampler for sampler in BASELINES if sampler not in ran]:
            parts.append(f"on *{name}* {', '.join(left)}")
    return f"Not run yet: {'; '.join(parts)}." if parts else ""


def render(work: Path) -> None:
    """Writes the page and its picture from what is in the folder."""
    found = {name: joined(work / f"{number}") for number, name in enumerate(SUITE)}
    trees = {name: tree for name, tree in found.items() if tree is not None}
    suite = {name: tree for name, tree in trees.items() if name != CHECK}
    ran = {
        str(label).split(" (")[0]
        for tree in trees.values()
        for label in tree["summary"].sampler.values
    }
    values = {
        "SETUP": "\n".join(
            f"- **{name}**: {row.note}" for name, row in BASELINES.items() if name in ran
        ),
        "SUMMARY": summary(suite),
        "CHECK": comparison_tables.markdown(trees[CHECK]),
        "EVIDENCE": evidences(trees),
        "TABLES": "\n\n".join(
            f"### {name}\n\n{comparison_tables.markdown(tree)}" for name, tree in suite.items()
        ),
        "SECONDS": f"{min(tree.attrs['allowed_least'] for tree in trees.values()):g}",
        "ABSENT": absent(trees),
        "PATIENCE": ", ".join(f"{name} {times}" for name, times in PATIENCE.items()),
    }
    text = Path(__file__).with_suffix(".md").read_text(encoding="utf-8")
    for word, value in values.items():
        text = text.replace(word, value)
    (ROOT / "reports" / "samplers.md").write_text(text, encoding="utf-8")
    comparison_figures.save(trees[PICTURED], ROOT / "reports" / "samplers.png")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="for each baseline, from each start"
    )
    parser.add_argument("--samplers", default=",".join(BASELINES))
    parser.add_argument("--frames", default=",".join(str(number) for number in range(len(SUITE))))
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "samplers")
    parser.add_argument("--render", action="store_true", help="only make the page")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(options.work / "compiled"))
    if options.render:
        render(options.work)
    else:
        model = PoseModel()
        for number, (name, frame) in enumerate(SUITE.items()):
            if str(number) in options.frames.split(","):
                print(name, flush=True)
                names = options.samplers.split(",")
                compare(
                    model, number, frame(model), names, options.seconds, options.work / str(number)
                )


if __name__ == "__main__":
    main()
