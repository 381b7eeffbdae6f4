"""Several samplers on one frame, each judged by exact draws: of the pose under one candidate, or of
torso, camera and pose together.

found = compare(model, frame)
found.tree["summary"].to_dataframe()
"""

import contextlib
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax

from poseterior.inference.baselines.catalogue import BASELINES, DISPERSED, ROOTED
from poseterior.inference.baselines.rooted import RootedTarget
from poseterior.inference.baselines.run import Allowance, check_law, check_packages
from poseterior.inference.importance.weighted import NUM_ROOTS
from poseterior.inference.results import save_tree
from poseterior.inference.sampler import (
    REJECTION,
    ROOTED_SAMPLERS,
    SAMPLERS,
    WEIGHTED,
    sample,
    sampler_of,
)
from poseterior.inference.store import locked
from poseterior.inference.studies.comparison import contest
from poseterior.inference.studies.comparison.contest import ENDLESS, Comparison, Stage, Truth
from poseterior.inference.studies.comparison.record import Entry, comparison_tree
from poseterior.probmodel.failures import BadInput
from poseterior.probmodel.model import PoseModel
from poseterior.probmodel.posterior import Estimate, require_root_prior
from poseterior.probmodel.root_priors import CANDIDATES, UNCERTAIN

ROUTE_REFERENCE = 1000
"""Draws by rejection that the judge compares with: some minutes."""


def compare(
    model: PoseModel,
    frame: Estimate,
    samplers: Sequence[str] | None = None,
    *,
    root: str = UNCERTAIN,
    seed: int = 0,
    seconds: float | None = 30.0,
    max_evaluations: int | None = None,
    num_samples: int = 10_000,
    num_roots: int = NUM_ROOTS,
    exact_draws: int | None = None,
    out: Path | None = None,
    stage: Stage = contextlib.nullcontext,
) -> Comparison:
    """Lets samplers draw from a frame's posterior, and judges each by exact draws.

    Parameters
    ----------
    model
        The prior of poses.
    frame
        The detection with its candidates.
    samplers
        Names of `ROOTED_SAMPLERS`; under candidates, of `SAMPLERS` and of
        `benchmark.external_samplers()`. By default weighted roots, or exact rejection.
    root
        One of `ROOT_PRIORS`: torso, camera and pose together, or the pose under the candidate with
        the largest weight.
    seed
        Of all draws.
    seconds, max_evaluations
        What each baseline may spend from each of its starts; None: no limit. Where torso and camera
        are uncertain it has one, dispersed over the exact draws: of few draws with seven
        coordinates more, too few stand in one flip.
    num_samples
        Draws of a sampler that needs no start. Of weighted roots as many are judged as are
        independent.
    num_roots
        From how many roots weighted ones draw; of the pilot run of rejection.
    exact_draws
        Draws that all are judged by; by default as many as take some minutes at most. Where torso
        and camera are uncertain rejection makes them, a few dozen a second.
    out
        A folder: `comparison.nc` is written there after every sampler, and what baselines have done
        is kept in `runs`, where the next call takes it up.
    stage
        Called with what is done next, in words; what it returns is entered meanwhile.

    Returns
    -------
    Comparison
        A line for every sampler and start.

    Raises
    ------
    BadInput
        On a sampler that does not exist, does not draw under this root or the law of errors, or
        whose package is missing, before any work is done; where `runs` holds another run, or
        another process is writing to `out`.
    OutOfBudget
        Where the exact draws are not complete.
    """
    require_root_prior(root)
    default, check, contested = CONTESTS[root]
    names = default if samplers is None else samplers
    check(names)
    asked = _Asked(
        model,
        frame,
        names,
        key=jax.random.key(seed),
        allowance=Allowance(max_evaluations, seconds),
        num_samples=num_samples,
        num_roots=num_roots,
        exact_draws=exact_draws,
        out=out,
    )
    entries: list[Entry] = []
    with locked(out) if out else contextlib.nullcontext():
        with stage("exact draws"):
            known, about, starts, enter = contested(asked)
        attributes = {
            "source": frame.detection.source,
            "person": frame.detection.person,
            "seed": seed,
            "exact_draws": known.sample.num_draws,
            **about,
        }
        for name, start in [(one, start) for one in names for start in starts(one)]:
            with stage(f"{name} {start}" if len(starts(name)) > 1 else name):
                entries.append(enter(name, start))
            found = Comparison(entries, comparison_tree(entries, known.sample, attributes))
            if out:
                save_tree(found.tree, out / "comparison.nc")
    return found


class _Asked(NamedTuple):
    """What `compare` is asked for: `names` of samplers, the `key` of all draws, and the others as
    there."""

    model: PoseModel
    frame: Estimate
    names: Sequence[str]
    key: jax.Array
    allowance: Allowance
    num_samples: int
    num_roots: int
    exact_draws: int | None
    out: Path | None

    def exact(self, usual: int) -> int:
        """How many exact draws, where so many are usual."""
        return usual if self.exact_draws is None else self.exact_draws

    def spent(self, name: str, start: str) -> dict[str, Any]:
        """How a baseline is run, as `baselines.run.run` takes it."""
        place = contest.place_of(self.out, name, start)
        return {"allowance": self.allowance, "num_samples": ENDLESS, "save_to": place}


class _Contest(NamedTuple):
    """The exact draws, what the tree says of them, the starts of a sampler, and its line from one
    of these."""

    known: Truth
    about: dict[str, Any]
    starts: Callable[[str], tuple[str, ...]]
    enter: Callable[[str, str], Entry]


def _of_candidate(asked: _Asked) -> _Contest:
    """Samplers of the pose under the candidate with the largest weight, judged by exact draws."""
    model, frame, names, key, allowance, *_ = asked
    for name in {*names} & {*BASELINES}:
        check_law(name, BASELINES[name], frame.likelihood.law)
    number = asked.exact(contest.EXACT_REFERENCE)
    known = contest.truth(model, frame, key=jax.random.fold_in(key, 0), number=number)

    def enter(name: str, start: str) -> Entry:
        # Its own key, whoever else is asked, so that runs can be taken up.
        own = jax.random.fold_in(key, contest.number_of(name))
        if name in BASELINES:
            spent = asked.spent(name, start)
            return contest.enter_baseline(model, known, name, start, key=own, **spent)[0]
        if name in SAMPLERS:
            return contest.enter_exact(model, known, name, key=own, num_samples=asked.num_samples)
        return contest.enter_external(model, known, name, key=own, allowance=allowance)

    seconds = math.inf if allowance.seconds is None else allowance.seconds
    return _Contest(known, {"seconds": seconds}, contest.starts_of, enter)


def _of_roots(asked: _Asked) -> _Contest:
    """Samplers of torso, camera and pose together, judged by rejection, whose draws are
    independent."""
    model, frame, names, key, *_ = asked
    posterior = frame.posterior(model)
    # Before any work is done.
    target = RootedTarget.of(posterior) if {*names} & {*ROOTED} else None
    draw = functools.partial(sample, model, frame, root=UNCERTAIN, num_roots=asked.num_roots)
    number = asked.exact(ROUTE_REFERENCE)
    result = draw(key=jax.random.fold_in(key, 0), sampler=REJECTION, num_samples=number)
    known = contest.truth_of(frame, result)

    def enter(name: str, start: str) -> Entry:
        own = jax.random.fold_in(key, 1 + ROOTED_SAMPLERS.index(name))
        if target and name in ROOTED:
            given = posterior, target, known, name, start
            return contest.enter_chains(*given, key=own, **asked.spent(name, start))[0]
        found = draw(key=own, sampler=name, num_samples=asked.num_samples)
        cost = found.tree.attrs["num_proposals"], found.tree.attrs["wall_time_s"]
        return contest.enter_draws(known, name, found, cost, thinned=name == WEIGHTED)

    about = {"root": UNCERTAIN, "cut_off": known.tree.attrs["cut_off"]}
    return _Contest(known, about, lambda name: (DISPERSED,) if name in ROOTED else ("",), enter)


def check_routes(names: Sequence[str]) -> None:
    """Raises `BadInput` where there is no name, or one that holds the root fixed, or whose package
    is missing."""
    for name in names:
        sampler_of(UNCERTAIN, name)
        if name in ROOTED:
            check_packages(name, BASELINES[name])
    if not names:
        raise BadInput(f"there is no sampler; choose from {', '.join(ROOTED_SAMPLERS)}")


CONTESTS = {
    CANDIDATES: (("rejection",), contest.check_names, _of_candidate),
    UNCERTAIN: ((WEIGHTED,), check_routes, _of_roots),
}
"""By the kind of root: who draws where nobody is named, what refuses samplers before any work is
done, and what makes the contest."""
