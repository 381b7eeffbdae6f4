"""Posterior SBC of samplers of poses: one joint is seen once more, and a sampler with a wrong
spread is found.

False-alarm rates stand beside every statistical test; seeds are fixed."""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy import stats

from poseterior.inference.draws import Draws, Sampler
from poseterior.inference.sampler import sampler_of
from poseterior.inference.studies.calibration.verdict import CALIBRATED, MISCALIBRATED
from poseterior.inference.studies.judging import posterior_sbc
from poseterior.inference.studies.judging.seen_again import SeenAgain, new_keypoints
from poseterior.probmodel import BadInput, Estimate, Likelihood, PoseModel
from poseterior.probmodel.errors.faults import EXCHANGE_INDEX
from poseterior.probmodel.errors.laws import LAWS, Gaussian
from poseterior.probmodel.posterior import Posterior
from poseterior.probmodel.skeleton import JOINT_INDEX, MIRROR
from tests.scenes import ALL_BUT_AN_ARM, key, prior_scene

WRIST = JOINT_INDEX["right_wrist"]


@functools.cache
def model() -> PoseModel:
    return PoseModel()


def arm(law: str = "disc") -> Estimate:
    """A scene of which one arm is seen."""
    frame = prior_scene(model(), 3, missing=ALL_BUT_AN_ARM)
    return dataclasses.replace(frame, likelihood=Likelihood(LAWS[law]()))


@dataclasses.dataclass(frozen=True)
class WrongSpread(Sampler):
    """Draws under errors that are so many times as large."""

    factor: float = 1.0

    def _blocks(self, posterior: Posterior, *given: Any) -> Iterator[Draws]:
        likelihood = posterior.likelihood
        wrong = dataclasses.replace(likelihood, factor=self.factor * likelihood.factor)
        inner = sampler_of("candidates")
        return inner._blocks(dataclasses.replace(posterior, likelihood=wrong), *given)


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, CALIBRATED), (0.3, MISCALIBRATED)])
def test_a_wrong_spread_is_found_on_the_data_at_hand(factor: float, verdict: str) -> None:
    """At a chance of 0.01 that a right sampler is accused."""
    sampler = WrongSpread("wrong", factor=factor)
    given = {"root": "candidates", "seed": 1, "num_replicates": 20, "num_samples": 50}
    found = posterior_sbc(model(), arm(), sampler, **given)
    assert found.verdict == verdict, found.sentence


def test_weights_are_the_density_of_both_over_the_middles() -> None:
    """By the density of cut Gaussians in the image, written out."""
    posterior = arm("gaussian").posterior(model(), "candidates")
    first = posterior.detection.keypoints[WRIST]
    again = SeenAgain(posterior, WRIST, first + np.array([9.0, -4.0]))
    draws = sampler_of("candidates").draw(again.between, key(0), 200)
    sigma = Gaussian.reach / 3 * 100.0 * np.asarray(posterior.detected.spread)[WRIST]

    def by_hand(keypoint: np.ndarray) -> np.ndarray:
        far = np.linalg.norm(draws.keypoints[:, WRIST] - keypoint, axis=1) / sigma
        inside = np.log(stats.chi2.cdf(9.0, 2))
        return np.where(far <= 3, -(far**2) / 2 - np.log(2 * np.pi * sigma**2) - inside, -np.inf)

    both = by_hand(first) + by_hand(again.keypoint)
    np.testing.assert_allclose(again.log_likelihood(draws), both, atol=1e-8)
    np.testing.assert_allclose(
        again.log_weight(draws), both - by_hand(first + np.array([4.5, -2.0])), atol=1e-8
    )


def test_exchanged_keypoints_are_seen_again_where_they_were() -> None:
    """A new detection has the faults of its draw: the wrists' keypoints stand under each other's
    names, and the density reads them so."""
    posterior = prior_scene(model(), 3).posterior(model(), "candidates")
    draws = sampler_of("candidates").draw(posterior, key(0), 20)
    faults = draws.faults._replace(exchange=np.full(20, EXCHANGE_INDEX["arms"]))
    draws = dataclasses.replace(draws, faults=faults)
    new = new_keypoints(draws)[:, WRIST]
    reach = 100.0 * np.asarray(posterior.detected.spread)[MIRROR[WRIST]]
    assert (np.linalg.norm(new - draws.keypoints[:, MIRROR[WRIST]], axis=1) < reach).all()
    keypoints = posterior.detection.keypoints.copy()
    keypoints[WRIST] = new[0]
    detection = dataclasses.replace(posterior.detection, keypoints=keypoints)
    exchanged = dataclasses.replace(posterior, detection=detection)
    assert np.isfinite(SeenAgain(exchanged, WRIST, new[0]).log_likelihood(draws)[0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"sampler": "nuts", "root": "candidates"}, "draws chains, and ranks need independent"),
        ({"num_replicates": 0}, "must be at least 1"),
        ({"sampler": "no such"}, "no sampler 'no such'"),
    ],
)
def test_refusals(given: dict, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        posterior_sbc(model(), arm(), **given)


@pytest.mark.sweep
@pytest.mark.parametrize("law", LAWS)
def test_weighted_roots_are_right_on_a_whole_body(law: str) -> None:
    """At a chance of 0.01 each."""
    frame = dataclasses.replace(prior_scene(model(), 3), likelihood=Likelihood(LAWS[law]()))
    found = posterior_sbc(model(), frame, num_replicates=60)
    assert found.verdict == CALIBRATED, found.sentence
