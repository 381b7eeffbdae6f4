"""Judgements of several samplers as one DataTree with a sampler dimension: `comparison.nc`."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.results import versions
from poseterior.inference.studies.comparison.cost import EPSILON, SHARES, Course
from poseterior.inference.studies.comparison.judge import Judgement, Test
from poseterior.inference.studies.comparison.pace import Pace
from poseterior.inference.studies.comparison.power import SmallestSeen
from poseterior.inference.studies.comparison.sample import NAMES, Sample
from poseterior.inference.studies.flips import FLIPPING
from poseterior.probmodel.skeleton import BONES, JOINTS

SHOWN_DRAWS, EXACT_SHOWN = 1000, 4000
"""Draws that are kept for pictures, of each sampler and exact ones."""


class Entry(NamedTuple):
    """One sampler's line: its name and start, the judgement (None where it brought no draws), its
    sentence, cost, course and pace, its log evidence with the standard error, and some `draws` `(n,
    c)` for pictures."""

    sampler: str
    start: str
    judgement: Judgement | None
    sentence: str
    num_draws: int
    evaluations: float
    seconds: float
    course: Course | None
    pace: Pace | None
    log_evidence: float
    log_evidence_se: float
    draws: np.ndarray = np.empty((0, len(NAMES)))

    @classmethod
    def without_draws(
        cls,
        sampler: str,
        start: str,
        sentence: str,
        cost: tuple[float, float],
        evidence: tuple[float, float] = (np.nan, np.nan),
    ) -> "Entry":
        """The line of a sampler that brought none, for so many evaluations and seconds."""
        return cls(
            sampler=sampler,
            start=start,
            judgement=None,
            sentence=sentence,
            num_draws=0,
            evaluations=cost[0],
            seconds=cost[1],
            course=None,
            pace=None,
            log_evidence=evidence[0],
            log_evidence_se=evidence[1],
        )

    @property
    def label(self) -> str:
        """The name in tables and plots."""
        return f"{self.sampler} ({self.start})" if self.start else self.sampler

    @property
    def verdict(self) -> str:
        """The judgement's, or that there was nothing to judge."""
        return "no draws" if self.judgement is None else self.judgement.verdict

    @property
    def worst_ess(self) -> float:
        """Effective draws of the worst coordinate, bulk or tail."""
        return 0.0 if self.judgement is None else self.judgement.mixing.worst

    @property
    def ess_per_second(self) -> float:
        """Effective draws of the worst coordinate a second, beyond the exact ones that the start
        was given."""
        return 0.0 if self.pace is None else self.pace.earned / self.seconds

    @property
    def settled_per_second(self) -> float:
        """The same of a run without its burn-in, by the autocorrelation time; see
        `Pace.settled`."""
        if self.pace is None or self.course is None:
            return 0.0
        if self.course.kept == 0:  # its draws come at the end: there is no burn-in to leave out
            return self.ess_per_second
        return self.pace.settled / (self.seconds * self.course.kept)

    @property
    def worst_rhat(self) -> float:
        """The largest R-hat of a coordinate; NaN where there is none."""
        return np.nan if self.judgement is None else self.judgement.mixing.worst_rhat

    @property
    def seconds_to_distance(self) -> float:
        """Seconds until the distance is `EPSILON`; infinite where it is not reached."""
        return np.inf if self.course is None else self.course.seconds_to()


def comparison_tree(
    entries: list[Entry], exact: Sample, attributes: dict[str, object]
) -> xr.DataTree:
    """Groups `summary`, `course`, `draws`, and where there are judgements `tests`, `coordinates`,
    `joints`, `modes`; every variable but the exact ones has the dimension `sampler`."""
    labels = [entry.label for entry in entries]
    groups = {
        "summary": _summary(entries),
        "course": _course(entries),
        "draws": _draws(entries, exact),
    }
    judged = [entry for entry in entries if entry.judgement is not None]
    if judged:
        groups |= {
            "tests": _tests(entries),
            "coordinates": _coordinates(entries, exact.names),
            "joints": _joints(entries),
            "modes": _modes(judged),
        }
    tree = xr.DataTree.from_dict(
        {
            name: group if "sampler" in group.coords else group.assign_coords(sampler=labels)
            for name, group in groups.items()
        }
    )
    tree.attrs.update({**attributes, "epsilon": EPSILON, "versions": versions()})
    return tree


def _column(entries: list[Entry], part: str, what: Callable[[Any], Any], without: Any) -> list[Any]:
    """Something of a part of every line; where a line lacks that part, what stands `without` it."""
    parts = (getattr(entry, part) for entry in entries)
    return [without if one is None else what(one) for one in parts]


def _judged(entries: list[Entry], what: Callable[[Judgement], Any], size: int = 1) -> np.ndarray:
    """`(sampler, size)`: something of every judgement, NaN where there is none."""
    return np.stack(_column(entries, "judgement", what, np.full(size, np.nan)))


def _summary(entries: list[Entry]) -> xr.Dataset:
    own = {
        "verdict": "verdict",
        "sentence": "sentence",
        "start": "start",
        "num_draws": "num_draws",
        "num_evaluations": "evaluations",
        "seconds": "seconds",
        "ess_worst": "worst_ess",
        "ess_per_second": "ess_per_second",
        "settled_per_second": "settled_per_second",
        "rhat_worst": "worst_rhat",
        "seconds_to_distance": "seconds_to_distance",
        "log_evidence": "log_evidence",
        "log_evidence_se": "log_evidence_se",
    }
    columns = {name: [getattr(entry, field) for entry in entries] for name, field in own.items()}
    columns |= {
        "autocorrelation_time": _column(entries, "pace", lambda pace: pace.time, np.nan),
        "time_known": _column(entries, "pace", lambda pace: float(pace.known), 0.0),
        "distance": _column(entries, "judgement", lambda one: one.distance, np.nan),
        "missed_mass": _column(entries, "judgement", lambda one: one.modes.missed, np.nan),
        "expected_missed_mass": _column(
            entries, "judgement", lambda one: one.modes.expected_missed, np.nan
        ),
        "unique": _column(entries, "judgement", lambda one: one.mixing.unique, np.nan),
    }
    seen = [None if entry.judgement is None else entry.judgement.seen for entry in entries]
    columns |= {
        f"seen_{name}": [np.nan if one is None else getattr(one, name) for one in seen]
        for name in SmallestSeen._fields
    }
    return xr.Dataset({name: ("sampler", values) for name, values in columns.items()})


def _course(entries: list[Entry]) -> xr.Dataset:
    blank = np.full(len(SHARES), np.nan)
    columns = {
        "seconds": _column(entries, "course", lambda course: course.seconds, blank),
        "distance": _column(entries, "course", lambda course: course.distance, blank),
    }
    return xr.Dataset(
        {name: (("sampler", "part"), np.stack(values)) for name, values in columns.items()}
    )


def _draws(entries: list[Entry], exact: Sample) -> xr.Dataset:
    """Some draws of every sampler, NaN where it has fewer, and some exact ones."""
    table = np.full((len(entries), SHOWN_DRAWS, len(exact.names)), np.nan, np.float32)
    for row, entry in enumerate(entries):
        if len(entry.draws):  # where there are none, nobody knows of how many coordinates
            table[row, : len(entry.draws)] = entry.draws[:SHOWN_DRAWS]
    known = exact.flat[:: max(1, exact.num_draws // EXACT_SHOWN)][:EXACT_SHOWN].astype(np.float32)
    return xr.Dataset(
        {
            "value": (("sampler", "draw", "coordinate"), table),
            "exact": (("exact_draw", "coordinate"), known),
        },
        coords={"coordinate": list(exact.names)},
        attrs={"units": "body units"},
    )


def _tests(entries: list[Entry]) -> xr.Dataset:
    """p-values by kind of test; the worst coordinate's name varies, so its kind is
    "coordinates"."""

    def kind(name: str) -> str:
        return "coordinates" if name.endswith((", shift", ", spread")) else name

    def by_kind(judgement: Judgement) -> dict[str, Test]:
        return {kind(test.name): test for test in (*judgement.tests, *judgement.beside)}

    found = _column(entries, "judgement", by_kind, {})
    names = list(dict.fromkeys(name for tests in found for name in tests))
    fields = ("statistic", "p_value", "size")
    values = {
        field: [[getattr(tests.get(name), field, np.nan) for name in names] for tests in found]
        for field in fields
    }
    return xr.Dataset(
        {field: (("sampler", "test"), values[field]) for field in fields}, coords={"test": names}
    )


def _coordinates(entries: list[Entry], names: tuple[str, ...]) -> xr.Dataset:
    columns: dict[str, Callable[[Judgement], np.ndarray]] = {
        "ess_bulk": lambda one: one.mixing.bulk,
        "ess_tail": lambda one: one.mixing.tail,
        "rhat": lambda one: one.mixing.rhat,
        "p_shift": lambda one: one.coordinate_p[:, 0],
        "p_spread": lambda one: one.coordinate_p[:, 1],
    }
    data = {
        name: (("sampler", "coordinate"), _judged(entries, what, len(names)))
        for name, what in columns.items()
    }
    return xr.Dataset(data, coords={"coordinate": list(names)})


def _joints(entries: list[Entry]) -> xr.Dataset:
    depth = _judged(entries, lambda one: one.joint_w1, len(BONES))
    return xr.Dataset(
        {"w1_depth": (("sampler", "joint"), depth, {"units": "body units"})},
        coords={"joint": [JOINTS[bone.end] for bone in BONES]},
    )


def _modes(judged: list[Entry]) -> xr.Dataset:
    """Shares of the depth flips, commonest first; a pattern is written as one letter a bone,
    t(owards) or a(way)."""
    shares: list[dict[str, float]] = []
    exact: dict[str, float] = {}
    for found in _column(judged, "judgement", lambda one: one.modes, None):
        names = ["".join("ta"[away] for away in pattern.astype(int)) for pattern in found.patterns]
        shares.append(dict(zip(names, found.share, strict=True)))
        exact |= {name: share for name, share in zip(names, found.exact, strict=True) if share > 0}
    order = sorted(exact, key=lambda name: -exact[name])
    of_mode = [[share.get(name, 0.0) for name in order] for share in shares]
    return xr.Dataset(
        {
            "share": (("sampler", "mode"), of_mode),
            "exact_share": (("mode",), [exact[name] for name in order]),
        },
        coords={"sampler": [entry.label for entry in judged], "mode": order},
        attrs={
            "bones": ", ".join(bone.name for bone in FLIPPING),
            "letters": "t: towards the camera, a: away from it",
        },
    )
