"""What came out of a stream of frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from poseterior.inference.stream import frame_and_person
from poseterior.probmodel.skeleton import BONES, JOINTS
from poseterior.reports.tables.posterior import MILLIMETRES, UNIT_NOTE
from poseterior.reports.tables.sheet import NOTHING, Column, Sheet, fixed, number
from poseterior.reports.tables.words import spoken

LIMB_ENDS = tuple(sorted(bone.end for bone in BONES))
"""The joints that move."""


def stream_json(summary: xr.Dataset) -> dict[str, Any]:
    """How many frames came to what end, and each frame's draws, evidence and effective roots (None
    where the root is fixed)."""
    status, counts = np.unique(summary.status.values, return_counts=True)
    rows = zip(
        summary.frame.values,
        summary.status.values,
        summary.sentence.values,
        summary.num_draws.values,
        summary.log_evidence.values,
        summary.effective_roots.values,
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
        }
        for name, end, why, draws, evidence, effective in rows
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
    """Each joint of the limbs: how well its depth is known over all frames, and where worst."""
    there = np.flatnonzero(summary.num_draws.values > 0)
    depth = summary.sd.sel(axis="z").values[there]
    several = len({person for _, person in _names(summary)}) > 1
    names = [
        f"{frame}, person {person}" if several else frame
        for frame, person in _names(summary.isel(frame=there))
    ]
    records = [
        {
            "joint": JOINTS[joint],
            "median_sd": float(np.median(depth[:, joint])),
            "median_sd_mm": float(np.median(depth[:, joint])) * MILLIMETRES,
            "least_sd": float(depth[:, joint].min()),
            "most_sd": float(depth[:, joint].max()),
            "most_in": names[int(np.argmax(depth[:, joint]))],
        }
        for joint in (LIMB_ENDS if len(there) else ())
    ]
    columns = [
        Column("joint", form=spoken, left=True),
        Column("sd of depth", "median_sd", fixed(2)),
        Column("mm", "median_sd_mm", fixed(0)),
        Column("least", "least_sd", fixed(2)),
        Column("most", "most_sd", fixed(2)),
        Column("in frame", "most_in", left=True),
    ]
    caption = f"sd: standard deviation of depth behind the pelvis, median over frames. {UNIT_NOTE}."
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
    if fragments:
        lines.append(
            f"{_count(len(fragments), 'fragment')} of people left out: too little is seen of them"
            f" beside somebody else (the first: {fragments[0]})"
        )
    return lines


def _names(summary: xr.Dataset) -> list[tuple[str, str]]:
    """The frame and the person of each row."""
    return [frame_and_person(str(name)) for name in summary.frame.values]


def _count(number: int, what: str) -> str:
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"
