"""Judgements of several samplers as one DataTree with a sampler dimension: `comparison.nc`."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.results import versions
from poseterior.inference.studies.comparison.cost import EPSILON, SHARES, Course
from poseterior.inference.studies.comparison.judge import Judgement
from poseterior.inference.studies.comparison.pace import Pace
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
        rhat = np.array([]) if self.judgement is None else self.judgement.mixing.rhat
        return float(np.nanmax(rhat)) if np.isfinite(rhat).any() else np.nan

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


def _summary(entries: list[Entry]) -> xr.Dataset:
    numbers = {
        "num_draws": [entry.num_draws for entry in entries],
        "num_evaluations": [entry.evaluations for entry in entries],
        "seconds": [entry.seconds for entry in entries],
        "ess_worst": [entry.worst_ess for entry in entries],
        "ess_per_second": [entry.ess_per_second for entry in entries],
        "settled_per_second": [entry.settled_per_second for entry in entries],
        "autocorrelation_time": [
            np.nan if entry.pace is None else entry.pace.time for entry in entries
        ],
        "time_known": [float(entry.pace is not None and entry.pace.known) for entry in entries],
        "rhat_worst": [entry.worst_rhat for entry in entries],
        "seconds_to_distance": [entry.seconds_to_distance for entry in entries],
        "log_evidence": [entry.log_evidence for entry in entries],
        "log_evidence_se": [entry.log_evidence_se for entry in entries],
    }
    words = {
        "verdict": [entry.verdict for entry in entries],
        "sentence": [entry.sentence for entry in entries],
        "start": [entry.start for entry in entries],
    }
    judged = {
        "distance": _each(entries, lambda found: found.distance),
        "missed_mass": _each(entries, lambda found: found.modes.missed),
        "expected_missed_mass": _each(entries, lambda found: found.modes.expected_missed),
        "unique": _each(entries, lambda found: found.mixing.unique),
    }
    return xr.Dataset(
        {name: ("sampler", values) for name, values in {**words, **numbers, **judged}.items()}
    )


def _each(entries: list[Entry], what: Callable[[Judgement], float]) -> list[float]:
    return [np.nan if entry.judgement is None else what(entry.judgement) for entry in entries]


def _course(entries: list[Entry]) -> xr.Dataset:
    blank = np.full(len(SHARES), np.nan)
    seconds = [blank if one.course is None else one.course.seconds for one in entries]
    distance = [blank if one.course is None else one.course.distance for one in entries]
    return xr.Dataset(
        {
            "seconds": (("sampler", "part"), np.stack(seconds)),
            "distance": (("sampler", "part"), np.stack(distance)),
        }
    )


def _draws(entries: list[Entry], exact: Sample) -> xr.Dataset:
    """Some draws of every sampler, NaN where it has fewer, and some exact ones."""
    table = np.full((len(entries), SHOWN_DRAWS, len(exact.names)), np.nan, np.float32)
    for row, entry in enumerate(entries):
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

    found = [
        {
            kind(test.name): test
            for test in ((*one.judgement.tests, *one.judgement.others) if one.judgement else ())
        }
        for one in entries
    ]
    names = list(dict.fromkeys(name for tests in found for name in tests))
    return xr.Dataset(
        {
            field: (
                ("sampler", "test"),
                [
                    [getattr(tests[name], field) if name in tests else np.nan for name in names]
                    for tests in found
                ],
            )
            for field in ("statistic", "p_value", "size")
        },
        coords={"test": names},
    )


def _coordinates(entries: list[Entry], names: tuple[str, ...]) -> xr.Dataset:
    blank = np.full(len(names), np.nan)
    columns = {
        "ess_bulk": [
            blank if one.judgement is None else one.judgement.mixing.bulk for one in entries
        ],
        "ess_tail": [
            blank if one.judgement is None else one.judgement.mixing.tail for one in entries
        ],
        "rhat": [blank if one.judgement is None else one.judgement.mixing.rhat for one in entries],
        "p_shift": [
            blank if one.judgement is None else one.judgement.coordinate_p[:, 0] for one in entries
        ],
        "p_spread": [
            blank if one.judgement is None else one.judgement.coordinate_p[:, 1] for one in entries
        ],
    }
    data = {name: (("sampler", "coordinate"), np.stack(values)) for name, values in columns.items()}
    return xr.Dataset(data, coords={"coordinate": list(names)})


def _joints(entries: list[Entry]) -> xr.Dataset:
    blank = np.full(len(BONES), np.nan)
    depth = np.stack(
        [blank if one.judgement is None else one.judgement.joint_w1 for one in entries]
    )
    coords = {"joint": [JOINTS[bone.end] for bone in BONES]}
    return xr.Dataset(
        {"w1_depth": (("sampler", "joint"), depth, {"units": "body units"})}, coords=coords
    )


def _modes(judged: list[Entry]) -> xr.Dataset:
    """Shares of the depth flips, commonest first; a pattern is written as one letter a bone,
    t(owards) or a(way)."""
    tables = []
    for entry in judged:
        assert entry.judgement is not None
        found = entry.judgement.modes
        names = ["".join("ta"[away] for away in pattern.astype(int)) for pattern in found.patterns]
        tables.append(
            (dict(zip(names, found.share, strict=True)), dict(zip(names, found.exact, strict=True)))
        )
    exact = {name: share for _, known in tables for name, share in known.items() if share > 0}
    order = sorted(exact, key=lambda name: -exact[name])
    return xr.Dataset(
        {
            "share": (
                ("sampler", "mode"),
                [[share.get(name, 0.0) for name in order] for share, _ in tables],
            ),
            "exact_share": (("mode",), [exact[name] for name in order]),
        },
        coords={"sampler": [entry.label for entry in judged], "mode": order},
        attrs={
            "bones": ", ".join(bone.name for bone in FLIPPING),
            "letters": "t: towards the camera, a: away from it",
        },
    )
