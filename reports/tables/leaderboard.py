"""The leaderboard of the benchmark in tables: a line is what one sampler brought on one target from
one start, under one budget.

*earned* are the effective draws of the worst coordinate beyond the exact ones that were given, and
*to 0.1 sd* the seconds until the sliced Wasserstein distance to the exact draws falls below 0.1
standard deviations for good."""

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy import stats

from poseterior.inference.benchmark.catalogue import load, targets
from poseterior.inference.benchmark.entrants import EXACT_ENGINE, GIFT
from poseterior.inference.studies.comparison.judge import (
    AGREES,
    CANNOT_TELL,
    DIFFERS,
    FEWEST_EFFECTIVE_DRAWS,
    UNMIXED,
)
from poseterior.inference.studies.comparison.mixing import CHAINS_APART
from poseterior.reports.tables.comparison import gift_sentence
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, fixed, number, written

EVALUATIONS, SECONDS = "evaluations", "seconds"
"""What runs are made equal in."""
Line = Mapping[str, Any]


def pace_of(line: Line) -> float:
    """What it earned a second; -1 where it brought no draws."""
    return line["earned"] / line["seconds"] if "earned" in line else -1.0


def verdict_of(line: Line) -> str:
    """What the judge said; of lines that were kept from before it had a word for chains that are
    still apart, that word."""
    apart = line["verdict"] == AGREES and (line.get("rhat_worst") or 0.0) > CHAINS_APART
    return UNMIXED if apart else line["verdict"]


def said_of(line: Line) -> str:
    """The verdict and, where it cannot tell, how much longer a run would have to be."""
    said = verdict_of(line)
    if said != CANNOT_TELL or not line["effective_draws"]:
        return said
    return (
        f"{said}: run {math.ceil(FEWEST_EFFECTIVE_DRAWS / line['effective_draws'])} times as long"
    )


def entered(lines: Iterable[Line]) -> list[Line]:
    """Lines that are ranked: of equal processor time, by samplers that were given nothing."""
    return [one for one in lines if one["budget"] == SECONDS and one["start"] != GIFT]


def ranking(lines: Sequence[Line]) -> Sheet:
    """All samplers on all targets: those first that agree on most of them, then those that are
    least behind exact draws."""
    own = entered(lines)
    exact = {one["target"]: pace_of(one) for one in own if one["sampler"] == EXACT_ENGINE}
    records = []
    for name in dict.fromkeys(one["sampler"] for one in own):
        mine = [one for one in own if one["sampler"] == name]
        said = Counter(map(verdict_of, mine))
        right = [one for one in mine if verdict_of(one) == AGREES]
        behind = [exact[one["target"]] / pace_of(one) for one in right if pace_of(one) > 0]
        records.append(
            {
                "sampler": name,
                "agrees": said[AGREES],
                "of": len(mine),
                "dim": max((load(one["target"]).dim for one in right), default=None),
                "behind": statistics.median(behind) if behind else None,
                "unmixed": said[UNMIXED],
                "differs": said[DIFFERS],
                "cannot tell": said[CANNOT_TELL],
                "no draws": said["no draws"],
            }
        )
    records.sort(key=lambda one: (-one["agrees"], one["behind"] or math.inf))
    columns = (
        Column("sampler", left=True),
        Column("agrees on", lambda one: f"{one['agrees']} of {one['of']}"),
        Column("up to dimension", "dim"),
        Column("exact draws ahead, times (median)", "behind", _count),
        *(Column(head) for head in (UNMIXED, DIFFERS, CANNOT_TELL, "no draws")),
    )
    return Sheet(columns, records)


def sorted_lines(lines: Iterable[Line]) -> list[Line]:
    """By target, budget, and what they earned a second."""
    order = {name: row for row, name in enumerate(targets())}
    return sorted(lines, key=lambda one: (order[one["target"]], one["budget"], -pace_of(one)))


def board(lines: Sequence[Line], target: str, budget: str) -> Sheet:
    """The table of a target, of runs that are equal in one thing; below it what explains who agrees
    by its start."""
    chosen = [one for one in lines if (one["target"], one["budget"]) == (target, budget)]
    columns = (
        Column("sampler", left=True),
        Column("start", lambda one: one["start"] or NOTHING, left=True),
        Column("verdict", said_of, left=True),
        Column("effective draws", lambda one: one.get("effective_draws"), _count),
        Column("earned/s", _earned("seconds"), _rate),
        Column("earned/1,000 evaluations", _earned("evaluations", 1000), _rate),
        Column("to 0.1 sd", _reached),
        Column("evaluations", lambda one: one.get("evaluations"), _count),
        Column("CPU s", lambda one: one.get("seconds"), _rate),
        Column("R-hat", lambda one: one.get("rhat_worst"), fixed(2)),
        Column("missed mass", lambda one: one.get("missed_mass"), written("{:.1%}")),
        Column("worst W1", lambda one: one.get("worst_w1"), fixed(2, " sd")),
        Column("evidence off", lambda one: one.get("evidence_error"), written("{:+.2f} nats")),
    )
    gifts = [gift for gift in map(_gift, chosen) if gift]
    return Sheet(columns, chosen, caption=". ".join(gifts))


def _gift(line: Line) -> str:
    if "earned" not in line:
        return ""
    record = {
        "sampler": line["sampler"],
        "verdict": line["verdict"],
        "start": GIFT if line["start"] == GIFT else "",
        "ess_worst": line["effective_draws"] or 0.0,
        "ess_per_second": pace_of(line),
        "seconds": line["seconds"],
        "rhat_worst": line["rhat_worst"],
    }
    return gift_sentence(record)


def _earned(cost: str, unit: float = 1.0) -> Any:
    return lambda one: unit * one["earned"] / one[cost] if one.get(cost) else None


_count = written("{:,.0f}")


def _rate(value: float | None) -> str:
    if value is None:
        return NOTHING
    return f"{value:,.0f}" if value >= 100 else f"{value:.2g}"


def _reached(line: Line) -> str:
    if "earned" not in line:
        return NOTHING
    return "never" if line["to_distance"] is None else f"{_rate(line['to_distance'])} s"


def ratios(lines: Sequence[Line]) -> Sheet:
    """By target: the exact row against the best of those that were given nothing, by what a second
    earns and by the time to 0.1 sd."""
    columns = (
        Column("target", left=True),
        Column("dim"),
        Column("exact, earned/s", "exact", _rate),
        Column("best other that agrees, from the prior", _best("best", "pace"), left=True),
        Column("ratio", form=_count),
        Column("exact, to 0.1 sd", "exact_time", _seconds),
        Column("first other there, from the prior", _best("first", "time", " s"), left=True),
        Column("ratio of times", _times),
    )
    return Sheet(columns, contests(lines))


def _best(name: str, value: str, unit: str = "") -> Any:
    def said(one: Mapping[str, Any]) -> str:
        return "none" if one[name] is None else f"{one[name]}: {_rate(one[value])}{unit}"

    return said


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{_rate(value)} s"


def _times(one: Mapping[str, Any]) -> str:
    if one["times"] is None:
        return NOTHING
    return ("" if one["first"] else "> ") + _rate(one["times"])


def contests(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """By target: what exact draws and the best other that agrees earn a second, when exact draws
    and the first other are within 0.1 sd, and the ratios of both. None where no other agrees or
    comes there; the ratio of times is then that to all the time that others had, and they would
    need more."""
    records = []
    for target in targets():
        own = [one for one in lines if one["target"] == target and one["budget"] == SECONDS]
        exact = next((one for one in own if one["sampler"] == EXACT_ENGINE), None)
        if exact is None:
            continue
        others = [one for one in own if one["sampler"] != EXACT_ENGINE and one["start"] != GIFT]
        right = [one for one in others if verdict_of(one) == AGREES and one["earned"] > 0]
        best = max(right, key=pace_of, default=None)
        there = [one for one in others if one.get("to_distance") is not None]
        first = min(there, key=lambda one: one["to_distance"], default=None)
        had = max((one["allowed"] for one in others), default=None)
        time = had if first is None else first["to_distance"]
        known = exact["to_distance"]
        records.append(
            {
                "target": target,
                "dim": load(target).dim,
                "exact": pace_of(exact),
                "best": None if best is None else best["sampler"],
                "pace": None if best is None else pace_of(best),
                "ratio": None if best is None else number(pace_of(exact) / pace_of(best)),
                "exact_time": known,
                "first": None if first is None else first["sampler"],
                "time": time,
                "times": None if time is None or known is None else time / known,
            }
        )
    return records


def alarms(verdicts: Mapping[str, tuple[int, Sequence[str]]]) -> Sheet:
    """How often exact draws are said to differ: by target, how many draws a set had, and what was
    said of each."""
    records = []
    for name, (size, said) in verdicts.items():
        records.append(_alarm(name, f"{len(said)} × {size}", said))
    if len(records) > 1:
        records.append(_alarm("all", "", [one for _, said in verdicts.values() for one in said]))
    columns = (
        Column("target", left=True),
        Column("sets × draws", "sets"),
        Column("said to differ", "differ"),
        Column("rate, 95 % interval", "rate"),
        Column("cannot tell"),
    )
    return Sheet(columns, records)


def _alarm(name: str, sets: str, said: Sequence[str]) -> dict[str, Any]:
    differ = said.count(DIFFERS)
    interval = stats.binomtest(differ, len(said)).proportion_ci(0.95)
    return {
        "target": name,
        "sets": sets,
        "differ": f"{differ} of {len(said)}",
        "rate": f"{differ / len(said):.1%} ({interval.low:.1%}–{interval.high:.1%})",
        "cannot tell": said.count(CANNOT_TELL),
    }


def read_alarms(folder: Path) -> dict[str, tuple[int, list[str]]]:
    """What `alarms` needs, from files `exact-<target>.txt`, whose first line is the size of a
    set."""
    found = {}
    for name in targets():
        path = folder / f"exact-{name}.txt"
        if path.exists():
            size, *said = path.read_text(encoding="utf-8").split("\n")
            found[name] = int(size), said
    return found


def finite(value: float) -> float | None:
    """The number, or None where it is infinite or none."""
    return value if math.isfinite(value) else None
