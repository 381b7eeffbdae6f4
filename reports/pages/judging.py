"""Writes reports/judging.md: which test of coverage notices which wrong posterior, ours and those
of others.

    python -m poseterior.reports.pages.judging work

The tests of sbi, bayesflow and pqm need these installed; what was kept in the folder, a file a
try, is there when the page is made again without them."""

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from poseterior.inference.studies.judging.judge import judge_coverage
from poseterior.inference.studies.judging.where import share_held
from poseterior.inference.studies.judging.wrong import WRONGS, Instances, told
from poseterior.reports.pages.page import Page, Work, kept_json, run
from poseterior.reports.tables.coverage import share
from poseterior.reports.tables.sheet import Column, Sheet, sheet_of

LEVEL = 0.05
TRIES = {100: 60, 300: 35, 1000: 12}
"""Instances, and how many times each is tried."""
DRAWN = 100
"""Draws of an instance."""
SEEDS = 200
NULLS = 300
"""Replicates of bayesflow's null."""
OURS = ("ranks (SBC)", "highest density", "energy balls", "TARP", "classifier", "where", "verdict")
Tried = dict[str, dict[str, bool]]
"""By posterior and test, whether it rejected."""


def main(work: Work) -> Page:
    accused = kept_json(work / "right.json", accusations)
    return Page(
        "judging",
        {
            "at_100": _table(100, work),
            "at_300": _table(300, work),
            "at_1000": _table(1000, work),
            "draws": DRAWN,
            "tried": ", ".join(f"{times} at {size:,}" for size, times in TRIES.items()),
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


def tried(whose: str, size: int, repetition: int) -> Tried:
    """What the tests of ours, or of others, say at `LEVEL`."""
    found: Tried = {}
    for row, fault in enumerate(WRONGS):
        case = told(fault, size, DRAWN, np.random.default_rng([49, size, row, repetition]))
        found[fault] = {
            f"{name}{kind}": bool(rejects)
            for name, test in TESTS[whose].items()
            for kind, rejects in test(case, repetition).items()
        }
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


Test = Callable[[Instances, int], Mapping[str, bool]]
TESTS: dict[str, dict[str, Test]] = {
    "ours": {"": _ours},
    "others": {
        "sbi SBC (KS)": _sbi_ranks,
        "sbi TARP": _sbi_tarp,
        "bayesflow log γ": _bayesflow_gamma,
        "bayesflow coverage bands": _bayesflow_coverage,
        "pqm": _pqm,
    },
}


def _table(size: int, work: Path) -> Sheet:
    rejected: dict[str, dict[str, list[bool]]] = {fault: {} for fault in WRONGS}
    for repetition in range(TRIES[size]):
        for whose in TESTS:
            path = work / f"{whose}-{size}-{repetition}.json"
            for fault, tests in kept_json(path, tried, whose, size, repetition).items():
                for name, rejects in tests.items():
                    rejected[fault].setdefault(name, []).append(rejects)
    names = list(rejected["right"])
    rows = [(fault, *(_said(tests[name]) for name in names)) for fault, tests in rejected.items()]
    return sheet_of([Column("posterior", left=True), *map(Column, names)], rows)


def _said(rejected: list[bool]) -> str:
    return share(share_held(np.array(rejected)))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    run(main)
