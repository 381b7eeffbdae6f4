"""The contest of reports/samplers.md: every baseline on every frame of the suite, from each start.

    python -m poseterior.reports.pages.contests --seconds 60 --work build/samplers

Every line is kept in the folder `--work`, with its run; called again with more seconds, the runs go
on. `--frames 1,2` and `--samplers` run some only, so that several processes can share the work. The
page is then made by `reports.pages.samplers`.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import jax
import typer
import xarray as xr

from poseterior.inference.baselines.catalogue import BASELINES
from poseterior.inference.baselines.run import Allowance
from poseterior.inference.baselines.target import Target
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.results import save_tree
from poseterior.inference.studies.comparison import comparison_tree, contest
from poseterior.inference.studies.comparison.record import Entry
from poseterior.inference.studies.scenes import (
    ALL_BUT_AN_ARM,
    foreshortened,
    low_scores,
    prior_scene,
)
from poseterior.probmodel import Estimate, PoseModel
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.pages.page import run

CHECK = "one arm seen"
"""Six dimensions, for every sampler to show that it is right; not of the suite."""
EXACT_DRAWS = 20_000
CLOCKED = (10_000, 100_000)
"""Draws of exact rejection that are timed, set-up included."""
CLOCK = time.process_time
"""Other work on the machine does not count."""
LONGER = {"nuts": 15, "hmc": 15, "ess": 4, "smc": 8, "nss": 32, "nautilus": 12}
"""Times as long as the others these may take: they have nothing before a long warm-up, or before
they have come from the prior to the posterior."""
CONTEST_WORK = Path("build") / "samplers"

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
    CHECK: lambda model: prior_scene(model, 1, missing=ALL_BUT_AN_ARM),
}
"""Frames of rising difficulty, and the check; the head is missing too but where it is said to be
seen."""


def clock(model: PoseModel, frame: Estimate, number: int) -> list[float]:
    """Processor seconds of exact rejection for each of `CLOCKED`, everything compiled, short of
    naming the draws."""
    found = []
    for draws in CLOCKED:
        started = CLOCK()
        ExactRejection().draw(frame.posterior(model, CANDIDATES), jax.random.key(number), draws)
        found.append(CLOCK() - started)
    return found


def compare(
    model: PoseModel,
    number: int,
    names: Sequence[str],
    seconds: float,
    folder: Path,
) -> None:
    """Runs the contest on one frame and writes a comparison of every line, unless there is one of
    as many seconds.

    Parameters
    ----------
    model
        The model.
    number
        Of the frame in `SUITE`; every random number comes from it.
    names
        The baselines.
    seconds
        For each, from each start, but for those with `LONGER`.
    folder
        Where lines and runs are kept.
    """
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    frame = list(SUITE.values())[number](model)
    known = contest.truth(model, frame, key=jax.random.key(1000 + number), number=EXACT_DRAWS)
    attributes: dict[str, object] = {
        "dim": Target.of(known.frame.posterior(model, CANDIDATES)).dim,
        "exact_log_evidence": known.evidence[0],
        "exact_log_evidence_se": known.evidence[1],
    }

    def keep(entry: Entry, path: Path, allowed: float) -> None:
        times = zip(CLOCKED, clock(model, known.frame, 4000 + number), strict=True)
        beside = {f"exact_seconds_{draws}": value for draws, value in times}
        about = attributes | beside | {"allowed": allowed}
        save_tree(comparison_tree([entry], known.sample, about), path)
        print(f"  {entry.label}: {entry.verdict}, {entry.sentence}", flush=True)

    if not (path := folder / "rejection.nc").exists():
        key = jax.random.key(2000 + number)
        entry = contest.enter_exact(
            model, known, "rejection", key=key, num_samples=CLOCKED[0], clock=CLOCK
        )
        keep(entry, path, 0.0)
    for name, start in [(one, start) for one in names for start in contest.starts_of(one)]:
        label = f"{name}-{start.replace(' ', '-')}".removesuffix("-")
        allowed = seconds * LONGER.get(name, 1)
        path = folder / f"{label}.nc"
        if path.exists() and xr.open_datatree(path).attrs["allowed"] >= allowed:
            continue
        entry, _ = contest.enter_baseline(
            model,
            known,
            name,
            start,
            key=jax.random.key(3000 + 100 * number + list(BASELINES).index(name)),
            allowance=Allowance(seconds=allowed),
            num_samples=contest.ENDLESS,
            save_to=folder / "runs" / f"{label}.npz",
            clock=CLOCK,
        )
        keep(entry, path, allowed)


def main(
    seconds: Annotated[float, typer.Option(help="For each baseline, from each start.")] = 60.0,
    samplers: str = ",".join(BASELINES),
    frames: str = ",".join(map(str, range(len(SUITE)))),
    work: Path = CONTEST_WORK,
) -> None:
    """Runs the contest on these frames, by their numbers."""
    jax.config.update("jax_compilation_cache_dir", str(work / "compiled"))
    model = PoseModel()
    for number, name in enumerate(SUITE):
        if str(number) in frames.split(","):
            print(name, flush=True)
            compare(model, number, samplers.split(","), seconds, work / str(number))


if __name__ == "__main__":
    run(main)
