"""Which bones break which limit."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from poseterior.probmodel.anatomy.limits import LIMITS, Check
from poseterior.probmodel.skeleton import BONE_NAMES
from poseterior.reports.tables.sheet import Column, Sheet, fixed, number
from poseterior.reports.tables.words import spoken

BREAKS = {
    "occupancy": "points outside its directions",
    "parent": "hangs from an impossible bone",
    "plane": "bends beyond the joint's plane",
    "box": "turns beyond the joint's range",
}


def check_json(check: Check, names: Sequence[str]) -> list[dict[str, Any]]:
    """Each pose: its name, whether it is possible, and which bone breaks which limit by how many
    degrees (None for a bone that hangs from an impossible one)."""
    valid, limit, excess = (np.atleast_2d(array) for array in check)
    return [
        {
            "pose": name,
            "possible": bool(valid[pose].all()),
            "broken": [
                {
                    "bone": bone,
                    "limit": LIMITS[limit[pose, i]],
                    "excess_degrees": number(excess[pose, i]),
                }
                for i, bone in enumerate(BONE_NAMES)
                if not valid[pose, i]
            ],
        }
        for pose, name in zip(range(len(valid)), names, strict=True)
    ]


def check_table(check: Check, names: Sequence[str]) -> Sheet:
    """One row for each broken limit; the caption says how many poses break none."""
    poses = check_json(check, names)
    records = [{"pose": pose["pose"], **broken} for pose in poses for broken in pose["broken"]]
    columns = [
        Column("pose", left=True),
        Column("bone", form=spoken, left=True),
        Column("breaks", "limit", BREAKS.__getitem__, left=True),
        Column("by degrees", "excess_degrees", fixed(1)),
    ]
    possible = sum(pose["possible"] for pose in poses)
    caption = f"{possible} of {len(poses)} poses are possible."
    return Sheet(columns, records, "Anatomical limits", caption)


def broken_table(check: Check) -> Sheet:
    """How many poses break each limit of each bone, and by how much at most."""
    records = []
    for index, bone in enumerate(BONE_NAMES):
        for code, limit in enumerate(LIMITS[1:], 1):
            excess = check.excess[check.limit[:, index] == code, index]
            if len(excess):
                most = None if np.isnan(excess).all() else float(np.nanmax(excess))
                records.append({"bone": bone, "limit": limit, "poses": len(excess), "most": most})
    columns = [
        Column("bone", form=spoken, left=True),
        Column("limit", left=True),
        Column("poses"),
        Column("most degrees", "most", fixed(1)),
    ]
    return Sheet(columns, records, "Broken limits")
