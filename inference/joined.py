"""Independent runs of one posterior as the chains of one result."""

from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.results import COMPLETE, Result

CHAINED = ("posterior", "sample_stats", "posterior_predictive", "log_likelihood")
"""Groups with a chain."""
_EVIDENCE, _ERROR = "log_evidence", "log_evidence_se"


def joined(results: list[Result]) -> Result:
    """The runs as chains, in their order; where one has fewer draws than the others, all are as
    short. Evidences are averaged, costs added; the status is that of the first run that is not
    complete."""
    draws = min(result.tree["posterior"].sizes["draw"] for result in results)
    trees = [result.tree for result in results]
    groups = {
        name: _chains([tree[name].to_dataset() for tree in trees], draws)
        for name in CHAINED
        if name in trees[0].children
    }
    groups["observed_data"] = trees[0]["observed_data"].to_dataset()
    groups["constant_data"] = _constant([tree["constant_data"].to_dataset() for tree in trees])
    whole = xr.DataTree.from_dict(groups)
    whole.attrs.update(_attributes(trees, draws))
    first = next((one for one in results if one.status != COMPLETE), results[0])
    return Result(whole, first.status, first.sentence)


def _chains(parts: list[xr.Dataset], draws: int) -> xr.Dataset:
    short = [
        part.isel(draw=slice(draws)).assign_coords(chain=[chain])
        for chain, part in enumerate(parts)
    ]
    return xr.concat(short, dim="chain", data_vars="minimal", join="exact", compat="equals")


def _constant(parts: list[xr.Dataset]) -> xr.Dataset:
    """What the runs share, with the mean of what each found out about the roots."""
    evidence, error = _mean_evidence(
        np.stack([part[_EVIDENCE].values for part in parts]),
        np.stack([part[_ERROR].values for part in parts]),
    )
    one = ("candidate",)
    weight = np.mean([part.weight.values for part in parts], axis=0)
    return parts[0].assign(
        {_EVIDENCE: (one, evidence), _ERROR: (one, error), "weight": (one, weight)}
    )


def _attributes(trees: list[xr.DataTree], draws: int) -> dict[str, Any]:
    given: list[dict[str, Any]] = [
        {str(name): value for name, value in tree.attrs.items()} for tree in trees
    ]
    evidence, error = _mean_evidence(
        np.array([[one[_EVIDENCE]] for one in given]), np.array([[one[_ERROR]] for one in given])
    )
    proposals = sum(int(one["num_proposals"]) for one in given)
    unfinished = [one["status"] for one in given if one["status"] != COMPLETE]
    return given[0] | {
        "num_samples": sum(int(one["num_samples"]) for one in given),
        "num_proposals": proposals,
        "acceptance_rate": len(given) * draws / max(proposals, 1),
        "wall_time_s": sum(float(one["wall_time_s"]) for one in given),
        "status": unfinished[0] if unfinished else COMPLETE,
        _EVIDENCE: float(evidence[0]),
        _ERROR: float(error[0]),
    }


def _mean_evidence(logs: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log of the mean over runs of evidences `(runs, n)`, and its standard error, `(n,)` each."""
    count = len(logs)
    total = np.logaddexp.reduce(logs, axis=0)
    with np.errstate(invalid="ignore"):  # where no run found anything: -inf - -inf
        share = np.where(np.isfinite(logs), np.exp(logs - total), 0.0)
    errors = np.where(share > 0, errors, 0.0)
    error = np.sqrt(np.sum((share * errors) ** 2, axis=0))
    return total - np.log(count), np.where(np.isfinite(total), error, np.inf)
