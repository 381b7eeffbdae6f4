"""Samplers on the frozen targets, held to equal processor time and equal evaluations: writes
reports/leaderboard.md and its pictures.

    python -m poseterior.reports.pages.leaderboard --work build/leaderboard --seconds 10

Every line is kept in the folder `--work`, and what is there is not run again; the page is made of
the lines that are there. `--samplers`, `--targets` and `--budgets` run some only. Then the judge is
asked about `--sets` sets of exact draws of each of the targets `--alarms`."""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from poseterior.inference.baselines.catalogue import BASELINES
from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark import exact_points, load, targets, verdict
from poseterior.inference.benchmark.entrants import (
    EXACT_ENGINE,
    GIFT,
    entrant,
    entrants,
)
from poseterior.inference.benchmark.external.entries import SamplerRun
from poseterior.inference.benchmark.references import sample_at
from poseterior.inference.benchmark.root import GivenRoot
from poseterior.inference.benchmark.submission import Submission
from poseterior.inference.benchmark.target import FrozenTarget
from poseterior.inference.benchmark.verdicts import Assessment, exact_sample
from poseterior.inference.studies.comparison.cost import course
from poseterior.inference.studies.comparison.sample import Sample
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.files import replacing
from poseterior.reports.figures.leaderboard import growth, standings
from poseterior.reports.pages.page import Page, Values, run
from poseterior.reports.tables.benchmark import verdict_record
from poseterior.reports.tables.leaderboard import (
    EVALUATIONS,
    SECONDS,
    Line,
    alarms,
    board,
    finite,
    ranking,
    ratios,
    read_alarms,
    sorted_lines,
)
from poseterior.reports.tables.sheet import NOTHING

TARGETS = (
    *("single", "arm", "arms", "legs", "four-missing", "one-missing", "settled"),
    *("foreshortened", "low-scores", "flips", "tiny", "whole", "cruel", "scene"),
    *("arm-soft", "whole-soft"),
)
"""All with hard walls, and two with soft ones."""
EVERYONE = (
    *(EXACT_ENGINE, "emcee", "emcee-de", "aies", "random-walk", "sa", "smc", "nss"),
    *("dynesty", "ultranest", "reddemcee", "nrpt"),
)
"""Who is run where nothing else is said."""
DEEP = ("arm", "legs", "whole", "cruel")
"""Targets on which chains also start in exact draws, and on which evaluations are made equal
too."""
FINE = tuple(2.0**-power for power in range(10, -1, -1))
"""Parts of a run at which its distance is measured."""
SETS, SET = 200, 500
"""Sets of exact draws that are judged at most, and draws of each."""
FEW_SETS, SMALL_SET = 60, 160
"""The same where the root is uncertain, and draws are dear."""
LEADERBOARD_WORK = Path("build") / "leaderboard"


def measured(target: FrozenTarget, exact: Sample, outcome: SamplerRun) -> dict[str, Any]:
    """What is found of draws."""
    submission = outcome.submission
    found = verdict(target, submission, exact)
    record = verdict_record(found)
    del record["tests"]
    effective = record["effective_draws"] or 0.0
    return record | {
        "earned": max(0.0, effective - outcome.given),
        "evaluations": finite(submission.evaluations),
        "seconds": submission.seconds,
        "rhat_worst": _worst_rhat(found),
        "to_distance": _time_to_distance(target, exact, outcome),
    }


def _worst_rhat(found: Assessment) -> float | None:
    rhat = found.judgement.mixing.rhat
    return float(np.nanmax(rhat)) if np.isfinite(rhat).any() else None


def _time_to_distance(target: FrozenTarget, exact: Sample, outcome: SamplerRun) -> float | None:
    """Seconds of the processor until the draws are within a distance of the exact ones. An ensemble
    is one chain, walker after walker: for its course its walkers are set apart."""
    points = outcome.submission.points
    if outcome.steps > 1:
        points = points.reshape(-1, outcome.steps, target.dim)
    sample = sample_at(target, points)
    way = course(sample, exact, outcome.submission.seconds, outcome.kept, FINE)
    return finite(way.seconds_to())


def line(
    target: FrozenTarget, exact: Sample, name: str, start: str, allowance: Allowance
) -> dict[str, Any]:
    """One sampler on one target: what was found, and what it cost."""
    about: dict[str, Any] = {"target": target.name, "sampler": name, "start": start}
    if why := entrant(name).cannot(target):
        return about | {"verdict": f"not run: {why}"}
    found = entrant(name).run(target, start, allowance)
    if found is None:
        return about | {"verdict": "no draws"}
    return about | measured(target, exact, found)


def measure(
    names: Sequence[str], chosen: Iterable[str], budgets: Mapping[str, Allowance], work: Path
) -> None:
    """Runs every line that is not yet in the folder."""
    for one in chosen:
        target = load(one)
        exact = exact_sample(load(one))
        for budget, name, start in _runs(one, names, budgets):
            label = f"{one} {budget} {name} {start}".strip().replace(" ", "-")
            path = work / f"{label}.json"
            if path.exists():
                continue
            allowance = budgets[budget]
            about = {"budget": budget, "allowed": getattr(allowance, budget)}
            found = about | line(target, exact, name, start, allowance)
            with replacing(path) as partial:
                partial.write_text(json.dumps(found), encoding="utf-8")
            print(label, found["verdict"], flush=True)


def _runs(
    target: str, names: Sequence[str], budgets: Iterable[str]
) -> Iterable[tuple[str, str, str]]:
    """Budgets, samplers and starts on a target."""
    for budget in budgets:
        if budget == EVALUATIONS and target not in DEEP:
            continue
        for name in names:
            for start in entrant(name).starts:
                if start != GIFT or target in DEEP:
                    yield budget, name, start


def false_alarms(chosen: Iterable[str], most: int, work: Path) -> None:
    """Judges sets of exact draws, as many of every target as are not yet in the folder. They are of
    the first blocks, and the judge's of the last."""
    for one in chosen:
        path = work / f"exact-{one}.txt"
        target = load(one)
        cheap = isinstance(target.root, GivenRoot)
        sets = min(most, SETS if cheap else FEW_SETS)
        size = SET if cheap else SMALL_SET
        said = path.read_text(encoding="utf-8").split("\n")[1:] if path.exists() else []
        if len(said) >= sets:
            continue
        exact = exact_sample(target)
        points = exact_points(target, sets * size).reshape(sets, 1, size, -1)
        for each in points[len(said) :]:
            said.append(verdict(target, Submission(each, size), exact).judgement.verdict)
            with replacing(path) as partial:
                partial.write_text("\n".join([str(size), *said]), encoding="utf-8")
        print("exact", one, flush=True)


def lines_in(work: Path) -> list[Line]:
    """The lines in a folder."""
    return sorted_lines(
        json.loads(path.read_text(encoding="utf-8")) for path in sorted(work.glob("*.json"))
    )


def values(lines: list[Line], work: Path) -> Values:
    """What fills the page."""
    titles = {SECONDS: "equal processor time", EVALUATIONS: "equal evaluations"}
    boards = [
        f"<details><summary>{target}, {load(target).dim} dimensions: {words}</summary>\n\n"
        f"{sheet.markdown()}\n\n</details>"
        for target in targets()
        for budget, words in titles.items()
        if (sheet := board(_run(lines), target, budget)).records
    ]
    ran = {one["sampler"] for one in _run(lines)}
    left = [name for name in BASELINES if name not in ran]
    return {
        "ranking": ranking(_run(lines)),
        "samplers": str(len(ran)),
        "targets": f"{len({one['target'] for one in lines})} of the {len(targets())}",
        "ratios": ratios(_run(lines)),
        "alarms": alarms(read_alarms(work)),
        "boards": "\n\n".join(boards),
        "not_for": _reasons(lines),
        "not_run": ", ".join(left) or "none",
        "seconds": _allowed(lines, SECONDS),
        "evaluations": _allowed(lines, EVALUATIONS),
        "notes": "\n".join(notes(ran)),
    }


def notes(ran: Collection[str]) -> list[str]:
    """How those that ran are set up."""
    return [
        f"- *{name}*: {entrant(name).note}."
        for name in entrants()
        if name in ran and name != EXACT_ENGINE
    ]


def _run(lines: list[Line]) -> list[Line]:
    """Those of samplers that are for their target."""
    return [one for one in lines if not one["verdict"].startswith("not run")]


def _reasons(lines: list[Line]) -> str:
    """Which samplers are not for which targets, and why."""
    found: dict[str, set[str]] = {}
    for one in lines:
        if one["verdict"].startswith("not run"):
            words = f"{one['sampler']}: {one['verdict'].removeprefix('not run: ')}"
            found.setdefault(words, set()).add(one["target"])
    return "\n".join(f"- {words} ({', '.join(sorted(on))})." for words, on in found.items())


def _allowed(lines: list[Line], budget: str) -> str:
    found = sorted({one["allowed"] for one in lines if one["budget"] == budget})
    return " or ".join(f"{value:,.0f}" for value in found) or NOTHING


def main(
    work: Path = LEADERBOARD_WORK,
    seconds: float = 10.0,
    evaluations: int = 50_000,
    samplers: str = ",".join(EVERYONE),
    targets: str = ",".join(TARGETS),
    budgets: str = f"{SECONDS},{EVALUATIONS}",
    alarms: str = ",".join(TARGETS),
    sets: int = SETS,
) -> Page:
    """Runs what is missing, and fills the page from all that is there."""
    jax.config.update("jax_compilation_cache_dir", str(work / "compiled"))
    names, chosen, judged = map(_listed, (samplers, targets, alarms))
    for target in (*chosen, *judged):
        load(target)
    for name in names:
        entrant(name).require()
    given = {
        SECONDS: Allowance(seconds=seconds),
        EVALUATIONS: Allowance(evaluations=evaluations),
    }
    if unknown := set(_listed(budgets)) - set(given):
        raise BadInput(f"there is no budget {unknown.pop()!r}; choose from {', '.join(given)}")
    measure(names, chosen, {name: given[name] for name in _listed(budgets)}, work)
    false_alarms(judged, sets, work)
    lines = lines_in(work)
    pictures = {
        "leaderboard": standings(_run(lines)),
        "leaderboard_growth": growth(_run(lines)),
    }
    return Page("leaderboard", values(lines, work), pictures)


def _listed(words: str) -> list[str]:
    """What stands between commas."""
    return [one for one in words.split(",") if one]


if __name__ == "__main__":
    run(main)
