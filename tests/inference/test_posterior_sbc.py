"""Posterior SBC: right where a sampler is, on the data at hand; a sampler that errs there is
found."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro.infer.util import log_density
from scipy import stats

from poseterior.inference.studies.calibration.verdict import CALIBRATED, MISCALIBRATED
from poseterior.inference.studies.judging import posterior_sbc
from poseterior.inference.studies.judging.posterior_sbc import Program, observed_twice
from poseterior.probmodel import BadInput

SEEN = np.array([1.2, 0.3, 2.0])


def model() -> None:
    mean = numpyro.sample("mean", dist.Normal(0, 2))
    with numpyro.plate("seen", 3):
        numpyro.sample("y", dist.Normal(mean, 1))


class Conjugate:
    """The posterior of `model` in closed form, with a wrong spread for two data sets."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def __call__(
        self, program: Program, key: jax.Array, replicate: Mapping[str, Any] | None
    ) -> Mapping[str, Any]:
        y = SEEN if replicate is None else np.concatenate([SEEN, replicate["y"]])
        precision = 1 / 4 + len(y)
        factor = 1.0 if replicate is None else self.factor
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        return {"mean": y.sum() / precision + factor * rng.normal(size=150) / precision**0.5}


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, CALIBRATED), (0.5, MISCALIBRATED)])
def test_a_sampler_is_judged_on_the_data_at_hand(factor: float, verdict: str) -> None:
    found = posterior_sbc(model, {"y": SEEN}, Conjugate(factor), seed=1, num_replicates=100)
    assert found.verdict == verdict, found.sentence
    assert found.quantities == ["mean"]


def test_data_are_seen_twice() -> None:
    """By the density of Gaussians, written out."""
    again = np.array([0.5, 0.1, -0.4])
    density = log_density(observed_twice(model, {"y": SEEN}), ({"y": again},), {}, {"mean": 0.7})
    by_hand = stats.norm.logpdf(0.7, 0, 2) + stats.norm.logpdf([*SEEN, *again], 0.7).sum()
    assert float(density[0]) == pytest.approx(by_hand)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((model, {"x": SEEN}, Conjugate(1.0)), "the model has no observed site x; it draws y"),
        ((model, {"y": SEEN}, "nuts"), "a function, not a name"),
    ],
)
def test_refusals(given: tuple, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        posterior_sbc(*given, num_replicates=20)


@pytest.mark.sweep
def test_nuts_is_right_on_a_small_model() -> None:
    found = posterior_sbc(model, {"y": SEEN}, num_replicates=40, num_samples=100)
    assert found.verdict == CALIBRATED, found.sentence
