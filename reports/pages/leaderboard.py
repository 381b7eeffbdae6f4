"""Samplers on the frozen targets, held to equal evaluations and equal processor time: writes
reports/leaderboard.md and its picture.

    python -m reports.pages.leaderboard --work build/leaderboard --seconds 10

Every line is kept in the folder `--work`, and what is there is not run again; the page is made of
the lines that are there. `--samplers`, `--targets` and `--budgets` run some only.
"""

import argparse
import json
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from inference.baselines.catalogue import BASELINES
from inference.baselines.run import Allowance, check_packages
from inference.baselines.run import run as run_baseline
from inference.baselines.target import Target
from inference.benchmark import estimate, exact_points, frozen_model, load, verdict
from inference.benchmark.guests import GUESTS
from inference.benchmark.submission import Submission
from inference.benchmark.target import FrozenTarget
from inference.benchmark.verdicts import exact_sample
from inference.exact.mixture import draw_mixture
from inference.studies.comparison.judge import CANNOT_TELL, DIFFERS
from inference.studies.comparison.sample import Sample
from probmodel.files import replacing
from reports.figures.colours import PALETTE
from reports.figures.style import TEXT, TITLE, blank, tidy
from reports.figures.style import page as blank_page
from reports.pages.page import Values, in_doubles, write_page
from reports.tables import Column, Sheet
from reports.tables.benchmark import verdict_record
from reports.tables.sheet import NOTHING, number

EXACT, GIFT, PRIOR = "exact", "exact draws", "prior"
"""The engine, and the two starts: exact draws as a gift; draws of the prior, led downhill until
they are inside, at the sampler's expense."""
TARGETS = (
    *("single", "arm", "arm-soft", "arms", "legs", "four-missing", "settled"),
    *("whole", "whole-soft", "cruel"),
)
EVALUATIONS, SECONDS = "evaluations", "seconds"
"""What runs are made equal in."""
DRAWS = 10_000
"""Exact draws that are timed."""
STEP = 0.3
"""Of the walk downhill, in R^d."""
PATIENCE = 4000
"""Most steps of the walk downhill."""
SETS, SET = 200, 500
"""Sets of exact draws that are judged, and draws of each."""
COLUMNS = 5
"""Panels in a row."""
CLOCK = time.process_time
WORK = Path("build") / "leaderboard"
NEVER = {
    "eryn": "Eryn 1.2.6 calls `numpy.in1d`, which NumPy 2.5 no longer has; it stops at once",
    "pocomc": "pocoMC 1.2.6 brings PyTorch with CUDA, several GB; not tried",
    "ultranest": "UltraNest 4.6.3, JAXNS 3.0 and flowMC 0.6.5 install; not tried yet",
    "nrpt": "non-reversible parallel tempering is not in BlackJAX 1.7; not written yet",
}
"""Samplers that users may expect and that are not here, and why."""


def downhill(target: FrozenTarget, rng: np.random.Generator, wanted: int) -> tuple[np.ndarray, int]:
    """Starts `(n, d)` inside the support from twice as many draws of the prior, by steps that are
    taken where the misfit does not rise, until `wanted` are inside; and the evaluations that this
    cost."""
    points = target.prior_points(rng, 2 * wanted)
    misfit = target.misfit(points)
    spent = len(points)
    for _ in range(PATIENCE):
        outside = np.flatnonzero(misfit > 1)
        if len(points) - len(outside) >= wanted:
            break
        scale = STEP * 10 ** rng.uniform(-2, 0.5, (len(outside), 1))
        proposal = points[outside] + scale * rng.normal(size=(len(outside), target.dim))
        found = target.misfit(proposal)
        better = found <= misfit[outside]
        points[outside[better]], misfit[outside[better]] = proposal[better], found[better]
        spent += len(outside)
    return points[misfit <= 1][:wanted], spent


def exact_line(target: FrozenTarget) -> tuple[Submission, int]:
    """The engine's own draws, everything compiled before the clock runs."""
    posterior = estimate(target).posterior(frozen_model())
    draw_mixture(posterior, key=jax.random.key(1), num_samples=DRAWS)
    started = CLOCK()
    found = draw_mixture(posterior, key=jax.random.key(2), num_samples=DRAWS)
    seconds = CLOCK() - started
    part = found.parts[0]
    points = Target.of(posterior).points_of(part.poses)[None]
    evaluations = found.attributes["num_proposals"]
    return (
        Submission(points, DRAWS, part.log_evidence, part.log_evidence_se, evaluations, seconds),
        0,
    )


def baseline_line(
    target: FrozenTarget, name: str, start: str, allowance: Allowance
) -> tuple[Submission, int] | None:
    """The draws of one of our baselines, and how many exact draws it was given; None where it found
    no start, or has no draws."""
    baseline = BASELINES[name]
    density = Target.of(estimate(target).posterior(frozen_model()))
    starts, spent, started = None, 0, CLOCK()
    if baseline.starts and start == GIFT:
        starts = exact_points(target, baseline.starts)
    elif baseline.starts:
        starts, spent = downhill(target, np.random.default_rng(7), baseline.starts)
        if not len(starts):
            return None
    before = CLOCK() - started if start == PRIOR else 0.0
    left = Allowance(
        None if allowance.evaluations is None else max(0, allowance.evaluations - spent),
        None if allowance.seconds is None else max(0.0, allowance.seconds - before),
    )
    done = run_baseline(
        baseline,
        name,
        density,
        key=jax.random.key(5),
        starts=starts,
        num_samples=1 << 40,
        most=20_000,
        allowance=left,
        clock=CLOCK,
    )
    if not done.num_draws:
        return None
    chains, draws = done.poses.length.shape[:2]
    flat = jax.tree.map(lambda leaf: np.asarray(leaf).reshape(-1, *leaf.shape[2:]), done.poses)
    points = density.points_of(flat).reshape(chains, draws, target.dim)
    evidence = done.log_evidence, done.log_evidence_se
    cost = float(done.cost.num_proposals + spent), done.cost.wall_time + before
    given = baseline.starts if start == GIFT else 0
    return Submission(points, chains * draws, *evidence, *cost), given


def line(
    target: FrozenTarget, exact: Sample, name: str, start: str, allowance: Allowance
) -> dict[str, Any]:
    """One sampler on one target: what was found, and what it cost."""
    if name == EXACT:
        found: tuple[Submission, int] | None = exact_line(target)
    elif name in GUESTS:
        guest = GUESTS[name][0](target, 3, allowance)
        found = None if guest is None else (guest, 0)
    else:
        found = baseline_line(target, name, start, allowance)
    about: dict[str, Any] = {"target": target.name, "sampler": name, "start": start}
    if found is None:
        return about | {"verdict": "no draws"}
    submission, given = found
    record = verdict_record(verdict(target, submission, exact))
    record.pop("tests")
    effective = record["effective_draws"] or 0.0
    return (
        about
        | record
        | {
            "earned": max(0.0, effective - given),
            "evaluations": submission.evaluations,
            "seconds": submission.seconds,
        }
    )


def starts_of(name: str) -> tuple[str, ...]:
    """The starts that a sampler is run from."""
    return (PRIOR, GIFT) if name in BASELINES and BASELINES[name].starts else ("",)


def measure(
    names: Iterable[str], targets: Iterable[str], budgets: dict[str, Allowance], work: Path
) -> None:
    """Runs every line that is not yet in the folder."""
    work.mkdir(parents=True, exist_ok=True)
    names = list(names)
    for one in targets:
        target, exact = load(one), exact_sample(load(one))
        for budget, allowance in budgets.items():
            for name in names:
                for start in starts_of(name):
                    label = f"{one} {budget} {name} {start}".strip().replace(" ", "-")
                    path = work / f"{label}.json"
                    if path.exists():
                        continue
                    found = {"budget": budget, **line(target, exact, name, start, allowance)}
                    with replacing(path) as partial:
                        partial.write_text(json.dumps(found), encoding="utf-8")
                    print(label, found["verdict"], flush=True)


def false_alarms(targets: Iterable[str], work: Path) -> None:
    """Judges sets of exact draws, of every target that is not yet in the folder."""
    for one in targets:
        path = work / f"exact-{one}.txt"
        if path.exists():
            continue
        target, exact = load(one), exact_sample(load(one))
        points = exact_points(target, SETS * SET).reshape(SETS, 1, SET, -1)
        found = [verdict(target, Submission(each, SET), exact) for each in points]
        with replacing(path) as partial:
            partial.write_text("\n".join(each.judgement.verdict for each in found))
        print("exact", one, flush=True)


def alarms_in(work: Path) -> Sheet:
    """How often exact draws are said to differ."""
    records = []
    for one in TARGETS:
        path = work / f"exact-{one}.txt"
        if not path.exists():
            continue
        said = path.read_text(encoding="utf-8").split("\n")
        differ = said.count(DIFFERS)
        interval = stats.binomtest(differ, len(said)).proportion_ci(0.95)
        records.append(
            {
                "target": one,
                "differ": f"{differ} of {len(said)}",
                "rate": f"{differ / len(said):.1%} ({interval.low:.1%}–{interval.high:.1%})",
                "cannot tell": said.count(CANNOT_TELL),
            }
        )
    columns = (
        Column("target", left=True),
        Column("said to differ", "differ"),
        Column("rate, 95 % interval", "rate"),
        Column("cannot tell"),
    )
    return Sheet(columns, records)


def lines_in(work: Path) -> list[dict[str, Any]]:
    """The lines in a folder, by target, budget and what they earned a second."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(work.glob("*.json"))]
    order = {name: row for row, name in enumerate(TARGETS)}
    return sorted(found, key=lambda one: (order[one["target"]], one["budget"], -_pace(one)))


def _pace(one: dict[str, Any]) -> float:
    return one["earned"] / one["seconds"] if "earned" in one else -1.0


def board(lines: list[dict[str, Any]], target: str, budget: str) -> Sheet:
    """The table of a target, of runs that are equal in one thing."""
    chosen = [one for one in lines if (one["target"], one["budget"]) == (target, budget)]
    columns = (
        Column("sampler", left=True),
        Column("start", lambda one: one["start"] or NOTHING, left=True),
        Column("verdict", left=True),
        Column("effective draws", lambda one: one.get("effective_draws"), _count),
        Column("earned/s", _earned("seconds"), _rate),
        Column("earned/1,000 evaluations", _earned("evaluations", 1000), _rate),
        Column("evaluations", lambda one: one.get("evaluations"), _count),
        Column("CPU s", lambda one: one.get("seconds"), _rate),
        Column("missed mass", lambda one: one.get("missed_mass"), _share),
        Column("worst W1", lambda one: one.get("worst_w1"), _sd),
        Column("evidence off", lambda one: one.get("evidence_error"), _nats),
    )
    return Sheet(columns, chosen)


def _earned(cost: str, unit: float = 1.0) -> Any:
    return lambda one: unit * one["earned"] / one[cost] if "earned" in one else None


def _count(value: float | None) -> str:
    return NOTHING if value is None else f"{value:,.0f}"


def _rate(value: float | None) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def _share(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1%}"


def _sd(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.2f} sd"


def _nats(value: float | None) -> str:
    return NOTHING if value is None else f"{value:+.2f} nats"


def ratios(lines: list[dict[str, Any]]) -> Sheet:
    """By target: the exact row against the best of those that were given nothing."""
    return Sheet(
        (
            Column("target", left=True),
            Column("dim"),
            Column("exact, earned/s", "exact", _rate),
            Column("best other that agrees, from the prior", _best, left=True),
            Column("ratio", form=_count),
        ),
        contests(lines),
    )


def _best(one: Mapping[str, Any]) -> str:
    return NOTHING if one["best"] is None else f"{one['best']}: {_rate(one['pace'])}"


def contests(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """By target: what exact draws and the best other earn a second, and their ratio; None where no
    other agrees."""
    records = []
    for target in TARGETS:
        own = [one for one in lines if one["target"] == target and one["budget"] == SECONDS]
        exact = next((one for one in own if one["sampler"] == EXACT), None)
        others = [one for one in own if one["sampler"] != EXACT and one["start"] != GIFT]
        right = [one for one in others if one["verdict"] == "agrees" and one["earned"] > 0]
        if exact is None:
            continue
        best = max(right, key=_pace, default=None)
        records.append(
            {
                "target": target,
                "dim": load(target).dim,
                "exact": _pace(exact),
                "best": None if best is None else best["sampler"],
                "pace": None if best is None else _pace(best),
                "ratio": None if best is None else number(_pace(exact) / _pace(best)),
            }
        )
    return records


def name_points(axes: Axes, named: list[tuple[float, float, str]]) -> None:
    """Writes names beside points `(x, y, name)`, from below upwards, each above the last one where
    the two would overprint each other."""
    if not named:
        return
    logs = np.log10([one[1] for one in named])
    room = 0.06 * max(np.ptp(logs), 0.3)
    before, lift = -np.inf, 0.0
    for row in np.argsort(logs, kind="stable"):
        x, y, words = named[row]
        lift = lift + 6 if logs[row] - before < room else 0.0
        before = logs[row]
        axes.annotate(words, (x, y), xytext=(5, lift - 2), textcoords="offset points", fontsize=6)


def growth(lines: list[dict[str, Any]]) -> Figure:
    """What exact draws and the best other earn a second, against the dimension."""
    figure = blank_page(6.4, 3.4)
    axes, named = figure.subplots(), []
    for one in contests(lines):
        soft = one["target"].endswith("-soft")
        fill = "none" if soft else "full"
        axes.plot(one["dim"], one["exact"], "o", color=PALETTE[0], ms=5, fillstyle=fill)
        named.append((one["dim"], one["exact"], f"exact, {one['target']}"))
        if one["best"] is not None:
            axes.plot(one["dim"], one["pace"], "s", color=PALETTE[1], ms=5, fillstyle=fill)
            named.append((one["dim"], one["pace"], f"{one['best']}, {one['target']}"))
    name_points(axes, named)
    axes.set(yscale="log", xlabel="dimensions", ylabel="effective draws earned a CPU second")
    axes.margins(x=0.15, y=0.1)
    tidy(axes)
    return figure


def picture(lines: list[dict[str, Any]]) -> Figure:
    """A panel a target: how far the worst coordinate is off against what a second earns; names
    stand beside the points."""
    shown = [target for target in TARGETS if any(one["target"] == target for one in lines)]
    rows = -(-len(shown) // COLUMNS)
    figure = blank_page(2.7 * min(len(shown), COLUMNS), 2.8 * rows)
    panels = figure.subplots(rows, min(len(shown), COLUMNS), squeeze=False).ravel()
    for axes in panels[len(shown) :]:
        blank(axes)
    for axes, target in zip(panels, shown, strict=False):
        named = []
        for one in lines:
            if (one["target"], one["budget"]) != (target, SECONDS) or "earned" not in one:
                continue
            place = max(_pace(one), 0.1), one["worst_w1"]
            colour = PALETTE[2] if one["verdict"] == "agrees" else PALETTE[1]
            axes.plot(
                *place,
                "o",
                color=colour,
                ms=4,
                fillstyle="none" if one["start"] == GIFT else "full",
            )
            label = one["sampler"] + (" (given)" if one["start"] == GIFT else "")
            named.append((*place, label))
        name_points(axes, named)
        axes.set(xscale="log", yscale="log")
        axes.set_title(f"{target}, {load(target).dim} dimensions", fontsize=TITLE)
    figure.supxlabel("effective draws earned a CPU second", fontsize=TEXT)
    figure.supylabel("W1 of the worst coordinate, standard deviations", fontsize=TEXT)
    for axes in panels:
        axes.margins(x=0.25, y=0.1)
        tidy(axes)
    return figure


def values(lines: list[dict[str, Any]], work: Path) -> Values:
    """What fills the page."""
    boards = [
        f"### {target}, {load(target).dim} dimensions: equal {words}\n\n{sheet.markdown()}"
        for target in TARGETS
        for budget, words in ((SECONDS, "processor time"), (EVALUATIONS, "evaluations"))
        if (sheet := board(lines, target, budget)).records
    ]
    ran = {one["sampler"] for one in lines}
    left = [name for name in BASELINES if name not in ran]
    spent = [one["seconds"] for one in lines if one["budget"] == SECONDS and "seconds" in one]
    return {
        "ratios": ratios(lines),
        "alarms": alarms_in(work),
        "boards": "\n\n".join(boards),
        "absent": "\n".join(f"- {words}." for words in NEVER.values()),
        "not_run": ", ".join(left) or "none",
        "seconds": f"{np.median(spent):.0f}" if spent else NOTHING,
        "evaluations": _count(_median_evaluations(lines)),
    }


def _median_evaluations(lines: list[dict[str, Any]]) -> float | None:
    found = [
        one["evaluations"] for one in lines if one["budget"] == EVALUATIONS and "evaluations" in one
    ]
    return float(np.median(found)) if found else None


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--work", type=Path, default=WORK)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--evaluations", type=int, default=50_000)
    everyone = [EXACT, "emcee", "emcee-de", "aies", "random-walk", "sa", "smc", "nss", *GUESTS]
    parser.add_argument("--samplers", default=",".join(everyone))
    parser.add_argument("--targets", default=",".join(TARGETS))
    parser.add_argument("--budgets", default=f"{SECONDS},{EVALUATIONS}")
    options = parser.parse_args()
    chosen = options.targets.split(",")
    if unknown := [name for name in chosen if name not in TARGETS]:
        parser.error(f"there is no row for {unknown[0]}; choose among {', '.join(TARGETS)}")
    in_doubles()
    options.work.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(options.work / "compiled"))
    names = [name for name in options.samplers.split(",") if name]
    for name in names:
        if name in BASELINES:
            check_packages(name, BASELINES[name])
    budgets = {
        SECONDS: Allowance(seconds=options.seconds),
        EVALUATIONS: Allowance(evaluations=options.evaluations),
    }
    budgets = {name: budgets[name] for name in options.budgets.split(",")}
    measure(names, chosen, budgets, options.work)
    false_alarms(chosen, options.work)
    lines = lines_in(options.work)
    pictures = {"leaderboard": picture(lines), "leaderboard_growth": growth(lines)}
    write_page("leaderboard", values(lines, options.work), pictures)


if __name__ == "__main__":
    main()
