"""External samplers: whoever declares an entry point is found, listed, run and judged by one name.

The package of these tests has two samplers: rejection from the prior, which is right, and the same
that leaves out half of the support. On a detection, whose exact draws are made anew, the draws that
are shipped for its target stand for those of rejection. Both draw with fixed seeds; the judge's
level is 1 %."""

import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from poseterior.inference import benchmark
from poseterior.inference.baselines.run import Allowance
from poseterior.inference.benchmark.entrants import entrant, entrants
from poseterior.inference.benchmark.external import entries
from poseterior.inference.benchmark.external.posterior import PosteriorTarget
from poseterior.inference.benchmark.programs import estimate, frozen_model
from poseterior.inference.studies.comparison import contest
from poseterior.inference.studies.comparison.judge import DIFFERS
from poseterior.probmodel import BadInput
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.reports.pages import leaderboard
from tests.scenes import key

OURS = ("dynesty", "ultranest", "reddemcee", "nrpt")
SAMPLERS = """
import numpy as np
from poseterior.inference.benchmark import (
    ExternalSampler, SamplerRun, Submission, shipped_points, submit
)
from poseterior.inference.benchmark.external.posterior import PosteriorTarget

PROPOSALS = 600_000


def accepted(target, seed):
    if isinstance(target, PosteriorTarget):  # the same law, and sooner
        return shipped_points("single")[:1500]
    points = target.prior_points(np.random.default_rng(seed), PROPOSALS)
    return points[target.misfit(points) <= 1]


def right(target, seed, allowance):
    found = accepted(target, seed)
    return SamplerRun(submit(target, points=found, evaluations=np.array(PROPOSALS)))


def wrong(target, seed, allowance):
    found = accepted(target, seed)
    return SamplerRun(submit(target, points=found[found[:, -1] > 0]))


def empty(target, seed, allowance):
    return None


def outside(target, seed, allowance):
    points = target.prior_points(np.random.default_rng(seed), 100)
    return SamplerRun(Submission(points[None], len(points)))


def function(target, seed, allowance):
    return "draws"


RIGHT = ExternalSampler(right, "rejection from the prior")
WRONG = ExternalSampler(wrong, "the same, of half the support")
EMPTY = ExternalSampler(empty, "nothing")
OUTSIDE = ExternalSampler(outside, "the prior")
SAID = ExternalSampler(function, "words")
NEEDY = ExternalSampler(right, "more", needs="no_such_package", install="mypackage[more]")
"""
NAMES = ("right", "wrong", "empty", "outside", "said", "needy")


def install(folder: Path, distribution: str, declared: dict[str, str]) -> None:
    """What pip leaves of a package that declares samplers."""
    about = folder / f"{distribution}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n", encoding="utf-8"
    )
    lines = [f"{name} = {value}" for name, value in declared.items()]
    (about / "entry_points.txt").write_text(
        "\n".join([f"[{entries.ENTRY_POINTS}]", *lines]), encoding="utf-8"
    )


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, where a package of a user's is installed."""
    (tmp_path / "mypackage.py").write_text(SAMPLERS, encoding="utf-8")
    install(
        tmp_path, "mypackage", {f"mypackage-{name}": f"mypackage:{name.upper()}" for name in NAMES}
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("mypackage", None)


def test_a_user_s_sampler_is_listed(installed: Path) -> None:
    mine = [name for name in entrants() if name.startswith("mypackage-")]
    assert mine == sorted(f"mypackage-{name}" for name in NAMES)
    assert entrant("mypackage-right").note == "rejection from the prior"
    contest.check_names(["rejection", "mypackage-right"])
    with pytest.raises(BadInput, match=r"there is no sampler 'mine'; .*mypackage-right"):
        contest.check_names(["mine"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["right", "wrong"])
def test_a_user_s_sampler_is_run_and_judged_on_a_target(
    installed: Path, tmp_path: Path, name: str
) -> None:
    """The whole way of the leaderboard, by its name alone; the wrong one is the control."""
    work = tmp_path / "work"
    work.mkdir()
    budgets = {"seconds": Allowance(seconds=10.0)}
    leaderboard.measure([f"mypackage-{name}"], ["single"], budgets, work)
    (line,) = leaderboard.lines_in(work)
    assert line["sampler"] == f"mypackage-{name}"
    assert (line["verdict"] == DIFFERS) == (name == "wrong"), line
    assert line["effective_draws"] > 100
    (note,) = leaderboard.notes({line["sampler"]})
    assert note.startswith(f"- *mypackage-{name}*: ")


@pytest.mark.slow
def test_a_user_s_sampler_is_compared_on_a_detection(installed: Path) -> None:
    """By the posterior of a frame in place of a frozen target."""
    model, frame = frozen_model(), estimate(benchmark.load("single"))
    known = contest.truth(model, frame, key=key(1), number=2000)
    lines = {
        name: contest.enter_external(
            model, known, f"mypackage-{name}", key=key(2), allowance=Allowance()
        )
        for name in ("right", "wrong", "empty", "outside", "said")
    }
    verdicts = {name: line.verdict for name, line in lines.items()}
    assert verdicts["right"] != DIFFERS
    assert verdicts["wrong"] == DIFFERS
    assert {verdicts[name] for name in ("empty", "outside", "said")} == {"no draws"}
    assert lines["right"].evaluations == 600_000
    assert lines["right"].settled_per_second == lines["right"].ess_per_second > 0
    assert "lie outside of the support" in lines["outside"].sentence
    assert "brought str, not a SamplerRun" in lines["said"].sentence
    assert "the budget is too small; allow more" in lines["empty"].sentence


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("single", marks=pytest.mark.slow), "arm-soft"])
def test_a_frame_s_posterior_is_what_the_frozen_target_is(name: str) -> None:
    """In every form that a sampler may ask for; the frozen target shares no code with it."""
    frozen = benchmark.load(name)
    target = PosteriorTarget.of(estimate(frozen).posterior(frozen_model(), CANDIDATES))
    assert target.dim == frozen.dim
    assert sorted(target.seen_joints) == sorted(frozen.seen_joints)
    cube = np.random.default_rng(0).uniform(size=(50, target.dim))
    points = frozen.prior_transform(cube)
    inside = benchmark.shipped_points(name)[:50]
    order = [target.seen_joints.index(joint) for joint in frozen.seen_joints]
    np.testing.assert_allclose(target.prior_transform(cube), points, atol=1e-9)
    for some in (points, inside):
        np.testing.assert_allclose(target.misfits(some)[:, order], frozen.misfits(some), rtol=1e-5)
        np.testing.assert_allclose(target.misfit(some), frozen.misfit(some), rtol=1e-5)
        np.testing.assert_allclose(
            target.log_graded(some, 50.0), frozen.log_graded(some, 50.0), rtol=1e-5, atol=1e-5
        )
    held = frozen.misfit(inside) <= 1 - 1e-5
    assert held.sum() > 40
    np.testing.assert_allclose(
        target.log_density(inside[held]), frozen.log_density(inside[held]), rtol=1e-5
    )


def test_ours_are_found_in_a_checkout_that_was_not_installed_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever an older install has left behind: nothing, or a sampler that is gone."""
    stale = metadata.EntryPoint("gone", "poseterior.gone:GONE", entries.ENTRY_POINTS)
    stale = stale._for(metadata.distribution("poseterior"))
    for left in ((), (stale,)):
        monkeypatch.setattr(metadata, "entry_points", lambda group, left=left: left)
        assert tuple(entries.external_samplers()) == OURS


def test_ours_are_found_where_there_is_no_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a wheel: by what was installed with it."""
    declared = {"nrpt": "poseterior.inference.benchmark.external.ladder:NRPT"}
    install(tmp_path, "poseterior", declared)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(entries, "CHECKOUT", tmp_path)
    assert tuple(entries.external_samplers()) == ("nrpt",)
    assert entries.external_sampler("nrpt").needs == ""


@pytest.mark.parametrize("name", OURS)
def test_ours_are_what_their_entries_say(name: str) -> None:
    found = entries.external_sampler(name)
    assert (found.needs == "") == (found.install == "")


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        ({"bad": "nowhere:SAMPLER"}, "cannot be imported from nowhere:SAMPLER"),
        ({"bad": "mypackage:NOTHING"}, "cannot be imported from mypackage:NOTHING"),
        ({"bad": "mypackage:right"}, "names mypackage:right, which is no ExternalSampler"),
        ({"bad": "mypackage:RIGHT", "nrpt": "mypackage:RIGHT"}, "two packages have a sampler"),
        ({"bad": "mypackage:NEEDY"}, r'is not installed; install "mypackage\[more\]"'),
    ],
)
def test_a_broken_package_is_told_in_a_sentence(
    installed: Path, declared: dict[str, str], words: str
) -> None:
    install(installed, "another", declared)
    with pytest.raises(BadInput, match=words):
        entrant("bad").require()
