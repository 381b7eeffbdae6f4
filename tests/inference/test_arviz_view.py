"""Every function of ArviZ that takes a posterior, on results of a fixed and of an uncertain root,
of one chain and of several, under a flat law and one that is not: it answers where the result has
what the table says that it needs, and refuses where it has not."""

import dataclasses
import inspect
import warnings
from collections.abc import Callable
from typing import Any

import lazy_loader
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

from poseterior import for_arviz, inference
from poseterior.probmodel import BadInput, Estimate, Likelihood, PoseModel
from poseterior.probmodel.errors.laws import Gaussian
from tests.scenes import key

az = lazy_loader.load("arviz")  # a second, for which other tests need not wait
AXIS, CHAINS, LAW = "one axis", "chains", "a law that is not flat"
NOTHING: tuple[str, ...] = ()
SUMMARIES = (
    "diagnose ess eti hdi histogram iqr kde mad mcse mean median mode qds rhat std summary thin var"
    " plot_autocorr plot_convergence_dist plot_dgof plot_dgof_dist plot_dist plot_ess"
    " plot_ess_evolution plot_forest plot_mcse plot_pair plot_parallel plot_ridge plot_trace"
    " plot_trace_dist"
)
NEEDS = {
    **dict.fromkeys(SUMMARIES.split(), NOTHING),
    **dict.fromkeys(("plot_rank", "plot_rank_dist"), (CHAINS,)),
    **dict.fromkeys(("plot_ppc_dist", "plot_ppc_tstat"), NOTHING),
    **dict.fromkeys(
        (
            "metrics",
            "plot_ppc_dist_pit",
            "plot_ppc_interval",
            "plot_ppc_pava",
            "plot_ppc_pit",
        ),
        (AXIS,),
    ),
    **dict.fromkeys(
        (
            "loo",
            "loo_expectations",
            "loo_influence",
            "plot_psense_dist",
            "plot_psense_quantities",
            "psense",
            "psense_summary",
        ),
        (LAW,),
    ),
    **dict.fromkeys(
        (
            "loo_metrics",
            "loo_pit",
            "loo_score",
            "plot_loo_interval",
            "plot_loo_pava",
            "plot_loo_pit",
        ),
        (LAW, AXIS),
    ),
}
"""What a function needs of a result."""
NOT_OURS = {
    **dict.fromkeys(("bayes_factor", "plot_bf", "plot_prior_posterior"), "draws of the prior"),
    **dict.fromkeys(("bfmi", "plot_energy"), "a Hamiltonian's energy"),
    **dict.fromkeys(("generate_survival_curves", "kaplan_meier", "plot_ppc_censored"), "survival"),
    **dict.fromkeys(("bayesian_r2", "loo_r2", "plot_lm", "residual_r2"), "a regression"),
    **dict.fromkeys(("lfo_cv", "loo_kfold"), "a sampler to fit anew"),
    **dict.fromkeys(("loo_approximate_posterior", "loo_moment_match", "loo_subsample"), "more"),
    **dict.fromkeys(("dict_to_dataset", "from_dict", "extract", "combine_plots"), "makes others"),
    **dict.fromkeys(("xarray_sel_iter", "xarray_to_ndarray", "xarray_var_iter"), "makes others"),
    **dict.fromkeys(("ci_in_rope", "plot_pair_focus", "plot_ppc_pava_residuals"), "an argument"),
    "ecdf": "not of trees yet",
    "plot_ecdf_pit": "simulations",
    "plot_ppc_rootogram": "discrete detections",
    "rhat_nested": "chains of chains",
}
"""Functions that ask for what no single posterior is."""


@pytest.fixture(scope="module")
def uncertain(example_estimate: Estimate) -> xr.DataTree:
    """One chain, under a law that is not flat."""
    frame = dataclasses.replace(example_estimate, likelihood=Likelihood(Gaussian(), 0.15))
    return inference.sample(PoseModel(), frame, key=key(1), num_samples=150, num_roots=100).tree


@pytest.fixture(scope="module")
def fixed(example_estimate: Estimate) -> xr.DataTree:
    """Two chains, under the paper's."""
    return inference.sample(
        PoseModel(),
        example_estimate,
        key=key(1),
        num_samples=300,
        chains=2,
        root="candidates",
    ).tree


def takes_a_posterior(name: str) -> bool:
    function = getattr(az, name)
    if name.startswith("_") or not inspect.isfunction(function):
        return False
    return next(iter(inspect.signature(function).parameters), "") in ("data", "dt")


def test_the_table_has_every_function() -> None:
    wanted = {name for name in dir(az) if takes_a_posterior(name)}
    assert wanted == {*NEEDS, *NOT_OURS}
    assert not {*NEEDS} & {*NOT_OURS}


def answered(function: Callable[..., Any], tree: xr.DataTree, **settings: Any) -> bool:
    """Whether it answers: no exception, and no figure that is left open."""
    try:
        with warnings.catch_warnings(), az.rc_context({"plot.max_subplots": 60}):
            warnings.simplefilter("ignore")  # of so few draws
            function(tree, **settings)
    except Exception:  # whatever ArviZ raises
        return False
    finally:
        plt.close("all")
    return True


@pytest.mark.slow
@pytest.mark.parametrize("axis", [None, "u"])
@pytest.mark.parametrize("name", NEEDS)
def test_it_answers_where_the_result_has_what_it_needs(
    name: str, axis: str | None, uncertain: xr.DataTree, fixed: xr.DataTree
) -> None:
    function = getattr(az, name)
    parameters = inspect.signature(function).parameters
    of_detections = "ppc" in name or "loo" in name or "var_names" not in parameters
    settings = {} if of_detections else {"var_names": ["bone_length"]}
    for tree, has in ((uncertain, {LAW}), (fixed, {CHAINS})):
        there = has if axis is None else has | {AXIS}
        found = answered(function, for_arviz(tree, axis), **settings)
        assert found == ({*NEEDS[name]} <= there), (name, axis, has)


@pytest.mark.slow
def test_the_view_is_the_result(uncertain: xr.DataTree, fixed: xr.DataTree) -> None:
    """No number is not one, densities are those of the program, and nothing is new."""
    for tree in (uncertain, fixed):
        view = for_arviz(tree, "v")
        assert {**view.attrs} == {**tree.attrs}
        for group in view.children.values():
            assert all(np.isfinite(one).all() for one in group.data_vars.values())
        joints = tree["posterior"].joints.sel(joint=view["posterior"].joint)
        xr.testing.assert_identical(view["posterior"].joints, joints)
        seen = np.isfinite(tree["posterior_predictive"].keypoints).all(["chain", "draw", "uv"])
        assert [*view["observed_data"].joint.values] == [*seen.joint.values[seen.values]]
    assert "log_prior" not in view.children
    view = for_arviz(uncertain)
    whole = view["log_prior"].pose + view["log_likelihood"].keypoints.sum("joint")
    np.testing.assert_allclose(whole, uncertain["sample_stats"].lp, rtol=1e-12)


@pytest.mark.slow
def test_a_joint_left_out_is_weighed_by_hand(uncertain: xr.DataTree) -> None:
    """`loo_pit` of one axis: draws weighed by one over the likelihood of the joint left out, of
    which ArviZ smooths the largest: within 0.05, where unweighed draws are not."""
    view = for_arviz(uncertain, "u")
    found = az.loo_pit(view).keypoints
    weight = np.exp(-view["log_likelihood"].keypoints)
    below = view["posterior_predictive"].keypoints < view["observed_data"].keypoints
    wanted = (weight * below).sum(["chain", "draw"]) / weight.sum(["chain", "draw"])
    assert abs(found - wanted).max() < 0.05 < abs(below.mean(["chain", "draw"]) - wanted).max()


def test_what_is_no_result_is_refused(fixed: xr.DataTree) -> None:
    with pytest.raises(BadInput, match="sample_stats is missing"):
        for_arviz(xr.DataTree.from_dict({"posterior": xr.Dataset()}))
    with pytest.raises(BadInput, match="u and v, not 'w'"):
        for_arviz(fixed, "w")
