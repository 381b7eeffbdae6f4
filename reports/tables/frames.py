"""What came out of a stream of frames."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from poseterior.inference.stream import frame_and_person
from poseterior.probmodel.body import MILLIMETRES
from poseterior.probmodel.skeleton import BONES, JOINTS
from poseterior.reports.tables.posterior import UNIT_NOTE
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, fixed, number
from poseterior.reports.tables.words import spoken

BELIEVED = 0.5
"""Probability above which a detection is called wrong."""
MOST_RUNS = 5
"""Stretches of frames that are named."""
LIMB_ENDS = tuple(sorted(bone.end for bone in BONES))
"""The joints that move."""


def stream_json(summary: xr.Dataset) -> dict[str, Any]:
    """How many frames came to what end, and each frame's draws, evidence, effective roots and
    the probability that left and right are exchanged, of several views in that where it is greatest
    (None where nothing is known of them)."""
    status, counts = np.unique(summary.status.values, return_counts=True)
    rows = zip(
        summary.frame.values,
        summary.status.values,
        summary.sentence.values,
        summary.num_draws.values,
        summary.log_evidence.values,
        summary.effective_roots.values,
        summary.exchange.values[..., 1:].sum(axis=-1).reshape(len(summary.frame), -1).max(axis=1),
        strict=True,
    )
    frames = [
        {
            "frame": str(name),
            "status": str(end),
            "sentence": str(why),
            "num_draws": int(draws),
            "log_evidence": number(evidence),
            "effective_roots": number(effective),
            "exchanged": number(exchanged),
        }
        for name, end, why, draws, evidence, effective, exchanged in rows
    ]
    return {"status": dict(zip(map(str, status), map(int, counts), strict=True)), "frames": frames}


def people_of_film(summary: xr.Dataset) -> Sheet:
    """Each person: in how many frames, with how many poses, and how well these are explained."""
    owner = np.array([person for _, person in _names(summary)])
    there = summary.num_draws.values > 0
    records = []
    for person in sorted(set(owner.tolist()), key=lambda name: (len(name), name)):
        own = owner == person
        evidence = summary.log_evidence.values[own]
        evidence = evidence[np.isfinite(evidence)]  # of those that were drawn, not filled
        records.append(
            {
                "person": person,
                "frames": int(own.sum()),
                "poses": int((own & there).sum()),
                "log_evidence": number(np.median(evidence)) if len(evidence) else None,
            }
        )
    columns = [
        Column("person", form=lambda person: person or NOTHING),
        Column("frames"),
        Column("with a pose", "poses"),
        Column("log evidence, median", "log_evidence", fixed(1)),
    ]
    return Sheet(columns, records, "People")


def film_table(summary: xr.Dataset) -> Sheet:
    """Each joint of the limbs: how well its depth is known over all frames, of calibrated cameras
    its place, and where worst."""
    there = np.flatnonzero(summary.num_draws.values > 0)
    in_world = "view" in summary.dims
    unit_mm = summary.attrs["unit_mm"] if in_world else MILLIMETRES
    spread = summary.sd.values[there]
    depth = np.linalg.norm(spread, axis=-1) if in_world else spread[..., 2]
    several = len({person for _, person in _names(summary)}) > 1
    names = [
        f"{frame}, person {person}" if several else frame
        for frame, person in _names(summary.isel(frame=there))
    ]
    records = [
        {
            "joint": JOINTS[joint],
            "median_sd": float(np.median(depth[:, joint])),
            "median_sd_mm": float(np.median(depth[:, joint])) * unit_mm,
            "least_sd": float(depth[:, joint].min()),
            "most_sd": float(depth[:, joint].max()),
            "most_in": names[int(np.argmax(depth[:, joint]))],
        }
        for joint in (LIMB_ENDS if len(there) else ())
    ]
    columns = [
        Column("joint", form=spoken, left=True),
        Column("sd" if in_world else "sd of depth", "median_sd", fixed(2)),
        Column("mm", "median_sd_mm", fixed(0)),
        Column("least", "least_sd", fixed(2)),
        Column("most", "most_sd", fixed(2)),
        Column("in frame", "most_in", left=True),
    ]
    caption = f"sd: standard deviation of depth behind the pelvis, median over frames. {UNIT_NOTE}."
    if in_world:
        caption = (
            "sd: standard deviation from the pelvis, of all axes together, median over frames."
            f" 1 body unit = {unit_mm:.0f} mm."
        )
    return Sheet(columns, records, "The film", caption)


def stream_lines(summary: xr.Dataset, fragments: Sequence[str] = ()) -> list[str]:
    """How many frames and people there are, to what end they came, the first reasons of those that
    brought nothing, and how many `fragments` of people were left out."""
    counts = stream_json(summary)["status"]
    ends = ", ".join(f"{count:,} {status}" for status, count in counts.items())
    frames, owners = (set(part) for part in zip(*_names(summary), strict=True))
    people = summary.sizes["frame"]
    said = "1 person" if len(owners) == 1 else f"{len(owners):,} people"
    failed = summary.isel(frame=np.flatnonzero(summary.status.values != "complete")[:3])
    reasons = zip(failed.frame.values, failed.sentence.values, strict=True)
    together = f", {people:,} times somebody" if len(owners) > 1 else ""
    lines = [f"{_count(len(frames), 'frame')} of {said}{together}: {ends}"]
    effective = summary.effective_roots.values
    effective = effective[np.isfinite(effective)]
    if len(effective):
        lines.append(
            f"effective roots of a frame: {np.median(effective):.0f}, the median; the fewest"
            f" {effective.min():.0f}"
        )
    lines += [f"{name}: {why}" for name, why in reasons]
    lines += fault_lines(summary)
    if fragments:
        lines.append(
            f"{_count(len(fragments), 'fragment')} of people left out: too little is seen of them"
            f" beside somebody else (the first: {fragments[0]})"
        )
    return lines


class Misread(NamedTuple):
    """Frames one after the other, `first` to `last`, in which left and right of the same parts are
    exchanged, more probably than not; the least of the probabilities, how many frames, and in which
    view of several."""

    first: str
    last: str
    pattern: str
    share: float
    number: int
    view: str = ""


def misread(summary: xr.Dataset) -> list[Misread]:
    """Where left and right are exchanged, by view, by person, and in their order."""
    if "view" not in summary.exchange.dims:
        return _misread(summary)
    views = [summary.isel(view=row) for row in range(summary.sizes["view"])]
    return [one._replace(view=str(own.view.values)) for own in views for one in _misread(own)]


def _misread(summary: xr.Dataset) -> list[Misread]:
    owner = np.array([person for _, person in _names(summary)])
    share = np.nan_to_num(summary.exchange.values[:, 1:])
    total = share.sum(axis=1)
    pattern = np.where(total > BELIEVED, 1 + np.argmax(share, axis=1), 0)
    found = []
    for person in dict.fromkeys(owner.tolist()):
        for which, some in itertools.groupby(np.flatnonzero(owner == person), pattern.__getitem__):
            rows = list(some)
            if which:
                first, last = (str(summary.frame.values[row]) for row in (rows[0], rows[-1]))
                name = str(summary.pattern.values[which])
                found.append(Misread(first, last, name, float(total[rows].min()), len(rows)))
    return found


def fault_lines(summary: xr.Dataset) -> list[str]:
    """In which frames left and right are exchanged, and which keypoints are wrong most often."""
    lines, runs = [], misread(summary)
    if runs:
        each = [
            f"{run.first}{'' if run.number == 1 else f' to {run.last}'}"
            f"{run.view and f' of {run.view}'} ({run.pattern}, {100 * run.share:.0f} %)"
            for run in runs[:MOST_RUNS]
        ]
        more = f" and {len(runs) - MOST_RUNS} more" if len(runs) > MOST_RUNS else ""
        total = sum(run.number for run in runs)
        frames = _count(total, "frame")
        lines.append(f"left and right are exchanged in {frames}: {', '.join(each)}{more}")
    wrong = (summary.outlier.values > BELIEVED).sum(axis=0).reshape(-1, len(JOINTS)).sum(axis=0)
    if wrong.any():
        times = "time" if "view" in summary.outlier.dims else "frame"
        worst = int(np.argmax(wrong))
        lines.append(
            f"{_count(int(wrong.sum()), 'keypoint')} probably wrong, the {spoken(JOINTS[worst])}"
            f" most often ({_count(int(wrong[worst]), times)})"
        )
    return lines


def _names(summary: xr.Dataset) -> list[tuple[str, str]]:
    """The frame and the person of each row."""
    return [frame_and_person(str(name)) for name in summary.frame.values]


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"
