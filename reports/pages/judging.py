"""Writes reports/judging.md: which test of coverage notices which wrong posterior, ours and those
of others.

    python -m poseterior.reports.pages.judging work

The tests of sbi, bayesflow and pqm run where these are installed (`OTHERS`); what was kept in the
folder is there when the page is made again without them."""

import warnings
from collections.abc import Callable, Mapping
from itertools import product

import numpy as np

from poseterior.inference.studies.judging.judge import judge_coverage
from poseterior.inference.studies.judging.where import share_held
from poseterior.inference.studies.judging.wrong import WRONGS, Instances, told
from poseterior.reports.pages.page import Page, Work, kept_json, run
from poseterior.reports.tables.sheet import Column, Sheet, sheet_of

LEVEL = 0.05
SIZES = {100: 20, 300: 8}
"""Instances, and how many times each is tried."""
DRAWN = 100
"""Draws of an instance."""
SEEDS = 200
NULLS = 300
"""Replicates of bayesflow's null."""
OURS = ("ranks (SBC)", "highest density", "energy balls", "TARP", "classifier", "where", "verdict")


def main(work: Work) -> Page:
    found = {
        (name, size): kept_json(work / f"{size}-{row}.json", powers, name, size)
        for (row, name), size in product(enumerate(WRONGS), SIZES)
    }
    tried = ", ".join(f"{times} at {size:,}" for size, times in SIZES.items())
    accused = kept_json(work / "right.json", accusations)
    return Page(
        "judging",
        {
            "at_100": _table(found, 100),
            "at_300": _table(found, 300),
            "draws": DRAWN,
            "tried": tried,
            "accused": accused,
            "accused_share": _said([*[True] * accused, *[False] * (SEEDS - accused)]),
            "seeds": SEEDS,
        },
    )


def accusations() -> int:
    """How many of `SEEDS` right posteriors the verdict accuses at `LEVEL`, every other one of
    weighted draws from a wider and shifted proposal."""
    found = 0
    for seed in range(SEEDS):
        rng = np.random.default_rng([7, seed])
        seen = rng.normal(size=(100, 2))
        mean = np.stack([seen[:, 0], seen.sum(axis=1)], axis=1)
        spread = np.exp(0.5 * seen[:, 1])[:, None]
        truth = mean + spread * rng.normal(size=(100, 2))
        off = rng.normal(size=(100, 60 * (1 + seed % 2), 2))
        weights = None
        if seed % 2:
            off = 1.5 * off + 0.3
            weights = np.exp(-0.5 * (off**2 - ((off - 0.3) / 1.5) ** 2).sum(axis=2))
        draws = mean[:, None] + spread[:, None] * off
        judged = judge_coverage(
            draws, truth, weights, covariates=seen, seed=seed, false_alarm=LEVEL
        )
        found += judged.verdict != "calibrated"
    return found


def powers(fault: str, size: int) -> dict[str, list[bool]]:
    """By test, whether it rejected at `LEVEL`, time after time."""
    found: dict[str, list[bool]] = {}
    for repetition in range(SIZES[size]):
        rng = np.random.default_rng([49, size, list(WRONGS).index(fault), repetition])
        case = told(fault, size, DRAWN, rng)
        for name, test in TESTS.items():
            for kind, rejects in test(case, repetition).items():
                found.setdefault(f"{name}{kind}", []).append(bool(rejects))
    return found


def _ours(case: Instances, seed: int) -> Mapping[str, bool]:
    seen = {f"seen {axis}": column for axis, column in enumerate(case.seen.T)}
    found = judge_coverage(
        case.draws,
        case.truth,
        log_density=case.log_density,
        covariates=seen,
        seed=seed,
        false_alarm=LEVEL,
    )
    assert found.local is not None
    alone = {name: value < LEVEL for name, value in found.calibration.families.items()}
    alone |= {"where": found.local.p_value < LEVEL, "verdict": found.verdict != "calibrated"}
    return {name: alone.get(name, False) for name in OURS}


def _sbi_ranks(case: Instances, seed: int) -> Mapping[str, bool]:
    import torch
    from sbi.diagnostics.sbc import check_uniformity_frequentist

    ranks = (case.draws < case.truth[:, None]).sum(axis=1)
    p_values = check_uniformity_frequentist(torch.tensor(ranks), DRAWN)
    return {"": float(p_values.min()) < LEVEL / len(p_values)}


def _sbi_tarp(case: Instances, seed: int) -> Mapping[str, bool]:
    import torch
    from sbi.diagnostics.tarp import _run_tarp, check_tarp, get_tarp_references

    torch.manual_seed(seed)
    truth = torch.tensor(case.truth)
    draws = torch.tensor(np.swapaxes(case.draws, 0, 1))
    curve, alpha = _run_tarp(draws, truth, get_tarp_references(truth), z_score_theta=True)
    return {"": float(check_tarp(curve, alpha)[1]) < LEVEL}


def _bayesflow_gamma(case: Instances, seed: int) -> Mapping[str, bool]:
    from bayesflow.diagnostics.metrics import calibration_log_gamma

    np.random.seed(seed)  # noqa: NPY002
    found = calibration_log_gamma(case.draws, case.truth, num_null_draws=NULLS, quantile=LEVEL / 3)
    return {"": min(found["values"]) < 0}


def _bayesflow_coverage(case: Instances, seed: int) -> Mapping[str, bool]:
    """Whether a curve leaves its band of 95 % anywhere, as its reader would see."""
    from bayesflow.utils.plot_utils import compute_empirical_coverage

    widths = np.arange(1, 100) / 100
    found = compute_empirical_coverage(
        case.draws, case.truth, widths, prob=1 - LEVEL, interval_type="central"
    )
    ideal = found["width_represented"]
    outside = (found["coverage_lower"] > ideal) | (found["coverage_upper"] < ideal)
    return {"": bool(outside.any())}


def _pqm(case: Instances, seed: int) -> Mapping[str, bool]:
    from pqm import pqm_pvalue

    np.random.seed(seed)  # noqa: NPY002
    joint = [np.hstack([part, case.seen]) for part in (case.truth, case.draws[:, 0])]
    return {"": float(np.mean(pqm_pvalue(*joint, num_refs=20, z_score_norm=True))) < LEVEL}


TESTS: dict[str, Callable[[Instances, int], Mapping[str, bool]]] = {
    "": _ours,
    "sbi SBC (KS)": _sbi_ranks,
    "sbi TARP": _sbi_tarp,
    "bayesflow log γ": _bayesflow_gamma,
    "bayesflow coverage bands": _bayesflow_coverage,
    "pqm": _pqm,
}


def _table(found: Mapping[tuple[str, int], dict[str, list[bool]]], size: int) -> Sheet:
    names = list(
        dict.fromkeys(test for (_, one), tests in found.items() if one == size for test in tests)
    )
    rows = [(fault, *(_said(found[fault, size].get(name)) for name in names)) for fault in WRONGS]
    return sheet_of([Column("posterior", left=True), *map(Column, names)], rows)


def _said(rejected: list[bool] | None) -> str:
    if not rejected:
        return "–"
    share = share_held(np.array(rejected))
    return f"{share.value:.0%} ({share.low:.0%}–{share.high:.0%})"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    run(main)
