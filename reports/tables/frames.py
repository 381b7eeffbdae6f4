"""What came out of a stream of frames."""

from typing import Any

import numpy as np
import xarray as xr

from reports.tables.posterior import UNIT_NOTE
from reports.tables.sheet import Column, Sheet, fixed, number


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


def stream_table(summary: xr.Dataset, most: int = 12) -> Sheet:
    """The first frames: evidence, and how uncertain the depths of wrists and ankles are; effective
    roots where the root is uncertain."""
    uncertain = bool(np.isfinite(summary.effective_roots.values).any())
    summary = summary.isel(frame=slice(most))
    depth = summary.sd.sel(axis="z")
    records = [
        {
            **record,
            **{end: _both_sides(depth.isel(frame=index), end) for end in ("wrist", "ankle")},
        }
        for index, record in enumerate(stream_json(summary)["frames"])
    ]
    columns = [
        Column("frame", left=True),
        Column("draws", "num_draws"),
        *([Column("roots", "effective_roots", fixed(0))] if uncertain else []),
        Column("log evidence", "log_evidence", fixed(1)),
        Column("wrists sd", "wrist"),
        Column("ankles sd", "ankle"),
        Column("", "status", lambda end: "" if end == "complete" else end, left=True),
    ]
    roots = " Roots: effective number." if uncertain else ""
    caption = f"sd: standard deviation of depth behind the pelvis. {UNIT_NOTE}.{roots}"
    return Sheet(columns, records, "Frames", caption)


def _both_sides(depth: xr.DataArray, end: str) -> str:
    pair = depth.sel(joint=[f"right_{end}", f"left_{end}"]).values
    return "/".join(fixed(2)(number(value)) for value in pair)


def stream_lines(summary: xr.Dataset) -> list[str]:
    """How many frames came to what end, and the first reasons of those that brought nothing."""
    counts = stream_json(summary)["status"]
    ends = ", ".join(f"{count:,} {status}" for status, count in counts.items())
    failed = summary.isel(frame=np.flatnonzero(summary.status.values != "complete")[:3])
    reasons = zip(failed.frame.values, failed.sentence.values, strict=True)
    lines = [f"{summary.sizes['frame']:,} frames: {ends}"]
    return lines + [f"{name}: {why}" for name, why in reasons]
