"""What ArviZ finds in a result: new detections, the likelihood of the one there is, and independent
exact chains; the same seed gives the same file.

False alarms: two p-values at 0.001 each; seeds are fixed."""

import dataclasses
import pickle
from pathlib import Path

import arviz as az
import jax
import numpy as np
import pytest
import xarray as xr
from scipy.stats import kstest

from poseterior import inference
from poseterior.inference import Result, results
from poseterior.inference.draws import joined, mean_evidence
from poseterior.inference.exact.mixture import ExactRejection
from poseterior.inference.predictions import KeypointsRead, log_likelihood
from poseterior.inference.results import save_tree
from poseterior.probmodel import BadInput, Estimate, Likelihood, PoseModel, Posterior
from poseterior.probmodel.root_priors import CANDIDATES
from poseterior.probmodel.skeleton import JOINTS
from tests.conftest import Cli
from tests.inference.test_error_laws import CutGaussian
from tests.scenes import key

FALSE_ALARM = 1e-3


@pytest.fixture(scope="module")
def chains(example_estimate: Estimate) -> Result:
    return inference.sample(
        PoseModel(),
        example_estimate,
        key=key(4),
        num_samples=200,
        chains=4,
        root="candidates",
    )


@pytest.fixture(scope="module")
def bent(example_estimate: Estimate) -> Posterior:
    """The example's posterior under a law that is not flat, and reaches as far as the disc."""
    law = CutGaussian()
    likelihood = Likelihood(law, example_estimate.likelihood.factor / law.reach)
    return dataclasses.replace(example_estimate, likelihood=likelihood).posterior(
        PoseModel(), CANDIDATES
    )


@pytest.fixture(scope="module")
def bent_likelihood(bent: Posterior, example_result: Result) -> xr.Dataset:
    """How likely the detection is given the example's draws under that law."""
    draws = example_result.tree["posterior"]
    spreads = np.stack(
        [
            np.asarray(one.spread) * root.camera.scale
            for one, root in zip(bent.observations, bent.candidates, strict=True)
        ]
    )
    found = log_likelihood(
        bent.likelihood.law,
        KeypointsRead(
            np.broadcast_to(bent.detection.keypoints, draws.keypoints.shape[1:]),
            np.zeros(draws.keypoints.shape[1:]),
            spreads[draws.candidate.values[0]],
            np.zeros(draws.keypoints.shape[1:3], bool),
        ),
        draws.keypoints.values[0],
    )
    counts = np.isfinite(spreads).any(axis=0)
    return xr.Dataset({"keypoints": (("chain", "draw", "detected"), found[None][..., counts])})


def errors(result: Result) -> np.ndarray:
    """Distances of predicted detections from the joints, in the joints' radii; only those that
    count."""
    posterior, made = result.tree["posterior"], result.tree["posterior_predictive"]
    offset = np.linalg.norm(made.keypoints.values - posterior.keypoints.values, axis=-1)
    radius = result.tree["constant_data"].radius.values[posterior.candidate.values]
    return (offset / radius)[np.isfinite(radius)]


def test_new_detections_follow_the_law(example_result: Result) -> None:
    """Squared distances are uniform in the disc: they are, and those of half of it are not."""
    square = errors(example_result) ** 2
    assert len(square) >= 8 * 200
    assert kstest(square, "uniform").pvalue > FALSE_ALARM
    assert kstest(0.9 * square, "uniform").pvalue < FALSE_ALARM
    made = example_result.tree["posterior_predictive"].keypoints
    seen = np.isfinite(example_result.tree["constant_data"].radius.values).all(axis=0)
    assert np.array_equal(np.isfinite(made.values).all(axis=(0, 1, 3)), seen)
    assert not seen[JOINTS.index("right_wrist")]  # it was not detected


def test_likelihoods_are_those_of_the_program(
    bent: Posterior, bent_likelihood: xr.Dataset, example_result: Result
) -> None:
    """Their sum, joint by joint, is the log density that observations have by another route."""
    draws = example_result.tree["posterior"]
    found = bent_likelihood.keypoints.sum("detected").values[0]
    which, joints = draws.candidate.values[0], draws.joints.values[0]
    wanted = [
        float(bent.observations[which[draw]].log_density(joints[draw]))
        for draw in range(0, 200, 20)
    ]
    assert found[::20] == pytest.approx(wanted, rel=1e-9)
    assert np.ptp(found) > 1


def test_arviz_compares_chains(chains: Result) -> None:
    found = az.rhat(chains.tree, var_names=["bone_length"])
    assert 0.95 < float(np.max(found["bone_length"])) < 1.1


@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto")  # of so few draws
def test_arviz_leaves_detections_out(bent_likelihood: xr.Dataset, example_result: Result) -> None:
    posterior = example_result.tree["posterior"].to_dataset()
    groups = {"log_likelihood": bent_likelihood, "posterior": posterior}
    assert np.isfinite(az.loo(xr.DataTree.from_dict(groups)).elpd)


def test_densities_and_predictions_wait_until_they_are_read(
    example_estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is computed for those who want the poses alone; who reads a part of it, in a copy
    from another process too, reads what stands in the whole."""
    calls = []
    compute = results.log_density
    monkeypatch.setattr(results, "log_density", lambda draws: calls.append(1) or compute(draws))
    tree = inference.sample(
        PoseModel(), example_estimate, key=key(4), num_samples=50, root="candidates"
    ).tree
    assert not calls
    some = tree["sample_stats"].lp.isel(draw=[3, 7, 40])
    copied = pickle.loads(pickle.dumps(tree))
    whole = tree["sample_stats"].lp.values
    assert np.array_equal(some.values, whole[:, [3, 7, 40]])
    assert np.array_equal(copied["sample_stats"].lp.values, whole)
    assert np.isfinite(whole).all()
    assert len(calls) == 1


@pytest.mark.parametrize("function", ["loo", "loo_expectations", "loo_pit"])
def test_arviz_leaves_nothing_out_under_a_flat_law(
    function: str, chains: Result, example_result: Result
) -> None:
    """All draws would weigh the same: an estimate with an error of 0. There is no likelihood to
    leave anything out of, and it is said why; under a law that is not flat there is."""
    for result in (chains, example_result):
        with pytest.raises((TypeError, ValueError, KeyError, AttributeError)):
            getattr(az, function)(result.tree)
        assert "log_likelihood" not in result.tree.children
        assert (
            "flat within its reach" in result.tree["posterior_predictive"].attrs["log_likelihood"]
        )


def test_chains_are_independent_runs_with_keys_of_their_own(
    chains: Result, example_estimate: Estimate
) -> None:
    posterior = chains.tree["posterior"]
    assert dict(posterior.sizes)["chain"] == 4
    assert dict(posterior.sizes)["draw"] == 50
    alone = inference.sample(
        PoseModel(),
        example_estimate,
        key=jax.random.split(key(4), 4)[2],
        num_samples=50,
        root="candidates",
    )
    assert np.array_equal(posterior.joints.values[2], alone.tree["posterior"].joints.values[0])
    assert len(np.unique(posterior.joints.values[:, 0, 8, 0])) == 4
    made = chains.tree["posterior_predictive"].keypoints.values
    assert len(np.unique(made[:, 0, 3, 0])) == 4
    assert chains.tree.attrs["seed"] == "0 4"
    assert chains.num_draws == chains.tree.attrs["num_samples"] == 200


def test_evidences_are_averaged(chains: Result, example_estimate: Estimate) -> None:
    own = [
        inference.sample(
            PoseModel(), example_estimate, key=one, num_samples=50, root="candidates"
        ).tree.attrs
        for one in jax.random.split(key(4), 4)
    ]
    logs = np.array([one["log_evidence"] for one in own])
    assert chains.tree.attrs["log_evidence"] == pytest.approx(np.log(np.exp(logs).mean()))
    assert chains.tree.attrs["log_evidence_se"] < min(one["log_evidence_se"] for one in own)
    assert chains.tree.attrs["num_proposals"] == sum(one["num_proposals"] for one in own)
    weight = chains.tree["constant_data"].weight.values
    assert weight.sum() == pytest.approx(1)


def test_evidence_where_a_run_found_nothing() -> None:
    assert mean_evidence([(-np.inf, np.inf)] * 2) == (-np.inf, np.inf)
    found = mean_evidence([(-3.0, 0.1), (-np.inf, np.inf)])
    assert found == pytest.approx((-3.0 - np.log(2), 0.1))


def test_the_same_seed_gives_the_same_file(
    chains: Result, example_estimate: Estimate, tmp_path: Path
) -> None:
    """All bytes but those of the time that it took."""
    again = inference.sample(
        PoseModel(),
        example_estimate,
        key=key(4),
        num_samples=200,
        chains=4,
        root="candidates",
    )
    for name, tree in (("a.nc", chains.tree.copy()), ("b.nc", again.tree)):
        tree.attrs = dict(tree.attrs) | {"wall_time_s": 0.0}
        save_tree(tree, tmp_path / name)
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()


def test_a_short_run_shortens_the_others(example_estimate: Estimate) -> None:
    posterior = example_estimate.posterior(PoseModel(), CANDIDATES)
    parts = [ExactRejection().draw(posterior, key(seed), 20 + 10 * seed) for seed in (0, 1)]
    short = dataclasses.replace(parts[0], status="out of budget", sentence="20 of 30 draws")
    whole = joined([parts[1], short])
    assert (whole.status, whole.sentence) == ("out of budget", "20 of 30 draws")
    assert (len(whole), whole.chains) == (40, 2)
    np.testing.assert_array_equal(whole.joints[20:], short.joints)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"chains": 0}, "10 samples cannot be in 0 chains; choose from 1 to one a sample"),
        ({"chains": 11}, "10 samples cannot be in 11 chains"),
        ({"chains": 2, "sampler": "emcee"}, "emcee decides itself how many chains it runs"),
        ({"chains": 2, "sampler": "magic"}, "there is no sampler 'magic'"),
    ],
)
def test_refusals(example_estimate: Estimate, arguments: dict, match: str) -> None:
    with pytest.raises(BadInput, match=match):
        inference.sample(
            PoseModel(),
            example_estimate,
            key=key(0),
            num_samples=10,
            root="candidates",
            **arguments,
        )


@pytest.mark.slow
def test_the_command_has_chains(tmp_path: Path, poseterior: Cli) -> None:
    from poseterior.probmodel.example import example

    out = tmp_path / "chains.nc"
    words = ("sample", example().path, "--root", "fixed", "--out", out, "--quiet")
    run = poseterior(*words, "--num-samples", 41, "--chains", 2)
    assert (run.code, run.err) == (0, "")
    assert "42 draws by rejection" in run.out
    refused = poseterior(*words, "--chains", 0)
    assert refused.code == 2
    assert "cannot be in 0 chains" in refused.err
