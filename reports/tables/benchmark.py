"""The benchmark in tables: its targets, and the verdict on draws of one."""

import math
from typing import Any

from poseterior.inference.benchmark.catalogue import targets
from poseterior.inference.benchmark.references import reference
from poseterior.inference.benchmark.verdicts import Assessment
from poseterior.inference.studies.comparison.judge import AGREES, DIFFERS, JUDGE_LEVEL
from poseterior.reports.tables.sheet import Column, Sheet, number, plus_minus, significant, written

CLEAR = 0.01
"""Modes of more mass are counted."""


def targets_table() -> Sheet:
    """The targets, easy ones first."""
    records = []
    for name, target in targets().items():
        known = reference(name)
        modes = list(known.modes.values())
        records.append(
            {
                "target": name,
                "dim": target.dim,
                "law": target.law,
                "log_evidence": known.log_evidence,
                "log_evidence_se": known.log_evidence_se,
                "modes": sum(mass > CLEAR for mass in modes),
                "largest_mode": modes[0],
                "about": target.about,
            }
        )
    columns = (
        Column("target", left=True, whole=True),
        Column("dim"),
        Column("law", left=True),
        Column(
            "log evidence", lambda one: "{log_evidence:.3f} ± {log_evidence_se:.3f}".format(**one)
        ),
        Column("modes > 1 %", "modes"),
        Column("largest", "largest_mode", lambda mass: f"{mass:.0%}"),
        Column("what it is", "about", left=True),
    )
    return Sheet(columns, records)


def tests_table(found: Assessment) -> Sheet:
    """The judge's tests of draws, those that decide first."""
    decisive = [{**test._asdict(), "decides": "yes"} for test in found.judgement.tests]
    others = [{**test._asdict(), "decides": "no"} for test in found.judgement.beside]
    columns = (
        Column("test", "name", left=True),
        Column("p", "p_value", significant(2)),
        Column("effective draws", "size", written("{:,.0f}")),
        Column("decides", left=True),
        Column("takes for granted", "assumption", left=True),
    )
    return Sheet(columns, decisive + others)


def verdict_sentences(found: Assessment) -> list[str]:
    """The verdict in words."""
    judgement = found.judgement
    judged = "" if found.judged == found.draws else f", {found.judged:,} of them judged"
    sentences = [
        f"{found.target}: {judgement.verdict}. {judgement.sentence}",
        f"{found.draws:,} draws{judged}, worth {judgement.mixing.worst:,.0f} independent ones in"
        " the worst coordinate",
        f"worst coordinate: {found.worst_coordinate}, W1 {found.worst_w1:.3f} standard deviations",
        f"mass in modes never visited: {judgement.modes.missed:.2%}; as many independent draws"
        f" would miss {judgement.modes.expected_missed:.2%}",
    ]
    if math.isfinite(found.evidence_error):
        sentences.append(_evidence(found))
    for value, unit in ((found.per_evaluation, "evaluation"), (found.per_second, "second")):
        if math.isfinite(value):
            sentences.append(f"effective draws per {unit}: {value:.3g}")
    return sentences


def _evidence(found: Assessment) -> str:
    error = number(found.evidence_error_se)
    off = f"log evidence off by {plus_minus((found.evidence_error, error))} nats"
    test = found.judgement.evidence
    if test is None:
        return f"{off}, not judged without log_evidence_se"
    p_value = significant(2)(test.p_value)
    return f"{off}: {DIFFERS if test.p_value < JUDGE_LEVEL else AGREES}, p = {p_value}"


def verdict_record(found: Assessment) -> dict[str, Any]:
    """The verdict as JSON has it."""
    judgement = found.judgement
    return {
        "target": found.target,
        "verdict": judgement.verdict,
        "sentence": judgement.sentence,
        "draws": found.draws,
        "judged": found.judged,
        "effective_draws": number(judgement.mixing.worst),
        "tests": tests_table(found).json(),
        "would_have_caught": None
        if judgement.seen is None
        else {name: number(value) for name, value in judgement.seen._asdict().items()},
        "missed_mass": judgement.modes.missed,
        "expected_missed_mass": judgement.modes.expected_missed,
        "worst_coordinate": found.worst_coordinate,
        "worst_w1": found.worst_w1,
        "evidence_error": number(found.evidence_error),
        "evidence_error_se": number(found.evidence_error_se),
        "effective_draws_per_evaluation": number(found.per_evaluation),
        "effective_draws_per_second": number(found.per_second),
    }
