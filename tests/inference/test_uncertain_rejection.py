"""Rejection with an uncertain root: what is not held against brute force by
`tests/inference/test_oracle.py`; against the fast route, with which it shares the attempts at limbs
only; and controls that must fail.

False alarms: evidence and every moment are held to 4 standard errors, 6e-5 each; seeds are fixed.
"""

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from poseterior import inference
from poseterior.inference.draws import OUT_OF_BUDGET
from poseterior.inference.importance import rejection, weighted
from poseterior.inference.importance.fault_patterns import fault_patterns, prior_share
from poseterior.inference.importance.rejection import RejectedRoots, reject_roots, verdict
from poseterior.inference.importance.weighted import log_mean
from poseterior.inference.sampler import REJECTION, WEIGHTED
from poseterior.inference.studies.comparison import compare
from poseterior.inference.studies.comparison.judge import AGREES, DIFFERS
from poseterior.inference.studies.comparison.sample import NAMES, ROOT_NAMES
from poseterior.probmodel import BadInput
from tests.inference import test_uncertain_faults as faulty
from tests.inference import test_uncertain_root as sound
from tests.scenes import key


@functools.cache
def few() -> RejectedRoots:
    model, frame = sound.small_case()
    return reject_roots(frame.posterior(model), key=key(8), num_samples=12, num_roots=40)


def apart(roots: RejectedRoots, brute: dict) -> float:
    """How far the evidence is from brute force, in standard errors."""
    error = math.hypot(roots.log_evidence_se, brute["se"])
    return abs(roots.log_evidence - brute["log"]) / error


@pytest.mark.sweep
def test_a_bound_that_is_too_low_cuts_off_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then roots of little weight are taken too often: the moments show it, and the verdict.
    Promises, which leave weights nearly even, are turned off."""
    brute = sound.truth()
    model, frame = sound.small_case()
    monkeypatch.setattr(rejection, "ROOM", 1e-4)
    monkeypatch.setattr(rejection, "CHANCE", 1.0)
    low = reject_roots(frame.posterior(model), key=key(7), num_samples=1500)
    assert low.cut_off > 0.5
    assert verdict(low)[0] == OUT_OF_BUDGET
    assert sound.off(sound.fast_moments(low, low.share), brute) > 8
    assert apart(low, brute) < 4  # the evidence needs no bound


def test_draws_are_independent_roots_with_one_draw_each() -> None:
    roots = few()
    points, poses, chosen = roots.draw(np.random.default_rng(0), 40)
    assert sorted(chosen) == list(range(12)) == sorted(set(chosen.tolist()))
    assert len(poses.length) == 12
    for part in (points.log_scale, *(column.reshape(12, -1)[:, 0] for column in poses[1:])):
        assert len(np.unique(part)) == 12
    model, frame = sound.small_case()
    assert np.isfinite(frame.posterior(model).log_joint(points, poses)).all()


@pytest.mark.slow
def test_the_evidence_is_the_mean_of_the_weights_and_says_its_error() -> None:
    roots, other = (
        few(),
        rejection.reject_roots(few().posterior, key=key(10), num_samples=12, num_roots=40),
    )
    assert roots.log_evidence == pytest.approx(log_mean(roots.log_weight))
    assert roots.effective == pytest.approx(12)
    error = math.hypot(roots.log_evidence_se, other.log_evidence_se)
    assert 0 < error < 0.5
    assert abs(roots.log_evidence - other.log_evidence) < 4 * error


@pytest.mark.slow
def test_the_same_key_the_same_draws() -> None:
    again = reject_roots(few().posterior, key=key(8), num_samples=12, num_roots=40)
    np.testing.assert_array_equal(again.points.rotation, few().points.rotation)
    assert again.log_evidence == few().log_evidence


def test_the_shares_of_all_strata_are_one() -> None:
    model, frame = faulty.small_case()
    posterior = frame.posterior(model)
    total = sum(prior_share(posterior, stratum) for stratum in fault_patterns(posterior))
    assert total == pytest.approx(1, abs=1e-9)


@pytest.mark.slow
def test_a_budget_that_ends_leaves_what_there_is() -> None:
    model, frame = sound.small_case()
    result = inference.sample(
        model,
        frame,
        key=key(8),
        root="uncertain",
        sampler="rejection",
        num_samples=10_000,
        num_roots=40,
        max_proposals=6_000_000,
    )
    assert result.status == OUT_OF_BUDGET
    assert 0 < result.num_draws < 10_000
    assert f"{result.num_draws:,} of 10,000 draws by rejection after" in result.sentence
    assert result.tree.attrs["sampler"] == "rejection"
    assert result.tree.attrs["cut_off"] == 0


def test_nothing_within_the_budget_is_no_draw() -> None:
    model, frame = sound.small_case()
    roots = reject_roots(frame.posterior(model), key=key(0), num_samples=5, max_proposals=1000)
    assert not roots.limbs
    assert roots.log_evidence == -math.inf
    assert verdict(roots)[1].startswith("0 of 5 draws by rejection after 0 proposals")
    assert not len(roots.draw(np.random.default_rng(0), 5)[2])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"num_samples": 0}, "number of samples must be at least 1, not 0"),
        ({"num_samples": 5, "num_roots": 0}, "number of roots must lie between 1 and 100,000"),
    ],
)
def test_what_makes_no_sense_is_refused(settings: dict[str, int], words: str) -> None:
    model, frame = sound.small_case()
    with pytest.raises(BadInput, match=words):
        reject_roots(frame.posterior(model), key=key(0), **settings)


@pytest.mark.parametrize(
    ("root", "sampler", "words"),
    [
        (
            "uncertain",
            "smc",
            "draws torso and camera; choose weighted-roots, rejection, emcee",
        ),
        ("candidates", "weighted-roots", "weighted-roots needs torso and camera uncertain"),
    ],
)
def test_samplers_and_roots_that_do_not_go_together(root: str, sampler: str, words: str) -> None:
    model, frame = sound.small_case()
    with pytest.raises(BadInput, match=words):
        inference.sample(model, frame, key=key(0), root=root, sampler=sampler)


@pytest.mark.sweep
def test_the_judge_holds_both_routes_against_rejection(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Both agree, whose chance is 0.99 each; weights without the scale's factors are caught."""
    model, frame = sound.small_case()
    settings = {"num_samples": 600, "exact_draws": 600, "num_roots": 3000}
    found = compare(model, frame, (WEIGHTED, REJECTION), seed=1, out=tmp_path, **settings)
    assert [entry.verdict for entry in found.entries] == [AGREES, AGREES]
    assert list(found.tree["draws"].coordinate.values) == [*NAMES, *ROOT_NAMES]
    assert (tmp_path / "comparison.nc").exists()
    right = weighted.log_limbs

    def wrong(posterior: Any, points: Any, faults: Any, limbs: Any) -> np.ndarray:
        return right(posterior, points, faults, limbs) + 2 * len(sound.SEEN) * points.log_scale

    monkeypatch.setattr(weighted, "log_limbs", wrong)
    caught = compare(model, frame, seed=2, **settings)
    assert caught.entries[0].verdict == DIFFERS


def test_there_is_no_contest_without_a_route() -> None:
    model, frame = sound.small_case()
    with pytest.raises(BadInput, match="there is no sampler; choose from weighted-roots"):
        compare(model, frame, [])
